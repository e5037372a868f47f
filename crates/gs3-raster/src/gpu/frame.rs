//! The kernels bound to the buffers of one picture size. A frame records them and creates nothing.

use gs3_compute::{
    Arena, Bound, BoundScan, BoundSort, Buffer, Gpu, GpuError, Kernel, Pairs, Recorder, Slice, Use, grid,
};

use super::blocks::{BLOCK_PIXELS, BLOCKS_STAGE};
use super::gbuffer::Target;
use super::kernels::{Kernels, Sorts};
use super::plan::{Band, Counters, FramePlan};
use super::scene::Page;

/// Invocations of the workgroups that `dispatches` counts, `GROUP` of `plan.wgsl`.
pub const GROUP: u32 = 256;

/// Byte offsets where `plan.wgsl` writes the counts of workgroups over splats and over entries.
const OVER_SPLATS: u64 = 0;
const OVER_ENTRIES: u64 = 3 * 4;

/// Byte offsets of single counts in [`Counters`].
const SPLATS: u64 = std::mem::offset_of!(Counters, splats) as u64;
const PLACES: u64 = std::mem::offset_of!(Counters, places) as u64;
const ENTRIES: u64 = std::mem::offset_of!(Counters, entries) as u64;

/// Byte offset in [`Counters`] of the maxima over frames.
const MOST: u64 = std::mem::offset_of!(Counters, most_splats) as u64;
const MOST_BYTES: u64 = size_of::<Counters>() as u64 - MOST;

/// Buffers of fixed size.
pub struct Fixed {
    pub view: Buffer,
    pub counters: Buffer,
    chunk_count: Buffer,
    dispatches: Buffer,
    splat_total: Buffer,
    entry_total: Buffer,
}

impl Fixed {
    pub fn new(gpu: &Gpu, chunks: u32) -> Result<Self, GpuError> {
        Ok(Self {
            view: gpu.buffer("view", Use::Uniform, size_of::<super::view::ViewUniform>() as u64)?,
            counters: gpu.buffer("counters", Use::Storage, size_of::<Counters>() as u64)?,
            chunk_count: gpu.buffer_with("chunk count", Use::Storage, &[chunks])?,
            dispatches: gpu.buffer("dispatches", Use::Indirect, 2 * 3 * 4)?,
            splat_total: gpu.buffer("splat total", Use::Storage, 4)?,
            entry_total: gpu.buffer("entry total", Use::Storage, 4)?,
        })
    }
}

/// A page's kernels.
struct BoundPage {
    mark: Bound,
    project: Bound,
    groups: [u32; 3],
}

/// A band's kernels.
struct BoundBand {
    count: Bound,
    emit: Bound,
    /// Workgroups over tiles, including the tile of entries that are not drawn.
    tiles: [u32; 3],
    /// One workgroup per tile.
    blend: [u32; 3],
}

/// A frame's kernels, except the kernels that write a G-buffer.
pub struct Frame {
    pub plan: FramePlan,
    pages: Vec<BoundPage>,
    scan_places: BoundScan,
    plan_splats: Bound,
    sort_by_depth: BoundSort,
    bands: Vec<BoundBand>,
    scan_tiles: BoundScan,
    plan_entries: Bound,
    sort_by_tile: BoundSort,
    clear: Bound,
    find: Bound,
    blend: Kernel,
    /// Uniforms of bands.
    band_buffers: Vec<Buffer>,
    dispatches: Buffer,
    /// Which of a sort's two buffers has the result.
    sorted: [usize; 2],
}

/// The buffers of a frame, by the names in the kernels. Each slice has the length in the plan, so that its length is
/// its capacity.
struct Buffers<'a> {
    plan: &'a FramePlan,
    arena: &'a Arena,
}

impl<'a> Buffers<'a> {
    fn get(&self, name: &str) -> Result<Slice<'a>, GpuError> {
        let buffer = self.arena.get(name).ok_or_else(|| GpuError::Bindings {
            kernel: "a frame".to_owned(),
            expected: name.to_owned(),
            actual: "no such buffer".to_owned(),
        })?;
        Ok(buffer.part(0, self.plan.bytes_of(name)))
    }

    fn pairs(&self, keys: [&str; 2], values: [&str; 2]) -> Result<[Pairs<'a>; 2], GpuError> {
        let pair = |k: usize| Ok(Pairs { keys: self.get(keys[k])?, values: self.get(values[k])? });
        Ok([pair(0)?, pair(1)?])
    }
}

/// Names of a sort's two buffers.
const ORDER: [&str; 2] = ["order0", "order1"];
const DEPTH_KEYS: [&str; 2] = ["depth_keys0", "depth_keys1"];
const ENTRY_TILES: [&str; 2] = ["entry_tiles0", "entry_tiles1"];
const ENTRY_SPLATS: [&str; 2] = ["entry_splats0", "entry_splats1"];

