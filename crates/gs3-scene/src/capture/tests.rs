//! One pose written in every format has to come back as the same camera; everything else has to be an error.

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
fn transforms_with_global_and_own_intrinsics() {
    let json = format!(
        r#"{{"fl_x": 500, "fl_y": 500.0, "w": 640.0, "h": 480, "k1": 0.0, "frames": [
            {{"file_path": "images/a.png", "transform_matrix": {OPENGL}}},
            {{"file_path": "images/b.png", "transform_matrix": {OPENGL}, "fl_x": 700, "cx": 10}}]}}"#
    );
    let path = parse_json(json.as_bytes()).unwrap();
    assert_is_the_camera(&path, 0);
    assert_eq!(path.name(0), Some("images/a.png"));
    let own = path.cameras()[1].intrinsics();
    assert_eq!((own.fx, own.fy, own.cx, own.cy), (700.0, 500.0, 10.0, 240.0));
}

#[test]
fn transforms_with_an_angle() {
    let angle = 2.0 * (320.0_f64 / 500.0).atan();
    let json = format!(
        r#"{{"camera_angle_x": {angle}, "w": 640, "h": 480, "frames": [{{"transform_matrix": {OPENGL}}}]}}"#
    );
    assert_is_the_camera(&parse_json(json.as_bytes()).unwrap(), 0);
}

#[test]
fn synthetic_scenes_state_an_angle_alone() {
    let json = format!(r#"{{"camera_angle_x": 0.7, "frames": [{{"transform_matrix": {OPENGL}}}]}}"#);
    let camera = parse_json(json.as_bytes()).unwrap().cameras()[0];
    assert_eq!((camera.width(), camera.height()), (800, 800));
}

#[test]
fn a_byte_order_mark_and_a_model_without_distortion_make_no_difference() {
    let json = format!(
        "\u{feff}{{\"camera_model\": \"OPENCV\", \"k1\": 0, \"is_fisheye\": false, \"ftheta_p0\": 0.0, \
         \"fl_x\": 500, \"w\": 640, \"h\": 480, \"frames\": [{{\"transform_matrix\": {OPENGL}}}]}}"
    );
    assert_is_the_camera(&parse_json(json.as_bytes()).unwrap(), 0);
}

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
    // As the Blender add-on writes it: the aspect is not that of the images.
    assert_is_the_camera(&path, 0);
    assert_is_the_camera(&path, 1);
    assert_eq!((path.frames_per_second(), path.is_cycle(), path.name(0)), (24.0, true, None));
}

/// A COLMAP model of one camera and two images, the second before the first by name.
fn colmap(model: u32, binary: bool) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let q = glam::DQuat::from_mat3(&expected_rotation().transpose());
    let t = -(expected_rotation().transpose() * CENTER);
    if binary {
        let mut cameras = 1_u64.to_le_bytes().to_vec();
        cameras.extend([7_u32, model].iter().flat_map(|v| v.to_le_bytes()));
        cameras.extend([640_u64, 480].iter().flat_map(|v| v.to_le_bytes()));
        cameras.extend([500.0_f64, 500.0, 320.0, 240.0].iter().flat_map(|v| v.to_le_bytes()));
        std::fs::write(folder.path().join("cameras.bin"), cameras).unwrap();
        let mut images = 2_u64.to_le_bytes().to_vec();
        for name in ["f10.jpg", "f9.jpg"] {
            images.extend(3_u32.to_le_bytes());
            images.extend([q.w, q.x, q.y, q.z, t.x, t.y, t.z].iter().flat_map(|v| v.to_le_bytes()));
            images.extend(7_u32.to_le_bytes());
            images.extend(name.bytes().chain([0]));
            images.extend(2_u64.to_le_bytes());
            images.extend([0; 48]);
        }
        std::fs::write(folder.path().join("images.bin"), images).unwrap();
    } else {
        let model = MODELS_FOR_TESTS[model as usize];
        let cameras = format!("# a comment\n7 {model} 640 480 500 500 320 240\n");
        std::fs::write(folder.path().join("cameras.txt"), cameras).unwrap();
        let pose = format!("{} {} {} {} {} {} {}", q.w, q.x, q.y, q.z, t.x, t.y, t.z);
        let images = format!("# a comment\n1 {pose} 7 f10.jpg\n\n2 {pose} 7 f9.jpg\n1.0 2.0 -1 3.0 4.0 5\n");
        std::fs::write(folder.path().join("images.txt"), images).unwrap();
    }
    folder
}

