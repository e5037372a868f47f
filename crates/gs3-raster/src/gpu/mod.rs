//! The GPU rasterizer: the same frame as [`crate::cpu`], in device memory, through wgpu on any adapter.
//!
//! | stage | shaders beside the CPU's stems | what |
//! |---|---|---|
//! | project | `chunk`, `project`, `geometry`, `sh` | marks the Gaussians that touch a sample, or with exact blocks a pixel, counts them, and writes their splats in scene order |
//! | order | | sorts the visible splats by depth, once for the whole picture |
//! | bin | `bin`, `tiles` | front to back, writes an entry for each tile of a splat; a stable sort by tile keeps that order within tiles |
//! | blend | `cover*`, `blend`, `places_tile`, `outputs_*`, `derivatives`, `mixed*` | a workgroup a tile, an invocation a pixel |
//! | blocks | `places_blocks`, `cover_blocks`, `blend` | the same for exact blocks, pixels of the native image, with the splats of a low-resolution frame |
//!
//! Deterministic except for the driver: splats of equal depth keep scene order, independent of the workgroup that
//! wrote them.
//!
//! A frame reads nothing back, and allocates memory only when size or outputs change. Only the device knows how many
//! splats are visible and how many tiles they cover. If the buffers overflow, [`GpuRasterizer::check_capacity`]
//! reports it and grows them, and the frame must be made again.

mod blend;
mod blocks;
mod crop;
mod error;
mod frame;
mod gbuffer;
mod kernels;
mod plan;
mod scene;
mod shaders;
#[cfg(test)]
mod tests;
mod view;

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use gs3_compute::{Arena, Gpu, GpuError, Limits, Readback, Recorder, Slice, Timings, now};
use gs3_scene::{Camera, GBuffer, Image, Margin, Scene, Size};

use crate::settings::{Culling, MAX_MARGIN, Outputs, RasterError, RasterSettings, Rules, Window};
use crate::view::View;
pub use blocks::{BLOCKS_STAGE, EXACT_BLOCK_BYTES, GpuBlocks, LowResolution};
pub use error::GpuRasterError;
use frame::{Fixed, Frame};
pub use gbuffer::GpuGBuffer;
use gbuffer::Target;
use kernels::{Kernels, Sorts};
use plan::{Capacity, Counters, FramePlan, ScenePlan};
use scene::Page;
pub use scene::ScenePrecision;
use shaders::STORAGE_BINDINGS;
use view::{Native, ViewUniform};

/// Rasterizes one scene on a GPU; keeps its memory between frames.
pub struct GpuRasterizer {
    gpu: Gpu,
    scene: Arc<Scene>,
    limits: Limits,
    plan: ScenePlan,
    culling: Culling,
    pages: Vec<Page>,
    kernels: Kernels,
    fixed: Fixed,
    arena: Arena,
    /// Whether frames have memory for margins.
    has_margins: bool,
    /// The sorts of the last size; their kernels may fit other sizes as well.
    sorts: Option<Sorts>,
    /// Kept when the size changes, so that a resized window does not measure it again.
    capacity: Option<Capacity>,
    frame: Option<Frame>,
    /// Number of `frame` among all frames of all rasterizers.
    frame_number: u64,
    /// The native picture of the frame recorded last, if the frame has the picture's splats.
    native: Option<Native>,
    /// Whether the next frame resets the maxima over frames.
    resets_counters: bool,
    /// The counters of frames, being read back.
    counters_back: Readback,
    /// The G-buffer of [`Self::rasterize_to`].
    gbuffer: GpuGBuffer,
    /// The device's clock, if it has one, for the frames that the caller waits for.
    clock: Option<Timings>,
    last_time: Option<Duration>,
}

impl fmt::Debug for GpuRasterizer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("GpuRasterizer")
            .field("gaussians", &self.scene.gaussians().len())
            .field("gpu", &self.gpu.adapter().name)
            .finish_non_exhaustive()
    }
}

