//! Copies the picture out of a frame with a margin.

use bytemuck::{Pod, Zeroable};
use gs3_compute::{Bound, Buffer, Gpu, GpuError, Kernel, Recorder, Use};

use super::gbuffer::GpuGBuffer;

/// Sides of the workgroups of `crop.wgsl`.
pub const GROUP: [u32; 2] = [64, 4];

/// `Crop` of `crop.wgsl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct CropUniform {
    size: [u32; 2],
    first: [u32; 2],
    stride: u32,
    _pad: u32,
}

/// The kernels that copy a picture, one per plane, and the copy's parameters. They belong to the picture, because
/// other rasterizers may also make frames into it.
#[derive(Default)]
pub struct BoundCrop {
    /// Number of the planes that the picture is copied from.
    padded: u64,
    planes: Vec<Bound>,
    uniform: Option<Buffer>,
}

/// Records the copy of the picture of `padded`, without its margin, into `picture`, which has the picture's size.
pub fn record(
    kernel: &Kernel,
    gpu: &Gpu,
    recorder: &mut Recorder<'_>,
    padded: &GpuGBuffer,
    picture: &mut GpuGBuffer,
) -> Result<(), GpuError> {
    if picture.crop.padded != padded.made() {
        let uniform = gpu.buffer("crop", Use::Uniform, size_of::<CropUniform>() as u64)?;
        let bind = |((_, from), (_, to)): (&(_, Buffer), &(_, Buffer))| {
            let buffers = [("crop", uniform.slice()), ("padded", from.slice()), ("picture", to.slice())];
            kernel.bind(gpu, &buffers)
        };
        let planes = padded.planes().iter().zip(picture.planes()).map(bind).collect::<Result<_, _>>()?;
        picture.crop = BoundCrop { padded: padded.made(), planes, uniform: Some(uniform) };
    }
    let (size, margin) = (picture.size(), padded.margin());
    let place = CropUniform {
        size: size.to_array(),
        first: [margin.left, margin.top],
        stride: padded.stride(),
        _pad: 0,
    };
    if let Some(uniform) = &picture.crop.uniform {
        recorder.write(&uniform.slice(), &[place])?;
    }
    let groups = [size.width.div_ceil(GROUP[0]), size.height.div_ceil(GROUP[1]), 1];
    for plane in &picture.crop.planes {
        recorder.dispatch(plane, groups);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use gs3_compute::assert_layout;

    use super::*;

    #[test]
    fn layout_is_that_of_the_shader() {
        assert_layout!(&[&crate::gpu::shaders::crop()], Crop, CropUniform { size, first, stride, _pad });
    }
}
