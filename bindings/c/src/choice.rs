//! The numbers of enumerations: callers may pass any.

use crate::status::Fault;

/// What `value` stands for among `all` numbers of the header's enumeration `of`, which begin at 0.
pub fn choice<T: Copy>(field: &str, of: &str, value: u32, all: &[(u32, T)]) -> Result<T, Fault> {
    let found = all.iter().find(|(number, _)| *number == value);
    found
        .map(|(_, meaning)| *meaning)
        .ok_or_else(|| Fault::argument(field, format_args!("0 to {} ({of})", all.len() - 1), value))
}

/// A yes, 1, or a no, 0.
pub fn flag(field: &str, value: u32) -> Result<bool, Fault> {
    match value {
        0 => Ok(false),
        1 => Ok(true),
        _ => Err(Fault::argument(field, "0 or 1", value)),
    }
}

/// `value`, or `default` where it is 0.
pub const fn or_default(value: u32, default: u32) -> u32 {
    if value == 0 { default } else { value }
}
