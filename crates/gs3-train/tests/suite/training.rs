//! Training on synthetic clips: it learns, on any number of threads the same, and validation says what was gained.

use std::path::Path;

use gs3_neural::Weights;
use gs3_neural::model::{PublishedNetwork, Tier};
use gs3_train::losses::Term;
use gs3_train::{
    ClipFolder, Network, Settings, State, TrainError, TrainStep, TrainedNetwork, Trainer, validate,
};

fn train(folder: &Path, network: Network, steps: u64) -> (Trainer, ClipFolder, Vec<TrainStep>) {
    train_as(folder, crate::common::settings(network, steps), steps)
}

fn train_as(folder: &Path, settings: Settings, steps: u64) -> (Trainer, ClipFolder, Vec<TrainStep>) {
    crate::common::write_clips(folder, settings.subject.clips());
    let clips = ClipFolder::open(folder, &settings).unwrap();
    let header = Trainer::header(&settings, "waves", "CC0-1.0").unwrap();
    let weights = Trainer::initial(&settings, header).unwrap();
    let mut trainer = Trainer::new(settings, State::new(weights)).unwrap();
    let steps = (0..steps).map(|k| trainer.step(&clips.train, k as f64 / steps as f64).unwrap()).collect();
    (trainer, clips, steps)
}

#[test]
fn loss_falls_and_held_out_clips_gain() {
    for network in Network::ALL {
        let folder = tempfile::tempdir().unwrap();
        let (trainer, clips, steps) = train(folder.path(), network, 150);
        let mean = |steps: &[TrainStep]| steps.iter().map(|step| step.loss).sum::<f64>() / steps.len() as f64;
        let (first, last) = (mean(&steps[..5]), mean(&steps[145..]));
        eprintln!("{network:?}: loss {first:.5} to {last:.5}");
        assert!(last < 0.5 * first, "{network:?}: {first} to {last}");
        let graph = trainer.graph();
        let gain = |weights| validate(trainer.settings().subject, graph, weights, &clips.held).unwrap();
        let gained = gain(&trainer.state.average);
        eprintln!("{gained:?}");
        assert!(gained.mean.unwrap()[0] > 2.0, "{network:?}: {gained:?}");
        let header = trainer.state.weights.header.clone();
        let none = gain(&Trainer::initial(trainer.settings(), header).unwrap());
        // Weights before training blend images that are the same here, and add nothing.
        assert!(none.mean.unwrap().iter().all(|gain| gain.abs() < 1e-4), "{none:?}");
        assert!((20.0..30.0).contains(&none.clips[0].analytic), "{none:?}");
    }
}

#[test]
fn a_larger_tier_begins_where_a_smaller_one_ended() {
    let folder = tempfile::tempdir().unwrap();
    let (trainer, clips, _) = train(folder.path(), Network::SuperSample, 20);
    let file = folder.path().join("weights.safetensors");
    let small = trainer.average();
    small.save(&file).unwrap();
    let settings = trainer.settings();
    let of = |tier: Tier| {
        let subject = TrainedNetwork::Own { network: Network::SuperSample, tier };
        Settings { subject, ..settings.clone() }
    };
    let large = of(Tier::High);
    let arrays = Trainer::load(&large, &file).unwrap().arrays;
    let header = Trainer::header(&large, "waves", "CC0-1.0").unwrap();
    let grown = Trainer::new(large, State::new(Weights { header, arrays })).unwrap();
    let gain = |trainer: &Trainer, weights| {
        let validation = validate(trainer.settings().subject, trainer.graph(), weights, &clips.held);
        validation.unwrap().mean.unwrap()[0]
    };
    let [before, after] = [gain(&trainer, &small), gain(&grown, &grown.state.weights)];
    assert!(before.abs() > 0.01 && (before - after).abs() < 1e-3, "{before} and {after}");
    // A smaller tier than the file's is another network.
    grown.average().save(&file).unwrap();
    let refused = Trainer::load(&of(Tier::Fast), &file).unwrap_err();
    assert!(matches!(refused, TrainError::WeightsFile { .. }), "{refused}");
}

/// Bits of all that a training has come to.
fn state_after(folder: &Path, steps: u64, threads: usize) -> State {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| train(folder, Network::SuperSample, steps).0.state)
}

#[test]
fn threads_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let one = state_after(folder.path(), 4, 1);
    assert_eq!(one.steps(), 4);
    for threads in [2, 5] {
        assert!(state_after(folder.path(), 4, threads) == one, "{threads} threads");
    }
}

/// Settings for `peer` on the small clips.
fn peer_settings(peer: PublishedNetwork, steps: u64) -> Settings {
    let subject = TrainedNetwork::Published(peer);
    let common = crate::common::settings(Network::SuperSample, steps);
    Settings { batch: 8, crop: 12, warm_up: 5, ..Settings::new(subject, common.scale, common.length) }
}

/// Frames are sampled elsewhere in each block of pixels; what a network gives is brought to the native image by whole
/// pixels. A network that is a pixel off could not gain anything over interpolation that honours the jitter.
#[test]
fn single_image_networks_learn_from_jittered_frames() {
    // Found are 15.7, -3.4 and 3.5 dB after so few steps, and -4.3, -7.6 and -5.5 dB where images stay where they are.
    for (peer, steps, least) in [
        (PublishedNetwork::Ecbsr, 400, 13.0),
        (PublishedNetwork::Rt4ksr, 400, -5.0),
        (PublishedNetwork::Ninasr, 48, 1.5),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let (trainer, clips, steps) = train_as(folder.path(), peer_settings(peer, steps), steps);
        let mean = |steps: &[TrainStep]| steps.iter().map(|step| step.loss).sum::<f64>() / steps.len() as f64;
        let (first, last) = (mean(&steps[..5]), mean(&steps[steps.len() - 5..]));
        let weights = trainer.average();
        weights.check(trainer.graph()).unwrap();
        let gained = validate(trainer.settings().subject, trainer.graph(), &weights, &clips.held).unwrap();
        eprintln!("{peer:?}: loss {first:.5} to {last:.5}, {gained:?}");
        assert!(last < 0.5 * first, "{peer:?}: {first} to {last}");
        assert!(gained.mean.unwrap()[0] > least, "{peer:?}: {gained:?}");
    }
}

#[test]
fn terms_that_a_network_has_no_part_in_are_refused() {
    for (subject, term) in [
        (TrainedNetwork::Published(PublishedNetwork::Ecbsr), Term::Temporal),
        (TrainedNetwork::Published(PublishedNetwork::Ecbsr), Term::Warp),
        (crate::common::settings(Network::SuperSample, 1).subject, Term::Alpha),
    ] {
        let mut settings = Settings { subject, ..crate::common::settings(Network::SuperSample, 1) };
        settings.loss.weights = Default::default();
        settings.loss.weights.set(term, 0.5);
        let header = Trainer::header(&settings, "waves", "CC0-1.0").unwrap();
        let weights = Trainer::initial(&settings, header).unwrap();
        let refused = Trainer::new(settings, State::new(weights)).unwrap_err();
        assert!(matches!(refused, TrainError::Setting { name, .. } if name == term.name()), "{refused}");
    }
}
