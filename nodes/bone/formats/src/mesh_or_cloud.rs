//! Files that hold a surface or a cloud.
//!
//! | Format | Taken |
//! |---|---|
//! | PLY | ASCII and both binary orders, any types and further properties |
//! | STL | binary and ASCII |
//! | PCD | ASCII, binary and compressed, any fields |
//! | OBJ | vertices, normals, faces with polygons and negative indices |
//! | VTK legacy | poly data, ASCII and binary, polygons and strips of both layouts |
//! | VTK XML | poly data of one piece, numbers as text, in base64 and appended, also compressed by zlib |
//! | OFF | also COFF, NOFF, CNOFF |
//! | text (XYZ, ASC, PTS, CSV) | any separator, decimal commas, headings |
//!
//! The format is recognised by the content, never by the name. Files of other kinds are refused by name, with what to
//! export instead.

pub use crate::shape::{CloudFileRead, MeshRead};

use crate::{
    FileError, Space, cloud_text,
    cursor::without_byte_order_mark,
    cut, input,
    kind::{TEXT, is_binary_stl},
    obj, off, pcd, ply,
    probe::{self, Kind},
    shape::{Shape, size_note},
    stl, vtk,
};
use osteoflow_geometry::{Cloud, Frame, SurfaceOrigin};
use std::path::Path;

/// The content of a file.
#[derive(Debug, Clone, PartialEq)]
pub enum MeshOrCloud {
    /// Triangles.
    Mesh(MeshRead),
    /// Points, with notes on them, one sentence each.
    Cloud(CloudFileRead, Vec<String>),
}

impl MeshOrCloud {
    /// What is suspicious, one sentence each.
    pub fn notes(&self) -> &[String] {
        match self {
            Self::Mesh(read) => &read.notes,
            Self::Cloud(_, notes) => notes,
        }
    }

    /// The axes that the file states; the coordinates are LPS if it states any.
    pub fn space(&self) -> Space {
        match self {
            Self::Mesh(read) => read.space,
            Self::Cloud(read, _) => read.space,
        }
    }

    /// The surface or the points, where `space` is that of a file that does not state one.
    ///
    /// # Errors
    /// A message, if the file states another.
    pub fn in_space(self, space: Space) -> Result<Self, String> {
        match self {
            Self::Mesh(read) => read.in_space(space).map(Self::Mesh),
            Self::Cloud(mut read, notes) => {
                if let Some(turn) = read.space.turn_to(space)? {
                    read.cloud = read.cloud.transformed(read.cloud.frame.clone(), &turn);
                }
                Ok(Self::Cloud(CloudFileRead { space, ..read }, notes))
            }
        }
    }

    /// The points, with the notes on them: those of a cloud, or the vertices of a surface, which is noted.
    pub fn into_cloud(self) -> (CloudFileRead, Vec<String>) {
        match self {
            Self::Cloud(read, notes) => (read, notes),
            Self::Mesh(MeshRead { mesh, space, mut notes, .. }) => {
                let cloud = Cloud::new(mesh.frame.clone(), mesh.vertex_column().clone());
                let cloud = cloud.expect("the vertices of a mesh are finite");
                notes.insert(0, "a surface; its vertices are taken as the points".into());
                let n_points_in_file = cloud.len();
                (CloudFileRead { cloud, n_points_in_file, n_dropped: 0, n_invalid: 0, space, notes: Vec::new() }, notes)
            }
        }
    }
}

