/// The type of a column's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum ColumnType {
    /// 64-bit float.
    F64 = 1,
    /// 32-bit float.
    F32 = 2,
    /// 64-bit signed integer.
    I64 = 3,
    /// 32-bit unsigned integer.
    U32 = 4,
    /// Byte.
    U8 = 5,
}

impl ColumnType {
    /// All types.
    pub(crate) const ALL: [Self; 5] = [Self::F64, Self::F32, Self::I64, Self::U32, Self::U8];

    /// Bytes of one value.
    pub fn size(self) -> usize {
        match self {
            Self::F64 | Self::I64 => 8,
            Self::F32 | Self::U32 => 4,
            Self::U8 => 1,
        }
    }

    /// The name, such as `f64`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::F64 => "f64",
            Self::F32 => "f32",
            Self::I64 => "i64",
            Self::U32 => "u32",
            Self::U8 => "u8",
        }
    }

    /// The type with this code in a recording.
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|t| *t as u8 == code)
    }
}
