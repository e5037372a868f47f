//! Exact blocks on a GPU: the errors that are expected of a frame, the choice of blocks, and what is remembered of them.

use gs3_compute::{Buffer, Gpu, Use};
use gs3_reconstruct::gpu::{GpuBlockSelector, SideOutput};
use gs3_reconstruct::{BlockBudget, Kriging, ResetReason, SuperSampler, select_blocks};
use gs3_scene::{Camera, ExactBlocks, GBuffer, Image, Size, block_grid};
use gs3_test_support::psnr;

use crate::common::{World, camera, grid_jitter, wall_and_post};
use crate::gpu::{FLOOR, Sampler, gpu};
use crate::refine::exact_blocks;

/// Units of the device's errors, and the expected squared error of one of them: `ERROR_UNITS` and `PER_LAPLACIAN`.
const PER_UNIT: f32 = 6.0 / (1 << 24) as f32;

/// The blocks that a device chooses by `errors`, in units, within `budget`.
fn chosen(gpu: &Gpu, errors: &[u32], size: Size, budget: BlockBudget) -> (Vec<[u16; 2]>, u32) {
    let buffer = gpu.buffer_with("errors", Use::Storage, errors).unwrap();
    let selector = GpuBlockSelector::new(gpu, size, &buffer).unwrap();
    // Twice: nothing of the first choice stays.
    for budget in [BlockBudget::ALL, budget] {
        let mut recorder = gpu.recorder(None);
        selector.record(&mut recorder, budget).unwrap();
        recorder.submit().unwrap();
    }
    let marks = gpu.read::<u32>(&selector.chosen().slice()).unwrap();
    let columns = block_grid(size)[0];
    let places = marks.iter().enumerate().filter(|(_, mark)| **mark != 0);
    let places = places.map(|(k, _)| [(k % columns) as u16, (k / columns) as u16]).collect();
    (places, gpu.read::<u32>(&selector.chosen_count().slice()).unwrap()[0])
}

#[test]
fn the_choice_is_the_cpus() {
    let Some(gpu) = gpu() else { return };
    let size = Size::new(410, 250);
    let [columns, rows] = block_grid(size);
    // Equal errors, none, the largest, and errors around the least one.
    let errors: Vec<u32> = (0..columns * rows)
        .map(|k| match k % 7 {
            0 => 0,
            1 => 5000,
            2 => 1 << 30,
            3 => 516 + (k % 3) as u32,
            _ => (k as u32).wrapping_mul(2_654_435_761) >> (3 + k % 25),
        })
        .collect();
    let as_floats: Vec<f32> = errors.iter().map(|units| *units as f32 * PER_UNIT).collect();
    let step = (0.5_f32 / 255.0).powi(2);
    for (most, least_error) in [
        (0.06, 0.0),
        (0.06, step),
        (0.9, step),
        (1.0, step),
        (1.0, 0.0),
        (0.3, -1.0),
        (1.0, -1.0),
        (0.0, 0.0),
    ] {
        let budget = BlockBudget { most, least_error };
        let (places, count) = chosen(&gpu, &errors, size, budget);
        let mut expected = select_blocks(&as_floats, size, budget);
        expected.sort_unstable_by_key(|[x, y]| (*y, *x));
        assert_eq!(count as usize, places.len());
        assert_eq!(places, expected, "{budget:?}");
    }
}

#[test]
fn expected_errors_match_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let world = wall_and_post(60.0);
    for (scale, size) in [(4, Size::new(230, 133)), (2, Size::new(101, 66))] {
        let pose = |k: usize| {
            camera(size.width, size.height, [0.02 * k as f64, 0.006 * k as f64, 0.004 * k as f64], 0.0, 0.0)
        };
        let mut cpu = SuperSampler::new(scale, Kriging::Off).unwrap();
        let mut device =
            Sampler::with_side_output(&gpu, scale, size, SideOutput::ExpectedErrors, Kriging::Off);
        for k in 0..6 {
            let gbuffer = world.gbuffer(&pose(k).low_resolution(scale), grid_jitter(scale, k));
            let mut image = Image::default();
            cpu.super_sample(&pose(k), &gbuffer, &mut image).unwrap();
            device.super_sample(&pose(k), &gbuffer);
            let found = gpu.read::<u32>(&device.sampler.expected_errors().unwrap().slice()).unwrap();
            let expected = cpu.expected_errors();
            // Memory is a multiple of 16 bytes.
            let found = &found[..expected.len()];
            let total: f64 = expected.iter().map(|error| f64::from(*error)).sum();
            let pairs = found.iter().zip(expected);
            let off: f64 =
                pairs.map(|(found, error)| f64::from((*found as f32 * PER_UNIT - error).abs())).sum();
            eprintln!("x{scale}, frame {k}: {:.1e} of {total:.3} off", off / total);
            // Halves of the history change a correction by a few thousandths (found: 3e-4 of all errors).
            assert!(total > 1.0 && off < 2e-3 * total, "x{scale}, frame {k}: {off} of {total}");
        }
    }
}

