//! From inputs to cameras: orbit, pan, dolly and flight, with a damping that ends.

use gs3::glam::{DAffine3, DMat3, DQuat, DVec3};
use gs3::scene::orbit::Bulk;
use gs3::scene::{Camera, CameraError, Intrinsics, Size};

/// Time in which the rest of a movement falls to 1/e, in seconds: quick for the hand, and slow enough that single
/// steps of a wheel do not jump at 30 frames a second.
const DAMPING: f64 = 0.06;

/// A turn by this angle, or a movement by this share of the distance to the pivot, is less than half a pixel of a
/// picture 8192 pixels wide. A smaller rest of a movement is done at once.
const STILL: f64 = 0.5 / 8192.0;

/// Radians per height of the picture dragged: a drag across the whole height is half a turn.
const TURN: f64 = std::f64::consts::PI;

/// Factor on the distance for one line of the wheel.
const DOLLY: f64 = 0.88;

/// Smallest angle between the view and the up axis, radians: at the axis left and right would swap.
const POLE: f64 = 0.02;

/// Flight in radii of the scene per second.
const FLIGHT: f64 = 0.5;

/// Factor of the fast flight; the slow one has its inverse.
const FAST: f64 = 4.0;

/// Vertical fields of view that can be set, radians: 5° to 120°.
pub const FOV: [f64; 2] = [0.087_266_462_599_716_47, 2.094_395_102_393_195_3];

/// A camera that turns around a pivot.
///
/// The pivot may be anywhere in view. `view = rotation · (world − pivot) + offset`: a turn changes the rotation alone, a
/// dolly the offset alone, a pan the pivot alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rig {
    /// The point that the camera turns around, world space.
    pub pivot: DVec3,
    /// From world to view axes (x right, y down, z forward).
    pub rotation: DQuat,
    /// The pivot in view space.
    pub offset: DVec3,
    /// Vertical field of view, radians.
    pub fov_y: f64,
}

impl Rig {
    /// The rig of `camera`, with its pivot `distance` in front of it. The principal point is taken as the centre.
    #[must_use]
    pub fn of(camera: &Camera, distance: f64) -> Self {
        let view_from_world = camera.view_from_world();
        let offset = DVec3::new(0.0, 0.0, distance);
        let i = camera.intrinsics();
        Self {
            pivot: camera.world_from_view().transform_point3(offset),
            rotation: DQuat::from_mat3(&view_from_world.matrix3).normalize(),
            offset,
            fov_y: 2.0 * (0.5 * f64::from(i.height) / i.fy).atan(),
        }
    }

    /// The camera for a picture of `size`.
    ///
    /// # Errors
    /// [`CameraError`] if the size is not valid, or the rig is outside of the range of numbers.
    pub fn camera(&self, size: Size) -> Result<Camera, CameraError> {
        let matrix3 = DMat3::from_quat(self.rotation);
        let pose = DAffine3 { matrix3, translation: self.offset - matrix3 * self.pivot };
        Camera::new(pose, Intrinsics::from_fov_y(size.width, size.height, self.fov_y))
    }

    /// Where the camera is.
    #[must_use]
    pub fn position(&self) -> DVec3 {
        self.pivot - self.world_from_view(self.offset)
    }

    /// Where the camera looks.
    #[must_use]
    pub fn forward(&self) -> DVec3 {
        self.world_from_view(DVec3::Z)
    }

    fn world_from_view(&self, view: DVec3) -> DVec3 {
        self.rotation.conjugate() * view
    }

    /// The rig at share `t` of the way to `other`.
    fn toward(&self, other: &Self, t: f64) -> Self {
        Self {
            pivot: self.pivot.lerp(other.pivot, t),
            rotation: self.rotation.slerp(other.rotation, t).normalize(),
            offset: self.offset.lerp(other.offset, t),
            fov_y: self.fov_y + t * (other.fov_y - self.fov_y),
        }
    }

