//! Motion between LR frames against exact positions and depths of an analytic world.

use crate::common::{Sheet, World, camera, wall_and_post};
use glam::DVec2;
use gs3_reconstruct::{Depth, DepthView, Motion, ReconstructError};
use gs3_scene::{Camera, GBuffer, Planes, Size};
use proptest::prelude::*;

const SCALE: u32 = 4;
const JITTERS: [[f32; 2]; 2] = [[0.375, -0.125], [-0.3, 0.2]];

fn motion(world: &World, cameras: [&Camera; 2], jitters: [[f32; 2]; 2]) -> Motion {
    let [now, before] = [0, 1].map(|k| world.gbuffer(&cameras[k].low_resolution(SCALE), jitters[k]));
    let mut motion = Motion::default();
    let view = |gbuffer, camera| DepthView::of_gbuffer(gbuffer, camera, SCALE).unwrap();
    motion.set(&view(&now, cameras[0]), &view(&before, cameras[1])).unwrap();
    motion
}

/// What a test says about one sample: flow, validity, and the truth. The true validity is the bilinear share of the samples
/// around the place that show the same surface.
struct Judged {
    flow: [f32; 2],
    validity: f32,
    expected: [f64; 2],
    share: f64,
}

/// All samples, with what the world says.
fn judge(world: &World, cameras: [&Camera; 2], jitters: [[f32; 2]; 2]) -> Vec<Judged> {
    let motion = motion(world, cameras, jitters);
    let [now, before] = cameras.map(|c| c.low_resolution(SCALE));
    let (width, height) = (motion.flow.width(), motion.flow.height());
    let judge = |k: usize| {
        let index = DVec2::new((k % width) as f64, (k / width) as f64);
        let jitter = jitters.map(|j| DVec2::new(f64::from(j[0]), f64::from(j[1])));
        let position = index + 0.5 + jitter[0];
        let depth = world.sample(&now, position).depth;
        // Nothing is far, in any direction.
        let point = now.unproject(position, if depth > 0.0 { depth } else { 1e9 });
        let (target, z) = before.project(point);
        let place = target - 0.5 - jitter[1];
        let is_inside = z > 0.0
            && target.cmpge(DVec2::ZERO).all()
            && target.x <= width as f64
            && target.y <= height as f64;
        // The bilinear cell of samples around the place, clamped to the frame.
        let last = DVec2::new(width as f64 - 1.0, height as f64 - 1.0);
        let held = place.clamp(DVec2::ZERO, last);
        let shares = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]].map(|corner| {
            let sample = (held.floor() + DVec2::from(corner)).min(last);
            let found = world.sample(&before, sample + 0.5 + jitter[1]).depth;
            let agrees = (found > 0.0) == (depth > 0.0) && (depth == 0.0 || (found - z).abs() < 0.1 * z);
            let weight = (1.0 - DVec2::from(corner) - held.fract()).abs();
            f64::from(u8::from(agrees && is_inside)) * weight.x * weight.y
        });
        let flow = [0, 1].map(|c| motion.flow.plane(c)[k]);
        let validity = motion.validity.data()[k];
        Judged { flow, validity, expected: (place - index).to_array(), share: shares.iter().sum() }
    };
    (0..width * height).map(judge).collect()
}

/// Checks all samples; how many were seen, hidden, and seen in part.
fn check(world: &World, cameras: [&Camera; 2], jitters: [[f32; 2]; 2]) -> [usize; 3] {
    let mut counts = [0; 3];
    for (k, judged) in judge(world, cameras, jitters).iter().enumerate() {
        let Judged { flow, validity, expected, share } = judged;
        let error = |c: usize| (f64::from(flow[c]) - expected[c]).abs();
        assert!(*validity == 0.0 || (error(0) < 1e-3 && error(1) < 1e-3), "{k}: {flow:?}, {expected:?}");
        assert!(*validity > 0.0 || *flow == [0.0; 2], "{k}: {flow:?}");
        assert!((0.0..=1.0).contains(validity), "{k}: {validity}");
        assert!(*share > 0.0 || *validity == 0.0, "{k}: not seen, but validity {validity}");
        // All four weights, but for rounding.
        assert!(*share < 1.0 - 1e-9 || *validity > 0.9999, "{k}: seen, but validity {validity}");
        // A flow within 0.001 along each axis makes shares within 0.002.
        assert!((f64::from(*validity) - share).abs() < 2e-3, "{k}: {share} is seen, but validity {validity}");
        counts[match share {
            0.0 => 1,
            share if *share > 0.9999 => 0,
            _ => 2,
        }] += 1;
    }
    counts
}