/// Whether the buffers held all that the frames since the last check needed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CapacityCheck {
    /// The buffers held all of each frame.
    Sufficient {
        /// The most Gaussians projected onto at least one sample, or one pixel with exact blocks.
        splats: u32,
        /// The most tiles that they cover in all, or in the fullest band where the picture takes several.
        entries: u32,
    },
    /// A frame overflowed. The buffers have grown, and the frame is to be made again.
    Grown,
}

/// Number of frames of all rasterizers, counted from 1. A G-buffer uses it to identify the frame that it is bound to.
static FRAMES: AtomicU64 = AtomicU64::new(1);

impl GpuRasterizer {
    /// Packs `scene`, sends it to the device and compiles the kernels.
    ///
    /// # Errors
    /// [`GpuRasterError::Gpu`] if the device has too little memory for the scene or fails.
    pub fn new(
        gpu: &Gpu,
        scene: Arc<Scene>,
        culling: Culling,
        precision: ScenePrecision,
    ) -> Result<Self, GpuRasterError> {
        Self::with_limits(gpu, scene, culling, precision, gpu.capabilities().limits)
    }

    /// As [`Self::new`], within `limits`, which may be smaller than the device's.
    fn with_limits(
        gpu: &Gpu,
        scene: Arc<Scene>,
        culling: Culling,
        precision: ScenePrecision,
        limits: Limits,
    ) -> Result<Self, GpuRasterError> {
        check_bindings(gpu, &limits, STORAGE_BINDINGS)?;
        let g = scene.gaussians();
        let plan = ScenePlan::new(&limits, g.len() as u64, g.sh_degree, precision)?;
        Ok(Self {
            pages: scene::upload(gpu, g, &plan)?,
            kernels: Kernels::new(gpu, &plan, scene.opacity_mode(), culling)?,
            fixed: Fixed::new(gpu, plan.chunks)?,
            gpu: gpu.clone(),
            limits,
            plan,
            culling,
            scene,
            arena: Arena::default(),
            has_margins: false,
            sorts: None,
            capacity: None,
            frame: None,
            frame_number: 0,
            native: None,
            resets_counters: true,
            counters_back: Readback::new(gpu, size_of::<Counters>() as u64)?,
            gbuffer: GpuGBuffer::default(),
            clock: gpu.capabilities().timestamps.then(|| Timings::new(gpu)).transpose()?,
            last_time: None,
        })
    }

    /// The scene.
    #[must_use]
    pub const fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// The device.
    #[must_use]
    pub const fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Records the scene seen by `camera` into `out`, which gets the camera's size plus the margin. At most once in a
    /// submission. Commands recorded afterwards find the G-buffer finished. From the first frame with a margin on,
    /// there is memory for the widest margin, so later frames allocate nothing.
    ///
    /// # Errors
    /// [`GpuRasterError`] if a setting is out of range, or the device has too little memory for the size.
    pub fn record(
        &mut self,
        recorder: &mut Recorder<'_>,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut GpuGBuffer,
    ) -> Result<(), GpuRasterError> {
        check(settings)?;
        let view = View::new(camera, settings, self.scene.details().near);
        self.record_view(recorder, camera.size(), &view, None, settings, out)
    }

