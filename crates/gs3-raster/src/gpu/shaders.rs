//! The kernels' sources: shared parts are written once.

use gs3_compute::{constants, grid_source};
use gs3_scene::OpacityMode;
use gs3_scene::gaussians::{SH_C0, SH_C1, SH_C2, SH_C3, SH_C4};
use half::f16;

use super::blocks::BLOCK_PIXELS;
use super::frame::GROUP;
use super::kernels::{culling_number, opacity_number};
use super::plan::splat_vectors;
use super::scene::{FIRST_RATIO, OPACITY_STEPS, QUATERNION_STEPS, ScenePrecision};
use crate::chunk::{self, CHUNK};
use crate::cpu::cover::BLOCK;
use crate::cpu::{blend, geometry, project, splat};
use crate::settings::{Culling, MAX_BLOCK_SCALE, MIN_ALPHA, MIN_ALPHA_INVERSE, Outputs, Rules};

/// Storage bindings that a kernel may have: what WebGPU guarantees. `blend` with mixed derivatives, which no frame of a
/// viewer has, takes one more; desktop drivers have 16 or more.
pub const STORAGE_BINDINGS: u32 = 8;

const VIEW: &str = include_str!("view.wgsl");
const SPLAT: &str = include_str!("splat.wgsl");
const FRAME: &str = include_str!("frame.wgsl");
const COVER: &str = include_str!("cover.wgsl");
const DERIVATIVES: &str = include_str!("derivatives.wgsl");

/// Constants that kernels share with the CPU's code, where their reasons are given.
fn numbers() -> String {
    let reals = constants(&[
        ("CHUNK_SLACK", chunk::SLACK),
        ("SUPPORT_MARGIN", project::SUPPORT_MARGIN),
        ("EXTENT_MARGIN", project::EXTENT_MARGIN),
        ("MAX_SLOPE", project::MAX_SLOPE),
        ("MIN_COMPENSATION", Rules::KERBL.min_compensation),
        ("MAX_SQUARED_RADIUS", project::MAX_SQUARED_RADIUS),
        ("TWO_LN_2", project::TWO_LN_2),
        ("HALF_LOG2_E_SQRT", project::HALF_LOG2_E_SQRT),
        ("MAX_STEEPNESS", project::MAX_STEEPNESS),
        ("MAX_DEVIATION", project::MAX_DEVIATION),
        ("PUBLISHED_SIGMAS", project::PUBLISHED_SIGMAS),
        ("PUBLISHED_TILE", project::PUBLISHED_TILE),
        ("STEEPEST_PLANE", geometry::STEEPEST_PLANE),
        ("SPAN_SLACK", splat::SPAN_SLACK),
        ("SPAN_SLACK_PER_PIXEL", splat::SPAN_SLACK_PER_PIXEL),
        ("REACH_FACTOR", splat::REACH_FACTOR),
        ("REACH_SLACK", splat::REACH_SLACK),
        ("MAX_FINITE", f32::MAX),
        ("TINY", f32::MIN_POSITIVE),
        ("C0", SH_C0),
        ("C1", SH_C1),
        ("MAX_ALPHA", Rules::KERBL.max_alpha),
        ("MIN_ALPHA", MIN_ALPHA),
        ("MIN_ALPHA_INVERSE", MIN_ALPHA_INVERSE),
        ("MIN_TRANSMITTANCE", blend::MIN_TRANSMITTANCE),
        ("UNSCALE", blend::UNSCALE),
        ("OPACITY_STEPS", OPACITY_STEPS as f32),
        ("QUATERNION_STEP", (1.0 / QUATERNION_STEPS) as f32),
    ]);
    let counts = constants(&[
        ("CHUNK", CHUNK as u32),
        ("BLOCK", BLOCK as u32),
        ("GROUP", GROUP),
        ("FIRST_RATIO", FIRST_RATIO),
        ("AABB_3_SIGMA", culling_number(Culling::Aabb3Sigma)),
        ("ADR", culling_number(Culling::Adr)),
        ("ACCU_TILE", culling_number(Culling::AccuTile)),
        ("EXACT", culling_number(Culling::Exact)),
        ("ANTIALIASED", opacity_number(OpacityMode::Antialiased)),
    ]);
    // C2_0 to C2_4, C3_0 to C3_6, C4_0 to C4_8.
    let of_degree = |degree: u32, factors: &[f32]| -> String {
        let named = |(k, factor): (usize, &f32)| constants(&[(format!("C{degree}_{k}").as_str(), *factor)]);
        factors.iter().enumerate().map(named).collect()
    };
    reals + &of_degree(2, &SH_C2) + &of_degree(3, &SH_C3) + &of_degree(4, &SH_C4) + &counts
}

fn joined(parts: &[&str]) -> String {
    numbers() + &parts.concat()
}

/// Gaussians to splats: entries `mark`, `project_color`, `project_gbuffer`.
pub fn project(precision: ScenePrecision) -> String {
    let scene = match precision {
        ScenePrecision::F16 => include_str!("scene_f16.wgsl"),
        ScenePrecision::F32 => include_str!("scene_f32.wgsl"),
    };
    joined(&[
        &grid_source(),
        VIEW,
        include_str!("scene.wgsl"),
        scene,
        include_str!("chunk.wgsl"),
        include_str!("sh.wgsl"),
        include_str!("geometry.wgsl"),
        include_str!("project.wgsl"),
    ])
}

