//! How a scene file is read: what to take of one that holds several representations of itself (streamed SOG), and what
//! a file does not say.

use std::path::Path;

use clap::Args;
use gs3::scene::Axes;
use gs3::scene::format::LoadOptions;

use crate::args::Switch;
use crate::error::CliError;
use crate::inputs;
use crate::values::Distance;

/// What to take of such a scene.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct Levels {
    /// Level of detail of a streamed scene (lod-meta.json), 0 the finest [default: the finest that each part of it has]
    #[arg(long, value_name = "N")]
    pub lod: Option<u32>,
    /// Whether the environment of a streamed scene (sky, far background) is part of it [default: on]
    #[arg(long, value_name = "on|off")]
    pub environment: Option<Switch>,
    /// Where x, y and z point in the scene file, as rdf (right, down, front), rub (right, up, back) or luf [default: as
    /// the file states, else as its format says: rub in SPZ, luf in glTF, rdf elsewhere]
    #[arg(long, value_name = "XYZ")]
    pub axes: Option<Axes>,
    /// Gaussians nearer to the camera than this are not shown, in world units along the view [default: 0.2, less in
    /// scenes smaller than one unit]
    #[arg(long, value_name = "DISTANCE")]
    pub near: Option<Distance>,
}

impl Levels {
    /// The same for another file, which has no levels.
    pub const fn of_whole(self) -> Self {
        Self { lod: None, environment: None, ..self }
    }

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
        if self.axes.is_some() && inputs::is_demo(scene) {
            let expected = "a scene file, whose axes it is about".to_owned();
            return Err(CliError::Option { option: "--axes", expected, actual: "demo".to_owned() });
        }
        let environment = !matches!(self.environment, Some(Switch::Off));
        Ok(LoadOptions { level_of_detail: self.lod, environment, axes: self.axes })
    }
}
