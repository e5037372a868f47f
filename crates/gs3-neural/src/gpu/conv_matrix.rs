//! Convolutions as products of matrices in hardware (cooperative matrices, "tensor cores").
//!
//! Matrices of 8×8 were run on lavapipe. Matrices of 16×16 have not been run, and nothing is tuned: no such hardware
//! was at hand. So they are used only on request. A run of pixels is loaded once for all columns, and a matrix of
//! weights once for [`RUNS`].

use gs3_compute::{Capabilities, Gpu, Subgroups, Use, constants};

use super::conv::{TILE, WORKGROUP_BYTES, seen};
use super::source::{self, BLOCK, blocks};
use super::{GpuEngine, GpuEngineSettings, GpuRunError, GpuTensorImage, Precision};
use crate::graph::{Border, Conv2d, Graph, GraphBuilder, Shape};
use crate::random::Random;
use crate::weights::{Header, Weights};

/// Runs of pixels of a subgroup.
const RUNS: usize = 4;

/// The most matrices of output channels of a subgroup: 4 runs × 3 of 16×16 are 96 sums a lane of 32.
const MAX_COLUMNS: usize = 3;

/// What multiplies matrices: subgroups, factors of f16, sums of f32.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct MatrixUnit {
    /// Rows and columns of all three matrices: 8 or 16.
    pub(crate) side: u32,
    /// Invocations of a subgroup.
    pub(crate) subgroup: u32,
}

impl MatrixUnit {
    /// The unit to use on a device, if the device was opened with [`gs3_compute::OptionalFeatures::Experimental`].
    /// Its subgroups must have one size, as on NVIDIA: work is divided among subgroups before their size is known.
    #[must_use]
    pub fn of(capabilities: &Capabilities) -> Option<Self> {
        let Subgroups::Present { min, max } = capabilities.subgroups else { return None };
        let has = |side: u32| capabilities.cooperative_matrix.contains(&[side; 3]);
        let side = [16, 8].into_iter().find(|side| has(*side))?;
        let unit = Self { side, subgroup: min };
        let fits = unit.threads() as u32 <= capabilities.limits.workgroup_invocations;
        (min == max && capabilities.shader_f16 && fits).then_some(unit)
    }

    /// Subgroups that share a tile.
    fn subgroups(self) -> usize {
        TILE * TILE / self.side as usize / RUNS
    }

    /// Invocations of a workgroup.
    fn threads(self) -> usize {
        self.subgroups() * self.subgroup as usize
    }
}

/// A convolution as a kernel.
#[derive(Clone, Debug)]
pub struct MatrixConvolution {
    conv: Conv2d,
    /// Parts of a concatenation.
    inputs: Vec<Shape>,
    out: Shape,
    unit: MatrixUnit,
    /// Matrices of output channels of a workgroup.
    columns: usize,
    /// Workgroups that share pixels.
    chunks: usize,
}

impl MatrixConvolution {
    /// None where its results would be mostly padding or its tile is too large.
    pub fn new(conv: Conv2d, inputs: &[Shape], out: Shape, unit: MatrixUnit) -> Option<Self> {
        let side = unit.side as usize;
        let total = out.channels.div_ceil(side);
        // The least idle work, then the most matrices of a subgroup.
        let waste = |columns: &usize| (total.next_multiple_of(*columns), MAX_COLUMNS - columns);
        let columns = (1..=MAX_COLUMNS).min_by_key(waste).unwrap_or(1);
        let edge = TILE + 2 * conv.reach();
        let bytes = edge * edge * side * 2 + unit.subgroups() * side * side * 4;
        let is_full = 2 * out.channels > side;
        let chunks = total.div_ceil(columns);
        let convolution = Self { conv, inputs: inputs.to_vec(), out, unit, columns, chunks };
        (is_full && bytes <= WORKGROUP_BYTES).then_some(convolution)
    }

    fn in_blocks(&self) -> usize {
        self.inputs.iter().map(|shape| blocks(*shape)).sum()
    }

    /// Matrices of input channels.
    fn in_matrices(&self) -> usize {
        (self.in_blocks() * BLOCK).div_ceil(self.unit.side as usize)
    }

