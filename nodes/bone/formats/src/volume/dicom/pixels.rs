//! The pixels of a file, frame by frame.

use super::super::data::folder_of;
use super::super::grid::VoxelUnit;
use super::codec::{jpeg_2000, jpeg_lossless, jpeg_lossless::Unread, run_length};
use super::elements::{DataSet, fragments};
use super::image::Image;
use super::syntax::{Compression, Remedy};
use crate::{FileError, input};
use flate2::read::DeflateDecoder;
use std::{
    io::Read as _,
    ops::Range,
    path::{Path, PathBuf},
};

/// Bytes that one byte of a file in JPEG 2000 may stand for: 512 x 512 pixels of air take 172, and the attributes of a layer a
/// thousand.
const MAX_EXPANSION: usize = 4096;

/// The pixel data of a file.
pub(super) struct Pixels {
    path: PathBuf,
    /// The data set.
    bytes: Vec<u8>,
    is_big: bool,
    compression: Compression,
    /// Where the fragments are; of uncompressed pixels one for all frames.
    fragments: Vec<Range<usize>>,
    /// Where frames begin among the bytes of the fragments, as far as the file says so.
    offsets: Vec<u64>,
    /// Whether they are in fragments.
    is_items: bool,
}

impl Pixels {
    pub(super) fn open(path: &Path) -> Result<Self, FileError> {
        Self::of(path, input::read(path)?)
    }

