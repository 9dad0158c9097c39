//! Trajectories of one moving frame: TUM, EuRoC MAV and KITTI odometry.
//!
//! # Source
//! The descriptions of the three data sets, and the readers of evo (`evo/tools/file_interface.py`).

use super::{Log, LogFormat, LogOptions, Sample, Turn, motion_capture, ndi, poses_csv, stamp::nanoseconds};
use crate::{
    FileError,
    cloud_text::is_heading,
    columns::{Row, heading_names, place},
    cursor::Cursor,
    cut, input,
    scalar::number,
    space::is_same,
    unit::length_mm,
};
use nalgebra::{Matrix3, Quaternion, Vector3};
use osteoflow_geometry::{FARTHEST_MM, MM_PER_M, ROUNDED_ROTATION, StampNs};
use std::{borrow::Cow, path::Path};

/// Number of lines that are looked at to recognise a format.
const N_LOOKED_AT: usize = 100;

/// The names of EuRoC's columns behind the stamp, without their units.
const EUROC: [&str; 7] = ["p_RS_R_x", "p_RS_R_y", "p_RS_R_z", "q_RS_w", "q_RS_x", "q_RS_y", "q_RS_z"];
/// The columns of TUM, each by the names that programs give it, in small letters without units and underscores.
const TUM: [&[&str]; 8] = [
    &["timestamp", "time", "stamp", "t", "seconds", "secs", "sec"],
    &["tx", "x", "px", "posx", "positionx"],
    &["ty", "y", "py", "posy", "positiony"],
    &["tz", "z", "pz", "posz", "positionz"],
    &["qx", "quatx", "quaternionx", "orientationx"],
    &["qy", "quaty", "quaterniony", "orientationy"],
    &["qz", "quatz", "quaternionz", "orientationz"],
    &["qw", "quatw", "quaternionw", "orientationw"],
];

