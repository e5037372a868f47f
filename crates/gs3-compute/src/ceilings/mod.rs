//! What a device can do at most, measured: no stage is faster than its bytes and operations at these rates.

use std::time::{Duration, Instant};

use bytemuck::{Pod, Zeroable};

use crate::buffer::{Buffer, Use};
use crate::capabilities::Limits;
use crate::error::GpuError;
use crate::gpu::Gpu;
use crate::kernel::Bound;
use crate::recorder::Recorder;
use crate::timings::Timings;
use crate::wgsl::constants;

/// The measured ceilings of a device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ceilings {
    /// Bytes per second that a kernel moves which copies buffers, those read and those written added up.
    pub copy_bytes_per_s: f64,
    /// Operations per second in single precision, a fused multiply-add being two.
    pub f32_flop_per_s: f64,
    /// The same in half precision, by vectors; `None` where the device has none.
    pub f16_flop_per_s: Option<f64>,
}

/// Bytes copied at a time, where there is room: several times what the caches of any GPU hold, 50 to 126 MB, in both
/// buffers.
const COPIED: u64 = 256 << 20;

/// Where even that much has no room, there is no measuring.
const LEAST_COPIED: u64 = 4 << 20;

/// Invocations of the workgroups of both kernels.
const THREADS: u32 = 256;

/// Vectors of an invocation of `copy.wgsl`, which writes them out.
const COPY_ITEMS: u32 = 4;
const _: () = assert!(COPY_ITEMS == 4, "as many as copy.wgsl writes out");

/// Bytes of a workgroup of `copy.wgsl`: vectors of 16 bytes.
const COPY_GROUP: u64 = (THREADS * COPY_ITEMS) as u64 * 16;

/// Invocations of `multiply_add.wgsl`: four times as many as run at once on the largest GPUs (148 multiprocessors of
/// 2,048), so that the device is little idle when the first ones end.
const INVOCATIONS: u32 = 1 << 20;

/// Operations of a round of an invocation: 2 × 8 vectors of four, two operations each.
const ROUND_FLOP: f64 = 2.0 * 8.0 * 4.0 * 2.0;

/// Work that is measured takes so long at least: a hundred times what starting it takes.
const LEAST: Duration = Duration::from_millis(2);

/// How often work is doubled at most until it does. 2¹⁴ rounds take 2 ms at 10¹⁵ operations per second.
const DOUBLINGS: u32 = 14;

/// Number of runs; the best one counts, because others may not have had the whole device. Growing before has warmed
/// up the device.
const RUNS: usize = 8;

/// `Load` of `multiply_add.wgsl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct Load {
    factor: f32,
    summand: f32,
    rounds: u32,
    _pad: u32,
}

impl Load {
    /// Sums approach ½, exactly in half precision too.
    fn of(rounds: u32) -> Self {
        Self { factor: 0.5, summand: 0.25, rounds, _pad: 0 }
    }
}

impl Ceilings {
    /// Measures `gpu`: some tens of milliseconds, on a software adapter a second or two. It takes up to 512 MiB of the
    /// device's memory meanwhile.
    ///
    /// # Errors
    /// [`GpuError`] if the device fails, has no room, or has a clock that stands still.
    pub fn measure(gpu: &Gpu) -> Result<Self, GpuError> {
        let mut clock = Clock::new(gpu)?;
        let copy = Copy::new(gpu)?;
        let copies = rate(|count| {
            clock.time(|recorder| (0..count).for_each(|_| recorder.dispatch(&copy.kernel, copy.groups)))
        })?;
        let mut flop_per_s = |number| {
            let sums = MultiplyAdds::new(gpu, number)?;
            let rounds = rate(|rounds| {
                gpu.write(&sums.load.slice(), &[Load::of(rounds)])?;
                clock.time(|recorder| recorder.dispatch(&sums.kernel, MultiplyAdds::GROUPS))
            })?;
            Ok::<_, GpuError>(rounds * ROUND_FLOP * f64::from(INVOCATIONS))
        };
        Ok(Self {
            copy_bytes_per_s: copies * 2.0 * copy.bytes as f64,
            f32_flop_per_s: flop_per_s(Number::Single)?,
            f16_flop_per_s: match gpu.capabilities().shader_f16 {
                true => Some(flop_per_s(Number::Half)?),
                false => None,
            },
        })
    }
}

