//! Pictures larger than what is rendered at once.

use std::fs;
use std::path::Path;

use super::chunks::few_gaussians;
use super::{gs3, json, names, png, refused, stderr, succeed};

/// A transforms.json of two cameras with images of `width` × 20 pixels around the same ray, from column 4100 of the widest on.
fn wide(width: u32) -> String {
    let frame = |x: f64| format!(r#"{{"transform_matrix": [[1,0,0,{x}],[0,1,0,-1],[0,0,1,7],[0,0,0,1]]}}"#);
    format!(
        r#"{{"w": {width}, "h": 20, "fl_x": 6000, "fl_y": 40, "cx": 4100, "cy": 10, "frames": [{}, {}]}}"#,
        frame(0.0),
        frame(0.1)
    )
}

fn render(at: &Path, options: &str) {
    succeed(at, &format!("render few.ply --mode native --backend cpu {options}"));
}

#[test]
fn pictures_of_any_size_are_made_in_tiles() {
    let folder = few_gaussians();
    let at = folder.path();
    fs::write(at.join("wide.json"), wide(8300)).unwrap();
    fs::write(at.join("part.json"), wide(8192)).unwrap();
    render(at, "--path wide.json --out wide --json r.json");
    render(at, "--path part.json --out part");
    assert_eq!(names(&at.join("wide")), ["frame_000000.png", "frame_000001.png"]);
    let report = json(&at.join("r.json"));
    assert_eq!(report["size"], serde_json::json!([8300, 20]));
    assert_eq!(report["tile"], serde_json::json!([2768, 20]));
    assert_eq!((&report["frames_written"], &report["is_complete"]), (&2.into(), &true.into()));
    for k in 0..2 {
        let [wide, part] = ["wide", "part"].map(|name| png(&at.join(format!("{name}/frame_{k:06}.png"))));
        assert_eq!((wide.0, wide.1, part.0), (8300, 20, 8192));
        let rows = wide.2.chunks_exact(3 * 8300).zip(part.2.chunks_exact(3 * 8192));
        // A camera of another width limits the Jacobian farther out, which changes what lies far outside alone.
        let differences = rows.flat_map(|(wide, part)| wide.iter().zip(part).map(|(a, b)| a.abs_diff(*b)));
        let (mut off, mut shown) = (0, 0);
        differences.for_each(|difference| off += usize::from(difference > 0));
        part.2.iter().for_each(|value| shown += usize::from(*value > 0));
        assert!(shown > 10_000 && off < shown / 100, "{off} of {shown} values differ");
    }
    // Frames that are there stay, in a folder of frames of this kind alone.
    let before = fs::read(at.join("wide/frame_000000.png")).unwrap();
    fs::remove_file(at.join("wide/frame_000001.png")).unwrap();
    render(at, "--path wide.json --out wide --skip-existing --json r.json");
    assert_eq!(json(&at.join("r.json"))["frames_rendered"], 1);
    assert!(
        fs::read(at.join("wide/frame_000000.png")).unwrap() == before && names(&at.join("wide")).len() == 2
    );
    let again = "render few.ply --mode native --backend cpu --path wide.json --background 1,0,0 --skip-existing --out wide";
    let said = stderr(&gs3(at, again).output().unwrap());
    assert!(said.contains("expected frames of background [1.0,0.0,0.0]"), "{said}");
    // One picture, transparent.
    render(at, "--path wide.json --out one.png --alpha");
    let (width, height, bytes) = png(&at.join("one.png"));
    assert_eq!((width, height, bytes.len()), (8300, 20, 4 * 8300 * 20));
    assert!(
        bytes.chunks_exact(4).any(|pixel| pixel[3] > 200)
            && bytes.chunks_exact(4).any(|pixel| pixel == [0; 4])
    );
}

#[test]
fn sizes_that_are_not_made_are_refused() {
    let folder = few_gaussians();
    let at = folder.path();
    fs::write(at.join("wide.json"), wide(8300)).unwrap();
    let before = names(at);
    let most = "--size: expected a size up to 8192x8192 (gs3 render --mode native makes larger pictures)";
    for (command, expected) in [
        ("render few.ply --size 8193x8 --out o", format!("{most}, found 8193x8")),
        (
            "render few.ply --path wide.json --out o",
            format!("{most}, as the images of the cameras are larger, found none, for 8300x20"),
        ),
        ("gbuffer few.ply --size 8x9999 --out o.npz", format!("{most}, found 8x9999")),
        ("bench few.ply --size 8193x8", format!("{most}, found 8193x8")),
        (
            "render few.ply --mode native --size 65536x8 --out o",
            "--size: expected WIDTHxHEIGHT from 1x1 to 65535x65535, found 65536x8".to_owned(),
        ),
        (
            "render few.ply --mode native --size 8193x8 --out o.mp4",
            "--out: expected DIR or FILE.png for frames of more than 8192 pixels a side, found o.mp4"
                .to_owned(),
        ),
        (
            "render few.ply --mode native --size 8193x8 --out o.exr",
            "--out: expected DIR or FILE.png for frames of more than 8192 pixels a side, found o.exr"
                .to_owned(),
        ),
        (
            "render few.ply --mode native --size 8193x8 --aov depth,motion --out o",
            "--aov: expected frames of at most 8192 pixels a side, found depth,motion".to_owned(),
        ),
    ] {
        let said = refused(&mut gs3(at, command));
        assert!(said.contains(&expected), "{command}: {said}");
        assert_eq!(names(at), before, "{command} leaves nothing");
    }
}

#[test]
#[cfg(unix)]
fn an_interrupted_picture_leaves_nothing() {
    let folder = few_gaussians();
    let at = folder.path();
    let child = gs3(at, "render demo --mode native --backend cpu --size 20000x20000 --out big/p.png")
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let output = super::interrupt(child, || at.join("big").is_dir() && !names(&at.join("big")).is_empty());
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(130), "{said}");
    assert!(said.contains("interrupted; all files are whole"), "{said}");
    assert_eq!(names(&at.join("big")), [""; 0]);
}
