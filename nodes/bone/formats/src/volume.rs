//! Volumes of voxels from a CT or an MR: NIfTI, NRRD, MetaImage, and a DICOM series in a folder.
//!
//! A volume keeps its grid as it was scanned: oblique, anisotropic, sheared by a tilted gantry, left-handed. Voxels are not
//! resampled; `t_lps_voxel` says where they are.
//!
//! Only geometry, modality, series number and the endings of unique identifiers are kept or named; nothing that says who the
//! patient is.

mod data;
mod dicom;
mod grid;
mod metaimage;
mod nifti;
mod nrrd;
mod numbers;

pub use dicom::SeriesFound;
pub use grid::{Volume, VolumeRead, VoxelUnit};

use crate::{
    FileError, input,
    kind::{Kind, Probe, is_mgh, marked},
    metaimage_header::is_metaimage,
};
use flate2::read::GzDecoder;
use nalgebra::{Matrix3, Point3};
use osteoflow_geometry::TooFar;
use std::{
    io::Read,
    path::{Path, PathBuf},
};

/// The files beside that hold the voxels of a detached header (.nhdr, .mhd); none if there is no other, or it cannot be found.
pub fn data_files(path: &Path) -> Vec<PathBuf> {
    match start_of(path) {
        Ok(start) if start.starts_with(b"NRRD") => nrrd::data_file(path).into_iter().collect(),
        Ok(start) if is_metaimage(&start) => metaimage::data_files(path),
        _ => Vec::new(),
    }
}

/// How the files of a format begin, and their reader.
type Format = (&'static str, fn(&[u8]) -> bool, fn(&Path, Option<&str>) -> Result<VolumeRead, FileError>);

pub(crate) const METAIMAGE: &str = "MetaImage";
pub(crate) const NRRD: &str = "NRRD";

const FORMATS: [Format; 4] = [
    (NRRD, |start| start.starts_with(b"NRRD"), |path, _| nrrd::read(path)),
    (METAIMAGE, is_metaimage, |path, _| metaimage::read(path)),
    ("DICOM", dicom::is_dicom, dicom::read_file),
    ("NIfTI", |start| nifti::is_nifti(start) || is_gzip_of_a_volume(start), |path, _| nifti::read(path)),
];

/// The format of a volume by its first bytes; none if it is no volume.
pub(crate) fn format_of(start: &[u8]) -> Option<&'static str> {
    FORMATS.iter().find(|(_, is_it, _)| is_it(start)).map(|(name, ..)| *name)
}

/// Whether a gzip file holds NIfTI, or MGH, which is refused by its name there; one that is damaged is taken for such.
fn is_gzip_of_a_volume(start: &[u8]) -> bool {
    let mut head = [0; 24];
    let is_gzip = start.starts_with(&[0x1f, 0x8b]);
    is_gzip && GzDecoder::new(start).read_exact(&mut head).map_or(true, |()| nifti::is_nifti(&head) || is_mgh(&head))
}

/// Reads the volume in a NIfTI, NRRD, MetaImage or DICOM file, recognised by its content, or the DICOM series in a folder.
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
        let Some((name, _, read)) = FORMATS.iter().find(|(_, is_it, _)| is_it(&start)) else {
            let found = marked(path, &start).unwrap_or_else(|| Probe::new(Kind::Unknown, "", path));
            return Err(found.refusal(path, "a NIfTI, NRRD, MetaImage or DICOM file, or the folder of a DICOM series"));
        };
        if series.is_some() && *name != "DICOM" {
            let message =
                "series chooses among the DICOM series of a folder, but this is a file of another format; leave it out";
            return Err(FileError::content(path, "series", message));
        }
        read(path, series)?
    };
    let volume = &mut read.volume;
    read.notes.extend(replace_non_finite(&mut volume.voxels));
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

/// The DICOM series of a folder, those that are no CT with the reason.
///
/// # Errors
/// [`FileError`] if a file cannot be read, or there is no image.
pub fn list_series(folder: &Path) -> Result<Vec<SeriesFound>, FileError> {
    dicom::list_series(folder)
}

/// The first bytes of a file, as many as tell its format.
fn start_of(path: &Path) -> Result<Vec<u8>, FileError> {
    input::head(path, 132)
}

/// Sets values above all numbers to the highest of the others, as bone and metal beyond a scanner's range are, and values below
/// all or without a number to the lowest; 0 if there are no others. Says how many.
fn replace_non_finite(voxels: &mut [f32]) -> Option<String> {
    let n_high = voxels.iter().filter(|v| **v == f32::INFINITY).count();
    let n_low = voxels.iter().filter(|v| !v.is_finite()).count() - n_high;
    if n_high + n_low == 0 {
        return None;
    }
    let finite = voxels.iter().copied().filter(|v| v.is_finite());
    let (low, high) = finite.fold((f32::MAX, f32::MIN), |(low, high), v| (low.min(v), high.max(v)));
    let (low, high) = if low <= high { (low, high) } else { (0.0, 0.0) };
    for v in voxels.iter_mut().filter(|v| !v.is_finite()) {
        *v = if *v == f32::INFINITY { high } else { low };
    }
    let to = |n: usize, what: &str, value: f32, which: &str| {
        (n > 0).then(|| format!("{n} voxels {what} were set to {value}, the {which} value of the others"))
    };
    let both = [
        to(n_high, "of +infinity", high, "highest"),
        to(n_low, "without a number (NaN) or of -infinity", low, "lowest"),
    ];
    Some(both.into_iter().flatten().collect::<Vec<_>>().join(", and "))
}
