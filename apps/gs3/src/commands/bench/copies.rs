//! A scene several times, side by side: a larger one to measure.

use std::sync::Arc;

use gs3::scene::info::SceneInfo;
use gs3::scene::{Camera, Scene, SceneError};

/// `copies` of `scene`: one where it is, the others to the right and to the left of `camera` in turn, next to each
/// other by the scene's bounds (without the outermost hundredths).
pub fn side_by_side(scene: Arc<Scene>, copies: u32, camera: &Camera) -> Result<Arc<Scene>, SceneError> {
    if copies <= 1 {
        return Ok(scene);
    }
    let bounds = SceneInfo::of(&scene).robust_bounds;
    let right = camera.world_from_view().matrix3.x_axis;
    let width: f64 =
        (0..3).map(|axis| right[axis].abs() * f64::from(bounds.max[axis] - bounds.min[axis])).sum();
    let (mode, details) = (scene.opacity_mode(), scene.details().clone());
    let one = scene.gaussians();
    let mut all = one.clone();
    for k in 1..copies {
        let place = f64::from(k.div_ceil(2)) * if k % 2 == 1 { 1.0 } else { -1.0 };
        let mut copy = one.clone();
        for (axis, means) in copy.means.iter_mut().enumerate() {
            let offset = (right[axis] * width * place) as f32;
            means.iter_mut().for_each(|mean| *mean += offset);
        }
        all.append(&copy);
    }
    Ok(Arc::new(Scene::new(all, mode)?.with_details(details)))
}

#[cfg(test)]
mod tests {
    use gs3::scene::demo;

    use super::*;

    #[test]
    fn copies_stand_to_the_right_and_to_the_left() {
        let (scene, camera) = (demo::scene().unwrap(), demo::path().cameras()[0]);
        let count = scene.gaussians().len();
        let right = camera.world_from_view().matrix3.x_axis;
        let along = |scene: &Scene, i: usize| {
            scene
                .gaussians()
                .mean(i)
                .iter()
                .zip(right.to_array())
                .map(|(m, r)| f64::from(*m) * r)
                .sum::<f64>()
        };
        let first = along(&scene, 7);
        let three = side_by_side(Arc::new(scene), 3, &camera).unwrap();
        assert_eq!(three.gaussians().len(), 3 * count);
        let [same, to_right, to_left] = [0, 1, 2].map(|k| along(&three, k * count + 7) - first);
        assert_eq!(same, 0.0);
        assert!(to_right > 1.0 && (to_right + to_left).abs() < 1e-3 * to_right, "{to_right} {to_left}");
    }
}
