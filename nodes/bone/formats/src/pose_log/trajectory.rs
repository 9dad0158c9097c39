//! Trajectories of one moving frame: TUM, EuRoC MAV and KITTI odometry.
//!
//! # Source
//! The descriptions of the three data sets, and the readers of evo (`evo/tools/file_interface.py`).

use super::{Log, LogFormat, LogOptions, Sample, Turn, columns, stamp::nanoseconds};
use crate::{
    FileError,
    columns::{Heading, Row},
    cursor::{Cursor, is_text},
    input, poses_csv,
    scalar::number,
};
use nalgebra::{Matrix3, Quaternion, Vector3};
use osteoflow_geometry::{ROUNDED_ROTATION, StampNs};
use std::path::Path;

/// Number of lines that are looked at to recognise a format.
const N_LOOKED_AT: usize = 100;

/// The names of EuRoC's columns behind the stamp, without their units.
const EUROC: [&str; 7] = ["p_RS_R_x", "p_RS_R_y", "p_RS_R_z", "q_RS_w", "q_RS_x", "q_RS_y", "q_RS_z"];
/// The names of TUM's columns behind the stamp.
const TUM: [&str; 7] = ["tx", "ty", "tz", "qx", "qy", "qz", "qw"];

/// The format of a text; `is_whole` says whether `head` is all of the file, so that its last line is complete.
pub(super) fn format_of(head: &[u8], is_whole: bool) -> Option<LogFormat> {
    if !is_text(head) {
        return None;
    }
    let text = String::from_utf8_lossy(head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head));
    let all: Vec<&str> = text.lines().collect();
    let lines = &all[..all.len() - usize::from(!is_whole && !all.is_empty())];
    let mut lines = lines.iter().map(|line| line.trim()).filter(|line| !line.is_empty());
    let is_comment = |line: &&str| line.starts_with('#') || line.starts_with('%');
    let first = lines.clone().next()?;
    if poses_csv::is_heading(lines.clone().find(|line| !is_comment(line))?) {
        return Some(LogFormat::Poses);
    }
    if columns::is_ndi(first) {
        return Some(LogFormat::Ndi);
    }
    if is_euroc_heading(first) {
        return Some(LogFormat::Euroc);
    }
    if is_tum_heading(first) {
        return Some(LogFormat::Tum);
    }
    let rows: Vec<Vec<&str>> =
        lines.by_ref().filter(|line| !is_comment(line)).take(N_LOOKED_AT).map(|line| cells(line).collect()).collect();
    let numbers: Option<Vec<Vec<f64>>> = rows.iter().map(|row| row.iter().map(|cell| number(cell)).collect()).collect();
    let numbers = numbers.filter(|rows| !rows.is_empty())?;
    let has_width = |widths: std::ops::RangeInclusive<usize>| numbers.iter().all(|row| widths.contains(&row.len()));
    // A row without a rotation is that of a lost tool, but not every row.
    let are = |turn: &dyn Fn(&[f64]) -> Option<bool>| {
        let mut found = numbers.iter().filter_map(|row| turn(row)).peekable();
        found.peek().is_some() && found.all(|is_it| is_it)
    };
    let unit = |q: [f64; 4]| {
        let norm = q.iter().map(|c| c * c).sum::<f64>().sqrt();
        (norm.is_finite() && norm > 0.0).then_some((norm - 1.0).abs() <= ROUNDED_ROTATION)
    };
    let is_whole_ns = |row: &Vec<&str>| row[0].len() >= 16 && row[0].bytes().all(|b| b.is_ascii_digit());
    let has_commas = rows
        .iter()
        .zip(text.lines().filter(|line| !line.trim().is_empty() && !is_comment(&line.trim())))
        .all(|(_, line)| line.contains(','));
    if has_width(8..=64)
        && has_commas
        && rows.iter().all(is_whole_ns)
        && are(&|row| unit([row[4], row[5], row[6], row[7]]))
    {
        return Some(LogFormat::Euroc);
    }
    let is_in_order = numbers.windows(2).all(|pair| pair[0][0] <= pair[1][0]);
    if has_width(8..=8) && !has_commas && is_in_order && are(&|row| unit([row[4], row[5], row[6], row[7]])) {
        return Some(LogFormat::Tum);
    }
    let orthonormal = |row: &[f64]| {
        let m = Matrix3::new(row[0], row[1], row[2], row[4], row[5], row[6], row[8], row[9], row[10]);
        let off = (m.transpose() * m - Matrix3::identity()).amax();
        (off.is_finite() && m != Matrix3::zeros()).then_some(off <= 2.0 * ROUNDED_ROTATION)
    };
    (has_width(12..=12) && !has_commas && are(&orthonormal)).then_some(LogFormat::Kitti)
}

