//! Point clouds in files.

use crate::{FileError, Space, input, mesh_or_cloud::shape_of, ply, write};
use osteoflow_geometry::{Cloud, Frame};
use std::path::Path;

/// A cloud read from a file.
#[derive(Debug, Clone, PartialEq)]
pub struct CloudFileRead {
    /// The finite points, mm, without stamp and viewpoint, which the format does not hold.
    pub cloud: Cloud,
    /// How many points the file has.
    pub n_points_in_file: usize,
    /// How many of them were NaN or infinite and were left out.
    pub n_dropped: usize,
    /// The axes that the file states; `cloud` is LPS if it states any.
    pub space: Space,
    /// Changes to the content and what was left out, one sentence each.
    pub notes: Vec<String>,
}

/// Reads points from a file of any format of [`read_mesh_or_cloud`](crate::mesh_or_cloud::read_mesh_or_cloud).
///
/// Of a surface the vertices are taken, with a note. `unit_mm` is the file's unit in mm: 1000 for metres. Points that are
/// not finite are left out and counted; if the file states RAS, the points are turned to LPS. `O(n)`.
///
/// # Errors
/// [`FileError`] if the file cannot be read, is of no such format or is cut short.
pub fn read_cloud(path: &Path, unit_mm: f64, frame: impl Into<Frame>) -> Result<CloudFileRead, FileError> {
    let bytes = input::read(path)?;
    let mut shape = shape_of(path, &bytes)?;
    if let Some(faces) = &shape.faces {
        let message = format!("the file is a surface of {} faces; its vertices are taken as points", faces.len());
        shape.notes.push(message);
    }
    shape.into_cloud(path, unit_mm, frame.into())
}

/// Reads the points of a PLY file: `x`, `y`, `z` of any type in any order, and `nx`, `ny`, `nz` if every kept point
/// has them; ASCII, little and big endian. `unit_mm` is the file's unit in mm: 1000 for metres. `O(n)`.
///
/// # Errors
/// [`FileError`] if the file cannot be read, is no PLY, is cut short or has no coordinates.
pub fn read_cloud_ply(path: &Path, unit_mm: f64, frame: impl Into<Frame>) -> Result<CloudFileRead, FileError> {
    let bytes = input::read(path)?;
    ply::shape(path, &bytes)?.into_cloud(path, unit_mm, frame.into())
}

/// Writes a cloud's points, and its normals and further columns if it has them, as little-endian PLY in double precision, so
/// that reading gives the same bits back for `unit_mm` = 1; 1000 writes metres (of the points, not of further columns).
///
/// # Errors
/// [`FileError`] if the file cannot be written, or a further column has the name of a coordinate.
pub fn write_ply(path: &Path, cloud: &Cloud, unit_mm: f64) -> Result<(), FileError> {
    std::fs::write(path, write::cloud_ply(path, cloud, unit_mm, Space::Unknown, None)?).map_err(FileError::write(path))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};

    fn read(bytes: &[u8], unit_mm: f64) -> Result<CloudFileRead, FileError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        read_cloud_ply(file.path(), unit_mm, "camera")
    }

    #[test]
    fn a_cloud_survives_being_written_bit_for_bit() {
        let points = vec![Point3::new(1.0 / 3.0, -2e-9, 210.123456789), Point3::new(-0.0, 5e3, 1.0)];
        let normals = vec![Vector3::z(), Vector3::new(0.6, 0.0, -0.8)];
        let cloud = Cloud::new("camera", points).unwrap();
        for cloud in [cloud.clone(), cloud.with_normals(normals).unwrap()] {
            let file = tempfile::NamedTempFile::new().unwrap();
            write_ply(file.path(), &cloud, 1.0).unwrap();
            let back = read_cloud_ply(file.path(), 1.0, "camera").unwrap();
            assert_eq!((back.cloud, back.n_points_in_file, back.n_dropped), (cloud.clone(), 2, 0));
            write_ply(file.path(), &cloud, 1000.0).unwrap();
            let back = read_cloud_ply(file.path(), 1000.0, "camera").unwrap().cloud;
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
        let said = |text: String| read(text.as_bytes(), 1.0).unwrap_err().to_string();
        for (text, expected) in [
            ("plain text".into(), "line 1: a PLY file begins with the line \"ply\""),
            (
                header(2) + "0 0 0\n",
                "the header promises 2 elements \"vertex\" of at least 6 bytes, but 6 bytes are left",
            ),
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
            assert!(said(text.clone()).contains(expected), "{expected}\n{}", said(text));
        }
        let mut cut =
            b"ply\nformat binary_little_endian 1.0\nelement vertex 3000000000\nproperty double x\nend_header\n"
                .to_vec();
        cut.extend([0; 64]);
        let said = read(&cut, 1.0).unwrap_err().to_string();
        assert!(
            said.contains("promises 3000000000 elements \"vertex\" of at least 8 bytes, but 64 bytes are left"),
            "{said}"
        );
    }
}
