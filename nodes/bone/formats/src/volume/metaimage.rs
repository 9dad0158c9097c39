//! MetaImage (.mha, .mhd): raw, compressed and text data, behind the header or in files beside it.
//!
//! Coordinates are LPS, as ITK has it. What ITK passes over although it bears on values or places is refused or noted.
//!
//! # Source
//! Kitware, "MetaIO documentation", and MetaIO's metaImage.cxx where that is silent.

use super::data::{Data, beside, folder_of};
use super::grid::{Volume, VolumeRead, affine, assumed_unit, n_voxels_and_bytes};
use super::numbers::Encoding;
use crate::metaimage_header::Header;
use crate::{FileError, input, scalar::Scalar};
use nalgebra::{Matrix3, Matrix4};
use std::{
    fs::File,
    io::{BufReader, Read, Seek, SeekFrom},
    path::{Path, PathBuf},
};

/// Directions are rounded to some digits; more than this off a right angle or off length 1 is no rounding.
const DIRECTION_TOLERANCE: f64 = 1e-3;

/// The files beside the header that hold its data; none if the data follow the header, or it cannot be read.
pub(super) fn data_files(path: &Path) -> Vec<PathBuf> {
    let names = || {
        let mut reader = BufReader::new(input::open(path).ok()?);
        let header = Header::read(path, &mut reader).ok()?;
        names(&header, &mut reader).ok()
    };
    names().into_iter().flatten().map(|name| folder_of(path).join(name)).collect()
}

/// The number of frames of a sequence, whose header has fields of each; none for a volume.
fn frames_of(header: &Header<'_>) -> Option<usize> {
    let of_frame = |key: &str| Some(key.strip_prefix("Seq_Frame")?.split('_').next()?.parse::<usize>().ok()? + 1);
    header.fields().iter().filter_map(|field| of_frame(&field.key)).max()
}

/// Reads a .mha or .mhd file.
pub(super) fn read(path: &Path) -> Result<VolumeRead, FileError> {
    let mut reader = BufReader::new(input::open(path)?);
    let header = Header::read(path, &mut reader)?;
    if let Some(n) = frames_of(&header) {
        let message = format!(
            "a sequence of {n} frames with their poses, as PLUS and SlicerIGT record it, is no volume; save the CT itself as .mha \
             or .nrrd"
        );
        return Err(FileError::content(path, "header", message));
    }
    let mut notes = Vec::new();
    let size = size(&header)?;
    let scalar = scalar(&header)?;
    // Other programs pass over both, so what a voxel's value is would depend on the program.
    for (key, usual) in [("ElementToIntensityFunctionSlope", 1.0), ("ElementToIntensityFunctionOffset", 0.0)] {
        if let Some(field) = header.get(&[key]).filter(|field| field.value.parse() != Ok(usual)) {
            let message = "a scale of the values, which ITK passes over; save the volume with its scaled values";
            return Err(header.fault(field, message));
        }
    }
    let (t_lps_voxel, is_oriented) = placement(&header, &mut notes)?;
    let [nx, ny, nz] = size;
    let type_name = &header.need("ElementType")?.value;
    let Some((n, n_bytes)) = n_voxels_and_bytes(size, scalar.n_bytes()) else {
        let message = format!("{nx} x {ny} x {nz} voxels are more than can be counted");
        return Err(header.fault(header.need("DimSize")?, message));
    };
    let is_binary = header.get(&["BinaryData"]).is_none() || header.is_set(&["BinaryData"])?;
    let is_compressed = header.is_set(&["CompressedData"])?;
    let is_big = header.is_set(&["ElementByteOrderMSB", "BinaryDataByteOrderMSB"])?;
    let skip = header.get(&["HeaderSize"]);
    let n_skipped: i64 = match skip {
        None => 0,
        Some(field) => field.value.parse().ok().filter(|n| *n >= -1).ok_or_else(|| {
            header.fault(field, format!("\"{}\" is no number of bytes", field.value.escape_default()))
        })?,
    };
    let names = names(&header, &mut reader)?;
    let data =
        |path: PathBuf, reader: BufReader<File>, start: u64, n: usize, n_bytes: u64| -> Result<Data, FileError> {
            let all = reader.get_ref().metadata().map_err(FileError::read(&path))?.len();
            let promise = format!("{n} {type_name} are {n_bytes} bytes");
            let encoding = Encoding { scalar, is_big, slope: 1.0, intercept: 0.0 };
            Ok(Data { path, reader, n_there: all.saturating_sub(start), n, n_bytes, promise, encoding })
        };
    let skipped_of = |data: Data| match (is_binary, is_compressed) {
        (false, _) => data.text(0),
        (true, true) => data.compressed(0),
        (true, false) if n_skipped < 0 => data.raw(-1),
        (true, false) => data.raw(0),
    };
    // Bytes before the data count from the beginning of their file, in which a local header lies too.
    let at_start = |path: &Path, reader: &mut BufReader<File>, start: u64| -> Result<u64, FileError> {
        if n_skipped <= 0 {
            return Ok(start);
        }
        reader.seek(SeekFrom::Start(n_skipped as u64)).map_err(FileError::read(path))
    };
    let (voxels, n_extra) = match &names[..] {
        [] => {
            let start = at_start(path, &mut reader, header.data_start)?;
            skipped_of(data(path.into(), reader, start, n, n_bytes)?)?
        }
        names => {
            if size[2] % names.len() != 0 || (names.len() > 1 && is_compressed) {
                let message = format!(
                    "{} files for {nz} layers{}; save the volume as one .mha file",
                    names.len(),
                    if is_compressed { ", compressed one by one" } else { "" }
                );
                return Err(header.fault(header.need("ElementDataFile")?, message));
            }
            let (mut voxels, mut n_extra) = (Vec::new(), 0);
            for name in names {
                let real = beside(path, name)?.map_err(|message| {
                    FileError::content(path, "ElementDataFile", format!("\"{}\": {message}", name.escape_default()))
                })?;
                let mut reader = BufReader::new(input::open(&real)?);
                let start = at_start(&real, &mut reader, 0)?;
                let n_files = names.len();
                let part = data(folder_of(path).join(name), reader, start, n / n_files, n_bytes / n_files as u64)?;
                let (mut values, more) = skipped_of(part)?;
                n_extra += more;
                if voxels.is_empty() { voxels = values } else { voxels.append(&mut values) }
            }
            (voxels, n_extra)
        }
    };
    if n_extra > 0 {
        notes.push(format!("{n_extra} bytes or more follow the volume and were not read"));
    }
    let is_mr = header.get(&["Modality"]).is_some_and(|field| field.value == "MET_MOD_MR");
    let unit = if is_mr { super::VoxelUnit::Unknown } else { assumed_unit(&voxels, "MetaImage", &mut notes) };
    let how = if !is_binary {
        "text"
    } else if is_compressed {
        "compressed"
    } else {
        "raw"
    };
    let volume = Volume { size, voxels, t_lps_voxel, unit, is_oriented };
    Ok(VolumeRead { volume, source: format!("MetaImage, {how}"), notes, frame_of_reference_uid: None })
}

