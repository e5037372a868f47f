//! Files of cameras, spelled out here: the seeds of their fuzz targets. Each holds the same two cameras, at (1, 2, 3)
//! and (1, 2, 4).

use std::collections::BTreeMap;

use gs3_scene::capture::{CaptureFault, ColmapEncoding, parse_colmap, parse_json};
use gs3_scene::glam::{DMat3, DVec3};
use gs3_scene::{Camera, CameraPath};

use crate::readers::{pack, unpack};

/// Both files of a binary model: one pinhole camera of 64 × 48 pixels, photos `a.jpg` and `b.jpg` with a point each.
fn colmap_binary() -> BTreeMap<String, Vec<u8>> {
    let mut cameras = 1_u64.to_le_bytes().to_vec();
    cameras.extend([7_u32, 1].iter().flat_map(|id| id.to_le_bytes()));
    cameras.extend([64_u64, 48].iter().flat_map(|side| side.to_le_bytes()));
    cameras.extend([60.0_f64, 60.0, 32.0, 24.0].iter().flat_map(|value| value.to_le_bytes()));
    let mut images = 2_u64.to_le_bytes().to_vec();
    for (name, z) in [("a.jpg", -3.0), ("b.jpg", -4.0)] {
        images.extend(5_u32.to_le_bytes());
        images.extend([1.0_f64, 0.0, 0.0, 0.0, -1.0, -2.0, z].iter().flat_map(|value| value.to_le_bytes()));
        images.extend(7_u32.to_le_bytes());
        images.extend(name.bytes().chain([0]));
        images.extend(1_u64.to_le_bytes());
        images.extend([0; 24]);
    }
    BTreeMap::from([("cameras".to_owned(), cameras), ("images".to_owned(), images)])
}

/// The same as text.
fn colmap_text() -> BTreeMap<String, Vec<u8>> {
    let cameras = b"# id model size parameters\n7 SIMPLE_PINHOLE 64 48 60 32 24\n";
    let images =
        b"# id pose camera name\n5 1 0 0 0 -1 -2 -3 7 a.jpg\n0.5 1.5 -1\n6 1 0 0 0 -1 -2 -4 7 b.jpg\n\n";
    BTreeMap::from([("cameras".to_owned(), cameras.to_vec()), ("images".to_owned(), images.to_vec())])
}

const TRANSFORMS: &str = r#"{"fl_x": 60, "w": 64, "h": 48.0, "k1": 0.0, "is_fisheye": false, "camera_model": "OPENCV",
"frames": [{"file_path": "a.png", "transform_matrix": [[1,0,0,1],[0,-1,0,2],[0,0,-1,3],[0,0,0,1]]},
{"file_path": "b.png", "camera_angle_y": 0.8, "fl_y": 6e1, "cx": 32, "transform_matrix":
[[1,0,0,1],[0,-1,0,2],[0,0,-1,4]]}]}"#;

const CAMERAS: &str = r#"[{"id": 0, "img_name": "b", "width": 64, "height": 48, "position": [1, 2, 4],
"rotation": [[1,0,0],[0,1,0],[0,0,1]], "fx": 60, "fy": 60},
{"img_name": "a", "width": 64, "height": 48, "position": [1, 2, 3],
"rotation": [[1,0,0],[0,1,0],[0,0,1]], "fx": 60.0, "fy": 60}]"#;

/// Of a field of view of 2 · atan(24 / 60).
const CAMERA_PATH: &str = r#"{"camera_type": "perspective", "render_width": 64, "render_height": 48, "fps": 24, "is_cycle": true,
"camera_path": [{"camera_to_world": [1,0,0,1,0,-1,0,2,0,0,-1,3,0,0,0,1], "fov": 43.60281897270362, "aspect": 1},
{"camera_to_world": [1,0,0,1,0,-1,0,2,0,0,-1,4,0,0,0,1], "fov": 43.60281897270362}]}"#;

