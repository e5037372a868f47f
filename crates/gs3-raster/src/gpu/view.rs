//! The camera in device memory.

use bytemuck::{Pod, Zeroable};
use gs3_scene::Size;

use crate::chunk::Frustum;
use crate::settings::RasterSettings;
use crate::view::{View, first_sample};

/// The part of a [`View`] that kernels read; `View` of `view.wgsl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct ViewUniform {
    rotation: [[f32; 4]; 3],
    frustum: [[f32; 4]; 4],
    origin: [f32; 3],
    dilation: f32,
    origin_rest: [f32; 3],
    near: f32,
    background: [f32; 3],
    _pad2: f32,
    focal: [f32; 2],
    center: [f32; 2],
    jacobian_low: [f32; 2],
    jacobian_high: [f32; 2],
    size: [u32; 2],
    stride: u32,
    scale: u32,
    cell_before: [f32; 2],
    cell_after: [f32; 2],
    picture: [u32; 2],
    margin: [u32; 2],
    first_sample: [f32; 2],
    has_blocks: u32,
    _pad3: u32,
}

/// The native picture between the samples of a low-resolution frame.
#[derive(Clone, Copy, Debug)]
pub struct Native {
    /// How many times coarser the frame is.
    pub scale: u32,
    /// The picture's size.
    pub size: Size,
}

impl ViewUniform {
    /// The view of a frame in planes with rows `stride` pixels apart. With `native`, splats that reach its pixels alone
    /// are projected as well.
    pub fn new(view: &View, settings: &RasterSettings, stride: u32, native: Option<Native>) -> Self {
        let Native { scale, size: picture } = native.unwrap_or(Native { scale: 1, size: view.size });
        let first =
            first_sample(scale, settings.jitter).map(|first| if native.is_some() { first } else { 0.0 });
        let scale_f64 = f64::from(scale);
        let last = scale_f64 - 1.0;
        // Native pixels lie less than two samples' distances beyond the outermost samples, with jitter up to one.
        let beyond = 2 * u32::from(native.is_some());
        let widened = View {
            size: view.size.map(|side| side + beyond),
            before: view.before.map(|before| before + beyond as f32),
            ..*view
        };
        let frustum = Frustum::new(&widened);
        Self {
            rotation: view.rotation.map(|[x, y, z]| [x, y, z, 0.0]),
            frustum: frustum.planes.map(|(_, [a, b, length], spread)| [a, b, length, spread]),
            origin: view.origin,
            dilation: view.dilation,
            origin_rest: view.rotation.map(|row| {
                let products =
                    row.iter().zip(view.origin_rest).map(|(r, rest)| f64::from(*r) * f64::from(rest));
                products.sum::<f64>() as f32
            }),
            near: view.near,
            background: settings.background,
            _pad2: 0.0,
            focal: view.focal,
            center: view.center,
            jacobian_low: view.jacobian_limits.map(|[low, _]| low),
            jacobian_high: view.jacobian_limits.map(|[_, high]| high),
            size: view.size.to_array(),
            stride,
            scale,
            cell_before: first.map(|first| (first.max(0.0) / scale_f64) as f32),
            cell_after: first.map(|first| ((last - first).max(0.0) / scale_f64) as f32),
            picture: picture.to_array(),
            margin: [settings.margin.left, settings.margin.top],
            first_sample: first.map(|first| first as f32),
            has_blocks: u32::from(native.is_some()),
            _pad3: 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use gs3_compute::assert_layout;

    use super::*;

    #[test]
    fn layout_is_that_of_the_shader() {
        assert_layout!(
            &[include_str!("view.wgsl")],
            View,
            ViewUniform {
                rotation,
                frustum,
                origin,
                dilation,
                origin_rest,
                near,
                background,
                _pad2,
                focal,
                center,
                jacobian_low,
                jacobian_high,
                size,
                stride,
                scale,
                cell_before,
                cell_after,
                picture,
                margin,
                first_sample,
                has_blocks,
                _pad3,
            }
        );
    }
}
