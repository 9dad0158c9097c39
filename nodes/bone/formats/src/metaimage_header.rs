//! The header of a MetaImage (.mha, .mhd): lines `key = value` up to `ElementDataFile`, behind which the data may begin.
//!
//! # Source
//! MetaIO of Kitware (metaUtils.cxx, `MET_Read`): names count as written, `:` separates as `=` does, and `ElementDataFile` is the
//! last field.

use crate::{FileError, scalar};
use std::{
    collections::HashMap,
    io::{BufRead, Read},
    path::Path,
};

/// The last field.
pub(crate) const DATA_FILE: &str = "ElementDataFile";

/// A longer line is no line of a header.
const MAX_LINE_BYTES: u64 = 1 << 20;
/// A longer header is no header; the poses of 100 000 frames take less.
const MAX_HEADER_BYTES: usize = 1 << 28;

/// A header's fields, in their order.
pub(crate) struct Header<'a> {
    path: &'a Path,
    fields: Vec<Field>,
    by_key: HashMap<String, usize>,
    /// Byte behind the line of `ElementDataFile`, at which the data of `LOCAL` begin.
    pub(crate) data_start: u64,
}

/// A field of a header.
pub(crate) struct Field {
    pub(crate) key: String,
    pub(crate) value: String,
    /// From 1 on.
    pub(crate) line: usize,
}

/// Whether a file begins like a MetaImage: `ObjectType = Image`, or without that line `NDims`, as the oldest writers have it.
pub(crate) fn is_metaimage(start: &[u8]) -> bool {
    let start = start.strip_prefix(b"\xef\xbb\xbf").unwrap_or(start).trim_ascii_start();
    let first = start.split(|b| *b == b'\n').next().unwrap_or_default();
    let Some((key, value)) = key_and_value(first) else { return false };
    match key {
        b"ObjectType" => value == b"Image",
        b"NDims" => value.iter().all(u8::is_ascii_digit) && !value.is_empty(),
        _ => false,
    }
}

/// Key and value of a line, separated by the first `=` or `:`.
fn key_and_value(line: &[u8]) -> Option<(&[u8], &[u8])> {
    let at = line.iter().position(|b| matches!(b, b'=' | b':'))?;
    Some((line[..at].trim_ascii(), line[at + 1..].trim_ascii()))
}

