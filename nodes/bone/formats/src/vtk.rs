//! Legacy VTK files of poly data, ASCII and binary, in the layouts before and since version 5, and its XML files.

mod xml;

use crate::{
    FileError,
    cursor::Cursor,
    kind::is_vtp,
    scalar::{self, Rows, Scalar},
    shape::{Places, Shape, fan},
    space::StatedSpace,
};
use nalgebra::{Point3, Vector3};
use std::path::Path;

/// The surface in a VTK file, or the cloud if it has neither polygons nor strips.
///
/// Vertices that are NaN are kept for the cloud to drop. Normals of the points are read, and for a cloud also the scalars
/// and fields of one number a point. Lines are left out with a note.
pub(crate) fn shape(path: &Path, bytes: &[u8]) -> Result<Shape, FileError> {
    let mut shape = if is_vtp(bytes) { xml::shape(path, bytes) } else { legacy(path, bytes) }?;
    if shape.faces.is_some() {
        shape.extras.clear();
    }
    Ok(shape)
}

fn legacy(path: &Path, bytes: &[u8]) -> Result<Shape, FileError> {
    let mut cursor = Cursor::new(path, bytes);
    let line = |cursor: &mut Cursor, what: &str| {
        let line = cursor.line().map(String::from);
        line.ok_or_else(|| cursor.fault(format!("the file ends before {what}; was it cut short?")))
    };
    line(&mut cursor, "the version")?;
    let title = line(&mut cursor, "the title")?;
    let stated = StatedSpace::of(&title).map_err(|message| cursor.fault(message))?;
    let encoding = line(&mut cursor, "ASCII or BINARY")?;
    cursor.is_binary = match encoding.trim().to_ascii_uppercase().as_str() {
        "ASCII" => false,
        "BINARY" => true,
        _ => return Err(cursor.fault(format!("\"{}\" is neither ASCII nor BINARY", encoding.trim()))),
    };
    let shape = Shape { stated, ..Shape::default() };
    let mut file = File { cursor, shape, has_dataset: false, has_points: false, attributes: None, lines: Vec::new() };
    while let Some(line) = file.cursor.filled_line() {
        file.section(line.trim())?;
    }
    match file.has_points {
        true => Ok(file.shape),
        false => file.fault("there is no section POINTS; was the file cut short?"),
    }
}

/// Points or cells, and their number.
#[derive(Clone, Copy)]
struct Attributes {
    n: usize,
    of_points: bool,
}

/// A file that is read section by section.
struct File<'a> {
    cursor: Cursor<'a>,
    shape: Shape,
    has_dataset: bool,
    has_points: bool,
    /// What the attributes that follow belong to.
    attributes: Option<Attributes>,
    /// The lines of the numbers read last, of a text.
    lines: Vec<usize>,
}

