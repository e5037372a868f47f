//! What chunks hold, compared with the G-buffer that they are made from.

use fearless_simd::dispatch;
use gs3_scene::{ExactBlock, GBuffer, Geometry, Gradients, Size};

use super::*;
use crate::error::ReconstructError;
use crate::reprojection::inverse_depth;

/// Width of a full chunk and a partial one.
const WIDTH: usize = 21;
const HEIGHT: usize = 4;

/// A frame with arbitrary values. From row 2 on it has one colour and no surface, except for its last sample.
fn gbuffer() -> GBuffer {
    let value = |k: usize| (k * 7919 % 1009) as f32 / 1009.0;
    let is_bare = |k: usize| k % (WIDTH * HEIGHT) >= 2 * WIDTH;
    let planes = |seed: usize, bare: f32| {
        let mut planes = Planes::<3>::new(WIDTH, HEIGHT);
        for (k, v) in planes.data_mut().iter_mut().enumerate() {
            *v = if is_bare(k) { bare } else { value(k + seed) };
        }
        planes
    };
    let mut depth_median = Planes::<1>::new(WIDTH, HEIGHT);
    for (k, z) in depth_median.data_mut().iter_mut().enumerate() {
        *z = if is_bare(k) { 0.0 } else { 1.0 + value(3 * k) };
    }
    depth_median.data_mut()[WIDTH * HEIGHT - 1] = 2.0;
    let gradients = Gradients { color_dx: planes(11, 0.0), color_dy: planes(23, 0.0), color_dxy: None };
    GBuffer {
        color: planes(5, 0.25),
        gradients: Some(gradients),
        geometry: Some(Geometry { depth_median, ..Geometry::default() }),
        ..GBuffer::default()
    }
}

#[test]
fn chunks_hold_what_the_gbuffer_says() -> Result<(), ReconstructError> {
    let gbuffer = gbuffer();
    let mut frame = SampleFrame::default();
    frame.fill(gs3_simd::level(), &gbuffer, 2)?;
    let (Some(gradients), Some(geometry)) = (&gbuffer.gradients, &gbuffer.geometry) else {
        return Err(ReconstructError::Missing { what: "all" });
    };
    let inverse = |x: usize, y: usize| inverse_depth(geometry.depth_median.row(0, y)[x]);
    for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
        let (chunk, lane) = (frame.chunk(y, x / CHUNK), x % CHUNK);
        let mut squares = 0.0;
        for c in 0..3 {
            let color = gbuffer.color.row(c, y)[x];
            let [dx, dy] = [&gradients.color_dx, &gradients.color_dy].map(|planes| planes.row(c, y)[x] / 2.0);
            let sample = frame.sample(x, y);
            assert_eq!([sample[c], sample[DX + c], sample[DY + c]], [color, dx, dy], "{x}, {y}");
            assert_eq!(chunk.colors()[c][lane], color);
            assert_eq!(chunk.quads(lane).map(|quad| quad[c]), [color, dx, dy]);
            squares += dx * dx + dy * dy;
        }
        assert_eq!(chunk.inverse_depth()[lane], inverse(x, y));
        let around = (y.saturating_sub(1)..(y + 2).min(HEIGHT))
            .flat_map(|y| (x.saturating_sub(1)..(x + 2).min(WIDTH)).map(move |x| (x, y)));
        let near = around.map(|(x, y)| inverse(x, y)).fold(0.0, f32::max);
        let is_beside = inverse(x, y) < near * EDGE_RATIO;
        let expected = if is_beside { CROSSING * (near - inverse(x, y)) * squares.sqrt() } else { 0.0 };
        assert!(
            (chunk.edge_slopes()[lane] - expected).abs() <= 1e-6,
            "{x}, {y}: {}",
            chunk.edge_slopes()[lane]
        );
    }
    let row_of = |x: usize, y: usize| (x..(x + CHUNK).min(WIDTH)).map(move |x| inverse(x, y));
    for (x, y) in [(0, 0), (CHUNK, 1), (CHUNK, HEIGHT - 1)] {
        let extent = frame.extents(y)[x / CHUNK];
        let far = row_of(x, y).fold(f32::INFINITY, f32::min);
        let near = row_of(x, y).fold(0.0, f32::max);
        assert_eq!(extent, Extent { far, near, bare: None }, "{x}, {y}");
    }
    let bare = Some([0.25; 3]);
    assert_eq!(frame.extents(2).iter().map(|extent| extent.bare).collect::<Vec<_>>(), [bare, bare]);
    Ok(())
}

