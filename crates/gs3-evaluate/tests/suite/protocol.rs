//! The protocol on a small scene: what it reports, resumes and survives.

use std::path::Path;
use std::sync::Arc;

use gs3::Culling;
use gs3::neural::model::{self, Tier, initial_weights};
use gs3::neural::{Graph, Header, Weights};
use gs3_evaluate::methods::{MethodError, MethodSettings, MethodSpec, build};
use gs3_evaluate::metrics::{Quantisation, psnr};
use gs3_evaluate::protocol::{Case, EvaluateError, Event, MethodScore, Moment, Protocol, Results, Subset};
use gs3_evaluate::report;
use gs3_scene::{CameraPath, Gaussians, OpacityMode, Scene, Size, orbit};

/// Some hundred overlapping Gaussians in a ball.
fn scene() -> Scene {
    const COUNT: usize = 400;
    let mut gaussians = Gaussians::zeroed(COUNT, 0);
    let mut state = 7u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32
    };
    for i in 0..COUNT {
        gaussians.means.iter_mut().for_each(|plane| plane[i] = 2.0 * random() - 1.0);
        gaussians.scales.iter_mut().for_each(|plane| plane[i] = 0.03 + 0.12 * random());
        gaussians.rotations.iter_mut().for_each(|plane| plane[i] = random() - 0.4);
        gaussians.opacities[i] = 0.3 + 0.7 * random();
        gaussians.sh[3 * i..3 * i + 3].iter_mut().for_each(|v| *v = 3.0 * random() - 1.5);
    }
    Scene::new(gaussians, OpacityMode::Default).unwrap()
}

fn protocol(methods: &str, case: Case) -> Protocol {
    let scene = Arc::new(scene());
    let path = orbit::around(&scene, 90, 96, 64).unwrap();
    Protocol {
        reference: Arc::clone(&scene),
        scene,
        scene_name: "ball".into(),
        path,
        path_name: "orbit".into(),
        frames: 10..16,
        case,
        size: Size::new(96, 64),
        scale: 4,
        methods: methods.split(',').map(|m| m.parse().unwrap()).collect(),
        culling: Culling::AccuTile,
        beside: Culling::AccuTile,
        background: [0.1, 0.2, 0.3],
        warm_up_frames: 1,
        weights: None,
        jod: false,
        command: "gs3 evaluate <ball> & more".into(),
    }
}

/// Runs a protocol; also gives the methods that were run, resumed and failed.
fn run(protocol: &Protocol, folder: &Path) -> (Results, [Vec<String>; 3]) {
    let mut seen: [Vec<String>; 3] = Default::default();
    let results = protocol.run(folder, &mut |event| match event {
        Event::Method { method, done: 1, .. } => seen[0].push(method.to_string()),
        Event::Resumed { method } => seen[1].push(method.to_string()),
        Event::Failed { failure } => seen[2].push(failure.method.clone()),
        Event::Method { .. } | Event::GroundTruth { .. } | Event::PhotosMissing { .. } => {}
    });
    (results.unwrap(), seen)
}

