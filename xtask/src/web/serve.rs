//! Static files on the loopback, for looking at the page and for its tests.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::path::{Component, Path, PathBuf};

use percent_encoding::percent_decode_str;

use crate::XtaskError;

/// Bytes of a request's head at most: browsers send a few hundred.
const MOST_HEAD: u64 = 64 << 10;

/// Serves `folder` on `port` of the loopback for ever.
pub fn serve(folder: &Path, port: u16) -> Result<(), XtaskError> {
    let failed = |source| XtaskError::Port { port, source };
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(failed)?;
    let address = listener.local_addr().map_err(failed)?;
    // The first line of the output says where, for programs that ask for any free port.
    println!("http://{address}/");
    std::thread::scope(|scope| {
        for stream in listener.incoming() {
            // One that is gone again is no reason to stop.
            let Ok(stream) = stream else { continue };
            scope.spawn(move || answer(stream, folder));
        }
    });
    Ok(())
}

/// Answers one request. A browser that goes away meanwhile gets none.
fn answer(stream: TcpStream, folder: &Path) {
    let mut head = BufReader::new((&stream).take(MOST_HEAD));
    let mut request = String::new();
    let mut line = String::new();
    if head.read_line(&mut request).is_err() {
        return;
    }
    while head.read_line(&mut line).is_ok_and(|count| count > 2) {
        line.clear();
    }
    _ = respond(&stream, folder, &request);
}

fn respond(mut stream: &TcpStream, folder: &Path, request: &str) -> io::Result<()> {
    let plain = |mut stream: &TcpStream, status: &str| {
        write!(stream, "HTTP/1.1 {status}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
    };
    let mut words = request.split(' ');
    let (method, target) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    if !["GET", "HEAD"].contains(&method) {
        return plain(stream, "405 Method Not Allowed");
    }
    let file = path_of(target).and_then(|path| File::open(folder.join(&path)).ok().map(|file| (path, file)));
    let Some((path, mut file)) = file.filter(|(_, file)| file.metadata().is_ok_and(|m| m.is_file())) else {
        return plain(stream, "404 Not Found");
    };
    // The page may share memory between threads only if it is isolated from others.
    write!(
        stream,
        "HTTP/1.1 200 OK\r\nContent-Type: {}\r\nContent-Length: {}\r\nCache-Control: no-store\r\n\
         Cross-Origin-Opener-Policy: same-origin\r\nCross-Origin-Embedder-Policy: require-corp\r\n\
         Cross-Origin-Resource-Policy: same-origin\r\nConnection: close\r\n\r\n",
        type_of(&path),
        file.metadata()?.len()
    )?;
    if method == "GET" {
        io::copy(&mut file, &mut stream)?;
    }
    Ok(())
}

/// The file that `target` of a request names, within the folder; `None` of one that leads out of it.
fn path_of(target: &str) -> Option<PathBuf> {
    let path = target.split(['?', '#']).next()?.strip_prefix('/')?;
    let path = percent_decode_str(path).decode_utf8().ok()?;
    let path = PathBuf::from(if path.is_empty() { "index.html" } else { &*path });
    path.components().all(|part| matches!(part, Component::Normal(_))).then_some(path)
}

fn type_of(path: &Path) -> &'static str {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("json") => "application/json",
        // Browsers compile WebAssembly while it comes only under its own type.
        Some("wasm") => "application/wasm",
        Some("png") => "image/png",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_name_files_within_the_folder_alone() {
        for (target, path) in [
            ("/", Some("index.html")),
            ("/?url=a.ply", Some("index.html")),
            ("/a/b%20c.wasm", Some("a/b c.wasm")),
            ("/../etc/passwd", None),
            ("/a/%2e%2e/%2e%2e/b", None),
            ("//etc/passwd", None),
            ("/%ff", None),
            ("/%zz", Some("%zz")),
            ("/%2e%2e%2fetc", None),
            ("a", None),
            ("", None),
        ] {
            assert_eq!(path_of(target), path.map(PathBuf::from), "{target}");
        }
    }

    fn ask(request: &str, folder: &Path) -> String {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let address = listener.local_addr().unwrap();
        std::thread::scope(|scope| {
            scope.spawn(|| answer(listener.accept().unwrap().0, folder));
            let mut stream = TcpStream::connect(address).unwrap();
            stream.write_all(request.as_bytes()).unwrap();
            let mut said = String::new();
            stream.read_to_string(&mut said).unwrap();
            said
        })
    }

    #[test]
    fn files_come_with_their_type_and_others_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a.wasm"), "bytes").unwrap();
        let said = ask("GET /a.wasm HTTP/1.1\r\nHost: x\r\n\r\n", folder.path());
        assert!(said.starts_with("HTTP/1.1 200 OK\r\n") && said.ends_with("\r\n\r\nbytes"), "{said}");
        assert!(said.contains("Content-Type: application/wasm\r\nContent-Length: 5\r\n"), "{said}");
        assert!(said.contains("Cross-Origin-Opener-Policy: same-origin"), "{said}");
        assert!(ask("HEAD /a.wasm HTTP/1.1\r\n\r\n", folder.path()).ends_with("\r\n\r\n"));
        for (request, status) in
            [("GET /none", "404"), ("POST /a.wasm", "405"), ("GET /", "404"), ("x", "405")]
        {
            let said = ask(&format!("{request} HTTP/1.1\r\n\r\n"), folder.path());
            assert!(said.starts_with(&format!("HTTP/1.1 {status} ")), "{request}: {said}");
        }
    }
}