const MODELS_FOR_TESTS: [&str; 5] = ["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"];

#[test]
fn colmap_models() {
    for binary in [true, false] {
        let folder = colmap(1, binary);
        let path = load(folder.path()).unwrap();
        assert_is_the_camera(&path, 0);
        assert_is_the_camera(&path, 1);
        assert_eq!((path.name(0), path.name(1)), (Some("f9.jpg"), Some("f10.jpg")));
    }
}

#[test]
fn colmap_distortion_is_refused_and_named() {
    for binary in [true, false] {
        let folder = colmap(4, binary);
        let message = load(folder.path()).unwrap_err().to_string();
        assert!(message.contains("OPENCV") && message.contains("undistort"), "{message}");
    }
}

#[test]
fn every_truncation_of_a_binary_model_is_an_error() {
    let folder = colmap(1, true);
    for name in ["cameras.bin", "images.bin"] {
        let file = folder.path().join(name);
        let whole = std::fs::read(&file).unwrap();
        for length in 0..whole.len() {
            std::fs::write(&file, &whole[..length]).unwrap();
            let error = load(folder.path()).unwrap_err();
            assert!(error.to_string().contains(name), "{error}");
        }
        std::fs::write(&file, whole).unwrap();
    }
}

#[test]
fn an_untrusted_count_allocates_nothing() {
    let folder = colmap(1, true);
    let file = folder.path().join("images.bin");
    let mut bytes = std::fs::read(&file).unwrap();
    bytes[..8].copy_from_slice(&u64::MAX.to_le_bytes());
    std::fs::write(&file, &bytes).unwrap();
    let error = load(folder.path()).unwrap_err();
    assert!(matches!(error.fault, CaptureFault::Truncated { .. }), "{error}");
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
        (r#"{"frames": [{"k2": 0.1}]}"#, "frames[0].k2: expected PINHOLE"),
        (r#"{"frames": [{"w": -3}]}"#, "frames[0].w: expected a positive whole number of pixels, found -3"),
        (r#"{"frames": [{"w": 1e300}]}"#, "frames[0].w: expected a positive whole number of pixels"),
        (r#"{"frames": [{"fl_x": 5}]}"#, "w: expected the image size in pixels, found nothing"),
        (
            r#"{"camera_angle_x": 1, "w": 5, "frames": [{}]}"#,
            "h: expected the image size in pixels, found nothing",
        ),
        (
            r#"{"camera_model": "OPENCV_FISHEYE", "frames": [{}]}"#,
            "camera_model: expected PINHOLE or SIMPLE_PINHOLE, found \"OPENCV_FISHEYE\"; run undistortion",
        ),
        (
            r#"{"is_fisheye": true, "frames": [{}]}"#,
            "is_fisheye: expected PINHOLE or SIMPLE_PINHOLE, found another lens (true); run undistortion",
        ),
        (r#"{"frames": [{"is_fisheye": "yes"}]}"#, "frames[0].is_fisheye: expected PINHOLE"),
        (r#"{"latlong": {}, "frames": [{}]}"#, "latlong: expected PINHOLE"),
        (r#"{"frames": [{"ftheta_p0": 0, "ftheta_p1": 0.1}]}"#, "frames[0].ftheta_p1: expected PINHOLE"),
        (r#"{"k6": 0.1, "frames": [{}]}"#, "k6: expected PINHOLE"),
        (r#"[{"width": 4}]"#, "[0].height: expected the image size in pixels, found nothing"),
        (
            r#"{"camera_path": 3, "render_height": 3, "render_width": 4}"#,
            "camera_path: expected an array, found 3",
        ),
        (r#"{"camera_type": "fisheye", "camera_path": []}"#, "camera_type: expected \"perspective\""),
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
fn a_camera_beyond_all_numbers_is_an_error() {
    // Turned by 45°, both coordinates add up to more than the largest number.
    let images = b"1 0.92388 0 0 0.38268 1.7e308 1.7e308 0 1 a.jpg\n\n";
    let fault = parse_colmap(ColmapEncoding::Text, b"1 SIMPLE_PINHOLE 4 4 1 2 2", images).unwrap_err();
    assert!(fault.to_string().starts_with("line 1: camera position: expected finite values"), "{fault}");
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
    // Whoever writes more than the limit finds the pipe closed.
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
        let folder = colmap(1, true);
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
