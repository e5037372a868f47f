//! LR frames of any renderer to HR frames, with everything in one object.

use gs3_scene::camera_path::pose_between;
use gs3_scene::{Camera, GBuffer, Image, Margin, Planes};

use crate::cpu::interpolate::{Interpolator, Neighbor};
use crate::cpu::super_sample::{Since, SuperSampler};
use crate::depth_lattice::DepthLattice;
use crate::error::{ReconstructError, check_size};
use crate::jitter::Sampling;
use crate::sequence::{FrameSequence, FrameStart, ResetReason};
use crate::settings::Kriging;
use crate::view::GBufferView;

/// Settings of a [`Reconstructor`], fixed at its construction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReconstructorSettings {
    /// Scale: high-resolution over low-resolution size, 1 to [`crate::MAX_SCALE`].
    pub scale: u32,
    /// Where LR frames are sampled.
    pub sampling: Sampling,
    /// Which pixels are kriged.
    pub kriging: Kriging,
    /// Widest margin that the renderer can render beyond each edge, in LR pixels; 0 for none.
    pub widest_margin: u32,
    /// Frames interpolated before each rendered frame, 0 for none.
    pub in_between: usize,
}

impl Default for ReconstructorSettings {
    fn default() -> Self {
        Self {
            scale: 4,
            sampling: Sampling::default(),
            kriging: Kriging::default(),
            widest_margin: 0,
            in_between: 1,
        }
    }
}

/// The images of [`Reconstructor::reconstruct`].
#[derive(Clone, Copy, Debug)]
pub struct Reconstructed<'a> {
    /// The in-between frames of the previous frame and this one, in order. None after a reset: the previous frame is
    /// shown at these moments.
    pub in_between: &'a [Image],
    /// The rendered frame: RGB, and the uncertainty that [`SuperSampler::super_sample`] describes.
    pub current: &'a Image,
    /// Why the frame has no history; none if it has one.
    pub reset: Option<ResetReason>,
}

/// The previous frame of the next one.
#[derive(Debug, Default)]
struct Frame {
    camera: Option<Camera>,
    gbuffer: GBuffer,
    image: Image,
}

/// Reconstructs the frames of one renderer, in order. It chooses each frame's jitter, detects camera cuts,
/// super-samples, and makes in-between frames. All memory is kept between frames.
///
/// For each frame: get its jitter from [`Self::next`] (or [`Self::next_jitter`] alone), render the LR frame of
/// [`Camera::low_resolution`] with this jitter, and pass the LR frame to [`Self::reconstruct`].
///
/// The reconstructor reads colour, the colour's derivatives per LR pixel (by differences if there are none) and
/// depth, each of the visible surface. Filter textures for the HR grid, for example by a LOD bias of −log₂ S.
/// Surfaces are followed by depths and cameras. Moving objects are followed by [`GBufferView::motion`].
#[derive(Debug)]
pub struct Reconstructor {
    settings: ReconstructorSettings,
    sequence: FrameSequence,
    super_sampler: SuperSampler,
    interpolator: Interpolator,
    previous: Frame,
    current: Frame,
    /// The current LR frame with its margin, if it has one.
    padded: GBuffer,
    /// Motion of the current LR frame with its margin, if there is any.
    vectors: Planes<2>,
    in_between: Vec<Image>,
}

impl Reconstructor {
    /// A reconstructor before its first frame.
    ///
    /// # Errors
    /// [`ReconstructError::Scale`] if the scale is not supported.
    pub fn new(settings: ReconstructorSettings) -> Result<Self, ReconstructError> {
        let ReconstructorSettings { scale, sampling, kriging, widest_margin, in_between } = settings;
        Ok(Self {
            settings,
            super_sampler: SuperSampler::new(scale, kriging)?,
            interpolator: Interpolator::new(scale)?,
            sequence: FrameSequence::new(scale, sampling, widest_margin),
            previous: Frame::default(),
            current: Frame::default(),
            padded: GBuffer::default(),
            vectors: Planes::default(),
            in_between: vec![Image::default(); in_between],
        })
    }

    /// How to render the frame of the HR `camera`. The call changes nothing.
    #[must_use]
    pub fn next(&self, camera: &Camera) -> FrameStart {
        self.sequence.begin(camera)
    }

