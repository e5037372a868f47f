//! Frames in numbers: linear colour, depth, normals and motion. Depth and normals are rasterized natively at the camera of
//! the frame, because a reconstructed frame has depth at low resolution only.

use gs3::raster::Outputs;
use gs3::scene::glam::DVec3;
use gs3::scene::{Camera, CameraPath, GBuffer, Geometry, Image, Planes};
use gs3::{FramePipeline, Mode, PipelineError, PipelineSettings, ResetReason, Session};
use rayon::prelude::*;

use super::args::RenderArgs;
use crate::cli::error::CliError;
use crate::cli::options::{Aov, AovFormat};
use crate::cli::rasterizer::{MachineRasterizer, native};
use crate::io::layers::{Layer, Layers};
use crate::io::output::Target;

/// Normals shorter than this have no direction.
const SHORTEST: f64 = 1e-6;

/// Makes the layers of frames.
pub struct LayerMaker {
    asked: Vec<Aov>,
    format: AovFormat,
    settings: PipelineSettings,
    /// Where more than colour is asked for.
    rasterizer: Option<MachineRasterizer>,
    gbuffer: GBuffer,
}

/// A camera, and the camera of the frame shown before its frame, if there is one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    pub camera: Camera,
    pub before: Option<Camera>,
}

impl LayerMaker {
    /// A maker of what `args` ask for of frames of `session`; none if they ask for pictures alone.
    pub fn new(args: &RenderArgs, target: &Target, session: &Session) -> Result<Option<Self>, CliError> {
        let settings = session.settings().pipeline;
        let rasterizer = match args.aov.is_empty() {
            true if !target.is_exr() => return Ok(None),
            true => None,
            false => Some(MachineRasterizer::new(session.scene(), settings.culling, session.machine())?),
        };
        let (asked, format) = (args.aov.clone(), args.aov_format);
        Ok(Some(Self { asked, format, settings, rasterizer, gbuffer: GBuffer::default() }))
    }

    /// The layers of the frame `image` with its `coverage`, seen by `view`.
    pub fn make(&mut self, image: &Image, coverage: Option<&Image>, view: &View) -> Result<Layers, CliError> {
        let mut layers = Layers::of_frame(image, coverage, self.format);
        if let Some(rasterizer) = &mut self.rasterizer {
            let settings = native(&self.settings, Outputs::GBuffer);
            rasterizer.gbuffer(&view.camera, &settings, &mut self.gbuffer)?;
            let geometry = self.gbuffer.geometry.as_ref();
            let geometry = geometry.ok_or(PipelineError::Internal { expected: "depth and normals" })?;
            let asked = Aov::ALL.into_iter().filter(|aov| self.asked.contains(aov));
            layers.layers.extend(asked.map(|aov| layer(aov, geometry, view)));
        }
        Ok(layers)
    }
}

/// What each of the frames that `pipeline` shows for frame `k` of `path` was seen by, in order. `is_alone` says that no frame
/// before it was rendered.
pub fn views(pipeline: &FramePipeline, path: &CameraPath, k: usize, is_alone: bool) -> Vec<View> {
    let reset = pipeline.last_reset().filter(|_| !is_alone);
    // At a cut the frame before is held; at a keyframe it is not.
    let is_held = reset.is_some_and(|reason| reason != ResetReason::Keyframe);
    views_of(pipeline.settings(), path, k, is_held)
}

fn views_of(settings: &PipelineSettings, path: &CameraPath, k: usize, is_held: bool) -> Vec<View> {
    let camera = path.cameras()[k];
    let Some(last) = k.checked_sub(1).map(|k| path.cameras()[k]) else {
        return vec![View { camera, before: None }];
    };
    let mut between = match settings.mode {
        Mode::Full => settings.poses_between(path, k),
        Mode::Native | Mode::Bicubic | Mode::SuperSample => Vec::new(),
    };
    if is_held {
        between.fill(last);
    }
    let mut before = Some(last);
    let shown = between.into_iter().chain([camera]);
    shown.map(|camera| View { camera, before: before.replace(camera) }).collect()
}

fn layer(aov: Aov, geometry: &Geometry, view: &View) -> Layer {
    let depth = &geometry.depth_median;
    match aov {
        Aov::Depth => {
            let plane = depth.data().par_iter().map(|z| if *z > 0.0 { *z } else { f32::INFINITY });
            Layer { array: "depth", channels: &["Z"], planes: vec![plane.collect()] }
        }
        Aov::Normal => {
            let planes = Vec::from(world_normals(&geometry.normal, &view.camera));
            Layer { array: "normal", channels: &["N.X", "N.Y", "N.Z"], planes }
        }
        Aov::Motion => {
            let planes = Vec::from(motion(depth, view));
            Layer { array: "motion", channels: &["motion.X", "motion.Y"], planes }
        }
    }
}

/// Unit normals in world space; 0 where nothing was hit.
fn world_normals(normal: &Planes<3>, camera: &Camera) -> [Vec<f32>; 3] {
    let world_from_view = camera.world_from_view().matrix3;
    let pixels: Vec<[f32; 3]> = (0..normal.width() * normal.height())
        .into_par_iter()
        .map(|i| {
            let view = DVec3::from([0, 1, 2].map(|c| f64::from(normal.plane(c)[i])));
            match view.length() {
                length if length >= SHORTEST => (world_from_view * view / length).as_vec3().to_array(),
                _ => [0.0; 3],
            }
        })
        .collect();
    [0, 1, 2].map(|c| pixels.par_iter().map(|pixel| pixel[c]).collect())
}

