//! Writing streamed SOG: a folder of data sets, and a tree over them in `lod-meta.json`.

use std::collections::HashSet;
use std::fs;
use std::io::{self, Write};
use std::path::Path;

use glam::{DVec3, Mat3, Quat, Vec3};
use gs3_files::write_atomically;
use rayon::prelude::*;
use serde_json::{Value, json};

use super::super::save::STREAMED_SOG;
use super::codebook::CODES;
use super::palette::Distinct;
use super::write::{GENERATOR, Means, Weights, encode};
use crate::gaussians::Gaussians;
use crate::scene::Scene;

/// Gaussians of a data set that has neighbours in space: at most two for each row of a palette, so that colours are close.
const NEIGHBOURS: usize = 1 << 17;

/// Most Gaussians of a data set that is kept: splat-transform puts about 512,000 into one, up to 548,560 in the captures. Players
/// still load such a scene part by part.
const MOST_OF_KEPT: usize = 600_000;

/// Most Gaussians of a leaf of the tree: what a player shows or leaves out at once. A leaf's entry in `lod-meta.json` takes
/// about 200 bytes, a hundredth of a byte for each of its Gaussians, which take about 20.
const LEAF: usize = 16_384;

/// How many standard deviations a Gaussian reaches: beyond 3 the rasterizer of Kerbl et al. draws nothing.
const EXTENT: f64 = 3.0;

/// Writes `scene` into `folder`; one level of detail. With `chunk` a data set has neighbours in space, at most `chunk` of them.
/// Without `chunk`, a scene from SOG keeps its data sets ([`kept_data_sets`]). [`STREAMED_SOG`] comes last: without
/// [`STREAMED_SOG`] the folder is no scene.
pub(in super::super) fn write_streamed(scene: &Scene, folder: &Path, chunk: Option<usize>) -> io::Result<()> {
    let count = scene.gaussians().len();
    let mut all: Vec<u32> = (0..count as u32).collect();
    let kept = if chunk.is_none() { kept_data_sets(scene.gaussians()) } else { None };
    let (runs, chunk) = match kept {
        Some(runs) => (runs, MOST_OF_KEPT),
        None => (vec![count], chunk.unwrap_or(NEIGHBOURS)),
    };
    let mut writer =
        Writer { scene, folder, chunk, weights: Weights::new(scene.gaussians()), names: Vec::new() };
    let mut rest = all.as_mut_slice();
    let mut trees = Vec::new();
    for run in runs {
        let (members, after) = rest.split_at_mut(run);
        trees.push(writer.data_sets(members)?);
        rest = after;
    }
    let (tree, _) = inner(trees);
    let meta = json!({
        "version": 1,
        "asset": { "generator": GENERATOR },
        "count": all.len(),
        "counts": [all.len()],
        "lodLevels": 1,
        "filenames": writer.names,
        "tree": tree,
    });
    write_file(&folder.join(STREAMED_SOG), &serde_json::to_vec(&meta)?)
}

/// Lengths of the data sets that the Gaussians came from: of runs, in the order of the Gaussians, that a palette and codebooks each
/// hold exactly. `None` if they would be more data sets than those of neighbours, as of scenes of other formats, or if there is no
/// palette to keep.
fn kept_data_sets(gaussians: &Gaussians) -> Option<Vec<usize>> {
    if gaussians.sh_degree == 0 {
        return None;
    }
    let most = gaussians.len().div_ceil(NEIGHBOURS).next_power_of_two();
    let (mut runs, mut start) = (Vec::new(), 0);
    let mut exact = Exact::default();
    for i in 0..gaussians.len() {
        if !exact.holds(gaussians, i) {
            runs.push(i - start);
            if runs.len() >= most {
                return None;
            }
            (start, exact) = (i, Exact::default());
            // One Gaussian alone always fits: its numbers are fewer than a codebook has.
            exact.holds(gaussians, i);
        }
    }
    runs.push(gaussians.len() - start);
    Some(runs)
}

/// What the palette and the three codebooks of a data set must hold so that nothing is lost.
#[derive(Default)]
struct Exact<'a> {
    rows: Distinct<'a>,
    /// Of scales, of degree 0, of the other harmonics: bits of numbers.
    codes: [HashSet<u32>; 3],
}

impl<'a> Exact<'a> {
    /// Adds Gaussian `i`. Whether a data set holds all Gaussians added.
    fn holds(&mut self, gaussians: &'a Gaussians, i: usize) -> bool {
        let (sh0, rest) = gaussians.sh_of(i).split_at(3);
        let known = self.rows.len();
        if self.rows.label(rest).is_none() {
            return false;
        }
        let of_row = if self.rows.len() > known { rest } else { &[] };
        self.codes.iter_mut().zip([&gaussians.scale(i), sh0, of_row]).all(|(codes, values)| {
            codes.extend(values.iter().map(|value| value.to_bits()));
            codes.len() <= CODES
        })
    }
}