impl<'a> Header<'a> {
    /// Reads the header; `reader` is then where the data of `LOCAL` begin.
    ///
    /// # Errors
    /// [`FileError`] with the line that is no field, gives one twice, or is missing.
    pub(crate) fn read(path: &'a Path, reader: &mut impl BufRead) -> Result<Self, FileError> {
        let mut header = Self { path, fields: Vec::new(), by_key: HashMap::new(), data_start: 0 };
        let mut bytes = Vec::new();
        for line in 1.. {
            bytes.clear();
            reader.by_ref().take(MAX_LINE_BYTES).read_until(b'\n', &mut bytes).map_err(FileError::read(path))?;
            let fault = |message: String| FileError::content(path, format!("line {line}"), message);
            let n = bytes.len() as u64;
            if n == 0 {
                let message = format!("the header ends without {DATA_FILE}; was the file cut short?");
                return Err(FileError::content(path, "header", message));
            }
            header.data_start += n;
            if n == MAX_LINE_BYTES || header.data_start > MAX_HEADER_BYTES as u64 {
                return Err(fault(format!(
                    "the header goes on without {DATA_FILE}, its last field; is it a MetaImage?"
                )));
            }
            let text = if line == 1 { bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes) } else { &bytes };
            if text.trim_ascii().is_empty() {
                continue;
            }
            let (key, value) = key_and_value(text).ok_or_else(|| {
                fault(format!("neither \"key = value\" nor blank; {DATA_FILE} is the last line of a header"))
            })?;
            let [key, value] = [key, value].map(|part| String::from_utf8_lossy(part).into_owned());
            let is_last = key == DATA_FILE;
            let before = header.by_key.insert(key.clone(), header.fields.len());
            if let Some(before) = before {
                let (key, before) = (key.escape_default(), header.fields[before].line);
                return Err(fault(format!("field \"{key}\" is given once more; line {before} has it")));
            }
            header.fields.push(Field { key, value, line });
            if is_last {
                break;
            }
        }
        Ok(header)
    }

    /// Reads the `key:=value` and `field: value` of an NRRD up to the blank line that ends its header.
    ///
    /// # Errors
    /// [`FileError`] with the line that is none of these, or gives a key twice.
    ///
    /// # Source
    /// The NRRD file format, sections 3 and 5.
    pub(crate) fn of_nrrd(path: &'a Path, reader: &mut impl BufRead) -> Result<Self, FileError> {
        let mut header = Self { path, fields: Vec::new(), by_key: HashMap::new(), data_start: 0 };
        let lines = reader.take(MAX_HEADER_BYTES as u64).split(b'\n').enumerate().skip(1);
        for (k, bytes) in lines {
            let (line, bytes) = (k + 1, bytes.map_err(FileError::read(path))?);
            let text = String::from_utf8_lossy(bytes.trim_ascii());
            if text.is_empty() {
                break;
            }
            if text.starts_with('#') {
                continue;
            }
            let fault = |message: &str| Err(FileError::content(path, format!("line {line}"), message));
            let Some((key, value)) = text.split_once(":=").or_else(|| text.split_once(": ")) else {
                return fault("neither \"field: value\", \"key:=value\" nor a comment; a blank line ends the header");
            };
            let [key, value] = [key, value].map(|part| part.trim().to_owned());
            if header.by_key.insert(key.clone(), header.fields.len()).is_some() {
                return fault("the field is given once more");
            }
            header.fields.push(Field { key, value, line });
        }
        Ok(header)
    }

    pub(crate) fn path(&self) -> &'a Path {
        self.path
    }

    /// All fields, in the order of the file.
    pub(crate) fn fields(&self) -> &[Field] {
        &self.fields
    }

    /// The first field that is there of several names for one thing.
    pub(crate) fn get(&self, keys: &[&str]) -> Option<&Field> {
        keys.iter().find_map(|key| self.by_key.get(*key)).map(|k| &self.fields[*k])
    }

    /// A field that must be there.
    pub(crate) fn need(&self, key: &str) -> Result<&Field, FileError> {
        let missing = || FileError::content(self.path, "header", format!("no field \"{key}\"; write the volume again"));
        self.get(&[key]).ok_or_else(missing)
    }

    /// The numbers of a field.
    pub(crate) fn numbers(&self, field: &Field) -> Result<Vec<f64>, FileError> {
        let number = |word: &str| {
            let fault = || self.fault(field, format!("\"{}\" is not a number", word.escape_default()));
            scalar::number(word).ok_or_else(fault)
        };
        field.value.split_ascii_whitespace().map(number).collect()
    }

    /// Whether a field says yes; no if it is missing.
    pub(crate) fn is_set(&self, keys: &[&str]) -> Result<bool, FileError> {
        let Some(field) = self.get(keys) else { return Ok(false) };
        match field.value.to_ascii_lowercase().as_str() {
            "true" | "t" | "1" | "yes" => Ok(true),
            "false" | "f" | "0" | "no" => Ok(false),
            other => Err(self.fault(field, format!("\"{}\" is neither True nor False", other.escape_default()))),
        }
    }

    /// An error at a field.
    pub(crate) fn fault(&self, field: &Field, message: impl Into<String>) -> FileError {
        FileError::content(self.path, format!("line {} ({})", field.line, field.key.escape_default()), message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &[u8]) -> Result<(Vec<(String, String)>, u64), String> {
        let path = Path::new("a.mha");
        let header = Header::read(path, &mut &text[..]).map_err(|error| error.to_string())?;
        let fields = header.fields().iter().map(|field| (field.key.clone(), field.value.clone())).collect();
        Ok((fields, header.data_start))
    }

    #[test]
    fn fields_end_with_the_data_file_and_the_data_begin_behind_its_line() {
        let text =
            b"\xef\xbb\xbfObjectType = Image\r\n\nNDims: 3\nComment = a = b\nElementDataFile = LOCAL\n\x01\x02=\n";
        let (fields, start) = read(text).unwrap();
        let pairs = [("ObjectType", "Image"), ("NDims", "3"), ("Comment", "a = b"), ("ElementDataFile", "LOCAL")];
        assert_eq!(fields, pairs.map(|(key, value)| (key.to_owned(), value.to_owned())));
        assert_eq!(&text[start as usize..], b"\x01\x02=\n");
    }

    #[test]
    fn what_is_no_header_is_refused_with_its_line() {
        for (text, message) in [
            (
                &b"NDims = 3\nDimSize = 1 1 1\n"[..],
                "a.mha: header: the header ends without ElementDataFile; was the file cut short?",
            ),
            (b"NDims = 3\nNDims = 2\n", "a.mha: line 2: field \"NDims\" is given once more; line 1 has it"),
            (
                b"NDims = 3\nvoxels\n",
                "a.mha: line 2: neither \"key = value\" nor blank; ElementDataFile is the last line of a header",
            ),
        ] {
            assert_eq!(read(text).unwrap_err(), message);
        }
        let long = [b"NDims = ".as_slice(), &[b'3'; 1 << 21]].concat();
        assert!(read(&long).unwrap_err().contains("line 1: the header goes on without ElementDataFile"));
    }

    #[test]
    fn a_metaimage_is_known_by_its_first_line() {
        for (start, is) in [
            (&b"ObjectType = Image\nNDims = 3"[..], true),
            (b"ObjectType=Image\r\n", true),
            (b"NDims = 3\nDimSize = 1 1 1\n", true),
            (b"ObjectType = Scene\nNDims = 3", false),
            (b"NDims = x\n", false),
            (b"1 2 3\n", false),
        ] {
            assert_eq!(is_metaimage(start), is, "{start:?}");
        }
    }
}
