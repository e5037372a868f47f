//! G-buffers in the memory of other renderers, in their layouts.

use gs3_scene::{GBuffer, Geometry, Gradients, Margin, Planes, Size};
use rayon::prelude::*;

use crate::difference::difference;
use crate::error::{ReconstructError, check_size};

/// `C` channels a pixel in the caller's memory. Channel `c` of the pixel in column `x` of row `y` is
/// `data[y · row + x · pixel + c · channel]`.
#[derive(Clone, Copy, Debug)]
pub struct PlanesView<'a, const C: usize> {
    data: &'a [f32],
    size: Size,
    strides: Strides,
}

/// Distances of neighbours in memory, in numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Strides {
    /// From one row to the next.
    pub row: usize,
    /// From one pixel of a row to the next.
    pub pixel: usize,
    /// From one channel of a pixel to the next.
    pub channel: usize,
}

impl<'a, const C: usize> PlanesView<'a, C> {
    /// An image of `size` with numbers `strides` apart.
    ///
    /// # Errors
    /// [`ReconstructError::TooShort`] if `data` ends before the last pixel.
    pub fn new(data: &'a [f32], size: Size, strides: Strides) -> Result<Self, ReconstructError> {
        let last = |count: usize, stride: usize| count.saturating_sub(1).checked_mul(stride);
        let [width, height] = size.to_usize();
        let parts = [last(height, strides.row), last(width, strides.pixel), last(C, strides.channel)];
        let end = parts.into_iter().try_fold(1_usize, |sum, part| sum.checked_add(part?));
        let is_empty = size.pixels() == 0 || C == 0;
        match end {
            Some(end) if is_empty || end <= data.len() => Ok(Self { data, size, strides }),
            _ => {
                let (expected, actual) = (end.unwrap_or(usize::MAX), data.len());
                Err(ReconstructError::TooShort { expected, actual })
            }
        }
    }

    /// An image of `size` without gaps, with `channels` numbers a pixel. The first `C` of them are read:
    /// for the colour of RGBA, `channels` is 4.
    ///
    /// # Errors
    /// [`ReconstructError::TooShort`] if `data` ends before the last pixel.
    pub fn interleaved(data: &'a [f32], size: Size, channels: usize) -> Result<Self, ReconstructError> {
        let row = (size.width as usize).saturating_mul(channels);
        Self::new(data, size, Strides { row, pixel: channels, channel: 1 })
    }

    /// An image of `size`, plane after plane without gaps.
    ///
    /// # Errors
    /// [`ReconstructError::TooShort`] if `data` ends before the last pixel.
    pub fn planar(data: &'a [f32], size: Size) -> Result<Self, ReconstructError> {
        let [width, height] = size.to_usize();
        Self::new(data, size, Strides { row: width, pixel: 1, channel: width.saturating_mul(height) })
    }

    /// Width and height.
    #[must_use]
    pub const fn size(&self) -> Size {
        self.size
    }

    /// Channel `c` of row `y`, pixel after pixel.
    fn row(&self, c: usize, y: usize) -> impl Iterator<Item = f32> + use<'a, C> {
        let Strides { row, pixel, channel } = self.strides;
        let start = y * row + c * channel;
        let data = self.data.get(start..).unwrap_or_default();
        data.iter().step_by(pixel.max(1)).take(self.size.width as usize).copied()
    }

    /// Copies the image into planes, with `convert` applied to every number.
    fn copy_into(&self, out: &mut Planes<C>, convert: impl Fn(f32) -> f32 + Sync) {
        let [width, height] = self.size.to_usize();
        out.resize(width, height);
        let rows = out.data_mut().par_chunks_exact_mut(width.max(1)).enumerate().with_min_len(16);
        rows.for_each(|(k, out)| {
            let row = self.row(k / height, k % height);
            out.iter_mut().zip(row).for_each(|(to, value)| *to = convert(value));
        });
    }
}

impl<'a, const C: usize> From<&'a Planes<C>> for PlanesView<'a, C> {
    fn from(planes: &'a Planes<C>) -> Self {
        let (row, channel) = (planes.width(), planes.width() * planes.height());
        Self { data: planes.data(), size: planes.size(), strides: Strides { row, pixel: 1, channel } }
    }
}

/// The meaning of the numbers of a depth buffer. `near` and `far` are distances of the clip planes along the view
/// axis in world units; `far` may be infinite.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub enum DepthEncoding {
    /// Distance along the view axis in world units; 0 where there is no surface.
    #[default]
    Distance,
    /// Projective depth: 0 at the near plane, 1 at the far plane. 1 means no surface.
    Projective {
        /// Distance of the near plane, above 0.
        near: f32,
        /// Distance of the far plane.
        far: f32,
    },
    /// Reversed projective depth: 1 at the near plane, 0 at the far plane. 0 means no surface.
    Reversed {
        /// Distance of the near plane, above 0.
        near: f32,
        /// Distance of the far plane.
        far: f32,
    },
    /// Linear depth: 0 at the near plane, 1 at the far plane, which must be finite. 1 means no surface.
    Linear {
        /// Distance of the near plane, 0 or more.
        near: f32,
        /// Distance of the far plane.
        far: f32,
    },
}

