//! Convolutions: their kernels and the order of their weights.

use gs3_compute::{GpuError, constants, grid};

use super::Precision;
use super::source::{self, BLOCK, blocks};
use crate::graph::{Border, Conv2d, Shape};

/// Pixels of a tile along a side.
pub const TILE: usize = 16;

/// Pixels of an invocation.
const PIXELS: usize = 4;

/// The most blocks of output channels of an invocation: 4 pixels × 4 blocks are 64 sums in registers.
const MAX_BLOCKS: usize = 4;

/// Invocations of a workgroup that share output channels.
const PIXEL_THREADS: usize = TILE * TILE / PIXELS;

/// Workgroup memory that every device has, bytes.
pub const WORKGROUP_BYTES: usize = 16 << 10;

/// How a convolution is divided among workgroups and invocations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Division {
    kind: Kind,
    /// Blocks of output channels of an invocation.
    blocks: usize,
    /// Invocations of a workgroup that share pixels.
    groups: usize,
    /// Workgroups that share pixels.
    chunks: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Tiled,
    Direct,
}

/// A convolution as a kernel.
#[derive(Clone, Debug)]
pub struct Convolution {
    conv: Conv2d,
    /// Parts of a concatenation.
    inputs: Vec<Shape>,
    out: Shape,
    division: Division,
}

impl Convolution {
    /// `is_computed`: some of what it reads is not stored, so that looking at it costs more.
    pub fn new(conv: Conv2d, inputs: &[Shape], out: Shape, is_computed: bool, precision: Precision) -> Self {
        let total = blocks(out);
        // The least idle work, then the most blocks of an invocation.
        let waste = |b: &usize| (total.next_multiple_of(*b), MAX_BLOCKS - b);
        let per_thread = (1..=MAX_BLOCKS).min_by_key(waste).unwrap_or(1);
        let all_groups = total.div_ceil(per_thread);
        let side = TILE + 2 * conv.reach();
        let bytes = |groups: usize| {
            let matrices = conv.kernel * conv.kernel * groups * per_thread * BLOCK;
            (side * side + matrices) * BLOCK * precision.bytes() as usize
        };
        let fitting = (1..=all_groups.min(4)).rev().find(|groups| bytes(*groups) <= WORKGROUP_BYTES);
        let division = match fitting.filter(|_| conv.kernel > 1 || is_computed) {
            Some(groups) => {
                // As few workgroups as that needs, then as few idle invocations.
                let chunks = all_groups.div_ceil(groups);
                let groups = all_groups.div_ceil(chunks);
                Division { kind: Kind::Tiled, blocks: per_thread, groups, chunks }
            }
            None => Division { kind: Kind::Direct, blocks: per_thread, groups: 1, chunks: all_groups },
        };
        Self { conv, inputs: inputs.to_vec(), out, division }
    }

    /// Blocks of output channels of a workgroup.
    fn group_blocks(&self) -> usize {
        self.division.groups * self.division.blocks
    }

    /// Matrices of four output rows and four input columns, columns one after the other, `[chunk][input
    /// block][tap][output block of the chunk]`, then one for each output block with its biases as first column.
    /// `weight` is `[outputs, inputs, kernel, kernel]`.
    pub fn weights(&self, weight: &[f32], bias: &[f32]) -> Vec<f32> {
        let taps = self.conv.kernel * self.conv.kernel;
        let channels: usize = self.inputs.iter().map(|shape| shape.channels).sum();
        // The first channel of each input block, and how many it has.
        let mut in_blocks = Vec::new();
        let mut first = 0;
        for shape in &self.inputs {
            for block in 0..blocks(*shape) {
                in_blocks.push((first + block * BLOCK, BLOCK.min(shape.channels - block * BLOCK)));
            }
            first += shape.channels;
        }
        let (group, mut matrices) = (self.group_blocks(), Vec::new());
        for chunk in 0..self.division.chunks {
            for (first, count) in &in_blocks {
                for tap in 0..taps {
                    for block in 0..group {
                        let mut matrix = [[0.0; BLOCK]; BLOCK];
                        for (i, column) in matrix.iter_mut().enumerate().take(*count) {
                            for (o, value) in column.iter_mut().enumerate() {
                                let o = (chunk * group + block) * BLOCK + o;
                                let at = (o * channels + first + i) * taps + tap;
                                *value = if o < self.out.channels { weight[at] } else { 0.0 };
                            }
                        }
                        matrices.push(matrix);
                    }
                }
            }
        }
        for block in 0..self.division.chunks * group {
            let mut matrix = [[0.0; BLOCK]; BLOCK];
            for (o, value) in matrix[0].iter_mut().enumerate() {
                *value = bias.get(block * BLOCK + o).copied().unwrap_or(0.0);
            }
            matrices.push(matrix);
        }
        matrices.into_flattened().into_flattened()
    }

