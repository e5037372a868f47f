use gs3_scene::{Geometry, Gradients, Intrinsics, Margin};

use super::*;

const SCALE: u32 = 4;
const SIZE: [usize; 2] = [24, 16];
const MARGIN: usize = 3;

/// A wall five units away and before it, at depth 3, a square of 6×6 LR pixels, with its margin.
fn gbuffer(left: f32) -> GBuffer {
    let [width, height] = SIZE.map(|side| side + 2 * MARGIN);
    let mut depth_median = Planes::<1>::new(width, height);
    for (k, z) in depth_median.data_mut().iter_mut().enumerate() {
        *z = if is_square(k, width, left) { 3.0 } else { 5.0 };
    }
    let (color, plane) = (Planes::new(width, height), || Planes::new(width, height));
    GBuffer {
        margin: Margin::all(MARGIN as u32),
        color,
        gradients: Some(Gradients { color_dx: plane(), color_dy: plane(), color_dxy: None }),
        geometry: Some(Geometry { depth_median, ..Geometry::default() }),
        ..GBuffer::default()
    }
}

/// Whether sample `k` is on the square with its left edge `left` of the picture's.
fn is_square(k: usize, width: usize, left: f32) -> bool {
    let [x, y] = [k % width, k / width].map(|v| v as f32 + 0.5 - MARGIN as f32);
    (left..left + 6.0).contains(&x) && (5.0..11.0).contains(&y)
}

fn camera() -> Camera {
    let [width, height] = SIZE.map(|side| side as u32 * SCALE);
    Camera::new(glam::DAffine3::IDENTITY, Intrinsics::from_fov_y(width, height, 0.8)).expect("valid")
}

/// The square has moved from `from` to `to`, LR pixels.
fn motion(from: f32, to: f32) -> SurfaceMotion {
    let (before, now, camera) = (gbuffer(from), gbuffer(to), camera());
    let mut frame = SampleFrame::default();
    frame.fill(gs3_simd::level(), &before, SCALE).expect("complete");
    let mut vectors = Planes::<2>::new(now.width(), now.height());
    let width = now.width();
    for (k, x) in vectors.plane_mut(0).iter_mut().enumerate() {
        *x = if is_square(k, width, to) { from - to } else { 0.0 };
    }
    let mut motion = SurfaceMotion::default();
    let frames = Frames { cameras: [&camera, &camera], before: &frame, now: &now, scale: SCALE };
    motion.set(&frames, &vectors);
    motion
}

/// The HR position of an LR position.
fn at(x: f32, y: f32) -> [f32; 2] {
    [x, y].map(|v| v * SCALE as f32)
}

#[test]
fn what_left_is_found_where_it_was() {
    let motion = motion(6.0, 9.0);
    // Three LR pixels are twelve HR pixels, at depth 3.
    let way = (12.0 * 3.0 / camera().intrinsics().fx) as f32;
    let moved = |departure: Departure| match departure {
        Departure::Moved([x, y, z]) => (x - way).abs() < 1e-5 && y.abs() < 1e-6 && z.abs() < 1e-6,
        _ => false,
    };
    let square = |x: f32, y: f32| motion.departure(at(x, y), 1.0 / 3.0, false);
    assert!(moved(square(8.3, 7.9)), "{:?}", square(8.3, 7.9));
    assert!(moved(square(6.1, 5.1)), "at its corner: {:?}", square(6.1, 5.1));
    let wall = |x: f32, y: f32| motion.departure(at(x, y), 0.2, false);
    assert_eq!(wall(2.5, 8.0), Departure::Still, "nothing moves here");
    assert_eq!(wall(5.6, 8.0), Departure::Still, "beside what moved");
    assert_eq!(wall(9.0, 8.0), Departure::Unknown, "it was hidden, nobody saw it");
    // What has moved before and is not found again is not taken to rest.
    assert_eq!(motion.departure(at(2.5, 8.0), 1.0, true), Departure::Unknown);
    assert_eq!(motion.departure(at(2.5, 8.0), 1.0, false), Departure::Still);
    assert_eq!(motion.departure(at(-100.0, 8.0), 0.2, false), Departure::Unknown, "outside");
}

#[test]
fn what_is_seen_where_something_moves_is_disturbed() {
    let motion = motion(6.0, 9.0);
    assert_eq!(motion.surface_shift(at(12.0, 8.0)), 12.0);
    assert_eq!(motion.surface_shift(at(8.6, 8.0)), 12.0, "between its samples and those of the wall");
    assert_eq!(motion.surface_shift(at(7.5, 8.0)), 0.0, "where it was");
    let limits = |left: f32, right: f32| {
        let [left, right] = [left, right].map(|v| v * SCALE as f32);
        BoxLimits { left, right, top: 30.0, bottom: 30.0 }
    };
    assert!(motion.any_here(limits(9.0, 10.0)) && !motion.any_here(limits(-3.0, 4.0)));
    assert!(motion.any_left(limits(6.0, 7.0)) && !motion.any_left(limits(16.0, 20.0)));
    assert_eq!(motion.movers().count(), 36);
}

#[test]
fn both_frames_have_displacements() {
    let motion = motion(6.0, 9.0);
    let [before, now] = motion.displacements().expect("something moves");
    let columns = |of: &[[f32; 3]]| {
        let moves = |x: &usize| of[8 * SIZE[0] + x] != [0.0; 3];
        (0..SIZE[0]).filter(moves).collect::<Vec<_>>()
    };
    assert_eq!(columns(before), [6, 7, 8, 9, 10, 11]);
    assert_eq!(columns(now), [9, 10, 11, 12, 13, 14]);
    let still = self::motion(6.0, 6.0);
    assert!(still.displacements().is_none());
}

#[test]
fn rectangles_are_counted() {
    let size = [7, 5];
    let is_in = |x: usize, y: usize| (3 * x + 5 * y) % 7 == 1;
    let mut counts = Counts::default();
    counts.set(size, |count| {
        for (x, y) in (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (x, y))) {
            if is_in(x, y) {
                count([x, y]);
            }
        }
    });
    for (x0, x1) in (0..9).flat_map(|a| (a..9).map(move |b| (a, b))) {
        for (y0, y1) in (0..7).flat_map(|a| (a..7).map(move |b| (a, b))) {
            let mut cells = (y0..y1.min(5)).flat_map(|y| (x0..x1.min(7)).map(move |x| (x, y)));
            let expected = cells.any(|(x, y)| is_in(x, y));
            assert_eq!(counts.any([x0, y0], [x1, y1]), expected, "{x0}..{x1}, {y0}..{y1}");
        }
    }
}
