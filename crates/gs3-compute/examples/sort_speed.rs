//! Keys per second of sort and scan: `cargo run --release -p gs3-compute --example sort_speed [COUNT]`.

use std::time::Instant;

use gs3_compute::{Gpu, GpuError, GpuSettings, OptionalFeatures, Pairs, Recorder, Scan, Sort, Timings, Use};

fn main() -> Result<(), GpuError> {
    let count: u32 = std::env::args().nth(1).and_then(|n| n.parse().ok()).unwrap_or(3_000_000);
    for features in [OptionalFeatures::All, OptionalFeatures::None] {
        let gpu = Gpu::new(&GpuSettings { features, ..GpuSettings::default() })?;
        println!("{}, optional features: {features:?}, {count} numbers", gpu.adapter().name);
        let keys: Vec<u32> = (0..count).map(|k| k.wrapping_mul(2_654_435_769).rotate_left(7)).collect();
        let length = gpu.buffer_with("count", Use::Storage, &[count])?;
        let buffers = [
            gpu.buffer_with("keys", Use::Storage, &keys)?,
            gpu.buffer_with("values", Use::Storage, &keys)?,
            gpu.buffer("keys 2", Use::Storage, u64::from(count) * 4)?,
            gpu.buffer("values 2", Use::Storage, u64::from(count) * 4)?,
        ];
        let [a, b, c, d] = &buffers;
        for bits in [32, 24, 16, 12] {
            let start = Instant::now();
            let sort = Sort::new(&gpu, count, bits)?;
            let pairs =
                [(a, b), (c, d)].map(|(keys, values)| Pairs { keys: keys.into(), values: values.into() });
            let bound = sort.bind(&gpu, length.slice(), pairs)?;
            println!("  compiled in {:.2} s: {:?}", start.elapsed().as_secs_f64(), sort.plan());
            measure(&gpu, &format!("sort {bits} bits"), count, |recorder| bound.record(recorder))?;
        }
        let scan = Scan::new(&gpu)?.bind(&gpu, length.slice(), a.slice(), c.slice())?;
        measure(&gpu, "scan", count, |recorder| scan.record(recorder))?;
    }
    Ok(())
}

/// The median of some runs, by the device's clock where it has one.
fn measure(gpu: &Gpu, what: &str, count: u32, record: impl Fn(&mut Recorder<'_>)) -> Result<(), GpuError> {
    let mut timings = Timings::new(gpu).ok();
    let mut seconds = Vec::new();
    for _ in 0..9 {
        let mut recorder = gpu.recorder(timings.as_mut());
        recorder.stage("all");
        record(&mut recorder);
        let start = Instant::now();
        let submission = recorder.submit()?;
        gpu.wait(&submission)?;
        let wall = start.elapsed();
        seconds.push(match &timings {
            Some(timings) => timings.read(gpu, &submission)?.iter().map(|t| t.time).sum(),
            None => wall,
        });
    }
    seconds.sort();
    let median = seconds[seconds.len() / 2].as_secs_f64();
    println!("  {what}: {:.3} ms, {:.1} M/s", 1e3 * median, f64::from(count) / median / 1e6);
    Ok(())
}
