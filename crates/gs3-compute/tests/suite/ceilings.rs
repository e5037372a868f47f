//! What a device can do at most.

use crate::common::devices;
use gs3_compute::Ceilings;

#[test]
fn ceilings_are_those_of_some_machine() {
    for gpu in devices() {
        let Ceilings { copy_bytes_per_s, f32_flop_per_s, f16_flop_per_s } = Ceilings::measure(&gpu).unwrap();
        println!("{copy_bytes_per_s:.3e} B/s, {f32_flop_per_s:.3e} FLOP/s, f16 {f16_flop_per_s:?}");
        // From a tenth of a loaded core to a hundred times the fastest GPU of 2026.
        assert!((1e8..1e15).contains(&copy_bytes_per_s), "{copy_bytes_per_s}");
        assert!((1e8..1e16).contains(&f32_flop_per_s), "{f32_flop_per_s}");
        assert_eq!(f16_flop_per_s.is_some(), gpu.capabilities().shader_f16);
        assert!(f16_flop_per_s.is_none_or(|rate| (1e7..1e16).contains(&rate)), "{f16_flop_per_s:?}");
    }
}
