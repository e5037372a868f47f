//! Files of kinds that people have reported trouble with, made here: what they mean is what is shown, or what is not used
//! is told.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use crate::scenes::npz;
use crate::{gs3, json, png, stderr, succeed};

/// Numbers from 0 to 1 that look random.
fn random(seed: u32) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1 << 24)
    }
}

/// A text PLY of Gaussians of degree 0 within a cube of `side` around `center`, with more properties and lines of the
/// header, and values for the properties.
fn ply(center: [f64; 3], side: f64, count: usize, header: &str, more: &dyn Fn(usize) -> String) -> String {
    let mut text = "ply\nformat ascii 1.0\n".to_owned();
    let (comments, properties): (Vec<&str>, Vec<&str>) =
        header.lines().partition(|l| l.starts_with("comment"));
    comments.iter().for_each(|line| writeln!(text, "{line}").unwrap());
    writeln!(text, "element vertex {count}").unwrap();
    for name in
        "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split(' ')
    {
        writeln!(text, "property double {name}").unwrap();
    }
    properties.iter().for_each(|line| writeln!(text, "{line}").unwrap());
    text += "end_header\n";
    let mut random = random(7);
    for i in 0..count {
        let position = center.map(|c| c + (random() - 0.5) * side);
        let color = [0; 3].map(|_| 3.0 * random() - 1.5);
        let scale = [0; 3].map(|_| (0.03 * side * (0.5 + random())).ln());
        let values = position.into_iter().chain(color).chain([1.0]).chain(scale).chain([1.0, 0.2, -0.3, 0.1]);
        values.for_each(|value| write!(text, "{value:.17} ").unwrap());
        writeln!(text, "{}", more(i)).unwrap();
    }
    text
}

fn plain(center: [f64; 3], side: f64) -> String {
    ply(center, side, 200, "", &|_| String::new())
}

/// A transforms.json of one camera of 96×64 pixels at `center`, looking along z.
fn camera(center: [f64; 3], more: &str) -> String {
    let [x, y, z] = center;
    format!(
        r#"{{"w": 96, "h": 64, "fl_x": 80{more}, "frames": [{{"file_path": "a.png", "transform_matrix":
        [[1, 0, 0, {x}], [0, -1, 0, {y}], [0, 0, -1, {z}], [0, 0, 0, 1]]}}]}}"#
    )
}

/// The colours of `gs3 gbuffer {arguments}`, and what it said.
fn color(at: &Path, arguments: &str) -> (Vec<f32>, String) {
    let output = succeed(at, &format!("gbuffer {arguments} --backend cpu --dilation kerbl --out o.npz"));
    (npz(&at.join("o.npz"))["color"].1.clone(), stderr(&output))
}

fn farthest(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn far_scenes_look_like_near_ones() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let far = [500_000.25, 4_500_000.5, 300.0];
    fs::write(at.join("near.ply"), plain([0.0; 3], 4.0)).unwrap();
    fs::write(at.join("far.ply"), plain(far, 4.0)).unwrap();
    fs::write(at.join("near.json"), camera([0.0, 0.0, -6.0], "")).unwrap();
    fs::write(at.join("far.json"), camera([far[0], far[1], far[2] - 6.0], "")).unwrap();
    let (near, said) = color(at, "near.ply --path near.json");
    assert_eq!(said, "");
    assert!(near.iter().any(|v| *v > 0.3));
    let (shown, _) = color(at, "far.ply --path far.json");
    assert!(farthest(&near, &shown) < 1e-3);
    // Files that are made of it are where it was.
    for extension in ["ply", "glb", "sog"] {
        succeed(at, &format!("convert far.ply again.{extension}"));
        let (again, _) = color(at, &format!("again.{extension} --path far.json"));
        assert!(farthest(&near, &again) < 0.2, "{extension}");
        let mean = near.iter().zip(&again).map(|(a, b)| (a - b).abs()).sum::<f32>() / near.len() as f32;
        assert!(mean < 0.01, "{extension}: {mean}");
    }
    let said = stderr(&succeed(at, "convert far.ply again.splat"));
    assert!(said.contains("rounded to steps"), "{said}");
}

