//! NRRD files: raw, gzip and text encodings, with the data behind the header or in a file beside it.
//!
//! # Source
//! Kindlmann, "Definition of NRRD File Format", teem.sourceforge.net/nrrd/format.html.

use super::data::{Data, beside, folder_of, shown};
use super::grid::{Volume, VolumeRead, affine, assumed_unit, n_voxels_and_bytes};
use super::numbers::{Encoding, gzip_limit};
use crate::scalar::Scalar;
use crate::{FileError, cursor::Cursor, input};
use std::{
    collections::HashMap,
    fs::File,
    io::{BufRead, BufReader, Read},
    path::{Path, PathBuf},
};

/// A longer header is no header.
const MAX_HEADER_BYTES: usize = 1 << 20;

/// A header's fields by name, in lower case, with their lines.
struct Header<'a> {
    path: &'a Path,
    fields: HashMap<String, (usize, String)>,
    /// Its length with the blank line.
    n_bytes: u64,
}

/// The file that holds the data of a detached header; none if the data follow the header, or it cannot be read.
pub(super) fn data_file(path: &Path) -> Option<PathBuf> {
    let mut reader = BufReader::new(input::open(path).ok()?);
    Header::read(path, &mut reader).ok()?.data_path()
}

/// Reads a .nrrd or .nhdr file.
pub(super) fn read(path: &Path) -> Result<VolumeRead, FileError> {
    let mut reader = BufReader::new(input::open(path)?);
    let header = Header::read(path, &mut reader)?;
    let mut notes = Vec::new();
    let (size, single) = header.size()?;
    let type_name = header.text("type")?.to_ascii_lowercase();
    let scalar = header.scalar(&type_name)?;
    let (t_lps_voxel, is_oriented) = placement(&header, single, &mut notes)?;
    let encoding_name = header.text("encoding")?.to_ascii_lowercase();
    let is_text = matches!(encoding_name.as_str(), "ascii" | "text" | "txt");
    let is_big = match header.get("endian").map(|(_, v)| v.to_ascii_lowercase()) {
        Some(order) if order == "little" => false,
        Some(order) if order == "big" => true,
        Some(order) => return Err(header.fault("endian", format!("\"{order}\" is neither little nor big"))),
        None if scalar.n_bytes() == 1 || is_text => false,
        None => {
            let message =
                format!("no field \"endian\", which {type_name} needs; add \"endian: little\" or \"endian: big\"");
            return Err(FileError::content(path, "header", message));
        }
    };
    let (data_path, reader, n_there) = header.data(reader)?;
    let [nx, ny, nz] = size;
    let Some((n, n_bytes)) = n_voxels_and_bytes(size, scalar.n_bytes()) else {
        return Err(header.fault("sizes", format!("{nx} x {ny} x {nz} voxels are more than can be counted")));
    };
    let promise = format!("{nx} x {ny} x {nz} {type_name} are {n_bytes} bytes");
    let encoding = Encoding { scalar, is_big, slope: 1.0, intercept: 0.0 };
    let mut data = Data { path: data_path, reader, n_there, n, n_bytes, promise, encoding };
    data.skip_lines(header.number_of("line skip")?.max(0))?;
    let n_skipped = header.number_of("byte skip")?;
    let (voxels, n_extra) = match encoding_name.as_str() {
        "raw" => data.raw(n_skipped)?,
        "gzip" | "gz" if n_skipped < 0 && n_bytes <= gzip_limit(n_there) => {
            let message = "\"byte skip: -1\" is for raw data; write the number of bytes";
            return Err(header.fault("byte skip", message));
        }
        "gzip" | "gz" => data.compressed(n_skipped as u64)?,
        _ if is_text => data.text(n_skipped.max(0) as u64)?,
        other => {
            let message = format!("encoding \"{other}\" is not read; save the volume as raw or gzip");
            return Err(header.fault("encoding", message));
        }
    };
    if n_extra > 0 {
        notes.push(format!("{n_extra} bytes or more follow the volume and were not read"));
    }
    let unit = assumed_unit(&voxels, "NRRD", &mut notes);
    let volume = Volume { size, voxels, t_lps_voxel, unit, is_oriented };
    Ok(VolumeRead { volume, source: format!("NRRD, {encoding_name}"), notes, frame_of_reference_uid: None })
}

