//! Exact blocks on a GPU: the native image's pixels within rounding, beside low-resolution frames with the same samples.

use std::sync::Arc;

use glam::DVec2;
use gs3_compute::{Buffer, Gpu, Use};
use gs3_raster::{
    Culling, EXACT_BLOCK_BYTES, GpuBlocks, GpuGBuffer, GpuRasterError, GpuRasterizer, LowResolution, Outputs,
    RasterError, RasterSettings, Rasterizer, ScenePrecision,
};
use gs3_scene::{BLOCK_SIDE, Camera, GBuffer, Image, Jitter, Margin, Scene, Size, block_grid};
use half::f16;

use crate::blocks;
use crate::compare::assert_identical;
use crate::gpu::gpu;
use crate::real_scenes;
use crate::scenes::{Random, RandomScene, camera_at_origin, posed, tilted_pose};

/// What halves leave of an image of values up to 1 is 72 dB; the bound of planes of G-buffers.
const FLOOR: f64 = 70.0;

/// Where α or the transmittance is at a step of the formulas, rounding decides: so many pixels in all may differ.
const STEPS: usize = 3;

/// The largest error of a sample's number, as a share of the plane's largest number: f32 sums in another order.
const SAMPLE_ERROR: f32 = 1e-3;

/// The value of pixels that no block covers.
const UNTOUCHED: f32 = -7.0;

fn settings(scale: u32, jitter: [f32; 2], margin: Margin) -> RasterSettings {
    RasterSettings { margin, ..blocks::settings(scale, jitter) }
}

fn native(scene: &Arc<Scene>, camera: &Camera) -> (Image, GBuffer) {
    blocks::native(&mut Rasterizer::new(Arc::clone(scene), Culling::AccuTile), camera)
}

/// An image with blocks, the blocks' samples, and which blocks are to be made.
struct Target {
    image: Buffer,
    samples: Buffer,
    /// Numbers of the chosen blocks, from 1 on.
    chosen: Vec<u32>,
    blocks: GpuBlocks,
}

impl Target {
    /// Each block of an image of `size` with the probability `share`.
    fn new(gpu: &Gpu, size: Size, share: f64, random: &mut Random) -> Self {
        let [columns, rows] = block_grid(size);
        let mut count = 0;
        let number = |_| {
            let is_chosen = f64::from((random.bits() % 1000) as u32) < 1000.0 * share;
            count += u32::from(is_chosen);
            if is_chosen { count } else { 0 }
        };
        let chosen: Vec<u32> = (0..columns * rows).map(number).collect();
        let pixels = vec![[f16::from_f32(UNTOUCHED).to_bits(); 4]; size.pixels() as usize];
        let image = gpu.buffer_with("image", Use::Storage, &pixels).expect("room");
        let marks = gpu.buffer_with("chosen", Use::Storage, &chosen).expect("room");
        // Without room for the last blocks.
        let room = u64::from(count - count / 8).max(1) * EXACT_BLOCK_BYTES;
        let samples = gpu.buffer("samples", Use::Storage, room).expect("room");
        Self { blocks: GpuBlocks::new(marks, image.clone(), samples.clone()), image, samples, chosen }
    }

    /// The chosen blocks equal the native image and G-buffer. No other pixel was written.
    fn assert_native(&self, gpu: &Gpu, (native, gbuffer): &(Image, GBuffer), what: &str) {
        self.assert_samples(gpu, native, gbuffer, what);
        let pixels = gpu.read::<[u16; 4]>(&self.image.slice()).expect("a device");
        let [columns, _] = block_grid(native.size());
        let mut errors = Vec::new();
        for (i, (actual, expected)) in pixels.iter().zip(native.pixels()).enumerate() {
            let (x, y) = (i % native.width(), i / native.width());
            let actual = actual.map(|bits| f16::from_bits(bits).to_f32());
            if self.chosen[y / BLOCK_SIDE * columns + x / BLOCK_SIDE] == 0 {
                assert_eq!(actual, [UNTOUCHED; 4], "{what}: {x}, {y} belongs to no block");
                continue;
            }
            assert_eq!(actual[3], 0.0, "{what}: uncertainty at {x}, {y}");
            errors.push((0..3).map(|c| f64::from(actual[c] - expected[c]).powi(2)).sum::<f64>());
        }
        assert!(!errors.is_empty(), "{what}: no block was chosen");
        errors.sort_by(f64::total_cmp);
        errors.truncate(errors.len() - STEPS.min(errors.len() / 100));
        let psnr = -10.0 * (errors.iter().sum::<f64>() / (3 * errors.len().max(1)) as f64).log10();
        eprintln!("{what}: {psnr:.1} dB of {} pixels", errors.len());
        assert!(psnr >= FLOOR, "{what}: expected at least {FLOOR} dB, found {psnr:.1}");
    }
}

