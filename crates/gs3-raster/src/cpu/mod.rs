//! The CPU rasterizer: `project` → `bin` → `blend` → `resolve`, all cores, SIMD chosen at run time.
//!
//! Frames have the same bits with any number of threads: every tile sorts its splats by a unique key (depth, then
//! scene order), and is blended by one thread.

mod bin;
pub(crate) mod blend;
mod block_rows;
mod block_table;
mod blocks;
pub(crate) mod cover;
pub(crate) mod geometry;
mod grid;
mod importance;
mod math;
mod order;
pub(crate) mod project;
mod resolve;
pub(crate) mod sh;
mod slabs;
pub(crate) mod splat;

use std::cell::RefCell;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use fearless_simd::{Level, dispatch};
use gs3_scene::{BLOCK_SIDE, Camera, GBuffer, Image, Margin, Scene};
use rayon::prelude::*;
use thread_local::ThreadLocal;
use web_time::Instant;

use crate::chunk::{self, CHUNK, Chunk};
use crate::settings::{Culling, Outputs, RasterError, RasterSettings, Window};
use crate::view::{View, samples_pixels};
use bin::{Bins, ENTRY_BYTES, Part, TILE_HEIGHT, TILE_WIDTH};
use blend::{COLOR, GBUFFER, GBUFFER_MIXED, SAMPLES};
use block_table::BlockTable;
use blocks::Scratch;
use grid::Grid;
pub use importance::Importance;
use project::{ProjectInput, ProjectOutputs, Projected};
use resolve::{Band, Resolver};
use slabs::{Blending, Slab, SlabPlace, TileState};

/// Chunks per projection job: large enough to amortise scheduling, small enough to balance the threads. A job's
/// splats fit the bits that keys have for them.
const JOB_CHUNKS: usize = 64;
const _: () = assert!(JOB_CHUNKS * CHUNK <= bin::MAX_JOB_SIZE);

const _: () = assert!(TILE_HEIGHT.is_multiple_of(BLOCK_SIDE) && TILE_WIDTH.is_multiple_of(BLOCK_SIDE));

/// Default of [`Rasterizer::with_list_memory`] in bytes: 2²⁵ splats of tiles. Frames of captures have up to a tenth of them.
pub const LIST_MEMORY: u64 = 256 << 20;

/// Wall-clock time of the stages of the last frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RasterTimes {
    /// Culling, projection, colour.
    pub project: Duration,
    /// Assignment to tiles.
    pub bin: Duration,
    /// Sorting within tiles, blending, writing.
    pub blend: Duration,
}

/// Rasterizes one scene; keeps its scratch memory between frames.
///
/// Work is spread over the current rayon thread pool.
pub struct Rasterizer {
    scene: Arc<Scene>,
    culling: Culling,
    level: Level,
    chunks: Vec<Chunk>,
    jobs: Vec<Projected>,
    bins: Bins,
    /// Most entries of `bins` at once.
    most_entries: u64,
    /// [`slabs::MOST_AT_ONCE`] and [`slabs::SLAB`]. Tests choose smaller numbers.
    most_gaussians: [usize; 2],
    /// The slabs of the last frame; `jobs` has the splats of the last slab.
    slabs: Vec<Slab>,
    /// Splats of the last frame.
    visible: usize,
    /// The parts of the last frame's last slab; `bins` has the entries of one part.
    parts: Vec<Part>,
    /// The low-resolution frame that the splats belong to, if the last frame was one.
    last: Option<LastFrame>,
    /// Scratch memory of each thread that blends, kept for the next frame.
    scratch: ThreadLocal<RefCell<Scratch>>,
    times: RasterTimes,
}

/// The state that [`Rasterizer::rasterize_blocks`] needs.
struct LastFrame {
    view: View,
    grid: Grid,
    settings: RasterSettings,
    /// Width and height of the native image.
    size: [usize; 2],
    /// Whether `jobs` still has what the frame left there: the splats of `view`, or of the last slab of `view`.
    is_shared: bool,
}

