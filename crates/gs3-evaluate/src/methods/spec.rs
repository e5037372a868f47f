//! Names of methods: `NAME[@FORMATION][+INTERPOLATION]`.

use std::fmt;
use std::str::FromStr;

use gs3::neural::model::{PublishedNetwork, Tier};
use gs3::{IN_BETWEEN, MAX_IN_BETWEEN, Quality};

/// How a method makes a frame from a rendered one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Spatial {
    /// Every pixel rasterized.
    Native,
    /// The nearest LR sample.
    Nearest,
    /// Linear interpolation.
    Bilinear,
    /// Catmull–Rom interpolation.
    Bicubic,
    /// Lanczos-3 interpolation.
    Lanczos,
    /// FSR 1: EASU and RCAS.
    Fsr1,
    /// Gradient-aware Hermite interpolation, mixed derivative estimated.
    Hermite,
    /// Gradient-aware Hermite interpolation, mixed derivative rendered (UpscaleGS).
    Spline,
    /// The best linear map of colours and gradients, fitted on other frames of the path.
    Ridge,
    /// gs3's super sampling with jittered history.
    History,
    /// [`Self::History`] with exact pixels where reconstruction is not to be trusted: what gs3 does by default.
    Refined(Quality),
    /// [`Self::History`], kriged where first-order predictions err visibly.
    Kriging,
    /// [`Self::Kriging`], rasterized beyond the edges that the camera turns to: all that networks refine, without them
    /// (below tiers fast and high, pixels are kriged coarsely and finely).
    Overscan,
    /// [`Self::History`] with all LR frames sampled at pixel centres: an ablation.
    Centered,
    /// [`Self::History`] without rendered gradients, an ablation: gradients of bicubic interpolation replace them.
    Gradientless,
    /// gs3's learned super sampling on top of [`Self::Overscan`].
    Learned(Tier),
    /// The network SPAN, 28 channels, ×4.
    Span,
    /// The network SAFMN++ light, ×4.
    Safmn,
    /// The network RT4KSR ×2, twice for ×4.
    Rt4ksr,
    /// A published network with weights of gs3's trainer.
    Trained(PublishedNetwork),
}

/// How LR frames come about. The choice decides how methods rank, so every result states its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Formation {
    /// Rasterized at LR with dilation 0.3/S²: exact point samples of the native image.
    #[default]
    Matched,
    /// Rasterized at LR with the dilation 0.3 of Kerbl et al.: a blurrier signal, as 3D Gaussian Splatting renders at that size.
    Kerbl,
    /// The native image reduced by an antialiasing bicubic filter, as image super resolution is trained. It needs the
    /// native image, so methods fed with it have no speed.
    Antialiased,
}

/// How a method makes in-between frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Interpolation {
    /// It shows rendered frames only.
    #[default]
    None,
    /// The previous frame once more.
    Repeat,
    /// The mean of the two neighbours.
    Blend,
    /// gs3's analytic warp of both neighbours to the poses between, and how many frames it makes: 1 to
    /// [`MAX_IN_BETWEEN`]. They are equally spaced; `warp` names one of them, `warp2` two and `warp3` three.
    Warp(u32),
    /// gs3's learned interpolation on top of [`Self::Warp`].
    Learned(Tier),
}

/// A method: how frames are super-sampled, from what, and how the ones between are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct MethodSpec {
    /// Rendered frames.
    pub spatial: Spatial,
    /// LR frames.
    pub formation: Formation,
    /// In-between frames.
    pub interpolation: Interpolation,
}

/// Why a text names no method.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SpecError {
    /// A part is not known.
    #[error("method '{method}': expected {part} one of {known}, found '{actual}'")]
    Unknown {
        /// The whole text.
        method: String,
        /// Which part of it.
        part: &'static str,
        /// Accepted values.
        known: String,
        /// The value found.
        actual: String,
    },
    /// The parts do not go together.
    #[error("method '{method}': expected {expected}")]
    Combination {
        /// The whole text.
        method: String,
        /// What would go together.
        expected: &'static str,
    },
}

