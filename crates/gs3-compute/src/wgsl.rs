//! What WGSL says, read without a device.

use naga::valid::{Capabilities, GlobalUse, ModuleInfo, ValidationFlags, Validator};
use naga::{AddressSpace, StorageAccess, TypeInner};

use crate::error::GpuError;

/// Whether `sources`, one after the other, are valid WGSL for [`Gpu::module`](crate::Gpu::module): the same check.
///
/// # Errors
/// [`GpuError::Shader`] with the place.
pub fn validate(label: &str, sources: &[&str]) -> Result<(), GpuError> {
    Reflected::new(label, &sources.concat()).map(|_| ())
}

/// Storage bindings of the entry point of `sources` that has the most.
///
/// # Errors
/// [`GpuError::Shader`] with the place of the first mistake.
pub fn storage_bindings(label: &str, sources: &[&str]) -> Result<usize, GpuError> {
    let reflected = Reflected::new(label, &sources.concat())?;
    let mut most = 0;
    for entry in &reflected.module.entry_points {
        let bindings = reflected.bindings(label, &entry.name)?;
        let is_storage = |b: &&Binding| matches!(b.ty, wgpu::BufferBindingType::Storage { .. });
        most = most.max(bindings.iter().filter(is_storage).count());
    }
    Ok(most)
}

/// A number that Rust and WGSL both have.
pub trait Number: Copy {
    /// Its type in WGSL.
    const TYPE: &'static str;

    /// It in WGSL, exactly.
    fn literal(self) -> String;
}

impl Number for f32 {
    const TYPE: &'static str = "f32";

    fn literal(self) -> String {
        // In the digits of an f64, which has the number exactly: browsers refuse the shortest digits of the largest f32, as
        // they are above the number.
        format!("{:e}f", f64::from(self))
    }
}

impl Number for u32 {
    const TYPE: &'static str = "u32";

    fn literal(self) -> String {
        format!("{self}u")
    }
}

/// Sizes, which are less than 2³² on devices.
impl Number for usize {
    const TYPE: &'static str = "u32";

    fn literal(self) -> String {
        format!("{self}u")
    }
}

/// `const NAME: type = value;` in WGSL for each of `values`, so that no number is written twice.
#[must_use]
pub fn constants<T: Number>(values: &[(&str, T)]) -> String {
    let line = |(name, value): &(&str, T)| format!("const {name}: {} = {};\n", T::TYPE, value.literal());
    values.iter().map(line).collect()
}

/// The offsets of the fields of a WGSL struct, for comparison with a Rust struct.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StructLayout {
    /// Its size.
    pub bytes: u32,
    /// Names and first bytes of its fields.
    pub fields: Vec<(String, u32)>,
}

/// Asserts that struct `$shader` of WGSL, a list of sources, and `$rust` have the same members at the same offsets,
/// and the same size. For tests of authors of kernels. It needs no device.
#[macro_export]
macro_rules! assert_layout {
    ($sources:expr, $shader:ident, $rust:ident { $($member:ident),* $(,)? }) => {
        let layout = $crate::struct_layout("layout", $sources, stringify!($shader))
            .unwrap_or_else(|error| panic!("{error}"));
        let rust = vec![$((stringify!($member).to_owned(), std::mem::offset_of!($rust, $member) as u32)),*];
        assert_eq!((rust, size_of::<$rust>() as u32), (layout.fields, layout.bytes));
    };
}

/// The layout of struct `name` in `sources`.
///
/// # Errors
/// [`GpuError::Shader`] if the sources are not valid or there is no such struct.
pub fn struct_layout(label: &str, sources: &[&str], name: &str) -> Result<StructLayout, GpuError> {
    let module = Reflected::new(label, &sources.concat())?.module;
    for (_, ty) in module.types.iter() {
        if let (Some(found), TypeInner::Struct { members, span }) = (&ty.name, &ty.inner)
            && found == name
        {
            let fields = members.iter().map(|m| (m.name.clone().unwrap_or_default(), m.offset)).collect();
            return Ok(StructLayout { bytes: *span, fields });
        }
    }
    Err(GpuError::Shader { label: label.to_owned(), message: format!("expected struct {name}, found none") })
}

/// A valid module.
#[derive(Debug)]
pub(crate) struct Reflected {
    module: naga::Module,
    info: ModuleInfo,
}

/// A buffer that a kernel uses.
#[derive(Clone, Debug)]
pub(crate) struct Binding {
    /// In the WGSL.
    pub name: String,
    /// Its number in group 0.
    pub number: u32,
    pub ty: wgpu::BufferBindingType,
}

impl Reflected {
    pub fn new(label: &str, source: &str) -> Result<Self, GpuError> {
        let shader = |message: String| GpuError::Shader { label: label.to_owned(), message };
        // Every extension is enabled here; a device refuses the extensions that it lacks.
        let module = naga::front::wgsl::parse_str(source).map_err(|e| shader(e.emit_to_string(source)))?;
        let info = Validator::new(ValidationFlags::all(), Capabilities::all())
            .validate(&module)
            .map_err(|e| shader(e.emit_to_string(source)))?;
        Ok(Self { module, info })
    }