    /// Workgroups.
    pub fn groups(&self) -> Result<[u32; 3], GpuError> {
        let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        let chunks = count(self.division.chunks);
        match self.division.kind {
            // At most 2¹⁵ / 16 along a side.
            Kind::Tiled => {
                Ok([count(self.out.width.div_ceil(TILE)), count(self.out.height.div_ceil(TILE)), chunks])
            }
            Kind::Direct => {
                let [x, y, _] = grid(count(self.out.pixels().div_ceil(PIXELS * PIXEL_THREADS)))?;
                Ok([x, y, chunks])
            }
        }
    }

    /// The kernel. `expressions` have `load` and `finish` ([`super::expression`]).
    pub fn source(&self, precision: Precision, border: Border, expressions: &str) -> String {
        let Self { conv, inputs, out, division } = self;
        let in_blocks: usize = inputs.iter().map(|shape| blocks(*shape)).sum();
        let taps = conv.kernel * conv.kernel;
        let mut text = source::header(precision) + &source::result(*out);
        text += &constants(&[
            ("TILE", TILE),
            ("KERNEL", conv.kernel),
            ("TAPS", taps),
            ("DILATION", conv.dilation),
            ("REACH", conv.reach()),
            ("IN_BLOCKS", in_blocks),
            ("THREAD_BLOCKS", division.blocks),
            ("GROUP_BLOCKS", self.group_blocks()),
            ("THREADS", PIXEL_THREADS * division.groups),
            ("FIRST_BIAS", division.chunks * in_blocks * taps * self.group_blocks()),
        ]);
        text += &format!(
            "@group(0) @binding({}) var<storage> weights: array<Matrix>;\n",
            source::PARTS.len() + 2
        );
        text += expressions;
        text += &seen(border);
        let template = match division.kind {
            Kind::Tiled => include_str!("conv_tiled.wgsl"),
            Kind::Direct => include_str!("conv_direct.wgsl"),
        };
        let partial = match precision {
            Precision::Single => "sum",
            Precision::Half => "partial",
        };
        let sums = |line: &dyn Fn(usize, usize) -> String| -> String {
            (0..PIXELS).flat_map(|p| (0..division.blocks).map(move |b| line(p, b))).collect()
        };
        let declare = |name: &str, ty: &str| sums(&|p, b| format!("var {name}{p}_{b} = {ty}(0.0);\n"));
        let (partial_sums, add_partial_sums) = match precision {
            Precision::Single => (String::new(), String::new()),
            Precision::Half => (
                declare("partial", "Block"),
                sums(&|p, b| format!("sum{p}_{b} += vec4<f32>(partial{p}_{b});\n")),
            ),
        };
        let (places, products, store) = match division.kind {
            Kind::Tiled => (String::new(), self.tiled_products(partial), self.tiled_store()),
            Kind::Direct => (places(), self.direct_products(partial), self.direct_store()),
        };
        // Longer names first: some contain others.
        let template = template
            .replace("ADD_PARTIAL_SUMS", &add_partial_sums)
            .replace("PARTIAL_SUMS", &partial_sums)
            .replace("    SUMS\n", &declare("sum", "vec4<f32>"))
            .replace("PLACES", &places)
            .replace("PRODUCTS", &products)
            .replace("STORE", &store);
        text + &template
    }

