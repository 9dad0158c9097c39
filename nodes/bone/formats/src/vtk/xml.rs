//! XML files of VTK with poly data (`.vtp`): numbers as text, in base64 or appended raw, also compressed by zlib.
//!
//! # Source
//! The VTK file formats, "XML file formats"; `vtkXMLDataParser` for the order of headers and blocks; `vtkMRMLModelStorageNode` for the
//! field `SPACE`.

use super::{Lists, keep};
use crate::{
    FileError,
    cursor::Cursor,
    scalar::{self, Rows, Scalar},
    shape::Shape,
    space::StatedSpace,
};
use base64::{Engine, engine::general_purpose::STANDARD};
use flate2::read::ZlibDecoder;
use nalgebra::Point3;
use roxmltree::{Document, Node, ParsingOptions};
use std::{io::Read, path::Path};

/// More elements are no poly data of one surface.
const MOST_NODES: u32 = 10_000;

/// What is the same for all arrays of a file.
struct File<'a> {
    cursor: Cursor<'a>,
    is_big: bool,
    is_compressed: bool,
    /// Of the counts of bytes before the numbers.
    count: Scalar,
    appended: &'a [u8],
    is_raw: bool,
}

/// The surface in the file, or the cloud if it has neither polygons nor strips.
pub(super) fn shape(path: &Path, bytes: &[u8]) -> Result<Shape, FileError> {
    let cursor = Cursor::new(path, bytes);
    let fault = |message: String| cursor.header_fault(message);
    // Raw numbers are no XML.
    let tag = b"<AppendedData";
    let at = bytes.windows(tag.len()).position(|window| window == tag).unwrap_or(bytes.len());
    let mut head = String::from_utf8_lossy(&bytes[..at]).into_owned();
    let tail = &bytes[at..];
    let start = tail.iter().position(|b| *b == b'_').map_or(tail.len(), |at| at + 1);
    if at < bytes.len() {
        head.push_str("</VTKFile>");
    }
    let options = ParsingOptions { allow_dtd: false, nodes_limit: MOST_NODES };
    let document = Document::parse_with_options(&head, options).map_err(|error| fault(error.to_string()))?;
    let root = document.root_element();
    let is_compressed = match root.attribute("compressor") {
        None | Some("") => false,
        Some("vtkZLibDataCompressor") => true,
        Some(other) => {
            return Err(fault(format!("{other} is not read; write the file with zlib or without compression")));
        }
    };
    let count = if root.attribute("header_type") == Some("UInt64") { Scalar::U64 } else { Scalar::U32 };
    let is_big = root.attribute("byte_order") == Some("BigEndian");
    let is_raw = String::from_utf8_lossy(&tail[..start]).contains("encoding=\"raw\"");
    let file = File { cursor, is_big, is_compressed, count, appended: &tail[start..], is_raw };
    let mut shape = Shape::default();
    let pieces: Vec<Node> = root.descendants().filter(|node| node.has_tag_name("Piece")).collect();
    let [piece] = pieces[..] else {
        return Err(fault(format!("{} pieces; one is read: append them to one poly data", pieces.len())));
    };
    let space = root.descendants().find(|node| node.attribute("Name") == Some("SPACE"));
    if let Some(space) = space {
        let letters: String =
            file.numbers(space)?.iter().map(|code| *code as u8 as char).filter(|c| *c != '\0').collect();
        shape.stated = StatedSpace::of(&format!("SPACE={letters}")).map_err(fault)?;
    }
    let of = |section: &str| piece.children().find(|node| node.has_tag_name(section));
    let arrays = |section: &str| of(section).into_iter().flat_map(|node| node.children().filter(Node::is_element));
    let points = arrays("Points").next().ok_or_else(|| file.fault(piece, "it has no Points"))?;
    let coordinates = file.numbers(points)?;
    let n = file.stated(piece, "NumberOfPoints")?;
    if coordinates.len() != 3 * n {
        return Err(file.fault(points, format!("{} numbers for {n} points of three", coordinates.len())));
    }
    shape.points = coordinates.chunks_exact(3).map(Point3::from_slice).collect();
    for array in arrays("PointData").filter(|array| array.has_tag_name("DataArray")) {
        let width = array.attribute("NumberOfComponents").and_then(|n| n.parse().ok()).unwrap_or(1);
        let values = file.numbers(array)?;
        if values.len() != n.saturating_mul(width) {
            return Err(file.fault(array, format!("{} numbers for {n} points of {width}", values.len())));
        }
        let name = array.attribute("Name").unwrap_or_default();
        let is_normal = of("PointData").and_then(|of| of.attribute("Normals")) == Some(name) || name == "Normals";
        keep(&mut shape, name, is_normal, width, values).map_err(|message| file.fault(array, message))?;
    }
    for (section, counted) in [("Lines", "NumberOfLines"), ("Strips", "NumberOfStrips"), ("Polys", "NumberOfPolys")] {
        let n_cells = file.stated(piece, counted)?;
        match (n_cells, section) {
            (0, _) => continue,
            (_, "Lines") => {
                shape.notes.push(format!("{n_cells} lines were left out"));
                continue;
            }
            _ => {}
        }
        let named = |name: &str| {
            let array = arrays(section).find(|array| array.attribute("Name") == Some(name));
            array
                .map_or_else(|| Err(file.fault(piece, format!("{section} has no {name}"))), |array| file.numbers(array))
        };
        let (indices, offsets) = (named("connectivity")?, named("offsets")?);
        let is_sorted = offsets.is_sorted() && offsets.iter().all(|end| end.fract() == 0.0 && *end >= 0.0);
        if offsets.len() != n_cells || !is_sorted || offsets.last() != Some(&(indices.len() as f64)) {
            let message =
                format!("the offsets of {section} are not those of {n_cells} cells with {} corners", indices.len());
            return Err(file.fault(piece, message));
        }
        let lists = Lists { ends: offsets.iter().map(|end| *end as usize).collect(), indices };
        lists.faces(shape.faces.get_or_insert_default(), section == "Strips", n).map_err(|(cell, corner)| {
            file.fault(piece, format!("cell {cell} of {section} names point {corner}, but there are {n}"))
        })?;
    }
    Ok(shape)
}