impl DepthEncoding {
    /// The distance along the view axis in world units; 0 where there is no surface, or if `value` is not a number.
    #[must_use]
    pub fn distance(self, value: f32) -> f32 {
        let is_hit = match self {
            Self::Distance => value > 0.0,
            Self::Projective { .. } | Self::Linear { .. } => value < 1.0,
            Self::Reversed { .. } => value > 0.0,
        };
        if !is_hit {
            return 0.0;
        }
        // 1/z is linear in projective depth: 1/near at one end, and 1/far, which may be 0, at the other end.
        let projective = |value: f32, near: f32, far: f32| {
            let (at_near, at_far) = (1.0 / near, 1.0 / far);
            1.0 / (at_far + (at_near - at_far) * value)
        };
        match self {
            Self::Distance => value,
            Self::Projective { near, far } => projective(1.0 - value, near, far),
            Self::Reversed { near, far } => projective(value, near, far),
            Self::Linear { near, far } => near + (far - near) * value,
        }
    }

    fn check(self) -> Result<(), ReconstructError> {
        let (is_valid, near, far) = match self {
            Self::Distance => return Ok(()),
            Self::Projective { near, far } | Self::Reversed { near, far } => {
                (near > 0.0 && far > near && near.is_finite(), near, far)
            }
            Self::Linear { near, far } => (near >= 0.0 && far > near && far.is_finite(), near, far),
        };
        if is_valid { Ok(()) } else { Err(ReconstructError::ClipPlanes { near, far }) }
    }
}

/// A low-resolution frame in the memory of any renderer: the input of [`crate::Reconstructor`].
///
/// All planes have one size: [`gs3_scene::Camera::low_resolution`] plus the margin. Values are point samples at the
/// LR pixel centres, shifted by the jitter.
#[derive(Clone, Copy, Debug)]
pub struct GBufferView<'a> {
    /// Display-encoded red, green, blue; finite.
    pub color: PlanesView<'a, 3>,
    /// ∂colour/∂x and ∂colour/∂y of the visible surface, per LR pixel. Without gradients, the colours are differenced
    /// ([`crate::difference`] gives the cost).
    pub gradients: Option<[PlanesView<'a, 3>; 2]>,
    /// Depth of the visible surface.
    pub depth: PlanesView<'a, 1>,
    /// The meaning of the numbers of `depth`.
    pub encoding: DepthEncoding,
    /// Motion vectors in LR pixels, x right and y down; finite. A vector points from a surface point's place in this
    /// frame to the same point's place in the previous frame. Both places are without jitter, and the camera's motion
    /// is included: the convention of FSR and DLSS.
    ///
    /// Without motion vectors, everything shown has stood still since the previous frame. A surface also counts as
    /// resting if its vectors differ from the motion by depths and cameras by at most 1/256 pixel plus 1/1024 of the
    /// vector (half precision rounds by as much). Other surfaces carry their history along, and move in the
    /// in-between frames.
    ///
    /// * The vector of a surface that the previous frame does not show anywhere is longer than two pictures.
    /// * Where there is no surface, a vector only says that the past counts as far as the current colours allow.
    /// * Vectors describe the motion of shapes. Lights, shadows and reflections that move over a resting surface are
    ///   seen up to S² frames late.
    /// * The vectors of the first frame after a reset are not read.
    ///
    /// Memory: 96 B per LR pixel, and 20 B per HR pixel once something moves. Time: a few per cent where nothing
    /// moves; a moving HR pixel costs up to ten times as much as a resting one.
    pub motion: Option<PlanesView<'a, 2>>,
    /// Jitter: the offset of the samples from the LR pixel centres, in LR pixels, x right and y down, within ±1.
    pub jitter: [f32; 2],
    /// The margin of the planes, in LR pixels beyond each edge of the picture.
    pub margin: Margin,
}

impl<'a> GBufferView<'a> {
    /// A frame without gradients, motion and margin, with depths as distances along the view axis.
    #[must_use]
    pub fn new(color: PlanesView<'a, 3>, depth: PlanesView<'a, 1>, jitter: [f32; 2]) -> Self {
        Self {
            color,
            gradients: None,
            depth,
            encoding: DepthEncoding::Distance,
            motion: None,
            jitter,
            margin: Margin::NONE,
        }
    }

