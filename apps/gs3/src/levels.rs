//! Scenes that hold several representations of themselves: streamed SOG.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Read;
use std::path::Path;

use clap::Args;
use gs3::scene::format::LoadOptions;
use serde_json::Value;

use crate::args::Switch;
use crate::error::CliError;
use crate::inputs::is_demo;

/// What to take of such a scene.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct Levels {
    /// Level of detail of a streamed scene (lod-meta.json), 0 the finest [default: the finest that each part of it has]
    #[arg(long, value_name = "N")]
    pub lod: Option<u32>,
    /// Whether the environment of a streamed scene (sky, far background) is part of it [default: on]
    #[arg(long, value_name = "on|off")]
    pub environment: Option<Switch>,
}

impl Levels {
    /// What to load of `scene`. Other scenes would not read these options.
    pub fn options(self, scene: &Path) -> Result<LoadOptions, CliError> {
        let given = self.lod.map(|_| "--lod").or(self.environment.map(|_| "--environment"));
        if let Some(option) = given
            && (is_demo(scene) || Streamed::of(scene).is_none())
        {
            return Err(CliError::Option {
                option,
                expected: "a streamed scene (lod-meta.json), which has levels and an environment".to_owned(),
                actual: scene.display().to_string(),
            });
        }
        let environment = !matches!(self.environment, Some(Switch::Off));
        Ok(LoadOptions { level_of_detail: self.lod, environment })
    }
}

/// What a streamed scene says of itself.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Streamed {
    /// Gaussians of each level of detail, the finest first.
    pub levels: BTreeMap<u32, u64>,
    pub has_environment: bool,
}

impl Streamed {
    /// Of the scene at `path`, if it is streamed. Whatever is wrong with it is for who loads it to tell.
    pub fn of(path: &Path) -> Option<Self> {
        let file = if path.is_dir() { path.join("lod-meta.json") } else { path.to_owned() };
        // Before opening: a pipe would wait for its writer.
        if !fs::metadata(&file).ok()?.is_file() {
            return None;
        }
        let mut file = File::open(file).ok()?;
        // Other formats begin with something else, and may be large.
        let mut bytes = Vec::new();
        file.by_ref().take(16).read_to_end(&mut bytes).ok()?;
        if !bytes.trim_ascii_start().starts_with(b"{") {
            return None;
        }
        file.read_to_end(&mut bytes).ok()?;
        let meta: Value = serde_json::from_slice(&bytes).ok()?;
        let mut streamed = Self { has_environment: meta["environment"].is_string(), ..Self::default() };
        streamed.add(meta.get("tree")?);
        Some(streamed)
    }

    /// Adds the Gaussians under `node`. The depth of the tree is bounded by the JSON parser (128).
    fn add(&mut self, node: &Value) {
        for (level, run) in node["lods"].as_object().into_iter().flatten() {
            if let (Ok(level), Some(count)) = (level.parse(), run["count"].as_u64()) {
                let all = self.levels.entry(level).or_default();
                *all = all.saturating_add(count);
            }
        }
        for child in node["children"].as_array().into_iter().flatten() {
            self.add(child);
        }
    }
}