/// Units of work per second, where `time` says how long so many of them take.
fn rate(mut time: impl FnMut(u32) -> Result<Duration, GpuError>) -> Result<f64, GpuError> {
    let mut count = 1;
    while time(count)? < LEAST && count < 1 << DOUBLINGS {
        count *= 2;
    }
    let mut best = Duration::MAX;
    for _ in 0..RUNS {
        best = best.min(time(count)?);
    }
    if best.is_zero() {
        let message = format!("expected {count} units of work to take time, found none passed");
        return Err(GpuError::Refused { what: "measuring ceilings".to_owned(), message });
    }
    Ok(f64::from(count) / best.as_secs_f64())
}

/// The device's clock, or the CPU's if the device has none.
struct Clock<'a> {
    gpu: &'a Gpu,
    timings: Option<Timings>,
}

impl<'a> Clock<'a> {
    fn new(gpu: &'a Gpu) -> Result<Self, GpuError> {
        let timings = match gpu.capabilities().timestamps {
            true => Some(Timings::new(gpu)?),
            false => None,
        };
        Ok(Self { gpu, timings })
    }

    /// What the work takes that `record` records.
    fn time(&mut self, record: impl FnOnce(&mut Recorder<'_>)) -> Result<Duration, GpuError> {
        let mut recorder = self.gpu.recorder(self.timings.as_mut());
        record(&mut recorder);
        let started = Instant::now();
        let submission = recorder.submit()?;
        self.gpu.wait(&submission)?;
        let waited = started.elapsed();
        match &self.timings {
            Some(timings) => Ok(timings.read(self.gpu, &submission)?.iter().map(|time| time.time).sum()),
            None => Ok(waited),
        }
    }
}

/// A copy from one buffer to another.
struct Copy {
    kernel: Bound,
    groups: [u32; 3],
    bytes: u64,
    #[cfg(test)]
    buffers: [Buffer; 2],
}

/// Bytes copied on a device of such limits.
fn most_copied(limits: &Limits) -> u64 {
    let most = COPIED.min(limits.binding_bytes).min(limits.buffer_bytes);
    most - most % COPY_GROUP
}

impl Copy {
    /// Allocates as much as there is memory for: half as much, if memory is full.
    fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let mut bytes = most_copied(&gpu.capabilities().limits);
        loop {
            match Self::with_bytes(gpu, bytes) {
                Err(GpuError::OutOfMemory { .. }) if bytes / 2 >= LEAST_COPIED => {
                    bytes = bytes / 2 / COPY_GROUP * COPY_GROUP;
                }
                made => return made,
            }
        }
    }

    fn with_bytes(gpu: &Gpu, bytes: u64) -> Result<Self, GpuError> {
        let [source, copied] =
            [gpu.buffer("source", Use::Storage, bytes)?, gpu.buffer("copied", Use::Storage, bytes)?];
        let kernel = gpu.module("copy", &[&copy_source()])?.kernel(gpu, "copy", &[])?;
        let kernel = kernel.bind(gpu, &[("source", source.slice()), ("copied", copied.slice())])?;
        Ok(Self {
            kernel,
            groups: [(bytes / COPY_GROUP) as u32, 1, 1],
            bytes,
            #[cfg(test)]
            buffers: [source, copied],
        })
    }
}

/// What is multiplied.
#[derive(Clone, Copy, Debug)]
enum Number {
    Single,
    Half,
}

/// Multiply-adds, as many rounds as `load` says.
struct MultiplyAdds {
    kernel: Bound,
    load: Buffer,
    #[cfg(test)]
    results: Buffer,
}

impl MultiplyAdds {
    /// 4,096, which every device takes.
    const GROUPS: [u32; 3] = [INVOCATIONS / THREADS, 1, 1];

    fn new(gpu: &Gpu, number: Number) -> Result<Self, GpuError> {
        let load = gpu.buffer_with("load", Use::Uniform, &[Load::of(1)])?;
        let results = gpu.buffer("results", Use::Storage, u64::from(INVOCATIONS) * 4)?;
        let module = gpu.module("multiply_add", &[&multiply_add_source(number)])?;
        let kernel = module.kernel(gpu, "multiply_add", &[])?;
        let kernel = kernel.bind(gpu, &[("load", load.slice()), ("results", results.slice())])?;
        Ok(Self {
            kernel,
            load,
            #[cfg(test)]
            results,
        })
    }
}

fn copy_source() -> String {
    constants(&[("THREADS", THREADS), ("ITEMS", COPY_ITEMS)]) + include_str!("copy.wgsl")
}

fn multiply_add_source(number: Number) -> String {
    // `enable` comes before everything else.
    let names = match number {
        Number::Single => "alias Number = f32;\nalias Vector = vec4<f32>;\n",
        Number::Half => "enable f16;\nalias Number = f16;\nalias Vector = vec4<f16>;\n",
    };
    names.to_owned() + &constants(&[("THREADS", THREADS)]) + include_str!("multiply_add.wgsl")
}