#[test]
fn methods_are_scored_by_subset_and_rank_as_they_should() {
    let folder = tempfile::tempdir().unwrap();
    let methods = "nearest,bicubic,bicubic@kerbl,bicubic@antialiased,hermite,spline,ridge,history,history+repeat,analytic";
    let (results, _) = run(&protocol(methods, Case::Path), folder.path());
    assert_eq!(results.failures, []);
    let psnr = |method: &str, subset| results.row(method, subset).unwrap().psnr;
    let rendered = |method: &str| psnr(method, Subset::SuperSampled);
    assert!(rendered("native") > 95.0, "{}", rendered("native"));
    for (better, worse) in [
        ("bicubic", "nearest"),
        ("bicubic", "bicubic@kerbl"),
        ("hermite", "bicubic"),
        ("spline", "bicubic"),
        ("ridge", "hermite"),
    ] {
        assert!(
            rendered(better) > rendered(worse),
            "{better} {} > {worse} {}",
            rendered(better),
            rendered(worse)
        );
    }
    let (warp, repeat) =
        (psnr("analytic", Subset::Interpolated), psnr("history+repeat", Subset::Interpolated));
    assert!(warp > repeat + 3.0, "{warp} against {repeat}");

    let row = |method: &str, subset| results.row(method, subset).unwrap().clone();
    assert_eq!((row("analytic", Subset::All).frames, row("analytic", Subset::SuperSampled).frames), (11, 6));
    assert!(results.row("bicubic", Subset::Interpolated).is_none());
    assert_eq!(row("bicubic", Subset::All).psnr, rendered("bicubic"));
    assert_eq!(row("native", Subset::All).speedup_over_native, Some(1.0));
    assert_eq!(row("bicubic@antialiased", Subset::All).displayed_fps, None);
    assert!(
        row("analytic", Subset::All).interpolate.is_some()
            && row("history", Subset::All).interpolate.is_none()
    );
    let (analytic, history) = (row("analytic", Subset::All), row("history+repeat", Subset::All));
    assert!(analytic.flicker < history.flicker && analytic.warping_error < history.warping_error);
    let [rendered, displayed] = results.protocol.truth[..] else {
        panic!("rendered frames, and one between")
    };
    assert_eq!((rendered.in_between, displayed.in_between), (0, 1));
    let (displayed, rendered) = (displayed.motion_px.unwrap(), rendered.motion_px.unwrap());
    assert!(displayed > 0.2 && (rendered / displayed - 2.0).abs() < 0.1, "{displayed} {rendered}");

    let json: serde_json::Value = serde_json::from_str(&serde_json::to_string(&results).unwrap()).unwrap();
    let first = &json["results"][0];
    let keys = [
        "method",
        "subset",
        "psnr",
        "ssim",
        "flip",
        "edge_psnr",
        "block_rmse_p99",
        "tpsnr",
        "warping_error",
        "displayed_fps",
        "speedup_over_native",
    ];
    assert!(keys.iter().all(|key| first.get(key).is_some()), "{first}");
    assert_eq!(first["subset"], "super_sampled");

    let page = report::html(&results);
    assert!(page.contains("gs3 evaluate &lt;ball&gt; &amp; more") && page.matches("<svg").count() == 6);
    assert!(!page.contains("http"), "the page loads nothing");
    assert!(report::markdown(&results).contains("| analytic |"));

    // Silhouettes are what is hardest to reconstruct, and the worst blocks err more than the mean.
    let (native, analytic) = (row("native", Subset::All), row("analytic", Subset::All));
    assert!(native.edge_psnr.unwrap() > 95.0 && native.block_rmse_p99 < 0.01, "{native:?}");
    assert!(analytic.edge_psnr.unwrap() < analytic.psnr, "{analytic:?}");
    assert!(analytic.block_rmse_p99 > 255.0 * 10.0_f64.powf(-analytic.psnr / 20.0), "{analytic:?}");
    assert!(results.protocol.truth.iter().all(|facts| (0.01..1.0).contains(&facts.edge_share.unwrap())));

    // A column of what was rasterized exactly, where some method does that.
    assert!(!page.contains("<th>Refined</th>") && !report::markdown(&results).contains("refined"));
    let mut refined = results;
    refined.results.iter_mut().filter(|r| r.method == "analytic").for_each(|r| r.refined_share = Some(0.125));
    assert!(
        report::html(&refined).contains("<th>Refined</th>")
            && report::html(&refined).contains("<td>12.5 %</td>")
    );
    let table = report::markdown(&refined);
    assert!(table.contains("| warping error | refined |") && table.contains("| 12.5 % |"), "{table}");
    let widths: Vec<usize> =
        table.lines().filter(|l| l.starts_with('|')).map(|l| l.matches('|').count()).collect();
    assert!(widths.iter().all(|width| *width == widths[0]), "{table}");
}

