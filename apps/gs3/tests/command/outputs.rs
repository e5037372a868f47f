//! What is written where, and what is refused to be; what is said where nobody listens.

use std::fs;
use std::process::Stdio;

use super::{gs3, names, refused, stderr, succeed};

const ONE_CAMERA: &str = r#"{"fl_x": 50, "w": 64, "h": 36, "frames": [
    {"transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}"#;

#[test]
fn outputs_are_checked_before_anything_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // No scene: reading it would be another error.
    fs::write(at.join("s.ply"), "noise").unwrap();
    fs::write(at.join("w.safetensors"), "noise").unwrap();
    fs::write(at.join("one.json"), ONE_CAMERA).unwrap();
    fs::create_dir(at.join("there.json")).unwrap();
    fs::create_dir(at.join("there.mp4")).unwrap();
    let before = names(at);
    for (arguments, expected) in [
        (
            "simplify s.ply --keep 0.5 --out z.xyz",
            "z.xyz: extension: expected .ply, .compressed.ply, .spz, .sog, .glb, .splat or lod-meta.json, found \"xyz\"",
        ),
        (
            "convert s.ply o.ksplat",
            "extension: expected .ply, .compressed.ply, .spz, .sog, .glb, .splat or lod-meta.json, found \"ksplat\"",
        ),
        ("convert s.ply ./s.ply", "OUTPUT: expected another place than that of an input, found ./s.ply"),
        ("convert s.ply one.json/o.ply", "one.json/o.ply: cannot be written: Not a directory"),
        ("gbuffer s.ply --out mine.ply", "--out: expected FILE.npz, found mine.ply"),
        ("render s.ply --out o --json s.ply", "--json: expected FILE.json, found s.ply"),
        ("render s.ply --out o --json there.json", "--json: expected a file, found there.json, a folder"),
        (
            "render s.ply --path one.json --out o --json one.json",
            "--json: expected another place than that of an",
        ),
        ("render s.ply --out o --compare c.jpg", "--compare: expected FILE.png, found c.jpg"),
        (
            "render s.ply --out a.png --compare ./a.png",
            "--compare: expected another place than that of --out",
        ),
        (
            "render s.ply --out cf --compare cf/frame_000000.png",
            "--compare: expected another name than those of the frames in cf, found cf/frame_000000.png",
        ),
        (
            "render s.ply --out cf.mp4 --compare ./cf/frame_1000000.png",
            "--compare: expected another name than those of the frames in cf, found ./cf/frame_1000000.png",
        ),
        ("render s.ply --out vid.mov", "--out: expected DIR, FILE.png, FILE.exr or FILE.mp4"),
        ("render s.ply --out there.mp4", "--out: expected a file, found there.mp4, a folder"),
        (
            "render s.ply --out one.mp4 --path one --json one",
            "--out, its frames: expected another place than that of an input, found one",
        ),
        ("render s.ply --out s.ply/", "s.ply/: cannot be written: Not a directory"),
        ("bench s.ply --json b.txt", "--json: expected FILE.json, found b.txt"),
        ("evaluate s.ply --path one.json --out one.json", "--out: expected a folder, found one.json, a file"),
        (
            "train super-sample --steps 1 --clips c --checkpoint k --out w5.txt",
            "--out: expected FILE.safetensors, found w5.txt",
        ),
        (
            "train super-sample --steps 1 --clips c --checkpoint k --init w.safetensors --out w.safetensors",
            "--out: expected another place than that of an input, found w.safetensors",
        ),
        ("train clips s.ply --network interpolate --out c --preview p.jpg", "--preview: expected FILE.png"),
    ] {
        let said = refused(&mut gs3(at, arguments));
        assert!(said.contains(expected), "gs3 {arguments}: {said}");
        assert_eq!(names(at), before, "gs3 {arguments} leaves nothing");
    }
}

/// What is no frame may lie among frames, under a name that looks like theirs too.
#[test]
fn a_comparison_may_lie_beside_the_frames() {
    let folder = tempfile::tempdir().unwrap();
    let render = "render demo --size 16x9 --frames 0..1 --tier analytic --out o --compare";
    for name in ["frame_.png", "frame_00000.png", "c.png"] {
        succeed(folder.path(), &format!("{render} o/{name}"));
    }
    assert_eq!(
        names(&folder.path().join("o")),
        ["c.png", "frame_.png", "frame_00000.png", "frame_000000.png"]
    );
}

#[test]
fn folders_that_are_missing_are_made() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    succeed(at, "gbuffer demo --size 16x9 --out planes/of/g.npz");
    succeed(at, "simplify demo --size 16x9 --frames 0..1 --keep 0.01 --out few/of/s.ply");
    succeed(at, "convert few/of/s.ply packed/s.spz");
    succeed(at, "render few/of/s.ply --size 16x9 --frames 0..1 --tier analytic --out with.dot/");
    assert_eq!(names(&at.join("with.dot")), ["frame_000000.png"]);
    assert_eq!(names(at), ["few", "packed", "planes", "with.dot"]);
    assert!(at.join("planes/of/g.npz").is_file() && at.join("packed/s.spz").is_file());
}

