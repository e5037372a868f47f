//! The kernels' sources: shared parts are written once, and constants come from the CPU's code.

use gs3_compute::{constants, grid_source};
use gs3_scene::BLOCK_SIDE;
use half::f16;

use super::plan::{BLOCKS_ALONG, KRIGED, MADE_WIDTH, SuperSamplePlan, WARPED, WORKGROUP};
use super::select::{ERROR_UNITS, GROUP, LARGEST_ERROR};
use super::side_output::SideOutput;
use crate::cpu::{
    blend, gather, kriging, nearest, neighbor_depth, other_surface, rectification, rigidity, splat, tile,
    warp,
};
use crate::reprojection;
use crate::settings::Kriging;

const BLOCK_CORNERS: &str = include_str!("block_corners.wgsl");
const CELLS: &str = include_str!("cells.wgsl");
const FRAME: &str = include_str!("frame.wgsl");
const HISTORY: &str = include_str!("history.wgsl");
const IN_BETWEEN: &str = include_str!("in_between.wgsl");
const ORDERED: &str = include_str!("ordered.wgsl");
const PACK_SAMPLE: &str = include_str!("pack_sample.wgsl");

/// Sides of the workgroups with an invocation a sample.
fn workgroup() -> String {
    constants(&[("WORKGROUP_X", WORKGROUP[0]), ("WORKGROUP_Y", WORKGROUP[1])])
}

/// The largest half: larger numbers would become infinite.
fn largest_half() -> String {
    constants(&[("LARGEST_HALF", f16::MAX.to_f32())])
}

/// Numbers as halves.
fn halves() -> String {
    largest_half() + include_str!("halves.wgsl")
}

/// Cells, and how far a sample reaches.
fn cells() -> String {
    constants(&[("COLUMNS", splat::COLUMNS as u32), ("ROWS", splat::ROWS as u32)]) + CELLS
}

fn joined(parts: &[&str]) -> String {
    parts.concat()
}

/// The current frame into the history, with its depth edges: entry `remember`.
pub fn samples() -> String {
    joined(&[&workgroup(), FRAME, &reprojection(), &write_sample(), include_str!("samples.wgsl")])
}

/// A sample into the history.
fn write_sample() -> String {
    let numbers = constants(&[
        ("EDGE_RATIO", crate::cpu::samples::EDGE_RATIO),
        ("CROSSING", crate::cpu::samples::CROSSING),
        ("CROSSING_OF_BLOCKS", crate::cpu::samples::CROSSING_OF_BLOCKS),
    ]);
    joined(&[&numbers, &halves(), PACK_SAMPLE, include_str!("write_sample.wgsl")])
}

/// Corners of exact blocks.
fn block_corners() -> String {
    constants(&[("BLOCK_SIDE", BLOCK_SIDE as u32)]) + BLOCK_CORNERS
}

/// The current frame's exact blocks into the history: entry `remember_blocks`.
pub fn blocks() -> String {
    let group = constants(&[("GROUP", GROUP)]) + &constants(&[("HALF_WAY", crate::cpu::samples::HALF_WAY)]);
    let shared = [group, block_corners(), grid_source(), reprojection(), write_sample()].concat();
    joined(&[&shared, FRAME, include_str!("blocks.wgsl")])
}

/// The current picture's samples for its surface, and how well they predict each other: entry `predict`.
pub fn predict() -> String {
    joined(&[&workgroup(), FRAME, &reprojection(), &halves(), PACK_SAMPLE, include_str!("predict.wgsl")])
}

/// Ranges of plausible colours: entry `find_ranges`.
pub fn rectification() -> String {
    let numbers = constants(&[
        ("DEPTH_TOLERANCE", rectification::DEPTH_TOLERANCE),
        ("EXTRAPOLATION", rectification::EXTRAPOLATION),
        ("MISMATCH", rectification::MISMATCH),
        ("DRIFT", rectification::DRIFT),
        ("ERROR_FLOOR", rectification::ERROR_FLOOR),
        ("EXTENT_FLOOR", rectification::EXTENT_FLOOR),
        ("MAX_FINITE", f32::MAX),
    ]);
    let own = include_str!("rectification.wgsl");
    joined(&[&numbers, &workgroup(), FRAME, &reprojection(), &halves(), own])
}

/// Depth pre-pass, and splatting of samples to their current places: entries `splat_depth` and `splat_color`.
pub fn splat() -> String {
    let numbers = constants(&[
        ("HIDDEN", rectification::HIDDEN),
        ("NOISE", tile::NOISE),
        ("AGING", splat::AGING),
        ("AGING_OF_BLOCKS", splat::AGING_OF_BLOCKS),
        ("ALIKE", splat::ALIKE),
        ("PER_FRAME", splat::PER_FRAME),
        ("MAX_NOISE", splat::MAX_NOISE),
        ("DEPTH_TOLERANCE", rectification::DEPTH_TOLERANCE),
        ("OCCLUDED", splat::OCCLUDED),
    ]);
    let rim = constants(&[("RIM", nearest::RIM as u32), ("EVERY", nearest::EVERY as u32)]);
    let own = include_str!("splat.wgsl");
    joined(&[&numbers, &rim, &workgroup(), FRAME, &cells(), &block_corners(), &reprojection(), own])
}

