// What a frame's kernels count, and a band of its tiles: beside Counters and Band in plan.rs, layouts compared by a
// test.

struct Counters {
    // Splats, those of them that there was room for. Counts that scans and sorts read are bindings of their own.
    @size(256) splats: u32,
    // Places that `count` fills: one more than splats.
    @size(256) places: u32,
    // (tile, splat) entries of the band that there was room for.
    @size(256) entries: u32,
    // The most visible Gaussians of a frame.
    most_splats: u32,
    // The most entries of a band of a frame.
    most_entries: u32,
    // Groups' sums of entries in shares of ENTRY_SHARE, rounded down.
    entry_shares: atomic<u32>,
    // Not 0 if the driver ended loops of blend early.
    loops_cut: atomic<u32>,
}

const ENTRY_SHARE: u32 = 4096u;

// Rows of tiles that are binned and blended together.
struct Band {
    first_row: u32,
    rows: u32,
    columns: u32,
    _pad: u32,
}
