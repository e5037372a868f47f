//! Everything that is wrong ends with one readable line, exit code 2 and no output.

use std::fs;

use super::{gs3, names, refused};

const ONE_CAMERA: &str = r#"{"fl_x": 50, "w": 64, "h": 36, "frames": [
    {"transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}"#;

#[test]
fn one_line_that_names_field_expected_and_actual() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("one.json"), ONE_CAMERA).unwrap();
    fs::write(at.join("singular.json"), ONE_CAMERA.replace("[1,0,0,0]", "[0,0,0,0]")).unwrap();
    fs::write(at.join("words.json"), ONE_CAMERA.replace("50", "\"wide\"")).unwrap();
    fs::write(at.join("empty.json"), r#"{"frames": []}"#).unwrap();
    fs::write(at.join("noise.ply"), "ply\nformat binary_little_endian 1.0\nelement vertex 99\n").unwrap();
    fs::write(at.join("noise.bin"), [7; 100]).unwrap();
    fs::write(at.join("file"), "not a folder").unwrap();
    let before = names(at);
    let cases: &[(&str, &[&str])] = &[
        ("render missing.ply --out o", &["missing.ply"]),
        ("render noise.ply --out o", &["noise.ply"]),
        ("render noise.bin --out o", &["noise.bin", "expected", "07 07"]),
        ("render demo --path missing.json --out o", &["missing.json", "cannot read"]),
        ("render demo --path singular.json --out o", &["singular.json: frames[0]: camera pose: expected"]),
        (
            "render demo --path words.json --out o",
            &["words.json: fl_x: expected a finite number, found \"wide\""],
        ),
        ("render demo --path empty.json --out o", &["empty.json: cameras: expected at least 1, found 0"]),
        (
            "render demo --path one.json --frames 0..2 --out o",
            &["--frames: expected frames within 0..1", "0..2"],
        ),
        (
            "gbuffer demo --size 16x9 --frame 18446744073709551615 --out o.npz",
            &["--frame: expected frames within 0..", "18446744073709551615"],
        ),
        ("render demo --budget 5 --out o", &["--budget: expected a streamed scene", "found demo"]),
        ("render demo --size 0x5 --out o", &["--size", "expected WIDTHxHEIGHT from 1x1", "0x5"]),
        ("render demo --size 9999x5 --out o", &["--size", "9999x5"]),
        ("render demo --size 64x36 --scale 0 --out o", &["--scale: expected auto or 1 to 8, found 0"]),
        ("render demo --size 64x36 --scale 99 --out o", &["--scale: expected auto or 1 to 8, found 99"]),
        ("render demo --frames 5..5 --out o", &["--frames", "expected A..B with A < B", "5..5"]),
        (
            "render demo --dilation -1 --out o",
            &["--dilation: expected matched, kerbl or a number", "found -1"],
        ),
        (
            "render demo --background -1,0,0 --out o",
            &["--background: expected R,G,B from 0 to 1, found -1,0,0"],
        ),
        ("render demo --scale -1 --out o", &["--scale: expected auto or 1 to 8, found -1"]),
        ("render demo --scale two --out o", &["--scale: expected auto or 1 to 8, found two"]),
        ("render demo --tier foo --out o", &["--tier: expected analytic, fast, balanced or high, found foo"]),
        ("render demo --tier fast", &["not provided: --out <DIR"]),
        ("render demo --out", &["--out: expected a value, found none"]),
        ("render demo --out o --ties fast", &["unexpected argument '--ties' found; tip:", "'--tier'"]),
        (
            "render demo --out o --tier fast --weights w",
            &["'--tier <TIER>' cannot be used with", "--weights"],
        ),
        ("rendre demo", &["unrecognized subcommand 'rendre'; tip:", "'render'"]),
        (
            "render demo --mode native --scale 2 --out o",
            &["--scale: expected --mode bicubic, super-sample or full"],
        ),
        (
            "render demo --mode native --in-between 2 --out o",
            &["--in-between: expected --mode full, found --mode native"],
        ),
        (
            "render demo --mode bicubic --overscan --out o",
            &["--overscan: expected --mode super-sample or full"],
        ),
        ("render demo --refine 2 --out o", &["--refine", "a share of the pixels from 0 to 1", "found \"2\""]),
        ("render demo --refine some --out o", &["--refine", "expected off, auto", "found \"some\""]),
        (
            "render demo --mode native --refine off --out o",
            &["--refine: expected --mode super-sample or full"],
        ),
        (
            "render demo --refine 0.1 --quality high --out o",
            &["--quality: expected --refine auto, found --refine 0.1"],
        ),
        ("render demo --mode native --kriging --out o", &["--kriging: expected --mode super-sample or full"]),
        ("render demo --mode native --jitter off --out o", &["--jitter: expected --mode"]),
        ("render demo --mode native --weights w --out o", &["--weights: expected --mode"]),
        ("render demo --mode native --tier fast --out o", &["--tier: expected --mode super-sample or full"]),
        ("render demo --mode bicubic --tier fast --out o", &["--tier: expected", "found --mode bicubic"]),
        (
            "render demo --mode bicubic --interpolation analytic --out o",
            &["--interpolation: expected --mode full"],
        ),
        ("render demo --mode bicubic --in-between 1 --out o", &["--in-between: expected --mode full"]),
        (
            "render demo --mode super-sample --interpolation learned --out o",
            &["--interpolation: expected --mode full, found --mode super-sample"],
        ),
        (
            "render demo --tier analytic --arithmetic bf16 --out o",
            &["--arithmetic: expected a tier with a network", "found analytic"],
        ),
        ("bench demo --warm-up 3", &["--warm-up: expected --backend gpu, found --backend cpu"]),
        ("bench demo --backend gpu --stages", &["--stages: expected --backend cpu, found --backend gpu"]),
        ("simplify demo --keep 0.5 --mass 0.9 --out o", &["--mass: expected --by mini-splatting"]),
        ("simplify demo --keep 0.5 --indoor --out o", &["--indoor: expected --by mini-splatting"]),
        ("evaluate demo --every 2 --out o", &["--photos"]),
        ("info .", &[".: expected a scene file, or a folder with lod-meta.json, meta.json or meta.lcc2"]),
        ("render demo --dilation nan --out o", &["expected matched, kerbl or a number", "nan"]),
        ("render demo --background 1,2 --out o", &["expected R,G,B from 0 to 1", "1,2"]),
        ("render demo --threads 0 --out o", &["--threads", "0"]),
        ("render demo --size 64x36 --frames 0..1 --out file/o", &["file/o: cannot be written"]),
        (
            "render demo --size 64x36 --out x.png --frames 0..3",
            &["--out: expected a folder or FILE.mp4", "x.png"],
        ),
        (
            "render demo --mode native --compare c.png --out o",
            &["--compare: expected a mode other than native"],
        ),
        (
            "render demo --size 64x36 --tier analytic --interpolation learned --out o",
            &["--interpolation: expected analytic", "tier analytic", "found learned"],
        ),
        (
            "render demo --size 64x36 --scale 2 --tier balanced --interpolation learned --out o",
            &["--interpolation: expected analytic", "balanced at scale 2", "found learned"],
        ),
        (
            "render demo --size 64x36 --backend cpu --tier balanced --matrix-products --out o",
            &["--matrix-products: expected a GPU", "found the CPU"],
        ),
        ("gbuffer demo --frame 900 --out g.npz", &["--frame: expected", "900"]),
        ("gbuffer demo --size 64x36 --out file/g.npz", &["file/g.npz: cannot be written"]),
        ("gbuffer demo --jitter 3,0 --out g.npz", &["expected X,Y from -1 to 1", "3,0"]),
        ("gbuffer demo --scale 0 --out g.npz", &["scale: expected 1 to"]),
        (
            "gbuffer demo --scale 2 --dilation kerbl --out g.npz",
            &["--scale: expected --dilation matched, found --dilation kerbl"],
        ),
        (
            "gbuffer demo --dilation 0.1 --scale 4 --out g.npz",
            &["--scale: expected --dilation matched, found --dilation 0.1"],
        ),
        (
            "evaluate demo --protocol paper --culling accutile --out o",
            &["--culling: expected --protocol methods, found --protocol paper"],
        ),
        ("gbuffer demo --backend cpu --adapter 0 --out g.npz", &["--adapter: expected", "--backend cpu"]),
        ("render demo --backend gpu --adapter 99 --out a.png", &["GPU adapter: expected adapter 99"]),
        ("info missing.spz", &["missing.spz"]),
        (
            "render demo --size 64x36 --weights nope.safetensors --out o",
            &["error: nope.safetensors: No such file"],
        ),
        ("export noise.bin --out o.onnx", &["error: noise.bin: expected safetensors"]),
        ("export nope --out o.onnx", &["error: nope: No such file"]),
        (
            "convert demo scene.xyz",
            &[
                "scene.xyz",
                "expected .ply, .compressed.ply, .spz, .sog, .glb, .splat or lod-meta.json",
                "xyz",
            ],
        ),
        (
            "convert demo scene.sog --lod-chunk-count 9",
            &["--lod-chunk-count: expected an output that ends in lod-meta.json, found 9 with scene.sog"],
        ),
        ("bench demo --frames 0..9999", &["--frames: expected", "0..9999"]),
    ];
    let training = "--clips c --checkpoint o --out o.safetensors";
    let trainings: &[(&str, &[&str])] = &[
        (
            "super-sample --steps 1 --perceptual p",
            &["--perceptual: expected --loss perceptual=WEIGHT above 0 with it, found perceptual=0"],
        ),
        ("interpolate --steps 1 --perceptual p --loss perceptual=0", &["--perceptual: expected --loss"]),
        ("super-sample --minutes 1e18", &["length: expected at most 1000000000 seconds, found 6"]),
        ("super-sample --steps 1 --epsilon 1e-30", &["epsilon: expected 1e-18 to 10, found 1e-30"]),
        (
            "super-sample --steps 1 --warm-up 18446744073709551615",
            &["warm-up: expected at most 1000000000 steps, found 18446744073709551615"],
        ),
        (
            "super-sample --steps 1 --save-every nan",
            &["time between checkpoints: expected 0 to 1000000000 seconds, found NaN"],
        ),
    ];
    let trainings = trainings.iter().map(|(arguments, expected)| {
        let (network, rest) = arguments.split_once(' ').unwrap();
        (format!("train {network} {training} {rest}"), *expected)
    });
    let cases = cases.iter().map(|(arguments, expected)| ((*arguments).to_owned(), *expected));
    for (arguments, expected) in cases.chain(trainings) {
        let said = refused(&mut gs3(at, &arguments));
        for part in expected {
            assert!(said.contains(part), "gs3 {arguments}: {said:?} should contain {part:?}");
        }
        assert_eq!(names(at), before, "gs3 {arguments} leaves nothing");
    }
}

#[test]
fn a_simd_level_that_is_not_there_is_told_before_any_work() {
    let folder = tempfile::tempdir().unwrap();
    // No processor has both.
    let foreign = if cfg!(target_arch = "aarch64") { "avx2" } else { "neon" };
    for (value, expected) in
        [("wide", "expected one of scalar"), (foreign, "expected a level that this processor has (scalar")]
    {
        let mut command = gs3(folder.path(), "render demo --frames 0..1 --size 64x36 --out out");
        let text = refused(command.env("GS3_SIMD", value));
        assert!(text.contains("GS3_SIMD") && text.contains(expected), "{text}");
        assert!(text.contains(value) && names(folder.path()).is_empty(), "{text}");
    }
}