    /// Each pixel of the column that the window reaches is read once, and meets the weights of all its taps.
    fn tiled_products(&self, sum: &str) -> String {
        let Self { conv, division, .. } = self;
        let rows = (PIXELS - 1) + (conv.kernel - 1) * conv.dilation + 1;
        let used = |row: usize| (0..conv.kernel).any(|dy| (0..PIXELS).any(|p| p + dy * conv.dilation == row));
        let mut text: String = (0..rows)
            .filter(|row| used(*row))
            .map(|row| format!("let pixel{row} = pixels[at + {row}u * SIDE];\n"))
            .collect();
        for dy in 0..conv.kernel {
            for b in 0..division.blocks {
                text += &format!(
                    "let matrix{dy}_{b} = matrices[matrix_at + {}u * GROUP_BLOCKS + {b}u];\n",
                    dy * conv.kernel
                );
                for p in 0..PIXELS {
                    let row = p + dy * conv.dilation;
                    text += &format!("{sum}{p}_{b} += matrix{dy}_{b} * pixel{row};\n");
                }
            }
        }
        text
    }

    fn direct_products(&self, sum: &str) -> String {
        let mut text: String =
            (0..PIXELS).map(|p| format!("let pixel{p} = seen(block, place{p} + step);\n")).collect();
        for b in 0..self.division.blocks {
            text += &format!("let matrix{b} = weights[matrix_at + {b}u];\n");
            text +=
                &(0..PIXELS).map(|p| format!("{sum}{p}_{b} += matrix{b} * pixel{p};\n")).collect::<String>();
        }
        text
    }

    fn tiled_store(&self) -> String {
        let mut text = String::new();
        for b in 0..self.division.blocks {
            text += &format!("let block{b} = tile.z * GROUP_BLOCKS + first_block + {b}u;\n");
            text += &format!(
                "if block{b} < BLOCKS {{\nlet bias = vec4<f32>(weights[FIRST_BIAS + block{b}][0]);\n"
            );
            for p in 0..PIXELS {
                text += &format!(
                    "if first_y + {p}u < HEIGHT {{ result[block{b} * PIXELS + (first_y + {p}u) * WIDTH + x] = \
                     Block(finish(block{b}, x, first_y + {p}u, sum{p}_{b} + bias)); }}\n"
                );
            }
            text += "}\n";
        }
        text
    }

    fn direct_store(&self) -> String {
        let mut text = String::new();
        for b in 0..self.division.blocks {
            text += &format!("let block{b} = group.z * GROUP_BLOCKS + {b}u;\n");
            text += &format!(
                "if block{b} < BLOCKS {{\nlet bias = vec4<f32>(weights[FIRST_BIAS + block{b}][0]);\n"
            );
            for p in 0..PIXELS {
                text += &format!(
                    "if first_pixel + {p}u * THREADS < PIXELS {{ \
                     result[block{b} * PIXELS + first_pixel + {p}u * THREADS] = \
                     Block(finish(block{b}, u32(place{p}.x), u32(place{p}.y), sum{p}_{b} + bias)); }}\n"
                );
            }
            text += "}\n";
        }
        text
    }
}

/// Where the pixels of an invocation are; beyond the last one it repeats.
fn places() -> String {
    let place = |p: usize| {
        format!(
            "let at{p} = min(first_pixel + {p}u * THREADS, PIXELS - 1u);
    let place{p} = vec2<i32>(vec2<u32>(at{p} % WIDTH, at{p} / WIDTH));\n"
        )
    };
    (0..PIXELS).map(place).collect()
}

/// `fn seen(block, at)`: what a window sees there, possibly outside the image.
pub fn seen(border: Border) -> String {
    let value = match border {
        Border::Replicate => "return value;",
        Border::Zero => "return select(Block(0.0), value, all(inside == at));",
    };
    format!(
        "fn seen(block: u32, at: vec2<i32>) -> Block {{
    let inside = clamp(at, vec2<i32>(0), vec2<i32>(i32(WIDTH), i32(HEIGHT)) - 1);
    let value = load(block, u32(inside.x), u32(inside.y));
    {value}
}}\n"
    )
}
