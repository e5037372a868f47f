//! The scene in device memory, in pages that fit one binding each.

use bytemuck::{Pod, Zeroable};
use gs3_compute::{Buffer, Gpu, GpuError, Slice, Use};
use gs3_scene::Gaussians;
use gs3_scene::gaussians::sh_coefficient_count;
use half::f16;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;

use super::plan::ScenePlan;
use crate::chunk::CHUNK;

/// The precision of the scene in device memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ScenePrecision {
    /// Colours in f16, means and largest scales in f32. The rest of the shape is packed to 128 bits, precisely enough
    /// to hit the same samples. 40 bytes a Gaussian of degree 0, 128 of degree 3, 184 of degree 4.
    #[default]
    F16,
    /// Everything in f32, as on the CPU: 60 bytes a Gaussian of degree 0, 240 of degree 3, 348 of degree 4.
    F32,
}

impl ScenePrecision {
    /// Bytes of a Gaussian's shape, without its mean and largest scale.
    pub(super) const fn shape_bytes(self) -> u64 {
        match self {
            Self::F16 => 16,
            Self::F32 => 32,
        }
    }

    /// Bytes of a Gaussian's spherical-harmonics coefficients, padded to words.
    pub(super) const fn sh_bytes(self, degree: u8) -> u64 {
        let values = 3 * sh_coefficient_count(degree) as u64;
        match self {
            Self::F16 => values.div_ceil(2) * 4,
            Self::F32 => values * 4,
        }
    }
}

/// Gaussians packed and sent at a time.
const STEP: usize = 256 * CHUNK;

/// Bytes sent before waiting for the device, so that drivers need not hold the scene twice.
const FLUSH_BYTES: u64 = 256 << 20;

/// `Chunk` of `scene.wgsl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct ChunkBounds {
    center: [f32; 3],
    radius: f32,
    largest_scale: f32,
    _pad: f32,
    _pad2: f32,
    _pad3: f32,
}

/// `Page` of `scene.wgsl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct PageUniform {
    first_chunk: u32,
    chunks: u32,
    gaussians: u32,
    _pad: u32,
}

/// A part of the scene.
pub struct Page {
    pub chunks: u32,
    uniform: Buffer,
    bounds: Buffer,
    centers: Buffer,
    shapes: Buffer,
    sh: Buffer,
}

impl Page {
    /// The page's buffers, by the names in the kernels.
    pub fn bindings(&self) -> [(&'static str, Slice<'_>); 5] {
        [
            ("page", self.uniform.slice()),
            ("chunks", self.bounds.slice()),
            ("centers", self.centers.slice()),
            ("shapes", self.shapes.slice()),
            ("sh", self.sh.slice()),
        ]
    }
}

/// Uploads `gaussians` according to `plan`.
///
/// # Errors
/// [`GpuError`] if the device has too little memory for the Gaussians.
pub fn upload(gpu: &Gpu, gaussians: &Gaussians, plan: &ScenePlan) -> Result<Vec<Page>, GpuError> {
    let mut chunks = crate::chunk::of_gaussians(gaussians);
    let mut pages = Vec::new();
    let mut sent = 0;
    for range in plan.pages.ranges() {
        let (start, end) = (range.start as usize, range.end as usize);
        let count = range.end - range.start;
        let uniform = PageUniform {
            first_chunk: (start / CHUNK) as u32,
            chunks: (end - start).div_ceil(CHUNK) as u32,
            gaussians: count as u32,
            _pad: 0,
        };
        let sh_bytes = plan.precision.sh_bytes(plan.sh_degree);
        let shape_bytes = plan.precision.shape_bytes();
        let centers = gpu.buffer("centers", Use::Storage, count * 16)?;
        let shapes = gpu.buffer("shapes", Use::Storage, count * shape_bytes)?;
        let sh = gpu.buffer("sh", Use::Storage, count * sh_bytes)?;
        for first in (start..end).step_by(STEP) {
            let last = (first + STEP).min(end);
            let packed = Packed::new(gaussians, first, last, plan.precision);
            for (chunk, centers) in chunks[first / CHUNK..].iter_mut().zip(packed.centers.chunks(CHUNK)) {
                chunk.largest_scale = centers.iter().fold(0.0, |a, c| a.max(c[3]));
            }
            let at = (first - start) as u64;
            gpu.write(&centers.part(at * 16, u64::MAX), &packed.centers)?;
            gpu.write(&shapes.part(at * shape_bytes, u64::MAX), &packed.shapes)?;
            gpu.write(&sh.part(at * sh_bytes, u64::MAX), &packed.sh)?;
            sent += (last - first) as u64 * (16 + shape_bytes + sh_bytes);
            if sent >= FLUSH_BYTES {
                gpu.wait(&gpu.recorder(None).submit()?)?;
                sent = 0;
            }
        }
        let of_page = &chunks[start / CHUNK..end.div_ceil(CHUNK)];
        let bounds = of_page.iter().map(|chunk| ChunkBounds {
            center: chunk.center,
            radius: chunk.radius,
            largest_scale: chunk.largest_scale,
            _pad: 0.0,
            _pad2: 0.0,
            _pad3: 0.0,
        });
        pages.push(Page {
            chunks: uniform.chunks,
            uniform: gpu.buffer_with("page", Use::Uniform, &[uniform])?,
            bounds: gpu.buffer_with("chunks", Use::Storage, &bounds.collect::<Vec<_>>())?,
            centers,
            shapes,
            sh,
        });
    }
    Ok(pages)
}

