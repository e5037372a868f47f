//! All that is random about a clip: where its camera is, how it moves, what of its view is kept.

use glam::{DAffine3, DVec2, DVec3};
use gs3::raster::{Outputs, RasterSettings, Rasterizer, matched_dilation};
use gs3::scene::{Camera, GBuffer, Planes};

use super::draw::Draw;
use super::error::MakeError;
use super::framing::Framing;
use super::movement::{Movement, Plan};
use super::{ClipSettings, ClipSource, start};
use crate::clip::Network;

/// Views are looked at in so coarse a grid before one is chosen.
const GLANCE: u32 = 16;

/// Views that are tried, and how many of them before the camera moves half as fast: some movements leave every view of
/// the scene.
const ATTEMPTS: usize = 400;
const PATIENCE: usize = 40;

/// Places of the window that are tried in a view.
const PLACES: usize = 12;

/// Least mean alpha of a window, but for a few.
const LEAST_ALPHA: f64 = 0.15;

/// Least mean change of colour from one HR pixel to the next, but for the same few: clips of walls that fill the window
/// and of things seen from too near teach nothing. (Empirical: captured grass has 0.05, a statue before black 0.006.)
const LEAST_DETAIL: f64 = 0.005;

/// The few that show nothing, or nothing sharp.
const DULL: f64 = 0.04;

/// Nothing may be nearer than this, but for a hundredth of what is seen: 1.5 times where Gaussians are culled, so that
/// none vanish in the middle of a clip.
const NEAREST: f32 = 0.3;

/// Frames that a recorded frame may remember: the S² of ×4, and then some.
const LONGEST_PAST: usize = 20;

/// Half of the clips begin within this many frames after a reset.
const SHORT_PAST: usize = 4;

/// How often the background is not black.
const COLORED: f64 = 0.15;

/// A clip before it is rendered.
#[derive(Clone, Debug)]
pub(super) struct Shot {
    pub framing: Framing,
    movement: Movement,
    /// Middle of the recorded frames, in frames since the reset.
    middle: f64,
    /// Background, display-encoded RGB.
    pub background: [f32; 3],
    /// Frames between the reset and the first one recorded.
    pub past: usize,
    /// Frames generated between rendered ones; for interpolation.
    pub in_between: usize,
}

impl Shot {
    /// Draws a clip of `source`.
    pub fn draw(
        draw: &mut Draw,
        source: &ClipSource,
        settings: &ClipSettings,
        is_held_out: bool,
        rasterizer: &mut Rasterizer,
    ) -> Result<Self, MakeError> {
        let past = match draw.chance(0.5) {
            true => draw.below(SHORT_PAST),
            false => SHORT_PAST + draw.below(LONGEST_PAST + 1 - SHORT_PAST),
        };
        let in_between = match settings.network {
            Network::SuperSample => 0,
            Network::Interpolate => draw.weighted(&[(0.75, 1), (0.17, 2), (0.08, 3)], 1),
        };
        let background = match draw.chance(COLORED) {
            true => std::array::from_fn(|_| draw.uniform(0.0, 1.0) as f32),
            false => [0.0; 3],
        };
        let rendered = settings.rendered(in_between);
        let half = 0.5 * (rendered - 1) as f64;
        let mut plan = Plan::draw(draw, half);
        let may_be_dull = draw.chance(DULL);
        // What is drawn so far stays, so that fast clips are as many as slow ones.
        let mut scout = Scout::new(rasterizer, settings.held_out, is_held_out, may_be_dull);
        for attempt in 1..=ATTEMPTS {
            if attempt % PATIENCE == 0 {
                plan.speed *= 0.5;
            }
            let framing = Framing::draw(draw, settings.size, settings.scale);
            let Some((framing, movement)) = scout.find(draw, source, framing, &plan)? else { continue };
            let middle = past as f64 + half;
            let shot = Self { framing, movement, middle, background, past, in_between };
            let times = [0.0, past as f64, (past + rendered - 1) as f64];
            if scout.likes(&shot, &times)? && scout.is_sharp(&shot, middle, settings.scale)? {
                return Ok(shot);
            }
        }
        Err(MakeError::NothingInSight { scene: source.name.clone(), attempts: ATTEMPTS })
    }

