//! Values of text PLY files, and elements of variable size in binary ones: what has to be walked one by one.

use std::io::{BufRead, BufReader, Read};

use super::super::error::{LoadError, quoted};
use super::super::source::{Cursor, Source};
use super::column::{Endian, Scalar};
use super::header::{Element, Header, Kind};

/// The longest number that is read.
const LONGEST_TOKEN: usize = 64;

/// Reads whitespace-separated numbers.
pub(super) struct Tokens<'a> {
    file: &'a str,
    reader: BufReader<Cursor<'a>>,
    token: Vec<u8>,
}

impl<'a> Tokens<'a> {
    pub(super) fn new(source: &'a Source<'a>, header: &Header) -> Result<Self, LoadError> {
        Ok(Self { file: source.name(), reader: reader_at(source, header.data_start)?, token: Vec::new() })
    }

    /// The next number; `element` is for messages.
    pub(super) fn next(&mut self, element: &str) -> Result<f64, LoadError> {
        self.token.clear();
        loop {
            let buffer = self.reader.fill_buf().map_err(|source| io_error(self.file, source))?;
            if self.token.is_empty() {
                let blank = buffer.iter().take_while(|byte| byte.is_ascii_whitespace()).count();
                if blank > 0 {
                    self.reader.consume(blank);
                    continue;
                }
            }
            let part = buffer.iter().take_while(|byte| !byte.is_ascii_whitespace()).count();
            self.token.extend_from_slice(&buffer[..part]);
            let ended = part < buffer.len() || part == 0;
            self.reader.consume(part);
            if ended || self.token.len() > LONGEST_TOKEN {
                break;
            }
        }
        let text = String::from_utf8_lossy(&self.token);
        text.parse().map_err(|_| {
            let actual = if text.is_empty() { "the end of the file".to_owned() } else { quoted(&text) };
            LoadError::invalid(self.file, format!("element {}", quoted(element)), "a number", actual)
        })
    }

    /// Skips all rows of `element`.
    pub(super) fn skip(&mut self, element: &Element) -> Result<(), LoadError> {
        if element.properties.is_empty() {
            return Ok(());
        }
        for _ in 0..element.count {
            for property in &element.properties {
                let first = self.next(&element.name)?;
                if let Kind::List { .. } = property.kind {
                    // A negative or NaN count casts to 0, a huge one ends with the file.
                    for _ in 0..first as u64 {
                        self.next(&element.name)?;
                    }
                }
            }
        }
        Ok(())
    }
}

/// Where the rows of `element` end in a binary file if they start at `start`.
pub(super) fn end_of(
    source: &Source<'_>,
    element: &Element,
    start: u64,
    endian: Endian,
) -> Result<u64, LoadError> {
    let field = format!("element {}", quoted(&element.name));
    if let Some(row_bytes) = element.row_bytes() {
        let bytes = element.count.saturating_mul(row_bytes);
        source.check_extent(start, bytes, &field)?;
        return Ok(start + bytes);
    }
    let mut reader = reader_at(source, start)?;
    let mut position = start;
    for _ in 0..element.count {
        for property in &element.properties {
            let bytes = match property.kind {
                Kind::Scalar(scalar) => scalar.size() as u64,
                Kind::List { count, item } => {
                    source.check_extent(position, count.size() as u64, &field)?;
                    let items = read_count(&mut reader, count, endian);
                    let items = items.map_err(|error| io_error(source.name(), error))?;
                    position += count.size() as u64;
                    items.saturating_mul(item.size() as u64)
                }
            };
            source.check_extent(position, bytes, &field)?;
            // Within the file by the check above, so within i64 too.
            reader.seek_relative(bytes as i64).map_err(|error| io_error(source.name(), error))?;
            position += bytes;
        }
    }
    Ok(position)
}

/// The count of a list; one of a type or value that cannot count is 0.
fn read_count(reader: &mut impl Read, scalar: Scalar, endian: Endian) -> std::io::Result<u64> {
    let mut bytes = [0; 8];
    let used = &mut bytes[..scalar.size()];
    reader.read_exact(used)?;
    if endian == Endian::Big {
        used.reverse();
    }
    let value = u64::from_le_bytes(bytes);
    Ok(match scalar {
        Scalar::U8 | Scalar::U16 | Scalar::U32 => value,
        Scalar::I8 => (value as i8).max(0) as u64,
        Scalar::I16 => (value as i16).max(0) as u64,
        Scalar::I32 => (value as i32).max(0) as u64,
        Scalar::F32 | Scalar::F64 => 0,
    })
}

fn reader_at<'a>(source: &'a Source<'a>, start: u64) -> Result<BufReader<Cursor<'a>>, LoadError> {
    let mut cursor = source.cursor();
    std::io::Seek::seek(&mut cursor, std::io::SeekFrom::Start(start))
        .map_err(|error| io_error(source.name(), error))?;
    Ok(BufReader::with_capacity(1 << 18, cursor))
}

fn io_error(file: &str, source: std::io::Error) -> LoadError {
    LoadError::Io { file: file.to_owned(), source }
}
