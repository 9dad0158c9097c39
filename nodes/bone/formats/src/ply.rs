//! The PLY format itself: header and elements, in ASCII and in both binary orders.
//!
//! Read by our own code because scanners write files that stricter readers refuse: `nan` for a pixel without depth, numbers such as
//! `.5` and `1.`, CRLF, blank lines. Counts are checked against the bytes that follow before anything is allocated.

use crate::{
    FileError,
    cursor::Cursor,
    scalar::{self, Rows, Scalar},
    shape::{Places, Shape, fan, normal_columns},
    space::StatedSpace,
};
use nalgebra::{Point3, Vector3};
use std::{borrow::Cow, path::Path};

/// The content of a PLY file: a surface if it has faces, otherwise a cloud.
pub(crate) fn shape(path: &Path, bytes: &[u8]) -> Result<Shape, FileError> {
    let mut cursor = Cursor::new(path, bytes);
    let Header { encoding, mut elements, stated } = header(&mut cursor)?;
    for element in &mut elements {
        element.read(&mut cursor, encoding)?;
    }
    let stride = elements.last().and_then(|last| Some(last.rows?.stride));
    let last = elements.last().map_or("", |last| &last.name);
    let notes = cursor.end("element", &format!("elements \"{last}\""), stride)?.into_iter().collect();

    let fault = |message: String| cursor.header_fault(message);
    let element = |name: &str| elements.iter().find(|element| element.name == name);
    let vertex =
        element("vertex").ok_or_else(|| fault("there is no element \"vertex\", which holds the points".into()))?;
    let place = |name: &str| {
        vertex
            .scalar(name)
            .ok_or_else(|| fault(format!("the points have no \"{name}\"; there are: {}", vertex.property_names())))
    };
    let places = [place("x")?, place("y")?, place("z")?];
    let normal_places = normal_columns(|name| vertex.scalar(name));
    let mut shape = Shape {
        points: vertex.triples::<Point3<f64>>(places),
        normals: normal_places.map(|places| vertex.triples::<Vector3<f64>>(places)),
        stated,
        ..Shape::default()
    };
    if element("tristrips").is_some_and(|strips| strips.count > 0) {
        return Err(fault("element \"tristrips\" is not read; export the surface as triangles".into()));
    }
    if let Some(face) = element("face").filter(|face| face.count > 0) {
        shape.faces = Some(faces(path, face, vertex.count)?);
    } else {
        for (k, property) in vertex.properties.iter().enumerate() {
            if places.contains(&k) || normal_places.is_some_and(|places| places.contains(&k)) {
                continue;
            }
            match property.kind {
                Kind::Scalar(_) => shape.extras.push((property.name.clone(), vertex.column(k).into_owned())),
                Kind::List(..) => {
                    shape.notes.push(format!("the list \"{}\" of the points was left out", property.name));
                }
            }
        }
    }
    shape.notes.extend::<Vec<_>>(notes);
    let vertex = elements.into_iter().find(|element| element.name == "vertex");
    shape.places = vertex.map(|vertex| vertex.places).unwrap_or_default();
    Ok(shape)
}

fn faces(path: &Path, face: &Element, n_vertices: usize) -> Result<Vec<[u32; 3]>, FileError> {
    // The two names that are in use.
    let lists = ["vertex_indices", "vertex_index"].iter().find_map(|name| face.lists(name)).ok_or_else(|| {
        let message = "the faces have no list \"vertex_indices\" or \"vertex_index\"; is it a surface?";
        FileError::content(path, "header", message)
    })?;
    let mut faces = Vec::with_capacity(face.count);
    let mut corners = Vec::new();
    for (k, polygon) in lists.enumerate() {
        if let Some(index) = polygon.iter().find(|i| i.fract() != 0.0 || !(0.0..n_vertices as f64).contains(*i)) {
            let message = format!("it names vertex {index}, but there are {n_vertices}");
            return Err(FileError::content(path, format!("face {k}"), message));
        }
        corners.clear();
        corners.extend(polygon.iter().map(|&i| i as u32));
        fan(&mut faces, &corners);
    }
    Ok(faces)
}

/// One kind of element.
struct Element<'a> {
    name: String,
    count: usize,
    properties: Vec<Property>,
    /// The bytes of a binary element of fixed size; the others are in the properties.
    rows: Option<Rows<'a>>,
    /// Where each is in the file.
    places: Places,
}

struct Property {
    name: String,
    kind: Kind,
    /// Offset in a row of a binary element of fixed size.
    offset: usize,
    values: Vec<f64>,
    /// For a list: where each element's run ends in `values`.
    ends: Vec<usize>,
}

