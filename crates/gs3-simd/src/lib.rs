//! The vector instructions that all CPU kernels use: the best that the processor has, or those that the environment
//! variable `GS3_SIMD` names.
//!
//! | `GS3_SIMD` | instructions |
//! |---|---|
//! | unset or empty | the best that the processor has |
//! | `scalar` | those that every processor of the architecture has: SSE2 on x86-64, NEON on 64-bit ARM, none elsewhere |
//! | `sse2`, `sse4.2`, `avx2`, `avx512` | x86: SSE2; x86-64-v2; x86-64-v3; AVX-512 as of Ice Lake |
//! | `neon` | 64-bit ARM |
//!
//! [`prefetch`] is the same on every level.
//!
//! ```
//! let level = gs3_simd::level();
//! assert!(gs3_simd::levels().iter().any(|(name, _)| *name == gs3_simd::name(level)));
//! ```

mod prefetch;
mod tests_on_levels;

use std::env;
use std::sync::LazyLock;

use fearless_simd::Level;

pub use prefetch::prefetch;
pub use tests_on_levels::repeat_tests_on_levels;

/// The environment variable that names a level.
pub const VARIABLE: &str = "GS3_SIMD";

/// All names that [`VARIABLE`] accepts, on any CPU.
const NAMES: [&str; 6] = ["scalar", "sse2", "sse4.2", "avx2", "avx512", "neon"];

/// Why the level that [`VARIABLE`] asks for cannot be had.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SimdError {
    /// No level has this name.
    #[error("{VARIABLE}: expected one of {}, found {actual:?}", NAMES.join(", "))]
    Unknown {
        /// The variable's value.
        actual: String,
    },
    /// The processor lacks the level.
    #[error("{VARIABLE}: expected a level that this processor has ({}), found {actual}", available.join(", "))]
    Missing {
        /// The variable's value.
        actual: String,
        /// The levels that the processor has.
        available: Vec<&'static str>,
    },
}

/// The level that kernels use: the one that [`VARIABLE`] asks for, or else the best.
///
/// Where the one asked for cannot be had, it is the best, and the first call says so on standard error; programs that
/// would rather stop ask [`requested`] first. The variable is read once.
#[must_use]
pub fn level() -> Level {
    static LEVEL: LazyLock<Level> = LazyLock::new(|| {
        requested().unwrap_or_else(|error| {
            let best = Level::new();
            eprintln!("warning: {error}; {} is used", name(best));
            best
        })
    });
    *LEVEL
}

/// The level that [`VARIABLE`] asks for, the best if the variable is unset or empty.
///
/// # Errors
/// [`SimdError`] if the variable names no level or one that the processor lacks.
pub fn requested() -> Result<Level, SimdError> {
    env::var_os(VARIABLE).map_or_else(|| Ok(Level::new()), |value| by_name(&value.to_string_lossy()))
}

/// The level of this name, the best for the empty name.
fn by_name(wanted: &str) -> Result<Level, SimdError> {
    if wanted.is_empty() {
        return Ok(Level::new());
    }
    if !NAMES.contains(&wanted) {
        return Err(SimdError::Unknown { actual: wanted.to_owned() });
    }
    if wanted == "scalar" {
        return Ok(Level::baseline());
    }
    let levels = levels();
    levels.iter().find(|(name, _)| *name == wanted).map(|(_, level)| *level).ok_or_else(|| {
        SimdError::Missing {
            actual: wanted.to_owned(),
            available: std::iter::once("scalar").chain(levels.iter().map(|(name, _)| *name)).collect(),
        }
    })
}

/// All levels of this processor with their names, from the least to the best.
#[must_use]
pub fn levels() -> Vec<(&'static str, Level)> {
    let best = Level::new();
    let mut levels = Vec::new();
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    {
        levels.extend(best.as_sse2().map(fearless_simd::Simd::level));
        levels.extend(best.as_sse4_2().map(fearless_simd::Simd::level));
        levels.extend(best.as_avx2().map(fearless_simd::Simd::level));
        levels.extend(best.as_avx512().map(fearless_simd::Simd::level));
    }
    #[cfg(target_arch = "aarch64")]
    levels.extend(best.as_neon().map(fearless_simd::Simd::level));
    if levels.is_empty() {
        levels.push(best);
    }
    levels.into_iter().map(|level| (name(level), level)).collect()
}

/// The name of a level, as in [`VARIABLE`]: `scalar` only where there are no vector instructions.
#[must_use]
pub fn name(level: Level) -> &'static str {
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    {
        let names = [
            (level.as_avx512().is_some(), "avx512"),
            (level.as_avx2().is_some(), "avx2"),
            (level.as_sse4_2().is_some(), "sse4.2"),
            (level.as_sse2().is_some(), "sse2"),
        ];
        if let Some((_, name)) = names.into_iter().find(|(is_included, _)| *is_included) {
            return name;
        }
    }
    #[cfg(target_arch = "aarch64")]
    if level.as_neon().is_some() {
        return "neon";
    }
    if level.is_fallback() { "scalar" } else { "other" }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn every_level_of_the_machine_is_found_by_its_name() {
        let levels = levels();
        assert_eq!(levels[0].0, name(by_name("scalar").unwrap()));
        assert_eq!(levels.last().unwrap().0, name(Level::new()));
        for (found, _) in levels {
            assert!(NAMES.contains(&found), "{found}");
            assert_eq!(name(by_name(found).unwrap()), found);
        }
        assert_eq!(name(by_name("").unwrap()), name(Level::new()));
    }

    #[test]
    fn what_is_no_level_is_told_with_what_is() {
        let error = by_name("avx3").unwrap_err().to_string();
        assert_eq!(
            error,
            "GS3_SIMD: expected one of scalar, sse2, sse4.2, avx2, avx512, neon, found \"avx3\""
        );
    }

    #[test]
    fn a_level_of_another_architecture_is_missing() {
        let foreign = if cfg!(target_arch = "aarch64") { "avx2" } else { "neon" };
        let error = by_name(foreign).unwrap_err();
        assert!(matches!(&error, SimdError::Missing { available, .. } if available.contains(&"scalar")));
        assert!(error.to_string().contains(&format!("found {foreign}")), "{error}");
    }
}