impl File<'_> {
    fn fault<T>(&self, message: impl Into<String>) -> Result<T, FileError> {
        Err(self.cursor.fault(message))
    }

    /// Reads the section that begins with the line.
    fn section(&mut self, line: &str) -> Result<(), FileError> {
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let key = words[0].to_ascii_uppercase();
        if !self.has_dataset && key != "DATASET" {
            return self.fault(format!("\"{key}\" precedes DATASET"));
        }
        let n_points = self.shape.points.len();
        match (key.as_str(), &words[1..]) {
            ("DATASET", [kind]) if kind.eq_ignore_ascii_case("POLYDATA") => self.has_dataset = true,
            ("DATASET", _) => {
                let message =
                    "only DATASET POLYDATA is read; extract the surface and write it as poly data, PLY or STL";
                return self.fault(format!("\"{line}\": {message}"));
            }
            ("POINTS", _) if self.has_points => return self.fault("there are two sections POINTS"),
            ("POINTS", [n, kind]) => {
                self.has_points = true;
                let (n, kind) = (self.cursor.count(n)?, self.kind(kind)?);
                let first = self.cursor.at;
                let values = self.values(n, 3, kind)?;
                self.shape.places = match self.cursor.is_binary {
                    true => Places::Rows { first, stride: 3 * kind.n_bytes() },
                    false => Places::Lines(self.lines.iter().copied().step_by(3).collect()),
                };
                self.shape.points = values.chunks_exact(3).map(Point3::from_slice).collect();
            }
            ("VERTICES" | "LINES" | "POLYGONS" | "TRIANGLE_STRIPS", [n, size]) => {
                let lists = self.cells(n, size)?;
                match key.as_str() {
                    "VERTICES" => {}
                    "LINES" => self.shape.notes.push(format!("{} lines were left out", lists.ends.len())),
                    _ if lists.ends.is_empty() => {}
                    _ => {
                        let faces = self.shape.faces.get_or_insert_default();
                        let added = lists.faces(faces, key == "TRIANGLE_STRIPS", n_points);
                        added.map_err(|(cell, corner)| {
                            let message =
                                format!("cell {cell} of {key} names point {corner}, but there are {n_points}");
                            self.cursor.fault(message + " before it")
                        })?;
                    }
                }
            }
            ("POINT_DATA" | "CELL_DATA", [n]) => {
                let (n, of_points) = (self.cursor.count(n)?, key == "POINT_DATA");
                if of_points && n != n_points {
                    return self.fault(format!("POINT_DATA is for {n} points, but there are {n_points}"));
                }
                self.attributes = Some(Attributes { n, of_points });
            }
            ("METADATA", _) => self.skip_metadata(),
            ("FIELD", [_, n_arrays]) => {
                for _ in 0..self.cursor.count(n_arrays)? {
                    self.array()?;
                }
            }
            ("LOOKUP_TABLE", [_, n]) => {
                let n = self.cursor.count(n)?;
                self.values(n, 4, Scalar::U8)?;
            }
            (key, arguments) => match self.attributes {
                Some(Attributes { n, .. }) => self.attribute(key, arguments, n)?,
                None => return self.fault(format!("\"{line}\" is no section of poly data")),
            },
        }
        Ok(())
    }

    /// Reads an array of a FIELD.
    fn array(&mut self) -> Result<(), FileError> {
        let Some(line) = self.cursor.filled_line() else {
            return self.fault("the file ends within FIELD; was it cut short?");
        };
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        if words[0].eq_ignore_ascii_case("METADATA") {
            return self.fault("METADATA stands before the arrays that FIELD counts");
        }
        let [name, n_components, n, kind] = words[..] else {
            return self.fault(format!("\"{}\" is no array of a FIELD", line.trim()));
        };
        let (n_components, n) = (self.cursor.count(n_components)?, self.cursor.count(n)?);
        if kind == "bit" {
            return self.fault(format!("array \"{name}\" of type {kind} is not read; leave it out"));
        }
        if kind == "string" {
            // Texts say nothing of the shape: names of materials, comments of the writer.
            (0..n.saturating_mul(n_components)).try_for_each(|_| self.skip_text())?;
        } else {
            let values = self.values(n, n_components, self.kind(kind)?)?;
            if n == self.shape.points.len() {
                self.keep(name, name.eq_ignore_ascii_case("normals"), n_components, values)?;
            }
        }
        // Metadata may follow the array.
        let start = self.cursor;
        match self.cursor.filled_line() {
            Some(line) if line.trim() == "METADATA" => self.skip_metadata(),
            _ => self.cursor = start,
        }
        Ok(())
    }

    /// Passes over a text of an array: a line, or in binary its length and its bytes.
    ///
    /// # Source
    /// `vtkDataReader::ReadArray`: the upper two bits of the first byte say how many bytes the length has, big-endian: 3 one, 2 two, 1
    /// four, 0 eight; the others belong to it.
    fn skip_text(&mut self) -> Result<(), FileError> {
        let cursor = &mut self.cursor;
        if !cursor.is_binary {
            return match cursor.line() {
                Some(_) => Ok(()),
                None => self.fault("the file ends within the texts of a FIELD; was it cut short?"),
            };
        }
        let first = cursor.rest().first().copied().unwrap_or_default();
        let n_length = 1 << (3 - (first >> 6));
        let length = cursor.take(n_length, "the length of a text")?;
        let length = length.iter().skip(1).fold(u64::from(first & 0x3f), |sum, &byte| sum << 8 | u64::from(byte));
        let length = usize::try_from(length).unwrap_or(usize::MAX);
        cursor.take(length, "a text").map(drop)
    }

    /// Reads an attribute of `n` points or cells.
    fn attribute(&mut self, key: &str, arguments: &[&str], n: usize) -> Result<(), FileError> {
        let (name, n_components, scalar) = match (key, arguments) {
            ("SCALARS", [name, kind]) => (name, 1, self.kind(kind)?),
            ("SCALARS", [name, kind, n]) => (name, self.cursor.count(n)?, self.kind(kind)?),
            ("NORMALS" | "VECTORS", [name, kind]) => (name, 3, self.kind(kind)?),
            ("TENSORS", [name, kind]) => (name, 9, self.kind(kind)?),
            ("TEXTURE_COORDINATES", [name, n, kind]) => (name, self.cursor.count(n)?, self.kind(kind)?),
            // In binary a colour is bytes, in ASCII numbers from 0 to 1.
            ("COLOR_SCALARS", [name, n]) => (name, self.cursor.count(n)?, Scalar::U8),
            _ => return self.fault(format!("\"{key} {}\" is no attribute that is read", arguments.join(" "))),
        };
        if key == "SCALARS" {
            let start = self.cursor;
            let line = self.cursor.filled_line().unwrap_or_default();
            // The line may be missing.
            if !line.trim_start().to_ascii_uppercase().starts_with("LOOKUP_TABLE") {
                self.cursor = start;
            }
        }
        let values = self.values(n, n_components, scalar)?;
        self.keep(name, key == "NORMALS", n_components, values)
    }

    /// Keeps numbers of the points; those of cells are passed over.
    fn keep(&mut self, name: &str, is_normal: bool, n_components: usize, values: Vec<f64>) -> Result<(), FileError> {
        if !self.attributes.is_some_and(|attributes| attributes.of_points) {
            return Ok(());
        }
        keep(&mut self.shape, name, is_normal, n_components, values).map_err(|message| self.cursor.fault(message))
    }

    fn kind(&self, name: &str) -> Result<Scalar, FileError> {
        Ok(match name.to_ascii_lowercase().as_str() {
            "char" | "signed_char" | "vtktypeint8" => Scalar::I8,
            "unsigned_char" | "vtktypeuint8" => Scalar::U8,
            "short" | "vtktypeint16" => Scalar::I16,
            "unsigned_short" | "vtktypeuint16" => Scalar::U16,
            "int" | "vtkidtype" | "vtktypeint32" => Scalar::I32,
            "unsigned_int" | "vtktypeuint32" => Scalar::U32,
            "long" | "long_long" | "vtktypeint64" => Scalar::I64,
            "unsigned_long" | "unsigned_long_long" | "vtktypeuint64" => Scalar::U64,
            "float" => Scalar::F32,
            "double" => Scalar::F64,
            _ => return self.fault(format!("\"{name}\" is no type of numbers that is read")),
        })
    }

    /// `n × width` numbers.
    fn values(&mut self, n: usize, width: usize, scalar: Scalar) -> Result<Vec<f64>, FileError> {
        let cursor = &mut self.cursor;
        let size = if cursor.is_binary { scalar.n_bytes() } else { 2 };
        cursor.promised(n, width.saturating_mul(size), &format!("times {width} numbers"))?;
        let n_values = n * width;
        if cursor.is_binary {
            let bytes = cursor.take(n_values * size, "the numbers")?;
            return Ok(Rows { bytes, stride: size, big: true }.column(scalar, 0));
        }
        let mut values = Vec::with_capacity(n_values);
        self.lines.clear();
        // A word at a time: many numbers are on a line, and a line may hold the end of one list and the next keyword.
        while values.len() < n_values {
            let (word, line) = cursor.word().ok_or_else(|| cursor.cut_short(values.len(), n_values, "numbers"))?;
            let value = std::str::from_utf8(word).ok().and_then(scalar::number).ok_or_else(|| {
                cursor.fault_at(line, format!("\"{}\" is not a number", String::from_utf8_lossy(word)))
            })?;
            values.push(value);
            self.lines.push(line);
        }
        cursor.end_line();
        Ok(values)
    }

    /// The cells of a section in either layout.
    fn cells(&mut self, n: &str, size: &str) -> Result<Lists, FileError> {
        let (n, size) = (self.cursor.count(n)?, self.cursor.count(size)?);
        let start = self.cursor;
        // Since version 5 there are offsets and a connectivity, each with a line of its own.
        let next = self.cursor.filled_line().unwrap_or_default();
        let words: Vec<&str> = next.split_ascii_whitespace().collect();
        if let ["OFFSETS", kind] = words[..] {
            let offsets = self.values(n, 1, self.kind(kind)?)?;
            let line = self.cursor.filled_line().unwrap_or_default();
            let ["CONNECTIVITY", kind] = line.split_ascii_whitespace().collect::<Vec<_>>()[..] else {
                return self.fault(format!("CONNECTIVITY is expected behind OFFSETS, not \"{}\"", line.trim()));
            };
            let indices = self.values(size, 1, self.kind(kind)?)?;
            let mut ends = Vec::with_capacity(n);
            let mut last = 0.0;
            for (k, &offset) in offsets.iter().enumerate() {
                if offset.fract() != 0.0 || !(last..=size as f64).contains(&offset) || (k == 0 && offset != 0.0) {
                    return self.fault(format!("offset {k} is {offset}, behind {last} of {size}"));
                }
                last = offset;
                if k > 0 {
                    ends.push(offset as usize);
                }
            }
            if n > 0 && last != size as f64 {
                return self.fault(format!("the last offset is {last}, but {size} corners follow"));
            }
            return Ok(Lists { ends, indices });
        }
        self.cursor = start;
        let values = self.values(size, 1, Scalar::I32)?;
        let (mut ends, mut indices) = (Vec::with_capacity(n.min(size)), Vec::with_capacity(size));
        let mut at = 0;
        for cell in 0..n {
            let count = values.get(at).copied().unwrap_or(-1.0);
            let left = values.len().saturating_sub(at + 1);
            if count.fract() != 0.0 || !(0.0..=left as f64).contains(&count) {
                return self.fault(format!("cell {cell} of {n} claims {count} corners, {left} numbers are left"));
            }
            indices.extend(&values[at + 1..at + 1 + count as usize]);
            ends.push(indices.len());
            at += 1 + count as usize;
        }
        if at != values.len() {
            return self.fault(format!("{n} cells take {at} of the {size} numbers that are stated"));
        }
        Ok(Lists { ends, indices })
    }

    /// Passes over the lines up to a blank one.
    fn skip_metadata(&mut self) {
        while self.cursor.line().is_some_and(|line| !line.trim().is_empty()) {}
    }
}

