//! The stages one by one against the CPU's, and devices smaller than any real one.

use glam::{DAffine3, DVec3};
use gs3_compute::{GpuSettings, Use, device_for_tests};
use gs3_scene::{Gaussians, Intrinsics, Margin, OpacityMode, Size};

use super::*;
use crate::cpu::Rasterizer;
use crate::settings::{Rules, matched_dilation};

/// The adapter of this machine; without one, a message.
fn gpu() -> Option<Gpu> {
    device_for_tests(&GpuSettings::default())
}

/// `count` Gaussians in a box before the camera, most of them a few pixels wide or less, one in fifty all over the
/// image; many have the same depth.
fn scene(count: usize, size: [f32; 2]) -> Arc<Scene> {
    let mut state = 1_u32;
    let mut random = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32
    };
    let mut g = Gaussians::zeroed(count, 1);
    for i in 0..count {
        let depth = 2.0 + (random() * 50.0).floor() / 10.0;
        for (k, side) in [2.4, 1.6].into_iter().enumerate() {
            g.means[k][i] = (random() - 0.5) * side * depth * 0.5;
        }
        g.means[2][i] = depth;
        let large = if i % 50 == 0 { 60.0 } else { 1.0 };
        for k in 0..3 {
            g.scales[k][i] = (size[0] + random() * (size[1] - size[0])) * large;
        }
        for k in 0..4 {
            g.rotations[k][i] = random() - 0.5;
        }
        g.opacities[i] = 0.02 + 0.97 * random();
        for value in &mut g.sh[i * 12..(i + 1) * 12] {
            *value = random() - 0.4;
        }
    }
    Arc::new(Scene::new(g, OpacityMode::Default).expect("valid"))
}

fn camera(width: u32, height: u32) -> Camera {
    narrow_camera(width, height, 0.8)
}

fn narrow_camera(width: u32, height: u32, fov_y: f64) -> Camera {
    let pose = DAffine3::from_translation(DVec3::new(0.02, -0.01, 0.3));
    Camera::new(pose, Intrinsics::from_fov_y(width, height, fov_y)).expect("valid")
}

const SETTINGS: RasterSettings = RasterSettings {
    outputs: Outputs::GBufferMixed,
    dilation: 0.3,
    jitter: [0.25, -0.125],
    margin: Margin::NONE,
    background: [0.1, 0.2, 0.3],
    rules: Rules::KERBL,
};

fn frame(rasterizer: &mut GpuRasterizer, camera: &Camera, settings: &RasterSettings) -> GBuffer {
    let mut gbuffer = GBuffer::default();
    rasterizer.rasterize_to(camera, settings, &mut gbuffer).unwrap_or_else(|e| panic!("{e}"));
    gbuffer
}

/// Exact blocks, every third one, of a picture twice as large as the frame of `camera`: four halves a pixel.
fn blocks(rasterizer: &mut GpuRasterizer, camera: &Camera) -> Vec<[u16; 4]> {
    let gpu = rasterizer.gpu.clone();
    let camera = camera.resized(2 * camera.width(), 2 * camera.height()).expect("valid");
    let number = |k: u32| if k.is_multiple_of(3) { k / 3 + 1 } else { 0 };
    let chosen: Vec<u32> = (0..camera.width() * camera.height()).map(number).collect();
    let image =
        gpu.buffer("image", Use::Storage, u64::from(camera.width() * camera.height()) * 8).expect("room");
    let marks = gpu.buffer_with("chosen", Use::Storage, &chosen).expect("room");
    let samples = gpu.buffer("samples", Use::Storage, EXACT_BLOCK_BYTES).expect("room");
    let (mut blocks, mut out) = (GpuBlocks::new(marks, image.clone(), samples), GpuGBuffer::default());
    let frame = LowResolution { camera: &camera, scale: 2, has_blocks: true };
    loop {
        let mut recorder = gpu.recorder(None);
        rasterizer.record_low_resolution(&mut recorder, frame, &SETTINGS, &mut out).expect("valid");
        rasterizer.record_blocks(&mut recorder, &mut blocks).expect("a frame");
        recorder.submit().expect("a device");
        if rasterizer.check_capacity().expect("room") != CapacityCheck::Grown {
            break gpu.read(&image.slice()).expect("a device");
        }
    }
}