#[derive(Clone, Copy)]
enum Kind {
    Scalar(Scalar),
    List(Scalar, Scalar),
}

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

impl<'a> Element<'a> {
    /// The place of a scalar property.
    fn scalar(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|p| p.name == name && matches!(p.kind, Kind::Scalar(_)))
    }

    /// The values of a scalar property, one for each element.
    fn column(&self, place: usize) -> Cow<'_, [f64]> {
        let property = &self.properties[place];
        match (self.rows, property.kind) {
            (Some(rows), Kind::Scalar(scalar)) => rows.column(scalar, property.offset).into(),
            _ => (&property.values).into(),
        }
    }

    /// Three scalar properties of each element.
    fn triples<T: From<[f64; 3]>>(&self, places: [usize; 3]) -> Vec<T> {
        let properties = places.map(|k| &self.properties[k]);
        if let Some(rows) = self.rows
            && let [Kind::Scalar(a), Kind::Scalar(b), Kind::Scalar(c)] = properties.map(|p| p.kind)
            && a == b
            && b == c
        {
            return rows.triples(a, properties.map(|p| p.offset));
        }
        let [x, y, z] = places.map(|k| self.column(k));
        (0..self.count).map(|k| [x[k], y[k], z[k]].into()).collect()
    }

    /// The runs of a list property, one for each element.
    fn lists(&self, name: &str) -> Option<impl Iterator<Item = &[f64]>> {
        let property = self.properties.iter().find(|p| p.name == name && matches!(p.kind, Kind::List(..)))?;
        let starts = std::iter::once(0).chain(property.ends.iter().copied());
        Some(starts.zip(&property.ends).map(|(start, &end)| &property.values[start..end]))
    }

    /// The names of the properties, for messages.
    fn property_names(&self) -> String {
        self.properties.iter().map(|p| p.name.as_str()).collect::<Vec<_>>().join(", ")
    }

    fn read(&mut self, cursor: &mut Cursor<'a>, encoding: Encoding) -> Result<(), FileError> {
        let (count, name) = (self.count, self.name.clone());
        if count > 0 && self.properties.is_empty() {
            return Err(cursor.fault(format!("the header gives element \"{name}\" no properties")));
        }
        let is_ascii = encoding == Encoding::Ascii;
        let mut least = 0;
        let mut is_fixed = !is_ascii;
        for property in &mut self.properties {
            let (Kind::Scalar(scalar) | Kind::List(scalar, _)) = property.kind;
            is_fixed &= matches!(property.kind, Kind::Scalar(_));
            property.offset = least;
            // In a text a number takes a digit and a blank.
            least += if is_ascii { 2 } else { scalar.n_bytes() };
        }
        cursor.is_binary = !is_ascii;
        cursor.promised(count, least, &format!("elements \"{name}\" of at least {least} bytes"))?;
        if is_fixed && least > 0 {
            self.places = Places::Rows { first: cursor.at, stride: least };
            let bytes = cursor.take(count * least, &format!("the data of {count} \"{name}\""))?;
            self.rows = Some(Rows { bytes, stride: least, big: encoding == Encoding::Big });
            return Ok(());
        }
        self.properties.iter_mut().for_each(|property| property.values.reserve(count));
        let mut places = Vec::with_capacity(count);
        for k in 0..count {
            if is_ascii {
                let text =
                    cursor.filled_line().ok_or_else(|| cursor.cut_short(k, count, &format!("elements \"{name}\"")))?;
                places.push(cursor.line);
                self.read_text(cursor, &text)?;
            } else {
                places.push(cursor.at);
                let is_big = encoding == Encoding::Big;
                let cut_short = |at: &Cursor| at.cut_short(k, count, &format!("elements \"{name}\""));
                read_values(&mut self.properties, cursor, |cursor, _, scalar| {
                    cursor.binary_number(scalar, is_big).ok_or_else(|| cut_short(cursor))
                })?;
            }
        }
        self.places = if is_ascii { Places::Lines(places) } else { Places::Bytes(places) };
        Ok(())
    }

    /// One element on a line of its own.
    fn read_text(&mut self, cursor: &mut Cursor, text: &str) -> Result<(), FileError> {
        let mut words = text.split_ascii_whitespace();
        read_values(&mut self.properties, cursor, |cursor, name, _| {
            let word = words.next().ok_or_else(|| cursor.fault(format!("no value for property \"{name}\"")))?;
            scalar::number(word).ok_or_else(|| cursor.fault(format!("\"{word}\" is not a number for \"{name}\"")))
        })?;
        match words.next() {
            None => Ok(()),
            Some(word) => Err(cursor.fault(format!(
                "\"{word}\" follows the {} properties of element \"{}\"; do header and data belong together?",
                self.properties.len(),
                self.name
            ))),
        }
    }
}