/// Whether a line is the heading of EuRoC's file of poses.
fn is_euroc_heading(line: &str) -> bool {
    line.trim_start_matches('#').trim_start().starts_with("timestamp")
        && EUROC[..3].iter().all(|name| line.contains(name))
}

/// Whether a line names TUM's columns, in any order and with any separator.
fn is_tum_heading(line: &str) -> bool {
    let line = line.trim_start_matches('#').trim_start();
    let names: Vec<&str> = cells(line).collect();
    line.starts_with("timestamp") && names.len() == 8 && TUM.iter().all(|name| names.contains(name))
}

/// The words of a line between commas, semicolons or blanks.
fn cells(line: &str) -> impl Iterator<Item = &str> {
    let separator = [',', ';'].into_iter().find(|&c| line.contains(c));
    let blanks = separator.is_none();
    line.split(move |c: char| separator == Some(c) || (blanks && c.is_whitespace()))
        .map(str::trim)
        .filter(move |cell| !blanks || !cell.is_empty())
}

/// Reads a trajectory.
pub(super) fn read(
    path: &Path,
    format: LogFormat,
    unit_mm: f64,
    options: &LogOptions,
    log: &mut Log,
) -> Result<(), FileError> {
    let bytes = input::read(path)?;
    let cursor = Cursor::text(path, &bytes)?;
    let (to, from) = match (&options.parent, &options.child) {
        (Some(parent), Some(child)) => (parent.as_str(), child.as_str()),
        _ => {
            let message =
                format!("{format} names no frames; give parent and child: each pose is that of child in parent");
            return Err(FileError::content(path, "frames", message));
        }
    };
    let (rows, names) = rows(cursor);
    let order = order(cursor, format, names.as_ref())?;
    let clock = Clock::of(path, format, options, rows.len())?;
    let width = if format == LogFormat::Kitti { 12 } else { 8 };
    for (k, (row, line)) in rows.iter().enumerate() {
        let fault = |message: String| cursor.fault_at(*line, message);
        let cells: Vec<&str> = cells(row).collect();
        // EuRoC's poses are followed by velocities and biases.
        if cells.len() < width || (cells.len() > width && format != LogFormat::Euroc) {
            let cut = if k + 1 == rows.len() { "; was the file cut short?" } else { "" };
            return Err(fault(format!("{width} numbers are expected in {format}, this line has {}{cut}", cells.len())));
        }
        let value = |place: usize| {
            let cell = cells[place];
            if cell.is_empty() {
                Ok(f64::NAN)
            } else {
                number(cell).ok_or_else(|| fault(format!("\"{cell}\" is not a number")))
            }
        };
        let mut v = [0.0; 12];
        // A stamp is read from its digits.
        let first = usize::from(format != LogFormat::Kitti);
        for (place, number) in v.iter_mut().enumerate().take(width).skip(first) {
            *number = value(place)?;
        }
        let stamp_ns = clock.stamp_ns(k, cells[0]).map_err(fault)?;
        let (translation, turn) = if format == LogFormat::Kitti {
            let [a, b, c, x, d, e, f, y, g, h, i, z] = v;
            (Vector3::new(x, y, z), Turn::Matrix(Matrix3::new(a, b, c, d, e, f, g, h, i)))
        } else {
            let [x, y, z, qx, qy, qz, qw] = order.map(|place| v[place]);
            (Vector3::new(x, y, z), Turn::Quaternion(Quaternion::new(qw, qx, qy, qz)))
        };
        let translation_mm = (translation * unit_mm).into();
        let sample = Sample { to: to.into(), from: from.into(), stamp_ns, translation_mm, turn };
        log.push(sample.pose().map_err(fault)?, || format!("line {line}"));
    }
    if !bytes.ends_with(b"\n") && !rows.is_empty() {
        log.notes.push("the last line has no end; was the file cut short?".into());
    }
    Ok(())
}

