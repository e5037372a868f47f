//! Which cameras are rendered and shown, and when.

use std::ops::Range;

use gs3_scene::camera_path::CameraPath;
use gs3_scene::{Camera, CameraError, Size};

/// How the camera moves over the evaluated frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Case {
    /// Along the path.
    #[default]
    Path,
    /// Not at all: it stays at the first frame.
    Rest,
    /// Along the path, with a cut to the far side of it in the middle.
    Cut,
}

impl Case {
    /// The case's name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Path => "path",
            Self::Rest => "rest",
            Self::Cut => "cut",
        }
    }
}

/// A rendered frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    pub camera: Camera,
    /// The true pose half-way from the step before; absent for the first step and at a cut.
    pub middle: Option<Camera>,
}

/// The evaluated frames in order. Displayed frame `2 i` is rendered frame `i`, `2 i − 1` the one before it.
#[derive(Clone, Debug)]
pub(super) struct Timeline {
    steps: Vec<Step>,
}

impl Timeline {
    pub fn new(path: &CameraPath, frames: Range<usize>, case: Case, size: Size) -> Result<Self, CameraError> {
        let count = frames.len();
        let cut = count / 2;
        let length = path.cameras().len();
        let time = |i: usize| match case {
            Case::Path => (frames.start + i) as f64,
            Case::Rest => frames.start as f64,
            Case::Cut if i < cut => (frames.start + i) as f64,
            Case::Cut => ((frames.start + i + length / 2) % length) as f64,
        };
        let camera = |time: f64| path.at(time).resized(size.width, size.height);
        let step = |i: usize| {
            let is_cut = case == Case::Cut && i == cut;
            let middle = match case {
                _ if i == 0 || is_cut => None,
                Case::Rest => Some(camera(time(i))?),
                Case::Path | Case::Cut => Some(camera(time(i) - 0.5)?),
            };
            Ok(Step { camera: camera(time(i))?, middle })
        };
        Ok(Self { steps: (0..count).map(step).collect::<Result<_, CameraError>>()? })
    }

    pub fn steps(&self) -> &[Step] {
        &self.steps
    }

    /// Number of displayed frames of a method that interpolates.
    pub fn displayed_count(&self) -> usize {
        2 * self.steps.len() - 1
    }

    /// What displayed frame `index` should show. Before a cut, where nothing lies between, that is the frame before.
    pub fn displayed(&self, index: usize) -> &Camera {
        let step = &self.steps[index.div_ceil(2)];
        match (index % 2, &step.middle) {
            (0, _) => &step.camera,
            (_, Some(middle)) => middle,
            (_, None) => &self.steps[index / 2].camera,
        }
    }

    /// Up to `count` cameras of `path`, spread evenly over what lies outside `frames`, at the given size.
    pub fn outside(
        &self,
        path: &CameraPath,
        frames: Range<usize>,
        size: Size,
        count: usize,
    ) -> Result<Vec<Camera>, CameraError> {
        let evaluated: Vec<Camera> = self.steps.iter().map(|s| s.camera).collect();
        let mut outside = Vec::new();
        for camera in path.cameras()[..frames.start].iter().chain(&path.cameras()[frames.end..]) {
            let camera = camera.resized(size.width, size.height)?;
            if !evaluated.contains(&camera) {
                outside.push(camera);
            }
        }
        let count = count.min(outside.len());
        Ok((0..count).map(|i| outside[(2 * i + 1) * outside.len() / (2 * count)]).collect())
    }
}