const SPATIAL: [(&str, Spatial); 26] = [
    ("native", Spatial::Native),
    ("nearest", Spatial::Nearest),
    ("bilinear", Spatial::Bilinear),
    ("bicubic", Spatial::Bicubic),
    ("lanczos", Spatial::Lanczos),
    ("fsr1", Spatial::Fsr1),
    ("hermite", Spatial::Hermite),
    ("spline", Spatial::Spline),
    ("ridge", Spatial::Ridge),
    ("history", Spatial::History),
    ("refined_fast", Spatial::Refined(Quality::Fast)),
    ("refined", Spatial::Refined(Quality::Balanced)),
    ("refined_high", Spatial::Refined(Quality::High)),
    ("kriging", Spatial::Kriging),
    ("overscan", Spatial::Overscan),
    ("history_centered", Spatial::Centered),
    ("history_gradientless", Spatial::Gradientless),
    ("fast_ss", Spatial::Learned(Tier::Fast)),
    ("balanced_ss", Spatial::Learned(Tier::Balanced)),
    ("high_ss", Spatial::Learned(Tier::High)),
    ("span", Spatial::Span),
    ("safmn", Spatial::Safmn),
    ("rt4ksr", Spatial::Rt4ksr),
    ("ecbsr_trained", Spatial::Trained(PublishedNetwork::Ecbsr)),
    ("rt4ksr_trained", Spatial::Trained(PublishedNetwork::Rt4ksr)),
    ("ninasr_trained", Spatial::Trained(PublishedNetwork::Ninasr)),
];
const FORMATIONS: [(&str, Formation); 3] =
    [("matched", Formation::Matched), ("kerbl", Formation::Kerbl), ("antialiased", Formation::Antialiased)];
const INTERPOLATIONS: [(&str, Interpolation); 8] = [
    ("repeat", Interpolation::Repeat),
    ("blend", Interpolation::Blend),
    ("warp", Interpolation::Warp(1)),
    ("warp2", Interpolation::Warp(2)),
    ("warp3", Interpolation::Warp(3)),
    ("fast", Interpolation::Learned(Tier::Fast)),
    ("balanced", Interpolation::Learned(Tier::Balanced)),
    ("high", Interpolation::Learned(Tier::High)),
];
/// Names of both parts of gs3 together. `default` is what `gs3 render` does unless it is told otherwise. The others have
/// one frame between two rendered ones, as the paper: `history+warp` is `--refine off --in-between 1`, `kriging+warp` the
/// same with `--kriging`, `overscan+warp` with `--overscan` too, `fast_ss+warp` with learning, and so on.
const WHOLE: [(&str, (Spatial, Interpolation)); 7] = [
    ("default", (Spatial::Refined(Quality::Balanced), Interpolation::Warp(IN_BETWEEN))),
    ("analytic", (Spatial::History, Interpolation::Warp(1))),
    ("kriged", (Spatial::Kriging, Interpolation::Warp(1))),
    ("overscanned", (Spatial::Overscan, Interpolation::Warp(1))),
    ("fast", (Spatial::Learned(Tier::Fast), Interpolation::Warp(1))),
    ("balanced", (Spatial::Learned(Tier::Balanced), Interpolation::Warp(1))),
    ("high", (Spatial::Learned(Tier::High), Interpolation::Warp(1))),
];

/// The methods compared where none are named.
pub const DEFAULT_METHODS: &str = "native,nearest,bilinear,bicubic,lanczos,fsr1,hermite,spline,ridge,history,refined,\
     bicubic@kerbl,bicubic+repeat,bicubic+blend,history+repeat,history+blend,analytic,default";

impl Spatial {
    /// The file of a published network's weights in their folder, if the method is one.
    #[must_use]
    pub const fn weight_file(self) -> Option<&'static str> {
        match self {
            Self::Span => Some("span28_x4.safetensors"),
            Self::Safmn => Some("safmnpp_light_x4.safetensors"),
            Self::Rt4ksr => Some("rt4ksr_x2.safetensors"),
            _ => None,
        }
    }

    /// Whether it reads image gradients or depth, which only rasterized LR frames have.
    const fn reads_gbuffer(self) -> bool {
        matches!(self, Self::Hermite | Self::Spline | Self::Ridge) || self.has_history()
    }

    /// Whether frames depend on the ones before.
    pub(crate) const fn has_history(self) -> bool {
        matches!(
            self,
            Self::History
                | Self::Refined(_)
                | Self::Kriging
                | Self::Overscan
                | Self::Centered
                | Self::Gradientless
                | Self::Learned(_)
        )
    }

    /// Whether [`gs3::FramePipeline`] makes it, and so in-between frames, too.
    pub(super) const fn is_pipeline(self) -> bool {
        self.has_history() && !matches!(self, Self::Gradientless)
    }

    /// Whether LR frames are jittered.
    pub(crate) const fn is_jittered(self) -> bool {
        self.has_history() && !matches!(self, Self::Centered)
    }
}

