//! Values of accessors as f32.

use super::super::error::LoadError;
use super::super::source::Source;
use super::document::{Accessor, Buffer, Document};

/// The types that values may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Component {
    I8,
    U8,
    I16,
    U16,
    F32,
}

impl Component {
    const fn from_number(number: u32) -> Option<Self> {
        Some(match number {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5126 => Self::F32,
            _ => return None,
        })
    }

    const fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::F32 => 4,
        }
    }

    /// The value in the first bytes. The caller ensures that there are enough bytes.
    fn read(self, bytes: &[u8], is_normalized: bool) -> f32 {
        let (value, largest) = match *bytes {
            [a, ..] if self == Self::I8 => (f32::from(a as i8), 127.0),
            [a, ..] if self == Self::U8 => (f32::from(a), 255.0),
            [a, b, ..] if self == Self::I16 => (f32::from(i16::from_le_bytes([a, b])), 32_767.0),
            [a, b, ..] if self == Self::U16 => (f32::from(u16::from_le_bytes([a, b])), 65_535.0),
            [a, b, c, d, ..] => return f32::from_le_bytes([a, b, c, d]),
            _ => return f32::NAN,
        };
        if is_normalized { (value / largest).max(-1.0) } else { value }
    }
}

/// Elements of an attribute within a buffer.
pub(super) struct Values<'a> {
    source: &'a Source<'a>,
    name: String,
    start: u64,
    stride: usize,
    component: Component,
    is_normalized: bool,
    components: usize,
    pub(super) count: usize,
}

impl<'a> Values<'a> {
    /// The values of accessor `index`, which must have `components` components: 1, 3 or 4.
    pub(super) fn new(
        file: &str,
        document: &Document,
        buffers: &'a [Buffer<'a>],
        name: &str,
        index: usize,
        components: usize,
    ) -> Result<Self, LoadError> {
        let field = format!("accessors[{index}] of {name}");
        let invalid = |part: &str, expected: &str, actual: String| {
            LoadError::invalid(file, format!("{field}.{part}"), expected, actual)
        };
        let Some(accessor) = document.accessors.get(index) else {
            let expected = format!("one of {} accessors", document.accessors.len());
            return Err(LoadError::invalid(file, field, expected, index.to_string()));
        };
        let Accessor { buffer_view, byte_offset, component_type, normalized, count, ref kind, ref sparse } =
            *accessor;
        let wanted = match components {
            1 => "SCALAR",
            3 => "VEC3",
            _ => "VEC4",
        };
        if kind != wanted {
            return Err(invalid("type", wanted, super::super::quoted(kind)));
        }
        if sparse.is_some() {
            return Err(invalid("sparse", "none", "some".to_owned()));
        }
        let Some(component) = Component::from_number(component_type) else {
            let expected = "5120 to 5123 or 5126 (bytes, shorts or floats)";
            return Err(invalid("componentType", expected, component_type.to_string()));
        };
        let Some(view) = buffer_view.and_then(|view| document.buffer_views.get(view)) else {
            return Err(invalid("bufferView", "a buffer view", "none".to_owned()));
        };
        let Some(buffer) = buffers.get(view.buffer) else {
            return Err(invalid("bufferView.buffer", "a buffer", view.buffer.to_string()));
        };
        let element = components * component.size();
        let stride = view.byte_stride.map_or(element as u64, |stride| stride);
        if stride < element as u64 || stride > 4096 {
            return Err(invalid("byteStride", &format!("{element} to 4096"), stride.to_string()));
        }
        // The last element needs no bytes up to the next.
        let bytes = count.saturating_sub(1).saturating_mul(stride).saturating_add(if count > 0 {
            element as u64
        } else {
            0
        });
        let within_view = byte_offset.saturating_add(bytes);
        if within_view > view.byte_length || view.byte_offset.saturating_add(view.byte_length) > buffer.length
        {
            let expected = format!("{count} elements within the buffer view and its buffer");
            return Err(invalid("count", &expected, format!("{within_view} bytes of {}", view.byte_length)));
        }
        Ok(Self {
            source: buffer.source.source(),
            name: name.to_owned(),
            start: buffer.start + view.byte_offset + byte_offset,
            stride: stride as usize,
            component,
            is_normalized: normalized,
            components,
            // Within a file, so within memory's reach.
            count: count as usize,
        })
    }

    /// Hands the components of elements `first` to `first + count` to `set`, with the index from `first` on.
    pub(super) fn each(
        &self,
        first: usize,
        count: usize,
        mut set: impl FnMut(usize, [f32; 4]),
    ) -> Result<(), LoadError> {
        if count == 0 {
            return Ok(());
        }
        let size = self.component.size();
        let mut bytes = vec![0; (count - 1) * self.stride + self.components * size];
        self.source.read_at(self.start + (first * self.stride) as u64, &mut bytes, &self.name)?;
        for i in 0..count {
            let element = &bytes[i * self.stride..];
            let mut values = [0.0; 4];
            for (k, value) in values[..self.components].iter_mut().enumerate() {
                *value = self.component.read(&element[k * size..], self.is_normalized);
            }
            set(i, values);
        }
        Ok(())
    }
}
