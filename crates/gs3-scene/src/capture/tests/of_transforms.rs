//! `transforms.json` of nerfstudio and of others.

use super::*;

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
        size: Some(Size::new(640, 480)),
        fov_y: Some(2.0 * (240.0_f64 / 500.0).atan()),
        dataparser: None,
    };
    assert_is_the_camera(&load_with(folder.path().join("transforms_train.json"), &options).unwrap(), 0);
    write("dataparser_transforms.json", &DATAPARSER.replace("0.5", "0"));
    write("transforms.json", &format!(r#"{{"fl_x": 500, "w": 640, "h": 480, {frames}}}"#));
    let fault = load(folder.path().join("transforms.json")).unwrap_err().to_string();
    assert!(fault.contains("dataparser_transforms.json: scale: expected a positive number"), "{fault}");
}
