//! NRRD files: raw, gzip and text encodings, with the data behind the header or in a file beside it.
//!
//! # Source
//! Kindlmann, "Definition of NRRD File Format", teem.sourceforge.net/nrrd/format.html.

use super::grid::{Volume, VolumeRead, affine, assumed_unit, n_voxels_and_bytes};
use super::numbers::{Encoding, StreamError, drain, gzip_limit, read_all};
use crate::scalar::Scalar;
use crate::{FileError, cursor::Cursor, input};
use flate2::read::MultiGzDecoder;
use std::{
    collections::HashMap,
    fs::File,
    io::{BufRead, BufReader, Read, Seek, SeekFrom},
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
    let size = header.size()?;
    let type_name = header.text("type")?.to_ascii_lowercase();
    let scalar = header.scalar(&type_name)?;
    let (t_lps_voxel, is_oriented) = placement(&header, &mut notes)?;
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
        "gzip" | "gz" => data.gzip(n_skipped as u64)?,
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

/// The data of a volume, from their beginning on.
struct Data {
    path: PathBuf,
    reader: BufReader<File>,
    /// Bytes from there to the end of the file.
    n_there: u64,
    /// Number of voxels.
    n: usize,
    /// Bytes of the voxels.
    n_bytes: u64,
    /// What the header promises, for messages.
    promise: String,
    encoding: Encoding,
}

impl Data {
    fn fault(&self, place: &str, message: impl Into<String>) -> FileError {
        FileError::content(&self.path, place, message)
    }

    fn too_short(&self, there: &str) -> FileError {
        self.fault("data", format!("cut short: {}, {there}; copy the file again", self.promise))
    }

    fn broken(&self, error: StreamError) -> FileError {
        match error {
            StreamError::Short(n) => {
                self.too_short(&format!("but only {} are there", n * self.encoding.scalar.n_bytes()))
            }
            StreamError::Io(error) => self.fault("gzip", format!("{error}; copy the file again")),
        }
    }

    fn skip_lines(&mut self, n_lines: i64) -> Result<(), FileError> {
        for _ in 0..n_lines {
            if self.reader.skip_until(b'\n').map_err(FileError::read(&self.path))? == 0 {
                let message = format!("the file ends before the {n_lines} lines that \"line skip\" leaves out");
                return Err(self.fault("data", message));
            }
        }
        Ok(())
    }

    /// The voxels of raw data, and the number of bytes behind them; those before them are skipped, -1 for all.
    fn raw(mut self, n_skipped: i64) -> Result<(Vec<f32>, u64), FileError> {
        if self.n_bytes > self.n_there {
            return Err(self.too_short(&format!("but only {} are there", self.n_there)));
        }
        let skipped = match u64::try_from(n_skipped) {
            Ok(n) => drain(&mut self.reader, n),
            Err(_) => self.reader.seek(SeekFrom::End(-(self.n_bytes as i64))),
        };
        skipped.map_err(FileError::read(&self.path))?;
        read_all(&mut self.reader, self.n, &self.encoding).map_err(|error| match error {
            StreamError::Io(error) => FileError::read(&self.path)(error),
            short => self.broken(short),
        })
    }

    fn gzip(mut self, n_skipped: u64) -> Result<(Vec<f32>, u64), FileError> {
        if self.n_bytes > gzip_limit(self.n_there) {
            return Err(self.too_short(&format!("{} bytes of gzip cannot hold them", self.n_there)));
        }
        let mut decoder = MultiGzDecoder::new(&mut self.reader);
        let skipped = drain(&mut decoder, n_skipped).map_err(StreamError::Io);
        let voxels = skipped.and_then(|_| read_all(&mut decoder, self.n, &self.encoding));
        voxels.map_err(|error| self.broken(error))
    }

    /// The voxels of numbers as text, and the number of bytes behind them.
    fn text(mut self, n_skipped: u64) -> Result<(Vec<f32>, u64), FileError> {
        let n = self.n;
        // Each number but the last takes two bytes.
        if (n as u64).saturating_mul(2) > self.n_there.saturating_add(1) {
            return Err(self.too_short(&format!("{} bytes of text cannot hold {n} numbers", self.n_there)));
        }
        drain(&mut self.reader, n_skipped).map_err(FileError::read(&self.path))?;
        let (mut voxels, mut line, mut n_line) = (Vec::new(), Vec::new(), 0);
        while voxels.len() < n {
            line.clear();
            n_line += 1;
            let n_read = self.reader.read_until(b'\n', &mut line).map_err(FileError::read(&self.path))?;
            let fault = |message: String| self.fault(&format!("line {n_line} of the data"), message);
            if n_read == 0 {
                return Err(fault(format!("cut short: {} of {n} numbers; copy the file again", voxels.len())));
            }
            for word in line.split(|b| b.is_ascii_whitespace() || *b == b',').filter(|word| !word.is_empty()) {
                let number = std::str::from_utf8(word).ok().and_then(|word| word.parse::<f32>().ok());
                voxels.push(number.ok_or_else(|| fault(format!("\"{}\" is no number", shown(word))))?);
            }
            if voxels.len() > n {
                return Err(fault(format!("{} numbers, but the sizes promise {n}", voxels.len())));
            }
        }
        let n_extra = drain(&mut self.reader, 1 << 20).map_err(FileError::read(&self.path))?;
        Ok((voxels, n_extra))
    }
}

/// The beginning of a word that is no number.
fn shown(word: &[u8]) -> String {
    String::from_utf8_lossy(&word[..word.len().min(20)]).escape_default().to_string()
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

    /// Number of voxels along each axis.
    fn size(&self) -> Result<[usize; 3], FileError> {
        let dimension = self.numbers("dimension")?.first().copied().unwrap_or(0.0) as usize;
        if dimension != 3 {
            let message = format!(
                "{dimension} dimensions; 3 are read: save the one frame or channel that shows the bone as a volume of its own"
            );
            return Err(self.fault("dimension", message));
        }
        let sizes = self.numbers("sizes")?;
        let [nx, ny, nz] = sizes[..] else {
            return Err(self.fault("sizes", format!("{} sizes for 3 dimensions", sizes.len())));
        };
        if sizes.iter().any(|s| s.fract() != 0.0 || !(1.0..1e9).contains(s)) {
            return Err(self.fault("sizes", format!("{nx} x {ny} x {nz} voxels; whole numbers from 1 are needed")));
        }
        Ok([nx as usize, ny as usize, nz as usize])
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
            let vector: [f64; 3] = numbers.and_then(|n| n.try_into().ok()).ok_or_else(fault)?;
            vectors.push(vector);
            rest = after.trim_start();
        }
        Ok(vectors)
    }

    fn folder(&self) -> &Path {
        self.path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
    }

    /// The path of the data of a detached header.
    fn data_path(&self) -> Option<PathBuf> {
        let (_, name) = self.get("data file")?;
        Some(self.folder().join(name))
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
        if name.is_empty() || name == "." || name == ".." || name.contains(['/', '\\', ':', '\0']) {
            return refused("the data must be in a file beside the header: a name without a folder");
        }
        let folder = self.folder();
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
fn placement(header: &Header, notes: &mut Vec<String>) -> Result<(nalgebra::Matrix4<f64>, bool), FileError> {
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
        header.vectors("space directions")?.try_into().map_err(|other: Vec<_>| {
            header.fault("space directions", format!("{} directions for 3 axes", other.len()))
        })?
    } else if signs.is_none() && header.get("spacings").is_some() {
        let spacings = header.numbers("spacings")?;
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
