//! The machine that rasterizes.

use std::sync::Arc;

#[cfg(feature = "gpu")]
use gs3_raster::GpuRasterizer;
use gs3_raster::{Culling, RasterSettings, Rasterizer};
use gs3_scene::{Camera, GBuffer, Image, Scene};

use crate::error::PipelineError;

pub enum AnyRasterizer {
    Cpu(Rasterizer),
    #[cfg(feature = "gpu")]
    Gpu(Box<GpuRasterizer>),
}

impl AnyRasterizer {
    pub fn cpu(scene: Arc<Scene>, culling: Culling) -> Self {
        Self::Cpu(Rasterizer::new(scene, culling))
    }

    #[cfg(feature = "gpu")]
    pub fn gpu(gpu: &gs3_compute::Gpu, scene: Arc<Scene>, culling: Culling) -> Result<Self, PipelineError> {
        let precision = gs3_raster::ScenePrecision::default();
        Ok(Self::Gpu(Box::new(GpuRasterizer::new(gpu, scene, culling, precision)?)))
    }

    /// The same machine with another scene.
    pub fn with_scene(&self, scene: Arc<Scene>, culling: Culling) -> Result<Self, PipelineError> {
        match self {
            Self::Cpu(_) => Ok(Self::cpu(scene, culling)),
            #[cfg(feature = "gpu")]
            Self::Gpu(rasterizer) => Self::gpu(rasterizer.gpu(), scene, culling),
        }
    }

    /// The GPU's rasterizer, if it is one.
    #[cfg(feature = "gpu")]
    pub fn gpu_mut(&mut self) -> Option<&mut GpuRasterizer> {
        match self {
            Self::Cpu(_) => None,
            Self::Gpu(rasterizer) => Some(rasterizer),
        }
    }

    pub const fn scene(&self) -> &Arc<Scene> {
        match self {
            Self::Cpu(rasterizer) => rasterizer.scene(),
            #[cfg(feature = "gpu")]
            Self::Gpu(rasterizer) => rasterizer.scene(),
        }
    }

    /// Splats of the last frame, where they are counted here.
    pub fn visible_count(&self) -> Option<usize> {
        match self {
            Self::Cpu(rasterizer) => Some(rasterizer.visible_count()),
            #[cfg(feature = "gpu")]
            Self::Gpu(_) => None,
        }
    }

    /// Into planes in the processor's memory.
    pub fn rasterize(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut GBuffer,
    ) -> Result<(), PipelineError> {
        match self {
            Self::Cpu(rasterizer) => Ok(rasterizer.rasterize(camera, settings, out)?),
            #[cfg(feature = "gpu")]
            Self::Gpu(rasterizer) => Ok(rasterizer.rasterize_to(camera, settings, out)?),
        }
    }

    /// Into an image in the processor's memory.
    pub fn rasterize_image(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut Image,
    ) -> Result<(), PipelineError> {
        match self {
            Self::Cpu(rasterizer) => Ok(rasterizer.rasterize_image(camera, settings, out)?),
            #[cfg(feature = "gpu")]
            Self::Gpu(rasterizer) => Ok(rasterizer.rasterize_image(camera, settings, out)?),
        }
    }
}