impl GpuRasterizer {
    /// The first `count` numbers of a frame's buffer.
    fn numbers(&self, name: &str, count: u32) -> Vec<u32> {
        let buffer = self.arena.get(name).expect("a buffer of the frame");
        self.gpu.read(&buffer.part(0, u64::from(count) * 4)).expect("a device")
    }
}

#[test]
fn stages_match_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let (scene, camera) = (scene(5000, [0.002, 0.02]), camera(250, 170));
    let settings = RasterSettings { dilation: matched_dilation(4), ..SETTINGS };
    for culling in [Culling::SnugBox, Culling::AccuTile, Culling::Exact] {
        let mut rasterizer =
            GpuRasterizer::new(&gpu, Arc::clone(&scene), culling, ScenePrecision::F32).expect("room");
        let rasterized = frame(&mut rasterizer, &camera, &settings);
        let mut cpu = Rasterizer::new(Arc::clone(&scene), culling);
        let splats = cpu.splats(&camera, &settings);

        // project: the same Gaussians in scene order, the same splats.
        let CapacityCheck::Sufficient { splats: count, entries } =
            rasterizer.check_capacity().expect("a device")
        else {
            panic!("the frame is complete");
        };
        assert_eq!(count as usize, splats.len(), "visible");
        let room = rasterizer.capacity.expect("a frame").splats;
        let words = rasterizer.numbers("splats", 3 * 4 * room);
        let [a, b, c] = [0, 1, 2].map(|k| &words[(4 * room * k) as usize..]);
        for (i, splat) in splats.iter().enumerate() {
            let row = |words: &[u32]| [0, 1, 2, 3].map(|k| f32::from_bits(words[4 * i + k]));
            let actual = [row(a), row(b), row(c)].concat();
            let [x, y] = splat.mean;
            let [red, green, blue] = splat.color;
            let expected = [x, y, splat.l11, splat.l21, splat.l22, splat.support];
            let numbers = actual[..6].iter().zip(expected);
            let colors = actual[8..].iter().zip([red, green, blue, splat.opacity]);
            for (actual, expected) in numbers.chain(colors) {
                assert!(
                    (actual - expected).abs() <= 2e-4 * expected.abs().max(0.1),
                    "{i}: {actual} {expected}"
                );
            }
            let sides =
                [b[4 * i + 2] & 0xffff, b[4 * i + 2] >> 16, b[4 * i + 3] & 0xffff, b[4 * i + 3] >> 16];
            let rect = [splat.rect.x0, splat.rect.x1, splat.rect.y0, splat.rect.y1].map(u32::from);
            assert!(sides.iter().zip(rect).all(|(a, e)| a.abs_diff(e) <= 1), "{i}: {sides:?} {rect:?}");
        }

        // order: by depth, equal depths in scene order.
        let order = rasterizer.numbers("order0", count);
        let mut expected: Vec<u32> = (0..count).collect();
        expected.sort_by_key(|&i| splats[i as usize].depth_bits);
        // Rounding of depths may exchange neighbours.
        let exchanged = order.iter().zip(&expected).filter(|(a, e)| a != e).count();
        assert!(exchanged * 100 <= expected.len(), "{exchanged} of {count} splats elsewhere");

        // bin: tiles have their splats in that order, and all that contribute to a pixel.
        let plan = &rasterizer.frame.as_ref().expect("a frame").plan;
        let half = (plan.tile_bits.div_ceil(8) % 2) as usize;
        let (columns, rows, side) = (plan.bands[0].columns, plan.bands[0].rows, plan.tile);
        let ranges = rasterizer.numbers("ranges", 2 * columns * rows);
        let entry_splats = rasterizer.numbers(["entry_splats0", "entry_splats1"][half], entries);
        let mut place = vec![0; count as usize];
        for (i, &splat) in order.iter().enumerate() {
            place[splat as usize] = i;
        }
        let mut total = 0;
        for tile in 0..columns * rows {
            let [start, end] = [0, 1].map(|k| ranges[(2 * tile + k) as usize] as usize);
            let of_tile = &entry_splats[start..end];
            total += of_tile.len();
            assert!(of_tile.is_sorted_by_key(|&splat| place[splat as usize]), "{culling:?}: tile {tile}");
            let [x0, y0] = [tile % columns, tile / columns].map(|k| (k * side) as f32);
            for (i, splat) in splats.iter().enumerate() {
                let is_listed = of_tile.contains(&(i as u32));
                let last = side as f32 - 0.9;
                let is_near = splat.reaches(x0 - 0.1, y0 - 0.1, x0 + last, y0 + last);
                if culling == Culling::Exact && is_listed {
                    assert!(is_near, "tile {tile} lists splat {i} in vain");
                }
                let contributes = || {
                    (0..side * side).any(|p| {
                        let (x, y) = (x0 + (p % side) as f32, y0 + (p / side) as f32);
                        let (dx, dy) = (splat.mean[0] - x, splat.mean[1] - y);
                        let (u, v) = (splat.l11 * dx + splat.l21 * dy, splat.l22 * dy);
                        let inside = x < 250.0 && y < 170.0;
                        inside && splat.opacity * (-(u * u + v * v)).exp2() > 1.001 / 255.0
                    })
                };
                assert!(is_listed || !is_near || !contributes(), "{culling:?}: tile {tile} lacks splat {i}");
            }
        }
        assert!(total <= entries as usize && total > count as usize, "{total} of {entries} entries drawn");

        // blend: the same picture.
        let mut expected = GBuffer::default();
        cpu.rasterize(&camera, &settings, &mut expected).expect("valid");
        let pairs = rasterized.color.data().iter().zip(expected.color.data());
        let squares: f64 = pairs.map(|(a, e)| f64::from(a - e).powi(2)).sum();
        assert!(squares < 1e-7 * expected.color.data().len() as f64, "{squares}");
    }
}

