//! Runs a pass: threads share its rows out, and compute each strip by strip.

use std::cell::RefCell;

use fearless_simd::Level;

use super::bf16::{self, TileConfig};
use super::block::{Block, Layout, Numbers, Rest, Sources};
use super::conv;
use super::ops;
use super::passes::EXPORTS;
use super::plan::{Kind, Pass, Step};
use crate::graph::Border;
use crate::images::Named;

/// Images that a pass writes, those of the rows that a thread computes; empty where one is not asked for.
pub type Exports<'a> = [&'a mut [f32]; EXPORTS];

thread_local! {
    /// Strips of the thread: grown once, kept for all networks.
    static SCRATCH: RefCell<Vec<Block>> = const { RefCell::new(Vec::new()) };
}

/// A pass with what it reads from outside.
#[derive(Clone, Copy, Debug)]
pub struct Job<'a> {
    pub pass: &'a Pass,
    pub level: Level,
    pub border: Border,
    pub images: &'a [Named<'a>],
    /// Which of `images` each layer of the graph is.
    pub image_of: &'a [usize],
    /// Blocks of scratch memory.
    pub scratch: usize,
    /// All of the arena but what the pass stores.
    pub arena: Rest<'a>,
}

impl Job<'_> {
    /// Computes `count` rows from `first` on, to `stored` and `exports`, which begin with that row.
    pub fn rows(&self, first: usize, count: usize, stored: &mut [Block], exports: Exports<'_>) {
        if count <= 1 {
            return SCRATCH.with_borrow_mut(|scratch| {
                if scratch.len() < self.scratch {
                    scratch.resize(self.scratch, Block::default());
                }
                self.row(first, scratch, stored, exports);
            });
        }
        let half = count / 2;
        let (above, below) = stored.split_at_mut(half * self.pass.row_len);
        let (mut above_exports, mut below_exports) = (Exports::default(), Exports::default());
        for (k, image) in exports.into_iter().enumerate() {
            let row_len = self.pass.exports.get(k).map_or(0, |(_, row_len)| *row_len);
            // Images that are not asked for are empty.
            let middle = (half * row_len).min(image.len());
            (above_exports[k], below_exports[k]) = image.split_at_mut(middle);
        }
        rayon::join(
            || self.rows(first, half, above, above_exports),
            || self.rows(first + half, count - half, below, below_exports),
        );
    }

    fn row(&self, y: usize, scratch: &mut [Block], stored: &mut [Block], mut exports: Exports<'_>) {
        let Pass { steps, width, strip, start, .. } = self.pass;
        let is_on_tiles = |step: &Step| matches!(&step.kind, Kind::Bf16(c) if c.is_on_tiles());
        let tile_config = steps.iter().any(is_on_tiles).then(TileConfig::new);
        for x in (0..*width).step_by(*strip) {
            // The last strip overlaps that before, whose pixels get the same values again.
            let x = x.min(width - strip);
            for step in steps {
                self.step(step, [x, y], tile_config.as_ref(), scratch, &mut exports);
                if let Some(whole) = &step.stored {
                    let row = &mut stored[whole.start - start..][..whole.row_len()];
                    store(&scratch[step.out.start..][..step.out.row_len()], *strip, row, whole, x);
                }
            }
        }
        for whole in steps.iter().filter_map(|step| step.stored.as_ref()) {
            fill_halo(self.border, whole, &mut stored[whole.start - start..][..whole.row_len()]);
        }
    }

    fn step(
        &self,
        step: &Step,
        [x, y]: [usize; 2],
        tile_config: Option<&TileConfig>,
        scratch: &mut [Block],
        exports: &mut Exports<'_>,
    ) {
        let Step { kind, inputs, out: layout, .. } = step;
        let len = if matches!(kind, Kind::Export { .. }) { 0 } else { layout.row_len() };
        let (out, strips) = Rest::split(scratch, layout.start, len);
        let sources = Sources::strip(self.arena, strips, x);
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
            Kind::Update(op) => ops::update_row(self.level, op, sources, inputs, layout, y, out),
            Kind::Row(op) => ops::run_row(self.level, op, self.border, sources, inputs, layout, y, out),
            Kind::WarpImage { image } => {
                let (_, image) = self.images[self.image_of[*image]];
                let size = [self.pass.width, self.pass.height];
                ops::warp_image_row(self.level, image, size, sources, &inputs[0], layout, y, out);
            }
            Kind::Export { export, exchange } => {
                let image = &mut exports[*export];
                if !image.is_empty() {
                    exchange.export_row(self.level, sources, inputs, y, self.pass.strip, image);
                }
            }
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