/// The lines with numbers, and the names in the heading or the last comment before them.
fn rows(mut cursor: Cursor<'_>) -> (Vec<Row<'_>>, Option<Heading>) {
    let (mut rows, mut names) = (Vec::new(), None);
    while let Some(line) = cursor.filled_line() {
        let text = line.trim();
        let comment = text.strip_prefix('#').or_else(|| text.strip_prefix('%'));
        let is_heading = rows.is_empty() && text.starts_with("timestamp");
        match comment.or(is_heading.then_some(text)) {
            // Other comments are no headings.
            Some(comment) if rows.is_empty() && comment.trim_start().starts_with("timestamp") => {
                let name = |cell: &str| cell.split(['[', '(']).next().unwrap_or_default().trim().to_owned();
                names = Some((cells(comment).map(name).collect(), cursor.line));
            }
            Some(_) => {}
            None => rows.push((line, cursor.line)),
        }
    }
    (rows, names)
}

/// The places of x, y, z, qx, qy, qz and qw. A heading with their names counts; without one the format has its order.
fn order(cursor: Cursor, format: LogFormat, names: Option<&Heading>) -> Result<[usize; 7], FileError> {
    let place_of = |wanted: &str| names.and_then(|(names, _)| names.iter().position(|name| name == wanted));
    match (format, names) {
        (LogFormat::Euroc, Some((_, line))) if place_of(EUROC[0]).is_some() => {
            let [x, y, z, w, i, j, k] = EUROC.map(place_of);
            let found = [x, y, z, i, j, k, w];
            if let Some(missing) = found.iter().position(Option::is_none) {
                let name = [EUROC[0], EUROC[1], EUROC[2], EUROC[4], EUROC[5], EUROC[6], EUROC[3]][missing];
                let message = format!(
                    "the heading has no column {name}, and a pose has a position and a rotation (q_RS_w, _x, _y, _z)"
                );
                return Err(cursor.fault_at(*line, message));
            }
            Ok(found.map(Option::unwrap_or_default))
        }
        (LogFormat::Euroc, _) => Ok([1, 2, 3, 5, 6, 7, 4]),
        (LogFormat::Tum, Some(_)) if TUM.iter().all(|name| place_of(name).is_some()) => {
            Ok(TUM.map(|name| place_of(name).unwrap_or_default()))
        }
        _ => Ok([1, 2, 3, 4, 5, 6, 7]),
    }
}

/// Where the stamps come from.
enum Clock {
    /// From the first cell, in units of `10^exponent` ns.
    Cell(i32),
    Rate(f64),
    Times(Vec<StampNs>),
}

impl Clock {
    fn of(path: &Path, format: LogFormat, options: &LogOptions, n_rows: usize) -> Result<Self, FileError> {
        match (format, &options.times, options.rate_hz) {
            (LogFormat::Euroc, ..) => Ok(Self::Cell(0)),
            (LogFormat::Kitti, Some(times), _) => {
                let text = input::read_text(times)?;
                let mut stamps = Vec::new();
                for (k, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
                    let fault = |message| FileError::content(times, format!("line {}", k + 1), message);
                    stamps.push(nanoseconds(line.trim(), 9).map_err(fault)?);
                }
                if stamps.len() != n_rows {
                    let message = format!("{} stamps for the {n_rows} poses of {}", stamps.len(), path.display());
                    return Err(FileError::content(times, "lines", message));
                }
                Ok(Self::Times(stamps))
            }
            (LogFormat::Kitti, None, Some(rate_hz)) => Ok(Self::Rate(rate_hz)),
            (LogFormat::Kitti, None, None) => {
                let message = "a KITTI trajectory has no stamps; give its rate in Hz (rate_hz, --rate), or its times.txt (times, --times)";
                Err(FileError::content(path, "stamps", message))
            }
            _ => Ok(Self::Cell(9)),
        }
    }