#[test]
fn a_resting_camera_converges_to_native_and_before_a_cut_the_last_frame_stays() {
    let folder = tempfile::tempdir().unwrap();
    let rest = Protocol { frames: 10..30, ..protocol("hermite,analytic", Case::Rest) };
    let (results, _) = run(&rest, folder.path());
    let last = score_of(&results, "analytic").frames.last().unwrap().psnr;
    assert!(last > 50.0, "after S² jittered frames standing still is native: {last}");
    assert!(results.protocol.truth.iter().all(|facts| facts.motion_px.unwrap() < 1e-9));

    let folder = tempfile::tempdir().unwrap();
    let methods = "bicubic+repeat,bicubic+blend,analytic,history+warp2,hermite+warp3";
    let (results, _) = run(&protocol(methods, Case::Cut), folder.path());
    // Nothing lies between the frames beside a cut: the one before (2) should stay on until the next (3), and it does.
    for method in methods.split(',') {
        let count = method.parse::<MethodSpec>().unwrap().in_between();
        let psnr = |moment: Moment| {
            score_of(&results, method).frames.iter().find(|f| f.moment == moment).unwrap().psnr
        };
        assert!(Moment::before(3, count).all(|moment| psnr(moment) == psnr(Moment::rendered(2))), "{method}");
        assert!(Moment::before(2, count).all(|moment| psnr(moment) != psnr(Moment::rendered(1))), "{method}");
    }
}

/// Two frames between are at a third and two thirds of the way, and so is what they are compared with.
#[test]
fn frames_between_are_judged_at_their_own_moments() {
    let folder = tempfile::tempdir().unwrap();
    let methods = ["analytic", "history+warp2", "hermite+warp2", "history+warp3"];
    let protocol = Protocol { warm_up_frames: 0, ..protocol(&methods.join(","), Case::Path) };
    let (results, _) = run(&protocol, folder.path());
    assert_eq!(results.failures, []);
    let settings = MethodSettings {
        scene: Arc::clone(&protocol.scene),
        scale: protocol.scale,
        culling: protocol.culling,
        background: protocol.background,
        training: Vec::new(),
        weights: None,
    };
    let mut native = build(MethodSpec::NATIVE, &settings).unwrap();
    let ways: [&[f64]; 4] = [&[0.5], &[1.0 / 3.0, 2.0 / 3.0], &[1.0 / 3.0, 2.0 / 3.0], &[0.25, 0.5, 0.75]];
    for (name, way) in methods.into_iter().zip(ways) {
        let mut method = build(name.parse().unwrap(), &settings).unwrap();
        let mut expected = Vec::new();
        for k in 0..protocol.frames.len() {
            let at = |time: f64| protocol.path.at(protocol.frames.start as f64 + time);
            let times: Vec<f64> = way.iter().filter(|_| k > 0).map(|t| k as f64 - 1.0 + t).collect();
            let between: Vec<_> = times.iter().map(|time| at(*time)).collect();
            let shown = method.render(&at(k as f64), &between).unwrap();
            assert_eq!(shown.iter().count(), times.len() + 1);
            for (time, image) in times.into_iter().chain([k as f64]).zip(shown.iter()) {
                let truth = native.render(&at(time), &[]).unwrap().current;
                expected.push((time, psnr(truth, image, Quantisation::None).unwrap()));
            }
        }
        let frames = &score_of(&results, name).frames;
        assert_eq!(frames.len(), expected.len());
        for (frame, (time, psnr)) in frames.iter().zip(&expected) {
            assert!((frame.moment.time() - time).abs() < 1e-9, "{name}: {} {time}", frame.moment.time());
            // The protocol keeps the truth at 16 bits: 108 dB. At 60 dB or less that is worth 1e-4 dB.
            assert!(*psnr < 60.0 && (frame.psnr - psnr).abs() < 1e-3, "{name} {time}: {} {psnr}", frame.psnr);
        }

        let row = |subset| results.row(name, subset).unwrap();
        let between: Vec<f64> =
            frames.iter().filter(|f| !f.moment.is_rendered()).map(|frame| frame.psnr).collect();
        let mean = between.iter().sum::<f64>() / between.len() as f64;
        assert!((row(Subset::Interpolated).psnr - mean).abs() < 1e-9, "{name}: the mean over all of them");
        let (all, rendered) = (row(Subset::All), row(Subset::SuperSampled));
        assert_eq!((rendered.frames, all.frames), (6, 5 * way.len() + 6));
        let shown = all.displayed_fps.unwrap() * all.total.unwrap().median_ms / 1e3;
        assert!((shown - (way.len() + 1) as f64).abs() < 1e-9, "{name}: {shown} frames for a rendered one");
        let score = score_of(&results, name);
        let motion = [Subset::All, Subset::SuperSampled, Subset::Interpolated]
            .map(|subset| [score.tpsnr[subset as usize].len(), score.flicker[subset as usize].len()]);
        let alone = if way.len() == 1 { [4, 3] } else { [0, 0] };
        assert_eq!(motion, [[all.frames - 1, all.frames - 2], [5, 4], alone], "{name}");
    }
    let truth = |count: usize| results.protocol.truth[count];
    for count in 0..=3 {
        let times = truth(0).motion_px.unwrap() / truth(count).motion_px.unwrap();
        assert!(
            truth(count).in_between as usize == count && (times - (count + 1) as f64).abs() < 0.1,
            "{times}"
        );
    }
    let page = report::html(&results);
    assert!(page.contains("between (frame 12.3333)") && page.contains("with 2 between"));
}

