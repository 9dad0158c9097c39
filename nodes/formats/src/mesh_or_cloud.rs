//! Files that hold a surface or a cloud.

use crate::{
    FileError,
    cloud_file::{CloudFileRead, cloud_of_ply},
    cloud_text,
    mesh_file::{MeshRead, mesh_of_ply, mesh_of_stl, size_note},
    ply::Ply,
};
use osteoflow_geometry::{Frame, SurfaceOrigin};
use std::path::Path;

/// The content of a file.
#[derive(Debug, Clone, PartialEq)]
pub enum MeshOrCloud {
    /// Triangles.
    Mesh(MeshRead),
    /// Points, with notes on them, one sentence each.
    Cloud(CloudFileRead, Vec<String>),
}

/// Reads the bytes of an STL, PLY, XYZ or CSV file, recognised by its content; `path` is used in messages only.
///
/// A PLY with faces is a surface, one without is a cloud; so is a text of numbers, one point a line, with a heading that
/// names the columns or without. `unit_mm` is the file's unit in mm: 1000 for metres. `O(n)`.
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
    read_in(path, bytes, unit_mm, frame.into())
}

fn read_in(path: &Path, bytes: &[u8], unit_mm: f64, frame: Frame) -> Result<MeshOrCloud, FileError> {
    let read = if bytes.starts_with(b"ply") {
        let ply = Ply::parse(path, bytes)?;
        if ply.element("face").is_some_and(|face| face.count > 0) {
            return mesh_of_ply(path, &ply, unit_mm, frame, SurfaceOrigin::User).map(MeshOrCloud::Mesh);
        }
        cloud_of_ply(path, &ply, unit_mm, frame)?
    } else if let Some(text) = text_of_numbers(bytes) {
        cloud_text::parse(path, text, unit_mm, frame)?
    } else if is_pcd(bytes) {
        let message = "PCD is not read; write the points as PLY, or as text with x y z on each line";
        return Err(FileError::content(path, "byte 0", message));
    } else {
        return mesh_of_stl(path, bytes, unit_mm, frame, SurfaceOrigin::User).map(MeshOrCloud::Mesh);
    };
    let (n, of) = (read.n_dropped, read.n_points_in_file);
    let mut notes: Vec<_> =
        (n > 0).then(|| format!("{n} of {of} points are not finite and were left out")).into_iter().collect();
    notes.extend(read.notes.iter().cloned());
    notes.extend(size_note(read.cloud.points(), "points span"));
    Ok(MeshOrCloud::Cloud(read, notes))
}

fn is_pcd(bytes: &[u8]) -> bool {
    bytes.starts_with(b"# .PCD") || bytes.starts_with(b"VERSION ")
}

/// The whole as text, unless it is an STL, which may be text as well, or a PCD.
fn text_of_numbers(bytes: &[u8]) -> Option<&str> {
    let head = &bytes[..bytes.len().min(1024)];
    let start = bytes.trim_ascii_start();
    let is_stl = start.len() >= 5 && start[..5].eq_ignore_ascii_case(b"solid");
    let is_text = head.iter().all(|&b| b >= b' ' || b.is_ascii_whitespace());
    (is_text && !is_stl && !is_pcd(bytes) && !start.is_empty()).then(|| std::str::from_utf8(bytes).ok())?
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
    fn points_that_are_dropped_or_of_implausible_size_are_noted() {
        let MeshOrCloud::Cloud(_, notes) = read(b"0 0 0\n0.1 0.2 0\nnan 0 0\n").unwrap() else { panic!("no cloud") };
        let size = "the points span 0.224 mm, which is no size of a bone or phantom; is the file in metres? then give \
                    unit_mm = 1000";
        assert_eq!(notes, ["1 of 3 points are not finite and were left out", size]);
    }

    #[test]
    fn a_format_that_is_not_read_is_named() {
        let said = |bytes: &[u8]| read(bytes).unwrap_err().to_string();
        assert!(said(b"# .PCD v0.7\nVERSION 0.7\n").contains("PCD is not read"), "{}", said(b"# .PCD v0.7\n"));
        assert!(said(b"solid a\nvertex\n").contains("line 2: a vertex has three numbers"));
        assert!(said(b"v 1 2 3\nv 1 2 3\n").contains("no column is called \"x\""), "{}", said(b"v 1 2 3\n"));
        assert!(said(b"").contains("0 bytes are too few"), "{}", said(b""));
        assert!(said(&[0; 200]).contains("no triangles"), "{}", said(&[0; 200]));
    }
}
