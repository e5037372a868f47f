//! The CPU renders until a GPU is ready.

use gs3::compute::skip_without_gpu;
use gs3::{Backend, PipelineError, SessionSettings};
use gs3_test_support::psnr_of_bytes;
use gs3_viewer::{Viewer, ViewerError, ViewerSettings};

use super::{Hand, SIZE, native, scene};

#[test]
fn the_gpu_goes_on_where_the_cpu_began() {
    let session = SessionSettings { backend: Backend::Gpu, ..SessionSettings::default() };
    let settings = ViewerSettings { session, native_when_fast: false, waker: None, fps: 30.0, size: SIZE };
    let path = gs3::scene::demo::path();
    let viewer = match pollster::block_on(Viewer::new_async("demo", scene(), Some(&path), settings)) {
        Ok(viewer) => viewer,
        Err(ViewerError::Pipeline(error @ PipelineError::Gpu(_))) => return skip_without_gpu(error),
        Err(error) => panic!("{error}"),
    };
    let mut hand = Hand { viewer, ..Hand::new() };
    assert_eq!(hand.viewer.backend(), Backend::Cpu, "the GPU has compiled nothing");
    // The frame of the CPU; natively the step then waits for the GPU.
    assert!(hand.step().is_new);
    let (rendered, of_cpu) = (hand.frames(), hand.viewer.frame().to_rgb8());
    assert_eq!((rendered, hand.viewer.backend()), (1, Backend::Gpu));
    hand.rest();
    // The history began anew: its sixteen frames, and the native one.
    assert_eq!(hand.frames(), 1 + 17);
    let of_gpu = hand.viewer.frame().to_rgb8();
    let camera = hand.viewer.camera().unwrap();
    for (frame, least) in [(of_cpu, 20.0), (of_gpu, 50.0)] {
        let psnr = psnr_of_bytes(&frame, &native(&camera));
        assert!(psnr > least, "{psnr:.1} dB");
    }
    assert_eq!(hand.viewer.message(), None);
}
