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

use crate::{FileError, LostPose};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use osteoflow_geometry::{Frame, Pose, StampNs};
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
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_reader(&bytes[..]);
    let csv_fault = |error: csv::Error| {
        let line = error.position().map_or(1, csv::Position::line);
        FileError::content(path, format!("line {line}"), error.to_string())
    };
    let header = reader.headers().map_err(csv_fault)?.clone();
    let column = |name: &str| {
        // Spreadsheets put a byte-order mark in front of the first name.
        header.iter().position(|h| h.trim_start_matches('\u{feff}') == name).ok_or_else(|| {
            let found = header.iter().collect::<Vec<_>>().join(",");
            let message = format!("the header has no \"{name}\": {} is expected, found {found}", COLUMNS.join(","));
            FileError::content(path, "line 1", message)
        })
    };
    let mut columns = [0; 10];
    for (index, name) in columns.iter_mut().zip(COLUMNS) {
        *index = column(name)?;
    }
    let mut poses = Vec::new();
    for record in reader.records() {
        let record = record.map_err(csv_fault)?;
        let line = record.position().map_or(0, csv::Position::line);
        let fault = |message: String| FileError::content(path, format!("line {line}"), message);
        let cell = |k: usize| record.get(columns[k]).unwrap_or_default();
        let frame = |k: usize| match cell(k) {
            "" => Err(fault(format!("\"{}\" is empty; name a frame such as world or bone_marker", COLUMNS[k]))),
            name => Ok(Frame::from(name)),
        };
        let stamp_ns: StampNs =
            cell(0).parse().map_err(|_| fault(format!("t_ns is \"{}\", whole nanoseconds are expected", cell(0))))?;
        let (to, from) = (frame(1)?, frame(2)?);
        let mut numbers = [f64::NAN; 7];
        for (k, number) in numbers.iter_mut().enumerate() {
            let text = cell(k + 3);
            if !text.is_empty() {
                *number = text
                    .parse()
                    .map_err(|_| fault(format!("{} is \"{text}\", a number is expected", COLUMNS[k + 3])))?;
            }
        }
        let [x, y, z, qx, qy, qz, qw] = numbers;
        let lost = |reason: &str| LostPose { to: to.clone(), from: from.clone(), stamp_ns, reason: reason.into() };
        let quaternion = Quaternion::new(qw, qx, qy, qz);
        if numbers.iter().any(|n| !n.is_finite()) {
            poses.push(Err(lost("a row without finite numbers")));
            continue;
        }
        if quaternion.norm() == 0.0 {
            poses.push(Err(lost("an all-zero quaternion")));
            continue;
        }
        if (quaternion.norm() - 1.0).abs() > 0.01 {
            let norm = quaternion.norm();
            return Err(fault(format!(
                "the quaternion has length {norm:.3} instead of 1; are the columns qx,qy,qz,qw?"
            )));
        }
        let rotation = UnitQuaternion::from_quaternion(quaternion);
        let isometry = Isometry3::from_parts(Translation3::new(x * unit_mm, y * unit_mm, z * unit_mm), rotation);
        poses.push(Ok(Pose::new(&to, &from, isometry).at(stamp_ns)));
    }
    Ok(poses)
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
