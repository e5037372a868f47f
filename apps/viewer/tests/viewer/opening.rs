//! What is opened, and what is told of it.

use gs3::glam::DVec3;
use gs3::scene::{Details, Gaussians, OpacityMode, Scene};
use gs3_viewer::input::Key;
use gs3_viewer::panels::Action;
use gs3_viewer::{Effect, Input, Opened};
use std::path::PathBuf;
use std::sync::Arc;

use super::Hand;

#[test]
fn what_cannot_be_opened_leaves_the_old_scene() {
    let mut hand = Hand::new();
    hand.rest();
    let (gaussians, before) = (hand.viewer.gaussians(), hand.viewer.frame().clone());
    hand.viewer.input(Input::Dropped(PathBuf::from("bad.ply")));
    hand.step();
    assert!(hand.viewer.is_opening());
    assert_eq!(hand.viewer.take_effects(), [Effect::Open(PathBuf::from("bad.ply"))]);
    hand.viewer.progress(0.5);
    hand.step();
    let message = "bad.ply: expected a scene, found nothing of the kind";
    hand.viewer.opened(Err(message.to_owned()), hand.now.get());
    hand.step();
    assert_eq!(hand.viewer.message(), Some(message));
    assert_ne!(hand.viewer.picture().pixels, before.pixels, "the message is in the picture");
    // The scene goes on under the message.
    let frames = hand.frames();
    hand.viewer.input(Input::PointerGone);
    hand.viewer.input(Input::Wheel(1.0));
    hand.rest();
    assert!(hand.frames() > frames && hand.viewer.message().is_some());
    hand.press(Key::R);
    hand.press(Key::Escape);
    assert_eq!(hand.viewer.message(), None);
    hand.rest();
    assert_eq!((hand.viewer.gaussians(), hand.viewer.frame()), (gaussians, &before));
}

#[test]
fn another_scene_is_shown_from_where_it_is_in_view() {
    let mut hand = Hand::new();
    hand.rest();
    let mut one = Gaussians::zeroed(1, 0);
    one.means[0][0] = 40.0;
    one.scales.iter_mut().for_each(|axis| axis[0] = 1.0);
    (one.rotations[0][0], one.opacities[0]) = (1.0, 0.9);
    one.sh.iter_mut().for_each(|v| *v = 1.0);
    let scene = Arc::new(Scene::new(one, OpacityMode::Default).unwrap());
    let opened = Opened::Scene { name: "one".to_owned(), scene, cameras: None };
    hand.viewer.opened(Ok(opened), hand.now.get());
    hand.rest();
    assert_eq!(hand.viewer.gaussians(), 1);
    let (pixel, z) = hand.viewer.camera().unwrap().project(DVec3::new(40.0, 0.0, 0.0));
    assert!(z > 0.0 && (pixel.x - 120.0).abs() < 1.0 && (pixel.y - 68.0).abs() < 1.0, "{pixel}");
}

/// The same Gaussians around another origin: in the file's coordinates nothing has moved.
#[test]
fn a_finer_scene_leaves_the_camera_and_its_path_where_they_are() {
    let mut hand = Hand::new();
    hand.rest();
    hand.press(Key::K);
    hand.viewer.input(Input::Wheel(1.0));
    hand.rest();
    hand.press(Key::K);
    hand.rest();
    let coarse = hand.viewer.scene();
    let origin = DVec3::new(5.0, -1.0, 3.0);
    let mut gaussians = coarse.gaussians().clone();
    for (means, by) in gaussians.means.iter_mut().zip(origin.to_array()) {
        means.iter_mut().for_each(|mean| *mean -= by as f32);
    }
    let details = Details { origin: coarse.details().origin + origin, ..coarse.details().clone() };
    let finer = Arc::new(Scene::new(gaussians, OpacityMode::Default).unwrap().with_details(details));
    let (before, shown) = (hand.viewer.camera().unwrap(), hand.viewer.frame().to_rgb8());
    assert!(hand.viewer.opened(Ok(Opened::Finer { scene: finer }), hand.now.get()));
    hand.rest();
    let after = hand.viewer.camera().unwrap();
    assert!((after.position() + origin).distance(before.position()) < 1e-9);
    let now = hand.viewer.frame().to_rgb8();
    let different = now.iter().zip(&shown).filter(|(a, b)| a.abs_diff(**b) > 2).count();
    assert!(different * 1000 < now.len(), "{different} of {} bytes differ", now.len());
    // The path still ends at its second key, which is this camera.
    hand.viewer.act(Action::Scrub(1e9), hand.now.get());
    hand.rest();
    assert!(hand.viewer.camera().unwrap().position().distance(after.position()) < 1e-9);
}

#[test]
fn files_are_asked_for() {
    let mut hand = Hand::new();
    hand.rest();
    hand.press(Key::O);
    assert_eq!(hand.viewer.take_effects(), [Effect::Choose]);
    hand.viewer.not_chosen("there is no dialog".to_owned());
    hand.step();
    assert_eq!(hand.viewer.message(), Some("there is no dialog"));
}
