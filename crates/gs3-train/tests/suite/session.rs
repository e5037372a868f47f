//! Trainings that are interrupted and taken up again, what they write, and what they refuse.

use std::cell::Cell;
use std::fs;
use std::path::Path;

use gs3_neural::Weights;
use gs3_neural::model::Tier;
use gs3_train::losses::Loss;
use gs3_train::{
    ClipFolder, Ending, Length, Log, Network, Places, Row, Settings, State, TrainError, TrainEvent,
    TrainedNetwork, Trainer, draw_log, train, validate,
};

const NETWORK: Network = Network::SuperSample;

fn own(network: Network, tier: Tier) -> TrainedNetwork {
    TrainedNetwork::Own { network, tier }
}

fn places(folder: &Path) -> Places {
    Places {
        clips: folder.join("clips"),
        checkpoint: folder.join("checkpoint"),
        out: folder.join("out").join("weights.safetensors"),
        log_every: 2,
        validate_every: 5,
        save_every: 1e9,
    }
}

fn start(settings: &Settings) -> Weights {
    Trainer::initial(settings, Trainer::header(settings, "waves", "CC0-1.0").unwrap()).unwrap()
}

/// Trains in `folder`, until the end or until `stop` steps are made.
fn run(folder: &Path, settings: &Settings, stop: u64) -> Result<(State, Ending, Vec<String>), TrainError> {
    let mut events = Vec::new();
    let last = Cell::new(0_u64);
    let mut report = |event: TrainEvent<'_>| match event {
        TrainEvent::Resumed { step, .. } => events.push(format!("resumed {step}")),
        TrainEvent::Step { step, .. } => last.set(step.step),
        TrainEvent::Validated { step, validation, .. } => {
            events.push(format!("validated {step} {:?}", validation.mean));
        }
        TrainEvent::Remeasured { step, gain, .. } => events.push(format!("remeasured {step} {gain:?}")),
    };
    let go_on = || last.get() < stop;
    let (state, ending) = train(settings.clone(), &places(folder), start(settings), &mut report, &go_on)?;
    Ok((state, ending, events))
}

/// All but the time, which is another each time.
fn timeless(state: State) -> State {
    State { seconds: 0.0, ..state }
}

#[test]
fn a_training_taken_up_again_goes_on_bit_for_bit() {
    let [straight, parts] = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let settings = crate::common::settings(NETWORK, 20);
    for folder in [&straight, &parts] {
        fs::create_dir(folder.path().join("clips")).unwrap();
        crate::common::write_clips(&folder.path().join("clips"), NETWORK);
    }
    let (expected, ending, events) = run(straight.path(), &settings, u64::MAX).unwrap();
    assert_eq!((ending, events.len()), (Ending::Finished, 5));

    let (_, ending, first) = run(parts.path(), &settings, 10).unwrap();
    assert_eq!(ending, Ending::Interrupted);
    // What a training that was killed leaves does no harm.
    fs::create_dir(places(parts.path()).checkpoint.join("step-99.unfinished")).unwrap();
    let (state, ending, then) = run(parts.path(), &settings, u64::MAX).unwrap();
    assert_eq!(ending, Ending::Finished);
    assert_eq!(then[0], "resumed 10");
    assert_eq!([&first[..], &then[1..]].concat(), events);
    assert!(timeless(state.clone()) == timeless(expected), "another state");
    // After the end nothing changes.
    let (again, ending, _) = run(parts.path(), &settings, u64::MAX).unwrap();
    assert!(again == state && ending == Ending::Finished);
}

