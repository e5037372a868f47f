//! Things that move by themselves: history and in-between frames follow the renderer's motion vectors.

use crate::world::{World, camera, psnr_where, turned_camera};
use glam::DVec3;
use gs3_reconstruct::{GBufferView, PlanesView, ReconstructError, Reconstructor, ReconstructorSettings};
use gs3_scene::{Camera, Image, Size};
use rayon::prelude::*;

/// Frames of a sequence: the history is full long before its end.
const FRAMES: usize = 24;

/// World units around the disc in which it was, or soon is.
const NEAR: f64 = 0.35;

/// PSNR of a frame on the disc, around it, and elsewhere.
#[derive(Clone, Copy, Debug)]
struct Quality {
    disc: f64,
    padded: f64,
    elsewhere: f64,
}

impl Quality {
    fn of(image: &Image, world: World, camera: &Camera, time: f64) -> Self {
        let (native, outside) = (world.native(camera, time), world.outside(camera, time));
        Self {
            disc: psnr_where(image, &native, |k| outside[k] < 0.0),
            padded: psnr_where(image, &native, |k| (0.0..NEAR).contains(&outside[k])),
            elsewhere: psnr_where(image, &native, |k| outside[k] >= NEAR),
        }
    }
}

/// Frames shown of `world`, with its motion or without, seen by `path`: the quality of the last one and of the last one
/// between.
fn run(world: World, path: impl Fn(f64) -> Camera, has_motion: bool) -> [Quality; 2] {
    let mut reconstructor = Reconstructor::new(ReconstructorSettings::default()).unwrap();
    let mut quality = None;
    for k in 0..FRAMES {
        let time = k as f64;
        let (now, before) = (path(time), path(time - 1.0));
        let buffers = world.render(&now, &before, reconstructor.next_jitter(&now), time);
        let view = if has_motion { buffers.moving_view() } else { buffers.view() };
        let between = path(time - 0.5);
        let shown = reconstructor.reconstruct_with_poses(&now, &view, &[between]).unwrap();
        if let Some(middle) = shown.in_between.first() {
            quality = Some([
                Quality::of(shown.current, world, &now, time),
                Quality::of(middle, world, &between, time - 0.5),
            ]);
        }
    }
    quality.unwrap()
}

