//! Native frames with depth, rendered once and kept on disk while methods are judged against them.

use std::fs;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use gs3_raster::{Culling, Outputs, RasterSettings, Rasterizer};
use gs3_scene::{Camera, GBuffer, Image, Planes};
use rayon::prelude::*;

use super::cache::{at_path, write_whole};
use super::moment::Moment;
use super::results::TruthFacts;
use super::timeline::Timeline;
use super::{EvaluateError, Protocol};
use crate::metrics::{DepthEdges, WarpFrame, warping_error};

/// A native frame.
#[derive(Debug)]
pub(super) struct Truth {
    pub camera: Camera,
    pub image: Image,
    /// Median depth.
    pub depth: Planes<1>,
    /// Where it jumps.
    pub edges: DepthEdges,
}

impl Truth {
    /// `image`, which claims to be this frame, with this frame's motion.
    pub fn warp<'a>(&'a self, image: &'a Image) -> WarpFrame<'a> {
        WarpFrame { image, camera: &self.camera, depth: &self.depth }
    }
}

/// Frames are stored as 16-bit RGB: their rounding, 4e-6 rms, bounds PSNR at 108 dB, above the cap of the protocol.
const LEVELS: f32 = 65535.0;

/// The ground truth of all displayed frames, each rendered once.
pub(super) struct GroundTruth<'a> {
    timeline: &'a Timeline,
    rasterizer: Rasterizer,
    settings: RasterSettings,
    folder: PathBuf,
    gbuffer: GBuffer,
}

impl<'a> GroundTruth<'a> {
    pub fn new(protocol: &Protocol, timeline: &'a Timeline, cache: &Path) -> Self {
        let settings =
            RasterSettings { background: protocol.background, ..RasterSettings::new(Outputs::GBuffer) };
        Self {
            timeline,
            rasterizer: Rasterizer::new(Arc::clone(&protocol.reference), Culling::AccuTile),
            settings,
            folder: cache.join("frames"),
            gbuffer: GBuffer::default(),
        }
    }

    fn file(&self, Moment(moment): Moment) -> PathBuf {
        self.folder.join(format!("{moment:05}.bin"))
    }

    /// Renders the frame displayed at `moment` unless it is there.
    pub fn ensure(&mut self, moment: Moment) -> Result<(), EvaluateError> {
        let path = self.file(moment);
        if path.exists() {
            return Ok(());
        }
        fs::create_dir_all(&self.folder).map_err(at_path(&self.folder))?;
        self.rasterizer.rasterize(self.timeline.camera(moment), &self.settings, &mut self.gbuffer)?;
        let color: Vec<u16> =
            self.gbuffer.color.data().par_iter().map(|v| (v.clamp(0.0, 1.0) * LEVELS + 0.5) as u16).collect();
        let depth = self.gbuffer.geometry.as_ref().map_or(&[][..], |g| g.depth_median.data());
        write_whole(&path, |file| {
            file.write_all(bytemuck::cast_slice(&color))?;
            file.write_all(bytemuck::cast_slice(depth))
        })
    }

    /// The frame displayed at `moment`.
    pub fn load(&mut self, moment: Moment) -> Result<Arc<Truth>, EvaluateError> {
        self.ensure(moment)?;
        let camera = *self.timeline.camera(moment);
        let (width, height) = (camera.width() as usize, camera.height() as usize);
        let path = self.file(moment);
        let size = width * height;
        let mut color = vec![0u16; 3 * size];
        let mut depth = Planes::new(width, height);
        let mut file = fs::File::open(&path).map_err(at_path(&path))?;
        file.read_exact(bytemuck::cast_slice_mut(&mut color)).map_err(at_path(&path))?;
        file.read_exact(bytemuck::cast_slice_mut(depth.data_mut())).map_err(at_path(&path))?;
        let mut image = Image::new(width, height);
        image.pixels_mut().par_iter_mut().enumerate().for_each(|(i, pixel)| {
            let [r, g, b] = [0, 1, 2].map(|c| f32::from(color[c * size + i]) / LEVELS);
            *pixel = [r, g, b, 1.0];
        });
        let edges = DepthEdges::of(&depth);
        Ok(Arc::new(Truth { camera, image, depth, edges }))
    }

    /// What the ground truth says about itself where `in_between` frames lie between two rendered ones.
    pub fn facts(&mut self, in_between: u32) -> Result<TruthFacts, EvaluateError> {
        let (mut errors, mut distances, mut edge_shares) = (Vec::new(), Vec::new(), Vec::new());
        let mut last: Option<Arc<Truth>> = None;
        for moment in self.timeline.moments(in_between) {
            let truth = self.load(moment)?;
            edge_shares.push(truth.edges.share());
            if let Some(before) = last {
                errors.extend(warping_error([before.warp(&before.image), truth.warp(&truth.image)])?);
                distances.extend(motion(&before, &truth.camera));
            }
            last = Some(truth);
        }
        let mean =
            |values: &[f64]| (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64);
        Ok(TruthFacts {
            in_between,
            warping_error: mean(&errors),
            motion_px: mean(&distances),
            edge_share: mean(&edge_shares),
        })
    }

    /// Removes the stored frames.
    pub fn remove_frames(&self) -> Result<(), EvaluateError> {
        match fs::remove_dir_all(&self.folder) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(at_path(&self.folder)(error)),
            _ => Ok(()),
        }
    }
}

/// Median distance in pixels that visible surface points move from `from` to `to`, on a 64×36 lattice. None where
/// nothing is visible.
fn motion(from: &Truth, to: &Camera) -> Option<f64> {
    const LATTICE: (usize, usize) = (64, 36);
    let (width, height) = (from.image.width(), from.image.height());
    let mut distances = Vec::new();
    for j in 0..LATTICE.1 {
        for i in 0..LATTICE.0 {
            let (x, y) = ((2 * i + 1) * width / (2 * LATTICE.0), (2 * j + 1) * height / (2 * LATTICE.1));
            let depth = f64::from(from.depth.row(0, y)[x]);
            if depth > 0.0 {
                let pixel = glam::DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let (position, z) = to.project(from.camera.unproject(pixel, depth));
                distances.extend((z > 0.0).then(|| position.distance(pixel)));
            }
        }
    }
    distances.sort_by(f64::total_cmp);
    distances.get(distances.len() / 2).copied()
}
