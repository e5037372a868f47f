//! Clips of a small scene.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use glam::DVec3;
use gs3::neural::model::{Tier, initial_weights};
use gs3::neural::{Header, Weights};
use gs3::scene::gaussians::sh_coefficient_count;
use gs3::scene::{Gaussians, OpacityMode, Scene, Size, orbit};
use gs3::{Dilation, Kriging};
use half::f16;

use super::analytic::plane;
use super::draw::Draw;
use super::*;
use crate::clip::{Clip, ClipFile, ClipFrame, from_unorm};

/// A ball of speckles, ten times as far from the origin as it is large.
pub(super) fn source() -> ClipSource {
    const COUNT: usize = 12_000;
    let mut draw = Draw::new(1);
    let mut g = Gaussians::zeroed(COUNT, 0);
    assert_eq!(sh_coefficient_count(0), 1);
    for i in 0..COUNT {
        let p = DVec3::new(20.0, 0.0, 0.0) + 2.0 * draw.direction();
        for k in 0..3 {
            g.means[k][i] = p[k] as f32;
            g.scales[k][i] = 0.03;
            g.sh[3 * i + k] = draw.uniform(-1.7, 1.7) as f32;
        }
        g.rotations[0][i] = 1.0;
        g.opacities[i] = 0.95;
    }
    let scene = Arc::new(Scene::new(g, OpacityMode::Default).unwrap());
    let paths = vec![orbit::around(&scene, 40, 1920, 1080).unwrap()];
    ClipSource { name: "ball".to_owned(), scene, paths }
}

pub(super) fn settings(network: Network) -> ClipSettings {
    ClipSettings {
        network,
        scale: 4,
        frames: 3,
        size: Size::new(96, 64),
        dilation: Dilation::Matched,
        held_out: 0.2,
        seed: 7,
        super_sample: None,
        kriging: Kriging::On,
    }
}

fn values(frame: &ClipFrame, name: &str) -> Vec<f32> {
    plane(frame, name).iter().map(|v| v.to_f32()).collect()
}

fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<_> = entries
        .map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), fs::read(&path).unwrap()))
        .collect();
    files.sort();
    files
}

/// The files are the same with any number of threads and after any number of interruptions; existing files stay.
#[test]
fn batches_are_taken_up_again_and_deterministic() {
    let source = source();
    let settings = settings(Network::SuperSample);
    let make = |folder: &Path, threads: usize, most: usize| {
        let batch = Batch { source: &source, settings: &settings, training: 4, held_out: 2, folder };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut made = Vec::new();
        pool.install(|| {
            batch.make(|clip| {
                made.push(clip);
                made.len() < most
            })
        })
        .unwrap();
        (made, batch.missing())
    };
    let [once, twice] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let (made, missing) = make(once.path(), 1, usize::MAX);
    assert_eq!((made.len(), missing), (6, 0));
    for clip in &made {
        let read = ClipFile::open(&clip.file).unwrap();
        assert_eq!((read.frames(), read.lr(), read.scale(), read.scene()), (3, [16, 24], 4, "ball"));
        assert!(clip.analytic_psnr > 15.0, "{clip:?}");
    }
    let (made, missing) = make(twice.path(), 2, 1);
    // Those begun are finished.
    assert!((1..6).contains(&made.len()) && missing == 6 - made.len(), "{} {missing}", made.len());
    let kept = fs::read(once.path().join("ball_0002.clip")).unwrap();
    fs::write(twice.path().join("ball_0003.clip"), &kept).unwrap();
    let (_, missing) = make(twice.path(), 3, usize::MAX);
    assert_eq!(missing, 0);
    for ((name, a), (other, b)) in files(once.path()).iter().zip(&files(twice.path())) {
        assert_eq!(name, other);
        assert_eq!(a == b, name != "ball_0003.clip", "{name}");
        assert!(a == b || *b == kept, "{name}");
    }
    assert_eq!(files(twice.path()).len(), 6);
    let [a, b] = [7, 8].map(|seed| source.clip(&ClipSettings { seed, ..settings.clone() }, 0).unwrap());
    assert_ne!(a, b);
}

/// A folder with clips of other settings, or with broken ones, stays as it is.
#[test]
fn batches_do_not_mix_settings() {
    let (source, folder) = (source(), tempfile::tempdir().unwrap());
    let settings = settings(Network::SuperSample);
    let make = |settings: &ClipSettings, training: usize| {
        let batch = Batch { source: &source, settings, training, held_out: 0, folder: folder.path() };
        batch.make(|_| true)
    };
    make(&settings, 1).unwrap();
    let before = files(folder.path());
    let refused = |settings: &ClipSettings| match make(settings, 2) {
        Err(MakeError::Mixed { file, field, expected, actual }) => {
            assert!(file.ends_with("ball_0000.clip"), "{}", file.display());
            (field, expected, actual)
        }
        other => panic!("{other:?}"),
    };
    let found = |field, expected: &str, actual: &str| (field, expected.to_owned(), actual.to_owned());
    assert_eq!(refused(&ClipSettings { frames: 4, ..settings.clone() }), found("frames", "4", "3"));
    assert_eq!(refused(&ClipSettings { scale: 2, ..settings.clone() }), found("scale", "2", "4"));
    assert_eq!(
        refused(&ClipSettings { size: Size::new(96, 32), ..settings.clone() }),
        found("size", "96x32", "96x64")
    );
    assert_eq!(files(folder.path()), before);
    fs::write(folder.path().join("ball_0000.clip"), b"no clip").unwrap();
    let before = files(folder.path());
    assert!(matches!(make(&settings, 2), Err(MakeError::Clip(_))));
    assert_eq!(files(folder.path()), before);
}