    /// The camera `time` frames after the reset.
    pub fn camera(&self, time: f64) -> Result<Camera, MakeError> {
        Ok(self.framing.camera(self.movement.pose(time - self.middle))?)
    }
}

/// Looks for views.
struct Scout<'a> {
    rasterizer: &'a mut Rasterizer,
    glance: GBuffer,
    held_out: f64,
    is_held_out: bool,
    may_be_dull: bool,
}

impl<'a> Scout<'a> {
    fn new(rasterizer: &'a mut Rasterizer, held_out: f64, is_held_out: bool, may_be_dull: bool) -> Self {
        Self { rasterizer, glance: GBuffer::default(), held_out, is_held_out, may_be_dull }
    }

    /// A place for the window of `framing`, and the movement of its camera, if a random pose shows something.
    fn find(
        &mut self,
        draw: &mut Draw,
        source: &ClipSource,
        framing: Framing,
        plan: &Plan,
    ) -> Result<Option<(Framing, Movement)>, MakeError> {
        let Some(start) = start::draw(draw, &source.paths, self.held_out, self.is_held_out) else {
            return Err(MakeError::NoPath { scene: source.name.clone() });
        };
        self.glance(&framing.view(start.view_from_world())?, GLANCE)?;
        let Some(distance) = self.seen([0.25, 0.25, 0.75, 0.75]).median() else { return Ok(None) };
        let world_from_view = start::vary(draw, start.world_from_view(), distance);
        let view = framing.view(world_from_view.inverse())?;
        self.glance(&view, GLANCE)?;
        for _ in 0..PLACES {
            let framing = framing.moved(draw);
            let window = framing.shares();
            let seen = self.seen(window);
            if !self.is_fine(&seen) {
                continue;
            }
            let [left, top, right, bottom] = window;
            let size = DVec2::new(f64::from(view.width()), f64::from(view.height()));
            let middle = DVec2::new(0.5 * (left + right), 0.5 * (top + bottom)) * size;
            let distance = seen.median().unwrap_or(distance);
            let target = view.view_from_world().transform_point3(view.unproject(middle, distance));
            let points: Vec<DVec3> = match seen.depths.is_empty() {
                true => vec![view.unproject(middle, distance)],
                false => seen.depths.iter().map(|(share, z)| view.unproject(*share * size, *z)).collect(),
            };
            let speed = plan.speed * f64::from(framing.view_width()) / 1920.0;
            let pixel = |pose: DAffine3, point: DVec3| {
                let (pixel, z) = framing.view(pose).ok()?.project(point);
                (z > 0.0).then_some(pixel)
            };
            let movement = Movement::new(plan.clone(), world_from_view, target, speed, &points, pixel);
            return Ok(Some((framing, movement)));
        }
        Ok(None)
    }

