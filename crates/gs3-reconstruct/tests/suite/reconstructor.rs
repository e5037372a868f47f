//! The reconstructor: frames of any renderer, in any memory layout.

use crate::world::{World, camera};
use gs3_reconstruct::{
    DepthEncoding, GBufferView, PlanesView, ReconstructError, Reconstructor, ReconstructorSettings, Strides,
};
use gs3_scene::{GBuffer, Image};
use gs3_test_support::psnr;

#[test]
fn a_resting_camera_becomes_native_with_exact_derivatives_and_without() {
    let (world, now) = (World::default(), camera(0.0));
    let native = world.native(&now, 0.0);
    for has_derivatives in [true, false] {
        let mut reconstructor = Reconstructor::new(ReconstructorSettings::default()).unwrap();
        let mut quality = Vec::new();
        for _ in 0..16 {
            let buffers = world.render(&now, &now, reconstructor.next_jitter(&now), 0.0);
            let view = buffers.view();
            let gradients = view.gradients.filter(|_| has_derivatives);
            let shown = reconstructor.reconstruct(&now, &GBufferView { gradients, ..view }).unwrap();
            quality.push(psnr(shown.current, &native));
        }
        // The kriging-free mean leaves a millionth of a neighbour's error at each pixel.
        assert!(quality[15] > 80.0 && quality[0] < 45.0, "derivatives {has_derivatives}: {quality:.1?}");
    }
}

#[test]
fn buffers_are_read_however_they_lie_and_whatever_their_depths_mean() {
    let world = World::default();
    let [mut plain, mut other] =
        [0, 1].map(|_| Reconstructor::new(ReconstructorSettings::default()).unwrap());
    for k in 0..4 {
        let now = camera(0.01 * f64::from(k));
        let buffers = world.render(&now, &now, plain.next_jitter(&now), 0.0);
        let [width, height] = buffers.size.to_usize();
        // Planes, bottom padding of rows, reversed depth.
        let row = width + 3;
        let mut planar = vec![f32::NAN; 3 * row * height];
        for (k, pixel) in buffers.rgba.chunks_exact(4).enumerate() {
            for c in 0..3 {
                planar[(c * height + k / width) * row + k % width] = pixel[c];
            }
        }
        let strides = Strides { row, pixel: 1, channel: row * height };
        let near = 0.125;
        let reversed: Vec<f32> = buffers.depth.iter().map(|z| near / z).collect();
        let view = GBufferView {
            color: PlanesView::new(&planar, buffers.size, strides).unwrap(),
            depth: PlanesView::planar(&reversed, buffers.size).unwrap(),
            encoding: DepthEncoding::Reversed { near, far: f32::INFINITY },
            ..buffers.view()
        };
        let a = plain.reconstruct(&now, &buffers.view()).unwrap().current.clone();
        let b = other.reconstruct(&now, &view).unwrap();
        // Depths round otherwise.
        assert!(psnr(&a, b.current) > 90.0, "frame {k}: {} dB", psnr(&a, b.current));
    }
}

#[test]
fn a_frame_that_is_refused_leaves_the_history_as_it_was() {
    let world = World::default();
    let run = |refuses: bool| {
        let mut reconstructor = Reconstructor::new(ReconstructorSettings::default()).unwrap();
        let mut shown = Image::default();
        for k in 0..4 {
            let now = camera(0.01 * f64::from(k));
            let buffers = world.render(&now, &now, reconstructor.next_jitter(&now), 0.0);
            if refuses {
                let mut bad = buffers.clone();
                bad.rgba[40] = f32::NAN;
                let error = reconstructor.reconstruct(&now, &bad.view()).unwrap_err();
                assert_eq!(error, ReconstructError::NotFinite { what: "G-buffer colour" });
                let small = camera(0.0).resized(64, 64).unwrap();
                let error = reconstructor.reconstruct(&small, &buffers.view()).unwrap_err();
                assert!(matches!(error, ReconstructError::Size { .. }), "{error}");
                let error =
                    reconstructor.reconstruct_with_poses(&now, &buffers.view(), &[now; 2]).unwrap_err();
                assert_eq!(error, ReconstructError::Poses { expected: 1, actual: 2 });
            }
            shown = reconstructor.reconstruct(&now, &buffers.view()).unwrap().current.clone();
        }
        shown
    };
    assert!(run(true) == run(false));
}

#[test]
fn gbuffers_of_our_own_are_views_too() {
    let now = camera(0.0);
    let gbuffer = GBuffer::zeroed(64, 40);
    let mut reconstructor = Reconstructor::new(ReconstructorSettings::default()).unwrap();
    let shown = reconstructor.reconstruct(&now, &GBufferView::of(&gbuffer).unwrap()).unwrap();
    assert!(shown.in_between.is_empty() && shown.current.pixels().iter().all(|pixel| pixel[..3] == [0.0; 3]));
    let error = GBufferView::of(&GBuffer { geometry: None, ..gbuffer }).map(|_| ()).unwrap_err();
    assert_eq!(error, ReconstructError::Missing { what: "depth" });
}
