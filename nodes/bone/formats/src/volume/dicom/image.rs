//! One image: where it is, and its values.

use super::super::grid::VoxelUnit;
use super::elements::{DataSet, Element, fragments, text};
use crate::FileError;
use nalgebra::{Point3, Vector3};
use std::path::Path;

/// Directions are rounded to some digits; more than this off a right angle or off length 1 is no rounding.
const DIRECTION_TOLERANCE: f64 = 1e-3;

/// Geometry and scaling of one image.
#[derive(Debug, Clone)]
pub(super) struct Image {
    pub(super) modality: String,
    pub(super) series_uid: String,
    pub(super) series_number: Option<i64>,
    pub(super) frame_of_reference_uid: Option<String>,
    pub(super) n_rows: usize,
    pub(super) n_columns: usize,
    /// Centre of the first pixel, LPS, mm.
    pub(super) position: Point3<f64>,
    /// Direction of rising column index, a unit vector.
    pub(super) row: Vector3<f64>,
    /// Direction of rising row index, a unit vector.
    pub(super) column: Vector3<f64>,
    /// Between rows, and between columns, mm.
    pub(super) spacing_mm: [f64; 2],
    pub(super) thickness_mm: Option<f64>,
    slope: f64,
    intercept: f64,
    is_scaled: bool,
    rescale_type: Option<String>,
    bits: Bits,
}

/// How a value lies in its cell.
#[derive(Debug, Clone, Copy)]
struct Bits {
    allocated: u32,
    stored: u32,
    high: u32,
    is_signed: bool,
    /// A stored value that stands for no data.
    padding: Option<i64>,
}

/// The values of the elements that are used.
#[derive(Default)]
struct Elements {
    values: Vec<(u32, Vec<u8>)>,
    has_pixels: bool,
    has_frames: bool,
}

const USED: [u32; 23] = [
    0x0008_0016,
    0x0008_0060,
    0x0018_0050,
    0x0020_000e,
    0x0020_0011,
    0x0020_0032,
    0x0020_0037,
    0x0020_0052,
    0x0028_0002,
    0x0028_0004,
    0x0028_0008,
    0x0028_0010,
    0x0028_0011,
    0x0028_0030,
    0x0028_0100,
    0x0028_0101,
    0x0028_0102,
    0x0028_0103,
    0x0028_0120,
    0x0028_1052,
    0x0028_1053,
    0x0028_1054,
    0x0028_0301,
];

impl Elements {
    fn value(&self, tag: u32) -> Option<&[u8]> {
        self.values.iter().find(|(t, _)| *t == tag).map(|(_, v)| v.as_slice())
    }

    fn text(&self, tag: u32) -> Option<String> {
        self.value(tag).map(text).filter(|t| !t.is_empty())
    }

    /// Decimal numbers, separated by backslashes.
    fn decimals(&self, tag: u32) -> Result<Option<Vec<f64>>, String> {
        let Some(text) = self.text(tag) else { return Ok(None) };
        let number = |word: &str| word.trim().parse::<f64>().ok().filter(|n| n.is_finite());
        let numbers: Option<Vec<f64>> = text.split('\\').map(number).collect();
        numbers.map(Some).ok_or_else(|| format!("{} holds no decimal numbers", shown(tag)))
    }

    fn decimal(&self, tag: u32) -> Result<Option<f64>, String> {
        match self.decimals(tag)?.as_deref() {
            None => Ok(None),
            Some([one]) => Ok(Some(*one)),
            Some(other) => Err(format!("{} holds {} numbers; one is needed", shown(tag), other.len())),
        }
    }

    fn vector<const N: usize>(&self, tag: u32, name: &str) -> Result<[f64; N], String> {
        let missing = || format!("{} {name} is missing; without it nobody knows where the voxels are", shown(tag));
        let numbers = self.decimals(tag)?.ok_or_else(missing)?;
        let n = numbers.len();
        numbers.try_into().map_err(|_| format!("{} {name} holds {n} numbers; {N} are needed", shown(tag)))
    }

