//! One diagram: axes with their numbers, and lines.

use std::ops::RangeInclusive;

use embedded_graphics::Drawable;
use embedded_graphics::mono_font::MonoTextStyle;
use embedded_graphics::mono_font::ascii::FONT_8X13;
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::{Point, Primitive, RgbColor};
use embedded_graphics::primitives::{Polyline, PrimitiveStyle};
use embedded_graphics::text::{Alignment, Text};

use super::Canvas;

/// Pixels left, above, right and below of the lines.
const MARGINS: [i32; 4] = [80, 30, 20, 30];

/// Height of a line of text in pixels.
const LINE: i32 = 16;

const GRID: Rgb888 = Rgb888::new(225, 225, 225);

/// Points joined by lines.
pub struct Series {
    pub name: &'static str,
    pub color: Rgb888,
    /// x and y.
    pub points: Vec<[f64; 2]>,
}

/// How y goes up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    Linear,
    /// Equal ratios are equal lengths.
    Logarithmic,
}

pub struct Panel {
    /// Left and upper border of the lines in pixels.
    start: [i32; 2],
    /// Right and lower border.
    end: [i32; 2],
    /// Last x; the first is 0.
    last: f64,
    axis: Axis,
    /// Of y, or of its logarithm to base 10.
    range: RangeInclusive<f64>,
}

impl Panel {
    /// A diagram at `place` of `size` pixels for x from 0 to `last`, high enough for all of `series`.
    pub fn new(place: [i32; 2], size: [i32; 2], last: f64, axis: Axis, series: &[Series]) -> Self {
        let start = [place[0] + MARGINS[0], place[1] + MARGINS[1]];
        let end = [place[0] + size[0] - MARGINS[2], place[1] + size[1] - MARGINS[3]];
        let mut panel = Self { start, end, last: last.max(1.0), axis, range: 0.0..=1.0 };
        let ys = series.iter().flat_map(|series| &series.points).map(|[_, y]| panel.scaled(*y));
        let (least, most) = ys
            .filter(|y| y.is_finite())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), y| (least.min(y), most.max(y)));
        if least <= most {
            // A constant has some height, too.
            let room = (0.05 * (most - least)).max(1e-3);
            panel.range = least - room..=most + room;
        }
        panel
    }

    pub fn draw(&self, canvas: &mut Canvas, series: &[Series]) {
        for x in ticks(0.0, self.last) {
            let bottom = self.point([x, 0.0]).x;
            line(canvas, &[Point::new(bottom, self.start[1]), Point::new(bottom, self.end[1])], GRID);
            text(
                canvas,
                &number(x),
                Point::new(bottom, self.end[1] + LINE),
                Rgb888::BLACK,
                Alignment::Center,
            );
        }
        for y in self.y_ticks() {
            let at = Point::new(self.start[0], self.height(self.scaled(y)));
            line(canvas, &[at, Point::new(self.end[0], at.y)], GRID);
            text(canvas, &number(y), at + Point::new(-6, 4), Rgb888::BLACK, Alignment::Right);
        }
        let mut at = Point::new(self.start[0], self.start[1] - 8);
        for series in series.iter().filter(|series| !series.points.is_empty()) {
            let points: Vec<Point> = series.points.iter().map(|p| self.point(*p)).collect();
            line(canvas, &points, series.color);
            at = text(canvas, series.name, at, series.color, Alignment::Left) + Point::new(24, 0);
        }
    }

    fn y_ticks(&self) -> Vec<f64> {
        let (least, most) = (*self.range.start(), *self.range.end());
        match self.axis {
            Axis::Linear => ticks(least, most),
            Axis::Logarithmic => {
                let decades = least.floor() as i32..=most.ceil() as i32;
                let all = decades.flat_map(|decade| [1.0, 2.0, 5.0].map(|digit| digit * 10_f64.powi(decade)));
                all.filter(|y| self.range.contains(&y.log10())).collect()
            }
        }
    }

    fn scaled(&self, y: f64) -> f64 {
        match self.axis {
            Axis::Linear => y,
            Axis::Logarithmic => y.log10(),
        }
    }

    /// The row of a scaled y.
    fn height(&self, y: f64) -> i32 {
        let share = (y - self.range.start()) / (self.range.end() - self.range.start());
        // A cast saturates: what is not finite lies outside.
        (f64::from(self.end[1]) - share * f64::from(self.end[1] - self.start[1])) as i32
    }

    fn point(&self, [x, y]: [f64; 2]) -> Point {
        let across = x / self.last * f64::from(self.end[0] - self.start[0]);
        Point::new(self.start[0] + across as i32, self.height(self.scaled(y)))
    }
}

/// About eight round numbers from `least` to `most`: multiples of 1, 2 or 5 times a power of ten.
fn ticks(least: f64, most: f64) -> Vec<f64> {
    let rough = (most - least) / 8.0;
    if !(rough.is_finite() && rough > 0.0) {
        return Vec::new();
    }
    let decade = 10_f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|digit| digit * decade).find(|step| *step >= rough);
    let step = step.unwrap_or(10.0 * decade);
    let (first, last) = ((least / step).ceil() as i64, (most / step).floor() as i64);
    (first..=last).map(|k| k as f64 * step).collect()
}

/// As short as a tick's number can be.
fn number(value: f64) -> String {
    // Multiples of 0.1 are not exact.
    let rounded = format!("{value:.6}");
    rounded.trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn line(canvas: &mut Canvas, points: &[Point], color: Rgb888) {
    // Drawing on a canvas cannot fail.
    let Ok(()) = Polyline::new(points).into_styled(PrimitiveStyle::with_stroke(color, 1)).draw(canvas);
}

/// Writes at `at` and returns where the text ends.
fn text(canvas: &mut Canvas, text: &str, at: Point, color: Rgb888, alignment: Alignment) -> Point {
    let Ok(end) =
        Text::with_alignment(text, at, MonoTextStyle::new(&FONT_8X13, color), alignment).draw(canvas);
    end
}

#[cfg(test)]
mod tests {
    use super::{number, ticks};

    #[test]
    fn ticks_are_round_and_within() {
        let text = |least, most| ticks(least, most).into_iter().map(number).collect::<Vec<_>>().join(" ");
        assert_eq!(text(0.0, 4000.0), "0 500 1000 1500 2000 2500 3000 3500 4000");
        assert_eq!(text(-0.12, 0.95), "0 0.2 0.4 0.6 0.8");
        assert_eq!(text(1.0, 1.0), "");
        assert_eq!(text(0.0, f64::NAN), "");
    }
}