/// A device with small bindings: the scene is split into pages and the picture into bands, and entries shrink the
/// bands further. The result has the same bits.
#[test]
fn small_bindings_change_nothing() {
    let Some(gpu) = gpu() else { return };
    // A sixth of the scene is in view.
    let (scene, camera) = (scene(40_000, [0.002, 0.01]), narrow_camera(250, 170, 0.3));
    let rasterizer = |binding_bytes: u64| {
        let limits = Limits { binding_bytes, ..gpu.capabilities().limits };
        let (culling, precision) = (Culling::AccuTile, ScenePrecision::F16);
        GpuRasterizer::with_limits(&gpu, Arc::clone(&scene), culling, precision, limits)
    };
    let mut large = rasterizer(128 << 20).expect("room");
    let expected = frame(&mut large, &camera, &SETTINGS);
    // The sort's capacity is 2¹⁶ at least; the picture is 22 rows of tiles of 32,000 bytes, a splat 80 bytes.
    let mut small = rasterizer(650_000).expect("room");
    assert_eq!(frame(&mut small, &camera, &SETTINGS), expected);
    assert_eq!(blocks(&mut small, &camera), blocks(&mut large, &camera));
    let bands = &small.frame.as_ref().expect("a frame").plan.bands;
    assert_eq!((small.pages.len(), large.pages.len()), (2, 1));
    assert!(bands.len() >= 2, "{bands:?}");

    // Too small for a row of tiles.
    let mut tiny = rasterizer(30_000).expect("pages");
    let refused = tiny.rasterize_to(&camera, &SETTINGS, &mut GBuffer::default());
    assert!(matches!(refused, Err(GpuRasterError::Gpu(GpuError::TooLarge { .. }))), "{refused:?}");

    let limits = Limits { storage_bindings: STORAGE_BINDINGS - 1, ..gpu.capabilities().limits };
    let (culling, precision) = (Culling::AccuTile, ScenePrecision::F16);
    let refused = GpuRasterizer::with_limits(&gpu, scene, culling, precision, limits).map(|_| ());
    assert!(matches!(refused, Err(GpuRasterError::Gpu(GpuError::Unsupported { .. }))), "{refused:?}");
}

