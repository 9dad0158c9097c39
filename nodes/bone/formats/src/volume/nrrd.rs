//! NRRD files: raw, gzip and text encodings, with the data behind the header or in a file beside it.
//!
//! # Source
//! Kindlmann, "Definition of NRRD File Format", teem.sourceforge.net/nrrd/format.html.

use super::grid::{Volume, VolumeRead, affine, assumed_unit, n_voxels_and_bytes};
use super::numbers::{Encoding, StreamError, drain, gunzip, gzip_limit, read_voxels};
use crate::scalar::Scalar;
use crate::{FileError, input};
use std::{
    collections::HashMap,
    fs::File,
    io::{BufRead, BufReader, Read, Seek, SeekFrom},
    path::{Path, PathBuf},
};

/// A longer header is no header.
const MAX_HEADER_BYTES: usize = 1 << 20;

/// A header's fields by name, in lower case, with their lines.
struct Header {
    fields: HashMap<String, (usize, String)>,
    /// Its length with the blank line.
    n_bytes: u64,
}

/// The file that holds the data of a detached header; none if the data follow the header, or it cannot be read.
pub(super) fn data_file(path: &Path) -> Option<PathBuf> {
    let mut reader = BufReader::new(input::open(path).ok()?);
    Header::read(path, &mut reader).ok()?.data_path(path)
}

