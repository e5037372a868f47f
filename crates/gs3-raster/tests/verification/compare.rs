//! Renders with the rasterizer, and holds a G-buffer against the oracle.

use std::sync::Arc;

use gs3_raster::{Culling, KERBL_DILATION, Outputs, RasterSettings, Rasterizer, Rules};
use gs3_scene::{Camera, GBuffer, Image, Margin, Planes, Scene};

use crate::oracle::{Oracle, Sample};

/// The three culling methods that must not change the image.
pub const EXACT_CULLING: [Culling; 3] = [Culling::SnugBox, Culling::AccuTile, Culling::Exact];

/// Everything at Kerbl's dilation, unjittered, over black.
pub const EVERYTHING: RasterSettings = RasterSettings {
    outputs: Outputs::GBufferMixed,
    dilation: KERBL_DILATION,
    jitter: [0.0; 2],
    margin: Margin::NONE,
    background: [0.0; 3],
    rules: Rules::KERBL,
};

/// A fresh G-buffer of `scene`.
pub fn render(scene: &Scene, culling: Culling, camera: &Camera, settings: &RasterSettings) -> GBuffer {
    let mut gbuffer = GBuffer::default();
    Rasterizer::new(Arc::new(scene.clone()), culling)
        .rasterize(camera, settings, &mut gbuffer)
        .expect("valid settings");
    gbuffer
}

/// A fresh image of `scene`.
pub fn render_image(scene: &Scene, culling: Culling, camera: &Camera, settings: &RasterSettings) -> Image {
    let mut image = Image::default();
    Rasterizer::new(Arc::new(scene.clone()), culling)
        .rasterize_image(camera, settings, &mut image)
        .expect("valid settings");
    image
}

/// The oracle for the same picture.
pub fn oracle(scene: &Scene, camera: &Camera, settings: &RasterSettings) -> Oracle {
    Oracle::new(scene, camera, settings.dilation, settings.jitter, settings.background).by(settings.rules)
}

/// The oracle's samples of all pixels, row by row.
pub fn oracle_samples(oracle: &Oracle, camera: &Camera) -> Vec<Sample> {
    let (w, h) = (camera.width() as usize, camera.height() as usize);
    (0..w * h).map(|p| oracle.pixel(p % w, p / w)).collect()
}

/// One kind of plane of the G-buffer, all its channels, beside the oracle's values.
pub struct Pair<'a> {
    pub name: &'static str,
    /// `[C, height, width]`.
    pub actual: &'a [f32],
    /// The oracle's value of a channel.
    pub expected: fn(&Sample, usize) -> f64,
}

/// All planes that `gbuffer` has.
pub fn pairs(gbuffer: &GBuffer) -> Vec<Pair<'_>> {
    fn pair<'a, const C: usize>(
        name: &'static str,
        planes: &'a Planes<C>,
        expected: fn(&Sample, usize) -> f64,
    ) -> Pair<'a> {
        Pair { name, actual: planes.data(), expected }
    }
    let mut all =
        vec![pair("color", &gbuffer.color, |s, k| s.color[k]), pair("alpha", &gbuffer.alpha, |s, _| s.alpha)];
    if let Some(g) = &gbuffer.gradients {
        all.push(pair("color_dx", &g.color_dx, |s, k| s.color_dx[k]));
        all.push(pair("color_dy", &g.color_dy, |s, k| s.color_dy[k]));
        all.extend(g.color_dxy.as_ref().map(|p| pair("color_dxy", p, |s, k| s.color_dxy[k])));
    }
    if let Some(g) = &gbuffer.geometry {
        all.push(pair("depth_median", &g.depth_median, |s, _| s.depth_median));
        all.push(pair("depth_expected", &g.depth_expected, |s, _| s.depth_expected));
        all.push(pair("normal", &g.normal, |s, k| s.normal[k]));
    }
    all
}

/// How many pixels were held against the oracle, and how many were too near a cut-off for that.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    pub compared: usize,
    pub excluded: usize,
}

impl Tally {
    pub fn add(&mut self, other: Self) {
        self.compared += other.compared;
        self.excluded += other.excluded;
    }

    /// Share of pixels near a cut-off.
    pub fn excluded_share(&self) -> f64 {
        self.excluded as f64 / (self.compared + self.excluded) as f64
    }
}

/// Asserts that every plane of `gbuffer` is within `tolerance` of the plane's largest value of `samples`, outside the
/// cut-off sets.
pub fn assert_matches(gbuffer: &GBuffer, samples: &[Sample], tolerance: f64, what: &str) -> Tally {
    let pixels = samples.len();
    assert_eq!(gbuffer.width() * gbuffer.height(), pixels, "{what}: size");
    for pair in pairs(gbuffer) {
        let channels = pair.actual.len() / pixels;
        let largest = (0..channels)
            .flat_map(|k| samples.iter().map(move |s| (s, k)))
            .fold(0.0_f64, |m, (s, k)| m.max((pair.expected)(s, k).abs()));
        let mut worst = (0.0, 0, 0);
        for k in 0..channels {
            for (p, sample) in samples.iter().enumerate() {
                let is_median = pair.name == "depth_median" && sample.cut_offs.median();
                if sample.cut_offs.any() || is_median {
                    continue;
                }
                let actual = f64::from(pair.actual[k * pixels + p]);
                let error = (actual - (pair.expected)(sample, k)).abs();
                // A NaN must lose, not pass.
                if error > worst.0 || error.is_nan() {
                    worst = (error, p, k);
                }
            }
        }
        let (error, p, k) = worst;
        assert!(
            error <= tolerance * largest,
            "{what}: {} channel {k} at pixel ({}, {}): expected {}, found {}, off by {:.2e} of the plane's largest value {largest}",
            pair.name,
            p % gbuffer.width(),
            p / gbuffer.width(),
            (pair.expected)(&samples[p], k),
            pair.actual[k * pixels + p],
            error / largest,
        );
    }
    let excluded = samples.iter().filter(|s| s.cut_offs.any()).count();
    Tally { compared: pixels - excluded, excluded }
}

/// Asserts that two G-buffers are the same bit for bit.
pub fn assert_identical(a: &GBuffer, b: &GBuffer, what: &str) {
    let (pa, pb) = (pairs(a), pairs(b));
    assert_eq!(pa.len(), pb.len(), "{what}: planes");
    for (x, y) in pa.iter().zip(&pb) {
        let different = (x.actual.iter().zip(y.actual)).position(|(v, w)| v.to_bits() != w.to_bits());
        assert_eq!(x.actual.len(), y.actual.len(), "{what}: {}", x.name);
        if let Some(i) = different {
            let (pixel, width) = (i % (a.width() * a.height()), a.width());
            panic!(
                "{what}: {} differs at pixel ({}, {}): {} and {}",
                x.name,
                pixel % width,
                pixel / width,
                x.actual[i],
                y.actual[i]
            );
        }
    }
}
