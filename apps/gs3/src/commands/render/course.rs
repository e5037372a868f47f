//! Frames of a path with the bits of one run over all of it, whichever of them are rendered.

use std::ops::Range;

use gs3::scene::CameraPath;
use gs3::{FramePipeline, PipelineError, ResetReason};

/// Where a pipeline is on a path.
#[derive(Clone, Copy, Debug, Default)]
pub struct Course {
    /// Most frames that are rendered and not shown before one; none for as many as one run's bits take.
    most: Option<usize>,
    /// The frame that goes on from the last one rendered, if there is one.
    next: Option<usize>,
}

/// What is rendered to show a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Leg {
    /// The frame, and before it those that are not shown.
    pub frames: Range<usize>,
    /// Whether the first of them begins anew.
    pub begins_anew: bool,
}

impl Leg {
    /// Whether the frame shown has none before it, and so none between.
    pub fn is_alone(&self) -> bool {
        self.begins_anew && self.frames.len() == 1
    }
}

impl Course {
    /// Before the first frame; at most `most` frames are rendered and not shown before one.
    pub const fn new(most: Option<usize>) -> Self {
        Self { most, next: None }
    }

    /// What is to be rendered to show frame `k`, which takes the frames from `first` on.
    pub fn leg(&self, k: usize, first: u64) -> Leg {
        let first = usize::try_from(first).unwrap_or(k).min(k);
        let first = self.most.map_or(first, |most| first.max(k.saturating_sub(most)));
        match self.next {
            Some(next) if (first..=k).contains(&next) => Leg { frames: next..k + 1, begins_anew: false },
            _ => Leg { frames: first..k + 1, begins_anew: true },
        }
    }

    /// Tells that the frames of a leg were rendered, the last of them `k`.
    pub const fn arrive(&mut self, k: usize) {
        self.next = Some(k + 1);
    }

    /// Tells that the pipeline lost its frames.
    pub const fn lose(&mut self) {
        self.next = None;
    }

    /// Renders frame `k` of `path` by `pipeline`, after those that it takes. Says whether there is none before it.
    ///
    /// # Errors
    /// [`PipelineError`] as of the pipeline; the next frame begins anew.
    pub fn render(
        &mut self,
        pipeline: &mut FramePipeline,
        path: &CameraPath,
        k: usize,
    ) -> Result<bool, PipelineError> {
        let leg = self.leg(k, pipeline.first_of_warm_up(k as u64));
        self.lose();
        if leg.begins_anew {
            pipeline.reset(ResetReason::CameraCut);
            pipeline.set_frame_number(leg.frames.start as u64);
        }
        for frame in leg.frames.clone() {
            let poses = pipeline.settings().poses_between(path, frame);
            pipeline.render_with_poses(&path.cameras()[frame], &poses)?;
        }
        self.arrive(k);
        Ok(leg.is_alone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_go_on_where_they_can() {
        let mut course = Course::new(None);
        assert_eq!(course.leg(40, 32), Leg { frames: 32..41, begins_anew: true });
        course.arrive(40);
        assert_eq!(course.leg(41, 32), Leg { frames: 41..42, begins_anew: false });
        // A gap that is shorter than what beginning anew takes, and one that is longer.
        assert_eq!(course.leg(44, 32), Leg { frames: 41..45, begins_anew: false });
        assert_eq!(course.leg(80, 64), Leg { frames: 64..81, begins_anew: true });
        course.lose();
        assert_eq!(course.leg(41, 32), Leg { frames: 32..42, begins_anew: true });
    }

    #[test]
    fn no_more_frames_than_allowed_come_before() {
        let course = Course::new(Some(2));
        assert_eq!(course.leg(40, 32), Leg { frames: 38..41, begins_anew: true });
        assert_eq!(course.leg(1, 0), Leg { frames: 0..2, begins_anew: true });
        assert!(Course::new(Some(0)).leg(40, 32).is_alone() && !course.leg(40, 32).is_alone());
        // The path's first frame.
        assert!(course.leg(0, 0).is_alone());
    }
}
