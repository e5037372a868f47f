//! How the camera of a clip moves.

use std::f64::consts::TAU;

use glam::{DAffine3, DQuat, DVec3};

use super::draw::Draw;

/// Speeds of the image in pixels a frame, at a width of 1920 pixels.
const SPEEDS: [f64; 2] = [0.25, 25.0];

/// How a camera moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Rest,
    /// Moves without turning.
    Dolly,
    /// Turns in its place.
    Pan,
    /// Circles what it looks at.
    Orbit,
    /// Turns about its axis.
    Roll,
    /// Moves and turns.
    Drift,
    /// Sways as in a hand.
    HandHeld,
}

const KINDS: [(f64, Kind); 7] = [
    (10.0, Kind::Rest),
    (20.0, Kind::Dolly),
    (20.0, Kind::Pan),
    (20.0, Kind::Orbit),
    (5.0, Kind::Roll),
    (15.0, Kind::Drift),
    (10.0, Kind::HandHeld),
];

/// How often a camera that moves also sways, and how fast, as a share of its speed.
const SWAYING: f64 = 0.2;
const SWAY_SHARE: f64 = 0.3;

/// Frequencies of swaying, per frame: 0.5 to 5 Hz at 30 frames a second.
const SWAY_FREQUENCIES: [f64; 2] = [0.016, 0.16];

/// How often a camera starts or stops while it is watched.
const START_OR_STOP: f64 = 0.15;

/// Largest change of speed over the recorded frames, as a share.
const ACCELERATION: f64 = 0.4;

/// Largest turn in a frame (3.4°) and largest way, as a share of the distance to what is seen: motions that would need
/// more to reach their speed are slower, as a dolly towards the middle of the window.
const LARGEST_STEP: f64 = 0.06;

/// A turn (radians, scaled axis) and a way (in distances to what is seen), in the view's axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Offset {
    turn: DVec3,
    way: DVec3,
}

/// `offset` · sin(2π (`frequency` · frames + `phase`)).
#[derive(Clone, Copy, Debug, PartialEq)]
struct Sway {
    offset: Offset,
    frequency: f64,
    phase: f64,
}

/// How a camera moves, before it is known where.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Plan {
    kind: Kind,
    /// Pixels a frame at a width of 1920 pixels.
    pub speed: f64,
    /// Per frame.
    steady: Offset,
    sways: Vec<Sway>,
    /// Change of speed per frame, as a share.
    acceleration: f64,
    /// Frames in which it moves steadily.
    moving: [f64; 2],
}

/// A movement around a pose, with time in frames; at time 0 it is there.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Movement {
    plan: Plan,
    world_from_view: DAffine3,
    /// What the camera turns about, in view space.
    pivot: DVec3,
    /// World units of a way of 1.
    distance: f64,
    /// Factor on all offsets.
    rate: f64,
}

impl Plan {
    /// A random plan for a clip that is recorded from time −`half` to `half`.
    pub fn draw(draw: &mut Draw, half: f64) -> Self {
        let kind = draw.weighted(&KINDS, Kind::Rest);
        let speed = draw.log_uniform(SPEEDS[0], SPEEDS[1]);
        let angle = draw.uniform(0.0, TAU);
        let across = DVec3::new(angle.cos(), angle.sin(), 0.0);
        let mut way = draw.direction();
        if draw.chance(0.4) {
            // Straight on or back, as one walks.
            way = 0.2 * way + way.z.signum() * DVec3::Z;
        }
        let level = DVec3::new(draw.uniform(-0.3, 0.3), way.x.signum(), 0.0);
        let steady = match kind {
            Kind::Rest | Kind::HandHeld => Offset::default(),
            Kind::Dolly => Offset { turn: DVec3::ZERO, way },
            // Most pans are level.
            Kind::Pan => Offset { turn: if draw.chance(0.5) { level } else { across }, way: DVec3::ZERO },
            Kind::Orbit => Offset { turn: level, way: DVec3::ZERO },
            Kind::Roll => Offset { turn: DVec3::Z * way.z.signum(), way: DVec3::ZERO },
            Kind::Drift => Offset { turn: across * draw.uniform(0.2, 1.0), way },
        };
        let share = match kind {
            Kind::HandHeld => 1.0,
            Kind::Rest => 0.0,
            _ if draw.chance(SWAYING) => SWAY_SHARE,
            _ => 0.0,
        };
        let sways = if share > 0.0 { (0..4).map(|_| Sway::draw(draw, share)).collect() } else { Vec::new() };
        let mut moving = [f64::NEG_INFINITY, f64::INFINITY];
        if draw.chance(START_OR_STOP) {
            moving[draw.below(2)] = draw.uniform(-half, half).round();
        }
        let acceleration = draw.uniform(-ACCELERATION, ACCELERATION) / (2.0 * half).max(1.0);
        Self { kind, speed, steady, sways, acceleration, moving }
    }

