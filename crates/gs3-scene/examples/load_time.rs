//! Measures how fast a scene loads and, if a target is given, saves:
//! `cargo run --release -p gs3-scene --example load_time -- SCENE [REPEATS [TARGET]]`.

use std::path::Path;
use std::time::Instant;

use gs3_scene::format::{LoadOptions, load, save};
use gs3_scene::info::SceneInfo;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("usage: load_time SCENE [REPEATS [TARGET]]")?;
    let repeats: u32 = arguments.next().map_or(Ok(3), |text| text.parse())?;
    let file_bytes = std::fs::metadata(&path).map_or(0, |meta| if meta.is_file() { meta.len() } else { 0 });
    let target = arguments.next();
    for repeat in 0..repeats {
        let start = Instant::now();
        let scene = load(Path::new(&path), &LoadOptions::default(), &|_| {})?;
        let seconds = start.elapsed().as_secs_f64();
        let gaussians = scene.gaussians();
        println!(
            "{path}: {} Gaussians, degree {}, {:.3} s, {:.0} MB/s of the file, {:.0} MB as f32, peak {} MB",
            gaussians.len(),
            gaussians.sh_degree,
            seconds,
            file_bytes as f64 / 1e6 / seconds,
            gaussians.byte_size() as f64 / 1e6,
            peak_megabytes().unwrap_or_default(),
        );
        if repeat == 0 {
            println!("{}", SceneInfo::of(&scene));
        }
        if let Some(target) = &target {
            let start = Instant::now();
            save(&scene, Path::new(target))?;
            let seconds = start.elapsed().as_secs_f64();
            let bytes = std::fs::metadata(target)?.len();
            println!("{target}: {seconds:.3} s, {:.1} MB", bytes as f64 / 1e6);
        }
    }
    Ok(())
}

/// The largest resident size of this process so far, where the system tells.
fn peak_megabytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kibibytes: u64 = line.split_ascii_whitespace().nth(1)?.parse().ok()?;
    Some(kibibytes * 1024 / 1_000_000)
}
