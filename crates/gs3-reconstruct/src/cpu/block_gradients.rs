//! Derivatives of a frame's exact blocks, and the gather of warped pixels from values and derivatives.
//!
//! A native image holds detail up to and beyond the limit of its pixels, so values alone do not tell what is half-way between two
//! pixels. Values with exact derivatives tell twice as much along each axis.

use std::slice;

use fearless_simd::{Level, Simd, dispatch, f32x16, prelude::*, u32x16};
use gs3_scene::{BLOCK_SIDE, ExactBlock, ExactBlocks, Image, Size, block_grid};
use gs3_simd::prefetch;
use rayon::prelude::*;

use crate::cpu::gather::{PHASE_BITS, QUAD, UNITS};

/// A pixel's derivatives are read four pixels at a time, as pixels are.
const SIDE: usize = BLOCK_SIDE;
const _: () = assert!(SIDE == QUAD);

/// Numbers of a row of a block: four pixels of red, green, blue and 0.
const ROW: usize = 4 * SIDE;

/// Rows of pixels that the cells of a patch have corners in.
const CORNERS: usize = SIDE + 1;

/// Pixels on either side that [`differences`] reads.
const REACH: usize = 2;

/// Weights of the differences between the pixels 1 and 2 on either side: the derivative of the polynomial through five pixels. (Seven
/// pixels gain 0.01 to 0.04 dB.)
const DIFFERENCES: [f32; REACH] = [2.0 / 3.0, -1.0 / 12.0];

/// Fewest exact pixels among the 5×5 pixels of a patch that is gathered with derivatives: a third. (Empirical: with 1, in-between frames
/// of `hqgarden_drift` and `flowers_orbit` gain 0.07 and 0.03 dB.)
const FEWEST: usize = 8;

/// The derivatives of a block's pixels, row by row. The upper half of each number is the upper half of the derivative along y as an
/// `f32`, the lower half is the same of the derivative along x. (Halves are known to 1/256. A pixel half-way between two others
/// has 1/8 of their derivatives, so even where neighbouring pixels are black and white, colours are off by 1/2000.)
type Packed = [[u32; ROW]; SIDE];

/// Derivatives of the colours of a frame's exact blocks, per HR pixel.
#[derive(Clone, Debug, Default)]
pub struct BlockGradients {
    /// The frame's size.
    size: Size,
    /// Columns of blocks.
    columns: usize,
    /// For each block of the frame, its number in `blocks` plus one; 0 for blocks without derivatives.
    numbers: Vec<u32>,
    blocks: Vec<Packed>,
}

impl BlockGradients {
    /// Begins a frame of `size` without exact blocks. The memory is kept.
    pub fn clear(&mut self, size: Size) {
        let [columns, rows] = block_grid(size);
        (self.size, self.columns) = (size, columns);
        self.numbers.clear();
        self.numbers.resize(columns * rows, 0);
        self.blocks.clear();
    }

    /// Adds exact blocks of the frame. Blocks outside the frame are left out.
    pub fn add(&mut self, blocks: &ExactBlocks) {
        let first = self.blocks.len() as u32 + 1;
        // In rows, as patches read them.
        let mut order: Vec<([u16; 2], u32)> = blocks
            .places
            .iter()
            .zip(0..blocks.blocks.len() as u32)
            .map(|([column, row], k)| ([*row, *column], k))
            .collect();
        order.par_sort_unstable();
        self.blocks.par_extend(order.par_iter().map(|(_, k)| packed(&blocks.blocks[*k as usize])));
        for (number, ([row, column], _)) in (first..).zip(&order) {
            let (column, row) = (usize::from(*column), usize::from(*row));
            if column < self.columns
                && let Some(of_place) = self.numbers.get_mut(row * self.columns + column)
            {
                *of_place = number;
            }
        }
    }

    /// The derivatives, if there are any.
    #[must_use]
    pub fn some(&self) -> Option<&Self> {
        (!self.blocks.is_empty()).then_some(self)
    }

    /// The size of the frame.
    pub(crate) const fn size(&self) -> Size {
        self.size
    }

