//! Exact blocks: expected errors, selection, the image and the history.

use crate::common::{World, camera, grid_jitter, wall_and_post};
use gs3_reconstruct::{BlockBudget, Kriging, SuperSampler, select_blocks};
use gs3_scene::{BLOCK_SIDE, Camera, ExactBlock, ExactBlocks, Image, Size, block_grid};
use gs3_test_support::psnr;

const SCALE: u32 = 4;
/// No multiple of a block's side along y.
const SIZE: Size = Size::new(240, 134);

fn at(t: f64) -> Camera {
    camera(SIZE.width, SIZE.height, [t, 0.3 * t, 0.2 * t], 0.1 * t, -0.05 * t)
}

/// The blocks of what `camera` sees.
pub fn exact_blocks(world: &World, camera: &Camera, places: Vec<[u16; 2]>) -> ExactBlocks {
    let native = world.gbuffer(camera, [0.0; 2]);
    let (gradients, geometry) = (native.gradients.as_ref().unwrap(), native.geometry.as_ref().unwrap());
    let block = |[column, row]: &[u16; 2]| {
        let mut block = ExactBlock::EMPTY;
        for lane in 0..16 {
            let x = usize::from(*column) * BLOCK_SIDE + lane % BLOCK_SIDE;
            let y = usize::from(*row) * BLOCK_SIDE + lane / BLOCK_SIDE;
            if x < native.width() && y < native.height() {
                for c in 0..3 {
                    block.color[c][lane] = native.color.row(c, y)[x];
                    block.color_dx[c][lane] = gradients.color_dx.row(c, y)[x];
                    block.color_dy[c][lane] = gradients.color_dy.row(c, y)[x];
                }
                block.depth_median[lane] = geometry.depth_median.row(0, y)[x];
            }
        }
        block
    };
    ExactBlocks { blocks: places.iter().map(block).collect(), places }
}

/// A sampler that refines `share` of each frame.
struct Run<'a> {
    world: &'a World,
    sampler: SuperSampler,
    image: Image,
    frames: usize,
}

impl<'a> Run<'a> {
    fn new(world: &'a World) -> Self {
        let sampler = SuperSampler::new(SCALE, Kriging::Off).unwrap();
        Self { world, sampler, image: Image::default(), frames: 0 }
    }

    /// Reconstructs the next frame; its expected errors.
    fn frame(&mut self, camera: &Camera) -> &[f32] {
        let gbuffer = self.world.gbuffer(&camera.low_resolution(SCALE), grid_jitter(SCALE, self.frames));
        self.sampler.super_sample(camera, &gbuffer, &mut self.image).unwrap();
        self.frames += 1;
        self.sampler.expected_errors()
    }

    fn select(&self, most: f32) -> Vec<[u16; 2]> {
        let budget = BlockBudget { most, least_error: 0.0 };
        select_blocks(self.sampler.expected_errors(), self.image.size(), budget)
    }

    fn refine(&mut self, camera: &Camera, places: Vec<[u16; 2]>) {
        let blocks = exact_blocks(self.world, camera, places);
        self.sampler.refine(&blocks, &mut self.image);
    }
}

