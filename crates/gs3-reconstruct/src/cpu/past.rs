//! A remembered frame.

use gs3_scene::Camera;

use crate::cpu::boxes::Boxes;
use crate::cpu::samples::SampleFrame;
use crate::cpu::splat::Source;
use crate::reprojection::Reprojection;

/// One remembered LR frame, or the exact blocks of one.
#[derive(Clone, Debug)]
pub(crate) struct Past {
    pub camera: Camera,
    /// Age in frames.
    pub age: usize,
    /// Mean inverse depth of the LR frame.
    pub mean_inverse_depth: f32,
    /// Whether the frame is exact blocks of a first frame that were expected to differ invisibly from the reconstruction.
    pub is_faint: bool,
    pub frame: SampleFrame,
    /// From the frame's camera to the current camera.
    pub reprojection: Reprojection,
    /// Parallax at depth 1 between both cameras, in HR pixels.
    pub parallax: f32,
    /// Focal length of the current camera, HR pixels.
    pub focal: f32,
    /// Boxes of the frame's chunks in the current frame.
    pub boxes: Boxes,
}

impl Past {
    /// An empty frame of `camera`.
    pub fn empty(camera: &Camera) -> Self {
        Self {
            camera: *camera,
            age: 0,
            mean_inverse_depth: 0.0,
            is_faint: false,
            frame: SampleFrame::default(),
            reprojection: Reprojection::new(camera, camera),
            parallax: 0.0,
            focal: 0.0,
            boxes: Boxes::default(),
        }
    }

    /// The frame as seen by the current camera.
    #[inline(always)]
    pub fn source(&self, scale: u32) -> Source<'_> {
        let Self { age, frame, reprojection, parallax, focal, .. } = self;
        let (age, parallax, focal) = (*age, *parallax, *focal);
        Source { frame, reprojection, age, parallax, focal, scale: scale as f32 }
    }
}