#[test]
fn what_rests_has_no_motion() {
    let mut world = wall_and_post(20.0);
    // Without the wall's right half there is background as well.
    (world.sheets[1].half_width, world.sheets[1].center, world.sheets[1].softness) = (5.0, -4.5, 1e-3);
    let camera = camera(243, 130, [0.3, 0.1, -0.2], 0.2, -0.1);
    let still = motion(&world, [&camera; 2], [JITTERS[0]; 2]);
    assert!(still.flow.data().iter().all(|v| *v == 0.0));
    assert!(still.validity.data().iter().all(|v| *v == 1.0));
    let shaken = motion(&world, [&camera; 2], JITTERS);
    for (c, [now, before]) in [[0.375, -0.3], [-0.125, 0.2_f32]].into_iter().enumerate() {
        let valid = shaken.flow.plane(c).iter().zip(shaken.validity.data()).filter(|(_, v)| **v > 0.0);
        assert!(valid.map(|(flow, _)| flow).all(|flow| (flow - (now - before)).abs() < 1e-6));
    }
    assert!(shaken.validity.data().iter().filter(|v| **v == 1.0).count() > 1800);
}

#[test]
fn moving_cameras_see_surfaces_where_they_were() {
    let world = wall_and_post(20.0);
    let before = camera(240, 136, [0.0, 0.0, 0.0], 0.0, 0.0);
    for (position, yaw, pitch) in [([0.4, 0.1, 0.3], 0.05, -0.03), ([-1.0, -0.2, -0.5], -0.1, 0.02)] {
        let now = camera(240, 136, position, yaw, pitch);
        let [seen, hidden, doubtful] = check(&world, [&now, &before], JITTERS);
        assert!(seen > 1000 && hidden > 50 && doubtful < 300, "{seen}, {hidden}, {doubtful}");
    }
}

#[test]
fn background_moves_as_infinitely_far_and_belongs_to_background() {
    let mut world = wall_and_post(20.0);
    world.sheets.pop();
    let before = camera(240, 136, [0.0; 3], 0.0, 0.0);
    let now = camera(240, 136, [0.9, 0.1, 0.3], 0.04, -0.03);
    let [seen, hidden, _] = check(&world, [&now, &before], JITTERS);
    assert!(seen > 1500 && hidden > 50, "{seen}, {hidden}");
}

#[test]
fn slanted_surfaces_are_followed_to_the_horizon() {
    let world = World { sheets: vec![Sheet::endless(6.0, 3, 5.0)] };
    let [now, before] = [[0.0; 3], [0.05, 0.02, 0.01]].map(|p| camera(240, 136, p, 1.0, 0.0));
    let motion = motion(&world, [&now, &before], JITTERS);
    // Left of the horizon, sample by sample towards it, depths grow by up to a third.
    let depths = world.gbuffer(&now.low_resolution(SCALE), JITTERS[0]).geometry.unwrap().depth_median;
    let row = depths.row(0, 17);
    let steep =
        (1..59).filter(|&i| row[i + 1] > 1.05 * row[i] && row[i + 1] < 2.0 * row[i]).collect::<Vec<_>>();
    assert!(steep.len() > 3, "{row:?}");
    for i in steep {
        assert!(motion.validity.row(0, 17)[i] > 0.99, "{i}: {:?}", motion.validity.row(0, 17));
    }
}

#[test]
fn the_sky_is_not_the_ground_at_the_horizon() {
    // Inverse depths of a plane are linear: at the first sample below the horizon, the slope is the inverse depth
    // itself.
    let mut inverse = Planes::<1>::new(8, 1);
    inverse.data_mut().iter_mut().enumerate().for_each(|(i, w)| *w = i as f32 / 8.0);
    let view = |jitter| DepthView {
        camera: camera(8, 1, [0.0; 3], 0.0, 0.0),
        jitter,
        depth: Depth::Inverse(&inverse),
    };
    let mut motion = Motion::default();
    motion.set(&view([0.25, 0.0]), &view([-0.25, 0.0])).unwrap();
    let validity = motion.validity.data();
    assert!((validity[0] - 0.5).abs() < 1e-5 && validity[1..7].iter().all(|v| *v > 0.9999), "{validity:?}");
}

