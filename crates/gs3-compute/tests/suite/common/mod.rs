//! What the tests of devices share.

use gs3_compute::{Gpu, GpuSettings, OptionalFeatures, device_for_tests};

/// The devices of this machine: with all features and with none.
pub fn devices() -> Vec<Gpu> {
    let features = [OptionalFeatures::All, OptionalFeatures::None];
    let open = |features| device_for_tests(&GpuSettings { features, ..GpuSettings::default() });
    features.into_iter().filter_map(open).collect()
}

/// xorshift32*: numbers without pattern, the same every time.
#[allow(dead_code, reason = "not every test needs numbers")]
pub struct Random(u64);

#[allow(dead_code, reason = "not every test needs numbers")]
impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    pub fn next(&mut self) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 32) as u32
    }
}