#[test]
fn small_scenes_are_not_cut_by_the_near_plane_and_others_aloud() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for (name, unit) in [("small", 1.0 / 64.0), ("large", 1.0)] {
        fs::write(at.join(format!("{name}.ply")), plain([0.0; 3], 4.0 * unit)).unwrap();
        fs::write(at.join(format!("{name}.json")), camera([0.0, 0.0, -6.0 * unit], "")).unwrap();
    }
    let (large, _) = color(at, "large.ply --path large.json");
    let (small, said) = color(at, "small.ply --path small.json");
    assert!(farthest(&large, &small) < 1e-3);
    assert_eq!(said, "");
    let (cut, said) = color(at, "small.ply --path small.json --near 0.1");
    assert!(said.contains("nearer than the near plane, 0.1") && said.contains("--near"), "{said}");
    assert!(farthest(&large, &cut) > 0.1);
    let output = gs3(at, "gbuffer small.ply --near 0 --out o.npz").output().unwrap();
    assert!(stderr(&output).contains("--near") && output.status.code() == Some(2));
}

#[test]
fn left_out_gaussians_and_unused_fields_are_told_by_every_command() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let header = "comment SplatRenderMode: odd\nproperty float mask\nproperty float nx";
    let broken = ply([0.0; 3], 4.0, 200, header, &|_| "1 0".to_owned());
    // Half of all Gaussians get no number for x.
    let mut lines: Vec<String> = broken.lines().map(str::to_owned).collect();
    let first = lines.iter().position(|line| line == "end_header").unwrap() + 1;
    for line in lines[first..].iter_mut().step_by(2) {
        let rest = line.split_once(' ').unwrap().1.to_owned();
        *line = format!("nan {rest}");
    }
    fs::write(at.join("s.ply"), lines.join("\n") + "\n").unwrap();
    fs::write(at.join("c.json"), camera([0.0, 0.0, -6.0], r#", "rolling_shutter": 0.5"#)).unwrap();
    for arguments in [
        "info s.ply",
        "convert s.ply o.spz",
        "gbuffer s.ply --path c.json --out o.npz",
        "render s.ply --path c.json --mode native --out o.png",
        "simplify s.ply --cameras c.json --keep 0.5 --out k.ply",
    ] {
        let said = stderr(&succeed(at, arguments));
        assert_eq!(
            said.matches("100 (100 invalid mean) invalid Gaussians are left out").count(),
            1,
            "{arguments}: {said}"
        );
        assert_eq!(said.matches("vertex properties not used: \"mask\"").count(), 1, "{arguments}: {said}");
        assert_eq!(said.matches("SplatRenderMode").count(), 1, "{arguments}: {said}");
        let cameras = usize::from(arguments.contains("c.json"));
        assert_eq!(
            said.matches("fields not used: \"rolling_shutter\"").count(),
            cameras,
            "{arguments}: {said}"
        );
    }
}

#[test]
fn the_vertical_axis_of_a_file_is_up() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // A column along z, wider than a place would be. The upper quarter is red.
    let mut random = random(3);
    let mut column = ply([0.0; 3], 1.0, 0, "comment Vertical Axis: z", &|_| String::new());
    column = column.replace("element vertex 0", "element vertex 600");
    for i in 0..600 {
        let height = f64::from(i) / 150.0;
        let [red, other] = if i > 450 { [2.0, -2.0] } else { [0.0, 0.0] };
        let (x, y) = (random() - 0.5, random() - 0.5);
        writeln!(column, "{x} {y} {height} {red} {other} {other} 3 -3 -3 -3 1 0 0 0").unwrap();
    }
    fs::write(at.join("z.ply"), column).unwrap();
    let info: serde_json::Value = serde_json::from_slice(&succeed(at, "info z.ply --json").stdout).unwrap();
    assert_eq!(info["bulk"]["up"], serde_json::json!([0.0, 0.0, 1.0]));
    succeed(at, "render z.ply --out o.png --size 160x160 --mode native --backend cpu");
    let (width, _, bytes) = png(&at.join("o.png"));
    let rows = |is: &dyn Fn(&[u8]) -> bool| {
        let found: Vec<usize> =
            bytes.chunks(3).enumerate().filter(|(_, p)| is(p)).map(|(i, _)| i / width as usize).collect();
        assert!(found.len() > 50);
        found.iter().sum::<usize>() / found.len()
    };
    let red = rows(&|p| p[0] > 100 && p[1] < 60);
    let grey = rows(&|p| p[0] > 60 && p[1] > 60);
    assert!(red + 30 < grey, "red in row {red}, grey in row {grey}");
}

