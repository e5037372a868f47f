//! Scenes and cameras from URLs.

use std::io::{self, Read};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{self, Receiver};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use gs3::scene::Size;
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, percent_decode_str, utf8_percent_encode};
use ureq::{Agent, ResponseExt};

use crate::opening::{FileMap, Opening, OpeningStep};
use crate::viewer::Opened;

/// Files at a time, as browsers open connections to a server.
const CONNECTIONS: usize = 6;

/// How long a server may take to connect, to begin its answer, and to send the next bytes, by default.
pub const PATIENCE: Duration = Duration::from_secs(30);

/// Bytes read between two reports of the progress.
const STEP: usize = 1 << 16;

/// Steps that are read before somebody wants them.
const AHEAD: usize = 4;

/// What stays as it is in a path (RFC 3986).
const PATH: &AsciiSet = &NON_ALPHANUMERIC.remove(b'-').remove(b'.').remove(b'_').remove(b'~').remove(b'/');

/// The URL that `place` is, if it is one.
pub fn url_of(place: &Path) -> Option<&str> {
    place.to_str().filter(|text| text.starts_with("http://") || text.starts_with("https://"))
}

/// Opens the scene or the cameras at `url`, and fetches the files that a scene names beside it. `coarse` gets the coarsest
/// levels of a streamed scene first. Of a streamed scene `budget` Gaussians are shown at most. Cameras that state no size
/// of their pictures get `size`. A server has `patience` to connect, to begin its answer, and to send the next bytes.
///
/// # Errors
/// One line with the file, what was expected and what was found.
pub fn open(
    url: &str,
    size: Size,
    budget: Option<u64>,
    patience: Duration,
    progress: &(dyn Fn(f32) + Sync),
    coarse: &dyn Fn(Opened),
) -> Result<Opened, String> {
    let agent: Agent = Agent::config_builder()
        .timeout_connect(Some(patience))
        .timeout_recv_response(Some(patience))
        .build()
        .into();
    let name = name_of(url);
    let (first, url) =
        fetched(&agent, url, patience, progress).map_err(|message| format!("{name}: {message}"))?;
    let mut opening = Opening::new(&name, FileMap::from([(name.clone(), first)]), true, budget);
    loop {
        match opening.go_on(size)? {
            OpeningStep::Done(opened) => return Ok(opened),
            OpeningStep::Coarse(opened) => coarse(opened),
            OpeningStep::Missing(paths) => {
                let files = all_fetched(&agent, &url, &paths, patience, progress);
                for (path, bytes) in files.map_err(|message| format!("{name}: {message}"))? {
                    opening.supply(&path, bytes);
                }
            }
        }
    }
}

/// The files at `paths` beside `url`, or the first error.
fn all_fetched(
    agent: &Agent,
    url: &str,
    paths: &[String],
    patience: Duration,
    progress: &(dyn Fn(f32) + Sync),
) -> Result<Vec<(String, Vec<u8>)>, String> {
    let next = AtomicUsize::new(0);
    let files = Mutex::new(Ok(Vec::with_capacity(paths.len())));
    std::thread::scope(|scope| {
        for _ in 0..CONNECTIONS.min(paths.len()) {
            scope.spawn(|| {
                while let Some(path) = paths.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let bytes = fetched(agent, &beside(url, path), patience, &|_| {});
                    let mut files = files.lock().unwrap_or_else(PoisonError::into_inner);
                    let Ok(done) = &mut *files else { return };
                    match bytes {
                        Ok((bytes, _)) => done.push((path.clone(), bytes)),
                        Err(message) => {
                            *files = Err(format!("{path}: {message}"));
                            return;
                        }
                    }
                    progress(done.len() as f32 / paths.len() as f32);
                }
            });
        }
    });
    files.into_inner().unwrap_or_else(PoisonError::into_inner)
}

/// The bytes at `url`, and the URL that they came from; or what was found instead.
fn fetched(
    agent: &Agent,
    url: &str,
    patience: Duration,
    progress: &(dyn Fn(f32) + Sync),
) -> Result<(Vec<u8>, String), String> {
    let wrong = |found: String| format!("expected a file, found {found}");
    let response = agent.get(url).call();
    let response = response.map_err(|error| match error {
        ureq::Error::StatusCode(code) => wrong(code.to_string()),
        other => wrong(other.to_string()),
    })?;
    // Servers may send elsewhere.
    let found_at = response.get_uri().to_string();
    let length = response.body().content_length();
    let steps = steps(response.into_body().into_reader()).map_err(|error| wrong(error.to_string()))?;
    let mut bytes = Vec::new();
    loop {
        match steps.recv_timeout(patience) {
            Ok(Ok(step)) if step.is_empty() => return Ok((bytes, found_at)),
            Ok(Ok(step)) => bytes.extend_from_slice(&step),
            Ok(Err(error)) => return Err(wrong(error.to_string())),
            Err(_) => return Err(wrong(format!("no more bytes for {} s", patience.as_secs()))),
        }
        if let Some(length) = length {
            progress((bytes.len() as f32 / length.max(1) as f32).min(1.0));
        }
    }
}

