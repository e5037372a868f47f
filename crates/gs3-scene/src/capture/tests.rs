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
    // As the Blender add-on writes it: the aspect is not the images' aspect.
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

/// A COLMAP model of text with this line for its camera.
fn colmap_text(camera: &str) -> Result<CameraPath, CaptureFault> {
    let q = glam::DQuat::from_mat3(&expected_rotation().transpose());
    let t = -(expected_rotation().transpose() * CENTER);
    let images = format!("1 {} {} {} {} {} {} {} 7 a.jpg\n\n", q.w, q.x, q.y, q.z, t.x, t.y, t.z);
    parse_colmap(ColmapEncoding::Text, camera.as_bytes(), images.as_bytes())
}

#[test]
fn colmap_lenses_are_pinholes_for_a_path_and_told() {
    for (camera, has_lens) in [
        ("7 SIMPLE_RADIAL 640 480 500 320 240 0", false),
        ("7 SIMPLE_RADIAL 640 480 500 320 240 0.1", true),
        ("7 RADIAL 640 480 500 320 240 0 0", false),
        ("7 OPENCV 640 480 500 500 320 240 0 0 0 0", false),
        ("7 OPENCV 640 480 500 500 320 240 -0.1 0.02 0.001 0", true),
        ("7 FULL_OPENCV 640 480 500 500 320 240 0 0 0 0 0 0 0 1e-3", true),
        ("7 FOV 640 480 500 500 320 240 0.5", true),
        ("7 OPENCV_FISHEYE 640 480 500 500 320 240 0 0 0 0", true),
        ("7 SIMPLE_RADIAL_FISHEYE 640 480 500 320 240 0", true),
        ("7 RADIAL_FISHEYE 640 480 500 320 240 0 0", true),
        ("7 THIN_PRISM_FISHEYE 640 480 500 500 320 240 0 0 0 0 0 0 0 0", true),
        ("7 RAD_TAN_THIN_PRISM_FISHEYE 640 480 500 500 320 240 0 0 0 0 0 0 0 0 0 0 0 0", true),
    ] {
        let path = colmap_text(camera).unwrap();
        assert_is_the_camera(&path, 0);
        assert_eq!(path.lens(0).is_some(), has_lens, "{camera}");
        assert_eq!(path.facts().notes.len(), usize::from(has_lens), "{camera}: {:?}", path.facts().notes);
    }
    let fault = colmap_text("7 MIRROR 640 480 500").unwrap_err().to_string();
    assert!(fault.contains("camera 7") && fault.contains("MIRROR") && fault.contains("undistort"), "{fault}");
}

#[test]
fn cameras_that_no_image_uses_do_not_matter() {
    let cameras = "7 PINHOLE 640 480 500 500 320 240\n8 OPENCV 640 480 nan nan\n9 MIRROR\n";
    assert_is_the_camera(&colmap_text(cameras).unwrap(), 0);
    let fault = colmap_text("7 PINHOLE 640 480 nan 500 320 240").unwrap_err().to_string();
    assert!(fault.contains("line 1") && fault.contains("fx"), "{fault}");
}

