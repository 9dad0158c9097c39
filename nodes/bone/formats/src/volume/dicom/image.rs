//! One layer: where it is, and how its values are stored.

use super::super::{data::folder_of, grid::VoxelUnit};
use super::attributes::{Attributes, shown};
use super::elements::{DataSet, Element};
use super::syntax::Compression;
use crate::FileError;
use nalgebra::{Point3, Vector3};
use std::path::Path;

/// Directions are rounded to some digits; more than this off a right angle or off length 1 is no rounding.
const DIRECTION_TOLERANCE: f64 = 1e-3;
/// More frames are not in one file.
const MAX_FRAMES: f64 = 65_536.0;

/// Endings of the classes of CT, MR and PET, of one layer and enhanced.
const OF_SCANNER: [&str; 9] = ["2", "2.1", "2.2", "4", "4.1", "4.4", "128", "128.1", "130"];

/// What tells scans of one series apart.
pub(super) const PHASES: [&str; 4] = ["acquisition", "time", "stack", "kernel"];

/// Which series a file belongs to.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Identity {
    pub(super) modality: String,
    pub(super) series_uid: String,
    pub(super) series_number: Option<i64>,
}

/// What a file holds.
pub(super) enum Found {
    /// No pixels: a report, a structure set, the index of a medium.
    Nothing,
    /// Layers of a volume.
    Layers(Vec<Image>),
    /// Pixels that are no layer of a volume, and why.
    NoLayer(Identity, String),
    /// A layer that cannot be read, and why.
    Faulty(Identity, FileError),
}

/// Geometry and scaling of one layer.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Image {
    pub(super) identity: Identity,
    pub(super) frame_of_reference_uid: Option<String>,
    /// Which frame of its file, and of how many.
    pub(super) frame: usize,
    pub(super) n_frames: usize,
    pub(super) is_localizer: bool,
    /// What tells layers at one place apart, see [`PHASES`].
    pub(super) phase: [Option<String>; PHASES.len()],
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
    pub(super) slope: f64,
    pub(super) intercept: f64,
    is_scaled: bool,
    rescale_type: Option<String>,
    pub(super) is_inverted: bool,
    pub(super) bits: Bits,
}

/// How a value lies in its cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Bits {
    pub(super) allocated: u32,
    stored: u32,
    high: u32,
    is_signed: bool,
    /// The least and the most stored value that stands for no data.
    pub(super) padding: Option<[i64; 2]>,
}

/// What a file says about its pixels, before anything is made of it.
struct Content {
    data_set: Attributes,
    shared: Attributes,
    frames: Vec<Attributes>,
    has_groups: bool,
    has_pixels: bool,
    compression: Compression,
}

impl Content {
    fn read(path: &Path, file: &[u8]) -> Result<Self, FileError> {
        let set = DataSet::of_file(path, file)?;
        let mut content = Self {
            data_set: Attributes::new(set.syntax.is_big),
            shared: Attributes::new(set.syntax.is_big),
            frames: Vec::new(),
            has_groups: false,
            has_pixels: false,
            compression: set.compression,
        };
        let mut reader = set.reader();
        loop {
            let at = reader.at;
            let fault = |message: String| FileError::content(path, format!("byte {}", set.start + at), message);
            let next = reader.next().map_err(|message| fault(format!("{message}; copy the file again")))?;
            let Some(element) = next else { return Ok(content) };
            let taken = content.take(&element).map_err(fault)?;
            if !taken {
                return Ok(content);
            }
        }
    }

    /// Takes an element; false at the pixels, behind which nothing is of use.
    fn take(&mut self, element: &Element<'_>) -> Result<bool, String> {
        match element.tag {
            0x5200_9229 => {
                self.has_groups = true;
                self.shared = Attributes::of_groups(element)?.into_iter().next().unwrap_or_default();
            }
            0x5200_9230 => {
                self.has_groups = true;
                self.frames = Attributes::of_groups(element)?;
            }
            0x7fe0_0008 | 0x7fe0_0009 => self.has_pixels = true,
            0x7fe0_0010.. => {
                self.has_pixels |= element.tag == 0x7fe0_0010;
                return Ok(false);
            }
            _ => self.data_set.take(element)?,
        }
        Ok(true)
    }
}

