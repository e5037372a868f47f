//! A server of files on the loopback interface.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::thread;

use percent_encoding::percent_decode_str;

/// Answers `GET` with the files of `folder` for as long as the program runs, and 404 for others. Returns the server's
/// address, `http://127.0.0.1:PORT`.
///
/// # Panics
/// If there is no loopback interface.
#[must_use]
pub fn serve(folder: &Path) -> String {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let address = format!("http://{}", listener.local_addr().expect("an address"));
    let folder = folder.to_owned();
    thread::spawn(move || listener.incoming().flatten().for_each(|stream| answer(&stream, &folder)));
    address
}

/// Answers one request. A client that goes away is no failure.
fn answer(mut stream: &TcpStream, folder: &Path) {
    let mut lines = BufReader::new(stream).lines().map_while(Result::ok);
    let request = lines.next().unwrap_or_default();
    lines.find(String::is_empty);
    let (status, body) = match fs::read(file(&request, folder)) {
        Ok(body) => ("200 OK", body),
        Err(_) => ("404 Not Found", Vec::new()),
    };
    let head = format!("HTTP/1.1 {status}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n", body.len());
    _ = stream.write_all(head.as_bytes()).and_then(|()| stream.write_all(&body));
}

/// The file that the first line of a request asks for: `GET /PATH?QUERY HTTP/1.1`.
fn file(request: &str, folder: &Path) -> PathBuf {
    let path = request.split(' ').nth(1).unwrap_or_default().trim_start_matches('/');
    let path = path.split('?').next().unwrap_or_default();
    folder.join(percent_decode_str(path).decode_utf8_lossy().as_ref())
}