/// Text models of programs that write no line of points.
#[test]
fn every_line_of_images_is_one_where_none_is_followed_by_points() {
    let cameras = b"7 PINHOLE 640 480 500 500 320 240";
    let image = |i: usize, name: &str| format!("{i} 1 0 0 0 0 0 {i} 7 {name}\n");
    let names = |images: String| {
        let path = parse_colmap(ColmapEncoding::Text, cameras, images.as_bytes())?;
        Ok::<_, CaptureFault>(
            (0..path.cameras().len()).map(|i| path.name(i).unwrap().to_owned()).collect::<Vec<_>>(),
        )
    };
    let one_each = (1..=6).map(|i| image(i, &format!("{i}.jpg"))).collect();
    assert_eq!(names(one_each).unwrap(), ["1.jpg", "2.jpg", "3.jpg", "4.jpg", "5.jpg", "6.jpg"]);
    // With points, with an empty line, with comments, with a name that is a number.
    let mixed = [
        image(1, "10"),
        "1 2 3 4 5 -1\n".into(),
        image(2, "b  c.jpg"),
        "\n".into(),
        "# x\n".into(),
        image(3, "9"),
    ];
    assert_eq!(names(mixed.concat()).unwrap(), ["9", "10", "b  c.jpg"]);
    let broken = [image(1, "a.jpg"), "1 2 x\n".into()].concat();
    let fault = names(broken).unwrap_err().to_string();
    assert!(fault.contains("line 2"), "{fault}");
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
fn distortion_in_transforms_is_a_lens() {
    let json = |more: &str| {
        format!(
            r#"{{"fl_x": 500, "w": 640, "h": 480, {more}, "frames": [{{"transform_matrix": {OPENGL}}}]}}"#
        )
    };
    let path = parse_json(json(r#""k1": -0.1, "p2": 0.01, "camera_model": "OPENCV""#).as_bytes()).unwrap();
    assert_is_the_camera(&path, 0);
    assert_eq!(path.lens(0), Some(&Lens::brown(-0.1, 0.0, 0.0, 0.01, 0.0)));
    assert!(path.facts().notes[0].contains("1 of 1 cameras"), "{:?}", path.facts().notes);
    for fisheye in [r#""camera_model": "OPENCV_FISHEYE""#, r#""is_fisheye": 1"#] {
        let path = parse_json(json(fisheye).as_bytes()).unwrap();
        assert!(matches!(path.lens(0), Some(Lens::Fisheye { .. })), "{fisheye}");
    }
    // An unknown member is reported once, by name; a false or 0 value is ignored.
    let path = parse_json(json(r#""rolling_shutter_time": 0.01, "is_hdr": false"#).as_bytes()).unwrap();
    assert_eq!(path.facts().notes, ["fields not used: \"rolling_shutter_time\""]);
}

#[test]
fn frames_of_transforms_come_in_the_order_of_their_names() {
    let frame = |name: &str| format!(r#"{{"file_path": "{name}", "transform_matrix": {OPENGL}}}"#);
    let names = |frames: [&str; 3]| {
        let frames = frames.map(frame).join(",");
        let json = format!(r#"{{"fl_x": 500, "w": 640, "h": 480, "frames": [{frames}]}}"#);
        let path = parse_json(json.as_bytes()).unwrap();
        [0, 1, 2].map(|i| path.name(i).unwrap_or_default().to_owned())
    };
    assert_eq!(names(["f_10.jpg", "f_9.jpg", "f_1.jpg"]), ["f_1.jpg", "f_9.jpg", "f_10.jpg"]);
    // Without a name for each, the file's order stays.
    assert_eq!(names(["f_10.jpg", "", "f_1.jpg"]), ["f_10.jpg", "", "f_1.jpg"]);
}

/// A picture of one colour.
fn picture(width: u32, height: u32) -> Vec<u8> {
    let mut png = Vec::new();
    let mut encoder = png::Encoder::new(&mut png, width, height);
    encoder.set_color(png::ColorType::Grayscale);
    let pixels = vec![0; (width * height) as usize];
    encoder.write_header().unwrap().write_image_data(&pixels).unwrap();
    png
}

#[test]
fn sizes_that_are_not_stated_are_those_of_the_pictures() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("images")).unwrap();
    std::fs::write(folder.path().join("images/a.png"), picture(640, 480)).unwrap();
    let file = folder.path().join("transforms.json");
    let frames = format!(r#""frames": [{{"file_path": "./images/a", "transform_matrix": {OPENGL}}}]"#);
    let angle = 2.0 * (320.0_f64 / 500.0).atan();
    for intrinsics in ["\"fl_x\": 500".to_owned(), format!("\"camera_angle_x\": {angle}")] {
        std::fs::write(&file, format!("{{{intrinsics}, {frames}}}")).unwrap();
        let path = load(&file).unwrap();
        assert_is_the_camera(&path, 0);
        assert!(path.facts().notes.is_empty(), "{:?}", path.facts().notes);
    }
    // Without pictures only an angle is known: a size is assumed and reported, and other sizes keep the angle.
    std::fs::remove_file(folder.path().join("images/a.png")).unwrap();
    let path = load(&file).unwrap();
    assert_eq!((path.cameras()[0].width(), path.facts().notes.len()), (800, 1));
    assert_is_the_camera(&path.resized(640, 480).unwrap(), 0);
    // Names do not lead out of the folder.
    std::fs::write(folder.path().join("b.png"), picture(4, 4)).unwrap();
    let inner = folder.path().join("images/transforms.json");
    let outside = r#"{"fl_x": 500, "frames": [{"file_path": "../b.png", "transform_matrix": []}]}"#;
    std::fs::write(&inner, outside).unwrap();
    assert!(load(&inner).unwrap_err().to_string().contains("the picture itself"));
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

/// A trained splat's frame: turned by a quarter about z, moved and scaled.
const DATAPARSER: &str = r#"{"transform": [[0, -1, 0, 1], [1, 0, 0, 0], [0, 0, 1, 0]], "scale": 0.5}"#;

#[test]
fn cameras_are_brought_into_the_frame_of_a_dataparser() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("dataparser_transforms.json", DATAPARSER);
    let frames = format!(r#""frames": [{{"file_path": "a.jpg", "transform_matrix": {OPENGL}}}]"#);
    write("transforms.json", &format!(r#"{{"fl_x": 500, "w": 640, "h": 480, {frames}}}"#));
    let path = load(folder.path().join("transforms.json")).unwrap();
    let camera = path.cameras()[0];
    // (1, 2, 3) turned is (−2, 1, 3), moved (−1, 1, 3).
    assert!(camera.position().distance(DVec3::new(-0.5, 0.5, 1.5)) < 1e-9, "{camera:?}");
    let forward = camera.world_from_view().matrix3.z_axis;
    assert!(forward.distance(DVec3::Y) < 1e-9, "{forward}");
    assert!(path.facts().notes[0].contains("dataparser_transforms.json"), "{:?}", path.facts().notes);
    // What `ns-export cameras` writes is there already, and takes its intrinsics from beside it.
    write("transforms_train.json", &format!(r#"[{{"file_path": "a.jpg", "transform": {OPENGL}}}]"#));
    let exported = load(folder.path().join("transforms_train.json")).unwrap();
    assert_is_the_camera(&exported, 0);
    std::fs::remove_file(folder.path().join("transforms.json")).unwrap();
    let fault = load(folder.path().join("transforms_train.json")).unwrap_err().to_string();
    assert!(fault.contains("ns-export cameras") && fault.contains("--fov"), "{fault}");
    let options = CaptureOptions {
        size: Some((640, 480)),
        fov_y: Some(2.0 * (240.0_f64 / 500.0).atan()),
        dataparser: None,
    };
    assert_is_the_camera(&load_with(folder.path().join("transforms_train.json"), &options).unwrap(), 0);
    write("dataparser_transforms.json", &DATAPARSER.replace("0.5", "0"));
    write("transforms.json", &format!(r#"{{"fl_x": 500, "w": 640, "h": 480, {frames}}}"#));
    let fault = load(folder.path().join("transforms.json")).unwrap_err().to_string();
    assert!(fault.contains("dataparser_transforms.json: scale: expected a positive number"), "{fault}");
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
    let path = parse_csv(table.as_bytes(), (640, 480)).unwrap();
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
        let fault = parse_csv(table.replacen(from, to, 1).as_bytes(), (640, 480)).unwrap_err().to_string();
        assert!(fault.contains(expected), "{fault} should contain {expected}");
    }
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
