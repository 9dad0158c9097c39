//! STL, binary and ASCII.

use crate::{
    FileError,
    cursor::Cursor,
    shape::{Places, Shape},
    space::StatedSpace,
};
use nalgebra::Point3;
use std::{collections::HashMap, path::Path};

const HEADER_BYTES: usize = 84;
const FACE_BYTES: usize = 50;

/// The number of triangles that a binary header counts, and the bytes of a file that holds them.
fn promised(bytes: &[u8]) -> Option<(u32, u64)> {
    let n = u32::from_le_bytes(*bytes.get(80..)?.first_chunk()?);
    Some((n, HEADER_BYTES as u64 + FACE_BYTES as u64 * u64::from(n)))
}

/// Whether a text begins as an ASCII STL. Many binary files do, too.
pub(crate) fn is_ascii(bytes: &[u8]) -> bool {
    bytes.trim_ascii_start().get(..5).is_some_and(|start| start.eq_ignore_ascii_case(b"solid"))
}

/// The surface in a binary STL file.
pub(crate) fn binary(path: &Path, bytes: &[u8]) -> Result<Shape, FileError> {
    let (end, note) = end_of_binary(path, bytes)?;
    let mut corners = Corners::default();
    let faces = bytes[HEADER_BYTES..end].chunks_exact(FACE_BYTES).enumerate().map(|(n, face)| {
        let at = HEADER_BYTES + n * FACE_BYTES;
        let float = |k: usize| f64::from(f32::from_le_bytes(face[4 * k..4 * k + 4].try_into().expect("four bytes")));
        // The normal comes first; it follows from the corners and is not read.
        [3, 6, 9].map(|k| corners.number([float(k), float(k + 1), float(k + 2)], at + 4 * k))
    });
    let (faces, notes) = (Some(faces.collect()), note.into_iter().collect());
    let Corners { vertices: points, places, .. } = corners;
    Ok(Shape { points, faces, stated: stated(path, bytes)?, notes, places: Places::Bytes(places), ..Shape::default() })
}

/// The surface in an ASCII STL file.
pub(crate) fn ascii(path: &Path, bytes: &[u8]) -> Result<Shape, FileError> {
    let mut corners = Corners::default();
    let faces = Some(facets(Cursor::new(path, bytes), &mut corners)?);
    let Corners { vertices: points, places, .. } = corners;
    Ok(Shape { points, faces, stated: stated(path, bytes)?, places: Places::Lines(places), ..Shape::default() })
}

/// The space in the header of a binary file, or in the first line of a text.
fn stated(path: &Path, bytes: &[u8]) -> Result<StatedSpace, FileError> {
    let head = bytes[..bytes.len().min(80)].split(|&b| b == b'\n' || b == 0).next().unwrap_or_default();
    StatedSpace::of(&String::from_utf8_lossy(head)).map_err(|message| FileError::content(path, "header", message))
}

/// Where the triangles end in a binary file that is longer than they are, with a note on what follows.
fn end_of_binary(path: &Path, bytes: &[u8]) -> Result<(usize, Option<String>), FileError> {
    let Some((n, expected)) = promised(bytes) else {
        let message = format!("{} bytes are too few for a binary STL, and no other format is recognised", bytes.len());
        return Err(FileError::content(path, "byte 0", message));
    };
    if (bytes.len() as u64) < expected {
        let message = format!(
            "no known format, or cut short: read as a binary STL, the header promises {n} triangles \
             ({expected} bytes), but the file has {} bytes",
            bytes.len()
        );
        return Err(FileError::content(path, "byte 80", message));
    }
    let mut cursor = Cursor::new(path, bytes);
    (cursor.is_binary, cursor.at) = (true, expected as usize);
    Ok((cursor.at, cursor.end("triangle", "triangles", Some(FACE_BYTES))?))
}

/// Gives each place its number; places are equal when their bits are, with no difference between 0 and -0.
#[derive(Default)]
struct Corners {
    vertices: Vec<Point3<f64>>,
    /// The line or byte at which each vertex comes first.
    places: Vec<usize>,
    numbers: HashMap<[u64; 3], u32>,
}

impl Corners {
    fn number(&mut self, vertex: [f64; 3], place: usize) -> u32 {
        let vertex = vertex.map(|c| c + 0.0);
        let Self { vertices, places, numbers, .. } = self;
        *numbers.entry(vertex.map(f64::to_bits)).or_insert_with(|| {
            vertices.push(vertex.into());
            places.push(place);
            vertices.len() as u32 - 1
        })
    }
}

