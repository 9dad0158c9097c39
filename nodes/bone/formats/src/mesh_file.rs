//! Triangle surfaces from STL and PLY files, and to STL.

use crate::{
    FileError, Space, input,
    mesh_or_cloud::{is_text, shape_of},
    shape::{Places, Shape},
    space::StatedSpace,
    write,
};
use nalgebra::{Isometry3, Point3, Translation3};
use osteoflow_geometry::{Frame, Mesh, SurfaceOrigin};
use std::{collections::HashMap, path::Path};

const STL_HEADER_BYTES: usize = 84;
const STL_FACE_BYTES: usize = 50;

/// A surface this small or this large (mm, the box's diagonal) is hardly a bone or a phantom: the unit is in doubt.
const PLAUSIBLE_MM: std::ops::Range<f64> = 3.0..3000.0;

/// A surface read from a file.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshRead {
    /// The surface, mm.
    pub mesh: Mesh,
    /// How many faces without an area were left out.
    pub n_degenerate: usize,
    /// The axes that the file states; `mesh` is LPS if it states any.
    pub space: Space,
    /// Suspicious properties of the file, one sentence each, such as a size that suggests metres.
    pub notes: Vec<String>,
}

impl MeshRead {
    /// The surface, where `space` is that of a file that does not state one.
    ///
    /// # Errors
    /// A message, if the file states another.
    pub fn in_space(mut self, space: Space) -> Result<Self, String> {
        match self.space {
            Space::Unknown => {
                if space == Space::Ras {
                    let turn = Isometry3::from_parts(Translation3::identity(), space.turn());
                    self.mesh = self.mesh.transformed(self.mesh.frame.clone(), &turn);
                }
                self.space = space;
                Ok(self)
            }
            stated if stated == space => Ok(self),
            stated => Err(format!("the file states SPACE={stated}")),
        }
    }
}

/// Reads a surface from a file of any format of [`read_mesh_or_cloud`](crate::mesh_or_cloud::read_mesh_or_cloud).
///
/// `unit_mm` is the file's unit in mm: 1 for millimetres, 1000 for metres. STL repeats the corners of each face; corners
/// with equal bits become one vertex. Polygons are cut into fans. Faces without an area are left out and counted. If the
/// file states RAS, the surface is turned to LPS. `O(n)`.
///
/// # Errors
/// [`FileError`] if the file cannot be read, is of no such format, is cut short, is a cloud, or holds no triangle or a
/// coordinate that is not finite.
pub fn read_mesh(
    path: &Path,
    unit_mm: f64,
    frame: impl Into<Frame>,
    origin: SurfaceOrigin,
) -> Result<MeshRead, FileError> {
    let bytes = input::read(path)?;
    shape_of(path, &bytes)?.into_mesh(path, unit_mm, frame.into(), origin)
}

/// The surface in the bytes of an STL file.
pub(crate) fn shape(path: &Path, bytes: &[u8]) -> Result<Shape, FileError> {
    let mut notes = Vec::new();
    let (Corners { vertices: points, places, is_text, .. }, faces) = stl_faces(path, bytes, &mut notes)?;
    let places = if is_text { Places::Lines(places) } else { Places::Bytes(places) };
    // The header of a binary file, or the first line of a text.
    let head = bytes[..bytes.len().min(80)].split(|&b| b == b'\n' || b == 0).next().unwrap_or_default();
    let stated = StatedSpace::of(&String::from_utf8_lossy(head))
        .map_err(|message| FileError::content(path, "header", message))?;
    Ok(Shape { points, faces: Some(faces), stated, notes, places, ..Shape::default() })
}

/// Writes a surface as binary STL, mm, in single precision; in frame `ct` it states LPS.
///
/// # Errors
/// [`FileError::Io`] if the file cannot be written.
pub fn write_stl(path: &Path, mesh: &Mesh) -> Result<(), FileError> {
    std::fs::write(path, write::stl(mesh, Space::of(&mesh.frame), None)).map_err(FileError::write(path))
}

type Faces = (Corners, Vec<[u32; 3]>);