impl<'a> Header<'a> {
    fn read(path: &'a Path, reader: &mut BufReader<File>) -> Result<Self, FileError> {
        // A blank line ends the header; a detached one may end with its file.
        let mut bytes = Vec::new();
        loop {
            let start = bytes.len();
            let left = (MAX_HEADER_BYTES - start) as u64;
            reader.by_ref().take(left).read_until(b'\n', &mut bytes).map_err(FileError::read(path))?;
            if bytes.len() == MAX_HEADER_BYTES {
                let place = format!("line {}", bytes.split(|&b| b == b'\n').count());
                let message = format!("the header has no end within {MAX_HEADER_BYTES} bytes; a blank line ends it");
                return Err(FileError::content(path, place, message));
            }
            if bytes[start..].trim_ascii_end().is_empty() {
                break;
            }
        }
        let mut cursor = Cursor::new(path, &bytes);
        let first = cursor.line().unwrap_or_default();
        if !matches!(first.trim_end().as_bytes(), [b'N', b'R', b'R', b'D', b'0', b'0', b'0', b'1'..=b'5']) {
            return Err(cursor.fault("the first line is not NRRD0001 to NRRD0005"));
        }
        let mut fields: HashMap<String, (usize, String)> = HashMap::new();
        while let Some(text) = cursor.filled_line() {
            // Comments and "key:=value" say nothing about the volume, but may say who the patient is.
            if text.starts_with('#') {
                continue;
            }
            let text = text.trim_end();
            match text.split_once(": ").or_else(|| text.strip_suffix(':').map(|key| (key, ""))) {
                Some((key, _)) if key.contains(":=") => {}
                None if text.contains(":=") => {}
                Some((key, value)) => {
                    let key = key.trim().to_ascii_lowercase();
                    let key = if key == "datafile" { "data file".into() } else { key };
                    let field = (cursor.line, value.trim().to_owned());
                    if let Some((before, _)) = fields.insert(key.clone(), field) {
                        let key = key.escape_default();
                        return Err(cursor.fault(format!("field \"{key}\" is given once more; line {before} has it")));
                    }
                }
                None => {
                    let message =
                        "neither \"field: value\", \"key:=value\" nor a comment; a blank line ends the header";
                    return Err(cursor.fault(message));
                }
            }
        }
        Ok(Self { path, fields, n_bytes: bytes.len() as u64 })
    }

    /// Number of voxels along each of the three axes of space, and which axis of a single frame or channel was left out.
    fn size(&self) -> Result<([usize; 3], Option<usize>), FileError> {
        let dimension = self.numbers("dimension")?.first().copied().unwrap_or(0.0) as usize;
        let mut sizes = self.numbers("sizes")?;
        if sizes.len() != dimension {
            return Err(self.fault("sizes", format!("{} sizes for {dimension} dimensions", sizes.len())));
        }
        let single = (dimension == 4).then(|| self.single_axis(&sizes)).flatten();
        if let Some(axis) = single {
            sizes.remove(axis);
        }
        let [nx, ny, nz] = sizes[..] else {
            let message = format!(
                "{dimension} dimensions; 3 are read, and a fourth of 1: save the one frame or channel that shows the bone as a \
                 volume of its own"
            );
            return Err(self.fault("dimension", message));
        };
        if sizes.iter().any(|s| s.fract() != 0.0 || !(1.0..1e9).contains(s)) {
            return Err(self.fault("sizes", format!("{nx} x {ny} x {nz} voxels; whole numbers from 1 are needed")));
        }
        Ok(([nx as usize, ny as usize, nz as usize], single))
    }

    /// The axis of size 1 that is none of space: the one without a direction, else the last or the first.
    fn single_axis(&self, sizes: &[f64]) -> Option<usize> {
        let directions = self.get("space directions").map(|(_, text)| text.replace("none", "(none)"));
        let without = directions.and_then(|text| text.split('(').skip(1).position(|part| part.starts_with("none")));
        let axes = without.into_iter().chain([3, 0]);
        axes.into_iter().find(|axis| sizes.get(*axis) == Some(&1.0) && without.is_none_or(|only| only == *axis))
    }

