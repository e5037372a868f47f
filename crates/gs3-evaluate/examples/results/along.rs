//! All methods along a path.

use std::error::Error;
use std::sync::Arc;

use gs3::Stage;
use gs3_evaluate::methods::{Method, MethodSettings, MethodSpec, build};
use gs3_evaluate::metrics::DepthEdges;
use gs3_raster::{Outputs, RasterSettings, Rasterizer};
use gs3_scene::{CameraPath, GBuffer, Image};

use crate::score::{Row, follow, milliseconds};
use crate::truth::Truth;

/// gs3: the names of super sampling alone, and with in-between frames. Learned ones are left out, aloud, where their weights
/// are not there.
pub const OURS: [(&str, &[&str]); 9] = [
    ("history", &["analytic"]),
    ("kriging", &["kriged"]),
    ("overscan", &["overscanned"]),
    ("fast_ss", &["fast"]),
    ("balanced_ss", &["balanced"]),
    ("high_ss", &["high"]),
    ("refined_fast", &["refined_fast+warp2"]),
    ("refined", &["refined+warp", "default"]),
    ("refined_high", &["refined_high+warp2"]),
];
/// Baselines, without in-between frames.
const BASELINES: [&str; 2] = ["bicubic", "hermite"];
/// Rows of a table: native rendering, [`BASELINES`], [`OURS`].
pub const NATIVE: usize = 0;
pub const BICUBIC: usize = 1;
pub const HISTORY: usize = 1 + BASELINES.len();
pub const ANALYTIC: usize = HISTORY + 1;
pub const KRIGING: usize = HISTORY + 2;
pub const OVERSCAN: usize = HISTORY + 4;

/// A method of ours on its way along the path.
struct Ours {
    method: Box<dyn Method>,
    /// The row of super sampling alone, of the first method that has it.
    alone: Option<usize>,
    /// The row with in-between frames.
    whole: usize,
}

/// Native rendering, [`BASELINES`] and [`OURS`] along the path, the latter in a row without what they make between and
/// in rows with it. And why some of ours are absent.
pub fn along(
    path: &CameraPath,
    frames: usize,
    settings: &MethodSettings,
) -> Result<(Vec<Row>, Vec<String>), Box<dyn Error>> {
    let mut rows = vec![Row::new(MethodSpec::NATIVE)];
    let mut baselines = Vec::new();
    for name in BASELINES {
        let spec = name.parse()?;
        baselines.push(build(spec, settings)?);
        rows.push(Row::new(spec));
    }
    let (mut ours, mut absent) = (Vec::new(), Vec::new());
    for (alone, wholes) in OURS {
        let mut first = Some(alone);
        for whole in wholes {
            let spec = whole.parse()?;
            match build(spec, settings) {
                Ok(method) => {
                    let alone = first.take().map(str::parse).transpose()?.map(|spec| {
                        rows.push(Row::new(spec));
                        rows.len() - 1
                    });
                    ours.push(Ours { method, alone, whole: rows.len() });
                    rows.push(Row::new(spec));
                }
                Err(error) => {
                    eprintln!("{whole} is left out: {error}");
                    absent.push(error.to_string());
                }
            }
        }
    }
    let mut truth = Truth::new(path, settings, rows.iter().map(|row| row.in_between))?;
    // Truth and image of the frame before, by row; of those with in-between frames, the last one displayed.
    let mut before: Vec<Option<(Image, Image)>> = vec![None; rows.len()];
    let cameras = path.cameras();
    let mut rasterizer = Rasterizer::new(Arc::clone(&settings.scene), settings.culling);
    let mut gbuffer = GBuffer::default();
    for k in 0..frames {
        let native_ms = truth.render(k)?;
        if k > 0 {
            rows[NATIVE].milliseconds.push(native_ms);
        }
        rasterizer.rasterize(&cameras[k], &RasterSettings::new(Outputs::GBuffer), &mut gbuffer)?;
        let depth = gbuffer.geometry.as_ref().ok_or("expected a G-buffer with depth")?;
        let edges = DepthEdges::of(&depth.depth_median);
        for (i, method) in baselines.iter_mut().enumerate() {
            let image = method.render(&cameras[k], &[])?.current.clone();
            let ms = milliseconds(method.as_ref(), &Stage::ALL);
            let row = &mut rows[BICUBIC + i];
            row.rendered.add(&truth.current, &image)?;
            row.rendered.add_faults(&truth.current, &image, &edges)?;
            if k > 0 {
                row.milliseconds.push(ms);
            }
            follow(row, &mut before[BICUBIC + i], &truth.current, image)?;
        }
        for Ours { method, alone, whole } in &mut ours {
            let row = &mut rows[*whole];
            let (poses, truths) = truth.between(row.in_between);
            let shown = method.render(&cameras[k], &poses)?;
            for (truth, image) in truths.into_iter().zip(shown.in_between.into_iter().flatten()) {
                row.between.add(truth, image)?;
                follow(row, &mut before[*whole], truth, image.clone())?;
            }
            let current = shown.current.clone();
            row.rendered.add(&truth.current, &current)?;
            row.rendered.add_faults(&truth.current, &current, &edges)?;
            follow(row, &mut before[*whole], &truth.current, current.clone())?;
            if k > 0 {
                row.milliseconds.push(milliseconds(method.as_ref(), &Stage::ALL));
            }
            if let Some(alone) = *alone {
                rows[alone].rendered = rows[*whole].rendered.clone();
                follow(&mut rows[alone], &mut before[alone], &truth.current, current)?;
                if k > 0 {
                    rows[alone].milliseconds.push(milliseconds(method.as_ref(), &Stage::ALL[..3]));
                }
            }
        }
    }
    Ok((rows, absent))
}