/// All its sources, for the test that every shader is valid.
#[cfg(test)]
pub(crate) fn sources() -> [String; 3] {
    [copy_source(), multiply_add_source(Number::Single), multiply_add_source(Number::Half)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::GpuSettings;

    /// The adapter of this machine, or a word that there is none.
    fn gpu() -> Option<Gpu> {
        crate::device_for_tests(&GpuSettings::default())
    }

    fn run(gpu: &Gpu, kernel: &Bound, groups: [u32; 3]) {
        let mut recorder = gpu.recorder(None);
        recorder.dispatch(kernel, groups);
        recorder.submit().unwrap_or_else(|error| panic!("{error}"));
    }

    /// Work that is left out would count as speed.
    #[test]
    fn copies_are_whole() {
        let Some(gpu) = gpu() else { return };
        for bytes in [COPY_GROUP, 1027 * COPY_GROUP] {
            let copy = Copy::with_bytes(&gpu, bytes).unwrap();
            let [source, copied] = &copy.buffers;
            let values: Vec<u32> = (1..=(bytes / 4) as u32).collect();
            gpu.write(&source.slice(), &values).unwrap();
            run(&gpu, &copy.kernel, copy.groups);
            assert!(gpu.read::<u32>(&copied.slice()).unwrap() == values, "{bytes}");
        }
    }

    #[test]
    fn every_multiply_add_is_done() {
        let Some(gpu) = gpu() else { return };
        let has_f16 = gpu.capabilities().shader_f16;
        for number in [Number::Single, Number::Half].into_iter().take(1 + usize::from(has_f16)) {
            let sums = MultiplyAdds::new(&gpu, number).unwrap();
            // Sums of eight numbers around 1.
            let rounding = if matches!(number, Number::Single) { 1e-6 } else { 4e-3 };
            for (rounds, left) in [(1, 2f64.powi(-8)), (8, 0.0)] {
                gpu.write(&sums.load.slice(), &[Load::of(rounds)]).unwrap();
                run(&gpu, &sums.kernel, MultiplyAdds::GROUPS);
                let results: Vec<f32> = gpu.read(&sums.results.slice()).unwrap();
                for (i, result) in results.iter().enumerate() {
                    // Half of what a sum begins beyond ½ is left after each multiply-add.
                    let begins = [0.0, 0.125, 0.25, 0.375, 1.0, 1.125, 1.25, 1.375];
                    let beyond: f64 = begins.iter().map(|x| x + (i % 64) as f64 / 128.0 - 0.5).sum();
                    let error = f64::from(*result) - (4.0 + beyond * left);
                    assert!(error.abs() <= rounding, "{number:?}, {rounds} rounds, {i}: {result}");
                }
            }
        }
    }

    #[test]
    fn work_grows_until_it_can_be_measured() {
        // 10 µs a unit, and once in a while another program is in the way.
        let mut runs = Vec::new();
        let found = rate(|count| {
            runs.push(count);
            let slow = if runs.len() % 3 == 0 { 5 } else { 1 };
            Ok(Duration::from_micros(10) * count * slow)
        });
        assert!((found.unwrap() - 1e5).abs() < 1e-3);
        assert!(Duration::from_micros(10) * runs[runs.len() - 1] * 5 >= LEAST, "{runs:?}");
        // A single unit is enough where it takes long.
        let mut most = 0;
        let found = rate(|count| {
            most = most.max(count);
            Ok(Duration::from_secs(1) * count)
        });
        assert_eq!((found, most), (Ok(1.0), 1));
        assert!(matches!(rate(|_| Ok(Duration::ZERO)), Err(GpuError::Refused { .. })));
    }

    #[test]
    fn copies_fit_the_smallest_device() {
        let limits = |binding_bytes, buffer_bytes| Limits { buffer_bytes, binding_bytes, ..Limits::LEAST };
        assert_eq!(most_copied(&limits(1 << 31, 1 << 31)), 256 << 20);
        assert_eq!(most_copied(&limits(128 << 20, 256 << 20)), 128 << 20);
        assert_eq!(most_copied(&limits((128 << 20) - 4, 256 << 20)), (128 << 20) - COPY_GROUP);
    }

    #[test]
    fn layouts_are_those_of_the_shader() {
        crate::assert_layout!(
            &[&multiply_add_source(Number::Single)],
            Load,
            Load { factor, summand, rounds, _pad }
        );
    }
}
