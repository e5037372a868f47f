//! gs3 while the camera rests.

use std::error::Error;
use std::fmt::Write;

use gs3_evaluate::methods::{MethodSettings, MethodSpec, build};
use gs3_evaluate::metrics::{Quantisation, psnr};
use gs3_evaluate::protocol::PSNR_CAP;
use gs3_scene::CameraPath;

use crate::along::OURS;

/// The paths with the first cameras that it rests at: one of each scene.
pub const PATHS: [&str; 4] = ["flowers_drift", "fungi_pan", "hqgarden_drift", "lacadiere_pan"];
/// After how many frames it is judged: the last is a period of the jitter, S².
pub const FRAMES: [usize; 3] = [4, 8, 16];

/// Rows of a table: every method of ours at the first camera of `path`.
pub fn rows(path_name: &str, path: &CameraPath, settings: &MethodSettings) -> Result<String, Box<dyn Error>> {
    let Some(camera) = path.cameras().first() else { return Ok(String::new()) };
    let truth = build(MethodSpec::NATIVE, settings)?.render(camera, &[])?.current.clone();
    let mut text = String::new();
    for (alone, _) in OURS {
        // Those without weights are told of with the paths.
        let Ok(mut method) = build(alone.parse()?, settings) else { continue };
        write!(text, "| {path_name} | {alone} |")?;
        for k in 1..=FRAMES[FRAMES.len() - 1] {
            let image = method.render(camera, &[])?.current;
            if FRAMES.contains(&k) {
                write!(text, " {:.2} |", psnr(&truth, image, Quantisation::None)?.min(PSNR_CAP))?;
            }
        }
        text += "\n";
    }
    Ok(text)
}