/// The format of a text; `is_whole` says whether `head` is all of the file, so that its last line is complete.
///
/// Nine rows of ten decide: a row that is none of the format is refused by its line, not the file by another format. Rows below a
/// heading of other names are a table, which has to be described, and points if these begin with x, y and z.
///
/// # Errors
/// A message, if there is no heading and the stamps are whole nanoseconds, but w may be the first or the last of the quaternion.
pub(super) fn format_of(head: &[u8], is_whole: bool) -> Result<Option<LogFormat>, String> {
    let text = String::from_utf8_lossy(head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head));
    let all: Vec<&str> = text.lines().collect();
    let lines = &all[..all.len() - usize::from(!is_whole && !all.is_empty())];
    let lines = lines.iter().map(|line| line.trim()).filter(|line| !line.is_empty());
    if lines.clone().find(|line| !is_comment(line)).is_some_and(poses_csv::is_heading) {
        return Ok(Some(LogFormat::Poses));
    }
    if lines.clone().take(ndi::N_HEAD_LINES).any(ndi::is_heading) {
        return Ok(Some(LogFormat::Ndi));
    }
    if motion_capture::is_it(&text) {
        return Ok(Some(LogFormat::MotionCapture));
    }
    let heads = lines.clone().take_while(|line| is_comment(line) || !begins_with_a_number(line));
    if let Some(format) = heads.clone().find_map(|line| Some(Names::of(line)?.format)) {
        return Ok(Some(format));
    }
    let heads = || heads.clone().map(|line| (heading_names(line.trim_start_matches(['#', '%', '/']).trim()), line));
    let is_of_poses = |names: &[String]| ["qx", "qy", "qz", "qw"].iter().all(|name| place(names, name).is_some());
    if heads().any(|(names, _)| is_heading(&names) && !is_of_poses(&names)) {
        return Ok(None);
    }
    let has_heading = heads().any(|(_, line)| !is_comment(line));
    let lines: Vec<&str> = lines.filter(|line| !is_comment(line)).take(N_LOOKED_AT).collect();
    let rows: Vec<Vec<Cow<str>>> = lines.iter().map(|line| cells(line)).collect();
    let number = |cell: &Cow<str>| if cell.is_empty() { Some(f64::NAN) } else { number(cell) };
    let numbers: Vec<Vec<f64>> =
        rows.iter().map(|row| row.iter().map(number).collect::<Option<_>>().unwrap_or_default()).collect();
    let most = |n: usize, of: usize| of > 0 && 10 * n >= 9 * of;
    let are = |width: &dyn Fn(usize) -> bool, turn: &dyn Fn(&[f64]) -> Option<bool>| {
        // A row without a rotation is that of a lost tool, but not every row.
        let found: Vec<Option<bool>> = numbers.iter().filter(|row| width(row.len())).map(|row| turn(row)).collect();
        let is_any = found.contains(&Some(true));
        is_any && most(found.iter().filter(|is_it| **is_it != Some(false)).count(), numbers.len())
    };
    let unit = |row: &[f64]| {
        let norm = row[4..8].iter().map(|c| c * c).sum::<f64>().sqrt();
        (norm.is_finite() && norm > 0.0).then_some((norm - 1.0).abs() <= ROUNDED_ROTATION)
    };
    let first: Vec<f64> = numbers.iter().filter_map(|row| row.first().copied()).collect();
    let n_in_order = first.windows(2).filter(|pair| pair[0] <= pair[1]).count();
    // No coordinate is as large as a stamp since 1970.
    let are_stamps = first.len() < 2 || most(n_in_order, first.len() - 1) || first.iter().all(|c| *c > FARTHEST_MM);
    let is_whole = |row: &&Vec<Cow<str>>| !row[0].is_empty() && row[0].bytes().all(|b| b.is_ascii_digit());
    if are_stamps && most(rows.iter().filter(is_whole).count(), rows.len()) && are(&|n| (8..=64).contains(&n), &unit) {
        let is_since_1970 = lines.iter().all(|line| line.contains([',', ';'])) && first.iter().all(|ns| *ns >= 1e15);
        // Stamps that many seconds apart are no tracker's.
        let step = first.last().map_or(0.0, |last| (last - first[0]) / (first.len() - 1).max(1) as f64);
        match () {
            () if has_heading => return Ok(Some(LogFormat::Table)),
            () if is_since_1970 => return Ok(Some(LogFormat::Euroc)),
            () if step >= LEAST_STEP_NS => return w_is_first(&numbers).map(|()| Some(LogFormat::Euroc)),
            () => {}
        }
    }
    if are_stamps && are(&|n| n == 8, &unit) {
        return Ok(Some(if has_heading { LogFormat::Table } else { LogFormat::Tum }));
    }
    let orthonormal = |row: &[f64]| {
        if row.len() == 16 && row[12..] != LAST_ROW {
            return Some(false);
        }
        let m = Matrix3::new(row[0], row[1], row[2], row[4], row[5], row[6], row[8], row[9], row[10]);
        let off = (m.transpose() * m - Matrix3::identity()).amax();
        (off.is_finite() && m != Matrix3::zeros()).then_some(off <= 2.0 * ROUNDED_ROTATION)
    };
    // One line of 16 numbers is a pose.
    if are(&|n| n == 12 || (n == 16 && numbers.len() > 1), &orthonormal) {
        return Ok(Some(LogFormat::Kitti));
    }
    // A text may name them, too, and has no rows of them.
    let has_rows = rows.iter().any(|row| row.len() >= 7 && row.iter().filter_map(number).count() >= 4);
    Ok((has_rows && heads().any(|(names, _)| is_of_poses(&names))).then_some(LogFormat::Table))
}

/// Stamps in whole numbers that are farther apart are no seconds; in nanoseconds they are a microsecond apart.
const LEAST_STEP_NS: f64 = 1000.0;

/// Checks that the first number of the quaternions is w: with it they are near the identity, and not with the last.
fn w_is_first(rows: &[Vec<f64>]) -> Result<(), String> {
    let rows: Vec<&Vec<f64>> =
        rows.iter().filter(|row| row.len() >= 8 && row[4..8].iter().all(|c| c.is_finite())).collect();
    let mean = |place: usize| rows.iter().map(|row| row[place].abs()).sum::<f64>() / rows.len() as f64;
    if mean(4) >= NEAR_IDENTITY && mean(7) < FAR_FROM_IDENTITY {
        return Ok(());
    }
    Err("these are poses with stamps in whole numbers, but whether w is the first number of the quaternion, as EuRoC has it, or the last, \
         nothing says; write a heading above them, as timestamp[ns],tx,ty,tz,qw,qx,qy,qz or timestamp[ns],tx,ty,tz,qx,qy,qz,qw; if these are \
         points, name the columns in a first line that begins with x,y,z"
        .to_owned())
}

