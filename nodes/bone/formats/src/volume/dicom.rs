//! DICOM: a series of layers in a folder, and enhanced images whose layers are in one file.
//!
//! The reader looks for some thirty attributes of geometry and scaling and passes over all others, patient's names among them,
//! without decoding them. A general crate would keep them in memory, allocate what a length field asks for, and depend on an
//! unmaintained text codec (RUSTSEC-2021-0153).
//!
//! # Source
//! DICOM PS3.3 C.7.6.2 (image plane), C.7.6.16 (functional groups) and C.11.1 (modality transformation); PS3.5 sections 7.1
//! (elements), 8.1.1 (pixel cells), A.4 (fragments) and A.5 (deflated).

mod attributes;
mod codec;
mod elements;
mod image;
mod layers;
mod pixels;
mod series;
mod syntax;

use super::{
    format_of,
    grid::{Volume, VolumeRead, VoxelUnit, affine, assumed_unit},
    start_of,
};
use crate::{FileError, input};
use image::{Found, Image};
use layers::Layers;
use nalgebra::Vector3;
use pixels::Pixels;
use series::{Layer, Series, choose};
use std::{
    io::Read,
    path::{Path, PathBuf},
};

/// Folders deeper than this are not searched.
const MAX_DEPTH: usize = 8;
/// Most files of a folder that are looked at.
const MAX_FILES: usize = 200_000;

/// Whether a file begins like DICOM: 128 bytes of anything, then the mark; or as a data set without either.
pub(super) fn is_dicom(start: &[u8]) -> bool {
    start.get(128..132) == Some(b"DICM") || syntax::is_bare(start)
}

/// A series in a folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SeriesFound {
    /// Modality, number, identifier's ending, number of images and their size.
    pub name: String,
    /// What chooses it.
    pub choice: String,
    /// Why it is not taken, such as a picture in colours.
    pub why_not: Option<String>,
}

/// The one layer, or the frames, in a file.
pub(super) fn read_file(path: &Path, choice: Option<&str>) -> Result<VolumeRead, FileError> {
    let found = Found::read(path, &input::read(path)?)?;
    let image = match found {
        Found::Nothing => {
            let message = "this DICOM file holds no image; give the folder of a CT series";
            return Err(FileError::content(path, "pixel data", message));
        }
        Found::NoLayer(_, why) => {
            let message = format!("{why}; choose the series of the CT itself");
            return Err(FileError::content(path, "data set", message));
        }
        Found::Layers(mut images) if images.len() == 1 && choice.is_none() => images.remove(0),
        several => {
            let mut notes = Vec::new();
            let series = choose(path, series::series(vec![(path.into(), several)]), choice, &mut notes)?;
            return assemble(path, series, notes);
        }
    };
    let mut notes = vec!["one layer of a series; a surface needs the folder with all of them".to_string()];
    let voxels = Pixels::open(path)?.values(&image, &mut notes)?;
    let thickness = image.thickness_mm.filter(|t| *t > 0.0).unwrap_or(1.0);
    let step = image.row.cross(&image.column) * thickness;
    let volume = placed(&image, step, 1, voxels, image.unit());
    let frame_of_reference_uid = image.frame_of_reference_uid.clone();
    let source = format!("DICOM, {}, one layer", image.identity.modality);
    Ok(VolumeRead { volume, source, notes, frame_of_reference_uid })
}

/// The series in a folder and the folders in it.
pub(super) fn read_folder(path: &Path, choice: Option<&str>) -> Result<VolumeRead, FileError> {
    let mut notes = Vec::new();
    let all = search(path, &mut notes)?;
    let series = choose(path, all, choice, &mut notes)?;
    assemble(path, series, notes)
}

/// The series in a folder and the folders in it, each with what chooses it.
pub(super) fn list_series(path: &Path) -> Result<Vec<SeriesFound>, FileError> {
    let all = search(path, &mut Vec::new())?;
    let found =
        |s: &Series| SeriesFound { name: s.name(), choice: s.choice(&all), why_not: s.why_not().map(str::to_owned) };
    Ok(all.iter().map(found).collect())
}

