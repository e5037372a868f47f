//! Line and scatter plots as SVG.

use std::fmt::Write;

/// Colours of methods, in order; distinguishable on white, repeated after the last.
const COLORS: [&str; 18] = [
    "#4a4a4a", "#1b6ca8", "#d1495b", "#2a9d4a", "#8f5bb5", "#e08e0b", "#17a2a2", "#8c564b", "#c73e9c",
    "#6b7a1e", "#5b8def", "#b03a2e", "#0f5c3f", "#b79f00", "#403f8f", "#e377c2", "#7f9aa8", "#96460e",
];

/// The colour of method `index`.
pub(super) fn color(index: usize) -> &'static str {
    COLORS[index % COLORS.len()]
}

/// A line or a point of a plot.
pub(super) struct Series {
    /// The method's index, for its colour and its visibility.
    pub method: usize,
    /// Its name.
    pub name: String,
    /// Points x, y.
    pub points: Vec<(f64, f64)>,
}

/// How a plot looks.
pub(super) struct Axes<'a> {
    /// Label of the x axis.
    pub x: &'a str,
    /// Label of the y axis.
    pub y: &'a str,
    /// Whether x is drawn in logarithms.
    pub log_x: bool,
    /// Whether points are named instead of joined.
    pub scatter: bool,
}

const WIDTH: f64 = 860.0;
const HEIGHT: f64 = 320.0;
const LEFT: f64 = 58.0;
const RIGHT: f64 = 20.0;
const TOP: f64 = 14.0;
const BOTTOM: f64 = 42.0;

/// The plot as an `svg` element; empty without points.
pub(super) fn plot(axes: &Axes<'_>, series: &[Series]) -> String {
    let place = |x: f64| if axes.log_x { x.log10() } else { x };
    let all =
        || series.iter().flat_map(|s| &s.points).filter(|(x, y)| place(*x).is_finite() && y.is_finite());
    if all().next().is_none() {
        return String::new();
    }
    let x_range = padded(all().map(|p| place(p.0)), if axes.scatter { 0.12 } else { 0.0 });
    let y_range = padded(all().map(|p| p.1), 0.06);
    let px = |x: f64| LEFT + (place(x) - x_range.0) / (x_range.1 - x_range.0) * (WIDTH - LEFT - RIGHT);
    let py = |y: f64| HEIGHT - BOTTOM - (y - y_range.0) / (y_range.1 - y_range.0) * (HEIGHT - TOP - BOTTOM);
    let mut svg = format!(
        "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{} over {}\">",
        axes.y, axes.x
    );
    // Writing to a string does not fail.
    for y in ticks(y_range, 6) {
        let at = py(y);
        let _ = write!(
            svg,
            "<line class=\"grid\" x1=\"{LEFT}\" x2=\"{}\" y1=\"{at:.1}\" y2=\"{at:.1}\"/>",
            WIDTH - RIGHT
        );
        let _ = write!(
            svg,
            "<text class=\"tick\" x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            LEFT - 6.0,
            at + 4.0,
            short(y)
        );
    }
    let x_ticks = if axes.log_x { log_ticks(x_range) } else { ticks(x_range, 10) };
    for x in x_ticks {
        let at = px(x);
        let bottom = HEIGHT - BOTTOM;
        let _ =
            write!(svg, "<line class=\"grid\" x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{TOP}\" y2=\"{bottom}\"/>");
        let _ = write!(
            svg,
            "<text class=\"tick\" x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
            bottom + 16.0,
            short(x)
        );
    }
    let middle = LEFT + (WIDTH - LEFT - RIGHT) / 2.0;
    let _ = write!(
        svg,
        "<text class=\"label\" x=\"{middle}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
        HEIGHT - 8.0,
        axes.x
    );
    let _ = write!(
        svg,
        "<text class=\"label\" transform=\"translate(14 {}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
        HEIGHT / 2.0,
        axes.y
    );
    let mut names = Vec::new();
    for s in series {
        let color = color(s.method);
        let _ = write!(svg, "<g data-method=\"{}\"><title>{}</title>", s.method, s.name);
        if axes.scatter {
            for (x, y) in &s.points {
                let (x, y) = (px(*x), py(*y));
                let _ = write!(svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"5\" fill=\"{color}\"/>");
                // Names of points at the right edge stand left of them; one that would cover another moves down.
                let (at, anchor) = if x > 0.85 * WIDTH { (x - 8.0, "end") } else { (x + 8.0, "start") };
                let mut y = y + 4.0;
                while names.iter().any(|(u, v): &(f64, f64)| (u - at).abs() < 110.0 && (v - y).abs() < 12.0) {
                    y += 4.0;
                }
                names.push((at, y));
                let name = &s.name;
                let _ =
                    write!(svg, "<text x=\"{at:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{name}</text>");
            }
        } else {
            let points: Vec<String> =
                s.points.iter().map(|(x, y)| format!("{:.1},{:.1}", px(*x), py(*y))).collect();
            let _ =
                write!(svg, "<polyline fill=\"none\" stroke=\"{color}\" points=\"{}\"/>", points.join(" "));
            for (x, y) in &s.points {
                let _ = write!(
                    svg,
                    "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"2\" fill=\"{color}\"/>",
                    px(*x),
                    py(*y)
                );
            }
        }
        svg += "</g>";
    }
    svg + "</svg>"
}

/// Smallest and largest value, with a margin of `share` of their distance at each side; never empty.
fn padded(values: impl Iterator<Item = f64>, share: f64) -> (f64, f64) {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    let margin = if high > low { (high - low) * share } else { 0.5 };
    (low - margin, high + margin)
}

/// Round values within `range`, about `count` of them, 1, 2 or 5 times a power of ten apart.
fn ticks((low, high): (f64, f64), count: usize) -> Vec<f64> {
    let rough = (high - low) / count as f64;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|s| *s >= rough).unwrap_or(rough);
    let first = (low / step).ceil() as i64;
    (first..=(high / step).floor() as i64).map(|i| i as f64 * step).collect()
}

/// 1, 2 and 5 times the powers of ten within a range of logarithms.
fn log_ticks((low, high): (f64, f64)) -> Vec<f64> {
    let powers = low.floor() as i32..=high.ceil() as i32;
    let values = powers.flat_map(|p| [1.0, 2.0, 5.0].map(|m| m * 10f64.powi(p)));
    values.filter(|v| (low..=high).contains(&v.log10())).collect()
}

/// A number without trailing zeros.
pub(super) fn short(value: f64) -> String {
    let text = format!("{value:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within() {
        assert_eq!(ticks((26.3, 31.9), 6), [27.0, 28.0, 29.0, 30.0, 31.0]);
        assert_eq!(log_ticks((-0.5, 1.4)), [0.5, 1.0, 2.0, 5.0, 10.0, 20.0]);
        assert_eq!(
            ["0.5", "-0.02", "10"],
            [short(0.5), short(-0.02), short(10.0)].each_ref().map(String::as_str)
        );
    }

    #[test]
    fn points_that_cannot_be_drawn_do_not_break_the_plot() {
        let axes = Axes { x: "x", y: "y", log_x: true, scatter: true };
        assert_eq!(plot(&axes, &[]), "");
        let point = |x, y| Series { method: 0, name: "m".into(), points: vec![(x, y)] };
        assert_eq!(plot(&axes, &[point(0.0, 1.0), point(2.0, f64::NAN)]), "");
        assert!(plot(&axes, &[point(2.0, 3.0)]).contains("<circle"));
    }
}
