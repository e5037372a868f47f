//! Pictures larger than what is rendered at once: native frames, rasterized tile by tile and written row by row. Memory
//! holds a tile and a row of tiles, whatever the size of the picture. The tiles of the CPU have the bits of the whole
//! picture.

use std::io;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use gs3::raster::{Outputs, RasterSettings, Window};
use gs3::scene::camera::MAX_SIDE;
use gs3::scene::{Camera, CameraPath, Image, PngChannels, Scene, Size, write_png_rows};
use gs3::{Machine, Mode, Networks, PipelineSettings};
use indicatif::ProgressBar;
use rayon::prelude::*;
use serde_json::json;

use super::args::RenderArgs;
use super::parts::{claim, end, frames_missing, stream_of};
use crate::cli::backend;
use crate::cli::error::CliError;
use crate::cli::exit::Outcome;
use crate::cli::interrupt;
use crate::cli::rasterizer::{MachineRasterizer, native};
use crate::cli::terminal::note;
use crate::io::alpha::{coverage, straight_rgba8};
use crate::io::inputs;
use crate::io::manifest::Manifest;
use crate::io::output::{Target, write_file, write_text};
use crate::io::report;

/// Largest tile: 64 MiB in f32. Wide tiles repeat less of the projection of Gaussians, and
/// low ones make rows of tiles that fit in memory at any width.
const LARGEST_TILE: Size = Size::new(4096, 1024);

/// Renders the native frames `range` of `path`.
pub fn run(
    args: &RenderArgs,
    target: &Target,
    scene: &Arc<Scene>,
    path: &CameraPath,
    range: Range<usize>,
    load_time: Duration,
) -> Result<Outcome, CliError> {
    check(args, target)?;
    let settings = args.frame_options.settings(Mode::Native);
    let machine = backend::open(&args.device, args.frame_options.features())?;
    let mut painter = Painter::new(scene, &settings, &machine, args.alpha)?;
    let facts = Manifest::new(scene, path, &settings, &Networks::default(), |_| 1, &machine, args.alpha)?;
    let missing = frames_missing(args, target, &facts, &range, 1)?;
    let first = path.cameras()[range.start];
    interrupt::watch()?;
    let rows = |camera: &Camera| u64::from(camera.height());
    let bar = ProgressBar::new(missing.iter().map(|k| rows(&path.cameras()[*k])).sum())
        .with_style(inputs::style("{pos}/{len} rows {wide_bar} {eta} left"));
    let mut done = 0;
    while let Some(&k) = missing.get(done) {
        let file = target.picture(k);
        if done == 0 {
            target.prepare()?;
            claim(target, &facts, &range)?;
        }
        if interrupt::requested() || !painter.paint(&path.cameras()[k], &file, &bar)? {
            break;
        }
        done += 1;
    }
    bar.finish_and_clear();
    let is_complete = done == missing.len();
    if painter.is_blank && done > 0 {
        inputs::warn_of_nothing_visible(scene.details().near);
    }
    let seconds = painter.render_time.as_secs_f64();
    let [load, encode] = [load_time, painter.encode_time].map(|time| time.as_secs_f64());
    if let Some(file) = &args.json {
        let figures = json!({
            "mode": Mode::Native.name(),
            "frames_displayed": done,
            "frames_rendered": done,
            "frames_written": done,
            "displayed_fps": report::per_second(done, seconds),
            "load_s": load,
            "encode_s": encode,
            "gaussians": scene.gaussians().len(),
            "size": first.size().to_array(),
            "tile": tile_size(&first, LARGEST_TILE).to_array(),
            "is_complete": is_complete,
            "alpha": args.alpha,
        });
        let figures = report::join(figures, report::asked(&args.view, &range, &settings));
        let figures = report::join(figures, report::machine(&machine));
        write_text(file, &format!("{figures:#}\n"))?;
    }
    note(format_args!(
        "{done} frames shown, {seconds:.1} s of rendering in tiles ({} in {}); loading {load:.2} s, encoding {encode:.2} s, \
         not included",
        Mode::Native.name(),
        args.out.display(),
    ));
    end(target, &range, missing.get(done).copied(), &range, &stream_of(path, &range, 1), None)
}

