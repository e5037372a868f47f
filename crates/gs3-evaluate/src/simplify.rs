//! Fewer Gaussians, chosen by their contributions to the images of given cameras: Mini-Splatting (Fang and Wang 2024)
//! and Speedy-Splat (Hanson et al. 2025), without the training that follows in both.
//!
//! Views are added up to [`Scores`]. [`sample`] or [`highest`] choose from the scores; [`simplify`] does everything.

use std::fmt;
use std::sync::Arc;

use gs3::neural::Random;
use gs3_raster::{Culling, Importance, RasterError, RasterSettings, Rasterizer};
use gs3_scene::{Camera, Scene, SceneError};

/// By what Gaussians are chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Criterion {
    /// A random choice, each Gaussian with a chance proportional to its importance.
    MiniSplatting {
        /// What a view adds to the importance.
        setting: Setting,
        /// Of the sampled Gaussians only the most important are kept, as few as hold this share of their importance;
        /// in `(0, 1]`, 0.99 in the publication.
        share: f64,
        /// Seed of the choice.
        seed: u64,
    },
    /// Those that the image reacts to most.
    SpeedySplat,
}

/// What Mini-Splatting's importance adds up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Setting {
    /// The blending weights.
    Indoor,
    /// The mean blending weight per pixel, in views where some pixel shows the Gaussian most: near and far count alike.
    Outdoor,
}

/// Why a scene is not simplified.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SimplifyError {
    /// The fraction to keep is not a fraction.
    #[error("keep: expected a number above 0 and at most 1, found {actual}")]
    Keep {
        /// The value found.
        actual: f64,
    },
    /// The share of importance is not a share.
    #[error("mass: expected a number above 0 and at most 1, found {actual}")]
    Share {
        /// The value found.
        actual: f64,
    },
    /// The cameras show nothing to choose by.
    #[error("cameras: expected at least 1 of {gaussians} Gaussians to be seen by {cameras} cameras, found 0")]
    NothingSeen {
        /// Number of Gaussians in the scene.
        gaussians: usize,
        /// Number of cameras.
        cameras: usize,
    },
    /// A setting is out of range.
    #[error(transparent)]
    Raster(#[from] RasterError),
    /// The Gaussians left do not make a scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
}

/// Keeps the fraction `keep` of the Gaussians of `scene`, chosen by `criterion` on what `cameras` see with `settings`,
/// in their order. By [`Criterion::MiniSplatting`] it can be fewer: what is never dominant in a pixel is never kept.
///
/// `on_view` is called with the number of views done.
///
/// # Errors
/// [`SimplifyError`] if a number is out of range or the cameras see nothing.
pub fn simplify(
    scene: &Arc<Scene>,
    cameras: &[Camera],
    settings: &RasterSettings,
    criterion: Criterion,
    keep: f64,
    on_view: &mut dyn FnMut(usize),
) -> Result<Scene, SimplifyError> {
    if !(keep > 0.0 && keep <= 1.0) {
        return Err(SimplifyError::Keep { actual: keep });
    }
    if let Criterion::MiniSplatting { share, .. } = criterion
        && !(share > 0.0 && share <= 1.0)
    {
        return Err(SimplifyError::Share { actual: share });
    }
    let gaussians = scene.gaussians().len();
    let mut rasterizer = Rasterizer::new(scene.clone(), Culling::AccuTile);
    let mut scores = Scores::zeroed(gaussians);
    let mut view = Importance::zeroed(gaussians);
    for (i, camera) in cameras.iter().enumerate() {
        view.clear();
        rasterizer.importance(camera, settings, &mut view)?;
        scores.add(criterion, &view);
        on_view(i + 1);
    }
    let scores = scores.finish(criterion);
    if !scores.iter().any(|&score| score > 0.0) {
        return Err(SimplifyError::NothingSeen { gaussians, cameras: cameras.len() });
    }
    let count = ((keep * gaussians as f64).round() as usize).clamp(1, gaussians);
    let kept = match criterion {
        Criterion::MiniSplatting { share, seed, .. } => most_of(&scores, sample(&scores, count, seed), share),
        Criterion::SpeedySplat => highest(&scores, count),
    };
    let mut is_kept = vec![false; gaussians];
    for i in kept {
        is_kept[i] = true;
    }
    let mut left = scene.gaussians().clone();
    left.retain(|_, i| is_kept[i]);
    Ok(Scene::new(left, scene.opacity_mode())?.with_details(scene.details().clone()))
}

