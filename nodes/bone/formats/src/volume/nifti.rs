//! NIfTI-1 and NIfTI-2, plain or gzip, in both byte orders.
//!
//! # Source
//! nifti1.h and nifti2.h of the NIfTI Data Format Working Group. The header is a table of 348 or 540 bytes, of which ten
//! fields are needed; a crate would bring an array library along for them.

use super::grid::{Volume, VolumeRead, affine, assumed_unit, n_voxels_and_bytes};
use super::numbers::{Encoding, StreamError, drain, gzip_limit, read_all};
use crate::scalar::Scalar;
use crate::{FileError, input};
use flate2::read::MultiGzDecoder;
use nalgebra::{Matrix3, Matrix4, Quaternion, Vector4};
use osteoflow_geometry::nearest_rotation;
use std::{
    io::{BufRead, BufReader, Read},
    path::Path,
};

/// RAS, the space of NIfTI, to LPS.
const RAS: [f64; 3] = [-1.0, -1.0, 1.0];

/// Two maps of one file that differ by more than this share of a voxel disagree.
const AGREEMENT: f64 = 0.1;

/// Whether a file begins like a NIfTI header.
pub(super) fn is_nifti(start: &[u8]) -> bool {
    version_and_order(start).is_some()
}

/// The version and whether the byte order is big, from the header's own size in its first four bytes.
fn version_and_order(start: &[u8]) -> Option<(u8, bool)> {
    let first: [u8; 4] = start.get(..4)?.try_into().ok()?;
    match (i32::from_le_bytes(first), i32::from_be_bytes(first)) {
        (348, _) => Some((1, false)),
        (_, 348) => Some((1, true)),
        (540, _) => Some((2, false)),
        (_, 540) => Some((2, true)),
        _ => None,
    }
}

/// The fields of a complete header, of either version.
struct Header {
    bytes: Vec<u8>,
    is_big: bool,
    version: u8,
}

impl Header {
    fn ordered<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut bytes: [u8; N] = std::array::from_fn(|k| self.bytes[at + k]);
        if self.is_big {
            bytes.reverse();
        }
        bytes
    }

    fn i16(&self, at: usize) -> i64 {
        i64::from(i16::from_le_bytes(self.ordered(at)))
    }

    fn i32(&self, at: usize) -> i64 {
        i64::from(i32::from_le_bytes(self.ordered(at)))
    }

    /// The number at `one` (single precision) in version 1, `two` (double) in version 2.
    fn float(&self, one: usize, two: usize) -> f64 {
        match self.version {
            1 => f64::from(f32::from_le_bytes(self.ordered(one))),
            _ => f64::from_le_bytes(self.ordered(two)),
        }
    }

    fn dim(&self, k: usize) -> i64 {
        match self.version {
            1 => self.i16(40 + 2 * k),
            _ => i64::from_le_bytes(self.ordered(16 + 8 * k)),
        }
    }

    fn pixdim(&self, k: usize) -> f64 {
        self.float(76 + 4 * k, 104 + 8 * k)
    }

    /// Datatype and bits per voxel.
    fn datatype(&self) -> (i64, i64) {
        let at = if self.version == 1 { 70 } else { 12 };
        (self.i16(at), self.i16(at + 2))
    }

    /// qform_code and sform_code.
    fn codes(&self) -> (i64, i64) {
        if self.version == 1 { (self.i16(252), self.i16(254)) } else { (self.i32(344), self.i32(348)) }
    }
}

/// What the file can hold.
struct Limits {
    file_bytes: u64,
    /// At most, decompressed.
    stream_bytes: u64,
    is_gzip: bool,
}

/// Reads a .nii or .nii.gz file.
pub(super) fn read(path: &Path) -> Result<VolumeRead, FileError> {
    let file = input::open(path)?;
    let file_bytes = file.metadata().map_err(FileError::read(path))?.len();
    let mut reader = BufReader::with_capacity(1 << 16, file);
    let is_gzip = reader.fill_buf().map_err(FileError::read(path))?.starts_with(&[0x1f, 0x8b]);
    if is_gzip {
        read_stream(
            path,
            &mut MultiGzDecoder::new(reader),
            &Limits { file_bytes, stream_bytes: gzip_limit(file_bytes), is_gzip },
        )
    } else {
        read_stream(path, &mut reader, &Limits { file_bytes, stream_bytes: file_bytes, is_gzip })
    }
}