fn score_of<'a>(results: &'a Results, method: &str) -> &'a MethodScore {
    &results.scores.iter().find(|(name, _)| name == method).unwrap().1
}

#[test]
fn finished_methods_are_resumed_and_failing_ones_do_not_end_the_run() {
    let folder = tempfile::tempdir().unwrap();
    // All frames are evaluated: nothing is left to fit the ridge map on.
    let all = Protocol { frames: 0..90, ..protocol("bicubic", Case::Path) };
    let few = Protocol { path: orbit::around(&all.scene, 6, 96, 64).unwrap(), frames: 0..6, ..all };
    let (first, seen) = run(&few, folder.path());
    assert_eq!(seen, [vec!["native".to_owned(), "bicubic".into()], vec![], vec![]]);

    let weights = folder.path().join("weights");
    std::fs::create_dir(&weights).unwrap();
    std::fs::write(weights.join("span28_x4.safetensors"), "no weights").unwrap();
    let methods = protocol("ridge,bicubic,span,nearest", Case::Path).methods;
    let more = Protocol { methods, weights: Some(weights), ..few.clone() };
    let (second, seen) = run(&more, folder.path());
    let expected: [Vec<String>; 3] = [
        vec!["nearest".into()],
        vec!["native".into(), "bicubic".into()],
        vec!["ridge".into(), "span".into()],
    ];
    assert_eq!(seen, expected);
    assert!(second.failures[0].error.contains("found none"), "{:?}", second.failures);
    assert!(second.failures[1].error.contains("expected safetensors"), "{:?}", second.failures);
    assert_eq!(first.row("bicubic", Subset::All), second.row("bicubic", Subset::All));
    assert!(report::html(&second).contains("ridge</b> failed"));

    let other = Protocol { background: [0.0; 3], ..few };
    assert_eq!(run(&other, folder.path()).1[1], Vec::<String>::new(), "another protocol resumes nothing");
}

fn header(graph: &Graph) -> Header {
    Header { tier: "fast".into(), licence: "MIT".into(), ..Header::of(graph, 4) }
}