#[test]
fn the_log_holds_every_step_once_and_the_best_weights_are_written() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("clips")).unwrap();
    crate::common::write_clips(&folder.path().join("clips"), NETWORK);
    let settings = crate::common::settings(NETWORK, 12);
    // What it began with is the best until something is better.
    let (state, ..) = run(folder.path(), &settings, 0).unwrap();
    assert_eq!(state.best.unwrap().step, 0);
    assert!(Weights::load(&places(folder.path()).out).unwrap() == start(&settings));
    run(folder.path(), &settings, 7).unwrap();
    let (state, ..) = run(folder.path(), &settings, u64::MAX).unwrap();
    let places = places(folder.path());
    let log = fs::read_to_string(places.checkpoint.join("log.csv")).unwrap();
    let steps: Vec<&str> = log.lines().map(|line| line.split(',').next().unwrap()).collect();
    assert_eq!(steps, ["step", "2", "4", "5", "6", "8", "10", "12"]);
    let columns = log.lines().next().unwrap().split(',').count();
    assert!(log.lines().all(|line| line.split(',').count() == columns), "{log}");
    let gains = log.lines().filter(|line| !line.ends_with(',')).count();
    assert_eq!(gains, 1 + 3, "the header, and steps 5, 10 and 12: {log}");
    assert!(Weights::load(&places.out).unwrap() == state.best.unwrap().weights);
    let checkpoints: Vec<_> =
        fs::read_dir(&places.checkpoint).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert!(checkpoints.iter().any(|name| name == "step-12") && checkpoints.len() <= 3, "{checkpoints:?}");
}

/// A log that is taken up again is replaced, not written over: whoever is killed while it is written leaves the old
/// one.
#[test]
fn logs_and_their_plots_are_whole_or_as_they_were() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let row = |step| Row {
        step,
        seconds: 1.0,
        rate: 1e-3,
        loss: 0.5,
        terms: Default::default(),
        gradient: 1.0,
        gains: None,
    };
    let mut log = Log::open(&at("log.csv"), 0).unwrap();
    (1..=3).for_each(|step| log.add(row(step)).unwrap());
    // Another name of the same file.
    fs::hard_link(at("log.csv"), at("old.csv")).unwrap();
    let log = Log::open(&at("log.csv"), 2).unwrap();
    let lines = |name: &str| fs::read_to_string(at(name)).unwrap().lines().count();
    assert_eq!((log.rows().len(), lines("log.csv"), lines("old.csv")), (2, 3, 4));
    // What cannot be written leaves nothing behind.
    fs::create_dir(at("log.png")).unwrap();
    draw_log(&at("log.png"), log.rows()).unwrap_err();
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 3);
}

#[test]
fn of_what_is_kept_the_beginning_has_its_share() {
    let folders = [0.0, 0.75].map(|kept| {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("clips")).unwrap();
        crate::common::write_clips(&folder.path().join("clips"), NETWORK);
        let settings = Settings { kept, ..crate::common::settings(NETWORK, 1) };
        run(folder.path(), &settings, u64::MAX).unwrap();
        (Weights::load(&places(folder.path()).out).unwrap(), start(&settings))
    });
    let [(trained, start), (mixed, _)] = folders;
    let mut moved = 0.0_f32;
    for (name, mixed) in &mixed.arrays {
        let [trained, start] = [&trained, &start].map(|weights| weights.arrays[name].values());
        for ((mixed, trained), start) in mixed.values().iter().zip(trained).zip(start) {
            let expected = 0.25 * trained + 0.75 * start;
            assert!((mixed - expected).abs() < 1e-6, "{name}: {mixed}, not {expected}");
            moved = moved.max((trained - start).abs());
        }
    }
    assert!(moved > 1e-4, "training moved weights by {moved} at most");
}

