//! Counts of workgroups beyond what one dimension of a dispatch takes.

use crate::GpuError;
use crate::wgsl::constants;

/// Workgroups in a row of a dispatch's grid. Every device takes 65,535 along each dimension; a power of two divides
/// fast.
pub const GRID_ROW: u32 = 1 << 15;

/// WGSL beside [`grid`]: `grid_of(groups)` gives a dispatch's counts, `group_index(workgroup_id)` a workgroup's place.
/// The last row may be longer than needed: kernels return where `group_index` is not below their count of groups.
#[must_use]
pub fn grid_source() -> String {
    constants(&[("GRID_ROW", GRID_ROW)]) + include_str!("grid.wgsl")
}

/// The counts of a dispatch of at least `groups` workgroups.
///
/// # Errors
/// [`GpuError::TooLarge`] above 2³⁰ workgroups, which every device takes.
pub fn grid(groups: u32) -> Result<[u32; 3], GpuError> {
    if groups > GRID_ROW * GRID_ROW {
        let max = u64::from(GRID_ROW * GRID_ROW);
        return Err(GpuError::TooLarge { what: "workgroups".to_owned(), max, actual: groups.into() });
    }
    Ok([groups.min(GRID_ROW), groups.div_ceil(GRID_ROW), if groups == 0 { 0 } else { 1 }])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_group_is_there_and_no_row_is_empty() {
        for groups in [0, 1, 5, GRID_ROW - 1, GRID_ROW, GRID_ROW + 1, 50_000_000, GRID_ROW * GRID_ROW] {
            let [x, y, z] = grid(groups).unwrap();
            let count = u64::from(x) * u64::from(y) * u64::from(z);
            assert!(
                count >= groups.into() && count < u64::from(groups) + u64::from(GRID_ROW).max(1),
                "{groups}"
            );
            assert!(x <= 65_535 && y <= 65_535, "{groups}");
        }
        assert!(matches!(grid(u32::MAX), Err(GpuError::TooLarge { actual: 0xFFFF_FFFF, .. })));
    }
}