/// The samples of `blocks` as a device reads them.
fn upload(gpu: &Gpu, blocks: &ExactBlocks) -> Buffer {
    let pixels = blocks.blocks.iter().flat_map(|block| (0..16).map(move |lane| (block, lane)));
    let of = |planes: &[[f32; 16]; 3], lane: usize, fourth: f32| {
        [planes[0][lane], planes[1][lane], planes[2][lane], fourth]
    };
    let (mut colors, mut dx, mut dy) = (Vec::new(), Vec::new(), Vec::new());
    for (block, lane) in pixels {
        colors.push(of(&block.color, lane, block.depth_median[lane]));
        dx.push(of(&block.color_dx, lane, 0.0));
        dy.push(of(&block.color_dy, lane, 0.0));
    }
    gpu.buffer_with("samples", Use::Storage, &[colors, dx, dy].concat()).unwrap()
}

/// The frame of `device`, with `blocks`, which the next frames remember. All frames together take no layer twice.
fn super_sample_with(
    gpu: &Gpu,
    device: &mut Sampler,
    (camera, gbuffer): (&Camera, &GBuffer),
    blocks: &ExactBlocks,
) -> Image {
    if blocks.is_empty() {
        return device.super_sample(camera, gbuffer).0;
    }
    let [columns, rows] = block_grid(camera.size());
    let mut errors = vec![0_u32; columns * rows];
    for [x, y] in &blocks.places {
        errors[usize::from(*y) * columns + usize::from(*x)] = 1000;
    }
    let errors = gpu.buffer_with("errors", Use::Storage, &errors).unwrap();
    let selector = GpuBlockSelector::new(gpu, camera.size(), &errors).unwrap();
    let bound = device.sampler.bind_blocks(&selector, &upload(gpu, blocks)).unwrap();
    let budget = BlockBudget { most: 1.0 / 25.0, least_error: 0.0 };
    device.super_sample_with_blocks((camera, gbuffer), (&bound, &selector, budget))
}

/// The history of a device remembers exact blocks as the CPU's does, while the camera moves.
#[test]
fn exact_blocks_are_remembered_as_on_the_cpu() {
    remember_blocks(&wall_and_post(60.0), 0.004);
}

/// The same with a post with an edge of several pixels, which reaches into blocks of the wall and moves away from them.
#[test]
fn exact_blocks_beside_soft_edges_are_remembered_as_on_the_cpu() {
    let mut world = wall_and_post(60.0);
    world.sheets[0].softness = 0.03;
    remember_blocks(&world, 0.008);
}

/// The same at rest, where samples lie on whole pixels.
#[test]
fn exact_blocks_are_remembered_at_rest_as_on_the_cpu() {
    remember_blocks(&wall_and_post(60.0), 0.0);
}

/// `step` is the camera's way from frame to frame.
fn remember_blocks(world: &World, step: f64) {
    let Some(gpu) = gpu() else { return };
    // No multiple of a block's side along y.
    let size = Size::new(240, 134);
    for scale in [2, 3, 4, 8] {
        let pose = |k: usize| {
            let t = step * k as f64;
            camera(size.width, size.height, [t, 0.3 * t, 0.2 * t], 0.1 * t, -0.05 * t)
        };
        let mut cpu = SuperSampler::new(scale, Kriging::Off).unwrap();
        let new = || Sampler::with_side_output(&gpu, scale, size, SideOutput::ExpectedErrors, Kriging::Off);
        let (mut device, mut forgetful) = (new(), new());
        for k in 0..5 {
            let gbuffer = world.gbuffer(&pose(k).low_resolution(scale), grid_jitter(scale, k));
            let mut expected = Image::default();
            cpu.super_sample(&pose(k), &gbuffer, &mut expected).unwrap();
            // In columns that the camera carries no older block to: the CPU would forget the older block.
            let is_chosen = |x: usize, y: usize| x % 8 == 2 * k && y % 4 == k % 4;
            let blocks = exact_blocks(world, &pose(k), places(size, is_chosen));
            let without = forgetful.super_sample(&pose(k), &gbuffer).0;
            let image = super_sample_with(&gpu, &mut device, (&pose(k), &gbuffer), &blocks);
            let [found, without] = [&image, &without].map(|image| psnr(image, &expected));
            eprintln!("x{scale}, frame {k}: {found:.1} dB, {without:.1} without blocks");
            assert!(found >= FLOOR, "x{scale}, frame {k}: {found:.1} dB");
            // At rest every pixel has an LR sample of its own after scale² frames.
            let is_complete = step == 0.0 && k + 1 >= (scale * scale) as usize;
            assert!(k == 0 || is_complete || without < found - 10.0, "x{scale}, frame {k}: no block matters");
            cpu.refine(&blocks, &mut expected);
        }
    }
}

