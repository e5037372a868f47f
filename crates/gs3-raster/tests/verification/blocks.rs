//! Low-resolution frames of the native image's own splats, and exact blocks beside them: both are the native image.

use std::sync::Arc;

use glam::DVec2;
use gs3_raster::{
    Culling, KERBL_DILATION, NEAR, Outputs, RasterError, RasterSettings, Rasterizer, matched_dilation,
};
use gs3_scene::{BLOCK_SIDE, Camera, ExactBlocks, GBuffer, Image, Jitter, Margin, block_grid, demo};

use crate::real_scenes::scenes;
use crate::scenes::{Random, RandomScene, camera_at_origin};

pub fn settings(scale: u32, jitter: [f32; 2]) -> RasterSettings {
    let background = [0.1, 0.3, 0.2];
    let dilation = matched_dilation(scale);
    RasterSettings { dilation, jitter, background, ..RasterSettings::new(Outputs::GBuffer) }
}

pub fn native(rasterizer: &mut Rasterizer, camera: &Camera) -> (Image, GBuffer) {
    let settings = RasterSettings { dilation: KERBL_DILATION, ..settings(1, [0.0; 2]) };
    let (mut image, mut gbuffer) = (Image::default(), GBuffer::default());
    rasterizer.rasterize_image(camera, &settings, &mut image).expect("valid settings");
    rasterizer.rasterize(camera, &settings, &mut gbuffer).expect("valid settings");
    (image, gbuffer)
}

/// Asserts that each block holds the native image's pixels: colours bit for bit, the rest as the native G-buffer has it.
fn assert_native(blocks: &ExactBlocks, image: &Image, gbuffer: &GBuffer) {
    let gradients = gbuffer.gradients.as_ref().expect("gradients");
    let geometry = gbuffer.geometry.as_ref().expect("depth");
    let (width, height) = (image.width(), image.height());
    for ([column, row], block) in blocks.places.iter().zip(&blocks.blocks) {
        for lane in 0..16 {
            let x = usize::from(*column) * BLOCK_SIDE + lane % BLOCK_SIDE;
            let y = usize::from(*row) * BLOCK_SIDE + lane / BLOCK_SIDE;
            if x >= width || y >= height {
                assert_eq!(block.color.map(|plane| plane[lane]), [0.0; 3], "beyond the image at {x}, {y}");
                assert_eq!(block.depth_median[lane], 0.0, "beyond the image at {x}, {y}");
                continue;
            }
            let pixel = image.pixels()[y * width + x];
            for c in 0..3 {
                assert_eq!(block.color[c][lane].to_bits(), pixel[c].to_bits(), "colour {c} at {x}, {y}");
                assert_eq!(block.color_dx[c][lane], gradients.color_dx.row(c, y)[x], "d/dx {c} at {x}, {y}");
                assert_eq!(block.color_dy[c][lane], gradients.color_dy.row(c, y)[x], "d/dy {c} at {x}, {y}");
            }
            assert_eq!(block.depth_median[lane], geometry.depth_median.row(0, y)[x], "depth at {x}, {y}");
        }
    }
}

/// Asserts that the samples of a low-resolution frame are the native image's pixels, bit for bit.
fn assert_samples(gbuffer: &GBuffer, image: &Image, scale: usize, cell: [usize; 2]) {
    let Margin { left, top, right, bottom } = gbuffer.margin;
    let (left, top) = (left as usize, top as usize);
    let mut compared = 0;
    for j in top..gbuffer.height() - bottom as usize {
        for i in left..gbuffer.width() - right as usize {
            let (x, y) = ((i - left) * scale + cell[0], (j - top) * scale + cell[1]);
            if x >= image.width() || y >= image.height() {
                continue;
            }
            let pixel = image.pixels()[y * image.width() + x];
            for c in 0..3 {
                assert_eq!(gbuffer.color.row(c, j)[i].to_bits(), pixel[c].to_bits(), "{c} at {x}, {y}");
            }
            compared += 1;
        }
    }
    let columns_and_rows = |side: usize| side / scale;
    let whole_cells = columns_and_rows(image.width()) * columns_and_rows(image.height());
    assert!(compared >= whole_cells, "{compared} samples compared");
}

fn cell(scale: u32, jitter: [f32; 2]) -> [usize; 2] {
    jitter.map(|offset| (scale as f32 * (0.5 + offset) - 0.5).round() as usize)
}

