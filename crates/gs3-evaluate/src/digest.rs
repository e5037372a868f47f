//! Numbers that identify everything that results depend on. Different inputs have different numbers, except in 1 of
//! 2⁶⁴ cases.

use std::hash::{DefaultHasher, Hash, Hasher};

use gs3_scene::{Gaussians, Scene};
use rayon::prelude::*;

/// Bytes that a thread reads at a time: a fraction of a millisecond of work, so that tasks cost nothing.
const AT_ONCE: usize = 1 << 20;

/// Of anything small; the same in every process of this program.
pub fn of(value: &impl Hash) -> u64 {
    let mut hasher = DefaultHasher::new();
    value.hash(&mut hasher);
    hasher.finish()
}

/// Of bytes, on all cores.
pub fn of_bytes(bytes: &[u8]) -> u64 {
    let parts: Vec<u64> = bytes.par_chunks(AT_ONCE).map(|part| of(&part)).collect();
    of(&parts)
}

/// Of all that is rendered of a scene. Its file's name, length and time would say less: streamed scenes are many files,
/// and a scene that was written anew in the same second is another one.
pub fn of_scene(scene: &Scene) -> u64 {
    let Gaussians { means, scales, rotations, opacities, sh_degree, sh } = scene.gaussians();
    let planes = means.iter().chain(scales).chain(rotations).chain([opacities, sh]);
    let planes: Vec<u64> = planes.map(|plane| of_bytes(bytemuck::cast_slice(plane))).collect();
    of(&(planes, sh_degree, scene.opacity_mode() as u8, scene.details().near.to_bits()))
}
