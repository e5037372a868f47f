//! What a device can do, and what gs3 needs of it.

use crate::error::GpuError;

/// Which of the features that not every adapter has are used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OptionalFeatures {
    /// All that the adapter has and wgpu does not call experimental.
    #[default]
    All,
    /// Products of matrices, too.
    Experimental,
    /// None but timestamps, as in a browser: the fallbacks run.
    None,
}

/// Invocations that exchange values without memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Subgroups {
    /// None, or not usable.
    Absent,
    /// Of `min` to `max` invocations, powers of two.
    Present {
        /// The smallest.
        min: u32,
        /// The largest.
        max: u32,
    },
}

/// What a device can do: resolved once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Capabilities {
    /// Subgroup operations in kernels.
    pub subgroups: Subgroups,
    /// `f16` in kernels and buffers (`enable f16;`).
    pub shader_f16: bool,
    /// Times of stages on the device.
    pub timestamps: bool,
    /// Sizes `m×n×k` of matrix products in hardware with f16 factors and f32 sums (`enable
    /// wgpu_cooperative_matrix;`); of a device that was not opened with [`OptionalFeatures::Experimental`] none.
    pub cooperative_matrix: Vec<[u32; 3]>,
    /// Sizes.
    pub limits: Limits,
}

/// Sizes that a device takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of one buffer.
    pub buffer_bytes: u64,
    /// Bytes of one storage binding.
    pub binding_bytes: u64,
    /// Storage bindings of a kernel.
    pub storage_bindings: u32,
    /// Multiple at which a binding may start in its buffer, bytes.
    pub binding_alignment: u32,
    /// Bytes of memory that a workgroup shares.
    pub workgroup_bytes: u32,
    /// Invocations of a workgroup.
    pub workgroup_invocations: u32,
    /// Workgroups along a dimension of a dispatch.
    pub workgroups: u32,
}

impl Limits {
    /// The least limits of a device of WebGPU (its specification, section "Limits").
    pub const LEAST: Self = Self {
        buffer_bytes: 256 << 20,
        binding_bytes: 128 << 20,
        storage_bindings: 8,
        binding_alignment: 256,
        workgroup_bytes: 16 << 10,
        workgroup_invocations: 256,
        workgroups: 65_535,
    };
}

impl From<wgpu::Limits> for Limits {
    fn from(limits: wgpu::Limits) -> Self {
        Self {
            buffer_bytes: limits.max_buffer_size,
            binding_bytes: limits.max_storage_buffer_binding_size,
            storage_bindings: limits.max_storage_buffers_per_shader_stage,
            binding_alignment: limits.min_storage_buffer_offset_alignment,
            workgroup_bytes: limits.max_compute_workgroup_storage_size,
            workgroup_invocations: limits.max_compute_invocations_per_workgroup,
            workgroups: limits.max_compute_workgroups_per_dimension,
        }
    }
}

/// Invocations of the smallest workgroup with cooperating subgroups.
const SMALLEST_WORKGROUP: u32 = 64;

impl Subgroups {
    /// The subgroups of an adapter called `name` that has them, with `min` to `max` invocations according to
    /// `backend`.
    fn of(backend: wgpu::Backend, name: &str, [min, max]: [u32; 2]) -> Self {
        match backend {
            // wgpu 30 knows no sizes by Metal and says 4 to 64. Apple's own processors have 32.
            wgpu::Backend::Metal if name.starts_with("Apple") => Self::of_sizes(32, 32),
            wgpu::Backend::Metal => Self::Absent,
            _ => Self::of_sizes(min, max),
        }
    }

    /// Subgroups of sizes from `min` to `max`, if every workgroup is a whole number of them: kernels assume full
    /// subgroups.
    fn of_sizes(min: u32, max: u32) -> Self {
        match min.is_power_of_two() && max.is_power_of_two() && max <= SMALLEST_WORKGROUP {
            true => Self::Present { min, max },
            false => Self::Absent,
        }
    }
}

impl Capabilities {
    /// The capabilities of `adapter`.
    pub(crate) fn of(adapter: &wgpu::Adapter) -> Self {
        let (features, info) = (adapter.features(), adapter.get_info());
        let has = |feature| features.contains(feature);
        let subgroups = match has(wgpu::Features::SUBGROUP) {
            true => Subgroups::of(info.backend, &info.name, [info.subgroup_min_size, info.subgroup_max_size]),
            false => Subgroups::Absent,
        };
        let products = match has(wgpu::Features::EXPERIMENTAL_COOPERATIVE_MATRIX) {
            true => adapter.cooperative_matrix_properties(),
            false => Vec::new(),
        };
        let half_to_single = products.iter().filter(|p| {
            p.ab_type == wgpu::CooperativeScalarType::F16 && p.cr_type == wgpu::CooperativeScalarType::F32
        });
        Self {
            subgroups,
            shader_f16: has(wgpu::Features::SHADER_F16),
            timestamps: has(wgpu::Features::TIMESTAMP_QUERY),
            cooperative_matrix: half_to_single.map(|p| [p.m_size, p.n_size, p.k_size]).collect(),
            limits: adapter.limits().into(),
        }
    }