    fn stamp_ns(&self, k: usize, cell: &str) -> Result<StampNs, String> {
        match self {
            Self::Cell(0) if cell.contains(['.', 'e', 'E']) => Err(format!(
                "the stamp {cell} is no whole number; EuRoC's are nanoseconds; TUM's are seconds, between blanks"
            )),
            Self::Cell(exponent) => nanoseconds(cell, *exponent),
            Self::Rate(rate_hz) => Ok((k as f64 * 1e9 / rate_hz).round() as StampNs),
            Self::Times(stamps) => Ok(stamps[k]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose_log::{PoseLog, log_format, read_log};
    use std::path::PathBuf;

    fn options() -> LogOptions {
        LogOptions { parent: Some("world".into()), child: Some("body".into()), ..LogOptions::default() }
    }

    fn read_with(text: &str, options: &LogOptions) -> Result<PoseLog, FileError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        read_log(file.path(), options)
    }

    fn found(text: &str) -> Option<LogFormat> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        log_format(file.path()).unwrap()
    }

    /// Half a radian about z, at 1, 2, 3.
    fn check(log: &PoseLog, k: usize, stamp_ns: StampNs) {
        let pose = &log.poses[k].as_ref().unwrap().value;
        assert_eq!((pose.to.as_str(), pose.from.as_str(), pose.stamp_ns), ("world", "body", stamp_ns));
        assert!((pose.isometry.translation.vector - Vector3::new(1000.0, 2000.0, 3000.0)).norm() < 1e-9, "metres");
        assert!((pose.isometry.rotation.scaled_axis() - Vector3::z() * 0.5).norm() < 1e-5, "{pose:?}");
    }

    const TUM_ROW: &str = "1403636579.763555584 1 2 3 0 0 0.247404 0.968912";
    const EUROC_ROW: &str = "1403636579763555584,1,2,3,0.968912,0,0,0.247404";
    const KITTI_ROW: &str = "0.877583 -0.479426 0 1 0.479426 0.877583 0 2 0 0 1 3";

    #[test]
    fn one_pose_is_read_from_each_format_with_its_order_of_the_quaternion() {
        let ns = 1_403_636_579_763_555_584;
        let tum = format!("# timestamp tx ty tz qx qy qz qw\r\n{TUM_ROW}\r\n");
        let euroc = format!(
            "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []\n{EUROC_ROW},9,9,9\n"
        );
        // The heading counts.
        let other = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_x [], q_RS_y [], q_RS_z [], q_RS_w []\n\
                     1403636579763555584,1,2,3,0,0,0.247404,0.968912\n";
        let w_first = "# timestamp tx ty tz qw qx qy qz\n1403636579.763555584 1 2 3 0.968912 0 0 0.247404\n";
        for (text, format) in [
            (tum.as_str(), LogFormat::Tum),
            (&format!("{TUM_ROW}\n"), LogFormat::Tum),
            (w_first, LogFormat::Tum),
            (&w_first.replacen("# ", "", 1).replace(' ', ","), LogFormat::Tum),
            (&euroc, LogFormat::Euroc),
            (&format!("{EUROC_ROW}\n"), LogFormat::Euroc),
            (other, LogFormat::Euroc),
        ] {
            let log = read_with(text, &options()).unwrap_or_else(|error| panic!("{error}\n{text}"));
            assert_eq!((log.format, &log.notes[..]), (format, &[][..]), "{text}");
            check(&log, 0, ns);
        }
        let kitti = LogOptions { rate_hz: Some(10.0), ..options() };
        let log = read_with(&format!("{KITTI_ROW}\n{KITTI_ROW}\n"), &kitti).unwrap();
        assert_eq!(log.format, LogFormat::Kitti);
        check(&log, 0, 1);
        check(&log, 1, 100_000_000);
    }

    #[test]
    fn a_pose_that_is_not_finite_or_has_no_rotation_is_lost_and_order_and_end_are_told() {
        let text = format!(
            "{TUM_ROW}\n1403636580.1 nan nan nan nan nan nan nan\n1403636580.2 1 2 3 0 0 0 0\n1403636580.15 1 2 3 0 0 0 1"
        );
        let log = read_with(&text, &LogOptions { format: Some(LogFormat::Tum), ..options() }).unwrap();
        let reasons: Vec<_> =
            log.poses.iter().filter_map(|pose| pose.as_ref().err()).map(|lost| lost.reason.as_str()).collect();
        assert_eq!(reasons, ["a position that is not finite", "an all-zero quaternion"]);
        assert!(log.notes.iter().any(|note| note.starts_with("the last line has no end")), "{:?}", log.notes);
        assert!(
            log.notes.iter().any(|note| note.contains("stamps run backwards once, first at line 4")),
            "{:?}",
            log.notes
        );
    }

    #[test]
    fn what_a_trajectory_does_not_say_is_asked_for_and_what_is_no_pose_is_refused_with_its_line() {
        let (tum, kitti) = (format!("{TUM_ROW}\n"), format!("{KITTI_ROW}\n{KITTI_ROW}\n"));
        let of = |text: &str, format: LogFormat, options: &LogOptions| {
            read_with(text, &LogOptions { format: Some(format), ..options.clone() }).unwrap_err().to_string()
        };
        let unnamed = of(&tum, LogFormat::Tum, &LogOptions::default());
        assert!(unnamed.contains("a TUM trajectory names no frames; give parent and child"), "{unnamed}");
        let no_rate = of(&kitti, LogFormat::Kitti, &options());
        assert!(no_rate.contains("a KITTI trajectory has no stamps; give its rate in Hz"), "{no_rate}");
        let times = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(times.path(), "0.5\n1e-1\n2\n").unwrap();
        let timed = LogOptions { times: Some(PathBuf::from(times.path())), ..options() };
        assert!(of(&kitti, LogFormat::Kitti, &timed).contains("3 stamps for the 2 poses of "));
        let mirrored = KITTI_ROW.replace("0 0 1 3", "0 0 -1 3");
        let rate = LogOptions { rate_hz: Some(10.0), ..options() };
        for (text, format, options, expected) in [
            (format!("{KITTI_ROW}\n{mirrored}\n"), LogFormat::Kitti, &rate, "line 2: the matrix is a mirror image"),
            (
                KITTI_ROW.replace("0 0 1 3", "0 0 1"),
                LogFormat::Kitti,
                &rate,
                "line 1: 12 numbers are expected in a KITTI trajectory, this line has 11",
            ),
            (
                format!("{TUM_ROW}\n1403636580 1 2 3 0"),
                LogFormat::Tum,
                &rate,
                "line 2: 8 numbers are expected in a TUM trajectory, this line has 5; was the file cut short?",
            ),
            (TUM_ROW.replace("0.247404", "2.4"), LogFormat::Tum, &rate, "line 1: the quaternion has length 2.58"),
            (TUM_ROW.replace('.', ","), LogFormat::Tum, &rate, "line 1: "),
            (
                TUM_ROW.replacen("1403636579.763555584", "1403636579763555584", 1),
                LogFormat::Tum,
                &rate,
                "taken in seconds, is beyond the year 2262",
            ),
            (
                EUROC_ROW.replacen("1403636579763555584", "1403636579.76", 1),
                LogFormat::Euroc,
                &rate,
                "is no whole number; EuRoC's are nanoseconds",
            ),
            (
                "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m]\n1403636579763555584,1,2,3\n".into(),
                LogFormat::Euroc,
                &rate,
                "line 1: the heading has no column q_RS_x",
            ),
        ] {
            let error = of(&text, format, options);
            assert!(error.contains(expected), "{error}\n{expected}");
        }
        // Stamps in another unit are no tracker's.
        let fast: String = (0..9).map(|k| format!("{}.0 1 2 {k} 0 0 0 1\n", 1_403_636_579 + 1000 * k)).collect();
        let log = read_with(&fast, &options()).unwrap();
        assert!(log.notes[0].contains("its poses are 1.0e3 s apart, as of no tracker"), "{:?}", log.notes);
    }

    #[test]
    fn texts_of_points_are_no_trajectories() {
        for text in [
            "1 2 3\n4 5 6\n",
            "x y z\n1 2 3\n",
            "0 1 2 3 4 5 6 7\n8 9 1 2 3 4 5 6\n",
            "1 0 0 5\n0 1 0 6\n0 0 1 7\n0 0 0 1\n",
            "5 1 2 3 0 0 0 1\n4 1 2 3 0 0 0 1\n",
            "1 2 3 4 5 6 7 8 9 10 11 12\n",
            "ply\nformat ascii 1.0\n",
            "",
            "# only a comment\n",
        ] {
            assert_eq!(found(text), None, "{text}");
        }
        assert_eq!(found("t_ns,parent,child,x,y,z,qx,qy,qz,qw\n"), Some(LogFormat::Poses));
        // Clouds of twelve columns have no rotations in them.
        assert_eq!(found("1 2 3 0 0 1 0.5 0.5 0.5 7 8 9\n"), None);
    }
}