    /// Records the `picture`, in pixels without its margin, that `view` shows, with the splats of the `native` picture. The
    /// settings are checked.
    fn record_view(
        &mut self,
        recorder: &mut Recorder<'_>,
        picture: Size,
        view: &View,
        native: Option<Native>,
        settings: &RasterSettings,
        out: &mut GpuGBuffer,
    ) -> Result<(), GpuRasterError> {
        self.native = native;
        self.has_margins |= settings.margin != Margin::NONE;
        let room = if self.has_margins { Margin::all(MAX_MARGIN).padded(picture) } else { picture };
        self.fit(room, settings.outputs)?;
        let Some(frame) = &self.frame else { return Ok(()) };
        out.fit(&self.gpu, settings.outputs, room)?;
        out.set(settings.margin.padded(picture), settings.margin, settings.jitter);
        if out.target.frame != self.frame_number {
            let blend = frame.bind_target(&self.gpu, &self.fixed, &self.arena, out.planes())?;
            out.target = Target { frame: self.frame_number, blend };
        }
        recorder
            .write(&self.fixed.view.slice(), &[ViewUniform::new(view, settings, out.stride(), native)])?;
        if std::mem::take(&mut self.resets_counters) {
            Frame::record_clearing(recorder, &self.fixed);
        }
        frame.record(recorder, &out.target);
        Ok(())
    }

    /// As [`Self::record_low_resolution`] into `padded`, always with memory for margins. The picture without the margin is copied
    /// into `picture`, with rows one after the other.
    ///
    /// # Errors
    /// As [`Self::record`].
    pub fn record_padded(
        &mut self,
        recorder: &mut Recorder<'_>,
        frame: LowResolution<'_>,
        settings: &RasterSettings,
        padded: &mut GpuGBuffer,
        picture: &mut GpuGBuffer,
    ) -> Result<(), GpuRasterError> {
        self.has_margins = true;
        self.record_low_resolution(recorder, frame, settings, padded)?;
        let size = frame.camera.low_resolution(frame.scale).size();
        picture.fit(&self.gpu, settings.outputs, size)?;
        picture.set(size, Margin::NONE, settings.jitter);
        Ok(crop::record(&self.kernels.copy_picture, &self.gpu, recorder, padded, picture)?)
    }

    /// Whether the buffers held all of the frames submitted since the last check. The check waits for these frames, so
    /// where frames follow each other, check after the next frame is recorded, or every few frames.
    ///
    /// # Errors
    /// [`GpuRasterError::Gpu`] if the device cannot hold what the frame needs, or fails.
    pub fn check_capacity(&mut self) -> Result<CapacityCheck, GpuRasterError> {
        let counters = self.gpu.read::<u8>(&self.counters())?;
        self.check_capacity_with(&counters)
    }

