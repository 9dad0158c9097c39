//! The PLY format itself: header and elements, in ASCII and in both binary orders.
//!
//! Read by our own code because scanners write files that stricter readers refuse: `nan` for a pixel without depth, numbers such as
//! `.5` and `1.`, CRLF, blank lines. Counts are checked against the bytes that follow before anything is allocated.

use crate::{
    FileError,
    scalar::{self, Rows, Scalar},
    shape::{Places, Shape, fan, normal_columns},
    space::StatedSpace,
};
use nalgebra::{Point3, Vector3};
use std::path::Path;

/// The content of a PLY file: a surface if it has faces, otherwise a cloud.
pub(crate) fn shape(path: &Path, bytes: &[u8]) -> Result<Shape, FileError> {
    let mut ply = Ply::parse(path, bytes)?;
    let fault = |message: String| FileError::content(path, "header", message);
    let vertex =
        ply.element("vertex").ok_or_else(|| fault("there is no element \"vertex\", which holds the points".into()))?;
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
        ..Shape::default()
    };
    if ply.element("tristrips").is_some_and(|strips| strips.count > 0) {
        return Err(fault("element \"tristrips\" is not read; export the surface as triangles".into()));
    }
    if let Some(face) = ply.element("face").filter(|face| face.count > 0) {
        shape.faces = Some(faces(path, face, vertex.count)?);
    } else {
        for (k, property) in vertex.properties.iter().enumerate() {
            if places.contains(&k) || normal_places.is_some_and(|places| places.contains(&k)) {
                continue;
            }
            match property.kind {
                Kind::Scalar(_) => shape.extras.push((property.name.clone(), vertex.column(k))),
                Kind::List(..) => {
                    shape.notes.push(format!("the list \"{}\" of the points was left out", property.name));
                }
            }
        }
    }
    shape.notes.append(&mut ply.notes);
    shape.stated = std::mem::take(&mut ply.stated);
    let vertex = ply.elements.iter_mut().find(|element| element.name == "vertex");
    shape.places = vertex.map(|vertex| std::mem::take(&mut vertex.places)).unwrap_or_default();
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

/// The elements of a file, in its order.
struct Ply<'a> {
    elements: Vec<Element<'a>>,
    stated: StatedSpace,
    notes: Vec<String>,
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

impl<'a> Ply<'a> {
    fn parse(path: &'a Path, bytes: &'a [u8]) -> Result<Self, FileError> {
        let mut lines = Lines { path, bytes, at: 0, line: 0 };
        let Header { encoding, mut elements, stated } = header(&mut lines)?;
        for element in &mut elements {
            element.check_size(&lines, encoding)?;
            match encoding {
                Encoding::Ascii => element.read_ascii(&mut lines)?,
                _ => element.read_binary(&mut lines, encoding == Encoding::Big)?,
            }
        }
        let mut notes = Vec::new();
        let left = &lines.bytes[lines.at..];
        if !left.trim_ascii().is_empty() {
            if encoding == Encoding::Ascii {
                let message = "more lines follow than the header counts; do header and data belong together?";
                return Err(FileError::content(path, format!("line {}", lines.line + 1), message));
            }
            let last = elements.last().and_then(|last| Some((&last.name, last.rows?.stride)));
            if let Some((name, stride)) = last.filter(|(_, stride)| left.len().is_multiple_of(*stride)) {
                let message = format!(
                    "{} more elements \"{name}\" follow than the header counts; do header and data belong together?",
                    left.len() / stride
                );
                return Err(FileError::content(path, format!("byte {}", lines.at), message));
            }
            let (n, at) = (left.len(), lines.at);
            notes.push(format!("{n} bytes follow the last element, from byte {at} on, and were not read"));
        }
        Ok(Self { elements, stated, notes })
    }

    fn element(&self, name: &str) -> Option<&Element<'a>> {
        self.elements.iter().find(|e| e.name == name)
    }
}