    /// Matrices of weights, `[chunk][input matrix][tap][column][input channel][output channel]`, then all biases.
    /// `weight` is `[outputs, inputs, kernel, kernel]`.
    pub fn weights(&self, weight: &[f32], bias: &[f32]) -> Vec<f32> {
        let (side, taps) = (self.unit.side as usize, self.conv.kernel * self.conv.kernel);
        let channels: usize = self.inputs.iter().map(|shape| shape.channels).sum();
        // Which channel each of the blocks' is, if any: parts end with blocks that are not full.
        let mut channel_of = vec![None; self.in_matrices() * side];
        let (mut at, mut first) = (0, 0);
        for shape in &self.inputs {
            (0..shape.channels).for_each(|k| channel_of[at + k] = Some(first + k));
            (at, first) = (at + blocks(*shape) * BLOCK, first + shape.channels);
        }
        let mut weights = Vec::new();
        for chunk in 0..self.chunks {
            for inputs in channel_of.chunks(side) {
                for tap in 0..taps {
                    for column in 0..self.columns {
                        let first = (chunk * self.columns + column) * side;
                        for channel in inputs {
                            weights.extend((first..first + side).map(|o| match channel {
                                Some(i) if o < self.out.channels => weight[(o * channels + i) * taps + tap],
                                _ => 0.0,
                            }));
                        }
                    }
                }
            }
        }
        let outputs = self.chunks * self.columns * side;
        weights.extend((0..outputs).map(|o| bias.get(o).copied().unwrap_or(0.0)));
        weights
    }

    /// Workgroups.
    pub fn groups(&self) -> [u32; 3] {
        // At most 2¹⁵ / 16 along a side.
        let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        [self.out.width.div_ceil(TILE), self.out.height.div_ceil(TILE), self.chunks].map(count)
    }

    /// The kernel. `expressions` have `load` and `finish` ([`super::expression`]).
    pub fn source(&self, border: Border, expressions: &str) -> String {
        let Self { conv, out, unit, columns, .. } = self;
        let (side, taps) = (unit.side as usize, conv.kernel * conv.kernel);
        let mut text = "enable wgpu_cooperative_matrix;\n".to_owned();
        text += &source::header(Precision::Half);
        text += &source::result(*out);
        text += &constants(&[
            ("TILE", TILE),
            ("SIDE", side),
            ("KERNEL", conv.kernel),
            ("TAPS", taps),
            ("DILATION", conv.dilation),
            ("REACH", conv.reach()),
            ("IN_BLOCKS", self.in_blocks()),
            ("IN_MATRICES", self.in_matrices()),
            ("RUNS", RUNS),
            ("COLUMNS", *columns),
            ("SUBGROUP", unit.subgroup as usize),
            ("SUBGROUPS", unit.subgroups()),
            ("THREADS", unit.threads()),
            ("FIRST_BIAS", self.chunks * self.in_matrices() * taps * columns * side * side),
        ]);
        text +=
            &format!("@group(0) @binding({}) var<storage> weights: array<f16>;\n", source::PARTS.len() + 2);
        text += expressions;
        text += &seen(border);
        let matrix = |numbers: &str, role: char| format!("coop_mat{side}x{side}<{numbers}, {role}>");
        let sums: Vec<(usize, usize)> = (0..RUNS).flat_map(|r| (0..*columns).map(move |c| (r, c))).collect();
        let declared = |(r, c): &(usize, usize)| format!("var sum{r}_{c} = {}();\n", matrix("f32", 'C'));
        let mut products = String::new();
        for c in 0..*columns {
            products += &format!(
                "let weights{c} = coopLoadT<{}>(&weights[matrix_at + {c}u * MATRIX], SIDE);\n",
                matrix("f16", 'B')
            );
        }
        for r in 0..RUNS {
            products += &format!(
                "let at{r} = run_at(first_run + {r}u) + step;
let pixels{r} = coopLoadT<{}>(&pixels[(at{r}.y * EDGE + at{r}.x) * SIDE], SIDE);\n",
                matrix("f16", 'A')
            );
            for c in 0..*columns {
                products += &format!("sum{r}_{c} = coopMultiplyAdd(pixels{r}, weights{c}, sum{r}_{c});\n");
            }
        }
        let stored = |(r, c): &(usize, usize)| {
            format!(
                "workgroupBarrier();
coopStoreT(sum{r}_{c}, &sums[subgroup * MATRIX], SIDE);
workgroupBarrier();
store(subgroup, lane, tile.xy, first_run + {r}u, (tile.z * COLUMNS + {c}u) * QUADS);\n"
            )
        };
        let template = include_str!("conv_matrix.wgsl")
            .replace("    SUMS\n", &sums.iter().map(declared).collect::<String>())
            .replace("            PRODUCTS\n", &products)
            .replace("    STORE\n", &sums.iter().map(stored).collect::<String>());
        text + &template
    }
}