fn search(path: &Path, notes: &mut Vec<String>) -> Result<Vec<Series>, FileError> {
    let mut files = Vec::new();
    let mut n_other = 0;
    list(path, 0, &mut files, &mut n_other)?;
    files.sort();
    let (mut all, mut n_without_image, mut others) = (Vec::new(), 0, Vec::new());
    for file in files {
        let mut start = Vec::new();
        input::open(&file)?.take(132).read_to_end(&mut start).map_err(FileError::read(&file))?;
        if !is_dicom(&start) {
            n_other += 1;
            others.push(file);
            continue;
        }
        match Found::read(&file, &input::read(&file)?)? {
            Found::Nothing => n_without_image += 1,
            found => all.push((file, found)),
        }
    }
    if all.is_empty() {
        let remedy = match others.iter().find(|file| start_of(file).is_ok_and(|start| format_of(&start).is_some())) {
            Some(file) => format!("give the file {} itself", file.display()),
            None => "give the folder of a CT series, or a NIfTI, NRRD or MetaImage file".into(),
        };
        let message = format!(
            "no DICOM image in it ({n_without_image} DICOM files without image, {n_other} other files); {remedy}"
        );
        return Err(FileError::content(path, "folder", message));
    }
    if n_other > 0 {
        notes.push(format!("{n_other} files that are not DICOM were left out"));
    }
    if n_without_image > 0 {
        notes.push(format!("{n_without_image} DICOM files without image were left out"));
    }
    Ok(series::series(all))
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
fn assemble(path: &Path, mut series: Series, mut notes: Vec<String>) -> Result<VolumeRead, FileError> {
    if let Some(fault) = series.fault.take() {
        return Err(fault);
    }
    let stack = layers::layers(path, &series, &mut notes)?;
    let first = &stack.layers[0].1;
    let voxels = voxels(&stack, &mut notes)?;
    let unit = if stack.layers.iter().all(|(_, image)| image.unit() == VoxelUnit::Hu) {
        VoxelUnit::Hu
    } else {
        VoxelUnit::Unknown
    };
    let is_unspecified = stack.layers.iter().all(|(_, image)| image.is_unspecified());
    let unit = if is_unspecified { assumed_unit(&voxels, "RescaleType (0028,1054)", &mut notes) } else { unit };
    if unit == VoxelUnit::Unknown {
        notes.push(format!("modality {}: the values are not stated to be HU", first.identity.modality));
    }
    let volume = placed(first, stack.step, stack.n(), voxels, unit);
    let uid = &first.frame_of_reference_uid;
    let is_shared = stack.layers.iter().all(|(_, image)| image.frame_of_reference_uid == *uid);
    let frame_of_reference_uid = uid.clone().filter(|_| is_shared);
    Ok(VolumeRead { volume, source: series.name(), notes, frame_of_reference_uid })
}

/// The values of a stack, layer by layer; where the stack has more voxels than layers, linearly between them.
fn voxels(stack: &Layers<'_>, notes: &mut Vec<String>) -> Result<Vec<f32>, FileError> {
    let first = &stack.layers[0].1;
    let per_layer = first.n_columns * first.n_rows;
    let mut voxels = Vec::with_capacity(per_layer * stack.layers.len());
    let mut before: Option<(f64, Vec<f32>)> = None;
    let mut file: Option<(&Path, Pixels)> = None;
    let mut k = 0;
    for (place, layer) in stack.places.iter().zip(&stack.layers) {
        let (path, image): &Layer = layer;
        let pixels = match file.take().filter(|(open, _)| *open == path) {
            Some((_, pixels)) => pixels,
            None => Pixels::open(path)?,
        };
        let values = pixels.values(image, notes)?;
        file = Some((path, pixels));
        while (k as f64) < *place {
            let (low, from) = before.as_ref().expect("the first layer is at place 0");
            let share = ((k as f64 - low) / (place - low)) as f32;
            voxels.extend(from.iter().zip(&values).map(|(a, b)| a + share * (b - a)));
            k += 1;
        }
        if (k as f64) == *place {
            voxels.extend_from_slice(&values);
            k += 1;
        }
        before = Some((*place, values));
    }
    Ok(voxels)
}

/// Layers from the first image on: columns along the rows' direction, rows along the columns' direction, layers by `step`.
fn placed(first: &Image, step: Vector3<f64>, n_layers: usize, voxels: Vec<f32>, unit: VoxelUnit) -> Volume {
    let [between_rows, between_columns] = first.spacing_mm;
    let axes = [first.row * between_columns, first.column * between_rows, step];
    let t_lps_voxel = affine(axes.map(Into::into), first.position.into(), [1.0; 3]);
    Volume { size: [first.n_columns, first.n_rows, n_layers], voxels, t_lps_voxel, unit, is_oriented: true }
}
