//! Writing PlayCanvas' compressed PLY: chunks of 256 neighbours with their bounds, 16 bytes a Gaussian within them, and
//! a byte for each value of the higher spherical harmonics.

use std::io::{self, Write};

use rayon::prelude::*;

use super::super::activation::log_scale;
use super::super::morton;
use super::super::quaternion::without_largest;
use super::super::rows::write_rows;
use super::compressed::CHUNK;
use super::write::comments;
use crate::gaussians::{Gaussians, SH_C0};
use crate::scene::Scene;

/// Logarithms of scales lie within this; smaller and larger ones are cut, as the format's own programs do.
const LOG_SCALES: [f32; 2] = [-20.0, 20.0];

/// Coefficients of degree 1 and above lie within ± this.
const SH_RANGE: f32 = 4.0;

/// Bounds of position, log scale and colour, `[quantity][min, max][axis]`.
type Bounds = [[[f32; 3]; 2]; 3];

/// Writes `scene` in Morton order. Positions of the file's frame are rounded to f32 where the scene has an origin.
pub(in super::super) fn write(scene: &Scene, writer: &mut impl Write) -> io::Result<()> {
    let gaussians = scene.gaussians();
    let order = morton_order(scene);
    let values = |i: usize| values(scene, i);
    let bounds: Vec<Bounds> = order
        .par_chunks(CHUNK)
        .map(|chunk| {
            let mut bounds = [[[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]]; 3];
            for i in chunk {
                for (bounds, value) in bounds.iter_mut().zip(values(*i as usize)) {
                    for axis in 0..3 {
                        bounds[0][axis] = bounds[0][axis].min(value[axis]);
                        bounds[1][axis] = bounds[1][axis].max(value[axis]);
                    }
                }
            }
            bounds
        })
        .collect();
    let rest = gaussians.sh_stride() - 3;
    writer.write_all(header(scene, bounds.len(), rest).as_bytes())?;
    write_rows(writer, bounds.len(), 72, |c, row| {
        for (bytes, value) in
            row.as_chunks_mut::<4>().0.iter_mut().zip(bounds[c].as_flattened().as_flattened())
        {
            *bytes = value.to_le_bytes();
        }
    })?;
    write_rows(writer, order.len(), 16, |k, row| {
        let i = order[k] as usize;
        let [position, scale, color] = values(i);
        let [of_position, of_scale, of_color] = &bounds[k / CHUNK];
        let unit = |value: f32, bounds: &[[f32; 3]; 2], axis: usize| {
            let extent = bounds[1][axis] - bounds[0][axis];
            if extent > 0.0 { (value - bounds[0][axis]) / extent } else { 0.0 }
        };
        let three = |value: [f32; 3], bounds| {
            let [x, y, z] = [0, 1, 2].map(|axis| unit(value[axis], bounds, axis));
            bits(x, 11) << 21 | bits(y, 10) << 11 | bits(z, 11)
        };
        let [r, g, b] = [0, 1, 2].map(|c| bits(unit(color[c], of_color, c), 8));
        let opacity = bits(gaussians.opacities[i], 8);
        let words = [
            three(position, of_position),
            rotation(gaussians.rotation(i)),
            three(scale, of_scale),
            r << 24 | g << 16 | b << 8 | opacity,
        ];
        for (bytes, word) in row.as_chunks_mut::<4>().0.iter_mut().zip(words) {
            *bytes = word.to_le_bytes();
        }
    })?;
    if rest > 0 {
        write_rows(writer, order.len(), rest, |k, row| {
            let sh = gaussians.sh_of(order[k] as usize);
            for (j, byte) in row.iter_mut().enumerate() {
                // Channel-major, unlike in memory.
                let value = sh[3 + j % (rest / 3) * 3 + j / (rest / 3)];
                *byte = ((value / (2.0 * SH_RANGE) + 0.5) * 256.0).clamp(0.0, 255.0) as u8;
            }
        })?;
    }
    Ok(())
}

/// Whether coefficients of Gaussian `i` are cut to [`SH_RANGE`].
pub(in super::super) fn is_sh_cut(gaussians: &Gaussians, i: usize) -> bool {
    gaussians.sh_of(i)[3..].iter().any(|value| value.abs() > SH_RANGE)
}

/// The position of Gaussian `i` in the file's frame, along one axis.
fn position(scene: &Scene, axis: usize, i: usize) -> f32 {
    (f64::from(scene.gaussians().means[axis][i]) + scene.details().origin[axis]) as f32
}

/// Position, log scale and colour.
fn values(scene: &Scene, i: usize) -> [[f32; 3]; 3] {
    let gaussians = scene.gaussians();
    let sh = gaussians.sh_of(i);
    [
        [0, 1, 2].map(|axis| position(scene, axis, i)),
        gaussians.scale(i).map(|scale| log_scale(scale).clamp(LOG_SCALES[0], LOG_SCALES[1])),
        [0, 1, 2].map(|c| sh[c] * SH_C0 + 0.5),
    ]
}

fn morton_order(scene: &Scene) -> Vec<u32> {
    let count = scene.gaussians().len();
    let bounds = [0, 1, 2].map(|axis| {
        let bound = |pick: fn(f32, f32) -> f32| {
            (0..count).into_par_iter().map(|i| position(scene, axis, i)).reduce_with(pick).unwrap_or_default()
        };
        [bound(f32::min), bound(f32::max)].map(f64::from)
    });
    morton::order(count, |i| {
        std::array::from_fn(|axis| {
            let [low, high] = bounds[axis];
            let share = (f64::from(position(scene, axis, i)) - low) / (high - low).max(f64::MIN_POSITIVE);
            (share * 65_535.0) as u16
        })
    })
}

/// `unit` from 0 to 1 in `count` bits.
fn bits(unit: f32, count: u32) -> u32 {
    let largest = (1u32 << count) - 1;
    ((unit * largest as f32).round().max(0.0) as u32).min(largest)
}

/// The largest component's index, then the others within ±√½, 10 bits each.
fn rotation(quaternion: [f32; 4]) -> u32 {
    let (largest, others) = without_largest(quaternion);
    others.iter().fold(largest as u32, |packed, value| {
        packed << 10 | bits(value * std::f32::consts::FRAC_1_SQRT_2 + 0.5, 10)
    })
}

fn header(scene: &Scene, chunks: usize, rest: usize) -> String {
    let mut header = String::from("ply\nformat binary_little_endian 1.0\n") + &comments(scene);
    header += &format!("element chunk {chunks}\n");
    for names in [["x", "y", "z"], ["scale_x", "scale_y", "scale_z"], ["r", "g", "b"]] {
        for bound in ["min", "max"] {
            for name in names {
                header += &format!("property float {bound}_{name}\n");
            }
        }
    }
    let count = scene.gaussians().len();
    header += &format!("element vertex {count}\n");
    for name in ["position", "rotation", "scale", "color"] {
        header += &format!("property uint packed_{name}\n");
    }
    if rest > 0 {
        header += &format!("element sh {count}\n");
        for i in 0..rest {
            header += &format!("property uchar f_rest_{i}\n");
        }
    }
    header + "end_header\n"
}
