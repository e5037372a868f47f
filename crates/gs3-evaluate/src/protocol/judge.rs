//! Runs one method over the timeline and scores every displayed frame.

use std::collections::VecDeque;
use std::sync::Arc;

use gs3::Stage;
use gs3_scene::Image;
use serde::{Deserialize, Serialize};

use super::EvaluateError;
use super::ground_truth::{GroundTruth, Truth};
use super::moment::Moment;
use super::results::Subset;
use super::timeline::Timeline;
use crate::methods::{Durations, Method};
use crate::metrics::flip::DEFAULT_PIXELS_PER_DEGREE;
use crate::metrics::{
    Quantisation, SsimBorder, Viewing, block_rmse_p99, color_video_vdp, edge_psnr, flicker, flip, psnr, ssim,
    tpsnr, warping_error,
};

/// PSNR of frames that agree better, or exactly, counts as this many dB, so that means exist.
pub const PSNR_CAP: f64 = 100.0;

/// Scores of one displayed frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameScore {
    /// When it is shown.
    pub moment: Moment,
    /// PSNR in dB, capped at [`PSNR_CAP`].
    pub psnr: f64,
    /// SSIM, borders cropped.
    pub ssim: f64,
    /// Mean ꟻLIP.
    pub flip: f64,
    /// PSNR in dB, capped, of the pixels near depth discontinuities of the native frame; none where it has no such
    /// pixels.
    pub edge_psnr: Option<f64>,
    /// 99th percentile of the RMSE of 8×8 blocks, in `[0, 255]`.
    pub block_rmse_p99: f64,
}

/// A detail of a displayed frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Crop {
    /// The ground truth's detail, as PNG.
    pub truth_png: Vec<u8>,
    /// The method's, as PNG.
    pub png: Vec<u8>,
}

/// All scores of one method.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MethodScore {
    /// Scores by displayed frame.
    pub frames: Vec<FrameScore>,
    /// tPSNR in dB, capped, of the pairs of consecutive frames of each subset, in the order of [`Subset::EACH`].
    pub tpsnr: [Vec<f64>; 3],
    /// Warping error of the same pairs, where something is visible in both.
    pub warping_error: [Vec<f64>; 3],
    /// Flicker of the triples of consecutive frames of each subset. Interpolated frames alone have no value of these three
    /// where there are several between two rendered ones, as they are not equally spaced then.
    pub flicker: [Vec<f64>; 3],
    /// Milliseconds of the stages of every rendered frame but the first, in the order of [`gs3::Stage::ALL`].
    pub stage_ms: Vec<[Option<f64>; Stage::ALL.len()]>,
    /// Milliseconds of native rendering beside them, frame by frame.
    pub native_ms: Vec<f64>,
    /// Share of the pixels of every rendered frame that the method rasterized exactly beside its LR frame, in `[0, 1]`;
    /// empty for methods that rasterize none so.
    pub refined_share: Vec<f64>,
    /// ColorVideoVDP of all frames in JOD, where it was asked for.
    pub jod: Option<f64>,
    /// A detail of one rendered frame and of the frames between it and the one before.
    pub crops: Vec<(Moment, Crop)>,
}

/// A displayed frame with its ground truth.
#[derive(Clone)]
struct Displayed {
    truth: Arc<Truth>,
    image: Arc<Image>,
}

/// Largest width and height that ColorVideoVDP sees, the middle of frames: its memory grows with pixels × frames. Both
/// videos, here and in its own format, take about 50 MB for each displayed frame of this size (estimated, not measured).
const JOD_SIZE: (usize, usize) = (1280, 720);
const JOD_MEMORY: usize = 4 << 30;

/// A method under judgement.
pub(super) struct Judged<'a> {
    pub method: &'a mut dyn Method,
    /// Frames that it shows between two rendered ones.
    pub in_between: u32,
    /// Native rendering, timed at the same time.
    pub beside: &'a mut dyn Method,
}

/// Runs a method and judges it, with ColorVideoVDP if frames are displayed at a `rate`.
pub(super) fn judge(
    Judged { method, in_between, beside }: Judged<'_>,
    timeline: &Timeline,
    truth: &mut GroundTruth<'_>,
    warm_up_frames: usize,
    rate: Option<f64>,
    progress: &mut dyn FnMut(usize),
) -> Result<MethodScore, EvaluateError> {
    for i in (0..timeline.rendered()).cycle().take(warm_up_frames) {
        let camera = timeline.camera(Moment::rendered(i));
        method.render(camera, &timeline.between(i, in_between))?;
        beside.render(camera, &[])?;
    }
    method.reset();
    let mut score = MethodScore::default();
    let mut recent: [VecDeque<Displayed>; 3] = Default::default();
    let crop_at = timeline.rendered() / 2;
    let mut before = Arc::new(Image::default());
    let mut video: [Vec<Image>; 2] = Default::default();
    for i in 0..timeline.rendered() {
        let camera = timeline.camera(Moment::rendered(i));
        let shown = method.render(camera, &timeline.between(i, in_between))?;
        // Where a method makes no frames between, the frame before stays on the screen.
        let between = shown
            .in_between
            .map(|image| image.map_or_else(|| Arc::clone(&before), |image| Arc::new(image.clone())));
        let current = Arc::new(shown.current.clone());
        before = Arc::clone(&current);
        score.refined_share.extend(method.refined_share());
        // The first frame has nothing before it, so a method that interpolates does less there.
        if i > 0 {
            score.stage_ms.push(milliseconds(method.durations()));
            beside.render(camera, &[])?;
            score.native_ms.push(milliseconds(beside.durations()).into_iter().flatten().sum());
        }
        // The first frame has no moments before it, also if a method still shows older images.
        let displayed = Moment::before(i, in_between).zip(between).chain([(Moment::rendered(i), current)]);
        for (moment, image) in displayed {
            let frame = Displayed { truth: truth.load(moment)?, image };
            score.frames.push(frame_score(moment, &frame)?);
            if rate.is_some() {
                video[0].push(middle(&frame.truth.image, JOD_SIZE));
                video[1].push(middle(&frame.image, JOD_SIZE));
            }
            if i == crop_at {
                score.crops.push((moment, crop(&frame.truth.image, &frame.image)));
            }
            for subset in [Subset::All, Subset::of(moment)] {
                // Not equally spaced.
                if subset == Subset::Interpolated && in_between > 1 {
                    continue;
                }
                let recent = &mut recent[subset as usize];
                recent.push_back(frame.clone());
                score_motion(subset, recent, &mut score)?;
                if recent.len() == 3 {
                    recent.pop_front();
                }
            }
        }
        progress(i + 1);
    }
    if let Some(rate) = rate {
        let display = "standard_4k".to_owned();
        let viewing = Viewing { display, frames_per_second: rate as f32, memory_limit_bytes: JOD_MEMORY };
        score.jod = Some(color_video_vdp(&video[0], &video[1], &viewing)?);
    }
    Ok(score)
}

