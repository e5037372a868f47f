//! Levels of detail by error and a budget: which level each leaf of a streamed scene gets.
//!
//! Every leaf starts at its smallest level. The step to a finer level that removes most error for each Gaussian it adds,
//! weighted with the pixels that the leaf covers, is taken first, until the next one does not fit. PlayCanvas's engine (2.22)
//! chooses so, too.

use std::collections::BinaryHeap;

use glam::DVec3;

use super::meta::Node;
use crate::camera::Camera;

/// What [`super::super::LoadOptions::budget`] asks for.
#[derive(Clone, Debug, PartialEq)]
pub struct Budget {
    /// Most Gaussians of the leaves together. The environment comes on top, and so does what the smallest levels have more.
    pub gaussians: u64,
    /// From where the scene will be seen, in right-down-front and the file's frame of reference. Without cameras all leaves
    /// are seen alike, by their size.
    pub cameras: Vec<Camera>,
}

/// A level of a leaf that is worth its Gaussians: no smaller one has less error.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Step {
    level: u32,
    count: u64,
    error: f64,
}

/// The level of each leaf under `root`, in the order of [`leaves`]; `None` of a leaf without levels.
pub(super) fn levels(root: &Node, budget: &Budget, to_rdf: glam::DMat3) -> Vec<Option<u32>> {
    let leaves = leaves(root);
    let steps: Vec<Vec<Step>> = leaves.iter().map(|leaf| worthwhile(leaf)).collect();
    let coverage: Vec<f64> = leaves.iter().map(|leaf| covered(leaf, &budget.cameras, to_rdf)).collect();
    let gain = |leaf: usize, taken: usize| {
        let [from, to] = [steps[leaf][taken], *steps[leaf].get(taken + 1)?];
        Some(coverage[leaf] * (from.error - to.error) / (to.count - from.count) as f64)
    };
    let mut taken = vec![0; leaves.len()];
    let mut spent: u64 = steps.iter().filter_map(|steps| steps.first()).map(|step| step.count).sum();
    // The largest gain first; of equal ones the leaf that comes first.
    let entry = |gain: f64, leaf: usize| (Gain(gain), std::cmp::Reverse(leaf));
    let mut next: BinaryHeap<_> =
        (0..leaves.len()).filter_map(|leaf| Some(entry(gain(leaf, 0)?, leaf))).collect();
    while let Some((_, std::cmp::Reverse(leaf))) = next.pop() {
        let added = steps[leaf][taken[leaf] + 1].count - steps[leaf][taken[leaf]].count;
        if spent + added > budget.gaussians {
            break;
        }
        spent += added;
        taken[leaf] += 1;
        next.extend(gain(leaf, taken[leaf]).map(|gain| entry(gain, leaf)));
    }
    steps.iter().zip(taken).map(|(steps, taken)| Some(steps.get(taken)?.level)).collect()
}

/// A gain in the order of numbers.
#[derive(PartialEq)]
struct Gain(f64);

impl Eq for Gain {}

impl PartialOrd for Gain {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Gain {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0)
    }
}

/// The nodes with levels, depth first.
pub(super) fn leaves(root: &Node) -> Vec<&Node> {
    let mut found = Vec::new();
    let mut left = vec![root];
    while let Some(node) = left.pop() {
        if !node.lods.is_empty() {
            found.push(node);
        }
        left.extend(node.children.iter().rev());
    }
    found
}

/// The levels of `leaf` from the smallest to the finest, without those that another one beats: by less error for fewer
/// Gaussians, or by two neighbours with more error removed by each Gaussian.
fn worthwhile(leaf: &Node) -> Vec<Step> {
    let finest = leaf.lods.values().map(|run| run.count).max().unwrap_or(0).max(1) as f64;
    let mut levels: Vec<Step> = leaf
        .lods
        .iter()
        .map(|(&level, run)| {
            let stated = leaf.errors.get(level as usize).copied().flatten();
            // Where the file has no errors: what halving the number loses is one unit, as in PlayCanvas's engine.
            let derived = || (finest / run.count.max(1) as f64).ln();
            let error = stated.filter(|error| error.is_finite() && *error >= 0.0).unwrap_or_else(derived);
            Step { level, count: run.count as u64, error }
        })
        .collect();
    levels.sort_by(|a, b| a.count.cmp(&b.count).then(a.error.total_cmp(&b.error)));
    let mut steps: Vec<Step> = Vec::with_capacity(levels.len());
    for level in levels {
        if steps.last().is_some_and(|last| level.error >= last.error || level.count == last.count) {
            continue;
        }
        // Error removed per Gaussian falls from step to step: what breaks the rule is passed over.
        while let [.., a, b] = steps[..]
            && slope(a, b) <= slope(b, level)
        {
            steps.pop();
        }
        steps.push(level);
    }
    steps
}

fn slope(from: Step, to: Step) -> f64 {
    (from.error - to.error) / (to.count - from.count) as f64
}

