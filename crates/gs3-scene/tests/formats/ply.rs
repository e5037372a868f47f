//! PLY of both kinds.

use gs3_scene::OpacityMode;

use crate::handmade::{compressed_ply, ply_odd, ply_text};
use crate::{assert_close, assert_error, load_bytes};

#[test]
fn any_order_and_type_of_properties_and_other_elements() {
    let scene = load_bytes("odd.ply", &ply_odd()).unwrap();
    let gaussians = scene.gaussians();
    assert_eq!((gaussians.len(), gaussians.sh_degree), (2, 1));
    assert_eq!(scene.opacity_mode(), OpacityMode::Antialiased);
    assert_eq!(gaussians.mean(0), [1.0, 2.0, 3.0]);
    assert_eq!(gaussians.mean(1), [-1.0, -2.0, -3.0]);
    assert_close(&gaussians.scale(0), &[(-1f32).exp(), 1.0, 1f32.exp()], 1e-6);
    assert_eq!(gaussians.rotation(0), [1.0, 0.0, 0.0, 0.0]);
    assert_close(&gaussians.opacities, &[0.880_797, 0.119_203], 1e-6);
    // f_rest is channel-major: coefficients 1, 2, 3 of red are 0, 1, 2, of green 3, 4, 5, of blue 6, 7, 8.
    assert_eq!(gaussians.sh_of(1), [0.1, 0.2, 0.3, 0.0, 3.0, 6.0, 1.0, 4.0, 7.0, 2.0, 5.0, 8.0]);
}

#[test]
fn text() {
    let scene = load_bytes("text.ply", &ply_text()).unwrap();
    assert_eq!(scene.gaussians().mean(0), [1.0, -2.5, 30.0]);
    assert_eq!(scene.gaussians().opacities, [0.5]);
    assert_close(&scene.gaussians().scale(0), &[(-1f32).exp(), 1.0, 1f32.exp()], 1e-6);
    assert_eq!(scene.gaussians().sh, [0.1, 0.2, 0.3]);
}

#[test]
fn compressed() {
    let scene = load_bytes("c.ply", &compressed_ply()).unwrap();
    let gaussians = scene.gaussians();
    assert_eq!((gaussians.len(), gaussians.sh_degree), (3, 1));
    assert_eq!(gaussians.mean(0), [-1.0, -2.0, -3.0]);
    assert_eq!(gaussians.mean(1), [1.0, 2.0, 3.0]);
    assert_eq!(gaussians.mean(2), [1.0, -2.0, -3.0]);
    assert_close(&gaussians.scale(0), &[1.0, (-4f32).exp(), (-4f32).exp()], 1e-6);
    assert_close(&gaussians.scale(1), &[1.0, 1.0, 1.0], 1e-6);
    assert_close(&gaussians.rotation(0), &[1.0, 0.0, 0.0, 0.0], 2e-3);
    assert_close(&gaussians.rotation(1), &[0.0, 0.0, 0.0, 1.0], 2e-3);
    let half = std::f32::consts::FRAC_1_SQRT_2;
    assert_close(&gaussians.rotation(2), &[half, half, 0.0, 0.0], 2e-3);
    assert_close(&gaussians.opacities, &[128.0 / 255.0, 1.0, 0.0], 1e-6);
    // Colours 0, 0.5 and 0.25 as coefficients (c − ½) / 0.2820948.
    assert_close(&gaussians.sh_of(0)[..3], &[-1.772_453_9, 0.0, -0.886_226_9], 1e-5);
    assert_eq!(gaussians.sh_of(0)[3..], [-4.0; 9]);
    assert_eq!(gaussians.sh_of(1)[3..], [4.0; 9]);
    let code = |code: f32| ((code + 0.5) / 256.0 - 0.5) * 8.0;
    let expected =
        [-4.0, code(3.0), code(6.0), code(1.0), code(127.0), code(7.0), code(2.0), code(128.0), code(8.0)];
    assert_close(&gaussians.sh_of(2)[3..], &expected, 1e-6);
}

#[test]
fn errors_name_file_field_expected_and_actual() {
    let header =
        |body: &str| format!("ply\nformat binary_little_endian 1.0\n{body}end_header\n").into_bytes();
    let surfels = "element vertex 1\nproperty float x\nproperty float y\nproperty float z\nproperty float scale_0\n\
                   property float scale_1\n";
    assert_error(load_bytes("2d.ply", &header(surfels)), &["2d.ply", "scale_2", "three", "2D"]);
    let points = header("element vertex 1\nproperty float x\nproperty float y\nproperty float z\n");
    assert_error(load_bytes("points.ply", &points), &["points.ply", "a point cloud", "x, y, z"]);
    assert_error(load_bytes("mesh.ply", &header("element face 1\n")), &["mesh.ply", "vertex", "none"]);
    assert_error(load_bytes("x.ply", &header("element vertex -1\n")), &["x.ply", "vertex", "number", "-1"]);
    assert_error(load_bytes("x.ply", &header("bad line\n")), &["x.ply", "header", "\"bad line\""]);
    let file = ply_odd();
    assert_error(load_bytes("cut.ply", &file[..file.len() - 40]), &["cut.ply", "vertex", "bytes"]);
    assert_error(load_bytes("cut.ply", b"ply\nformat"), &["cut.ply", "end_header"]);
    let text = ply_text();
    assert_error(load_bytes("cut.ply", &text[..text.len() - 6]), &["cut.ply", "vertex"]);
    let huge = String::from_utf8(text.clone()).unwrap().replace("vertex 1", "vertex 18446744073709551615");
    assert_error(load_bytes("huge.ply", huge.as_bytes()), &["huge.ply", "vertex", "bytes"]);
    let huge = String::from_utf8(text).unwrap().replace("vertex 1", "vertex 18446744073709551615");
    let huge = huge.replace("ascii", "binary_little_endian");
    assert_error(load_bytes("huge.ply", huge.as_bytes()), &["huge.ply", "vertex", "bytes"]);
}

#[test]
fn an_empty_scene_and_one_of_invalid_gaussians_are_errors() {
    let text = String::from_utf8(ply_text()).unwrap();
    let empty = text.replace("vertex 1", "vertex 0");
    assert_error(load_bytes("empty.ply", empty.as_bytes()), &["empty.ply", "no valid Gaussian"]);
    let invalid = text.replace("1 -2.5 3e1", "nan inf 0");
    assert_error(load_bytes("nan.ply", invalid.as_bytes()), &["nan.ply", "1 dropped"]);
}

#[test]
fn invalid_gaussians_are_dropped_and_counted() {
    let text = String::from_utf8(ply_text()).unwrap().replace("vertex 1", "vertex 4");
    // An infinite scale, a zero quaternion, an infinite logit (opaque, valid).
    let more = "1 1 1 0 0 0 0 1000 0 0 1 0 0 0\n1 1 1 0 0 0 0 0 0 0 0 0 0 0\n7 1 1 0 0 0 inf 0 0 0 1 0 0 0\n";
    let scene = load_bytes("mixed.ply", (text + more).as_bytes()).unwrap();
    assert_eq!(scene.gaussians().len(), 2);
    assert_eq!(scene.gaussians().mean(1), [7.0, 1.0, 1.0]);
    assert_eq!(scene.gaussians().opacities[1], 1.0);
    assert_eq!((scene.dropped().invalid_scale, scene.dropped().invalid_rotation), (1, 1));
    assert_eq!(scene.dropped().total(), 2);
}