fn read_stream(path: &Path, reader: &mut impl Read, limits: &Limits) -> Result<VolumeRead, FileError> {
    let fault = |place: &str, message: String| FileError::content(path, place, message);
    let broken = |error: std::io::Error| fault("gzip", format!("{error}; copy the file again"));
    let header = Header::read(reader).map_err(|(place, message)| fault(place, message))?;
    let layout = header.layout(limits).map_err(|(place, message)| fault(&place, message))?;
    let Layout { size: [nx, ny, nz], n, n_bytes, offset, scalar } = layout;
    let n_header = header.n_bytes() as u64;
    let n_skipped = drain(reader, offset - n_header).map_err(broken)?;
    if n_skipped < offset - n_header {
        let message = format!("cut short: the file ends after {} bytes, before its voxels", n_skipped + n_header);
        return Err(fault("vox_offset", message));
    }

    let mut notes = Vec::new();
    let (mut slope, mut intercept) = (header.float(112, 176), header.float(116, 184));
    if slope == 0.0 || !slope.is_finite() || !intercept.is_finite() {
        if slope != 0.0 {
            notes.push("scl_slope or scl_inter is not finite; values were not scaled".into());
        }
        (slope, intercept) = (1.0, 0.0);
    }
    let unit_mm = header.unit_mm(&mut notes).map_err(|message| fault("xyzt_units", message))?;
    let placed = placement(&header, layout.size, unit_mm, &mut notes);
    let (t_lps_voxel, is_oriented) = placed.map_err(|(place, message)| fault(place, message))?;

    let encoding = Encoding { scalar, is_big: header.is_big, slope, intercept };
    let (voxels, n_extra) = read_all(reader, n, &encoding).map_err(|error| match error {
        StreamError::Short(n_there) => {
            let there = n_there * scalar.n_bytes();
            let message = format!(
                "cut short: {nx} x {ny} x {nz} voxels are {n_bytes} bytes, but only {there} are there; copy the file again"
            );
            fault(&format!("byte {}", offset + there as u64), message)
        }
        StreamError::Io(error) => broken(error),
    })?;
    if n_extra > 0 {
        let total = offset + n_bytes;
        notes.push(format!("{n_extra} bytes or more follow the {total} bytes of the volume and were not read"));
    }
    let unit = assumed_unit(&voxels, "NIfTI", &mut notes);
    let volume = Volume { size: layout.size, voxels, t_lps_voxel, unit, is_oriented };
    Ok(VolumeRead { volume, source: format!("NIfTI-{}", header.version), notes, frame_of_reference_uid: None })
}

/// Where the voxels are in the stream, and how they are stored.
struct Layout {
    size: [usize; 3],
    /// Number of voxels.
    n: usize,
    /// Their bytes.
    n_bytes: u64,
    /// The byte at which they begin.
    offset: u64,
    scalar: Scalar,
}

impl Header {
    /// Reads a header of either version.
    ///
    /// # Errors
    /// The field and a message.
    fn read(reader: &mut impl Read) -> Result<Self, (&'static str, String)> {
        let mut bytes = Vec::new();
        // What stops a stream early shows in the number of bytes.
        let _ = reader.by_ref().take(4).read_to_end(&mut bytes);
        let (version, is_big) = version_and_order(&bytes).ok_or_else(|| {
            let message = match bytes[..] {
                [0, 0, 0, 1] => "an MGZ of FreeSurfer is not read; convert it to .nii.gz (mri_convert)",
                _ => "the first four bytes are not 348 or 540, the size of a NIfTI header; of gzip files only .nii.gz is read",
            };
            ("byte 0", message.to_owned())
        })?;
        let n_bytes = if version == 1 { 348 } else { 540 };
        let _ = reader.by_ref().take(n_bytes as u64 - 4).read_to_end(&mut bytes);
        let n = bytes.len();
        if n < n_bytes {
            return Err(("header", format!("the header has {n_bytes} bytes, but the file ends after {n}")));
        }
        let (magic, expected) = if version == 1 { (&bytes[344..348], b"n+1\0") } else { (&bytes[4..8], b"n+2\0") };
        if magic == b"ni1\0" || magic == b"ni2\0" {
            let message = "this is the header of a pair .hdr/.img; convert the pair to one .nii file";
            return Err(("magic", message.into()));
        }
        if magic != expected {
            let message = "the magic is not \"n+1\" or \"n+2\"; an ANALYZE 7.5 header states no orientation: convert the DICOM \
                           to NIfTI";
            return Err(("magic", message.into()));
        }
        Ok(Self { bytes, is_big, version })
    }