impl fmt::Debug for Rasterizer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Rasterizer")
            .field("gaussians", &self.scene.gaussians().len())
            .field("culling", &self.culling)
            .finish_non_exhaustive()
    }
}

impl Rasterizer {
    /// Prepares `scene`: computes bounds of runs of Gaussians, for culling.
    #[must_use]
    pub fn new(scene: Arc<Scene>, culling: Culling) -> Self {
        Self::with_level(scene, culling, gs3_simd::level())
    }

    /// As [`Self::new`] with a given SIMD level instead of [`gs3_simd::level`].
    #[must_use]
    pub fn with_level(scene: Arc<Scene>, culling: Culling, level: Level) -> Self {
        let chunks = chunk::of_gaussians(scene.gaussians());
        let mut jobs = Vec::new();
        jobs.resize_with(chunks.len().div_ceil(JOB_CHUNKS), Projected::default);
        Self {
            scene,
            culling,
            level,
            chunks,
            jobs,
            bins: Bins::default(),
            most_entries: LIST_MEMORY / ENTRY_BYTES,
            most_gaussians: [slabs::MOST_AT_ONCE, slabs::SLAB],
            slabs: Vec::new(),
            visible: 0,
            parts: Vec::new(),
            last: None,
            scratch: ThreadLocal::new(),
            times: RasterTimes::default(),
        }
    }

    /// The same rasterizer, with lists of the splats of tiles that take at most `bytes` at once instead of [`LIST_MEMORY`], or
    /// as much as one tile's list. A frame with longer lists is made in parts, one after the other, with the same bits. Each part visits all
    /// splats again.
    #[must_use]
    pub fn with_list_memory(self, bytes: u64) -> Self {
        Self { most_entries: bytes / ENTRY_BYTES, ..self }
    }

    /// The scene.
    #[must_use]
    pub const fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// Wall-clock time of the stages of the last frame.
    #[must_use]
    pub const fn times(&self) -> RasterTimes {
        self.times
    }

    /// Number of splats that the last frame projected onto at least one sample.
    #[must_use]
    pub const fn visible_count(&self) -> usize {
        self.visible
    }

    /// Rasterizes the scene seen by `camera` into `out`, which gets the camera's size plus the margin. Its memory is
    /// reused.
    ///
    /// # Errors
    /// [`RasterError`] if a setting is out of range; `out` is unchanged then.
    pub fn rasterize(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut GBuffer,
    ) -> Result<(), RasterError> {
        settings.check()?;
        let view = View::new(camera, settings, self.scene.details().near);
        let grid = Grid::native(view.size);
        self.fill(&view, &grid, settings, out);
        Ok(())
    }

    /// Rasterizes the low-resolution frame of `camera`, `scale` (1 to 8) times coarser than the camera's image, into
    /// `out`. The samples equal those by [`Self::rasterize`] of [`Camera::low_resolution`] with the same `settings`,
    /// except for rounding. With matched dilation and jitter on the exact grid ([`gs3_scene::jitter::Jitter::grid`]), a sample
    /// has the bits of a pixel of the native image, and the frame's splats are the native image's, which
    /// [`Self::rasterize_blocks`] shares. With other jitter, and with many Gaussians in view, [`Self::rasterize_blocks`]
    /// projects the scene again.
    ///
    /// # Errors
    /// [`RasterError`] if a setting is out of range, or if the margin's left or top side times `scale` is not a
    /// multiple of a block's four pixels. `out` is unchanged then.
    pub fn rasterize_low_resolution(
        &mut self,
        camera: &Camera,
        scale: u32,
        settings: &RasterSettings,
        out: &mut GBuffer,
    ) -> Result<(), RasterError> {
        settings.check()?;
        settings.check_blocks(scale)?;
        let view = View::of_low_resolution(camera, scale, settings, self.scene.details().near);
        let grid = Grid::low_resolution(camera, scale, settings);
        let is_shared = samples_pixels(scale, settings.jitter);
        if is_shared {
            self.fill(&view, &grid, settings, out);
        } else {
            // The native image's splats are cut to its pixels, so they are not enough between and beyond these.
            self.rasterize(&camera.low_resolution(scale), settings, out)?;
        }
        let size = camera.size().to_usize();
        let has_blocks = settings.outputs != Outputs::Color;
        self.last = has_blocks.then_some(LastFrame { view, grid, settings: *settings, size, is_shared });
        Ok(())
    }

