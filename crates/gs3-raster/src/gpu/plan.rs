//! All sizes of the GPU rasterizer, from the scene, the picture's size and the device's limits: pure functions.

use bytemuck::{Pod, Zeroable};
use gs3_compute::{ChunkPlan, GpuError, Limits, MAX_PAIRS, Need, Use};
use gs3_scene::Size;

use super::scene::ScenePrecision;
use crate::chunk::CHUNK;
use crate::settings::Outputs;

/// Side of a tile in pixels, `TILE` of the shaders. Low-resolution frames have few pixels, with many splats each: smaller
/// tiles keep more of a device busy, and the longest list, which the frame waits for, is shorter. Larger frames are busy
/// anyway, and small tiles are more work for `bin`.
const fn tile_side(outputs: Outputs, size: Size) -> u32 {
    let is_small = size.pixels() <= SMALL_FRAME;
    if !matches!(outputs, Outputs::Color) && is_small { 8 } else { 16 }
}

/// Pixels of the largest frame with small tiles: 1,024 tiles of 16×16. (H100, hqgarden, `bin` and `blend`: 480×270 takes 0.84
/// ms with small tiles and 1.30 ms with large ones, 1024×540 0.89 and 0.79 ms.)
const SMALL_FRAME: u64 = 1024 * 256;

/// Bits of a depth that may differ: depths are positive, so the sign bit never differs.
pub const DEPTH_BITS: u32 = 31;

/// Bytes of a pixel in a plane of the G-buffer: four f32.
pub const PIXEL_BYTES: u64 = 16;

/// `Counters` of `frame.wgsl`: members that bindings start at lie 256 bytes apart, as any device takes them.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct Counters {
    pub splats: u32,
    _pad0: [u32; 63],
    pub places: u32,
    _pad1: [u32; 63],
    pub entries: u32,
    _pad2: [u32; 63],
    pub most_splats: u32,
    pub most_entries: u32,
    pub entry_shares: u32,
    pub loops_cut: u32,
}

/// `Band` of `frame.wgsl`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Band {
    pub first_row: u32,
    pub rows: u32,
    pub columns: u32,
    pub _pad: u32,
}

/// The division of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScenePlan {
    pub gaussians: u32,
    pub sh_degree: u8,
    pub precision: ScenePrecision,
    /// Gaussians in parts that fit one binding each, whole chunks.
    pub pages: ChunkPlan,
    pub chunks: u32,
}

impl ScenePlan {
    /// # Errors
    /// [`GpuError::TooLarge`] above 2³² Gaussians.
    pub fn new(
        limits: &Limits,
        gaussians: u64,
        sh_degree: u8,
        precision: ScenePrecision,
    ) -> Result<Self, GpuError> {
        let too_large = |_| GpuError::TooLarge {
            what: "Gaussians of a scene".to_owned(),
            max: u32::MAX.into(),
            actual: gaussians,
        };
        let largest = precision.sh_bytes(sh_degree).max(precision.shape_bytes());
        Ok(Self {
            gaussians: u32::try_from(gaussians).map_err(too_large)?,
            sh_degree,
            precision,
            pages: ChunkPlan::new(limits, gaussians, largest, CHUNK as u64)?,
            chunks: u32::try_from(gaussians.div_ceil(CHUNK as u64)).map_err(too_large)?,
        })
    }
}

/// Capacities that only the frame itself can prove to be sufficient.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Capacity {
    /// Visible Gaussians.
    pub splats: u32,
    /// (tile, splat) pairs of a band.
    pub entries: u32,
    /// Rows of tiles in a band, at most.
    pub band_rows: u32,
}

/// Vectors of a splat (`splat.wgsl`).
pub const fn splat_vectors(outputs: Outputs) -> u32 {
    match outputs {
        Outputs::Color => 3,
        Outputs::Samples | Outputs::GBuffer | Outputs::GBufferMixed => 5,
    }
}

/// Bytes of a splat.
const fn splat_bytes(outputs: Outputs) -> u64 {
    splat_vectors(outputs) as u64 * 16
}

/// The most splats and entries that one binding each can hold.
fn most(limits: &Limits) -> Capacity {
    let bytes = limits.binding_bytes.min(limits.buffer_bytes);
    // The digits of a sort take fewer bytes than its keys.
    let items = |size: u64| (bytes / size).min(MAX_PAIRS.into()) as u32;
    Capacity { splats: items(splat_bytes(Outputs::GBufferMixed)), entries: items(4), band_rows: u32::MAX }
}