    fn n_bytes(&self) -> usize {
        if self.version == 1 { 348 } else { 540 }
    }

    /// Size and place of the voxels, which the file can hold.
    ///
    /// # Errors
    /// The field and a message.
    fn layout(&self, limits: &Limits) -> Result<Layout, (String, String)> {
        let fault = |place: &str, message: String| Err((place.to_owned(), message));
        let n_dims = self.dim(0);
        if !(1..=7).contains(&n_dims) {
            return fault("dim[0]", format!("{n_dims} dimensions; 1 to 7 are possible"));
        }
        let dims: [i64; 7] = std::array::from_fn(|k| if (k as i64) < n_dims { self.dim(k + 1) } else { 1 });
        if let Some(k) = dims.iter().position(|d| *d < 1) {
            let message = format!("{} voxels along this axis; at least 1 is needed", dims[k]);
            return fault(&format!("dim[{}]", k + 1), message);
        }
        let [nx, ny, nz, ..] = dims;
        if dims[3..].iter().any(|d| *d != 1) {
            let n_frames = dims[3..].iter().fold(1i64, |n, d| n.saturating_mul(*d));
            let message = format!(
                "{n_dims} dimensions: {n_frames} frames of {nx} x {ny} x {nz} voxels; save the one frame that shows the bone as a \
                 volume of its own"
            );
            return fault("dim", message);
        }
        let (datatype, bits) = self.datatype();
        let scalar = number_type(datatype).map_err(|message| ("datatype".to_owned(), message))?;
        if bits != 8 * scalar.n_bytes() as i64 {
            let message = format!("{bits} bits per voxel, but datatype {datatype} has {}", 8 * scalar.n_bytes());
            return fault("bitpix", message);
        }
        let size = [nx, ny, nz].map(|d| usize::try_from(d).unwrap_or(usize::MAX));
        let offset = match self.version {
            1 => self.float(108, 0),
            _ => i64::from_le_bytes(self.ordered(168)) as f64,
        };
        let n_header = self.n_bytes();
        if !(n_header as f64..1e12).contains(&offset) || offset.fract() != 0.0 {
            let message = format!("voxels begin at byte {offset}, but the header has {n_header} bytes");
            return fault("vox_offset", message);
        }
        let offset = offset as u64;
        let counted = n_voxels_and_bytes(size, scalar.n_bytes());
        let total = counted.and_then(|(_, n_bytes)| n_bytes.checked_add(offset));
        match counted.filter(|_| total.is_some_and(|total| total <= limits.stream_bytes)) {
            Some((n, n_bytes)) => Ok(Layout { size, n, n_bytes, offset, scalar }),
            None => {
                let there = match limits.is_gzip {
                    true => format!("{} bytes of gzip cannot hold them", limits.file_bytes),
                    false => format!("the file has {}", limits.file_bytes),
                };
                let needed = total.map_or("more bytes than can be counted".into(), |total| format!("{total} bytes"));
                let message =
                    format!("cut short: {nx} x {ny} x {nz} voxels need {needed}, {there}; copy the file again");
                fault("dim", message)
            }
        }
    }

    /// The unit of length.
    fn unit_mm(&self, notes: &mut Vec<String>) -> Result<f64, String> {
        // Version 1 has one byte, version 2 an integer.
        let unit = if self.version == 1 { i64::from(self.bytes[123]) } else { self.i32(500) } & 7;
        Ok(match unit {
            1 => 1000.0,
            2 => 1.0,
            3 => 0.001,
            0 => {
                notes.push("the unit of length is not stated (xyzt_units); millimetres were assumed".into());
                1.0
            }
            other => return Err(format!("{other} is no unit of length; 1 (m), 2 (mm) and 3 (um) are")),
        })
    }
}