/// Gaussians as words of the device's buffers.
struct Packed {
    /// Mean and largest scale.
    centers: Vec<[f32; 4]>,
    shapes: Vec<u32>,
    sh: Vec<u32>,
}

impl Packed {
    fn new(g: &Gaussians, first: usize, last: usize, precision: ScenePrecision) -> Self {
        let sh = &g.sh[first * g.sh_stride()..last * g.sh_stride()];
        let range = (first..last).into_par_iter();
        let centers = range.clone().map(|i| {
            let [x, y, z] = g.mean(i);
            [x, y, z, g.scale(i).into_iter().fold(0.0, f32::max)]
        });
        let (shapes, sh) = match precision {
            ScenePrecision::F16 => {
                let shapes: Vec<_> =
                    range.map(|i| packed_shape(g.scale(i), g.opacities[i], g.rotation(i))).collect();
                (shapes.as_flattened().to_vec(), sh_f16(sh, g.sh_stride()))
            }
            ScenePrecision::F32 => {
                let shape = |i: usize| {
                    let ([sx, sy, sz], [w, x, y, z]) = (g.scale(i), g.rotation(i));
                    [sx, sy, sz, g.opacities[i], w, x, y, z].map(f32::to_bits)
                };
                let shapes: Vec<_> = range.map(shape).collect();
                (shapes.as_flattened().to_vec(), bytemuck::cast_slice(sh).to_vec())
            }
        };
        Self { centers: centers.collect(), shapes, sh }
    }
}

/// Scales, opacity and rotation in 128 bits. This moves an ellipse's edge by about 1e-5 of its radius. With 16 bits
/// for each value, as for colours, the edge would move by 5e-4, and one sample in 10⁵ would be hit on one machine
/// only, which adds or removes its depth.
///
/// The axes are rotated so that the first is the longest; its scale is stored beside the mean. `scene_f16.wgsl`
/// unpacks:
///
/// | word | bits 31 to 10 | bits 9 to 0 |
/// |---|---|---|
/// | 0, 1 | second and third scale over the first, [`ratio_bits`] | opacity in steps of 1 / [`OPACITY_STEPS`], bits 0 to 9 and 10 to 19 |
///
/// | words 2, 3 | |
/// |---|---|
/// | 63, 62 | opacity, bits 21 and 20 |
/// | 61, 60 | which part of the quaternion is largest, of w, x, y, z |
/// | 59 to 0 | its other parts, 20 bits each from the lowest |
fn packed_shape(scales: [f32; 3], opacity: f32, rotation: [f32; 4]) -> [u32; 4] {
    let first = (1..3).fold(0, |best, k| if scales[k] > scales[best] { k } else { best });
    let ratio = |k: usize| ratio_bits(scales[(first + k) % 3], scales[first]);
    let opacity = (f64::from(opacity) * OPACITY_STEPS).round() as u32;
    let (part, others) = smallest_three(turned(rotation, first));
    let [a, b, c] = others.map(|v| (f64::from(v) * QUATERNION_STEPS).round() as i64 as u64 & 0xf_ffff);
    let rest = a | b << 20 | c << 40 | (part as u64) << 60 | u64::from(opacity >> 20) << 62;
    [
        ratio(1) << 10 | opacity & 0x3ff,
        ratio(2) << 10 | opacity >> 10 & 0x3ff,
        rest as u32,
        (rest >> 32) as u32,
    ]
}

