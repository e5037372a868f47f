//! The frame on a device, read top to bottom.

use std::fmt;

use gs3_compute::{Gpu, GpuError, Submission, Timings};
use gs3_raster::{GpuRasterizer, RasterSettings, Settled};
use gs3_reconstruct::ResetReason;
use gs3_reconstruct::gpu::{GpuImage, NeighborView};
use gs3_scene::{Camera, GBuffer, Image};

use super::sized::Sized;
use crate::error::PipelineError;
use crate::lattice::DepthLattice;
use crate::learned::Networks;
use crate::settings::PipelineSettings;

/// A frame to be made.
#[derive(Clone, Copy, Debug)]
pub struct GpuRequest<'a> {
    /// What sees it.
    pub camera: &'a Camera,
    /// How its low-resolution frame is rasterized.
    pub raster: &'a RasterSettings,
    /// Moments and cameras of the frames between the last one and this one; none where nothing is wanted between.
    pub between: &'a [(f64, Camera)],
}

/// What comes back to the processor with a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Take {
    /// Nothing.
    Nothing,
    /// What the next frame needs to know, some hundred bytes: what is shown is shown by the device.
    Facts,
    /// That, the frame and those between.
    Shown,
}

/// What is shown, in device memory: [`GpuImage::pixels`] are four halves a pixel, of which the fourth is no part of the
/// picture. The next frame writes to those between again, the one after it to this one.
#[derive(Clone, Copy, Debug)]
pub struct GpuPresented<'a> {
    /// The frames between the last one and this one, in order; none after a cut.
    pub between: &'a [GpuImage],
    /// The frame.
    pub current: &'a GpuImage,
}

/// Makes the frames of one pipeline on a device: all memory stays from frame to frame, and a frame is one submission.
pub struct GpuFrames {
    gpu: Gpu,
    settings: PipelineSettings,
    networks: Networks,
    sized: Option<Sized>,
    /// Why the next frame starts without history, if it does.
    invalid: Option<ResetReason>,
    /// The view of the frame submitted last, until it is kept.
    pending: Option<NeighborView>,
    /// Images between it and the one before.
    between: usize,
}

impl fmt::Debug for GpuFrames {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("GpuFrames")
            .field("settings", &self.settings)
            .field("invalid", &self.invalid)
            .finish_non_exhaustive()
    }
}

/// What [`GpuFrames::render`] tells of a frame.
pub(crate) struct Rendered {
    pub lattice: DepthLattice,
    pub submission: Submission,
}

impl GpuFrames {
    /// Frames on `gpu` as `settings` want them, refined by `networks` where there are any, in half precision if the
    /// device has it. Memory comes with the first frames.
    #[must_use]
    pub fn new(gpu: &Gpu, settings: &PipelineSettings, networks: &Networks) -> Self {
        let (gpu, settings, networks) = (gpu.clone(), *settings, networks.clone());
        let invalid = Some(ResetReason::FirstFrame);
        Self { gpu, settings, networks, sized: None, invalid, pending: None, between: 0 }
    }

    /// Whether it can make frames of `size`: networks on devices want whole blocks of pixels.
    #[must_use]
    pub fn takes(&self, size: [u32; 2]) -> bool {
        let is_whole = size.iter().all(|side| side.is_multiple_of(self.settings.scale));
        let Networks { super_sample, interpolate, .. } = &self.networks;
        (super_sample.is_none() && interpolate.is_none()) || is_whole
    }

    /// Forgets the frames before: the next one starts anew.
    pub fn reset(&mut self, reason: ResetReason) {
        self.invalid = Some(reason);
    }

    /// Submits the frame that `request` asks for; `rasterizer` is that of its scene on the same device. Nothing comes
    /// back. It becomes the last frame with [`Self::keep`]; submitted again before, it is made anew, as
    /// [`GpuRasterizer::settle`] may want it.
    ///
    /// # Errors
    /// [`PipelineError`] if a setting is out of range, or the device has no room or fails. The history is then as
    /// before, or gone if the frame has another size than the last one.
    pub fn submit(
        &mut self,
        rasterizer: &mut GpuRasterizer,
        request: &GpuRequest<'_>,
        timings: Option<&mut Timings>,
    ) -> Result<Submission, PipelineError> {
        self.submit_taking(Take::Nothing, rasterizer, request, timings)
    }