/// Squared errors by block: sums over pixels and RGB.
fn true_errors(image: &Image, native: &Image) -> Vec<f32> {
    let [columns, rows] = block_grid(image.size());
    let mut errors = vec![0.0; columns * rows];
    for (k, (a, b)) in image.pixels().iter().zip(native.pixels()).enumerate() {
        let (x, y) = (k % image.width() / BLOCK_SIDE, k / image.width() / BLOCK_SIDE);
        errors[y * columns + x] += (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f32>();
    }
    errors
}

#[test]
fn expected_errors_find_the_blocks_that_err() {
    let world = wall_and_post(60.0);
    let mut run = Run::new(&world);
    for k in 0..20 {
        let camera = at(0.02 * k as f64);
        let expected = run.frame(&camera).to_vec();
        if k < 8 {
            continue;
        }
        let errors = true_errors(&run.image, &world.native(&camera));
        assert_eq!(expected.len(), errors.len());
        let all: f32 = errors.iter().sum();
        let [columns, _] = block_grid(run.image.size());
        let worst = run.select(0.1);
        assert_eq!(worst.len(), (0.1 * errors.len() as f32).round() as usize);
        let found: f32 = worst.iter().map(|[x, y]| errors[usize::from(*y) * columns + usize::from(*x)]).sum();
        // A tenth of the blocks at random has a tenth of the error.
        assert!(found > 0.25 * all, "frame {k}: {:.3} of the error", found / all);
    }
}

/// Blocks that reach beyond the image have the errors of their pixels in it.
#[test]
fn errors_of_blocks_at_the_border_are_those_of_their_pixels() {
    let world = wall_and_post(60.0);
    for width in 237..=240 {
        let mut sampler = SuperSampler::new(SCALE, Kriging::Off).unwrap();
        let mut image = Image::default();
        // Memory of tiles is not zero from the second frame on.
        for k in 0..3 {
            let camera = camera(width, SIZE.height, [0.02 * f64::from(k), 0.0, 0.0], 0.0, 0.0);
            let gbuffer = world.gbuffer(&camera.low_resolution(SCALE), grid_jitter(SCALE, k as usize));
            sampler.super_sample(&camera, &gbuffer, &mut image).unwrap();
            let errors = sampler.expected_errors();
            let [columns, rows] = block_grid(image.size());
            let of_column = |x: usize| (0..rows).map(|y| errors[y * columns + x]).sum::<f32>();
            let most = (columns - 20..columns - 1).map(of_column).fold(0.0, f32::max);
            let last = of_column(columns - 1);
            assert!(last > 0.0 && last < 1.5 * most, "width {width}, frame {k}: {last} of {most}");
        }
    }
}

#[test]
fn what_is_refined_is_exact_and_certain() {
    let world = wall_and_post(60.0);
    let mut run = Run::new(&world);
    for k in 0..3 {
        run.frame(&at(0.02 * k as f64));
    }
    let camera = at(0.04);
    let before = run.image.clone();
    // The last row of blocks lies half outside the image.
    let places = vec![[0, 0], [7, 3], [59, 33], [30, 33]];
    run.refine(&camera, places.clone());
    let native = world.gbuffer(&camera, [0.0; 2]);
    let mut exact = 0;
    for (k, (pixel, before)) in run.image.pixels().iter().zip(before.pixels()).enumerate() {
        let (x, y) = (k % run.image.width(), k / run.image.width());
        if places.contains(&[(x / 4) as u16, (y / 4) as u16]) {
            let [r, g, b] = [0, 1, 2].map(|c| native.color.row(c, y)[x]);
            assert_eq!(*pixel, [r, g, b, 0.0], "{x}, {y}");
            exact += 1;
        } else {
            assert_eq!(pixel, before, "{x}, {y}");
        }
    }
    assert_eq!(exact, 2 * 16 + 2 * 8);
    assert_eq!(run.sampler.remembered_blocks(), 4);
}

#[test]
fn the_next_frames_know_what_was_refined() {
    let world = wall_and_post(60.0);
    // Slowly: blocks are forgotten once the picture has moved by 3 % of its width.
    let path = |k: usize| at(0.01 * k as f64);
    // Before anything is refined in the last frame.
    let quality = |share: f32| {
        let mut run = Run::new(&world);
        for k in 0..20 {
            run.frame(&path(k));
            if k < 19 {
                let places = run.select(share);
                run.refine(&path(k), places);
            }
        }
        psnr(&run.image, &world.native(&path(19)))
    };
    let [none, some] = [quality(0.0), quality(0.1)];
    assert!(some > none + 1.5, "{none:.2} dB without, {some:.2} dB with a tenth of each frame before");
}

#[test]
fn a_resting_camera_becomes_native_sooner_and_needs_no_more() {
    let world = wall_and_post(60.0);
    let camera = at(0.3);
    let native = world.native(&camera);
    let reached = |share: f32, frames: usize| {
        let mut run = Run::new(&world);
        for _ in 0..frames {
            run.frame(&camera);
            let places = run.select(share);
            run.refine(&camera, places);
        }
        (psnr(&run.image, &native), run)
    };
    let (without, _) = reached(0.0, 4);
    let (with, _) = reached(0.1, 4);
    assert!(with > without + 2.0, "after four frames {without:.2} dB, {with:.2} dB refined");
    let (last, mut run) = reached(0.1, 16);
    assert!(last > 80.0, "{last:.2} dB");
    run.frame(&camera);
    assert!(run.select(1.0).is_empty(), "nothing is uncertain any more");
    // Whole frames are exact at once and stay so.
    let mut run = Run::new(&world);
    run.frame(&camera);
    let [columns, rows] = block_grid(run.image.size());
    let all = (0..rows).flat_map(|y| (0..columns).map(move |x| [x as u16, y as u16])).collect();
    run.refine(&camera, all);
    assert!(psnr(&run.image, &native) >= 120.0);
    run.frame(&camera);
    assert!(psnr(&run.image, &native) > 80.0, "{:.2} dB", psnr(&run.image, &native));
}

/// A block of each frame, where no other block is. The camera only turns, by 3 % of the picture's width in four frames.
#[test]
fn blocks_are_forgotten_after_six_frames_of_a_turn_and_not_at_rest() {
    let world = wall_and_post(60.0);
    let remembered = |turn: f64| {
        let mut run = Run::new(&world);
        for k in 0..12 {
            let camera = camera(SIZE.width, SIZE.height, [0.0; 3], turn * f64::from(k), 0.0);
            run.frame(&camera);
            run.refine(&camera, vec![[30, 2 * k as u16 + 4]]);
        }
        run.sampler.remembered_blocks()
    };
    assert_eq!(remembered(0.0), 12);
    assert_eq!(remembered(0.01), 7, "the last frame's, and those of six frames before");
}

#[test]
fn what_is_refined_again_is_remembered_once() {
    let world = wall_and_post(60.0);
    let mut run = Run::new(&world);
    let places: Vec<[u16; 2]> = (10..20).flat_map(|y| (10..30).map(move |x| [x, y])).collect();
    for k in 0..10 {
        // Far less than a block's side a frame.
        let camera = at(0.001 * k as f64);
        run.frame(&camera);
        run.refine(&camera, places.clone());
        let remembered = run.sampler.remembered_blocks();
        assert!((200..=280).contains(&remembered), "{remembered} blocks after frame {k}");
    }
    // What leaves the picture is forgotten.
    for k in 0..2 {
        let away = camera(SIZE.width, SIZE.height, [0.0; 3], 2.5, 0.0);
        run.frame(&away);
        let places = if k == 0 { Vec::new() } else { vec![[1, 1]] };
        run.refine(&away, places);
    }
    assert_eq!(run.sampler.remembered_blocks(), 1);
}

/// All blocks of a first frame are remembered at rest. Once the camera moves, those with an expected error of at most half a step
/// of 8 bits are not. Blocks of later frames are, whatever their errors.
#[test]
fn faint_blocks_of_a_first_frame_are_forgotten_in_motion() {
    let world = wall_and_post(8.0);
    let mut run = Run::new(&world);
    let [columns, rows] = block_grid(SIZE);
    let all: Vec<[u16; 2]> =
        (0..rows).flat_map(|y| (0..columns).map(move |x| [x as u16, y as u16])).collect();
    run.frame(&at(0.3));
    let least = 48.0 * (0.5_f32 / 255.0).powi(2);
    let visible = run.sampler.expected_errors().iter().filter(|error| **error > least).count();
    assert!(visible > all.len() / 10 && visible < all.len() * 9 / 10, "{visible} of {}", all.len());
    // The blocks of a frame may come in several calls.
    all.chunks(all.len().div_ceil(2)).for_each(|part| run.refine(&at(0.3), part.to_vec()));
    run.frame(&at(0.3));
    run.refine(&at(0.3), Vec::new());
    assert_eq!(run.sampler.remembered_blocks(), all.len());
    run.frame(&at(0.301));
    run.refine(&at(0.301), Vec::new());
    let remembered = run.sampler.remembered_blocks();
    // A few have left the picture.
    assert!(remembered <= visible && remembered > visible * 9 / 10, "{remembered} of {visible}");
    run.refine(&at(0.301), all.clone());
    run.frame(&at(0.302));
    assert!(run.sampler.remembered_blocks() >= all.len());
}
