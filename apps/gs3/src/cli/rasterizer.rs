//! Rasterization without a pipeline: on a machine, or on the CPU where that machine is a GPU that was found and fails.

use std::sync::Arc;

use gs3::raster::{
    GpuRasterError, GpuRasterizer, Outputs, RasterError, RasterSettings, Rasterizer, ScenePrecision, Window,
};
use gs3::scene::{Camera, GBuffer, Image, Scene};
use gs3::{Culling, Machine, PipelineError, PipelineSettings};

use super::backend;
use super::error::CliError;

/// Rasterizes a scene for as long as a run lasts.
pub struct MachineRasterizer {
    scene: Arc<Scene>,
    culling: Culling,
    on: On,
    /// Whether the CPU takes over from the GPU.
    may_change: bool,
}

enum On {
    Cpu(Box<Rasterizer>),
    Gpu(Box<GpuRasterizer>),
}

/// What a native frame with `settings` is rasterized with.
pub fn native(settings: &PipelineSettings, outputs: Outputs) -> RasterSettings {
    RasterSettings {
        dilation: settings.dilation.at_scale(1),
        background: settings.background,
        ..RasterSettings::new(outputs)
    }
}

impl MachineRasterizer {
    /// A rasterizer of `scene` on `machine`.
    pub fn new(scene: &Arc<Scene>, culling: Culling, machine: &Machine) -> Result<Self, CliError> {
        let may_change = matches!(machine, Machine::FoundGpu(_));
        let on_gpu = |gpu| GpuRasterizer::new(gpu, Arc::clone(scene), culling, ScenePrecision::default());
        let on = match machine.gpu().map(on_gpu) {
            None => None,
            Some(Ok(on_gpu)) => Some(On::Gpu(Box::new(on_gpu))),
            Some(Err(error)) if may_change => {
                backend::tell_take_over(&error);
                None
            }
            Some(Err(error)) => return Err(PipelineError::from(error).into()),
        };
        let on = on.unwrap_or_else(|| On::Cpu(Box::new(Rasterizer::new(Arc::clone(scene), culling))));
        Ok(Self { scene: Arc::clone(scene), culling, on, may_change })
    }

    /// The G-buffer of the frame of `camera`.
    pub fn gbuffer(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut GBuffer,
    ) -> Result<(), CliError> {
        self.run(
            out,
            |cpu, out| cpu.rasterize(camera, settings, out),
            |gpu, out| gpu.rasterize_to(camera, settings, out),
        )
    }

    /// Colour and alpha of a `window` of the frame of `camera`.
    pub fn window(
        &mut self,
        camera: &Camera,
        window: Window,
        settings: &RasterSettings,
        out: &mut Image,
    ) -> Result<(), CliError> {
        self.run(
            out,
            |cpu, out| cpu.rasterize_window(camera, window, settings, out),
            |gpu, out| gpu.rasterize_window(camera, window, settings, out),
        )
    }

    /// Whether the last frame showed no Gaussian, where that is known.
    pub fn is_blank(&self) -> bool {
        match &self.on {
            On::Cpu(cpu) => cpu.visible_count() == 0,
            On::Gpu(_) => false,
        }
    }

    fn run<T>(
        &mut self,
        out: &mut T,
        on_cpu: impl Fn(&mut Rasterizer, &mut T) -> Result<(), RasterError>,
        on_gpu: impl Fn(&mut GpuRasterizer, &mut T) -> Result<(), GpuRasterError>,
    ) -> Result<(), CliError> {
        loop {
            match &mut self.on {
                On::Cpu(cpu) => return Ok(on_cpu(cpu, out)?),
                On::Gpu(gpu) => match on_gpu(gpu, out) {
                    Ok(()) => return Ok(()),
                    Err(error) if self.may_change => backend::tell_take_over(&error),
                    Err(error) => return Err(PipelineError::from(error).into()),
                },
            }
            self.on = On::Cpu(Box::new(Rasterizer::new(Arc::clone(&self.scene), self.culling)));
        }
    }
}