/// Pixels that the leaf covers in the mean of the cameras' images. A leaf that no camera sees has a millionth of a pixel: what
/// is left of the budget goes to the largest of them.
fn covered(leaf: &Node, cameras: &[Camera], to_rdf: glam::DMat3) -> f64 {
    let Some(bound) = &leaf.bound else { return 1.0 };
    let [low, high] = [bound.min, bound.max].map(DVec3::from);
    let (center, radius) = (to_rdf * low.midpoint(high), 0.5 * (high - low).length());
    let radius = if radius.is_finite() { radius } else { 0.0 };
    if cameras.is_empty() {
        return radius * radius;
    }
    let pixels: f64 = cameras.iter().map(|camera| pixels_of(camera, center, radius)).sum();
    (pixels / cameras.len() as f64).max(1e-6 * radius / (1.0 + radius))
}

/// Pixels of the camera's image that a ball covers, at most all; none where the ball is outside the image.
fn pixels_of(camera: &Camera, center: DVec3, radius: f64) -> f64 {
    let lens = camera.intrinsics();
    let [width, height] = [f64::from(camera.width()), f64::from(camera.height())];
    let seen = camera.view_from_world().transform_point3(center);
    let distance = seen.length();
    if distance <= radius {
        return width * height;
    }
    if seen.z <= -radius {
        return 0.0;
    }
    // The disc that the ball's silhouette would be in the image's centre, and where that centre is.
    let disc = (lens.fx * lens.fy).sqrt() * radius / (distance * distance - radius * radius).sqrt();
    let z = seen.z.max(1e-3 * distance);
    let at = [lens.fx * seen.x / z + lens.cx, lens.fy * seen.y / z + lens.cy];
    let is_outside =
        [(at[0], width), (at[1], height)].iter().any(|(at, side)| *at < -disc || *at > side + disc);
    if is_outside { 0.0 } else { (std::f64::consts::PI * disc * disc).min(width * height) }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use glam::{DAffine3, DMat3};

    use super::super::meta::{Bound, Run};
    use super::*;
    use crate::camera::Intrinsics;

    fn leaf(x: f64, counts: &[usize], errors: &[f64]) -> Node {
        let run = |&count: &usize| Run { file: 0, offset: 0, count };
        Node {
            children: Vec::new(),
            lods: counts
                .iter()
                .map(run)
                .enumerate()
                .map(|(k, run)| (k as u32, run))
                .collect::<BTreeMap<_, _>>(),
            bound: Some(Bound { min: [x - 1.0, -1.0, 9.0], max: [x + 1.0, 1.0, 11.0] }),
            errors: errors.iter().copied().map(Some).collect(),
        }
    }

    fn root(children: Vec<Node>) -> Node {
        Node { children, lods: BTreeMap::new(), bound: None, errors: Vec::new() }
    }

    fn chosen(root: &Node, gaussians: u64, cameras: Vec<Camera>) -> Vec<u32> {
        levels(root, &Budget { gaussians, cameras }, DMat3::IDENTITY)
            .into_iter()
            .map(|level| level.unwrap())
            .collect()
    }

    #[test]
    fn the_budget_goes_where_it_removes_most_error() {
        // The second leaf loses ten times as much by its coarser level.
        let tree = root(vec![leaf(0.0, &[100, 50], &[0.0, 0.1]), leaf(3.0, &[100, 50], &[0.0, 1.0])]);
        assert_eq!(chosen(&tree, 0, vec![]), [1, 1]);
        assert_eq!(chosen(&tree, 149, vec![]), [1, 1]);
        assert_eq!(chosen(&tree, 150, vec![]), [1, 0]);
        assert_eq!(chosen(&tree, 200, vec![]), [0, 0]);
    }

    #[test]
    fn leaves_in_view_and_near_come_first() {
        let tree = root(vec![leaf(0.0, &[100, 50], &[]), leaf(40.0, &[100, 50], &[])]);
        let camera = |x: f64| {
            let pose = DAffine3::from_translation(DVec3::new(-x, 0.0, 0.0));
            Camera::new(pose, Intrinsics::from_fov_y(100, 100, 0.5)).unwrap()
        };
        assert_eq!(chosen(&tree, 150, vec![camera(0.0)]), [0, 1]);
        assert_eq!(chosen(&tree, 150, vec![camera(40.0)]), [1, 0]);
        // Of both cameras, the one that is nearer counts more.
        let back = |x: f64, z: f64| {
            let pose = DAffine3::from_translation(DVec3::new(-x, 0.0, z));
            Camera::new(pose, Intrinsics::from_fov_y(100, 100, 0.5)).unwrap()
        };
        assert_eq!(chosen(&tree, 150, vec![back(0.0, 50.0), back(40.0, 0.0)]), [1, 0]);
    }

    #[test]
    fn levels_that_others_beat_are_passed_over() {
        let steps = |counts: &[usize], errors: &[f64]| {
            worthwhile(&leaf(0.0, counts, errors)).iter().map(|step| step.level).collect::<Vec<_>>()
        };
        // Level 1 has more Gaussians than level 2 and more error.
        assert_eq!(steps(&[100, 60, 50], &[0.0, 0.5, 0.4]), [2, 0]);
        // Level 1 removes less a Gaussian than the step from 2 to 0.
        assert_eq!(steps(&[100, 90, 50], &[0.0, 0.9, 1.0]), [2, 0]);
        assert_eq!(steps(&[100, 60, 50], &[0.0, 0.1, 1.0]), [2, 1, 0]);
        // Without errors: halves lose alike, so each costs twice as much as the one before.
        assert_eq!(steps(&[100, 50, 25], &[]), [2, 1, 0]);
    }
}