/// Capacity for `count` items: powers of two up to 2²⁰, then multiples of 2²⁰, so that buffers that have grown seldom
/// grow again.
fn rounded(count: u32, max: u32) -> u32 {
    const STEP: u32 = 1 << 20;
    const LEAST: u32 = 1 << 16;
    let rounded = match count {
        0..STEP => count.next_power_of_two().max(LEAST),
        _ => count.checked_next_multiple_of(STEP).unwrap_or(max),
    };
    rounded.min(max)
}

impl Capacity {
    /// The initial capacity, a guess.
    pub fn new(limits: &Limits, scene: &ScenePlan, size: Size, outputs: Outputs) -> Self {
        let most = most(limits);
        // Rarely more than half of a large scene is in view.
        let splats = scene.gaussians.min((1 << 20).max(scene.gaussians / 2)).min(most.splats);
        let tile = tile_side(outputs, size);
        let tiles = size.width.div_ceil(tile) * size.height.div_ceil(tile);
        // Low-resolution splats touch one or two tiles, and splats of native frames three to ten.
        let entries = u64::from(splats) * 4 + u64::from(tiles) * 16;
        let entries = entries.min(most.entries.into()) as u32;
        Self {
            splats: rounded(splats, most.splats),
            entries: rounded(entries, most.entries),
            band_rows: most.band_rows,
        }
    }

    /// The capacity for a frame with these needs, plus a quarter where possible; `None` if the capacity was
    /// sufficient.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] if the device cannot hold the frame's needs.
    pub fn grown(
        self,
        limits: &Limits,
        rows: u32,
        splats: u32,
        entries: u32,
    ) -> Result<Option<Self>, GpuError> {
        let most = most(limits);
        let too_large = |what: &str, max: u32, actual: u32| GpuError::TooLarge {
            what: what.to_owned(),
            max: max.into(),
            actual: actual.into(),
        };
        let with_reserve = |count: u32, max: u32| rounded(count.saturating_add(count / 4), max);
        let mut grown = self;
        if splats > self.splats {
            if splats > most.splats {
                return Err(too_large("visible Gaussians", most.splats, splats));
            }
            grown.splats = with_reserve(splats, most.splats);
        }
        if entries > self.entries {
            if entries > most.entries {
                // Smaller bands have fewer entries each.
                let band_rows = self.band_rows.min(rows);
                if band_rows == 1 {
                    return Err(too_large("splats on a row of tiles", most.entries, entries));
                }
                let share = entries.div_ceil(most.entries).max(2);
                grown.band_rows = (band_rows / share).max(1);
                grown.entries = most.entries;
            } else {
                grown.entries = with_reserve(entries, most.entries);
            }
        }
        Ok((grown != self).then_some(grown))
    }
}

/// Sizes of a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FramePlan {
    /// Capacity in pixels.
    pub size: Size,
    pub outputs: Outputs,
    /// Side of a tile in pixels.
    pub tile: u32,
    pub capacity: Capacity,
    /// Parts of the picture that are binned and blended one after the other. A band has as many rows of tiles as fit
    /// one binding of pixels.
    pub bands: Vec<Band>,
    /// Bits of a tile's number in a band, including the number after the last tile.
    pub tile_bits: u32,
    /// All buffers except the G-buffer's.
    pub needs: Vec<Need>,
}

impl FramePlan {
    /// # Errors
    /// [`GpuError::TooLarge`] if the device cannot bind buffers of this size.
    pub fn new(
        limits: &Limits,
        scene: &ScenePlan,
        size: Size,
        outputs: Outputs,
        capacity: Capacity,
    ) -> Result<Self, GpuError> {
        Self::with_tiles(limits, scene, size, outputs, capacity, tile_side(outputs, size))
    }