/// Every `every`-th block of an image, from a random one on.
fn some_blocks(image: &Image, every: usize, random: &mut Random) -> Vec<[u16; 2]> {
    let [columns, rows] = block_grid(image.size());
    let all = (0..rows).flat_map(|y| (0..columns).map(move |x| [x as u16, y as u16]));
    all.skip((random.bits() as usize) % every).step_by(every).collect()
}

#[test]
fn samples_and_blocks_are_the_native_image_at_every_scale() {
    let mut random = Random(5);
    for (seed, scale) in (1..=8_u32).enumerate() {
        let margin = Margin { left: 4, top: 8, right: 3, bottom: 5 };
        for (size, margin) in [([101, 67], Margin::NONE), ([160, 96], margin), ([3, 2], Margin::NONE)] {
            let camera = camera_at_origin(size[0], size[1], DVec2::new(0.1, -0.1));
            let recipe = RandomScene { seed: seed as u64, count: 120, sh_degree: 1, ..RandomScene::BASE };
            let mut rasterizer = Rasterizer::new(Arc::new(recipe.build(&camera)), Culling::AccuTile);
            let (image, gbuffer) = native(&mut rasterizer, &camera);
            let grid = Jitter::grid(scale);
            for frame in [0, grid.period() as u64 / 2] {
                let jitter = grid.offset(frame);
                let settings = RasterSettings { margin, ..settings(scale, jitter) };
                let mut lr = GBuffer::default();
                rasterizer
                    .rasterize_low_resolution(&camera, scale, &settings, &mut lr)
                    .expect("valid settings");
                assert_samples(&lr, &image, scale as usize, cell(scale, jitter));
                let mut blocks = ExactBlocks::default();
                for every in [1, 3, 40] {
                    let places = some_blocks(&image, every, &mut random);
                    rasterizer.rasterize_blocks(&places, &mut blocks).expect("a frame before");
                    assert_eq!(blocks.len(), places.len());
                    assert_native(&blocks, &image, &gbuffer);
                }
            }
        }
    }
}

#[test]
fn blocks_of_real_scenes_are_the_native_image() {
    let mut random = Random(11);
    for (name, scene, camera) in scenes() {
        let camera = camera.resized(320, 180).expect("valid");
        for culling in [Culling::AccuTile, Culling::Exact] {
            let mut rasterizer = Rasterizer::new(Arc::clone(&scene), culling);
            let (image, gbuffer) = native(&mut rasterizer, &camera);
            let jitter = Jitter::grid(4).offset(random.bits() % 16);
            let mut lr = GBuffer::default();
            let settings = settings(4, jitter);
            rasterizer.rasterize_low_resolution(&camera, 4, &settings, &mut lr).expect("valid settings");
            assert_samples(&lr, &image, 4, cell(4, jitter));
            let mut blocks = ExactBlocks::default();
            let places = some_blocks(&image, 7, &mut random);
            rasterizer.rasterize_blocks(&places, &mut blocks).expect("a frame before");
            assert_eq!(blocks.len(), places.len(), "{name}");
            assert_native(&blocks, &image, &gbuffer);
        }
    }
}