impl Target {
    /// The samples equal the native G-buffer, but for steps of the formulas.
    fn assert_samples(&self, gpu: &Gpu, native: &Image, gbuffer: &GBuffer, what: &str) {
        let gradients = gbuffer.gradients.as_ref().expect("gradients");
        let depths = &gbuffer.geometry.as_ref().expect("depth").depth_median;
        let numbers = gpu.read::<[f32; 4]>(&self.samples.slice()).expect("a device");
        let room = (self.samples.bytes() / EXACT_BLOCK_BYTES) as usize;
        let [columns, _] = block_grid(native.size());
        let (mut compared, mut off) = (0, [0; 4]);
        let planes = [&gbuffer.color, &gradients.color_dx, &gradients.color_dy];
        let largest = |values: &[f32]| values.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
        let most = planes.map(|plane| largest(plane.data()));
        let most_depth = largest(depths.data());
        for (place, number) in self.chosen.iter().enumerate().filter(|(_, number)| **number > 0) {
            let block = *number as usize - 1;
            for lane in (0..16).filter(|_| block < room) {
                let x = place % columns * BLOCK_SIDE + lane % BLOCK_SIDE;
                let y = place / columns * BLOCK_SIDE + lane / BLOCK_SIDE;
                if x >= native.width() || y >= native.height() {
                    continue;
                }
                compared += 1;
                let [color, dx, dy] = [0, 1, 2].map(|k| numbers[(k * room + block) * 16 + lane]);
                for (k, (found, plane)) in [color, dx, dy].iter().zip(planes).enumerate() {
                    let is_off = |c: usize| (found[c] - plane.row(c, y)[x]).abs() > SAMPLE_ERROR * most[k];
                    off[k] += usize::from((0..3).any(is_off));
                }
                off[3] += usize::from((color[3] - depths.row(0, y)[x]).abs() > SAMPLE_ERROR * most_depth);
                assert!(dx[3] == 0.0 && dy[3] == 0.0, "{what}: {dx:?}, {dy:?}");
            }
        }
        eprintln!("{what}: of {compared} samples, colour, ∂x, ∂y and depth are off in {off:?}");
        assert!(compared > 0, "{what}: no samples");
        assert!(off.iter().all(|off| *off <= STEPS), "{what}: of {compared} samples {off:?} are off");
    }
}

/// The low-resolution frame with blocks, and the frame without.
fn frames(
    gpu: &Gpu,
    rasterizer: &mut GpuRasterizer,
    (camera, scale): (&Camera, u32),
    settings: &RasterSettings,
    target: &mut Target,
) -> [GBuffer; 2] {
    [true, false].map(|has_blocks| {
        let (mut on_device, mut frame) = (GpuGBuffer::default(), GBuffer::default());
        // An overflow is made again, as pipelines do.
        loop {
            let mut recorder = gpu.recorder(None);
            let lr = LowResolution { camera, scale, has_blocks };
            rasterizer.record_low_resolution(&mut recorder, lr, settings, &mut on_device).expect("room");
            if has_blocks {
                rasterizer.record_blocks(&mut recorder, &mut target.blocks).expect("a frame before");
            }
            recorder.submit().expect("a device");
            if rasterizer.check_capacity().expect("room") != gs3_raster::CapacityCheck::Grown {
                break;
            }
        }
        on_device.read(gpu, &mut frame).expect("a device");
        frame
    })
}

