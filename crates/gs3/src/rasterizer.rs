//! Rasterization into the processor's memory, whatever machine does it.

#[cfg(feature = "gpu")]
use gs3_raster::GpuRasterizer;
use gs3_raster::{RasterSettings, Rasterizer};
use gs3_scene::{Camera, GBuffer, Image};

use crate::error::PipelineError;

/// A rasterizer whose planes are in the processor's memory, or come back there.
pub trait RasterizeHere {
    /// Into planes.
    fn rasterize(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut GBuffer,
    ) -> Result<(), PipelineError>;

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
        settings: &RasterSettings,
        out: &mut GBuffer,
    ) -> Result<(), PipelineError> {
        Ok(Self::rasterize(self, camera, settings, out)?)
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
        settings: &RasterSettings,
        out: &mut GBuffer,
    ) -> Result<(), PipelineError> {
        Ok(self.rasterize_to(camera, settings, out)?)
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