/// The previous frame's colours, found along `motion`, equal this frame's colours.
#[test]
fn motion_carries_colours_along() {
    let source = source();
    let settings = ClipSettings { frames: 4, ..settings(Network::SuperSample) };
    let (mut moved, mut unmoved, mut count) = (0.0, 0.0, 0);
    for number in 0..12 {
        let clip = source.clip(&settings, number).unwrap();
        let [height, width] = clip.lr;
        for frames in clip.frames.windows(2) {
            let [before, now] = [0, 1].map(|k| values(&frames[k], "color"));
            let (motion, validity) = (values(&frames[1], "motion"), values(&frames[1], "validity"));
            for (p, flow) in motion.as_chunks::<2>().0.iter().enumerate() {
                // Where it has moved by a pixel at least; both frames sample it somewhere else by less.
                if validity[p] < 0.99 || flow[0].hypot(flow[1]) < 1.0 {
                    continue;
                }
                let [x, y] = [(p % width) as f32 + flow[0], (p / width) as f32 + flow[1]];
                for c in 0..3 {
                    let color = now[3 * p + c];
                    moved += (bilinear(&before, [width, height], c, [x, y]) - color).abs();
                    unmoved += (before[3 * p + c] - color).abs();
                }
                count += 1;
            }
        }
    }
    assert!(count > 300, "{count}");
    assert!(moved < 0.6 * unmoved, "{moved} {unmoved}");
}

fn bilinear(image: &[f32], [width, height]: [usize; 2], c: usize, [x, y]: [f32; 2]) -> f32 {
    let (x, y) = (x.clamp(0.0, (width - 1) as f32), y.clamp(0.0, (height - 1) as f32));
    let at = |i: f32, j: f32| {
        let (i, j) = ((i as usize).min(width - 1), (j as usize).min(height - 1));
        image[3 * (j * width + i) + c]
    };
    let (i, j) = (x.floor(), y.floor());
    let row = |j: f32| at(i, j) + (at(i + 1.0, j) - at(i, j)) * (x - i);
    row(j) + (row(j + 1.0) - row(j)) * (y - j)
}

/// What enters the window has been seen in its margin: frames without networks are no worse along its border.
#[test]
fn borders_have_a_past() {
    let source = source();
    let settings = ClipSettings { frames: 6, ..settings(Network::SuperSample) };
    let (mut border, mut inside) = ([0.0, 0.0], [0.0, 0.0]);
    for number in 0..16 {
        let clip = source.clip(&settings, number).unwrap();
        let [height, width] = clip.lr.map(|side| 4 * side);
        let last = values(clip.frames.last().unwrap(), "history");
        for (p, pixel) in last.as_chunks::<4>().0.iter().enumerate() {
            let (x, y) = (p % width, p / width);
            let is_border = x.min(width - 1 - x).min(y.min(height - 1 - y)) < 6;
            let sum = if is_border { &mut border } else { &mut inside };
            (sum[0], sum[1]) = (sum[0] + f64::from(pixel[3]), sum[1] + 1.0);
        }
    }
    let [border, inside] = [border, inside].map(|[sum, count]| sum / count);
    assert!(border < 1.05 * inside, "{border} {inside}");
}

/// In-between frames are at their own poses: a blend of the neighbours is near the native frame there, nearer than
/// the previous frame alone. Their time is recorded.
#[test]
fn frames_between_are_between() {
    let source = source();
    let settings = settings(Network::Interpolate);
    let (mut blended, mut alone) = (0.0, 0.0);
    let mut times = Vec::new();
    for number in 0..12 {
        let clip = source.clip(&settings, number).unwrap();
        clip.check().unwrap();
        for frame in &clip.frames {
            times.push(plane(frame, "geometry")[1].to_f32());
            let error = |image: &[[f32; 4]]| -> f64 {
                let native = frame.target.as_chunks::<3>().0;
                let errors = image
                    .iter()
                    .zip(native)
                    .flat_map(|(a, b)| (0..3).map(|c| f64::from((a[c] - from_unorm(b[c])).powi(2))));
                errors.sum()
            };
            blended += error(&analytic(clip.network, frame));
            alone += error(values(frame, "before").as_chunks().0);
        }
    }
    assert!(blended < 0.8 * alone, "{blended} {alone}");
    let halves = times.iter().filter(|t| **t == 0.5).count();
    assert!(2 * halves > times.len() && halves < times.len(), "{times:?}");
}