/// Reads a .nrrd or .nhdr file.
pub(super) fn read(path: &Path) -> Result<VolumeRead, FileError> {
    let file = input::open(path)?;
    let mut reader = BufReader::new(file);
    let header = Header::read(path, &mut reader)?;
    let mut notes = Vec::new();

    let dimension: usize = header.numbers(path, "dimension")?.first().copied().unwrap_or(0.0) as usize;
    if dimension != 3 {
        let message = format!(
            "{dimension} dimensions; 3 are read: save the one frame or channel that shows the bone as a volume of its own"
        );
        return Err(header.fault(path, "dimension", message));
    }
    let sizes = header.numbers(path, "sizes")?;
    let [nx, ny, nz] = sizes[..] else {
        return Err(header.fault(path, "sizes", format!("{} sizes for 3 dimensions", sizes.len())));
    };
    if sizes.iter().any(|s| s.fract() != 0.0 || !(1.0..1e9).contains(s)) {
        return Err(header.fault(path, "sizes", format!("{nx} x {ny} x {nz} voxels; whole numbers from 1 are needed")));
    }
    let size = [nx as usize, ny as usize, nz as usize];
    let type_name = header.text(path, "type")?.to_ascii_lowercase();
    let scalar = match type_name.as_str() {
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
        other => {
            let message = format!("type \"{other}\" is not read; save the volume as short or float");
            return Err(header.fault(path, "type", message));
        }
    };
    let (t_lps_voxel, is_oriented) = placement(path, &header, &mut notes)?;
    let encoding_name = header.text(path, "encoding")?.to_ascii_lowercase();
    let is_big = match header.get("endian").map(|(_, v)| v.to_ascii_lowercase()) {
        Some(order) if order == "little" => false,
        Some(order) if order == "big" => true,
        Some(order) => return Err(header.fault(path, "endian", format!("\"{order}\" is neither little nor big"))),
        None if scalar.n_bytes() == 1 || matches!(encoding_name.as_str(), "ascii" | "text" | "txt") => false,
        None => {
            let message =
                format!("no field \"endian\", which {type_name} needs; add \"endian: little\" or \"endian: big\"");
            return Err(FileError::content(path, "header", message));
        }
    };
    let (data_path, mut data, data_bytes) = header.data(path, reader)?;
    let fault = |place: String, message: String| FileError::content(&data_path, place, message);
    let Some((n, n_bytes)) = n_voxels_and_bytes(size, scalar.n_bytes()) else {
        return Err(header.fault(path, "sizes", format!("{nx} x {ny} x {nz} voxels are more than can be counted")));
    };
    let too_short = |found: String| {
        let message =
            format!("cut short: {nx} x {ny} x {nz} {type_name} are {n_bytes} bytes, {found}; copy the file again");
        fault("data".into(), message)
    };
    let skip = |key: &str| -> Result<i64, FileError> {
        let Some((_, text)) = header.get(key) else { return Ok(0) };
        text.parse()
            .ok()
            .filter(|n| *n >= -1)
            .ok_or_else(|| header.fault(path, key, format!("\"{text}\" is no number of them")))
    };
    let (n_lines, n_skipped) = (skip("line skip")?.max(0), skip("byte skip")?);
    for _ in 0..n_lines {
        let n = data.skip_until(b'\n').map_err(FileError::read(&data_path))?;
        if n == 0 {
            return Err(fault(
                "data".into(),
                format!("the file ends before the {n_lines} lines that \"line skip\" leaves out"),
            ));
        }
    }
    let encoding = Encoding { scalar, is_big, slope: 1.0, intercept: 0.0 };
    let broken = |error: std::io::Error| fault("gzip".into(), format!("{error}; copy the file again"));
    let short = |error: StreamError| match error {
        StreamError::Short(found) => too_short(format!("but only {} are there", found * scalar.n_bytes())),
        StreamError::Io(error) => broken(error),
    };
    let (voxels, n_extra) = match encoding_name.as_str() {
        "raw" => {
            if n_bytes > data_bytes {
                return Err(too_short(format!("but only {data_bytes} are there")));
            }
            if n_skipped == -1 {
                data.seek(SeekFrom::End(-(n_bytes as i64))).map_err(FileError::read(&data_path))?;
            } else {
                drain(&mut data, n_skipped as u64).map_err(FileError::read(&data_path))?;
            }
            let voxels = read_voxels(&mut data, n, n, &encoding).map_err(short)?;
            (voxels, drain(&mut data, 1 << 20).map_err(FileError::read(&data_path))?)
        }
        "gzip" | "gz" => {
            if n_bytes > gzip_limit(data_bytes) {
                return Err(too_short(format!("{data_bytes} bytes of gzip cannot hold them")));
            }
            if n_skipped == -1 {
                let message = "\"byte skip: -1\" is for raw data; write the number of bytes".into();
                return Err(header.fault(path, "byte skip", message));
            }
            let mut decoder = gunzip(data);
            drain(&mut decoder, n_skipped as u64).map_err(broken)?;
            let voxels = read_voxels(&mut decoder, n, n, &encoding).map_err(short)?;
            (voxels, drain(&mut decoder, 1 << 20).map_err(broken)?)
        }
        "ascii" | "text" | "txt" => {
            // Each number but the last takes two bytes.
            if (n as u64).saturating_mul(2) > data_bytes.saturating_add(1) {
                return Err(too_short(format!("{data_bytes} bytes of text cannot hold {n} numbers")));
            }
            drain(&mut data, n_skipped.max(0) as u64).map_err(FileError::read(&data_path))?;
            text_voxels(&data_path, data, n)?
        }
        other => {
            let message = format!("encoding \"{other}\" is not read; save the volume as raw or gzip");
            return Err(header.fault(path, "encoding", message));
        }
    };
    if n_extra > 0 {
        notes.push(format!("{n_extra} bytes or more follow the volume and were not read"));
    }
    let unit = assumed_unit(&voxels, "NRRD", &mut notes);
    let volume = Volume { size, voxels, t_lps_voxel, unit, is_oriented };
    Ok(VolumeRead { volume, source: format!("NRRD, {encoding_name}"), notes })
}

/// `n` numbers as text, and the number of bytes behind them.
fn text_voxels(path: &Path, mut data: BufReader<File>, n: usize) -> Result<(Vec<f32>, u64), FileError> {
    let mut voxels = Vec::new();
    let mut line = Vec::new();
    let mut n_line = 0;
    while voxels.len() < n {
        line.clear();
        n_line += 1;
        let fault = |message: String| FileError::content(path, format!("line {n_line} of the data"), message);
        if data.read_until(b'\n', &mut line).map_err(FileError::read(path))? == 0 {
            return Err(fault(format!("cut short: {} of {n} numbers; copy the file again", voxels.len())));
        }
        for word in line.split(|b| b.is_ascii_whitespace() || *b == b',').filter(|word| !word.is_empty()) {
            let number = std::str::from_utf8(word).ok().and_then(|word| word.parse::<f32>().ok());
            voxels.push(number.ok_or_else(|| fault(format!("\"{}\" is no number", shown(word))))?);
        }
    }
    if voxels.len() > n {
        let message = format!("{} numbers, but the sizes promise {n}", voxels.len());
        return Err(FileError::content(path, format!("line {n_line} of the data"), message));
    }
    let n_extra = drain(&mut data, 1 << 20).map_err(FileError::read(path))?;
    Ok((voxels, n_extra))
}