/// A surface at inverse depth 1 in one LR sample, before a background at infinity. Blocks beside the sample know of the surface's
/// edge, others do not.
#[test]
fn blocks_know_of_edges_beside_them() -> Result<(), ReconstructError> {
    let margin = Margin { left: 2, top: 1, right: 1, bottom: 0 };
    // At scale 4 a block lies around one LR sample. At scale 3, with jitter 0, the middle of block 1 is half-way between the
    // samples 1 and 2, and counts as beside sample 2.
    let own = |block: [u16; 2]| block.map(usize::from);
    let third = |block: [u16; 2]| block.map(|k| (f64::from(4 * k + 2) / 3.0 + 1e-6) as usize);
    let of_four = [([5, 3], Margin::NONE), ([0, 0], margin), ([11, 7], margin)];
    let of_four = of_four.map(|(near, margin)| (4, [-0.375, 0.125], near, margin, Size::new(12, 8)));
    let of_three = (3, [0.0; 2], [3, 2], Margin::NONE, Size::new(16, 11));
    for (scale, jitter, near, margin, lr) in of_four.into_iter().chain([of_three]) {
        let padded = margin.padded(lr).to_usize();
        let mut gbuffer = GBuffer { jitter, margin, ..GBuffer::zeroed(padded[0], padded[1]) };
        let at = (near[1] + margin.top as usize) * padded[0] + near[0] + margin.left as usize;
        if let Some(geometry) = &mut gbuffer.geometry {
            geometry.depth_median.data_mut()[at] = 1.0;
        }
        let (mut frame, mut of_blocks) = (SampleFrame::default(), SampleFrame::default());
        frame.fill(gs3_simd::level(), &gbuffer, scale)?;
        // The norm of all derivatives is 5.
        let slopes = [[3.0; CHUNK], [4.0; CHUNK], [0.0; CHUNK]];
        let block = ExactBlock { color_dx: slopes, ..ExactBlock::EMPTY };
        let places: Vec<[u16; 2]> = (0..8).flat_map(|y| (0..12).map(move |x| [x, y])).collect();
        let blocks: Vec<_> = places.iter().map(|place| (*place, &block)).collect();
        of_blocks.fill_blocks(gs3_simd::level(), &blocks, Size::new(48, 32), &frame, scale);
        for (k, place) in places.iter().enumerate() {
            let nearest = if scale == 4 { own(*place) } else { third(*place) };
            let is_beside = (0..2).all(|a| nearest[a].abs_diff(near[a]) <= 1);
            let expected = if is_beside { 5.0 * CROSSING_OF_BLOCKS } else { 0.0 };
            let chunk = of_blocks.chunk(k / BLOCKS_PER_ROW, k % BLOCKS_PER_ROW);
            assert_eq!(*chunk.edge_slopes(), [expected; CHUNK], "x{scale}, block {place:?}, near {near:?}");
        }
    }
    Ok(())
}

#[test]
fn the_nearest_of_a_block_are_of_the_pixels_around() {
    // Numbers in no order, each once.
    let values: [f32; CHUNK] = std::array::from_fn(|i| (i * 7 % CHUNK) as f32);
    let found = dispatch!(gs3_simd::level(), simd => {
        fill::nearest_in_block(simd, f32x16::load_array(simd, values)).to_array()
    });
    for (i, found) in found.into_iter().enumerate() {
        let [x, y] = [i % BLOCK_SIDE, i / BLOCK_SIDE];
        let is_around = |k: &usize| (k % BLOCK_SIDE).abs_diff(x) <= 1 && (k / BLOCK_SIDE).abs_diff(y) <= 1;
        let expected = (0..CHUNK).filter(is_around).map(|k| values[k]).fold(f32::NEG_INFINITY, f32::max);
        assert_eq!(found, expected, "pixel {i}");
    }
}
