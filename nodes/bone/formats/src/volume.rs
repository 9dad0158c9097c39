//! Volumes of voxels from a CT or an MR: NIfTI, NRRD, and a DICOM series in a folder.
//!
//! A volume keeps its grid as it was scanned: oblique, anisotropic, sheared by a tilted gantry, left-handed. Voxels are not
//! resampled; `t_lps_voxel` says where they are.
//!
//! Only geometry, modality, series number and the endings of unique identifiers are kept or named; nothing that says who the
//! patient is.

mod dicom;
mod nifti;
mod nrrd;
mod numbers;

use crate::{FileError, input};
use flate2::read::MultiGzDecoder;
use nalgebra::{Matrix3, Matrix4, Point3, Vector3};
use osteoflow_geometry::TooFar;
use std::{
    io::Read,
    path::{Path, PathBuf},
};

/// The most that deflate can expand a byte.
const MAX_EXPANSION: u64 = 1032;

/// What the values of voxels mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VoxelUnit {
    /// Hounsfield units, by the file or by its values (then a note says so).
    Hu,
    /// Unknown: an MR, or values that were not scaled.
    Unknown,
}

/// A regular grid of voxels.
#[derive(Debug, Clone, PartialEq)]
pub struct Volume {
    /// Number of voxels along x (fastest), y and z.
    pub size: [usize; 3],
    /// Their values after the file's slope and intercept, `x × y × z`, finite. Single precision: exact for 24 bits.
    pub voxels: Vec<f32>,
    /// From a voxel's index (its centre) to LPS, mm. It may be oblique, anisotropic, sheared and left-handed.
    pub t_lps_voxel: Matrix4<f64>,
    /// What the values mean.
    pub unit: VoxelUnit,
    /// Whether the file says how the volume lies in the patient. If not, its surface may be turned or mirrored.
    pub is_oriented: bool,
}

/// A volume read from a file or a folder.
#[derive(Debug, Clone, PartialEq)]
pub struct VolumeRead {
    /// The volume.
    pub volume: Volume,
    /// What was read, in a few words: format, modality, series.
    pub source: String,
    /// Suspicious properties of the files, one sentence each.
    pub notes: Vec<String>,
}

/// Which volume of a folder.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct VolumeOptions {
    /// Number of a DICOM series, or the ending of its unique identifier. None: the only one.
    pub series: Option<String>,
}

/// The file beside that holds the voxels of a detached header (.nhdr); none if there is no other, or it cannot be found.
pub fn data_file(path: &Path) -> Option<PathBuf> {
    start_of(path).ok().filter(|start| start.starts_with(b"NRRD")).and_then(|_| nrrd::data_file(path))
}

/// Whether the path is a folder, as of a DICOM series, or a file that begins as NIfTI, gzip, NRRD or DICOM do.
pub fn is_volume(path: &Path) -> bool {
    path.is_dir() || start_of(path).is_ok_and(|start| is_volume_file(&start))
}

fn is_volume_file(start: &[u8]) -> bool {
    start.starts_with(b"NRRD") || dicom::is_dicom(start) || start.starts_with(&[0x1f, 0x8b]) || nifti::is_nifti(start)
}

/// Reads the volume in a NIfTI, NRRD or DICOM file, recognised by its content, or the DICOM series in a folder.
///
/// In a folder, files may have any name and order and lie in folders of it; others are ignored and counted. A single DICOM
/// file gives one layer. `O(voxels)`; memory is bounded by what the files can hold.
///
/// # Errors
/// [`FileError`] if a file cannot be read, is none of these, is cut short, or leaves a doubt about where a voxel is or what
/// its value is; if a folder holds several series and none is chosen.
pub fn read_volume(path: &Path, options: &VolumeOptions) -> Result<VolumeRead, FileError> {
    let metadata = std::fs::metadata(path).map_err(FileError::read(path))?;
    let mut read = if metadata.is_dir() {
        dicom::read_folder(path, options.series.as_deref())?
    } else {
        let start = start_of(path)?;
        if start.starts_with(b"NRRD") {
            nrrd::read(path)?
        } else if dicom::is_dicom(&start) {
            dicom::read_file(path)?
        } else if start.starts_with(&[0x1f, 0x8b]) || nifti::is_nifti(&start) {
            nifti::read(path)?
        } else {
            let message = "neither NIfTI (348 or 540 in the first four bytes), NRRD (\"NRRD\") nor DICOM (\"DICM\" at byte \
                           128); give a .nii, .nii.gz, .nrrd or .nhdr file, or the folder of a DICOM series";
            return Err(FileError::content(path, "byte 0", message));
        }
    };
    if options.series.is_some() && !metadata.is_dir() {
        let message = "series chooses among the DICOM series of a folder, but this is a file; leave it out";
        return Err(FileError::content(path, "series", message));
    }
    let volume = &mut read.volume;
    let n_bad = replace_non_finite(&mut volume.voxels);
    if n_bad > 0 {
        read.notes.push(format!("{n_bad} voxels are not finite and were set to the lowest value of the others"));
    }
    let linear: Matrix3<f64> = volume.t_lps_voxel.fixed_view::<3, 3>(0, 0).into();
    let lengths: [f64; 3] = std::array::from_fn(|k| linear.column(k).norm());
    let is_space = volume.t_lps_voxel.iter().all(|c| c.is_finite())
        && lengths.iter().all(|l| *l > 0.0)
        && linear.determinant().abs() > 1e-6 * lengths.iter().product::<f64>();
    if !is_space {
        let message =
            format!("the axes of the voxels do not span space (lengths {lengths:?} mm); export the volume again");
        return Err(FileError::content(path, "geometry", message));
    }
    let size = volume.size.map(|n| n.saturating_sub(1) as f64);
    for corner in 0..8_usize {
        let index = std::array::from_fn(|k| if corner >> k & 1 == 1 { size[k] } else { 0.0 });
        let at = volume.t_lps_voxel.transform_point(&Point3::from(index));
        TooFar::check(at.coords.as_slice()).map_err(|far| {
            let message = format!("voxel {index:?} is at ({:?}, {:?}, {:?}) mm: {far}", at.x, at.y, at.z);
            FileError::content(path, "geometry", message)
        })?;
    }
    if lengths.iter().any(|l| !(0.01..=20.0).contains(l)) {
        let [x, y, z] = lengths;
        read.notes.push(format!("voxels of {x} x {y} x {z} mm are hardly a CT's; is the unit of length right?"));
    }
    Ok(read)
}

