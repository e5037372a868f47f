//! Columns of binary rows: one property of many Gaussians, of any scalar type and byte order.

/// The scalar types of PLY.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

/// The byte order of binary values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Endian {
    Little,
    Big,
}

impl Scalar {
    /// By either of the names in use.
    pub(super) fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes of a value.
    pub(super) const fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

/// Where a property is in binary rows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Column {
    pub(super) scalar: Scalar,
    pub(super) endian: Endian,
    /// First byte within a row; the property ends within the row.
    pub(super) offset: usize,
}

impl Column {
    /// Hands the property of each row of `row_bytes` bytes to `set`, with the row's index.
    #[inline]
    pub(super) fn each(self, rows: &[u8], row_bytes: usize, set: impl FnMut(usize, f32)) {
        self.each_as(rows, row_bytes, |value| value as f32, |value| value, set);
    }

    /// The same in double precision.
    #[inline]
    pub(super) fn each_f64(self, rows: &[u8], row_bytes: usize, set: impl FnMut(usize, f64)) {
        self.each_as(rows, row_bytes, |value| value, f64::from, set);
    }

    /// The same as the type that `double` makes of doubles and of integers, which doubles hold exactly, and `single` of
    /// singles.
    #[inline]
    fn each_as<T>(
        self,
        rows: &[u8],
        row_bytes: usize,
        double: impl Fn(f64) -> T,
        single: impl Fn(f32) -> T,
        mut set: impl FnMut(usize, T),
    ) {
        macro_rules! each {
            ($type:ty, $from:ident) => {
                each!($type, $from, |value| double(f64::from(value)))
            };
            ($type:ty, $from:ident, $as:expr) => {
                for (i, row) in rows.chunks_exact(row_bytes).enumerate() {
                    if let Some((value, _)) = row[self.offset..].split_first_chunk() {
                        set(i, $as(<$type>::$from(*value)));
                    }
                }
            };
        }
        match (self.scalar, self.endian) {
            (Scalar::I8, _) => each!(i8, from_le_bytes),
            (Scalar::U8, _) => each!(u8, from_le_bytes),
            (Scalar::I16, Endian::Little) => each!(i16, from_le_bytes),
            (Scalar::I16, Endian::Big) => each!(i16, from_be_bytes),
            (Scalar::U16, Endian::Little) => each!(u16, from_le_bytes),
            (Scalar::U16, Endian::Big) => each!(u16, from_be_bytes),
            (Scalar::I32, Endian::Little) => each!(i32, from_le_bytes),
            (Scalar::I32, Endian::Big) => each!(i32, from_be_bytes),
            (Scalar::U32, Endian::Little) => each!(u32, from_le_bytes),
            (Scalar::U32, Endian::Big) => each!(u32, from_be_bytes),
            (Scalar::F32, Endian::Little) => each!(f32, from_le_bytes, &single),
            (Scalar::F32, Endian::Big) => each!(f32, from_be_bytes, &single),
            (Scalar::F64, Endian::Little) => each!(f64, from_le_bytes),
            (Scalar::F64, Endian::Big) => each!(f64, from_be_bytes),
        }
    }

    /// The property of `row` as 32 bits, for a type of 4 bytes.
    #[inline]
    pub(super) fn word(self, row: &[u8]) -> u32 {
        match (row[self.offset..].first_chunk(), self.endian) {
            (Some(bytes), Endian::Little) => u32::from_le_bytes(*bytes),
            (Some(bytes), Endian::Big) => u32::from_be_bytes(*bytes),
            (None, _) => 0,
        }
    }
}
