//! `gs3 convert`.

use gs3::scene::format::{SaveOptions, SpzVersion, format_of};

use crate::args::ConvertArgs;
use crate::destination::Destination;
use crate::error::CliError;
use crate::output::save_scene;
use crate::{Outcome, destination, inputs};

pub fn run(args: &ConvertArgs) -> Result<Outcome, CliError> {
    destination::check(&[Destination::scene("OUTPUT", &args.output)], [args.input.as_path()])?;
    let (scene, _) = inputs::scene_at(&args.input, args.levels)?;
    let format = format_of(&args.output)?;
    let spz_version = match args.spz_version {
        Some(version) if format != "spz" => {
            return Err(CliError::Option {
                option: "--spz-version",
                expected: "an output that ends in .spz".to_owned(),
                actual: format!("{version} with {}", args.output.display()),
            });
        }
        Some(3) => SpzVersion::Three,
        _ => SpzVersion::Four,
    };
    save_scene(&scene, &args.output, &SaveOptions { spz_version })?;
    Ok(Outcome::Done)
}
