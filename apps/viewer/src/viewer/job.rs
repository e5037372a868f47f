//! A frame on its way: what is asked of the session, and what comes back.

use std::time::Duration;

use gs3::scene::Camera;
use gs3::{Mode, PipelineError, Refine, ResetReason, Session, StageTimes};

use crate::compare::{Compare, ComparedMethod};
use crate::paint::Framebuffer;
use crate::views::{View, show_difference, show_image, show_view};

/// Factor on the differences to native, so that one step of 8 bits is visible.
const DIFFERENCE_GAIN: f32 = 8.0;

/// The frame to make.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Make {
    /// None: the last frame is shown in another way.
    Nothing,
    /// The next frame of the history.
    Reconstructed {
        /// Which pixels are exact; none leaves the choice as it is.
        refine: Option<Refine>,
        /// When the camera was where between the frame before and this one: an in-between frame for each.
        between: Vec<(Duration, Camera)>,
    },
    /// The native image.
    Native,
}

/// What is asked of the session.
#[derive(Debug)]
pub(super) struct Job {
    /// The frame's camera.
    pub camera: Camera,
    /// When the camera was there, by the viewer's clock.
    pub asked: Duration,
    pub make: Make,
    /// Whether the native image is shown instead of the reconstructed one.
    pub shows_native: bool,
    pub view: View,
    pub compare: Compare,
    /// The first column of each part of a comparison but the first.
    pub columns: Vec<usize>,
    /// Pictures whose memory can be used again.
    pub spare: Vec<Framebuffer>,
}

/// A picture to show.
#[derive(Clone, Debug)]
pub(super) struct Shown {
    pub picture: Framebuffer,
    pub camera: Camera,
    /// When the camera was there.
    pub asked: Duration,
    /// Whether the scene was rendered for the picture; false for in-between frames.
    pub is_rendered: bool,
}

/// What comes back.
#[derive(Debug)]
pub(super) struct Finished {
    pub camera: Camera,
    pub make: Make,
    pub view: View,
    pub compare: Compare,
    /// The pictures in the order in which they are shown, or why there are none.
    pub pictures: Result<Vec<Shown>, PipelineError>,
    /// How long the frame took, and all that the session rendered with it: frames to compare with, a G-buffer.
    pub making: Duration,
    pub rendering: Duration,
    /// How long all of the job took.
    pub took: Duration,
    /// The stages of the frame.
    pub times: StageTimes,
    /// Notices of the session.
    pub notices: Vec<String>,
    pub spare: Vec<Framebuffer>,
}

impl Job {
    /// Does what is asked.
    pub async fn run(mut self, session: &mut Session, clock: &dyn Fn() -> Duration) -> Finished {
        let begun = clock();
        let made = self.make(session).await;
        let making = clock().saturating_sub(begun);
        let rendered = match made {
            Ok(()) => self.make_beside(session).await,
            Err(error) => Err(error),
        };
        let rendering = clock().saturating_sub(begun);
        let pictures = rendered.map(|()| self.compose(session));
        Finished {
            camera: self.camera,
            view: self.view,
            compare: self.compare,
            pictures,
            making,
            rendering,
            took: clock().saturating_sub(begun),
            times: session.pipeline().times(),
            notices: session.take_notices(),
            make: self.make,
            spare: self.spare,
        }
    }

    /// Makes the frame.
    async fn make(&self, session: &mut Session) -> Result<(), PipelineError> {
        match &self.make {
            Make::Nothing => {}
            Make::Reconstructed { refine, between } => {
                if let Some(refine) = refine {
                    session.set_refine(*refine)?;
                }
                session.set_in_between(between.len() as u32)?;
                let poses: Vec<Camera> = between.iter().map(|(_, camera)| *camera).collect();
                session.render_with_poses_async(&self.camera, &poses).await?;
            }
            Make::Native => _ = session.reference_async(Mode::Native, &self.camera).await?,
        }
        Ok(())
    }

    /// Makes what is shown beside the frame or instead of it.
    async fn make_beside(&self, session: &mut Session) -> Result<(), PipelineError> {
        // Of a frame that was made before, too: its view may be another now.
        if !matches!(self.make, Make::Native) && self.view.reads_gbuffer() {
            session.fetch_gbuffer_async().await?;
            if self.view == View::Normals {
                session.fetch_normals()?;
            }
        }
        if self.make == Make::Nothing {
            return Ok(());
        }
        for method in self.compare.methods() {
            if let ComparedMethod::Reference(mode) = method {
                session.reference_async(*mode, &self.camera).await?;
            }
        }
        if self.compare == Compare::Difference {
            session.reference_async(Mode::Native, &self.camera).await?;
        }
        Ok(())
    }

    /// The in-between frames, and the shown part of the frame.
    fn compose(&mut self, session: &Session) -> Vec<Shown> {
        let mut shown = Vec::new();
        // Frames without history have none in between, except keyframes.
        if let Make::Reconstructed { between, .. } = &self.make
            && matches!(session.pipeline().last_reset(), None | Some(ResetReason::Keyframe))
        {
            for (image, (asked, camera)) in session.pipeline().presented().iter().zip(between) {
                let mut picture = self.spare.pop().unwrap_or_default();
                picture.resize([image.width(), image.height()]);
                show_image(image, 0..image.width(), &mut picture);
                shown.push(Shown { picture, camera: *camera, asked: *asked, is_rendered: false });
            }
        }
        let mut picture = self.spare.pop().unwrap_or_default();
        self.compose_frame(session, &mut picture);
        let is_rendered = self.make != Make::Nothing;
        shown.push(Shown { picture, camera: self.camera, asked: self.asked, is_rendered });
        shown
    }

    /// The shown part of the frame.
    fn compose_frame(&self, session: &Session, picture: &mut Framebuffer) {
        let pipeline = session.pipeline();
        let native = session.last_reference(Mode::Native);
        let shown = native.filter(|_| self.shows_native).unwrap_or_else(|| pipeline.last_image());
        let size = [shown.width(), shown.height()];
        let wanted = [self.camera.width() as usize, self.camera.height() as usize];
        picture.resize(wanted);
        if size != wanted {
            // A frame of the new size is on its way; until then there is no frame to show.
            return picture.pixels.fill(0);
        }
        if self.view != View::Picture {
            return show_view(self.view, pipeline, picture);
        }
        if let (Compare::Difference, Some(native)) = (self.compare, native) {
            return show_difference(shown, native, DIFFERENCE_GAIN, picture);
        }
        let mut from = 0;
        let mut ends = self.columns.iter().copied();
        for method in self.compare.methods() {
            let end = ends.next().unwrap_or(size[0]);
            let image = match method {
                ComparedMethod::Reference(mode) => session.last_reference(*mode).unwrap_or(shown),
                ComparedMethod::Gs3 => shown,
            };
            show_image(image, from..end, picture);
            from = end;
        }
    }
}