    /// The buffers that `entry` uses.
    pub fn bindings(&self, label: &str, entry: &str) -> Result<Vec<Binding>, GpuError> {
        let shader = |message: String| GpuError::Shader { label: label.to_owned(), message };
        let Self { module, info } = self;
        let Some(index) = module.entry_points.iter().position(|e| e.name == entry) else {
            let names: Vec<&str> = module.entry_points.iter().map(|e| e.name.as_str()).collect();
            return Err(shader(format!("expected entry point {entry}, found {}", names.join(", "))));
        };
        let usage = info.get_entry_point(index);
        let mut bindings = Vec::new();
        for (handle, variable) in module.global_variables.iter() {
            let Some(binding) = &variable.binding else { continue };
            if usage[handle] == GlobalUse::empty() {
                continue;
            }
            let name = variable.name.clone().unwrap_or_default();
            let ty = match variable.space {
                AddressSpace::Uniform => wgpu::BufferBindingType::Uniform,
                AddressSpace::Storage { access } => {
                    let read_only = !access.contains(StorageAccess::STORE);
                    wgpu::BufferBindingType::Storage { read_only }
                }
                _ => return Err(shader(format!("expected buffers only, found {name}"))),
            };
            if binding.group != 0 {
                return Err(shader(format!("{name}: expected group 0, found {}", binding.group)));
            }
            bindings.push(Binding { name, number: binding.binding, ty });
        }
        Ok(bindings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constants_are_exact() {
        let text = constants(&[("LEAST", f32::MIN_POSITIVE), ("MOST", f32::MAX), ("THIRD", 1.0 / 3.0)])
            + &constants(&[("ALL", u32::MAX)])
            + &constants(&[("SIDE", 16_usize)]);
        let module = Reflected::new("constants", &text).unwrap().module;
        let values: Vec<naga::Literal> = module
            .constants
            .iter()
            .filter_map(|(_, constant)| match module.global_expressions[constant.init] {
                naga::Expression::Literal(literal) => Some(literal),
                _ => None,
            })
            .collect();
        use naga::Literal::{F32, U32};
        let expected = [F32(f32::MIN_POSITIVE), F32(f32::MAX), F32(1.0 / 3.0), U32(u32::MAX), U32(16)];
        assert_eq!(values, expected);
    }
    use crate::capabilities::{Limits, Subgroups};
    use crate::sort::SortPlan;
    use gs3_test_support::check_literals;

    use crate::{ceilings, scan, sort};

    fn check(label: &str, sources: &[String]) {
        validate(label, &sources.iter().map(String::as_str).collect::<Vec<_>>()).unwrap();
    }

    #[test]
    fn every_shader_is_valid() {
        let limits = Limits {
            buffer_bytes: 1 << 30,
            binding_bytes: 1 << 30,
            workgroup_bytes: 32 << 10,
            ..Limits::LEAST
        };
        let mut used = String::new();
        for subgroups in [Subgroups::Absent, Subgroups::Present { min: 8, max: 32 }] {
            for bits in [1, 8, 13, 32] {
                let plan = SortPlan::new(&limits, subgroups, 1000, bits).unwrap();
                let source = sort::source(&plan);
                check("sort", &source);
                used += &source.concat();
            }
            let source = scan::source(subgroups);
            check("scan", &source);
            used += &source.concat();
        }
        for source in ceilings::sources() {
            validate("ceilings", &[&source]).unwrap();
            used += &source;
        }
        // No file is forgotten.
        let mut files = 0;
        let mut explained = 0;
        for folder in ["src", "src/ceilings", "src/scan", "src/sort"] {
            let folder = format!("{}/{folder}", env!("CARGO_MANIFEST_DIR"));
            explained += check_literals(&folder);
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.extension().is_some_and(|e| e == "wgsl") {
                    let text = std::fs::read_to_string(&path).unwrap();
                    assert!(used.contains(&text), "{} is in no shader tested here", path.display());
                    files += 1;
                }
            }
        }
        assert_eq!((files, explained), (11, 11));
    }

    #[test]
    fn layouts_are_those_of_wgsl() {
        let source = "struct Camera { eye: vec3<f32>, focal: f32, size: vec2<u32>, last: vec3<f32> }
                      @group(0) @binding(0) var<uniform> camera: Camera;";
        let layout = struct_layout("camera", &[source], "Camera").unwrap();
        let fields = [("eye", 0), ("focal", 12), ("size", 16), ("last", 32)].map(|(n, o)| (n.to_owned(), o));
        assert_eq!(layout, StructLayout { bytes: 48, fields: fields.into() });
        assert!(matches!(struct_layout("camera", &[source], "Eye"), Err(GpuError::Shader { .. })));
        assert!(validate("broken", &["fn f( {}"]).is_err());
    }
}