    /// Whether the difference to `other` is invisible.
    fn is_near(&self, other: &Self) -> bool {
        let reach = STILL * other.offset.length();
        self.pivot.distance(other.pivot) <= reach
            && self.offset.distance(other.offset) <= reach
            && self.rotation.angle_between(other.rotation) <= STILL
            && (self.fov_y - other.fov_y).abs() <= STILL
    }
}

/// A direction of flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flight {
    /// W.
    Forward,
    /// S.
    Back,
    /// A.
    Left,
    /// D.
    Right,
    /// E.
    Up,
    /// Q.
    Down,
}

/// The camera under the control of a user: its target, and its current place on the way there.
#[derive(Clone, Debug)]
pub struct Controls {
    shown: Rig,
    aimed: Rig,
    home: Rig,
    up: DVec3,
    /// Radius of the scene's bulk, the unit of flight.
    radius: f64,
    held: [bool; 6],
}

impl Controls {
    /// Controls that start at `camera`, in a scene with the bulk `bulk`.
    #[must_use]
    pub fn new(camera: &Camera, bulk: &Bulk) -> Self {
        let depth = camera.view_from_world().transform_point3(bulk.center).z;
        // Within a place, the place's middle may be behind the camera, or so near that every drag turns the camera
        // around.
        let distance = if depth > 0.1 * bulk.radius { depth } else { bulk.radius };
        let rig = Rig::of(camera, distance);
        Self { shown: rig, aimed: rig, home: rig, up: bulk.up, radius: bulk.radius, held: [false; 6] }
    }

    /// The rig shown.
    #[must_use]
    pub const fn shown(&self) -> &Rig {
        &self.shown
    }

    /// The upward direction, of length 1.
    #[must_use]
    pub const fn up(&self) -> DVec3 {
        self.up
    }

    /// Turns around the pivot when the pointer is dragged by `delta` pixels in a picture of `height`: the content
    /// under the pointer follows it. The horizon stays level.
    pub fn orbit(&mut self, delta: [f64; 2], height: f64) {
        let turn = TURN / height.max(1.0);
        let rig = &mut self.aimed;
        // Around the up axis, then around the camera's own x axis as far as the pole allows.
        let around = DQuat::from_axis_angle(self.up, -delta[0] * turn);
        rig.rotation *= around.conjugate();
        let angle = rig.forward().angle_between(self.up);
        let wanted = angle + delta[1] * turn;
        let limits = [POLE.min(angle), (std::f64::consts::PI - POLE).max(angle)];
        let tilt = wanted.clamp(limits[0], limits[1]) - angle;
        rig.rotation = (DQuat::from_rotation_x(tilt) * rig.rotation).normalize();
    }

    /// Moves sideways when the pointer is dragged by `delta` pixels in a picture of `height`: the pivot's plane
    /// follows the pointer.
    pub fn pan(&mut self, delta: [f64; 2], height: f64) {
        let rig = &mut self.aimed;
        let depth = rig.offset.z.abs().max(STILL * self.radius);
        let unit = 2.0 * depth * (0.5 * rig.fov_y).tan() / height.max(1.0);
        rig.pivot -= rig.world_from_view(DVec3::new(delta[0] * unit, delta[1] * unit, 0.0));
    }

    /// Moves towards the pivot by `lines` of a wheel, or away if `lines` is negative. The camera never reaches the
    /// pivot.
    pub fn dolly(&mut self, lines: f64) {
        self.approach(DOLLY.powf(lines));
    }

    /// Scales the distance to the pivot by `factor`, within a thousandth and a thousand radii of the scene. A factor
    /// that is NaN is ignored.
    pub fn approach(&mut self, factor: f64) {
        if factor.is_nan() {
            return;
        }
        let rig = &mut self.aimed;
        let length = rig.offset.length();
        let limits = [1e-3 * self.radius, 1e3 * self.radius];
        let wanted = (length * factor).clamp(limits[0].min(length), limits[1].max(length));
        rig.offset *= wanted / length;
    }

