//! The grid of the samples of a jittered LR frame, as seen from HR pixels.

/// Largest distance of a sample from a pixel's centre to count as on it, in pixels: a hundred times the rounding
/// error.
const CENTRE_TOLERANCE: f32 = 1e-3;

/// One HR coordinate on the LR sample grid: between samples `index` and `index + 1`, at `fraction` of the way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct GridPosition {
    /// The sample at or before the coordinate; −1 or less before the first sample.
    pub index: isize,
    /// `[0, 1)`.
    pub fraction: f32,
}

/// One axis of the sample grid of a jittered LR frame, as seen from HR pixel centres.
///
/// LR sample `i` lies at HR coordinate `S (i + ½ + jitter)`. HR pixel `x` has its centre at `x + ½`. So the pixel's
/// position is `(x + ½)/S − ½ − jitter` samples. The fraction repeats every `S` pixels: there are `S` phases.
#[derive(Clone, Debug, Default)]
pub(crate) struct SampleAxis {
    phases: Vec<GridPosition>,
}

impl SampleAxis {
    pub fn new(scale: u32, jitter: f32) -> Self {
        let mut axis = Self::default();
        axis.set(scale, jitter);
        axis
    }

    /// Makes this the axis of another frame, reusing its memory.
    pub fn set(&mut self, scale: u32, jitter: f32) {
        let s = f64::from(scale);
        self.phases.clear();
        self.phases.extend((0..scale).map(|r| {
            let position = (f64::from(r) + 0.5) / s - 0.5 - f64::from(jitter);
            // Jitters are f32 numbers such as 1/6. Their rounding must not move a pixel that coincides with a sample
            // into the cell before it, at a fraction of 0.99999997.
            let position =
                if (position - position.round()).abs() < 1e-6 { position.round() } else { position };
            GridPosition { index: position.floor() as isize, fraction: (position - position.floor()) as f32 }
        }));
    }

    /// The positions of the pixels of one period.
    pub fn phases(&self) -> &[GridPosition] {
        &self.phases
    }

    /// The position of HR pixel `x`.
    pub fn position(&self, x: usize) -> GridPosition {
        let scale = self.phases.len();
        let phase = self.phases[x % scale];
        GridPosition { index: phase.index + (x / scale) as isize, fraction: phase.fraction }
    }
}

/// The pixels with a sample of the frame on their centres: every S-th pixel, if the jitter is on the S×S grid.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SampledPixels {
    pub first: [usize; 2],
    scale: usize,
}

impl SampledPixels {
    /// The grid of samples `scale` pixels apart with this jitter; none if the samples are not on pixel centres.
    pub fn new(jitter: [f32; 2], scale: u32) -> Option<Self> {
        let offset = jitter.map(|j| (0.5 + j) * scale as f32 - 0.5);
        let is_exact = |o: &f32| {
            *o >= -CENTRE_TOLERANCE && (o - o.round()).abs() < CENTRE_TOLERANCE && o.round() < scale as f32
        };
        // Not negative, and below the scale.
        let first = offset.map(|o| o.round() as usize);
        offset.iter().all(is_exact).then_some(Self { first, scale: scale as usize })
    }

    /// Samples along an axis on the `count` pixels starting at `from`: the indices of the samples, and their pixels
    /// relative to `from`.
    pub fn along(
        &self,
        axis: usize,
        from: usize,
        count: usize,
    ) -> impl Iterator<Item = (usize, usize)> + use<> {
        let (first, scale) = (self.first[axis], self.scale);
        let begin = from.saturating_sub(first).div_ceil(scale);
        (begin..).map(move |i| (i, first + i * scale - from)).take_while(move |(_, at)| *at < count)
    }

    /// The rows of samples that lie on pixel rows `top..top + count`.
    pub fn rows(&self, top: usize, count: usize) -> std::ops::Range<usize> {
        let before = |row: usize| row.saturating_sub(self.first[1]).div_ceil(self.scale);
        before(top)..before(top + count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grid_jitter_puts_samples_on_pixel_centres() {
        for scale in 1..=4_u32 {
            for a in 0..scale {
                let s = scale as f32;
                let axis = SampleAxis::new(scale, (a as f32 - (s - 1.0) / 2.0) / s);
                for x in 0..20_usize {
                    let position = axis.position(x);
                    let hits = x % scale as usize == a as usize;
                    assert_eq!(
                        position.fraction == 0.0,
                        hits,
                        "scale {scale}, offset {a}, pixel {x}: {position:?}"
                    );
                    if hits {
                        assert_eq!(position.index, (x / scale as usize) as isize);
                    }
                }
            }
        }
    }

    #[test]
    fn any_jitter_is_the_formula() {
        let axis = SampleAxis::new(3, 0.31);
        for x in 0..30_usize {
            let position = axis.position(x);
            let expected = (x as f64 + 0.5) / 3.0 - 0.5 - f64::from(0.31_f32);
            assert!((position.index as f64 + f64::from(position.fraction) - expected).abs() < 1e-6);
            assert!((0.0..1.0).contains(&position.fraction));
        }
    }
}
