//! Which cameras are rendered and shown, and when.

use std::ops::Range;

use gs3_scene::camera_path::CameraPath;
use gs3_scene::{Camera, CameraError, Size};

use super::moment::{Moment, PER_RENDERED};

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

/// The evaluated frames: what is to be seen at each moment.
#[derive(Clone, Debug)]
pub(super) struct Timeline {
    /// By [`Moment`]. Before a cut, where nothing lies between, that is the camera of the frame before.
    cameras: Vec<Camera>,
    /// The first rendered frame after a cut.
    cut: Option<usize>,
}

impl Timeline {
    pub fn new(path: &CameraPath, frames: Range<usize>, case: Case, size: Size) -> Result<Self, CameraError> {
        let count = frames.len();
        let cut = (case == Case::Cut).then_some(count / 2);
        let length = path.cameras().len();
        let time = |i: usize| match case {
            Case::Rest => frames.start as f64,
            Case::Cut if cut.is_some_and(|cut| i >= cut) => ((frames.start + i + length / 2) % length) as f64,
            Case::Path | Case::Cut => (frames.start + i) as f64,
        };
        let camera = |moment: Moment| {
            // The rendered frame at the moment, or the next one, and how far away it is.
            let next = moment.time().ceil() as usize;
            let ahead = next as f64 - moment.time();
            let time = match case {
                Case::Rest => time(next),
                Case::Cut if ahead > 0.0 && cut == Some(next) => time(next - 1),
                Case::Path | Case::Cut => time(next) - ahead,
            };
            path.at(time).resized(size.width, size.height)
        };
        let Moment(last) = Moment::rendered(count.saturating_sub(1));
        Ok(Self { cameras: (0..=last).map(Moment).map(camera).collect::<Result<_, _>>()?, cut })
    }

    /// Number of rendered frames.
    pub fn rendered(&self) -> usize {
        self.cameras.len().div_ceil(PER_RENDERED)
    }

    /// The moments at which a method with `count` frames between two rendered ones displays a frame, in order.
    pub fn moments(&self, count: u32) -> impl Iterator<Item = Moment> + use<> {
        (0..self.rendered()).flat_map(move |i| Moment::before(i, count).chain([Moment::rendered(i)]))
    }

    /// What a frame displayed at `moment` should show.
    pub fn camera(&self, moment: Moment) -> &Camera {
        &self.cameras[moment.0]
    }

    /// The cameras of the `count` frames between rendered frame `i` and the one before it; none before the first frame
    /// and at a cut.
    pub fn between(&self, i: usize, count: u32) -> Vec<Camera> {
        let moments = Moment::before(i, count).filter(|_| self.cut != Some(i));
        moments.map(|moment| *self.camera(moment)).collect()
    }

    /// Up to `count` cameras of `path`, spread evenly over what lies outside `frames`, at the given size.
    pub fn outside(
        &self,
        path: &CameraPath,
        frames: Range<usize>,
        size: Size,
        count: usize,
    ) -> Result<Vec<Camera>, CameraError> {
        let evaluated: Vec<Camera> = self.cameras.iter().step_by(PER_RENDERED).copied().collect();
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