fn number_type(datatype: i64) -> Result<Scalar, String> {
    let name = match datatype {
        2 => return Ok(Scalar::U8),
        4 => return Ok(Scalar::I16),
        8 => return Ok(Scalar::I32),
        16 => return Ok(Scalar::F32),
        64 => return Ok(Scalar::F64),
        256 => return Ok(Scalar::I8),
        512 => return Ok(Scalar::U16),
        768 => return Ok(Scalar::U32),
        1024 => return Ok(Scalar::I64),
        1280 => return Ok(Scalar::U64),
        32 | 1792 | 2048 => "complex numbers",
        128 | 2304 => "colours",
        1536 => "128-bit floats",
        1 => "single bits",
        _ => "unknown",
    };
    Err(format!("datatype {datatype} ({name}) is not read; save the volume as 16-bit integers or floats"))
}

/// The map from voxels to LPS, mm, and whether the orientation is stated.
fn placement(
    header: &Header,
    size: [usize; 3],
    unit_mm: f64,
    notes: &mut Vec<String>,
) -> Result<(Matrix4<f64>, bool), (&'static str, String)> {
    let scaled = |mut t: Matrix4<f64>| {
        t.fixed_view_mut::<3, 4>(0, 0).scale_mut(unit_mm);
        t
    };
    let (qform_code, sform_code) = header.codes();
    let spacing: [f64; 3] = std::array::from_fn(|k| header.pixdim(k + 1));
    let is_spaced = spacing.iter().all(|s| s.is_finite() && *s > 0.0);
    let sform = (sform_code > 0).then(|| {
        let row = |k: usize| std::array::from_fn(|c| header.float(280 + 16 * k + 4 * c, 400 + 32 * k + 8 * c));
        let rows: [[f64; 4]; 3] = [row(0), row(1), row(2)];
        let axes = std::array::from_fn(|c| std::array::from_fn(|r| rows[r][c]));
        scaled(affine(axes, std::array::from_fn(|r| rows[r][3]), RAS))
    });
    let qform = (qform_code > 0 && is_spaced).then(|| -> Result<_, (&'static str, String)> {
        let [b, c, d] = std::array::from_fn(|k| header.float(256 + 4 * k, 352 + 8 * k));
        // A half turn has a = 0, which rounding can take below.
        let a = (1.0 - (b * b + c * c + d * d)).max(0.0).sqrt();
        let turn = nearest_rotation(Quaternion::new(a, b, c, d))
            .map_err(|error| ("quatern_b, quatern_c, quatern_d", format!("({b}, {c}, {d}): {error}")))?;
        let turn = turn.value.to_rotation_matrix();
        let side = if header.pixdim(0) < 0.0 { -1.0 } else { 1.0 };
        let spacings = Matrix3::from_diagonal(&[spacing[0], spacing[1], side * spacing[2]].into());
        let axes: Matrix3<f64> = turn.matrix() * spacings;
        let columns = std::array::from_fn(|k| axes.column(k).into_owned().into());
        Ok(scaled(affine(columns, std::array::from_fn(|k| header.float(268 + 4 * k, 376 + 8 * k)), RAS)))
    });
    let qform = qform.transpose()?;
    if let (Some(s), Some(q)) = (&sform, &qform) {
        let corner = |t: &Matrix4<f64>, c: usize| {
            let at: [f64; 3] = std::array::from_fn(|k| if c >> k & 1 == 0 { 0.0 } else { (size[k] - 1) as f64 });
            (t * Vector4::new(at[0], at[1], at[2], 1.0)).xyz()
        };
        let apart = (0..8).map(|c| (corner(s, c) - corner(q, c)).norm()).fold(0.0, f64::max);
        if apart > AGREEMENT * unit_mm * spacing.into_iter().fold(f64::MAX, f64::min) {
            notes.push(format!("sform and qform place the volume up to {apart:.2} mm apart; the sform was taken"));
        }
    }
    if let Some(t) = sform.or(qform) {
        return Ok((t, true));
    }
    if !is_spaced {
        return Err(("pixdim", "neither sform, qform nor three positive pixdim say how large a voxel is".into()));
    }
    notes.push(
        "no orientation is stated (sform_code and qform_code are 0): how the volume lies in the patient is unknown, and the \
         surface may be mirrored"
            .into(),
    );
    let axes = std::array::from_fn(|k| std::array::from_fn(|r| if r == k { spacing[k] } else { 0.0 }));
    Ok((scaled(affine(axes, [0.0; 3], RAS)), false))
}
