//! Arranging values in lanes.

use fearless_simd::{Simd, f32x4, f32x16, i32x16, prelude::*, u8x64};

/// Samples of a row that are processed together: one vector.
pub(crate) const CHUNK: usize = 16;

/// For four identical blocks, the byte indices that fill all four lanes of block `b` with its lane `b`.
const SPREAD: [u8; 64] = {
    let mut bytes = [0; 64];
    let mut k = 0;
    while k < 64 {
        bytes[k] = (k / 16 * 4 + k % 4) as u8;
        k += 1;
    }
    bytes
};

/// Four values, each four times in a row.
#[inline(always)]
pub(crate) fn spread<S: Simd>(simd: S, values: &[f32]) -> f32x16<S> {
    let bytes = u8x64::load_array_ref(simd, &SPREAD);
    repeat(simd, values).swizzle_dyn_within_blocks(bytes)
}

/// Four values in a row, four times.
#[inline(always)]
pub(crate) fn repeat<S: Simd>(simd: S, values: &[f32]) -> f32x16<S> {
    f32x16::block_splat(f32x4::from_slice(simd, values))
}

/// Vectors of `N` times sixteen values.
#[inline(always)]
pub(crate) fn load_all<S: Simd, const N: usize>(simd: S, values: &[[f32; CHUNK]; N]) -> [f32x16<S>; N] {
    let mut vectors = [f32x16::splat(simd, 0.0); N];
    for (vector, values) in vectors.iter_mut().zip(values) {
        *vector = f32x16::load_array_ref(simd, values);
    }
    vectors
}

/// Looks up four values of sixteen lanes: numbers `first..first + 4` of entry `at[lane]` of `table`, each number in a vector of
/// its own.
#[inline(always)]
pub(crate) fn look_up_four<S: Simd, const N: usize>(
    simd: S,
    table: &[[f32; N]],
    at: &[i32; CHUNK],
    first: usize,
) -> [f32x16<S>; 4] {
    let mut rows = [[f32x4::splat(simd, 0.0); 4]; 4];
    for (k, quads) in rows.iter_mut().enumerate() {
        for (i, quad) in quads.iter_mut().enumerate() {
            *quad = f32x4::from_slice(simd, &table[at[4 * k + i] as usize][first..first + 4]);
        }
        let [a, b, c, d] = *quads;
        let ((a, c), (b, d)) = (a.interleave(c), b.interleave(d));
        let ((first, second), (third, fourth)) = (a.interleave(b), c.interleave(d));
        *quads = [first, second, third, fourth];
    }
    let [a, b, c, d] = rows;
    let mut columns = [f32x16::splat(simd, 0.0); 4];
    for (k, column) in columns.iter_mut().enumerate() {
        *column = a[k].combine(b[k]).combine(c[k].combine(d[k]));
    }
    columns
}

/// The first sixteen values of `values`, 0 beyond them.
#[inline(always)]
pub(crate) fn load<S: Simd>(simd: S, values: &[f32]) -> f32x16<S> {
    if let Some(values) = values.first_chunk() {
        return f32x16::load_array_ref(simd, values);
    }
    let mut padded = [0.0; 16];
    padded[..values.len()].copy_from_slice(values);
    f32x16::load_array(simd, padded)
}

/// Number of values of a row that [`look_up`] covers at once.
pub(crate) const WINDOW: usize = 32;

/// The byte indices of the window's values at places in `0..WINDOW`, for [`look_up`].
#[inline(always)]
pub(crate) fn window_bytes<S: Simd>(places: f32x16<S>) -> u8x64<S> {
    (places.to_int::<i32x16<S>>() * 0x0404_0404 + 0x0302_0100).bitcast()
}

/// Looks up sixteen of the first [`WINDOW`] values of `values`.
#[inline(always)]
pub(crate) fn look_up<S: Simd>(simd: S, values: &[f32], bytes: u8x64<S>) -> f32x16<S> {
    let (low, high) = values[..WINDOW].split_at(WINDOW / 2);
    f32x16::from_slice(simd, low).concat_swizzle_dyn(f32x16::from_slice(simd, high), bytes)
}

#[cfg(test)]
mod tests {
    use fearless_simd::dispatch;

    use super::*;

    #[test]
    fn numbers_of_all_lanes_are_looked_up() {
        let table: Vec<[f32; 8]> = (0..50).map(|i| std::array::from_fn(|k| (100 * i + k) as f32)).collect();
        let at: [i32; CHUNK] = std::array::from_fn(|lane| (lane * lane * 7 % 50) as i32);
        for first in [0, 4] {
            let found = dispatch!(gs3_simd::level(), simd => look_up_four(simd, &table, &at, first).map(|v| v.to_array()));
            for (k, found) in found.iter().enumerate() {
                assert_eq!(*found, at.map(|i| table[i as usize][first + k]), "number {k} from {first} on");
            }
        }
    }
}