/// Blocks of an image alone have the image's bits with few of its splats: of a scene with distant chunks and one without order,
/// with every rule of culling, at sizes that are no multiple of a block, for no block up to all of them.
#[test]
fn blocks_of_an_image_alone_are_the_image() {
    let mut random = Random(17);
    let far = camera_at_origin(203, 131, DVec2::new(0.1, -0.1));
    let recipe = RandomScene { seed: 9, count: 3000, sh_degree: 1, ..RandomScene::BASE };
    let random_scene = Arc::new(recipe.build(&far));
    let demo_camera = demo::path().cameras()[30].resized(322, 181).expect("a valid size");
    let demo = ("demo", Arc::new(demo::scene().expect("the demo")), demo_camera);
    let real = scenes()
        .into_iter()
        .map(|(name, scene, camera)| (name, scene, camera.resized(322, 181).expect("valid")));
    let all = [("random", random_scene, far), demo].into_iter().chain(real);
    for (name, scene, camera) in all {
        for culling in
            [Culling::Aabb3Sigma, Culling::Adr, Culling::SnugBox, Culling::AccuTile, Culling::Exact]
        {
            let mut rasterizer = Rasterizer::new(Arc::clone(&scene), culling);
            let settings = RasterSettings { dilation: KERBL_DILATION, ..settings(1, [0.0; 2]) };
            let mut image = Image::default();
            rasterizer.rasterize_image(&camera, &settings, &mut image).expect("valid settings");
            let mut blocks = ExactBlocks::default();
            for every in [2000, 60, 1] {
                let mut places = some_blocks(&image, every, &mut random);
                places.push([60_000, 3]);
                rasterizer
                    .rasterize_image_blocks(&camera, &settings, &places, &mut blocks)
                    .expect("valid settings");
                assert_eq!(blocks.len(), places.len() - 1, "{name}");
                for ([column, row], block) in blocks.places.iter().zip(&blocks.blocks) {
                    for lane in 0..16 {
                        let x = usize::from(*column) * BLOCK_SIDE + lane % BLOCK_SIDE;
                        let y = usize::from(*row) * BLOCK_SIDE + lane / BLOCK_SIDE;
                        let is_inside = x < image.width() && y < image.height();
                        let pixel = if is_inside { image.pixels()[y * image.width() + x] } else { [0.0; 4] };
                        for c in 0..3 {
                            let [made, expected] = [block.color[c][lane], pixel[c]].map(f32::to_bits);
                            assert_eq!(made, expected, "{name} {culling:?}: colour {c} at {x}, {y}");
                        }
                    }
                }
                assert_eq!(
                    rasterizer.rasterize_blocks(&places, &mut blocks),
                    Err(RasterError::NoFrame),
                    "the splats are those of the blocks"
                );
            }
        }
    }
}

/// Frames with samples between and beyond the native image's pixels have the bits of the low-resolution camera's frames, and
/// blocks after them the bits of the native image.
#[test]
fn samples_off_the_pixels_see_all_splats() {
    let camera = camera_at_origin(128, 72, DVec2::ZERO);
    let recipe = RandomScene { seed: 4, count: 3000, sigma: [0.05, 0.3], ..RandomScene::BASE };
    let scene = Arc::new(recipe.build(&camera));
    let margin = Margin { left: 4, top: 8, right: 3, bottom: 5 };
    for culling in [Culling::AccuTile, Culling::Exact, Culling::SnugBox] {
        let mut rasterizer = Rasterizer::new(Arc::clone(&scene), culling);
        let (image, gbuffer) = native(&mut rasterizer, &camera);
        for (jitter, margin) in [([0.0; 2], Margin::NONE), ([-0.45, 0.5], margin)] {
            let settings = RasterSettings { margin, ..settings(4, jitter) };
            let (mut lr, mut alone) = (GBuffer::default(), GBuffer::default());
            rasterizer.rasterize(&camera.low_resolution(4), &settings, &mut alone).expect("valid settings");
            rasterizer.rasterize_low_resolution(&camera, 4, &settings, &mut lr).expect("valid settings");
            assert_eq!(lr.color.data(), alone.color.data(), "{culling:?} {jitter:?}");
            assert!(lr.color.data().iter().any(|v| *v > 0.1), "something is in view");
            let mut blocks = ExactBlocks::default();
            // Twice: the second time the splats are at hand.
            for _ in 0..2 {
                let places = some_blocks(&image, 3, &mut Random(2));
                rasterizer.rasterize_blocks(&places, &mut blocks).expect("a frame before");
                assert_eq!(blocks.len(), places.len());
                assert_native(&blocks, &image, &gbuffer);
            }
        }
    }
}

/// What a scene says of itself holds for low-resolution frames and blocks as for native frames: its near plane, and
/// harmonics of degree 4.
#[test]
fn near_planes_and_degree_4_are_shared() {
    let camera = camera_at_origin(96, 64, DVec2::ZERO);
    let recipe = RandomScene { seed: 8, count: 150, sh_degree: 4, ..RandomScene::BASE };
    let jitter = Jitter::grid(4).offset(5);
    let mut colors = Vec::new();
    for near in [NEAR, 5.0] {
        let scene = Arc::new(recipe.build(&camera).with_near(near));
        assert_eq!(scene.gaussians().sh_degree, 4);
        let mut rasterizer = Rasterizer::new(scene, Culling::AccuTile);
        let (image, gbuffer) = native(&mut rasterizer, &camera);
        let mut lr = GBuffer::default();
        rasterizer
            .rasterize_low_resolution(&camera, 4, &settings(4, jitter), &mut lr)
            .expect("valid settings");
        assert_samples(&lr, &image, 4, cell(4, jitter));
        let mut blocks = ExactBlocks::default();
        rasterizer
            .rasterize_blocks(&some_blocks(&image, 2, &mut Random(1)), &mut blocks)
            .expect("a frame before");
        assert_native(&blocks, &image, &gbuffer);
        colors.push(lr.color.data().to_vec());
    }
    assert_ne!(colors[0], colors[1], "the near plane cuts something");
}