/// The content of a file in its own unit.
fn shape_of(path: &Path, bytes: &[u8]) -> Result<Shape, FileError> {
    let probe = probe::of(path, bytes)?;
    let is_binary = is_binary_stl(bytes);
    let read = match probe.format {
        "PLY" => ply::shape,
        "STL" if is_binary => stl::binary,
        "STL" => stl::ascii,
        "VTK" | "VTK XML" => vtk::shape,
        "PCD" => pcd::shape,
        "OBJ" => obj::shape,
        "OFF" => off::shape,
        TEXT => cloud_text::shape,
        // A binary STL that was cut short has no other mark.
        _ if probe.kind == Kind::Unknown => stl::binary,
        _ => return Err(probe.refusal(path, "a surface or a cloud")),
    };
    // The 80 bytes that a binary STL begins with may hold anything.
    let bytes = if is_binary { bytes } else { without_byte_order_mark(bytes) };
    let mut shape = read(path, bytes)?;
    shape.notes.extend(cut::last_number(path, bytes)?);
    if probe.kind == Kind::Points {
        shape.notes.push("these are picked points, which are taken for a cloud".into());
    }
    Ok(shape)
}

/// Reads a surface from a file of any of [these formats](self).
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
    shape_of(path, &input::read(path)?)?.into_mesh(path, unit_mm, frame.into(), origin)
}

/// Reads points from a file of any of [these formats](self).
///
/// Of a surface the vertices are taken, with a note. `unit_mm` is the file's unit in mm: 1000 for metres. Points that are
/// not finite are left out and counted; if the file states RAS, the points are turned to LPS. `O(n)`.
///
/// # Errors
/// [`FileError`] if the file cannot be read, is of no such format or is cut short.
pub fn read_cloud(path: &Path, unit_mm: f64, frame: impl Into<Frame>) -> Result<CloudFileRead, FileError> {
    let mut shape = shape_of(path, &input::read(path)?)?;
    if let Some(faces) = &shape.faces {
        let message = format!("the file is a surface of {} faces; its vertices are taken as points", faces.len());
        shape.notes.push(message);
    }
    shape.into_cloud(path, unit_mm, frame.into())
}