/// The first bytes of a file, as many as tell its format.
fn start_of(path: &Path) -> Result<Vec<u8>, FileError> {
    let mut start = Vec::new();
    input::open(path)?.take(132).read_to_end(&mut start).map_err(FileError::read(path))?;
    Ok(start)
}

/// Sets values that are not finite to the lowest of the others, or 0; returns their number.
fn replace_non_finite(voxels: &mut [f32]) -> usize {
    let n_bad = voxels.iter().filter(|v| !v.is_finite()).count();
    if n_bad > 0 {
        let lowest = voxels.iter().copied().filter(|v| v.is_finite()).reduce(f32::min).unwrap_or(0.0);
        voxels.iter_mut().filter(|v| !v.is_finite()).for_each(|v| *v = lowest);
    }
    n_bad
}

/// The map of voxels whose axes (per voxel) and first centre are given in a space that differs from LPS by `signs`.
fn affine(axes: [[f64; 3]; 3], first: [f64; 3], signs: [f64; 3]) -> Matrix4<f64> {
    let turn = Matrix3::from_diagonal(&Vector3::from(signs));
    let mut t = (turn * Matrix3::from_columns(&axes.map(Vector3::from))).to_homogeneous();
    t.fixed_view_mut::<3, 1>(0, 3).copy_from(&(turn * Vector3::from(first)));
    t
}

/// Whether values without a stated unit look like Hounsfield units: air below, bone above, most of them between.
fn looks_like_hu(voxels: &[f32]) -> bool {
    let start = (f32::MAX, f32::MIN, 0usize);
    let (low, high, n_tissue) = voxels
        .iter()
        .filter(|v| v.is_finite())
        .fold(start, |(low, high, n), v| (low.min(*v), high.max(*v), n + usize::from((-1100.0..=3100.0).contains(v))));
    (-10_000.0..=-500.0).contains(&low) && high >= 300.0 && 2 * n_tissue >= voxels.len()
}

/// The unit of values whose file states none, with a note.
fn assumed_unit(voxels: &[f32], format: &str, notes: &mut Vec<String>) -> VoxelUnit {
    if looks_like_hu(voxels) {
        notes
            .push(format!("{format} states no unit of its values; with air and bone among them they were taken as HU"));
        VoxelUnit::Hu
    } else {
        VoxelUnit::Unknown
    }
}

/// The number of voxels of a size, and of their bytes, if both can be counted.
fn n_voxels_and_bytes(size: [usize; 3], bytes_each: usize) -> Option<(usize, u64)> {
    let n = size.iter().try_fold(1usize, |n, s| n.checked_mul(*s))?;
    Some((n, (n as u64).checked_mul(bytes_each as u64)?))
}

/// What a gzip stream of `compressed` bytes holds at most.
fn gzip_limit(compressed: u64) -> u64 {
    compressed.saturating_mul(MAX_EXPANSION).saturating_add(1024)
}

/// Reads at most `limit` bytes of what is left of a gzip stream, so that its checksum is verified; returns their number.
fn drain(reader: &mut impl Read, limit: u64) -> std::io::Result<u64> {
    std::io::copy(&mut reader.take(limit), &mut std::io::sink())
}

/// A decoder of gzip, also of several streams in a row.
fn gunzip<R: Read>(reader: R) -> MultiGzDecoder<R> {
    MultiGzDecoder::new(reader)
}