/// Where the surface of each pixel was in the frame before, less where it is, in pixels, y down. Nothing moves but the
/// camera; what has no surface is infinitely far. 0 where there is no frame before, or one of another size, and for what
/// lay behind its camera.
fn motion(depth: &Planes<1>, View { camera, before }: &View) -> [Vec<f32>; 2] {
    let (width, height) = (depth.width(), depth.height());
    let Some(before) = before.filter(|before| before.size() == camera.size()) else {
        return [(); 2].map(|()| vec![0.0; width * height]);
    };
    let (now, then) = (camera.intrinsics(), before.intrinsics());
    let then_from_now = before.view_from_world() * camera.world_from_view();
    let pixels: Vec<[f32; 2]> = (0..width * height)
        .into_par_iter()
        .map(|i| {
            let (x, y) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            let z = f64::from(depth.data()[i]);
            let direction = DVec3::new((x - now.cx) / now.fx, (y - now.cy) / now.fy, 1.0);
            // Per unit of depth now: no surface is at infinity, where the camera's place does not count.
            let inverse_depth = if z > 0.0 { 1.0 / z } else { 0.0 };
            let seen = then_from_now.matrix3 * direction + then_from_now.translation * inverse_depth;
            if seen.z <= 0.0 {
                return [0.0; 2];
            }
            let place = [then.fx * seen.x / seen.z + then.cx, then.fy * seen.y / seen.z + then.cy];
            [(place[0] - x) as f32, (place[1] - y) as f32]
        })
        .collect();
    [0, 1].map(|c| pixels.par_iter().map(|pixel| pixel[c]).collect())
}

#[cfg(test)]
mod tests {
    use gs3::scene::Intrinsics;
    use gs3::scene::demo;
    use gs3::scene::glam::{DAffine3, DMat3, DVec2};

    use super::*;

    fn camera(turn: f64, position: DVec3) -> Camera {
        let rotation = DMat3::from_rotation_y(turn);
        let pose = DAffine3 { matrix3: rotation, translation: -(rotation * position) };
        Camera::new(pose, Intrinsics::from_fov_y(32, 18, 1.0)).unwrap()
    }

    #[test]
    fn motion_is_where_the_point_was() {
        let (now, then) = (camera(0.1, DVec3::new(0.3, -0.1, 0.2)), camera(0.0, DVec3::ZERO));
        let values: Vec<f32> =
            (0..32 * 18).map(|i| if i % 7 == 0 { 0.0 } else { 1.0 + i as f32 * 0.01 }).collect();
        let depth = Planes::from_data(32, 18, values).unwrap();
        let [x, y] = motion(&depth, &View { camera: now, before: Some(then) });
        for i in 0..32 * 18 {
            let pixel = DVec2::new((i % 32) as f64 + 0.5, (i / 32) as f64 + 0.5);
            // Far enough for nothing to be left of the cameras' distance.
            let z = if i % 7 == 0 { 1e12 } else { f64::from(depth.data()[i]) };
            let (was, _) = then.project(now.unproject(pixel, z));
            let found = DVec2::new(f64::from(x[i]), f64::from(y[i]));
            assert!((was - pixel - found).length() < 1e-4, "{i}: {found}, expected {}", was - pixel);
        }
        // Right of a camera that turned right is what was farther right.
        assert!(x.iter().any(|v| v.abs() > 1.0));
        for before in [None, Some(then.resized(64, 36).unwrap())] {
            let still = motion(&depth, &View { camera: now, before });
            assert!(still.iter().flatten().all(|v| *v == 0.0));
        }
        // Behind a camera that looks the other way.
        let back = camera(std::f64::consts::PI, DVec3::ZERO);
        assert!(
            motion(&depth, &View { camera: now, before: Some(back) }).iter().flatten().all(|v| *v == 0.0)
        );
    }

    #[test]
    fn normals_are_turned_into_the_world_and_of_length_1() {
        let mut normal = Planes::new(2, 1);
        // Half opaque, facing the camera.
        normal.plane_mut(2)[0] = -0.5;
        let [x, y, z] = world_normals(&normal, &camera(std::f64::consts::FRAC_PI_2, DVec3::ZERO));
        // The view's z is the world's −x: view_from_world turns x to −z.
        assert!((x[0] - 1.0).abs() < 1e-6 && y[0].abs() < 1e-6 && z[0].abs() < 1e-6, "{x:?} {y:?} {z:?}");
        assert_eq!([x[1], y[1], z[1]], [0.0; 3]);
    }

    #[test]
    fn every_frame_is_seen_by_its_camera_and_moves_from_the_frame_before() {
        let path = demo::path().resized(32, 18).unwrap();
        let of = |mode, in_between, k, is_held| {
            let settings = PipelineSettings { mode, in_between, ..PipelineSettings::default() };
            views_of(&settings, &path, k, is_held)
        };
        let cameras = path.cameras();
        assert_eq!(of(Mode::Full, 1, 0, false), [View { camera: cameras[0], before: None }]);
        let native = of(Mode::Native, 1, 5, false);
        assert_eq!(native, [View { camera: cameras[5], before: Some(cameras[4]) }]);
        let full = of(Mode::Full, 2, 5, false);
        let between = [path.at(4.0 + 1.0 / 3.0), path.at(4.0 + 2.0 / 3.0)];
        assert_eq!(full.iter().map(|v| v.camera).collect::<Vec<_>>(), [between[0], between[1], cameras[5]]);
        assert_eq!(
            full.iter().map(|v| v.before.unwrap()).collect::<Vec<_>>(),
            [cameras[4], between[0], between[1]]
        );
        // At a cut the frame before is shown once more.
        let held = of(Mode::Full, 1, 5, true);
        assert_eq!(held[0], View { camera: cameras[4], before: Some(cameras[4]) });
        assert_eq!(held[1], View { camera: cameras[5], before: Some(cameras[4]) });
    }
}