/// The values of one element; `number` gives the next of a property, which is of the type.
fn read_values<'a>(
    properties: &mut [Property],
    cursor: &mut Cursor<'a>,
    mut number: impl FnMut(&mut Cursor<'a>, &str, Scalar) -> Result<f64, FileError>,
) -> Result<(), FileError> {
    for Property { name, kind, values, ends, .. } in properties {
        match *kind {
            Kind::Scalar(scalar) => values.push(number(cursor, name, scalar)?),
            Kind::List(count, item) => {
                let n = number(cursor, name, count)?;
                if n.fract() != 0.0 || !(0.0..f64::INFINITY).contains(&n) {
                    return Err(cursor.fault(format!("list \"{name}\" claims {n} values")));
                }
                for _ in 0..n as usize {
                    values.push(number(cursor, name, item)?);
                }
                ends.push(values.len());
            }
        }
    }
    Ok(())
}

struct Header<'a> {
    encoding: Encoding,
    elements: Vec<Element<'a>>,
    stated: StatedSpace,
}

fn header<'a>(cursor: &mut Cursor<'a>) -> Result<Header<'a>, FileError> {
    if cursor.line().is_none_or(|line| line.trim() != "ply") {
        return Err(cursor.fault("a PLY file begins with the line \"ply\"; is it another kind of file?"));
    }
    let (mut encoding, mut elements, mut stated) = (None, Vec::<Element>::new(), StatedSpace::default());
    loop {
        let Some(text) = cursor.line() else {
            return Err(cursor.fault("the header has no \"end_header\"; was the file cut short?"));
        };
        let fault = |message: String| Err(cursor.fault(message));
        match text.split_ascii_whitespace().collect::<Vec<_>>()[..] {
            [] => {}
            ["comment" | "obj_info", ..] => stated.take(&text).map_err(|message| cursor.fault(message))?,
            ["format", ..] if encoding.is_some() => return fault("the header has a second line \"format\"".into()),
            ["format", "ascii", ..] => encoding = Some(Encoding::Ascii),
            ["format", "binary_little_endian", ..] => encoding = Some(Encoding::Little),
            ["format", "binary_big_endian", ..] => encoding = Some(Encoding::Big),
            ["element", name, count] => {
                let count = cursor.count(count)?;
                if elements.iter().any(|element| element.name == name) {
                    return fault(format!("the header names element \"{name}\" twice"));
                }
                let (name, properties, places) = (name.into(), Vec::new(), Places::Order);
                elements.push(Element { name, count, properties, rows: None, places });
            }
            ["property", ref words @ .., name] => {
                let kind = match *words {
                    [t] => named(t).map(Kind::Scalar),
                    ["list", count, item] => named(count).zip(named(item)).map(|(c, i)| Kind::List(c, i)),
                    _ => None,
                };
                let Some(kind) = kind else {
                    return fault(format!("\"{}\" is no known property type", words.join(" ")));
                };
                let Some(element) = elements.last_mut() else {
                    return fault("a property precedes the first element".into());
                };
                if element.properties.iter().any(|property| property.name == name) {
                    return fault(format!("element \"{}\" has two properties \"{name}\"", element.name));
                }
                let name = name.into();
                element.properties.push(Property { name, kind, offset: 0, values: Vec::new(), ends: Vec::new() });
            }
            ["end_header"] => break,
            _ => return fault(format!("\"{}\" is no line of a PLY header", text.trim())),
        }
    }
    let encoding = encoding.ok_or_else(|| cursor.fault("the header has no \"format\" line"))?;
    Ok(Header { encoding, elements, stated })
}