fn frame_score(moment: Moment, frame: &Displayed) -> Result<FrameScore, EvaluateError> {
    let (reference, test) = (&frame.truth.image, &*frame.image);
    Ok(FrameScore {
        moment,
        psnr: psnr(reference, test, Quantisation::None)?.min(PSNR_CAP),
        ssim: ssim(reference, test, SsimBorder::Crop)?,
        flip: flip(reference, test, DEFAULT_PIXELS_PER_DEGREE)?,
        edge_psnr: edge_psnr(reference, test, &frame.truth.edges, Quantisation::None)?
            .map(|psnr| psnr.min(PSNR_CAP)),
        block_rmse_p99: block_rmse_p99(reference, test, Quantisation::None)?,
    })
}

/// Scores the newest frame against the ones before it.
fn score_motion(
    subset: Subset,
    recent: &VecDeque<Displayed>,
    score: &mut MethodScore,
) -> Result<(), EvaluateError> {
    let frames: Vec<&Displayed> = recent.iter().collect();
    if let [.., before, now] = frames[..] {
        let truths = [&before.truth.image, &now.truth.image];
        let value = tpsnr(truths, [&before.image, &now.image], Quantisation::None)?;
        score.tpsnr[subset as usize].push(value.min(PSNR_CAP));
        let error = warping_error([before.truth.warp(&before.image), now.truth.warp(&now.image)])?;
        score.warping_error[subset as usize].extend(error);
    }
    if let [a, b, c] = frames[..] {
        let truths = [&a.truth.image, &b.truth.image, &c.truth.image];
        let value = flicker(truths, [&a.image, &b.image, &c.image], Quantisation::None)?;
        score.flicker[subset as usize].push(value);
    }
    Ok(())
}

/// The middle of `image`, at most of this size.
fn middle(image: &Image, (width, height): (usize, usize)) -> Image {
    let (width, height) = (width.min(image.width()), height.min(image.height()));
    let (left, top) = ((image.width() - width) / 2, (image.height() - height) / 2);
    let pixels = (top..top + height).flat_map(|y| image.row(y)[left..left + width].iter().copied());
    // As many pixels as it says.
    Image::from_pixels(width, height, pixels.collect()).unwrap_or_default()
}

fn milliseconds(durations: Durations) -> [Option<f64>; Stage::ALL.len()] {
    durations.map(|d| d.map(|d| d.as_secs_f64() * 1e3))
}

/// Width and height of details, in pixels.
const CROP: (usize, usize) = (320, 180);

/// The part of the frame where the ground truth has most detail.
pub(crate) fn crop(truth: &Image, test: &Image) -> Crop {
    let size = (CROP.0.min(truth.width()), CROP.1.min(truth.height()));
    let mut best = (-1.0, (0, 0));
    for top in (0..=truth.height() - size.1).step_by(size.1.div_ceil(2)) {
        for left in (0..=truth.width() - size.0).step_by(size.0.div_ceil(2)) {
            let detail = detail(truth, (left, top), size);
            if detail > best.0 {
                best = (detail, (left, top));
            }
        }
    }
    let png = |image: &Image| png_rgb8(image, best.1, size);
    Crop { truth_png: png(truth), png: png(test) }
}

/// Sum of absolute differences of neighbouring green values, every other row.
fn detail(image: &Image, (left, top): (usize, usize), (width, height): (usize, usize)) -> f64 {
    let rows = (top..top + height).step_by(2);
    rows.flat_map(|y| image.row(y)[left..left + width].windows(2))
        .map(|pair| f64::from((pair[1][1] - pair[0][1]).abs()))
        .sum()
}

/// The part of `image` at `(left, top)`, as an 8-bit RGB PNG.
fn png_rgb8(image: &Image, (left, top): (usize, usize), (width, height): (usize, usize)) -> Vec<u8> {
    let pixels = (top..top + height).flat_map(|y| image.row(y)[left..left + width].iter().copied()).collect();
    let part = Image::from_pixels(width, height, pixels).unwrap_or_default();
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    // Writing to memory fails only for sizes of 0, and images have none.
    let written = encoder.write_header().and_then(|mut writer| writer.write_image_data(&part.to_rgb8()));
    if written.is_err() {
        bytes.clear();
    }
    bytes
}
