//! What a network has learned: arrays named as its layers, and where they come from.

#[cfg(feature = "fs")]
use std::path::Path;

use crate::arrays::{self, Array, Arrays, Texts};
use crate::error::WeightError;
use crate::graph::{Activation, Graph, Op, Parameter};
use crate::random::Random;

/// Where weights come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// [`Graph::name`].
    pub network: String,
    /// [`Graph::version`].
    pub version: u32,
    /// HR pixels per LR pixel along a side.
    pub scale: u32,
    /// [`Tier::name`](crate::model::Tier::name).
    pub tier: String,
    /// The scenes it was trained on.
    pub training_data: String,
    /// Licence of the weights, an SPDX expression.
    pub licence: String,
}

/// Learned numbers of one network.
#[derive(Clone, Debug, PartialEq)]
pub struct Weights {
    /// Where they come from.
    pub header: Header,
    /// By [`Parameter`](crate::Parameter) name.
    pub arrays: Arrays,
}

impl Weights {
    /// Random weights for `graph`, the same for the same seed: uniform, so that features keep their variance (He et al.
    /// 2015): variance 2 / fan-in before rectifiers, else 1 / fan-in. Biases are 0.
    #[must_use]
    pub fn random(graph: &Graph, header: Header, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let mut arrays = Arrays::new();
        for layer in graph.layers() {
            let [input] = layer.inputs[..] else { continue };
            let channels = graph.channels(input);
            let Op::Conv2d(conv) = &layer.op else {
                // Where their publications start: a quarter for slopes, nothing changed by normalisation.
                for (kind, shape) in layer.op.parameters(channels) {
                    let start = match (&layer.op, kind) {
                        (Op::Prelu, _) => 0.25,
                        (_, "weight") => 1.0,
                        _ => 0.0,
                    };
                    let mut array = Array::zeros(&shape);
                    array.values_mut().fill(start);
                    arrays.insert(format!("{}.{kind}", layer.name), array);
                }
                continue;
            };
            let gain = match conv.activation {
                Activation::Identity | Activation::Sigmoid | Activation::Tanh => 1.0,
                _ => 2.0,
            };
            let shape = [conv.outputs, channels, conv.kernel, conv.kernel];
            let fan_in = (shape[1] * shape[2] * shape[3]) as f32;
            // A uniform number in ±b has variance b² / 3.
            let bound = (3.0 * gain / fan_in).sqrt();
            let mut weight = Array::zeros(&shape);
            weight.values_mut().fill_with(|| bound * random.signed());
            arrays.insert(format!("{}.weight", layer.name), weight);
            if conv.bias {
                arrays.insert(format!("{}.bias", layer.name), Array::zeros(&[conv.outputs]));
            }
        }
        Self { header, arrays }
    }

    /// Checks that the weights fit `graph`.
    ///
    /// # Errors
    /// [`WeightError`] naming the first array that is missing, too much, of another shape or not finite, or the field
    /// of the header that differs.
    pub fn check(&self, graph: &Graph) -> Result<(), WeightError> {
        self.check_parameters(graph, &graph.parameters())
    }