/// Mean of |w| of rotations by less than 50 degrees.
const NEAR_IDENTITY: f64 = 0.9;
/// Mean of |w| of rotations by more than 120 degrees.
const FAR_FROM_IDENTITY: f64 = 0.5;

/// The last row of a 4 x 4 matrix, which some write behind KITTI's twelve numbers.
const LAST_ROW: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

fn is_comment(line: &str) -> bool {
    line.starts_with(['#', '%'])
}

fn begins_with_a_number(line: &str) -> bool {
    cells(line).first().is_some_and(|cell| number(cell).is_some())
}

/// The words of a line between semicolons, commas or blanks. Commas that do not separate are decimal, and become points.
fn cells(line: &str) -> Vec<Cow<'_, str>> {
    let blanks: Vec<&str> = line.split_whitespace().collect();
    let is_decimal = |word: &&str| {
        let (whole, fraction) = word.split_once(',').unwrap_or((word, "0"));
        [whole.trim_start_matches('-'), fraction]
            .iter()
            .all(|part| part.starts_with(|c: char| c.is_ascii_digit()) && !part.contains(','))
    };
    let of = |word: &'_ str| -> Cow<'_, str> { word.replace(',', ".").into() };
    if line.contains(';') {
        return line
            .split(';')
            .map(str::trim)
            .map(|word| if word.contains(',') { of(word).into_owned().into() } else { word.into() })
            .collect();
    }
    if line.contains(',') {
        if blanks.len() >= 8 && blanks.iter().all(is_decimal) {
            return blanks.into_iter().map(|word| of(word).into_owned().into()).collect();
        }
        return line.split(',').map(|word| word.trim().into()).collect();
    }
    blanks.into_iter().map(Cow::from).collect()
}

/// The columns that a heading names.
struct Names {
    format: LogFormat,
    /// The places of x, y, z, qx, qy, qz and qw; of EuRoC's the column that is missing.
    order: Result<[usize; 7], &'static str>,
    /// The units of the stamps and of x, if they are stated.
    units: [Option<String>; 2],
}

