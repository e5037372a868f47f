//! What the frames of a folder are: written beside them, so that frames of one kind are put together and others refused.

use std::io::{self, ErrorKind};
use std::path::Path;

use gs3::scene::{Camera, CameraPath, Scene};
use gs3::{Machine, Mode, Networks, PipelineError, PipelineSettings};
use gs3_files::{read_within, write_new};
use rayon::prelude::*;
use serde_json::{Map, Value, json};

use super::output::write_text;
use crate::cli::error::CliError;
use crate::cli::options::{Aov, AovFormat};

/// Name of the file in the folder of the frames.
pub const NAME: &str = "manifest.json";

/// Most bytes that are read of one: some fifty times what is written.
const MOST_BYTES: u64 = 1 << 16;

/// What all frames of a folder have in common.
#[derive(Clone, Debug, PartialEq)]
pub struct Manifest(Map<String, Value>);

impl Manifest {
    /// The manifest of frames of `scene` along `path`, made with `settings` and `networks` on `machine`. `scale_of` is the scale of
    /// the frame of a camera. `alpha` says whether the frames have transparency.
    pub fn new(
        scene: &Scene,
        path: &CameraPath,
        settings: &PipelineSettings,
        networks: &Networks,
        scale_of: impl Fn(&Camera) -> u32,
        machine: &Machine,
        alpha: bool,
    ) -> Result<Self, CliError> {
        let each = settings.displayed_per_rendered();
        let mut facts = json!({
            "gs3": env!("CARGO_PKG_VERSION"),
            "scene": scene_hash(scene),
            "cameras": path_hash(path),
            "frames": (path.cameras().len().max(1) - 1) * each + 1,
            "frames_per_second": path.frames_per_second() * each as f64,
            "backend": machine.backend().name(),
            "mode": settings.mode.name(),
            "culling": settings.culling.name(),
            "dilation": settings.dilation.to_string(),
            "background": settings.background,
            "alpha": alpha,
        });
        if settings.mode != Mode::Native {
            facts["scale"] = scales(path, scale_of);
            facts["keyframes"] = json!(settings.keyframes);
            facts["sampling"] = json!(settings.sampling.name());
        }
        if settings.mode.has_history() {
            facts["quality"] = json!(settings.quality.name());
            facts["refine"] = json!(settings.refine.to_string());
            facts["kriging"] = json!(settings.kriging.name());
            facts["overscan"] = json!(settings.overscan);
            for (name, weights) in
                [("super_sample", &networks.super_sample), ("interpolate", &networks.interpolate)]
            {
                let Some(weights) = weights else { continue };
                let bytes = weights.to_bytes().map_err(gs3::NetworkError::from)?;
                facts[name] = json!(blake3::hash(&bytes).to_hex().as_str());
                facts["arithmetic"] = json!(networks.arithmetic.name());
            }
        }
        if settings.mode == Mode::Full {
            facts["in_between"] = json!(settings.in_between);
        }
        match facts {
            Value::Object(facts) => Ok(Self(facts)),
            _ => Err(PipelineError::Internal { expected: "an object of facts" }.into()),
        }
    }

    /// The same frames with these quantities of pixels beside each; with none, the same.
    pub fn with_aovs(mut self, aovs: &[Aov], format: AovFormat) -> Self {
        let names: Vec<&str> = Aov::ALL.into_iter().filter(|aov| aovs.contains(aov)).map(Aov::name).collect();
        if !names.is_empty() {
            self.0.insert("aov".to_owned(), json!(names.join(",")));
            self.0.insert("aov_format".to_owned(), json!(format.name()));
        }
        self
    }

