//! Stable radix sort of pairs of u32.

mod plan;

pub use plan::{MAX_PAIRS, SortPlan};

use crate::buffer::{Buffer, Slice, Use};
use crate::capabilities::Subgroups;
use crate::error::GpuError;
use crate::gpu::Gpu;
use crate::grid::grid_source;
use crate::kernel::{Bound, Kernel, Module};
use crate::recorder::Recorder;

/// Sorts keys with their values by the lowest bits of the keys. Equal keys keep their order.
#[derive(Clone, Debug)]
pub struct Sort {
    plan: SortPlan,
    kernels: Kernels,
    dispatches: Buffer,
    control: Buffer,
    status: Buffer,
}

#[derive(Clone, Debug)]
struct Kernels {
    prepare: Kernel,
    histogram: Kernel,
    /// One for each pass.
    sweeps: Vec<Kernel>,
}

/// Keys with their values. Their length is at least the sort's capacity.
#[derive(Clone, Copy, Debug)]
pub struct Pairs<'a> {
    /// What is compared.
    pub keys: Slice<'a>,
    /// What goes with them.
    pub values: Slice<'a>,
}

/// A sort with its buffers.
#[derive(Clone, Debug)]
pub struct BoundSort {
    prepare: Bound,
    histogram: Bound,
    sweeps: Vec<Bound>,
    dispatches: Buffer,
}

/// Where counts of the dispatches of the histogram kernel are, bytes.
const HISTOGRAM_DISPATCH: u64 = 3 * 4;

/// The WGSL for `plan`.
pub(crate) fn source(plan: &SortPlan) -> Vec<String> {
    let (prefix, rank) = match plan.subgroups {
        Subgroups::Present { .. } => {
            (include_str!("../prefix_subgroups.wgsl"), include_str!("rank_subgroups.wgsl"))
        }
        Subgroups::Absent => (include_str!("../prefix_shared.wgsl"), include_str!("rank_shared.wgsl")),
    };
    let parts: [&str; 5] = [&plan.constants(), &grid_source(), prefix, include_str!("sort.wgsl"), rank];
    parts.map(str::to_owned).into()
}

impl Sort {
    /// A sort of up to `capacity` pairs by the lowest `key_bits` bits of their keys.
    ///
    /// # Errors
    /// [`GpuError`] if it does not fit the device.
    pub fn new(gpu: &Gpu, capacity: u32, key_bits: u32) -> Result<Self, GpuError> {
        Self::of_plan(gpu, Self::plan_for(gpu, capacity, key_bits)?, &[])
    }

    /// The same for another number of pairs, with these kernels where as many bits count: nothing is compiled then.
    ///
    /// # Errors
    /// As [`Sort::new`].
    pub fn resized(&self, gpu: &Gpu, capacity: u32, key_bits: u32) -> Result<Self, GpuError> {
        let plan = Self::plan_for(gpu, capacity, key_bits)?;
        match plan.constants() == self.plan.constants() {
            true => Self::with_kernels(gpu, plan, self.kernels.clone()),
            false => Self::of_plan(gpu, plan, &[]),
        }
    }

    /// The same without patience: every tile that is not done at the first look is counted again. For tests.
    ///
    /// # Errors
    /// As [`Sort::new`].
    #[doc(hidden)]
    pub fn impatient(gpu: &Gpu, capacity: u32, key_bits: u32) -> Result<Self, GpuError> {
        Self::of_plan(gpu, Self::plan_for(gpu, capacity, key_bits)?, &[("POLLS", 0.0)])
    }

    fn plan_for(gpu: &Gpu, capacity: u32, key_bits: u32) -> Result<SortPlan, GpuError> {
        let capabilities = gpu.capabilities();
        SortPlan::new(&capabilities.limits, capabilities.subgroups, capacity, key_bits)
    }

    fn of_plan(gpu: &Gpu, plan: SortPlan, polls: &[(&str, f64)]) -> Result<Self, GpuError> {
        let source = source(&plan);
        let module: Module = gpu.module("sort", &source.iter().map(String::as_str).collect::<Vec<_>>())?;
        let sweeps = (0..plan.passes).map(|pass| {
            let constants = [&[("PASS", f64::from(pass))], polls].concat();
            module.kernel(gpu, "sweep", &constants)
        });
        let kernels = Kernels {
            prepare: module.kernel(gpu, "prepare", &[])?,
            histogram: module.kernel(gpu, "histogram", &[])?,
            sweeps: sweeps.collect::<Result<_, _>>()?,
        };
        Self::with_kernels(gpu, plan, kernels)
    }

    fn with_kernels(gpu: &Gpu, plan: SortPlan, kernels: Kernels) -> Result<Self, GpuError> {
        Ok(Self {
            plan,
            kernels,
            dispatches: gpu.buffer("sort dispatches", Use::Indirect, plan.dispatch_bytes)?,
            control: gpu.buffer("sort control", Use::Storage, plan.control_bytes)?,
            status: gpu.buffer("sort status", Use::Storage, plan.status_bytes)?,
        })
    }

    /// Its sizes.
    #[must_use]
    pub fn plan(&self) -> &SortPlan {
        &self.plan
    }

    /// Will sort the first pairs of `pairs[0]`, as many as the first u32 of `count` says, at most the capacity.
    /// The result is in `pairs[plan.result()]`; the other one is overwritten.
    ///
    /// # Errors
    /// [`GpuError`] if the device refuses.
    pub fn bind(&self, gpu: &Gpu, count: Slice<'_>, pairs: [Pairs<'_>; 2]) -> Result<BoundSort, GpuError> {
        // The lengths of the bound buffers tell the kernels the capacity.
        let room = u64::from(self.plan.capacity) * 4;
        let buffers = |pass: usize| {
            let (from, to) = (pairs[pass % 2], pairs[(pass + 1) % 2]);
            [
                ("count", count),
                ("keys_in", from.keys.first(room)),
                ("values_in", from.values.first(room)),
                ("keys_out", to.keys.first(room)),
                ("values_out", to.values.first(room)),
                ("dispatches", self.dispatches.slice()),
                ("control", self.control.slice()),
                ("status", self.status.slice()),
            ]
        };
        let Kernels { prepare, histogram, sweeps } = &self.kernels;
        let sweeps = sweeps.iter().enumerate().map(|(pass, kernel)| kernel.bind(gpu, &buffers(pass)));
        Ok(BoundSort {
            prepare: prepare.bind(gpu, &buffers(0))?,
            histogram: histogram.bind(gpu, &buffers(0))?,
            sweeps: sweeps.collect::<Result<_, _>>()?,
            dispatches: self.dispatches.clone(),
        })
    }
}

impl BoundSort {
    /// Records the sort: two dispatches and one for each pass, as large as the count needs.
    pub fn record(&self, recorder: &mut Recorder<'_>) {
        recorder.dispatch(&self.prepare, [1, 1, 1]);
        recorder.dispatch_indirect(&self.histogram, &self.dispatches, HISTOGRAM_DISPATCH);
        for sweep in &self.sweeps {
            recorder.dispatch_indirect(sweep, &self.dispatches, 0);
        }
    }
}