    /// Makes `point` the pivot. The view does not move.
    pub fn set_pivot(&mut self, point: DVec3) {
        for rig in [&mut self.shown, &mut self.aimed] {
            rig.offset += rig.rotation * (point - rig.pivot);
            rig.pivot = point;
        }
    }

    /// Adds `by`, world units, to every position, for another scene of the same place with the bulk `bulk`.
    pub fn shift(&mut self, by: DVec3, bulk: &Bulk) {
        for rig in [&mut self.shown, &mut self.aimed, &mut self.home] {
            rig.pivot += by;
        }
        self.radius = bulk.radius;
    }

    /// Begins or ends a flight in one direction.
    pub fn hold(&mut self, flight: Flight, is_held: bool) {
        self.held[flight as usize] = is_held;
    }

    /// Ends all flights, as when the window loses the keyboard.
    pub fn release(&mut self) {
        self.held = [false; 6];
    }

    /// Moves back until all of `bulk` is in the picture, with the same direction of view.
    pub fn frame(&mut self, bulk: &Bulk) {
        let rig = &mut self.aimed;
        rig.pivot = bulk.center;
        rig.offset = DVec3::new(0.0, 0.0, bulk.radius / (0.5 * rig.fov_y).sin());
    }

    /// Goes back to the first camera.
    pub fn reset(&mut self) {
        self.aimed = self.home;
    }

    /// Jumps to `rig` at once, as when a recorded path plays.
    pub fn jump(&mut self, rig: Rig) {
        (self.shown, self.aimed) = (rig, rig);
    }

    /// Sets the vertical field of view, radians, within [`FOV`].
    pub fn set_fov(&mut self, fov_y: f64) {
        if fov_y.is_finite() {
            self.aimed.fov_y = fov_y.clamp(FOV[0], FOV[1]);
        }
    }

    /// The target of the vertical field of view, radians.
    #[must_use]
    pub const fn fov(&self) -> f64 {
        self.aimed.fov_y
    }

    /// Sets the upward direction to `up`, of any length but 0. The horizon is levelled unless the camera looks along
    /// `up`.
    pub fn set_up(&mut self, up: DVec3) {
        let Some(up) = up.try_normalize() else { return };
        self.up = up;
        let forward = self.aimed.forward();
        if let Some(right) = forward.cross(up).try_normalize().filter(|_| forward.cross(up).length() > POLE) {
            let down = forward.cross(right);
            let world_from_view = DMat3::from_cols(right, down, forward);
            self.aimed.rotation = DQuat::from_mat3(&world_from_view.transpose()).normalize();
        }
    }

    /// Whether the camera is moving.
    #[must_use]
    pub fn is_moving(&self) -> bool {
        self.shown != self.aimed || self.held.contains(&true)
    }

    /// Advances by `seconds`. `speed` is a factor on the flight. Returns whether the camera has moved.
    pub fn advance(&mut self, seconds: f64, speed: f64) -> bool {
        let axis = |positive: Flight, negative: Flight| {
            f64::from(self.held[positive as usize]) - f64::from(self.held[negative as usize])
        };
        let level = DVec3::new(axis(Flight::Right, Flight::Left), 0.0, axis(Flight::Forward, Flight::Back));
        let rise = axis(Flight::Up, Flight::Down);
        let flight = self.aimed.world_from_view(level) + rise * self.up;
        self.aimed.pivot += flight.normalize_or_zero() * (FLIGHT * self.radius * speed * seconds);
        if self.shown == self.aimed {
            return false;
        }
        let t = 1.0 - (-seconds / DAMPING).exp();
        let next = self.shown.toward(&self.aimed, t);
        self.shown = if next.is_near(&self.aimed) { self.aimed } else { next };
        true
    }
}

/// The factor on the flight for shift (fast) and ctrl (slow).
#[must_use]
pub fn flight_speed(is_fast: bool, is_slow: bool) -> f64 {
    let fast = if is_fast { FAST } else { 1.0 };
    if is_slow { fast / FAST } else { fast }
}