    /// The manifest in `folder`, if there is one.
    pub fn read(folder: &Path) -> Result<Option<Self>, CliError> {
        let file = folder.join(NAME);
        let bytes = match read_within(&file, MOST_BYTES).map_err(io::Error::from) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            Err(source) => return Err(CliError::Read { path: file, source }),
        };
        match serde_json::from_slice(&bytes) {
            Ok(facts) => Ok(Some(Self(facts))),
            Err(error) => {
                let message = format!("expected what gs3 render writes, found {error}");
                Err(CliError::Manifest { path: file, message })
            }
        }
    }

    /// Puts it into `folder`, before any frame. Where another one is there, the folder's frames are of another kind: that is
    /// refused, unless `replaces` says that all of them are replaced.
    pub fn claim(&self, folder: &Path, replaces: bool) -> Result<(), CliError> {
        let file = folder.join(NAME);
        let text = format!("{:#}\n", Value::Object(self.0.clone()));
        match write_new(&file, text.as_bytes()) {
            Ok(()) => return Ok(()),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(source) => return Err(CliError::write(&file)(source)),
        }
        match Self::read(folder)? {
            Some(there) if there == *self => Ok(()),
            Some(_) | None if replaces => write_text(&file, &text),
            there => self.refuse(folder, &there.unwrap_or_else(|| Self(Map::new()))),
        }
    }

    /// Refuses to mix frames of this kind with those in `folder`, if there are any that are known to be of another.
    pub fn check(&self, folder: &Path) -> Result<(), CliError> {
        match Self::read(folder)? {
            Some(there) if there != *self => self.refuse(folder, &there),
            _ => Ok(()),
        }
    }

    fn refuse(&self, folder: &Path, there: &Self) -> Result<(), CliError> {
        let mut names: Vec<&String> = self.0.keys().chain(there.0.keys()).collect();
        // What others follow from comes first.
        let first = ["scene", "cameras", "backend", "mode"];
        names.sort_by_key(|name| match first.iter().position(|first| first == name) {
            Some(place) => place,
            None => first.len() + usize::from(name.starts_with("frames")),
        });
        let other = names.into_iter().find(|name| self.0.get(*name) != there.0.get(*name));
        let text = |facts: &Map<String, Value>, name: &str| match facts.get(name) {
            Some(Value::String(text)) => text.clone(),
            Some(value) => value.to_string(),
            None => "none".to_owned(),
        };
        let message = match other {
            Some(name) => format!(
                "expected frames of {name} {}, found those of {name} {} (another folder, or without them)",
                text(&self.0, name),
                text(&there.0, name)
            ),
            None => "expected frames of this run's settings, found others".to_owned(),
        };
        Err(CliError::Manifest { path: folder.join(NAME), message })
    }

    /// How many frames the whole path shows.
    pub fn frames(&self) -> Option<usize> {
        usize::try_from(self.0.get("frames")?.as_u64()?).ok()
    }

    /// Frames shown per second.
    pub fn rate(&self) -> Option<f64> {
        self.0.get("frames_per_second")?.as_f64().filter(|rate| *rate > 0.0 && rate.is_finite())
    }
}

/// A digest of all Gaussians and of what else of a scene changes pictures.
fn scene_hash(scene: &Scene) -> String {
    let gaussians = scene.gaussians();
    let planes = gaussians.means.iter().chain(&gaussians.scales).chain(&gaussians.rotations);
    let planes: Vec<&[f32]> =
        planes.chain([&gaussians.opacities, &gaussians.sh]).map(Vec::as_slice).collect();
    // Planes are hashed at once, then their digests; little-endian numbers on all machines that gs3 is built for.
    let digests: Vec<blake3::Hash> =
        planes.par_iter().map(|plane| blake3::hash(bytemuck::cast_slice(plane))).collect();
    let mut hasher = blake3::Hasher::new();
    digests.iter().for_each(|digest| _ = hasher.update(digest.as_bytes()));
    let details = scene.details();
    hasher.update(format!("{} {} {}", gaussians.sh_degree, details.near, details.origin).as_bytes());
    hasher.finalize().to_hex().to_string()
}

/// A digest of all cameras.
fn path_hash(path: &CameraPath) -> String {
    let mut hasher = blake3::Hasher::new();
    for camera in path.cameras() {
        hasher.update(format!("{camera:?}").as_bytes());
    }
    hasher.update(format!("{} {}", path.is_cycle(), path.facts().is_panorama).as_bytes());
    hasher.finalize().to_hex().to_string()
}

/// The scale of the frames of `path`, or a list of their scales, the smallest first.
fn scales(path: &CameraPath, scale_of: impl Fn(&Camera) -> u32) -> Value {
    let mut scales: Vec<u32> = path.cameras().iter().map(scale_of).collect();
    scales.sort_unstable();
    scales.dedup();
    match scales[..] {
        [one] => json!(one),
        _ => json!(scales),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use gs3::Scale;
    use gs3::scene::demo;

    #[test]
    fn a_path_of_several_sizes_has_all_of_their_scales() {
        let of = |sizes: &[[u32; 2]]| {
            let camera = demo::path().cameras()[0];
            let cameras = sizes.iter().map(|[w, h]| camera.resized(*w, *h).unwrap()).collect();
            CameraPath::new(cameras, 30.0, false).unwrap()
        };
        let auto = |camera: &Camera| Scale::Auto.at(camera.size());
        assert_eq!(scales(&of(&[[64, 36], [80, 45]]), auto), json!(4));
        let mixed = of(&[[4096, 2160], [64, 36], [4096, 2160]]);
        assert_eq!(scales(&mixed, auto), json!([4, 6]));
        assert_eq!(scales(&mixed, |_| 4), json!(4));
    }
}
