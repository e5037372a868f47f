//! The kernels of a scene, compiled once.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::hash::Hash;

use gs3_compute::{Gpu, GpuError, Kernel, Scan, Sort};
use gs3_scene::OpacityMode;

use super::plan::{DEPTH_BITS, FramePlan, ScenePlan};
use super::shaders;
use crate::settings::{Culling, Outputs};

/// Kernels that do not depend on sizes.
pub struct Kernels {
    pub mark: Kernel,
    pub project_color: Kernel,
    pub project_gbuffer: Kernel,
    pub scan: Scan,
    pub plan_splats: Kernel,
    pub plan_entries: Kernel,
    pub clear: Kernel,
    pub find: Kernel,
    pub copy_picture: Kernel,
    /// `CULLING` of `bin.wgsl`.
    culling: (&'static str, f64),
    /// Splats to tiles, `count` and `emit`, by the side of a tile, compiled at the first use.
    bin: HashMap<u32, [Kernel; 2]>,
    /// Tiles to pixels, by outputs and the side of a tile, in the same way.
    blend: HashMap<(Outputs, u32), Kernel>,
    /// Tiles to the pixels of exact blocks, in the same way.
    blend_blocks: HashMap<(Outputs, u32), Kernel>,
}

/// The sorts, which depend on sizes.
pub struct Sorts {
    pub by_depth: Sort,
    pub by_tile: Sort,
}

/// `CULLING` of `project.wgsl` and `bin.wgsl`.
pub const fn culling_number(culling: Culling) -> u32 {
    match culling {
        Culling::Aabb3Sigma => 0,
        Culling::Adr => 1,
        Culling::SnugBox => 2,
        Culling::AccuTile => 3,
        Culling::Exact => 4,
    }
}

/// `OPACITY_MODE` of `project.wgsl`.
pub const fn opacity_number(mode: OpacityMode) -> u32 {
    match mode {
        OpacityMode::Default => 0,
        OpacityMode::Antialiased => 1,
    }
}

impl Kernels {
    pub fn new(gpu: &Gpu, scene: &ScenePlan, mode: OpacityMode, culling: Culling) -> Result<Self, GpuError> {
        let culling = ("CULLING", f64::from(culling_number(culling)));
        let mode = ("OPACITY_MODE", f64::from(opacity_number(mode)));
        let constants = [culling, mode, ("SH_DEGREE", f64::from(scene.sh_degree))];
        let project = gpu.module("project", &[&shaders::project(scene.precision)])?;
        let plan = gpu.module("plan", &[&shaders::plan()])?;
        let tiles = gpu.module("tiles", &[&shaders::tiles()])?;
        Ok(Self {
            mark: project.kernel(gpu, "mark", &constants)?,
            project_color: project.kernel(gpu, "project_color", &constants)?,
            project_gbuffer: project.kernel(gpu, "project_gbuffer", &constants)?,
            scan: Scan::new(gpu)?,
            plan_splats: plan.kernel(gpu, "plan_splats", &[])?,
            plan_entries: plan.kernel(gpu, "plan_entries", &[])?,
            clear: tiles.kernel(gpu, "clear", &[])?,
            find: tiles.kernel(gpu, "find", &[])?,
            copy_picture: gpu.module("crop", &[&shaders::crop()])?.kernel(gpu, "copy_picture", &[])?,
            culling,
            bin: HashMap::new(),
            blend: HashMap::new(),
            blend_blocks: HashMap::new(),
        })
    }

    /// Splats to tiles of `tile`×`tile` pixels: `count` and `emit`.
    pub fn bin(&mut self, gpu: &Gpu, tile: u32) -> Result<[Kernel; 2], GpuError> {
        let culling = self.culling;
        compiled(&mut self.bin, tile, || {
            let module = gpu.module("bin", &[&shaders::bin(tile)])?;
            Ok([module.kernel(gpu, "count", &[culling])?, module.kernel(gpu, "emit", &[culling])?])
        })
    }

    /// Tiles to pixels.
    pub fn blend(&mut self, gpu: &Gpu, plan: &FramePlan) -> Result<Kernel, GpuError> {
        let FramePlan { outputs, tile, .. } = *plan;
        compiled(&mut self.blend, (outputs, tile), || {
            gpu.module("blend", &[&shaders::blend(outputs, tile)])?.kernel(gpu, "blend", &[])
        })
    }

    /// Tiles to the pixels of exact blocks, with the splats of frames of `plan`.
    pub fn blend_blocks(&mut self, gpu: &Gpu, plan: &FramePlan) -> Result<Kernel, GpuError> {
        let FramePlan { outputs, tile, .. } = *plan;
        compiled(&mut self.blend_blocks, (outputs, tile), || {
            gpu.module("blocks", &[&shaders::blend_blocks(outputs, tile)])?.kernel(gpu, "blend", &[])
        })
    }

    pub const fn project(&self, outputs: Outputs) -> &Kernel {
        match outputs {
            Outputs::Color => &self.project_color,
            Outputs::Samples | Outputs::GBuffer | Outputs::GBufferMixed => &self.project_gbuffer,
        }
    }
}

/// The kernels of `of`, made by `compile` if there are none yet.
fn compiled<Of: Eq + Hash, K: Clone>(
    kernels: &mut HashMap<Of, K>,
    of: Of,
    compile: impl FnOnce() -> Result<K, GpuError>,
) -> Result<K, GpuError> {
    match kernels.entry(of) {
        Entry::Occupied(compiled) => Ok(compiled.get().clone()),
        Entry::Vacant(place) => Ok(place.insert(compile()?).clone()),
    }
}

impl Sorts {
    /// The sorts for `plan`. Kernels of `before` are reused where they fit.
    pub fn new(gpu: &Gpu, plan: &FramePlan, before: Option<&Self>) -> Result<Self, GpuError> {
        let sort = |before: Option<&Sort>, capacity, bits| match before {
            Some(before) => before.resized(gpu, capacity, bits),
            None => Sort::new(gpu, capacity, bits),
        };
        Ok(Self {
            by_depth: sort(before.map(|sorts| &sorts.by_depth), plan.capacity.splats, DEPTH_BITS)?,
            by_tile: sort(before.map(|sorts| &sorts.by_tile), plan.capacity.entries, plan.tile_bits)?,
        })
    }
}
