//! `gs3 info`.

use std::path::PathBuf;

use gs3::scene::format::Streamed;
use gs3::scene::info::{Digits, SceneInfo};
use gs3::scene::orbit::Bulk;
use serde_json::json;

use crate::cli::error::CliError;
use crate::cli::exit::Outcome;
use crate::cli::options::SceneOptions;
use crate::cli::terminal::print;
use crate::io::inputs;
use crate::io::report;

#[derive(Debug, clap::Args)]
pub struct InfoArgs {
    /// Scene file or folder, or `demo` for the built-in scene
    pub scene: PathBuf,
    #[command(flatten)]
    pub scene_options: SceneOptions,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

pub fn run(args: &InfoArgs) -> Result<Outcome, CliError> {
    let (scene, load_time) = inputs::scene_at(&args.scene, args.scene_options)?;
    let (info, bulk) = (SceneInfo::of(&scene), Bulk::of(&scene));
    let streamed = inputs::streamed(&args.scene)?;
    if !args.json {
        let indented = |lines: String| lines.lines().map(|line| format!("  {line}\n")).collect::<String>();
        let levels = streamed.map_or_else(String::new, |streamed| indented(levels_of(streamed)));
        let (name, info, bulk) = (args.scene.display(), indented(info.to_string()), indented(text_of(&bulk)));
        print(format_args!("{name}\n{levels}{info}{bulk}"))?;
        return Ok(Outcome::Done);
    }
    let Bulk { center, radius, extent, is_object, up } = bulk;
    let [center, extent, up] = [center, extent, up].map(|v| v.to_array());
    let bulk =
        json!({ "center": center, "radius": radius, "extent": extent, "is_object": is_object, "up": up });
    let mut facts = report::join(json!(info), json!({ "bulk": bulk, "load_s": load_time.as_secs_f64() }));
    if let Some(Streamed { levels, has_environment, .. }) = streamed {
        facts = report::join(facts, json!({ "levels": levels, "has_environment": has_environment }));
    }
    print(format_args!("{facts:#}\n"))?;
    Ok(Outcome::Done)
}

fn levels_of(Streamed { levels, has_environment, .. }: Streamed) -> String {
    format!("levels          {levels}{}", if has_environment { ", and an environment" } else { "" })
}

fn text_of(Bulk { center, radius, is_object, up, .. }: &Bulk) -> String {
    let [center, up] = [center, up].map(|v| v.to_array().map(|v| Digits(v).to_string()).join(", "));
    let kind = if *is_object { "an object" } else { "a place" };
    format!("bulk            radius {} around {center}, {kind}, up {up}", Digits(*radius))
}