impl Names {
    /// The columns of a heading, a comment or not; none if it is none of a trajectory.
    fn of(line: &str) -> Option<Self> {
        let line = line.trim_start_matches(['#', '%']).trim();
        let mut names: Vec<(String, Option<String>)> = Vec::new();
        for cell in cells(line) {
            let (name, unit) = cell.split_once(['[', '(']).map_or((&*cell, None), |(name, unit)| (name, Some(unit)));
            let unit = unit.map(|unit| unit.trim_end_matches([']', ')']).trim().to_owned());
            match names.last_mut() {
                // A unit behind a blank.
                Some((_, last)) if name.is_empty() && !line.contains([',', ';']) => *last = unit,
                _ => names.push((name.trim().to_owned(), unit)),
            }
        }
        let unit = |place: usize| names.get(place).and_then(|(_, unit)| unit.clone());
        let place = |wanted: &str| names.iter().position(|(name, _)| name == wanted);
        if names.first().is_some_and(|(name, _)| name == "timestamp")
            && EUROC[..3].iter().all(|name| place(name).is_some())
        {
            let order = ["p_RS_R_x", "p_RS_R_y", "p_RS_R_z", "q_RS_x", "q_RS_y", "q_RS_z", "q_RS_w"]
                .map(|name| place(name).ok_or(name));
            let missing = order.iter().find_map(|place| place.err());
            let order = missing.map_or_else(|| Ok(order.map(Result::unwrap_or_default)), Err);
            return Some(Self { format: LogFormat::Euroc, order, units: [unit(0), unit(1)] });
        }
        let plain = |name: &str| name.to_lowercase().replace(['_', '-', '.'], "");
        let places = TUM.map(|known| names.iter().position(|(name, _)| known.contains(&plain(name).as_str())));
        let [Some(0), Some(x), Some(y), Some(z), Some(i), Some(j), Some(k), Some(w)] = places else { return None };
        let is_tum = names.len() == 8;
        is_tum.then(|| Self { format: LogFormat::Tum, order: Ok([x, y, z, i, j, k, w]), units: [unit(0), unit(x)] })
    }
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
    let (rows, names) = rows(cursor, format);
    let order = match &names {
        None if format == LogFormat::Euroc => [1, 2, 3, 5, 6, 7, 4],
        None => [1, 2, 3, 4, 5, 6, 7],
        Some((names, line)) => {
            let fault = |message| cursor.fault_at(*line, message);
            check_unit(names.units[1].as_deref(), unit_mm).map_err(fault)?;
            names.order.map_err(|missing| {
                fault(format!(
                    "the heading has no column {missing}, and a pose has a position and a rotation (q_RS_w, _x, _y, _z)"
                ))
            })?
        }
    };
    if format == LogFormat::Euroc && names.is_none() && !rows.iter().all(|(row, _)| row.find([',', ';']) >= Some(16)) {
        log.notes.push(
            "there is no heading: the stamps, whole numbers too far apart for seconds, are taken for nanoseconds, and the first number of \
             the quaternion for w, as EuRoC has them, since the rotations are small so"
                .into(),
        );
    }
    let stated = names.as_ref().and_then(|(names, _)| names.units[0].as_deref());
    let clock = Clock::of(path, format, options, rows.len(), stated)?;
    for (k, (row, line)) in rows.iter().enumerate() {
        let fault = |message: String| cursor.fault_at(*line, message);
        let cells = cells(row);
        let width = match format {
            LogFormat::Kitti if cells.len() == 16 => 16,
            LogFormat::Kitti => 12,
            _ => order.into_iter().fold(8, |width, place| width.max(place + 1)),
        };
        // EuRoC's poses are followed by velocities and biases.
        if cells.len() < width || (cells.len() > width && format != LogFormat::Euroc) {
            let cut = if k + 1 == rows.len() { "; was the file cut short?" } else { "" };
            return Err(fault(format!("{width} numbers are expected in {format}, this line has {}{cut}", cells.len())));
        }
        let value = |place: usize| {
            let cell = &cells[place];
            if cell.is_empty() {
                Ok(f64::NAN)
            } else {
                number(cell).ok_or_else(|| fault(format!("\"{cell}\" is not a number")))
            }
        };
        let stamp_ns = clock.stamp_ns(k, &cells[0]).map_err(fault)?;
        let (translation, turn) = if format == LogFormat::Kitti {
            let mut v = [0.0; 16];
            v.iter_mut().enumerate().take(width).try_for_each(|(place, number)| value(place).map(|v| *number = v))?;
            let [a, b, c, x, d, e, f, y, g, h, i, z, last @ ..] = v;
            if width == 16 && last != LAST_ROW {
                return Err(fault("a 4 x 4 matrix row by row ends with 0 0 0 1".into()));
            }
            (Vector3::new(x, y, z), Turn::Matrix(Matrix3::new(a, b, c, d, e, f, g, h, i)))
        } else {
            let mut v = [0.0; 7];
            v.iter_mut().zip(order).try_for_each(|(number, place)| value(place).map(|v| *number = v))?;
            let [x, y, z, qx, qy, qz, qw] = v;
            (Vector3::new(x, y, z), Turn::Quaternion(Quaternion::new(qw, qx, qy, qz)))
        };
        let translation_mm = (translation * unit_mm).into();
        let sample = Sample { to: to.into(), from: from.into(), stamp_ns, translation_mm, turn };
        log.push(sample.pose().map_err(fault)?, || format!("line {line}"));
    }
    log.notes.extend(cut::last_number(path, &bytes)?);
    Ok(())
}

/// Refuses a unit of length in a heading that is another than the one that is read.
fn check_unit(stated: Option<&str>, unit_mm: f64) -> Result<(), String> {
    let Some((name, stated_mm)) = stated.and_then(|name| Some((name, length_mm(name)?))) else { return Ok(()) };
    if is_same(stated_mm, unit_mm) {
        return Ok(());
    }
    Err(format!(
        "the heading says that positions are in {name}, and {unit_mm} mm are taken for one; give unit_mm = {stated_mm} (--scale {})",
        stated_mm / MM_PER_M
    ))
}

/// The lines with numbers, and the last heading before them.
fn rows(mut cursor: Cursor<'_>, format: LogFormat) -> (Vec<Row<'_>>, Option<(Names, usize)>) {
    let (mut rows, mut names) = (Vec::new(), None);
    while let Some(line) = cursor.filled_line() {
        let text = line.trim();
        let heading = rows.is_empty().then(|| Names::of(text)).flatten().filter(|names| names.format == format);
        if let Some(heading) = heading {
            names = Some((heading, cursor.line));
        } else if !is_comment(text) {
            rows.push((line, cursor.line));
        }
    }
    (rows, names)
}

