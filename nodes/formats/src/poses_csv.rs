//! Poses over time as CSV, for those who track without a recorder.
//!
//! ```csv
//! t_ns,parent,child,x,y,z,qx,qy,qz,qw
//! 1750000010000000000,world,camera_marker,181.8,-101.4,1070.6,-0.1521,0.7584,0.4722,-0.4227
//! 1750000010050000000,world,camera_marker,,,,,,,
//! ```
//!
//! One row is `t_parent_child`: where `child` lies in `parent`, in **millimetres** (or the unit the reader is told), with
//! the quaternion's scalar last. `t_ns` is nanoseconds; 0 is for a pose that always holds. A row without numbers, or with
//! NaN or an all-zero quaternion, says that the marker was not seen. Columns may stand in any order; further ones are
//! ignored.

use crate::{
    FileError, LostPose,
    table::{Row, Table},
};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use osteoflow_geometry::{Frame, Pose};
use std::path::Path;

/// The columns, in the order in which they are written.
const COLUMNS: [&str; 10] = ["t_ns", "parent", "child", "x", "y", "z", "qx", "qy", "qz", "qw"];

/// Reads the rows of a poses file, in file order; a row in which the marker was not seen is a [`LostPose`].
///
/// `unit_mm` is the unit of x, y and z in mm: 1 for millimetres. Quaternions are normalised; one further than 1 % from
/// unit length is an error, since columns are then probably exchanged.
///
/// # Errors
/// [`FileError`], naming the line: a missing column, a word where a number should be, a quaternion that is none.
pub fn read_poses(path: &Path, unit_mm: f64) -> Result<Vec<Result<Pose, LostPose>>, FileError> {
    let bytes = std::fs::read(path).map_err(FileError::read(path))?;
    let table = Table::parse(path, &bytes)?;
    let mut columns = [0; COLUMNS.len()];
    for (column, name) in columns.iter_mut().zip(COLUMNS) {
        *column = table.column(name)?;
    }
    table.rows().map(|row| pose(&row, columns, unit_mm)).collect()
}

fn pose(row: &Row, columns: [usize; COLUMNS.len()], unit_mm: f64) -> Result<Result<Pose, LostPose>, FileError> {
    let [stamp, parent, child, numbers @ ..] = columns;
    let stamp_ns = row.whole(stamp)?;
    let (to, from): (Frame, Frame) = (row.named(parent)?.into(), row.named(child)?.into());
    let mut values = [0.0; 7];
    for (value, column) in values.iter_mut().zip(numbers) {
        *value = row.number(column)?;
    }
    let [x, y, z, qx, qy, qz, qw] = values;
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    let lost = |reason: &str| Ok(Err(LostPose { to: to.clone(), from: from.clone(), stamp_ns, reason: reason.into() }));
    if !values.iter().all(|v| v.is_finite()) {
        return lost("a row without finite numbers");
    }
    let norm = quaternion.norm();
    if norm == 0.0 {
        return lost("an all-zero quaternion");
    }
    if (norm - 1.0).abs() > 0.01 {
        return Err(
            row.fault(format!("the quaternion has length {norm:.3} instead of 1; are the columns qx,qy,qz,qw?"))
        );
    }
    let translation = Translation3::new(x * unit_mm, y * unit_mm, z * unit_mm);
    let isometry = Isometry3::from_parts(translation, UnitQuaternion::from_quaternion(quaternion));
    Ok(Ok(Pose::new(to, from, isometry).at(stamp_ns)))
}

/// Writes poses in mm, one row each, in their order.
///
/// # Errors
/// [`FileError::Io`] if the file cannot be written.
pub fn write_poses(path: &Path, poses: &[Pose]) -> Result<(), FileError> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let mut row = |cells: Vec<String>| writer.write_record(cells).expect("memory takes any record");
    row(COLUMNS.map(String::from).to_vec());
    for pose in poses {
        let (t, q) = (&pose.isometry.translation, &pose.isometry.rotation);
        let numbers = [t.x, t.y, t.z, q.i, q.j, q.k, q.w];
        let names = [pose.stamp_ns.to_string(), pose.to.to_string(), pose.from.to_string()];
        row(names.into_iter().chain(numbers.iter().map(f64::to_string)).collect());
    }
    let bytes = writer.into_inner().expect("memory is always flushed");
    std::fs::write(path, bytes).map_err(FileError::write(path))
}