    /// The cells of the 4×4 pixels from a fixed-point place of an image of `size` on, if at least [`FEWEST`] of the cells' corners are
    /// exact; none near the border. Positions are those of [`crate::cpu::gather::Gather`].
    #[inline(always)]
    pub(crate) fn cells(&self, size: Size, [x, y]: [i32; 2]) -> Option<Cells<'_>> {
        let (column, row) = ((x >> PHASE_BITS) as isize, (y >> PHASE_BITS) as isize);
        let [width, height] = size.to_usize().map(|side| side as isize);
        let (side, reach) = (SIDE as isize, REACH as isize);
        // Differences are taken of all pixels of two blocks side by side.
        let is_inside = column >= side
            && row >= side
            && column + 2 * side + reach <= width
            && row + side + 1 + reach <= height;
        if !is_inside {
            return None;
        }
        let (column, row) = (column as usize, row as usize);
        let first = row / SIDE * self.columns + column / SIDE;
        let numbers = &self.numbers[..];
        let upper = [numbers[first], numbers[first + 1]];
        let lower = [numbers[first + self.columns], numbers[first + self.columns + 1]];
        if upper[0] | upper[1] | lower[0] | lower[1] == 0 {
            return None;
        }
        // Patches are gathered from left to right, as blocks lie in memory. The exact blocks of a row have gaps, so their memory is no
        // stream that the hardware detects.
        for [left, right] in [upper, lower] {
            if let Some(next) = self.blocks.get(left.max(right) as usize) {
                prefetch(slice::from_ref(next));
            }
        }
        // Columns of pixels in the left and the right blocks, and rows in the upper and the lower ones.
        let (columns, rows) = (SIDE - column % SIDE, SIDE - row % SIDE);
        let (columns, rows) = ([columns, CORNERS - columns], [rows, CORNERS - rows]);
        let mut exact = 0;
        for k in 0..2 {
            exact += columns[k] * rows[0] * usize::from(upper[k] > 0);
            exact += columns[k] * rows[1] * usize::from(lower[k] > 0);
        }
        if exact < FEWEST {
            return None;
        }
        let blocks =
            [upper, lower].map(|row| row.map(|number| self.blocks.get((number as usize).wrapping_sub(1))));
        Some(Cells { column, row, blocks })
    }
}

/// The cells between 5×5 pixels.
pub(crate) struct Cells<'a> {
    /// The first pixel.
    column: usize,
    row: usize,
    /// The blocks that the pixels are in, two rows of two; none where they are not exact.
    blocks: [[Option<&'a Packed>; 2]; 2],
}

impl Cells<'_> {
    /// Four rows of four pixels of `image`, the first at `place`, from values and derivatives (bicubic Hermite interpolation without
    /// mixed derivatives). Derivatives of pixels beside exact blocks are differences.
    ///
    /// A kernel of its own: inlined wherever patches are gathered, the code would not fit the instruction cache.
    #[inline(always)]
    pub fn patch(&self, level: Level, image: &Image, place: [i32; 2], out: &mut [[f32; ROW]; SIDE]) {
        dispatch!(level, simd => self.gather(simd, image, place, out));
    }

    /// Interpolates four rows of four pixels, the first at `(x, y)`.
    #[inline(always)]
    fn gather<S: Simd>(&self, simd: S, image: &Image, [x, y]: [i32; 2], out: &mut [[f32; ROW]; SIDE]) {
        let Self { column, row, .. } = *self;
        let pixels = image.pixels().as_flattened();
        let pitch = 4 * image.width();
        let [across, down] = [Cell::at(x), Cell::at(y)];
        let mut sums = [f32x16::splat(simd, 0.0); SIDE];
        for r in 0..CORNERS {
            let blocks = &self.blocks[(row % SIDE + r) / SIDE];
            let (first_row, in_block) = ((row + r) * pitch, (row + r) % SIDE);
            let mut halves = [u32x16::splat(simd, 0); 2];
            for k in 0..2 {
                halves[k] = match blocks[k] {
                    Some(block) => u32x16::load_array_ref(simd, &block[in_block]),
                    None => differences(simd, pixels, first_row + 4 * SIDE * (column / SIDE + k), pitch),
                };
            }
            let [dx_dy, second_dx_dy] = beside(halves, column % SIDE);
            let values = &pixels[first_row + 4 * column..][..4 * CORNERS];
            let (first, second) =
                (f32x16::from_slice(simd, &values[..ROW]), f32x16::from_slice(simd, &values[4..]));
            let ([dx, dy], [second_dx, second_dy]) = (unpack(dx_dy), unpack(second_dx_dy));
            // The values and the derivatives along y between the two corners of each cell.
            let value = first * across.value[0];
            let value = second.mul_add(across.value[1], value);
            let value = dx.mul_add(across.slope[0], value);
            let value = second_dx.mul_add(across.slope[1], value);
            let slope = second_dy.mul_add(across.value[1], dy * across.value[0]);
            if r < SIDE {
                sums[r] = value.mul_add(down.value[0], slope.mul_add(down.slope[0], sums[r]));
            }
            if r > 0 {
                sums[r - 1] = value.mul_add(down.value[1], slope.mul_add(down.slope[1], sums[r - 1]));
            }
        }
        for (sum, out) in sums.into_iter().zip(out) {
            sum.store_array(out);
        }
    }
}

