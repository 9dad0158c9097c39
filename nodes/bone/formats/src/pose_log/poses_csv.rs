//! Poses over time as CSV, for tracking without a recorder.
//!
//! ```csv
//! t_ns,parent,child,x,y,z,qx,qy,qz,qw
//! 1750000010000000000,world,camera_marker,181.8,-101.4,1070.6,-0.1521,0.7584,0.4722,-0.4227
//! 1750000010050000000,world,camera_marker,,,,,,,
//! ```
//!
//! One row is `t_parent_child`, the pose of `child` in `parent`, in **millimetres** (or the unit passed to the reader), with
//! the quaternion's scalar last. `t_ns` is nanoseconds; 0 is for a constant pose. A row without numbers, or with NaN or an
//! all-zero quaternion, means that the marker was not seen. Columns may be in any order; further ones are ignored.

use super::{Log, LogFormat, PoseLog, Sample, Turn};
use crate::{
    FileError, LostPose, cut, input,
    space::check_comments,
    table::{self, Row, Table},
};
use nalgebra::Quaternion;
use osteoflow_geometry::{Frame, Nearest, Pose};
use std::path::Path;

/// The columns, in the order in which they are written.
const COLUMNS: [&str; 10] = ["t_ns", "parent", "child", "x", "y", "z", "qx", "qy", "qz", "qw"];

/// Whether a line is the heading of a poses file.
pub(crate) fn is_heading(line: &str) -> bool {
    let names: Vec<&str> = line.split(table::separator(line)).map(str::trim).collect();
    COLUMNS.iter().all(|name| names.contains(name))
}

/// The rows of a poses file.
#[derive(Debug, Clone, PartialEq)]
pub struct PosesRead {
    /// The poses in file order, with notes and signs.
    pub log: PoseLog,
    /// The line of each row, counted from 1.
    pub lines: Vec<u64>,
}

/// Reads the rows of a poses file, in file order; a row in which the marker was not seen is a [`LostPose`].
///
/// `unit_mm` is the unit of x, y and z in mm: 1 for millimetres. A rounded quaternion gives the nearest rotation, with its
/// correction.
///
/// # Errors
/// [`FileError`], naming the line: a missing column, a word instead of a number, a quaternion whose length is farther
/// than [`ROUNDED_ROTATION`](osteoflow_geometry::ROUNDED_ROTATION) from 1.
pub fn read_poses(path: &Path, unit_mm: f64) -> Result<PosesRead, FileError> {
    let mut log = Log::default();
    let lines = read(path, unit_mm, &mut log)?;
    Ok(PosesRead { log: log.finish(LogFormat::Poses), lines })
}

/// Reads the rows into a log, and gives the line of each.
pub(crate) fn read(path: &Path, unit_mm: f64, log: &mut Log) -> Result<Vec<u64>, FileError> {
    let bytes = input::read(path)?;
    check_comments(path, &bytes, unit_mm)?;
    let table = Table::parse(path, &bytes)?;
    let mut columns = [0; COLUMNS.len()];
    for (column, name) in columns.iter_mut().zip(COLUMNS) {
        *column = table.column(name)?;
    }
    log.has_constants = true;
    let mut lines = Vec::new();
    for row in table.rows() {
        log.push(pose(&row, columns, unit_mm)?, || format!("line {}", row.line()));
        lines.push(row.line());
    }
    log.notes.extend(cut::last_number(path, &bytes)?);
    Ok(lines)
}

fn pose(
    row: &Row,
    columns: [usize; COLUMNS.len()],
    unit_mm: f64,
) -> Result<Result<Nearest<Pose>, LostPose>, FileError> {
    let [stamp, parent, child, numbers @ ..] = columns;
    let stamp_ns = row.whole(stamp).map_err(|fault| in_seconds(row, stamp).unwrap_or(fault))?;
    let (to, from): (Frame, Frame) = (row.named(parent)?.into(), row.named(child)?.into());
    let mut values = [0.0; 7];
    for (value, column) in values.iter_mut().zip(numbers) {
        *value = row.number(column)?;
    }
    let [x, y, z, qx, qy, qz, qw] = values;
    if !values.iter().all(|v| v.is_finite()) {
        return Ok(Err(LostPose { to, from, stamp_ns, reason: "a row without finite numbers".into() }));
    }
    let translation_mm = [x, y, z].map(|c| c * unit_mm);
    let turn = Turn::Quaternion(Quaternion::new(qw, qx, qy, qz));
    Sample { to, from, stamp_ns, translation_mm, turn }.pose().map_err(|message| row.fault(message))
}

/// The fault of a stamp with a fraction.
fn in_seconds(row: &Row, stamp: usize) -> Option<FileError> {
    let text = row.text(stamp);
    text.parse::<f64>().ok().filter(|s| s.is_finite() && s.abs() < 9e9)?;
    // By its digits: a float has too few for nanoseconds since 1970.
    let (whole, fraction) = text.split_once('.')?;
    let message = format!(
        "a whole number of nanoseconds is expected; likely cause: it is in seconds, then write {whole}{fraction:0<9.9}"
    );
    Some(row.fault(format!("t_ns is \"{text}\", {message}")))
}

