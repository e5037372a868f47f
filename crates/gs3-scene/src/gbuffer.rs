//! The G-buffer: what is rasterized at low resolution and what reconstruction reads. Any renderer can fill one.

use rayon::prelude::*;

use crate::size::Size;

/// Rows that a thread copies at a time: shorter tasks cost more than they copy.
const ROWS_AT_ONCE: usize = 64;

/// `C` planes of f32, `[C, height, width]`, in one allocation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Planes<const C: usize> {
    width: usize,
    height: usize,
    data: Vec<f32>,
}

impl<const C: usize> Planes<C> {
    /// Zeroed planes.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, data: vec![0.0; C * width * height] }
    }

    /// Planes of given numbers, `[C, height, width]`: of another renderer, say, which gives pixel after pixel.
    ///
    /// ```
    /// use gs3_scene::{GBuffer, Planes};
    ///
    /// let (width, height) = (4, 2);
    /// let pixels = vec![[0.1, 0.2, 0.3]; width * height];
    /// let planar = (0..3).flat_map(|c| pixels.iter().map(move |pixel| pixel[c])).collect();
    ///
    /// let mut frame = GBuffer::zeroed(width, height);
    /// frame.color = Planes::from_data(width, height, planar).ok_or("another size")?;
    /// assert_eq!(frame.color.row(2, 1), [0.3; 4]);
    /// # Ok::<(), &str>(())
    /// ```
    ///
    /// Returns `None` if `data` does not hold `C × height × width` of them.
    #[must_use]
    pub fn from_data(width: usize, height: usize, data: Vec<f32>) -> Option<Self> {
        let len = width.checked_mul(height)?.checked_mul(C)?;
        (data.len() == len).then_some(Self { width, height, data })
    }

    /// Width in pixels.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    #[must_use]
    pub const fn height(&self) -> usize {
        self.height
    }

    /// Width and height.
    #[must_use]
    pub fn size(&self) -> Size {
        Size::of(self.width, self.height)
    }

    /// All planes, `[C, height, width]`.
    #[must_use]
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// All planes, `[C, height, width]`.
    #[must_use]
    pub fn data_mut(&mut self) -> &mut [f32] {
        &mut self.data
    }

    /// Plane `c`, `[height, width]`.
    ///
    /// # Panics
    /// If there is no plane `c`.
    #[must_use]
    pub fn plane(&self, c: usize) -> &[f32] {
        let size = self.width * self.height;
        &self.data[c * size..(c + 1) * size]
    }

    /// Plane `c`, `[height, width]`.
    ///
    /// # Panics
    /// If there is no plane `c`.
    #[must_use]
    pub fn plane_mut(&mut self, c: usize) -> &mut [f32] {
        let size = self.width * self.height;
        &mut self.data[c * size..(c + 1) * size]
    }

    /// Whether no number is infinite or NaN.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        /// The bits of the exponent: all are set in what is not finite.
        const EXPONENT: u32 = 0x7F80_0000;
        /// Numbers that are looked at without a branch, so by vectors, and by one thread.
        const RUN: usize = 1 << 14;
        let largest = |run: &[f32]| run.iter().fold(0, |most, v| (v.to_bits() & EXPONENT).max(most));
        self.data.par_chunks(RUN).all(|run| largest(run) < EXPONENT)
    }

    /// Row `y` of plane `c`, `[width]`.
    ///
    /// # Panics
    /// If there is no such row or plane.
    #[must_use]
    pub fn row(&self, c: usize, y: usize) -> &[f32] {
        let start = (c * self.height + y) * self.width;
        &self.data[start..start + self.width]
    }

    /// Makes the planes `width`×`height`, reusing their memory. The contents are unspecified afterwards.
    pub fn resize(&mut self, width: usize, height: usize) {
        self.data.resize(C * width * height, 0.0);
        self.width = width;
        self.height = height;
    }

    /// Makes `out` these planes without `margin`, as far as they are larger.
    fn crop(&self, margin: Margin, out: &mut Self) {
        let [left, top, right, bottom] =
            [margin.left, margin.top, margin.right, margin.bottom].map(|side| side as usize);
        let width = self.width.saturating_sub(left + right);
        let height = self.height.saturating_sub(top + bottom);
        out.resize(width, height);
        if width == 0 || height == 0 {
            return;
        }
        out.data.par_chunks_exact_mut(width).with_min_len(ROWS_AT_ONCE).enumerate().for_each(|(k, row)| {
            row.copy_from_slice(&self.row(k / height, top + k % height)[left..left + width]);
        });
    }
}

/// Exact derivatives of the blended colour with respect to the pixel position, per pixel of the G-buffer's own grid.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gradients {
    /// ∂colour/∂x, RGB.
    pub color_dx: Planes<3>,
    /// ∂colour/∂y, RGB.
    pub color_dy: Planes<3>,
    /// ∂²colour/∂x∂y, RGB, where it was asked for.
    pub color_dxy: Option<Planes<3>>,
}