/// LR pixels of the trial: enough workgroups to fill a device, the last ones not full.
const TRIAL: [usize; 2] = [257, 259];

/// Inputs of the trial, by their channels: as many as a kernel has parts, few of them whole matrices.
const TRIAL_PARTS: [(&str, usize); source::PARTS.len()] =
    [("a", 17), ("b", 3), ("c", 8), ("d", 4), ("e", 1), ("f", 16)];

/// Its convolutions, of the forms that networks have, each a kernel of its own: what it reads, and output channels that
/// make with matrices of either side several chunks of several columns and one chunk of few, the last column not full.
const TRIAL_CONVOLUTIONS: [(&str, Conv2d, &[usize]); 3] = [
    ("wide", Conv2d::new(3, 92), &[0, 1]),
    ("pixelwise", Conv2d::new(1, 28), &[0, 1, 2, 3, 4, 5]),
    ("narrow", Conv2d::new(3, 12), &[5]),
];

/// How often: what depends on the order of workgroups need not show at once.
const TRIALS: usize = 4;

/// How far results of the trial, numbers about 1 of f16, may be apart: a few of their last places. Without one of the
/// 180 products that make one they would be by 0.03 in the mean.
const TOLERANCE: f32 = 1e-2;

impl MatrixUnit {
    /// Whether it gives on `gpu` what invocations give by themselves, of convolutions of parts, with padding: the
    /// feature is young in drivers and in wgpu, and a wrong picture is worse than a slow one.
    ///
    /// # Errors
    /// [`GpuRunError::Matrices`] if it does not; what the device refuses.
    pub fn check(self, gpu: &Gpu) -> Result<(), GpuRunError> {
        let expected = trial_output(gpu, None)?;
        for _ in 0..TRIALS {
            let output = trial_output(gpu, Some(self))?;
            // NaN is the largest in this order.
            let apart = expected.iter().zip(&output).map(|(e, a)| (e - a).abs());
            let most = apart.max_by(f32::total_cmp).unwrap_or(0.0);
            if most.is_nan() || most > TOLERANCE {
                return Err(GpuRunError::Matrices { max: TOLERANCE, actual: most });
            }
        }
        Ok(())
    }
}

/// The trial's network.
fn trial() -> Result<(Graph, Weights), GpuRunError> {
    let mut g = GraphBuilder::new("trial", 1, Border::Replicate);
    let parts = TRIAL_PARTS.map(|(name, channels)| g.input(name, channels, 1));
    for (name, conv, reads) in TRIAL_CONVOLUTIONS {
        let reads: Vec<_> = reads.iter().map(|k| parts[*k]).collect();
        let result = g.conv(name, conv, &reads);
        g.output(name, result);
    }
    let graph = g.finish()?;
    let mut weights = Weights::random(&graph, Header::of(&graph, 1), 1);
    for (name, conv, _) in TRIAL_CONVOLUTIONS {
        if let Some(bias) = weights.arrays.get_mut(&format!("{name}.bias")) {
            let values = bias.values_mut().iter_mut().enumerate();
            values.for_each(|(k, v)| *v = k as f32 / conv.outputs as f32);
        }
    }
    Ok((graph, weights))
}

