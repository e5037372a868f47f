//! How well the expected errors of blocks tell their true errors: a table of ten bins and a plot, and how much of the
//! gain of an oracle selecting by them gets. 1280×720 from 320×180, a twentieth of the blocks exact.
//!
//! `cargo run --release -p gs3-reconstruct --example expected_error -- OUT.svg SCENE=PATH ...`; `demo=demo` is the demo
//! scene.

use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;

use gs3_raster::{Culling, Outputs, RasterSettings, Rasterizer, matched_dilation};
use gs3_reconstruct::{BlockBudget, Kriging, SuperSampler, select_blocks};
use gs3_scene::{
    BLOCK_SIDE, CameraPath, ExactBlocks, GBuffer, Image, Scene, Size, block_grid, capture, demo, format,
    jitter::Jitter,
};

const SCALE: u32 = 4;
const SIZE: Size = Size::new(1280, 720);
const SHARE: f32 = 0.05;
/// Frames that are judged, once the history is full.
const JUDGED: std::ops::Range<u64> = 16..40;
const BINS: usize = 10;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// Squared errors of `image`, clamped to `[0, 1]`, in blocks: sums over pixels and RGB.
fn true_errors(image: &Image, native: &Image) -> Vec<f32> {
    let [columns, rows] = block_grid(image.size());
    let mut errors = vec![0.0; columns * rows];
    for (k, (a, b)) in image.pixels().iter().zip(native.pixels()).enumerate() {
        let (x, y) = (k % image.width() / BLOCK_SIDE, k / image.width() / BLOCK_SIDE);
        for c in 0..3 {
            errors[y * columns + x] += (a[c].clamp(0.0, 1.0) - b[c].clamp(0.0, 1.0)).powi(2);
        }
    }
    errors
}

/// PSNR of a frame with block errors `errors`, if the share `share` of blocks that `by` ranks first had no error.
fn psnr_without(errors: &[f32], by: &[f32], share: f64) -> f64 {
    let mut order: Vec<usize> = (0..errors.len()).collect();
    order.sort_unstable_by(|a, b| by[*b].total_cmp(&by[*a]));
    let left =
        order[(share * errors.len() as f64) as usize..].iter().map(|k| f64::from(errors[*k])).sum::<f64>();
    let numbers = 3.0 * SIZE.pixels() as f64;
    -10.0 * (left / numbers).max(1e-12).log10()
}

/// What is found on one path.
struct Calibration {
    name: String,
    /// Predicted and true mean squared errors of a number of a block, by tenths of the blocks in order of the first.
    bins: [[f64; 2]; BINS],
    /// PSNR of frames with 0, 5, 10 % of the blocks exact: selected by expected and by true errors.
    gains: [[f64; 2]; 3],
}

fn calibrate(name: &str, scene: Scene, path: &CameraPath) -> Outcome<Calibration> {
    let path = path.resized(SIZE.width, SIZE.height)?;
    let mut rasterizer = Rasterizer::new(Arc::new(scene), Culling::default());
    let mut sampler = SuperSampler::new(SCALE, Kriging::Off)?;
    let jitter = Jitter::grid(SCALE);
    let (mut image, mut native) = (Image::default(), Image::default());
    let (mut gbuffer, mut blocks) = (GBuffer::default(), ExactBlocks::default());
    let mut pairs = Vec::new();
    let mut gains = [[0.0; 2]; 3];
    for k in 0..JUDGED.end {
        let camera = path.at(k as f64);
        let settings = RasterSettings {
            dilation: matched_dilation(SCALE),
            jitter: jitter.offset(k),
            ..RasterSettings::new(Outputs::GBuffer)
        };
        rasterizer.rasterize_low_resolution(&camera, SCALE, &settings, &mut gbuffer)?;
        sampler.super_sample(&camera, &gbuffer, &mut image)?;
        let budget = BlockBudget { most: SHARE, least_error: 0.0 };
        let places = select_blocks(sampler.expected_errors(), image.size(), budget);
        rasterizer.rasterize_blocks(&places, &mut blocks)?;
        if JUDGED.contains(&k) {
            rasterizer.rasterize_image(&camera, &RasterSettings::new(Outputs::Color), &mut native)?;
            let (errors, expected) = (true_errors(&image, &native), sampler.expected_errors());
            for (gain, share) in gains.iter_mut().zip([0.0, 0.05, 0.1]) {
                gain[0] += psnr_without(&errors, expected, share) / JUDGED.count() as f64;
                gain[1] += psnr_without(&errors, &errors, share) / JUDGED.count() as f64;
            }
            pairs.extend(expected.iter().copied().zip(errors));
        }
        sampler.refine(&blocks, &mut image);
    }
    pairs.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let mut bins = [[0.0; 2]; BINS];
    for (bin, pairs) in bins.iter_mut().zip(pairs.chunks(pairs.len().div_ceil(BINS))) {
        let numbers = (3 * BLOCK_SIDE * BLOCK_SIDE * pairs.len()) as f64;
        *bin = [pairs.iter().map(|p| f64::from(p.0)).sum(), pairs.iter().map(|p| f64::from(p.1)).sum()]
            .map(|sum: f64| sum / numbers);
    }
    Ok(Calibration { name: name.to_owned(), bins, gains })
}

