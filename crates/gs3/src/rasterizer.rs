//! Rasterization into the CPU's memory, on any machine.

#[cfg(feature = "gpu")]
use gs3_raster::GpuRasterizer;
use gs3_raster::{RasterSettings, Rasterizer};
use gs3_scene::{Camera, ExactBlocks, GBuffer, Image};

use crate::error::PipelineError;

/// A rasterizer with results in the CPU's memory, written there or read back. The futures are ready at the first poll. Only
/// those of a GPU in a browser wait for the event loop.
pub trait RasterizeHere {
    /// Rasterizes the LR frame of `camera`, `scale` times coarser, into planes.
    async fn rasterize(
        &mut self,
        camera: &Camera,
        scale: u32,
        settings: &RasterSettings,
        out: &mut GBuffer,
    ) -> Result<(), PipelineError>;

    /// Whether the rasterizer makes exact blocks.
    fn makes_blocks(&self) -> bool;

    /// Exact blocks of the last frame of [`Self::rasterize`], if the rasterizer makes exact blocks.
    fn rasterize_blocks(&mut self, places: &[[u16; 2]], out: &mut ExactBlocks) -> Result<(), PipelineError>;

    /// Exact blocks of the image of `camera`, colours alone, if the rasterizer makes exact blocks. [`Self::rasterize_blocks`] needs a
    /// new frame then.
    fn rasterize_image_blocks(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        places: &[[u16; 2]],
        out: &mut ExactBlocks,
    ) -> Result<(), PipelineError>;

    /// Rasterizes into an image.
    async fn rasterize_image(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut Image,
    ) -> Result<(), PipelineError>;
}

impl RasterizeHere for Rasterizer {
    async fn rasterize(
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

    fn rasterize_image_blocks(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        places: &[[u16; 2]],
        out: &mut ExactBlocks,
    ) -> Result<(), PipelineError> {
        Ok(Self::rasterize_image_blocks(self, camera, settings, places, out)?)
    }

    async fn rasterize_image(
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
    async fn rasterize(
        &mut self,
        camera: &Camera,
        scale: u32,
        settings: &RasterSettings,
        out: &mut GBuffer,
    ) -> Result<(), PipelineError> {
        Ok(self.rasterize_to_async(&camera.low_resolution(scale), settings, out).await?)
    }

    fn makes_blocks(&self) -> bool {
        false
    }

    fn rasterize_blocks(&mut self, _: &[[u16; 2]], out: &mut ExactBlocks) -> Result<(), PipelineError> {
        out.clear();
        Ok(())
    }

    fn rasterize_image_blocks(
        &mut self,
        _: &Camera,
        _: &RasterSettings,
        _: &[[u16; 2]],
        out: &mut ExactBlocks,
    ) -> Result<(), PipelineError> {
        out.clear();
        Ok(())
    }

    async fn rasterize_image(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut Image,
    ) -> Result<(), PipelineError> {
        Ok(self.rasterize_image_async(camera, settings, out).await?)
    }
}
