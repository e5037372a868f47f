//! `gs3 render` and `gs3 bench`.

use std::fs;
use std::path::Path;
use std::process::Stdio;

use super::{gs3, json, names, png, stderr, succeed};

#[test]
fn full_shows_three_frames_per_rendered_one_and_reports() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    succeed(
        at,
        "render demo --size 160x90 --frames 0..3 --mode full --out out --compare cmp/c.png --json r.json --threads 2",
    );
    assert_eq!(names(&at.join("out")), (0..7).map(|k| format!("frame_{k:06}.png")).collect::<Vec<_>>());
    let (width, height, bytes) = png(&at.join("out/frame_000003.png"));
    assert_eq!((width, height), (160, 90));
    let mean = bytes.iter().map(|v| f64::from(*v)).sum::<f64>() / bytes.len() as f64;
    assert!((60.0..200.0).contains(&mean), "a picture is neither black nor white: {mean}");
    assert_eq!(png(&at.join("cmp/c.png")).0, 3 * 53 + 8);

    let report = json(&at.join("r.json"));
    assert_eq!(report["frames_displayed"], 7);
    assert_eq!(report["frames_rendered"], 3);
    assert_eq!((&report["backend"], &report["threads"]), (&"cpu".into(), &2.into()));
    for field in ["displayed_fps", "load_s", "encode_s"] {
        assert!(report[field].as_f64().unwrap() > 0.0, "{field}: {report}");
    }
    for stage in ["rasterize", "super_sample", "interpolate"] {
        assert!(report["stage_ms"][stage].as_f64().unwrap() > 0.0, "{stage}: {report}");
    }
    assert_eq!(report["peak_rss_mb"].is_number(), cfg!(target_os = "linux"));
    let (bicubic, own) = (&report["compare"]["bicubic_psnr"], &report["compare"]["psnr"]);
    assert!(own.as_f64().unwrap() > bicubic.as_f64().unwrap() + 0.5, "{report}");
    let compared = |figure: &str| report["compare"][figure].as_f64().unwrap();
    // The second and the third rendered frame show three each; natively that is six frames.
    assert_eq!(report["compare"]["frames"], 2);
    assert!(compared("native_fps") > 0.0 && compared("mean_psnr") > 20.0, "{report}");
    let ratio = compared("displayed_fps") / compared("native_fps");
    assert!((compared("times_native") / ratio - 1.0).abs() < 1e-9, "{report}");
}

#[test]
fn every_mode_writes_single_frames() {
    let folder = tempfile::tempdir().unwrap();
    for mode in ["native", "bicubic", "super-sample", "full"] {
        let file = format!("{mode}.png");
        succeed(folder.path(), &format!("render demo --size 97x55 --mode {mode} --frames 2..3 --out {file}"));
        assert_eq!(png(&folder.path().join(file)).0, 97);
    }
    assert_eq!(names(folder.path()).len(), 4, "nothing else is left: {:?}", names(folder.path()));
}

#[test]
fn interpolation_is_learned_where_it_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let render = |name: &str, options: &str| {
        let size = "--size 128x72 --frames 8..9 --tier fast";
        succeed(at, &format!("render demo {size} {options} --out {name} --json {name}.json"));
        let made = if name == "learned" { "learned" } else { "analytic" };
        assert_eq!(json(&at.join(format!("{name}.json")))["interpolation"], made);
        [22, 24].map(|k| png(&at.join(name).join(format!("frame_{k:06}.png"))).2)
    };
    let [plain, analytic, learned] = [
        render("plain", ""),
        render("analytic", "--interpolation analytic"),
        render("learned", "--interpolation learned"),
    ];
    assert!(plain == analytic, "in-between frames are warped unless something else is wanted");
    assert!(learned[0] != plain[0], "the network changes the in-between frame");
    assert!(learned[1] == plain[1], "it leaves rendered frames as they are");
}

