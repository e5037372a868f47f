//! One pose written in every format has to come back as the same camera; everything else has to be an error.

mod of_colmap;
mod of_transforms;

use std::path::Path;

use super::file::read;
use super::*;
use proptest::prelude::*;

/// Camera at (1, 2, 3) that looks along world +x with world +z up: right = −y, down = −z, forward = +x.
const CENTER: DVec3 = DVec3::new(1.0, 2.0, 3.0);

fn expected_rotation() -> DMat3 {
    DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X)
}

fn assert_is_the_camera(path: &CameraPath, index: usize) {
    let camera = path.cameras()[index];
    assert!((camera.position() - CENTER).length() < 1e-9, "{camera:?}");
    let difference = camera.world_from_view().matrix3 - expected_rotation();
    assert!(difference.to_cols_array().iter().all(|v| v.abs() < 1e-9), "{camera:?}");
    let i = camera.intrinsics();
    assert_eq!((i.width, i.height), (640, 480));
    assert!((i.fx - 500.0).abs() < 1e-9 && (i.fy - 500.0).abs() < 1e-9, "{i:?}");
}

/// OpenGL camera-to-world of the camera: right, up, backward.
const OPENGL: &str = "[[0, 0, -1, 1], [-1, 0, 0, 2], [0, 1, 0, 3], [0, 0, 0, 1]]";

#[test]
fn inria_cameras_in_the_order_of_names() {
    let camera = |name: &str, fx: f64| {
        format!(
            r#"{{"id": 0, "img_name": "{name}", "width": 640, "height": 480, "position": [1, 2, 3],
                "rotation": [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], "fx": {fx}, "fy": 500}}"#
        )
    };
    let json = format!("[{}, {}]", camera("frame_10", 600.0), camera("frame_2", 500.0));
    let path = parse_json(json.as_bytes()).unwrap();
    assert_is_the_camera(&path, 0);
    assert_eq!((path.name(0), path.name(1)), (Some("frame_2"), Some("frame_10")));
}

#[test]
fn nerfstudio_path() {
    let fov = (2.0 * (240.0_f64 / 500.0).atan()).to_degrees();
    let json = format!(
        r#"{{"camera_type": "perspective", "render_width": 640, "render_height": 480, "fps": 24, "is_cycle": true,
            "camera_path": [{{"camera_to_world": [0,0,-1,1, -1,0,0,2, 0,1,0,3, 0,0,0,1], "fov": {fov}, "aspect": 1}},
                            {{"camera_to_world": [0,0,-1,1, -1,0,0,2, 0,1,0,3, 0,0,0,1], "fov": {fov}}}]}}"#
    );
    let path = parse_json(json.as_bytes()).unwrap();
    // As the Blender add-on writes it: the aspect is not the images' aspect.
    assert_is_the_camera(&path, 0);
    assert_is_the_camera(&path, 1);
    assert_eq!((path.frames_per_second(), path.is_cycle(), path.name(0)), (24.0, true, None));
}