/// Scores of a scene's Gaussians, added up over views; each array is `[N]`.
pub struct Scores {
    scores: Vec<f64>,
    was_dominant: Vec<bool>,
}

impl fmt::Debug for Scores {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Scores").field("gaussians", &self.scores.len()).finish_non_exhaustive()
    }
}

impl Scores {
    /// No view yet.
    #[must_use]
    pub fn zeroed(count: usize) -> Self {
        Self { scores: vec![0.0; count], was_dominant: vec![false; count] }
    }

    /// Adds the statistics of one view.
    pub fn add(&mut self, criterion: Criterion, view: &Importance) {
        for (i, (score, was_dominant)) in self.scores.iter_mut().zip(&mut self.was_dominant).enumerate() {
            let is_dominant = view.dominant[i] > 0;
            *was_dominant |= is_dominant;
            *score += match criterion {
                Criterion::MiniSplatting { setting: Setting::Indoor, .. } => view.weight[i],
                Criterion::MiniSplatting { setting: Setting::Outdoor, .. } if is_dominant => {
                    view.weight[i] / view.pixels[i] as f64
                }
                Criterion::MiniSplatting { setting: Setting::Outdoor, .. } => 0.0,
                Criterion::SpeedySplat => view.sensitivity[i],
            };
        }
    }

    /// The scores, none negative. By Mini-Splatting what was never dominant has none.
    #[must_use]
    pub fn finish(mut self, criterion: Criterion) -> Vec<f64> {
        for (score, was_dominant) in self.scores.iter_mut().zip(self.was_dominant) {
            let is_out = matches!(criterion, Criterion::MiniSplatting { .. }) && !was_dominant;
            // Colours beyond all measure may have overflowed to NaN, which `max` turns into 0.
            *score = if is_out { 0.0 } else { score.max(0.0) };
        }
        self.scores
    }
}

/// `count` indices drawn without replacement, each draw with chances proportional to `scores`; fewer where fewer scores
/// are positive. Ascending, and the same for the same seed.
///
/// The `count` smallest of exponential variables with rates `scores` are such a draw (Efraimidis and Spirakis 2006).
#[must_use]
pub fn sample(scores: &[f64], count: usize, seed: u64) -> Vec<usize> {
    // One output of the generator scatters neighbouring seeds over all states.
    let mut random = Random::new(Random::new(seed).next_bits());
    let arrivals = scores.iter().enumerate().map(|(i, score)| (-uniform(&mut random).ln() / score, i));
    first(arrivals.filter(|(_, i)| scores[*i] > 0.0).collect(), count)
}

/// Indices of the `count` highest `scores`, ascending. Of equal scores the first are taken.
#[must_use]
pub fn highest(scores: &[f64], count: usize) -> Vec<usize> {
    first(scores.iter().enumerate().map(|(i, score)| (-score, i)).collect(), count)
}

/// The smallest set of `indices` with scores that sum to at least `share` of all their scores, ascending.
#[must_use]
pub fn most_of(scores: &[f64], mut indices: Vec<usize>, share: f64) -> Vec<usize> {
    if share >= 1.0 {
        return indices;
    }
    let wanted = share * indices.iter().map(|&i| scores[i]).sum::<f64>();
    indices.sort_unstable_by(|&a, &b| scores[b].total_cmp(&scores[a]).then(a.cmp(&b)));
    let mut held = 0.0;
    let enough = indices.iter().position(|&i| {
        held += scores[i];
        held >= wanted
    });
    indices.truncate(enough.map_or(indices.len(), |last| last + 1));
    indices.sort_unstable();
    indices
}