impl File<'_> {
    fn fault(&self, node: Node, message: impl std::fmt::Display) -> FileError {
        let line = node.document().text_pos_at(node.range().start).row as usize;
        let name = node.attribute("Name").unwrap_or(node.tag_name().name());
        self.cursor.fault_at(line, format!("{}: {message}", name.escape_default()))
    }

    /// A number of things; 0 if it is not stated.
    fn stated(&self, node: Node, name: &str) -> Result<usize, FileError> {
        let Some(text) = node.attribute(name) else { return Ok(0) };
        text.parse().map_err(|_| self.fault(node, format!("{name} is \"{}\"", text.escape_default())))
    }

    /// The numbers of an array, or the codes of the letters of a text.
    fn numbers(&self, array: Node) -> Result<Vec<f64>, FileError> {
        let fault = |message: &str| self.fault(array, message);
        let kind = match array.attribute("type") {
            Some("Int8") => Scalar::I8,
            Some("UInt8" | "String") => Scalar::U8,
            Some("Int16") => Scalar::I16,
            Some("UInt16") => Scalar::U16,
            Some("Int32") => Scalar::I32,
            Some("UInt32") => Scalar::U32,
            Some("Int64") => Scalar::I64,
            Some("UInt64") => Scalar::U64,
            Some("Float32") => Scalar::F32,
            Some("Float64") => Scalar::F64,
            _ => return Err(fault("its type is none that is read")),
        };
        let text = array.text().unwrap_or_default();
        let bytes = match array.attribute("format") {
            Some("ascii") => {
                let number = |word: &str| scalar::number(word).ok_or_else(|| fault("its text is not all numbers"));
                return text.split_ascii_whitespace().map(number).collect();
            }
            Some("appended") => {
                let from = self.appended.get(self.stated(array, "offset")?..);
                let from = from.ok_or_else(|| fault("its offset is behind the end; was the file cut short?"))?;
                self.unpacked(from, self.is_raw)
            }
            _ => self.unpacked(text.trim().as_bytes(), false),
        };
        let bytes = bytes.ok_or_else(|| fault("its numbers end early, or are damaged; was the file cut short?"))?;
        Ok(Rows { bytes: &bytes, stride: kind.n_bytes(), big: self.is_big }.column(kind, 0))
    }

    /// The bytes of an array: their number before them, or the sizes of compressed blocks.
    fn unpacked(&self, mut from: &[u8], is_raw: bool) -> Option<Vec<u8>> {
        let width = self.count.n_bytes();
        let count = |bytes: &[u8], k: usize| Some(self.count.first(bytes.get(k * width..)?, self.is_big)? as usize);
        let n = count(&take(&mut &*from, is_raw, width)?, 0)?;
        if !self.is_compressed {
            return Some(take(&mut from, is_raw, width.checked_add(n)?)?.split_off(width));
        }
        let header = take(&mut from, is_raw, width.checked_mul(n.checked_add(3)?)?)?;
        let (size, last) = (count(&header, 1)?, count(&header, 2)?);
        let sizes = (0..n).map(|k| count(&header, 3 + k)).collect::<Option<Vec<_>>>()?;
        let packed = take(&mut from, is_raw, sizes.iter().try_fold(0, |sum: usize, n| sum.checked_add(*n))?)?;
        let (mut bytes, mut rest) = (Vec::new(), &packed[..]);
        for (k, length) in sizes.into_iter().enumerate() {
            let expected = if k + 1 == n && last > 0 { last } else { size };
            let block = ZlibDecoder::new(rest.split_off(..length)?);
            let n_read = block.take(expected as u64).read_to_end(&mut bytes).ok()?;
            (n_read == expected).then_some(())?;
        }
        Some(bytes)
    }
}