/// Frames that a network refines: the same with one that changes nothing yet, others with one that does.
#[test]
fn frames_around_may_be_refined() {
    let source = source();
    let settings = settings(Network::Interpolate);
    let graph = Network::SuperSample.graph(4, Tier::Fast).unwrap();
    let header = Header { tier: Tier::Fast.name().to_owned(), ..Header::of(&graph, 4) };
    let mut initial = initial_weights(&graph, header.clone(), 1);
    // Nothing of the frame before, nor of the drift.
    for bias in ["head.alpha.bias", "head.beta.bias"] {
        initial.arrays.get_mut(bias).unwrap().values_mut().fill(-30.0);
    }
    let changing = Weights::random(&graph, header, 1);
    let changing_again = changing.clone();
    let clip = |weights: Option<Weights>| {
        let super_sample = weights.map(Arc::new);
        source.clip(&ClipSettings { super_sample, ..settings.clone() }, 0).unwrap()
    };
    let plain = clip(None);
    let [same, other] = [initial.clone(), changing].map(|weights| analytic_psnr(&clip(Some(weights))));
    assert!((same - analytic_psnr(&plain)).abs() < 1e-3, "{same}");
    assert!(other < same - 1.0, "{other} {same}");
    let [initial, changing] = [initial, changing_again].map(|weights| Some(Arc::new(weights)));
    let refined = ClipSettings { super_sample: initial, ..settings };
    // The previous frame of super sampling is refined; what the network gives does not show in the clip else.
    let of_super_sampling = |super_sample: &Option<Arc<Weights>>| {
        let settings = ClipSettings {
            network: Network::SuperSample,
            super_sample: super_sample.clone(),
            ..refined.clone()
        };
        source.clip(&settings, 0).unwrap()
    };
    let [plain, same, other] = [&None, &refined.super_sample, &changing].map(of_super_sampling);
    assert!(plain == same && plain != other);
    for (plain, other) in plain.frames.iter().zip(&other.frames) {
        let pairs = plain.inputs.iter().zip(&other.inputs);
        let differ: Vec<_> = pairs.filter(|(a, b)| a != b).map(|(a, _)| a.name.as_str()).collect();
        assert!(differ.iter().all(|name| name.starts_with("previous")), "{differ:?}");
    }
    let other_scale = source.clip(&ClipSettings { scale: 2, ..refined }, 0).unwrap_err();
    assert!(other_scale.to_string().contains("scale"), "{other_scale}");
}

/// A clip that begins with a reset has no past in its first frame; others have one.
#[test]
fn resets_show() {
    let source = source();
    let settings = settings(Network::SuperSample);
    let seen = |frame: &ClipFrame| plane(frame, "validity").iter().any(|v| *v > f16::ZERO);
    let clips: Vec<Clip> = (0..24).map(|k| source.clip(&settings, k).unwrap()).collect();
    let resets = clips.iter().filter(|clip| !seen(&clip.frames[0])).count();
    assert!((1..10).contains(&resets), "{resets}");
    assert!(clips.iter().all(|clip| seen(&clip.frames[1])));
}

#[test]
fn nonsense_is_refused() {
    let source = source();
    let base = settings(Network::SuperSample);
    let error = |settings: ClipSettings| source.clip(&settings, 0).unwrap_err().to_string();
    let size = "size of clips: expected multiples of 4 up to 4096x2160, found";
    assert_eq!(error(ClipSettings { size: Size::new(96, 62), ..base.clone() }), format!("{size} 96x62"));
    assert_eq!(error(ClipSettings { size: Size::new(0, 64), ..base.clone() }), format!("{size} 0x64"));
    assert_eq!(error(ClipSettings { size: Size::new(64, 4096), ..base.clone() }), format!("{size} 64x4096"));
    assert!(error(ClipSettings { frames: 0, ..base.clone() }).contains("expected at least 1, found 0"));
    assert!(error(ClipSettings { held_out: 0.7, ..base.clone() }).contains("found 0.7"));
    assert!(error(ClipSettings { held_out: f64::NAN, ..base.clone() }).contains("found NaN"));
    assert!(error(ClipSettings { scale: 99, ..base.clone() }).contains("99"));
    let lost = ClipSource { paths: vec![], ..source.clone() };
    assert!(lost.clip(&base, 0).unwrap_err().to_string().contains("camera path"));
    let away = source.paths[0].cameras()[0];
    let pose = glam::DAffine3::from_rotation_y(std::f64::consts::PI) * away.view_from_world();
    let away = gs3::scene::Camera::new(pose, away.intrinsics()).unwrap();
    let blind = ClipSource { paths: vec![CameraPath::new(vec![away], 30.0, false).unwrap()], ..source };
    assert!(blind.clip(&base, 0).unwrap_err().to_string().contains("ball: expected a window that shows"));
}

#[test]
fn previews_show_every_frame() {
    let clip = source().clip(&settings(Network::SuperSample), 0).unwrap();
    let image = preview(&clip);
    assert_eq!((image.width(), image.height()), (5 * 96, 3 * 64));
    let native = clip.frames[2].target.as_chunks::<3>().0[96 * 5 + 7].map(from_unorm);
    assert_eq!(image.row(2 * 64 + 5)[4 * 96 + 7][..3], native);
}