impl Formation {
    /// The formation's name.
    #[must_use]
    pub fn name(self) -> &'static str {
        name_of(&FORMATIONS, self)
    }
}

impl MethodSpec {
    /// Rasterizing every pixel: what speed-ups are stated against.
    pub const NATIVE: Self =
        Self { spatial: Spatial::Native, formation: Formation::Matched, interpolation: Interpolation::None };

    /// The methods, each once, native rendering first.
    pub(crate) fn with_native(methods: &[Self]) -> Vec<Self> {
        let mut all = vec![Self::NATIVE];
        for method in methods {
            if !all.contains(method) {
                all.push(*method);
            }
        }
        all
    }

    /// Frames shown between two rendered ones.
    #[must_use]
    pub const fn in_between(self) -> u32 {
        match self.interpolation {
            Interpolation::None => 0,
            Interpolation::Repeat | Interpolation::Blend | Interpolation::Learned(_) => 1,
            Interpolation::Warp(count) => count,
        }
    }

    /// Frames shown for each rendered one.
    #[must_use]
    pub const fn displayed_per_rendered(self) -> usize {
        self.in_between() as usize + 1
    }

    /// All names. Each may be followed by one of [`Self::formations`] and one of [`Self::interpolations`].
    #[must_use]
    pub fn names() -> String {
        let whole = WHOLE.iter().map(|(name, _)| *name);
        SPATIAL.iter().map(|(name, _)| *name).chain(whole).collect::<Vec<_>>().join(", ")
    }

    /// All names of LR formations.
    #[must_use]
    pub fn formations() -> String {
        listed(&FORMATIONS)
    }

    /// All names of interpolations.
    #[must_use]
    pub fn interpolations() -> String {
        listed(&INTERPOLATIONS)
    }

    pub(super) fn check(self, method: &str) -> Result<Self, SpecError> {
        let learned = matches!(self.interpolation, Interpolation::Learned(_));
        let warps = matches!(self.interpolation, Interpolation::Warp(_)) || learned;
        let is_too_few_or_many =
            self.interpolation == Interpolation::Warp(0) || self.in_between() > MAX_IN_BETWEEN;
        let expected = if is_too_few_or_many {
            "a warp to 1 to 3 frames between two rendered ones"
        } else if self.spatial == Spatial::Native && (self.formation != Formation::Matched || warps) {
            "no LR formation and no warp with native rendering"
        } else if self.formation == Formation::Antialiased && (self.spatial.reads_gbuffer() || warps) {
            "a rasterized LR formation (matched or kerbl) where gradients or depth are read"
        } else if self.formation == Formation::Antialiased && matches!(self.spatial, Spatial::Trained(_)) {
            "a rasterized LR formation (matched or kerbl), sampled as the network was trained"
        } else if learned && !self.spatial.is_pipeline() {
            "learned interpolation of frames that gs3 super-samples (history, fast_ss, balanced_ss, high_ss)"
        } else {
            return Ok(self);
        };
        Err(SpecError::Combination { method: method.into(), expected })
    }
}

impl FromStr for MethodSpec {
    type Err = SpecError;

    fn from_str(method: &str) -> Result<Self, SpecError> {
        let (rest, interpolation) = match method.split_once('+') {
            Some((rest, name)) => (rest, lookup(method, "interpolation", &INTERPOLATIONS, name)?),
            None => (method, Interpolation::None),
        };
        let (name, formation) = match rest.split_once('@') {
            Some((name, formation)) => (name, lookup(method, "LR formation", &FORMATIONS, formation)?),
            None => (rest, Formation::Matched),
        };
        let whole = WHOLE.iter().find(|(whole, _)| *whole == name);
        if let (Some((_, (spatial, interpolation))), Interpolation::None) = (whole, interpolation) {
            return Self { spatial: *spatial, formation, interpolation: *interpolation }.check(method);
        }
        let spatial = find(&SPATIAL, name).ok_or_else(|| unknown(method, "name", Self::names(), name))?;
        Self { spatial, formation, interpolation }.check(method)
    }
}

impl fmt::Display for MethodSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let whole = WHOLE.iter().find(|(_, parts)| *parts == (self.spatial, self.interpolation));
        f.write_str(whole.map_or_else(|| name_of(&SPATIAL, self.spatial), |(name, _)| name))?;
        if self.formation != Formation::Matched {
            write!(f, "@{}", self.formation.name())?;
        }
        if self.interpolation != Interpolation::None && whole.is_none() {
            write!(f, "+{}", name_of(&INTERPOLATIONS, self.interpolation))?;
        }
        Ok(())
    }
}