#[test]
fn kriging_and_tiers_reach_the_picture() {
    let folder = tempfile::tempdir().unwrap();
    let render = |name: &str, options: &str| {
        let size = "--size 128x72 --frames 0..3 --mode super-sample --refine off";
        succeed(folder.path(), &format!("render demo {size} {options} --out {name}"));
        png(&folder.path().join(name).join("frame_000002.png")).2
    };
    let [off, coarse, on, fine] = ["", "--kriging=coarse", "--kriging", "--kriging=fine"]
        .map(|kriging| render(&format!("made{kriging}"), &format!("--tier analytic {kriging}")));
    assert!(coarse != off && on != coarse && fine != on && fine != off, "each kriges other pixels");
    assert!(render("overscan", "--tier analytic --overscan") != off, "the camera moves");
    let [balanced, high] =
        ["balanced", "high"].map(|tier| render(tier, &format!("--tier {tier} --arithmetic f32")));
    assert!(balanced != on, "networks refine what is kriged");
    assert!(high != balanced, "and so does that of tier high");
}

#[test]
fn options_reach_the_picture() {
    let folder = tempfile::tempdir().unwrap();
    let render = |name: &str, options: &str| {
        succeed(folder.path(), &format!("render demo --size 96x54 {options} --out {name}.png"));
        png(&folder.path().join(format!("{name}.png"))).2
    };
    let plain = render("plain", "--mode bicubic");
    let kerbl = render("kerbl", "--mode bicubic --dilation kerbl");
    assert!(plain != kerbl && kerbl == render("stock", "--mode bicubic --dilation stock"));
    assert!(plain == render("value", "--mode bicubic --dilation 0.01875"), "matched is 0.3 / 4²");
    assert!(plain != render("centered", "--mode bicubic --jitter off"));
    assert!(plain == render("exact", "--mode bicubic --culling exact"));
    assert!(plain != render("scale", "--mode bicubic --scale 2"));
    // Some of the demo's sky lets the background through.
    assert!(plain != render("background", "--mode bicubic --background 1,0,0"));
}

fn frames(folder: &Path) -> Vec<(String, Vec<u8>)> {
    names(folder).into_iter().map(|name| (name.clone(), fs::read(folder.join(name)).unwrap())).collect()
}

#[test]
fn frames_are_the_same_bytes_whatever_the_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    for threads in [1, 2, 5] {
        let options = format!("--frames 0..3 --threads {threads} --out {threads}");
        succeed(folder.path(), &format!("render demo --size 160x90 {options}"));
    }
    let one = frames(&folder.path().join("1"));
    assert_eq!(one.len(), 7);
    assert!(one == frames(&folder.path().join("2")) && one == frames(&folder.path().join("5")));
}

/// Frames wait for others to be encoded with, by as many threads as there are: not all of them in memory.
#[test]
#[cfg(target_os = "linux")]
fn memory_does_not_grow_with_the_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let peak = |threads: u32| {
        let options = format!("--size 1280x720 --mode native --frames 0..24 --threads {threads}");
        succeed(folder.path(), &format!("render demo {options} --backend cpu --out o --json r.json"));
        json(&folder.path().join("r.json"))["peak_rss_mb"].as_f64().unwrap()
    };
    let (few, many) = (peak(8), peak(64));
    // As many frames as threads would be 24 here, each 4.6 MB: 74 MB more. Threads have caches of their own.
    assert!(many < few + 40.0, "{few} MB, {many} MB");
}

#[test]
fn a_smooth_path_has_as_many_frames_as_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    succeed(folder.path(), "render demo --size 64x36 --mode native --smooth 4 --out out");
    assert_eq!(names(&folder.path().join("out")).len(), 4);
}