/// Refuses what is not made of pictures as large as this.
fn check(args: &RenderArgs, target: &Target) -> Result<(), CliError> {
    let most = format!("{MAX_SIDE} pixels a side");
    let refused =
        |option, expected: String, actual: String| Err(CliError::Option { option, expected, actual });
    if !args.aov.is_empty() {
        let asked: Vec<&str> = args.aov.iter().map(|aov| aov.name()).collect();
        return refused("--aov", format!("frames of at most {most}"), asked.join(","));
    }
    match target {
        Target::Single(_) | Target::Folder(_) if !target.is_exr() => Ok(()),
        _ => refused(
            "--out",
            format!("DIR or FILE.png for frames of more than {most}"),
            args.out.display().to_string(),
        ),
    }
}

/// Tiles begin at multiples of this many pixels: the published rules of culling cut splats at tiles of 16 pixels.
const STEP: u32 = 16;

/// The size of the tiles of the image of `camera`, about `largest` at most: as few as there can be, of nearly one
/// size. The last ones end with the image.
fn tile_size(camera: &Camera, largest: Size) -> Size {
    Size::new(tile_side(camera.width(), largest.width), tile_side(camera.height(), largest.height))
}

fn tile_side(side: u32, largest: u32) -> u32 {
    side.div_ceil(side.div_ceil(largest.max(1))).next_multiple_of(STEP).min(side)
}

/// The first pixel and the number of pixels of each tile along a side.
fn parts(side: u32, tile: u32) -> impl Iterator<Item = (u32, u32)> {
    (0..side).step_by(tile.max(1) as usize).map(move |first| (first, tile.min(side - first)))
}

/// Makes pictures of tiles.
struct Painter {
    color: MachineRasterizer,
    coverage: Option<MachineRasterizer>,
    settings: RasterSettings,
    largest_tile: Size,
    /// The colour and the coverage of a tile.
    tile: [Image; 2],
    is_blank: bool,
    render_time: Duration,
    encode_time: Duration,
}

/// Why a picture is not whole.
enum Stop {
    Error(CliError),
    Interrupted,
}

impl From<CliError> for Stop {
    fn from(error: CliError) -> Self {
        Self::Error(error)
    }
}

impl Painter {
    fn new(
        scene: &Arc<Scene>,
        settings: &PipelineSettings,
        machine: &Machine,
        with_alpha: bool,
    ) -> Result<Self, CliError> {
        let coverage = match with_alpha {
            true => Some(MachineRasterizer::new(&coverage(scene)?, settings.culling, machine)?),
            false => None,
        };
        Ok(Self {
            color: MachineRasterizer::new(scene, settings.culling, machine)?,
            coverage,
            settings: native(settings, Outputs::Color),
            largest_tile: LARGEST_TILE,
            tile: Default::default(),
            is_blank: true,
            render_time: Duration::ZERO,
            encode_time: Duration::ZERO,
        })
    }

    /// Writes the picture of `camera` as a PNG file, whole or not at all. Says whether it is there: not after a request to
    /// end.
    fn paint(&mut self, camera: &Camera, file: &Path, bar: &ProgressBar) -> Result<bool, CliError> {
        let channels = if self.coverage.is_some() { PngChannels::Rgba } else { PngChannels::Rgb };
        let mut stop = None;
        let written = write_file(file, |writer| {
            write_png_rows(writer, camera.size(), channels, |rows| {
                let painted = self.rows(camera, &mut |pixels, count| {
                    rows.write_all(pixels)?;
                    bar.inc(u64::from(count));
                    Ok(())
                });
                match painted {
                    Ok(written) => written,
                    Err(reason) => {
                        stop = Some(reason);
                        Err(io::Error::other("the picture is not whole"))
                    }
                }
            })
        });
        match stop {
            Some(Stop::Error(error)) => Err(error),
            Some(Stop::Interrupted) => Ok(false),
            None => written.map(|()| true),
        }
    }