    /// The device's counters of the needs of frames. The bytes read back after a frame are the maxima over all frames
    /// since the counters were last read back.
    #[must_use]
    pub fn counters(&self) -> Slice<'_> {
        self.fixed.counters.slice()
    }

    /// As [`Self::check_capacity`], from the bytes of [`Self::counters`] after the last submitted frame.
    ///
    /// # Errors
    /// [`GpuRasterError::Gpu`] if the device cannot hold what the frame needs, or its driver cut loops short.
    pub fn check_capacity_with(&mut self, counters: &[u8]) -> Result<CapacityCheck, GpuRasterError> {
        self.resets_counters = true;
        let (Some(frame), Some(capacity)) = (&self.frame, self.capacity) else {
            return Ok(CapacityCheck::Sufficient { splats: 0, entries: 0 });
        };
        let found = counters.get(..size_of::<Counters>()).map(bytemuck::pod_read_unaligned::<Counters>);
        let (splats, entries) = found.map_or((0, 0), |c| (c.most_splats, c.most_entries));
        let is_cut = found.is_some_and(|c| c.loops_cut != 0);
        let rows = frame.plan.bands.first().map_or(1, |band| band.rows);
        match capacity.grown(&self.limits, rows, splats, entries)? {
            None if is_cut => Err(GpuError::LoopsCut { what: "blending".to_owned() }.into()),
            None => Ok(CapacityCheck::Sufficient { splats, entries }),
            Some(grown) => {
                self.capacity = Some(grown);
                self.frame = None;
                Ok(CapacityCheck::Grown)
            }
        }
    }

    /// Rasterizes the scene seen by `camera` into `out` and waits for the frame. After an overflow the frame is made
    /// again until it is complete.
    ///
    /// # Errors
    /// [`GpuRasterError`] if a setting is out of range, or the device has too little memory or fails.
    pub fn rasterize(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut GpuGBuffer,
    ) -> Result<(), GpuRasterError> {
        now(self.make_whole(|rasterizer, recorder| rasterizer.record(recorder, camera, settings, out)))
    }

    /// Time of the last frame of [`Self::rasterize`] and the methods built on it, by the device's clock, without reading the
    /// frame back; none before the first frame, or without a clock.
    #[must_use]
    pub const fn last_time(&self) -> Option<Duration> {
        self.last_time
    }

    /// Submits what `record` records, and again after an overflow, until the frame is complete.
    async fn make_whole(
        &mut self,
        record: impl FnMut(&mut Self, &mut Recorder<'_>) -> Result<(), GpuRasterError>,
    ) -> Result<(), GpuRasterError> {
        let mut clock = self.clock.take();
        let made = self.make_timed(clock.as_mut(), record).await;
        self.clock = clock;
        self.last_time = made?;
        Ok(())
    }

    /// As [`Self::make_whole`]; the frame's time by `clock`.
    async fn make_timed(
        &mut self,
        mut clock: Option<&mut Timings>,
        mut record: impl FnMut(&mut Self, &mut Recorder<'_>) -> Result<(), GpuRasterError>,
    ) -> Result<Option<Duration>, GpuRasterError> {
        loop {
            let gpu = self.gpu.clone();
            let mut recorder = gpu.recorder(clock.as_deref_mut());
            record(self, &mut recorder)?;
            recorder.read_back(&self.counters(), &self.counters_back, 0);
            let submission = recorder.submit()?;
            let counters = self.counters_back.read(&gpu, &submission, <[u8]>::to_vec).await?;
            if self.check_capacity_with(&counters)? == CapacityCheck::Grown {
                continue;
            }
            return match &clock {
                Some(clock) => {
                    let times = clock.read_async(&gpu, &submission).await?;
                    Ok(Some(times.iter().map(|stage| stage.time).sum()))
                }
                None => Ok(None),
            };
        }
    }

    /// As [`Self::rasterize`], read back.
    ///
    /// # Errors
    /// As [`Self::rasterize`]; in a browser [`Self::rasterize_to_async`] is for it.
    pub fn rasterize_to(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut GBuffer,
    ) -> Result<(), GpuRasterError> {
        now(self.rasterize_to_async(camera, settings, out))
    }

    /// As [`Self::rasterize_to`], without blocking a browser.
    ///
    /// # Errors
    /// As [`Self::rasterize`].
    pub async fn rasterize_to_async(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut GBuffer,
    ) -> Result<(), GpuRasterError> {
        self.make_own(|rasterizer, recorder, own| rasterizer.record(recorder, camera, settings, own)).await?;
        Ok(self.gbuffer.read_async(&self.gpu, out).await?)
    }

    /// Rasterizes colour only, read back as an [`Image`] with alpha in the fourth channel. `settings.outputs` and
    /// `settings.margin` are not read.
    ///
    /// # Errors
    /// As [`Self::rasterize`]; in a browser [`Self::rasterize_image_async`] is for it.
    pub fn rasterize_image(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut Image,
    ) -> Result<(), GpuRasterError> {
        now(self.rasterize_image_async(camera, settings, out))
    }

    /// As [`Self::rasterize_image`], without blocking a browser.
    ///
    /// # Errors
    /// As [`Self::rasterize`].
    pub async fn rasterize_image_async(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut Image,
    ) -> Result<(), GpuRasterError> {
        let settings = RasterSettings { outputs: Outputs::Color, margin: Margin::NONE, ..*settings };
        self.make_own(|rasterizer, recorder, own| rasterizer.record(recorder, camera, &settings, own))
            .await?;
        Ok(self.gbuffer.read_image(&self.gpu, out).await?)
    }

    /// Submits what `record` records into the G-buffer of this rasterizer, until the frame is complete.
    async fn make_own(
        &mut self,
        mut record: impl FnMut(&mut Self, &mut Recorder<'_>, &mut GpuGBuffer) -> Result<(), GpuRasterError>,
    ) -> Result<(), GpuRasterError> {
        let mut own = std::mem::take(&mut self.gbuffer);
        let made = self.make_whole(|rasterizer, recorder| record(rasterizer, recorder, &mut own)).await;
        self.gbuffer = own;
        made
    }

    /// Rasterizes colour only, as [`Self::rasterize_image`] does, of a `window` of the camera's image: `out` gets the
    /// window's size. The window has the whole image's pixels but for rounding: positions count from the window's first
    /// pixel. With [`Culling::Aabb3Sigma`] and [`Culling::Adr`] this holds if the window begins at multiples of 16 pixels.
    ///
    /// # Errors
    /// As [`Self::rasterize`]; [`RasterError::Window`] if the window is empty or not within the image.
    pub fn rasterize_window(
        &mut self,
        camera: &Camera,
        window: Window,
        settings: &RasterSettings,
        out: &mut Image,
    ) -> Result<(), GpuRasterError> {
        let settings = RasterSettings { outputs: Outputs::Color, margin: Margin::NONE, ..*settings };
        check(&settings)?;
        window.check(camera.size())?;
        let view = View::from_window(camera, window, &settings, self.scene.details().near);
        let size = window.size();
        now(self.make_own(|rasterizer, recorder, own| {
            rasterizer.record_view(recorder, size, &view, None, &settings, own)
        }))?;
        Ok(now(self.gbuffer.read_image(&self.gpu, out))?)
    }

    /// Makes sure that `self.frame` has this size and these outputs.
    fn fit(&mut self, size: Size, outputs: Outputs) -> Result<(), GpuRasterError> {
        if self.frame.as_ref().is_some_and(|frame| frame.plan.size == size && frame.plan.outputs == outputs) {
            return Ok(());
        }
        if outputs == Outputs::GBufferMixed {
            check_bindings(&self.gpu, &self.limits, STORAGE_BINDINGS + 1)?;
        }
        let guess = Capacity::new(&self.limits, &self.plan, size, outputs);
        let known = self.capacity.get_or_insert(guess);
        known.entries = known.entries.max(guess.entries);
        let plan = FramePlan::new(&self.limits, &self.plan, size, outputs, *known)?;
        self.set_frame(plan)
    }

    fn set_frame(&mut self, plan: FramePlan) -> Result<(), GpuRasterError> {
        // If creation fails, buffers that the old frame is bound to may be gone.
        self.frame = None;
        let Self { gpu, kernels, sorts, pages, fixed, arena, .. } = self;
        self.frame = Some(Frame::new(gpu, plan, kernels, sorts, pages, fixed, arena)?);
        self.frame_number = FRAMES.fetch_add(1, Ordering::Relaxed);
        // The needs of frames of another size say nothing about these frames.
        self.resets_counters = true;
        Ok(())
    }
}

/// Checks that a kernel of `gpu` may have `needed` storage bindings.
fn check_bindings(gpu: &Gpu, limits: &Limits, needed: u32) -> Result<(), GpuError> {
    if limits.storage_bindings >= needed {
        return Ok(());
    }
    Err(GpuError::Unsupported {
        adapter: gpu.adapter().name.clone(),
        what: "storage bindings of a kernel".to_owned(),
        expected: format!("at least {needed}"),
        actual: limits.storage_bindings.to_string(),
    })
}

/// Checks `settings` against what a GPU supports.
fn check(settings: &RasterSettings) -> Result<(), RasterError> {
    settings.check()?;
    match settings.rules == Rules::KERBL {
        true => Ok(()),
        false => Err(RasterError::Rules { actual: settings.rules }),
    }
}