/// Samples in the order of their cells: entries `list` and `rank`.
pub fn order() -> String {
    joined(&[&workgroup(), FRAME, &cells(), include_str!("order.wgsl")])
}

/// The rest of the samples in that order: entry `copy`.
pub fn copy() -> String {
    joined(&[&workgroup(), FRAME, &cells(), include_str!("copy.wgsl")])
}

/// The places of one view's samples in another view.
fn reprojection() -> String {
    constants(&[("NEAREST_DEPTH", reprojection::NEAREST_DEPTH), ("MIN_DIVISOR", reprojection::MIN_DIVISOR)])
        + include_str!("reprojection.wgsl")
}

/// Errors of blocks as whole numbers.
fn errors() -> String {
    constants(&[("ERROR_UNITS", ERROR_UNITS), ("LARGEST_ERROR", LARGEST_ERROR)])
        + &constants(&[("BLOCK_SIDE", BLOCK_SIDE as u32)])
}

/// The blocks with the largest expected errors: entries `rank` and `choose`.
pub fn select() -> String {
    joined(&[&errors(), &constants(&[("GROUP", GROUP)]), &grid_source(), include_str!("select.wgsl")])
}

/// Samples to pixels, with the bindings of the side output: entry `accumulate`.
pub fn tile(plan: &SuperSamplePlan, side_output: SideOutput, kriging: Kriging) -> String {
    let numbers = constants(&[
        ("NOISE", tile::NOISE),
        ("SURFACE", tile::SURFACE),
        ("EXACT", tile::EXACT),
        ("CURVATURE", tile::CURVATURE),
        ("FAINT", tile::FAINT),
        ("BLOCK_REACH", splat::BLOCK_REACH),
        ("THRESHOLD", kriging.threshold().unwrap_or_default()),
    ]);
    let kriging = format!("const KRIGING: bool = {};\n", kriging.threshold().is_some());
    // Dividing by a constant is several times faster.
    let sizes =
        constants(&[("MADE_WIDTH", MADE_WIDTH), ("MADE_HEIGHT", plan.made_height), ("SCALE", plan.scale)]);
    let own = [include_str!("hermite.wgsl"), ORDERED, include_str!("tile.wgsl")].concat();
    let side_output = match side_output {
        SideOutput::None => include_str!("side_output_none.wgsl").to_owned(),
        SideOutput::Innovation => include_str!("innovation.wgsl").to_owned(),
        SideOutput::ExpectedErrors => {
            constants(&[("BLOCKS_ALONG", BLOCKS_ALONG)]) + &errors() + include_str!("expected_errors.wgsl")
        }
    };
    joined(&[&numbers, &largest_half(), &kriging, &sizes, FRAME, &cells(), HISTORY, &own, &side_output])
}

/// Marked pixels from the samples around them: entry `krige_marked`.
pub fn krige() -> String {
    let numbers = constants(&[
        ("LENGTH", kriging::LENGTH),
        ("NUGGET", kriging::NUGGET),
        ("PER_NOISE", kriging::PER_NOISE),
        ("FARTHEST", kriging::FARTHEST),
        ("FADE", kriging::FADE),
        ("FADE_LIMIT", kriging::FADE_LIMIT),
        ("UNTRUSTED", kriging::UNTRUSTED),
        ("TRUSTED", kriging::TRUSTED),
    ]);
    let sizes = constants(&[
        ("SAMPLES", kriging::SAMPLES as u32),
        ("KRIGED_WIDTH", KRIGED[0]),
        ("KRIGED_HEIGHT", KRIGED[1]),
        ("WIDTH", super::kriging::WIDTH as u32),
        ("THREADS", super::kriging::THREADS as u32),
    ]);
    let own = include_str!("kriging.wgsl").replace("    FILL\n", &super::kriging::fill());
    let own = own.replace("    ELIMINATE\n", &super::kriging::eliminate());
    joined(&[&numbers, &largest_half(), &sizes, FRAME, &cells(), HISTORY, ORDERED, &own])
}

/// The neighbours' depths at the pose of the in-between frame: entry `scatter_depth`.
pub fn neighbor_depth() -> String {
    let numbers = constants(&[("SAME_SURFACE", reprojection::SAME_SURFACE)]);
    joined(&[&numbers, &workgroup(), IN_BETWEEN, &reprojection(), include_str!("neighbor_depth.wgsl")])
}

/// Depths without holes: entry `fill`.
pub fn middle_depth() -> String {
    let numbers = constants(&[("MAX_FINITE", f32::MAX)]);
    joined(&[&numbers, &workgroup(), IN_BETWEEN, include_str!("middle_depth.wgsl")])
}