fn facets(mut cursor: Cursor, corners: &mut Corners) -> Result<Vec<[u32; 3]>, FileError> {
    let (mut faces, mut open, mut closed) = (Vec::new(), Vec::new(), true);
    // The line of the facet that is open, and how many loops it has.
    let mut facet: Option<(usize, usize)> = None;
    while let Some(line) = cursor.line() {
        let text = line.to_ascii_lowercase();
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        let fault = |message: String| Err(cursor.fault(message));
        if let (Some((line, _)), Some(word @ ("facet" | "endsolid" | "solid"))) = (facet, words.first().copied()) {
            return fault(format!("\"{word}\" comes before the \"endfacet\" of the facet on line {line}"));
        }
        if closed && !matches!(words[..], [] | ["solid", ..]) {
            return fault(format!("\"{}\" is not within \"solid\" and \"endsolid\"", text.trim()));
        }
        match words[..] {
            ["vertex", ..] if facet.is_none() => return fault("a vertex is not within a facet".into()),
            ["vertex", x, y, z] => {
                let vertex = [cursor.number(x)?, cursor.number(y)?, cursor.number(z)?];
                open.push(corners.number(vertex, cursor.line));
            }
            ["vertex", ..] => return fault(format!("a vertex has three numbers, this one has {}", words.len() - 1)),
            ["endloop", ..] => match std::mem::take(&mut open)[..] {
                [a, b, c] => {
                    faces.push([a, b, c]);
                    facet = facet.map(|(line, n_loops)| (line, n_loops + 1));
                }
                ref other => return fault(format!("a facet has three corners, this one has {}", other.len())),
            },
            ["endfacet", ..] => match facet.take() {
                Some((_, 1)) if open.is_empty() => {}
                Some((_, 1..)) => return fault("a facet has one loop of three corners, this one has more".into()),
                Some((line, 0)) if open.is_empty() => return fault(format!("the facet on line {line} has no corners")),
                Some((line, 0)) => return fault(format!("the loop of the facet on line {line} has no \"endloop\"")),
                None => return fault("\"endfacet\" ends no facet".into()),
            },
            ["endsolid", ..] => closed = true,
            ["solid", ..] if closed => closed = false,
            ["solid", ..] => return fault("\"solid\" comes before the \"endsolid\" of the one before".into()),
            ["facet", ..] => facet = Some((cursor.line, 0)),
            [] | ["outer", ..] => {}
            _ => return fault(format!("\"{}\" is no line of an ASCII STL", text.trim())),
        }
    }
    if let Some((line, _)) = facet {
        return Err(cursor.fault_at(line, "the facet has no \"endfacet\"; was the file cut short?"));
    }
    if !closed {
        return Err(cursor.fault("the file ends without \"endsolid\"; was it cut short?"));
    }
    Ok(faces)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Space,
        mesh_or_cloud::{MeshRead, read_mesh},
        write::write_stl,
    };
    use osteoflow_geometry::{Mesh, SurfaceOrigin};

    /// A tetrahedron of 40 mm, closed, faces turning outwards.
    fn tetrahedron() -> Mesh {
        let corner = |x, y, z| Point3::new(x, y, z);
        let vertices =
            vec![corner(0.0, 0.0, 0.0), corner(40.0, 0.0, 0.0), corner(0.0, 40.0, 0.0), corner(0.0, 0.0, 40.0)];
        let faces = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
        Mesh::new("ct", SurfaceOrigin::User, vertices, faces).unwrap()
    }

    fn read(bytes: &[u8]) -> Result<MeshRead, FileError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        read_mesh(file.path(), 1.0, "ct", SurfaceOrigin::User)
    }

    fn error_message(bytes: &[u8]) -> String {
        read(bytes).unwrap_err().to_string()
    }

    fn binary() -> Vec<u8> {
        let file = tempfile::NamedTempFile::new().unwrap();
        write_stl(file.path(), &tetrahedron()).unwrap();
        std::fs::read(file.path()).unwrap()
    }

    /// The corners of all faces: the surface, whatever the numbers of its vertices.
    fn corners(mesh: &Mesh) -> Vec<[Point3<f64>; 3]> {
        (0..mesh.faces().len()).map(|face| mesh.corners(face)).collect()
    }

    #[test]
    fn a_surface_survives_being_written() {
        let back = read(&binary()).unwrap();
        assert_eq!(corners(&back.mesh), corners(&tetrahedron()));
        assert_eq!((back.mesh.vertices().len(), back.n_degenerate, back.notes.len()), (4, 0, 0));
    }

    #[test]
    fn a_file_that_states_no_space_is_in_the_one_given_and_another_is_refused() {
        let stated = |space| MeshRead { mesh: tetrahedron(), n_degenerate: 0, space, notes: vec![] };
        let read = |from, given| stated(from).in_space(given).map(|read| (read.mesh.vertices()[1].x, read.space));
        assert_eq!(read(Space::Unknown, Space::Lps), Ok((40.0, Space::Lps)));
        assert_eq!(read(Space::Unknown, Space::Ras), Ok((-40.0, Space::Ras)));
        // A surface that states its space is in LPS already.
        assert_eq!(
            (read(Space::Lps, Space::Lps), read(Space::Ras, Space::Ras)),
            (Ok((40.0, Space::Lps)), Ok((40.0, Space::Ras)))
        );
        assert_eq!(read(Space::Ras, Space::Lps), Err("the file states SPACE=RAS".to_owned()));
        assert_eq!(read(Space::Lps, Space::Unknown), Err("the file states SPACE=LPS".to_owned()));
    }

    #[test]
    fn a_binary_file_that_begins_with_solid_is_binary() {
        let mut bytes = binary();
        bytes[..24].copy_from_slice(b"solid made by a exporter");
        assert_eq!(corners(&read(&bytes).unwrap().mesh), corners(&tetrahedron()));
    }

    #[test]
    fn the_same_surface_is_read_from_every_format() {
        let mut ascii = String::from(" SOLID bone\r\n");
        for [a, b, c] in corners(&tetrahedron()) {
            ascii += "  facet normal 0 0 0\r\n    OUTER LOOP\r\n";
            for p in [a, b, c] {
                // 0 and -0 in turn, which are one place.
                ascii += &format!(
                    "      vertex {:e} {} {}\r\n",
                    p.x,
                    p.y,
                    if p.z == 0.0 { -p.x.signum() * 0.0 } else { p.z }
                );
            }
            ascii += "    endloop\r\n  endfacet\r\n";
        }
        ascii += "endsolid bone\r\n";
        assert!(ascii.contains(" -0\r"));
        let back = read(ascii.as_bytes()).unwrap();
        assert_eq!(corners(&back.mesh), corners(&tetrahedron()));
        assert_eq!(back.mesh.vertices().len(), 4);

        let text = "ply\nformat ascii 1.0\ncomment bone\nelement vertex 4\nproperty float x\nproperty float y\nproperty double z\n\
                    property uchar red\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n\
                    0 0 0 255\n40 0 0 255\n0 40. 0 255\n0 0 4e1 255\n\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n";
        assert_eq!(corners(&read(text.as_bytes()).unwrap().mesh), corners(&tetrahedron()));
        let crlf = text.replace('\n', "\r\n").replace("vertex_indices", "vertex_index");
        assert_eq!(corners(&read(crlf.as_bytes()).unwrap().mesh), corners(&tetrahedron()));

        for big in [false, true] {
            let order = if big { "big" } else { "little" };
            let mut bytes = format!(
                "ply\nformat binary_{order}_endian 1.0\nelement vertex 4\nproperty double z\nproperty float y\nproperty short x\n\
                 element face 4\nproperty uchar flag\nproperty list uint8 uint32 vertex_indices\nend_header\n"
            )
            .into_bytes();
            let put = |bytes: &mut Vec<u8>, little: &[u8]| {
                if big { bytes.extend(little.iter().rev()) } else { bytes.extend(little) }
            };
            for p in tetrahedron().vertices() {
                put(&mut bytes, &p.z.to_le_bytes());
                put(&mut bytes, &(p.y as f32).to_le_bytes());
                put(&mut bytes, &(p.x as i16).to_le_bytes());
            }
            for face in tetrahedron().faces() {
                bytes.extend([9, 3]);
                face.iter().for_each(|i| put(&mut bytes, &i.to_le_bytes()));
            }
            assert_eq!(corners(&read(&bytes).unwrap().mesh), corners(&tetrahedron()), "{order}");
        }
    }

    #[test]
    fn polygons_are_cut_into_fans_and_faces_without_area_are_counted() {
        let text = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n\
                    element face 4\nproperty list uchar int vertex_indices\nend_header\n\
                    0 0 0\n9 0 0\n9 9 0\n0 9 0\n4.5 0 0\n4 0 1 2 3\n3 0 1 1\n3 0 4 1\n2 0 1\n";
        let back = read(text.as_bytes()).unwrap();
        assert_eq!(back.mesh.faces(), [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(back.n_degenerate, 3, "a doubled corner, three on a line, two corners");
        assert_eq!(back.notes, ["3 of 5 faces have no area and were left out"]);
    }

    #[test]
    fn a_bone_in_metres_is_noticed_and_its_unit_can_be_given() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let small = tetrahedron().vertices().iter().map(|v| v / 1000.0).collect::<Vec<_>>();
        let small = Mesh::new("ct", SurfaceOrigin::User, small, tetrahedron().face_column().clone()).unwrap();
        write_stl(file.path(), &small).unwrap();
        let taken = read_mesh(file.path(), 1.0, "ct", SurfaceOrigin::User).unwrap();
        assert!(
            taken.notes[0].contains("spans 0.069 mm") && taken.notes[0].contains("unit_mm = 1000"),
            "{:?}",
            taken.notes
        );
        let read = read_mesh(file.path(), 1000.0, "ct", SurfaceOrigin::User).unwrap();
        assert_eq!(read.notes, [""; 0]);
        // 0.04 m in single precision is off by 1e-6 mm.
        assert!((read.mesh.corners(0)[1].y - 40.0).abs() < 1e-5);
    }

    #[test]
    fn files_that_are_no_surface_say_why() {
        let mut cut = binary();
        cut.truncate(200);
        assert!(
            error_message(&cut).contains("promises 4 triangles (284 bytes), but the file has 200 bytes"),
            "{}",
            error_message(&cut)
        );
        assert!(error_message(b"").contains("the file is empty"), "{}", error_message(b""));
        let mut nan = binary();
        nan[96..100].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(error_message(&nan).contains("vertex 0 is not finite"), "{}", error_message(&nan));
        let text = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1,5 0 0\n";
        assert!(
            error_message(text.as_bytes()).contains("line 5: \"1,5\" is not a number"),
            "{}",
            error_message(text.as_bytes())
        );
        let text = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nendloop\nendfacet\nendsolid\n";
        assert!(error_message(text.as_bytes()).contains("line 5: a facet has three corners, this one has 1"));
        let text =
            "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n";
        assert!(error_message(text.as_bytes()).contains("without \"endsolid\"; was it cut short?"));
        let points = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n";
        assert!(
            error_message(points.as_bytes()).contains("the file holds 1 points and no faces, but a surface is needed"),
            "{}",
            error_message(points.as_bytes())
        );
        let face = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
                    element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n3 0 1 2\n";
        assert!(
            error_message(face.as_bytes()).contains("face 0: it names vertex 1, but there are 1"),
            "{}",
            error_message(face.as_bytes())
        );
        let missing = read_mesh("no/such.stl".as_ref(), 1.0, "ct", SurfaceOrigin::User).unwrap_err().to_string();
        assert!(missing.starts_with("no/such.stl: cannot be read:"), "{missing}");
    }

    #[test]
    fn bytes_behind_the_last_triangle_are_noted() {
        let mut bytes = binary();
        bytes.extend([0; 7]);
        let back = read(&bytes).unwrap();
        assert_eq!(back.notes, ["7 bytes follow the last triangle, from byte 284 on, and were not read"]);
        bytes.resize(284 + 2 * FACE_BYTES, 0);
        let expected = "byte 284: 2 more triangles follow than the header counts";
        assert!(error_message(&bytes).contains(expected), "{}", error_message(&bytes));
    }

    #[test]
    fn an_ascii_facet_that_is_open_or_misplaced_is_refused_at_its_line() {
        let facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 9 0 0\nvertex 0 9 0\nendloop\nendfacet\n";
        let whole = format!("solid a\n{facet}endsolid a\n");
        assert!(read(whole.as_bytes()).is_ok());
        assert!(read(format!("{whole}solid b\n{facet}endsolid b\n").as_bytes()).is_ok(), "two solids");
        for (text, expected) in [
            (
                whole.replace("endloop\nendfacet\n", ""),
                "line 7: \"endsolid\" comes before the \"endfacet\" of the facet on line 2",
            ),
            (
                whole.replace("endfacet\nendsolid a\n", ""),
                "line 2: the facet has no \"endfacet\"; was the file cut short?",
            ),
            (
                whole.replace("endfacet\n", facet),
                "line 8: \"facet\" comes before the \"endfacet\" of the facet on line 2",
            ),
            (whole.replace("endloop\n", ""), "line 7: the loop of the facet on line 2 has no \"endloop\""),
            (whole.replace("vertex 0 9 0\n", ""), "line 6: a facet has three corners, this one has 2"),
            (format!("{whole}{facet}"), "line 10: \"facet normal 0 0 1\" is not within \"solid\" and \"endsolid\""),
            (whole.replace("endsolid a\n", ""), "the file ends without \"endsolid\""),
            (
                whole.replace("solid a\n", "solid a\nfacet normal 0 0 1\nendfacet\n"),
                "line 3: the facet on line 2 has no corners",
            ),
        ] {
            assert!(
                error_message(text.as_bytes()).contains(expected),
                "{expected}\n{}",
                error_message(text.as_bytes())
            );
        }
    }
}
