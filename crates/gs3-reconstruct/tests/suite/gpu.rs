//! Reconstruction on a GPU against the CPU's: the same images within rounding, on any adapter at hand.

use std::sync::OnceLock;

use crate::common::{World, camera, grid_jitter, wall_and_post, wall_that_ends};
use gs3_compute::{Buffer, Gpu, GpuError, GpuSettings, Recorder, Use, device_for_tests};
use gs3_reconstruct::gpu::{
    BoundBlocks, GpuBlockSelector, GpuImage, GpuInterpolator, GpuNeighbor, GpuPlanes, GpuReconstructError,
    GpuSuperSampler, NeighborView, SideOutput,
};
use gs3_reconstruct::{
    BlockBudget, DepthLattice, Interpolator, Kriging, Neighbor, ReconstructError, ResetReason, SuperSampler,
    Warped,
};
use gs3_scene::{Camera, GBuffer, Image, Margin, Planes, Size};
use gs3_test_support::psnr;

/// What halves leave of an image of values up to 1: an error of 2⁻¹² makes 72 dB.
pub const FLOOR: f64 = 68.0;

/// The same of frames as they are, where pixels are kriged: at a scale of 8 a frame here is so small that one pixel
/// that only one of both kriges falls below it.
const KRIGED_FLOOR: f64 = 58.0;

/// Pixels of a frame that one of both kriges and the other does not, at most: where a pixel's error is what is just
/// worth kriging, rounding decides. (Found: 1.3e-3.)
const FLIPPED: f64 = 2e-3;

/// The adapter of this machine, or a word that there is none.
pub fn gpu() -> Option<Gpu> {
    static GPU: OnceLock<Option<Gpu>> = OnceLock::new();
    GPU.get_or_init(|| device_for_tests(&GpuSettings::default())).clone()
}

/// An LR G-buffer in device memory.
struct Uploaded([Buffer; 3]);

impl Uploaded {
    fn new(gpu: &Gpu, gbuffer: &GBuffer) -> Self {
        Self::with_rows(gpu, gbuffer, gbuffer.width(), gbuffer.height())
    }

    /// With rows `stride` pixels apart, and memory for `rows` rows.
    fn with_rows(gpu: &Gpu, gbuffer: &GBuffer, stride: usize, rows: usize) -> Self {
        let width = gbuffer.width();
        let (gradients, geometry) = (gbuffer.gradients.as_ref().unwrap(), gbuffer.geometry.as_ref().unwrap());
        let plane = |rgb: &Planes<3>, fourth: &Planes<1>| {
            let [r, g, b] = [0, 1, 2].map(|c| rgb.plane(c));
            // What lies beyond is not to be read.
            let mut pixels = vec![[f32::NAN; 4]; stride * rows];
            for i in 0..r.len() {
                pixels[i / width * stride + i % width] = [r[i], g[i], b[i], fourth.data()[i]];
            }
            gpu.buffer_with("plane", Use::Storage, &pixels).unwrap()
        };
        Self([
            plane(&gbuffer.color, &gbuffer.alpha),
            plane(&gradients.color_dx, &geometry.depth_median),
            plane(&gradients.color_dy, &geometry.depth_expected),
        ])
    }

    fn planes(&self) -> GpuPlanes<'_> {
        let [color_alpha, dx_median, dy_expected] = &self.0;
        GpuPlanes { color_alpha, dx_median, dy_expected }
    }
}

/// Most pixels beyond an edge in these tests.
const MARGIN: u32 = 8;

/// A super sampler that reads and writes as the CPU's does.
pub struct Sampler {
    gpu: Gpu,
    size: Size,
    pub sampler: GpuSuperSampler,
}

impl Sampler {
    fn new(gpu: &Gpu, scale: u32, size: Size, kriging: Kriging) -> Self {
        Self::with_side_output(gpu, scale, size, SideOutput::Innovation, kriging)
    }

    pub fn with_side_output(
        gpu: &Gpu,
        scale: u32,
        size: Size,
        side_output: SideOutput,
        kriging: Kriging,
    ) -> Self {
        let sampler = GpuSuperSampler::new(gpu, scale, size, side_output, kriging, MARGIN).unwrap();
        Self { gpu: gpu.clone(), size, sampler }
    }

