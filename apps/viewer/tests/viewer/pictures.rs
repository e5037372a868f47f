//! What a picture shows: comparisons, screenshots, other sizes.

use gs3::scene::Size;
use gs3::{FramePipeline, Mode, PipelineSettings};
use gs3_test_support::psnr_of_bytes;
use gs3_viewer::input::{Button, Key};
use gs3_viewer::{Destination, Effect, Input};

use super::{Hand, SIZE, first_camera, native, scene};

#[test]
fn comparisons_show_each_method_on_its_side() {
    let mut hand = Hand::new();
    hand.press(Key::C);
    hand.step();
    let camera = hand.viewer.camera().unwrap();
    let expected = native(&camera);
    let half = |rgb: &[u8], columns: std::ops::Range<usize>| -> Vec<u8> {
        let rows = rgb.chunks_exact(SIZE.width as usize * 3);
        rows.flat_map(|row| row[columns.start * 3..columns.end * 3].to_vec()).collect()
    };
    let shown = hand.viewer.frame().to_rgb8();
    assert_eq!(half(&shown, 0..120), half(&expected, 0..120));
    assert_ne!(half(&shown, 120..240), half(&expected, 120..240), "gs3 has not converged yet");
    // The divider is dragged to a quarter.
    hand.viewer.input(Input::PointerMoved([121.0, 60.0]));
    hand.viewer.input(Input::Button(Button::Left, true));
    hand.viewer.input(Input::PointerMoved([60.0, 60.0]));
    hand.viewer.input(Input::Button(Button::Left, false));
    hand.rest();
    assert_eq!(hand.viewer.camera().unwrap(), camera, "dragging a divider does not turn the camera");
    assert_eq!(hand.viewer.frame().to_rgb8(), expected, "at rest gs3 is native");
    let settings = PipelineSettings { mode: Mode::Bicubic, ..PipelineSettings::default() };
    let mut bicubic = FramePipeline::new(scene(), settings).unwrap();
    let bicubic = bicubic.render(&camera).unwrap().current.to_rgb8();
    hand.press(Key::C);
    hand.rest();
    assert_eq!(half(&hand.viewer.frame().to_rgb8(), 0..120), half(&bicubic, 0..120));
    assert_eq!(half(&hand.viewer.frame().to_rgb8(), 120..240), half(&expected, 120..240));
}

#[test]
fn large_screenshots_are_native_frames() {
    let mut hand = Hand::new();
    let shot = |scale| gs3_viewer::Shot { file: None, panels: false, scale, camera: None };
    hand.rest();
    hand.viewer.shoot(shot(2));
    hand.rest();
    let effects = hand.viewer.take_effects();
    let [Effect::Save(Destination::Numbered { stem: "gs3", extension: "png" }, bytes)] = &effects[..] else {
        panic!("{} effects", effects.len())
    };
    let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
    let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut rgb).unwrap();
    let camera = first_camera().resized(480, 272).unwrap();
    let psnr = psnr_of_bytes(&rgb, &native(&camera));
    assert!(psnr > 60.0, "{psnr:.1} dB");
    // The native image is back.
    assert_eq!(hand.viewer.frame().to_rgb8(), native(&hand.viewer.camera().unwrap()));
}

#[test]
fn another_size_and_scale_are_shown_at_once() {
    let mut hand = Hand::new();
    hand.rest();
    hand.viewer.input(Input::Resized(Size::new(161, 90)));
    hand.viewer.input(Input::Scale(2.0));
    hand.step();
    assert_eq!((hand.viewer.picture().size, hand.viewer.camera().unwrap().width()), ([161, 90], 161));
    hand.rest();
    assert_eq!(hand.viewer.frame().to_rgb8(), native(&hand.viewer.camera().unwrap()));
    hand.viewer.input(Input::Resized(Size::new(0, 0)));
    hand.step();
    assert_eq!(hand.viewer.size(), Size::new(1, 1));
}