/// The parts of a unit quaternion besides its largest are at most √½: 2¹⁹ − 1 steps and a sign.
pub const QUATERNION_STEPS: f64 = 524_287.0 * std::f64::consts::SQRT_2;

/// Steps of the opacity up to 1, in 22 bits: the 8-bit opacities of most scene formats stay exact.
pub const OPACITY_STEPS: f64 = 255.0 * 16_384.0;

/// The smallest code of a ratio: 2⁻³¹, as an f32 without its lowest six bits.
pub const FIRST_RATIO: u32 = 96 << 17;

/// `scale / largest` in 22 bits, 17 of them mantissa; 0 below 2⁻³¹.
fn ratio_bits(scale: f32, largest: f32) -> u32 {
    let ratio = if largest > 0.0 { scale / largest } else { 0.0 };
    ((ratio.to_bits() + (1 << 5)) >> 6).saturating_sub(FIRST_RATIO)
}

/// The rotation `q` with its axes permuted: axis `first` becomes the first one. A rotation by a third of a turn about
/// (1, 1, 1) is applied before `q`, as often as needed.
fn turned(q: [f32; 4], first: usize) -> [f32; 4] {
    (0..first).fold(q, |[w, x, y, z], _| {
        [w - x - y - z, w + x + y - z, w - x + y + z, w + x - y + z].map(|v| 0.5 * v)
    })
}

/// The index of the largest part of `q`, and the other parts of the same rotation with that part positive.
fn smallest_three(q: [f32; 4]) -> (usize, [f32; 3]) {
    let part = (1..4).fold(0, |best, k| if q[k].abs() > q[best].abs() { k } else { best });
    let sign = if q[part] < 0.0 { -1.0 } else { 1.0 };
    (part, [0, 1, 2].map(|k| sign * q[k + usize::from(k >= part)]))
}

/// Rows of `stride` coefficients as f16, each row padded to whole words.
fn sh_f16(sh: &[f32], stride: usize) -> Vec<u32> {
    let halves = stride.next_multiple_of(2);
    let mut packed = vec![0_u32; sh.len() / stride * halves / 2];
    let rows: &mut [u16] = bytemuck::cast_slice_mut(&mut packed);
    rows.par_chunks_mut(halves).zip(sh.par_chunks(stride)).for_each(|(to, from)| {
        // No scene has numbers beyond the range of f16.
        let to: &mut [f16] = bytemuck::cast_slice_mut(&mut to[..stride]);
        to.convert_from_f32_slice(from);
    });
    packed
}

#[cfg(test)]
mod tests {
    use gs3_compute::assert_layout;
    use gs3_scene::gaussians::MAX_SH;

    use super::*;

    #[test]
    fn layouts_are_those_of_the_shader() {
        let source = include_str!("scene.wgsl");
        assert_layout!(&[source], Page, PageUniform { first_chunk, chunks, gaussians, _pad });
        assert_layout!(&[source], Chunk, ChunkBounds { center, radius, largest_scale, _pad, _pad2, _pad3 });
    }

