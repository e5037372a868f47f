//! Training on synthetic clips: it learns, on any number of threads the same, and validation says what was gained.

#![allow(clippy::unwrap_used, reason = "clips are whole")]

mod common;

use std::path::Path;

use gs3_train::{ClipFolder, Network, State, Step, Trainer, validate};

fn train(folder: &Path, network: Network, steps: u64) -> (Trainer, ClipFolder, Vec<Step>) {
    common::write_clips(folder, network);
    let settings = common::settings(network, steps);
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
        let mean = |steps: &[Step]| steps.iter().map(|step| step.loss).sum::<f64>() / steps.len() as f64;
        let (first, last) = (mean(&steps[..5]), mean(&steps[145..]));
        eprintln!("{network:?}: loss {first:.5} to {last:.5}");
        assert!(last < 0.5 * first, "{network:?}: {first} to {last}");
        let graph = trainer.graph();
        let gain = |weights| validate(graph, weights, &clips.held).unwrap();
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