/// The sides of tiles change no bit, of frames and of exact blocks.
#[test]
fn tiles_of_any_size_make_the_same_frames() {
    let Some(gpu) = gpu() else { return };
    let (scene, camera) = (scene(20_000, [0.002, 0.01]), camera(250, 170));
    let mut rasterizer =
        GpuRasterizer::new(&gpu, scene, Culling::AccuTile, ScenePrecision::F16).expect("room");
    let made = [8, 16].map(|tile| {
        let capacity = Capacity { splats: 1 << 16, entries: 1 << 20, band_rows: u32::MAX };
        let (limits, plan) = (&rasterizer.limits, &rasterizer.plan);
        let plan = FramePlan::with_tiles(limits, plan, Size::new(250, 170), SETTINGS.outputs, capacity, tile);
        rasterizer.capacity = Some(capacity);
        rasterizer.set_frame(plan.expect("sizes")).expect("room");
        let made = (frame(&mut rasterizer, &camera, &SETTINGS), blocks(&mut rasterizer, &camera));
        assert_eq!(rasterizer.frame.as_ref().expect("a frame").plan.tile, tile, "no frame was planned anew");
        made
    });
    assert!(made[0] == made[1]);
}

/// An overflow is reported, and the next frame has enough memory.
#[test]
fn a_frame_without_room_is_made_again() {
    let Some(gpu) = gpu() else { return };
    let (scene, camera) = (scene(20_000, [0.002, 0.01]), camera(250, 170));
    let new = || {
        GpuRasterizer::new(&gpu, Arc::clone(&scene), Culling::AccuTile, ScenePrecision::F16).expect("room")
    };
    let mut roomy = new();
    let expected = frame(&mut roomy, &camera, &SETTINGS);
    for capacity in [
        Capacity { splats: 1000, entries: 1 << 20, band_rows: u32::MAX },
        Capacity { splats: 1 << 16, entries: 3000, band_rows: u32::MAX },
        Capacity { splats: 7, entries: 5, band_rows: 3 },
    ] {
        let mut cramped = new();
        let plan =
            FramePlan::new(&cramped.limits, &cramped.plan, Size::new(250, 170), SETTINGS.outputs, capacity)
                .expect("sizes");
        cramped.capacity = Some(capacity);
        cramped.set_frame(plan).expect("room");
        let mut gbuffer = GpuGBuffer::default();
        let mut recorder = gpu.recorder(None);
        cramped.record(&mut recorder, &camera, &SETTINGS, &mut gbuffer).expect("valid");
        recorder.submit().expect("a device");
        assert_eq!(cramped.check_capacity().expect("a device"), CapacityCheck::Grown, "{capacity:?}");
        assert_eq!(frame(&mut cramped, &camera, &SETTINGS), expected, "{capacity:?}");
        assert!(matches!(cramped.check_capacity(), Ok(CapacityCheck::Sufficient { .. })));
    }
}

