//! PNG images of 8 bits, grey or colour, as cameras' programs write them.
//!
//! # Source
//! Portable Network Graphics, third edition (W3C), sections 5, 9 and 11.

use flate2::{Crc, read::ZlibDecoder};
use std::io::Read;

const SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";

/// The largest image that is unpacked: a file of a few bytes can claim any size.
const MAX_BYTES: usize = 1 << 29;

/// An image without its camera.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Pixels {
    /// Number of columns.
    pub(crate) width: u32,
    /// Number of rows.
    pub(crate) height: u32,
    /// Bytes of a pixel: 1 (grey) or 3 (red, green, blue).
    pub(crate) channels: u32,
    /// Row by row from the top left.
    pub(crate) bytes: Vec<u8>,
}

/// The pixels of a PNG file: 8 bits, grey or colour, an alpha channel left out; not interlaced, without palette. `O(pixels)`.
///
/// # Errors
/// What is wrong or not read, as a sentence without a subject.
pub(crate) fn read_png(data: &[u8]) -> Result<Pixels, String> {
    let mut rest = data.strip_prefix(SIGNATURE).ok_or("does not begin as a PNG file does")?;
    let (mut head, mut packed) = (None, Vec::new());
    loop {
        let (kind, body) = chunk(&mut rest)?;
        match &kind {
            b"IHDR" => head = Some(Head::of(body)?),
            b"IDAT" => packed.extend_from_slice(body),
            b"IEND" => break,
            // A lower case letter marks what a reader may leave out.
            [first, ..] if first.is_ascii_lowercase() || &kind == b"PLTE" => {}
            _ => return Err(format!("has a chunk {}, which is not known", String::from_utf8_lossy(&kind))),
        }
    }
    let Head { width, height, n_bytes } = head.ok_or("has no header (IHDR)")?;
    let stride = width as usize * n_bytes;
    let n_unpacked = (stride + 1).checked_mul(height as usize).filter(|n| *n <= MAX_BYTES);
    let n_unpacked = n_unpacked.ok_or_else(|| format!("has {width} x {height} pixels, too many"))?;
    let mut unpacked = Vec::new();
    let limit = n_unpacked as u64 + 1;
    ZlibDecoder::new(&*packed)
        .take(limit)
        .read_to_end(&mut unpacked)
        .map_err(|e| format!("cannot be unpacked: {e}"))?;
    if unpacked.len() != n_unpacked {
        return Err(format!("holds {} bytes for {width} x {height} pixels, {n_unpacked} are expected", unpacked.len()));
    }
    let mut rows = vec![0u8; stride * height as usize];
    for y in 0..height as usize {
        let line = &unpacked[y * (stride + 1)..(y + 1) * (stride + 1)];
        let (above, here) = rows.split_at_mut(y * stride);
        let above = above.len().checked_sub(stride).map(|start| &above[start..]);
        unfilter(line[0], &line[1..], above, &mut here[..stride], n_bytes)?;
    }
    let channels = if n_bytes < 3 { 1 } else { 3 };
    let bytes = if channels == n_bytes {
        rows
    } else {
        rows.chunks_exact(n_bytes).flat_map(|pixel| pixel[..channels].iter().copied()).collect()
    };
    Ok(Pixels { width, height, channels: channels as u32, bytes })
}

/// The next chunk: its type and body.
fn chunk<'a>(rest: &mut &'a [u8]) -> Result<([u8; 4], &'a [u8]), String> {
    const CUT: &str = "ends before its end; was it cut short?";
    let (length, after) = rest.split_first_chunk::<4>().ok_or(CUT)?;
    let length = u32::from_be_bytes(*length) as usize;
    let (kind, after_kind) = after.split_first_chunk::<4>().ok_or(CUT)?;
    let (body, after_body) = after_kind.split_at_checked(length).ok_or(CUT)?;
    let (crc, next) = after_body.split_first_chunk::<4>().ok_or(CUT)?;
    let mut found = Crc::new();
    found.update(kind);
    found.update(body);
    if found.sum() != u32::from_be_bytes(*crc) {
        return Err(format!("is damaged: the checksum of {} differs", String::from_utf8_lossy(kind)));
    }
    *rest = next;
    Ok((*kind, body))
}

struct Head {
    width: u32,
    height: u32,
    /// Bytes of a pixel, with alpha.
    n_bytes: usize,
}

impl Head {
    fn of(body: &[u8]) -> Result<Self, String> {
        let [w0, w1, w2, w3, h0, h1, h2, h3, depth, colour, 0, 0, interlace] = *body else {
            return Err("has a header that is not that of a PNG file".into());
        };
        let n_bytes = match colour {
            0 => 1,
            2 => 3,
            4 => 2,
            6 => 4,
            3 => return Err("has a palette, which is not read; save it as 8 bit RGB".into()),
            other => return Err(format!("has colour type {other}, which is not known")),
        };
        if depth != 8 {
            return Err(format!("has {depth} bits per channel; only 8 are read"));
        }
        if interlace != 0 {
            return Err("is interlaced, which is not read; save it without".into());
        }
        let [width, height] = [[w0, w1, w2, w3], [h0, h1, h2, h3]].map(u32::from_be_bytes);
        if width == 0 || height == 0 {
            return Err(format!("has {width} x {height} pixels"));
        }
        Ok(Self { width, height, n_bytes })
    }
}

