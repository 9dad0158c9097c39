//! Volumes of voxels from a CT or an MR: NIfTI, NRRD, and a DICOM series in a folder.
//!
//! A volume keeps its grid as it was scanned: oblique, anisotropic, sheared by a tilted gantry, left-handed. Voxels are not
//! resampled; `t_lps_voxel` says where they are.
//!
//! Only geometry, modality, series number and the endings of unique identifiers are kept or named; nothing that says who the
//! patient is.

mod dicom;
mod grid;
mod nifti;
mod nrrd;
mod numbers;

pub use grid::{Volume, VolumeRead, VoxelUnit};

use crate::{FileError, input};
use nalgebra::{Matrix3, Point3};
use osteoflow_geometry::TooFar;
use std::{
    io::Read,
    path::{Path, PathBuf},
};

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
/// file gives one layer. `series` is the number of a DICOM series, or the ending of its unique identifier. `O(voxels)`; memory is bounded by what the files can hold.
///
/// # Errors
/// [`FileError`] if a file cannot be read, is none of these, is cut short, or leaves a doubt about where a voxel is or what
/// its value is; if a folder holds several series and none is chosen.
pub fn read_volume(path: &Path, series: Option<&str>) -> Result<VolumeRead, FileError> {
    let metadata = std::fs::metadata(path).map_err(FileError::read(path))?;
    let mut read = if metadata.is_dir() {
        dicom::read_folder(path, series)?
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
    if series.is_some() && !metadata.is_dir() {
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