    /// The offset at `time`, for a rate of 1.
    fn offset(&self, time: f64) -> Offset {
        let steps = self.steps(time);
        let mut offset = Offset { turn: self.steady.turn * steps, way: self.steady.way * steps };
        for sway in &self.sways {
            let angle = |time: f64| TAU * (sway.frequency * time + sway.phase);
            let by = angle(time).sin() - angle(0.0).sin();
            offset.turn += by * sway.offset.turn;
            offset.way += by * sway.offset.way;
        }
        offset
    }

    /// Steps at time `time`: those at constant acceleration from 0 on, as far as the camera moves in between.
    fn steps(&self, time: f64) -> f64 {
        // Long before it is watched, speed would fall to 0 and below.
        let speed_limit = 0.9 / self.acceleration.abs().max(1e-9);
        let travelled = |t: f64| {
            let within = t.clamp(-speed_limit, speed_limit);
            let speed = 1.0 + self.acceleration * within;
            within + 0.5 * self.acceleration * within * within + (t - within) * speed
        };
        let [start, stop] = self.moving;
        travelled(time.clamp(start, stop)) - travelled(0.0_f64.clamp(start, stop))
    }
}

impl Sway {
    /// A sway with a speed of about `share` of a step.
    fn draw(draw: &mut Draw, share: f64) -> Self {
        let frequency = draw.log_uniform(SWAY_FREQUENCIES[0], SWAY_FREQUENCIES[1]);
        let amplitude = share / (TAU * frequency);
        // A hand turns more than it moves.
        let offset = Offset { turn: amplitude * draw.direction(), way: 0.3 * amplitude * draw.direction() };
        Self { offset, frequency, phase: draw.uniform(0.0, 1.0) }
    }
}

impl Movement {
    /// `plan` around the pose `world_from_view`. The target of the view is at `target`, in view space, with positive
    /// z. `points` are the visible points in world space. `pixel` gives a point's place in the image of a
    /// view_from_world pose. `speed` is in pixels a frame.
    pub fn new(
        plan: Plan,
        world_from_view: DAffine3,
        target: DVec3,
        speed: f64,
        points: &[DVec3],
        pixel: impl Fn(DAffine3, DVec3) -> Option<glam::DVec2>,
    ) -> Self {
        let pivot = if plan.kind == Kind::Orbit { target } else { DVec3::ZERO };
        // So small that the image moves in proportion.
        const TINY: f64 = 1e-5;
        let always = Plan { moving: [f64::NEG_INFINITY, f64::INFINITY], ..plan.clone() };
        let mut movement = Self { plan: always, world_from_view, pivot, distance: target.z, rate: TINY };
        // The mean of a few frames' medians, because swaying has no constant speed.
        let times = [-3.0, -1.0, 1.0, 3.0];
        let per_rate = times.map(|time| movement.image_speed(time, points, &pixel)).iter().sum::<f64>()
            / (times.len() as f64 * TINY);
        let largest = times.map(|time| movement.largest_step(time)).into_iter().fold(0.0, f64::max) / TINY;
        let rate = if per_rate > 0.0 { speed / per_rate } else { f64::INFINITY };
        movement.rate = if largest > 0.0 { rate.min(LARGEST_STEP / largest) } else { 0.0 };
        movement.plan = plan;
        movement
    }

    /// View from world at `time`.
    pub fn pose(&self, time: f64) -> DAffine3 {
        let Offset { turn, way } = self.plan.offset(time);
        let turn = DAffine3::from_quat(DQuat::from_scaled_axis(turn * self.rate));
        let about = DAffine3::from_translation(self.pivot) * turn * DAffine3::from_translation(-self.pivot);
        let moved =
            self.world_from_view * about * DAffine3::from_translation(way * self.rate * self.distance);
        moved.inverse()
    }