/// Indices of the `count` smallest keys, ascending; equal keys by index.
fn first(mut keyed: Vec<(f64, usize)>, count: usize) -> Vec<usize> {
    if count < keyed.len() {
        keyed.select_nth_unstable_by(count, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        keyed.truncate(count);
    }
    let mut indices: Vec<usize> = keyed.into_iter().map(|(_, i)| i).collect();
    indices.sort_unstable();
    indices
}

/// Uniform in `(0, 1)`, never 0, because the logarithm of 0 is infinite. It uses the upper 53 bits, which an f64
/// holds exactly.
fn uniform(random: &mut Random) -> f64 {
    ((random.next_bits() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    const INDOOR: Criterion = Criterion::MiniSplatting { setting: Setting::Indoor, share: 1.0, seed: 0 };
    const OUTDOOR: Criterion = Criterion::MiniSplatting { setting: Setting::Outdoor, share: 1.0, seed: 0 };

    #[test]
    fn scores_follow_the_published_rules() {
        // Gaussian 0 is dominant in view 0 only, 1 in both, 2 in none.
        let views = [
            Importance {
                weight: vec![6.0, 2.0, 9.0],
                pixels: vec![12, 8, 10],
                dominant: vec![3, 1, 0],
                sensitivity: vec![1.0, 2.0, 3.0],
            },
            Importance {
                weight: vec![4.0, 3.0, 9.0],
                pixels: vec![16, 4, 10],
                dominant: vec![0, 1, 0],
                sensitivity: vec![0.5, 0.25, f64::NAN],
            },
        ];
        let of = |criterion| {
            let mut scores = Scores::zeroed(3);
            views.iter().for_each(|view| scores.add(criterion, view));
            scores.finish(criterion)
        };
        assert_eq!(of(INDOOR), [10.0, 5.0, 0.0]);
        assert_eq!(of(OUTDOOR), [0.5, 1.0, 0.0]);
        assert_eq!(of(Criterion::SpeedySplat), [1.5, 2.25, 0.0]);
    }

    #[test]
    fn samples_are_drawn_in_proportion_and_without_replacement() {
        let scores = [1.0, 0.0, 2.0, 5.0];
        let mut drawn = [[0_u32; 4]; 4];
        for seed in 0..20_000 {
            let one = sample(&scores, 1, seed)[0];
            let two = sample(&scores, 2, seed);
            assert!(two[0] < two[1] && two.contains(&one));
            let other = if two[0] == one { two[1] } else { two[0] };
            drawn[one][one] += 1;
            drawn[one][other] += 1;
        }
        for (one, other, chance) in [
            (0, 0, 1.0 / 8.0),
            (2, 2, 0.25),
            (3, 3, 0.625),
            (3, 2, 0.625 * 2.0 / 3.0),
            (0, 3, 0.125 * 5.0 / 7.0),
        ] {
            // The standard deviation is at most √(0.25 / 20000) = 0.0035.
            let share = f64::from(drawn[one][other]) / 20_000.0;
            assert!((share - chance).abs() < 0.015, "{one} then {other}: expected {chance}, found {share}");
        }
        assert_eq!(sample(&scores, 4, 7), [0, 2, 3], "what has no importance is never drawn");
        let many = vec![1.0; 1000];
        assert_eq!(sample(&many, 500, 3), sample(&many, 500, 3));
        assert_ne!(sample(&many, 500, 3), sample(&many, 500, 4));
    }

    #[test]
    fn the_highest_and_those_that_hold_most() {
        let scores = [3.0, 1.0, 0.0, 4.0, 3.0, 0.0];
        assert_eq!(highest(&scores, 2), [0, 3]);
        assert_eq!(highest(&scores, 3), [0, 3, 4]);
        assert_eq!(highest(&scores, 5), [0, 1, 2, 3, 4]);
        assert_eq!(highest(&scores, 9).len(), 6);
        assert_eq!(most_of(&scores, vec![0, 1, 3, 4], 0.9), [0, 3, 4]);
        assert_eq!(most_of(&scores, vec![0, 1, 3], 0.5), [3]);
        assert_eq!(most_of(&scores, vec![0, 1, 2], 1.0), [0, 1, 2]);
    }
}
