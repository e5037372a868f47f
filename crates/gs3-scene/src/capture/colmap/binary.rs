//! COLMAP's binary files, little endian.

use super::{CamerasById, CaptureFault, MODELS, PosedImage, calibration, parameter_count};

/// Bytes of one observed point of an image: x, y, point id.
const POINT_BYTES: u64 = 24;

pub fn cameras(bytes: &[u8]) -> Result<CamerasById, CaptureFault> {
    let mut reader = Reader { rest: bytes };
    let count = reader.u64("number of cameras")?;
    let mut cameras = CamerasById::new();
    for i in 0..count {
        let field = format!("camera {i}");
        let id = reader.u32(&field)?;
        let number = reader.u32(&field)?;
        let model =
            MODELS.get(number as usize).map_or_else(|| format!("model {number}"), |(m, _)| (*m).to_owned());
        let size = [reader.u64(&field)?, reader.u64(&field)?];
        let parameters = (0..parameter_count(&format!("{field} model"), &model)?)
            .map(|_| reader.f64(&field))
            .collect::<Result<Vec<_>, _>>()?;
        cameras.insert(id, calibration(&field, &model, size, &parameters));
    }
    Ok(cameras)
}

pub fn images(bytes: &[u8]) -> Result<Vec<PosedImage>, CaptureFault> {
    let mut reader = Reader { rest: bytes };
    let count = reader.u64("number of images")?;
    let mut images = Vec::new();
    for i in 0..count {
        let field = format!("image {i}");
        reader.u32(&field)?; // the image's id; photos are told apart by name
        let mut rotation = [0.0; 4];
        for value in &mut rotation {
            *value = reader.f64(&field)?;
        }
        let mut translation = [0.0; 3];
        for value in &mut translation {
            *value = reader.f64(&field)?;
        }
        let camera_id = reader.u32(&field)?;
        let name = reader.text(&format!("{field} name"))?;
        let points = reader.u64(&field)?;
        reader.skip(points.saturating_mul(POINT_BYTES), &format!("{field} points"))?;
        images.push(PosedImage { field, name, camera_id, rotation, translation });
    }
    Ok(images)
}

struct Reader<'a> {
    rest: &'a [u8],
}

impl Reader<'_> {
    fn take<const N: usize>(&mut self, field: &str) -> Result<[u8; N], CaptureFault> {
        let Some((head, rest)) = self.rest.split_first_chunk::<N>() else {
            return Err(self.truncated(field, N as u64));
        };
        self.rest = rest;
        Ok(*head)
    }

    fn u32(&mut self, field: &str) -> Result<u32, CaptureFault> {
        self.take(field).map(u32::from_le_bytes)
    }

    fn u64(&mut self, field: &str) -> Result<u64, CaptureFault> {
        self.take(field).map(u64::from_le_bytes)
    }

    fn f64(&mut self, field: &str) -> Result<f64, CaptureFault> {
        self.take(field).map(f64::from_le_bytes)
    }

    /// Text up to and without a zero byte.
    fn text(&mut self, field: &str) -> Result<String, CaptureFault> {
        let Some(end) = self.rest.iter().position(|b| *b == 0) else {
            return Err(self.truncated(field, self.rest.len() as u64 + 1));
        };
        let text = String::from_utf8_lossy(&self.rest[..end]).into_owned();
        self.rest = &self.rest[end + 1..];
        Ok(text)
    }

    fn skip(&mut self, count: u64, field: &str) -> Result<(), CaptureFault> {
        let rest = usize::try_from(count).ok().and_then(|n| self.rest.get(n..));
        self.rest = rest.ok_or_else(|| self.truncated(field, count))?;
        Ok(())
    }

    fn truncated(&self, field: &str, expected: u64) -> CaptureFault {
        CaptureFault::Truncated { field: field.into(), expected, actual: self.rest.len() as u64 }
    }
}
