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

/// How the scene lies in device memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ScenePrecision {
    /// Means in f32, the rest in 16 bits: 40 bytes a Gaussian of degree 0, 128 of degree 3.
    #[default]
    F16,
    /// All in f32, as the CPU has it: 60 bytes a Gaussian of degree 0, 240 of degree 3.
    F32,
}

impl ScenePrecision {
    /// Bytes of a Gaussian's scales, opacity and rotation.
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

/// Bytes sent after which the device is waited for, so that drivers need not hold the scene twice.
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
    scale_unit: f32,
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
    /// The page's buffers by the names that kernels have for them.
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

/// Uploads `gaussians` as `plan` says.
///
/// # Errors
/// [`GpuError`] if the device has no room for them.
pub fn upload(gpu: &Gpu, gaussians: &Gaussians, plan: &ScenePlan) -> Result<Vec<Page>, GpuError> {
    let unit = match plan.precision {
        ScenePrecision::F16 => scale_unit(gaussians),
        ScenePrecision::F32 => 1.0,
    };
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
            scale_unit: unit,
        };
        let sh_bytes = plan.precision.sh_bytes(plan.sh_degree);
        let shape_bytes = plan.precision.shape_bytes();
        let centers = gpu.buffer("centers", Use::Storage, count * 16)?;
        let shapes = gpu.buffer("shapes", Use::Storage, count * shape_bytes)?;
        let sh = gpu.buffer("sh", Use::Storage, count * sh_bytes)?;
        for first in (start..end).step_by(STEP) {
            let last = (first + STEP).min(end);
            let packed = Packed::new(gaussians, first, last, plan.precision, unit);
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

/// The power of two nearest to the geometric mean of the Gaussians' largest scales: divided by it they lie in the middle
/// of what f16 can hold, 2⁻¹⁴ to 2¹⁶ at full precision, whatever the scene's unit of length.
fn scale_unit(g: &Gaussians) -> f32 {
    let exponents = (0..g.len()).into_par_iter().filter_map(|i| {
        let largest = g.scale(i).into_iter().fold(0.0, f32::max);
        (largest > 0.0).then(|| f64::from(largest).log2())
    });
    let (sum, count) = exponents
        .fold(|| (0.0, 0_u64), |(s, n), e| (s + e, n + 1))
        .reduce(|| (0.0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
    // Within what f32 can hold along with its inverse.
    (sum / count.max(1) as f64).round().clamp(-100.0, 100.0).exp2() as f32
}

/// Gaussians as words of the device's buffers.
struct Packed {
    /// Mean and largest scale.
    centers: Vec<[f32; 4]>,
    shapes: Vec<u32>,
    sh: Vec<u32>,
}

impl Packed {
    fn new(g: &Gaussians, first: usize, last: usize, precision: ScenePrecision, unit: f32) -> Self {
        let range = first..last;
        match precision {
            ScenePrecision::F16 => {
                let shapes: Vec<_> = range.clone().into_par_iter().map(|i| shape_f16(g, i, unit)).collect();
                let centers = range.into_par_iter().zip(&shapes).map(|(i, shape)| {
                    let [x, y, z] = g.mean(i);
                    let scales = [shape[0] as u16, (shape[0] >> 16) as u16, shape[1] as u16];
                    let scales = scales.map(|bits| f16::from_bits(bits).to_f32() * unit);
                    [x, y, z, scales.into_iter().fold(0.0, f32::max)]
                });
                Self {
                    centers: centers.collect(),
                    sh: sh_f16(&g.sh[first * g.sh_stride()..last * g.sh_stride()], g.sh_stride()),
                    shapes: shapes.as_flattened().to_vec(),
                }
            }
            ScenePrecision::F32 => {
                let shape = |i: usize| {
                    let ([sx, sy, sz], [w, x, y, z]) = (g.scale(i), g.rotation(i));
                    [sx, sy, sz, g.opacities[i], w, x, y, z].map(f32::to_bits)
                };
                let center = |i: usize| {
                    let [x, y, z] = g.mean(i);
                    [x, y, z, g.scale(i).into_iter().fold(0.0, f32::max)]
                };
                let shapes: Vec<_> = range.clone().into_par_iter().map(shape).collect();
                Self {
                    centers: range.into_par_iter().map(center).collect(),
                    shapes: shapes.as_flattened().to_vec(),
                    sh: bytemuck::cast_slice(&g.sh[first * g.sh_stride()..last * g.sh_stride()]).to_vec(),
                }
            }
        }
    }
}

/// Scales as f16 in units of `unit`, opacity as 16-bit fixed point of [0, 1], the quaternion of [-1, 1]; see
/// `scene_f16.wgsl`.
fn shape_f16(g: &Gaussians, i: usize, unit: f32) -> [u32; 4] {
    let pair = |low: u16, high: u16| u32::from(low) | u32::from(high) << 16;
    let [sx, sy, sz] = g.scale(i).map(|s| f16::from_f32((s / unit).min(f16::MAX.to_f32())).to_bits());
    let opacity = (g.opacities[i] * 65535.0).round() as u16;
    let [w, x, y, z] = g.rotation(i).map(|v| (v * 32767.0).round() as i16 as u16);
    [pair(sx, sy), pair(sz, opacity), pair(w, x), pair(y, z)]
}

/// Rows of `stride` coefficients as f16, each row padded to whole words.
fn sh_f16(sh: &[f32], stride: usize) -> Vec<u32> {
    let halves = stride.next_multiple_of(2);
    let mut packed = vec![0_u32; sh.len() / stride * halves / 2];
    let rows: &mut [u16] = bytemuck::cast_slice_mut(&mut packed);
    rows.par_chunks_mut(halves).zip(sh.par_chunks(stride)).for_each(|(to, from)| {
        // Largest degree: 48 coefficients.
        let mut clamped = [0.0; 48];
        let clamped = &mut clamped[..stride];
        for (to, from) in clamped.iter_mut().zip(from) {
            *to = from.clamp(f16::MIN.to_f32(), f16::MAX.to_f32());
        }
        let to: &mut [f16] = bytemuck::cast_slice_mut(&mut to[..stride]);
        to.convert_from_f32_slice(clamped);
    });
    packed
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::layout::assert_layout;

    #[test]
    fn layouts_are_those_of_the_shader() {
        let source = include_str!("scene.wgsl");
        assert_layout!(source, Page, PageUniform { first_chunk, chunks, gaussians, scale_unit });
        assert_layout!(source, Chunk, ChunkBounds { center, radius, largest_scale, _pad, _pad2, _pad3 });
    }

    fn gaussians(scale: f32) -> Gaussians {
        let mut g = Gaussians::zeroed(3, 1);
        g.scales = [vec![scale; 3], vec![scale * 0.25, scale, 0.0], vec![scale * 1e-3; 3]];
        g.rotations = [vec![0.5; 3], vec![-0.5; 3], vec![0.5; 3], vec![-0.5; 3]];
        g.opacities = vec![1.0 / 255.0, 0.5, 1.0];
        g.sh = (0..36).map(|k| k as f32 * 0.125 - 1.0).collect();
        g
    }

    /// The scale's unit does not matter, and what 16 bits can hold exactly stays exact.
    #[test]
    fn packed_values_are_within_the_precision_of_their_formats() {
        for scale in [1e-6, 0.01, 1.0, 3e4, 1e9_f32] {
            let g = gaussians(scale);
            let unit = scale_unit(&g);
            assert_eq!(unit.log2().fract(), 0.0, "{unit} is a power of two");
            let packed = Packed::new(&g, 0, 3, ScenePrecision::F16, unit);
            for i in 0..3 {
                let words = &packed.shapes[4 * i..4 * i + 4];
                let halves = [words[0] as u16, (words[0] >> 16) as u16, words[1] as u16];
                for (bits, expected) in halves.into_iter().zip(g.scale(i)) {
                    let actual = f16::from_bits(bits).to_f32() * unit;
                    assert!((actual - expected).abs() <= expected * 5e-4, "{actual} {expected} {unit}");
                }
                let opacity = (words[1] >> 16) as f32 / 65535.0;
                assert!((opacity - g.opacities[i]).abs() < 8e-6, "{opacity}");
                assert_eq!(words[2] as u16 as i16, 16384);
                assert_eq!((words[3] >> 16) as u16 as i16, -16384);
                assert!(packed.centers[i][3] >= g.scale(i)[0] * 0.999);
            }
            let sh: &[f16] = bytemuck::cast_slice(&packed.sh);
            assert!(sh.iter().zip(&g.sh).all(|(a, b)| a.to_f32() == *b));
        }
    }

    #[test]
    fn outliers_are_clamped() {
        let mut g = gaussians(1.0);
        g.scales[0][1] = 1e30;
        g.sh[0] = 1e6;
        g.sh[1] = -1e6;
        let packed = Packed::new(&g, 0, 3, ScenePrecision::F16, 1.0);
        assert!(packed.centers.iter().flatten().all(|v| v.is_finite()));
        assert_eq!(packed.centers[1][3], 65504.0);
        let sh: &[f16] = bytemuck::cast_slice(&packed.sh);
        assert_eq!((sh[0].to_f32(), sh[1].to_f32()), (65504.0, -65504.0));
    }

    #[test]
    fn odd_rows_are_padded() {
        let packed = sh_f16(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], 3);
        let halves: &[f16] = bytemuck::cast_slice(&packed);
        let values: Vec<f32> = halves.iter().map(|h| h.to_f32()).collect();
        assert_eq!(values, [1.0, 2.0, 3.0, 0.0, 4.0, 5.0, 6.0, 0.0]);
    }
}
