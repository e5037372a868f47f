//! Rows of many Gaussians, written.

use std::io::{self, Write};

use rayon::prelude::*;

/// Writes `bytes` in rows that `fill` makes, a block of rows at a time, rows of a block on all cores.
pub(super) fn write_rows(
    writer: &mut impl Write,
    count: usize,
    row_bytes: usize,
    fill: impl Fn(usize, &mut [u8]) + Sync,
) -> io::Result<()> {
    const BLOCK: usize = 1 << 15;
    let mut bytes = vec![0; BLOCK.min(count) * row_bytes];
    for first in (0..count).step_by(BLOCK) {
        let rows = &mut bytes[..BLOCK.min(count - first) * row_bytes];
        rows.par_chunks_exact_mut(row_bytes).with_min_len(256).enumerate().for_each(|(i, row)| {
            fill(first + i, row);
        });
        writer.write_all(rows)?;
    }
    Ok(())
}