fn name_of<T: PartialEq>(table: &[(&'static str, T)], value: T) -> &'static str {
    table.iter().find(|(_, v)| *v == value).map_or("", |(name, _)| name)
}

fn lookup<T: Copy>(
    method: &str,
    part: &'static str,
    table: &[(&'static str, T)],
    actual: &str,
) -> Result<T, SpecError> {
    find(table, actual).ok_or_else(|| unknown(method, part, listed(table), actual))
}

fn find<T: Copy>(table: &[(&str, T)], name: &str) -> Option<T> {
    table.iter().find(|(known, _)| *known == name).map(|(_, value)| *value)
}

fn listed<T>(table: &[(&str, T)]) -> String {
    table.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ")
}

fn unknown(method: &str, part: &'static str, known: String, actual: &str) -> SpecError {
    SpecError::Unknown { method: method.into(), part, known, actual: actual.into() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs3::PipelineSettings;

    #[test]
    fn names_read_back_as_written() {
        let names = DEFAULT_METHODS
            .split(',')
            .chain(["span@antialiased", "analytic@kerbl", "hermite@kerbl+warp", "ecbsr_trained+warp"])
            .chain(["refined+warp", "refined_fast+warp2", "history@kerbl+warp3", "fast_ss+warp2"])
            .chain([
                "fast",
                "balanced_ss",
                "high@kerbl",
                "balanced_ss+balanced",
                "history+balanced",
                "fast_ss+high",
                "kriging",
                "kriged",
                "overscan",
                "overscanned",
                "high_ss+blend",
            ]);
        for name in names {
            assert_eq!(name.parse::<MethodSpec>().map(|m| m.to_string()).as_deref(), Ok(name));
        }
        for (parts, whole) in
            [("history+warp", "analytic"), ("balanced_ss+warp", "balanced"), ("refined+warp2", "default")]
        {
            assert_eq!(parts.parse::<MethodSpec>(), whole.parse());
        }
    }

    #[test]
    fn methods_say_how_many_frames_they_show_between_two_rendered_ones() {
        let in_between = |name: &str| name.parse::<MethodSpec>().map(MethodSpec::in_between);
        for (name, count) in [
            ("refined", 0),
            ("bicubic+repeat", 1),
            ("bicubic+blend", 1),
            ("analytic", 1),
            ("balanced_ss+balanced", 1),
            ("refined+warp", 1),
            ("refined+warp2", 2),
            ("history+warp3", 3),
        ] {
            assert_eq!(in_between(name), Ok(count), "{name}");
        }
        assert_eq!(in_between("default"), Ok(PipelineSettings::default().in_between));
        let most = INTERPOLATIONS.iter().filter(|(_, part)| matches!(part, Interpolation::Warp(_))).count();
        assert_eq!(most, MAX_IN_BETWEEN as usize);
        for count in [0, MAX_IN_BETWEEN + 1] {
            let spec = MethodSpec {
                spatial: Spatial::Bicubic,
                formation: Formation::Matched,
                interpolation: Interpolation::Warp(count),
            };
            assert!(matches!(spec.check(""), Err(SpecError::Combination { .. })), "{count}");
        }
    }

    #[test]
    fn what_makes_no_method_is_refused_with_what_would() {
        let message = |name: &str| name.parse::<MethodSpec>().map_err(|e| e.to_string()).unwrap_err();
        assert!(message("bicubik").contains("one of native, nearest"), "{}", message("bicubik"));
        assert!(
            message("bicubik").contains(
                "ninasr_trained, default, analytic, kriged, overscanned, fast, balanced, high, found"
            )
        );
        assert!(message("bicubic@blurry").contains("found 'blurry'"));
        assert!(message("bicubic+flow").contains("repeat, blend, warp, warp2, warp3"));
        for name in [
            "native@kerbl",
            "native+warp",
            "native+warp2",
            "bicubic+warp4",
            "hermite@antialiased",
            "bicubic@antialiased+warp",
            "bicubic+balanced",
            "rt4ksr_trained@antialiased",
            "balanced@antialiased",
            "balanced+warp",
            "",
        ] {
            assert!(name.parse::<MethodSpec>().is_err(), "{name}");
        }
    }
}
