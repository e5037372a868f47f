//! Scores of frames, and what is made of them.

use std::error::Error;
use std::time::Duration;

use gs3::{KEYFRAMES, Stage};
use gs3_evaluate::methods::{Method, MethodSpec};
use gs3_evaluate::metrics::{
    DepthEdges, Quantisation, SsimBorder, block_rmse_p99, edge_psnr, psnr, ssim, tpsnr,
};
use gs3_evaluate::protocol::PSNR_CAP;
use gs3_scene::Image;

/// A row of a table.
#[derive(Clone)]
pub struct Row {
    pub name: String,
    pub rendered: Scores,
    pub between: Scores,
    pub tpsnr: Vec<f64>,
    pub milliseconds: Vec<f64>,
    /// Frames shown between two rendered ones.
    pub in_between: u32,
}

/// Scores of frames, in their order.
#[derive(Clone, Default)]
pub struct Scores {
    pub psnr: Vec<f64>,
    pub ssim: Vec<f64>,
    /// Not a number where a frame has no edge.
    pub edge_psnr: Vec<f64>,
    pub block_rmse_p99: Vec<f64>,
}

impl Row {
    pub fn new(spec: MethodSpec) -> Self {
        Self {
            name: spec.to_string(),
            rendered: Scores::default(),
            between: Scores::default(),
            tpsnr: Vec::new(),
            milliseconds: Vec::new(),
            in_between: spec.in_between(),
        }
    }

    /// Displayed frames per second by the median time; none for methods with frames that need the native image.
    pub fn fps(&self) -> Option<f64> {
        let mut times = self.milliseconds.clone();
        times.sort_by(f64::total_cmp);
        Some(f64::from(self.in_between + 1) * 1e3 / times.get(times.len() / 2)?)
    }
}

impl Scores {
    pub fn add(&mut self, truth: &Image, image: &Image) -> Result<(), Box<dyn Error>> {
        self.psnr.push(psnr(truth, image, Quantisation::None)?.min(PSNR_CAP));
        self.ssim.push(ssim(truth, image, SsimBorder::Crop)?);
        Ok(())
    }

    /// Adds what shows faults that cover little of an image.
    pub fn add_faults(
        &mut self,
        truth: &Image,
        image: &Image,
        edges: &DepthEdges,
    ) -> Result<(), Box<dyn Error>> {
        let at_edges = edge_psnr(truth, image, edges, Quantisation::None)?;
        self.edge_psnr.push(at_edges.map_or(f64::NAN, |value| value.min(PSNR_CAP)));
        self.block_rmse_p99.push(block_rmse_p99(truth, image, Quantisation::None)?);
        Ok(())
    }
}

/// Adds the tPSNR of `image` and the frame before it, and remembers it.
pub fn follow(
    row: &mut Row,
    before: &mut Option<(Image, Image)>,
    truth: &Image,
    image: Image,
) -> Result<(), Box<dyn Error>> {
    if let Some((truth_before, image_before)) = before {
        let value = tpsnr([truth_before, truth], [image_before, &image], Quantisation::None)?;
        row.tpsnr.push(value.min(PSNR_CAP));
    }
    *before = Some((truth.clone(), image));
    Ok(())
}

pub fn milliseconds(method: &dyn Method, stages: &[Stage]) -> f64 {
    let durations = method.durations();
    let total: Duration = stages.iter().filter_map(|stage| durations[*stage as usize]).sum();
    total.as_secs_f64() * 1e3
}

pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// The mean over rendered frames, without those that `refined*` makes natively as a whole: the first one and the keyframes.
pub fn mean_of_rendered(values: &[f64]) -> Option<f64> {
    let judged =
        values.iter().enumerate().filter(|(k, value)| k % KEYFRAMES as usize != 0 && value.is_finite());
    mean(&judged.map(|(_, value)| *value).collect::<Vec<_>>())
}

pub fn shown(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "–".into(), |v| format!("{v:.digits$}"))
}