impl Frame {
    /// Allocates the buffers of `plan` and binds the kernels to them.
    pub fn new(
        gpu: &Gpu,
        plan: FramePlan,
        kernels: &mut Kernels,
        sorts: &mut Option<Sorts>,
        pages: &[Page],
        fixed: &Fixed,
        arena: &mut Arena,
    ) -> Result<Self, GpuError> {
        // Everything is bound again below, whether or not the buffers grew.
        let _ = arena.fit(gpu, &plan.needs)?;
        let blend = kernels.blend(gpu, &plan)?;
        let [count, emit] = kernels.bin(gpu, plan.tile)?;
        let sorts = &*sorts.insert(Sorts::new(gpu, &plan, sorts.as_ref())?);
        let sorted = [sorts.by_depth.plan().result(), sorts.by_tile.plan().result()];
        let buffers = Buffers { plan: &plan, arena };
        let counters = fixed.counters.slice();
        let count_at = |start: u64| fixed.counters.part(start, 4);

        let mut projected = vec![
            ("view", fixed.view.slice()),
            ("depth_keys", buffers.get(DEPTH_KEYS[0])?),
            ("order", buffers.get(ORDER[0])?),
        ];
        for name in ["marks", "places", "splats"] {
            projected.push((name, buffers.get(name)?));
        }
        let bound_page = |page: &Page| {
            let bindings = [&projected[..], &page.bindings()].concat();
            Ok(BoundPage {
                mark: kernels.mark.bind(gpu, &bindings)?,
                project: kernels.project(plan.outputs).bind(gpu, &bindings)?,
                groups: grid(page.chunks)?,
            })
        };
        let bound_pages = pages.iter().map(bound_page).collect::<Result<Vec<_>, GpuError>>()?;

        let planned = [
            ("counters", counters),
            ("dispatches", fixed.dispatches.slice()),
            ("splat_total", fixed.splat_total.slice()),
            ("entry_total", fixed.entry_total.slice()),
            ("order", buffers.get(ORDER[0])?),
            ("entry_tiles", buffers.get(ENTRY_TILES[0])?),
        ];
        let band_buffers = plan
            .bands
            .iter()
            .map(|band| gpu.buffer_with("band", Use::Uniform, &[*band]))
            .collect::<Result<Vec<_>, GpuError>>()?;
        let mut bands = Vec::with_capacity(plan.bands.len());
        for (band, buffer) in plan.bands.iter().zip(&band_buffers) {
            let binned = [
                ("splats", buffers.get("splats")?),
                ("order", buffers.get(ORDER[sorted[0]])?),
                ("counters", counters),
                ("band", buffer.slice()),
                ("view", fixed.view.slice()),
                ("tile_counts", buffers.get("tile_counts")?),
                ("entry_tiles", buffers.get(ENTRY_TILES[0])?),
                ("entry_splats", buffers.get(ENTRY_SPLATS[0])?),
            ];
            bands.push(BoundBand {
                count: count.bind(gpu, &binned)?,
                emit: emit.bind(gpu, &binned)?,
                tiles: grid((band.rows * band.columns + 1).div_ceil(GROUP))?,
                blend: [band.columns, band.rows, 1],
            });
        }
        let tiles = [
            ("counters", counters),
            ("entry_tiles", buffers.get(ENTRY_TILES[sorted[1]])?),
            ("ranges", buffers.get("ranges")?),
        ];
        let (scan, chunk_count) = (&kernels.scan, fixed.chunk_count.slice());
        Ok(Self {
            pages: bound_pages,
            scan_places: scan.bind(gpu, chunk_count, buffers.get("places")?, fixed.splat_total.slice())?,
            plan_splats: kernels.plan_splats.bind(gpu, &planned)?,
            sort_by_depth: sorts.by_depth.bind(gpu, count_at(SPLATS), buffers.pairs(DEPTH_KEYS, ORDER)?)?,
            bands,
            scan_tiles: scan.bind(
                gpu,
                count_at(PLACES),
                buffers.get("tile_counts")?,
                fixed.entry_total.slice(),
            )?,
            plan_entries: kernels.plan_entries.bind(gpu, &planned)?,
            sort_by_tile: sorts.by_tile.bind(
                gpu,
                count_at(ENTRIES),
                buffers.pairs(ENTRY_TILES, ENTRY_SPLATS)?,
            )?,
            clear: kernels.clear.bind(gpu, &tiles)?,
            find: kernels.find.bind(gpu, &tiles)?,
            blend,
            band_buffers,
            dispatches: fixed.dispatches.clone(),
            sorted,
            plan,
        })
    }

