//! Frames of hostile scenes and cameras, and frames refined by hostile weights: an error in one line or finite pixels.

use std::sync::{Arc, OnceLock};

use gs3::glam::{DAffine3, DMat3, DVec3};
use gs3::neural::Weights;
use gs3::scene::{Camera, Gaussians, Intrinsics, OpacityMode, Scene};
use gs3::{FramePipeline, Mode, Networks, PipelineSettings, Scale};

use crate::entry::{Entry, check_message};

/// The targets by name.
pub const TARGETS: [(&str, Entry); 2] = [("frames", frames), ("weights", weights)];

/// Bytes of a Gaussian in [`frames`]: mean, scales, rotation, opacity, and the colour's constant and linear terms.
const GAUSSIAN: usize = 4 * (3 + 3 + 4 + 1 + 12);
/// Bytes before the Gaussians: switches, and two cameras of 3 × 4 pose, focal lengths and principal point.
const HEADER: usize = 4 + 2 * 4 * 16;

/// Two frames of the CPU's pipeline, of a scene and two cameras with the input's bits as their numbers.
pub fn frames(data: &[u8]) {
    let Some((header, body)) = data.split_at_checked(HEADER) else { return };
    let mut values = header[4..].chunks_exact(4).map(float);
    let mut next = || values.next().unwrap_or_default();
    let cameras: Vec<_> = (0..2)
        .filter_map(|_| {
            let column = |v: [f32; 3]| DVec3::from(v.map(f64::from));
            let columns: [DVec3; 4] = std::array::from_fn(|_| column([next(), next(), next()]));
            let [a, b, c, t] = columns;
            let [fx, fy, cx, cy] = std::array::from_fn(|_| f64::from(next()));
            let pose = DAffine3::from_mat3_translation(DMat3::from_cols(a, b, c), t);
            match Camera::new(pose, Intrinsics { width: 40, height: 24, fx, fy, cx, cy }) {
                Ok(camera) => Some(camera),
                Err(error) => {
                    check_message(&error.to_string());
                    None
                }
            }
        })
        .collect();
    let opacity = if header[0] & 1 == 0 { OpacityMode::Default } else { OpacityMode::Antialiased };
    let scene = match Scene::new(gaussians(body), opacity) {
        Ok(scene) => Arc::new(scene),
        Err(error) => return check_message(&error.to_string()),
    };
    let mode = [Mode::Native, Mode::Bicubic, Mode::SuperSample, Mode::Full][usize::from(header[1]) % 4];
    let settings = PipelineSettings {
        mode,
        scale: Scale::Fixed(u32::from(header[2]) % 5),
        in_between: u32::from(header[3]) % 4,
        ..PipelineSettings::default()
    };
    match FramePipeline::new(scene, settings) {
        Ok(mut pipeline) => render(&mut pipeline, &cameras),
        Err(error) => check_message(&error.to_string()),
    }
}

/// Weights of a network, and two frames that it refines if gs3 takes it.
pub fn weights(data: &[u8]) {
    let mut networks = Networks::default();
    let weights = match Weights::from_bytes(data) {
        Ok(weights) => weights,
        Err(error) => return check_message(&error.to_string()),
    };
    if let Err(error) = networks.add(weights) {
        return check_message(&error.to_string());
    }
    match FramePipeline::with_networks(still_life(), PipelineSettings::default(), &networks) {
        Ok(mut pipeline) => {
            let looks = [0.0, 0.02].map(|x| {
                let pose = DAffine3::from_translation(DVec3::new(x, 0.0, 4.0));
                Camera::new(pose, Intrinsics::from_fov_y(16, 16, 1.0)).expect("a camera")
            });
            render(&mut pipeline, &looks);
        }
        Err(error) => check_message(&error.to_string()),
    }
}

fn render(pipeline: &mut FramePipeline, cameras: &[Camera]) {
    for camera in cameras {
        match pipeline.render(camera) {
            Ok(shown) => {
                for image in shown.iter() {
                    assert!(
                        image.pixels().iter().flatten().all(|value| value.is_finite()),
                        "a pixel that is no number"
                    );
                }
            }
            Err(error) => check_message(&error.to_string()),
        }
    }
}

fn gaussians(body: &[u8]) -> Gaussians {
    let count = (body.len() / GAUSSIAN).min(16);
    let mut gaussians = Gaussians::zeroed(count, 1);
    for (i, bytes) in body.chunks_exact(GAUSSIAN).take(count).enumerate() {
        let mut values = bytes.chunks_exact(4).map(float);
        let Gaussians { means, scales, rotations, opacities, sh, .. } = &mut gaussians;
        let planes = means.iter_mut().chain(scales).chain(rotations).chain([opacities]);
        for plane in planes {
            plane[i] = values.next().unwrap_or_default();
        }
        for (value, of) in sh[i * 12..].iter_mut().zip(values) {
            *value = of;
        }
    }
    gaussians
}

fn float(bytes: &[u8]) -> f32 {
    f32::from_le_bytes(bytes.try_into().expect("four bytes"))
}

/// Three Gaussians before a camera at z = 0 that looks along z.
fn still_life() -> Arc<Scene> {
    static SCENE: OnceLock<Arc<Scene>> = OnceLock::new();
    let make = || {
        let mut gaussians = Gaussians::zeroed(3, 0);
        for i in 0..3 {
            gaussians.means[0][i] = i as f32 - 1.0;
            gaussians.scales.iter_mut().for_each(|plane| plane[i] = 0.4);
            gaussians.rotations[0][i] = 1.0;
            gaussians.opacities[i] = 0.9;
            gaussians.sh[3 * i + i] = 1.0;
        }
        Arc::new(Scene::new(gaussians, OpacityMode::Default).expect("a scene"))
    };
    Arc::clone(SCENE.get_or_init(make))
}
