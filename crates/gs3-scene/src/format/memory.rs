//! Memory for the Gaussians of a file.

use crate::gaussians::{Gaussians, sh_coefficient_count};

use super::error::LoadError;

/// Zeroed Gaussians for a reader to fill in place.
///
/// # Errors
/// [`LoadError::Memory`] if the system has not enough for them. Without the question the process would end.
pub(super) fn gaussians(file: &str, count: usize, sh_degree: u8) -> Result<Gaussians, LoadError> {
    let needed = bytes(count as u64, sh_degree);
    if needed.is_none_or(|needed| !is_there(needed)) {
        return Err(LoadError::Memory { file: file.to_owned(), expected: needed.unwrap_or(u64::MAX) });
    }
    Ok(Gaussians::zeroed(count, sh_degree))
}

/// What `count` Gaussians take; `None` above 64 bits.
fn bytes(count: u64, sh_degree: u8) -> Option<u64> {
    let floats = 3 + 3 + 4 + 1 + 3 * sh_coefficient_count(sh_degree) as u64;
    count.checked_mul(floats * size_of::<f32>() as u64)
}

/// Whether the system gives so many bytes. They are given back at once, untouched.
#[cfg(not(target_arch = "wasm32"))]
fn is_there(bytes: u64) -> bool {
    // Where nothing is asked for there is nothing to refuse.
    bytes == 0 || usize::try_from(bytes).is_ok_and(|bytes| memmap2::MmapMut::map_anon(bytes).is_ok())
}

/// A module of WebAssembly has at most 4 GiB, and no way to ask.
#[cfg(target_arch = "wasm32")]
fn is_there(bytes: u64) -> bool {
    bytes < 1 << 32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_machine_has_is_an_error() {
        assert_eq!(bytes(1, 3), Some(4 * 59));
        let error = gaussians("a.ply", 1 << 50, 3).expect_err("more than addresses reach");
        let expected = 236_u64 << 50;
        assert_eq!(
            error.to_string(),
            format!("a.ply: Gaussians: expected {expected} bytes of free memory, found less")
        );
        assert!(gaussians("a.ply", usize::MAX, 4).is_err());
        assert_eq!(gaussians("a.ply", 0, 3).map(|g| g.len()).ok(), Some(0));
        assert_eq!(gaussians("a.ply", 10, 3).map(|g| g.len()).ok(), Some(10));
    }
}