    /// As [`Self::new`], with tiles of `tile`×`tile` pixels.
    pub fn with_tiles(
        limits: &Limits,
        scene: &ScenePlan,
        size: Size,
        outputs: Outputs,
        capacity: Capacity,
        tile: u32,
    ) -> Result<Self, GpuError> {
        let Size { width: columns, height: rows } = size.map(|side| side.div_ceil(tile));
        let row_bytes = u64::from(tile) * u64::from(size.width) * PIXEL_BYTES;
        let bytes = limits.binding_bytes.min(limits.buffer_bytes);
        let band_rows =
            u32::try_from(bytes / row_bytes).unwrap_or(u32::MAX).min(capacity.band_rows).min(rows);
        if band_rows == 0 {
            let what = "bytes of a row of tiles".to_owned();
            return Err(GpuError::TooLarge { what, max: bytes, actual: row_bytes });
        }
        let band = |first_row: u32| {
            let rows = band_rows.min(rows - first_row);
            Band { first_row, rows, columns, _pad: 0 }
        };
        let bands = (0..rows).step_by(band_rows as usize).map(band).collect();
        let tiles = band_rows * columns;
        let plan = Self {
            size,
            outputs,
            tile,
            capacity,
            bands,
            tile_bits: u32::BITS - tiles.leading_zeros(),
            needs: needs(scene, outputs, capacity, tiles),
        };
        for need in &plan.needs {
            if need.bytes > bytes {
                let what = format!("bytes of buffer {}", need.name);
                return Err(GpuError::TooLarge { what, max: bytes, actual: need.bytes });
            }
        }
        Ok(plan)
    }

    /// Where a band's pixels are in a plane, in bytes: start and length.
    pub fn band_bytes(&self, band: &Band) -> (u64, u64) {
        let row = u64::from(self.size.width) * PIXEL_BYTES;
        let tile = self.tile;
        let first = band.first_row * tile;
        let last = ((band.first_row + band.rows) * tile).min(self.size.height);
        (u64::from(first) * row, u64::from(last - first) * row)
    }

    /// The bytes that the named buffer needs.
    pub fn bytes_of(&self, name: &str) -> u64 {
        self.needs.iter().find(|need| need.name == name).map_or(0, |need| need.bytes)
    }
}

/// Buffers of a frame. Names ending in 0 and 1 are a sort's two buffers.
fn needs(scene: &ScenePlan, outputs: Outputs, capacity: Capacity, tiles: u32) -> Vec<Need> {
    let Capacity { splats, entries, .. } = capacity;
    let storage =
        |name, count: u32, size: u64| Need { name, usage: Use::Storage, bytes: u64::from(count) * size };
    vec![
        storage("marks", scene.chunks, CHUNK as u64 / 8),
        storage("places", scene.chunks, 4),
        storage("splats", splats, splat_bytes(outputs)),
        storage("depth_keys0", splats, 4),
        storage("depth_keys1", splats, 4),
        storage("order0", splats, 4),
        storage("order1", splats, 4),
        storage("tile_counts", splats + 1, 4),
        storage("entry_tiles0", entries, 4),
        storage("entry_tiles1", entries, 4),
        storage("entry_splats0", entries, 4),
        storage("entry_splats1", entries, 4),
        storage("ranges", tiles + 1, 8),
    ]
}

#[cfg(test)]
mod tests {
    use gs3_compute::assert_layout;

    use super::*;

    #[test]
    fn layouts_are_those_of_the_shader() {
        let source = include_str!("frame.wgsl");
        assert_layout!(&[source], Band, Band { first_row, rows, columns, _pad });
        assert_layout!(
            &[source],
            Counters,
            Counters { splats, places, entries, most_splats, most_entries, entry_shares, loops_cut }
        );
    }

    fn limits(binding_bytes: u64) -> Limits {
        Limits {
            buffer_bytes: 4 * binding_bytes,
            binding_bytes,
            storage_bindings: 16,
            workgroup_bytes: 32 << 10,
            ..Limits::LEAST
        }
    }

    const SIZES: [[u32; 2]; 8] =
        [[1, 1], [15, 17], [480, 270], [1920, 1080], [4096, 2160], [7680, 4320], [8192, 8192], [8192, 1]];