/// Splats to tiles of `tile`×`tile` pixels: entries `count` and `emit`.
pub fn bin(tile: u32) -> String {
    let tile = constants(&[("TILE", tile)]);
    joined(&[&tile, &grid_source(), VIEW, FRAME, SPLAT, include_str!("bin.wgsl")])
}

/// Counts between the stages: entries `plan_splats` and `plan_entries`.
pub fn plan() -> String {
    joined(&[&grid_source(), FRAME, include_str!("plan.wgsl")])
}

/// Entries of tiles: entries `clear` and `find`.
pub fn tiles() -> String {
    joined(&[&grid_source(), FRAME, include_str!("tiles.wgsl")])
}

/// The picture without its margin: entry `copy_picture`.
pub fn crop() -> String {
    let [x, y] = super::crop::GROUP;
    constants(&[("WORKGROUP_X", x), ("WORKGROUP_Y", y)]) + include_str!("crop.wgsl")
}

/// Splats that a workgroup stages at a time, at least; 256 invocations stage 128. (On an H100, 64 invocations take 0.59 ms with 64
/// splats at a time and 0.94 ms with 32, hqgarden at 480×270. With 256 splats at a time, native colour takes 1.38 instead of
/// 1.13 ms at 4096×2160.)
const LEAST_BATCH: u32 = 64;

/// Tiles to pixels: entry `blend`.
pub fn blend(outputs: Outputs, tile: u32) -> String {
    let sizes = blend_sizes(outputs, tile, tile * tile);
    let gbuffer = [DERIVATIVES, include_str!("outputs_gbuffer.wgsl")].concat();
    let pixels = include_str!("cover_pixels.wgsl");
    let [pixels, outputs, mixed] = match outputs {
        Outputs::Color => [include_str!("cover_pixels_none.wgsl"), include_str!("outputs_color.wgsl"), ""],
        Outputs::Samples | Outputs::GBuffer => [pixels, &gbuffer, include_str!("mixed_none.wgsl")],
        Outputs::GBufferMixed => [pixels, &gbuffer, include_str!("mixed.wgsl")],
    };
    let places = include_str!("places_tile.wgsl");
    joined(&[&sizes, VIEW, FRAME, SPLAT, COVER, pixels, places, &blending(), outputs, mixed])
}

/// Tiles to the pixels of exact blocks, from the splats of frames of `outputs`: entry `blend`.
pub fn blend_blocks(outputs: Outputs, tile: u32) -> String {
    let numbers = blend_sizes(outputs, tile, BLOCK_PIXELS)
        + &constants(&[("MAX_SCALE", MAX_BLOCK_SCALE)])
        + &constants(&[("LARGEST_HALF", f16::MAX.to_f32())]);
    let own = [include_str!("cover_blocks.wgsl"), include_str!("places_blocks.wgsl")].concat();
    let outputs = [DERIVATIVES, include_str!("outputs_blocks.wgsl")].concat();
    joined(&[&numbers, VIEW, FRAME, SPLAT, COVER, &own, &blending(), &outputs])
}

/// Sizes of blending with the splats of frames of `outputs` in tiles of `tile`×`tile`, with `pixels` invocations.
fn blend_sizes(outputs: Outputs, tile: u32, pixels: u32) -> String {
    let (vectors, batch) = (splat_vectors(outputs), (pixels / 2).max(LEAST_BATCH));
    constants(&[("SPLAT_VECTORS", vectors), ("TILE", tile), ("PIXELS", pixels), ("BATCH", batch)])
}

/// Front-to-back blending, with its generated lines.
fn blending() -> String {
    include_str!("blend.wgsl").replace("                SPLATS\n", &super::blend::splats())
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs3_compute::{storage_bindings, validate};
    use gs3_test_support::check_literals;

    #[test]
    fn no_kernel_has_more_bindings_than_said() {
        let bindings = |source: &str| storage_bindings("kernel", &[source]).unwrap_or_else(|e| panic!("{e}"));
        let most = STORAGE_BINDINGS as usize;
        assert_eq!(bindings(&project(ScenePrecision::F16)), most);
        assert_eq!(bindings(&project(ScenePrecision::F32)), most);
        assert_eq!(bindings(&blend(Outputs::GBuffer, 8)), most);
        assert_eq!(bindings(&blend(Outputs::GBufferMixed, 8)), most + 1);
        for source in
            [bin(16), plan(), tiles(), crop(), blend(Outputs::Color, 16), blend_blocks(Outputs::GBuffer, 8)]
        {
            assert!(bindings(&source) < most);
        }
    }

    #[test]
    fn every_shader_is_valid() {
        for precision in [ScenePrecision::F16, ScenePrecision::F32] {
            validate("project", &[&project(precision)]).unwrap_or_else(|e| panic!("{precision:?}: {e}"));
        }
        for (label, source) in [("plan", plan()), ("tiles", tiles()), ("crop", crop())] {
            validate(label, &[&source]).unwrap_or_else(|e| panic!("{e}"));
        }
        for tile in [8, 16] {
            validate("bin", &[&bin(tile)]).unwrap_or_else(|e| panic!("{tile}: {e}"));
            for outputs in [Outputs::Color, Outputs::GBuffer, Outputs::GBufferMixed] {
                for (label, source) in
                    [("blend", blend(outputs, tile)), ("blocks", blend_blocks(outputs, tile))]
                {
                    validate(label, &[&source]).unwrap_or_else(|e| panic!("{label} {outputs:?} {tile}: {e}"));
                }
            }
        }
        assert_eq!(check_literals(concat!(env!("CARGO_MANIFEST_DIR"), "/src/gpu")), 27);
    }
}