    pub fn super_sample(&mut self, camera: &Camera, gbuffer: &GBuffer) -> (Image, GpuImage) {
        self.super_sample_padded(camera, gbuffer, gbuffer)
    }

    /// With exact blocks that the next frames remember: `bound` of the choice of `selector` by `budget`.
    pub fn super_sample_with_blocks(
        &mut self,
        (camera, gbuffer): (&Camera, &GBuffer),
        (bound, selector, budget): (&BoundBlocks, &GpuBlockSelector, BlockBudget),
    ) -> Image {
        let blocks = budget.blocks_of(selector.blocks() as usize) as u32;
        let remember = |sampler: &mut GpuSuperSampler, recorder: &mut Recorder<'_>| {
            selector.record(recorder, budget).unwrap();
            sampler.record_blocks(recorder, bound).unwrap();
        };
        self.super_sample_then(camera, [gbuffer, gbuffer], blocks, remember).0
    }

    fn super_sample_padded(
        &mut self,
        camera: &Camera,
        gbuffer: &GBuffer,
        padded: &GBuffer,
    ) -> (Image, GpuImage) {
        self.super_sample_then(camera, [gbuffer, padded], 0, |_, _| ())
    }

    pub fn super_sample_then(
        &mut self,
        camera: &Camera,
        [gbuffer, padded]: [&GBuffer; 2],
        blocks: u32,
        then: impl Fn(&mut GpuSuperSampler, &mut Recorder<'_>),
    ) -> (Image, GpuImage) {
        let (uploaded, to) =
            (Uploaded::new(&self.gpu, gbuffer), GpuImage::new(&self.gpu, self.size).unwrap());
        let room = 2 * MARGIN as usize;
        let around_uploaded =
            Uploaded::with_rows(&self.gpu, padded, gbuffer.width() + room, gbuffer.height() + room);
        let bound = self.sampler.bind(&uploaded.planes(), &around_uploaded.planes(), &to).unwrap();
        let mut recorder = self.gpu.recorder(None);
        self.sampler.record(&mut recorder, &bound, camera, gbuffer.jitter, padded.margin, blocks).unwrap();
        then(&mut self.sampler, &mut recorder);
        recorder.submit().unwrap();
        self.sampler.commit(DepthLattice::of(gbuffer).mean_inverse_depth());
        let mut out = Image::default();
        to.read(&self.gpu, &mut out).unwrap();
        (out, to)
    }
}

/// The mean error of the uncertainties, and the share of pixels that one of both calls exact and the other does not.
fn uncertainty_errors(actual: &Image, expected: &Image) -> (f64, f64) {
    let count = actual.pixels().len() as f64;
    let pairs = || actual.pixels().iter().zip(expected.pixels());
    let sum: f64 = pairs().map(|(a, e)| f64::from((a[3] - e[3]).abs())).sum();
    (sum / count, pairs().filter(|(a, e)| (a[3] == 0.0) != (e[3] == 0.0)).count() as f64 / count)
}

