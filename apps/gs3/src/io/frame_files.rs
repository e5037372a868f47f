//! Names of the files of frames.

use std::ffi::OsStr;
use std::fs;
use std::ops::Range;
use std::path::Path;

/// Name of the frame with the number `number` among all displayed ones.
pub fn frame_name(number: usize) -> String {
    name_with(number, "png")
}

/// Name of the file with this extension that belongs to the frame with the number `number`.
pub fn name_with(number: usize, extension: &str) -> String {
    format!("frame_{number:06}.{extension}")
}

/// Whether `name` is the name of a frame's file.
pub fn is_frame_name(name: &OsStr) -> bool {
    frame_number(name).is_some()
}

/// The number of the frame with the name `name`, if there is one.
fn frame_number(name: &OsStr) -> Option<usize> {
    let number = name.to_str()?.strip_prefix("frame_")?.strip_suffix(".png")?.parse().ok()?;
    (name == frame_name(number).as_str()).then_some(number)
}

/// Numbers of the frames in `folder`, in no order.
pub fn frame_numbers(folder: &Path) -> impl Iterator<Item = usize> {
    let names = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.file_name());
    names.filter_map(|name| frame_number(&name))
}

/// How many frames in `folder` have other numbers than `written`.
pub fn others(folder: &Path, written: &Range<usize>) -> usize {
    frame_numbers(folder).filter(|number| !written.contains(number)).count()
}