/// The names of the files that hold the data; none if the data follow the header.
fn names(header: &Header<'_>, reader: &mut BufReader<File>) -> Result<Vec<String>, FileError> {
    let field = header.need("ElementDataFile")?;
    let value = field.value.as_str();
    if value.eq_ignore_ascii_case("LOCAL") {
        return Ok(Vec::new());
    }
    let mut words = value.split_ascii_whitespace();
    if words.next() == Some("LIST") {
        if !matches!(words.next(), None | Some("2" | "2D")) {
            return Err(header.fault(field, "a list of files that are no layers; save the volume as one .mha file"));
        }
        let mut list = String::new();
        // A name has at most 255 bytes.
        let limit = 256 * size(header)?[2] as u64;
        reader
            .take(limit)
            .read_to_string(&mut list)
            .map_err(|error| header.fault(field, format!("the list of files cannot be read: {error}")))?;
        let names: Vec<String> =
            list.lines().map(str::trim).filter(|name| !name.is_empty()).map(str::to_owned).collect();
        return match names.len() {
            0 => Err(header.fault(field, "LIST, but no names of files follow; was the file cut short?")),
            _ => Ok(names),
        };
    }
    if value.contains('%') {
        return Err(header.fault(field, "a pattern of names; save the volume as one .mha file"));
    }
    Ok(vec![value.to_owned()])
}

/// Number of voxels along each axis; a fourth axis must be of one voxel.
fn size(header: &Header<'_>) -> Result<[usize; 3], FileError> {
    let (n_dims, sizes) = (header.need("NDims")?, header.need("DimSize")?);
    let numbers = header.numbers(sizes)?;
    if n_dims.value.parse() != Ok(numbers.len()) {
        return Err(
            header.fault(sizes, format!("{} sizes for NDims = {}", numbers.len(), n_dims.value.escape_default()))
        );
    }
    let [nx, ny, nz, ref rest @ ..] = numbers[..] else {
        let message = format!("{} dimensions; 3 are read", numbers.len());
        return Err(header.fault(n_dims, message));
    };
    if rest.len() > 1 || rest.iter().any(|n| *n != 1.0) {
        let message = format!(
            "{} dimensions; 3 are read, and a fourth of 1: save the one frame that shows the bone as a volume of its own",
            numbers.len()
        );
        return Err(header.fault(n_dims, message));
    }
    if [nx, ny, nz].iter().any(|s| s.fract() != 0.0 || !(1.0..1e9).contains(s)) {
        return Err(header.fault(sizes, format!("{nx} x {ny} x {nz} voxels; whole numbers from 1 are needed")));
    }
    Ok([nx as usize, ny as usize, nz as usize])
}