/// The next bytes, raw or as one text in base64; none if they end before.
fn take(from: &mut &[u8], is_raw: bool, n: usize) -> Option<Vec<u8>> {
    let part = from.split_off(..if is_raw { n } else { n.div_ceil(3).checked_mul(4)? })?;
    let mut bytes = if is_raw { part.to_vec() } else { STANDARD.decode(part).ok()? };
    (bytes.len() >= n).then(|| bytes.truncate(n))?;
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Space,
        kind::{has_vtp_faces, is_vtp},
    };

    /// As VTK 9.7 writes a square with a number for each point and a field `SPACE`, in base64 with zlib, without empty sections.
    const PACKED: &str = r#"<?xml version="1.0"?>
<VTKFile type="PolyData" version="0.1" byte_order="LittleEndian" header_type="UInt32" compressor="vtkZLibDataCompressor">
<PolyData><FieldData><Array type="String" Name="SPACE" NumberOfTuples="1" format="binary">
  AQAAAACAAAAEAAAADAAAAA==eF4LcgxmAAACtQDn
</Array></FieldData>
<Piece NumberOfPoints="4" NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0" NumberOfPolys="1">
<PointData Scalars="distance_mm"><DataArray type="Float32" Name="distance_mm" format="binary">
  AQAAAACAAAAQAAAAFQAAAA==eF5jYGCwZ2BoAGIGByA6AAAM+gI/
</DataArray></PointData>
<Points><DataArray type="Float32" Name="Points" NumberOfComponents="3" format="binary">
  AQAAAACAAAAwAAAAEwAAAA==eF5jYEAGAo6obHQ+gz0AGLsBhA==
</DataArray></Points>
<Lines><DataArray type="Int64" Name="connectivity" format="binary">AAAAAACAAAAAAAAA</DataArray></Lines>
<Polys><DataArray type="Int64" Name="connectivity" format="binary">
  AQAAAACAAAAgAAAAEwAAAA==eF5jYIAARijNBKWZoTQAAHAABw==
</DataArray><DataArray type="Int64" Name="offsets" format="binary">
  AQAAAACAAAAIAAAACwAAAA==eF5jYYAAAAAoAAU=