impl<'a> Element<'a> {
    /// The place of a scalar property.
    fn scalar(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|p| p.name == name && matches!(p.kind, Kind::Scalar(_)))
    }

    /// The values of a scalar property, one for each element.
    fn column(&self, place: usize) -> Vec<f64> {
        let property = &self.properties[place];
        match (self.rows, property.kind) {
            (Some(rows), Kind::Scalar(scalar)) => rows.column(scalar, property.offset),
            _ => property.values.clone(),
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

    /// Checks that the file is long enough for the elements that its header announces.
    fn check_size(&self, lines: &Lines, encoding: Encoding) -> Result<(), FileError> {
        if self.count > 0 && self.properties.is_empty() {
            return Err(lines.fault(format!("the header gives element \"{}\" no properties", self.name)));
        }
        let size = |t: Scalar| if encoding == Encoding::Ascii { 2 } else { t.n_bytes() };
        let least: usize = self
            .properties
            .iter()
            .map(|p| match p.kind {
                Kind::Scalar(t) | Kind::List(t, _) => size(t),
            })
            .sum();
        // The last line may lack its line break.
        let left = (lines.bytes.len() - lines.at + 1) as u64;
        if (self.count as u64).saturating_mul(least as u64) > left {
            let message = format!(
                "the header promises {} elements \"{}\" of at least {least} bytes, but {} bytes are left; \
                 was the file cut short?",
                self.count,
                self.name,
                left - 1
            );
            return Err(lines.fault(message));
        }
        Ok(())
    }

    fn read_ascii(&mut self, lines: &mut Lines) -> Result<(), FileError> {
        self.properties.iter_mut().for_each(|property| property.values.reserve(self.count));
        let mut places = Vec::with_capacity(self.count);
        for index in 0..self.count {
            let text = loop {
                match lines.next()? {
                    Some(text) if text.trim().is_empty() => {}
                    Some(text) => break text,
                    None => {
                        let message = format!(
                            "the file ends after {index} of {} elements \"{}\"; was it cut short?",
                            self.count, self.name
                        );
                        return Err(lines.fault(message));
                    }
                }
            };
            places.push(lines.line);
            let mut words = text.split_ascii_whitespace();
            let mut number = |name: &str| -> Result<f64, FileError> {
                let word = words.next().ok_or_else(|| lines.fault(format!("no value for property \"{name}\"")))?;
                scalar::number(word).ok_or_else(|| lines.fault(format!("\"{word}\" is not a number for \"{name}\"")))
            };
            for property in &mut self.properties {
                match property.kind {
                    Kind::Scalar(_) => property.values.push(number(&property.name)?),
                    Kind::List(..) => {
                        let n = number(&property.name)?;
                        // More values than the line has characters cannot be there.
                        if n.fract() != 0.0 || !(0.0..=text.len() as f64).contains(&n) {
                            return Err(lines.fault(format!("list \"{}\" claims {n} values", property.name)));
                        }
                        for _ in 0..n as usize {
                            property.values.push(number(&property.name)?);
                        }
                        property.ends.push(property.values.len());
                    }
                }
            }
            if let Some(word) = words.next() {
                return Err(lines.fault(format!(
                    "\"{word}\" follows the {} properties of element \"{}\"; do header and data belong together?",
                    self.properties.len(),
                    self.name
                )));
            }
        }
        self.places = Places::Lines(places);
        Ok(())
    }

    fn read_binary(&mut self, lines: &mut Lines<'a>, big: bool) -> Result<(), FileError> {
        let mut stride = 0;
        let is_fixed = self.properties.iter_mut().all(|property| {
            let Kind::Scalar(scalar) = property.kind else { return false };
            property.offset = stride;
            stride += scalar.n_bytes();
            true
        });
        if is_fixed && stride > 0 {
            // The size was checked, but for the one byte by which a text may be shorter.
            let n = self.count * stride;
            let bytes = lines.bytes.get(lines.at..lines.at + n).ok_or_else(|| {
                lines.fault(format!("the file ends within the {} \"{}\"; was it cut short?", self.count, self.name))
            })?;
            lines.at += n;
            self.rows = Some(Rows { bytes, stride, big });
            self.places = Places::Rows { first: lines.at - n, stride };
            return Ok(());
        }
        self.properties.iter_mut().for_each(|property| property.values.reserve(self.count));
        let mut places = Vec::with_capacity(self.count);
        for index in 0..self.count {
            places.push(lines.at);
            for property in &mut self.properties {
                let cut = |lines: &Lines| {
                    lines.fault(format!(
                        "the file ends within element {index} of {} \"{}\"; was it cut short?",
                        self.count, self.name
                    ))
                };
                match property.kind {
                    Kind::Scalar(t) => {
                        property.values.push(lines.number(t, big).ok_or_else(|| cut(lines))?);
                    }
                    Kind::List(count, item) => {
                        let n = lines.number(count, big).ok_or_else(|| cut(lines))?;
                        let left = (lines.bytes.len() - lines.at) / item.n_bytes();
                        if n.fract() != 0.0 || !(0.0..=left as f64).contains(&n) {
                            let name = &property.name;
                            return Err(lines.fault(format!("list \"{name}\" claims {n} values, {left} can follow")));
                        }
                        for _ in 0..n as usize {
                            property.values.push(lines.number(item, big).ok_or_else(|| cut(lines))?);
                        }
                        property.ends.push(property.values.len());
                    }
                }
            }
        }
        self.places = Places::Bytes(places);
        Ok(())
    }
}

struct Header<'a> {
    encoding: Encoding,
    elements: Vec<Element<'a>>,
    stated: StatedSpace,
}

