//! The reference frames of a session: frames without history, of pipelines of their own.

use std::sync::Arc;

use gs3_reconstruct::ResetReason;
use gs3_scene::{Camera, Image};

use super::Session;
use crate::error::PipelineError;
use crate::frame::FramePipeline;
use crate::now::now;
use crate::settings::{Mode, PipelineSettings};

/// The pipeline that makes reference frames of one mode.
pub(super) struct Reference {
    pipeline: FramePipeline,
    /// The camera of the last reference frame, if that frame is complete and shows the current scene.
    camera: Option<Camera>,
}

impl Session {
    /// The frame of `camera` in `mode`, without history: native, or bicubic from the settings' low resolution. Modes
    /// with history give their first frame. If the last reference frame of `mode` has this camera, it is returned
    /// unchanged.
    ///
    /// # Errors
    /// [`PipelineError`] as [`Self::render`], and if the scene does not fit on a GPU for a second time.
    pub fn reference(&mut self, mode: Mode, camera: &Camera) -> Result<&Image, PipelineError> {
        now(self.reference_async(mode, camera))
    }

    /// The frame of `camera` in `mode`, as [`Self::reference`] makes it, without blocking a browser.
    ///
    /// # Errors
    /// As [`Self::reference`].
    pub async fn reference_async(&mut self, mode: Mode, camera: &Camera) -> Result<&Image, PipelineError> {
        if let Err(error) = self.make_reference(mode, camera).await {
            self.take_over(error)?;
            self.make_reference(mode, camera).await?;
        }
        self.last_reference(mode).ok_or(PipelineError::Internal { expected: "a reference frame" })
    }

    async fn make_reference(&mut self, mode: Mode, camera: &Camera) -> Result<(), PipelineError> {
        let place = self.references.iter().position(|made| made.pipeline.settings().mode == mode);
        let place = match place {
            Some(place) => place,
            None => {
                let pipeline = self.reference_pipeline(mode)?;
                self.references.push(Reference { pipeline, camera: None });
                self.references.len() - 1
            }
        };
        let Reference { pipeline, camera: last } = &mut self.references[place];
        if *last == Some(*camera) {
            return Ok(());
        }
        *last = None;
        pipeline.reset(ResetReason::CameraCut);
        pipeline.render_async(camera).await?;
        *last = Some(*camera);
        Ok(())
    }

    fn reference_pipeline(&self, mode: Mode) -> Result<FramePipeline, PipelineError> {
        let settings = PipelineSettings { mode, ..self.settings.pipeline };
        #[cfg_attr(not(feature = "gpu"), expect(unused_mut, reason = "no GPU takes it"))]
        let mut pipeline =
            FramePipeline::with_networks(Arc::clone(self.scene()), settings, &self.settings.networks)?;
        #[cfg(feature = "gpu")]
        if let Some(gpu) = self.machine.gpu() {
            pipeline.render_on(gpu)?;
        }
        Ok(pipeline)
    }

    /// The last frame of [`Self::reference`] in `mode`, if it shows the current scene with the current settings.
    #[must_use]
    pub fn last_reference(&self, mode: Mode) -> Option<&Image> {
        let made = self.references.iter().find(|made| made.pipeline.settings().mode == mode)?;
        made.camera.map(|_| made.pipeline.last_image())
    }
}