/// Keeps the normals of the points and their columns of one number each.
///
/// # Errors
/// The points have other normals already.
fn keep(
    shape: &mut Shape,
    name: &str,
    is_normal: bool,
    n_components: usize,
    values: Vec<f64>,
) -> Result<(), &'static str> {
    if n_components == 1 {
        shape.extras.push((name.to_owned(), values));
    } else if is_normal && n_components == 3 {
        let normals: Vec<_> = values.chunks_exact(3).map(Vector3::from_column_slice).collect();
        let before = shape.normals.replace(normals);
        if before.is_some() && before != shape.normals {
            return Err("the points have other normals further up; keep one of the two");
        }
    }
    Ok(())
}

/// Runs of indices: where each ends, and all of them.
struct Lists {
    ends: Vec<usize>,
    indices: Vec<f64>,
}

impl Lists {
    /// Adds the triangles of the polygons or strips.
    ///
    /// # Errors
    /// The cell and the index that no point has.
    fn faces(&self, faces: &mut Vec<[u32; 3]>, strips: bool, n_points: usize) -> Result<(), (usize, f64)> {
        let mut start = 0;
        let mut corners = Vec::new();
        for (cell, &end) in self.ends.iter().enumerate() {
            corners.clear();
            for &index in &self.indices[start..end] {
                if index.fract() != 0.0 || !(0.0..n_points.min(u32::MAX as usize) as f64).contains(&index) {
                    return Err((cell, index));
                }
                corners.push(index as u32);
            }
            if strips {
                // Every other triangle of a strip is turned.
                faces.extend(
                    corners
                        .windows(3)
                        .enumerate()
                        .map(|(k, w)| if k % 2 == 0 { [w[0], w[1], w[2]] } else { [w[1], w[0], w[2]] }),
                );
            } else {
                fan(faces, &corners);
            }
            start = end;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Space,
        shape::{CloudFileRead, MeshRead},
    };
    use osteoflow_geometry::SurfaceOrigin;

    fn mesh(bytes: &[u8]) -> Result<MeshRead, FileError> {
        let path = "a.vtk".as_ref();
        shape(path, bytes)?.into_mesh(path, 1.0, "ct".into(), SurfaceOrigin::User)
    }

    fn cloud(bytes: &[u8]) -> Result<CloudFileRead, FileError> {
        let path = "a.vtk".as_ref();
        shape(path, bytes)?.into_cloud(path, 1.0, "ct".into())
    }

    fn ascii(rest: &str) -> String {
        format!(
            "# vtk DataFile Version 3.0\nbone SPACE=LPS\nASCII\nDATASET POLYDATA\nPOINTS 4 float\n\
             0 0 0 9 0 0\n9 9 0\n0 9 0\n{rest}"
        )
    }

    fn binary(parts: &[(&str, Vec<u8>)]) -> Vec<u8> {
        let mut bytes = b"# vtk DataFile Version 5.1\nvtk output\nBINARY\nDATASET POLYDATA\n".to_vec();
        for (line, data) in parts {
            bytes.extend(format!("{line}\n").bytes());
            bytes.extend(data);
            bytes.push(b'\n');
        }
        bytes
    }

    fn floats(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|v| v.to_be_bytes()).collect()
    }

