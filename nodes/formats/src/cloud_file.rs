//! Point clouds in PLY files.

use crate::{FileError, ply::Ply};
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::{Cloud, Frame};
use std::{fmt::Write as _, path::Path};

/// A cloud read from a file.
#[derive(Debug, Clone, PartialEq)]
pub struct CloudFileRead {
    /// The finite points, mm, without stamp and viewpoint, which the format does not hold.
    pub cloud: Cloud,
    /// How many points the file has.
    pub n_points_in_file: usize,
    /// How many of them were NaN or infinite and were left out.
    pub n_dropped: usize,
}

/// Reads the points of a PLY file: `x`, `y`, `z` of any type in any order, and `nx`, `ny`, `nz` where every kept point
/// has them; ASCII, little and big endian. `unit_mm` is the file's unit in mm: 1000 for metres. `O(n)`.
///
/// # Errors
/// [`FileError`] if the file cannot be read, is no PLY, is cut short or has no coordinates.
pub fn read_cloud_ply(path: &Path, unit_mm: f64, frame: impl Into<Frame>) -> Result<CloudFileRead, FileError> {
    let ply = Ply::read(path)?;
    let vertex = ply.element("vertex").ok_or_else(|| {
        FileError::content(path, "header", "there is no element \"vertex\"; a point cloud holds its points there")
    })?;
    let column = |name: &str| {
        vertex.scalars(name).ok_or_else(|| {
            let found = vertex.property_names();
            FileError::content(path, "header", format!("the points have no \"{name}\"; there are: {found}"))
        })
    };
    let [x, y, z] = [column("x")?, column("y")?, column("z")?];
    let normals = ["nx", "ny", "nz"].map(|name| vertex.scalars(name));
    let finite: Vec<usize> =
        (0..vertex.count).filter(|&k| x[k].is_finite() && y[k].is_finite() && z[k].is_finite()).collect();
    let points: Vec<Point3<f64>> = finite.iter().map(|&k| Point3::new(x[k], y[k], z[k]) * unit_mm).collect();
    let mut cloud = Cloud::new(frame, points)
        .map_err(|_| FileError::content(path, "points", format!("a coordinate overflows with unit_mm = {unit_mm}")))?;
    if let [Some(nx), Some(ny), Some(nz)] = normals {
        let unit = |&k: &usize| {
            let normal = Vector3::new(nx[k], ny[k], nz[k]);
            normal.try_normalize(1e-9).filter(|n| n.iter().all(|c| c.is_finite()))
        };
        if let Some(normals) = finite.iter().map(unit).collect::<Option<Vec<_>>>() {
            cloud = cloud.with_normals(normals).expect("each kept point has its normal");
        }
    }
    let n_dropped = vertex.count - finite.len();
    Ok(CloudFileRead { cloud, n_points_in_file: vertex.count, n_dropped })
}

/// Writes a cloud's points, and normals if it has them, as little-endian PLY in double precision, so that reading gives
/// the same bits back for `unit_mm` = 1; 1000 writes metres.
///
/// # Errors
/// [`FileError::Io`] if the file cannot be written.
pub fn write_ply(path: &Path, cloud: &Cloud, unit_mm: f64) -> Result<(), FileError> {
    let mut header = String::from("ply\nformat binary_little_endian 1.0\n");
    let mut line = |text: &str| writeln!(header, "{text}").expect("a string takes any text");
    line(&format!("comment osteoflow cloud, frame {}", cloud.frame.as_str().replace(['\n', '\r'], " ")));
    line(&format!("element vertex {}", cloud.len()));
    let normals = cloud.normals();
    for name in ["x", "y", "z", "nx", "ny", "nz"].iter().take(if normals.is_some() { 6 } else { 3 }) {
        line(&format!("property double {name}"));
    }
    line("end_header");
    let mut bytes = header.into_bytes();
    for (k, point) in cloud.points().iter().enumerate() {
        bytes.extend(point.iter().flat_map(|&c| (c / unit_mm).to_le_bytes()));
        if let Some(normals) = normals {
            bytes.extend(normals[k].iter().flat_map(|c| c.to_le_bytes()));
        }
    }
    std::fs::write(path, bytes).map_err(FileError::write(path))
}