#[test]
fn axes_are_those_of_the_file_or_as_told() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("s.ply"), plain([0.0; 3], 4.0)).unwrap();
    fs::write(at.join("c.json"), camera([0.0, 0.0, -6.0], "")).unwrap();
    let (expected, _) = color(at, "s.ply --path c.json");
    for (version, stated, other) in [(3, "right-up-back", "rdf"), (4, "right-down-front", "rub")] {
        succeed(at, &format!("convert s.ply s.spz --spz-version {version}"));
        let (spz, _) = color(at, "s.spz --path c.json");
        let mean = expected.iter().zip(&spz).map(|(a, b)| (a - b).abs()).sum::<f32>() / spz.len() as f32;
        assert!(mean < 0.01, "version {version}: {mean}");
        let text = String::from_utf8(succeed(at, "info s.spz").stdout).unwrap();
        assert!(text.contains(&format!("{stated} (as the file states)")), "{text}");
        // Taken as the other, it is upside down.
        let (turned, said) = color(at, &format!("s.spz --path c.json --axes {other}"));
        assert!(farthest(&expected, &turned) > 0.2);
        assert!(said.contains(&format!("states axes {stated}")), "{said}");
    }
    let (same, _) = color(at, "s.ply --path c.json --axes rdf");
    assert_eq!(expected, same);
    let output = gs3(at, "convert s.ply o.ply --spz-version 3").output().unwrap();
    assert!(stderr(&output).contains("--spz-version: expected an output that ends in .spz"));
}

#[test]
fn frames_have_straight_alpha_in_every_mode() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("s.ply"), plain([0.0; 3], 4.0)).unwrap();
    fs::write(at.join("c.json"), camera([0.0, 0.0, -6.0], "")).unwrap();
    succeed(at, "gbuffer s.ply --path c.json --backend cpu --scale 1 --out g.npz");
    let arrays = npz(&at.join("g.npz"));
    let (color, alpha) = (&arrays["color"].1, &arrays["alpha"].1);
    for mode in [
        "native",
        "bicubic --scale 2",
        "super-sample --scale 2 --tier analytic",
        "full --scale 2 --tier analytic",
    ] {
        succeed(at, &format!("render s.ply --path c.json --alpha --backend cpu --mode {mode} --out o.png"));
        let decoder = ::png::Decoder::new(std::io::BufReader::new(fs::File::open(at.join("o.png")).unwrap()));
        let mut reader = decoder.read_info().unwrap();
        assert_eq!(reader.info().color_type, ::png::ColorType::Rgba);
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut bytes).unwrap();
        let (mut sum, mut worst) = (0.0f32, 0.0f32);
        for (i, pixel) in bytes.chunks(4).enumerate() {
            sum += (f32::from(pixel[3]) / 255.0 - alpha[i]).abs();
            if alpha[i] > 0.5 && mode == "native" {
                let straight = |c: usize| (color[3 * i + c] / alpha[i]).clamp(0.0, 1.0);
                worst =
                    (0..3).map(|c| (f32::from(pixel[c]) / 255.0 - straight(c)).abs()).fold(worst, f32::max);
            }
        }
        let mean = sum / alpha.len() as f32;
        assert!(
            mean < if mode == "native" { 0.003 } else { 0.03 } && worst < 0.012,
            "{mode}: {mean} {worst}"
        );
    }
    let output = gs3(at, "render s.ply --path c.json --alpha --out o.mp4").output().unwrap();
    assert!(stderr(&output).contains("--alpha: expected --out DIR or FILE.png"), "{}", stderr(&output));
}

