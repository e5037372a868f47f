//! Where the camera is, as a page states it.

use gs3::glam::DVec3;
use gs3::scene::Intrinsics;
use gs3::scene::orbit::look_at;
use serde::{Deserialize, Serialize};

use crate::controls::{FOV, Rig};

/// A camera as JSON: `{"position": [x, y, z], "target": [x, y, z], "fov": 50}`, in the coordinates of the scene's file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraPlace {
    /// Where the camera is.
    pub position: [f64; 3],
    /// The pivot, in the middle of the picture.
    pub target: [f64; 3],
    /// Vertical field of view, degrees; if missing, the previous camera's.
    pub fov: Option<f64>,
}

/// The text that is no camera.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("camera: {message}")]
pub struct CameraPlaceError {
    message: String,
}

impl CameraPlace {
    /// Reads `json`.
    ///
    /// # Errors
    /// [`CameraPlaceError`] with what was expected and what was found.
    pub fn parse(json: &str) -> Result<Self, CameraPlaceError> {
        serde_json::from_str(json).map_err(|e| CameraPlaceError { message: e.to_string() })
    }

    /// The place of `rig` in a scene with this `origin`. The target lies where the pivot is deep, straight ahead.
    #[must_use]
    pub fn of(rig: &Rig, origin: DVec3) -> Self {
        let position = rig.position();
        let target = position + rig.offset.z.max(f64::MIN_POSITIVE) * rig.forward();
        Self {
            position: (position + origin).to_array(),
            target: (target + origin).to_array(),
            fov: Some(rig.fov_y.to_degrees()),
        }
    }

    /// The rig at this place, with `up` upwards; `before` has the field of view of a place without one.
    ///
    /// # Errors
    /// [`CameraPlaceError`] if position and target are no two points, or the field of view is none.
    pub fn rig(&self, before: &Rig, up: DVec3, origin: DVec3) -> Result<Rig, CameraPlaceError> {
        let error = |message: String| CameraPlaceError { message };
        let [position, target] = [self.position, self.target].map(|at| DVec3::from_array(at) - origin);
        let fov_y = self.fov.map_or(before.fov_y, f64::to_radians);
        if !(FOV[0]..=FOV[1]).contains(&fov_y) {
            let limits = FOV.map(f64::to_degrees);
            return Err(error(format!(
                "fov: expected {:.0} to {:.0} degrees, found {}",
                limits[0],
                limits[1],
                fov_y.to_degrees()
            )));
        }
        let distance = position.distance(target);
        if !(distance > 0.0 && distance.is_finite()) {
            return Err(error(format!(
                "expected a position and a target elsewhere, found {:?} and {:?}",
                self.position, self.target
            )));
        }
        let intrinsics = Intrinsics::from_fov_y(2, 2, fov_y);
        let camera = look_at(position, target, up, intrinsics).map_err(|_| {
            error(format!("expected a camera that does not look along the up axis, found {:?}", self.target))
        })?;
        Ok(Rig::of(&camera, distance))
    }
}

#[cfg(test)]
mod tests {
    use gs3::glam::DQuat;

    use super::*;

    fn rig() -> Rig {
        Rig { pivot: DVec3::ZERO, rotation: DQuat::IDENTITY, offset: DVec3::Z, fov_y: 0.9 }
    }

    #[test]
    fn a_place_in_is_the_place_out() {
        let place = CameraPlace { position: [13.0, -4.0, 1.5], target: [10.0, 0.0, 0.0], fov: Some(40.0) };
        let origin = DVec3::new(10.0, 0.0, 0.0);
        let set = place.rig(&rig(), DVec3::Z, origin).unwrap();
        assert!((set.position() - DVec3::new(3.0, -4.0, 1.5)).length() < 1e-12);
        let told = CameraPlace::of(&set, origin);
        let read = CameraPlace::parse(&serde_json::to_string(&told).unwrap()).unwrap();
        assert_eq!(read, told);
        for axis in 0..3 {
            assert!((told.position[axis] - place.position[axis]).abs() < 1e-9);
            assert!((told.target[axis] - place.target[axis]).abs() < 1e-9);
        }
        assert!((told.fov.unwrap() - 40.0).abs() < 1e-9);
    }

    #[test]
    fn what_is_no_camera_is_told() {
        let refused = |json: &str| {
            let placed = CameraPlace::parse(json).and_then(|place| place.rig(&rig(), DVec3::Z, DVec3::ZERO));
            placed.unwrap_err().to_string()
        };
        assert!(refused("{}").contains("missing field `position`"));
        assert!(
            refused(r#"{"position": [1, 2], "target": [0, 0, 0]}"#).starts_with("camera: invalid length 2")
        );
        let same = refused(r#"{"position": [1, 2, 3], "target": [1, 2, 3]}"#);
        assert!(same.contains("expected a position and a target elsewhere"), "{same}");
        let wide = refused(r#"{"position": [1, 2, 3], "target": [0, 0, 0], "fov": 170}"#);
        assert_eq!(wide, "camera: fov: expected 5 to 120 degrees, found 170");
        let along = refused(r#"{"position": [0, 0, 3], "target": [0, 0, 0]}"#);
        assert!(along.contains("does not look along the up axis"), "{along}");
    }
}
