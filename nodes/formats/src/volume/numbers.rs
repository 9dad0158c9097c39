//! Voxel values from bytes of any type and order.

use std::io::{ErrorKind, Read};

/// The type of a stored value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum NumberType {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl NumberType {
    pub(super) fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// One value; `bytes` are as many as the type has.
    #[inline]
    fn value(self, bytes: &[u8], is_big: bool) -> f64 {
        let mut ordered = [0u8; 8];
        let n = self.bytes();
        ordered[..n].copy_from_slice(&bytes[..n]);
        if is_big {
            ordered[..n].reverse();
        }
        let low = u64::from_le_bytes(ordered);
        match self {
            Self::I8 => f64::from(low as i8),
            Self::U8 => f64::from(low as u8),
            Self::I16 => f64::from(low as i16),
            Self::U16 => f64::from(low as u16),
            Self::I32 => f64::from(low as i32),
            Self::U32 => f64::from(low as u32),
            Self::I64 => low as i64 as f64,
            Self::U64 => low as f64,
            Self::F32 => f64::from(f32::from_bits(low as u32)),
            Self::F64 => f64::from_bits(low),
        }
    }
}

/// How values are stored and scaled: `slope * stored + intercept`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Encoding {
    pub(super) number: NumberType,
    pub(super) is_big: bool,
    pub(super) slope: f64,
    pub(super) intercept: f64,
}

/// Why a stream gave no volume.
#[derive(Debug)]
pub(super) enum StreamError {
    /// It ended after so many whole voxels.
    Short(usize),
    /// It cannot be read or decompressed.
    Io(std::io::Error),
}

/// Reads `n` voxels. At most `reserve` of them are allocated ahead of what the stream gives.
pub(super) fn read_voxels(
    reader: &mut impl Read,
    n: usize,
    reserve: usize,
    encoding: &Encoding,
) -> Result<Vec<f32>, StreamError> {
    const CHUNK: usize = 1 << 16;
    let Encoding { number, is_big, slope, intercept } = *encoding;
    let width = number.bytes();
    let mut voxels = Vec::with_capacity(n.min(reserve));
    let mut buffer = vec![0u8; n.min(CHUNK) * width];
    while voxels.len() < n {
        let wanted = (n - voxels.len()).min(CHUNK) * width;
        let (filled, error) = fill(reader, &mut buffer[..wanted]);
        let scale = |bytes: &[u8]| (slope * number.value(bytes, is_big) + intercept) as f32;
        voxels.extend(buffer[..filled].chunks_exact(width).map(scale));
        match error {
            // A gzip stream that is cut says so, a plain one just ends.
            Some(error) if error.kind() != ErrorKind::UnexpectedEof => return Err(StreamError::Io(error)),
            _ if filled < wanted => return Err(StreamError::Short(voxels.len())),
            _ => {}
        }
    }
    Ok(voxels)
}

/// Fills the buffer as far as the stream reaches; returns how far, and what stopped it if that is an error.
pub(super) fn fill(reader: &mut impl Read, buffer: &mut [u8]) -> (usize, Option<std::io::Error>) {
    let mut filled = 0;
    while filled < buffer.len() {
        match reader.read(&mut buffer[filled..]) {
            Ok(0) => break,
            Ok(n) => filled += n,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return (filled, Some(error)),
        }
    }
    (filled, None)
}
