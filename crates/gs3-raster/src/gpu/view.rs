//! The camera in device memory.

use bytemuck::{Pod, Zeroable};

use crate::chunk::Frustum;
use crate::settings::RasterSettings;
use crate::view::View;

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
    _pad3: u32,
}

impl ViewUniform {
    /// The view of a frame in planes with rows `stride` pixels apart.
    pub fn new(view: &View, settings: &RasterSettings, stride: u32) -> Self {
        let frustum = Frustum::new(view);
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
            size: view.size,
            stride,
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
                _pad3,
            }
        );
    }
}