/// Reads the bytes of a file of [these formats](self), recognised by its content; `path` is used in messages only.
///
/// A file with faces is a surface, one without is a cloud. `unit_mm` is the file's unit in mm: 1000 for metres. A file that
/// states `SPACE=RAS` is turned to LPS. `O(n)`.
///
/// # Errors
/// [`FileError`] if the file is of none of these formats, is cut short, or holds a surface with a coordinate that is not
/// finite; a cloud's points that are not finite are left out and counted.
pub fn read_mesh_or_cloud(
    path: &Path,
    bytes: &[u8],
    unit_mm: f64,
    frame: impl Into<Frame>,
) -> Result<MeshOrCloud, FileError> {
    let (shape, frame) = (shape_of(path, bytes)?, frame.into());
    if shape.faces.is_some() {
        return shape.into_mesh(path, unit_mm, frame, SurfaceOrigin::User).map(MeshOrCloud::Mesh);
    }
    let read = shape.into_cloud(path, unit_mm, frame)?;
    let (n, of) = (read.n_dropped, read.n_points_in_file);
    let mut notes: Vec<_> =
        (n > 0).then(|| format!("{n} of {of} points are not finite and were left out")).into_iter().collect();
    notes.extend(read.notes.iter().cloned());
    notes.extend(size_note(read.cloud.points(), "points span"));
    Ok(MeshOrCloud::Cloud(read, notes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn read(bytes: &[u8]) -> Result<MeshOrCloud, FileError> {
        read_mesh_or_cloud("a.file".as_ref(), bytes, 1.0, "ct")
    }

    fn ply(faces: &str) -> String {
        let head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n";
        format!("{head}{faces}end_header\n0 0 0\n40 0 0\n0 40 0\n")
    }

    #[test]
    fn a_ply_is_a_surface_where_it_has_faces_and_a_cloud_elsewhere() {
        let lists = |n| format!("element face {n}\nproperty list uchar int vertex_indices\n");
        let MeshOrCloud::Mesh(mesh) = read((ply(&lists(1)) + "3 0 1 2\n").as_bytes()).unwrap() else {
            panic!("no mesh")
        };
        assert_eq!(mesh.mesh.faces(), [[0, 1, 2]]);
        for text in [ply(""), ply(&lists(0)), "x,y,z\n0,0,0\n40,0,0\n0,40,0\n".into()] {
            let MeshOrCloud::Cloud(cloud, notes) = read(text.as_bytes()).unwrap() else { panic!("no cloud: {text}") };
            assert_eq!(cloud.cloud.points()[1], Point3::new(40.0, 0.0, 0.0));
            assert_eq!(notes, [""; 0]);
        }
    }

    #[test]
    fn a_stated_space_is_read_and_ras_is_turned_without_turning_the_faces_over() {
        let mut stl = vec![0; 80];
        stl[..25].copy_from_slice(b"3D Slicer output. SPACE=R");
        stl[25..27].copy_from_slice(b"AS");
        stl.extend(1_u32.to_le_bytes());
        let corners = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 40.0, 0.0, 0.0, 0.0, 40.0, 0.0_f32];
        stl.extend(corners.iter().flat_map(|c| c.to_le_bytes()));
        stl.extend([0; 2]);
        let faces = "element face 1\nproperty list uchar int vertex_indices\ncomment SPACE=RAS\n";
        let ply = ply(faces) + "3 0 1 2\n";
        let ascii = "solid SPACE=RAS\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 40 0 0\nvertex 0 40 0\nendloop\n\
                     endfacet\nendsolid\n";
        for bytes in [&stl[..], ply.as_bytes(), ascii.as_bytes()] {
            let MeshOrCloud::Mesh(found) = read(bytes).unwrap() else { panic!("no mesh") };
            assert_eq!(found.space, Space::Ras);
            assert_eq!(found.mesh.vertices()[1..], [Point3::new(-40.0, 0.0, 0.0), Point3::new(0.0, -40.0, 0.0)]);
            assert!(found.mesh.area_vector(0).z > 0.0);
            assert_eq!(found.notes, ["the file states SPACE=RAS; x and y were negated, which gives LPS"]);
        }
        let contradictory = ply.replace("comment", "comment SPACE=LPS\ncomment");
        let complaint = read(contradictory.as_bytes()).unwrap_err().to_string();
        assert!(complaint.contains("line 10: SPACE=RAS contradicts SPACE=LPS before it"), "{complaint}");
    }

    #[test]
    fn a_ply_with_more_than_its_header_counts_is_refused_or_noted() {
        let complaint = |text: String| read(text.as_bytes()).unwrap_err().to_string();
        let more = ply("") + "\n1 2 3\n";
        assert!(
            complaint(more.clone()).contains("line 12: more lines follow than the header counts"),
            "{}",
            complaint(more)
        );
        let twice = ply("element vertex 1\nproperty float x\n");
        assert!(
            complaint(twice.clone()).contains("line 7: the header names element \"vertex\" twice"),
            "{}",
            complaint(twice)
        );
        let twice = ply("property float x\n");
        assert!(
            complaint(twice.clone()).contains("line 7: element \"vertex\" has two properties \"x\""),
            "{}",
            complaint(twice)
        );
        let head = "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty double x\nproperty double y\n\
                    property double z\nproperty uchar red\nend_header\n";
        let mut bytes = head.as_bytes().to_vec();
        bytes.extend([40.0_f64, 1.0, 2.0].iter().flat_map(|c| c.to_le_bytes()));
        bytes.extend([7, 8, 9]);
        let MeshOrCloud::Cloud(found, _) = read(&bytes).unwrap() else { panic!("no cloud") };
        assert_eq!(found.notes, ["2 bytes follow the last element, from byte 162 on, and were not read"]);
        assert_eq!(&*found.cloud.extras()[0].1, [7.0]);
        bytes.resize(head.len() + 3 * 25, 0);
        let expected = "byte 162: 2 more elements \"vertex\" follow than the header counts";
        assert!(read(&bytes).unwrap_err().to_string().contains(expected), "{}", read(&bytes).unwrap_err());
        let twice = ply("").replace("format ascii 1.0\n", "format ascii 1.0\nformat binary_little_endian 1.0\n");
        assert!(
            complaint(twice.clone()).contains("line 3: the header has a second line \"format\""),
            "{}",
            complaint(twice)
        );
    }

    #[test]
    fn a_file_of_each_format_is_recognised_by_its_content() {
        let cloud = |text: &str| match read(text.as_bytes()).unwrap_or_else(|e| panic!("{e}\n{text}")) {
            MeshOrCloud::Cloud(read, _) => read.cloud.points().to_vec(),
            MeshOrCloud::Mesh(_) => panic!("a mesh: {text}"),
        };
        for text in [
            "# a comment\nv 0 0 0\nv 40 1 2\n",
            "# a comment\nOFF\n2 0 0\n0 0 0\n40 1 2\n",
            "# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\nPOINTS 2 float\n0 0 0 40 1 2\n",
            "# .PCD v0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2\nPOINTS 2\nDATA ascii\n0 0 0\n40 1 2\n",
            "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2\nDATA ascii\n0 0 0\n40 1 2\n",
            "# a comment\n0 0 0\n40 1 2\n",
        ] {
            assert_eq!(cloud(text), [Point3::origin(), Point3::new(40.0, 1.0, 2.0)], "{text}");
        }
        let complaint = |bytes: &[u8]| read(bytes).unwrap_err().to_string();
        assert!(complaint(b"1 2 3\r4 5 6\r").contains("lines end with CR alone"), "{}", complaint(b"1 2 3\r4 5 6\r"));
        assert!(complaint(b"OFF\n0 0 0\n").contains("there is no point in the file"), "{}", complaint(b"OFF\n0 0 0\n"));
        assert!(matches!(read(b"\xef\xbb\xbfv 1 2 3\n"), Ok(MeshOrCloud::Cloud(..))));
        // Comments may be in another encoding than UTF-8.
        let latin = b"# Gr\xf6\xdfe\n0 0 0\n40 1 2\n";
        assert!(matches!(read(latin), Ok(MeshOrCloud::Cloud(..))));
    }

    #[test]
    fn points_that_are_dropped_or_of_implausible_size_are_noted() {
        let MeshOrCloud::Cloud(_, notes) = read(b"0 0 0\n0.1 0.2 0\nnan 0 0\n").unwrap() else { panic!("no cloud") };
        let size = "the points span 0.224 mm, which is no size of a bone or phantom; is the file in metres? then give \
                    unit_mm = 1000";
        assert_eq!(notes, ["1 of 3 points are not finite and were left out", size]);
    }

    /// One point in each format, the last of them far away, and the place of that point.
    fn far_points() -> Vec<(&'static str, Vec<u8>, &'static str)> {
        let text = |text: &str| text.as_bytes().to_vec();
        let ply_head = |format: &str| {
            format!(
                "ply\nformat {format} 1.0\nelement vertex 2\nproperty double x\nproperty double y\nproperty double z\nend_header\n"
            )
        };
        let pcd_head =
            |data: &str| format!("VERSION 0.7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nWIDTH 2\nDATA {data}\n");
        let vtk_head =
            |data: &str| format!("# vtk DataFile Version 3.0\nt\n{data}\nDATASET POLYDATA\nPOINTS 2 double\n");
        let points = [1.0, 2.0, 3.0, 4.0, -1e45, 6.0];
        let little = |head: String| [head.as_bytes(), &points.map(f64::to_le_bytes).concat()].concat();
        let big = |head: String| [head.as_bytes(), &points.map(f64::to_be_bytes).concat()].concat();
        let vertex = |z: f32| [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 9.0, 0.0, 0.0, 0.0, 9.0, z];
        let mut stl = vec![0; 80];
        stl.extend(2_u32.to_le_bytes());
        for z in [0.0, -1e30] {
            stl.extend(vertex(z).iter().flat_map(|c: &f32| c.to_le_bytes()).chain([0, 0]));
        }
        vec![
            ("PLY", text(&(ply_head("ascii") + "1 2 3\n\n4 -1e45 6\n")), "line 10"),
            ("PLY", little(ply_head("binary_little_endian")), "byte"),
            ("PLY", big(ply_head("binary_big_endian")), "byte"),
            ("PCD", text(&(pcd_head("ascii") + "1 2 3\n# no\n4 -1e45 6\n")), "line 9"),
            ("PCD", little(pcd_head("binary")), "byte"),
            ("VTK", text(&(vtk_head("ASCII") + "1 2 3 4\n-1e45 6\n")), "line 6"),
            ("VTK", big(vtk_head("BINARY")), "byte"),
            ("OBJ", text("v 1 2 3\nvn 0 0 1\nv 4 -1e45 6\n"), "line 3"),
            ("OFF", text("OFF\n2 0 0\n1 2 3\n# no\n4 -1e45 6\n"), "line 5"),
            ("XYZ", text("# x y z\n1 2 3\n4 -1e45 6\n"), "line 3"),
            ("CSV", text("x;y;z\n1;2;3\n4;-1e45;6\n"), "line 3"),
            ("STL", stl, "byte 170"),
            (
                "STL",
                text(
                    "solid a\nfacet normal 0 0 1\nouter loop\nvertex 1 2 3\nvertex 4 -1e45 6\nvertex 0 9 0\nendloop\nendfacet\nendsolid\n",
                ),
                "line 5",
            ),
        ]
    }

    #[test]
    fn a_coordinate_beyond_ten_kilometres_is_refused_with_its_place_and_value_in_every_format() {
        for (format, bytes, place) in far_points() {
            // The last point is at the end.
            let place = if place == "byte" { format!("byte {}", bytes.len() - 24) } else { place.into() };
            let complaint = read(&bytes).unwrap_err().to_string();
            assert!(complaint.starts_with(&format!("a.file: {place}: the point (")), "{format}: {complaint}");
            assert!(complaint.contains("the coordinate -1"), "{format}: {complaint}");
            assert!(
                complaint.contains("e45 mm is farther") || complaint.contains("e30 mm is farther"),
                "{format}: {complaint}"
            );
        }
        // The limit is one of millimetres: a file in metres is scaled first.
        let complaint =
            read_mesh_or_cloud("a.xyz".as_ref(), b"1 2 3\n0 20000 0\n", 1000.0, "ct").unwrap_err().to_string();
        assert!(
            complaint
                .contains("line 2: the point (0.0, 20000.0, 0.0) in units of 1000 mm: the coordinate 20000000.0 mm"),
            "{complaint}"
        );
        assert!(read_mesh_or_cloud("a.xyz".as_ref(), b"1 2 3\n0 2e7 0\n", 0.001, "ct").is_ok());
        assert!(read(b"1 2 3\n0 1e7 0\n").is_ok(), "the limit itself");
    }

    #[test]
    fn a_unit_that_the_file_states_is_heeded() {
        let complaint = read(b"# 3D Slicer output. SPACE=LPS;UNIT=m\n0 0 0\n0.4 1 2\n").unwrap_err().to_string();
        assert!(
            complaint.contains("header: the file states UNIT=m, but is read in units of 1 mm; give unit_mm = 1000"),
            "{complaint}"
        );
    }

    #[test]
    fn a_format_that_is_not_read_is_named() {
        let complaint = |bytes: &[u8]| read(bytes).unwrap_err().to_string();
        let open = b"solid a\nfacet normal 0 0 1\nouter loop\nvertex\n";
        assert!(complaint(open).contains("line 4: a vertex has three numbers"), "{}", complaint(open));
        assert!(complaint(b"w 1 2 3\nw 1 2 3\n").contains("no column is called \"x\""), "{}", complaint(b"w 1 2 3\n"));
        assert!(complaint(b"").contains("byte 0: the file is empty"), "{}", complaint(b""));
        assert!(complaint(&[0; 200]).contains("no triangles"), "{}", complaint(&[0; 200]));
    }
}
