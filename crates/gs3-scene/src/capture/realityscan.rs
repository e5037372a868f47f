//! Cameras as RealityScan (RealityCapture) exports them: a CSV table of position, heading, pitch and roll, focal length
//! in millimetres of 36 mm film, and Brown's distortion. The pictures beside the file tell the image sizes.

use std::collections::HashMap;

use glam::{DMat3, DVec3};

use super::context::Context;
use super::order::in_order;
use super::{CaptureFault, Captured, Photo, camera_from_world_pose, path_through};
use crate::camera::Intrinsics;
use crate::format::quoted;
use crate::lens::Lens;
use crate::size::Size;

/// Width of the film that focal lengths are given for, millimetres.
const FILM: f64 = 36.0;

/// Columns that must be there.
const REQUIRED: [&str; 8] = ["name", "x", "y", "alt", "heading", "pitch", "roll", "f"];

/// Columns that may be there.
const OPTIONAL: [&str; 8] = ["px", "py", "k1", "k2", "k3", "k4", "t1", "t2"];

/// Whether `bytes` begin as such a table.
#[cfg(feature = "fs")]
pub(super) fn is_table(bytes: &[u8]) -> bool {
    let line = bytes.split(|byte| *byte == b'\n').next().unwrap_or_default();
    let line = String::from_utf8_lossy(&line[..line.len().min(1000)]).to_ascii_lowercase();
    ["name", "heading", "pitch", "roll", "alt"].iter().all(|column| line.contains(column))
}

pub(super) fn parse(bytes: &[u8], context: &Context<'_>) -> Result<Captured, CaptureFault> {
    let text = String::from_utf8_lossy(bytes);
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let header = lines.next().map(|(_, line)| line.trim_start_matches(['#', '\u{feff}'])).unwrap_or_default();
    let columns: HashMap<String, usize> =
        header.split(',').enumerate().map(|(k, name)| (name.trim().to_ascii_lowercase(), k)).collect();
    for name in REQUIRED {
        if !columns.contains_key(name) {
            return Err(CaptureFault::field("line 1", &format!("a column {name}"), quoted(header)));
        }
    }
    let is_known = |name: &str| REQUIRED.contains(&name) || OPTIONAL.contains(&name) || name.is_empty();
    context.note_unknown(columns.keys().filter(|name| !is_known(name)).map(|name| quoted(name)).collect());
    let mut photos = Vec::new();
    for (index, line) in lines {
        let field = format!("line {}", index + 1);
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let number = |name: &str| match columns.get(name).and_then(|k| cells.get(*k)) {
            None if OPTIONAL.contains(&name) => Ok(0.0),
            Some(cell) => (cell.parse().ok().filter(|value: &f64| value.is_finite()))
                .ok_or_else(|| CaptureFault::field(&format!("{field} {name}"), "a number", quoted(cell))),
            None => Err(CaptureFault::field(&format!("{field} {name}"), "a number", "nothing")),
        };
        let name = cells.get(columns["name"]).copied().unwrap_or_default().to_owned();
        let Some(size) = context.picture_size(&name).or(context.options.size) else {
            let expected = "the picture beside the file, or in its folder images, for its size (or --size)";
            return Err(CaptureFault::field(&format!("{field} name"), expected, quoted(&name)));
        };
        let pixels = f64::from(size.width.max(size.height)) / FILM;
        let focal = number("f")? * pixels;
        let Size { width, height } = size;
        let intrinsics = Intrinsics {
            width,
            height,
            fx: focal,
            fy: focal,
            cx: number("px")? * pixels + 0.5 * f64::from(width),
            cy: number("py")? * pixels + 0.5 * f64::from(height),
        };
        let [heading, pitch, roll] =
            [number("heading")?, number("pitch")?, number("roll")?].map(f64::to_radians);
        // Right, up and back of a camera, z up in the world.
        let turn =
            DMat3::from_rotation_z(-heading) * DMat3::from_rotation_x(pitch) * DMat3::from_rotation_y(roll);
        let rotation = DMat3::from_cols(turn.x_axis, -turn.y_axis, -turn.z_axis);
        let center = DVec3::new(number("x")?, number("y")?, number("alt")?);
        let [k1, k2, k3, k4] = [number("k1")?, number("k2")?, number("k3")?, number("k4")?];
        if k4 != 0.0 {
            context.note(format!("{field}: the fourth radial coefficient, {k4}, is not used"));
        }
        let lens = Lens::brown(k1, k2, number("t1")?, number("t2")?, k3);
        let camera = camera_from_world_pose(&field, rotation, center, intrinsics)?;
        photos.push(Photo { name, camera, lens: Some(lens).filter(|lens| !lens.is_pinhole()) });
    }
    photos.sort_by(|a, b| in_order(&a.name, &b.name));
    path_through(photos)
}