/// Surfaces to their previous places: entry `find_motion`.
pub fn motion() -> String {
    let numbers = constants(&[("SAME_SURFACE", reprojection::SAME_SURFACE)]);
    joined(&[&numbers, &workgroup(), &reprojection(), include_str!("motion.wgsl")])
}

/// Both neighbours to the in-between frame: entries `blend`, `separate` and `separate_both`.
pub fn warp() -> String {
    let numbers = constants(&[
        ("SAME_SURFACE", reprojection::SAME_SURFACE),
        ("ONE_SURFACE", neighbor_depth::ONE_SURFACE),
        ("SILHOUETTE", neighbor_depth::SILHOUETTE),
        ("UNSEEN", neighbor_depth::HIDDEN),
        ("RIGID", rigidity::RIGID),
        ("LOOSE", rigidity::LOOSE),
        ("LESS", other_surface::LESS),
        ("DISAGREE", other_surface::DISAGREE),
        ("PATCH_MIDDLE", other_surface::PATCH_MIDDLE),
        ("NEGLIGIBLE", blend::NEGLIGIBLE),
        ("UNSURE", blend::UNSURE),
        ("MAX_FINITE", f32::MAX),
    ]);
    let sizes = constants(&[("PATCHES", WARPED[0] / warp::SIDE as u32), ("LINES", WARPED[1])]);
    let bits = gather::PHASE_BITS;
    let phases = format!("const PHASE_BITS: u32 = {bits}u;\nconst UNITS: i32 = {};\n", 1 << bits);
    let factors = |k: usize| gather::FIT.map(|factors| format!("{:?}", factors[k])).join(", ");
    let taps = format!(
        "const TAPS: u32 = {}u;\nconst BEFORE: i32 = {};\nconst FIT_FIRST = vec3<f32>({});\nconst FIT_SECOND = vec3<f32>({});\n",
        gather::TAPS,
        gather::BEFORE,
        factors(0),
        factors(1),
    );
    let [gather, warp] = [include_str!("gather.wgsl"), include_str!("warp.wgsl")];
    joined(&[
        &numbers,
        &sizes,
        &largest_half(),
        &phases,
        &taps,
        IN_BETWEEN,
        &reprojection(),
        gather,
        warp,
        include_str!("other_surface.wgsl"),
        include_str!("blend.wgsl"),
        include_str!("separate.wgsl"),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs3_compute::{Limits, storage_bindings, validate};
    use gs3_scene::Size;
    use gs3_test_support::check_literals;

    /// The number that WebGPU guarantees.
    const STORAGE_BINDINGS: usize = 8;

    #[test]
    fn every_shader_is_valid_and_runs_everywhere() {
        let limits = |workgroup_bytes| Limits {
            buffer_bytes: 1 << 30,
            binding_bytes: 1 << 30,
            workgroup_bytes,
            ..Limits::LEAST
        };
        let plan = |bytes| SuperSamplePlan::new(&limits(bytes), Size::new(64, 64), 4, 0, true).unwrap();
        let shaders = [
            ("samples", samples()),
            ("predict", predict()),
            ("rectification", rectification()),
            ("splat", splat()),
            ("order", order()),
            ("copy", copy()),
            ("tile", tile(&plan(32 << 10), SideOutput::None, Kriging::Off)),
            ("tile", tile(&plan(16 << 10), SideOutput::None, Kriging::On)),
            ("tile with innovation", tile(&plan(32 << 10), SideOutput::Innovation, Kriging::On)),
            ("tile with errors", tile(&plan(16 << 10), SideOutput::ExpectedErrors, Kriging::On)),
            ("select", select()),
            ("blocks", blocks()),
            ("krige", krige()),
            ("neighbor_depth", neighbor_depth()),
            ("middle_depth", middle_depth()),
            ("warp", warp()),
            ("motion", motion()),
        ];
        for (label, source) in &shaders {
            validate(label, &[source]).unwrap_or_else(|e| panic!("{label}: {e}"));
            let bindings = storage_bindings(label, &[source]).unwrap();
            assert!(bindings <= STORAGE_BINDINGS, "{label}: {bindings} storage bindings");
        }
        // No file is forgotten.
        let mut files = 0;
        for entry in std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/src/gpu")).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_some_and(|e| e == "wgsl") {
                let text = std::fs::read_to_string(&path).unwrap();
                // Without the lines that are written out.
                let parts: Vec<&str> =
                    text.split("    FILL\n").flat_map(|part| part.split("    ELIMINATE\n")).collect();
                let is_used =
                    shaders.iter().any(|(_, source)| parts.iter().all(|part| source.contains(part)));
                assert!(is_used, "{}", path.display());
                files += 1;
            }
        }
        let explained = check_literals(concat!(env!("CARGO_MANIFEST_DIR"), "/src/gpu"));
        assert_eq!((files, explained), (32, 32));
    }
}