    fn scalar(&self, name: &str) -> Result<Scalar, FileError> {
        Ok(match name {
            "signed char" | "int8" | "int8_t" => Scalar::I8,
            "uchar" | "unsigned char" | "uint8" | "uint8_t" => Scalar::U8,
            "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => Scalar::I16,
            "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => Scalar::U16,
            "int" | "signed int" | "int32" | "int32_t" => Scalar::I32,
            "uint" | "unsigned int" | "uint32" | "uint32_t" => Scalar::U32,
            "longlong"
            | "long long"
            | "long long int"
            | "signed long long"
            | "signed long long int"
            | "int64"
            | "int64_t" => Scalar::I64,
            "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => Scalar::U64,
            "float" => Scalar::F32,
            "double" => Scalar::F64,
            _ => {
                let message = format!("type \"{name}\" is not read; save the volume as short or float");
                return Err(self.fault("type", message));
            }
        })
    }

    /// A number of bytes or lines; 0 if the field is missing, -1 at least.
    fn number_of(&self, key: &str) -> Result<i64, FileError> {
        let Some((_, text)) = self.get(key) else { return Ok(0) };
        let number = text.parse().ok().filter(|n| *n >= -1);
        number.ok_or_else(|| self.fault(key, format!("\"{text}\" is no number of them")))
    }

    fn get(&self, key: &str) -> Option<(usize, &str)> {
        self.fields.get(key).map(|(line, value)| (*line, value.as_str()))
    }

    fn fault(&self, key: &str, message: impl Into<String>) -> FileError {
        let place = self.get(key).map_or("header".into(), |(line, _)| format!("line {line} ({key})"));
        FileError::content(self.path, place, message)
    }

    fn text(&self, key: &str) -> Result<&str, FileError> {
        let missing = || FileError::content(self.path, "header", format!("no field \"{key}\"; write the volume again"));
        self.get(key).map(|(_, value)| value).ok_or_else(missing)
    }

    fn numbers(&self, key: &str) -> Result<Vec<f64>, FileError> {
        let number = |word: &str| {
            let fault = || self.fault(key, format!("\"{}\" is no number", shown(word.as_bytes())));
            word.parse::<f64>().map_err(|_| fault())
        };
        self.text(key)?.split_ascii_whitespace().map(number).collect()
    }

    /// Vectors such as `(1,0,0) (0,1,0) none`; `none` is left out.
    fn vectors(&self, key: &str) -> Result<Vec<[f64; 3]>, FileError> {
        let fault = || self.fault(key, "vectors are written (x,y,z), with three numbers each");
        let mut rest = self.text(key)?.trim();
        let mut vectors = Vec::new();
        while !rest.is_empty() {
            if let Some(after) = rest.strip_prefix("none") {
                rest = after.trim_start();
                continue;
            }
            let (inside, after) = rest.strip_prefix('(').and_then(|r| r.split_once(')')).ok_or_else(fault)?;
            let numbers: Option<Vec<f64>> = inside.split(',').map(|word| word.trim().parse().ok()).collect();
            let vector = match numbers.as_deref() {
                Some(&[x, y, z]) => [x, y, z],
                // Of a space with a fourth axis, along which no axis of the others goes.
                Some(&[x, y, z, w]) if w == 0.0 || [x, y, z] == [0.0; 3] || key == "space origin" => [x, y, z],
                _ => return Err(fault()),
            };
            vectors.push(vector);
            rest = after.trim_start();
        }
        Ok(vectors)
    }

    /// The path of the data of a detached header.
    fn data_path(&self) -> Option<PathBuf> {
        let (_, name) = self.get("data file")?;
        Some(folder_of(self.path).join(name))
    }

    /// The file with the data, at their beginning, and the number of bytes from there to its end.
    fn data(&self, reader: BufReader<File>) -> Result<(PathBuf, BufReader<File>, u64), FileError> {
        let length = |file: &File| file.metadata().map(|m| m.len());
        let Some((_, name)) = self.get("data file") else {
            let all = length(reader.get_ref()).map_err(FileError::read(self.path))?;
            return Ok((self.path.into(), reader, all.saturating_sub(self.n_bytes)));
        };
        let refused = |message: &str| Err(self.fault("data file", message));
        if name.starts_with("LIST") || name.contains('%') {
            return refused("the data are in several files; save the volume as one .nrrd file");
        }
        let real = match beside(self.path, name)? {
            Ok(real) => real,
            Err(message) => return refused(message),
        };
        let file = input::open(&real)?;
        let n = length(&file).map_err(FileError::read(&real))?;
        Ok((folder_of(self.path).join(name), BufReader::new(file), n))
    }
}