/// Scores of other weights, of another scene of as many Gaussians, of another camera in between are no scores of these.
#[test]
fn what_results_depend_on_is_measured_anew() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let graph = model::super_sample(4, Tier::Fast).unwrap();
    let [a, b] = ["a", "b"].map(|name| folder.path().join(name));
    for (seed, weights) in [(1, &a), (2, &b)] {
        std::fs::create_dir(weights).unwrap();
        let file = weights.join("super_sample_fast_x4.safetensors");
        Weights::random(&graph, header(&graph), seed).save(&file).unwrap();
    }
    let with = |weights: Option<&Path>| Protocol {
        weights: weights.map(Path::to_owned),
        ..protocol("bicubic,fast_ss", Case::Path)
    };
    let [both, learned] = [["native", "bicubic"], ["fast_ss", ""]].map(|names| {
        names.into_iter().filter(|name| !name.is_empty()).map(str::to_owned).collect::<Vec<_>>()
    });
    let all = [&both[..], &learned].concat();
    let psnr = |results: &Results| results.row("fast_ss", Subset::SuperSampled).unwrap().psnr;
    let (of_a, seen) = run(&with(Some(&a)), &out);
    assert_eq!(seen, [all.clone(), vec![], vec![]]);
    for weights in [Some(&*b), None] {
        let (other, seen) = run(&with(weights), &out);
        assert_eq!(seen, [learned.clone(), both.clone(), vec![]], "{weights:?}");
        assert_ne!(psnr(&other), psnr(&of_a), "{weights:?}");
    }
    let (again, seen) = run(&with(Some(&a)), &out);
    assert_eq!(seen, [vec![], all.clone(), vec![]]);
    assert_eq!(psnr(&again), psnr(&of_a));

    let base = with(None);
    let mut gaussians = base.scene.gaussians().clone();
    gaussians.sh[0] += 0.5;
    let scene = Arc::new(Scene::new(gaussians, OpacityMode::Default).unwrap());
    let mut cameras = base.path.cameras().to_vec();
    cameras[12] = cameras[11];
    let path = CameraPath::new(cameras, base.path.frames_per_second(), true).unwrap();
    for other in [
        Protocol { reference: Arc::clone(&scene), ..base.clone() },
        Protocol { scene, ..base.clone() },
        Protocol { path, ..base.clone() },
    ] {
        run(&base, &out);
        let (_, [ran, resumed, _]) = run(&other, &out);
        assert_eq!((ran, resumed), (all.clone(), vec![]));
    }
}

#[test]
fn learned_tiers_start_at_the_analytic_pipeline() {
    let folder = tempfile::tempdir().unwrap();
    for graph in [model::super_sample(4, Tier::Fast), model::interpolate(4, Tier::Fast)].map(Result::unwrap) {
        let file = folder.path().join(format!("{}_fast_x4.safetensors", graph.name()));
        initial_weights(&graph, header(&graph), 1).save(&file).unwrap();
    }
    let protocol = Protocol {
        weights: Some(folder.path().to_owned()),
        ..protocol("analytic,kriged,fast,fast_ss,fast_ss+fast,history+fast,fast_ss+repeat", Case::Path)
    };
    let (results, _) = run(&protocol, &folder.path().join("out"));
    assert_eq!(results.failures, []);
    let psnr = |method: &str, subset| results.row(method, subset).unwrap().psnr;
    // Interpolation starts as it is without learning; super sampling as the mean of the present and the previous frame,
    // where both may count, which is about as good as the present one alone.
    let over = |basis: &str, method: &str, subset| psnr(method, subset) - psnr(basis, subset);
    let gain = |method: &str, subset| over("kriged", method, subset);
    for subset in [Subset::SuperSampled, Subset::Interpolated] {
        let gained = over("analytic", "history+fast", subset);
        assert!(gained.abs() < 0.01, "{gained} dB");
        // Between frames, what is averaged already loses a little from being averaged again.
        let least = if subset == Subset::SuperSampled { -0.1 } else { -0.5 };
        for method in ["fast", "fast_ss+fast"] {
            assert!((least..2.0).contains(&gain(method, subset)), "{method}: {} dB", gain(method, subset));
        }
    }
    let other = gain("fast", Subset::SuperSampled).abs();
    assert!(other > 1e-3, "the previous frame counts: {other} dB");
    for method in ["fast_ss", "fast_ss+repeat"] {
        let same = psnr(method, Subset::SuperSampled) - psnr("fast", Subset::SuperSampled);
        assert!(same.abs() < 0.01, "{method}: {same} dB");
    }
    // The networks ran: weights that say anything else spoil what they are of, and that alone.
    let graph = model::interpolate(4, Tier::Fast).unwrap();
    let file = folder.path().join("interpolate_fast_x4.safetensors");
    Weights::random(&graph, header(&graph), 1).save(&file).unwrap();
    let (spoiled, _) = run(&protocol, &folder.path().join("spoiled"));
    for method in ["fast_ss+fast", "history+fast"] {
        let lost = |subset| psnr(method, subset) - spoiled.row(method, subset).unwrap().psnr;
        assert!(lost(Subset::Interpolated) > 1.0, "{method}: {} dB", lost(Subset::Interpolated));
        assert!(lost(Subset::SuperSampled).abs() < 1e-9, "{method}: {} dB", lost(Subset::SuperSampled));
    }
    let warped = psnr("fast", Subset::Interpolated) - spoiled.row("fast", Subset::Interpolated).unwrap().psnr;
    assert!(warped.abs() < 1e-9, "whole tiers warp: {warped} dB");
}

