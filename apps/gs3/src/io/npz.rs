//! NumPy archives: `.npy` arrays in a zip file.

use std::io::{self, Seek, Write};
use std::mem;

use zip::ZipWriter;
use zip::write::SimpleFileOptions;

/// Writes an archive of the arrays that `add` adds.
pub fn write<W: Write + Seek>(
    writer: W,
    add: impl FnOnce(&mut ZipWriter<W>) -> io::Result<()>,
) -> io::Result<()> {
    let mut zip = ZipWriter::new(writer);
    if let Err(error) = add(&mut zip).and_then(|()| zip.flush()) {
        // Dropped, it would try to end the archive and say on its own that it cannot.
        mem::forget(zip);
        return Err(error);
    }
    zip.finish()?;
    Ok(())
}

/// Adds the array `name` of `shape` (row-major, f32, little endian).
pub fn add(
    zip: &mut ZipWriter<impl Write + Seek>,
    name: &str,
    shape: &[usize],
    values: impl Iterator<Item = f32>,
) -> io::Result<()> {
    // Stored: floats hardly compress. Large enough images pass 4 GiB.
    let bytes = shape.iter().product::<usize>() as u64 * 4;
    let options = SimpleFileOptions::default()
        .compression_method(zip::CompressionMethod::Stored)
        .large_file(bytes >= u64::from(u32::MAX) - 4096);
    zip.start_file(format!("{name}.npy"), options)?;
    zip.write_all(&header(shape))?;
    let mut buffer = Vec::with_capacity(1 << 16);
    for value in values {
        buffer.extend(value.to_le_bytes());
        if buffer.len() == 1 << 16 {
            zip.write_all(&buffer)?;
            buffer.clear();
        }
    }
    zip.write_all(&buffer)
}

/// Magic, version 1.0, length, and the array's description, padded to 64 bytes.
fn header(shape: &[usize]) -> Vec<u8> {
    let shape = shape.iter().map(|n| format!("{n},")).collect::<String>();
    let mut text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({shape}), }}");
    const PREFIX: usize = 10;
    let length = (PREFIX + text.len() + 1).next_multiple_of(64) - PREFIX;
    text.push_str(&" ".repeat(length - text.len() - 1));
    text.push('\n');
    let mut header = b"\x93NUMPY\x01\x00".to_vec();
    // A shape of at most three dimensions fits many times.
    header.extend((length as u16).to_le_bytes());
    header.extend(text.as_bytes());
    header
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn header_is_aligned_and_describes_the_shape() {
        for shape in [&[7_usize][..], &[270, 480], &[4320, 7680, 3]] {
            let header = header(shape);
            assert_eq!(header.len() % 64, 0);
            assert_eq!(usize::from(u16::from_le_bytes([header[8], header[9]])) + 10, header.len());
            assert!(header.ends_with(b"\n"));
        }
        let text = String::from_utf8_lossy(&header(&[2, 3])).into_owned();
        assert!(text.contains("'shape': (2,3,), }"), "{text}");
    }
}
