//! `gs3 evaluate --photos` as its users run it, on photos rendered from the built-in scene.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use gs3::raster::{Outputs, RasterSettings, Rasterizer};
use gs3::scene::{Camera, Image, demo};
use serde_json::{Value, json};

/// The demo scene's rendered image at `camera`.
fn render(camera: &Camera) -> Image {
    let mut image = Image::default();
    let mut rasterizer = Rasterizer::new(demo::scene().unwrap().into(), gs3::Culling::default());
    rasterizer.rasterize_image(camera, &RasterSettings::new(Outputs::Color), &mut image).unwrap();
    image
}

fn write_png(path: &Path, image: &Image) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let mut encoder =
        png::Encoder::new(fs::File::create(path).unwrap(), image.width() as u32, image.height() as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header().unwrap().write_image_data(&image.to_rgb8()).unwrap();
}

/// Writes three photos, the last at half the size of its camera's image, and a `transforms.json` that says the
/// photographer stood `shift` further to the right than the photos were taken.
fn photo_set(folder: &Path, shift: f64) {
    // Not divisible by the scale: what is left over is not judged.
    let path = demo::path().resized(162, 98).unwrap();
    let cameras: Vec<Camera> = [0, 20, 40].map(|i| path.cameras()[i]).to_vec();
    let mut frames = Vec::new();
    for (i, camera) in cameras.iter().enumerate() {
        let photo = if i == 2 { camera.resized(81, 49).unwrap() } else { *camera };
        write_png(&folder.join(format!("photos/view_{i}.png")), &render(&photo));
        let pose = camera.world_from_view();
        let (right, down, forward) = (pose.matrix3.x_axis, pose.matrix3.y_axis, pose.matrix3.z_axis);
        let center = pose.translation + right * shift;
        let row = |r: usize| json!([right[r], -down[r], -forward[r], center[r]]);
        let intrinsics = camera.intrinsics();
        frames.push(json!({
            "file_path": format!("./photos/view_{i}"),
            "transform_matrix": [row(0), row(1), row(2), [0, 0, 0, 1]],
            "w": intrinsics.width, "h": intrinsics.height, "fl_x": intrinsics.fx, "fl_y": intrinsics.fy,
            "cx": intrinsics.cx, "cy": intrinsics.cy,
        }));
    }
    fs::write(folder.join("transforms.json"), json!({ "frames": frames }).to_string()).unwrap();
}

fn evaluate(photos: &Path, out: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_gs3"))
        .args(["evaluate", "demo", "--photos"])
        .arg(photos)
        .arg("--out")
        .arg(out)
        .args(arguments)
        .output()
        .unwrap()
}

