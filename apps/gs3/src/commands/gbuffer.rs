//! `gs3 gbuffer`.

use std::io::{self, Seek, Write};
use std::path::PathBuf;

use gs3::compute::OptionalFeatures;
use gs3::raster::{Outputs, RasterSettings};
use gs3::scene::{GBuffer, Planes};
use zip::ZipWriter;

use crate::cli::backend;
use crate::cli::error::CliError;
use crate::cli::exit::Outcome;
use crate::cli::options::{CullingArg, Device, SceneOptions, View};
use crate::cli::rasterizer::MachineRasterizer;
use crate::cli::threads::start_threads;
use crate::cli::values::{DilationArg, Pair, Rgb, scale};
use crate::io::destination::{self, Destination};
use crate::io::inputs;
use crate::io::npz;
use crate::io::output::write_file;

#[derive(Debug, clap::Args)]
pub struct GbufferArgs {
    #[command(flatten)]
    pub view: View,
    #[command(flatten)]
    pub scene_options: SceneOptions,
    /// Frame of the path
    #[arg(long, default_value_t = 0, value_name = "K")]
    pub frame: usize,
    /// Scale S of the matched dilation, 0.3/S². The image has --size whatever S is: give the low-resolution size for a
    /// low-resolution frame
    #[arg(long, default_value_t = 4, value_name = "S", value_parser = scale(1))]
    pub scale: u32,
    /// Offset of the samples from the pixel centres
    #[arg(long, default_value = "0,0", value_name = "X,Y", allow_hyphen_values = true)]
    pub jitter: Pair,
    /// Dilation of splats in px² of the rendered grid: matched (0.3/S²), kerbl (0.3, as in Kerbl et al.) or a number
    #[arg(long, default_value = "matched", value_name = "matched|kerbl|VALUE", allow_hyphen_values = true)]
    pub dilation: DilationArg,
    /// Which tiles a splat is assigned to
    #[arg(long, default_value = "accutile")]
    pub culling: CullingArg,
    /// Background colour, each from 0 to 1
    #[arg(long, default_value = "0,0,0", value_name = "R,G,B", allow_hyphen_values = true)]
    pub background: Rgb,
    #[command(flatten)]
    pub device: Device,
    /// Also write the mixed derivative color_dxy
    #[arg(long)]
    pub mixed: bool,
    /// Output file: f32 arrays [H, W] or [H, W, 3] `color` (display-encoded RGB), `color_dx`, `color_dy` and
    /// `color_dxy` (its derivatives per pixel of this grid), `depth_median` and `depth_expected` (along the view's z,
    /// in the scene's unit, 0 where nothing was hit), `normal` (in view space: x right, y down, z forward; accumulated
    /// with the weights of the colour, so shorter than 1 where splats differ) and `alpha`
    #[arg(long, value_name = "FILE.npz")]
    pub out: PathBuf,
}

pub fn run(args: &GbufferArgs) -> Result<Outcome, CliError> {
    start_threads(args.view.threads)?;
    destination::check(&[Destination::file("--out", &args.out, "npz")], args.view.inputs())?;
    let (scene, _) = inputs::scene_of(&args.view, args.scene_options)?;
    let path = inputs::cameras(&args.view, &scene)?;
    inputs::check_is_perspective(&path)?;
    inputs::check_frames("--frame", &(args.frame..args.frame.saturating_add(1)), &path)?;
    let settings = RasterSettings {
        dilation: args.dilation.0.at_scale(args.scale),
        jitter: args.jitter.0,
        background: args.background.0,
        ..RasterSettings::new(if args.mixed { Outputs::GBufferMixed } else { Outputs::GBuffer })
    };
    let mut gbuffer = GBuffer::default();
    let camera = &path.cameras()[args.frame];
    let machine = backend::open(&args.device, OptionalFeatures::All)?;
    MachineRasterizer::new(&scene, args.culling.into(), &machine)?.gbuffer(
        camera,
        &settings,
        &mut gbuffer,
    )?;
    inputs::tell_what_is_too_near(&scene, &path.cameras()[args.frame..=args.frame]);
    if gbuffer.alpha.plane(0).iter().all(|alpha| *alpha == 0.0) {
        inputs::warn_of_nothing_visible(scene.details().near);
    }
    write_file(&args.out, |writer| npz::write(writer, |zip| write_planes(zip, &gbuffer)))?;
    Ok(Outcome::Done)
}

fn write_planes(zip: &mut ZipWriter<impl Write + Seek>, gbuffer: &GBuffer) -> io::Result<()> {
    rgb(zip, "color", &gbuffer.color)?;
    scalar(zip, "alpha", &gbuffer.alpha)?;
    if let Some(gradients) = &gbuffer.gradients {
        rgb(zip, "color_dx", &gradients.color_dx)?;
        rgb(zip, "color_dy", &gradients.color_dy)?;
        if let Some(color_dxy) = &gradients.color_dxy {
            rgb(zip, "color_dxy", color_dxy)?;
        }
    }
    if let Some(geometry) = &gbuffer.geometry {
        scalar(zip, "depth_median", &geometry.depth_median)?;
        scalar(zip, "depth_expected", &geometry.depth_expected)?;
        rgb(zip, "normal", &geometry.normal)?;
    }
    Ok(())
}

/// `[H, W]`.
fn scalar(zip: &mut ZipWriter<impl Write + Seek>, name: &str, planes: &Planes<1>) -> io::Result<()> {
    npz::add(zip, name, &[planes.height(), planes.width()], planes.data().iter().copied())
}

/// `[H, W, 3]`.
fn rgb(zip: &mut ZipWriter<impl Write + Seek>, name: &str, planes: &Planes<3>) -> io::Result<()> {
    let size = planes.height() * planes.width();
    let values = (0..size).flat_map(|i| (0..3).map(move |c| planes.data()[c * size + i]));
    npz::add(zip, name, &[planes.height(), planes.width(), 3], values)
}