/// What `reader` reads, step by step, at last an empty step or an error. A thread of its own reads: a server that stalls
/// holds that thread alone, until the connection ends.
fn steps(mut reader: impl Read + Send + 'static) -> io::Result<Receiver<io::Result<Vec<u8>>>> {
    let (sender, receiver) = mpsc::sync_channel(AHEAD);
    let read = move || loop {
        let mut step = vec![0; STEP];
        let result = match reader.read(&mut step) {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Ok(count) => {
                step.truncate(count);
                Ok(step)
            }
            Err(error) => Err(error),
        };
        let is_last = result.as_ref().map_or(true, Vec::is_empty);
        if sender.send(result).is_err() || is_last {
            return;
        }
    };
    std::thread::Builder::new().name("fetch".to_owned()).spawn(read)?;
    Ok(receiver)
}

/// `url` without what follows its path, and the place of its last `/`.
fn path_of(url: &str) -> (&str, usize) {
    let path = &url[..url.find(['?', '#']).unwrap_or(url.len())];
    let host = path.find("://").map_or(0, |place| place + 3);
    (path, path[host..].rfind('/').map_or(path.len(), |place| host + place))
}

/// The URL of `path` in the folder of `url`.
fn beside(url: &str, path: &str) -> String {
    let (whole, end) = path_of(url);
    format!("{}/{}", &whole[..end], utf8_percent_encode(path, PATH))
}

/// What messages call the file at `url`.
fn name_of(url: &str) -> String {
    let (path, end) = path_of(url);
    match path.get(end + 1..).unwrap_or_default() {
        "" => path.to_owned(),
        name => percent_decode_str(name).decode_utf8_lossy().into_owned(),
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::net::TcpListener;

    use gs3::scene::format::save;
    use gs3_test_support::{row_of_gaussians, serve};

    use super::*;

    #[test]
    fn scenes_come_from_urls_coarse_first() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("a garden")).unwrap();
        save(&row_of_gaussians(5, 0.0), at("five.ply")).unwrap();
        save(&row_of_gaussians(9, 0.0), at("a garden/fine one.sog")).unwrap();
        save(&row_of_gaussians(3, 0.0), at("a garden/coarse.sog")).unwrap();
        let lod = r#"{"version": 1, "lodLevels": 2, "filenames": ["fine one.sog", "coarse.sog"],
            "tree": {"bound": {"min": [0, 0, 0], "max": [9, 1, 1]},
            "lods": {"0": {"file": 0, "offset": 0, "count": 9}, "1": {"file": 1, "offset": 0, "count": 3}}}}"#;
        std::fs::write(at("a garden/lod-meta.json"), lod).unwrap();
        std::fs::write(at("a garden/torn.json"), lod.replace("coarse", "none")).unwrap();
        let address = serve(folder.path());
        let of = |opened: &Opened| match opened {
            Opened::Scene { scene, .. } | Opened::Finer { scene } => scene.gaussians().len(),
            Opened::Cameras { .. } => panic!("cameras"),
        };
        let seen = Mutex::new(Vec::new());
        let coarse = |opened: Opened| seen.lock().unwrap().push(of(&opened));
        let get = |path: &str| {
            open(&format!("{address}/{path}"), Size::new(64, 40), None, PATIENCE, &|_| {}, &coarse)
        };
        assert_eq!(of(&get("five.ply?a=b#c").unwrap()), 5);
        let finer = get("a%20garden/lod-meta.json").unwrap();
        assert!(matches!(finer, Opened::Finer { .. }));
        assert_eq!((of(&finer), seen.lock().unwrap().clone()), (9, vec![3]));
        for (path, expected) in [
            ("none.ply", "none.ply: expected a file, found 404"),
            ("a%20garden/torn.json", "torn.json: none.sog: expected a file, found 404"),
        ] {
            assert_eq!(get(path).unwrap_err(), expected);
        }
        let gone = open("http://127.0.0.1:9/a.ply", Size::new(64, 40), None, PATIENCE, &|_| {}, &coarse)
            .unwrap_err();
        assert!(gone.starts_with("a.ply: expected a file, found ") && gone.lines().count() == 1, "{gone}");
    }

    #[test]
    fn a_server_that_stalls_is_an_error() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = format!("http://{}/a.ply", listener.local_addr().unwrap());
        std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            stream.write_all(b"HTTP/1.1 200 OK\r\nContent-Length: 100\r\n\r\nply").unwrap();
            // Until the client goes.
            _ = stream.read_to_end(&mut Vec::new());
        });
        let error =
            open(&address, Size::new(64, 40), None, Duration::from_secs(1), &|_| {}, &|_| {}).unwrap_err();
        assert_eq!(error, "a.ply: expected a file, found no more bytes for 1 s");
    }

    #[test]
    fn urls_are_told_from_files_and_joined() {
        assert_eq!(url_of(Path::new("https://a.b/c.ply")), Some("https://a.b/c.ply"));
        assert_eq!(url_of(Path::new("https.ply")), None);
        assert_eq!(beside("http://a.b/c/d.json?e=/f", "g h/i.webp"), "http://a.b/c/g%20h/i.webp");
        assert_eq!(beside("http://a.b", "c"), "http://a.b/c");
        assert_eq!(name_of("http://a.b/c%20d.ply#e"), "c d.ply");
        assert_eq!(name_of("http://a.b/"), "http://a.b/");
    }
}
