//! `gs3 devices`.

use std::fmt::Write;

use gs3::neural::MatrixUnit;
use gs3_compute::{AdapterChoice, AdapterReport, Capabilities, Limits, Subgroups, adapters, choose};
use serde_json::{Value, json};

use crate::cli::error::CliError;
use crate::cli::exit::Outcome;
use crate::cli::terminal::print;

#[derive(Debug, clap::Args)]
pub struct DevicesArgs {
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

pub fn run(args: &DevicesArgs) -> Result<Outcome, CliError> {
    let adapters = adapters();
    match args.json {
        true => print(format_args!("{:#}\n", facts(&adapters)))?,
        false => print(text(&adapters))?,
    }
    Ok(Outcome::Done)
}

/// The same as [`text`] for programs.
fn facts(adapters: &[AdapterReport]) -> Value {
    let choice = choose(adapters, AdapterChoice::Auto).map_err(|error| error.to_string());
    let taken = choice.as_ref().ok().map(|(number, _)| *number);
    let fact = |(number, adapter): (usize, &AdapterReport)| {
        let AdapterReport { name, api, kind, driver, capabilities, missing } = adapter;
        let Capabilities { subgroups, shader_f16, timestamps, cooperative_matrix, limits } = capabilities;
        let subgroups = match subgroups {
            Subgroups::Absent => Value::Null,
            Subgroups::Present { min, max } => json!([min, max]),
        };
        json!({
            "number": number,
            "name": name,
            "kind": kind.to_string(),
            "api": api.to_string(),
            "driver": driver,
            "is_taken": taken == Some(number),
            "missing": missing.as_ref().map(ToString::to_string),
            "subgroups": subgroups,
            "f16": *shader_f16,
            "timestamps": *timestamps,
            "matrix_products": cooperative_matrix,
            // Whether `--matrix-products` runs on it.
            "takes_matrix_products": MatrixUnit::of(capabilities).is_some(),
            "buffer_bytes": limits.buffer_bytes,
            "binding_bytes": limits.binding_bytes,
            "storage_bindings": limits.storage_bindings,
            "workgroup_bytes": limits.workgroup_bytes,
            "workgroup_invocations": limits.workgroup_invocations,
        })
    };
    json!({
        "adapters": adapters.iter().enumerate().map(fact).collect::<Vec<_>>(),
        "reason": choice.map_or_else(|error| error, |(_, reason)| reason),
    })
}

/// What is known of `adapters`, and which one would be taken.
fn text(adapters: &[AdapterReport]) -> String {
    let mut text = String::new();
    for (number, adapter) in adapters.iter().enumerate() {
        let AdapterReport { name, api, kind, driver, capabilities, missing } = adapter;
        // Writing to a string does not fail.
        let _ = writeln!(text, "{number}  {name}\n   {kind}, {api}, driver {driver}");
        let _ = writeln!(text, "   {}\n   {}", features(capabilities), limits(&capabilities.limits));
        if let Some(missing) = missing {
            let _ = writeln!(text, "   cannot run gs3: {missing}");
        }
    }
    let _ = match choose(adapters, AdapterChoice::Auto) {
        Ok((number, reason)) => writeln!(text, "taken without --adapter: {number}, {reason}"),
        Err(_) if adapters.is_empty() => writeln!(text, "no GPU adapter found; gs3 runs on the CPU"),
        Err(error) => writeln!(text, "no adapter can run gs3, which runs on the CPU: {error}"),
    };
    text
}

fn features(capabilities: &Capabilities) -> String {
    let Capabilities { subgroups, shader_f16, timestamps, cooperative_matrix, .. } = capabilities;
    let named = |name: &str, support: bool| match support {
        true => name.to_owned(),
        false => format!("no {name}"),
    };
    let subgroups = match subgroups {
        Subgroups::Absent => "no subgroups".to_owned(),
        Subgroups::Present { min, max } if min == max => format!("subgroups of {min}"),
        Subgroups::Present { min, max } => format!("subgroups of {min} to {max}"),
    };
    let sizes: Vec<String> = cooperative_matrix.iter().map(|[m, n, k]| format!("{m}×{n}×{k}")).collect();
    let matrix = match sizes[..] {
        [] => "no matrix products".to_owned(),
        _ => format!("matrix products f16 → f32 of {}", sizes.join(", ")),
    };
    [subgroups, named("f16", *shader_f16), named("timestamps", *timestamps), matrix].join(", ")
}

fn limits(limits: &Limits) -> String {
    let mib = |bytes: u64| format!("{} MiB", bytes >> 20);
    format!(
        "buffers up to {}, bindings up to {} ({} a kernel), workgroups of {} with {} KiB",
        mib(limits.buffer_bytes),
        mib(limits.binding_bytes),
        limits.storage_bindings,
        limits.workgroup_invocations,
        limits.workgroup_bytes >> 10,
    )
}

#[cfg(test)]
mod tests {
    use gs3_compute::{AdapterKind, Api};

    use super::*;

    #[test]
    fn adapters_are_told_with_the_one_taken_and_why() {
        let limits = Limits {
            buffer_bytes: 1 << 30,
            workgroup_bytes: 32 << 10,
            workgroup_invocations: 1024,
            ..Limits::LEAST
        };
        let adapter = |name: &str, kind, shader_f16| AdapterReport {
            name: name.to_owned(),
            api: Api::Vulkan,
            kind,
            driver: "mesa 1".to_owned(),
            capabilities: Capabilities {
                subgroups: Subgroups::Present { min: 8, max: 32 },
                shader_f16,
                timestamps: true,
                cooperative_matrix: vec![[16, 16, 16]],
                limits,
            },
            missing: None,
        };
        let all =
            [adapter("slow", AdapterKind::Software, false), adapter("fast", AdapterKind::Discrete, true)];
        assert_eq!(
            text(&all),
            "0  slow\n   software, Vulkan, driver mesa 1\n   \
             subgroups of 8 to 32, no f16, timestamps, matrix products f16 → f32 of 16×16×16\n   \
             buffers up to 1024 MiB, bindings up to 128 MiB (8 a kernel), workgroups of 1024 with 32 KiB\n\
             1  fast\n   discrete GPU, Vulkan, driver mesa 1\n   \
             subgroups of 8 to 32, f16, timestamps, matrix products f16 → f32 of 16×16×16\n   \
             buffers up to 1024 MiB, bindings up to 128 MiB (8 a kernel), workgroups of 1024 with 32 KiB\n\
             taken without --adapter: 1, the only discrete GPU; discrete before integrated, virtual and software ones\n"
        );
        // Fields that `cargo xtask gpu-report` reads.
        let facts = facts(&all);
        let [slow, fast] = [0, 1].map(|k| &facts["adapters"][k]);
        assert_eq!((&slow["is_taken"], &fast["is_taken"]), (&json!(false), &json!(true)));
        assert_eq!(
            (&fast["name"], &fast["kind"], &fast["number"]),
            (&json!("fast"), &json!("discrete GPU"), &json!(1))
        );
        assert_eq!((&fast["subgroups"], &fast["matrix_products"]), (&json!([8, 32]), &json!([[16, 16, 16]])));
        // Its subgroups are of no one size.
        assert_eq!((&fast["f16"], &fast["takes_matrix_products"]), (&json!(true), &json!(false)));
        assert_eq!(super::facts(&[])["adapters"], json!([]));
        assert_eq!(text(&[]), "no GPU adapter found; gs3 runs on the CPU\n");
    }
}