/// Writes poses in mm, one row each, in their order.
///
/// # Errors
/// [`FileError::Io`] if the file cannot be written.
pub fn write_poses(path: &Path, poses: &[Pose]) -> Result<(), FileError> {
    write_rows(path, poses.iter().map(Ok))
}

/// As [`write_poses`]; a row in which the tool was not seen has no numbers.
///
/// # Errors
/// [`FileError::Io`] if the file cannot be written.
pub fn write_rows<'a>(
    path: &Path,
    poses: impl Iterator<Item = Result<&'a Pose, &'a LostPose>>,
) -> Result<(), FileError> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let mut row = |cells: Vec<String>| writer.write_record(cells).expect("memory takes any record");
    row(COLUMNS.map(String::from).to_vec());
    for pose in poses {
        let ((stamp_ns, to, from), numbers) = match pose {
            Ok(pose) => {
                let (t, q) = (&pose.isometry.translation, &pose.isometry.rotation);
                let numbers = [t.x, t.y, t.z, q.i, q.j, q.k, q.w].map(|number| number.to_string());
                ((pose.stamp_ns, &pose.to, &pose.from), numbers)
            }
            Err(lost) => ((lost.stamp_ns, &lost.to, &lost.from), Default::default()),
        };
        row([stamp_ns.to_string(), to.to_string(), from.to_string()].into_iter().chain(numbers).collect());
    }
    let bytes = writer.into_inner().expect("memory is always flushed");
    osteoflow_container::durable::write(path, bytes).map_err(FileError::write(path))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, Vector3};

    fn read(text: &str) -> Result<Vec<Result<Nearest<Pose>, LostPose>>, FileError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        read_poses(file.path(), 1.0).map(|read| read.log.poses)
    }

    #[test]
    fn semicolons_and_tabs_separate_and_commas_are_decimal_then() {
        let text = "t_ns;parent;child;x;y;z;qx;qy;qz;qw\n7;world;bone;1,5;-2,25;3;0;0;0,6;0,8\n";
        for text in [text.to_owned(), text.replace(';', "\t"), text.replace(',', ".")] {
            let pose = read(&text).unwrap().remove(0).unwrap().value;
            assert_eq!((pose.stamp_ns, pose.isometry.translation.vector), (7, Vector3::new(1.5, -2.25, 3.0)), "{text}");
            assert!((pose.isometry.rotation.k - 0.6).abs() < 1e-12, "{text}");
        }
    }

    #[test]
    fn poses_survive_being_written_bit_for_bit() {
        let pose = |k: i64| {
            let turn = Vector3::new(0.1, -0.7, 2.0) * k as f64;
            Pose::new("world", "bone, marker", Isometry3::new(Vector3::new(1.0 / 3.0, -2.0, 1e-7), turn)).at(k)
        };
        let poses: Vec<Pose> = (0..5).map(pose).collect();
        let file = tempfile::NamedTempFile::new().unwrap();
        write_poses(file.path(), &poses).unwrap();
        let back = read_poses(file.path(), 1.0).unwrap().log.poses.into_iter().map(|pose| pose.unwrap().value);
        let back: Vec<Pose> = back.collect();
        for (a, b) in back.iter().zip(&poses) {
            assert_eq!(
                (&a.to, &a.from, a.stamp_ns, a.isometry.translation),
                (&b.to, &b.from, b.stamp_ns, b.isometry.translation)
            );
            assert!(a.isometry.rotation.angle_to(&b.isometry.rotation) < 1e-12);
        }
        assert_eq!(back.len(), 5);
    }

    #[test]
    fn columns_may_be_in_any_order_and_lost_markers_are_named() {
        let text = "\u{feff}child,parent,qw,qx,qy,qz,x,y,z,t_ns,quality\n# a comment\nm, world ,1,0,0,0,1.5,2,3,10,good\n\n\
                    m,world,,,,,,,,20,lost\nm,world,0,0,0,0,1,2,3,30,lost\nm,world,nan,0,0,0,1,2,3,40,lost\n";
        let poses = read(text).unwrap();
        let expected = Pose::new("world", "m", Isometry3::translation(1.5, 2.0, 3.0)).at(10);
        assert_eq!(poses[0].as_ref().unwrap().value, expected);
        let lost: Vec<(i64, &str)> =
            poses[1..].iter().map(|p| p.as_ref().unwrap_err()).map(|l| (l.stamp_ns, l.reason.as_str())).collect();
        let empty = "a row without finite numbers";
        assert_eq!(lost, [(20, empty), (30, "an all-zero quaternion"), (40, empty)]);
    }

    #[test]
    fn a_quaternion_of_three_decimals_gives_the_nearest_rotation_with_its_correction() {
        let header = "t_ns,parent,child,x,y,z,qx,qy,qz,qw\n";
        let pose = read(&format!("{header}1,world,m,0,0,0,0.271,-0.653,0.271,0.653\n")).unwrap().remove(0).unwrap();
        assert!((pose.value.isometry.rotation.norm() - 1.0).abs() < 1e-15);
        assert!((pose.correction.deviation - 1.5e-4).abs() < 1e-4, "{:?}", pose.correction);
    }

    #[test]
    fn stamps_that_run_backwards_are_noted_with_their_line_for_each_marker() {
        let row = |t_ns: i64, child: &str| format!("{t_ns},world,{child},0,0,0,0,0,0,1\n");
        let header = "t_ns,parent,child,x,y,z,qx,qy,qz,qw\n";
        let text = format!("{header}{}{}{}{}", row(10, "a"), row(5, "b"), row(8, "a"), row(6, "b"));
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        let log = read_poses(file.path(), 1.0).unwrap().log;
        assert_eq!(log.signs.len(), 1, "{:?}", log.signs);
        let expected = "t_world_a: stamps run backwards once, first at line 4: 8 ns comes after 10 ns";
        assert!(log.signs[0].1.starts_with(expected), "{}", log.signs[0].1);
    }

    #[test]
    fn the_signs_of_other_logs_are_those_of_a_poses_file_and_constants_have_no_part_in_them() {
        let header = "t_ns,parent,child,x,y,z,qx,qy,qz,qw\n";
        let rows = |step_ns: usize| {
            let row = |k: usize| format!("{},world,bone,{},-80,1500,0,0,0,1\n", 1_750_000_000 + step_ns * k, 120 + k);
            (0..30).map(row).collect::<String>()
        };
        let constants =
            "0,phantom,marker,1,2,3,0,0,0,1\n0,phantom,marker,0,0,0,0,0,0,1\n0,phantom,marker,0,0,0,0,0,0,1\n";
        let read = |text: String| {
            let file = tempfile::NamedTempFile::new().unwrap();
            std::fs::write(file.path(), text).unwrap();
            read_poses(file.path(), 1.0).unwrap().log
        };
        let sound = read(format!("{header}{constants}{}", rows(50_000_000)));
        assert_eq!((&sound.signs[..], &sound.notes[..]), (&[][..], &[][..]));
        assert_eq!(sound.poses[0].as_ref().unwrap().value.stamp_ns, 0, "a constant stays one");
        let [(rule, sign)] = &read(format!("{header}{}", rows(50_000))).signs[..] else { panic!("microseconds") };
        assert!(*rule == "stamp_unit" && sign.starts_with("t_world_bone: its poses are 5.0e-5 s apart"), "{sign}");
        let two = rows(50_000_000)
            + &rows(50_000_000).replace(",bone,", ",/bone,")
            + &rows(50_000_000).replace(",bone,", ",Bone,");
        let two = read(format!("{header}{two}"));
        assert!(two.notes[0].contains("\"bone\" and \"/bone\" differ by the slash alone"), "{:?}", two.notes);
        assert!(two.signs.iter().any(|(rule, _)| *rule == "frame_names"), "{:?}", two.signs);
        assert!(two.poses[30..60].iter().all(|pose| pose.as_ref().unwrap().value.from.as_str() == "bone"));
    }

    #[test]
    fn a_fault_names_its_line() {
        let header = "t_ns,parent,child,x,y,z,qx,qy,qz,qw\n";
        let good = "1,world,m,0,0,0,0,0,0,1\n";
        for (text, expected) in [
            ("t_ns,parent,child,x,y,z,qx,qy,qz\n".into(), "line 1: the header has no column \"qw\"; it reads t_ns,"),
            (String::new(), "line 1: the header has no column \"t_ns\""),
            (
                format!("{header}{good}1.5,world,m,0,0,0,0,0,0,1\n"),
                "line 3: t_ns is \"1.5\", a whole number of nanoseconds is expected; likely cause: it is in seconds, then write 1500000000",
            ),
            (format!("{header}1750000001.000000,world,m,0,0,0,0,0,0,1\n"), "then write 1750000001000000000"),
            (format!("{header}{good}{good}1,world,m,0,0,up,0,0,0,1\n"), "line 4: z is \"up\", a number is expected"),
            (format!("{header}1,world,m,0,0,0,0,0,1\n"), "line 2: the header names 10 columns, this line has 9"),
            (
                format!("{header}{good}1,world,m,0,-1e45,0,0,0,0,1\n"),
                "line 3: the translation: the coordinate -1e45 mm is farther than 1e7 mm (10 km)",
            ),
            (format!("qw,{header}1,{good}"), "line 1: column 11 is called \"qw\" as one before it is"),
            (format!("{header}1,,m,0,0,0,0,0,0,1\n"), "line 2: column \"parent\" is empty"),
            (format!("{header}1,world,m,0,0,0,10,20,30,1\n"), "line 2: the quaternion has length 37.4"),
            (
                format!("{header}{good}1,world,m,0,0,0,0,0,0,1.0011\n"),
                "line 3: the quaternion has length 1.0011 instead of 1, off by 1.1e-3 where 1e-3 is allowed",
            ),
        ] {
            let message = read(&text).unwrap_err().to_string();
            assert!(message.contains(expected), "{expected}\n{message}");
        }
    }
}