    fn u16(&self, tag: u32, is_big: bool) -> Option<u16> {
        let bytes: [u8; 2] = self.value(tag)?.get(..2)?.try_into().ok()?;
        Some(if is_big { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) })
    }
}

fn shown(tag: u32) -> String {
    format!("({:04x},{:04x})", tag >> 16, tag & 0xffff)
}

impl Image {
    /// The image in a file; `None` if it holds none.
    pub(super) fn read(path: &Path, file: &[u8]) -> Result<Option<Self>, FileError> {
        let set = DataSet::of_file(path, file)?;
        let is_big = set.syntax.is_big;
        let mut elements = Elements::default();
        let mut reader = set.reader();
        loop {
            let at = reader.at;
            let next = reader.next().map_err(|message| {
                FileError::content(path, format!("byte {}", set.start + at), format!("{message}; copy the file again"))
            })?;
            let Some(Element { tag, value, is_items }) = next else { break };
            match tag {
                // Functional groups of an enhanced image.
                0x5200_9229 | 0x5200_9230 => elements.has_frames = true,
                0x7fe0_0008 | 0x7fe0_0009 | 0x7fe0_0010 => elements.has_pixels = true,
                _ if USED.contains(&tag) && !is_items => {
                    if elements.value(tag).is_some() {
                        let message = format!("{} is given twice; export the image again", shown(tag));
                        return Err(FileError::content(path, format!("byte {}", set.start + at), message));
                    }
                    elements.values.push((tag, value[..value.len().min(256)].to_vec()))
                }
                _ => {}
            }
            if tag >= 0x7fe0_0010 {
                break;
            }
        }
        let class = elements.text(0x0008_0016).unwrap_or_default();
        if !elements.has_pixels || class == "1.2.840.10008.1.3.10" {
            return Ok(None);
        }
        Self::of(&elements, &class, is_big).map(Some).map_err(|message| FileError::content(path, "data set", message))
    }