/// Weights of the corners of a cell along an axis (cubic Hermite interpolation).
struct Cell {
    value: [f32; 2],
    slope: [f32; 2],
}

impl Cell {
    /// The weights at a fixed-point position.
    #[inline(always)]
    fn at(position: i32) -> Self {
        let f = (position & ((1 << PHASE_BITS) - 1)) as f32 * (1.0 / UNITS);
        let g = 1.0 - f;
        let second = f * f * (3.0 - 2.0 * f);
        Self { value: [1.0 - second, second], slope: [f * g * g, -f * f * g] }
    }
}

/// Rounds to the upper half of an `f32`; of finite numbers.
#[inline]
const fn upper_half(v: f32) -> u32 {
    v.to_bits().wrapping_add(0x8000) & 0xffff_0000
}

fn packed(block: &ExactBlock) -> Packed {
    // Plane by plane, so that the compiler makes vectors of it.
    let mut planes = [[0; 16]; 3];
    for (plane, (dx, dy)) in planes.iter_mut().zip(block.color_dx.iter().zip(&block.color_dy)) {
        for (number, (dx, dy)) in plane.iter_mut().zip(dx.iter().zip(dy)) {
            *number = upper_half(*dx) >> 16 | upper_half(*dy);
        }
    }
    let [r, g, b] = planes;
    let mut out = [[0; ROW]; SIDE];
    for (k, pixel) in out.as_flattened_mut().as_chunks_mut::<4>().0.iter_mut().enumerate() {
        *pixel = [r[k], g[k], b[k], 0];
    }
    out
}

/// Four pixels from pixel `first` (below 4) of eight on, and the four pixels one to the right.
#[inline(always)]
fn beside<S: Simd>([left, right]: [u32x16<S>; 2], first: usize) -> [u32x16<S>; 2] {
    match first {
        0 => [left, left.slide::<4>(right)],
        1 => [left.slide::<4>(right), left.slide::<8>(right)],
        2 => [left.slide::<8>(right), left.slide::<12>(right)],
        _ => [left.slide::<12>(right), right],
    }
}

/// The derivatives along x and along y of four packed pixels.
#[inline(always)]
fn unpack<S: Simd>(packed: u32x16<S>) -> [f32x16<S>; 2] {
    [(packed << 16_u32).bitcast(), (packed & 0xffff_0000).bitcast()]
}