/// The blocks, columns and rows, of an image of `size` that `is_chosen` names.
fn places(size: Size, is_chosen: impl Fn(usize, usize) -> bool) -> Vec<[u16; 2]> {
    let [columns, rows] = block_grid(size);
    let all = (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y)));
    all.filter(|(x, y)| is_chosen(*x, *y)).map(|(x, y)| [x as u16, y as u16]).collect()
}

/// While a camera turns, the history of a device forgets LR frames and exact blocks as the CPU's does.
#[test]
fn frames_are_forgotten_in_motion_as_on_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let (world, size, scale) = (wall_and_post(60.0), Size::new(240, 136), 4);
    // By 3 % of the picture's width in three frames.
    let pose = |k: usize| camera(size.width, size.height, [0.0; 3], 0.02 * k as f64, 0.0);
    let mut cpu = SuperSampler::new(scale, Kriging::Off).unwrap();
    let mut without = SuperSampler::new(scale, Kriging::Off).unwrap();
    let mut device = Sampler::with_side_output(&gpu, scale, size, SideOutput::ExpectedErrors, Kriging::Off);
    let mut apart = f64::INFINITY;
    for k in 0..14 {
        let gbuffer = world.gbuffer(&pose(k).low_resolution(scale), grid_jitter(scale, k));
        let (mut expected, mut unforgotten) = (Image::default(), Image::default());
        cpu.super_sample(&pose(k), &gbuffer, &mut expected).unwrap();
        without.super_sample(&pose(k), &gbuffer, &mut unforgotten).unwrap();
        // In rows of their own, and far from the edges: the CPU forgets older blocks at the same places, and blocks that leave
        // the picture. Every second frame has none, so the four layers of a device hold the blocks of the last six frames.
        let is_chosen = |x: usize, y: usize| k % 2 == 0 && (18..42).contains(&x) && y > 3 && y % 14 == k;
        let blocks = exact_blocks(&world, &pose(k), places(size, is_chosen));
        let image = super_sample_with(&gpu, &mut device, (&pose(k), &gbuffer), &blocks);
        let found = psnr(&image, &expected);
        apart = apart.min(psnr(&unforgotten, &expected));
        eprintln!("frame {k}: {found:.1} dB, {apart:.1} from all frames without blocks");
        assert!(found >= FLOOR, "frame {k}: {found:.1} dB");
        cpu.refine(&blocks, &mut expected);
    }
    assert!(apart < FLOOR - 10.0, "neither blocks nor frames matter: {apart:.1} dB");
}

/// A reset between the recording of a frame and its commit is for the next frame.
#[test]
fn a_reset_before_the_commit_is_kept() {
    let Some(gpu) = gpu() else { return };
    let (world, size) = (wall_and_post(60.0), Size::new(64, 64));
    let camera = camera(size.width, size.height, [0.0; 3], 0.0, 0.0);
    let gbuffer = world.gbuffer(&camera.low_resolution(4), grid_jitter(4, 0));
    let mut device = Sampler::with_side_output(&gpu, 4, size, SideOutput::None, Kriging::Off);
    device.super_sample(&camera, &gbuffer);
    assert_eq!(device.sampler.history_invalid(), None);
    device.super_sample_then(&camera, [&gbuffer, &gbuffer], 0, |sampler, _| {
        sampler.reset(ResetReason::SceneChange);
    });
    assert_eq!(device.sampler.history_invalid(), Some(ResetReason::SceneChange));
}