    /// The values that `scene_f16.wgsl` unpacks: scales, opacity, quaternion.
    fn unpacked(words: [u32; 4], largest: f32) -> ([f32; 3], f64, [f32; 4]) {
        let ratio = |word: u32| match word >> 10 {
            0 => 0.0,
            code => f32::from_bits((code + FIRST_RATIO) << 6),
        };
        let opacity = words[0] & 0x3ff | (words[1] & 0x3ff) << 10 | words[3] >> 30 << 20;
        let bits = u64::from(words[2]) | u64::from(words[3]) << 32;
        let other = |k: usize| ((bits << (44 - 20 * k)) as i64 >> 44) as f64 / QUATERNION_STEPS;
        let mut quaternion: Vec<f64> = (0..3).map(other).collect();
        let largest_part = (1.0 - quaternion.iter().map(|v| v * v).sum::<f64>()).max(0.0).sqrt();
        quaternion.insert((bits >> 60) as usize & 3, largest_part);
        let quaternion = [0, 1, 2, 3].map(|k| quaternion[k] as f32);
        (
            [1.0, ratio(words[0]), ratio(words[1])].map(|r| r * largest),
            f64::from(opacity) / OPACITY_STEPS,
            quaternion,
        )
    }

    /// Columns of the rotation matrix.
    fn axes([w, x, y, z]: [f32; 4]) -> [[f32; 3]; 3] {
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
            [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
            [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    }

    /// For every scale of the scene, and every axis and part of the quaternion as the largest.
    #[test]
    fn shapes_keep_axes_scales_and_opacity() {
        let mut state = 1_u32;
        let mut random = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        for i in 0..2000 {
            let unit = [1e-30, 1e-6, 0.01, 1.0, 3e4, 1e30][i % 6];
            let scales = [random(), random() * 1e-3, random() * 0.5].map(|s| s * unit);
            let scales = [0, 1, 2].map(|k| scales[(k + i) % 3]);
            let opacity = [0.0, 1.0, 1.0 / 255.0, random()][i / 3 % 4];
            let q = [0; 4].map(|_| random() - 0.5);
            let norm = q.iter().map(|v| v * v).sum::<f32>().sqrt();
            let rotation = q.map(|v| v / norm);
            let largest = scales.into_iter().fold(0.0, f32::max);
            let (actual, actual_opacity, turned) = unpacked(packed_shape(scales, opacity, rotation), largest);
            let expected = f64::from(opacity);
            assert!((actual_opacity - expected).abs() <= 1.2e-7, "{actual_opacity} {expected}");
            let first = scales.iter().position(|s| *s == largest).unwrap();
            for k in 0..3 {
                let expected = scales[(first + k) % 3];
                assert!((actual[k] - expected).abs() <= expected * 4e-6, "{actual:?} {scales:?}");
                let (actual, expected) = (axes(turned)[k], axes(rotation)[(first + k) % 3]);
                let off = [0, 1, 2].map(|c| (actual[c] - expected[c]).abs()).into_iter().fold(0.0, f32::max);
                assert!(off < 8e-6, "axis {k}: {actual:?} {expected:?}");
            }
        }
        for flat in [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 1e-30]] {
            let largest = flat.into_iter().fold(0.0, f32::max);
            let (scales, ..) = unpacked(packed_shape(flat, 0.5, [1.0, 0.0, 0.0, 0.0]), largest);
            assert_eq!(scales, [largest, 0.0, 0.0]);
        }
    }

    #[test]
    fn colors_are_halves_up_to_the_largest_that_a_scene_has() {
        let mut g = Gaussians::zeroed(3, 1);
        g.rotations[0] = vec![1.0; 3];
        g.scales[1][1] = 1e30;
        g.sh = (0..36).map(|k| k as f32 * 0.125 - 1.0).collect();
        (g.sh[0], g.sh[1]) = (MAX_SH, -MAX_SH);
        let packed = Packed::new(&g, 0, 3, ScenePrecision::F16);
        assert_eq!(packed.centers[1], [0.0, 0.0, 0.0, 1e30]);
        let sh: &[f16] = bytemuck::cast_slice(&packed.sh);
        assert!(sh.iter().zip(&g.sh).all(|(a, b)| a.to_f32() == *b));
    }

    #[test]
    fn odd_rows_are_padded() {
        let packed = sh_f16(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], 3);
        let halves: &[f16] = bytemuck::cast_slice(&packed);
        let values: Vec<f32> = halves.iter().map(|h| h.to_f32()).collect();
        assert_eq!(values, [1.0, 2.0, 3.0, 0.0, 4.0, 5.0, 6.0, 0.0]);
    }
}
