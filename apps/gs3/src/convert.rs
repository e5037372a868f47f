//! `gs3 convert`.

use crate::args::ConvertArgs;
use crate::destination::Destination;
use crate::error::CliError;
use crate::output::save_scene;
use crate::terminal::note;
use crate::{Outcome, destination, inputs};

pub fn run(args: &ConvertArgs) -> Result<Outcome, CliError> {
    destination::check(&[Destination::scene("OUTPUT", &args.output)], [args.input.as_path()])?;
    let (scene, _) = inputs::scene_at(&args.input, args.levels)?;
    save_scene(&scene, &args.output)?;
    let dropped = scene.dropped().total();
    if dropped > 0 {
        note(format_args!("{dropped} invalid Gaussians dropped (gs3 info says why)"));
    }
    Ok(Outcome::Done)
}