#[cfg(test)]
mod tests {
    use gs3::glam::DVec2;
    use gs3::scene::orbit::look_at;

    use super::*;

    const SIZE: Size = Size::new(320, 200);

    fn bulk() -> Bulk {
        Bulk { center: DVec3::ZERO, radius: 2.0, extent: DVec3::ONE, is_object: true, up: DVec3::Z }
    }

    fn controls() -> Controls {
        let intrinsics = Intrinsics::from_fov_y(SIZE.width, SIZE.height, 0.9);
        let camera = look_at(DVec3::new(3.0, -4.0, 1.5), DVec3::ZERO, DVec3::Z, intrinsics).unwrap();
        Controls::new(&camera, &bulk())
    }

    fn settle(controls: &mut Controls) -> usize {
        let mut steps = 0;
        while controls.advance(1.0 / 30.0, 1.0) {
            steps += 1;
            assert!(steps < 100, "damping does not end");
        }
        steps
    }

    fn camera(controls: &Controls) -> Camera {
        controls.shown().camera(SIZE).unwrap()
    }

    #[test]
    fn a_camera_in_is_the_camera_out() {
        let path = gs3::scene::demo::path().resized(SIZE.width, SIZE.height).unwrap();
        for given in path.cameras().iter().step_by(40) {
            let shown = camera(&Controls::new(given, &bulk()));
            assert!(shown.view_from_world().abs_diff_eq(given.view_from_world(), 1e-12));
            assert!((shown.intrinsics().fy - given.intrinsics().fy).abs() < 1e-9);
        }
    }

    #[test]
    fn an_orbit_keeps_distance_horizon_and_pivot() {
        let mut controls = controls();
        let pivot = controls.shown().pivot;
        let (before, distance) = (camera(&controls), controls.shown().position().distance(pivot));
        controls.orbit([50.0, 0.0], 200.0);
        settle(&mut controls);
        let after = camera(&controls);
        assert!((after.position().distance(pivot) - distance).abs() < 1e-9);
        assert!((after.position().z - before.position().z).abs() < 1e-9, "a level drag keeps the height");
        // A quarter of the height is an eighth of a turn.
        let angle = before.position().truncate().angle_to(after.position().truncate());
        assert!((angle.abs() - std::f64::consts::FRAC_PI_4).abs() < 1e-6, "{angle}");
        // A point nearer than the pivot moves to the right, as the pointer does.
        let near = pivot + 0.2 * (before.position() - pivot);
        assert!(after.project(near).0.x > before.project(near).0.x + 1.0);
        for camera in [before, after] {
            assert!((camera.project(pivot).0 - DVec2::new(160.0, 100.0)).length() < 1e-6);
            let right = camera.world_from_view().matrix3.x_axis;
            assert!(right.z.abs() < 1e-9, "the horizon is level");
        }
        // Down: the camera rises, and never beyond the pole.
        controls.orbit([0.0, 20.0], 200.0);
        settle(&mut controls);
        assert!(camera(&controls).position().z > after.position().z);
        controls.orbit([0.0, 1e4], 200.0);
        settle(&mut controls);
        let down = controls.shown().forward().angle_between(DVec3::NEG_Z);
        assert!((down - POLE).abs() < 1e-6, "{down}");
    }

    #[test]
    fn a_pan_moves_the_pivot_with_the_pointer() {
        let mut controls = controls();
        let pivot = controls.shown().pivot;
        let before = camera(&controls).project(pivot).0;
        controls.pan([12.0, -7.0], 200.0);
        settle(&mut controls);
        let moved = camera(&controls).project(pivot).0 - before;
        assert!((moved - DVec2::new(12.0, -7.0)).length() < 1e-6, "{moved}");
    }

