//! What weights come from.

use gs3_neural::Header;

/// `header` for weights that were trained from the weights of `earlier`: the earlier training data contributes to
/// them, and its licence applies to them as well.
#[must_use]
pub fn continued(header: Header, earlier: &Header) -> Header {
    let both = |earlier: &str, now: &str, separator: &str, part: &dyn Fn(&str) -> String| {
        let mut parts: Vec<&str> = Vec::new();
        for text in [earlier, now].into_iter().flat_map(|text| text.split(separator)) {
            if !text.is_empty() && !parts.contains(&text) {
                parts.push(text);
            }
        }
        match parts[..] {
            [only] => only.to_owned(),
            _ => parts.into_iter().map(part).collect::<Vec<_>>().join(separator),
        }
    };
    // In SPDX's expressions AND binds closer than OR.
    let bracketed = |text: &str| match text.contains(" OR ") && !text.starts_with('(') {
        true => format!("({text})"),
        false => text.to_owned(),
    };
    Header {
        training_data: both(&earlier.training_data, &header.training_data, ", ", &str::to_owned),
        licence: both(&earlier.licence, &header.licence, " AND ", &bracketed),
        ..header
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_owe_to_all_that_they_were_trained_on() {
        let header = |training_data: &str, licence: &str| {
            let [network, tier] = ["super_sample", "fast"].map(str::to_owned);
            let (training_data, licence) = (training_data.to_owned(), licence.to_owned());
            Header { network, version: 1, scale: 4, tier, training_data, licence }
        };
        for (earlier, now, both) in [
            (("demo, guitar", "CC0-1.0"), ("demo", "CC0-1.0"), ("demo, guitar", "CC0-1.0")),
            (("", ""), ("demo", "CC0-1.0"), ("demo", "CC0-1.0")),
            (("demo", "MIT OR Apache-2.0"), ("demo", "MIT OR Apache-2.0"), ("demo", "MIT OR Apache-2.0")),
            (
                ("guitar", "MIT OR Apache-2.0"),
                ("demo", "CC-BY-4.0"),
                ("guitar, demo", "(MIT OR Apache-2.0) AND CC-BY-4.0"),
            ),
            // Of a training that is taken up for the second time.
            (
                ("guitar, demo", "(MIT OR Apache-2.0) AND CC-BY-4.0"),
                ("demo", "CC-BY-4.0"),
                ("guitar, demo", "(MIT OR Apache-2.0) AND CC-BY-4.0"),
            ),
        ] {
            let of = |(data, licence): (&str, &str)| header(data, licence);
            assert_eq!(continued(of(now), &of(earlier)), of(both));
        }
    }
}
