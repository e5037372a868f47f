//! Runs a group of passes: threads share its rows out, and compute each strip by strip.

use std::cell::RefCell;
use std::ops::Range;

use fearless_simd::Level;

use super::bf16::{self, TileConfig};
use super::block::{Block, Layout, Numbers, Remainder, Sources};
use super::conv;
use super::ops;
use super::passes::{EXPORTS, Wave};
use super::plan::{Group, Kind, Pass, Step};
use crate::graph::Border;
use crate::images::Named;

/// Images that a group writes: the rows that a thread computes. An image that is not asked for is empty.
pub type Exports<'a> = [&'a mut [f32]; EXPORTS];

thread_local! {
    /// Strips of the thread: grown once, kept for all networks.
    static SCRATCH: RefCell<Vec<Block>> = const { RefCell::new(Vec::new()) };
}

/// A group with what it reads from outside.
#[derive(Clone, Copy, Debug)]
pub struct Job<'a> {
    pub group: &'a Group,
    pub level: Level,
    pub border: Border,
    pub images: &'a [Named<'a>],
    /// Which of `images` each layer of the graph is.
    pub image_of: &'a [usize],
    /// Blocks of scratch memory.
    pub scratch: usize,
    /// All of the arena but what the group stores.
    pub arena: Remainder<'a>,
}

/// Rows that a thread computes, and where they go.
#[derive(Debug)]
pub struct Slab<'a> {
    pub rows: Range<usize>,
    /// Of what the group stores.
    pub stored: &'a mut [Block],
    pub exports: Exports<'a>,
}

impl<'a> Slab<'a> {
    /// The rows above row `middle` and the others.
    fn split(self, group: &Group, middle: usize) -> [Self; 2] {
        let count = middle - self.rows.start;
        let (above, below) = self.stored.split_at_mut(count * group.row_len);
        let (mut above_exports, mut below_exports) = (Exports::default(), Exports::default());
        for (k, image) in self.exports.into_iter().enumerate() {
            let row_len = group.exports.get(k).map_or(0, |(_, row_len)| *row_len);
            // Images that are not asked for are empty.
            let middle = (count * row_len).min(image.len());
            (above_exports[k], below_exports[k]) = image.split_at_mut(middle);
        }
        [
            Slab { rows: self.rows.start..middle, stored: above, exports: above_exports },
            Slab { rows: middle..self.rows.end, stored: below, exports: below_exports },
        ]
    }
}

