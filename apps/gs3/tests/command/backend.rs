//! `--backend` and `--adapter`.

use crate::{gs3, json, png, stderr, succeed};

/// The GPU has the scene in 16 bits, so colours may be off by a little.
#[test]
fn the_gpu_draws_what_the_cpu_draws() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let render = "render demo --mode native --size 96x54";
    succeed(at, &format!("{render} --backend cpu --json cpu.json --out cpu.png"));
    let output = gs3(at, &format!("{render} --backend gpu --json gpu.json --out gpu.png")).output().unwrap();
    if !output.status.success() && stderr(&output).contains("GPU adapter: expected") {
        eprintln!("skipped: no adapter: {}", stderr(&output));
        return;
    }
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(json(&at.join("cpu.json"))["rasterizer"], "cpu");
    assert_ne!(json(&at.join("gpu.json"))["rasterizer"], "cpu");
    let (cpu, gpu) = (png(&at.join("cpu.png")), png(&at.join("gpu.png")));
    assert_eq!((gpu.0, gpu.1), (96, 54));
    let far = cpu.2.iter().zip(&gpu.2).filter(|(a, b)| a.abs_diff(**b) > 2).count();
    assert!(far * 1000 <= cpu.2.len(), "{far} of {} values are off by more than 2/255", cpu.2.len());

    succeed(at, "gbuffer demo --size 80x45 --mixed --backend cpu --out cpu.npz");
    succeed(at, "gbuffer demo --size 80x45 --mixed --backend gpu --out gpu.npz");
    let size = |name: &str| std::fs::metadata(at.join(name)).unwrap().len();
    assert_eq!(size("cpu.npz"), size("gpu.npz"));
}
