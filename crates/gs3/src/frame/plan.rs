//! What follows from the settings and the networks.

use gs3_neural::Weights;
use gs3_neural::model::{Tier, tier_of};
use gs3_raster::{MAX_MARGIN, Outputs, RasterSettings};
use gs3_reconstruct::{BlockBudget, Kriging, Sampling};

use super::inputs::FrameInputs;
use crate::error::{NetworkError, PipelineError};
use crate::learned::Networks;
use crate::refine::Refine;
use crate::scale::Scale;
use crate::settings::{MAX_IN_BETWEEN, Mode, PipelineSettings};

/// How all frames of a pipeline are made: its settings, and the values derived from the settings and the networks.
/// Both machines read this plan, so neither derives values on its own.
#[derive(Clone, Debug)]
pub struct FramePlan {
    /// The settings as the caller gave them.
    pub settings: PipelineSettings,
    /// The scale of frames, HR over LR size on each axis: 1 in [`Mode::Native`], the networks' if there are any.
    pub scale: Scale,
    pub sampling: Sampling,
    /// Which pixels are kriged: at least the pixels that were kriged when the network's tier was trained.
    pub kriging: Kriging,
    /// Which pixels are rasterized exactly.
    pub refine: Refine,
    /// The widest margin of LR frames beyond each edge, in LR pixels; 0 if they have no margins.
    pub widest_margin: u32,
    /// Number of frames interpolated before the next rendered frame, at most [`Self::most_in_between`].
    pub in_between: u32,
    /// The networks that the mode uses.
    pub networks: Networks,
}

impl FramePlan {
    /// # Errors
    /// [`PipelineError::InBetween`] if the number of in-between frames is too small or too large; [`PipelineError`]
    /// of the network if its weights name no tier.
    pub fn new(settings: PipelineSettings, networks: &Networks) -> Result<Self, PipelineError> {
        let mode = settings.mode;
        if mode == Mode::Full && !(1..=MAX_IN_BETWEEN).contains(&settings.in_between) {
            return Err(PipelineError::InBetween {
                expected: [1, MAX_IN_BETWEEN],
                actual: settings.in_between,
            });
        }
        check_refine(settings.refine)?;
        // Networks that the mode does not use count as well, so that frames of all modes are comparable.
        let scale = if mode == Mode::Native { Scale::Fixed(1) } else { settings.scale.with(networks) };
        let Networks { super_sample, interpolate, arithmetic } = networks.clone();
        let networks = Networks {
            super_sample: super_sample.filter(|_| mode.has_history()),
            interpolate: interpolate.filter(|_| mode == Mode::Full),
            arithmetic,
        };
        let weights = networks.super_sample.as_deref();
        let has_margins = mode.has_history() && (settings.overscan || weights.is_some());
        Ok(Self {
            settings,
            scale,
            sampling: if mode == Mode::Native { Sampling::Centered } else { settings.sampling },
            kriging: settings.kriging.max(weights.map_or(Ok(Kriging::Off), least_kriging)?),
            refine: if mode.has_history() { settings.refine } else { Refine::Off },
            widest_margin: if has_margins { MAX_MARGIN } else { 0 },
            in_between: settings.displayed_per_rendered() as u32 - 1,
            networks,
        })
    }

    /// Changes the choice of exact pixels.
    ///
    /// # Errors
    /// [`PipelineError::RefineShare`] if the share is not in `[0, 1]`.
    pub fn set_refine(&mut self, refine: Refine) -> Result<(), PipelineError> {
        check_refine(refine)?;
        self.settings.refine = refine;
        self.refine = if self.settings.mode.has_history() { refine } else { Refine::Off };
        Ok(())
    }

    /// The blocks that may be exact in a frame. `fitting` is the share of the pixels that fits the time of a frame.
    pub fn block_budget(&self, inputs: &FrameInputs, fitting: f32) -> BlockBudget {
        match self.refine {
            refine if !refine.is_on() => BlockBudget { most: 0.0, least_error: 0.0 },
            refine if inputs.reset.is_some() && refine.starts_exact() => BlockBudget::ALL,
            Refine::Off | Refine::Auto => self.settings.quality.budget(inputs.camera.size()),
            Refine::Share(share) => BlockBudget { most: share, least_error: 0.0 },
            Refine::FrameTime(_) => BlockBudget { most: fitting, least_error: 0.0 },
        }
    }

    /// The blocks that may be exact in an in-between frame; none if in-between frames have no exact pixels.
    pub fn budget_between(&self) -> Option<BlockBudget> {
        let is_auto = self.refine == Refine::Auto && self.networks.interpolate.is_none();
        self.settings.quality.budget_between().filter(|_| is_auto)
    }

    /// The rasterizer's settings for the native image.
    pub fn raster_image(&self) -> RasterSettings {
        RasterSettings {
            dilation: self.settings.dilation.at_scale(1),
            background: self.settings.background,
            ..RasterSettings::new(Outputs::Color)
        }
    }

    /// Changes the number of frames interpolated before each rendered frame.
    ///
    /// # Errors
    /// [`PipelineError::InBetween`] if there is no memory for so many.
    pub const fn set_in_between(&mut self, count: u32) -> Result<(), PipelineError> {
        let most = self.most_in_between();
        if count > most {
            return Err(PipelineError::InBetween { expected: [0, most], actual: count });
        }
        self.in_between = count;
        Ok(())
    }

    /// Largest number of frames interpolated before a rendered frame. Machines have memory for as many.
    pub const fn most_in_between(&self) -> u32 {
        self.settings.displayed_per_rendered() as u32 - 1
    }

    /// Moments of the frames interpolated before the next rendered frame, in (0, 1), in order.
    pub fn moments(&self) -> impl Iterator<Item = f64> + use<> {
        PipelineSettings { in_between: self.in_between, ..self.settings }.moments()
    }

    /// The planes of LR frames that the stages read: networks read normals, too.
    pub const fn outputs(&self) -> Outputs {
        match self.networks.super_sample {
            Some(_) => Outputs::GBuffer,
            None => Outputs::Samples,
        }
    }

    /// The rasterizer's settings for `outputs` of a frame.
    pub fn raster(&self, outputs: Outputs, inputs: &FrameInputs) -> RasterSettings {
        RasterSettings {
            dilation: self.settings.dilation.at_scale(inputs.scale),
            background: self.settings.background,
            jitter: inputs.jitter,
            margin: inputs.margin,
            ..RasterSettings::new(outputs)
        }
    }

    /// Checks the rasterizer's settings that are the same for every frame.
    pub fn check_raster(&self) -> Result<(), PipelineError> {
        Ok(RasterSettings {
            dilation: self.settings.dilation.at_scale(self.scale.largest()),
            background: self.settings.background,
            ..RasterSettings::new(Outputs::GBuffer)
        }
        .check()?)
    }
}

fn check_refine(refine: Refine) -> Result<(), PipelineError> {
    match refine {
        Refine::Share(share) if !(0.0..=1.0).contains(&share) => {
            Err(PipelineError::RefineShare { actual: share })
        }
        _ => Ok(()),
    }
}

/// The least kriging that the network of `weights` needs: its tier was trained on frames kriged in this way.
///
/// # Errors
/// [`NetworkError`] if the weights name no tier.
fn least_kriging(weights: &Weights) -> Result<Kriging, NetworkError> {
    Ok(match tier_of(&weights.header)? {
        Tier::Fast => Kriging::Coarse,
        Tier::Balanced => Kriging::On,
        Tier::High => Kriging::Fine,
    })
}