/// In a sequence of frames one frame overflows, and a later frame does not.
#[test]
fn no_frame_lacks_room_unseen() {
    let Some(gpu) = gpu() else { return };
    // All over the picture: 50 × 4,096 tiles of 16×16 pixels, where at first there is room for 16 a tile.
    let mut large = Gaussians::zeroed(50, 0);
    large.scales.iter_mut().for_each(|scales| scales.fill(100.0));
    large.rotations[0].fill(1.0);
    large.opacities.fill(0.9);
    let scene = Arc::new(Scene::new(large, OpacityMode::Default).expect("valid"));
    let intrinsics = Intrinsics::from_fov_y(1024, 1024, 0.8);
    let camera =
        |z| Camera::new(DAffine3::from_translation(DVec3::new(0.0, 0.0, z)), intrinsics).expect("a rotation");
    let (before, behind) = (camera(5.0), camera(-5.0));
    let mut rasterizer =
        GpuRasterizer::new(&gpu, scene, Culling::default(), ScenePrecision::default()).expect("room");
    let settings = RasterSettings::new(Outputs::Color);
    let mut out = GpuGBuffer::default();
    let mut checked = |cameras: &[&Camera]| {
        for camera in cameras {
            let mut recorder = gpu.recorder(None);
            rasterizer.record(&mut recorder, camera, &settings, &mut out).expect("valid");
            recorder.submit().expect("a device");
        }
        rasterizer.check_capacity().expect("a device")
    };
    assert_eq!(checked(&[&behind]), CapacityCheck::Sufficient { splats: 0, entries: 0 });
    assert_eq!(checked(&[&before, &behind]), CapacityCheck::Grown);
    let all = CapacityCheck::Sufficient { splats: 50, entries: 50 * 4096 };
    assert_eq!(checked(&[&behind, &before, &behind]), all);
    // A second check gives the same answer; the frames after it are counted separately.
    assert_eq!(checked(&[]), all);
    assert_eq!(checked(&[&behind]), CapacityCheck::Sufficient { splats: 0, entries: 0 });
}

/// A tile with pixels that wait for their last splat behind more splats than some drivers' loops have rounds: the
/// frame is correct, or refused.
#[test]
fn tiles_of_very_many_splats_are_right_or_refused() {
    let Some(gpu) = gpu() else { return };
    const COUNT: usize = 150_000;
    let camera = camera(32, 32);
    let mut g = Gaussians::zeroed(COUNT, 0);
    for i in 0..COUNT {
        // All splats except the last on one sample. The last splat is behind them, all over the picture.
        let depth = if i + 1 < COUNT { 2.0 } else { 5.0 };
        let mean = camera.unproject([5.5, 5.5].into(), depth).to_array();
        (0..3).for_each(|k| g.means[k][i] = mean[k] as f32);
        (0..3).for_each(|k| g.scales[k][i] = if i + 1 < COUNT { 1e-4 } else { 20.0 });
        // Two of 0.99 would leave exactly the least transmittance, where rounding decides.
        (g.rotations[0][i], g.opacities[i]) = (1.0, 0.98);
        g.sh[3 * i..3 * i + 3].fill(1.0);
    }
    let scene = Arc::new(Scene::new(g, OpacityMode::Default).expect("valid"));
    let settings = RasterSettings { dilation: matched_dilation(8), jitter: [0.0; 2], ..SETTINGS };
    let mut rasterizer =
        GpuRasterizer::new(&gpu, Arc::clone(&scene), Culling::AccuTile, ScenePrecision::F32).expect("room");
    let mut actual = GBuffer::default();
    match rasterizer.rasterize_to(&camera, &settings, &mut actual) {
        Err(error) => {
            let expected = GpuError::LoopsCut { what: "blending".to_owned() };
            assert_eq!(error, GpuRasterError::Gpu(expected));
        }
        Ok(()) => {
            let mut expected = GBuffer::default();
            Rasterizer::new(scene, Culling::AccuTile)
                .rasterize(&camera, &settings, &mut expected)
                .expect("valid");
            let pairs = actual.alpha.data().iter().zip(expected.alpha.data());
            assert!(pairs.clone().all(|(a, e)| (a - e).abs() < 1e-3), "{:?}", pairs.collect::<Vec<_>>());
        }
    }
}