    pub(crate) fn with(self, features: OptionalFeatures) -> Self {
        match features {
            OptionalFeatures::Experimental => self,
            OptionalFeatures::All => Self { cooperative_matrix: Vec::new(), ..self },
            OptionalFeatures::None => Self {
                subgroups: Subgroups::Absent,
                shader_f16: false,
                cooperative_matrix: Vec::new(),
                ..self
            },
        }
    }

    /// What of it `device` was opened with.
    pub(crate) fn within(self, device: &wgpu::Device) -> Self {
        let (features, limits) = (device.features(), Limits::from(device.limits()));
        let opened = |has: bool, feature| has && features.contains(feature);
        let has_products = features.contains(wgpu::Features::EXPERIMENTAL_COOPERATIVE_MATRIX);
        Self {
            subgroups: match features.contains(wgpu::Features::SUBGROUP) {
                true => self.subgroups,
                false => Subgroups::Absent,
            },
            shader_f16: opened(self.shader_f16, wgpu::Features::SHADER_F16),
            timestamps: opened(self.timestamps, wgpu::Features::TIMESTAMP_QUERY),
            cooperative_matrix: if has_products { self.cooperative_matrix } else { Vec::new() },
            limits,
        }
    }

    pub(crate) fn required_features(&self) -> wgpu::Features {
        let mut features = wgpu::Features::empty();
        features.set(wgpu::Features::SUBGROUP, self.subgroups != Subgroups::Absent);
        features.set(wgpu::Features::SHADER_F16, self.shader_f16);
        features.set(wgpu::Features::TIMESTAMP_QUERY, self.timestamps);
        features.set(wgpu::Features::EXPERIMENTAL_COOPERATIVE_MATRIX, !self.cooperative_matrix.is_empty());
        features
    }
}

/// Leave to use what wgpu calls experimental, if something of it is used.
#[allow(unsafe_code, reason = "wgpu asks for it: its experimental features are less tested than others")]
pub(crate) fn experimental(capabilities: &Capabilities) -> wgpu::ExperimentalFeatures {
    match capabilities.cooperative_matrix.is_empty() {
        true => wgpu::ExperimentalFeatures::disabled(),
        // SAFETY: the caller who opens the device asks for it, in wgpu's terms. naga checks where a matrix that a
        // kernel loads or stores begins; the kernel must ensure that the matrix ends inside the buffer.
        false => unsafe { wgpu::ExperimentalFeatures::enabled() },
    }
}

/// The first thing that gs3 needs and `adapter`, or a device of it with lower `limits`, lacks. All are what WebGPU
/// guarantees.
pub(crate) fn missing(adapter: &wgpu::Adapter, limits: &Limits) -> Option<GpuError> {
    let lacks = |what: &str, expected: String, actual: String| {
        let (adapter, what) = (adapter.get_info().name, what.to_owned());
        Some(GpuError::Unsupported { adapter, what, expected, actual })
    };
    if !adapter.get_downlevel_capabilities().flags.contains(wgpu::DownlevelFlags::COMPUTE_SHADERS) {
        return lacks("compute shaders", "present".to_owned(), "absent".to_owned());
    }
    let needs: [(&str, u64, u64); 6] = [
        ("bytes of a storage binding", 128 << 20, limits.binding_bytes),
        ("bytes of a buffer", 256 << 20, limits.buffer_bytes),
        ("storage bindings of a kernel", 8, limits.storage_bindings.into()),
        ("bytes of workgroup memory", 16 << 10, limits.workgroup_bytes.into()),
        ("invocations of a workgroup", 256, limits.workgroup_invocations.into()),
        ("workgroups along a dimension", 65_535, limits.workgroups.into()),
    ];
    let (what, expected, actual) = needs.into_iter().find(|(_, expected, actual)| actual < expected)?;
    lacks(what, format!("at least {expected}"), actual.to_string())
}

#[cfg(test)]
mod tests {
    use wgpu::Backend::{Metal, Vulkan};

    use super::*;

    #[test]
    fn subgroups_are_of_sizes_that_are_so() {
        let of_32 = Subgroups::Present { min: 32, max: 32 };
        assert_eq!(Subgroups::of(Vulkan, "NVIDIA H200", [32, 32]), of_32);
        assert_eq!(Subgroups::of(Vulkan, "RADV", [32, 64]), Subgroups::Present { min: 32, max: 64 });
        assert_eq!(Subgroups::of(Vulkan, "of more than a workgroup", [8, 128]), Subgroups::Absent);
        assert_eq!(Subgroups::of(Metal, "Apple M3 Max", [4, 64]), of_32);
        assert_eq!(Subgroups::of(Metal, "AMD Radeon Pro", [4, 64]), Subgroups::Absent);
    }
}