fn scalar(header: &Header<'_>) -> Result<Scalar, FileError> {
    if let Some(field) = header.get(&["ElementNumberOfChannels"]).filter(|field| field.value != "1") {
        let message = format!("{} values per voxel: colours or vectors hold no density", field.value.escape_default());
        return Err(header.fault(field, message));
    }
    let field = header.need("ElementType")?;
    Ok(match field.value.as_str() {
        "MET_CHAR" | "MET_ASCII_CHAR" => Scalar::I8,
        "MET_UCHAR" => Scalar::U8,
        "MET_SHORT" => Scalar::I16,
        "MET_USHORT" => Scalar::U16,
        // Of 32 bits in MetaIO, whatever the machine.
        "MET_INT" | "MET_LONG" => Scalar::I32,
        "MET_UINT" | "MET_ULONG" => Scalar::U32,
        "MET_LONG_LONG" => Scalar::I64,
        "MET_ULONG_LONG" => Scalar::U64,
        "MET_FLOAT" => Scalar::F32,
        "MET_DOUBLE" => Scalar::F64,
        other => {
            let message =
                format!("type \"{}\" is not read; save the volume as MET_SHORT or MET_FLOAT", other.escape_default());
            return Err(header.fault(field, message));
        }
    })
}

/// The map from voxels to LPS, mm, and whether the orientation is stated.
fn placement(header: &Header<'_>, notes: &mut Vec<String>) -> Result<(Matrix4<f64>, bool), FileError> {
    let n_dims = header.numbers(header.need("DimSize")?)?.len();
    let counted = |keys: &[&str], n: usize| -> Result<Option<Vec<f64>>, FileError> {
        let Some(field) = header.get(keys) else { return Ok(None) };
        let numbers = header.numbers(field)?;
        if numbers.len() != n || numbers.iter().any(|number| !number.is_finite()) {
            let message = format!("{} numbers; {n} finite ones are needed", numbers.len());
            return Err(header.fault(field, message));
        }
        Ok(Some(numbers))
    };
    if let Some(field) = header.get(&["DistanceUnits"]).filter(|field| !["mm", "?"].contains(&&*field.value)) {
        let message =
            format!("lengths in {}, which ITK takes for mm; save the volume in mm", field.value.escape_default());
        return Err(header.fault(field, message));
    }
    let Some(spacing) = counted(&["ElementSpacing", "ElementSize"], n_dims)? else {
        let message =
            "no field \"ElementSpacing\", so the size of a voxel is unknown; export the volume with its geometry";
        return Err(header.fault(header.need("DimSize")?, message));
    };
    let first = counted(&["Offset", "Origin", "Position"], n_dims)?.unwrap_or_else(|| {
        notes.push("no Offset is stated; the first voxel was placed at 0, 0, 0".into());
        vec![0.0; n_dims]
    });
    let first = [first[0], first[1], first[2]];
    let Some(matrix) = counted(&["TransformMatrix", "Rotation", "Orientation"], n_dims * n_dims)? else {
        notes.push(
            "orientation unknown: no TransformMatrix is stated, so how the volume lies in the patient is unknown, and the surface \
             may be mirrored"
                .into(),
        );
        let axes = std::array::from_fn(|k| std::array::from_fn(|r| if r == k { spacing[k] } else { 0.0 }));
        return Ok((affine(axes, first, [1.0; 3]), false));
    };
    // The direction of each axis in turn: the columns of the matrix that ITK shows.
    let directions = Matrix3::from_fn(|r, k| matrix[k * n_dims + r]);
    let off = (directions.transpose() * directions - Matrix3::identity()).abs().max();
    if off.is_nan() || off > DIRECTION_TOLERANCE {
        let message = format!("the directions of the axes are {off:.4} off unit length or a right angle");
        return Err(FileError::content(header.path(), "TransformMatrix", message));
    }
    if let Some(field) = header.get(&["AnatomicalOrientation"]) {
        let letters = letters(&directions);
        if field.value.len() == 3 && field.value != "???" && letters.as_ref().is_some_and(|l| *l != field.value) {
            notes.push(format!(
                "AnatomicalOrientation is {}, but TransformMatrix is {}; the matrix was taken, as ITK does",
                field.value.escape_default(),
                letters.unwrap_or_default()
            ));
        }
    }
    let axes = std::array::from_fn(|k| std::array::from_fn(|r| directions[(r, k)] * spacing[k]));
    Ok((affine(axes, first, [1.0; 3]), true))
}

/// Where the axes come from, a letter each; none if an axis is far from all of the body's.
fn letters(directions: &Matrix3<f64>) -> Option<String> {
    let of = |k: usize| {
        let r = directions.column(k).iamax();
        let along = directions[(r, k)];
        let names = [['R', 'L'], ['A', 'P'], ['I', 'S']][r];
        (along.abs() > 0.8).then_some(names[usize::from(along < 0.0)])
    };
    (0..3).map(of).collect()
}