    /// For every picture and scene, every binding fits the smallest devices that gs3 supports. Bands cover the
    /// picture once, and bindings of bands start at offsets that devices accept.
    #[test]
    fn every_size_fits_the_smallest_device() {
        for binding_bytes in [128 << 20, 2 << 30, (4 << 30) - 4] {
            let limits = limits(binding_bytes);
            for gaussians in [1, 255, 257, 3_400_000, 50_000_000] {
                for (degree, precision) in
                    [(0, ScenePrecision::F16), (3, ScenePrecision::F16), (3, ScenePrecision::F32)]
                {
                    let scene = ScenePlan::new(&limits, gaussians, degree, precision).unwrap();
                    check_pages(&scene, &limits);
                    for size in SIZES.map(Size::from) {
                        for outputs in [Outputs::Color, Outputs::GBufferMixed] {
                            let capacity = Capacity::new(&limits, &scene, size, outputs);
                            let plan = FramePlan::new(&limits, &scene, size, outputs, capacity).unwrap();
                            check_frame(&plan, &limits);
                        }
                    }
                }
            }
        }
    }

    fn check_pages(scene: &ScenePlan, limits: &Limits) {
        let mut next = 0;
        for range in scene.pages.ranges() {
            assert_eq!(range.start, next);
            assert_eq!(range.start % CHUNK as u64, 0);
            let count = range.end - range.start;
            let row = scene.precision.sh_bytes(scene.sh_degree).max(scene.precision.shape_bytes());
            assert!(count * row <= limits.binding_bytes, "{scene:?}");
            assert!(gs3_compute::grid(count.div_ceil(CHUNK as u64) as u32).is_ok());
            next = range.end;
        }
        assert_eq!(next, u64::from(scene.gaussians));
    }

    fn check_frame(plan: &FramePlan, limits: &Limits) {
        assert!(plan.needs.iter().all(|need| need.bytes <= limits.binding_bytes && need.bytes > 0));
        let (mut row, mut end) = (0, 0);
        for band in &plan.bands {
            assert_eq!(band.first_row, row);
            assert!(band.rows > 0 && band.rows <= limits.workgroups && band.columns <= limits.workgroups);
            let (start, bytes) = plan.band_bytes(band);
            assert_eq!((start, start % 256), (end, 0));
            assert!(bytes > 0 && bytes <= limits.binding_bytes);
            assert!(band.rows * band.columns < 1 << plan.tile_bits);
            (row, end) = (row + band.rows, start + bytes);
        }
        assert_eq!(end, plan.size.pixels() * PIXEL_BYTES, "{}", plan.size);
        assert_eq!(row, plan.size.height.div_ceil(plan.tile));
    }

    #[test]
    fn room_grows_to_what_a_frame_needed() {
        let limits = limits(128 << 20);
        let capacity = Capacity { splats: 1000, entries: 2000, band_rows: u32::MAX };
        let grown = |splats, entries| capacity.grown(&limits, 135, splats, entries).unwrap();
        assert_eq!(grown(1000, 2000), None);
        assert_eq!(grown(1001, 2000), Some(Capacity { splats: 1 << 16, ..capacity }));
        assert_eq!(grown(1000, 400_000), Some(Capacity { entries: 1 << 19, ..capacity }));
        assert_eq!(grown(800_000, 0), Some(Capacity { splats: 1 << 20, ..capacity }));
        assert_eq!(grown(1_677_721, 0), Some(Capacity { splats: 1_677_721, ..capacity }));
    }

    /// If no binding can hold a band's entries, bands shrink, down to one row of tiles.
    #[test]
    fn bands_shrink_when_entries_do_not_fit() {
        let limits = limits(128 << 20);
        let most = (128 << 20) / 4;
        let scene = ScenePlan::new(&limits, 3_000_000, 0, ScenePrecision::F16).unwrap();
        let mut capacity = Capacity::new(&limits, &scene, Size::new(7680, 4320), Outputs::Color);
        let rows = 270;
        let mut seen = Vec::new();
        loop {
            match capacity.grown(&limits, rows, 0, u32::MAX) {
                Ok(Some(grown)) => {
                    assert_eq!(grown.entries, most);
                    assert!(grown.band_rows < capacity.band_rows);
                    capacity = grown;
                    seen.push(capacity.band_rows);
                }
                Ok(None) => panic!("there was never enough"),
                Err(GpuError::TooLarge { max, .. }) => {
                    assert_eq!(max, u64::from(most));
                    break;
                }
                Err(other) => panic!("{other}"),
            }
        }
        assert_eq!(seen.last(), Some(&1));
        let over = capacity.grown(&limits, rows, 9_000_000, 0);
        assert!(
            matches!(over, Err(GpuError::TooLarge { max: 1_677_721, actual: 9_000_000, .. })),
            "{over:?}"
        );
    }
}