    fn fill(&mut self, view: &View, grid: &Grid, settings: &RasterSettings, out: &mut GBuffer) {
        resolve::prepare(out, grid.size, settings);
        let bands = resolve::gbuffer_bands(out);
        match settings.outputs {
            Outputs::Color => self.run::<COLOR>(view, grid, settings, bands),
            Outputs::Samples => self.run::<SAMPLES>(view, grid, settings, bands),
            Outputs::GBuffer => self.run::<GBUFFER>(view, grid, settings, bands),
            Outputs::GBufferMixed => self.run::<GBUFFER_MIXED>(view, grid, settings, bands),
        }
    }

    /// Rasterizes colour only, as an [`Image`] with alpha in the fourth channel. `settings.outputs` and
    /// `settings.margin` are not read.
    ///
    /// # Errors
    /// [`RasterError`] if a setting is out of range; `out` is unchanged then.
    pub fn rasterize_image(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut Image,
    ) -> Result<(), RasterError> {
        settings.check()?;
        let settings = RasterSettings { margin: Margin::NONE, ..*settings };
        out.resize(camera.width() as usize, camera.height() as usize);
        let view = View::new(camera, &settings, self.scene.details().near);
        self.run::<COLOR>(&view, &Grid::native(view.size), &settings, resolve::image_bands(out));
        Ok(())
    }

    /// Rasterizes colour only, as [`Self::rasterize_image`] does, of a `window` of the camera's image: `out` gets the
    /// window's size and has the bits of those pixels of the whole image. Gaussians that reach into the window from
    /// outside are in it. Images larger than memory are made window by window.
    ///
    /// [`Culling::Aabb3Sigma`] and [`Culling::Adr`] cut splats, and pixels are blended in blocks of 4×4. With these two the
    /// window has the whole image's bits if the window begins at multiples of 4 pixels.
    ///
    /// # Errors
    /// [`RasterError`] if a setting is out of range, or the window is empty or not within the image; `out` is unchanged
    /// then.
    pub fn rasterize_window(
        &mut self,
        camera: &Camera,
        window: Window,
        settings: &RasterSettings,
        out: &mut Image,
    ) -> Result<(), RasterError> {
        settings.check()?;
        window.check(camera.size())?;
        out.resize(window.width as usize, window.height as usize);
        let view = View::of_window(camera, window, settings, self.scene.details().near);
        self.run::<COLOR>(&view, &Grid::window(window), settings, resolve::image_bands(out));
        Ok(())
    }

    fn run<const OUTPUTS: usize>(
        &mut self,
        view: &View,
        grid: &Grid,
        settings: &RasterSettings,
        bands: Vec<Band<'_>>,
    ) {
        self.last = None;
        (self.times, self.visible) = (RasterTimes::default(), 0);
        let started = Instant::now();
        let slabs = self.slabs_of::<OUTPUTS>(view, grid);
        self.slabs.clone_from(&slabs);
        self.times.project = started.elapsed();
        let [columns, _] = grid.tiles();
        let mut of_rows: Vec<_> = bands.into_iter().map(|out| (out, Vec::new())).collect();
        if slabs.len() > 1 {
            of_rows.iter_mut().for_each(|(_, states)| {
                states.resize_with(columns, || TileState::new(OUTPUTS));
            });
        }
        for (k, slab) in slabs.iter().enumerate() {
            let started = Instant::now();
            let outputs =
                ProjectOutputs { depths: OUTPUTS >= SAMPLES, normals: OUTPUTS >= GBUFFER, indices: false };
            self.project(&slab.of(view), outputs, None);
            self.visible += self.jobs.iter().map(|job| job.splats.len()).sum::<usize>();
            self.parts = Bins::parts(&self.jobs, grid, self.most_entries);
            self.times.project += started.elapsed();
            let place = SlabPlace::new(k, slabs.len());
            self.blend_slab::<OUTPUTS>(view, grid, settings, place, &mut of_rows);
        }
    }