/// The beginning of a word that is no number.
fn shown(word: &[u8]) -> String {
    String::from_utf8_lossy(&word[..word.len().min(20)]).escape_default().to_string()
}

impl Header {
    fn read(path: &Path, reader: &mut BufReader<File>) -> Result<Self, FileError> {
        let mut fields: HashMap<String, (usize, String)> = HashMap::new();
        let (mut n_bytes, mut n_line) = (0u64, 0);
        let mut line = Vec::new();
        loop {
            line.clear();
            n_line += 1;
            let fault = |message: String| FileError::content(path, format!("line {n_line}"), message);
            let n = reader
                .by_ref()
                .take(MAX_HEADER_BYTES as u64)
                .read_until(b'\n', &mut line)
                .map_err(FileError::read(path))?;
            n_bytes += n as u64;
            if n_bytes >= MAX_HEADER_BYTES as u64 {
                return Err(fault(format!(
                    "the header has no end within {MAX_HEADER_BYTES} bytes; a blank line ends it"
                )));
            }
            let text = String::from_utf8_lossy(line.trim_ascii_end()).into_owned();
            // A detached header may end with its file.
            if n == 0 || text.is_empty() {
                break;
            }
            let is_version = n_line == 1 && text.len() == 8 && text.starts_with("NRRD000") && text.is_ascii();
            if n_line == 1 {
                if !is_version || !(b'1'..=b'5').contains(&text.as_bytes()[7]) {
                    return Err(fault("the first line is not NRRD0001 to NRRD0005".into()));
                }
            } else if let Some((key, value)) =
                text.split_once(": ").or_else(|| text.strip_suffix(':').map(|key| (key, "")))
            {
                // Comments and "key:=value" say nothing about the volume, but may say who the patient is.
                if text.starts_with('#') || key.contains(":=") {
                    continue;
                }
                let key = key.trim().to_ascii_lowercase();
                let key = if key == "datafile" { "data file".into() } else { key };
                let value = value.trim().to_string();
                if let Some((before, _)) = fields.insert(key.clone(), (n_line, value)) {
                    return Err(fault(format!(
                        "field \"{}\" is given once more; line {before} has it",
                        key.escape_default()
                    )));
                }
            } else if !text.starts_with('#') && !text.contains(":=") {
                return Err(fault(
                    "neither \"field: value\", \"key:=value\" nor a comment; a blank line ends the header".into(),
                ));
            }
        }
        Ok(Self { fields, n_bytes })
    }

    fn get(&self, key: &str) -> Option<(usize, &str)> {
        self.fields.get(key).map(|(line, value)| (*line, value.as_str()))
    }

    fn fault(&self, path: &Path, key: &str, message: String) -> FileError {
        let place = self.get(key).map_or("header".into(), |(line, _)| format!("line {line} ({key})"));
        FileError::content(path, place, message)
    }

    fn text(&self, path: &Path, key: &str) -> Result<&str, FileError> {
        let missing = || FileError::content(path, "header", format!("no field \"{key}\"; write the volume again"));
        self.get(key).map(|(_, value)| value).ok_or_else(missing)
    }

    fn numbers(&self, path: &Path, key: &str) -> Result<Vec<f64>, FileError> {
        let number = |word: &str| {
            let fault = || self.fault(path, key, format!("\"{}\" is no number", shown(word.as_bytes())));
            word.parse::<f64>().map_err(|_| fault())
        };
        self.text(path, key)?.split_ascii_whitespace().map(number).collect()
    }

