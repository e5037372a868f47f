//! Low-resolution frames of any renderer to high-resolution ones: all of it in one object.

use gs3_scene::camera_path::pose_between;
use gs3_scene::{Camera, GBuffer, Image, Margin, Planes};

use crate::cpu::interpolate::{Interpolator, Neighbor};
use crate::cpu::super_sample::{Since, SuperSampler};
use crate::depth_lattice::DepthLattice;
use crate::error::{ReconstructError, camera_size, check_size};
use crate::jitter::Sampling;
use crate::sequence::ResetReason;
use crate::sequence::{FrameSequence, FrameStart};
use crate::settings::Kriging;
use crate::view::GBufferView;

/// Settings of a [`Reconstructor`], fixed at its construction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReconstructorSettings {
    /// High-resolution over low-resolution size, 1 to [`crate::MAX_SCALE`].
    pub scale: u32,
    /// Where LR frames are sampled.
    pub sampling: Sampling,
    /// Which pixels are kriged.
    pub kriging: Kriging,
    /// LR pixels that the renderer can render beyond each edge, 0 for none.
    pub widest_margin: u32,
    /// Frames interpolated before each rendered one, 0 for none.
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

/// What [`Reconstructor::reconstruct`] gives to show.
#[derive(Clone, Copy, Debug)]
pub struct Reconstructed<'a> {
    /// The frames between the previous one and this one, in order. None after a reset: the previous frame stays on for
    /// these moments.
    pub in_between: &'a [Image],
    /// The frame: RGB, and the uncertainty that [`SuperSampler::super_sample`] describes.
    pub current: &'a Image,
    /// Why it has no history, if it has none.
    pub reset: Option<ResetReason>,
}

/// A frame that the next one goes on from.
#[derive(Debug, Default)]
struct Frame {
    camera: Option<Camera>,
    gbuffer: GBuffer,
    image: Image,
}

/// Reconstructs the frames of one renderer, one after the other: chooses where each is sampled, tells camera cuts,
/// super-samples, and makes in-between frames. All memory is kept between frames.
///
/// For each frame: ask [`Self::next`] for its jitter (or [`Self::next_jitter`] alone), render the LR frame of
/// [`Camera::low_resolution`] sampled there, and give it to [`Self::reconstruct`].
///
/// Colour is read, its derivatives per LR pixel (differenced where there are none) and depth; of each the visible
/// surface's. Textures are filtered for the HR grid, as by a LOD bias of −log₂ S. Surfaces are followed by depths and
/// cameras, and where something moves by itself, by [`GBufferView::motion`].
#[derive(Debug)]
pub struct Reconstructor {
    settings: ReconstructorSettings,
    sequence: FrameSequence,
    super_sampler: SuperSampler,
    interpolator: Interpolator,
    previous: Frame,
    current: Frame,
    /// The current LR frame with its margin, where it has one.
    padded: GBuffer,
    /// Motion of the current LR frame, margin included, where it has any.
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

    /// How the frame of the HR `camera` is to be rendered. Asking changes nothing.
    #[must_use]
    pub fn next(&self, camera: &Camera) -> FrameStart {
        self.sequence.begin(camera)
    }

    /// Where within its LR pixels the frame of the HR `camera` is to be sampled: an offset from the pixel centre in LR
    /// pixels, x right and y down. Asking changes nothing.
    #[must_use]
    pub fn next_jitter(&self, camera: &Camera) -> [f32; 2] {
        self.next(camera).jitter
    }

    /// Forgets the frames before: the next one starts anew, for this reason unless another came first.
    pub fn reset(&mut self, reason: ResetReason) {
        self.sequence.reset(reason);
    }

    /// Reconstructs the frame of the HR `camera` from its LR frame, and in-between frames at poses between the previous
    /// camera and this one.
    ///
    /// # Errors
    /// [`ReconstructError`] if `gbuffer` is not the LR frame of `camera`, its jitter is outside of its pixels, or it has
    /// numbers that are not finite. The history is then as before.
    pub fn reconstruct(
        &mut self,
        camera: &Camera,
        gbuffer: &GBufferView<'_>,
    ) -> Result<Reconstructed<'_>, ReconstructError> {
        self.reconstruct_with_poses(camera, gbuffer, &[])
    }

    /// As [`Self::reconstruct`], where the true cameras of the in-between frames are known: `poses` are all of them, in
    /// order, or none.
    ///
    /// # Errors
    /// As [`Self::reconstruct`]; also if `poses` are of another number or size.
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

    /// Makes the current frame and those between; gives their number.
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
        let before =
            Neighbor { camera: before, image: &self.previous.image, gbuffer: &self.previous.gbuffer };
        let after = Neighbor { camera, image, gbuffer };
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
        let size = camera_size(camera);
        poses.iter().try_for_each(|pose| check_size("camera between two frames", size, camera_size(pose)))
    }

    /// The settings.
    #[must_use]
    pub const fn settings(&self) -> &ReconstructorSettings {
        &self.settings
    }
}
