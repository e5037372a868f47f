//! Rows of many Gaussians, as bytes.

use std::io::{self, Read, Write};

use rayon::prelude::*;

/// Rows that are made at once.
const BLOCK: usize = 1 << 15;

/// The bytes of `count` rows of `row_bytes` each that `fill` makes, a block of rows at a time, rows of a block on all cores.
pub(super) struct Rows<F> {
    count: usize,
    row_bytes: usize,
    fill: F,
    /// The next row to make.
    next: usize,
    block: Vec<u8>,
    /// Bytes of `block` that are read.
    read: usize,
}

impl<F: Fn(usize, &mut [u8]) + Sync> Rows<F> {
    pub(super) const fn new(count: usize, row_bytes: usize, fill: F) -> Self {
        Self { count, row_bytes, fill, next: 0, block: Vec::new(), read: 0 }
    }

    /// The bytes that are left of the block, or else of the next one; none at the end.
    fn block(&mut self) -> &[u8] {
        if self.read == self.block.len() {
            let first = self.next;
            self.next = (first + BLOCK).min(self.count);
            self.read = 0;
            self.block.resize((self.next - first) * self.row_bytes, 0);
            let fill = &self.fill;
            self.block.par_chunks_exact_mut(self.row_bytes).with_min_len(256).enumerate().for_each(
                |(i, row)| {
                    fill(first + i, row);
                },
            );
        }
        &self.block[self.read..]
    }
}

impl<F: Fn(usize, &mut [u8]) + Sync> Read for Rows<F> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let mut left = self.block();
        let count = left.read(buffer)?;
        self.read += count;
        Ok(count)
    }
}

/// Writes [`Rows`].
pub(super) fn write_rows(
    writer: &mut impl Write,
    count: usize,
    row_bytes: usize,
    fill: impl Fn(usize, &mut [u8]) + Sync,
) -> io::Result<()> {
    let mut rows = Rows::new(count, row_bytes, fill);
    loop {
        let block = rows.block();
        if block.is_empty() {
            return Ok(());
        }
        writer.write_all(block)?;
        rows.read = rows.block.len();
    }
}