/// A capture may have cameras of several sizes: nothing lies between two that differ, so a number is left out there.
#[test]
fn cameras_of_different_sizes_are_rendered_one_after_the_other() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let camera = |k: u32| {
        // Two frames of one size, two of another, one of the first.
        let (width, height) = if k / 2 == 1 { (80, 48) } else { (64, 48) };
        let pose = format!("[[1,0,0,{}],[0,0,-1,-9],[0,1,0,2],[0,0,0,1]]", f64::from(k) * 0.02);
        format!(r#"{{"fl_x": 50, "w": {width}, "h": {height}, "transform_matrix": {pose}}}"#)
    };
    let cameras: Vec<String> = (0..5).map(camera).collect();
    fs::write(at.join("sizes.json"), format!(r#"{{"frames": [{}]}}"#, cameras.join(", "))).unwrap();
    let render = "render demo --path sizes.json --tier analytic --backend cpu --out";
    let sizes = |out: &str| {
        let width = |name: &String| (name[6..12].parse::<u32>().unwrap(), png(&at.join(out).join(name)).0);
        names(&at.join(out)).iter().map(width).collect::<Vec<_>>()
    };
    succeed(at, &format!("{render} full --in-between 1"));
    assert_eq!(sizes("full"), [(0, 64), (1, 64), (2, 64), (4, 80), (5, 80), (6, 80), (8, 64)]);
    succeed(at, &format!("{render} super --mode super-sample"));
    assert_eq!(sizes("super"), [(0, 64), (1, 64), (2, 80), (3, 80), (4, 64)]);
    succeed(at, &format!("{render} smooth --smooth 7 --in-between 3"));
    assert!(sizes("smooth").iter().any(|size| size.1 == 80), "{:?}", sizes("smooth"));
    succeed(at, &format!("{render} part --frames 3..5 --in-between 1"));
    assert_eq!(sizes("part"), [(5, 80), (6, 80), (8, 64)]);
    succeed(at, "bench demo --path sizes.json --tier analytic");
}

#[test]
#[cfg(unix)]
fn an_interrupted_run_leaves_whole_files_and_says_how_to_go_on() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let mut command = gs3(folder.path(), "render demo --size 320x180 --out out --json r.json");
    let child = command.stderr(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
    let output = super::interrupt(child, || out.is_dir() && names(&out).len() >= 4);
    assert_eq!(output.status.code(), Some(130), "{}", stderr(&output));
    let names = names(&out);
    assert!(names.len() >= 4 && names.len() < 718, "{}", names.len());
    for name in &names {
        assert_eq!(png(&out.join(name)).0, 320, "{name}");
    }
    let rendered = json(&folder.path().join("r.json"))["frames_rendered"].as_u64().unwrap();
    assert_eq!(names.len() as u64, 3 * rendered - 2, "all frames rendered are written");
    let said = stderr(&output);
    assert!(said.contains(&format!("--frames {rendered}..240")), "{said}");
}

#[test]
fn bench_prints_ratios_first() {
    let folder = tempfile::tempdir().unwrap();
    let output = succeed(folder.path(), "bench demo --size 160x90 --frames 0..2 --stages --json b.json");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.starts_with("displayed fps, full / native"), "{said}");
    let report = json(&folder.path().join("b.json"));
    let ratio = report["displayed_fps_full_over_native"].as_f64().unwrap();
    let by_hand = report["full"]["displayed_fps"].as_f64().unwrap()
        / report["native"]["displayed_fps"].as_f64().unwrap();
    assert!((ratio - by_hand).abs() < 1e-9 && ratio > 0.0);
    assert!(report["gbuffer_over_native"].as_f64().unwrap() > 0.0);
    for what in ["native", "lr_gbuffer"] {
        let stage = |name: &str| report["raster_ms"][what][name].as_f64().unwrap();
        assert!(["project", "bin", "blend"].map(stage).iter().all(|ms| *ms > 0.0 && *ms < 60_000.0));
        assert!(said.lines().any(|line| line.starts_with(what) && line.contains("rasterizer:  project")));
    }
}

#[test]
fn reports_state_what_ran_and_short_captures_need_no_frames() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let report = |mode: &str| {
        let options = format!("--size 64x36 --frames 0..2 --mode {mode} --tier analytic --out {mode}");
        succeed(at, &format!("render demo {options} --json r.json"));
        json(&at.join("r.json"))
    };
    for (mode, fields) in [
        ("native", [false; 4]),
        ("bicubic", [true, false, false, false]),
        ("super-sample", [true, true, false, false]),
        ("full", [true; 4]),
    ] {
        let report = report(mode);
        let told = ["scale", "tier", "interpolation", "in_between"].map(|field| report.get(field).is_some());
        assert_eq!(told, fields, "{report}");
    }
    // Larger frames have a larger scale.
    for (size, scale) in [("64x36", 4), ("2720x1360", 6)] {
        let options = format!("--size {size} --frames 0..1 --mode bicubic --out {size} --json r.json");
        succeed(at, &format!("render demo {options}"));
        assert_eq!(json(&at.join("r.json"))["scale"], scale);
        assert_eq!(json(&at.join(size).join("manifest.json"))["scale"], scale);
    }
    let camera = "{\"transform_matrix\": [[1,0,0,0],[0,0,-1,-9],[0,1,0,2],[0,0,0,1]]}";
    let cameras = format!("{{\"fl_x\": 50, \"w\": 64, \"h\": 36, \"frames\": [{camera}, {camera}]}}");
    fs::write(at.join("two.json"), cameras).unwrap();
    succeed(at, "bench demo --path two.json --tier analytic --json b.json");
    assert_eq!(json(&at.join("b.json"))["frames"], serde_json::json!([0, 2]));
}