#[test]
fn what_does_not_fit_is_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let settings = crate::common::settings(NETWORK, 3);
    let refused = |settings: &Settings| run(at, settings, u64::MAX).unwrap_err().to_string();
    let contains = |text: String, part: &str| assert!(text.contains(part), "{text} does not say {part}");
    contains(refused(&settings), "clips");
    fs::create_dir(at.join("clips")).unwrap();
    contains(refused(&settings), "expected clips (*.clip) to train on, found none");
    crate::common::clip(NETWORK, 4, [14, 20], 9).save(&at.join("clips/held-only.clip")).unwrap();
    contains(refused(&settings), "found none");
    crate::common::write_clips(&at.join("clips"), NETWORK);
    contains(
        refused(&Settings { scale: 4, ..settings.clone() }),
        "expected a clip for super_sample at scale 4",
    );
    contains(
        refused(&Settings { subject: own(Network::Interpolate, Tier::Fast), ..settings.clone() }),
        "for interpolate at scale 2",
    );
    contains(
        refused(&Settings { crop: 17, ..settings.clone() }),
        "at least 3 frames of 17×17 LR pixels, found 5 frames of 16×18",
    );
    contains(refused(&Settings { window: 6, ..settings.clone() }), "at least 6 frames");
    contains(refused(&Settings { crop: 4, ..settings.clone() }), "crop: expected 5 to 4096, found 4");
    contains(
        refused(&Settings { rate: f64::NAN, ..settings.clone() }),
        "rate: expected a finite number above 0, found NaN",
    );
    contains(
        refused(&Settings { kept: 1.0, ..settings.clone() }),
        "kept: expected 0 to less than 1, found 1",
    );
    contains(refused(&Settings { batch: 0, ..settings.clone() }), "batch: expected 1 to 4096, found 0");
    for (length, part) in [
        (Length::Seconds(1e18), "length: expected at most 1000000000 seconds, found 1000000000000000000"),
        (Length::Seconds(f64::INFINITY), "length: expected a finite number above 0, found inf"),
        (Length::Steps(0), "length: expected a finite number above 0, found 0"),
    ] {
        contains(refused(&Settings { length, ..settings.clone() }), part);
    }
    contains(
        refused(&Settings { warm_up: u64::MAX, ..settings.clone() }),
        "warm-up: expected at most 1000000000 steps, found 18446744073709551615",
    );
    for (epsilon, actual) in [(1e-30, "1e-30"), (0.0, "0e0"), (11.0, "1.1e1"), (f32::NAN, "NaN")] {
        let loss = Loss { epsilon, ..settings.loss };
        let expected = format!("epsilon: expected 1e-18 to 10, found {actual}");
        contains(refused(&Settings { loss, ..settings.clone() }), &expected);
    }
    for save_every in [f64::NAN, f64::INFINITY, -1.0] {
        let places = Places { save_every, ..places(at) };
        let refused = train(settings.clone(), &places, start(&settings), &mut |_| {}, &|| true).unwrap_err();
        let expected = "time between checkpoints: expected 0 to 1000000000 seconds, found";
        contains(refused.to_string(), &format!("{expected} {save_every}"));
    }
    fs::write(at.join("clips/damaged.clip"), [7; 40]).unwrap();
    contains(refused(&settings), "damaged.clip: expected a clip in safetensors");
    assert!(!places(at).checkpoint.exists() && !places(at).out.exists());
}

#[test]
fn damaged_checkpoints_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("clips")).unwrap();
    crate::common::write_clips(&folder.path().join("clips"), NETWORK);
    let settings = crate::common::settings(NETWORK, 2);
    run(folder.path(), &settings, 1).unwrap();
    let checkpoint = places(folder.path()).checkpoint.join("step-1");
    for (file, part) in [
        ("weights.safetensors", "weights.safetensors: expected safetensors"),
        ("adam.safetensors", "adam.safetensors: expected safetensors"),
        ("state.json", "state.json, content: expected the state of a training"),
    ] {
        let whole = fs::read(checkpoint.join(file)).unwrap();
        fs::write(checkpoint.join(file), "damaged").unwrap();
        let refused = run(folder.path(), &settings, 2).unwrap_err().to_string();
        assert!(refused.contains(part), "{refused}");
        fs::write(checkpoint.join(file), whole).unwrap();
    }
    // Of a time that no clock counts to.
    let whole = fs::read_to_string(checkpoint.join("state.json")).unwrap();
    let (before, after) = whole.split_once("\"seconds\": ").unwrap();
    let rest = &after[after.find(',').unwrap()..];
    fs::write(checkpoint.join("state.json"), format!("{before}\"seconds\": 1e300{rest}")).unwrap();
    let refused = run(folder.path(), &settings, 2).unwrap_err().to_string();
    assert!(refused.contains("state.json, seconds: expected 0 to 1000000000, found 1"), "{refused}");
    fs::write(checkpoint.join("state.json"), whole).unwrap();
    // A checkpoint of another size of the network, before anything is said of going on.
    let other = Settings { subject: own(NETWORK, Tier::Balanced), ..settings.clone() };
    let refused = run(folder.path(), &other, 2).unwrap_err().to_string();
    assert!(refused.ends_with("checkpoint, tier: expected balanced, found fast"), "{refused}");
    run(folder.path(), &settings, 2).unwrap();
}

