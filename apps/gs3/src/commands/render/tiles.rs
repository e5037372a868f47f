//! Pictures larger than what is rendered at once: native frames, rasterized tile by tile and written row by row. Memory
//! holds a tile and a row of tiles, whatever the size of the picture. The tiles of the CPU have the bits of the whole
//! picture.

use std::io;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use gs3::raster::Window;
use gs3::scene::camera::MAX_SIDE;
use gs3::scene::{Camera, CameraPath, Image, PngChannels, Scene, write_png_rows};
use gs3::{Machine, Mode, Networks, PipelineSettings};
use indicatif::ProgressBar;
use rayon::prelude::*;
use serde_json::json;

use super::args::RenderArgs;
use super::native::NativeRasterizer;
use super::parts::{claim, frames_missing, remainder};
use crate::cli::backend;
use crate::cli::error::CliError;
use crate::cli::exit::Outcome;
use crate::cli::interrupt;
use crate::cli::terminal::note;
use crate::io::alpha::{coverage, straight_rgba8};
use crate::io::inputs;
use crate::io::manifest::Manifest;
use crate::io::output::{Target, write_file, write_text};
use crate::io::report;
use crate::io::video::Stream;

/// Largest tile, width and height in pixels: 64 MiB in f32. Wide tiles repeat less of the projection of Gaussians, and
/// low ones make rows of tiles that fit in memory at any width.
const LARGEST_TILE: [u32; 2] = [4096, 1024];

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
    let facts = Manifest::new(scene, path, &settings, &Networks::default(), &machine, args.alpha)?;
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
    let fps = if seconds > 0.0 { done as f64 / seconds } else { 0.0 };
    let [load, encode] = [load_time, painter.encode_time].map(|time| time.as_secs_f64());
    if let Some(file) = &args.json {
        let figures = json!({
            "mode": Mode::Native.name(),
            "frames_displayed": done,
            "frames_rendered": done,
            "frames_written": done,
            "displayed_fps": fps,
            "load_s": load,
            "encode_s": encode,
            "gaussians": scene.gaussians().len(),
            "size": [first.width(), first.height()],
            "tile": tile_size(&first, LARGEST_TILE),
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
    if is_complete {
        return Ok(Outcome::Done);
    }
    let stream =
        Stream { size: [first.width(), first.height()], rate: path.frames_per_second(), frames: range.len() };
    let again = remainder(target, range.start, &(missing[done]..range.end), &range, &stream);
    note(format_args!("interrupted; all files are whole. To go on: {again}"));
    Ok(Outcome::Interrupted)
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

/// Width and height of the tiles of the image of `camera`, at most `largest`: as few as there can be, all of one size.
fn tile_size(camera: &Camera, largest: [u32; 2]) -> [u32; 2] {
    let size = [camera.width(), camera.height()];
    [0, 1].map(|a| size[a].div_ceil(size[a].div_ceil(largest[a].max(1))))
}

/// First pixels of the tiles of a side: the last tile ends where the side ends, and may repeat pixels of the one before.
fn firsts(side: u32, tile: u32) -> impl Iterator<Item = u32> {
    (0..side.div_ceil(tile)).map(move |i| (i * tile).min(side - tile))
}

/// Makes pictures of tiles.
struct Painter {
    color: NativeRasterizer,
    coverage: Option<NativeRasterizer>,
    largest_tile: [u32; 2],
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
            true => Some(NativeRasterizer::new(&coverage(scene)?, settings, machine)?),
            false => None,
        };
        Ok(Self {
            color: NativeRasterizer::new(scene, settings, machine)?,
            coverage,
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
            write_png_rows(writer, [camera.width(), camera.height()], channels, |rows| {
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
        let [width, height] = tile_size(camera, self.largest_tile);
        let bytes_each = if self.coverage.is_some() { 4 } else { 3 };
        let row_bytes = bytes_each * camera.width() as usize;
        let mut band = vec![0; row_bytes * height as usize];
        let mut next_row = 0;
        for top in firsts(camera.height(), height) {
            let started = Instant::now();
            for left in firsts(camera.width(), width) {
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
            // The last row of tiles may repeat rows that are written.
            let new = &band[row_bytes * (next_row - top) as usize..];
            if let Err(error) = write(new, top + height - next_row) {
                return Ok(Err(error));
            }
            self.encode_time += rendered.elapsed();
            next_row = top + height;
        }
        Ok(Ok(()))
    }

    /// The pixels of a tile, RGB or straight RGBA.
    fn tile(&mut self, camera: &Camera, window: Window) -> Result<Vec<u8>, CliError> {
        let [color, alpha] = &mut self.tile;
        self.color.window(camera, window, color)?;
        self.is_blank &= self.color.is_blank();
        match &mut self.coverage {
            None => Ok(color.to_rgb8()),
            Some(coverage) => {
                coverage.window(camera, window, alpha)?;
                Ok(straight_rgba8(color, alpha))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use gs3::FramePipeline;
    use gs3::scene::demo;

    use super::*;

    #[test]
    fn tiles_of_one_size_cover_a_side() {
        for (side, largest) in [(20_000_u32, 4096), (8193, 4096), (7, 3), (5, 9), (1, 1), (65_535, 4096)] {
            let tile = side.div_ceil(side.div_ceil(largest));
            let firsts: Vec<u32> = firsts(side, tile).collect();
            assert!(tile <= largest && firsts[0] == 0 && firsts[firsts.len() - 1] + tile == side);
            assert!(firsts.windows(2).all(|pair| pair[0] < pair[1] && pair[1] <= pair[0] + tile));
        }
    }

    /// Tiles that end anywhere, within tiles of the rasterizer too, give the bytes of the pipeline's native frame.
    #[test]
    fn a_picture_of_tiles_is_the_picture() {
        let scene = Arc::new(demo::scene().unwrap());
        let camera = demo::path().resized(211, 123).unwrap().cameras()[7];
        let settings =
            PipelineSettings { mode: Mode::Native, background: [0.3, 0.1, 0.6], ..Default::default() };
        let native = |scene: &Arc<Scene>| {
            let mut pipeline = FramePipeline::new(Arc::clone(scene), settings).unwrap();
            pipeline.render(&camera).unwrap().current.clone()
        };
        let image = native(&scene);
        let covered = native(&coverage(&scene).unwrap());
        for with_alpha in [false, true] {
            let expected = if with_alpha { straight_rgba8(&image, &covered) } else { image.to_rgb8() };
            for largest_tile in [[4096, 1024], [64, 48], [37, 19], [211, 1], [3, 123]] {
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
                assert!(found == expected, "{largest_tile:?}, alpha {with_alpha}");
                assert!(!painter.is_blank);
            }
        }
    }
}