impl Job<'_> {
    /// Computes `slab` in as many parts as there are `rings`. The ring of a part is the memory of rows that passes
    /// keep for each other.
    pub fn slabs(&self, slab: Slab<'_>, rings: &mut [Vec<Block>]) {
        match rings {
            [] => {}
            [ring] => self.slab(slab, ring),
            _ => {
                let half = rings.len() / 2;
                let middle = slab.rows.start + slab.rows.len() * half / rings.len();
                let [above, below] = slab.split(self.group, middle);
                let (rings_above, rings_below) = rings.split_at_mut(half);
                rayon::join(|| self.slabs(above, rings_above), || self.slabs(below, rings_below));
            }
        }
    }

    /// Computes a slab row by row, each pass its rows behind the others: the slab's rows, and the rows above and
    /// below that later passes need.
    fn slab(&self, mut slab: Slab<'_>, ring: &mut [Block]) {
        let Range { start, end } = slab.rows;
        if slab.rows.is_empty() {
            return;
        }
        let Group { passes, height, .. } = self.group;
        let is_on_tiles = |step: &Step| matches!(&step.kind, Kind::Bf16(c) if c.is_on_tiles());
        let uses_tiles = passes.iter().flat_map(|pass| &pass.steps).any(is_on_tiles);
        let tile_config = uses_tiles.then(TileConfig::new);
        let rows_of = |wave: &Wave| start.saturating_sub(wave.extra)..(end + wave.extra).min(*height);
        let first = passes.iter().map(|pass| rows_of(&pass.wave).start + pass.wave.lag).min();
        let last = passes.iter().map(|pass| rows_of(&pass.wave).end + pass.wave.lag).max();
        SCRATCH.with_borrow_mut(|scratch| {
            if scratch.len() < self.scratch {
                scratch.resize(self.scratch, Block::default());
            }
            for time in first.unwrap_or(start)..last.unwrap_or(end) {
                for pass in passes {
                    let row = time.checked_sub(pass.wave.lag);
                    if let Some(y) = row.filter(|y| rows_of(&pass.wave).contains(y)) {
                        self.row(pass, y, tile_config.as_ref(), scratch, ring, &mut slab);
                    }
                }
            }
        });
    }

    /// Computes row `y`; what other threads have to write it does not.
    fn row(
        &self,
        pass: &Pass,
        y: usize,
        tile_config: Option<&TileConfig>,
        scratch: &mut [Block],
        ring: &mut [Block],
        slab: &mut Slab<'_>,
    ) {
        let Group { width, start, row_len, .. } = self.group;
        let (kept, ring) = Remainder::split(ring, pass.start + (y & pass.mask) * pass.row_len, pass.row_len);
        let own = slab.rows.contains(&y).then(|| y - slab.rows.start);
        let mut stored = own.map(|row| &mut slab.stored[row * row_len..][..*row_len]);
        for x in (0..*width).step_by(pass.strip) {
            // The last strip overlaps the strip before. The shared pixels get the same values again.
            let x = x.min(width - pass.strip);
            if pass.prefetches {
                self.prefetch_next(pass, [x + pass.strip, y]);
            }
            for step in &pass.steps {
                let out = step.out.start..step.out.start + step.len();
                let (made, strips) = Remainder::split(scratch, out.start, out.len());
                let sources = Sources::strip(self.arena, ring, strips, x);
                match &step.kind {
                    Kind::Export { export, exchange } => {
                        if let Some(row) = own
                            && !slab.exports[*export].is_empty()
                        {
                            let image = &mut slab.exports[*export][row * exchange.row_len()..];
                            let image = &mut image[..exchange.row_len()];
                            exchange.export_row(self.level, sources, &step.inputs, y, pass.strip, image);
                        }
                    }
                    _ => self.step(step, [x, y], tile_config, sources, made),
                }
                if let Some(whole) = &step.kept {
                    let row = &mut kept[whole.start - pass.start..][..whole.row_len()];
                    store(&scratch[out.clone()], pass.strip, row, whole, x);
                }
                if let (Some(whole), Some(stored)) = (&step.stored, &mut stored) {
                    let row = &mut stored[whole.start - start..][..whole.row_len()];
                    store(&scratch[out], pass.strip, row, whole, x);
                }
            }
        }
        for step in &pass.steps {
            if let Some(whole) = &step.kept {
                fill_halo(self.border, whole, &mut kept[whole.start - pass.start..][..whole.row_len()]);
            }
            if let (Some(whole), Some(stored)) = (&step.stored, &mut stored) {
                fill_halo(self.border, whole, &mut stored[whole.start - start..][..whole.row_len()]);
            }
        }
    }

    /// Asks for what the strip from pixel `x` of row `y` on, or the first of the next row, reads of images.
    fn prefetch_next(&self, pass: &Pass, [x, y]: [usize; 2]) {
        let [x, y] = if x < self.group.width { [x, y] } else { [0, y + 1] };
        for step in &pass.steps {
            let Kind::Import(imports) = &step.kind else { continue };
            for (layer, exchange) in imports {
                let (_, image) = self.images[self.image_of[*layer]];
                exchange.strip(image, [x, y], pass.strip).for_each(bf16::prefetch);
            }
        }
    }

    /// Computes a strip of what is not an export to `out`.
    fn step(
        &self,
        step: &Step,
        [x, y]: [usize; 2],
        tile_config: Option<&TileConfig>,
        sources: Sources<'_>,
        out: &mut [Block],
    ) {
        let Step { kind, inputs, out: layout, .. } = step;
        match kind {
            Kind::Import(imports) => {
                for (layer, exchange) in imports {
                    let (_, image) = self.images[self.image_of[*layer]];
                    exchange.import_row(self.level, image, [x, y], layout, out);
                }
            }
            Kind::Convolution(convolution) => {
                convolution.run_row(self.level, sources, layout, y as isize, out);
            }
            Kind::Bf16(convolution) => convolution.run_row(self.level, tile_config, sources, layout, y, out),
            Kind::Thin(convolution) => convolution.run_row(self.level, sources, layout, y, out),
            Kind::Learned(learned) => {
                learned.run_row(self.level, self.border, sources, &inputs[0], layout, y, out);
            }
            Kind::Row(op) => ops::run_row(self.level, op, self.border, sources, inputs, layout, y, out),
            Kind::WarpImage { image } => {
                let (_, image) = self.images[self.image_of[*image]];
                let size = [self.group.width, self.group.height];
                ops::warp_image_row(self.level, image, size, sources, &inputs[0], layout, y, out);
            }
            // What the caller writes.
            Kind::Export { .. } => {}
        }
    }
}

/// Copies a strip that begins at pixel `x` to its place in a row of `whole`.
fn store(strip: &[Block], width: usize, row: &mut [Block], whole: &Layout, x: usize) {
    match whole.numbers {
        Numbers::F32 => {
            for (from, to) in strip.chunks_exact(width).zip(row.chunks_exact_mut(whole.stride())) {
                to[whole.halo + x..][..width].copy_from_slice(from);
            }
        }
        Numbers::Bf16 => bf16::store(strip, width, row, whole, x),
    }
}

/// Fills the pixels beside a row of a whole tensor.
fn fill_halo(border: Border, whole: &Layout, row: &mut [Block]) {
    match whole.numbers {
        Numbers::F32 => conv::fill_halo(border, whole, row),
        Numbers::Bf16 => bf16::fill_halo(border, whole, row),
    }
}