    /// Blends the splats at hand over the pixels of `of_rows`, for each row of tiles its band and the states of its tiles. Frames of
    /// one slab have no states.
    fn blend_slab<const OUTPUTS: usize>(
        &mut self,
        view: &View,
        grid: &Grid,
        settings: &RasterSettings,
        place: SlabPlace,
        of_rows: &mut [(Band<'_>, Vec<TileState>)],
    ) {
        let resolver = Resolver::new(view, settings);
        for part in &self.parts {
            let started = Instant::now();
            self.bins.fill(&self.jobs, grid, part, self.culling);
            let binned = Instant::now();
            let (jobs, bins, level) = (&self.jobs, &self.bins, self.level);
            let blending = Blending { jobs, bins, grid, resolver: &resolver, place, level };
            of_rows[part.rows.clone()].par_iter_mut().zip(part.rows.clone()).for_each(
                |((out, states), row)| {
                    let scratch = &mut self.scratch.get_or_default().borrow_mut().tile;
                    for column in part.columns.clone() {
                        blending.tile::<OUTPUTS>([column, row], states.get_mut(column), scratch, out);
                    }
                },
            );
            self.times.bin += binned - started;
            self.times.blend += binned.elapsed();
        }
    }

    /// The slabs of `view`.
    fn slabs_of<const OUTPUTS: usize>(&self, view: &View, grid: &Grid) -> Vec<Slab> {
        let values = grid.size[0] * grid.size[1] * blend::planes(OUTPUTS);
        slabs::slabs(self.scene.gaussians(), &self.chunks, view, values, self.most_gaussians)
    }

    /// The splats of a frame in scene order.
    #[cfg(all(test, feature = "gpu"))]
    pub(crate) fn splats(&mut self, camera: &Camera, settings: &RasterSettings) -> Vec<splat::Splat> {
        let view = View::new(camera, settings, self.scene.details().near);
        self.project(&view, ProjectOutputs::default(), None);
        self.jobs.iter().flat_map(|job| job.splats.iter().copied()).collect()
    }

    /// Projects the splats of `view`; if there are `wanted` blocks, the splats with a rectangle that meets one of them.
    fn project(&mut self, view: &View, outputs: ProjectOutputs, wanted: Option<&BlockTable>) {
        let input = ProjectInput {
            gaussians: self.scene.gaussians(),
            opacity_mode: self.scene.opacity_mode(),
            view,
            culling: self.culling,
            outputs,
            wanted,
        };
        let (chunks, level) = (&self.chunks, self.level);
        let frustum = chunk::Frustum::new(view);
        if self.slabs.len() > 1 {
            // Each job's memory is freed: other jobs have the splats of the next slab.
            self.jobs.par_iter_mut().for_each(|job| *job = Projected::default());
        }
        self.jobs.par_iter_mut().enumerate().for_each(|(j, out)| {
            out.clear();
            let first = j * JOB_CHUNKS;
            let last = (first + JOB_CHUNKS).min(chunks.len());
            for (i, chunk) in chunks[first..last].iter().enumerate() {
                if !frustum.may_see(chunk) {
                    continue;
                }
                let start = (first + i) * CHUNK;
                let end = (start + CHUNK).min(input.gaussians.len());
                dispatch!(level, s => project::project(s, &input, start, end, out));
            }
        });
    }
}