</DataArray></Polys></Piece></PolyData></VTKFile>"#;

    const SQUARE: [[f64; 3]; 4] = [[0.0, 0.0, 0.0], [9.0, 0.0, 0.0], [9.0, 9.0, 0.0], [0.0, 9.0, 0.5]];

    /// A cloud whose numbers are appended: its coordinates, and normals at byte 52.
    fn appended(numbers: &[u8], encoding: &str) -> Vec<u8> {
        let head = format!(
            "<VTKFile type=\"PolyData\" byte_order=\"BigEndian\" header_type=\"UInt64\"><PolyData>\
             <Piece NumberOfPoints=\"2\" NumberOfLines=\"7\"><PointData Normals=\"n\">\
             <DataArray type=\"Float32\" Name=\"n\" NumberOfComponents=\"3\" format=\"appended\" offset=\"{}\"/></PointData>\
             <Points><DataArray type=\"Float64\" NumberOfComponents=\"3\" format=\"appended\" offset=\"0\"/></Points>\
             </Piece></PolyData><AppendedData encoding=\"{encoding}\">\n _",
            if encoding == "raw" { 56 } else { 76 }
        );
        [head.as_bytes(), numbers, b"\n</AppendedData></VTKFile>"].concat()
    }

    fn numbers() -> [Vec<u8>; 2] {
        let points = [1.0_f64, 2.0, 3.0, -4.0, 5.0, 6.5].map(f64::to_be_bytes).concat();
        let normals = [0.0_f32, 0.0, 1.0, 0.0, 1.0, 0.0].map(f32::to_be_bytes).concat();
        [points, normals].map(|bytes| [&(bytes.len() as u64).to_be_bytes()[..], &bytes].concat())
    }

    fn said(bytes: &[u8]) -> String {
        super::super::shape("a.vtp".as_ref(), bytes).map_or_else(|error| error.to_string(), |_| "read".into())
    }

    #[test]
    fn a_surface_is_read_as_vtk_writes_it_in_the_axes_that_it_states() {
        let shape = super::super::shape("a.vtp".as_ref(), PACKED.as_bytes()).unwrap();
        assert_eq!(shape.points, SQUARE.map(Point3::from));
        assert_eq!(shape.faces, Some(vec![[0, 1, 2], [0, 2, 3]]));
        assert_eq!(shape.stated.space, Space::Ras);
        let text = PACKED.replace("NumberOfPolys=\"1\"", "NumberOfPolys=\"0\"");
        let cloud = super::super::shape("a.vtp".as_ref(), text.as_bytes()).unwrap();
        assert_eq!((cloud.faces, cloud.extras), (None, vec![("distance_mm".into(), vec![0.5, 1.0, 2.0, -3.0])]));
        assert!(is_vtp(PACKED.as_bytes()) && has_vtp_faces(PACKED.as_bytes()) && !has_vtp_faces(text.as_bytes()));
        assert!(!is_vtp(PACKED.replace("PolyData\" v", "ImageData\" v").as_bytes()));
    }

    #[test]
    fn appended_numbers_are_read_raw_and_in_base64_in_either_order_of_bytes() {
        let raw = appended(&numbers().concat(), "raw");
        let text = appended(numbers().map(|bytes| STANDARD.encode(bytes)).concat().as_bytes(), "base64");
        for bytes in [raw, text] {
            let shape = super::super::shape("a.vtp".as_ref(), &bytes).unwrap();
            assert_eq!(shape.points, [[1.0, 2.0, 3.0], [-4.0, 5.0, 6.5]].map(Point3::from));
            assert_eq!(shape.normals.unwrap()[1].y, 1.0);
            assert_eq!(shape.notes, ["7 lines were left out"]);
        }
    }

    #[test]
    fn what_is_cut_damaged_or_of_another_kind_is_refused_with_its_line() {
        let raw = appended(&numbers().concat(), "raw");
        for (bytes, expected) in [
            (
                raw[..raw.len() - 40].to_vec(),
                "line 1: n: its numbers end early, or are damaged; was the file cut short?",
            ),
            (
                PACKED.replace("eF5jYEAGAo6o", "eF5jYEAGAAAA").into(),
                "line 10: Points: its numbers end early, or are damaged",
            ),
            (
                PACKED.replace("NumberOfPoints=\"4\"", "NumberOfPoints=\"5\"").into(),
                "line 10: Points: 12 numbers for 5 points of three",
            ),
            (
                PACKED.replace("NumberOfPolys=\"1\"", "NumberOfPolys=\"2\"").into(),
                "line 6: Piece: the offsets of Polys are not those of 2 cells with 4 corners",
            ),
            (PACKED.replace("vtkZLib", "vtkLZ4").into(), "vtkLZ4DataCompressor is not read; write the file with zlib"),
            (
                PACKED.replace("Float32\" Name=\"Points", "Float16\" Name=\"Points").into(),
                "line 10: Points: its type is none that is read",
            ),
            (PACKED.replace("</Piece>", "</Piece><Piece/>").into(), "2 pieces; one is read"),
            (PACKED.replace("</PolyData>", "").into(), "VTKFile"),
        ] {
            let said = said(&bytes);
            assert!(said.contains(expected), "{said}\n{expected}");
        }
        // Every cut is refused, and none is another number.
        for n in 0..raw.len() - b"\n</AppendedData></VTKFile>".len() {
            assert_ne!(said(&raw[..n]), "read", "{n}");
        }
    }
}
