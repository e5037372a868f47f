//! Native frames with depth, rendered once and kept on disk while methods are judged against them.

use std::fs;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use gs3_raster::{Culling, Outputs, RasterSettings, Rasterizer};
use gs3_scene::{Camera, GBuffer, Image, Planes};
use rayon::prelude::*;

use super::cache::{at_path, write_whole};
use super::results::{Subset, TruthFacts};
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

/// The ground truth of all displayed frames.
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

    fn file(&self, index: usize) -> PathBuf {
        self.folder.join(format!("{index:05}.bin"))
    }

    /// Renders displayed frame `index` unless it is there.
    pub fn ensure(&mut self, index: usize) -> Result<(), EvaluateError> {
        let path = self.file(index);
        if path.exists() {
            return Ok(());
        }
        fs::create_dir_all(&self.folder).map_err(at_path(&self.folder))?;
        self.rasterizer.rasterize(self.timeline.displayed(index), &self.settings, &mut self.gbuffer)?;
        let color: Vec<u16> =
            self.gbuffer.color.data().par_iter().map(|v| (v.clamp(0.0, 1.0) * LEVELS + 0.5) as u16).collect();
        let depth = self.gbuffer.geometry.as_ref().map_or(&[][..], |g| g.depth_median.data());
        write_whole(&path, |file| {
            file.write_all(bytemuck::cast_slice(&color))?;
            file.write_all(bytemuck::cast_slice(depth))
        })
    }

    /// Displayed frame `index`.
    pub fn load(&mut self, index: usize) -> Result<Arc<Truth>, EvaluateError> {
        self.ensure(index)?;
        let camera = *self.timeline.displayed(index);
        let (width, height) = (camera.width() as usize, camera.height() as usize);
        let path = self.file(index);
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

    /// What the ground truth says about itself: its own warping error and the speed of its motion.
    pub fn facts(&mut self) -> Result<TruthFacts, EvaluateError> {
        let mut warping = [const { Vec::new() }; 3];
        let mut speeds = [const { Vec::new() }; 2];
        let mut edge_shares = Vec::new();
        let mut recent: Vec<Arc<Truth>> = Vec::new();
        for index in 0..self.timeline.displayed_count() {
            let truth = self.load(index)?;
            let subset = Subset::of_displayed(index);
            edge_shares.push(truth.edges.share());
            for (subset, back) in [(Subset::All, 1), (subset, 2)] {
                let Some(before) = recent.len().checked_sub(back).map(|i| &recent[i]) else { continue };
                let error = warping_error([before.warp(&before.image), truth.warp(&truth.image)])?;
                warping[subset as usize].extend(error);
                speeds[back - 1].extend(motion(before, &truth.camera));
            }
            if recent.len() == 2 {
                recent.remove(0);
            }
            recent.push(truth);
        }
        let mean =
            |values: &[f64]| (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64);
        let [displayed, rendered] = speeds;
        Ok(TruthFacts {
            warping_error: Subset::EACH.map(|subset| mean(&warping[subset as usize])),
            motion_px_per_displayed_frame: mean(&displayed),
            motion_px_per_rendered_frame: mean(&rendered),
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