    pub(super) fn of(path: &Path, file: Vec<u8>) -> Result<Self, FileError> {
        let set = DataSet::of_file(path, &file)?;
        let fault = |message: String| FileError::content(path, "(7fe0,0010) pixel data", message);
        let (is_big, compression, start) = (set.syntax.is_big, set.compression, set.start);
        let mut reader = set.reader();
        let (mut extended, mut found) = (Vec::new(), None);
        while let Some(element) = reader.next().map_err(fault)? {
            match element.tag {
                // Offsets of frames in 64 bits.
                0x7fe0_0001 => extended = element.value.chunks_exact(8).map(|b| u64::from_le_bytes(eight(b))).collect(),
                0x7fe0_0010 => {
                    found = Some((element.start, element.value.len(), element.is_items));
                    break;
                }
                _ => {}
            }
        }
        let Some((at, n, is_items)) = found else {
            return Err(fault("floating-point pixels are not read; export the series as 16-bit integers".into()));
        };
        let value = &set.bytes[at..at + n];
        let place = |part: &[u8]| {
            let start = at + (part.as_ptr() as usize - value.as_ptr() as usize);
            start..start + part.len()
        };
        let mut parts = if is_items { fragments(value).map_err(fault)? } else { vec![&[], value] };
        let table = if parts.is_empty() { &[][..] } else { parts.remove(0) };
        let basic = table.chunks_exact(4).map(|b| u64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])));
        let offsets = if extended.is_empty() { basic.collect() } else { extended };
        let fragments = parts.into_iter().map(place).collect();
        // Inflated data sets stand alone; others are where they are in the file.
        let (bytes, shift) = match set.bytes {
            std::borrow::Cow::Owned(inflated) => (inflated, 0),
            std::borrow::Cow::Borrowed(_) => (Vec::new(), start),
        };
        let shifted = |range: Range<usize>| range.start + shift..range.end + shift;
        let fragments = Vec::into_iter(fragments).map(shifted).collect();
        let bytes = if shift > 0 || bytes.is_empty() { file } else { bytes };
        Ok(Self { path: path.into(), bytes, is_big, compression, fragments, offsets, is_items })
    }

    fn fault(&self, image: &Image, message: impl Into<String>) -> FileError {
        let place = match image.n_frames {
            1 => "(7fe0,0010) pixel data".into(),
            _ => format!("(7fe0,0010) pixel data, frame {}", image.frame + 1),
        };
        FileError::content(&self.path, place, message)
    }

    /// The values of a layer, columns fastest; notes on what became of them.
    pub(super) fn values(&self, image: &Image, notes: &mut Vec<String>) -> Result<Vec<f32>, FileError> {
        let cells = self.cells(image).map_err(|message| self.fault(image, message))?;
        let (mut n_padded, bits) = (0usize, &image.bits);
        let is_hu = image.unit() == VoxelUnit::Hu;
        let values = cells.into_iter().map(|cell| {
            let stored = bits.value(cell);
            let value = (image.slope * stored as f64 + image.intercept) as f32;
            // Padding that would be bone is no tissue; lower padding does no harm.
            if bits.padding.is_some_and(|[least, most]| (least..=most).contains(&stored)) && value > 0.0 && is_hu {
                n_padded += 1;
                return -1024.0;
            }
            value
        });
        let values = values.collect();
        let mut note = |note: &str| {
            if notes.iter().all(|known| known != note) {
                notes.push(note.into());
            }
        };
        if n_padded > 0 {
            note(
                "voxels of the padding value (0028,0120), or of its range to (0028,0121), which is as bright as bone, were set to air (-1024 HU)",
            );
        }
        if self.compression == (Compression::Jpeg2000 { is_lossy: true }) {
            note(
                "the pixels are in JPEG 2000 that may be lossy (1.2.840.10008.1.2.4.91); values may differ from the scanner's",
            );
        }
        if image.is_inverted {
            note("MONOCHROME1 says how the images are shown; their values are as stored, which programs of ITK invert");
        }
        Ok(values)
    }

    /// What is stored for each pixel.
    fn cells(&self, image: &Image) -> Result<Vec<u32>, String> {
        let size @ [nx, ny] = [image.n_columns, image.n_rows];
        let (n, width) = (nx * ny, image.bits.allocated as usize / 8);
        let little = |cell: &[u8]| cell.iter().rev().fold(0, |sum, byte| sum << 8 | u32::from(*byte));
        let promised = n.saturating_mul(width).saturating_mul(image.n_frames);
        if promised > self.bytes.len().saturating_mul(MAX_EXPANSION) {
            let n_frames = image.n_frames;
            return Err(format!(
                "cut short: {} bytes cannot hold {n_frames} frames of {nx} x {ny} pixels; copy the file again",
                self.bytes.len()
            ));
        }
        if self.is_items {
            let frame = self.frame(image)?;
            return match self.compression {
                Compression::RunLength => {
                    Ok(run_length::decode(&frame, n, width)?.chunks_exact(width).map(little).collect())
                }
                Compression::JpegLossless => jpeg_lossless::decode(&frame, size).map_err(|message| match message {
                    Unread::Kind(kind) => Remedy::Dcmtk("dcmdjpeg").sentence(kind, folder_of(&self.path)),
                    Unread::Broken(message) => message,
                }),
                Compression::Jpeg2000 { .. } => jpeg_2000::decode(&frame, size),
                Compression::Encapsulated | Compression::DeflatedFrames => {
                    let frame = match self.compression {
                        Compression::DeflatedFrames => inflated(&frame, n * width)?,
                        _ => frame,
                    };
                    let cells = frame.get(..n * width).ok_or_else(|| {
                        format!("cut short: {n} pixels of {width} bytes are needed, {} bytes are there; copy the file again", frame.len())
                    })?;
                    Ok(cells.chunks_exact(width).map(little).collect())
                }
                _ => Err(
                    "the pixels are in fragments, which this transfer syntax does not have; export the series again"
                        .into(),
                ),
            };
        }
        if !matches!(self.compression, Compression::None | Compression::Deflated) {
            return Err(
                "the pixels are not in fragments, as this transfer syntax has them; export the series again".into()
            );
        }
        if self.is_big && width == 1 {
            return Err(
                "pixels of 8 bits in big-endian order are not read; export the series in little-endian order".into()
            );
        }
        let all = &self.bytes[self.fragments[0].clone()];
        let start = image.frame * n * width;
        let bytes = all.get(start..start + n * width).ok_or_else(|| {
            let frames = if image.n_frames == 1 { String::new() } else { format!("{} frames of ", image.n_frames) };
            format!(
                "cut short: {frames}{nx} x {ny} pixels of {width} bytes are {}, {} are there; copy the file again",
                n * width * image.n_frames,
                all.len()
            )
        })?;
        let big = |cell: &[u8]| cell.iter().fold(0, |sum, byte| sum << 8 | u32::from(*byte));
        let cells = bytes.chunks_exact(width);
        Ok(if self.is_big { cells.map(big).collect() } else { cells.map(little).collect() })
    }

    /// The compressed bytes of a frame, from all its fragments.
    fn frame(&self, image: &Image) -> Result<Vec<u8>, String> {
        let part = |ranges: &[Range<usize>]| ranges.iter().flat_map(|r| &self.bytes[r.clone()]).copied().collect();
        let (n_frames, n) = (image.n_frames, self.fragments.len());
        if n_frames == 1 {
            return Ok(part(&self.fragments));
        }
        if n == n_frames {
            return Ok(part(&self.fragments[image.frame..=image.frame]));
        }
        if n > n_frames && self.offsets.len() == n_frames {
            // Each fragment counts with the eight bytes of its item.
            let starts = self.fragments.iter().scan(0u64, |at, range| {
                let start = *at;
                *at += 8 + range.len() as u64;
                Some(start)
            });
            let starts: Vec<u64> = starts.collect();
            let index = |offset: u64| starts.iter().position(|start| *start == offset);
            let first = index(self.offsets[image.frame]);
            let end = self.offsets.get(image.frame + 1).map_or(Some(n), |offset| index(*offset));
            if let (Some(first), Some(end)) = (first, end)
                && first < end
            {
                return Ok(part(&self.fragments[first..end]));
            }
        }
        Err(format!(
            "{n} fragments for {n_frames} frames, and no table that says which belong together; export the series again"
        ))
    }
}

/// At most `n` bytes of a frame that is deflated.
fn inflated(frame: &[u8], n: usize) -> Result<Vec<u8>, String> {
    let mut out = Vec::new();
    let read = DeflateDecoder::new(frame).take(n as u64).read_to_end(&mut out);
    read.map(|_| out).map_err(|error| format!("{error} in the deflated frame; copy the file again"))
}

fn eight(bytes: &[u8]) -> [u8; 8] {
    std::array::from_fn(|k| bytes[k])
}