    fn of(elements: &Elements, class: &str, is_big: bool) -> Result<Self, String> {
        let n_frames = elements.decimal(0x0028_0008)?.unwrap_or(1.0);
        let enhanced = match class {
            "1.2.840.10008.5.1.4.1.1.2.1" => Some("Enhanced CT Image"),
            "1.2.840.10008.5.1.4.1.1.2.2" => Some("Legacy Converted Enhanced CT Image"),
            "1.2.840.10008.5.1.4.1.1.4.1" => Some("Enhanced MR Image"),
            _ if elements.has_frames || n_frames > 1.0 => Some("a multi-frame image"),
            _ => None,
        };
        if let Some(name) = enhanced {
            return Err(format!(
                "{name} ({n_frames} frames in one file) is not read; export the series as one file per layer, or convert it to \
                 NIfTI with dcm2niix"
            ));
        }
        // Codes hold capitals, digits and blanks; anything else is not repeated.
        let code =
            |text: String| text.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_' || b == b' ').then_some(text);
        let modality =
            elements.text(0x0008_0060).and_then(code).filter(|m| m.len() <= 16).unwrap_or_else(|| "unknown".into());
        let photometric = elements.text(0x0028_0004).and_then(code).unwrap_or_default();
        let samples = elements.u16(0x0028_0002, is_big).unwrap_or(1);
        if samples != 1 || !photometric.starts_with("MONOCHROME") {
            return Err(format!(
                "{samples} samples per pixel, photometric interpretation \"{photometric}\": a picture in colours holds no density; \
                 choose the series of the CT itself"
            ));
        }
        let needed = |tag: u32, name: &str| {
            elements
                .u16(tag, is_big)
                .ok_or_else(|| format!("{} {name} is missing; is it an image of a scanner?", shown(tag)))
        };
        let (n_rows, n_columns) = (needed(0x0028_0010, "Rows")?, needed(0x0028_0011, "Columns")?);
        if n_rows == 0 || n_columns == 0 {
            return Err(format!("{n_columns} columns and {n_rows} rows; at least one of each is needed"));
        }
        let allocated = u32::from(needed(0x0028_0100, "BitsAllocated")?);
        let stored = elements.u16(0x0028_0101, is_big).map_or(allocated, u32::from);
        let high = elements.u16(0x0028_0102, is_big).map_or(stored.saturating_sub(1), u32::from);
        if !matches!(allocated, 8 | 16 | 32)
            || stored == 0
            || stored > allocated
            || high >= allocated
            || high + 1 < stored
        {
            return Err(format!("{stored} bits stored up to bit {high} of {allocated}: 8, 16 or 32 bits are read"));
        }
        let is_signed = elements.u16(0x0028_0103, is_big) == Some(1);
        let mut bits = Bits { allocated, stored, high, is_signed, padding: None };
        bits.padding =
            elements.u16(0x0028_0120, is_big).filter(|_| allocated == 16).map(|raw| bits.value(u32::from(raw)));
        let [rx, ry, rz, cx, cy, cz] = elements.vector(0x0020_0037, "ImageOrientationPatient")?;
        let (row, column) = (Vector3::new(rx, ry, rz), Vector3::new(cx, cy, cz));
        let off = (row.norm() - 1.0).abs().max((column.norm() - 1.0).abs()).max(row.dot(&column).abs());
        if off.is_nan() || off >= DIRECTION_TOLERANCE {
            return Err(format!(
                "(0020,0037) ImageOrientationPatient: the directions of rows and columns are {off:.4} off unit length or a right angle"
            ));
        }
        let spacing_mm: [f64; 2] = elements.vector(0x0028_0030, "PixelSpacing")?;
        if spacing_mm.iter().any(|s| *s <= 0.0) {
            return Err("(0028,0030) PixelSpacing is not positive".into());
        }
        let (slope, intercept) = (elements.decimal(0x0028_1053)?, elements.decimal(0x0028_1052)?);
        if slope == Some(0.0) {
            return Err("(0028,1053) RescaleSlope is 0, which makes all values equal".into());
        }
        let uid = |tag: u32| elements.text(tag).filter(|uid| uid.bytes().all(|b| b.is_ascii_digit() || b == b'.'));
        Ok(Self {
            modality,
            series_uid: uid(0x0020_000e).unwrap_or_default(),
            frame_of_reference_uid: uid(0x0020_0052),
            series_number: elements.text(0x0020_0011).and_then(|t| t.parse().ok()),
            n_rows: n_rows.into(),
            n_columns: n_columns.into(),
            position: elements.vector(0x0020_0032, "ImagePositionPatient")?.into(),
            row: row.normalize(),
            column: column.normalize(),
            spacing_mm,
            thickness_mm: elements.decimal(0x0018_0050).ok().flatten(),
            slope: slope.unwrap_or(1.0),
            intercept: intercept.unwrap_or(0.0),
            is_scaled: slope.is_some() && intercept.is_some(),
            rescale_type: elements.text(0x0028_1054).and_then(code),
            bits,
        })
    }

    /// HU for a CT that says how its values are scaled.
    pub(super) fn unit(&self) -> VoxelUnit {
        let is_hu = self.rescale_type.as_deref().is_none_or(|kind| kind == "HU");
        if self.modality == "CT" && self.is_scaled && is_hu { VoxelUnit::Hu } else { VoxelUnit::Unknown }
    }