#[test]
fn both_forms_of_depth_are_one() {
    let world = wall_and_post(20.0);
    let cameras = [[0.4, 0.1, 0.3], [0.0; 3]].map(|p| camera(240, 136, p, 0.0, 0.0));
    let gbuffers: [GBuffer; 2] = [0, 1].map(|k| world.gbuffer(&cameras[k].low_resolution(SCALE), JITTERS[k]));
    let views = [0, 1].map(|k| DepthView::of_gbuffer(&gbuffers[k], &cameras[k], SCALE).unwrap());
    let inverse = gbuffers.each_ref().map(|gbuffer| {
        let mut inverse = gbuffer.geometry.as_ref().unwrap().depth_median.clone();
        inverse.data_mut().iter_mut().for_each(|z| *z = if *z > 0.0 { 1.0 / *z } else { 0.0 });
        inverse
    });
    let others = [0, 1].map(|k| DepthView { depth: Depth::Inverse(&inverse[k]), ..views[k] });
    let mut motions = [Motion::default(), Motion::default()];
    motions[0].set(&views[0], &views[1]).unwrap();
    motions[1].set(&others[0], &others[1]).unwrap();
    assert_eq!((&motions[0].flow, &motions[0].validity), (&motions[1].flow, &motions[1].validity));
}

#[test]
fn the_result_does_not_depend_on_the_threads() {
    let world = wall_and_post(20.0);
    let cameras = [[0.4, 0.1, 0.3], [0.0; 3]].map(|p| camera(240, 136, p, 0.0, 0.0));
    let [one, three] = [1, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| motion(&world, [&cameras[0], &cameras[1]], JITTERS))
    });
    assert_eq!((one.flow, one.validity), (three.flow, three.validity));
}

#[test]
fn wrong_inputs_are_typed_errors() {
    let camera = camera(64, 36, [0.0; 3], 0.0, 0.0);
    let (depth, small) = (Planes::new(64, 36), Planes::new(16, 9));
    let view = DepthView { camera, jitter: [0.0; 2], depth: Depth::Z(&depth) };
    let mut motion = Motion::default();
    let error = motion.set(&DepthView { depth: Depth::Z(&small), ..view }, &view).unwrap_err();
    assert_eq!(
        error,
        ReconstructError::Size { what: "depth", expected: Size::new(64, 36), actual: Size::new(16, 9) }
    );
    let other = DepthView { camera: camera.low_resolution(4), depth: Depth::Inverse(&small), ..view };
    let error = motion.set(&view, &other).unwrap_err();
    assert!(matches!(error, ReconstructError::Size { what: "previous view", .. }));
    let error = motion.set(&view, &DepthView { jitter: [f32::NAN, 0.0], ..view }).unwrap_err();
    assert!(matches!(error, ReconstructError::Jitter { .. }));
    let error = DepthView::of_gbuffer(&GBuffer::zeroed(64, 36), &camera, 0).unwrap_err();
    assert_eq!(error, ReconstructError::Scale { actual: 0 });
    assert_eq!(motion.flow.data().len(), 0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn nothing_is_ever_infinite(
        width in 1_u32..50, height in 1_u32..50, seed in any::<u64>(), is_inverse in any::<bool>(),
        jitters in prop::array::uniform2((-1.0_f32..1.0, -1.0_f32..1.0)),
        step in prop::array::uniform3(-2.0_f64..2.0), far in 0.0_f64..1e40, yaw in -2.0_f64..2.0,
    ) {
        let depths = [0.0, 1e-30, 1e-7, f32::NAN, 0.3, 1.0, f32::INFINITY, 1e6, 1e30, -1.0];
        let planes = [0, 1].map(|_| {
            let mut plane = Planes::<1>::new(width as usize, height as usize);
            for (i, z) in plane.data_mut().iter_mut().enumerate() {
                *z = depths[((seed >> (i % 61)) % 10) as usize];
            }
            plane
        });
        let views = [0, 1].map(|k| {
            let step = if seed % 3 == 0 { [far; 3] } else { step };
            let camera = camera(width, height, step.map(|s| s * k as f64), yaw * k as f64, 0.0);
            let depth = if is_inverse { Depth::Inverse(&planes[k]) } else { Depth::Z(&planes[k]) };
            DepthView { camera, jitter: jitters[k].into(), depth }
        });
        let mut motion = Motion::default();
        motion.set(&views[0], &views[1]).unwrap();
        for (k, validity) in motion.validity.data().iter().enumerate() {
            prop_assert!((0.0..=1.0).contains(validity));
            let flow = [0, 1].map(|c| motion.flow.plane(c)[k]);
            prop_assert!(flow.iter().all(|v| v.is_finite() && (*validity > 0.0 || *v == 0.0)), "{flow:?}");
        }
    }
}