#[test]
fn panoramas_show_all_around() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // One red ball before the camera and one green one to its right.
    let mut scene =
        ply([0.0; 3], 1.0, 0, "", &|_| String::new()).replace("element vertex 0", "element vertex 2");
    scene += "0 0 5 2 -2 -2 9 -1 -1 -1 1 0 0 0\n5 0 0 -2 2 -2 9 -1 -1 -1 1 0 0 0\n";
    fs::write(at.join("s.ply"), scene).unwrap();
    let path = r#"{"camera_type": "equirectangular", "render_width": 128, "render_height": 64, "camera_path":
        [{"camera_to_world": [1,0,0,0, 0,-1,0,0, 0,0,-1,0, 0,0,0,1], "fov": 50, "aspect": 2}]}"#;
    fs::write(at.join("p.json"), path).unwrap();
    succeed(at, "render s.ply --path p.json --mode native --backend cpu --out o.png");
    let (width, height, bytes) = png(&at.join("o.png"));
    assert_eq!((width, height), (128, 64));
    let pixel = |x: usize, y: usize| [0, 1, 2].map(|c| bytes[(y * 128 + x) * 3 + c]);
    let (front, right, behind) = (pixel(64, 32), pixel(96, 32), pixel(0, 32));
    assert!(front[0] > 150 && front[1] < 50, "{front:?}");
    assert!(right[1] > 150 && right[0] < 50, "{right:?}");
    assert_eq!(behind, [0; 3]);
    let output = gs3(at, "gbuffer s.ply --path p.json --out o.npz").output().unwrap();
    assert!(stderr(&output).contains("perspective cameras"), "{}", stderr(&output));
}

#[test]
fn large_cameras_are_rendered_at_a_size_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("s.ply"), plain([0.0; 3], 4.0)).unwrap();
    let large = camera([0.0, 0.0, -6.0], "")
        .replace("\"w\": 96, \"h\": 64, \"fl_x\": 80", "\"w\": 9600, \"h\": 6400, \"fl_x\": 8000");
    fs::write(at.join("large.json"), large).unwrap();
    fs::write(at.join("c.json"), camera([0.0, 0.0, -6.0], "")).unwrap();
    let (expected, _) = color(at, "s.ply --path c.json");
    let (shown, _) = color(at, "s.ply --path large.json --size 96x64");
    assert!(farthest(&expected, &shown) < 1e-4);
    let output = gs3(at, "gbuffer s.ply --path large.json --out o.npz").output().unwrap();
    let said = stderr(&output);
    assert!(said.contains("--size: expected a size up to 8192x8192") && said.contains("9600x6400"), "{said}");
    let (wide, _) = color(at, "s.ply --path c.json --fov 90");
    assert!(farthest(&expected, &wide) > 0.1);
}

/// Entries of splats and tiles beyond what memory has room for are made in bands of rows.
#[test]
#[cfg(target_os = "linux")]
fn heavy_scenes_render_within_bounded_memory() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // 200,000 Gaussians that cover all of 1,200 tiles each: 1 GB of entries at once.
    let mut splat = Vec::new();
    let mut random = random(9);
    for _ in 0..200_000 {
        let mean = [random() - 0.5, random() - 0.5, random() - 0.5].map(|v| v as f32);
        splat.extend(mean.into_iter().chain([2.0; 3]).flat_map(f32::to_le_bytes));
        splat.extend([200, 100, 50, 20, 255, 128, 128, 128]);
    }
    fs::write(at.join("heavy.splat"), splat).unwrap();
    fs::write(at.join("c.json"), camera([0.0, 0.0, -3.0], "")).unwrap();
    let arguments = "render heavy.splat --path c.json --size 960x640 --mode native --backend cpu --threads 2 --out o.png \
                     --json o.json";
    succeed(at, arguments);
    let peak = json(&at.join("o.json"))["peak_rss_mb"].as_f64().unwrap();
    assert!(peak < 700.0, "{peak} MB");
}
