//! The system's dialog that asks for files.

use std::io;
use std::path::PathBuf;

use rfd::{AsyncFileDialog, FileHandle};
use winit::window::Window;

/// Asks for files in a dialog over `window`, and calls `tell` from another thread with the files, none of them if the user
/// cancels, or with one line that says why nobody can be asked.
///
/// # Errors
/// What the system reports if there is no thread.
pub fn ask(
    window: &Window,
    tell: impl FnOnce(Result<Vec<PathBuf>, String>) + Send + 'static,
) -> io::Result<()> {
    // macOS makes dialogs on the window's thread alone; waiting for them is done elsewhere.
    let asked = AsyncFileDialog::new().set_title("Open scenes or cameras").set_parent(window).pick_files();
    let wait = move || tell(answer(pollster::block_on(asked)));
    std::thread::Builder::new().name("dialog".to_owned()).spawn(wait).map(drop)
}

fn answer(answer: Option<Vec<FileHandle>>) -> Result<Vec<PathBuf>, String> {
    match answer {
        Some(files) => Ok(files.iter().map(|file| file.path().to_owned()).collect()),
        // Elsewhere a cancelled dialog answers nothing.
        None if cfg!(any(windows, target_os = "macos")) => Ok(Vec::new()),
        None => Err("file dialog: expected xdg-desktop-portal or zenity, found neither; files can be dropped into the \
                     window"
            .to_owned()),
    }
}
