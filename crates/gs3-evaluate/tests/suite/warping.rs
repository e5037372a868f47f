//! The warping error on a plane with frames known in closed form.

use glam::{DAffine3, DQuat, DVec2, DVec3};
use gs3_evaluate::metrics::{MetricError, WarpFrame, warping_error};
use gs3_scene::{Camera, Image, Intrinsics, Planes, Size};

/// A smooth texture on the world plane z = 4, seen by `camera`.
fn render(camera: &Camera) -> (Image, Planes<1>) {
    let (width, height) = (camera.width() as usize, camera.height() as usize);
    let (mut image, mut depth) = (Image::new(width, height), Planes::new(width, height));
    for y in 0..height {
        for x in 0..width {
            let pixel = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            let direction = camera.unproject(pixel, 1.0) - camera.position();
            let point = camera.position() + direction * ((4.0 - camera.position().z) / direction.z);
            let colour =
                [point.x * 3.0, point.y * 2.0, point.x + point.y].map(|v| (0.5 + 0.3 * v.sin()) as f32);
            image.pixels_mut()[y * width + x] = [colour[0], colour[1], colour[2], 1.0];
            depth.data_mut()[y * width + x] = camera.project(point).1 as f32;
        }
    }
    (image, depth)
}

fn camera(x: f64, yaw: f64) -> Camera {
    let world_from_view =
        DAffine3::from_rotation_translation(DQuat::from_rotation_y(yaw), DVec3::new(x, 0.1 * x, 0.3 * x));
    Camera::new(world_from_view.inverse(), Intrinsics::from_fov_y(96, 64, 0.9)).unwrap()
}

struct Frame {
    camera: Camera,
    image: Image,
    depth: Planes<1>,
}

impl Frame {
    fn new(camera: Camera) -> Self {
        let (image, depth) = render(&camera);
        Self { camera, image, depth }
    }

    fn view(&self) -> WarpFrame<'_> {
        WarpFrame { image: &self.image, camera: &self.camera, depth: &self.depth }
    }
}

#[test]
fn exact_motion_of_a_plane_leaves_only_the_sampling_error() {
    let (first, mut second) = (Frame::new(camera(0.0, 0.0)), Frame::new(camera(0.21, 0.03)));
    let exact = warping_error([first.view(), second.view()]).unwrap().unwrap();
    // Bilinear error of the texture: h²/8 · |f''| = (0.058 world units per pixel)²/8 · 2.7, squared, two curved
    // channels.
    assert!(exact < 1e-5, "{exact}");

    for pixel in second.image.pixels_mut() {
        *pixel = pixel.map(|v| v + 0.05);
    }
    let brighter = warping_error([first.view(), second.view()]).unwrap().unwrap();
    assert!((brighter - 3.0 * 0.05 * 0.05).abs() < 2e-4, "{brighter}");

    // The frame of another pose does not follow the motion.
    second.image = render(&camera(0.31, 0.03)).0;
    let wrong = warping_error([first.view(), second.view()]).unwrap().unwrap();
    assert!(wrong > 100.0 * exact, "{wrong} against {exact}");
}

#[test]
fn pixels_that_leave_the_image_or_are_hidden_do_not_count() {
    let (mut first, mut second) = (Frame::new(camera(0.0, 0.0)), Frame::new(camera(0.21, 0.03)));
    let visible = warping_error([first.view(), second.view()]).unwrap();
    // Another colour where something nearer hides the plane changes nothing.
    for y in 0..64 {
        for x in 40..96 {
            second.image.pixels_mut()[y * 96 + x] = [1.0, 0.0, 1.0, 1.0];
            second.depth.data_mut()[y * 96 + x] *= 0.9;
        }
    }
    let hidden = warping_error([first.view(), second.view()]).unwrap().unwrap();
    assert!(hidden < 1e-5 && Some(hidden) != visible, "{hidden}");

    let away = Frame::new(camera(0.0, 0.0));
    let turned = Frame { camera: camera(0.0, 2.0), image: away.image.clone(), depth: away.depth.clone() };
    assert_eq!(warping_error([away.view(), turned.view()]), Ok(None));
    first.depth.data_mut().fill(f32::NAN);
    assert_eq!(warping_error([first.view(), second.view()]), Ok(None));
}

#[test]
fn a_depth_of_another_size_is_refused() {
    let (first, mut second) = (Frame::new(camera(0.0, 0.0)), Frame::new(camera(0.21, 0.03)));
    second.depth = Planes::new(48, 32);
    assert_eq!(
        warping_error([first.view(), second.view()]),
        Err(MetricError::Size { what: "depth", expected: Size::new(96, 64), actual: Size::new(48, 32) })
    );
}
