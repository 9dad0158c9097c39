//! Legacy VTK files of poly data, ASCII and binary, in the layouts before and since version 5.

use crate::{
    FileError,
    scalar::{self, Rows, Scalar},
    shape::{Places, Shape, fan},
    space::StatedSpace,
};
use nalgebra::{Point3, Vector3};
use std::path::Path;

/// The first bytes of a legacy file.
pub(crate) const MARK: &[u8] = b"# vtk DataFile";

/// The surface in a VTK file, or the cloud if it has neither polygons nor strips.
///
/// Vertices that are NaN are kept for the cloud to drop. Normals of the points are read, and for a cloud also the scalars
/// and fields of one number a point. Lines are left out with a note.
pub(crate) fn shape(path: &Path, bytes: &[u8]) -> Result<Shape, FileError> {
    let mut file = Cursor { path, bytes, at: 0, line: 0, binary: false, lines: Vec::new() };
    file.line("the version")?;
    let title = file.line("the title")?;
    let stated = StatedSpace::of(&title).map_err(|message| file.fault(message))?;
    let encoding = file.line("ASCII or BINARY")?;
    let binary = match encoding.trim().to_ascii_uppercase().as_str() {
        "ASCII" => false,
        "BINARY" => true,
        _ => return Err(file.fault(format!("\"{}\" is neither ASCII nor BINARY", encoding.trim()))),
    };
    let mut shape = Shape { stated, ..Shape::default() };
    let mut faces = Vec::new();
    let (mut has_points, mut has_faces, mut has_dataset) = (false, false, false);
    // What the attributes that follow belong to.
    let mut attributes = Attributes::None;
    let mut extras = Vec::new();
    while let Some(line) = file.keyword()? {
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let key = words[0].to_ascii_uppercase();
        if !has_dataset && key != "DATASET" {
            return Err(file.fault(format!("\"{key}\" precedes DATASET")));
        }
        // From here on the numbers are binary, if the file is.
        file.binary = binary;
        match (key.as_str(), &words[1..]) {
            ("DATASET", [kind]) if kind.eq_ignore_ascii_case("POLYDATA") => has_dataset = true,
            ("DATASET", _) => {
                let message =
                    "only DATASET POLYDATA is read; extract the surface and write it as poly data, PLY or STL";
                return Err(file.fault(format!("\"{}\": {message}", line.trim())));
            }
            ("POINTS", [n, kind]) => {
                if std::mem::replace(&mut has_points, true) {
                    return Err(file.fault("there are two sections POINTS".into()));
                }
                let (n, kind) = (file.count(n)?, file.kind(kind)?);
                let first = file.at;
                let values = file.values(n, 3, kind)?;
                shape.places = match binary {
                    true => Places::Rows { first, stride: 3 * kind.n_bytes() },
                    false => Places::Lines(file.lines.iter().copied().step_by(3).collect()),
                };
                shape.points = values.chunks_exact(3).map(|p| Point3::new(p[0], p[1], p[2])).collect();
            }
            ("VERTICES" | "LINES" | "POLYGONS" | "TRIANGLE_STRIPS", [n, size]) => {
                let lists = file.cells(n, size)?;
                if key == "LINES" {
                    shape.notes.push(format!("{} lines were left out", lists.ends.len()));
                }
                if matches!(key.as_str(), "VERTICES" | "LINES") {
                    continue;
                }
                has_faces |= !lists.ends.is_empty();
                lists.faces(&mut faces, key == "TRIANGLE_STRIPS", shape.points.len()).map_err(|(cell, corner)| {
                    let n = shape.points.len();
                    file.fault(format!("cell {cell} of {key} names point {corner}, but there are {n} before it"))
                })?;
            }
            ("POINT_DATA", [n]) => {
                let n = file.count(n)?;
                if n != shape.points.len() {
                    return Err(
                        file.fault(format!("POINT_DATA is for {n} points, but there are {}", shape.points.len()))
                    );
                }
                attributes = Attributes::Points(n);
            }
            ("CELL_DATA", [n]) => attributes = Attributes::Cells(file.count(n)?),
            ("METADATA", _) => file.skip_metadata()?,
            ("FIELD", [_, n_arrays]) => {
                for _ in 0..file.count(n_arrays)? {
                    let Some(line) = file.keyword()? else {
                        return Err(file.fault("the file ends within FIELD; was it cut short?".into()));
                    };
                    let words: Vec<&str> = line.split_ascii_whitespace().collect();
                    if words[0].eq_ignore_ascii_case("METADATA") {
                        return Err(file.fault("METADATA stands before the arrays that FIELD counts".into()));
                    }
                    let [name, n_components, n, kind] = words[..] else {
                        return Err(file.fault(format!("\"{}\" is no array of a FIELD", line.trim())));
                    };
                    let (n_components, n) = (file.count(n_components)?, file.count(n)?);
                    let values = match kind {
                        "string" | "bit" => {
                            return Err(
                                file.fault(format!("array \"{name}\" of type {kind} is not read; leave it out"))
                            );
                        }
                        _ => file.values(n, n_components, file.kind(kind)?)?,
                    };
                    if attributes.is_points() && n == shape.points.len() {
                        if name.eq_ignore_ascii_case("normals") && n_components == 3 {
                            set_normals(&mut shape, &file, vectors(&values))?;
                        } else if n_components == 1 {
                            extras.push((name.to_owned(), values));
                        }
                    }
                    file.skip_array_metadata()?;
                }
            }
            ("LOOKUP_TABLE", [_, n]) => {
                let n = file.count(n)?;
                if binary {
                    file.values(n, 4, Scalar::U8)?
                } else {
                    file.values(n, 4, Scalar::F32)?
                };
            }
            (key, arguments) => match attributes.n() {
                Some(n) => {
                    let values = attribute(&mut file, key, arguments, n)?;
                    match values {
                        Some((1, name, values)) if attributes.is_points() => extras.push((name, values)),
                        Some((_, _, values)) if attributes.is_points() && key == "NORMALS" => {
                            set_normals(&mut shape, &file, vectors(&values))?;
                        }
                        _ => {}
                    }
                }
                None => return Err(file.fault(format!("\"{}\" is no section of poly data", line.trim()))),
            },
        }
    }
    if !has_points {
        return Err(file.fault("there is no section POINTS; was the file cut short?".into()));
    }
    if has_faces {
        shape.faces = Some(faces);
    } else {
        shape.extras = extras;
    }
    Ok(shape)
}