/// A note on an implausible size; `what` names the surface or cloud.
pub(crate) fn size_note(points: &[Point3<f64>], what: &str) -> Option<String> {
    let (mut min, mut max) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for point in points {
        // Coordinates are finite: plain comparisons take a fifth of the time of `f64::min`, which minds NaN.
        for (k, &c) in point.iter().enumerate() {
            min[k] = if c < min[k] { c } else { min[k] };
            max[k] = if c > max[k] { c } else { max[k] };
        }
    }
    let span_mm = Some((Point3::from(max) - Point3::from(min)).norm()).filter(|_| !points.is_empty())?;
    let advice = match span_mm {
        s if PLAUSIBLE_MM.contains(&s) => return None,
        s if s < PLAUSIBLE_MM.start => "is the file in metres? then give unit_mm = 1000",
        _ => "is the file in micrometres? then give unit_mm = 0.001",
    };
    Some(format!("the {what} {span_mm:.3} mm, which is no size of a bone or phantom; {advice}"))
}

/// Whether the length is that of a binary STL with as many triangles as its header counts.
pub(crate) fn is_binary_stl(bytes: &[u8]) -> bool {
    let n = bytes.get(80..STL_HEADER_BYTES).map(|n| u32::from_le_bytes(n.try_into().expect("four bytes")));
    n.is_some_and(|n| n > 0 && STL_HEADER_BYTES as u64 + STL_FACE_BYTES as u64 * u64::from(n) == bytes.len() as u64)
}

fn stl_faces(path: &Path, bytes: &[u8], notes: &mut Vec<String>) -> Result<Faces, FileError> {
    let n_promised = bytes.get(80..84).map(|n| u32::from_le_bytes(n.try_into().expect("four bytes")));
    let n_expected = n_promised.map(|n| STL_HEADER_BYTES as u64 + STL_FACE_BYTES as u64 * u64::from(n));
    // The length decides, since many binary files begin with the word that should mark text.
    if n_expected == Some(bytes.len() as u64) {
        return Ok(binary_stl(&bytes[STL_HEADER_BYTES..]));
    }
    let start = bytes.trim_ascii_start();
    if start.len() >= 5 && start[..5].eq_ignore_ascii_case(b"solid") && is_text(bytes) {
        return ascii_stl(path, bytes);
    }
    match n_expected {
        None => {
            let message =
                format!("{} bytes are too few for a binary STL, and no other format is recognised", bytes.len());
            Err(FileError::content(path, "byte 0", message))
        }
        Some(expected) if (bytes.len() as u64) < expected => {
            let message = format!(
                "no known format, or cut short: read as a binary STL, the header promises {} triangles \
                 ({expected} bytes), but the file has {} bytes",
                n_promised.unwrap_or_default(),
                bytes.len()
            );
            Err(FileError::content(path, "byte 80", message))
        }
        Some(expected) => {
            let extra = bytes.len() as u64 - expected;
            if extra.is_multiple_of(STL_FACE_BYTES as u64) {
                let message = format!(
                    "the header promises {} triangles, but {} more follow; is the header another file's?",
                    n_promised.unwrap_or_default(),
                    extra / STL_FACE_BYTES as u64
                );
                return Err(FileError::content(path, format!("byte {expected}"), message));
            }
            notes.push(format!("{extra} bytes follow the last triangle, from byte {expected} on, and were not read"));
            Ok(binary_stl(&bytes[STL_HEADER_BYTES..expected as usize]))
        }
    }
}

