//! All methods along a path.

use std::error::Error;
use std::sync::Arc;

use gs3::Stage;
use gs3_evaluate::methods::{MethodSettings, MethodSpec, build};
use gs3_evaluate::metrics::DepthEdges;
use gs3_raster::{Outputs, RasterSettings, Rasterizer};
use gs3_scene::{CameraPath, GBuffer, Image};

use crate::score::{Row, follow, milliseconds};

/// gs3: the names of super sampling alone and with the in-between frames. Learned ones are left out, aloud, where their
/// weights are not there.
pub const OURS: [[&str; 2]; 9] = [
    ["history", "analytic"],
    ["kriging", "kriged"],
    ["overscan", "overscanned"],
    ["fast_ss", "fast"],
    ["balanced_ss", "balanced"],
    ["high_ss", "high"],
    ["refined_fast", "refined_fast+warp"],
    ["refined", "default"],
    ["refined_high", "refined_high+warp"],
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

/// Native rendering, [`BASELINES`] and [`OURS`] along the path, the latter in two rows each: without what they make
/// between, and with it. And why some of ours are absent.
pub fn along(
    path: &CameraPath,
    frames: usize,
    settings: &MethodSettings,
) -> Result<(Vec<Row>, Vec<String>), Box<dyn Error>> {
    let mut native = build(MethodSpec::NATIVE, settings)?;
    let mut rows = vec![Row::new("native", 1.0)];
    let mut baselines = Vec::new();
    for name in BASELINES {
        baselines.push(build(name.parse()?, settings)?);
        rows.push(Row::new(name, 1.0));
    }
    let (mut ours, mut absent) = (Vec::new(), Vec::new());
    for [alone, whole] in OURS {
        match build(whole.parse()?, settings) {
            Ok(method) => {
                ours.push(method);
                rows.extend([Row::new(alone, 1.0), Row::new(whole, 2.0)]);
            }
            Err(error) => {
                eprintln!("{whole} is left out: {error}");
                absent.push(error.to_string());
            }
        }
    }
    // Truth and image of the frame before, by row; of those with in-between frames, the last one displayed.
    let mut before: Vec<Option<(Image, Image)>> = vec![None; rows.len()];
    let cameras = path.cameras();
    let mut rasterizer = Rasterizer::new(Arc::clone(&settings.scene), settings.culling);
    let mut gbuffer = GBuffer::default();
    for k in 0..frames {
        let middle = (k > 0).then(|| path.at(k as f64 - 0.5));
        let truth_between = match &middle {
            Some(camera) => Some(native.render(camera, None)?.current.clone()),
            None => None,
        };
        let truth = native.render(&cameras[k], None)?.current.clone();
        if k > 0 {
            rows[NATIVE].milliseconds.push(milliseconds(native.as_ref(), &Stage::ALL));
        }
        rasterizer.rasterize(&cameras[k], &RasterSettings::new(Outputs::GBuffer), &mut gbuffer)?;
        let depth = gbuffer.geometry.as_ref().ok_or("expected a G-buffer with depth")?;
        let edges = DepthEdges::of(&depth.depth_median);
        for (i, method) in baselines.iter_mut().enumerate() {
            let image = method.render(&cameras[k], None)?.current.clone();
            let ms = milliseconds(method.as_ref(), &Stage::ALL);
            let row = &mut rows[BICUBIC + i];
            row.rendered.add(&truth, &image)?;
            row.rendered.add_faults(&truth, &image, &edges)?;
            if k > 0 {
                row.milliseconds.push(ms);
            }
            follow(row, &mut before[BICUBIC + i], &truth, image)?;
        }
        for (i, method) in ours.iter_mut().enumerate() {
            let [alone, whole] = [HISTORY + 2 * i, HISTORY + 2 * i + 1];
            let shown = method.render(&cameras[k], middle.as_ref())?;
            let (between, current) = (shown.in_between.cloned(), shown.current.clone());
            rows[alone].rendered.add(&truth, &current)?;
            rows[alone].rendered.add_faults(&truth, &current, &edges)?;
            rows[whole].rendered = rows[alone].rendered.clone();
            if let (Some(truth), Some(image)) = (&truth_between, between) {
                rows[whole].between.add(truth, &image)?;
                follow(&mut rows[whole], &mut before[whole], truth, image)?;
                rows[alone].milliseconds.push(milliseconds(method.as_ref(), &Stage::ALL[..3]));
                rows[whole].milliseconds.push(milliseconds(method.as_ref(), &Stage::ALL));
            }
            follow(&mut rows[alone], &mut before[alone], &truth, current.clone())?;
            follow(&mut rows[whole], &mut before[whole], &truth, current)?;
        }
    }
    Ok((rows, absent))
}