/// The map from voxels to LPS, mm, and whether the orientation is stated.
fn placement(
    header: &Header,
    single: Option<usize>,
    notes: &mut Vec<String>,
) -> Result<(nalgebra::Matrix4<f64>, bool), FileError> {
    let unit_mm = match header.get("space units") {
        None => 1.0,
        Some((line, text)) => {
            if ["???", "none"].iter().any(|unit| text.contains(unit)) {
                notes.push(format!("line {line}: the unit of length is not stated ({text}); millimetres were assumed"));
            }
            let units: Vec<&str> = text.split('"').map(str::trim).filter(|u| !u.is_empty()).collect();
            let one = |unit: &str| match unit {
                "mm" | "millimeter" | "millimeters" | "???" | "none" => Some(1.0),
                "m" | "meter" | "meters" => Some(1000.0),
                "cm" => Some(10.0),
                "um" | "µm" | "micron" | "microns" | "micrometer" => Some(0.001),
                _ => None,
            };
            match units[..] {
                [a, b, c] if a == b && b == c && one(a).is_some() => one(a).unwrap_or(1.0),
                _ => {
                    let message = "three equal units of length are needed, such as \"mm\" \"mm\" \"mm\"";
                    return Err(header.fault("space units", message));
                }
            }
        }
    };
    let space = header.get("space").map(|(_, text)| text.to_ascii_lowercase());
    let signs = match space.as_deref() {
        Some("left-posterior-superior" | "lps") => Some([1.0, 1.0, 1.0]),
        Some("right-anterior-superior" | "ras") => Some([-1.0, -1.0, 1.0]),
        Some("left-anterior-superior" | "las") => Some([1.0, -1.0, 1.0]),
        Some("scanner-xyz" | "3d-right-handed" | "3d-left-handed") | None => None,
        Some(_) => {
            let message = "this space is not read; left-posterior-superior, right-anterior-superior and left-anterior-superior are";
            return Err(header.fault("space", message));
        }
    };
    if signs.is_none() {
        notes.push(
            "orientation unknown: no space such as left-posterior-superior is stated, so how the volume lies in the patient is \
             unknown, and the surface may be mirrored"
                .into(),
        );
    }
    let axes: [[f64; 3]; 3] = if header.get("space directions").is_some() {
        let mut directions = header.vectors("space directions")?;
        if let Some(axis) = single.filter(|axis| directions.len() == 4 && directions[*axis] == [0.0; 3]) {
            directions.remove(axis);
        }
        directions.try_into().map_err(|other: Vec<_>| {
            header.fault("space directions", format!("{} directions for 3 axes", other.len()))
        })?
    } else if signs.is_none() && header.get("spacings").is_some() {
        let mut spacings = header.numbers("spacings")?;
        if let Some(axis) = single.filter(|axis| *axis < spacings.len()) {
            spacings.remove(axis);
        }
        if spacings.len() != 3 {
            return Err(header.fault("spacings", format!("{} spacings for 3 axes", spacings.len())));
        }
        std::array::from_fn(|k| std::array::from_fn(|r| if r == k { spacings[k] } else { 0.0 }))
    } else {
        let message = "no field \"space directions\" (nor \"spacings\" without a space), so the size of a voxel is unknown; export \
                       the volume with its geometry";
        return Err(FileError::content(header.path, "header", message));
    };
    let first = match header.get("space origin") {
        None => {
            notes.push("no space origin is stated; the first voxel was placed at 0, 0, 0".into());
            [0.0; 3]
        }
        Some(_) => match header.vectors("space origin")?[..] {
            [origin] => origin,
            ref other => {
                return Err(header.fault("space origin", format!("{} points; one is needed", other.len())));
            }
        },
    };
    let scaled = |v: [f64; 3]| v.map(|c| c * unit_mm);
    Ok((affine(axes.map(scaled), scaled(first), signs.unwrap_or([1.0; 3])), signs.is_some()))
}