fn header<'a>(lines: &mut Lines<'a>) -> Result<Header<'a>, FileError> {
    if lines.next()?.map(str::trim) != Some("ply") {
        return Err(lines.fault("a PLY file begins with the line \"ply\"; is it another kind of file?".into()));
    }
    let (mut encoding, mut elements, mut stated) = (None, Vec::<Element>::new(), StatedSpace::default());
    loop {
        let Some(text) = lines.next()? else {
            return Err(lines.fault("the header has no \"end_header\"; was the file cut short?".into()));
        };
        match text.split_ascii_whitespace().collect::<Vec<_>>()[..] {
            [] => {}
            ["comment" | "obj_info", ..] => stated.take(text).map_err(|message| lines.fault(message))?,
            ["format", ..] if encoding.is_some() => {
                return Err(lines.fault("the header has a second line \"format\"".into()));
            }
            ["format", "ascii", ..] => encoding = Some(Encoding::Ascii),
            ["format", "binary_little_endian", ..] => encoding = Some(Encoding::Little),
            ["format", "binary_big_endian", ..] => encoding = Some(Encoding::Big),
            ["element", name, count] => {
                let count = count.parse().map_err(|_| lines.fault(format!("\"{count}\" is no count of elements")))?;
                if elements.iter().any(|element| element.name == name) {
                    return Err(lines.fault(format!("the header names element \"{name}\" twice")));
                }
                elements.push(Element {
                    name: name.into(),
                    count,
                    properties: Vec::new(),
                    rows: None,
                    places: Places::Order,
                });
            }
            ["property", ref words @ .., name] => {
                let kind = match *words {
                    [t] => named(t).map(Kind::Scalar),
                    ["list", count, item] => named(count).zip(named(item)).map(|(c, i)| Kind::List(c, i)),
                    _ => None,
                };
                let kind =
                    kind.ok_or_else(|| lines.fault(format!("\"{}\" is no known property type", words.join(" "))))?;
                let Some(element) = elements.last_mut() else {
                    return Err(lines.fault("a property precedes the first element".into()));
                };
                if element.properties.iter().any(|property| property.name == name) {
                    return Err(lines.fault(format!("element \"{}\" has two properties \"{name}\"", element.name)));
                }
                let name = name.into();
                element.properties.push(Property { name, kind, offset: 0, values: Vec::new(), ends: Vec::new() });
            }
            ["end_header"] => break,
            _ => return Err(lines.fault(format!("\"{}\" is no line of a PLY header", text.trim()))),
        }
    }
    let encoding = encoding.ok_or_else(|| lines.fault("the header has no \"format\" line".into()))?;
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

/// A place in a file: lines while it is text, bytes behind a binary header.
struct Lines<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    at: usize,
    line: usize,
}

impl<'a> Lines<'a> {
    /// The next line without its line break; none at the end.
    fn next(&mut self) -> Result<Option<&'a str>, FileError> {
        let rest = &self.bytes[self.at..];
        if rest.is_empty() {
            return Ok(None);
        }
        self.line += 1;
        let n = rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
        self.at += (n + 1).min(rest.len());
        let text = std::str::from_utf8(&rest[..n]).or_else(|_| {
            // Only comments may be in another encoding than ASCII.
            if rest.starts_with(b"comment") || rest.starts_with(b"obj_info") { Ok("comment") } else { Err(()) }
        });
        text.map(|t| Some(t.trim_end_matches('\r'))).map_err(|()| self.fault("the line is no text".into()))
    }

    fn number(&mut self, scalar: Scalar, big: bool) -> Option<f64> {
        let value = scalar.first(&self.bytes[self.at..], big)?;
        self.at += scalar.n_bytes();
        Some(value)
    }

    fn fault(&self, message: String) -> FileError {
        FileError::content(self.path, format!("line {}", self.line), message)
    }
}
