//! The PLY header: a text that declares elements and their properties.

use super::super::error::{LoadError, quoted};
use super::super::source::Source;
use super::column::{Endian, Scalar};
use super::comments::Comments;

/// The longest header that is read; headers of 3D Gaussian Splatting have about 1,500 bytes.
const LONGEST_HEADER: usize = 1 << 20;

/// How the values after the header are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Text,
    Binary(Endian),
}

#[derive(Debug)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    pub(super) comments: Comments,
    /// Where the values start.
    pub(super) data_start: u64,
}

#[derive(Debug)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

#[derive(Debug)]
pub(super) struct Property {
    pub(super) name: String,
    pub(super) kind: Kind,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Kind {
    Scalar(Scalar),
    /// A count, and as many items.
    List {
        count: Scalar,
        item: Scalar,
    },
}

impl Header {
    pub(super) fn read(source: &Source<'_>) -> Result<Self, LoadError> {
        let mut parser = Parser { file: source.name(), encoding: None, elements: Vec::new() };
        let mut comments = Comments::default();
        let mut bytes = source.head(4096)?;
        let mut line_start = 0;
        loop {
            let Some(length) = bytes[line_start..].iter().position(|byte| *byte == b'\n') else {
                if bytes.len() >= LONGEST_HEADER || bytes.len() as u64 == source.len() {
                    let expected = format!("\"end_header\" within {LONGEST_HEADER} bytes");
                    return Err(parser.invalid("header", expected, format!("none in {}", bytes.len())));
                }
                bytes = source.head((bytes.len() * 2).min(LONGEST_HEADER))?;
                continue;
            };
            let line = String::from_utf8_lossy(&bytes[line_start..line_start + length]).into_owned();
            let line = line.trim_end_matches('\r');
            let first = line_start == 0;
            line_start += length + 1;
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            match words.as_slice() {
                ["ply"] if first => {}
                _ if first => return Err(parser.invalid("header", "\"ply\"", quoted(line))),
                ["end_header"] => break,
                ["comment" | "obj_info", comment @ ..] => comments.read(comment),
                [] => {}
                words => parser.declare(words, line)?,
            }
        }
        let Some(encoding) = parser.encoding else {
            return Err(parser.invalid("header", "a line that starts with \"format\"", "none"));
        };
        Ok(Self { encoding, elements: parser.elements, comments, data_start: line_start as u64 })
    }

    pub(super) fn element(&self, file: &str, name: &str) -> Result<&Element, LoadError> {
        (self.elements.iter().find(|element| element.name == name))
            .ok_or_else(|| LoadError::invalid(file, "header", format!("an element \"{name}\""), "none"))
    }
}

struct Parser<'a> {
    file: &'a str,
    encoding: Option<Encoding>,
    elements: Vec<Element>,
}

impl Parser<'_> {
    fn invalid(&self, field: &str, expected: impl Into<String>, actual: impl Into<String>) -> LoadError {
        LoadError::invalid(self.file, field, expected, actual)
    }

    fn declare(&mut self, words: &[&str], line: &str) -> Result<(), LoadError> {
        match words {
            ["format", encoding, _version] => {
                self.encoding = Some(match *encoding {
                    "ascii" => Encoding::Text,
                    "binary_little_endian" => Encoding::Binary(Endian::Little),
                    "binary_big_endian" => Encoding::Binary(Endian::Big),
                    other => {
                        let expected = "ascii, binary_little_endian or binary_big_endian";
                        return Err(self.invalid("format", expected, quoted(other)));
                    }
                });
                Ok(())
            }
            ["element", name, count] => {
                let count = count.parse().map_err(|_| {
                    self.invalid(&format!("element {}", quoted(name)), "a number of rows", quoted(count))
                })?;
                self.elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() });
                Ok(())
            }
            ["property", "list", count, item, name] => {
                let kind = Kind::List { count: self.scalar(name, count)?, item: self.scalar(name, item)? };
                self.add(name, kind)
            }
            ["property", scalar, name] => {
                let kind = Kind::Scalar(self.scalar(name, scalar)?);
                self.add(name, kind)
            }
            _ => {
                Err(self.invalid("header", "format, comment, element, property or end_header", quoted(line)))
            }
        }
    }

    fn scalar(&self, property: &str, name: &str) -> Result<Scalar, LoadError> {
        Scalar::from_name(name).ok_or_else(|| {
            self.invalid(&format!("property {}", quoted(property)), "a scalar type", quoted(name))
        })
    }

    fn add(&mut self, name: &str, kind: Kind) -> Result<(), LoadError> {
        let field = format!("property {}", quoted(name));
        let Some(element) = self.elements.last() else {
            return Err(self.invalid(&field, "an element before it", "none"));
        };
        if element.properties.iter().any(|property| property.name == name) {
            return Err(self.invalid(&field, "one of this name in an element", "two"));
        }
        if let Some(element) = self.elements.last_mut() {
            element.properties.push(Property { name: name.to_owned(), kind });
        }
        Ok(())
    }
}

impl Element {
    /// Bytes of a row; `None` where a list makes rows differ.
    pub(super) fn row_bytes(&self) -> Option<u64> {
        let size = |property: &Property| match property.kind {
            Kind::Scalar(scalar) => Some(scalar.size() as u64),
            Kind::List { .. } => None,
        };
        self.properties.iter().map(size).sum()
    }

    /// The scalar property `name`: its type and its byte within a row. `None` if there is none or one before
    /// it is a list.
    pub(super) fn find(&self, name: &str) -> Option<(Scalar, usize)> {
        let mut offset = 0;
        for property in &self.properties {
            match property.kind {
                Kind::Scalar(scalar) if property.name == name => return Some((scalar, offset)),
                Kind::Scalar(scalar) => offset += scalar.size(),
                Kind::List { .. } => return None,
            }
        }
        None
    }
}