/// Depth and normals. Planes that were not asked for are empty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Geometry {
    /// View-space depth z of the surface at which transmittance falls to one half, world units, forward positive; 0, as
    /// anything that is not positive and finite, where nothing was hit.
    pub depth_median: Planes<1>,
    /// Mean view-space depth z of what was blended, weighted by contribution, world units; 0 where nothing was hit.
    pub depth_expected: Planes<1>,
    /// View-space normal, accumulated with the blending weights (length = share of opaque, agreeing normals),
    /// x right, y down, z forward; facing normals have negative z.
    pub normal: Planes<3>,
}

/// Pixels rasterized beyond the edges of the picture (overscan, or a guard band): what a turning camera will show next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Margin {
    /// Columns before the first.
    pub left: u32,
    /// Rows above the first.
    pub top: u32,
    /// Columns after the last.
    pub right: u32,
    /// Rows below the last.
    pub bottom: u32,
}

impl Margin {
    /// Nothing beyond the edges.
    pub const NONE: Self = Self { left: 0, top: 0, right: 0, bottom: 0 };

    /// The same beyond each edge.
    #[must_use]
    pub const fn all(pixels: u32) -> Self {
        Self { left: pixels, top: pixels, right: pixels, bottom: pixels }
    }

    /// The size of a picture of `size` with its margin.
    #[must_use]
    pub const fn padded(self, size: Size) -> Size {
        Size {
            width: size.width.saturating_add(self.left).saturating_add(self.right),
            height: size.height.saturating_add(self.top).saturating_add(self.bottom),
        }
    }

    /// The widest of the four.
    #[must_use]
    pub fn widest(self) -> u32 {
        self.left.max(self.top).max(self.right).max(self.bottom)
    }
}

/// One rasterized frame with what only Gaussians give: exact gradients, depth, normals.
///
/// Pixel `(i, j)` is the point sample of the image at `(i + 0.5 + jitter.x, j + 0.5 + jitter.y)` of this grid. The
/// grid's origin lies [`Self::margin`] left of and above the picture's. All planes that are there have
/// the same size. All values except depths are finite.
///
/// Another renderer must fill the planes that are read: enlarging reads colour; Hermite interpolation also reads
/// gradients; super sampling and interpolation over time also read median depths; networks also read alpha and
/// normals. Reconstruction does not read expected depths.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GBuffer {
    /// Offset of the sample positions from the pixel centres, in pixels of this grid.
    pub jitter: [f32; 2],
    /// How much of the planes lies beyond the edges of the picture.
    pub margin: Margin,
    /// Colour over the background, display-encoded RGB, not clamped above.
    pub color: Planes<3>,
    /// Opacity 1 − T, `[0, 1]`.
    pub alpha: Planes<1>,
    /// Image gradients, where they were asked for.
    pub gradients: Option<Gradients>,
    /// Depth and normals, where they were asked for.
    pub geometry: Option<Geometry>,
}

impl GBuffer {
    /// A black, transparent frame with gradients, depth and normals, all zero, for a renderer to fill.
    #[must_use]
    pub fn zeroed(width: usize, height: usize) -> Self {
        let (rgb, single) = (Planes::new(width, height), Planes::new(width, height));
        Self {
            jitter: [0.0; 2],
            margin: Margin::NONE,
            gradients: Some(Gradients { color_dx: rgb.clone(), color_dy: rgb.clone(), color_dxy: None }),
            geometry: Some(Geometry {
                depth_median: single.clone(),
                depth_expected: single.clone(),
                normal: rgb.clone(),
            }),
            color: rgb,
            alpha: single,
        }
    }

    /// Width in pixels, the margin included.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.color.width()
    }

    /// Height in pixels, the margin included.
    #[must_use]
    pub const fn height(&self) -> usize {
        self.color.height()
    }

    /// Width and height, the margin included.
    #[must_use]
    pub fn size(&self) -> Size {
        self.color.size()
    }

    /// Makes `out` the picture alone, without the margin around it, reusing memory.
    pub fn crop(&self, out: &mut Self) {
        let Self { jitter, margin, color, alpha, gradients, geometry } = self;
        (out.jitter, out.margin) = (*jitter, Margin::NONE);
        color.crop(*margin, &mut out.color);
        alpha.crop(*margin, &mut out.alpha);
        crop_some(gradients, &mut out.gradients, |from, to| {
            from.color_dx.crop(*margin, &mut to.color_dx);
            from.color_dy.crop(*margin, &mut to.color_dy);
            crop_some(&from.color_dxy, &mut to.color_dxy, |from, to| from.crop(*margin, to));
        });
        crop_some(geometry, &mut out.geometry, |from, to| {
            from.depth_median.crop(*margin, &mut to.depth_median);
            from.depth_expected.crop(*margin, &mut to.depth_expected);
            from.normal.crop(*margin, &mut to.normal);
        });
    }
}

/// Crops what is there into what was there, or takes it away.
fn crop_some<T: Default>(from: &Option<T>, to: &mut Option<T>, crop: impl Fn(&T, &mut T)) {
    match from {
        Some(from) => crop(from, to.get_or_insert_default()),
        None => *to = None,
    }
}