    /// The planes of `gbuffer`, with its median depths, of a scene that stands still.
    ///
    /// # Errors
    /// [`ReconstructError::Missing`] if `gbuffer` has no geometry.
    pub fn of(gbuffer: &'a GBuffer) -> Result<Self, ReconstructError> {
        let geometry = gbuffer.geometry.as_ref().ok_or(ReconstructError::Missing { what: "depth" })?;
        let gradients = gbuffer.gradients.as_ref();
        Ok(Self {
            gradients: gradients.map(|g| [(&g.color_dx).into(), (&g.color_dy).into()]),
            margin: gbuffer.margin,
            ..Self::new((&gbuffer.color).into(), (&geometry.depth_median).into(), gbuffer.jitter)
        })
    }

    /// Copies the frame into `out`, and its motion, if there is any, into `vectors`. Memory is reused.
    pub(crate) fn copy_into(
        &self,
        out: &mut GBuffer,
        vectors: &mut Planes<2>,
    ) -> Result<(), ReconstructError> {
        self.encoding.check()?;
        let expected = self.color.size();
        check_size("G-buffer depth", expected, self.depth.size())?;
        for plane in self.gradients.iter().flatten() {
            check_size("G-buffer gradients", expected, plane.size())?;
        }
        if let Some(motion) = &self.motion {
            check_size("G-buffer motion", expected, motion.size())?;
            motion.copy_into(vectors, |value| value);
        }
        (out.jitter, out.margin) = (self.jitter, self.margin);
        self.color.copy_into(&mut out.color, |value| value);
        let geometry = out.geometry.get_or_insert_with(Geometry::default);
        self.depth.copy_into(&mut geometry.depth_median, |value| self.encoding.distance(value));
        let gradients = out.gradients.get_or_insert_with(Gradients::default);
        match &self.gradients {
            Some([dx, dy]) => {
                dx.copy_into(&mut gradients.color_dx, |value| value);
                dy.copy_into(&mut gradients.color_dy, |value| value);
            }
            None => difference(&out.color, &geometry.depth_median, gradients),
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_found_wherever_they_lie() {
        // RGBA of 3×2 pixels in rows of four.
        let data: Vec<f32> = (0..32).map(|k| k as f32).collect();
        let mut out = Planes::<3>::default();
        let strides = Strides { row: 16, pixel: 4, channel: 1 };
        PlanesView::<3>::new(&data, Size::new(3, 2), strides).unwrap().copy_into(&mut out, |v| v);
        for (c, y, x) in [(0, 0, 0), (2, 0, 1), (1, 1, 2)] {
            assert_eq!(out.row(c, y)[x], (16 * y + 4 * x + c) as f32);
        }
        let own = Planes::<3>::from_data(4, 2, data[..24].to_vec()).unwrap();
        PlanesView::from(&own).copy_into(&mut out, |v| v);
        assert_eq!(out, own);
        // The last number needed is the last one of the last pixel.
        assert!(PlanesView::<3>::interleaved(&data[..31], Size::new(4, 2), 4).is_ok());
        let error = PlanesView::<3>::interleaved(&data[..30], Size::new(4, 2), 4).unwrap_err();
        assert_eq!(error, ReconstructError::TooShort { expected: 31, actual: 30 });
        let huge = PlanesView::<1>::interleaved(&data, Size::new(u32::MAX, 2), 1).unwrap_err();
        assert!(matches!(huge, ReconstructError::TooShort { actual: 32, .. }), "{huge}");
        // An end beyond all numbers.
        let apart = Strides { row: usize::MAX, pixel: usize::MAX, channel: 1 };
        let endless = PlanesView::<1>::new(&data, Size::new(3, 2), apart).unwrap_err();
        assert_eq!(endless, ReconstructError::TooShort { expected: usize::MAX, actual: 32 });
    }

    #[test]
    fn depths_are_those_of_a_projection() {
        let (near, far) = (0.1_f32, 50.0_f32);
        for z in [0.1_f32, 0.5, 3.0, 49.0] {
            // Depth by a graphics API's perspective matrix.
            let standard = far / (far - near) * (1.0 - near / z);
            let endless = near / z;
            for (encoding, value) in [
                (DepthEncoding::Distance, z),
                (DepthEncoding::Projective { near, far }, standard),
                (DepthEncoding::Reversed { near, far }, 1.0 - standard),
                (DepthEncoding::Reversed { near, far: f32::INFINITY }, endless),
                (DepthEncoding::Projective { near, far: f32::INFINITY }, 1.0 - endless),
                (DepthEncoding::Linear { near, far }, (z - near) / (far - near)),
            ] {
                let actual = encoding.distance(value);
                assert!((actual - z).abs() < 1e-3 * z, "{encoding:?}: {actual}, expected {z}");
            }
        }
        assert_eq!(DepthEncoding::Reversed { near, far }.distance(0.0), 0.0);
        assert_eq!(DepthEncoding::Projective { near, far }.distance(1.0), 0.0);
        assert_eq!(DepthEncoding::Linear { near, far }.distance(f32::NAN), 0.0);
        let error = DepthEncoding::Linear { near, far: f32::INFINITY }.check().unwrap_err();
        assert_eq!(error.to_string(), "clip planes: expected 0 < near < far, found near 0.1 and far inf");
    }
}
