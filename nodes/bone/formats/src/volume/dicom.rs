//! A DICOM series in a folder, uncompressed or run-length encoded.
//!
//! The reader looks for some twenty elements of geometry and scaling and passes over all others, patient's names among them,
//! without decoding them. A general crate would keep them in memory, allocate what a length field asks for, and depend on an
//! unmaintained text codec (RUSTSEC-2021-0153).
//!
//! # Source
//! DICOM PS3.3 C.7.6.2 (image plane) and C.11.1 (modality transformation); PS3.5 sections 7.1 (elements), 8.1.1 (pixel cells),
//! A.5 (deflated) and annex G (run-length encoding).

mod elements;
mod image;
mod series;

use super::grid::{Volume, VolumeRead, VoxelUnit, affine};
use crate::{FileError, input};
use image::Image;
use nalgebra::Vector3;
use series::{Series, choose};
use std::{
    io::Read,
    path::{Path, PathBuf},
};

/// Folders deeper than this are not searched.
const MAX_DEPTH: usize = 8;
/// Most files of a folder that are looked at.
const MAX_FILES: usize = 200_000;

/// Whether a file begins like DICOM: 128 bytes of anything, then the mark.
pub(super) fn is_dicom(start: &[u8]) -> bool {
    start.get(128..132) == Some(b"DICM")
}

/// The one layer in a file.
pub(super) fn read_file(path: &Path) -> Result<VolumeRead, FileError> {
    let bytes = input::read(path)?;
    let image = Image::read(path, &bytes)?.ok_or_else(|| {
        FileError::content(path, "pixel data", "this DICOM file holds no image; give the folder of a CT series")
    })?;
    let mut notes = vec!["one layer of a series; a surface needs the folder with all of them".to_string()];
    let voxels = image.voxels(path, &bytes, &mut notes)?;
    let thickness = image.thickness_mm.filter(|t| *t > 0.0).unwrap_or(1.0);
    let step = image.row.cross(&image.column) * thickness;
    let volume = placed(&image, step, 1, voxels, image.unit());
    let frame_of_reference_uid = image.frame_of_reference_uid.clone();
    Ok(VolumeRead { volume, source: format!("DICOM, {}, one layer", image.modality), notes, frame_of_reference_uid })
}

/// The series in a folder and the folders in it.
pub(super) fn read_folder(path: &Path, choice: Option<&str>) -> Result<VolumeRead, FileError> {
    let mut files = Vec::new();
    let mut n_other = 0;
    list(path, 0, &mut files, &mut n_other)?;
    files.sort();
    let (mut images, mut n_without_image, mut others) = (Vec::new(), 0, Vec::new());
    for file in files {
        let mut start = Vec::new();
        input::open(&file)?.take(132).read_to_end(&mut start).map_err(FileError::read(&file))?;
        if !is_dicom(&start) {
            n_other += 1;
            others.push(file);
            continue;
        }
        let bytes = input::read(&file)?;
        match Image::read(&file, &bytes)? {
            Some(image) => images.push((file, image)),
            None => n_without_image += 1,
        }
    }
    if images.is_empty() {
        let is_volume = |p: &PathBuf| {
            let name = p.to_string_lossy().to_ascii_lowercase();
            [".nii", ".nii.gz", ".nrrd", ".nhdr"].iter().any(|end| name.ends_with(end))
        };
        let remedy = match others.iter().find(|p| is_volume(p)) {
            Some(file) => format!("give the file {} itself", file.display()),
            None => "give the folder of a CT series, or a NIfTI or NRRD file".into(),
        };
        let message = format!(
            "no DICOM image in it ({n_without_image} DICOM files without image, {n_other} other files); {remedy}"
        );
        return Err(FileError::content(path, "folder", message));
    }
    let mut notes = Vec::new();
    if n_other > 0 {
        notes.push(format!("{n_other} files that are not DICOM were left out"));
    }
    if n_without_image > 0 {
        notes.push(format!("{n_without_image} DICOM files without image were left out"));
    }
    let series = choose(path, images, choice)?;
    assemble(path, series, notes)
}

/// Regular files of a folder and of the folders in it; links to folders are not followed.
fn list(folder: &Path, depth: usize, files: &mut Vec<PathBuf>, n_other: &mut usize) -> Result<(), FileError> {
    for entry in std::fs::read_dir(folder).map_err(FileError::read(folder))? {
        let entry = entry.map_err(FileError::read(folder))?;
        let (path, kind) = (entry.path(), entry.file_type().map_err(FileError::read(folder))?);
        if kind.is_dir() {
            if depth + 1 > MAX_DEPTH {
                let message = format!("folders lie more than {MAX_DEPTH} deep; give the folder of one series");
                return Err(FileError::content(folder, "folder", message));
            }
            list(&path, depth + 1, files, n_other)?;
        } else if path.is_file() {
            files.push(path);
        } else {
            *n_other += 1;
        }
        if files.len() > MAX_FILES {
            let message = format!("more than {MAX_FILES} files; give the folder of one series");
            return Err(FileError::content(folder, "folder", message));
        }
    }
    Ok(())
}

/// The volume of a series.
fn assemble(path: &Path, series: Series, mut notes: Vec<String>) -> Result<VolumeRead, FileError> {
    let order = series.layers(path, &mut notes)?;
    let first = &order.images[0].1;
    let per_layer = first.n_columns * first.n_rows;
    let mut voxels = Vec::with_capacity(per_layer * order.images.len());
    for (file, image) in &order.images {
        let bytes = input::read(file)?;
        voxels.extend(image.voxels(file, &bytes, &mut notes)?);
    }
    notes.dedup();
    let unit = if order.images.iter().all(|(_, image)| image.unit() == VoxelUnit::Hu) {
        VoxelUnit::Hu
    } else {
        VoxelUnit::Unknown
    };
    if unit == VoxelUnit::Unknown {
        notes.push(format!("modality {}: the values are not stated to be HU", first.modality));
    }
    let volume = placed(first, order.step, order.images.len(), voxels, unit);
    let uid = &first.frame_of_reference_uid;
    let is_shared = order.images.iter().all(|(_, image)| image.frame_of_reference_uid == *uid);
    let frame_of_reference_uid = uid.clone().filter(|_| is_shared);
    Ok(VolumeRead { volume, source: series.name(), notes, frame_of_reference_uid })
}

/// Layers from the first image on: columns along the rows' direction, rows along the columns' direction, layers by `step`.
fn placed(first: &Image, step: Vector3<f64>, n_layers: usize, voxels: Vec<f32>, unit: VoxelUnit) -> Volume {
    let [between_rows, between_columns] = first.spacing_mm;
    let axes = [first.row * between_columns, first.column * between_rows, step];
    let t_lps_voxel = affine(axes.map(Into::into), first.position.into(), [1.0; 3]);
    Volume { size: [first.n_columns, first.n_rows, n_layers], voxels, t_lps_voxel, unit, is_oriented: true }
}