fn vectors(values: &[f64]) -> Vec<Vector3<f64>> {
    values.chunks_exact(3).map(|v| Vector3::new(v[0], v[1], v[2])).collect()
}

/// Refuses normals that differ from those that the points have.
fn set_normals(shape: &mut Shape, file: &Cursor<'_>, normals: Vec<Vector3<f64>>) -> Result<(), FileError> {
    match shape.normals.replace(normals) {
        Some(before) if shape.normals.as_ref() != Some(&before) => {
            Err(file.fault("the points have other normals further up; keep one of the two".into()))
        }
        _ => Ok(()),
    }
}

enum Attributes {
    None,
    Points(usize),
    Cells(usize),
}

impl Attributes {
    fn n(&self) -> Option<usize> {
        match *self {
            Self::None => None,
            Self::Points(n) | Self::Cells(n) => Some(n),
        }
    }

    fn is_points(&self) -> bool {
        matches!(self, Self::Points(_))
    }
}

/// The values of an attribute of `n` points or cells: the number of components, the name and the values.
fn attribute(
    file: &mut Cursor,
    key: &str,
    arguments: &[&str],
    n: usize,
) -> Result<Option<(usize, String, Vec<f64>)>, FileError> {
    let (name, n_components, scalar) = match (key, arguments) {
        ("SCALARS", [name, kind]) => (name, 1, file.kind(kind)?),
        ("SCALARS", [name, kind, n]) => (name, file.count(n)?, file.kind(kind)?),
        ("NORMALS" | "VECTORS", [name, kind]) => (name, 3, file.kind(kind)?),
        ("TENSORS", [name, kind]) => (name, 9, file.kind(kind)?),
        ("TEXTURE_COORDINATES", [name, n, kind]) => (name, file.count(n)?, file.kind(kind)?),
        // In binary a colour is bytes, in ASCII numbers from 0 to 1.
        ("COLOR_SCALARS", [name, n]) => (name, file.count(n)?, Scalar::U8),
        _ => return Err(file.fault(format!("\"{key} {}\" is no attribute that is read", arguments.join(" ")))),
    };
    if key == "SCALARS" {
        let binary = std::mem::replace(&mut file.binary, false);
        let at = (file.at, file.line);
        let line = file.keyword()?.unwrap_or_default();
        // The line may be missing.
        if !line.trim_start().to_ascii_uppercase().starts_with("LOOKUP_TABLE") {
            (file.at, file.line) = at;
        }
        file.binary = binary;
    }
    let name = (*name).to_owned();
    Ok(Some((n_components, name, file.values(n, n_components, scalar)?)))
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

struct Cursor<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    at: usize,
    /// Lines passed; of a binary file places are bytes.
    line: usize,
    binary: bool,
    /// The lines of the numbers read last, of a text.
    lines: Vec<usize>,
}