    /// Vectors such as `(1,0,0) (0,1,0) none`; `none` is left out.
    fn vectors(&self, path: &Path, key: &str) -> Result<Vec<[f64; 3]>, FileError> {
        let fault = || self.fault(path, key, "vectors are written (x,y,z), with three numbers each".into());
        let mut rest = self.text(path, key)?.trim();
        let mut vectors = Vec::new();
        while !rest.is_empty() {
            if let Some(after) = rest.strip_prefix("none") {
                rest = after.trim_start();
                continue;
            }
            let (inside, after) = rest.strip_prefix('(').and_then(|r| r.split_once(')')).ok_or_else(fault)?;
            let numbers: Option<Vec<f64>> = inside.split(',').map(|word| word.trim().parse().ok()).collect();
            let vector: [f64; 3] = numbers.and_then(|n| n.try_into().ok()).ok_or_else(fault)?;
            vectors.push(vector);
            rest = after.trim_start();
        }
        Ok(vectors)
    }

    /// The path of the data of a detached header.
    fn data_path(&self, path: &Path) -> Option<PathBuf> {
        let (_, name) = self.get("data file")?;
        Some(path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).join(name))
    }

    /// The file with the data, at their beginning, and the number of bytes from there to its end.
    fn data(&self, path: &Path, reader: BufReader<File>) -> Result<(PathBuf, BufReader<File>, u64), FileError> {
        let length = |file: &File| file.metadata().map(|m| m.len());
        let Some((_, name)) = self.get("data file") else {
            let all = length(reader.get_ref()).map_err(FileError::read(path))?;
            return Ok((path.into(), reader, all.saturating_sub(self.n_bytes)));
        };
        let refused = |message: &str| Err(self.fault(path, "data file", message.into()));
        if name.starts_with("LIST") || name.contains('%') {
            return refused("the data are in several files; save the volume as one .nrrd file");
        }
        if name.is_empty() || name == "." || name == ".." || name.contains(['/', '\\', ':', '\0']) {
            return refused("the data must be in a file beside the header: a name without a folder");
        }
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let beside = folder.join(name);
        let real = std::fs::canonicalize(&beside).map_err(FileError::read(&beside))?;
        let real_folder = std::fs::canonicalize(folder).map_err(FileError::read(folder))?;
        if real.parent() != Some(&real_folder) {
            return refused("the data file is a link out of the header's folder; copy the data beside the header");
        }
        let file = input::open(&real)?;
        let n = length(&file).map_err(FileError::read(&beside))?;
        Ok((beside, BufReader::new(file), n))
    }
}

/// The map from voxels to LPS, mm, and whether the orientation is stated.
fn placement(
    path: &Path,
    header: &Header,
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
                    let message = "three equal units of length are needed, such as \"mm\" \"mm\" \"mm\"".into();
                    return Err(header.fault(path, "space units", message));
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
            return Err(header.fault(path, "space", message.into()));
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
        header.vectors(path, "space directions")?.try_into().map_err(|found: Vec<_>| {
            header.fault(path, "space directions", format!("{} directions for 3 axes", found.len()))
        })?
    } else if signs.is_none() && header.get("spacings").is_some() {
        let spacings = header.numbers(path, "spacings")?;
        if spacings.len() != 3 {
            return Err(header.fault(path, "spacings", format!("{} spacings for 3 axes", spacings.len())));
        }
        std::array::from_fn(|k| std::array::from_fn(|r| if r == k { spacings[k] } else { 0.0 }))
    } else {
        let message = "no field \"space directions\" (nor \"spacings\" without a space), so the size of a voxel is unknown; export \
                       the volume with its geometry";
        return Err(FileError::content(path, "header", message));
    };
    let first = match header.get("space origin") {
        None => {
            notes.push("no space origin is stated; the first voxel was placed at 0, 0, 0".into());
            [0.0; 3]
        }
        Some(_) => match header.vectors(path, "space origin")?[..] {
            [origin] => origin,
            ref other => {
                return Err(header.fault(path, "space origin", format!("{} points; one is needed", other.len())));
            }
        },
    };
    let scaled = |v: [f64; 3]| v.map(|c| c * unit_mm);
    Ok((affine(axes.map(scaled), scaled(first), signs.unwrap_or([1.0; 3])), signs.is_some()))
}