    const CORNERS: [f32; 12] = [0.0, 0.0, 0.0, 9.0, 0.0, 0.0, 9.0, 9.0, 0.0, 0.0, 9.0, 0.0];

    #[test]
    fn texts_in_the_field_data_are_passed_over_in_text_and_in_binary() {
        let field = "FIELD FieldData 2\nnote 1 2 string\nof the bone\n\nage 1 1 int\n7\n";
        let text = ascii("POLYGONS 1 5\n4 0 1 2 3\n").replace("POINTS", &format!("{field}POINTS"));
        assert_eq!(mesh(text.as_bytes()).unwrap().mesh.faces().len(), 2);
        let long = "x".repeat(300);
        let mut texts = vec![0xc0 | 3];
        texts.extend(b"abc");
        texts.extend([0x80 | 1, 44]);
        texts.extend(long.bytes());
        let ints = |values: &[i32]| values.iter().flat_map(|v| v.to_be_bytes()).collect::<Vec<u8>>();
        let parts = |texts: Vec<u8>| {
            binary(&[
                ("FIELD FieldData 1\nnote 1 2 string", texts),
                ("POINTS 4 float", floats(&CORNERS)),
                ("POLYGONS 1 5", ints(&[4, 0, 1, 2, 3])),
            ])
        };
        assert_eq!(mesh(&parts(texts)).unwrap().mesh.faces().len(), 2);
        let error = mesh(&parts(vec![0x7f, 255, 255, 255])).unwrap_err().to_string();
        assert!(
            error.contains("a text needs 1073741823 bytes") && error.contains("was the file cut short?"),
            "{error}"
        );
    }