#[test]
fn whole_tiers_warp_and_learned_interpolation_wants_its_weights() {
    let folder = tempfile::tempdir().unwrap();
    // No interpolation network comes for ×2.
    let graph = model::super_sample(2, Tier::Balanced).unwrap();
    let header = Header { tier: "balanced".into(), licence: "MIT".into(), ..Header::of(&graph, 2) };
    initial_weights(&graph, header, 1)
        .save(folder.path().join("super_sample_balanced_x2.safetensors"))
        .unwrap();
    let weights = Some(folder.path().to_path_buf());
    let with = |methods| Protocol { scale: 2, weights: weights.clone(), ..protocol(methods, Case::Path) };
    let (results, _) = run(&with("balanced"), &folder.path().join("out"));
    assert_eq!(results.failures, []);
    assert!(results.row("balanced", Subset::Interpolated).is_some());
    for method in ["balanced_ss+balanced", "history+balanced"] {
        let error = with(method).run(&folder.path().join("no"), &mut |_| {}).unwrap_err();
        assert!(matches!(error, EvaluateError::Method(MethodError::Network { .. })), "{error}");
    }
}

#[test]
fn color_video_vdp_judges_where_it_is_asked_to() {
    let folder = tempfile::tempdir().unwrap();
    let with = Protocol { jod: true, ..protocol("nearest,analytic", Case::Path) };
    let (results, _) = run(&with, folder.path());
    let jod = |method: &str, subset| results.row(method, subset).unwrap().jod;
    let [native, nearest, analytic] =
        ["native", "nearest", "analytic"].map(|method| jod(method, Subset::All).unwrap());
    assert!(native > 9.9 && native > analytic && analytic > nearest, "{native} {analytic} {nearest}");
    assert_eq!(jod("analytic", Subset::Interpolated), None);
    assert!(report::html(&results).contains("<th>JOD</th>") && report::markdown(&results).contains(" JOD |"));
    let without = Protocol { jod: false, ..with };
    let (results, _) = run(&without, folder.path());
    assert_eq!(results.row("native", Subset::All).unwrap().jod, None);
    assert!(
        !report::html(&results).contains("<th>JOD</th>") && !report::markdown(&results).contains(" JOD |")
    );
}

#[test]
fn protocols_that_make_no_sense_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let base = protocol("bicubic", Case::Path);
    let error = |protocol: Protocol| protocol.run(folder.path(), &mut |_| {}).unwrap_err();
    assert!(matches!(
        error(Protocol { frames: 88..91, ..base.clone() }),
        EvaluateError::Frames { available: 90, .. }
    ));
    assert!(matches!(error(Protocol { frames: 5..7, ..base.clone() }), EvaluateError::Frames { .. }));
    assert!(matches!(
        error(Protocol { size: Size::new(98, 64), ..base.clone() }),
        EvaluateError::Size { scale: 4, .. }
    ));
    assert!(matches!(error(Protocol { scale: 1, ..base.clone() }), EvaluateError::Scale { actual: 1 }));
    assert!(matches!(error(Protocol { size: Size::new(0, 64), ..base.clone() }), EvaluateError::Camera(_)));
    let without = |methods: &str, weights: Option<&Path>| Protocol {
        weights: weights.map(Path::to_owned),
        ..protocol(methods, Case::Path)
    };
    assert!(matches!(error(without("span", None)), EvaluateError::Method(MethodError::NoWeights { .. })));
    assert!(matches!(
        error(without("bicubic,span@kerbl", Some(folder.path()))),
        EvaluateError::Method(MethodError::WeightFile { .. })
    ));
    let high = Protocol { scale: 8, ..without("high", Some(folder.path())) };
    assert!(matches!(error(high), EvaluateError::Method(MethodError::Network { .. })));
    let file = folder.path().join("file");
    std::fs::write(&file, "").unwrap();
    assert!(matches!(base.run(&file, &mut |_| {}), Err(EvaluateError::File { .. })));
    assert!(!folder.path().join("cache").exists(), "refused before anything is written");
}
