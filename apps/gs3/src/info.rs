//! `gs3 info`.

use gs3::scene::format::Streamed;
use gs3::scene::orbit::Bounds;
use gs3::scene::{OpacityMode, Scene};
use serde_json::{Value, json};

use crate::args::InfoArgs;
use crate::error::CliError;
use crate::terminal::print;
use crate::{Outcome, inputs, report};

/// Percentiles of opacity and scale that are reported.
const PERCENTILES: [u32; 7] = [0, 5, 25, 50, 75, 95, 100];

pub fn run(args: &InfoArgs) -> Result<Outcome, CliError> {
    let (scene, load_time) = inputs::scene_at(&args.scene, args.levels)?;
    let mut facts = facts(&scene, load_time.as_secs_f64());
    if let Some(Streamed { levels, has_environment }) = inputs::streamed(&args.scene)? {
        facts = report::join(facts, json!({ "levels": levels, "has_environment": has_environment }));
    }
    if args.json {
        print(format_args!("{facts:#}\n"))?;
    } else {
        print(text(&args.scene.display().to_string(), &facts))?;
    }
    Ok(Outcome::Done)
}

fn facts(scene: &Scene, load_s: f64) -> Value {
    let g = scene.gaussians();
    let range = |values: &[f32]| {
        let low = values.iter().copied().fold(f32::INFINITY, f32::min);
        let high = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        [low, high]
    };
    let [x, y, z] = [0, 1, 2].map(|axis: usize| range(&g.means[axis]));
    let Bounds { center, radius, extent, is_object, up } = Bounds::of(scene);
    let dropped = scene.dropped();
    json!({
        "gaussians": g.len(),
        "sh_degree": g.sh_degree,
        "opacity_mode": match scene.opacity_mode() {
            OpacityMode::Default => "default",
            OpacityMode::Antialiased => "antialiased",
        },
        "bounds": { "min": [x[0], y[0], z[0]], "max": [x[1], y[1], z[1]] },
        "bulk": {
            "center": center.to_array(), "radius": radius, "extent": extent.to_array(), "is_object": is_object, "up": up.to_array(),
        },
        "opacity_percentiles": percentiles(g.opacities.clone()),
        "scale_percentiles": percentiles(g.scales.concat()),
        "dropped": {
            "total": dropped.total(),
            "non_finite_mean": dropped.non_finite_mean,
            "invalid_scale": dropped.invalid_scale,
            "invalid_rotation": dropped.invalid_rotation,
            "invalid_opacity": dropped.invalid_opacity,
            "non_finite_sh": dropped.non_finite_sh,
            "excessive_sh": dropped.excessive_sh,
        },
        "f32_mb": g.byte_size() as f64 / 1e6,
        "load_s": load_s,
    })
}

/// `[[percentile, value]…]`.
fn percentiles(mut values: Vec<f32>) -> Vec<Value> {
    values.sort_unstable_by(f32::total_cmp);
    let last = values.len().saturating_sub(1);
    let value = |p: u32| values.get((f64::from(p) / 100.0 * last as f64).round() as usize);
    PERCENTILES.iter().map(|p| json!([p, value(*p)])).collect()
}

/// The same for people.
fn text(name: &str, facts: &Value) -> String {
    let row = |values: &Value| {
        let pairs = values.as_array().into_iter().flatten();
        pairs.map(|pair| format!("{}% {}", pair[0], number(&pair[1]))).collect::<Vec<_>>().join("  ")
    };
    let point =
        |value: &Value| value.as_array().into_iter().flatten().map(number).collect::<Vec<_>>().join(", ");
    let levels = facts["levels"].as_u64().map_or_else(String::new, |levels| {
        let environment = if facts["has_environment"] == json!(true) { ", and an environment" } else { "" };
        format!("  levels      {}{environment}\n", levels)
    });
    let bulk = &facts["bulk"];
    let dropped = &facts["dropped"];
    let reasons =
        dropped.as_object().into_iter().flatten().filter(|(key, n)| *key != "total" && **n != json!(0));
    let reasons: Vec<String> = reasons.map(|(key, n)| format!("{n} {}", key.replace('_', " "))).collect();
    let because = if reasons.is_empty() { String::new() } else { format!(" ({})", reasons.join(", ")) };
    format!(
        "{name}\n  Gaussians   {}, {:.1} MB as f32, SH degree {}, {} opacity\n{levels}  bounds      {}  to  {}\n  \
         bulk        radius {} around {}, {}, up {}\n  opacity     {}\n  scale       {}\n  dropped     {}{because}\n",
        facts["gaussians"],
        facts["f32_mb"].as_f64().unwrap_or(0.0),
        facts["sh_degree"],
        facts["opacity_mode"].as_str().unwrap_or_default(),
        point(&facts["bounds"]["min"]),
        point(&facts["bounds"]["max"]),
        number(&bulk["radius"]),
        point(&bulk["center"]),
        if bulk["is_object"] == json!(true) { "an object" } else { "a place" },
        point(&bulk["up"]),
        row(&facts["opacity_percentiles"]),
        row(&facts["scale_percentiles"]),
        dropped["total"],
    )
}

/// Four significant digits: coordinates and scales span decades, and tell less in zeros than in powers of ten.
fn number(value: &Value) -> String {
    let value = value.as_f64().unwrap_or(0.0);
    match value.abs() {
        0.0 => "0".to_owned(),
        size @ 0.001..10_000.0 => {
            // Digits after the point, of which 1 to 10 has three.
            let digits = (3.0 - size.log10().floor()).max(0.0) as usize;
            format!("{value:.digits$}")
        }
        _ => format!("{value:.3e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_four_digits_that_tell_something() {
        for (value, expected) in [
            (0.0, "0"),
            (3.2e-7, "3.200e-7"),
            (0.001_234_56, "0.001235"),
            (-0.5, "-0.5000"),
            (1.0, "1.000"),
            (-12.345_6, "-12.35"),
            (9_876.5, "9876"),
            (54_321.0, "5.432e4"),
            (-1e38, "-1.000e38"),
        ] {
            assert_eq!(number(&json!(value)), expected);
        }
    }
}