    #[test]
    fn the_same_square_is_read_from_every_layout() {
        let ints = |values: &[i32]| values.iter().flat_map(|v| v.to_be_bytes()).collect::<Vec<u8>>();
        let longs = |values: &[i64]| values.iter().flat_map(|v| v.to_be_bytes()).collect::<Vec<u8>>();
        for bytes in [
            ascii("POLYGONS 1 5\n4 0 1 2 3\n").into_bytes(),
            ascii("POLYGONS 2 8 \n3 0 1 2 3 0 2 3 \n\nCELL_DATA 2\nSCALARS a int 1\nLOOKUP_TABLE default\n1 2\n").into_bytes(),
            ascii("VERTICES 1 2\n1 0\nPOLYGONS 2 4\nOFFSETS vtktypeint64\n0 4\nCONNECTIVITY vtktypeint64\n0 1 2 3\nMETADATA\nINFORMATION 0\n\nPOINT_DATA 4\nNORMALS n float\n0 0 1 0 0 1 0 0 1 0 0 1\n").into_bytes(),
            binary(&[("POINTS 4 float", floats(&CORNERS)), ("POLYGONS 1 5", ints(&[4, 0, 1, 2, 3]))]),
            binary(&[
                ("POINTS 4 double", CORNERS.iter().flat_map(|&c| f64::from(c).to_be_bytes()).collect()),
                ("METADATA\nINFORMATION 0\n", vec![]),
                ("POLYGONS 3 6\nOFFSETS vtktypeint64", longs(&[0, 3, 6])),
                ("CONNECTIVITY vtktypeint64", longs(&[0, 1, 2, 0, 2, 3])),
                ("CELL_DATA 2\nFIELD FieldData 1\nregion 1 2 int", ints(&[1, 2])),
            ]),
        ] {
            let content = mesh(&bytes).unwrap_or_else(|e| panic!("{e}\n{}", String::from_utf8_lossy(&bytes)));
            assert_eq!(content.mesh.faces(), [[0, 1, 2], [0, 2, 3]]);
            assert_eq!(content.mesh.vertices()[2], Point3::new(9.0, 9.0, 0.0));
            assert_eq!(content.space == Space::Lps, bytes[..60].windows(5).any(|w| w == b"ASCII"));
        }
        let strip = mesh(ascii("TRIANGLE_STRIPS 1 5\n4 0 1 3 2\n").as_bytes()).unwrap();
        assert_eq!(strip.mesh.faces(), [[0, 1, 3], [3, 1, 2]], "both turn alike");
        assert!((strip.mesh.area_mm2() - 81.0).abs() < 1e-12 && strip.mesh.area_vector(1).z > 0.0);
    }

