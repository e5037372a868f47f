//! The CPU rasterizer: `project` → `bin` → `blend` → `resolve`, all cores, SIMD chosen at run time.
//!
//! Deterministic: a frame is the same bit for bit whatever the number of threads, because every tile sorts its splats
//! by a unique key (depth, then scene order) and is blended by one thread.

mod bin;
pub(crate) mod blend;
pub(crate) mod cover;
mod geometry;
mod importance;
mod math;
mod order;
pub(crate) mod project;
mod resolve;
pub(crate) mod sh;
pub(crate) mod splat;

use std::fmt;
use std::sync::Arc;
use std::time::{Duration, Instant};

use fearless_simd::{Level, dispatch};
use gs3_scene::{Camera, GBuffer, Image, Margin, Scene};
use rayon::prelude::*;

use crate::chunk::{self, CHUNK, Chunk};
use crate::settings::{Culling, Outputs, RasterError, RasterSettings};
use crate::view::View;
use bin::{Bins, TILE_HEIGHT, TILE_WIDTH};
use blend::{COLOR, GBUFFER, GBUFFER_MIXED, TileScratch};
pub use importance::Importance;
use project::{ProjectInput, Projected};
use resolve::{Band, Resolver};

/// Chunks per projection job: large enough to amortise scheduling, small enough to balance; a job's splats fit the
/// bits that keys have for them.
const JOB_CHUNKS: usize = 64;
const _: () = assert!(JOB_CHUNKS * CHUNK <= bin::MAX_JOB_SIZE);

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
    times: RasterTimes,
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
    /// Prepares `scene`: bounds of runs of Gaussians, for culling.
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
        Self { scene, culling, level, chunks, jobs, bins: Bins::default(), times: RasterTimes::default() }
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
    pub fn visible_count(&self) -> usize {
        self.jobs.iter().map(|job| job.splats.len()).sum()
    }

    /// Rasterizes the scene seen by `camera` into `out`, which takes the camera's size and the margin around it; its
    /// memory is reused.
    ///
    /// # Errors
    /// [`RasterError`] if a setting is out of range; `out` is untouched then.
    pub fn rasterize(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut GBuffer,
    ) -> Result<(), RasterError> {
        settings.check()?;
        resolve::prepare(out, camera, settings);
        let bands = resolve::gbuffer_bands(out);
        match settings.outputs {
            Outputs::Color => self.run::<COLOR>(camera, settings, bands),
            Outputs::GBuffer => self.run::<GBUFFER>(camera, settings, bands),
            Outputs::GBufferMixed => self.run::<GBUFFER_MIXED>(camera, settings, bands),
        }
        Ok(())
    }

    /// Rasterizes colour only, as an [`Image`] whose fourth channel is alpha. `settings.outputs` and
    /// `settings.margin` are not read.
    ///
    /// # Errors
    /// [`RasterError`] if a setting is out of range; `out` is untouched then.
    pub fn rasterize_image(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut Image,
    ) -> Result<(), RasterError> {
        settings.check()?;
        let settings = RasterSettings { margin: Margin::NONE, ..*settings };
        out.resize(camera.width() as usize, camera.height() as usize);
        self.run::<COLOR>(camera, &settings, resolve::image_bands(out));
        Ok(())
    }

    fn run<const OUTPUTS: usize>(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        bands: Vec<Band<'_>>,
    ) {
        let started = Instant::now();
        let view = View::new(camera, settings);
        self.project(&view, OUTPUTS != COLOR, false);
        let projected = Instant::now();

        let size = view.size.map(|side| side as usize);
        let (columns, rows) = (size[0].div_ceil(TILE_WIDTH), size[1].div_ceil(TILE_HEIGHT));
        self.bins.fill(&self.jobs, columns, rows, self.culling);
        let binned = Instant::now();

        let (jobs, bins, level) = (&self.jobs, &self.bins, self.level);
        let resolver = Resolver::new(&view, settings);
        bands.into_par_iter().enumerate().for_each_init(TileScratch::default, |scratch, (row, mut band)| {
            for column in 0..columns {
                dispatch!(level, s => {
                    let tile = [column, row];
                    blend::blend_tile::<_, OUTPUTS>(s, jobs, bins, tile, size, scratch);
                    resolver.resolve::<_, OUTPUTS>(s, &mut scratch.blocks, tile, size, &mut band);
                });
            }
        });
        self.times =
            RasterTimes { project: projected - started, bin: binned - projected, blend: binned.elapsed() };
    }

    /// The splats of a frame in scene order.
    #[cfg(all(test, feature = "gpu"))]
    pub(crate) fn splats(&mut self, camera: &Camera, settings: &RasterSettings) -> Vec<splat::Splat> {
        self.project(&View::new(camera, settings), false, false);
        self.jobs.iter().flat_map(|job| job.splats.iter().copied()).collect()
    }

    fn project(&mut self, view: &View, with_geometry: bool, with_indices: bool) {
        let input = ProjectInput {
            gaussians: self.scene.gaussians(),
            opacity_mode: self.scene.opacity_mode(),
            view,
            culling: self.culling,
            with_geometry,
            with_indices,
        };
        let (chunks, level) = (&self.chunks, self.level);
        let frustum = chunk::Frustum::new(view);
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