fn results(photos: &Path, arguments: &[&str]) -> Value {
    let out = photos.join("out");
    let output = evaluate(photos, &out, arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(fs::read_to_string(out.join("report.html")).unwrap().contains("view_0"));
    assert!(fs::read_to_string(out.join("table.md")).unwrap().contains("| native |"));
    serde_json::from_slice(&fs::read(out.join("results.json")).unwrap()).unwrap()
}

fn score(results: &Value, row: usize, metric: &str) -> f64 {
    results["results"][row][metric].as_f64().unwrap()
}

#[test]
fn photos_of_the_scene_itself_are_met_and_a_camera_beside_its_place_is_seen() {
    let folder = tempfile::tempdir().unwrap();
    photo_set(folder.path(), 0.0);
    let exact = results(folder.path(), &["--methods", "native"]);
    let images = exact["results"][0]["images"].as_array().unwrap();
    let sizes: Vec<_> = images.iter().map(|i| i["size"].clone()).collect();
    assert_eq!(sizes, [json!([162, 98]), json!([162, 98]), json!([81, 49])]);
    // Poses come back from JSON with rounding; a value may round to its neighbour of 256.
    assert!(images.iter().all(|i| i["psnr"].as_f64().unwrap() > 60.0), "{exact}");
    assert!(score(&exact, 0, "ssim") > 0.9999 && score(&exact, 0, "flip") < 1e-3, "{exact}");

    let both = results(folder.path(), &["--methods", "bicubic", "--every", "2"]);
    let images = both["results"][1]["images"].as_array().unwrap();
    assert_eq!((&images[0]["size"], &images[1]["size"]), (&json!([160, 96]), &json!([80, 48])));
    assert_eq!((both["protocol"]["judged"].as_u64(), images.len()), (Some(2), 2));
    assert!(score(&both, 0, "psnr") > 60.0 && score(&both, 1, "psnr") < 45.0, "{both}");
    // A shift of half a low-resolution pixel would cost far more than this.
    assert!(score(&both, 1, "psnr") > 18.0, "{both}");

    photo_set(folder.path(), 0.05);
    let shifted = results(folder.path(), &["--methods", "native"]);
    assert!(score(&shifted, 0, "psnr") < 40.0, "{shifted}");
    assert!(score(&shifted, 0, "ssim") < 0.99 && score(&shifted, 0, "flip") > 0.01, "{shifted}");
}

#[test]
fn photos_without_a_file_are_left_out_and_told() {
    let folder = tempfile::tempdir().unwrap();
    photo_set(folder.path(), 0.0);
    fs::remove_file(folder.path().join("photos/view_0.png")).unwrap();
    let out = folder.path().join("out");
    // Every second of those that are there: the first of them.
    let output = evaluate(folder.path(), &out, &["--methods", "native", "--every", "2"]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    assert_eq!(said, "1 of the capture's photos have no file and are left out, ./photos/view_0 the first\n");
    let results: Value = serde_json::from_slice(&fs::read(out.join("results.json")).unwrap()).unwrap();
    assert_eq!(results["protocol"]["missing"], json!(["./photos/view_0"]));
    let names: Vec<_> =
        results["results"][0]["images"].as_array().unwrap().iter().map(|i| i["name"].clone()).collect();
    assert_eq!(names, ["./photos/view_1"]);
    for file in ["table.md", "report.html"] {
        let text = fs::read_to_string(out.join(file)).unwrap();
        assert!(text.contains("./photos/view_0 of the capture has no file."), "{file}");
    }
}

#[test]
fn history_gathers_on_the_way_to_a_photo() {
    let folder = tempfile::tempdir().unwrap();
    photo_set(folder.path(), 0.0);
    let results = results(folder.path(), &["--methods", "bicubic,history"]);
    let row = |method: &str| {
        let rows = results["results"].as_array().unwrap();
        rows.iter().find(|row| row["method"] == method).unwrap().clone()
    };
    let [alone, way] = ["psnr", "after_way"].map(|key| {
        move |row: &Value| match key {
            "psnr" => row[key].as_f64().unwrap(),
            _ => row[key]["psnr"].as_f64().unwrap(),
        }
    });
    let (bicubic, history) = (row("bicubic"), row("history"));
    assert_eq!(alone(&bicubic), way(&bicubic), "nothing is carried over");
    // Sixteen frames know sixteen times as much.
    assert!(way(&history) > alone(&history) + 2.0, "{history}");
    for image in history["images"].as_array().unwrap() {
        assert!(way(image) > alone(image), "{image}");
    }
}

#[test]
fn bad_photo_sets_get_one_line_and_exit_code_2() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    photo_set(folder.path(), 0.0);
    let refused = |arguments: &[&str], message: &str| {
        let output = evaluate(folder.path(), &out, arguments);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert!(text.contains(message), "{text}");
        assert!(!out.exists());
    };
    refused(&["--methods", "analytic"], "without interpolation");
    refused(&["--path", "elsewhere.json"], "cannot be used with");
    // Some may be missing, but not all.
    refused(&["--images", "/nowhere"], "photo './photos/view_0': expected a file");
    let photo = folder.path().join("photos/view_1.png");
    write_png(&photo, &Image::new(162, 80));
    refused(&[], "found 162x80");
    fs::write(&photo, "no image").unwrap();
    refused(&[], "expected a PNG or JPEG image");
    fs::write(
        folder.path().join("transforms.json"),
        r#"{"frames": [{"transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0]],
        "w": 32, "h": 32, "fl_x": 30}]}"#,
    )
    .unwrap();
    refused(&[], "camera 0 of the capture: expected the name of its photo, found none");
}
