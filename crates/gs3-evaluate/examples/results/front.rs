//! Quality over speed: a plot of each path, and which methods others exceed in both.

use std::fmt::Write;

use crate::along::NATIVE;
use crate::score::{Row, mean_of_rendered};

/// A panel of the plot and what is around its axes, in px; panels stand in rows of two.
const PANEL: [f64; 2] = [560.0, 300.0];
const LEFT: f64 = 46.0;
const TOP: f64 = 30.0;
const RIGHT: f64 = 96.0;
const BOTTOM: f64 = 36.0;
const COLUMNS: usize = 2;
/// Width of a letter and height of a line of names, px: a font of 11 px.
const LETTER: f64 = 6.2;
const LINE: f64 = 11.0;

/// A method on one path.
struct Point<'a> {
    name: &'a str,
    /// Displayed frames a second over native rendering's.
    speed: f64,
    /// Mean PSNR of rendered frames, dB.
    psnr: f64,
}

impl Point<'_> {
    /// Whether `other` is as good in both and better in one.
    fn is_exceeded_by(&self, other: &Self) -> bool {
        other.speed >= self.speed
            && other.psnr >= self.psnr
            && (other.speed > self.speed || other.psnr > self.psnr)
    }
}

/// The methods of a path that have a speed, but native rendering, which has no PSNR.
fn points(rows: &[Row]) -> Vec<Point<'_>> {
    let Some(native) = rows[NATIVE].fps() else { return Vec::new() };
    let points = rows[NATIVE + 1..].iter().filter_map(|row| {
        Some(Point {
            name: &row.name,
            speed: row.fps()? / native,
            psnr: mean_of_rendered(&row.rendered.psnr)?,
        })
    });
    points.collect()
}