    #[test]
    fn vertices_alone_are_a_cloud_with_normals_and_scalars() {
        let points = [1.0, 2.0, 3.0, f32::NAN, 0.0, 0.0, 4.0, 5.0, 6.0];
        let content = cloud(&binary(&[
            ("POINTS 3 float", floats(&points)),
            ("POINT_DATA 3\nSCALARS heat float\nLOOKUP_TABLE default", floats(&[7.0, 8.0, 9.0])),
            ("NORMALS Normals float", floats(&[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0])),
            ("FIELD FieldData 2\ngrey 1 3 unsigned_char", vec![1, 2, 3]),
            ("pair 2 3 unsigned_char", vec![1, 2, 3, 4, 5, 6]),
        ]))
        .unwrap();
        assert_eq!((content.cloud.len(), content.n_dropped, content.space), (2, 1, Space::Unknown));
        assert_eq!(content.cloud.normals().unwrap(), [Vector3::z(), Vector3::x()]);
        let extras: Vec<(&str, &[f64])> = content.cloud.extras().iter().map(|(n, v)| (&**n, &**v)).collect();
        assert_eq!(extras, [("heat", &[7.0, 9.0][..]), ("grey", &[1.0, 3.0][..])]);
    }

    #[test]
    fn a_broken_file_names_its_place() {
        for (bytes, expected) in [
            (ascii("POLYGONS 1 5\n4 0 1 2 4\n"), "cell 0 of POLYGONS names point 4, but there are 4"),
            (ascii("POLYGONS 1 5\n5 0 1 2 3\n"), "line 10: cell 0 of 1 claims 5 corners, 4 numbers are left"),
            (ascii("POLYGONS 1 6\n4 0 1 2 3 0\n"), "1 cells take 5 of the 6 numbers"),
            (ascii("POLYGONS 1 5\n4 0 1 2    \n"), "the file ends after 4 of 5 numbers"),
            (ascii("POLYGONS 1 500\n4 0 1 2 3\n"), "500 times 1 numbers are promised, but 10 bytes are left"),
            (ascii("POLYGONS 1 5\n4 0 1 x 3\n"), "line 10: \"x\" is not a number"),
            (ascii(""), "surface: the file holds 4 points and no faces"),
            (ascii("").replace("POLYDATA", "UNSTRUCTURED_GRID"), "only DATASET POLYDATA is read; extract the surface"),
            (ascii("").replace("ASCII", "TEXT"), "line 3: \"TEXT\" is neither ASCII nor BINARY"),
            (ascii("").replace("float", "half"), "line 5: \"half\" is no type of numbers"),
            (ascii("POINT_DATA 3\n"), "POINT_DATA is for 3 points, but there are 4"),
            (
                ascii(
                    "POINT_DATA 4\nNORMALS a float\n0 0 1 0 0 1 0 0 1 0 0 1\nNORMALS b float\n0 0 1 0 0 1 0 0 1 0 1 0\n",
                ),
                "line 13: the points have other normals further up; keep one of the two",
            ),
            (
                ascii(
                    "POINT_DATA 4\nFIELD f 1\nnormals 3 4 float\n0 0 1 0 0 1 0 0 1 0 0 1\nNORMALS b float\n0 0 1 0 0 1 0 0 1 0 0 -1\n",
                ),
                "the points have other normals further up; keep one of the two",
            ),
            (ascii("").replace("POINTS", "POINT"), "\"POINT 4 float\" is no section of poly data"),
            ("# vtk DataFile Version 3.0\n".into(), "the file ends before the title"),
        ] {
            let message = mesh(String::as_bytes(&bytes)).unwrap_err().to_string();
            assert!(message.contains(expected), "{expected}\n{message}");
        }
        let cut = binary(&[("POINTS 4 float", floats(&CORNERS[..5]))]);
        let message = mesh(&cut).unwrap_err().to_string();
        assert!(message.contains("byte 77: 4 times 3 numbers are promised, but 21 bytes are left"), "{message}");
    }
}
