//! Steps of a training.

use std::path::Path;
use std::sync::Mutex;

use gs3_neural::model::{Tier, grown, initial_weights};
use gs3_neural::{Graph, Header, Weights};
use rayon::prelude::*;

use crate::batch::Choice;
use crate::checkpoint;
use crate::clip::ClipFile;
use crate::error::TrainError;
use crate::form::Form;
use crate::losses::Terms;
use crate::optimise;
use crate::settings::Settings;
use crate::state::State;
use crate::trained_network::TrainedNetwork;
use crate::unroll::{ItemResult, Memory, Unroll, operations_per_pixel};

/// Makes steps. Results depend on settings, weights and clips alone, not on the number of threads.
#[derive(Debug)]
pub struct Trainer {
    settings: Settings,
    graph: Graph,
    form: Form,
    unroll: Unroll,
    /// What has been learned.
    pub state: State,
    /// Memory of items, as many as have been worked on at once.
    memories: Mutex<Vec<Memory>>,
}

/// What a step did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainStep {
    /// Its number, from 1.
    pub step: u64,
    /// Mean values of the terms, without their weights.
    pub terms: Terms,
    /// The loss: the terms, weighted.
    pub loss: f64,
    /// Length of the derivative by all weights, before it was shortened.
    pub gradient: f64,
    /// Learning rate.
    pub rate: f32,
}

impl Trainer {
    /// A training that goes on from `state`.
    ///
    /// # Errors
    /// [`TrainError`] if settings are out of range or weights are another network's.
    pub fn new(settings: Settings, state: State) -> Result<Self, TrainError> {
        let graph = settings.subject.graph(settings.scale)?;
        let form = Form::new(settings.subject, &graph);
        let unroll = Unroll::new(&graph, &settings)?;
        form.check(&graph, &state.weights)?;
        form.check(&graph, &state.average)?;
        Ok(Self { settings, graph, form, unroll, state, memories: Mutex::default() })
    }

    /// The header of weights trained with `settings`.
    ///
    /// # Errors
    /// [`TrainError::Graph`] if there is no network of that scale.
    pub fn header(settings: &Settings, training_data: &str, licence: &str) -> Result<Header, TrainError> {
        let graph = settings.subject.graph(settings.scale)?;
        Ok(Header {
            tier: settings.subject.size().to_owned(),
            training_data: training_data.to_owned(),
            licence: licence.to_owned(),
            ..Header::of(&graph, settings.scale)
        })
    }

    /// The weights that training from nothing begins with. Our networks start as the analytic pipeline.
    ///
    /// # Errors
    /// [`TrainError::Graph`] if there is no network of that scale.
    pub fn initial(settings: &Settings, header: Header) -> Result<Weights, TrainError> {
        let graph = settings.subject.graph(settings.scale)?;
        let start = initial_weights(&graph, header, settings.seed);
        Ok(Form::new(settings.subject, &graph).initial(&graph, start, settings.seed))
    }

    /// Weights of a file that training can begin with: the network's, or a smaller tier's, grown ([`grown`]). For
    /// networks with a different form in training, only checkpoints hold such weights.
    ///
    /// # Errors
    /// [`TrainError`] if they cannot be read, do not fit the network, or cannot be grown to fit.
    pub fn load(settings: &Settings, path: &Path) -> Result<Weights, TrainError> {
        let graph = settings.subject.graph(settings.scale)?;
        let form = Form::new(settings.subject, &graph);
        let weights = Weights::load(path).map_err(checkpoint::within(path))?;
        let small = match settings.subject {
            TrainedNetwork::Own { network, tier } => {
                let mut smaller = Tier::ALL.into_iter().take_while(|small| *small != tier);
                let small = smaller.find(|small| small.name() == weights.header.tier);
                small.map(|small| network.graph(settings.scale, small)).transpose()?
            }
            TrainedNetwork::Published(_) => None,
        };
        if let Some(small) = small {
            weights.check(&small).map_err(checkpoint::within(path))?;
            let header = weights.header.clone();
            return Ok(grown(&small, &weights, &graph, header, settings.seed)?);
        }
        form.check(&graph, &weights).map_err(checkpoint::within(path))?;
        Ok(weights)
    }

    /// The settings.
    #[must_use]
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The network.
    #[must_use]
    pub fn graph(&self) -> &Graph {
        &self.graph
    }

    /// The average of the weights, as they are run.
    #[must_use]
    pub fn average(&self) -> Weights {
        self.form.fold(&self.state.average)
    }

    /// What is validated and written: that average with its share of `start`, the weights of the beginning
    /// ([`Settings::kept`]).
    #[must_use]
    pub fn result(&self, start: &Weights) -> Weights {
        let mut average = self.average();
        if self.settings.kept > 0.0 {
            optimise::mix(&mut average.arrays, &self.form.fold(start).arrays, self.settings.kept as f32);
        }
        average
    }

    /// Floating-point operations of a step's convolutions.
    ///
    /// # Errors
    /// [`TrainError::Graph`] if the graph cannot take the size.
    pub fn operations(&self) -> Result<f64, TrainError> {
        let Settings { batch, window, crop, .. } = self.settings;
        Ok(operations_per_pixel(&self.graph, crop)? * (batch * window * crop * crop) as f64)
    }

    /// Makes a step on parts of `clips`, when `progress` of the training is done.
    ///
    /// # Errors
    /// [`TrainError`] if a clip cannot be read, or the loss is no longer a number; the state is as before then.
    pub fn step(&mut self, clips: &[ClipFile], progress: f64) -> Result<TrainStep, TrainError> {
        let (batch, done) = (self.settings.batch, self.state.steps());
        let packed = self.unroll.pack(&self.form.fold(&self.state.weights))?;
        let item = |k: usize| -> Result<Option<ItemResult>, TrainError> {
            let Some(choice) = Choice::new(clips, &self.settings, done, k) else { return Ok(None) };
            let clip = choice.read()?;
            let mut memory = self.take_memory();
            let result = self.unroll.run(&packed, &clip, done as usize * batch + k, &mut memory)?;
            self.memories.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).push(memory);
            Ok(Some(result))
        };
        let items: Vec<Result<Option<ItemResult>, TrainError>> =
            (0..batch).into_par_iter().with_max_len(1).map(item).collect();

        // In the order of items, whichever thread was first.
        let (mut v_weights, mut terms) = (self.unroll.v_weights(), Terms::default());
        for item in items {
            let Some(item) = item? else { continue };
            optimise::add(&mut v_weights, &item.v_weights);
            terms += item.terms;
        }
        let mut v_weights = self.form.pull_back(&self.state.weights, v_weights);
        terms /= batch as f64;
        let loss = terms.weighted(&self.settings.loss.weights);
        let gradient = optimise::length(&v_weights) / batch as f64;
        if !(loss.is_finite() && gradient.is_finite()) {
            return Err(TrainError::Diverged { step: done + 1, loss });
        }
        let shortened = (self.settings.longest_gradient / gradient).min(1.0);
        optimise::multiply(&mut v_weights, (shortened / batch as f64) as f32);
        let rate = self.settings.rate_at(done, progress);
        let State { weights, average, adam, .. } = &mut self.state;
        adam.step(&mut weights.arrays, &v_weights, rate)?;
        optimise::average(&mut average.arrays, &weights.arrays, done + 1);
        Ok(TrainStep { step: done + 1, terms, loss, gradient, rate })
    }

    fn take_memory(&self) -> Memory {
        let free = self.memories.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).pop();
        free.unwrap_or_else(|| self.unroll.memory())
    }
}