#[test]
fn a_low_resolution_frame_is_that_of_the_low_resolution_camera() {
    let camera = camera_at_origin(128, 72, DVec2::ZERO);
    let recipe = RandomScene { seed: 3, count: 100, ..RandomScene::BASE };
    let mut rasterizer = Rasterizer::new(Arc::new(recipe.build(&camera)), Culling::AccuTile);
    for jitter in [[0.0; 2], [-0.375, 0.125]] {
        let settings = settings(4, jitter);
        let (mut shared, mut alone) = (GBuffer::default(), GBuffer::default());
        rasterizer.rasterize(&camera.low_resolution(4), &settings, &mut alone).expect("valid settings");
        rasterizer.rasterize_low_resolution(&camera, 4, &settings, &mut shared).expect("valid settings");
        assert_eq!((shared.jitter, shared.width(), shared.height()), (jitter, 32, 18));
        // Positions are rounded in other units; a contribution near 1/255 may fall to either side.
        let far = |a: &[f32], b: &[f32], by: f32| {
            a.iter().zip(b).filter(|(a, b)| (*a - *b).abs() > by * (1.0 + a.abs())).count()
        };
        let count = far(shared.color.data(), alone.color.data(), 1e-4);
        // Of 1728; each flip is a contribution of 1/255.
        assert!(count <= 35, "{count} colours");
        assert_eq!(far(shared.color.data(), alone.color.data(), 0.02), 0);
        let gradients = |g: &GBuffer| g.gradients.as_ref().unwrap().color_dx.data().to_vec();
        let count = far(&gradients(&shared), &gradients(&alone), 1e-3);
        assert!(count <= 70, "{count} derivatives");
        let depths = |g: &GBuffer| g.geometry.as_ref().unwrap().depth_median.data().to_vec();
        let count = far(&depths(&shared), &depths(&alone), 1e-3);
        assert!(count <= 12, "{count} depths");
        assert!(gradients(&alone).iter().any(|v| v.abs() > 0.01), "something varies");
    }
}

#[test]
fn what_cannot_be_shared_is_refused() {
    let camera = camera_at_origin(32, 24, DVec2::ZERO);
    let recipe = RandomScene { seed: 3, count: 20, ..RandomScene::BASE };
    let mut rasterizer = Rasterizer::new(Arc::new(recipe.build(&camera)), Culling::AccuTile);
    let (mut blocks, mut gbuffer, mut image) = (ExactBlocks::default(), GBuffer::default(), Image::default());
    assert_eq!(rasterizer.rasterize_blocks(&[[0, 0]], &mut blocks), Err(RasterError::NoFrame));
    let of_scale = |scale| settings(scale, [0.0; 2]);
    for scale in [0, 9] {
        let refused = rasterizer.rasterize_low_resolution(&camera, scale, &of_scale(1), &mut gbuffer);
        assert_eq!(refused, Err(RasterError::Scale { actual: scale }));
    }
    let margin = Margin { left: 1, ..Margin::NONE };
    let refused = RasterSettings { margin, ..of_scale(2) };
    assert_eq!(
        rasterizer.rasterize_low_resolution(&camera, 2, &refused, &mut gbuffer),
        Err(RasterError::MarginBlocks { scale: 2, actual: 1 })
    );
    rasterizer.rasterize_low_resolution(&camera, 4, &of_scale(4), &mut gbuffer).expect("valid settings");
    // Beyond the image there are none, and one named twice is made once.
    rasterizer
        .rasterize_blocks(&[[0, 0], [8, 0], [0, 6], [7, 5], [0, 0]], &mut blocks)
        .expect("a frame before");
    assert_eq!(blocks.places, [[0, 0], [7, 5]]);
    // Another frame in between takes the splats' place.
    rasterizer
        .rasterize_image(&camera, &RasterSettings::new(Outputs::Color), &mut image)
        .expect("valid settings");
    assert_eq!(rasterizer.rasterize_blocks(&[[0, 0]], &mut blocks), Err(RasterError::NoFrame));
}