impl Found {
    /// What is in a file.
    ///
    /// # Errors
    /// It cannot be read so far that its series is known.
    pub(super) fn read(path: &Path, file: &[u8]) -> Result<Self, FileError> {
        let content = Content::read(path, file)?;
        let class = content.data_set.text(0x0008_0016).unwrap_or_default();
        if !content.has_pixels || class == "1.2.840.10008.1.3.10" {
            return Ok(Self::Nothing);
        }
        let modality = content.data_set.code(0x0008_0060).filter(|m| m.len() <= 16);
        let identity = Identity {
            modality: modality.unwrap_or_else(|| "unknown".into()),
            series_uid: content.data_set.uid(0x0020_000e).unwrap_or_default(),
            series_number: content.data_set.text(0x0020_0011).and_then(|t| t.parse().ok()),
        };
        if let Some(why) = no_layer(&content, &class) {
            return Ok(Self::NoLayer(identity, why));
        }
        let fault = |place: &str, message: String| FileError::content(path, place, message);
        if let Some(message) = content.compression.refusal(folder_of(path)) {
            return Ok(Self::Faulty(identity, fault("(0002,0010) transfer syntax", message)));
        }
        Ok(match layers(content, &class, &identity) {
            Ok(layers) => Self::Layers(layers),
            Err(message) => Self::Faulty(identity, fault("data set", message)),
        })
    }
}

/// Why pixels are no layer of a volume, such as a page of text; none if they may be one.
fn no_layer(content: &Content, class: &str) -> Option<String> {
    let set = &content.data_set;
    let photometric = set.code(0x0028_0004).unwrap_or_default();
    let samples = set.u16(0x0028_0002).unwrap_or(1);
    if samples != 1 || !(photometric.is_empty() || photometric.starts_with("MONOCHROME")) {
        return Some(format!(
            "{samples} samples per pixel, photometric interpretation \"{photometric}\": a picture in colours holds no density"
        ));
    }
    let is_of_scanner = OF_SCANNER.iter().any(|end| class.strip_prefix("1.2.840.10008.5.1.4.1.1.") == Some(end));
    if is_of_scanner {
        return None;
    }
    let modality = set.code(0x0008_0060);
    if let Some(other) = modality.filter(|m| !["CT", "MR", "PT"].contains(&m.as_str())) {
        return Some(format!("modality {other}, which is none of CT, MR and PET"));
    }
    let has = |tag: u32| set.has(tag) || content.shared.has(tag) || content.frames.iter().any(|f| f.has(tag));
    let is_placed = has(0x0020_0032) || has(0x0020_0037);
    (!is_placed).then(|| "no place in the patient is stated, as of a picture that was captured from a screen".into())
}

/// The layers in a file: one, or each frame of an enhanced image.
fn layers(content: Content, class: &str, identity: &Identity) -> Result<Vec<Image>, String> {
    let Content { data_set, shared, frames, has_groups, .. } = content;
    let n_frames = data_set.decimal(0x0028_0008)?.unwrap_or(1.0);
    if !has_groups {
        let name = match class {
            "1.2.840.10008.5.1.4.1.1.2.1" => "an Enhanced CT Image",
            "1.2.840.10008.5.1.4.1.1.2.2" => "a Legacy Converted Enhanced CT Image",
            _ if n_frames != 1.0 => "a multi-frame image",
            _ => return Ok(vec![Image::of(&data_set, identity, 0, 1)?]),
        };
        return Err(format!(
            "{name} of {n_frames} frames without (5200,9230), which says where each frame is; export the series as one file per layer"
        ));
    }
    if n_frames.fract() != 0.0 || !(1.0..=MAX_FRAMES).contains(&n_frames) {
        return Err(format!("(0028,0008) NumberOfFrames is {n_frames}; a whole number from 1 is needed"));
    }
    let n_frames = n_frames as usize;
    if frames.len() != n_frames {
        return Err(format!(
            "(5200,9230) says where {} frames are, but (0028,0008) NumberOfFrames is {n_frames}; export the series again",
            frames.len()
        ));
    }
    let of_all = shared.before(&data_set);
    let image = |(k, frame): (usize, Attributes)| {
        Image::of(&frame.before(&of_all), identity, k, n_frames)
            .map_err(|message| format!("frame {}: {message}", k + 1))
    };
    frames.into_iter().enumerate().map(image).collect()
}

