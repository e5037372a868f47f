//! Frames of a path with the bits of one run over all of it, whichever of them are rendered.

use std::ops::Range;

use gs3::scene::CameraPath;
use gs3::{PipelineError, Session};

use crate::cli::backend::tell_notices;

/// Where sessions are on a path.
#[derive(Clone, Copy, Debug, Default)]
pub struct Course {
    /// Most frames that are rendered and not shown before one; none for as many as one run's bits take.
    most: Option<usize>,
    /// The frame that goes on from the last one rendered, if there is one.
    next: Option<usize>,
}

/// What is rendered to show a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Leg {
    /// The frame, and before it those that are not shown.
    frames: Range<usize>,
    /// Whether the first of them begins anew.
    begins_anew: bool,
}

impl Leg {
    /// Whether the frame shown has none before it, and so none between.
    fn is_alone(&self) -> bool {
        self.begins_anew && self.frames.len() == 1
    }
}

impl Course {
    /// Before the first frame; at most `most` frames are rendered and not shown before one.
    pub const fn new(most: Option<usize>) -> Self {
        Self { most, next: None }
    }

    /// What is to be rendered to show frame `k`, which takes the frames from `first` on.
    fn leg(&self, k: usize, first: u64) -> Leg {
        let first = usize::try_from(first).unwrap_or(k).min(k);
        let first = self.most.map_or(first, |most| first.max(k.saturating_sub(most)));
        match self.next {
            Some(next) if (first..=k).contains(&next) => Leg { frames: next..k + 1, begins_anew: false },
            _ => Leg { frames: first..k + 1, begins_anew: true },
        }
    }

    /// Tells that the frames before the next one are lost.
    const fn lose(&mut self) {
        self.next = None;
    }

    /// Makes frame `k` of a path by `sessions`, after the frames that it takes: `make` lets all sessions render a frame. Gives
    /// what `make` gave for frame `k`, and whether there is no frame before it. After a change of machines all that the frame
    /// takes is made anew, so the frame has the bits of a run on that machine.
    ///
    /// # Errors
    /// [`PipelineError`] as of `make`; the next frame begins anew.
    pub fn travel<T>(
        &mut self,
        sessions: &mut [Session],
        k: usize,
        mut make: impl FnMut(&mut [Session], usize) -> Result<T, PipelineError>,
    ) -> Result<(T, bool), PipelineError> {
        loop {
            let backends = |sessions: &[Session]| sessions.iter().map(Session::backend).collect::<Vec<_>>();
            let before = backends(sessions);
            let first = sessions.iter().map(|session| session.pipeline().first_of_warm_up(k as u64)).min();
            let leg = self.leg(k, first.unwrap_or(k as u64));
            self.lose();
            if leg.begins_anew {
                sessions.iter_mut().for_each(|session| session.begin_at(leg.frames.start as u64));
            }
            for frame in leg.frames.start..k {
                make(sessions, frame)?;
            }
            let made = make(sessions, k)?;
            sessions.iter_mut().for_each(tell_notices);
            if backends(sessions) == before {
                self.next = Some(k + 1);
                return Ok((made, leg.is_alone()));
            }
        }
    }

    /// Renders frame `k` of `path` by `session`, as [`Self::travel`] does. Says whether there is no frame before it.
    ///
    /// # Errors
    /// [`PipelineError`] as of the session; the next frame begins anew.
    pub fn render(
        &mut self,
        session: &mut Session,
        path: &CameraPath,
        k: usize,
    ) -> Result<bool, PipelineError> {
        let ((), is_alone) = self.travel(std::slice::from_mut(session), k, |sessions, k| {
            sessions.iter_mut().try_for_each(|session| {
                let poses = session.settings().pipeline.poses_between(path, k);
                session.render_with_poses(&path.cameras()[k], &poses).map(|_| ())
            })
        })?;
        Ok(is_alone)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_go_on_where_they_can() {
        let mut course = Course::new(None);
        assert_eq!(course.leg(40, 32), Leg { frames: 32..41, begins_anew: true });
        course.next = Some(41);
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
