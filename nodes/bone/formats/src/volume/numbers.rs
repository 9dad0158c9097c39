//! Voxel values from bytes of any type and order.

use crate::scalar::{Rows, Scalar};
use std::io::{ErrorKind, Read};

/// The most that deflate can expand a byte.
pub(super) const MAX_EXPANSION: u64 = 1032;

/// How values are stored and scaled: `slope * stored + intercept`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Encoding {
    pub(super) scalar: Scalar,
    pub(super) is_big: bool,
    pub(super) slope: f64,
    pub(super) intercept: f64,
}

/// Why a stream gave no volume.
#[derive(Debug)]
pub(super) enum StreamError {
    /// It ended after this number of whole voxels.
    Short(usize),
    /// It cannot be read or decompressed.
    Io(std::io::Error),
}

/// Reads the `n` voxels of a stream, which it can hold, and counts the bytes behind them, to a megabyte.
pub(super) fn read_all(reader: &mut impl Read, n: usize, encoding: &Encoding) -> Result<(Vec<f32>, u64), StreamError> {
    const CHUNK: usize = 1 << 16;
    let Encoding { scalar, is_big, slope, intercept } = *encoding;
    let width = scalar.n_bytes();
    let (mut voxels, mut bytes) = (Vec::with_capacity(n), Vec::new());
    while voxels.len() < n {
        let wanted = (n - voxels.len()).min(CHUNK) * width;
        bytes.clear();
        let outcome = reader.by_ref().take(wanted as u64).read_to_end(&mut bytes);
        let rows = Rows { bytes: &bytes, stride: width, big: is_big };
        voxels.extend(rows.column(scalar, 0).into_iter().map(|stored| (slope * stored + intercept) as f32));
        match outcome {
            // A gzip stream that is cut says so, a plain one just ends.
            Err(error) if error.kind() != ErrorKind::UnexpectedEof => return Err(StreamError::Io(error)),
            _ if bytes.len() < wanted => return Err(StreamError::Short(voxels.len())),
            _ => {}
        }
    }
    Ok((voxels, drain(reader, 1 << 20).map_err(StreamError::Io)?))
}

/// What a gzip stream of `compressed` bytes holds at most.
pub(super) fn gzip_limit(compressed: u64) -> u64 {
    compressed.saturating_mul(MAX_EXPANSION).saturating_add(1024)
}

/// Reads at most `limit` bytes of what is left of a gzip stream, so that its checksum is verified; returns their number.
pub(super) fn drain(reader: &mut impl Read, limit: u64) -> std::io::Result<u64> {
    std::io::copy(&mut reader.take(limit), &mut std::io::sink())
}
