//! Rasterization into the processor's memory, whatever machine does it.

#[cfg(feature = "gpu")]
use gs3_raster::GpuRasterizer;
use gs3_raster::{RasterSettings, Rasterizer};
use gs3_scene::{Camera, ExactBlocks, GBuffer, Image};

use crate::error::PipelineError;

/// A rasterizer whose planes are in the processor's memory, or come back there.
pub trait RasterizeHere {
    /// The low-resolution frame of `camera`, `scale` times coarser, into planes.
    fn rasterize(
        &mut self,
        camera: &Camera,
        scale: u32,
        settings: &RasterSettings,
        out: &mut GBuffer,
    ) -> Result<(), PipelineError>;

    /// Whether it makes exact blocks.
    fn makes_blocks(&self) -> bool;

    /// Exact blocks of the frame that [`Self::rasterize`] made last, if it makes any.
    fn rasterize_blocks(&mut self, places: &[[u16; 2]], out: &mut ExactBlocks) -> Result<(), PipelineError>;

    /// Into an image.
    fn rasterize_image(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut Image,
    ) -> Result<(), PipelineError>;
}

impl RasterizeHere for Rasterizer {
    fn rasterize(
        &mut self,
        camera: &Camera,
        scale: u32,
        settings: &RasterSettings,
        out: &mut GBuffer,
    ) -> Result<(), PipelineError> {
        Ok(self.rasterize_low_resolution(camera, scale, settings, out)?)
    }

    fn makes_blocks(&self) -> bool {
        true
    }

    fn rasterize_blocks(&mut self, places: &[[u16; 2]], out: &mut ExactBlocks) -> Result<(), PipelineError> {
        Ok(Self::rasterize_blocks(self, places, out)?)
    }

    fn rasterize_image(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut Image,
    ) -> Result<(), PipelineError> {
        Ok(Self::rasterize_image(self, camera, settings, out)?)
    }
}

#[cfg(feature = "gpu")]
impl RasterizeHere for GpuRasterizer {
    fn rasterize(
        &mut self,
        camera: &Camera,
        scale: u32,
        settings: &RasterSettings,
        out: &mut GBuffer,
    ) -> Result<(), PipelineError> {
        Ok(self.rasterize_to(&camera.low_resolution(scale), settings, out)?)
    }

    fn makes_blocks(&self) -> bool {
        false
    }

    fn rasterize_blocks(&mut self, _: &[[u16; 2]], out: &mut ExactBlocks) -> Result<(), PipelineError> {
        out.clear();
        Ok(())
    }

    fn rasterize_image(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut Image,
    ) -> Result<(), PipelineError> {
        Ok(Self::rasterize_image(self, camera, settings, out)?)
    }
}