/// Whether no other point exceeds each of `points`.
fn front(points: &[Point<'_>]) -> Vec<bool> {
    points.iter().map(|point| !points.iter().any(|other| point.is_exceeded_by(other))).collect()
}

/// A table of the methods on the front of each path, and the methods that are on no front.
pub fn dominated(paths: &[(&'static str, usize, Vec<Row>)]) -> String {
    let mut text = String::from("| path | not exceeded, from slow to fast |\n|---|---|\n");
    let mut never: Vec<&str> = paths.first().map_or_else(Vec::new, |(_, _, rows)| {
        rows[NATIVE + 1..].iter().map(|row| row.name.as_str()).collect()
    });
    for (path, _, rows) in paths {
        let points = points(rows);
        let mut on_front: Vec<&Point<'_>> =
            points.iter().zip(front(&points)).filter_map(|(point, is_on)| is_on.then_some(point)).collect();
        on_front.sort_by(|a, b| a.speed.total_cmp(&b.speed));
        never.retain(|name| !on_front.iter().any(|point| point.name == *name));
        let names: Vec<String> = on_front.iter().map(|point| format!("`{}`", point.name)).collect();
        // Writing to a string does not fail.
        let _ = writeln!(text, "| {path} | {} |", names.join(", "));
    }
    let never: Vec<String> = never.iter().map(|name| format!("`{name}`")).collect();
    let _ =
        write!(text, "\nOn no path: {}.", if never.is_empty() { "none".into() } else { never.join(", ") });
    text
}

/// The plot of all paths, as the text of an SVG file.
pub fn plot(paths: &[(&'static str, usize, Vec<Row>)]) -> String {
    let [width, height] = [PANEL[0] * COLUMNS as f64, PANEL[1] * paths.len().div_ceil(COLUMNS) as f64];
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" \
         font-size=\"11\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n"
    );
    for (k, (path, _, rows)) in paths.iter().enumerate() {
        let corner = [PANEL[0] * (k % COLUMNS) as f64, PANEL[1] * (k / COLUMNS) as f64];
        let _ = writeln!(svg, "<g transform=\"translate({} {})\">", corner[0], corner[1]);
        panel(&mut svg, path, &points(rows));
        svg += "</g>\n";
    }
    svg + "</svg>\n"
}

/// One path: logarithmic speed from left to right, dB upwards.
fn panel(svg: &mut String, path: &str, points: &[Point<'_>]) {
    let range = |values: &mut dyn Iterator<Item = f64>| {
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
    };
    // Native rendering's own speed is always in the plot.
    let (slow, fast) = range(&mut points.iter().map(|point| point.speed).chain([1.0]));
    let (low, high) = range(&mut points.iter().map(|point| point.psnr));
    if slow >= fast || low >= high {
        return;
    }
    let x = |speed: f64| LEFT + (speed / slow).ln() / (fast / slow).ln() * (PANEL[0] - LEFT - RIGHT);
    let y = |psnr: f64| PANEL[1] - BOTTOM - (psnr - low) / (high - low) * (PANEL[1] - TOP - BOTTOM);
    let _ = writeln!(
        svg,
        "<text x=\"{LEFT}\" y=\"16\" font-size=\"13\" font-weight=\"bold\">{path}</text>\
         <text x=\"{LEFT}\" y=\"{}\">displayed frames a second, × native</text>\
         <text transform=\"translate(12 {}) rotate(-90)\">PSNR, dB</text>",
        PANEL[1] - 6.0,
        PANEL[1] / 2.0
    );
    for tick in [0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0].into_iter().filter(|tick| (slow..=fast).contains(tick)) {
        let (at, color) = (x(tick), if tick == 1.0 { "#888" } else { "#ddd" });
        let _ = writeln!(
            svg,
            "<path d=\"M{at:.1} {TOP}V{}\" stroke=\"{color}\"/><text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\">{tick}</text>",
            PANEL[1] - BOTTOM,
            PANEL[1] - BOTTOM + 14.0
        );
    }
    // Ten lines at most.
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().find(|step| (high - low) / step < 10.0).unwrap_or(20.0);
    let mut tick = (low / step).ceil() * step;
    while tick <= high {
        let at = y(tick);
        let _ = writeln!(
            svg,
            "<path d=\"M{LEFT} {at:.1}H{}\" stroke=\"#ddd\"/><text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{tick}</text>",
            PANEL[0] - RIGHT,
            LEFT - 4.0,
            at + 4.0
        );
        tick += step;
    }
    let mut sorted: Vec<(&Point<'_>, bool)> = points.iter().zip(front(points)).collect();
    sorted.sort_by(|a, b| a.0.speed.total_cmp(&b.0.speed));
    let line: Vec<String> = sorted
        .iter()
        .filter(|(_, is_on_front)| *is_on_front)
        .map(|(point, _)| format!("{:.1},{:.1}", x(point.speed), y(point.psnr)))
        .collect();
    let _ = writeln!(svg, "<polyline points=\"{}\" fill=\"none\" stroke=\"#d1495b\"/>", line.join(" "));
    // Left, right and line of each name.
    let mut names: Vec<[f64; 3]> = Vec::new();
    for (point, is_on_front) in sorted {
        let (at, down) = (x(point.speed), y(point.psnr));
        let color = match (point.name, is_on_front) {
            ("default", _) => "#1b6ca8",
            (_, true) => "#d1495b",
            (_, false) => "#888",
        };
        let (left, right) = (at + 7.0, at + 7.0 + LETTER * point.name.len() as f64);
        let is_free = |line: f64| {
            !names.iter().any(|[from, to, taken]| *from < right && left < *to && (taken - line).abs() < LINE)
        };
        // The nearest free line, below and above in turn.
        let shifts = (0..8).flat_map(|k| [f64::from(k) * LINE, -f64::from(k) * LINE]);
        let line = shifts.map(|shift| down + 4.0 + shift).find(|line| is_free(*line)).unwrap_or(down + 4.0);
        names.push([left, right, line]);
        let _ = writeln!(
            svg,
            "<circle cx=\"{at:.1}\" cy=\"{down:.1}\" r=\"4\" fill=\"{color}\"/>\
             <text x=\"{left:.1}\" y=\"{line:.1}\" fill=\"{color}\">{}</text>",
            point.name
        );
    }
}
