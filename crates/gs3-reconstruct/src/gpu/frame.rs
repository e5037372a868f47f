//! Data of a frame for all kernels of super sampling: the layouts of `frame.wgsl`.

use bytemuck::{Pod, Zeroable};
use gs3_scene::Camera;

use crate::reprojection::{Reprojection, parallax};
use crate::settings::{MAX_LAYERS, MAX_PAST};

/// LR frames and layers in the history.
pub const MAX_SOURCES: usize = MAX_PAST + MAX_LAYERS;

/// Phases of pixels within an LR pixel.
pub const PHASES: usize = crate::MAX_SCALE as usize;

/// `Past` of `frame.wgsl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct PastUniform {
    pub rows: [[f32; 4]; 3],
    pub offset: [f32; 2],
    pub first: u32,
    pub parallax: f32,
    pub extent: [u32; 2],
    pub count: u32,
    pub age: u32,
}

/// `Frame` of `frame.wgsl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct FrameUniform {
    pub size: [u32; 2],
    pub lr: [u32; 2],
    pub scale: u32,
    pub frames: u32,
    pub layers: u32,
    pub first_of_blocks: u32,
    pub cell_offset: [f32; 2],
    pub first_sampled: [u32; 2],
    pub padded: [u32; 2],
    pub first_of_corners: u32,
    pub _pad: u32,
    pub x_places: [[f32; 4]; PHASES],
    pub y_places: [[f32; 4]; PHASES],
    pub past: [PastUniform; MAX_SOURCES],
}

impl PastUniform {
    /// A frame of camera `past` as `current` sees it, without samples.
    pub fn between(past: &Camera, current: &Camera) -> Self {
        let rows = rows(&Reprojection::new(past, current));
        Self { rows, parallax: parallax(past, current), ..Self::zeroed() }
    }
}

/// Rows of the homography, and the epipole, as kernels read them.
pub fn rows(reprojection: &Reprojection) -> [[f32; 4]; 3] {
    let Reprojection { rows, epipole, .. } = reprojection;
    std::array::from_fn(|k| [rows[k][0], rows[k][1], rows[k][2], epipole[k]])
}

#[cfg(test)]
mod tests {
    use gs3_compute::assert_layout;

    use super::*;

    #[test]
    fn layouts_are_those_of_the_shader() {
        let source = include_str!("frame.wgsl");
        assert_layout!(&[source], Past, PastUniform { rows, offset, first, parallax, extent, count, age });
        assert_layout!(
            &[source],
            Frame,
            FrameUniform {
                size,
                lr,
                scale,
                frames,
                layers,
                first_of_blocks,
                cell_offset,
                first_sampled,
                padded,
                first_of_corners,
                _pad,
                x_places,
                y_places,
                past
            }
        );
    }
}