    /// Whether what `shot` renders is fine at all of `times`.
    fn likes(&mut self, shot: &Shot, times: &[f64]) -> Result<bool, MakeError> {
        for time in times {
            self.glance(&shot.camera(*time)?, GLANCE)?;
            if !self.is_fine(&self.seen([0.0, 0.0, 1.0, 1.0])) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    fn is_fine(&self, seen: &Seen) -> bool {
        (seen.alpha >= LEAST_ALPHA || self.may_be_dull) && 100 * seen.too_near <= seen.depths.len()
    }

    /// Whether there is detail in what `shot` renders at `time`, at the scale of its LR frames.
    fn is_sharp(&mut self, shot: &Shot, time: f64, scale: u32) -> Result<bool, MakeError> {
        self.glance(&shot.camera(time)?, scale)?;
        let Some(gradients) = &self.glance.gradients else { return Ok(false) };
        let slopes = gradients.color_dx.data().iter().chain(gradients.color_dy.data());
        let (mut sum, mut count) = (0.0, 0);
        for slope in slopes {
            (sum, count) = (sum + f64::from(slope.abs()), count + 1);
        }
        Ok(self.may_be_dull || sum >= LEAST_DETAIL * f64::from(scale) * f64::from(count))
    }

    /// Looks through `camera`, with one sample for `grid`×`grid` of its pixels.
    fn glance(&mut self, camera: &Camera, grid: u32) -> Result<(), MakeError> {
        let settings =
            RasterSettings { dilation: matched_dilation(grid), ..RasterSettings::new(Outputs::GBuffer) };
        Ok(self.rasterizer.rasterize(&camera.low_resolution(grid), &settings, &mut self.glance)?)
    }

    /// What was seen in a part of the last glance: left, top, right and bottom as shares.
    fn seen(&self, [left, top, right, bottom]: [f64; 4]) -> Seen {
        let none = Planes::default();
        let depth = self.glance.geometry.as_ref().map_or(&none, |geometry| &geometry.depth_median);
        let (width, height) = (depth.width(), depth.height());
        let span = |from: f64, to: f64, side: usize| {
            let first = ((from * side as f64) as usize).min(side.saturating_sub(1));
            first..((to * side as f64).ceil() as usize).clamp(first, side)
        };
        let mut seen = Seen::default();
        let mut count = 0;
        for y in span(top, bottom, height) {
            for x in span(left, right, width) {
                count += 1;
                seen.alpha += f64::from(self.glance.alpha.row(0, y)[x]);
                let z = depth.row(0, y)[x];
                if z > 0.0 {
                    let place = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                    seen.depths.push((place / DVec2::new(width as f64, height as f64), f64::from(z)));
                    seen.too_near += usize::from(z < NEAREST);
                }
            }
        }
        seen.alpha /= f64::from(count.max(1));
        seen
    }
}

/// What is seen in a window.
#[derive(Clone, Debug, Default)]
struct Seen {
    /// Mean.
    alpha: f64,
    /// Where something was hit, as shares of the view, and its depth.
    depths: Vec<(DVec2, f64)>,
    /// How many of them are too near.
    too_near: usize,
}

impl Seen {
    fn median(&self) -> Option<f64> {
        let mut depths: Vec<f64> = self.depths.iter().map(|(_, z)| *z).collect();
        let middle = depths.len() / 2;
        (!depths.is_empty()).then(|| *depths.select_nth_unstable_by(middle, f64::total_cmp).1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clips::tests::{settings, source};

    #[test]
    fn clips_are_as_varied_as_stated() {
        let (source, settings) = (source(), settings(Network::SuperSample));
        let mut rasterizer = Rasterizer::new(source.scene.clone(), gs3::Culling::default());
        let mut draw = Draw::new(2);
        let shots: Vec<Shot> = (0..150)
            .map(|_| Shot::draw(&mut draw, &source, &settings, false, &mut rasterizer).unwrap())
            .collect();
        let share = |is: &dyn Fn(&Shot) -> bool| shots.iter().filter(|s| is(s)).count() as f64 / 150.0;
        let short = share(&|s| s.past < SHORT_PAST);
        assert!((0.35..0.65).contains(&short), "{short}");
        let black = share(&|s| s.background == [0.0; 3]);
        assert!((0.75..0.95).contains(&black), "{black}");
        assert!(shots.iter().all(|s| s.past <= LONGEST_PAST));
        // Speeds of the ball, in pixels a frame at a width of 1920.
        let mut speeds: Vec<f64> = shots.iter().map(|s| speed(s, DVec3::new(20.0, 0.0, 0.0))).collect();
        speeds.sort_by(f64::total_cmp);
        assert!(speeds[5] < 1e-6, "{speeds:?}");
        assert!((0.5..5.0).contains(&speeds[75]), "{}", speeds[75]);
        assert!((12.0..60.0).contains(&speeds[147]), "{}", speeds[147]);
    }

    /// Pixels that `point` moves in the frame in the middle.
    fn speed(shot: &Shot, point: DVec3) -> f64 {
        let [a, b] = [-0.5, 0.5].map(|t| shot.camera(shot.middle + t).unwrap().project(point).0);
        a.distance(b) * 1920.0 / f64::from(shot.framing.view_width())
    }
}
