//! WGSL modules, their entry points, and entry points with their buffers.

use std::sync::Arc;

use crate::allocations::count;
use crate::buffer::Slice;
use crate::device_id::DeviceId;
use crate::error::GpuError;
use crate::gpu::Gpu;
use crate::wgsl::{Binding, Reflected};

/// A valid WGSL module. All its buffers are in group 0.
#[derive(Clone, Debug)]
pub struct Module {
    label: String,
    device_id: DeviceId,
    raw: wgpu::ShaderModule,
    reflected: Arc<Reflected>,
}

/// An entry point, compiled.
#[derive(Clone, Debug)]
pub struct Kernel {
    label: String,
    device_id: DeviceId,
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
    declared: Vec<Binding>,
}

/// A kernel with its buffers.
#[derive(Clone, Debug)]
pub struct Bound {
    pub(crate) device_id: DeviceId,
    pub(crate) pipeline: wgpu::ComputePipeline,
    pub(crate) group: wgpu::BindGroup,
}

impl Gpu {
    /// A module of WGSL: `sources` one after the other. Its loops must end: they are not counted.
    ///
    /// # Errors
    /// [`GpuError::Shader`] if it is not valid.
    pub fn module(&self, label: &str, sources: &[&str]) -> Result<Module, GpuError> {
        Module::new(self, label, sources)
    }
}

impl Module {
    fn new(gpu: &Gpu, label: &str, sources: &[&str]) -> Result<Self, GpuError> {
        let source = sources.concat();
        let reflected = Arc::new(Reflected::new(label, &source)?);
        let descriptor = wgpu::ShaderModuleDescriptor {
            label: Some(label),
            source: wgpu::ShaderSource::Wgsl(source.into()),
        };
        let raw = gpu
            .checked(label, 0, || created(&gpu.device, descriptor))
            .map_err(|error| as_shader_error(label, error))?;
        Ok(Self { label: label.to_owned(), device_id: gpu.device_id, raw, reflected })
    }

    /// The module's entry point `entry`, with `override` constants. Workgroup memory is not cleared before it runs.
    ///
    /// # Errors
    /// [`GpuError::Shader`] if there is none, or the driver refuses it.
    pub fn kernel(&self, gpu: &Gpu, entry: &str, constants: &[(&str, f64)]) -> Result<Kernel, GpuError> {
        gpu.device_id.check(self.device_id, "a shader module")?;
        let label = format!("{}.{entry}", self.label);
        let declared = self.reflected.bindings(&label, entry)?;
        let entries: Vec<wgpu::BindGroupLayoutEntry> = declared
            .iter()
            .map(|d| wgpu::BindGroupLayoutEntry {
                binding: d.number,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: wgpu::BindingType::Buffer { ty: d.ty, has_dynamic_offset: false, min_binding_size: None },
                count: None,
            })
            .collect();
        let created = gpu.checked(&label, 0, || {
            let descriptor = wgpu::BindGroupLayoutDescriptor { label: Some(&label), entries: &entries };
            let layout = gpu.device.create_bind_group_layout(&descriptor);
            let pipeline_layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(&label),
                bind_group_layouts: &[Some(&layout)],
                immediate_size: 0,
            });
            count(&gpu.counts.kernels);
            let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(&label),
                layout: Some(&pipeline_layout),
                module: &self.raw,
                entry_point: Some(entry),
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants,
                    zero_initialize_workgroup_memory: false,
                },
                cache: None,
            });
            (layout, pipeline)
        });
        let (layout, pipeline) = created.map_err(|error| as_shader_error(&label, error))?;
        Ok(Kernel { label, device_id: gpu.device_id, pipeline, layout, declared })
    }
}

/// The module, without the counter that wgpu adds to every loop to make it end: the counter has 64 bits, is tested in
/// each round, and prevents unrolling. All other checks stay.
#[allow(unsafe_code, reason = "wgpu asks for it where a check is left out")]
fn created(device: &wgpu::Device, descriptor: wgpu::ShaderModuleDescriptor<'_>) -> wgpu::ShaderModule {
    let checks =
        wgpu::ShaderRuntimeChecks { force_loop_bounding: false, ..wgpu::ShaderRuntimeChecks::checked() };
    // SAFETY: kernels must have loops that end ([`Gpu::module`]). Loops of gs3 run over counts, the lists that they
    // follow have no cycles, and waiting for another workgroup stops after a limited number of reads.
    unsafe { device.create_shader_module_trusted(descriptor, checks) }
}

impl Kernel {
    /// The kernel with a buffer for each name that its shader declares and uses. Names that the module declares for
    /// other entry points may be there too.
    ///
    /// # Errors
    /// [`GpuError::Bindings`] if one is missing, [`GpuError::TooLarge`] if one is longer than a binding may be.
    pub fn bind(&self, gpu: &Gpu, buffers: &[(&str, Slice<'_>)]) -> Result<Bound, GpuError> {
        gpu.device_id.check(self.device_id, "a kernel")?;
        let max = gpu.capabilities().limits.binding_bytes;
        let mut entries = Vec::with_capacity(self.declared.len());
        for declared in &self.declared {
            let Some((name, slice)) = buffers.iter().find(|(name, _)| *name == declared.name) else {
                let names = |names: Vec<&str>| names.join(", ");
                return Err(GpuError::Bindings {
                    kernel: self.label.clone(),
                    expected: names(self.declared.iter().map(|d| d.name.as_str()).collect()),
                    actual: names(buffers.iter().map(|b| b.0).collect()),
                });
            };
            gpu.device_id.check(slice.buffer.device_id, "a buffer that a kernel is to use")?;
            if slice.bytes > max {
                let what = format!("bytes of {name} of kernel {}", self.label);
                return Err(GpuError::TooLarge { what, max, actual: slice.bytes });
            }
            entries.push(wgpu::BindGroupEntry { binding: declared.number, resource: slice.binding() });
        }
        let descriptor =
            wgpu::BindGroupDescriptor { label: Some(&self.label), layout: &self.layout, entries: &entries };
        count(&gpu.counts.bindings);
        let group = gpu.checked(&self.label, 0, || gpu.device.create_bind_group(&descriptor))?;
        Ok(Bound { device_id: self.device_id, pipeline: self.pipeline.clone(), group })
    }
}

/// Converts a refusal of a shader or pipeline to a shader error.
fn as_shader_error(label: &str, error: GpuError) -> GpuError {
    match error {
        GpuError::Refused { message, .. } => GpuError::Shader { label: label.to_owned(), message },
        other => other,
    }
}
