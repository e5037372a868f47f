//! Frames of a path with the bits of one run over all of it, whichever of them are rendered.

use std::ops::Range;

use gs3::scene::CameraPath;
use gs3::{Backend, PipelineError, Session};

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

    /// Makes frame `k` of a path by `sessions`, after the frames that it takes: `make` lets all sessions render a frame. Gives
    /// what `make` gave for frame `k`, and whether there is no frame before it. Where the CPU takes over for one session, all
    /// continue on the CPU, and what the frame takes is made anew: the frame has the bits of a run on the CPU.
    ///
    /// # Errors
    /// [`PipelineError`] as of `make`; the next frame begins anew.
    pub fn travel<T>(
        &mut self,
        sessions: &mut [Session],
        k: usize,
        mut make: impl FnMut(&mut [Session], usize) -> Result<T, PipelineError>,
    ) -> Result<(T, bool), PipelineError> {
        let on_gpus = |sessions: &[Session]| sessions.iter().filter(|s| s.backend() == Backend::Gpu).count();
        loop {
            if on_gpus(sessions) < sessions.len() {
                sessions.iter_mut().try_for_each(Session::render_on_cpu)?;
            }
            let before = on_gpus(sessions);
            let first = sessions.iter().map(|session| session.pipeline().first_of_warm_up(k as u64)).min();
            let leg = self.leg(k, first.unwrap_or(k as u64));
            self.next = None;
            if leg.begins_anew {
                sessions.iter_mut().for_each(|session| session.begin_at(leg.frames.start as u64));
            }
            let mut made = None;
            for frame in leg.frames.clone() {
                let frame_made = make(sessions, frame);
                tell_notices(sessions);
                made = Some(frame_made?).filter(|_| on_gpus(sessions) == before);
                if made.is_none() {
                    break;
                }
            }
            if let Some(made) = made {
                self.next = Some(k + 1);
                return Ok((made, leg.is_alone()));
            }
        }
    }

    /// Renders frame `k` of `path` by `sessions`, as [`Self::travel`] does. Says whether there is no frame before it.
    ///
    /// # Errors
    /// [`PipelineError`] as of a session; the next frame begins anew.
    pub fn render(
        &mut self,
        sessions: &mut [Session],
        path: &CameraPath,
        k: usize,
    ) -> Result<bool, PipelineError> {
        let ((), is_alone) = self.travel(sessions, k, |sessions, k| {
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
    use gs3::scene::demo;
    use gs3::{Machine, SessionSettings};

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
        course.next = None;
        assert_eq!(course.leg(41, 32), Leg { frames: 32..42, begins_anew: true });
    }

    /// As a driver that resets: frames after it have the bits of a run on the CPU.
    #[test]
    fn the_cpu_takes_over_for_all_sessions() {
        let settings = SessionSettings { backend: Backend::Gpu, ..SessionSettings::default() };
        let Ok(first) = Session::new(demo::scene().unwrap(), settings) else {
            return gs3::compute::skip_without_gpu("no session has one");
        };
        let gpu = first.machine().gpu().unwrap().clone();
        let found = Machine::FoundGpu(gpu.clone());
        let session =
            || Session::on(found.clone(), demo::scene().unwrap(), first.settings().clone()).unwrap();
        let mut sessions = [session(), session()];
        let path = demo::path().resized(64, 36).unwrap();
        let mut course = Course::new(None);
        assert!(course.render(&mut sessions, &path, 0).unwrap());
        gpu.destroy();
        for k in 1..3 {
            course.render(&mut sessions, &path, k).unwrap();
        }
        let on_cpu = SessionSettings { backend: Backend::Cpu, ..first.settings().clone() };
        let mut expected = [Session::new(demo::scene().unwrap(), on_cpu).unwrap()];
        let mut course = Course::new(None);
        course.render(&mut expected, &path, 2).unwrap();
        for session in &sessions {
            assert_eq!(session.backend(), Backend::Cpu);
            assert!(session.pipeline().last_image() == expected[0].pipeline().last_image());
        }
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