#[test]
fn blocks_are_the_native_image_at_every_scale() {
    let Some(gpu) = gpu() else { return };
    let mut random = Random(3);
    // Margins are whole blocks, sizes are not.
    let margin_of = |scale: u32| match scale {
        1 => Margin { left: 4, top: 8, right: 3, bottom: 5 },
        2 => Margin { left: 2, top: 4, right: 1, bottom: 0 },
        3 | 5 | 7 => Margin { left: 4, top: 8, right: 0, bottom: 2 },
        6 => Margin { left: 2, top: 4, right: 1, bottom: 0 },
        _ => Margin { left: 3, top: 1, right: 2, bottom: 32 },
    };
    for (k, scale) in (1..=8_u32).enumerate() {
        for (size, margin, share) in [
            ([101, 67], Margin::NONE, 0.4),
            ([330, 150], margin_of(scale), 0.06),
            ([3, 2], Margin::NONE, 1.0),
        ] {
            let at = |width: u32| camera_at_origin(width, size[1], DVec2::new(0.05, 0.1));
            let camera = posed(&at(size[0]), tilted_pose());
            // Splats beyond the picture too.
            let wide = posed(&at(2 * size[0]), tilted_pose());
            let recipe = RandomScene {
                seed: k as u64,
                count: 400,
                sigma: [[0.1, 40.0], [0.05, 2.0]][k % 2],
                anisotropy: [2.0, 30.0, 300.0][k % 3],
                ..RandomScene::BASE
            };
            let scene = Arc::new(recipe.build(&wide));
            let image = native(&scene, &camera);
            let culling = [Culling::AccuTile, Culling::Exact, Culling::SnugBox][k % 3];
            let mut rasterizer = GpuRasterizer::new(&gpu, scene, culling, ScenePrecision::F32).expect("room");
            let grid = Jitter::grid(scale);
            // The last one lies between the pixels, for which samples are no native pixels, but blocks are.
            let jitters = [grid.offset(0), grid.offset(grid.period() as u64 / 2), [0.37, -0.45]];
            for jitter in jitters {
                let settings = settings(scale, jitter, margin);
                let mut target = Target::new(&gpu, camera.size(), share, &mut random);
                let [with, without] = frames(&gpu, &mut rasterizer, (&camera, scale), &settings, &mut target);
                let what = format!("x{scale}, {size:?}, jitter {jitter:?}");
                assert_identical(&with, &without, &what);
                target.assert_native(&gpu, &image, &what);
            }
        }
    }
}

#[test]
fn blocks_of_real_scenes_are_the_native_image() {
    let Some(gpu) = gpu() else { return };
    let mut random = Random(8);
    for (name, scene, camera) in real_scenes::scenes() {
        let camera = camera.resized(320, 180).expect("valid");
        let image = native(&scene, &camera);
        let mut rasterizer =
            GpuRasterizer::new(&gpu, scene, Culling::AccuTile, ScenePrecision::F32).expect("room");
        let mut target = Target::new(&gpu, camera.size(), 0.3, &mut random);
        let settings = settings(4, Jitter::grid(4).offset(random.bits() % 16), Margin::NONE);
        let [with, without] = frames(&gpu, &mut rasterizer, (&camera, 4), &settings, &mut target);
        assert_identical(&with, &without, name);
        target.assert_native(&gpu, &image, name);
    }
}

#[test]
fn blocks_without_their_frame_or_room_are_typed_errors() {
    let Some(gpu) = gpu() else { return };
    let camera = camera_at_origin(64, 40, DVec2::ZERO);
    let scene = Arc::new(RandomScene { count: 20, ..RandomScene::BASE }.build(&camera));
    let new =
        |culling| GpuRasterizer::new(&gpu, Arc::clone(&scene), culling, ScenePrecision::F32).expect("room");
    let mut target = Target::new(&gpu, Size::new(64, 40), 1.0, &mut Random(1));
    let mut small = Target::new(&gpu, Size::new(64, 36), 1.0, &mut Random(1));
    let (settings, mut out) = (settings(4, [0.125; 2], Margin::NONE), GpuGBuffer::default());
    for (culling, has_blocks, makes_blocks, outputs) in [
        (Culling::AccuTile, false, true, Outputs::GBuffer),
        (Culling::Adr, true, false, Outputs::GBuffer),
        (Culling::AccuTile, true, true, Outputs::Color),
        (Culling::AccuTile, true, true, Outputs::GBuffer),
    ] {
        let settings = RasterSettings { outputs, ..settings };
        let mut rasterizer = new(culling);
        assert_eq!(rasterizer.makes_blocks(), makes_blocks);
        let mut recorder = gpu.recorder(None);
        let none = rasterizer.record_blocks(&mut recorder, &mut target.blocks);
        assert!(matches!(none, Err(GpuRasterError::Settings(RasterError::NoFrame))), "{none:?}");
        let frame = LowResolution { camera: &camera, scale: 4, has_blocks };
        rasterizer.record_low_resolution(&mut recorder, frame, &settings, &mut out).expect("room");
        let made = rasterizer.record_blocks(&mut recorder, &mut target.blocks);
        if has_blocks && makes_blocks && outputs == Outputs::GBuffer {
            assert!(made.is_ok(), "{made:?}");
            let refused = rasterizer.record_blocks(&mut recorder, &mut small.blocks);
            assert!(matches!(refused, Err(GpuRasterError::Gpu(_))), "{refused:?}");
        } else {
            assert!(matches!(made, Err(GpuRasterError::Settings(RasterError::NoFrame))), "{made:?}");
        }
        recorder.submit().expect("a device");
    }
}
