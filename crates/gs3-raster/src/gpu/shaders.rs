//! The kernels' sources, put together: what kernels share is written once.

use gs3_compute::GRID_WGSL;

use super::scene::ScenePrecision;
use crate::settings::Outputs;

/// Storage bindings of the kernel that has most, `project_gbuffer`. Desktop drivers have 16 or more.
pub const STORAGE_BINDINGS: u32 = 13;

const VIEW: &str = include_str!("view.wgsl");
const SPLAT: &str = include_str!("splat.wgsl");
const FRAME: &str = include_str!("frame.wgsl");

/// Gaussians to splats: entries `mark`, `project_color`, `project_gbuffer`.
pub fn project(precision: ScenePrecision) -> [&'static str; 8] {
    let scene = match precision {
        ScenePrecision::F16 => include_str!("scene_f16.wgsl"),
        ScenePrecision::F32 => include_str!("scene_f32.wgsl"),
    };
    [
        GRID_WGSL,
        VIEW,
        include_str!("scene.wgsl"),
        scene,
        include_str!("chunk.wgsl"),
        include_str!("sh.wgsl"),
        include_str!("geometry.wgsl"),
        include_str!("project.wgsl"),
    ]
}

/// Splats to tiles: entries `count` and `emit`.
pub const BIN: [&str; 4] = [GRID_WGSL, FRAME, SPLAT, include_str!("bin.wgsl")];

/// Counts between the stages: entries `plan_splats` and `plan_entries`.
pub const PLAN: [&str; 3] = [GRID_WGSL, FRAME, include_str!("plan.wgsl")];

/// Entries of tiles: entries `clear` and `find`.
pub const TILES: [&str; 3] = [GRID_WGSL, FRAME, include_str!("tiles.wgsl")];

/// The picture without its margin: entry `copy_picture`.
pub const CROP: [&str; 1] = [include_str!("crop.wgsl")];

/// Tiles to pixels: entry `blend`.
pub fn blend(outputs: Outputs) -> Vec<&'static str> {
    let mut sources = vec![VIEW, FRAME, SPLAT, include_str!("cover.wgsl"), include_str!("blend.wgsl")];
    let gbuffer = include_str!("outputs_gbuffer.wgsl");
    match outputs {
        Outputs::Color => sources.push(include_str!("outputs_color.wgsl")),
        Outputs::GBuffer => sources.extend([gbuffer, include_str!("mixed_none.wgsl")]),
        Outputs::GBufferMixed => sources.extend([gbuffer, include_str!("mixed.wgsl")]),
    }
    sources
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs3_compute::validate;

    #[test]
    fn no_kernel_has_more_bindings_than_said() {
        let bindings = |sources: &[&str]| sources.concat().matches("var<storage").count() as u32;
        assert_eq!(bindings(&project(ScenePrecision::F16)), STORAGE_BINDINGS);
        assert_eq!(bindings(&project(ScenePrecision::F32)), STORAGE_BINDINGS);
        assert!(bindings(&blend(Outputs::GBufferMixed)) <= STORAGE_BINDINGS);
    }

    #[test]
    fn every_shader_is_valid() {
        for precision in [ScenePrecision::F16, ScenePrecision::F32] {
            validate("project", &project(precision)).unwrap_or_else(|e| panic!("{precision:?}: {e}"));
        }
        for (label, sources) in [("bin", &BIN[..]), ("plan", &PLAN), ("tiles", &TILES), ("crop", &CROP)] {
            validate(label, sources).unwrap_or_else(|e| panic!("{e}"));
        }
        for outputs in [Outputs::Color, Outputs::GBuffer, Outputs::GBufferMixed] {
            validate("blend", &blend(outputs)).unwrap_or_else(|e| panic!("{outputs:?}: {e}"));
        }
    }
}
