//! Buffers that results share when they are not needed at the same time.

/// Gives out buffers. Separate ones rather than places in one: a kernel may not read and write one buffer, and one
/// binding may be too small for all.
#[derive(Debug, Default)]
pub struct Slots {
    /// Bytes of each.
    pub bytes: Vec<u64>,
    free: Vec<usize>,
}

impl Slots {
    /// A buffer of at least `bytes`: of the free ones the smallest that is long enough, else the longest, grown.
    pub fn take(&mut self, bytes: u64) -> usize {
        let enough = self.free.iter().copied().filter(|slot| self.bytes[*slot] >= bytes);
        let best = enough
            .min_by_key(|slot| self.bytes[*slot])
            .or_else(|| self.free.iter().copied().max_by_key(|slot| self.bytes[*slot]));
        match best {
            Some(slot) => {
                self.free.retain(|free| *free != slot);
                self.bytes[slot] = self.bytes[slot].max(bytes);
                slot
            }
            None => {
                self.bytes.push(bytes);
                self.bytes.len() - 1
            }
        }
    }

    /// `slot` is no longer needed.
    pub fn give_back(&mut self, slot: usize) {
        self.free.push(slot);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn free_buffers_are_taken_again() {
        let mut slots = Slots::default();
        let (a, b) = (slots.take(100), slots.take(10));
        slots.give_back(a);
        slots.give_back(b);
        assert_eq!((slots.take(5), slots.take(200)), (b, a));
        assert_eq!(slots.take(1), 2);
        assert_eq!(slots.bytes, [200, 10, 1]);
    }
}
