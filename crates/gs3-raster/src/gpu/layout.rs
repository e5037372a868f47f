//! Compares structs here with those of the shaders, without a device.

/// Names and offsets of the members of struct `name` of WGSL `source`, and its size.
pub fn of_shader(source: &str, name: &str) -> (Vec<(String, usize)>, usize) {
    let module = naga::front::wgsl::parse_str(source).expect("valid WGSL");
    let found = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(name));
    let naga::TypeInner::Struct { members, span } = &found.expect("the struct").1.inner else {
        panic!("{name} is no struct");
    };
    let members = members.iter().map(|m| (m.name.clone().unwrap_or_default(), m.offset as usize));
    (members.collect(), *span as usize)
}

/// Asserts that a struct of WGSL and one of Rust have the same members at the same offsets, and the same size.
macro_rules! assert_layout {
    ($source:expr, $shader:ident, $rust:ident { $($member:ident),* $(,)? }) => {
        let rust = vec![$((stringify!($member).to_owned(), std::mem::offset_of!($rust, $member))),*];
        let expected = $crate::gpu::layout::of_shader($source, stringify!($shader));
        assert_eq!((rust, size_of::<$rust>()), expected);
    };
}

pub(crate) use assert_layout;