fn named(name: &str) -> Option<Scalar> {
    Some(match name {
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        mesh_or_cloud::{CloudFileRead, read_cloud},
        write::write_ply,
    };
    use osteoflow_geometry::Cloud;

    fn read(bytes: &[u8], unit_mm: f64) -> Result<CloudFileRead, FileError> {
        let path = "a.ply".as_ref();
        shape(path, bytes)?.into_cloud(path, unit_mm, "camera".into())
    }

    #[test]
    fn a_cloud_survives_being_written_bit_for_bit() {
        let points = vec![Point3::new(1.0 / 3.0, -2e-9, 210.123456789), Point3::new(-0.0, 5e3, 1.0)];
        let normals = vec![Vector3::z(), Vector3::new(0.6, 0.0, -0.8)];
        let cloud = Cloud::new("camera", points).unwrap();
        for cloud in [cloud.clone(), cloud.with_normals(normals).unwrap()] {
            let file = tempfile::NamedTempFile::new().unwrap();
            write_ply(file.path(), &cloud, 1.0).unwrap();
            let back = read_cloud(file.path(), 1.0, "camera").unwrap();
            assert_eq!((back.cloud, back.n_points_in_file, back.n_dropped), (cloud.clone(), 2, 0));
            write_ply(file.path(), &cloud, 1000.0).unwrap();
            let back = read_cloud(file.path(), 1000.0, "camera").unwrap().cloud;
            // Millimetres to metres and back is not exact in binary.
            assert!(back.points().iter().zip(cloud.points()).all(|(a, b)| (a - b).norm() < 1e-9));
        }
    }

    #[test]
    fn points_without_depth_are_left_out_and_counted() {
        let text = "ply\nformat ascii 1.0\nobj_info scanner\nelement vertex 4\nproperty float z\nproperty float intensity\n\
                    property float y\nproperty float x\nend_header\n.2 1 0 +.1\nnan 1 nan nan\n-inf 0 0 0\n1. 0 0 0\n";
        let back = read(text.as_bytes(), 1000.0).unwrap();
        assert_eq!((back.n_points_in_file, back.n_dropped), (4, 2));
        assert_eq!(back.cloud.points(), [Point3::new(100.0, 0.0, 200.0), Point3::new(0.0, 0.0, 1000.0)]);
    }

    #[test]
    fn normals_come_only_when_every_kept_point_has_one() {
        let header = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n\
                      property float nx\nproperty float ny\nproperty float nz\nend_header\n";
        let all = read(format!("{header}0 0 0 0 0 2\n1 0 0 0 1 0\n").as_bytes(), 1.0).unwrap();
        assert_eq!(all.cloud.normals(), Some(&[Vector3::z(), Vector3::y()][..]));
        assert_eq!(all.notes, ["1 of 2 normals have lengths from 2.000e0 to 2.000e0 and were scaled to 1"]);
        let some = read(format!("{header}0 0 0 0 0 2\n1 0 0 nan 1 0\n").as_bytes(), 1.0).unwrap();
        assert_eq!((some.cloud.normals(), some.cloud.len()), (None, 2));
        assert_eq!(some.notes, ["1 of 2 normals are zero or not finite, so the cloud goes without normals"]);
    }

    #[test]
    fn a_surface_gives_its_vertices_with_a_note() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 3\n").unwrap();
        let read = read_cloud(file.path(), 1.0, "ct").unwrap();
        assert_eq!(read.cloud.len(), 3);
        assert_eq!(read.notes, ["the file is a surface of 1 faces; its vertices are taken as points"]);
    }

    #[test]
    fn a_broken_file_names_its_line() {
        let header = |n: usize| {
            format!(
                "ply\nformat ascii 1.0\nelement vertex {n}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
            )
        };
        let refusal = |text: String| read(text.as_bytes(), 1.0).unwrap_err().to_string();
        for (text, expected) in [
            ("plain text".into(), "line 1: a PLY file begins with the line \"ply\""),
            (header(2) + "0 0 0\n", "2 elements \"vertex\" of at least 6 bytes are promised, but 6 bytes are left"),
            (header(2) + "0 0 0     \n      \n", "the file ends after 1 of 2 elements \"vertex\"; was it cut short?"),
            (header(2) + "0 0 0\n0 0     \n", "line 9: no value for property \"z\""),
            (header(1) + "0 0 0 7\n", "line 8: \"7\" follows the 3 properties"),
            (header(1) + "0 zero 0\n", "line 8: \"zero\" is not a number for \"y\""),
            (
                header(1).replace("property float z\n", "") + "0 0\n",
                "header: the points have no \"z\"; there are: x, y",
            ),
            (header(1).replace("float z", "half z"), "line 6: \"half\" is no known property type"),
            (header(1).replace("end_header\n", ""), "the header has no \"end_header\""),
            (
                "ply\nformat ascii 1.0\nelement vertex 9\nend_header\n".into(),
                "the header gives element \"vertex\" no properties",
            ),
            (header(usize::MAX), "bytes are left; was the file cut short?"),
        ] {
            assert!(refusal(text.clone()).contains(expected), "{expected}\n{}", refusal(text));
        }
        let mut cut =
            b"ply\nformat binary_little_endian 1.0\nelement vertex 3000000000\nproperty double x\nend_header\n"
                .to_vec();
        cut.extend([0; 64]);
        let refusal = read(&cut, 1.0).unwrap_err().to_string();
        assert!(
            refusal.contains("3000000000 elements \"vertex\" of at least 8 bytes are promised, but 64 bytes are left"),
            "{refusal}"
        );
    }
}
