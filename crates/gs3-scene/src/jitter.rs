//! Sub-pixel offsets of the low-resolution sampling grid, one per frame.

/// The offsets of the LR camera over time, in LR pixels from the pixel centre, each within `(-0.5, 0.5)`.
#[derive(Clone, Debug, PartialEq)]
pub struct Jitter {
    offsets: Vec<[f32; 2]>,
}

impl Jitter {
    /// Always the pixel centres.
    #[must_use]
    pub fn none() -> Self {
        Self { offsets: vec![[0.0, 0.0]] }
    }

    /// The exact `scale`×`scale` grid: offsets `((a − (S−1)/2) / S, (b − (S−1)/2) / S)`, so that every LR pixel of a
    /// frame is the sample of HR pixel `(a, b)` of its block, and any S² frames in a row hold all of them.
    ///
    /// The order is a farthest-point sequence on the torus, so that also the first few frames after a cut or a
    /// disocclusion are spread well: each offset is as far as possible from the ones before, the block repeating in
    /// all directions; among equals, the one with the largest sum of squared distances to them, then the first in
    /// row order.
    ///
    /// `scale` is at most 16, and held to it: finding the order takes S⁶ steps.
    #[must_use]
    pub fn grid(scale: u32) -> Self {
        let s = scale.clamp(1, 16);
        let offset = |i: u32| ((f64::from(i) - f64::from(s - 1) * 0.5) / f64::from(s)) as f32;
        let mut offsets = Vec::new();
        for [a, b] in farthest_points(s) {
            offsets.push([offset(a), offset(b)]);
        }
        Self { offsets }
    }

    /// The offset `[x, y]` of frame `frame`.
    #[must_use]
    pub fn offset(&self, frame: u64) -> [f32; 2] {
        self.offsets[(frame % self.offsets.len() as u64) as usize]
    }

    /// Number of frames after which the offsets repeat, at least 1.
    #[must_use]
    pub fn period(&self) -> usize {
        self.offsets.len()
    }
}

/// All cells of an `s`×`s` torus, farthest first.
fn farthest_points(s: u32) -> Vec<[u32; 2]> {
    let around = |a: u32, b: u32| a.abs_diff(b).min(s - a.abs_diff(b));
    let distance = |p: [u32; 2], q: [u32; 2]| around(p[0], q[0]).pow(2) + around(p[1], q[1]).pow(2);
    let mut rest: Vec<[u32; 2]> = (0..s * s).map(|i| [i % s, i / s]).collect();
    let mut chosen = vec![rest.remove(0)];
    while !rest.is_empty() {
        let rank = |p: [u32; 2]| {
            let nearest = chosen.iter().map(|q| distance(p, *q)).min().unwrap_or(0);
            (nearest, chosen.iter().map(|q| distance(p, *q)).sum::<u32>())
        };
        let best = (0..rest.len()).rev().max_by_key(|i| rank(rest[*i])).unwrap_or(0);
        chosen.push(rest.remove(best));
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grid_visits_every_pixel_of_the_block_once_and_hits_pixel_centres() {
        for scale in 1..=4_u32 {
            let jitter = Jitter::grid(scale);
            assert_eq!(jitter.period(), (scale * scale) as usize);
            let mut seen = vec![0; (scale * scale) as usize];
            // Any S² consecutive frames, not only the first ones.
            for frame in 5..5 + u64::from(scale * scale) {
                let [x, y] = jitter.offset(frame);
                let s = scale as f32;
                // LR pixel 0 samples HR position S (0.5 + jitter), which has to be the centre of an HR pixel.
                let hr = [x, y].map(|v| s * (0.5 + v) - 0.5);
                let cell = hr.map(|v| v.round());
                assert!((hr[0] - cell[0]).abs() < 1e-5 && (hr[1] - cell[1]).abs() < 1e-5, "{hr:?}");
                seen[(cell[0] + s * cell[1]) as usize] += 1;
            }
            assert!(seen.iter().all(|n| *n == 1), "{seen:?}");
        }
    }

    #[test]
    fn a_hostile_scale_takes_no_time() {
        assert_eq!(Jitter::grid(u32::MAX).period(), 256);
    }

    #[test]
    fn the_first_grid_offsets_are_spread() {
        // Of a 4×4 block, the first two are diagonal, the first four form a 2×2 lattice.
        let jitter = Jitter::grid(4);
        let cells: Vec<[i32; 2]> =
            (0..4).map(|f| jitter.offset(f).map(|v| (v * 4.0 + 1.5).round() as i32)).collect();
        assert_eq!(cells[0], [0, 0]);
        assert_eq!(cells[1], [2, 2]);
        assert_eq!(cells[2], [2, 0]);
        assert_eq!(cells[3], [0, 2]);
    }
}
