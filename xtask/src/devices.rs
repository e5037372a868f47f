//! What `gs3 devices` says.

use serde::Serialize;

use crate::XtaskError;

/// Words of `gs3 devices` that mean something here.
const SOFTWARE: &str = "software";
const TAKEN: &str = "taken without --adapter: ";
const PRODUCTS: &str = "matrix products f16 → f32 of ";

/// The adapters of a machine.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Devices {
    /// As `gs3 devices` said it.
    pub text: String,
    adapters: Vec<Adapter>,
    /// The number of the one that gs3 takes by itself.
    taken: Option<usize>,
}

/// An adapter.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Adapter {
    /// What `--adapter` calls it.
    pub number: usize,
    /// Its name.
    pub name: String,
    /// Discrete, integrated, …, or software.
    pub kind: String,
    /// Whether `gs3 bench --matrix-products` runs on it: of 8×8 or 16×16, with f16 and subgroups of one size.
    pub matrix_products: bool,
}

impl Devices {
    /// Reads the text of `gs3 devices`: a line that begins with an adapter's number, indented lines about it, and in the
    /// end the one that is taken.
    pub fn parse(text: &str) -> Self {
        let mut devices = Self { text: text.to_owned(), ..Self::default() };
        let mut line_of_adapter = 0;
        for line in text.lines() {
            if let Some(about) = line.strip_prefix("   ") {
                line_of_adapter += 1;
                let Some(adapter) = devices.adapters.last_mut() else { continue };
                match line_of_adapter {
                    1 => adapter.kind = about.split(", ").next().unwrap_or_default().to_owned(),
                    2 => adapter.matrix_products = multiplies_matrices(about),
                    _ => {}
                }
            } else if let Some(taken) = line.strip_prefix(TAKEN) {
                devices.taken = taken.split(',').next().and_then(|number| number.parse().ok());
            } else if let Some((number, name)) = line.split_once("  ")
                && let Ok(number) = number.parse()
            {
                line_of_adapter = 0;
                devices.adapters.push(Adapter { number, name: name.to_owned(), ..Adapter::default() });
            }
        }
        devices
    }

    /// The adapter to measure: the one asked for, else the one that gs3 takes by itself, unless that is software, whose
    /// figures say nothing about GPUs.
    pub fn chosen(&self, asked: Option<usize>) -> Result<&Adapter, XtaskError> {
        let adapter = asked.or(self.taken).and_then(|number| self.adapters.get(number));
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

fn multiplies_matrices(features: &str) -> bool {
    let Some((others, sizes)) = features.split_once(PRODUCTS) else { return false };
    let mut others = others.split(", ");
    let one_size = others.next().is_some_and(|it| it.starts_with("subgroups of ") && !it.contains(" to "));
    one_size
        && others.any(|it| it == "f16")
        && sizes.split(", ").any(|size| matches!(size, "8×8×8" | "16×16×16"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAVAPIPE: &str = "0  llvmpipe (LLVM 15.0.6, 256 bits)\n   \
        software, Vulkan, driver llvmpipe Mesa 22.3.6 (LLVM 15.0.6)\n   \
        subgroups of 8, f16, timestamps, no matrix products\n   \
        buffers up to 2047 MiB, bindings up to 128 MiB (32 a kernel), workgroups of 1024 with 32 KiB\n";
    const CARD: &str = "1  fast  card\n   discrete GPU, Vulkan, driver NVIDIA 5\n   \
        subgroups of 32, f16, timestamps, matrix products f16 → f32 of 16×8×8, 16×16×16\n   \
        buffers up to 1024 MiB, bindings up to 128 MiB (8 a kernel), workgroups of 1024 with 32 KiB\n";

    #[test]
    fn adapters_are_read_with_what_they_can_do() {
        let text =
            format!("{LAVAPIPE}{CARD}{TAKEN}1, the only discrete GPU; discrete before integrated ones\n");
        let devices = Devices::parse(&text);
        let [lavapipe, card] = &devices.adapters[..] else { panic!("{devices:?}") };
        assert_eq!(
            (lavapipe.name.as_str(), lavapipe.kind.as_str()),
            ("llvmpipe (LLVM 15.0.6, 256 bits)", SOFTWARE)
        );
        assert_eq!((card.name.as_str(), card.kind.as_str(), card.number), ("fast  card", "discrete GPU", 1));
        assert_eq!((lavapipe.matrix_products, card.matrix_products), (false, true));
        assert_eq!(devices.chosen(None).unwrap(), card);
        assert_eq!(devices.chosen(Some(0)).unwrap(), lavapipe);
    }

    #[test]
    fn matrix_products_are_those_that_gs3_uses() {
        for (features, expected) in [
            ("subgroups of 32, f16, timestamps, matrix products f16 → f32 of 8×8×8", true),
            ("subgroups of 32, no f16, timestamps, matrix products f16 → f32 of 8×8×8", false),
            ("subgroups of 32 to 64, f16, timestamps, matrix products f16 → f32 of 16×16×16", false),
            ("subgroups of 32, f16, timestamps, matrix products f16 → f32 of 16×8×16", false),
            ("subgroups of 32, f16, timestamps, no matrix products", false),
        ] {
            assert_eq!(multiplies_matrices(features), expected, "{features}");
        }
    }

    #[test]
    fn software_is_measured_only_for_who_asks() {
        let devices =
            Devices::parse(&format!("{LAVAPIPE}{TAKEN}0, the only one that can run gs3; software\n"));
        assert_eq!(
            devices.chosen(None).unwrap_err().to_string(),
            "expected a GPU in hardware that can run gs3 (--adapter N measures any), found 0 llvmpipe (LLVM 15.0.6, \
             256 bits) (software)"
        );
        assert!(devices.chosen(Some(0)).is_ok());
        assert_eq!(
            devices.chosen(Some(1)).unwrap_err().to_string(),
            "expected adapter 1, found 0 llvmpipe (LLVM 15.0.6, 256 bits) (software)"
        );
        let none = Devices::parse("no GPU adapter found; gs3 runs on the CPU\n").chosen(None).unwrap_err();
        assert!(none.to_string().ends_with(", found none"), "{none}");
    }

    /// The command pins its text by a test of its own; this one notices where that test moves away from what is read here.
    #[test]
    fn the_command_still_says_so() {
        let source = include_str!("../../apps/gs3/src/devices.rs");
        for words in [
            TAKEN,
            PRODUCTS,
            "{number}  {name}\\n   {kind}, {api}",
            "\"subgroups of {min}\"",
            "[subgroups, named(\"f16\"",
        ] {
            assert!(source.contains(words), "{words}");
        }
        assert!(
            include_str!("../../crates/gs3-compute/src/adapter.rs")
                .contains("Self::Software => \"software\"")
        );
    }
}
