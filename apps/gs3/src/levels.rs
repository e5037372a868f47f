//! Scenes that hold several representations of themselves: streamed SOG.

use std::path::Path;

use clap::Args;
use gs3::scene::format::LoadOptions;

use crate::args::Switch;
use crate::error::CliError;
use crate::inputs;

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
            && inputs::streamed(scene)?.is_none()
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