/// Expected against true root mean squared errors, of 255, both axes logarithmic from 0.1 to 100.
fn plot(all: &[Calibration]) -> String {
    const COLORS: [&str; 8] =
        ["#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f"];
    let at = |error: f64| (255.0 * error.sqrt()).max(0.1).log10() * 150.0 + 200.0;
    let mut svg = String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 720 560\" font-family=\"sans-serif\" font-size=\"14\">\n\
         <rect width=\"720\" height=\"560\" fill=\"white\"/>\n",
    );
    for (label, value) in [("0.1", 0.1), ("1", 1.0), ("10", 10.0), ("100", 100.0)] {
        let place = at((value / 255.0_f64).powi(2));
        _ = writeln!(
            svg,
            "<path d=\"M{place} 50V500M50 {y}H500\" stroke=\"#ddd\"/><text x=\"{place}\" y=\"520\">{label}</text>\
             <text x=\"15\" y=\"{y}\">{label}</text>",
            y = 550.0 - place
        );
    }
    svg += "<path d=\"M50 500L500 50\" stroke=\"#888\" stroke-dasharray=\"4\"/>\n\
            <text x=\"180\" y=\"545\">expected RMSE of a tenth of the blocks (of 255)</text>\n\
            <text x=\"50\" y=\"35\">true RMSE (of 255)</text>\n";
    for (k, (path, color)) in all.iter().zip(COLORS.iter().cycle()).enumerate() {
        let points: Vec<String> =
            path.bins.iter().map(|[x, y]| format!("{:.1},{:.1}", at(*x), 550.0 - at(*y))).collect();
        _ = writeln!(
            svg,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"2\"/>\
             <text x=\"515\" y=\"{}\" fill=\"{color}\">{}</text>",
            points.join(" "),
            70 + 22 * k,
            path.name
        );
    }
    svg + "</svg>\n"
}

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [out, inputs @ ..] = arguments.as_slice() else {
        return Err("usage: expected_error OUT.svg SCENE=PATH ...".into());
    };
    let mut all = Vec::new();
    for input in inputs {
        let (scene, path) = input.split_once('=').ok_or("expected SCENE=PATH")?;
        let name = Path::new(path).file_stem().and_then(|name| name.to_str()).unwrap_or(path);
        let (scene, path) = if scene == "demo" {
            (demo::scene()?, demo::path())
        } else {
            let scene = format::load(Path::new(scene), &format::LoadOptions::default(), &|_| {})?;
            (scene, capture::load(Path::new(path))?)
        };
        let found = calibrate(name, scene, &path)?;
        println!("{name}");
        for [expected, error] in found.bins {
            let rmse = |error: f64| 255.0 * error.sqrt();
            println!("  expected {:7.3}  true {:7.3} of 255", rmse(expected), rmse(error));
        }
        let [none, five, ten] = found.gains;
        for (share, gain) in [(5, five), (10, ten)] {
            let of_oracle = (gain[0] - none[0]) / (gain[1] - none[1]);
            println!(
                "  {share} % of the blocks exact: {:.2} → {:.2} dB by expected, {:.2} by true errors: {:.0} % of the gain",
                none[0],
                gain[0],
                gain[1],
                100.0 * of_oracle
            );
        }
        all.push(found);
    }
    std::fs::write(out, plot(&all))?;
    Ok(())
}