    /// The values, columns fastest.
    pub(super) fn voxels(&self, path: &Path, file: &[u8], notes: &mut Vec<String>) -> Result<Vec<f32>, FileError> {
        let set = DataSet::of_file(path, file)?;
        let fault = |message: String| FileError::content(path, "(7fe0,0010) pixel data", message);
        let mut reader = set.reader();
        let pixels = loop {
            match reader.next().map_err(fault)? {
                Some(element) if element.tag == 0x7fe0_0010 => break element,
                Some(_) => {}
                None => {
                    return Err(fault(
                        "floating-point pixels are not read; export the series as 16-bit integers".into(),
                    ));
                }
            }
        };
        let n = self.n_rows * self.n_columns;
        let width = self.bits.allocated as usize / 8;
        let [nx, ny] = [self.n_columns, self.n_rows];
        let decoded;
        let bytes = if pixels.is_items {
            if !set.syntax.is_run_length {
                return Err(fault(
                    "the pixels are in fragments, which this transfer syntax does not have; export the series again"
                        .into(),
                ));
            }
            decoded = run_length(&fragments(pixels.value).map_err(fault)?.concat(), n, width).map_err(fault)?;
            &decoded
        } else {
            pixels.value
        };
        if bytes.len() < n * width {
            let message = format!(
                "cut short: {nx} x {ny} pixels of {width} bytes are {}, {} are there; copy the file again",
                n * width,
                bytes.len()
            );
            return Err(fault(message));
        }
        let is_big = set.syntax.is_big;
        let raw = |cell: &[u8]| {
            let at = |k: usize| u32::from(cell[if is_big { width - 1 - k } else { k }]);
            (0..width).fold(0, |sum, k| sum | at(k) << (8 * k))
        };
        let mut n_padded = 0usize;
        let voxels: Vec<f32> = bytes
            .chunks_exact(width)
            .take(n)
            .map(|cell| {
                let stored = self.bits.value(raw(cell));
                let value = (self.slope * stored as f64 + self.intercept) as f32;
                // Padding that would be bone is no tissue; lower padding does no harm.
                if self.bits.padding == Some(stored) && value > 0.0 && self.unit() == VoxelUnit::Hu {
                    n_padded += 1;
                    return -1024.0;
                }
                value
            })
            .collect();
        if n_padded > 0 {
            let note =
                "voxels of the padding value (0028,0120), which is as bright as bone, were set to air (-1024 HU)";
            if notes.iter().all(|known| known != note) {
                notes.push(note.into());
            }
        }
        Ok(voxels)
    }
}

impl Bits {
    /// The stored value in a cell.
    fn value(&self, cell: u32) -> i64 {
        let shifted = u64::from(cell) >> (self.high + 1 - self.stored);
        let value = (shifted & ((1u64 << self.stored) - 1)) as i64;
        if self.is_signed && value >> (self.stored - 1) & 1 == 1 { value - (1i64 << self.stored) } else { value }
    }
}

/// Decodes one frame: segments of the most significant bytes first, each packed.
fn run_length(frame: &[u8], n: usize, width: usize) -> Result<Vec<u8>, String> {
    let word = |k: usize| frame.get(4 * k..4 * k + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    let n_segments = word(0).ok_or("the run-length header is cut short")?;
    if n_segments != width {
        return Err(format!("{n_segments} run-length segments for values of {width} bytes"));
    }
    // Packing gives at most 128 bytes for two.
    if n * width > frame.len().saturating_mul(64) {
        return Err(format!("cut short: {} run-length bytes cannot hold {n} values of {width} bytes", frame.len()));
    }
    let mut cells = vec![0u8; n * width];
    for segment in 0..width {
        let start = word(segment + 1).unwrap_or(usize::MAX);
        let end = if segment + 1 < width { word(segment + 2).unwrap_or(0) } else { frame.len() };
        let packed =
            frame.get(start..end).filter(|_| start >= 64).ok_or("a run-length segment lies outside the frame")?;
        let (mut at, mut filled) = (0, 0);
        let place = |k: usize| k * width + (width - 1 - segment);
        while filled < n {
            let control = *packed
                .get(at)
                .ok_or_else(|| format!("cut short: run-length segment {segment} gives {filled} of {n} bytes"))?;
            at += 1;
            match control as i8 {
                count @ 0.. => {
                    let literal = packed.get(at..at + count as usize + 1).ok_or("a literal run is cut short")?;
                    for byte in literal.iter().take(n - filled) {
                        cells[place(filled)] = *byte;
                        filled += 1;
                    }
                    at += literal.len();
                }
                -128 => {}
                count => {
                    let byte = *packed.get(at).ok_or("a repeated run is cut short")?;
                    at += 1;
                    for _ in 0..(1 - i32::from(count)).min((n - filled) as i32) {
                        cells[place(filled)] = byte;
                        filled += 1;
                    }
                }
            }
        }
    }
    Ok(cells)
}
