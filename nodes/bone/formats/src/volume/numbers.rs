//! Voxel values from bytes of any type and order.

use crate::scalar::{Rows, Scalar};
use flate2::read::MultiGzDecoder;
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

/// Reads `n` voxels. At most `reserve` of them are allocated ahead of what the stream gives.
fn read_voxels(reader: &mut impl Read, n: usize, reserve: usize, encoding: &Encoding) -> Result<Vec<f32>, StreamError> {
    const CHUNK: usize = 1 << 16;
    let Encoding { scalar, is_big, slope, intercept } = *encoding;
    let width = scalar.n_bytes();
    let mut voxels = Vec::with_capacity(n.min(reserve));
    let mut buffer = vec![0u8; n.min(CHUNK) * width];
    while voxels.len() < n {
        let wanted = (n - voxels.len()).min(CHUNK) * width;
        let (filled, error) = fill(reader, &mut buffer[..wanted]);
        let rows = Rows { bytes: &buffer[..filled], stride: width, big: is_big };
        voxels.extend(rows.column(scalar, 0).into_iter().map(|stored| (slope * stored + intercept) as f32));
        match error {
            // A gzip stream that is cut says so, a plain one just ends.
            Some(error) if error.kind() != ErrorKind::UnexpectedEof => return Err(StreamError::Io(error)),
            _ if filled < wanted => return Err(StreamError::Short(voxels.len())),
            _ => {}
        }
    }
    Ok(voxels)
}

/// Reads the `n` voxels of a stream as [`read_voxels`], and counts the bytes behind them, to a megabyte.
pub(super) fn read_all(
    reader: &mut impl Read,
    n: usize,
    reserve: usize,
    encoding: &Encoding,
) -> Result<(Vec<f32>, u64), StreamError> {
    let voxels = read_voxels(reader, n, reserve, encoding)?;
    Ok((voxels, drain(reader, 1 << 20).map_err(StreamError::Io)?))
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

/// What a gzip stream of `compressed` bytes holds at most.
pub(super) fn gzip_limit(compressed: u64) -> u64 {
    compressed.saturating_mul(MAX_EXPANSION).saturating_add(1024)
}

/// Reads at most `limit` bytes of what is left of a gzip stream, so that its checksum is verified; returns their number.
pub(super) fn drain(reader: &mut impl Read, limit: u64) -> std::io::Result<u64> {
    std::io::copy(&mut reader.take(limit), &mut std::io::sink())
}

/// A decoder of gzip, also of several streams in a row.
pub(super) fn gunzip<R: Read>(reader: R) -> MultiGzDecoder<R> {
    MultiGzDecoder::new(reader)
}