    /// The same, of which `take` comes back.
    fn submit_taking(
        &mut self,
        take: Take,
        rasterizer: &mut GpuRasterizer,
        request: &GpuRequest<'_>,
        timings: Option<&mut Timings>,
    ) -> Result<Submission, PipelineError> {
        let GpuRequest { camera, raster, between } = *request;
        let Self { gpu, settings, networks, sized, invalid, pending, between: made } = self;
        let size = [camera.width(), camera.height()];
        if sized.as_ref().is_some_and(|sized| sized.size != size) {
            *sized = None;
            *invalid = Some(ResetReason::SizeOrTierChange);
        }
        let sized = match sized {
            Some(sized) => sized,
            none => {
                let counters = rasterizer.counters().bytes();
                none.insert(Sized::new(gpu, settings, networks, size, counters)?)
            }
        };
        let (last, current) = (sized.newest, 1 - sized.newest);
        let view = NeighborView { camera: *camera, jitter: raster.jitter };
        let mut recorder = gpu.recorder(timings);

        // Gaussians to the low-resolution G-buffer.
        let lr_camera = camera.low_resolution(settings.scale);
        sized.record_rasterizing(&mut recorder, rasterizer, &lr_camera, raster, current)?;

        // G-buffer and history to the frame, which a network may refine.
        let last_view = sized.sides[last].view.filter(|_| invalid.is_none());
        if let Some(reason) = *invalid {
            sized.super_sampler.reset(reason);
        }
        sized.record_super_sampling(&mut recorder, current, &view, raster.margin, last_view.as_ref())?;

        // The last frame and this one to those between.
        let between = if last_view.is_some() { between } else { &[] };
        sized.record_between(&mut recorder, current, [last_view.as_ref(), Some(&view)], between)?;

        *made = between.len().min(sized.between.len());
        if take != Take::Nothing {
            sized.record_facts(&mut recorder, &rasterizer.counters());
        }
        if take == Take::Shown {
            sized.record_images(&mut recorder, current, *made);
        }
        *pending = Some(view);
        Ok(recorder.submit()?)
    }

    /// Makes the frame submitted last the last frame.
    pub fn keep(&mut self) {
        let (Some(sized), Some(view)) = (&mut self.sized, self.pending.take()) else { return };
        sized.super_sampler.keep();
        sized.newest = 1 - sized.newest;
        sized.sides[sized.newest].view = Some(view);
        self.invalid = None;
    }

    /// The frame submitted last and those between it and the one before, once the device has made them; none before
    /// the first.
    #[must_use]
    pub fn presented(&self) -> Option<GpuPresented<'_>> {
        let sized = self.sized.as_ref()?;
        let side = if self.pending.is_some() { 1 - sized.newest } else { sized.newest };
        Some(GpuPresented { between: &sized.between[..self.between], current: &sized.sides[side].image })
    }

    /// Makes the frame that `request` asks for, as often as it takes until all of it had room, and reads it back into
    /// `out`, if there is one: the image and those between.
    pub(crate) fn render(
        &mut self,
        rasterizer: &mut GpuRasterizer,
        request: &GpuRequest<'_>,
        mut timings: Option<&mut Timings>,
        mut out: Option<(&mut Image, &mut [Image])>,
    ) -> Result<Rendered, PipelineError> {
        let take = if out.is_some() { Take::Shown } else { Take::Facts };
        loop {
            let submission = self.submit_taking(take, rasterizer, request, timings.as_deref_mut())?;
            let Some(sized) = &self.sized else { return Err(no_memory().into()) };
            let current = 1 - sized.newest;
            let read = sized.readback.read(&self.gpu, &submission, |bytes| {
                let settled = rasterizer.settle_with(sized.places.counters_of(bytes));
                if let (Ok(Settled::Complete { .. }), Some((image, between))) = (&settled, &mut out) {
                    sized.sides[current].image.decode(sized.places.image_of(bytes), image);
                    for (k, image) in between.iter_mut().take(self.between).enumerate() {
                        sized.sides[current].image.decode(sized.places.between_of(bytes, k), image);
                    }
                }
                (settled, sized.places.lattice_of(bytes))
            });
            let (settled, lattice) = read?;
            if let Settled::Complete { .. } = settled? {
                self.keep();
                return Ok(Rendered { lattice, submission });
            }
        }
    }

    /// Reads the low-resolution G-buffer of the last frame back into `out`; nothing before the first frame.
    pub(crate) fn read_gbuffer(&self, out: &mut GBuffer) -> Result<(), PipelineError> {
        match &self.sized {
            Some(sized) => Ok(sized.sides[sized.newest].gbuffer.read(&self.gpu, out)?),
            None => Ok(()),
        }
    }
}

/// There is always memory for a frame that was submitted.
fn no_memory() -> GpuError {
    GpuError::Refused { what: "a frame".to_owned(), message: "expected its memory, found none".to_owned() }
}