/// Gives each place its number; places are equal when their bits are, with no difference between 0 and -0.
#[derive(Default)]
struct Corners {
    vertices: Vec<Point3<f64>>,
    /// The line or byte at which each vertex comes first.
    places: Vec<usize>,
    is_text: bool,
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

fn binary_stl(bytes: &[u8]) -> Faces {
    let mut corners = Corners::default();
    let faces = bytes.chunks_exact(STL_FACE_BYTES).enumerate().map(|(n, face)| {
        let at = STL_HEADER_BYTES + n * STL_FACE_BYTES;
        let float = |k: usize| f64::from(f32::from_le_bytes(face[4 * k..4 * k + 4].try_into().expect("four bytes")));
        // The normal comes first; it follows from the corners and is not read.
        [3, 6, 9].map(|k| corners.number([float(k), float(k + 1), float(k + 2)], at + 4 * k))
    });
    let faces = faces.collect();
    (corners, faces)
}

fn ascii_stl(path: &Path, bytes: &[u8]) -> Result<Faces, FileError> {
    let mut corners = Corners { is_text: true, ..Corners::default() };
    let (mut faces, mut open, mut closed) = (Vec::new(), Vec::new(), true);
    // The line of the facet that is open, and how many loops it has.
    let mut facet: Option<(usize, usize)> = None;
    for (k, line) in bytes.split(|&b| b == b'\n').enumerate() {
        let fault = |message: String| FileError::content(path, format!("line {}", k + 1), message);
        let text = String::from_utf8_lossy(line).to_ascii_lowercase();
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        if let (Some((line, _)), Some(word @ ("facet" | "endsolid" | "solid"))) = (facet, words.first().copied()) {
            return Err(fault(format!("\"{word}\" comes before the \"endfacet\" of the facet on line {line}")));
        }
        if closed && !matches!(words[..], [] | ["solid", ..]) {
            return Err(fault(format!("\"{}\" is not within \"solid\" and \"endsolid\"", text.trim())));
        }
        match words[..] {
            ["vertex", ..] if facet.is_none() => return Err(fault("a vertex is not within a facet".into())),
            ["vertex", x, y, z] => {
                let number = |word: &str| -> Result<f64, FileError> {
                    word.parse().map_err(|_| fault(format!("\"{word}\" is not a coordinate")))
                };
                open.push(corners.number([number(x)?, number(y)?, number(z)?], k + 1));
            }
            ["vertex", ..] => {
                return Err(fault(format!("a vertex has three numbers, this one has {}", words.len() - 1)));
            }
            ["endloop", ..] => match std::mem::take(&mut open)[..] {
                [a, b, c] => {
                    faces.push([a, b, c]);
                    facet = facet.map(|(line, n_loops)| (line, n_loops + 1));
                }
                ref other => return Err(fault(format!("a facet has three corners, this one has {}", other.len()))),
            },
            ["endfacet", ..] => match facet.take() {
                Some((_, 1)) if open.is_empty() => {}
                Some((_, 1..)) => return Err(fault("a facet has one loop of three corners, this one has more".into())),
                Some((line, 0)) if open.is_empty() => {
                    return Err(fault(format!("the facet on line {line} has no corners")));
                }
                Some((line, 0)) => {
                    return Err(fault(format!("the loop of the facet on line {line} has no \"endloop\"")));
                }
                None => return Err(fault("\"endfacet\" ends no facet".into())),
            },
            ["endsolid", ..] => closed = true,
            ["solid", ..] if closed => closed = false,
            ["solid", ..] => return Err(fault("\"solid\" comes before the \"endsolid\" of the one before".into())),
            ["facet", ..] => facet = Some((k + 1, 0)),
            [] | ["outer", ..] => {}
            _ => return Err(fault(format!("\"{}\" is no line of an ASCII STL", text.trim()))),
        }
    }
    if let Some((line, _)) = facet {
        let message = "the facet has no \"endfacet\"; was the file cut short?";
        return Err(FileError::content(path, format!("line {line}"), message));
    }
    if !closed {
        let place = format!("line {}", bytes.split(|&b| b == b'\n').count());
        return Err(FileError::content(path, place, "the file ends without \"endsolid\"; was it cut short?"));
    }
    Ok((corners, faces))
}

#[cfg(test)]
mod tests {
    use super::*;

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
            error_message(text.as_bytes()).contains("line 5: \"1,5\" is not a coordinate"),
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
        bytes.resize(284 + 2 * STL_FACE_BYTES, 0);
        let expected = "byte 284: the header promises 4 triangles, but 2 more follow";
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
