//! Models of COLMAP, binary ones and of text.

use super::*;

/// A COLMAP model of one camera and two images, the second before the first by name.
pub(super) fn colmap_model(model: u32, binary: bool) -> tempfile::TempDir {
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
        let folder = colmap_model(1, binary);
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
    let folder = colmap_model(1, true);
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
    let folder = colmap_model(1, true);
    let file = folder.path().join("images.bin");
    let mut bytes = std::fs::read(&file).unwrap();
    bytes[..8].copy_from_slice(&u64::MAX.to_le_bytes());
    std::fs::write(&file, &bytes).unwrap();
    let error = load(folder.path()).unwrap_err();
    assert!(matches!(error.fault, CaptureFault::Truncated { .. }), "{error}");
}

#[test]
fn a_camera_beyond_all_numbers_is_an_error() {
    // Turned by 45°, both coordinates add up to more than the largest number.
    let images = b"1 0.92388 0 0 0.38268 1.7e308 1.7e308 0 1 a.jpg\n\n";
    let fault = parse_colmap(ColmapEncoding::Text, b"1 SIMPLE_PINHOLE 4 4 1 2 2", images).unwrap_err();
    assert!(fault.to_string().starts_with("line 1: camera position: expected finite values"), "{fault}");
}
