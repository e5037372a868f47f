//! What `gs3 devices --json` says.

use serde::{Deserialize, Serialize};

use crate::XtaskError;

/// What it calls a driver that runs on the processor.
const SOFTWARE: &str = "software";

/// The adapters of a machine.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Devices {
    adapters: Vec<Adapter>,
}

/// An adapter, with what means something here.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Adapter {
    /// What `--adapter` calls it.
    pub number: usize,
    /// Its name.
    pub name: String,
    /// Discrete, integrated, …, or software.
    pub kind: String,
    /// Whether gs3 takes it by itself.
    is_taken: bool,
    /// Whether `gs3 bench --matrix-products` runs on it.
    #[serde(rename = "takes_matrix_products")]
    pub matrix_products: bool,
}

impl Devices {
    /// The adapter to measure: the requested one, else gs3's own choice. A software adapter is not chosen, because
    /// its figures say nothing about GPUs.
    pub fn chosen(&self, asked: Option<usize>) -> Result<&Adapter, XtaskError> {
        let adapter = match asked {
            Some(number) => self.adapters.get(number),
            None => self.adapters.iter().find(|adapter| adapter.is_taken),
        };
        adapter.filter(|adapter| asked.is_some() || adapter.kind != SOFTWARE).ok_or_else(|| {
            let found: Vec<String> =
                self.adapters.iter().map(|a| format!("{} {} ({})", a.number, a.name, a.kind)).collect();
            XtaskError::NoAdapter {
                expected: asked.map_or_else(
                    || "a GPU in hardware that can run gs3 (--adapter N measures any)".to_owned(),
                    |number| format!("adapter {number}"),
                ),
                actual: if found.is_empty() { "none".to_owned() } else { found.join(", ") },
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;

    fn adapter(number: usize, kind: &str, is_taken: bool) -> Value {
        json!({
            "number": number, "name": format!("it {number}"), "kind": kind, "is_taken": is_taken, "f16": true,
            "takes_matrix_products": kind != SOFTWARE,
        })
    }

    fn devices(adapters: &[Value]) -> Devices {
        serde_json::from_value(json!({ "adapters": adapters, "reason": "" })).unwrap()
    }

    #[test]
    fn the_one_that_gs3_takes_is_measured_or_the_one_asked_for() {
        let devices = devices(&[adapter(0, SOFTWARE, false), adapter(1, "discrete GPU", true)]);
        let card = devices.chosen(None).unwrap();
        assert_eq!((card.number, card.name.as_str(), card.matrix_products), (1, "it 1", true));
        let software = devices.chosen(Some(0)).unwrap();
        assert_eq!((software.number, software.kind.as_str(), software.matrix_products), (0, SOFTWARE, false));
    }

    #[test]
    fn software_is_measured_only_for_who_asks() {
        let software = devices(&[adapter(0, SOFTWARE, true)]);
        assert_eq!(
            software.chosen(None).unwrap_err().to_string(),
            "expected a GPU in hardware that can run gs3 (--adapter N measures any), found 0 it 0 (software)"
        );
        assert!(software.chosen(Some(0)).is_ok());
        let error = software.chosen(Some(1)).unwrap_err();
        assert_eq!(error.to_string(), "expected adapter 1, found 0 it 0 (software)");
        let none = devices(&[]).chosen(None).unwrap_err();
        assert!(none.to_string().ends_with(", found none"), "{none}");
    }
}