    /// Median way of `points` in the image in the frame from `time` on, in pixels.
    pub fn image_speed(
        &self,
        time: f64,
        points: &[DVec3],
        pixel: impl Fn(DAffine3, DVec3) -> Option<glam::DVec2>,
    ) -> f64 {
        let (from, to) = (self.pose(time), self.pose(time + 1.0));
        let mut ways: Vec<f64> =
            points.iter().filter_map(|p| Some(pixel(from, *p)?.distance(pixel(to, *p)?))).collect();
        if ways.is_empty() {
            return 0.0;
        }
        let middle = ways.len() / 2;
        *ways.select_nth_unstable_by(middle, f64::total_cmp).1
    }

    /// The larger of turn and way in the frame from `time` on.
    fn largest_step(&self, time: f64) -> f64 {
        let (a, b) = (self.plan.offset(time), self.plan.offset(time + 1.0));
        self.rate * a.turn.distance(b.turn).max(a.way.distance(b.way))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec2;

    fn movement(kind: Kind, speed: f64, moving: [f64; 2], acceleration: f64) -> Movement {
        let way = if kind == Kind::Dolly { DVec3::X } else { DVec3::ZERO };
        let turn = if kind == Kind::Dolly { DVec3::ZERO } else { DVec3::Y };
        let steady = Offset { turn, way };
        let plan = Plan { kind, speed, steady, sways: Vec::new(), acceleration, moving };
        let pose =
            DAffine3::from_rotation_translation(DQuat::from_rotation_x(0.3), DVec3::new(1.0, 2.0, 3.0));
        let target = DVec3::new(0.5, 0.2, 4.0);
        let points = [pose.transform_point3(target)];
        Movement::new(plan, pose, target, speed, &points, pixel)
    }

    /// A camera of 1,000 pixels at distance 1.
    fn pixel(view_from_world: DAffine3, point: DVec3) -> Option<DVec2> {
        let p = view_from_world.transform_point3(point);
        (p.z > 0.0).then(|| 1000.0 * p.truncate() / p.z)
    }

    fn place(movement: &Movement, time: f64) -> DVec2 {
        let target = movement.world_from_view.transform_point3(DVec3::new(0.5, 0.2, 4.0));
        pixel(movement.pose(time), target).unwrap()
    }

    #[test]
    fn speeds_are_those_of_the_image() {
        const ALWAYS: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];
        for kind in [Kind::Dolly, Kind::Pan] {
            let steady = movement(kind, 10.0, ALWAYS, 0.0);
            assert!(steady.pose(0.0).abs_diff_eq(steady.world_from_view.inverse(), 1e-12));
            for time in [-5.0, 0.0, 5.0] {
                let way = place(&steady, time).distance(place(&steady, time + 1.0));
                assert!((9.0..11.0).contains(&way), "{kind:?} {time}: {way}");
            }
            let faster = movement(kind, 10.0, ALWAYS, 0.05);
            let way = |time: f64| place(&faster, time).distance(place(&faster, time + 1.0));
            assert!((1.3..2.0).contains(&(way(4.0) / way(-4.0))), "{} {}", way(4.0), way(-4.0));
        }
        // What it circles stays; more would be needed than it turns in a frame at most.
        let orbit = movement(Kind::Orbit, 10.0, ALWAYS, 0.0);
        assert!(place(&orbit, 0.0).distance(place(&orbit, 1.0)) < 1e-6);
        assert!((orbit.rate - LARGEST_STEP).abs() < 1e-6, "{}", orbit.rate);
    }

    #[test]
    fn cameras_start_and_stop() {
        let start = movement(Kind::Pan, 3.0, [2.0, f64::INFINITY], 0.01);
        assert_eq!(start.pose(-9.0), start.pose(2.0));
        assert!(place(&start, 2.0).distance(place(&start, 3.0)) > 2.0);
        let stop = movement(Kind::Pan, 3.0, [f64::NEG_INFINITY, -1.0], 0.01);
        assert_eq!(stop.pose(-1.0), stop.pose(30.0));
        assert!(place(&stop, -2.0).distance(place(&stop, -1.0)) > 2.0);
    }
}