/// A camera for each frame, and a name.
type Motion = (&'static str, Box<dyn Fn(usize) -> Camera>);

/// Camera motions; each tests something else.
fn motions(size: Size) -> Vec<Motion> {
    let at =
        move |position: [f64; 3], yaw: f64, pitch: f64| camera(size.width, size.height, position, yaw, pitch);
    vec![
        ("rest", Box::new(move |_| at([0.1, 0.0, 0.0], 0.05, 0.0))),
        ("drift", Box::new(move |k| at([0.02 * k as f64, 0.006 * k as f64, 0.004 * k as f64], 0.0, 0.0))),
        (
            "turn",
            Box::new(move |k| at([0.0; 3], 0.5 * (0.06 * k as f64).sin(), -0.15 * (0.06 * k as f64).sin())),
        ),
        // Samples crowd, up to dozens in a pixel. Straight back, whole rows would land half-way between pixels, where
        // rounding decides which they reach.
        (
            "flight back",
            Box::new(move |k| at([0.0, 0.007 * k as f64, 2.0 - 0.5 * k as f64], 0.003 * k as f64, 0.0)),
        ),
        // Samples thin out, the post passes the camera and falls behind it; the wall does not.
        (
            "flight forward",
            Box::new(move |k| {
                at([0.05, 0.007 * k as f64, 5.0 - 5.0 * (-0.06 * k as f64).exp()], 0.003 * k as f64, 0.0)
            }),
        ),
    ]
}

/// The PSNR of `actual`, and the share of its pixels that were kriged where the pixels of `ways[own]`, the CPU's
/// image, were not, or the other way round. The latter pixels are compared with their values under the other kriging.
/// `ways` begin without kriging and end with the finest.
fn kriged_psnr(actual: &Image, ways: &[Image], own: usize) -> (f64, f64) {
    let (first_order, finest) = (&ways[0], &ways[ways.len() - 1]);
    let difference = |a: &[f32; 4], b: &[f32; 4]| (0..3).map(|c| f64::from(a[c] - b[c]).powi(2)).sum::<f64>();
    let (mut sum, mut flipped) = (0.0, 0);
    for (i, (actual, expected)) in actual.pixels().iter().zip(ways[own].pixels()).enumerate() {
        let is_kriged = *expected != first_order.pixels()[i];
        let other = if is_kriged { first_order } else { finest };
        // What the finest leaves alone the CPU has not kriged at all.
        let is_unknown = own > 0 && other.pixels()[i] == *expected;
        let mut error = difference(actual, expected);
        // Eight times what halves leave.
        let limit = 2e-3 * expected[..3].iter().fold(1.0, |most: f64, v| most.max(f64::from(v.abs())));
        if own > 0 && error > limit * limit {
            flipped += 1;
            error = if is_unknown { 0.0 } else { difference(actual, &other.pixels()[i]) };
        }
        sum += error;
    }
    let count = actual.pixels().len() as f64;
    (-10.0 * (sum / (3.0 * count)).log10(), f64::from(flipped) / count)
}

#[test]
fn super_sampling_matches_the_cpu() {
    // With a margin, more LR columns than a workgroup has.
    compare_super_sampling(
        4,
        Size::new(230, 133),
        &[Kriging::Off, Kriging::Coarse, Kriging::On, Kriging::Fine],
    );
}

/// How much is kriged is the same choice at any scale.
#[test]
fn super_sampling_by_other_scales_matches_the_cpu() {
    for (scale, size) in [(1, [67, 40]), (2, [101, 66]), (3, [64, 95]), (8, [90, 70])] {
        compare_super_sampling(scale, size.into(), &[Kriging::Off, Kriging::Fine]);
    }
}

/// Over all motions; at scale 8 over two, as a history of 64 frames takes most of the time.
fn compare_super_sampling(scale: u32, size: Size, ways: &[Kriging]) {
    let Some(gpu) = gpu() else { return };
    let world = wall_and_post(60.0);
    let each = || ways.iter().copied();
    // Their kernels take long to compile.
    let mut on_gpu: Vec<_> = each().map(|way| Sampler::new(&gpu, scale, size, way)).collect();
    for (name, pose) in
        motions(size).into_iter().filter(|(name, _)| scale < 8 || ["drift", "turn"].contains(name))
    {
        let mut on_cpu: Vec<_> = each().map(|way| SuperSampler::new(scale, way).unwrap()).collect();
        on_gpu.iter_mut().for_each(|gpu| gpu.sampler.reset(ResetReason::SceneChange));
        let mut expected = vec![Image::default(); ways.len()];
        let mut worst = vec![(f64::INFINITY, 0.0_f64); ways.len()];
        let mut certain = vec![(0.0, 0.0); ways.len()];
        // Once around the history, and two more.
        for k in 0..(scale * scale) as usize + 2 {
            // Another one in each frame, and none in some.
            let [left, top, right, bottom] = [0, 3, 5, 7].map(|by| (k as u32 * by) % (MARGIN + 1));
            let margin = Margin { left, top, right, bottom };
            let lr = pose(k).low_resolution(scale);
            let padded = world.gbuffer_around(&lr, grid_jitter(scale, k), margin);
            let mut gbuffer = GBuffer::default();
            padded.crop(&mut gbuffer);
            for (cpu, expected) in on_cpu.iter_mut().zip(&mut expected) {
                cpu.super_sample_padded(&pose(k), &gbuffer, &padded, expected).unwrap();
            }
            for (way, (gpu, worst)) in on_gpu.iter_mut().zip(&mut worst).enumerate() {
                let (actual, _) = gpu.super_sample_padded(&pose(k), &gbuffer, &padded);
                let (psnr, flipped) = kriged_psnr(&actual, &expected, way);
                *worst = (worst.0.min(psnr), worst.1.max(flipped));
                let whole = self::psnr(&actual, &expected[way]);
                assert!(
                    scale > 4 || whole >= KRIGED_FLOOR,
                    "x{scale}, {name}, {:?}: {whole:.1} dB",
                    ways[way]
                );
                certain[way] = uncertainty_errors(&actual, &expected[way]);
            }
        }
        for (way, ((psnr, flipped), certain)) in worst.into_iter().zip(certain).enumerate() {
            let innovation = on_gpu[way].sampler.innovation().unwrap();
            let found: Vec<[f32; 4]> = gpu.read(&innovation.slice()).unwrap();
            let expected = on_cpu[way].innovation();
            let pairs = found.iter().flatten().zip(expected.iter().flatten());
            let sum: f64 = pairs.map(|(a, e)| f64::from(a - e).powi(2)).sum();
            let news = (sum / (4 * expected.len()) as f64).sqrt();
            let what = format!(
                "x{scale}, {name}, kriging {:?}: {psnr:.1} dB at worst, {flipped:.1e} of the pixels otherwise, \
                 uncertainty {certain:?}, innovation {news:.1e}",
                ways[way]
            );
            eprintln!("{what}");
            assert!(psnr >= FLOOR && flipped <= FLIPPED, "{what}");
            assert!(certain.0 < 1e-3 && certain.1 < 0.01 && news < 1e-3, "{what}");
        }
    }
}

/// Which sample came first to its pixel differs from run to run; the image must not.
#[test]
fn frames_repeat_bit_for_bit() {
    let Some(gpu) = gpu() else { return };
    let world = wall_and_post(60.0);
    let size = Size::new(266, 50);
    let pose = |k: usize| camera(size.width, size.height, [0.0, 0.0, 2.0 - 0.9 * k as f64], 0.0, 0.0);
    let run = |sampler: GpuSuperSampler| {
        let mut sampler = Sampler { gpu: gpu.clone(), size, sampler };
        let frame = |k| {
            let gbuffer = world.gbuffer(&pose(k).low_resolution(4), grid_jitter(4, k));
            sampler.super_sample(&pose(k), &gbuffer)
        };
        (0..16).map(frame).map(|(image, _)| image).collect::<Vec<_>>()
    };
    let first = run(GpuSuperSampler::new(&gpu, 4, size, SideOutput::None, Kriging::On, MARGIN).unwrap());
    assert!(
        run(GpuSuperSampler::new(&gpu, 4, size, SideOutput::None, Kriging::On, MARGIN).unwrap()) == first
    );
    // Software adapters may run everything in order.
    assert!(run(GpuSuperSampler::backward(&gpu, 4, size, MARGIN).unwrap()) == first);
}

/// Bare background is certain, and a resting camera's image becomes exact.
#[test]
fn background_is_certain() {
    let Some(gpu) = gpu() else { return };
    let mut world = wall_and_post(60.0);
    world.sheets.pop();
    world.sheets[0].softness = 5e-4;
    let pose = camera(840, 136, [0.3, 0.0, 0.0], 0.05, 0.0);
    let mut sampler = Sampler::new(&gpu, 4, Size::new(840, 136), Kriging::Off);
    let mut images: Vec<Image> = Vec::new();
    for k in 0..16 {
        let gbuffer = world.gbuffer(&pose.low_resolution(4), grid_jitter(4, k));
        images.push(sampler.super_sample(&pose, &gbuffer).0);
    }
    let empty = images[0].pixels().iter().filter(|p| **p == [0.0; 4]).count();
    assert!(empty > 840 * 136 / 4, "only {empty} pixels are certain to be empty");
    assert!(images[15].pixels().iter().all(|p| p[3] == 0.0));
    assert!(psnr(&images[15], &world.native(&pose)) > FLOOR);
}

/// History ends at a reset, and a frame that is not kept is no history.
#[test]
fn history_is_what_was_kept() {
    let Some(gpu) = gpu() else { return };
    let (world, other) = (wall_and_post(60.0), wall_and_post(35.0));
    let size = Size::new(96, 64);
    let pose = |k: usize| camera(size.width, size.height, [0.05 * k as f64, 0.0, 0.0], 0.0, 0.0);
    let gbuffer = |world: &World, k: usize| world.gbuffer(&pose(k).low_resolution(4), grid_jitter(4, k));
    let mut sampler = Sampler::new(&gpu, 4, size, Kriging::Off);
    assert_eq!(sampler.sampler.history_invalid(), Some(ResetReason::FirstFrame));
    for k in 0..3 {
        sampler.super_sample(&pose(k), &gbuffer(&world, k));
    }
    assert_eq!(sampler.sampler.history_invalid(), None);

    // A frame that lacked something, recorded and not kept, then made again.
    let bad = Uploaded::new(&gpu, &gbuffer(&other, 3));
    let (width, height) = (size.width.div_ceil(4) + 2 * MARGIN, size.height.div_ceil(4) + 2 * MARGIN);
    let bad_around = Uploaded::with_rows(&gpu, &gbuffer(&other, 3), width as usize, height as usize);
    let image = GpuImage::new(&gpu, size).unwrap();
    let bound = sampler.sampler.bind(&bad.planes(), &bad_around.planes(), &image).unwrap();
    let mut recorder = gpu.recorder(None);
    sampler.sampler.record(&mut recorder, &bound, &pose(3), grid_jitter(4, 3), Margin::NONE, 0).unwrap();
    recorder.submit().unwrap();
    let after = sampler.super_sample(&pose(3), &gbuffer(&world, 3)).0;
    let mut straight = Sampler::new(&gpu, 4, size, Kriging::Off);
    let expected = (0..4).map(|k| straight.super_sample(&pose(k), &gbuffer(&world, k)).0).last().unwrap();
    assert!(after == expected);

    sampler.sampler.reset(ResetReason::SceneChange);
    assert_eq!(sampler.sampler.history_invalid(), Some(ResetReason::SceneChange));
    let anew = sampler.super_sample(&pose(4), &gbuffer(&other, 4)).0;
    let fresh = Sampler::new(&gpu, 4, size, Kriging::Off).super_sample(&pose(4), &gbuffer(&other, 4)).0;
    assert!(anew == fresh);
    let later = sampler.super_sample(&pose(5), &gbuffer(&other, 5)).0;
    assert!(later != Sampler::new(&gpu, 4, size, Kriging::Off).super_sample(&pose(5), &gbuffer(&other, 5)).0);
}

#[test]
fn interpolation_matches_the_cpu() {
    let Some(gpu) = gpu() else { return };
    // Smooth surfaces, too: other surfaces beside silhouettes agree alike there.
    let worlds = [wall_that_ends(60.0), wall_that_ends(10.0)];
    let others = [(1, [67, 40]), (2, [101, 66]), (3, [64, 95]), (8, [90, 70])];
    let others = others.map(|(scale, size)| (&worlds[0], scale, size));
    let by_four = worlds.each_ref().map(|world| (world, 4, [230, 133]));
    for (world, scale, size) in by_four.into_iter().chain(others) {
        let size = Size::from(size);
        for (name, pose) in motions(size) {
            let cameras = [pose(2), pose(3)];
            let gbuffers =
                [0, 1].map(|k| world.gbuffer(&cameras[k].low_resolution(scale), grid_jitter(scale, k)));
            let mut images = [0, 1].map(|_| Image::default());
            let on_device = [0, 1].map(|k| {
                let (image, on_device) =
                    Sampler::new(&gpu, scale, size, Kriging::Off).super_sample(&cameras[k], &gbuffers[k]);
                images[k] = image;
                on_device
            });
            let uploaded = [0, 1].map(|k| Uploaded::new(&gpu, &gbuffers[k]));
            let mut cpu = Interpolator::new(scale).unwrap();
            let interpolator = GpuInterpolator::new(&gpu, scale, size).unwrap();
            let neighbor = |k: usize| Neighbor {
                camera: &cameras[k],
                image: &images[k],
                gbuffer: &gbuffers[k],
                gradients: None,
            };
            let on_gpu = |k: usize| GpuNeighbor { image: &on_device[k], planes: uploaded[k].planes() };
            let view = |k: usize| NeighborView { camera: cameras[k], jitter: gbuffers[k].jitter };
            for t in [0.25, 0.5] {
                let at = gs3_scene::camera_path::pose_between(&cameras[0], &cameras[1], f64::from(t));
                let (mut expected, mut actual) = (Image::default(), Image::default());
                cpu.interpolate(neighbor(0), neighbor(1), t, &at, &mut expected).unwrap();
                let out = GpuImage::new(&gpu, size).unwrap();
                let bound = interpolator.bind(&on_gpu(0), &on_gpu(1), &out).unwrap();
                let mut recorder = gpu.recorder(None);
                interpolator.record(&mut recorder, &bound, [&view(0), &view(1)], t, &at).unwrap();
                recorder.submit().unwrap();
                out.read(&gpu, &mut actual).unwrap();
                let what = format!("x{scale}, {name} at {t}: {:.1} dB", psnr(&actual, &expected));
                eprintln!("{what}");
                assert!(psnr(&actual, &expected) >= FLOOR, "{what}");

                // The same, left to the caller to blend.
                let mut warped = Warped::default();
                cpu.warp(neighbor(0), neighbor(1), t, &at, &mut warped).unwrap();
                let outs = [0, 1].map(|_| GpuImage::new(&gpu, size).unwrap());
                let pixels = size.pixels() as usize;
                let share = gpu.buffer("share", Use::Storage, 4 * pixels as u64).unwrap();
                let bound = interpolator.bind_both(&on_gpu(0), &on_gpu(1), outs.each_ref(), &share).unwrap();
                let mut recorder = gpu.recorder(None);
                interpolator.record(&mut recorder, &bound, [&view(0), &view(1)], t, &at).unwrap();
                recorder.submit().unwrap();
                for (out, expected) in outs.iter().zip([&warped.before, &warped.after]) {
                    out.read(&gpu, &mut actual).unwrap();
                    let what = format!("{what}, separate {:.1} dB", psnr(&actual, expected));
                    assert!(psnr(&actual, expected) >= FLOOR, "{what}");
                }
                let shares: Vec<f32> = gpu.read(&share.part(0, 4 * pixels as u64)).unwrap();
                let differ =
                    shares.iter().zip(warped.share.data()).filter(|(a, e)| (*a - *e).abs() > 0.01).count();
                assert!(shares.len() == pixels && differ < pixels / 100, "{what}: {differ} shares");
            }
        }
    }
}

#[test]
fn what_does_not_fit_is_a_typed_error() {
    let Some(gpu) = gpu() else { return };
    let scale =
        GpuSuperSampler::new(&gpu, 9, Size::new(64, 64), SideOutput::None, Kriging::On, 0).map(|_| ());
    assert_eq!(scale, Err(ReconstructError::Scale { actual: 9 }.into()));
    let sampler =
        |size, margin| GpuSuperSampler::new(&gpu, 1, size, SideOutput::None, Kriging::On, margin).map(|_| ());
    // Frames of a valid size; one device in a hundred has memory for their history.
    if gpu.capabilities().limits.binding_bytes < (8192 * 8192) * 32 {
        let large = sampler(Size::new(8192, 8192), 8192);
        assert!(matches!(large, Err(GpuReconstructError::Gpu(GpuError::TooLarge { .. }))), "{large:?}");
    }
    for actual in [[0, 64], [64, 8193], [u32::MAX; 2]].map(Size::from) {
        let size = Err(ReconstructError::FrameSize { actual }.into());
        assert_eq!(sampler(actual, 0), size);
        assert_eq!(GpuInterpolator::new(&gpu, 4, actual).map(|_| ()), size);
        assert_eq!(GpuImage::new(&gpu, actual).map(|_| ()), size);
    }
    let wide = ReconstructError::Margin { max: 8192, actual: u32::MAX };
    assert_eq!(sampler(Size::new(64, 64), u32::MAX), Err(wide.into()));
    let mut sampler =
        GpuSuperSampler::new(&gpu, 4, Size::new(64, 64), SideOutput::None, Kriging::On, 0).unwrap();
    let pose = camera(64, 64, [0.0; 3], 0.0, 0.0);
    let uploaded = Uploaded::new(&gpu, &wall_and_post(60.0).gbuffer(&pose.low_resolution(4), [0.0; 2]));
    let small = GpuImage::new(&gpu, Size::new(60, 64)).unwrap();
    let size =
        ReconstructError::Size { what: "image", expected: Size::new(64, 64), actual: Size::new(60, 64) };
    assert_eq!(sampler.bind(&uploaded.planes(), &uploaded.planes(), &small).map(|_| ()), Err(size.into()));
    // A row short.
    let short = gpu.buffer("short", Use::Storage, 16 * 15 * 16).unwrap();
    let planes = GpuPlanes { dy_expected: &short, ..uploaded.planes() };
    let out = GpuImage::new(&gpu, Size::new(64, 64)).unwrap();
    let short =
        GpuError::TooSmall { what: "bytes of plane dy_expected".to_owned(), min: 16 * 256, actual: 16 * 240 };
    for (planes, padded) in [(planes, uploaded.planes()), (uploaded.planes(), planes)] {
        assert_eq!(sampler.bind(&planes, &padded, &out).map(|_| ()), Err(short.clone().into()));
    }
    let twin = GpuSuperSampler::new(&gpu, 4, Size::new(64, 64), SideOutput::None, Kriging::On, 0).unwrap();
    let strange = twin.bind(&uploaded.planes(), &uploaded.planes(), &out).unwrap();
    let strange =
        sampler.record(&mut gpu.recorder(None), &strange, &pose, [0.0; 2], Margin::NONE, 0).unwrap_err();
    assert!(matches!(strange, GpuReconstructError::Gpu(GpuError::Bindings { .. })), "{strange}");
    let bound = sampler
        .bind(&uploaded.planes(), &uploaded.planes(), &GpuImage::new(&gpu, Size::new(64, 64)).unwrap())
        .unwrap();
    let mut recorder = gpu.recorder(None);
    let other = camera(60, 64, [0.0; 3], 0.0, 0.0);
    let size =
        ReconstructError::Size { what: "camera", expected: Size::new(64, 64), actual: Size::new(60, 64) };
    assert_eq!(sampler.record(&mut recorder, &bound, &other, [0.0; 2], Margin::NONE, 0), Err(size.into()));
    let jitter = sampler.record(&mut recorder, &bound, &pose, [f32::NAN, 0.0], Margin::NONE, 0);
    let wide = Margin { right: 1, ..Margin::NONE };
    let margin = sampler.record(&mut recorder, &bound, &pose, [0.0; 2], wide, 0);
    assert_eq!(margin, Err(ReconstructError::Margin { max: 0, actual: 1 }.into()));
    assert!(matches!(jitter, Err(GpuReconstructError::Reconstruct(ReconstructError::Jitter { .. }))));
    let interpolator = GpuInterpolator::new(&gpu, 4, Size::new(64, 64)).unwrap();
    let image = GpuImage::new(&gpu, Size::new(64, 64)).unwrap();
    let neighbor = GpuNeighbor { image: &image, planes: uploaded.planes() };
    let out = GpuImage::new(&gpu, Size::new(64, 64)).unwrap();
    let bound = interpolator.bind(&neighbor, &neighbor, &out).unwrap();
    let view = NeighborView { camera: pose, jitter: [0.0; 2] };
    let late = interpolator.record(&mut recorder, &bound, [&view, &view], 1.5, &pose);
    assert_eq!(late, Err(ReconstructError::Time { actual: 1.5 }.into()));
}