    /// Gives the rows of the picture of `camera` to `write`, some at a time, with their number. The inner error is that of
    /// `write`.
    fn rows(
        &mut self,
        camera: &Camera,
        write: &mut dyn FnMut(&[u8], u32) -> io::Result<()>,
    ) -> Result<io::Result<()>, Stop> {
        let tile = tile_size(camera, self.largest_tile);
        let bytes_each = if self.coverage.is_some() { 4 } else { 3 };
        let row_bytes = bytes_each * camera.width() as usize;
        let mut band = vec![0; row_bytes * tile.height as usize];
        for (top, height) in parts(camera.height(), tile.height) {
            let started = Instant::now();
            for (left, width) in parts(camera.width(), tile.width) {
                if interrupt::requested() {
                    return Err(Stop::Interrupted);
                }
                let pixels = self.tile(camera, Window { left, top, width, height })?;
                let first = bytes_each * left as usize;
                let tile_bytes = bytes_each * width as usize;
                let rows = band.par_chunks_exact_mut(row_bytes).zip(pixels.par_chunks_exact(tile_bytes));
                rows.for_each(|(row, of_tile)| row[first..first + tile_bytes].copy_from_slice(of_tile));
            }
            let rendered = Instant::now();
            self.render_time += rendered - started;
            if let Err(error) = write(&band[..row_bytes * height as usize], height) {
                return Ok(Err(error));
            }
            self.encode_time += rendered.elapsed();
        }
        Ok(Ok(()))
    }

    /// The pixels of a tile, RGB or straight RGBA.
    fn tile(&mut self, camera: &Camera, window: Window) -> Result<Vec<u8>, CliError> {
        let [color, alpha] = &mut self.tile;
        self.color.window(camera, window, &self.settings, color)?;
        self.is_blank &= self.color.is_blank();
        match &mut self.coverage {
            None => Ok(color.to_rgb8()),
            Some(coverage) => {
                coverage.window(camera, window, &self.settings, alpha)?;
                Ok(straight_rgba8(color, alpha))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use gs3::FramePipeline;
    use gs3::raster::Culling;
    use gs3::scene::demo;

    use super::*;

    #[test]
    fn tiles_cover_a_side() {
        for side in [20_000, 8193, 4096, 4097, 7, 1, 65_535] {
            let tile = tile_side(side, LARGEST_TILE.width);
            let parts: Vec<_> = parts(side, tile).collect();
            let expected = side.div_ceil(LARGEST_TILE.width) as usize;
            assert!(tile <= LARGEST_TILE.width && parts.len() == expected, "{side}: {tile}");
            let end = parts.iter().fold(0, |end, (first, count)| if *first == end { end + count } else { 0 });
            assert_eq!(end, side);
            assert!(parts.iter().all(|(first, count)| first.is_multiple_of(STEP) && *count > 0));
        }
    }

    /// Tiles of any size give the bytes of the pipeline's native frame, with any culling.
    #[test]
    fn a_picture_of_tiles_is_the_picture() {
        let scene = Arc::new(demo::scene().unwrap());
        let camera = demo::path().resized(211, 123).unwrap().cameras()[7];
        let cullings = [Culling::Aabb3Sigma, Culling::Adr, Culling::AccuTile];
        for (culling, with_alpha) in cullings.into_iter().flat_map(|c| [(c, false), (c, true)]) {
            let background = [0.3, 0.1, 0.6];
            let settings =
                PipelineSettings { mode: Mode::Native, culling, background, ..PipelineSettings::default() };
            let native = |scene: &Arc<Scene>| {
                let mut pipeline = FramePipeline::new(Arc::clone(scene), settings).unwrap();
                pipeline.render(&camera).unwrap().current.clone()
            };
            let image = native(&scene);
            let expected = match with_alpha {
                true => straight_rgba8(&image, &native(&coverage(&scene).unwrap())),
                false => image.to_rgb8(),
            };
            for largest_tile in
                [LARGEST_TILE, Size::new(64, 48), Size::new(37, 19), Size::new(211, 1), Size::new(3, 123)]
            {
                let mut painter = Painter::new(&scene, &settings, &Machine::Cpu, with_alpha).unwrap();
                painter.largest_tile = largest_tile;
                let mut found = Vec::new();
                let mut rows = 0;
                let painted = painter.rows(&camera, &mut |pixels, count| {
                    rows += count;
                    found.extend_from_slice(pixels);
                    Ok(())
                });
                assert!(matches!(painted, Ok(Ok(()))) && rows == 123);
                assert!(found == expected, "{culling:?}, {largest_tile:?}, alpha {with_alpha}");
                assert!(!painter.is_blank);
            }
        }
    }
}
