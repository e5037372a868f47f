//! The picture out of a frame with a margin around it.

use bytemuck::{Pod, Zeroable};
use gs3_compute::{Bound, Buffer, Gpu, GpuError, Kernel, Recorder, Use};

use super::gbuffer::GpuGBuffer;
use super::shaders;

/// Sides of the workgroups of `crop.wgsl`.
const GROUP: [u32; 2] = [64, 4];

/// `Crop` of `crop.wgsl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct CropUniform {
    size: [u32; 2],
    first: [u32; 2],
    stride: u32,
    _pad: u32,
}

/// Copies pictures.
pub struct Crop {
    kernel: Kernel,
    uniform: Buffer,
}

/// A kernel for each plane of a picture, and which planes it is copied from.
#[derive(Default)]
pub struct BoundCrop {
    around: u64,
    planes: Vec<Bound>,
}

impl Crop {
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let kernel = gpu.module("crop", &shaders::CROP)?.kernel(gpu, "copy_picture", &[])?;
        Ok(Self { kernel, uniform: gpu.buffer("crop", Use::Uniform, size_of::<CropUniform>() as u64)? })
    }

    /// Records the picture of `around`, without its margin, into `picture`, which has been made for its size.
    pub fn record(
        &self,
        gpu: &Gpu,
        recorder: &mut Recorder<'_>,
        around: &GpuGBuffer,
        picture: &mut GpuGBuffer,
    ) -> Result<(), GpuError> {
        if picture.crop.around != around.made() {
            let bind = |((_, from), (_, to)): (&(_, Buffer), &(_, Buffer))| {
                let buffers =
                    [("crop", self.uniform.slice()), ("around", from.slice()), ("picture", to.slice())];
                self.kernel.bind(gpu, &buffers)
            };
            let planes = around.planes().iter().zip(picture.planes()).map(bind).collect::<Result<_, _>>()?;
            picture.crop = BoundCrop { around: around.made(), planes };
        }
        let (size, margin) = (picture.size(), around.margin());
        let first = [margin.left, margin.top];
        gpu.write(&self.uniform.slice(), &[CropUniform { size, first, stride: around.stride(), _pad: 0 }])?;
        let groups = [size[0].div_ceil(GROUP[0]), size[1].div_ceil(GROUP[1]), 1];
        for plane in &picture.crop.planes {
            recorder.dispatch(plane, groups);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::layout::assert_layout;

    #[test]
    fn layout_is_that_of_the_shader() {
        assert_layout!(include_str!("crop.wgsl"), Crop, CropUniform { size, first, stride, _pad });
    }
}