/// Where the stamps come from.
enum Clock {
    /// From the first cell, whole nanoseconds.
    Whole,
    /// From the first cell, in units of `10^exponent` ns.
    Cell(i32),
    Rate(f64),
    Times(Vec<StampNs>),
}

impl Clock {
    fn of(
        path: &Path,
        format: LogFormat,
        options: &LogOptions,
        n_rows: usize,
        stated: Option<&str>,
    ) -> Result<Self, FileError> {
        match (format, &options.times, options.rate_hz) {
            (LogFormat::Euroc, ..) => Ok(Self::Whole),
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
            _ => Ok(Self::Cell(match stated {
                Some("ns") => 0,
                Some("us" | "µs") => 3,
                Some("ms") => 6,
                _ => 9,
            })),
        }
    }

    fn stamp_ns(&self, k: usize, cell: &str) -> Result<StampNs, String> {
        match self {
            Self::Whole if cell.contains(['.', 'e', 'E']) => Err(format!(
                "the stamp {cell} is no whole number; EuRoC's are nanoseconds; TUM's are seconds, between blanks"
            )),
            Self::Whole => nanoseconds(cell, 0),
            Self::Cell(exponent) => nanoseconds(cell, *exponent),
            Self::Rate(rate_hz) => Ok((k as f64 * 1e9 / rate_hz).round() as StampNs),
            Self::Times(stamps) => Ok(stamps[k]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose_log::{PoseLog, read_log};
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
        format_of(text.as_bytes(), true).unwrap()
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
        // Of a heading with other columns first the named ones count, however far to the right.
        let v = ",v [m]".repeat(20);
        let far =
            format!("#timestamp{v}, p_RS_R_x, p_RS_R_y, p_RS_R_z, q_RS_x, q_RS_y, q_RS_z, q_RS_w\n1403636579763555584");
        let nines = ",9".repeat(20);
        let log = read_with(&format!("{far}{nines},1,2,3,0,0,0.247404,0.968912\n"), &options()).unwrap();
        check(&log, 0, ns);
        let error = read_with(&format!("{far}{nines},1,2,3\n"), &options()).unwrap_err().to_string();
        assert!(error.contains("28 numbers are expected in a EuRoC trajectory, this line has 24"), "{error}");
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
        let (rule, sign) = &log.signs[0];
        assert!(*rule == "stamp_order" && sign.contains("stamps run backwards once, first at line 4"), "{sign}");
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
        let slow: String = (0..9).map(|k| format!("{}.0 1 2 0.0{k} 0 0 0 1\n", 1_403_636_579 + 50 * k)).collect();
        let signs = read_with(&slow, &options()).unwrap().signs;
        assert!(signs[0].1.contains("its poses are 50.0 s apart, and 50.0 ms, as of a tracker, if"), "{signs:?}");
    }

    /// What people make of a TUM trajectory: each is read with the same pose.
    #[test]
    fn other_separators_headings_and_decimal_commas_give_the_same_pose() {
        let ns = 1_403_636_579_763_555_584;
        let rows = |text: &str| format!("{text}\n{text}\n");
        let comma = TUM_ROW.replace(' ', ",");
        let semicolons = TUM_ROW.replace(' ', ";").replace('.', ",");
        let w_first = "1403636579.763555584 1 2 3 0.968912 0 0 0.247404";
        for (text, format) in [
            (rows(&comma), LogFormat::Tum),
            (rows(&TUM_ROW.replace(' ', ", ")), LogFormat::Tum),
            (rows(&TUM_ROW.replace(' ', "\t")), LogFormat::Tum),
            (rows(&TUM_ROW.replace('.', ",")), LogFormat::Tum),
            (rows(&semicolons), LogFormat::Tum),
            (format!("timestamp;tx;ty;tz;qx;qy;qz;qw\n{semicolons}\n"), LogFormat::Tum),
            (format!("# time x y z qw qx qy qz\n{w_first}\n"), LogFormat::Tum),
            (
                format!("# seen by a camera\n# timestamp [s] x [m] y [m] z [m] q_w q_x q_y q_z\n{w_first}\n"),
                LogFormat::Tum,
            ),
            (format!("t,x,y,z,qw,qx,qy,qz\n{}\n", w_first.replace(' ', ",")), LogFormat::Tum),
            (format!("time(s) tx ty tz qw qx qy qz\n{w_first}\n"), LogFormat::Tum),
            (format!("time[ns],tx,ty,tz,qx,qy,qz,qw\n{}\n", comma.replacen('.', "", 1)), LogFormat::Tum),
            (rows(&EUROC_ROW.replace(',', ";").replace('.', ",")), LogFormat::Euroc),
        ] {
            let log = read_with(&text, &options()).unwrap_or_else(|error| panic!("{error}\n{text}"));
            assert_eq!(log.format, format, "{text}");
            check(&log, 0, ns);
        }
        let kitti = LogOptions { rate_hz: Some(10.0), ..options() };
        for text in [rows(&KITTI_ROW.replace(' ', ",")), rows(&format!("{KITTI_ROW} 0 0 0 1"))] {
            let log = read_with(&text, &kitti).unwrap_or_else(|error| panic!("{error}\n{text}"));
            assert_eq!(log.format, LogFormat::Kitti, "{text}");
            check(&log, 1, 100_000_000);
        }
    }

    /// Of many rows one that is wrong is refused by its line, and the file is not taken for points.
    #[test]
    fn a_wrong_row_among_many_is_refused_as_a_row_of_its_format() {
        let row = |k: usize| TUM_ROW.replacen("579", &format!("{}", 580 + k), 1);
        let with = |wrong: &str| {
            (0..20).map(|k| if k == 19 { format!("{wrong}\n") } else { row(k) + "\n" }).collect::<String>()
        };
        for (wrong, expected) in [
            (TUM_ROW.replace("0.247404", "2.4"), "line 20: the quaternion has length 2.58"),
            (
                "1403636599 1 2 3 0".into(),
                "line 20: 8 numbers are expected in a TUM trajectory, this line has 5; was the file cut short?",
            ),
            ("done".into(), "line 20: 8 numbers are expected in a TUM trajectory, this line has 1"),
        ] {
            let error = read_with(&with(&wrong), &options()).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}\n{expected}");
        }
        // The second half before the first, as of two files that were put together.
        let halves: String = (0..20).map(|k| row((k + 10) % 20) + "\n").collect();
        let log = read_with(&halves, &options()).unwrap();
        assert!(log.signs[0].1.contains("stamps run backwards once, first at line 11"), "{:?}", log.signs);
        let error = read_with("# timestamp tx ty tz qx qy qz qw\n", &options()).unwrap_err().to_string();
        assert!(error.contains("there is no pose in the file; was it cut short?"), "{error}");
        for (text, expected) in [
            ("", "the file is empty"),
            ("PK\u{3}\u{4} and more", "ZIP archive is not read"),
            ("1 2 3\r4 5 6\r", "lines end with CR alone"),
        ] {
            let error = read_with(text, &options()).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}\n{expected}");
        }
        let kitti = LogOptions { rate_hz: Some(10.0), ..options() };
        let rows = |last: &str| {
            (0..20).map(|k| format!("{KITTI_ROW} 0 0 0 {}\n", if k == 19 { last } else { "1" })).collect::<String>()
        };
        let error = read_with(&rows("2"), &kitti).unwrap_err().to_string();
        assert!(error.contains("line 20: a 4 x 4 matrix row by row ends with 0 0 0 1"), "{error}");
    }

    #[test]
    fn lengths_of_no_tracker_are_told_and_a_heading_of_another_unit_is_refused() {
        let mm: String = (0..3).map(|k| format!("{k}.5 120.5 -80 1500 0 0 0 1\n")).collect();
        let log = read_with(&mm, &options()).unwrap();
        assert!(
            log.signs[0]
                .1
                .contains("its positions are up to 1507 m away, farther than a tracker sees; are they in mm?"),
            "{:?}",
            log.signs
        );
        let named = format!("# timestamp [s] x [mm] y [mm] z [mm] qx qy qz qw\n{mm}");
        let error = read_with(&named, &options()).unwrap_err().to_string();
        assert!(
            error.contains(
                "line 1: the heading says that positions are in mm, and 1000 mm are taken for one; give unit_mm = 1"
            ),
            "{error}"
        );
        let log = read_with(&named, &LogOptions { unit_mm: Some(1.0), ..options() }).unwrap();
        assert_eq!(log.notes, [""; 0]);
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
