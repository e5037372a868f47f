//! `--backend` and `--adapter`.

use crate::{gs3, json, png, stderr, succeed};

/// The GPU has the scene's colours in 16 bits, so they may be off by a little.
#[test]
fn the_gpu_draws_what_the_cpu_draws() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let render = "render demo --mode native --size 96x54";
    succeed(at, &format!("{render} --backend cpu --json cpu.json --out cpu.png"));
    let output = gs3(at, &format!("{render} --backend gpu --json gpu.json --out gpu.png")).output().unwrap();
    if !output.status.success() && stderr(&output).contains("GPU adapter: expected") {
        return gs3::compute::skip_without_gpu(stderr(&output));
    }
    assert!(output.status.success(), "{}", stderr(&output));
    let [on_cpu, on_gpu] = ["cpu.json", "gpu.json"].map(|name| json(&at.join(name)));
    assert_eq!((&on_cpu["backend"], on_cpu.get("adapter")), (&"cpu".into(), None));
    assert_eq!(on_gpu["backend"], "gpu");
    assert!(on_gpu["adapter"].as_str().is_some_and(|name| !name.is_empty()), "{on_gpu}");
    let (cpu, gpu) = (png(&at.join("cpu.png")), png(&at.join("gpu.png")));
    assert_eq!((gpu.0, gpu.1), (96, 54));
    let far = cpu.2.iter().zip(&gpu.2).filter(|(a, b)| a.abs_diff(**b) > 2).count();
    assert!(far * 1000 <= cpu.2.len(), "{far} of {} values are off by more than 2/255", cpu.2.len());

    succeed(at, "gbuffer demo --size 80x45 --mixed --backend cpu --out cpu.npz");
    succeed(at, "gbuffer demo --size 80x45 --mixed --backend gpu --out gpu.npz");
    let size = |name: &str| std::fs::metadata(at.join(name)).unwrap().len();
    assert_eq!(size("cpu.npz"), size("gpu.npz"));
}

/// Stages in their order by the device's clock, none of them missing or longer than all together.
#[test]
fn bench_tells_the_stages_of_the_gpu() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let bench = "bench demo --size 256x144 --frames 0..3 --warm-up 1 --backend gpu --json b.json";
    let output = gs3(at, bench).output().unwrap();
    if !output.status.success() && stderr(&output).contains("GPU adapter: expected") {
        return gs3::compute::skip_without_gpu(stderr(&output));
    }
    assert!(output.status.success(), "{}", stderr(&output));
    let figures = json(&at.join("b.json"));
    assert_eq!((&figures["backend"], &figures["frames"]), (&"gpu".into(), &[0, 3][..].into()));
    for side in ["native", "lr_gbuffer"] {
        let stages = figures[side]["stages"].as_array().unwrap();
        let names: Vec<_> = stages.iter().map(|stage| stage["stage"].as_str().unwrap()).collect();
        assert_eq!(names, ["project", "order", "bin", "blend", "all"]);
        let ms = |stage: usize, what: &str| stages[stage][what].as_f64().unwrap();
        for stage in 0..4 {
            let (median, p99) = (ms(stage, "median_ms"), ms(stage, "p99_ms"));
            assert!(0.0 < median && median <= p99 && p99 < ms(4, "p99_ms"), "{side}: {stages:?}");
        }
        assert!(figures[side]["fps"].as_f64().unwrap() > 0.0);
        assert!(figures[side]["most_splats"].as_u64().unwrap() > 1000);
    }
    assert!(figures["sort"]["keys_per_s"].as_f64().unwrap() > 0.0);
    let ceilings = figures["ceilings"].as_object().unwrap();
    assert!(["copy_gb_per_s", "f32_tflop_per_s"].iter().all(|name| ceilings[*name].as_f64().unwrap() > 0.0));
    let half = &ceilings["f16_tflop_per_s"];
    assert!(half.is_null() || half.as_f64().unwrap() > 0.0, "{ceilings:?}");
}

/// Wrong inputs are told before any driver wakes: there is no such adapter, and nobody asks.
#[test]
fn no_device_is_asked_for_before_the_inputs_are_right() {
    let folder = tempfile::tempdir().unwrap();
    for (command, message) in [
        ("render missing.ply --out o", "missing.ply"),
        ("render demo --path missing.json --out o", "missing.json"),
        ("render demo --size 64x36 --frames 0..9999 --out o", "--frames"),
        ("render demo --size 64x36 --scale 99 --out o", "scale"),
        ("gbuffer missing.ply --out g.npz", "missing.ply"),
        ("gbuffer demo --frame 9999 --out g.npz", "--frame"),
        ("bench missing.ply", "missing.ply"),
    ] {
        let output = gs3(folder.path(), &format!("{command} --backend gpu --adapter 99")).output().unwrap();
        let told = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{command}");
        assert!(told.contains(message) && !told.contains("adapter"), "{command}: {told}");
    }
}
