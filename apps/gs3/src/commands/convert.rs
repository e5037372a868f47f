//! `gs3 convert`.

use std::path::PathBuf;

use gs3::scene::format::{STREAMED_SOG, SaveOptions, SpzVersion, format_of};

use crate::cli::error::CliError;
use crate::cli::exit::Outcome;
use crate::cli::options::SceneOptions;
use crate::io::destination::{self, Destination};
use crate::io::inputs;
use crate::io::output::save_scene;

#[derive(Debug, clap::Args)]
pub struct ConvertArgs {
    /// Scene file or folder, or `demo` for the built-in scene
    pub input: PathBuf,
    /// Output file: .ply, .compressed.ply, .spz, .sog, .glb, .splat; or DIR/lod-meta.json for streamed SOG
    pub output: PathBuf,
    /// Version of .spz files: 3 for programs that do not know 4 yet
    #[arg(long, value_name = "3|4", value_parser = clap::value_parser!(u8).range(3..=4))]
    pub spz_version: Option<u8>,
    /// Most Gaussians of a part of streamed SOG, in thousands: smaller parts have closer colours and more bytes [default: the
    /// parts that a scene from SOG came in, else 131]
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=200_000))]
    pub lod_chunk_count: Option<u32>,
    #[command(flatten)]
    pub scene_options: SceneOptions,
}

pub fn run(args: &ConvertArgs) -> Result<Outcome, CliError> {
    destination::check(&[Destination::scene("OUTPUT", &args.output)], [args.input.as_path()])?;
    let (scene, _) = inputs::scene_at(&args.input, args.scene_options)?;
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
    let mut options = SaveOptions { spz_version, ..SaveOptions::default() };
    if let Some(thousands) = args.lod_chunk_count {
        if format != STREAMED_SOG {
            return Err(CliError::Option {
                option: "--lod-chunk-count",
                expected: format!("an output that ends in {STREAMED_SOG}"),
                actual: format!("{thousands} with {}", args.output.display()),
            });
        }
        options.chunk = Some(thousands as usize * 1000);
    }
    save_scene(&scene, &args.output, &options)?;
    Ok(Outcome::Done)
}