    #[test]
    fn a_dolly_never_reaches_the_pivot() {
        let mut controls = controls();
        let pivot = controls.shown().pivot;
        let distance = controls.shown().position().distance(pivot);
        controls.dolly(1.0);
        settle(&mut controls);
        let nearer = controls.shown().position().distance(pivot);
        assert!((nearer / distance - DOLLY).abs() < 1e-6);
        controls.dolly(1e6);
        settle(&mut controls);
        let nearest = controls.shown().position().distance(pivot);
        assert!(nearest > 0.0 && nearest < 0.01, "{nearest}");
        assert!(controls.shown().forward().dot(pivot - controls.shown().position()) > 0.0);
    }

    #[test]
    fn a_new_pivot_does_not_move_the_view() {
        let mut controls = controls();
        let before = camera(&controls);
        controls.set_pivot(DVec3::new(0.5, 0.7, -0.2));
        assert!(!controls.is_moving());
        assert!(camera(&controls).view_from_world().abs_diff_eq(before.view_from_world(), 1e-12));
        let seen = before.project(DVec3::new(0.5, 0.7, -0.2));
        controls.orbit([30.0, 10.0], 200.0);
        settle(&mut controls);
        let after = camera(&controls).project(DVec3::new(0.5, 0.7, -0.2));
        assert!((after.0 - seen.0).length() < 1e-6, "the pivot stays where it was seen");
    }

    #[test]
    fn flight_goes_where_its_key_says() {
        for (flight, axis) in [
            (Flight::Forward, DVec3::Z),
            (Flight::Back, DVec3::NEG_Z),
            (Flight::Left, DVec3::NEG_X),
            (Flight::Right, DVec3::X),
        ] {
            let mut controls = controls();
            let (from, axis) = (controls.shown().position(), controls.shown().world_from_view(axis));
            controls.hold(flight, true);
            for _ in 0..30 {
                controls.advance(1.0 / 30.0, 1.0);
            }
            controls.release();
            settle(&mut controls);
            let way = controls.shown().position() - from;
            assert!((way - axis * FLIGHT * 2.0).length() < 1e-6, "{flight:?}: {way}");
        }
        let mut controls = controls();
        let from = controls.shown().position();
        controls.hold(Flight::Up, true);
        controls.advance(0.5, flight_speed(true, false));
        controls.release();
        settle(&mut controls);
        let way = controls.shown().position() - from;
        assert!((way - DVec3::Z * FLIGHT * 2.0 * FAST * 0.5).length() < 1e-6, "{way}");
        assert_eq!(flight_speed(false, true) * flight_speed(true, false), 1.0);
    }

    #[test]
    fn the_frame_holds_the_scene_and_reset_goes_home() {
        let mut controls = controls();
        let home = camera(&controls);
        controls.pan([900.0, 300.0], 200.0);
        controls.dolly(-7.0);
        settle(&mut controls);
        controls.frame(&bulk());
        settle(&mut controls);
        let camera_now = camera(&controls);
        let right = camera_now.world_from_view().matrix3.x_axis;
        let down = camera_now.world_from_view().matrix3.y_axis;
        for point in [down * 2.0, -down * 2.0, right * 2.0, -right * 2.0] {
            let (pixel, z) = camera_now.project(point);
            assert!(z > 0.0 && (0.0..=320.0).contains(&pixel.x) && (0.0..=200.0).contains(&pixel.y));
        }
        controls.reset();
        settle(&mut controls);
        assert_eq!(camera(&controls), home);
    }

    #[test]
    fn another_up_axis_levels_the_horizon() {
        let mut controls = controls();
        controls.set_up(DVec3::new(0.0, 3.0, 0.0));
        settle(&mut controls);
        let right = camera(&controls).world_from_view().matrix3.x_axis;
        assert!(right.y.abs() < 1e-9);
        let shown = camera(&controls);
        assert!(shown.project(DVec3::Y * 0.1).0.y < shown.project(DVec3::ZERO).0.y);
        controls.set_up(DVec3::ZERO);
        assert_eq!(controls.up(), DVec3::Y);
    }
}
