//! The log as a picture: the loss and its terms, and the gains on held-out clips, over steps.

mod panel;

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::{DrawTarget, OriginDimensions, Pixel, RgbColor, Size};
use gs3_files::write_atomically;

use crate::error::TrainError;
use crate::log::Row;
use crate::losses::Term;
use panel::{Axis, Panel, Series};

/// Size of the picture in pixels.
const SIZE: [u32; 2] = [1200, 900];

/// Colours of the series, distinguishable by most eyes (Okabe and Ito 2008).
const COLORS: [Rgb888; 6] = [
    Rgb888::new(0, 0, 0),
    Rgb888::new(0, 114, 178),
    Rgb888::new(213, 94, 0),
    Rgb888::new(0, 158, 115),
    Rgb888::new(204, 121, 167),
    Rgb888::new(230, 159, 0),
];

/// Draws `rows` to a PNG file, whole or not at all.
///
/// # Errors
/// [`TrainError::File`] if it cannot be written.
pub fn draw(path: &Path, rows: &[Row]) -> Result<(), TrainError> {
    let mut canvas = Canvas::new(SIZE);
    let steps = rows.last().map_or(1.0, |row| row.step as f64);
    let over_steps = |value: &dyn Fn(&Row) -> Option<f64>| -> Vec<[f64; 2]> {
        rows.iter().filter_map(|row| Some([row.step as f64, value(row)?])).collect()
    };

    let mut losses =
        vec![Series { name: "loss", color: COLORS[0], points: over_steps(&|row| Some(row.loss)) }];
    for (term, color) in Term::ALL.into_iter().zip(COLORS.into_iter().cycle().skip(1)) {
        let points = over_steps(&|row| Some(row.terms.get(term)).filter(|value| *value > 0.0));
        losses.push(Series { name: term.name(), color, points });
    }
    let gains = ["PSNR gain on held-out clips, dB", "tPSNR gain, dB"].into_iter().enumerate();
    let gains: Vec<Series> = gains
        .map(|(k, name)| Series {
            name,
            color: COLORS[k + 1],
            points: over_steps(&|row| row.gains.map(|gains| gains[k])),
        })
        .collect();

    let [width, half] = [SIZE[0] as i32, SIZE[1] as i32 / 2];
    Panel::new([0, 0], [width, half], steps, Axis::Logarithmic, &losses).draw(&mut canvas, &losses);
    Panel::new([0, half], [width, half], steps, Axis::Linear, &gains).draw(&mut canvas, &gains);
    canvas.save(path)
}

/// An RGB image to draw on.
struct Canvas {
    size: [u32; 2],
    pixels: Vec<u8>,
}

impl Canvas {
    fn new(size: [u32; 2]) -> Self {
        Self { size, pixels: vec![255; 3 * (size[0] * size[1]) as usize] }
    }

    fn save(&self, path: &Path) -> Result<(), TrainError> {
        let encode = |file: &mut BufWriter<File>| {
            let mut encoder = png::Encoder::new(file, self.size[0], self.size[1]);
            encoder.set_color(png::ColorType::Rgb);
            let mut writer = encoder.write_header()?;
            writer.write_image_data(&self.pixels)?;
            Ok(writer.finish()?)
        };
        write_atomically(path, encode).map_err(|source| TrainError::File { path: path.to_owned(), source })
    }
}

impl OriginDimensions for Canvas {
    fn size(&self) -> Size {
        Size::new(self.size[0], self.size[1])
    }
}

impl DrawTarget for Canvas {
    type Color = Rgb888;
    type Error = std::convert::Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(&mut self, pixels: I) -> Result<(), Self::Error> {
        for Pixel(at, color) in pixels {
            let (Ok(x), Ok(y)) = (u32::try_from(at.x), u32::try_from(at.y)) else { continue };
            if x < self.size[0] && y < self.size[1] {
                let k = 3 * (y * self.size[0] + x) as usize;
                self.pixels[k..k + 3].copy_from_slice(&[color.r(), color.g(), color.b()]);
            }
        }
        Ok(())
    }
}
