//! `gs3 convert`.

use gs3::scene::format::save;

use crate::args::ConvertArgs;
use crate::error::CliError;
use crate::{Outcome, inputs};

pub fn run(args: &ConvertArgs) -> Result<Outcome, CliError> {
    let (scene, _) = inputs::scene(&args.input)?;
    save(&scene, &args.output)?;
    let dropped = scene.dropped().total();
    if dropped > 0 {
        eprintln!("{dropped} invalid Gaussians dropped (gs3 info says why)");
    }
    Ok(Outcome::Done)
}