/// One Gaussian far away costs an SPZ file the precision of all others.
#[test]
fn coarse_positions_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = |far: f32| {
        let fields = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"];
        let fields =
            fields.into_iter().chain(["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]);
        let fields: String = fields.map(|field| format!("property float {field}\n")).collect();
        // Standard deviations of e⁻⁵ = 0.0067.
        let gaussian = |x: f32| format!("{x} 0 1 0 0 0 2 -5 -5 -5 1 0 0 0\n");
        let gaussians = [0.0, 0.1, far].map(gaussian).concat();
        format!("ply\nformat ascii 1.0\nelement vertex 3\n{fields}end_header\n{gaussians}")
    };
    for (far, is_coarse) in [(0.2, false), (1e6, true)] {
        fs::write(at.join("s.ply"), scene(far)).unwrap();
        let output = gs3(at, "convert s.ply s.spz").output().unwrap();
        let said = stderr(&output);
        assert!(output.status.success(), "{said}");
        // 2⁻³ is the finest step with which 24 bits reach a million.
        let expected =
            "s.spz: positions are rounded to steps of 1.25e-1, as one Gaussian is 1.00e6 from the origin";
        assert_eq!(said.contains(expected), is_coarse, "{said}");
        assert!(is_coarse || !said.contains("rounded"), "{said}");
        let output = gs3(at, "convert s.ply other.ply").output().unwrap();
        assert!(!stderr(&output).contains("rounded"), "nothing is rounded in a PLY");
    }
}

#[test]
#[cfg(target_os = "linux")]
fn links_stay_and_full_devices_are_told_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("figures"), "before").unwrap();
    std::os::unix::fs::symlink("figures", at.join("r.json")).unwrap();
    let render = "render demo --size 16x9 --frames 0..1 --tier analytic --out o --json";
    succeed(at, &format!("{render} r.json"));
    assert!(at.join("r.json").is_symlink());
    assert!(fs::read_to_string(at.join("figures")).unwrap().starts_with('{'));
    // Planes of more than a megabyte, which reach the device before the archive ends.
    for arguments in [format!("{render} /dev/full"), "gbuffer demo --size 200x112 --out /dev/full".to_owned()]
    {
        let output = gs3(at, &arguments).output().unwrap();
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(75), "{said}");
        assert!(
            said.starts_with("error: /dev/full: cannot be written: ") && said.contains("No space left"),
            "{said}"
        );
        assert_eq!(said.trim_end().lines().count(), 1, "{said}");
    }
}

#[test]
#[cfg(target_os = "linux")]
fn weights_without_an_end_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in ["render demo --size 16x9 --weights /dev/zero --out o", "export /dev/zero --out o.onnx"]
    {
        let expected = "error: /dev/zero: path: expected a regular file or a pipe, found something else\n";
        assert_eq!(refused(&mut gs3(folder.path(), arguments)), expected);
    }
}

#[test]
#[cfg(target_os = "linux")]
fn nobody_needs_to_listen() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let full = || fs::OpenOptions::new().write(true).open("/dev/full").unwrap();

    // A pipe without a reader.
    let mut child = gs3(at, "info demo").stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success() && output.stderr.is_empty(), "{}", stderr(&output));

    let bench = "bench demo --size 16x9 --frames 0..1 --tier analytic --json b.json";
    for arguments in ["info demo", "info demo --json", "devices", "devices --json", bench] {
        let said = refused(gs3(at, arguments).stdout(full()));
        assert!(
            said.starts_with("error: standard output: cannot be written: No space"),
            "{arguments}: {said}"
        );
    }
    assert!(at.join("b.json").is_file(), "the figures are written whether or not they can be shown");

    let render = "render demo --size 16x9 --frames 0..1 --tier analytic --out o";
    assert!(gs3(at, render).stderr(full()).status().unwrap().success());
    assert_eq!(gs3(at, "info missing.ply").stderr(full()).status().unwrap().code(), Some(2));
}

#[test]
#[cfg(target_os = "linux")]
fn a_command_that_is_ended_leaves_no_part_of_a_file() {
    // Whoever starts a command under `nohup` wants it to go on.
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:")).unwrap();
    let ended_by = [1, 2, 15].map(|signal| 1_u64 << (signal - 1)).iter().sum::<u64>();
    if u64::from_str_radix(ignored.trim(), 16).unwrap() & ended_by != 0 {
        eprintln!("skipped: requests to end are ignored here");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let child = gs3(at, "convert demo s.sog").stderr(Stdio::piped()).spawn().unwrap();
    // The first one only tries whether there can be one.
    let output = super::interrupt(child, || names(at).iter().any(|name| name.ends_with(".1.partial")));
    assert_eq!(output.status.code(), Some(130), "{}", stderr(&output));
    assert_eq!(names(at), [""; 0]);
}

/// Some formats go back to their beginning, which a pipe does not allow.
#[test]
#[cfg(unix)]
fn a_pipe_gets_the_bytes_of_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for extension in ["spz", "sog", "ply", "compressed.ply", "glb", "splat"] {
        let pipe = at.join(format!("pipe.{extension}"));
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let child =
            gs3(at, &format!("convert demo pipe.{extension}")).stderr(Stdio::piped()).spawn().unwrap();
        let bytes = fs::read(&pipe).unwrap();
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success(), "{extension}: {}", stderr(&output));
        succeed(at, &format!("convert demo file.{extension}"));
        assert!(bytes == fs::read(at.join(format!("file.{extension}"))).unwrap(), "{extension} differs");
    }
}
