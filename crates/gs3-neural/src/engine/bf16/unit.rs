//! What multiplies bf16 numbers, and where it is.

use std::sync::OnceLock;

/// Instructions of x86 processors that multiply bf16 numbers and add f32.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// A vector of 16 pairs of numbers (`VDPBF16PS`).
    Avx512Bf16,
    /// A tile of 16 × 32 numbers by one of 32 × 16 (`TDPBF16PS`).
    Amx,
}

impl Unit {
    /// The faster of those that this machine has.
    pub fn best() -> Option<Self> {
        [Self::Amx, Self::Avx512Bf16].into_iter().find(|unit| unit.is_available())
    }

    /// Whether this machine has it, and its operating system lets the process use it.
    pub fn is_available(self) -> bool {
        static TILES: OnceLock<bool> = OnceLock::new();
        match self {
            Self::Avx512Bf16 => machine::has_pairs(),
            // Once, as it asks the operating system.
            Self::Amx => *TILES.get_or_init(|| machine::has_pairs() && machine::has_tiles()),
        }
    }

    /// Whether it is faster than f32: tiles are on all machines that have them; pairs where they start as often as f32
    /// multiply-adds of half as many numbers, on AMD's.
    pub fn gains(self) -> bool {
        match self {
            Self::Amx => true,
            Self::Avx512Bf16 => machine::vendor() == *b"AuthenticAMD",
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod machine {
    use core::arch::x86_64::{__cpuid, __cpuid_count};

    pub fn has_pairs() -> bool {
        // The two last ones store parts of vectors; no processor lacks them that has the others.
        gs3_simd::level().as_avx512().is_some()
            && is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512bf16")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512vl")
    }

    /// Leaf 7 of `cpuid`: bits 22 and 24 of register d are AMX-BF16 and AMX-TILE.
    pub fn has_tiles() -> bool {
        const AMX: u32 = 1 << 22 | 1 << 24;
        gs3_simd::level().as_avx512().is_some()
            && __cpuid(0).eax >= 7
            && __cpuid_count(7, 0).edx & AMX == AMX
            && may_use_tiles()
    }

    /// Tiles are 8 KiB of a thread's state, which Linux saves only for processes that ask for it. It refuses where it
    /// does not know them, or where the stack that a thread handles signals on is too small for them.
    #[cfg(target_os = "linux")]
    #[allow(unsafe_code, reason = "a system call")]
    fn may_use_tiles() -> bool {
        /// `asm/prctl.h`.
        const ARCH_REQ_XCOMP_PERM: libc::c_long = 0x1023;
        /// The state component of tiles, among the extended states.
        const XTILEDATA: libc::c_long = 18;
        // SAFETY: it takes numbers and gives one; nothing of this process changes but what it may use.
        unsafe { libc::syscall(libc::SYS_arch_prctl, ARCH_REQ_XCOMP_PERM, XTILEDATA) == 0 }
    }

    /// How others are asked was not tried.
    #[cfg(not(target_os = "linux"))]
    fn may_use_tiles() -> bool {
        false
    }

    /// Who made the processor: leaf 0 of `cpuid`, its text in registers b, d, c.
    pub fn vendor() -> [u8; 12] {
        let leaf = __cpuid(0);
        let mut name = [0; 12];
        for (bytes, register) in name.chunks_exact_mut(4).zip([leaf.ebx, leaf.edx, leaf.ecx]) {
            bytes.copy_from_slice(&register.to_le_bytes());
        }
        name
    }
}

#[cfg(not(target_arch = "x86_64"))]
mod machine {
    pub fn has_pairs() -> bool {
        false
    }

    pub fn has_tiles() -> bool {
        false
    }

    pub fn vendor() -> [u8; 12] {
        [0; 12]
    }
}