impl Cursor<'_> {
    fn fault(&self, message: String) -> FileError {
        let place = if self.binary { format!("byte {}", self.at) } else { format!("line {}", self.line.max(1)) };
        FileError::content(self.path, place, message)
    }

    fn next_line(&mut self) -> Option<String> {
        let rest = &self.bytes[self.at..];
        if rest.is_empty() {
            return None;
        }
        let n = rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
        self.at += (n + 1).min(rest.len());
        self.line += 1;
        Some(String::from_utf8_lossy(&rest[..n]).trim_end_matches('\r').to_owned())
    }

    fn line(&mut self, what: &str) -> Result<String, FileError> {
        self.next_line().ok_or_else(|| self.fault(format!("the file ends before {what}; was it cut short?")))
    }

    /// The next line that is not blank; none at the end.
    fn keyword(&mut self) -> Result<Option<String>, FileError> {
        while let Some(line) = self.next_line() {
            if !line.trim().is_empty() {
                return Ok(Some(line));
            }
        }
        Ok(None)
    }

    fn count(&self, word: &str) -> Result<usize, FileError> {
        word.parse().map_err(|_| self.fault(format!("\"{word}\" is not a count")))
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
            _ => return Err(self.fault(format!("\"{name}\" is no type of numbers that is read"))),
        })
    }

    /// `n × width` numbers.
    fn values(&mut self, n: usize, width: usize, scalar: Scalar) -> Result<Vec<f64>, FileError> {
        let left = self.bytes.len() - self.at;
        let size = if self.binary { scalar.n_bytes() } else { 2 };
        let n_values = n.checked_mul(width);
        let n_bytes = n_values.and_then(|n| n.checked_mul(size));
        // The last number of a text needs no blank behind it.
        let (Some(n_values), Some(n_bytes)) = (n_values, n_bytes.filter(|&n| n <= left + usize::from(!self.binary)))
        else {
            let message =
                format!("{n} times {width} numbers are promised, but {left} bytes are left; was the file cut short?");
            return Err(self.fault(message));
        };
        if self.binary {
            let bytes = &self.bytes[self.at..self.at + n_bytes];
            self.at += n_bytes;
            return Ok(Rows { bytes, stride: size, big: true }.column(scalar, 0));
        }
        let mut values = Vec::with_capacity(n_values);
        self.lines.clear();
        while values.len() < n_values {
            // A word at a time: many numbers are on a line, and a line may hold the end of one list and the next keyword.
            let rest = &self.bytes[self.at..];
            let blank = rest.iter().position(|b| !b.is_ascii_whitespace()).unwrap_or(rest.len());
            self.line += rest[..blank].iter().filter(|&&b| b == b'\n').count();
            let rest = &rest[blank..];
            let n = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
            self.at += blank + n;
            if n == 0 {
                let message = format!("the file ends after {} of {n_values} numbers; was it cut short?", values.len());
                return Err(self.fault(message));
            }
            let word = String::from_utf8_lossy(&rest[..n]);
            // The line was counted when its keyword was read; numbers begin on the next.
            let value = scalar::number(&word).ok_or_else(|| {
                let line = format!("line {}", self.line + 1);
                FileError::content(self.path, line, format!("\"{word}\" is not a number"))
            })?;
            values.push(value);
            self.lines.push(self.line + 1);
        }
        // To the end of the line, so that the next keyword begins one.
        let rest = &self.bytes[self.at..];
        let blank = rest.iter().position(|&b| !matches!(b, b' ' | b'\t' | b'\r')).unwrap_or(rest.len());
        if rest.get(blank) == Some(&b'\n') {
            self.at += blank + 1;
            self.line += 1;
        }
        Ok(values)
    }

    /// The cells of a section in either layout.
    fn cells(&mut self, n: &str, size: &str) -> Result<Lists, FileError> {
        let (n, size) = (self.count(n)?, self.count(size)?);
        let start = (self.at, self.line);
        // Since version 5 there are offsets and a connectivity, each with a line of its own.
        let next = self.keyword()?.unwrap_or_default();
        let words: Vec<&str> = next.split_ascii_whitespace().collect();
        if let ["OFFSETS", kind] = words[..] {
            let offsets = self.values(n, 1, self.kind(kind)?)?;
            let line = self.keyword()?.unwrap_or_default();
            let ["CONNECTIVITY", kind] = line.split_ascii_whitespace().collect::<Vec<_>>()[..] else {
                return Err(self.fault(format!("CONNECTIVITY is expected behind OFFSETS, not \"{}\"", line.trim())));
            };
            let indices = self.values(size, 1, self.kind(kind)?)?;
            let mut ends = Vec::with_capacity(n);
            let mut last = 0.0;
            for (k, &offset) in offsets.iter().enumerate() {
                if offset.fract() != 0.0 || !(last..=size as f64).contains(&offset) || (k == 0 && offset != 0.0) {
                    return Err(self.fault(format!("offset {k} is {offset}, behind {last} of {size}")));
                }
                last = offset;
                if k > 0 {
                    ends.push(offset as usize);
                }
            }
            if n > 0 && last != size as f64 {
                return Err(self.fault(format!("the last offset is {last}, but {size} corners follow")));
            }
            return Ok(Lists { ends, indices });
        }
        (self.at, self.line) = start;
        let values = self.values(size, 1, Scalar::I32)?;
        let (mut ends, mut indices) = (Vec::with_capacity(n.min(size)), Vec::with_capacity(size));
        let mut at = 0;
        for cell in 0..n {
            let count = values.get(at).copied().unwrap_or(-1.0);
            let left = values.len().saturating_sub(at + 1);
            if count.fract() != 0.0 || !(0.0..=left as f64).contains(&count) {
                return Err(self.fault(format!("cell {cell} of {n} claims {count} corners, {left} numbers are left")));
            }
            indices.extend(&values[at + 1..at + 1 + count as usize]);
            ends.push(indices.len());
            at += 1 + count as usize;
        }
        if at != values.len() {
            return Err(self.fault(format!("{n} cells take {at} of the {size} numbers that are stated")));
        }
        Ok(Lists { ends, indices })
    }

    /// Passes over the lines up to a blank one.
    fn skip_metadata(&mut self) -> Result<(), FileError> {
        while let Some(line) = self.next_line() {
            if line.trim().is_empty() {
                break;
            }
        }
        Ok(())
    }

    /// Passes over the metadata that may follow an array of a field.
    fn skip_array_metadata(&mut self) -> Result<(), FileError> {
        let start = (self.at, self.line);
        match self.keyword()? {
            Some(line) if line.trim() == "METADATA" => self.skip_metadata(),
            _ => {
                (self.at, self.line) = start;
                Ok(())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Space, cloud_file::CloudFileRead, mesh_file::MeshRead};
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
            let found = mesh(&bytes).unwrap_or_else(|e| panic!("{e}\n{}", String::from_utf8_lossy(&bytes)));
            assert_eq!(found.mesh.faces(), [[0, 1, 2], [0, 2, 3]]);
            assert_eq!(found.mesh.vertices()[2], Point3::new(9.0, 9.0, 0.0));
            assert_eq!(found.space == Space::Lps, bytes[..60].windows(5).any(|w| w == b"ASCII"));
        }
        let strip = mesh(ascii("TRIANGLE_STRIPS 1 5\n4 0 1 3 2\n").as_bytes()).unwrap();
        assert_eq!(strip.mesh.faces(), [[0, 1, 3], [3, 1, 2]], "both turn alike");
        assert!((strip.mesh.area_mm2() - 81.0).abs() < 1e-12 && strip.mesh.area_vector(1).z > 0.0);
    }

    #[test]
    fn vertices_alone_are_a_cloud_with_normals_and_scalars() {
        let points = [1.0, 2.0, 3.0, f32::NAN, 0.0, 0.0, 4.0, 5.0, 6.0];
        let found = cloud(&binary(&[
            ("POINTS 3 float", floats(&points)),
            ("POINT_DATA 3\nSCALARS heat float\nLOOKUP_TABLE default", floats(&[7.0, 8.0, 9.0])),
            ("NORMALS Normals float", floats(&[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0])),
            ("FIELD FieldData 2\ngrey 1 3 unsigned_char", vec![1, 2, 3]),
            ("pair 2 3 unsigned_char", vec![1, 2, 3, 4, 5, 6]),
        ]))
        .unwrap();
        assert_eq!((found.cloud.len(), found.n_dropped, found.space), (2, 1, Space::Unknown));
        assert_eq!(found.cloud.normals().unwrap(), [Vector3::z(), Vector3::x()]);
        let extras: Vec<(&str, &[f64])> = found.cloud.extras().iter().map(|(n, v)| (&**n, &**v)).collect();
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
            let said = mesh(String::as_bytes(&bytes)).unwrap_err().to_string();
            assert!(said.contains(expected), "{expected}\n{said}");
        }
        let cut = binary(&[("POINTS 4 float", floats(&CORNERS[..5]))]);
        let said = mesh(&cut).unwrap_err().to_string();
        assert!(said.contains("byte 77: 4 times 3 numbers are promised, but 21 bytes are left"), "{said}");
    }
}