#[test]
fn errors_name_the_field() {
    let cases = [
        (
            r#"{"frames": [{"transform_matrix": 3}], "fl_x": 1, "w": 4, "h": 4}"#,
            "frames[0].transform_matrix: expected an array",
        ),
        (r#"{"frames": [], "fl_x": 1}"#, "cameras: expected at least 1, found 0"),
        (r#"{"frames": [{}]}"#, "frames[0].fl_x: expected fl_x or camera_angle_x"),
        (r#"{"frames": [{"k2": "x"}]}"#, "frames[0].k2: expected a finite number"),
        (r#"{"frames": [{"w": -3}]}"#, "frames[0].w: expected a positive whole number of pixels, found -3"),
        (r#"{"frames": [{"w": 1e300}]}"#, "frames[0].w: expected a positive whole number of pixels"),
        (
            r#"{"frames": [{"fl_x": 5}]}"#,
            "w: expected the image size in pixels, or the picture itself, found nothing",
        ),
        (
            r#"{"camera_angle_x": 1, "w": 5, "frames": [{}]}"#,
            "h: expected the image size in pixels, or the picture itself, found nothing",
        ),
        (
            r#"{"camera_model": "MIRROR", "frames": [{}]}"#,
            "camera_model: expected a pinhole, radial or fisheye lens, found \"MIRROR\"; run undistortion",
        ),
        (r#"{"is_fisheye": true, "frames": [{}]}"#, "frames[0].fl_x: expected fl_x or camera_angle_x"),
        (r#"{"frames": [{"is_fisheye": "yes"}]}"#, "frames[0].is_fisheye: expected true or false"),
        (r#"{"latlong": {}, "frames": [{}]}"#, "latlong: expected a pinhole"),
        (r#"{"frames": [{"ftheta_p0": 0, "ftheta_p1": 0.1}]}"#, "frames[0].ftheta_p1: expected a pinhole"),
        (r#"[{"width": 4}]"#, "[0].height: expected the image size in pixels, found nothing"),
        (
            r#"{"camera_path": 3, "render_height": 3, "render_width": 4}"#,
            "camera_path: expected an array, found 3",
        ),
        (
            r#"{"camera_type": "fisheye", "camera_path": []}"#,
            "camera_type: expected \"perspective\" or \"equirectangular\"",
        ),
        (r#"{"x": 1}"#, "expected cameras"),
        ("{", "expected valid JSON"),
    ];
    for (json, expected) in cases {
        let message = parse_json(json.as_bytes()).unwrap_err().to_string();
        assert!(message.contains(expected), "{message:?} should contain {expected:?}");
    }
    let singular = OPENGL.replace('1', "0");
    let json = format!(r#"{{"fl_x": 5, "w": 4, "h": 4, "frames": [{{"transform_matrix": {singular}}}]}}"#);
    let message = parse_json(json.as_bytes()).unwrap_err().to_string();
    assert!(message.contains("frames[0]: camera pose"), "{message}");
}

#[test]
fn principal_points_and_rounded_rotations_of_inria_cameras() {
    let camera = |more: &str, rotation: &str| {
        format!(
            r#"[{{"img_name": "a", "width": 640, "height": 480, "position": [1, 2, 3], "rotation": {rotation},
                "fx": 500, "fy": 500{more}}}]"#
        )
    };
    let exact = "[[0, 0, 1], [-1, 0, 0], [0, -1, 0]]";
    let path = parse_json(camera(r#", "cx": 300, "cy": 200"#, exact).as_bytes()).unwrap();
    let i = path.cameras()[0].intrinsics();
    assert_eq!((i.cx, i.cy), (300.0, 200.0));
    // The farthest that three decimals are off in one product: 0.577 · 0.0005 · 3 · 2.
    let rounded = "[[0.577, 0.577, 0.577], [-0.707, 0.707, 0.0], [-0.408, -0.408, 0.816]]";
    assert!(parse_json(camera("", rounded).as_bytes()).is_ok());
    assert!(parse_json(camera("", &rounded.replace("0.816", "0.81")).as_bytes()).is_err());
    let path = parse_json(camera(r#", "k1": 0.1"#, exact).as_bytes()).unwrap();
    assert_eq!(path.facts().notes, ["fields not used: \"k1\""]);
}

#[test]
fn panoramas_are_told_from_perspective_paths() {
    let json = r#"{"camera_type": "equirectangular", "render_width": 64, "render_height": 32,
        "camera_path": [{"camera_to_world": [0,0,-1,1, -1,0,0,2, 0,1,0,3, 0,0,0,1]}]}"#;
    let path = parse_json(json.as_bytes()).unwrap();
    assert!(path.facts().is_panorama);
    assert!(path.cameras()[0].position().distance(CENTER) < 1e-9);
}

#[test]
fn settings_of_supersplat_are_a_camera_or_an_animation() {
    let still = r#"{"version": 2, "cameras": [{"initial": {"position": [-1, -2, 3], "target": [-2, -2, 3], "fov": 90}}],
        "animTracks": []}"#;
    let path = parse_json(still.as_bytes()).unwrap();
    let camera = path.cameras()[0];
    assert!(camera.position().distance(CENTER) < 1e-9);
    // Half a turn about z: what looks to −x there looks to +x here. 90° of the longer side.
    assert!(camera.world_from_view().matrix3.z_axis.distance(DVec3::X) < 1e-9);
    assert!((camera.intrinsics().fx - 960.0).abs() < 1e-9, "{camera:?}");
    assert!(path.facts().notes[0].contains("1920x1080"));
    let animated = r#"{"version": 2, "cameras": [], "animTracks": [{"duration": 2, "frameRate": 4, "loopMode": "repeat",
        "smoothness": 0, "keyframes": {"times": [0, 4], "values": {"position": [0, 0, 0, 4, 0, 0],
        "target": [0, 0, 9, 4, 0, 9], "fov": [60, 30]}}}]}"#;
    let path = parse_json(animated.as_bytes()).unwrap();
    assert_eq!((path.cameras().len(), path.frames_per_second(), path.is_cycle()), (8, 4.0, true));
    let x: Vec<f64> = path.cameras().iter().map(|camera| -camera.position().x).collect();
    // There and back again, eased at the keys.
    let eased = |t: f64| 4.0 * (3.0 * t * t - 2.0 * t * t * t);
    let expected = [0.0, eased(0.25), eased(0.5), eased(0.75), 4.0, eased(0.75), eased(0.5), eased(0.25)];
    assert!(x.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{x:?}");
    for (from, to, expected) in [
        ("\"duration\": 2", "\"duration\": 1e12", "duration: expected"),
        ("[0, 4]", "[4, 0]", "keyframes.times: expected ascending"),
        ("[60, 30]", "[60]", "keyframes.values.fov: expected 2 numbers"),
        ("[60, 30]", "[0, 0]", "frame 0 fov: expected degrees"),
        ("\"version\": 2", "\"version\": 3", "version: expected version 2"),
    ] {
        let fault = parse_json(animated.replace(from, to).as_bytes()).unwrap_err().to_string();
        assert!(fault.contains(expected), "{fault} should contain {expected}");
    }
}

#[test]
fn realityscan_tables() {
    let table = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2\n\
        f_10.jpg,1,2,3,90,90,0,28.125,0,0,0,0,0,0,0,0\nf_9.jpg,1,2,3,0,0,0,28.125,1.8,0,0.1,0,0,0,0,0\n";
    let path = parse_csv(table.as_bytes(), Size::new(640, 480)).unwrap();
    assert_eq!((path.name(0), path.name(1)), (Some("f_9.jpg"), Some("f_10.jpg")));
    // Heading east, level: right is south, forward east.
    assert_is_the_camera(&path, 1);
    // Not turned: looks straight down, north at the top.
    let down = path.cameras()[0];
    assert!(down.world_from_view().matrix3.z_axis.distance(DVec3::NEG_Z) < 1e-9);
    assert!(down.world_from_view().matrix3.y_axis.distance(DVec3::NEG_Y) < 1e-9);
    assert!((down.intrinsics().cx - 352.0).abs() < 1e-9);
    assert!(path.lens(0).is_some() && path.lens(1).is_none());
    for (from, to, expected) in [
        (",f,", ",g,", "line 1: expected a column f"),
        ("28.125,0", "x,0", "line 2 f: expected a number"),
        (",heading", "", "line 1: expected a column heading"),
    ] {
        let fault =
            parse_csv(table.replacen(from, to, 1).as_bytes(), Size::new(640, 480)).unwrap_err().to_string();
        assert!(fault.contains(expected), "{fault} should contain {expected}");
    }
}

#[test]
fn a_missing_file_is_named() {
    let message = load(Path::new("no/such/path.json")).unwrap_err().to_string();
    assert!(message.starts_with("no/such/path.json: cannot read"), "{message}");
}

#[test]
fn files_beyond_the_limit_are_refused_before_they_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("huge.json");
    // A file of holes: no bytes on disk, and none in memory.
    std::fs::File::create(&path).unwrap().set_len(MAX_JSON_BYTES + 1).unwrap();
    let message = load(&path).unwrap_err().to_string();
    assert!(message.contains("size: expected at most 67108864 bytes, found 67108865"), "{message}");
    std::fs::write(&path, [0; 8]).unwrap();
    assert_eq!(read(&path, 8).unwrap(), [0; 8]);
    assert!(read(&path, 7).is_err());
}

#[test]
#[cfg(unix)]
fn pipes_are_read_to_their_end_or_the_limit_and_devices_are_not() {
    let message = load(Path::new("/dev/zero")).unwrap_err().to_string();
    assert_eq!(message, "/dev/zero: path: expected a regular file or a pipe, found something else");

    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let write = |bytes: Vec<u8>| {
        let pipe = pipe.clone();
        std::thread::spawn(move || std::fs::write(pipe, bytes))
    };
    let json = format!(r#"{{"camera_angle_x": 1, "frames": [{{"transform_matrix": {OPENGL}}}]}}"#);
    let writer = write(json.into_bytes());
    assert_eq!(load(&pipe).unwrap().cameras().len(), 1);
    writer.join().unwrap().unwrap();
    // A writer of more bytes than the limit finds the pipe closed.
    let writer = write(vec![0; 1 << 20]);
    let message = read(&pipe, 1000).unwrap_err().to_string();
    assert!(message.contains("size: expected at most 1000 bytes, found more"), "{message}");
    assert_eq!(writer.join().unwrap().unwrap_err().kind(), std::io::ErrorKind::BrokenPipe);
}

#[test]
fn shared_paths() {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/paths"));
    let Ok(entries) = std::fs::read_dir(folder) else {
        eprintln!("skipped: {} is absent", folder.display());
        return;
    };
    for entry in entries {
        let path = load(entry.unwrap().path()).unwrap();
        assert_eq!(path.cameras().len(), 300);
        assert_eq!((path.frames_per_second(), path.is_cycle()), (30.0, true));
        assert!(path.cameras().iter().all(|c| (c.width(), c.height()) == (4096, 2160)));
    }
}

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        let _ = parse_json(&bytes);
        let folder = of_colmap::colmap_model(1, true);
        std::fs::write(folder.path().join("images.bin"), &bytes).unwrap();
        let _ = load(folder.path());
    }

    #[test]
    fn damaged_json_never_panics(position in 0_usize..300, byte in any::<u8>()) {
        let json = format!(r#"{{"fl_x": 500, "w": 640, "h": 480, "frames": [{{"transform_matrix": {OPENGL}}}]}}"#);
        let mut bytes = json.into_bytes();
        let position = position % bytes.len();
        bytes[position] = byte;
        let _ = parse_json(&bytes);
    }
}