/// Undoes the filter of a row.
fn unfilter(filter: u8, line: &[u8], above: Option<&[u8]>, here: &mut [u8], n_bytes: usize) -> Result<(), String> {
    for i in 0..line.len() {
        let left = if i < n_bytes { 0 } else { here[i - n_bytes] };
        let up = above.map_or(0, |above| above[i]);
        let corner = if i < n_bytes { 0 } else { above.map_or(0, |above| above[i - n_bytes]) };
        let predicted = match filter {
            0 => 0,
            1 => left,
            2 => up,
            3 => u16::midpoint(left.into(), up.into()) as u8,
            4 => paeth(left, up, corner),
            other => return Err(format!("has a row with filter {other}, which is not known")),
        };
        here[i] = line[i].wrapping_add(predicted);
    }
    Ok(())
}

/// Whichever of the three is nearest to `left + up - corner`; left before up before corner.
fn paeth(left: u8, up: u8, corner: u8) -> u8 {
    let [a, b, c] = [left, up, corner].map(i16::from);
    let [to_a, to_b, to_c] = [a, b, c].map(|p| (a + b - c - p).abs());
    match () {
        () if to_a <= to_b && to_a <= to_c => left,
        () if to_b <= to_c => up,
        () => corner,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::{Compression, write::ZlibEncoder};
    use std::io::Write;

    fn chunk_of(kind: &[u8; 4], body: &[u8]) -> Vec<u8> {
        let mut crc = Crc::new();
        crc.update(kind);
        crc.update(body);
        [&(body.len() as u32).to_be_bytes()[..], kind, body, &crc.sum().to_be_bytes()].concat()
    }

    /// A file of that colour type whose rows have the filters 0 to 4 in turn.
    fn written(width: u32, height: u32, head: [u8; 5], n_bytes: usize, bytes: &[u8]) -> Vec<u8> {
        let stride = width as usize * n_bytes;
        let mut packed = ZlibEncoder::new(Vec::new(), Compression::default());
        for y in 0..height as usize {
            let filter = (y % 5) as u8;
            packed.write_all(&[filter]).unwrap();
            for i in 0..stride {
                let at = |dy: usize, dx: usize| match (y >= dy, i >= dx) {
                    (true, true) => bytes[(y - dy) * stride + i - dx],
                    _ => 0,
                };
                let (left, up, corner) = (at(0, n_bytes), at(1, 0), at(1, n_bytes));
                let predicted = match filter {
                    0 => 0,
                    1 => left,
                    2 => up,
                    3 => ((u16::from(left) + u16::from(up)) / 2) as u8,
                    _ => paeth(left, up, corner),
                };
                packed.write_all(&[bytes[y * stride + i].wrapping_sub(predicted)]).unwrap();
            }
        }
        let head = [&width.to_be_bytes()[..], &height.to_be_bytes(), &head].concat();
        let (first, second) = (packed.finish().unwrap(), b"tEXtSoftware");
        let half = first.len() / 2;
        let data = [chunk_of(b"IDAT", &first[..half]), chunk_of(b"IDAT", &first[half..])].concat();
        let text = chunk_of(b"tEXt", second);
        [SIGNATURE, &chunk_of(b"IHDR", &head), &text, &data, &chunk_of(b"IEND", &[])].concat()
    }

    fn noise(n: usize) -> Vec<u8> {
        (0..n).map(|i| (i * i * 31 + i * 7) as u8).collect()
    }

    #[test]
    fn colour_and_grey_are_read_with_every_filter_and_alpha_is_left_out() {
        for (colour, n_bytes, channels) in [(0, 1, 1), (2, 3, 3), (4, 2, 1), (6, 4, 3)] {
            let bytes = noise(7 * 11 * n_bytes);
            let read = read_png(&written(7, 11, [8, colour, 0, 0, 0], n_bytes, &bytes)).unwrap();
            let expected: Vec<u8> = bytes.chunks(n_bytes).flat_map(|p| p[..channels].to_vec()).collect();
            assert_eq!(read, Pixels { width: 7, height: 11, channels: channels as u32, bytes: expected }, "{colour}");
        }
    }

    #[test]
    fn what_is_not_read_or_damaged_is_refused_by_name() {
        let good = written(4, 3, [8, 2, 0, 0, 0], 3, &noise(36));
        let refused = |data: &[u8]| read_png(data).unwrap_err();
        assert_eq!(refused(b"\xff\xd8\xff\xe0"), "does not begin as a PNG file does");
        assert!(refused(&written(4, 3, [16, 2, 0, 0, 0], 6, &noise(72))).starts_with("has 16 bits per channel"));
        assert!(refused(&written(4, 3, [8, 3, 0, 0, 0], 1, &noise(12))).starts_with("has a palette"));
        assert!(refused(&written(4, 3, [8, 2, 0, 0, 1], 3, &noise(36))).starts_with("is interlaced"));
        // The header claims more rows than there are.
        let mut tall = written(4, 3, [8, 2, 0, 0, 0], 3, &noise(36));
        let head = chunk_of(b"IHDR", &[0, 0, 0, 4, 0, 0, 0, 9, 8, 2, 0, 0, 0]);
        tall.splice(8..8 + head.len(), head);
        assert_eq!(refused(&tall), "holds 39 bytes for 4 x 9 pixels, 117 are expected");
        for at in 8..good.len() {
            let mut damaged = good.clone();
            damaged[at] ^= 0x10;
            assert!(read_png(&damaged).is_err(), "byte {at}");
            assert!(read_png(&good[..at]).is_err(), "cut at {at}");
        }
        let huge = chunk_of(b"IHDR", &[127, 0, 0, 0, 127, 0, 0, 0, 8, 2, 0, 0, 0]);
        let huge = [SIGNATURE, &huge, &chunk_of(b"IDAT", &[]), &chunk_of(b"IEND", &[])].concat();
        assert!(refused(&huge).ends_with("too many"));
    }
}