impl Image {
    fn of(attributes: &Attributes, identity: &Identity, frame: usize, n_frames: usize) -> Result<Self, String> {
        let (n_rows, n_columns) = (attributes.needed(0x0028_0010, "Rows")?, attributes.needed(0x0028_0011, "Columns")?);
        if n_rows == 0 || n_columns == 0 {
            return Err(format!("{n_columns} columns and {n_rows} rows; at least one of each is needed"));
        }
        let bits = Bits::of(attributes)?;
        let [rx, ry, rz, cx, cy, cz] = attributes.vector(0x0020_0037, "ImageOrientationPatient")?;
        let (row, column) = (Vector3::new(rx, ry, rz), Vector3::new(cx, cy, cz));
        let off = (row.norm() - 1.0).abs().max((column.norm() - 1.0).abs()).max(row.dot(&column).abs());
        if off.is_nan() || off >= DIRECTION_TOLERANCE {
            return Err(format!(
                "(0020,0037) ImageOrientationPatient: the directions of rows and columns are {off:.4} off unit length or a right angle"
            ));
        }
        let spacing_mm: [f64; 2] = attributes.vector(0x0028_0030, "PixelSpacing")?;
        if spacing_mm.iter().any(|s| *s <= 0.0) {
            return Err("(0028,0030) PixelSpacing is not positive".into());
        }
        let (slope, intercept) = (attributes.decimal(0x0028_1053)?, attributes.decimal(0x0028_1052)?);
        if slope == Some(0.0) {
            return Err("(0028,1053) RescaleSlope is 0, which makes all values equal".into());
        }
        if attributes.has(0x0028_3000) && slope.is_none() {
            let tag = shown(0x0028_3000);
            return Err(format!(
                "{tag}: the values are given by a table instead of a slope, which is not read; export the series with RescaleSlope"
            ));
        }
        let kind = attributes.code(0x0008_0008).unwrap_or_default();
        let number = |tag: u32| attributes.u32(tag).map(|n| n.to_string());
        Ok(Self {
            identity: identity.clone(),
            frame_of_reference_uid: attributes.uid(0x0020_0052),
            frame,
            n_frames,
            is_localizer: kind.split('\\').any(|value| value.trim() == "LOCALIZER"),
            phase: [
                attributes.code(0x0020_0012).or_else(|| attributes.u16(0x0020_9156).map(|n| n.to_string())),
                attributes.code(0x0020_0100).or_else(|| number(0x0020_9128)),
                attributes.code(0x0020_9056),
                attributes.code(0x0018_1210),
            ],
            n_rows: n_rows.into(),
            n_columns: n_columns.into(),
            position: attributes.vector(0x0020_0032, "ImagePositionPatient")?.into(),
            row: row.normalize(),
            column: column.normalize(),
            spacing_mm,
            thickness_mm: attributes.decimal(0x0018_0050).ok().flatten(),
            slope: slope.unwrap_or(1.0),
            intercept: intercept.unwrap_or(0.0),
            is_scaled: slope.is_some() && intercept.is_some(),
            rescale_type: attributes.code(0x0028_1054),
            is_inverted: attributes.code(0x0028_0004).is_some_and(|kind| kind.trim() == "MONOCHROME1"),
            bits,
        })
    }

    /// HU for a CT that says how its values are scaled.
    pub(super) fn unit(&self) -> VoxelUnit {
        let is_hu = self.rescale_type.as_deref().is_none_or(|kind| kind == "HU");
        if self.identity.modality == "CT" && self.is_scaled && is_hu { VoxelUnit::Hu } else { VoxelUnit::Unknown }
    }

    /// Whether the file leaves the unit of its scaled values open, as GDCM and ITK write it.
    pub(super) fn is_unspecified(&self) -> bool {
        self.identity.modality == "CT" && self.is_scaled && self.rescale_type.as_deref() == Some("US")
    }

    /// Along the normal of the layer, mm.
    pub(super) fn height(&self, normal: &Vector3<f64>) -> f64 {
        self.position.coords.dot(normal)
    }
}

impl Bits {
    fn of(attributes: &Attributes) -> Result<Self, String> {
        let allocated = u32::from(attributes.needed(0x0028_0100, "BitsAllocated")?);
        let stored = attributes.u16(0x0028_0101).map_or(allocated, u32::from);
        let high = attributes.u16(0x0028_0102).map_or(stored.saturating_sub(1), u32::from);
        if !matches!(allocated, 8 | 16 | 32)
            || stored == 0
            || stored > allocated
            || high >= allocated
            || high + 1 < stored
        {
            return Err(format!("{stored} bits stored up to bit {high} of {allocated}: 8, 16 or 32 bits are read"));
        }
        let is_signed = attributes.u16(0x0028_0103) == Some(1);
        let mut bits = Self { allocated, stored, high, is_signed, padding: None };
        let value = |tag| attributes.u16(tag).filter(|_| allocated == 16).map(|raw| bits.value(u32::from(raw)));
        // The limit of the range may be below its first value.
        bits.padding = value(0x0028_0120).map(|first| {
            let last = value(0x0028_0121).unwrap_or(first);
            [first.min(last), first.max(last)]
        });
        Ok(bits)
    }

    /// The stored value in a cell.
    pub(super) fn value(&self, cell: u32) -> i64 {
        let shifted = u64::from(cell) >> (self.high + 1 - self.stored);
        let value = (shifted & ((1u64 << self.stored) - 1)) as i64;
        if self.is_signed && value >> (self.stored - 1) & 1 == 1 { value - (1i64 << self.stored) } else { value }
    }
}
