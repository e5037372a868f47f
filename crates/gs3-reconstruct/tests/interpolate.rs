//! Frame interpolation at the true middle pose.
#![allow(clippy::unwrap_used, reason = "test code outside of test functions")]

mod common;

use common::{Sheet, World, camera, psnr, wall_and_post};
use gs3_reconstruct::{Interpolator, Neighbor, ReconstructError};
use gs3_scene::{Camera, GBuffer, Image};
use proptest::prelude::*;

struct Frame {
    camera: Camera,
    image: Image,
    gbuffer: GBuffer,
}

impl Frame {
    /// The exact HR frame and its LR frame.
    fn of(world: &World, camera: Camera, scale: u32, jitter: [f32; 2]) -> Self {
        let gbuffer = world.gbuffer(&camera.low_resolution(scale), jitter);
        Self { camera, image: world.native(&camera), gbuffer }
    }

    fn neighbor(&self) -> Neighbor<'_> {
        Neighbor { camera: &self.camera, image: &self.image, gbuffer: &self.gbuffer }
    }
}

fn pose(x: f64) -> Camera {
    camera(240, 136, [x, 0.0, 0.0], 0.0, 0.0)
}

fn between(world: &World, x: [f64; 2], t: f32) -> (Image, Image) {
    let [before, after] =
        [(x[0], [0.1, -0.2]), (x[1], [-0.3, 0.2])].map(|(x, jitter)| Frame::of(world, pose(x), 4, jitter));
    let middle = pose(x[0] + (x[1] - x[0]) * f64::from(t));
    let mut out = Image::default();
    let mut interpolator = Interpolator::new(4).unwrap();
    interpolator.interpolate(before.neighbor(), after.neighbor(), t, &middle, &mut out).unwrap();
    (out, world.native(&middle))
}

#[test]
fn a_moving_wall_is_where_it_should_be() {
    let world = World { sheets: vec![Sheet::endless(6.0, 3, 40.0)] };
    for t in [0.25, 0.5, 0.8] {
        let (out, native) = between(&world, [0.0, 0.3], t);
        let (repeated, _) = between(&world, [0.0, 0.3], 0.0);
        let (moved, repeated) = (psnr(&out, &native), psnr(&repeated, &native));
        assert!(moved > 38.0 && moved > repeated + 15.0, "t {t}: {moved:.2} dB, repeated {repeated:.2} dB");
    }
}

#[test]
fn the_ends_of_the_interval_are_the_neighbors() {
    let world = wall_and_post(40.0);
    for t in [0.0, 1.0] {
        let (out, native) = between(&world, [0.0, 0.2], t);
        assert!(psnr(&out, &native) > 70.0, "t {t}: {:.2} dB", psnr(&out, &native));
    }
}

#[test]
fn occlusion_and_holes_are_filled_from_the_neighbor_that_sees() {
    let world = wall_and_post(40.0);
    let (out, native) = between(&world, [0.0, 1.0], 0.5);
    // Each neighbour hides 10 columns of the wall beside the post that the middle frame shows. A blend with the post
    // there would be off by 0.1 in red. The silhouettes themselves are known to one LR pixel only.
    let silhouettes = [-0.25, 0.25].map(|x| {
        let (pixel, _) = pose(0.5).project([x, 0.0, 3.0].into());
        pixel.x
    });
    for x in 0..out.width() {
        if silhouettes.iter().any(|s| (x as f64 + 0.5 - s).abs() < 4.0) {
            continue;
        }
        let mean = |image: &Image| (0..136).map(|y| image.row(y)[x][0]).sum::<f32>() / 136.0;
        assert!((mean(&out) - mean(&native)).abs() < 0.04, "column {x}: {} {}", mean(&out), mean(&native));
    }
}

#[test]
fn the_result_does_not_depend_on_the_threads() {
    let world = wall_and_post(40.0);
    let images = [1, 2, 5].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| between(&world, [0.0, 0.25], 0.5).0)
    });
    assert!(images[1..].iter().all(|image| image == &images[0]));
}

#[test]
fn wrong_inputs_are_typed_errors() {
    let world = wall_and_post(40.0);
    let frame = Frame::of(&world, pose(0.0), 4, [0.0; 2]);
    let mut interpolator = Interpolator::new(4).unwrap();
    let mut out = Image::default();
    let n = frame.neighbor();
    let error = interpolator.interpolate(n, n, f32::NAN, &frame.camera, &mut out).unwrap_err();
    assert!(matches!(error, ReconstructError::Time { .. }));
    let small = camera(64, 36, [0.0; 3], 0.0, 0.0);
    let error = interpolator.interpolate(n, n, 0.5, &small, &mut out).unwrap_err();
    assert!(matches!(error, ReconstructError::Size { what: "neighbour camera", .. }));
    let bare = GBuffer { geometry: None, ..frame.gbuffer.clone() };
    let error = interpolator
        .interpolate(n, Neighbor { gbuffer: &bare, ..n }, 0.5, &frame.camera, &mut out)
        .unwrap_err();
    assert_eq!(error, ReconstructError::Missing { what: "depth" });
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn constants_stay_and_nothing_is_nan(
        width in 1_u32..50, height in 1_u32..50, scale in 1_u32..=8, seed in any::<u64>(), t in 0.0_f32..=1.0,
        step in prop::array::uniform3(-2.0_f64..2.0), yaw in -2.0_f64..2.0,
    ) {
        let frames = [0.0, 1.0].map(|k| {
            let camera = camera(width, height, step.map(|s| s * k), yaw * k, 0.0);
            let mut frame = Frame::of(&World { sheets: Vec::new() }, camera, scale, [0.4, -0.9]);
            frame.image.pixels_mut().fill([0.25, 0.5, 0.75, 1.0]);
            let depths = [0.0, 1e-30, 1e-7, 0.3, 1.0, 5.0, 1e6, 1e30];
            for (i, z) in frame.gbuffer.geometry.as_mut().unwrap().depth_median.data_mut().iter_mut().enumerate() {
                *z = depths[((seed >> (i % 61)) % 8) as usize];
            }
            frame
        });
        let middle = camera(width, height, step.map(|s| s * 0.5), yaw * 0.5, 0.0);
        let mut out = Image::default();
        let mut interpolator = Interpolator::new(scale).unwrap();
        interpolator.interpolate(frames[0].neighbor(), frames[1].neighbor(), t, &middle, &mut out).unwrap();
        for pixel in out.pixels() {
            for (value, expected) in pixel.iter().zip([0.25, 0.5, 0.75, 1.0]) {
                prop_assert!((value - expected).abs() < 1e-5, "{pixel:?}");
            }
        }
    }
}