/// The packed derivatives of four pixels in a row, by differences. The first number of the pixels is `pixels[at]`, and rows are `pitch`
/// numbers apart.
#[inline(always)]
fn differences<S: Simd>(simd: S, pixels: &[f32], at: usize, pitch: usize) -> u32x16<S> {
    let [mut dx, mut dy] = [f32x16::splat(simd, 0.0); 2];
    for (k, weight) in DIFFERENCES.iter().enumerate() {
        let (across, down) = (4 * (k + 1), pitch * (k + 1));
        let (right, left) = (at + across, at - across);
        let (below, above) = (at + down, at - down);
        let of_x = f32x16::from_slice(simd, &pixels[right..right + ROW])
            - f32x16::from_slice(simd, &pixels[left..left + ROW]);
        let of_y = f32x16::from_slice(simd, &pixels[below..below + ROW])
            - f32x16::from_slice(simd, &pixels[above..above + ROW]);
        dx = of_x.mul_add(*weight, dx);
        dy = of_y.mul_add(*weight, dy);
    }
    let [dx, dy]: [u32x16<S>; 2] = [dx.bitcast(), dy.bitcast()];
    (dx >> 16_u32) | (dy & 0xffff_0000)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::gather::Gather;

    const SIZE: Size = Size::new(44, 41);

    /// Waves of up to 0.45 cycles a pixel, with their derivatives along x and y.
    fn waves(x: f32, y: f32, c: usize) -> [f32; 3] {
        let mut sum = [0.0; 3];
        for k in 1..=5_u8 {
            let (k, turn) = (f32::from(k), std::f32::consts::TAU * 0.45);
            let (across, down) = (turn * k / 5.0 * 0.8, turn * (6.0 - k) / 5.0 * 0.5);
            let (sin, cos) = (across * x + down * y + k + c as f32).sin_cos();
            sum = [sum[0] + sin, sum[1] + across * cos, sum[2] + down * cos];
        }
        sum
    }

    fn image() -> Image {
        let [width, height] = SIZE.to_usize();
        let mut image = Image::new(width, height);
        for (k, pixel) in image.pixels_mut().iter_mut().enumerate() {
            let (x, y) = ((k % width) as f32, (k / width) as f32);
            *pixel = [waves(x, y, 0)[0], waves(x, y, 1)[0], waves(x, y, 2)[0], 0.1 * x];
        }
        image
    }

    fn blocks(places: Vec<[u16; 2]>) -> ExactBlocks {
        let block = |[column, row]: &[u16; 2]| {
            let mut block = ExactBlock::EMPTY;
            for (k, c) in (0..16).flat_map(|k| (0..3).map(move |c| (k, c))) {
                let (x, y) = (f32::from(4 * column) + (k % 4) as f32, f32::from(4 * row) + (k / 4) as f32);
                [block.color[c][k], block.color_dx[c][k], block.color_dy[c][k]] = waves(x, y, c);
            }
            block
        };
        ExactBlocks { blocks: places.iter().map(block).collect(), places }
    }

    fn gradients(is_exact: impl Fn(u16, u16) -> bool) -> BlockGradients {
        let mut gradients = BlockGradients::default();
        gradients.clear(SIZE);
        // From the right, in two parts: blocks come in any order.
        let places = (0..12).flat_map(|row| (0..12).rev().map(move |column| [column, row]));
        let (left, right): (Vec<_>, Vec<_>) =
            places.filter(|[x, y]| is_exact(*x, *y)).partition(|[x, _]| *x < 6);
        gradients.add(&blocks(right));
        gradients.add(&blocks(left));
        gradients
    }

    fn units(place: [f32; 2]) -> [i32; 2] {
        place.map(|v| (v * UNITS).round() as i32)
    }

    fn patch(gradients: &BlockGradients, image: &Image, place: [i32; 2]) -> Option<[[f32; ROW]; SIDE]> {
        let mut out = [[0.0; ROW]; SIDE];
        gradients.cells(image.size(), place)?.patch(gs3_simd::level(), image, place, &mut out);
        Some(out)
    }

    /// Squared distance of a patch to the truth.
    fn error(patch: &[[f32; ROW]; SIDE], [x, y]: [f32; 2]) -> f32 {
        let numbers = (0..SIDE).flat_map(|r| (0..SIDE).flat_map(move |k| (0..3).map(move |c| (r, k, c))));
        numbers.map(|(r, k, c)| (patch[r][4 * k + c] - waves(x + k as f32, y + r as f32, c)[0]).powi(2)).sum()
    }

    #[test]
    fn detail_is_nearer_to_the_truth_than_by_values() {
        let (image, gather) = (image(), Gather::new());
        let gradients = gradients(|_, _| true);
        let (mut by_gradients, mut by_values) = (0.0, 0.0);
        for k in 0..=255_u8 {
            let place = [10.5 + f32::from(k % 16) * 0.3125, 11.5 + f32::from(k / 16) * 0.4375];
            by_gradients += error(&patch(&gradients, &image, units(place)).unwrap(), place);
            dispatch!(gs3_simd::level(), simd => {
                let values = gather.patch(simd, &image, units(place)).unwrap().map(|row| row.to_array());
                by_values += error(&values, place);
            });
        }
        assert!(by_gradients < 0.2 * by_values, "{by_gradients}, by values {by_values}");
    }

    /// Of a plane, differences are the derivatives: it does not matter which blocks are exact.
    #[test]
    fn pixels_beside_exact_blocks_have_differences() {
        let plane = |x: f32, y: f32| [0.5 * x - 0.25 * y, 0.25 * x + 0.5 * y, 0.125 * x];
        let mut image = image();
        for (k, pixel) in image.pixels_mut().iter_mut().enumerate() {
            let [r, g, b] = plane((k % 44) as f32, (k / 44) as f32);
            *pixel = [r, g, b, 0.0];
        }
        let slopes = [[0.5, 0.25, 0.125], [-0.25, 0.5, 0.0]];
        let [color_dx, color_dy] = slopes.map(|slopes| slopes.map(|slope| [slope; 16]));
        let block = ExactBlock { color_dx, color_dy, ..ExactBlock::EMPTY };
        let mut gradients = BlockGradients::default();
        gradients.clear(SIZE);
        let places: Vec<_> =
            (0..10).flat_map(|y| (y % 2..11).step_by(2).map(move |x| [x as u16, y as u16])).collect();
        gradients.add(&ExactBlocks { blocks: vec![block; places.len()], places });
        for k in 0..200_u8 {
            let [x, y] = [5.0 + f32::from(k % 20) * 1.375, 4.0 + f32::from(k / 20) * 2.25];
            let found = patch(&gradients, &image, units([x, y])).expect("enough exact pixels");
            for (r, row) in found.iter().enumerate() {
                for (c, pixel) in row.as_chunks::<4>().0.iter().enumerate() {
                    let expected = plane(x + c as f32, y + r as f32);
                    for (found, expected) in pixel.iter().zip(expected) {
                        assert!((found - expected).abs() < 2e-3, "({x}, {y}): {found}, expected {expected}");
                    }
                }
            }
        }
    }

    /// Whatever the derivatives are.
    #[test]
    fn patches_have_the_image_at_its_pixels_and_the_border_is_left_to_others() {
        let image = image();
        // At least eight of 5×5 pixels are exact.
        let gradients = gradients(|x, y| (x + y) % 2 == 1);
        for (x, y) in (4..33).flat_map(|y| (4..33).map(move |x| (x, y))) {
            let Some(found) = patch(&gradients, &image, units([x as f32, y as f32])) else {
                panic!("enough pixels from ({x}, {y}) on are exact");
            };
            for (r, row) in found.iter().enumerate() {
                assert_eq!(
                    row.as_slice(),
                    image.row(y + r)[x..x + SIDE].as_flattened(),
                    "({x}, {y}), row {r}"
                );
            }
        }
        for place in [[3.9, 10.0], [10.0, 3.9], [35.0, 10.0], [10.0, 35.0], [-9.0, 5.0], [5.0, 900.0]] {
            assert!(patch(&gradients, &image, units(place)).is_none(), "{place:?}");
        }
    }

    #[test]
    fn few_exact_pixels_are_not_enough() {
        let gradients = gradients(|x, y| [x, y] == [4, 4]);
        // The block's pixels are 16 to 19 along both axes: 4×1, 2×4, 2×2, 3×3, 2×4 and none of 5×5 pixels.
        for (place, expected) in [
            ([16.0, 19.0], false),
            ([13.5, 15.0], true),
            ([13.0, 13.0], false),
            ([17.0, 17.0], true),
            ([18.0, 16.0], true),
            ([8.0, 8.0], false),
        ] {
            assert_eq!(gradients.cells(SIZE, units(place)).is_some(), expected, "{place:?}");
        }
        let mut none = gradients.clone();
        assert!(gradients.some().is_some());
        none.clear(SIZE);
        assert!(none.some().is_none() && none.cells(SIZE, units([16.0, 16.0])).is_none());
        // Blocks outside the picture are left out.
        none.add(&blocks(vec![[11, 2], [3, 11], [4, 4]]));
        assert!(none.cells(SIZE, units([16.0, 16.0])).is_some());
    }

    #[test]
    fn derivatives_are_rounded_to_256ths() {
        for v in [0.0_f32, 1.0, -0.37, 1e-9, 123.4] {
            let found = f32::from_bits(upper_half(v));
            assert!((found - v).abs() <= v.abs() / 256.0, "{v}: {found}");
        }
    }
}