/// What `gpu` makes of the trial: all its convolutions.
fn trial_output(gpu: &Gpu, matrices: Option<MatrixUnit>) -> Result<Vec<f32>, GpuRunError> {
    let (graph, weights) = trial()?;
    let settings = GpuEngineSettings { matrices, ..GpuEngineSettings::new(Precision::Half) };
    let engine = GpuEngine::new(gpu, &graph, &weights, TRIAL, &settings)?;
    let mut random = Random::new(1);
    let mut from = Vec::new();
    for (name, channels) in TRIAL_PARTS {
        let values: Vec<f32> = (0..TRIAL[0] * TRIAL[1] * channels).map(|_| random.signed()).collect();
        from.push((name, gpu.buffer_with("trial", Use::Storage, &values)?));
    }
    let made =
        |image: &GpuTensorImage| Ok((image.name.clone(), gpu.buffer("trial", Use::Storage, image.bytes)?));
    let to = engine.outputs().iter().map(made).collect::<Result<Vec<_>, GpuRunError>>()?;
    let inputs: Vec<_> = from.iter().map(|(name, buffer)| (*name, buffer.slice())).collect();
    let outputs: Vec<_> = to.iter().map(|(name, buffer)| (name.as_str(), buffer.slice())).collect();
    let bound = engine.bind(gpu, &inputs, &outputs)?;
    let mut recorder = gpu.recorder(None);
    bound.record(&mut recorder);
    recorder.submit()?;
    let mut all = Vec::new();
    for ((_, buffer), image) in to.iter().zip(engine.outputs()) {
        all.extend(gpu.read::<f32>(&buffer.part(0, image.bytes))?);
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use gs3_compute::{GpuSettings, OptionalFeatures, device_for_tests};

    use super::super::plan::Plan;
    use super::*;

    /// Planned for subgroups half as large as they are, a workgroup has half of those that it needs.
    #[test]
    fn a_unit_that_errs_is_found_out() {
        let settings = GpuSettings { features: OptionalFeatures::Experimental, ..GpuSettings::default() };
        let Some(gpu) = device_for_tests(&settings) else { return };
        let Some(unit) = MatrixUnit::of(gpu.capabilities()) else {
            return eprintln!("skipped: no products of matrices");
        };
        unit.check(&gpu).unwrap();
        let wrong = MatrixUnit { subgroup: unit.subgroup / 2, ..unit };
        assert!(matches!(wrong.check(&gpu), Err(GpuRunError::Matrices { .. })));
    }

    /// On no device: the trial is of kernels of matrices only, and they are valid.
    #[test]
    fn the_trial_tries_matrices_of_every_form() {
        let (graph, weights) = trial().unwrap();
        for unit in [MatrixUnit { side: 8, subgroup: 8 }, MatrixUnit { side: 16, subgroup: 32 }] {
            let settings =
                GpuEngineSettings { matrices: Some(unit), ..GpuEngineSettings::new(Precision::Half) };
            let plan = Plan::new(&graph, &weights, TRIAL, &settings).unwrap();
            let of_matrices = plan.steps.iter().filter(|step| step.source.contains("coopMultiplyAdd"));
            let columns = of_matrices.map(|step| {
                gs3_compute::validate(&step.label, &[&step.source]).unwrap();
                step.source.matches("let weights").count()
            });
            let columns: Vec<usize> = columns.collect();
            assert_eq!(columns.len(), TRIAL_CONVOLUTIONS.len(), "{unit:?}");
            assert!(columns.windows(2).any(|pair| pair[0] != pair[1]), "{columns:?}");
        }
    }

    #[test]
    fn units_need_subgroups_of_one_size_and_half_precision() {
        let limits = gs3_compute::Limits {
            buffer_bytes: 1 << 30,
            binding_bytes: 1 << 30,
            ..gs3_compute::Limits::LEAST
        };
        let card = Capabilities {
            subgroups: Subgroups::Present { min: 32, max: 32 },
            shader_f16: true,
            timestamps: true,
            cooperative_matrix: vec![[8; 3], [16; 3], [16, 8, 16]],
            limits,
        };
        assert_eq!(MatrixUnit::of(&card), Some(MatrixUnit { side: 16, subgroup: 32 }));
        let lacking = [
            Capabilities { subgroups: Subgroups::Present { min: 32, max: 64 }, ..card.clone() },
            Capabilities { subgroups: Subgroups::Absent, ..card.clone() },
            Capabilities { shader_f16: false, ..card.clone() },
            Capabilities { cooperative_matrix: vec![[16, 8, 16]], ..card.clone() },
            // Eight subgroups of 64 are more than a workgroup takes.
            Capabilities {
                subgroups: Subgroups::Present { min: 64, max: 64 },
                cooperative_matrix: vec![[8; 3]],
                ..card
            },
        ];
        assert!(lacking.iter().all(|capabilities| MatrixUnit::of(capabilities).is_none()));
    }
}