const SUPERSPLAT: &str = r#"{"version": 2, "cameras": [{"initial": {"position": [1, 2, 3], "target": [0, 0, 0], "fov": 60}}],
"animTracks": [{"name": "a", "duration": 0.2, "frameRate": 30, "loopMode": "none", "interpolation": "spline",
"smoothness": 1, "keyframes": {"times": [0, 3], "values": {"position": [-1, -2, 3, -1, -2, 4],
"target": [-1, -2, 9, -1, -2, 9], "fov": [60, 50]}}}]}"#;

const REALITYSCAN: &str = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2\n\
b.jpg,1,2,4,0,90,0,33.75,0,0,0.1,0,0,0,0,0\na.jpg,1,2,3,0,90,0,33.75,0,0,0,0,0,0,0,0\n";

/// The seed of a fuzz target of cameras.
pub fn seed(target: &str) -> Option<Vec<u8>> {
    match target {
        "colmap_binary" => Some(pack(&colmap_binary())),
        "colmap_text" => Some(pack(&colmap_text())),
        "transforms" => Some(TRANSFORMS.into()),
        "cameras" => Some(CAMERAS.into()),
        "camera_path" => Some(CAMERA_PATH.into()),
        "supersplat" => Some(SUPERSPLAT.into()),
        "realityscan" => Some(REALITYSCAN.into()),
        _ => None,
    }
}

/// Fuzzing starts from files that are read to their end, not from the first error.
#[test]
fn the_seeds_are_the_same_two_cameras() {
    let colmap = |encoding: ColmapEncoding, target: &str| {
        let files = unpack(&seed(target).unwrap());
        parse_colmap(encoding, &files["cameras"], &files["images"])
    };
    let paths: [Result<CameraPath, CaptureFault>; 5] = [
        colmap(ColmapEncoding::Binary, "colmap_binary"),
        colmap(ColmapEncoding::Text, "colmap_text"),
        parse_json(&seed("transforms").unwrap()),
        parse_json(&seed("cameras").unwrap()),
        parse_json(&seed("camera_path").unwrap()),
    ];
    for path in paths {
        let path = path.unwrap();
        let is_at = |camera: &Camera, z: f64| {
            let (pose, i) = (camera.world_from_view(), camera.intrinsics());
            let is_there = pose.translation.distance(DVec3::new(1.0, 2.0, z)) < 1e-12;
            let is_upright = pose.matrix3.abs_diff_eq(DMat3::IDENTITY, 1e-12);
            let is_pinhole = (i.width, i.height, i.cx, i.cy) == (64, 48, 32.0, 24.0);
            is_there && is_upright && is_pinhole && (i.fx - 60.0).abs() + (i.fy - 60.0).abs() < 1e-9
        };
        let [first, second] = path.cameras() else { panic!("{path:?}") };
        assert!(is_at(first, 3.0) && is_at(second, 4.0), "{path:?}");
    }
}

/// What a file says comes back in one line, however long it is.
#[test]
fn words_in_messages_are_cut() {
    let long = "q".repeat(10_000);
    // Cameras that no image has are not looked at.
    let image = b"1 1 0 0 0 0 0 0 1 a.png\n\n";
    let faults = [
        parse_colmap(ColmapEncoding::Text, format!("1 {long} 64 48 1 1 1").as_bytes(), image),
        parse_colmap(ColmapEncoding::Text, format!("1 PINHOLE {long}").as_bytes(), image),
        parse_json(format!(r#"{{"camera_model": "{long}\n", "frames": [{{}}]}}"#).as_bytes()),
        parse_json(format!(r#"{{"camera_type": "{long}\n", "camera_path": []}}"#).as_bytes()),
    ];
    for fault in faults {
        let message = fault.unwrap_err().to_string();
        assert!(message.len() < 400 && !message.contains('\n') && message.contains("qqq"), "{message}");
    }
}