    /// Where to sample the frame of the HR `camera` within its LR pixels: the offset from the pixel centre in LR
    /// pixels, x right and y down. The call changes nothing.
    #[must_use]
    pub fn next_jitter(&self, camera: &Camera) -> [f32; 2] {
        self.next(camera).jitter
    }

    /// Drops the history: the next frame starts anew, for this reason unless an earlier reason is pending.
    pub fn reset(&mut self, reason: ResetReason) {
        self.sequence.reset(reason);
    }

    /// Reconstructs the frame of the HR `camera` from its LR frame, with in-between frames at poses between the
    /// previous camera and this one.
    ///
    /// # Errors
    /// [`ReconstructError`] if `gbuffer` is not the LR frame of `camera`, if its jitter is too large, or if it has
    /// numbers that are not finite. The history stays unchanged then.
    pub fn reconstruct(
        &mut self,
        camera: &Camera,
        gbuffer: &GBufferView<'_>,
    ) -> Result<Reconstructed<'_>, ReconstructError> {
        self.reconstruct_with_poses(camera, gbuffer, &[])
    }

    /// Reconstructs as [`Self::reconstruct`] does, with the true cameras of the in-between frames. `poses` are all of
    /// these cameras in order, or none.
    ///
    /// # Errors
    /// As [`Self::reconstruct`]; also if `poses` have another number or another size.
    pub fn reconstruct_with_poses(
        &mut self,
        camera: &Camera,
        gbuffer: &GBufferView<'_>,
        poses: &[Camera],
    ) -> Result<Reconstructed<'_>, ReconstructError> {
        self.check_poses(camera, poses)?;
        let start = self.sequence.begin(camera);
        std::mem::swap(&mut self.previous, &mut self.current);
        let made = self.make(camera, gbuffer, poses, &start);
        let count = match made {
            Ok(count) => count,
            Err(error) => {
                std::mem::swap(&mut self.previous, &mut self.current);
                return Err(error);
            }
        };
        self.current.camera = Some(*camera);
        self.sequence.commit(camera, start.reset, gbuffer.jitter, DepthLattice::of(&self.current.gbuffer));
        let in_between = &self.in_between[..count];
        Ok(Reconstructed { in_between, current: &self.current.image, reset: start.reset })
    }

    /// Makes the current frame and its in-between frames. Returns the number of in-between frames.
    fn make(
        &mut self,
        camera: &Camera,
        view: &GBufferView<'_>,
        poses: &[Camera],
        start: &FrameStart,
    ) -> Result<usize, ReconstructError> {
        let Frame { gbuffer, image, .. } = &mut self.current;
        let padded = if view.margin == Margin::NONE {
            view.copy_into(gbuffer, &mut self.vectors)?;
            &*gbuffer
        } else {
            view.copy_into(&mut self.padded, &mut self.vectors)?;
            self.padded.crop(gbuffer);
            &self.padded
        };
        let vectors = view.motion.is_some().then_some(&self.vectors);
        let since = Since { reset: start.reset, vectors };
        self.super_sampler.super_sample_since(since, camera, gbuffer, padded, image)?;
        let (Some(previous), Some(before)) = (&start.previous, &self.previous.camera) else { return Ok(0) };
        let before = Neighbor {
            camera: before,
            image: &self.previous.image,
            gbuffer: &self.previous.gbuffer,
            gradients: None,
        };
        let after = Neighbor { camera, image, gbuffer, gradients: None };
        let (count, displacements) = (self.in_between.len(), self.super_sampler.displacements());
        for (k, out) in self.in_between.iter_mut().enumerate() {
            let t = (k + 1) as f64 / (count + 1) as f64;
            let pose = poses.get(k).copied().unwrap_or_else(|| pose_between(previous, camera, t));
            self.interpolator.interpolate_moving(before, after, displacements, t as f32, &pose, out)?;
        }
        Ok(count)
    }

    fn check_poses(&self, camera: &Camera, poses: &[Camera]) -> Result<(), ReconstructError> {
        let expected = self.in_between.len();
        if ![0, expected].contains(&poses.len()) {
            return Err(ReconstructError::Poses { expected, actual: poses.len() });
        }
        let size = camera.size();
        poses.iter().try_for_each(|pose| check_size("camera between two frames", size, pose.size()))
    }

    /// The settings.
    #[must_use]
    pub const fn settings(&self) -> &ReconstructorSettings {
        &self.settings
    }
}