#[test]
fn nothing_in_sight_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // Far above the demo, looking up.
    let cameras = "{\"fl_x\": 50, \"w\": 64, \"h\": 36, \"frames\": [{\"transform_matrix\":
        [[1,0,0,0],[0,-1,0,0],[0,0,-1,9999],[0,0,0,1]]}]}";
    fs::write(at.join("away.json"), cameras).unwrap();
    for mode in ["native", "full"] {
        let options = format!("--path away.json --mode {mode} --tier analytic --backend cpu --out {mode}");
        let said = stderr(&succeed(at, &format!("render demo {options}")));
        assert_eq!(said.lines().filter(|line| line.starts_with("warning: no Gaussian")).count(), 1, "{said}");
    }
    let said = stderr(&succeed(at, "render demo --size 64x36 --frames 0..1 --mode native --out o"));
    assert!(!said.contains("warning"), "{said}");
}

/// Over any background, what is written with alpha is what is rendered over it.
#[test]
fn alpha_shows_what_is_behind() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let [r, g, b] = [0.2, 0.9, 0.4];
    for mode in ["native", "super-sample", "full"] {
        let render = format!("render demo --size 160x90 --frames 0..3 --tier analytic --mode {mode}");
        succeed(at, &format!("{render} --alpha --out clear --json clear.json"));
        succeed(at, &format!("{render} --background {r},{g},{b} --out behind"));
        assert_eq!(json(&at.join("clear.json"))["alpha"], true);
        let frames = names(&at.join("behind"));
        assert_eq!(names(&at.join("clear")), frames, "{mode}");
        let (mut worst, mut sum, mut seen) = (0.0_f64, 0.0, [0; 3]);
        for name in &frames {
            let (clear, behind) = (png(&at.join("clear").join(name)).2, png(&at.join("behind").join(name)).2);
            assert_eq!(clear.len() / 4, behind.len() / 3);
            for (clear, behind) in clear.chunks_exact(4).zip(behind.chunks_exact(3)) {
                let alpha = f64::from(clear[3]) / 255.0;
                seen[usize::from(clear[3] > 0) + usize::from(clear[3] == 255)] += 1;
                for ((clear, behind), background) in clear.iter().zip(behind).zip([r, g, b]) {
                    let shown = alpha * f64::from(*clear) + (1.0 - alpha) * 255.0 * background;
                    let off = (shown - f64::from(*behind)).abs();
                    worst = worst.max(off);
                    sum += off * off;
                }
            }
            fs::remove_file(at.join("clear").join(name)).unwrap();
            fs::remove_file(at.join("behind").join(name)).unwrap();
        }
        // The demo is everywhere, at its rim thinly.
        assert!(seen[1] > 100 && seen[2] > 100, "half clear and opaque pixels: {seen:?}");
        let rms = (sum / (frames.len() * 160 * 90 * 3) as f64).sqrt();
        // Native alpha and colours are rounded to 8 bits; a reconstruction over another background errs otherwise.
        let (most, mean) = if mode == "native" { (2.0, 0.6) } else { (255.0, 6.0) };
        assert!(worst <= most && rms <= mean, "{mode}: {worst} at most, {rms} rms");
    }
}