/// A state is saved twice at one step where a training ends, or is begun again after its end. Whatever happens then,
/// one of the two is left.
#[test]
fn saving_a_step_again_never_loses_it() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("clips")).unwrap();
    crate::common::write_clips(&folder.path().join("clips"), NETWORK);
    let settings = crate::common::settings(NETWORK, 2);
    let (state, ..) = run(folder.path(), &settings, u64::MAX).unwrap();
    let at = |name: &str| places(folder.path()).checkpoint.join(name);
    // What cannot be written.
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("nowhere/deep", at("step-2.unfinished")).unwrap();
        run(folder.path(), &settings, u64::MAX).unwrap_err();
        fs::remove_file(at("step-2.unfinished")).unwrap();
        let (again, _, events) = run(folder.path(), &settings, u64::MAX).unwrap();
        assert!(again == state && events == ["resumed 2"], "{events:?}");
    }
    // What was killed between taking the old one away and putting the new one there.
    fs::rename(at("step-2"), at("step-2.replaced")).unwrap();
    fs::create_dir(at("step-2.unfinished")).unwrap();
    let (again, _, events) = run(folder.path(), &settings, u64::MAX).unwrap();
    assert!(again == state && events == ["resumed 2"], "{events:?}");
    let left = ["step-2", "step-2.replaced", "step-2.unfinished"].map(|name| at(name).exists());
    assert_eq!(left, [true, false, false]);
    // What was killed before it took the old one away: the new one counts.
    fs::create_dir(at("step-2.replaced")).unwrap();
    let (again, ..) = run(folder.path(), &settings, u64::MAX).unwrap();
    assert!(again == state && !at("step-2.replaced").exists());
}

/// Gains are of the clips they were measured on. On others the old record would stand for ever, or fall to anything.
#[test]
fn a_record_of_other_clips_is_measured_again() {
    let folder = tempfile::tempdir().unwrap();
    let clips = folder.path().join("clips");
    fs::create_dir(&clips).unwrap();
    crate::common::write_clips(&clips, NETWORK);
    let settings = crate::common::settings(NETWORK, 12);
    let (state, ..) = run(folder.path(), &settings, 5).unwrap();
    let best = state.best.unwrap();
    // The same name, size and header.
    crate::common::clip(NETWORK, 4, [14, 20], 10).save(&clips.join("held-waves.clip")).unwrap();
    let (state, _, events) = run(folder.path(), &settings, 0).unwrap();
    let record = state.best.unwrap();
    let opened = ClipFolder::open(&clips, &settings).unwrap();
    let graph = settings.subject.graph(settings.scale).unwrap();
    let [gain, _] = validate(settings.subject, &graph, &best.weights, &opened.held).unwrap().mean.unwrap();
    assert_eq!(events, ["resumed 5".to_owned(), format!("remeasured 5 {:?}", Some(gain))]);
    assert_ne!(gain, best.gain);
    assert_eq!((record.gain, record.step, record.held), (gain, 5, opened.digest().unwrap()));
    assert!(record.weights == best.weights);
    // Clips that are the same are not measured again.
    let (_, _, events) = run(folder.path(), &settings, 0).unwrap();
    assert_eq!(events, ["resumed 5"]);
    // Neither is a record kept that nothing can be compared with.
    fs::remove_file(clips.join("held-waves.clip")).unwrap();
    let (state, _, events) = run(folder.path(), &settings, 0).unwrap();
    assert_eq!(events, ["resumed 5", "remeasured 5 None"]);
    assert!(state.best.is_none());
    assert!(Weights::load(&places(folder.path()).out).unwrap() == state.average);
}