struct Writer<'a> {
    scene: &'a Scene,
    folder: &'a Path,
    chunk: usize,
    weights: Weights<'a>,
    /// The `meta.json` of each data set, as `lod-meta.json` names them.
    names: Vec<String>,
}

impl Writer<'_> {
    /// The tree of the Gaussians with the indices `members`, and its bound: data sets of neighbours, and leaves within each.
    fn data_sets(&mut self, members: &mut [u32]) -> io::Result<(Value, Bound)> {
        if members.len() > self.chunk {
            let (left, right) = self.split(members);
            return Ok(inner(vec![self.data_sets(left)?, self.data_sets(right)?]));
        }
        let mut order = Vec::with_capacity(members.len());
        let tree = self.leaves(members, &mut order);
        let name = format!("0_{}", self.names.len());
        self.write_data_set(&self.folder.join(&name), &order)?;
        self.names.push(format!("{name}/meta.json"));
        Ok(tree)
    }

    /// The tree of the `members` within the next data set, and its bound. Its Gaussians follow those in `order`.
    fn leaves(&self, members: &mut [u32], order: &mut Vec<u32>) -> (Value, Bound) {
        if members.len() > LEAF {
            let (left, right) = self.split(members);
            return inner(vec![self.leaves(left, order), self.leaves(right, order)]);
        }
        let run = json!({ "file": self.names.len(), "offset": order.len(), "count": members.len() });
        order.extend(Means::new(self.scene, members).morton_order(members));
        let bound = Bound::of(self.scene, members);
        (json!({ "bound": bound.json(), "lods": { "0": run } }), bound)
    }

    /// The files of one data set: images, then `meta.json`.
    fn write_data_set(&self, folder: &Path, order: &[u32]) -> io::Result<()> {
        fs::create_dir_all(folder)?;
        let meta = encode(self.scene, &self.weights, order, &mut |name, image| {
            write_file(&folder.join(name), &image)
        })?;
        write_file(&folder.join("meta.json"), &meta)
    }

    /// Two halves, on both sides of the median along the longest axis.
    fn split<'m>(&self, members: &'m mut [u32]) -> (&'m mut [u32], &'m mut [u32]) {
        let means = &self.scene.gaussians().means;
        let extent = |axis: usize| {
            let values = || members.par_iter().map(|i| means[axis][*i as usize]);
            let [low, high] = [values().reduce_with(f32::min), values().reduce_with(f32::max)];
            high.unwrap_or_default() - low.unwrap_or_default()
        };
        let extents = [0, 1, 2].map(extent);
        let longest = (0..3).max_by(|a, b| extents[*a].total_cmp(&extents[*b])).unwrap_or_default();
        let plane = &means[longest];
        let middle = members.len() / 2;
        // Of equal ones the first come first, so that a scene has one tree.
        members.select_nth_unstable_by(middle, |a, b| {
            plane[*a as usize].total_cmp(&plane[*b as usize]).then(a.cmp(b))
        });
        members.split_at_mut(middle)
    }
}

/// A node above others; one alone is the tree.
fn inner(mut children: Vec<(Value, Bound)>) -> (Value, Bound) {
    if children.len() == 1 {
        return children.remove(0);
    }
    let bound = children.iter().fold(Bound::NONE, |all, (_, bound)| all.union(*bound));
    let nodes: Vec<Value> = children.into_iter().map(|(node, _)| node).collect();
    (json!({ "bound": bound.json(), "children": nodes }), bound)
}

/// The box along the axes that contains Gaussians with their extents, world units.
#[derive(Clone, Copy, Debug)]
struct Bound {
    low: DVec3,
    high: DVec3,
}

impl Bound {
    const NONE: Self = Self { low: DVec3::INFINITY, high: DVec3::NEG_INFINITY };

    fn union(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    fn of(scene: &Scene, members: &[u32]) -> Self {
        let (gaussians, origin) = (scene.gaussians(), scene.details().origin);
        let bound = members.iter().map(|i| *i as usize).fold(Self::NONE, |bound, i| {
            let [w, x, y, z] = gaussians.rotation(i);
            // A row of the rotation times the scales: its length is the standard deviation along that axis.
            let axes =
                Mat3::from_quat(Quat::from_xyzw(x, y, z, w)) * Mat3::from_diagonal(gaussians.scale(i).into());
            let deviations =
                axes.transpose().to_cols_array_2d().map(|row| f64::from(Vec3::from(row).length()));
            let reach = EXTENT * DVec3::from(deviations);
            let mean = Vec3::from(gaussians.mean(i)).as_dvec3() + origin;
            bound.union(Self { low: mean - reach, high: mean + reach })
        });
        // A scene without Gaussians has one empty leaf.
        if members.is_empty() { Self { low: origin, high: origin } } else { bound }
    }

    fn json(self) -> Value {
        json!({ "min": self.low.to_array(), "max": self.high.to_array() })
    }
}

fn write_file(path: &Path, bytes: &[u8]) -> io::Result<()> {
    write_atomically(path, |writer| writer.write_all(bytes))
}
