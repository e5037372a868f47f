//! Writing the PLY of 3D Gaussian Splatting: binary little endian, f32, the trainer's properties in its order.

use std::io::{self, Write};

use glam::DVec3;

use super::super::activation::{log_scale, logit};
use super::super::rows::write_rows;
use super::comments::vertical_axis;
use crate::scene::{OpacityMode, Scene};

/// Writes `scene`. Positions are in double precision if the scene has an origin of its own. 3D Gaussian Splatting declares
/// normals and never uses them; they are written as zeros, since some readers count on them.
pub(in super::super) fn write(scene: &Scene, writer: &mut impl Write) -> io::Result<()> {
    let gaussians = scene.gaussians();
    let rest = gaussians.sh_stride() - 3;
    writer.write_all(header(scene, rest).as_bytes())?;
    let origin = scene.details().origin;
    let is_precise = origin != DVec3::ZERO;
    let position_bytes = if is_precise { 24 } else { 12 };
    let row_bytes = position_bytes + (14 + rest) * size_of::<f32>();
    write_rows(writer, gaussians.len(), row_bytes, |i, row| {
        let sh = gaussians.sh_of(i);
        let scale = gaussians.scale(i).map(log_scale);
        // Channel-major, unlike in memory.
        let sh_rest = (0..rest).map(|k| sh[3 + k % (rest / 3) * 3 + k / (rest / 3)]);
        let (position, row) = row.split_at_mut(position_bytes);
        let mean = gaussians.mean(i);
        if is_precise {
            for (axis, bytes) in position.as_chunks_mut::<8>().0.iter_mut().enumerate() {
                *bytes = (f64::from(mean[axis]) + origin[axis]).to_le_bytes();
            }
        } else {
            for (bytes, value) in position.as_chunks_mut::<4>().0.iter_mut().zip(mean) {
                *bytes = value.to_le_bytes();
            }
        }
        let values = ([0.0; 3].into_iter())
            .chain([sh[0], sh[1], sh[2]])
            .chain(sh_rest)
            .chain([logit(gaussians.opacities[i])])
            .chain(scale)
            .chain(gaussians.rotation(i));
        for (bytes, value) in row.as_chunks_mut::<4>().0.iter_mut().zip(values) {
            *bytes = value.to_le_bytes();
        }
    })
}

fn header(scene: &Scene, rest: usize) -> String {
    let mut header = String::from("ply\nformat binary_little_endian 1.0\n") + &comments(scene);
    let details = scene.details();
    header += &format!("element vertex {}\n", scene.gaussians().len());
    let position = if details.origin == DVec3::ZERO { "float" } else { "double" };
    for axis in ["x", "y", "z"] {
        header += &format!("property {position} {axis}\n");
    }
    let names = ["nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"].map(str::to_owned);
    let rest = (0..rest).map(|i| format!("f_rest_{i}"));
    let last = ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];
    for name in names.into_iter().chain(rest).chain(last.map(str::to_owned)) {
        header += &format!("property float {name}\n");
    }
    header + "end_header\n"
}

/// What a header says of the picture in comments.
pub(super) fn comments(scene: &Scene) -> String {
    let mut comments = String::new();
    if scene.opacity_mode() == OpacityMode::Antialiased {
        comments += "comment SplatRenderMode: mip\ncomment antialiased 1\n";
    }
    if let Some(up) = scene.details().up {
        comments += &format!("comment Vertical Axis: {}\n", vertical_axis(up));
    }
    comments
}