    /// Binds blending to the G-buffer's planes, for each band.
    pub fn bind_target(
        &self,
        gpu: &Gpu,
        fixed: &Fixed,
        arena: &Arena,
        planes: &[(&'static str, Buffer)],
    ) -> Result<Vec<Bound>, GpuError> {
        self.bind_blending(gpu, fixed, arena, &self.blend, |band| {
            let (start, bytes) = self.plan.band_bytes(band);
            planes.iter().map(|(name, plane)| (*name, plane.part(start, bytes))).collect()
        })
    }

    /// Binds `kernel`, which blends exact blocks, for each band: the blocks that `chosen` marks, into `image`.
    pub fn bind_blocks(
        &self,
        gpu: &Gpu,
        fixed: &Fixed,
        arena: &Arena,
        kernel: &Kernel,
        [chosen, image, samples]: [&Buffer; 3],
    ) -> Result<Vec<Bound>, GpuError> {
        let outputs =
            || vec![("chosen", chosen.slice()), ("image", image.slice()), ("exact_samples", samples.slice())];
        self.bind_blending(gpu, fixed, arena, kernel, |_| outputs())
    }

    /// Binds `kernel` for each band to what blending reads, and to the band's `outputs`.
    fn bind_blending<'a>(
        &self,
        gpu: &Gpu,
        fixed: &Fixed,
        arena: &Arena,
        kernel: &Kernel,
        outputs: impl Fn(&Band) -> Vec<(&'static str, Slice<'a>)>,
    ) -> Result<Vec<Bound>, GpuError> {
        let buffers = Buffers { plan: &self.plan, arena };
        let mut blended =
            vec![("view", fixed.view.slice()), ("entry_splats", buffers.get(ENTRY_SPLATS[self.sorted[1]])?)];
        blended.push(("counters", fixed.counters.slice()));
        for name in ["ranges", "splats"] {
            blended.push((name, buffers.get(name)?));
        }
        let bind = |(band, uniform): (_, &Buffer)| {
            let all: Vec<_> =
                blended.iter().copied().chain([("band", uniform.slice())]).chain(outputs(band)).collect();
            kernel.bind(gpu, &all)
        };
        self.plan.bands.iter().zip(&self.band_buffers).map(bind).collect()
    }

    /// Records a reset of the maxima over frames.
    pub fn record_clearing(recorder: &mut Recorder<'_>, fixed: &Fixed) {
        recorder.stage("project");
        recorder.clear(&fixed.counters.part(MOST, MOST_BYTES));
    }

    /// Records the frame. Stages are named after the CPU's.
    pub fn record(&self, recorder: &mut Recorder<'_>, target: &Target) {
        recorder.stage("project");
        for page in &self.pages {
            recorder.dispatch(&page.mark, page.groups);
        }
        self.scan_places.record(recorder);
        recorder.dispatch(&self.plan_splats, [1, 1, 1]);
        for page in &self.pages {
            recorder.dispatch(&page.project, page.groups);
        }
        recorder.stage("order");
        self.sort_by_depth.record(recorder);
        for (band, blend) in self.bands.iter().zip(&target.blend) {
            self.record_bin(recorder, "bin", band);
            recorder.stage("blend");
            recorder.dispatch(blend, band.blend);
        }
    }

    /// Records the exact blocks of the frame recorded last, `scale` times coarser. `blend` is of [`Self::bind_blocks`].
    pub fn record_blocks(&self, recorder: &mut Recorder<'_>, blend: &[Bound], scale: u32) {
        let pixels_of_tile = (self.plan.tile * scale).pow(2);
        let groups = pixels_of_tile.div_ceil(BLOCK_PIXELS);
        for (band, blend) in self.bands.iter().zip(blend) {
            // Only the last band's entries are still there.
            if self.bands.len() > 1 {
                self.record_bin(recorder, BLOCKS_STAGE, band);
            }
            recorder.stage(BLOCKS_STAGE);
            let [columns, rows, _] = band.blend;
            recorder.dispatch(blend, [columns, rows, groups]);
        }
    }

    fn record_bin(&self, recorder: &mut Recorder<'_>, stage: &'static str, band: &BoundBand) {
        recorder.stage(stage);
        recorder.dispatch_indirect(&band.count, &self.dispatches, OVER_SPLATS);
        self.scan_tiles.record(recorder);
        recorder.dispatch(&self.plan_entries, [1, 1, 1]);
        recorder.dispatch_indirect(&band.emit, &self.dispatches, OVER_SPLATS);
        self.sort_by_tile.record(recorder);
        recorder.dispatch(&self.clear, band.tiles);
        recorder.dispatch_indirect(&self.find, &self.dispatches, OVER_ENTRIES);
    }
}