/// A name, what moves, and where the camera is in each frame.
type Case = (&'static str, World, fn(f64) -> Camera);

/// The motions of disc and camera that are tried.
fn cases() -> [Case; 5] {
    let flying = World { velocity: DVec3::new(0.021, 0.004, 0.0), spin: 0.0 };
    let turning = World { velocity: DVec3::new(0.017, 0.0, 0.0), spin: 0.02 };
    let coming = World { velocity: DVec3::new(0.012, 0.0, -0.05), spin: 0.01 };
    let slow = World { velocity: DVec3::new(0.0031, 0.0013, 0.0), spin: 0.0 };
    let rest = |_: f64| camera(0.0);
    let pan = |time: f64| camera(0.009 * time);
    let turn = |time: f64| turned_camera(0.004 * time, 0.0016 * time);
    [
        ("flying", flying, rest),
        ("flying past a camera that moves", flying, pan),
        ("turning", turning, turn),
        ("coming", coming, pan),
        ("slow", slow, rest),
    ]
}

#[test]
fn what_moves_is_as_sharp_as_what_stands_still() {
    cases().into_par_iter().for_each(|(name, world, path)| {
        let [with, without] = [true, false].map(|has_motion| run(world, path, has_motion));
        let [still, still_between] = run(World::default(), path, false);
        for (kind, with, without, still) in
            [("frame", with[0], without[0], still), ("between", with[1], without[1], still_between)]
        {
            let figures =
                format!("{name}, {kind}: with {with:.1?}, without {without:.1?}, still {still:.1?}");
            println!("{figures}");
            // Seen: 8.8 to 25.4 dB more than without, and up to 6 dB less than where a camera passes what rests.
            assert!(with.disc > without.disc + 6.0 && with.disc > 35.0, "{figures}");
            // Around it are uncovered places with a short history, and samples that its rim may have hidden.
            assert!(with.padded > without.padded.min(still.padded) - 0.5 && with.padded > 30.0, "{figures}");
            assert!(with.elsewhere > without.elsewhere.min(100.0) - 0.1, "{figures}");
        }
    });
}

#[test]
fn vectors_of_what_stands_still_change_nothing() {
    let path = |k: usize| turned_camera(0.012 * k as f64, 0.003 * k as f64);
    let world = World::default();
    let settings = ReconstructorSettings { in_between: 2, ..Default::default() };
    let [mut plain, mut told] = [0, 1].map(|_| Reconstructor::new(settings).unwrap());
    for k in 0..6 {
        let (now, before) = (path(k), path(k.saturating_sub(1)));
        let buffers = world.render(&now, &before, plain.next_jitter(&now), 0.0);
        // As half precision rounds them.
        let mut rounded = buffers.clone();
        rounded.motion.iter_mut().for_each(|v| *v *= 1.0 + 2.0_f32.powi(-12));
        let plain = plain.reconstruct(&now, &buffers.view()).unwrap();
        let told = told.reconstruct(&now, &rounded.moving_view()).unwrap();
        assert!(plain.current == told.current && plain.in_between == told.in_between, "frame {k}");
    }
}

#[test]
fn what_stops_becomes_native_and_leaves_no_trail() {
    let flying = World { velocity: DVec3::new(0.05, 0.01, 0.0), spin: 0.0 };
    let now = camera(0.0);
    // It stays where it was in frame 12. Frames that say nothing of motion stand still as those do that say so.
    let (stop, native) = (12, flying.native(&now, 12.0));
    for is_silent in [|_: usize| true, |k: usize| k.is_multiple_of(2)] {
        let mut reconstructor = Reconstructor::new(ReconstructorSettings::default()).unwrap();
        let mut quality = 0.0;
        for k in 0..stop + 17 {
            let jitter = reconstructor.next_jitter(&now);
            let mut buffers = flying.render(&now, &now, jitter, k.min(stop) as f64);
            if k > stop {
                buffers.motion.fill(0.0);
            }
            let view = if k > stop && is_silent(k) { buffers.view() } else { buffers.moving_view() };
            quality = psnr_where(reconstructor.reconstruct(&now, &view).unwrap().current, &native, |_| true);
        }
        // Every pixel has a sample of its own again; its neighbours leave a millionth of their error.
        assert!(quality > 80.0, "{quality} dB");
    }
}

#[test]
fn motion_that_cannot_be_is_refused_and_changes_nothing() {
    let world = World { velocity: DVec3::new(0.03, 0.0, 0.0), spin: 0.01 };
    let now = camera(0.0);
    let run = |refuses: bool| {
        let mut reconstructor = Reconstructor::new(ReconstructorSettings::default()).unwrap();
        let mut shown = (Image::default(), Vec::new());
        for k in 0..5 {
            let buffers = world.render(&now, &now, reconstructor.next_jitter(&now), f64::from(k));
            if refuses {
                let mut bad = buffers.clone();
                bad.motion[77] = f32::INFINITY;
                let error = reconstructor.reconstruct(&now, &bad.moving_view()).unwrap_err();
                assert_eq!(error, ReconstructError::NotFinite { what: "G-buffer motion" });
                let small = PlanesView::interleaved(&buffers.motion, Size::new(10, 10), 2).unwrap();
                let view = GBufferView { motion: Some(small), ..buffers.view() };
                let error = reconstructor.reconstruct(&now, &view).unwrap_err();
                let expected = buffers.size;
                let what = "G-buffer motion";
                assert_eq!(error, ReconstructError::Size { what, expected, actual: Size::new(10, 10) });
            }
            let made = reconstructor.reconstruct(&now, &buffers.moving_view()).unwrap();
            shown = (made.current.clone(), made.in_between.to_vec());
        }
        shown
    };
    assert!(run(true) == run(false));
}

#[test]
fn any_finite_vectors_make_finite_frames() {
    let world = World { velocity: DVec3::new(0.03, 0.0, 0.0), spin: 0.0 };
    let path = |k: usize| turned_camera(0.01 * k as f64, 0.002 * k as f64);
    let mut reconstructor = Reconstructor::new(ReconstructorSettings::default()).unwrap();
    // Anything, always the same.
    let mut state = 1_u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state >> 16
    };
    for k in 0..8 {
        let (now, before) = (path(k), path(k.saturating_sub(1)));
        let mut buffers = world.render(&now, &before, reconstructor.next_jitter(&now), k as f64);
        for v in buffers.motion.iter_mut() {
            let size = [0.01, 1.0, 30.0, 1e4, 1e20, f32::MAX][next() as usize % 6];
            *v = size * (next() as f32 / 32768.0 - 1.0);
        }
        for z in buffers.depth.iter_mut() {
            *z = [*z, *z, 0.0, 1e-7, 1e-3, 1e30, f32::INFINITY][next() as usize % 7];
        }
        let shown = reconstructor.reconstruct(&now, &buffers.moving_view()).unwrap();
        for image in shown.in_between.iter().chain([shown.current]) {
            assert!(image.pixels().iter().flatten().all(|v| v.is_finite()), "frame {k}");
        }
    }
}
