//! What the numbers of a renderer's descriptor say, in the library's own types.

use std::time::Duration;

use gs3::{Backend, Dilation, IN_BETWEEN, Mode, Networks, PipelineSettings, Quality, Refine, Scale, Tier};

use super::{gs3_backend, gs3_dilation, gs3_mode, gs3_networks, gs3_quality, gs3_refine, gs3_renderer_desc};
use crate::choice::{choice, flag, or_default};
use crate::frame::{kriging, sampling};
use crate::status::Fault;
use crate::status::gs3_status::GS3_ERROR_UNSUPPORTED;

impl gs3_renderer_desc {
    /// How frames are made, and the networks that refine them.
    pub(super) fn settings(&self) -> Result<(PipelineSettings, Networks), Fault> {
        let modes = [
            (gs3_mode::GS3_MODE_SUPER_SAMPLE as u32, Mode::SuperSample),
            (gs3_mode::GS3_MODE_FULL as u32, Mode::Full),
            (gs3_mode::GS3_MODE_NATIVE as u32, Mode::Native),
            (gs3_mode::GS3_MODE_BICUBIC as u32, Mode::Bicubic),
        ];
        let qualities = [
            (gs3_quality::GS3_QUALITY_BALANCED as u32, Quality::Balanced),
            (gs3_quality::GS3_QUALITY_FAST as u32, Quality::Fast),
            (gs3_quality::GS3_QUALITY_HIGH as u32, Quality::High),
        ];
        let dilations = [
            (gs3_dilation::GS3_DILATION_MATCHED as u32, Dilation::Matched),
            (gs3_dilation::GS3_DILATION_KERBL as u32, Dilation::Kerbl),
            (gs3_dilation::GS3_DILATION_VALUE as u32, Dilation::Value(self.dilation_value)),
        ];
        let settings = PipelineSettings {
            mode: choice("mode", "gs3_mode", self.mode, &modes)?,
            scale: if self.scale == 0 { Scale::Auto } else { Scale::Fixed(self.scale) },
            sampling: sampling(self.sampling)?,
            kriging: kriging(self.kriging)?,
            overscan: flag("overscan", self.overscan)?,
            refine: self.refine()?,
            quality: choice("quality", "gs3_quality", self.quality, &qualities)?,
            dilation: choice("dilation", "gs3_dilation", self.dilation, &dilations)?,
            in_between: or_default(self.in_between_count, IN_BETWEEN),
            background: self.background,
            ..PipelineSettings::default()
        };
        Ok((settings, self.networks(settings.scale.of_networks())?))
    }

    fn refine(&self) -> Result<Refine, Fault> {
        let value = self.refine_value;
        // A time that is none is told where it is asked for.
        let time = Duration::try_from_secs_f32(value / 1e3).ok().filter(|time| !time.is_zero());
        let all = [
            (gs3_refine::GS3_REFINE_AUTO as u32, Some(Refine::Auto)),
            (gs3_refine::GS3_REFINE_OFF as u32, Some(Refine::Off)),
            (gs3_refine::GS3_REFINE_SHARE as u32, Some(Refine::Share(value))),
            (gs3_refine::GS3_REFINE_FRAME_TIME as u32, time.map(Refine::FrameTime)),
        ];
        let refine = choice("refine", "gs3_refine", self.refine, &all)?;
        refine.ok_or_else(|| Fault::argument("refine_value", "milliseconds above 0", value))
    }

    fn networks(&self, scale: u32) -> Result<Networks, Fault> {
        let tiers = [
            (gs3_networks::GS3_NETWORKS_NONE as u32, None),
            (gs3_networks::GS3_NETWORKS_FAST as u32, Some(Tier::Fast)),
            (gs3_networks::GS3_NETWORKS_BALANCED as u32, Some(Tier::Balanced)),
            (gs3_networks::GS3_NETWORKS_HIGH as u32, Some(Tier::High)),
        ];
        let refines_between = flag("networks_between", self.networks_between)?;
        let Some(tier) = choice("networks", "gs3_networks", self.networks, &tiers)? else {
            return Ok(Networks::default());
        };
        let networks = Networks::shipped(scale, tier)
            .map_err(|error| Fault::new(GS3_ERROR_UNSUPPORTED, format_args!("networks: {error}")))?;
        Ok(if refines_between { networks } else { Networks { interpolate: None, ..networks } })
    }

    /// What renders.
    pub(super) fn backend(&self) -> Result<Backend, Fault> {
        let all = [
            (gs3_backend::GS3_BACKEND_AUTO as u32, Backend::Auto),
            (gs3_backend::GS3_BACKEND_CPU as u32, Backend::Cpu),
            (gs3_backend::GS3_BACKEND_GPU as u32, Backend::Gpu),
        ];
        choice("backend", "gs3_backend", self.backend, &all)
    }
}