    /// Whether they are of `graph`, but have `parameters` in the place of its own: what gives these while they are
    /// trained.
    ///
    /// # Errors
    /// As [`Weights::check`].
    pub fn check_parameters(&self, graph: &Graph, parameters: &[Parameter]) -> Result<(), WeightError> {
        let header = |field: &'static str, expected: String, actual: String| match expected == actual {
            true => Ok(()),
            false => Err(WeightError::Header { field, expected, actual }),
        };
        header("network", graph.name().to_owned(), self.header.network.clone())?;
        header("version", graph.version().to_string(), self.header.version.to_string())?;
        for parameter in parameters {
            let name = parameter.name.clone();
            let Some(array) = self.arrays.get(&name) else {
                return Err(WeightError::Missing { name, expected: parameter.shape.clone() });
            };
            if array.shape() != parameter.shape {
                let (expected, actual) = (parameter.shape.clone(), format!("{:?}", array.shape()));
                return Err(WeightError::Shape { name, expected, actual });
            }
            if let Some(value) = array.values().iter().find(|v| !v.is_finite()) {
                return Err(WeightError::NotFinite { name, value: *value });
            }
        }
        match self.arrays.keys().find(|name| parameters.iter().all(|p| p.name != **name)) {
            Some(name) => Err(WeightError::Unknown { name: name.clone() }),
            None => Ok(()),
        }
    }

    /// The numbers of a parameter; none if there is no such parameter, which [`Weights::check`] excludes.
    pub(crate) fn parameter(&self, layer: &str, kind: &str) -> &[f32] {
        self.arrays.get(&format!("{layer}.{kind}")).map_or(&[], |array| array.values())
    }

    /// From a safetensors file in memory.
    ///
    /// # Errors
    /// [`WeightError`] if it is something else or lacks a field of the header.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, WeightError> {
        let (texts, arrays) = arrays::from_bytes(bytes)?;
        Ok(Self { header: Header::from_texts(&texts)?, arrays })
    }

    /// As a safetensors file.
    ///
    /// # Errors
    /// [`WeightError::Format`] if a name cannot be written.
    pub fn to_bytes(&self) -> Result<Vec<u8>, WeightError> {
        arrays::to_bytes(&self.header.to_texts(), &self.arrays)
    }

    /// Reads a safetensors file.
    ///
    /// # Errors
    /// [`WeightError`] if it cannot be read, or as [`Weights::from_bytes`].
    #[cfg(feature = "fs")]
    pub fn load(path: impl AsRef<Path>) -> Result<Self, WeightError> {
        let (texts, arrays) = arrays::load(path.as_ref())?;
        Ok(Self { header: Header::from_texts(&texts)?, arrays })
    }

    /// Writes a safetensors file, whole or not at all.
    ///
    /// # Errors
    /// [`WeightError`] if it cannot be written.
    #[cfg(feature = "fs")]
    pub fn save(&self, path: impl AsRef<Path>) -> Result<(), WeightError> {
        arrays::save(path.as_ref(), &self.header.to_texts(), &self.arrays)
    }
}

impl Header {
    /// A header for weights of `graph`, `scale` HR pixels per LR pixel along a side. The other texts are empty.
    #[must_use]
    pub fn of(graph: &Graph, scale: u32) -> Self {
        let [tier, training_data, licence] = [const { String::new() }; 3];
        Self {
            network: graph.name().to_owned(),
            version: graph.version(),
            scale,
            tier,
            training_data,
            licence,
        }
    }

    pub(crate) fn to_texts(&self) -> Texts {
        let fields = [
            ("network", self.network.clone()),
            ("version", self.version.to_string()),
            ("scale", self.scale.to_string()),
            ("tier", self.tier.clone()),
            ("training_data", self.training_data.clone()),
            ("licence", self.licence.clone()),
        ];
        fields.into_iter().map(|(name, text)| (name.to_owned(), text)).collect()
    }

    fn from_texts(texts: &Texts) -> Result<Self, WeightError> {
        let text = |field: &'static str| match texts.get(field) {
            Some(text) => Ok(text.clone()),
            None => {
                Err(WeightError::Header { field, expected: "a text".to_owned(), actual: "none".to_owned() })
            }
        };
        let number = |field: &'static str| {
            let actual = text(field)?;
            let wrong =
                |_| WeightError::Header { field, expected: "a number".to_owned(), actual: actual.clone() };
            actual.parse().map_err(wrong)
        };
        Ok(Self {
            network: text("network")?,
            version: number("version")?,
            scale: number("scale")?,
            tier: text("tier")?,
            training_data: text("training_data")?,
            licence: text("licence")?,
        })
    }
}
