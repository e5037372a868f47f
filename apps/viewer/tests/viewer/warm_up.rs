//! The CPU renders until a GPU is ready.

use std::sync::Arc;
use std::time::Duration;

use gs3::compute::skip_without_gpu;
use gs3::scene::demo;
use gs3::{Backend, FramePipeline, Mode, PipelineError, PipelineSettings, SessionSettings};
use gs3_test_support::psnr_of_bytes;
use gs3_viewer::{Opened, Viewer, ViewerError, ViewerSettings};

use super::{Hand, SIZE, native, scene};

/// A viewer on a GPU that is not ready; none where there is no GPU.
fn hand() -> Option<Hand> {
    let session = SessionSettings { backend: Backend::Gpu, ..SessionSettings::default() };
    let settings = ViewerSettings { session, native_when_fast: false, waker: None, fps: 30.0, size: SIZE };
    let path = demo::path();
    let viewer = match pollster::block_on(Viewer::new_async("demo", scene(), Some(&path), settings)) {
        Ok(viewer) => viewer,
        Err(ViewerError::Pipeline(error @ PipelineError::Gpu(_))) => {
            skip_without_gpu(error);
            return None;
        }
        Err(error) => panic!("{error}"),
    };
    assert_eq!(viewer.backend(), Backend::Cpu, "the GPU has compiled nothing");
    Some(Hand { viewer, ..Hand::new() })
}

#[test]
fn the_gpu_goes_on_where_the_cpu_began() {
    let Some(mut hand) = hand() else { return };
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

/// A scene that comes before the GPU is ready is the GPU's scene.
#[test]
fn the_gpu_gets_ready_for_the_scene_that_is_shown() {
    let Some(mut hand) = hand() else { return };
    let scene = Arc::new(demo::scene().unwrap());
    let opened = Opened::Scene { name: "whole".into(), scene: Arc::clone(&scene), cameras: None };
    assert!(hand.viewer.opened(Ok(opened), Duration::ZERO));
    // The GPU is ready for the scene of the beginning, and then for this one.
    hand.step();
    assert_eq!(hand.viewer.backend(), Backend::Cpu);
    hand.step();
    assert_eq!(hand.viewer.backend(), Backend::Gpu);
    hand.rest();
    assert!(Arc::ptr_eq(&hand.viewer.scene(), &scene));
    let settings = PipelineSettings { mode: Mode::Native, ..PipelineSettings::default() };
    let mut native = FramePipeline::new(scene, settings).unwrap();
    let native = native.render(&hand.viewer.camera().unwrap()).unwrap().current.to_rgb8();
    let psnr = psnr_of_bytes(&hand.viewer.frame().to_rgb8(), &native);
    assert!(psnr > 50.0, "{psnr:.1} dB");
}
