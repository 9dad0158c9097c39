//! Tables of poses whose heading is described, such as those of NDI's and Atracsys' programs.

use super::{
    FARTHEST_MM, Log, LogOptions, Sample, Turn,
    motion_capture::{self, Capture},
    ndi::{self, Ndi},
    stamp::nanoseconds,
};
use crate::{FileError, LostPose, columns::quoted_cells, cursor::Cursor, cut, input, scalar, space::is_same};
use nalgebra::{Matrix3, Quaternion, Rotation3, Vector3};
use osteoflow_geometry::StampNs;
use schemars::JsonSchema;
use serde::Deserialize;
use std::path::Path;

/// What the columns of a table of poses are. Columns are named as in the heading; of several with one name, `Tx#2` is the second, or
/// `after` says which. A tool whose columns have stamps of their own behind `after` takes these.
///
/// The separator (semicolon, tab or comma), a decimal comma between semicolons or tabs, and lines before the heading are found.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Columns {
    /// The column of the stamps.
    pub time: String,
    /// The unit of the stamps: `s`, `ms`, `us`, `ns`, or `frames`, which `rate_hz` turns into seconds.
    pub time_unit: TimeUnit,
    /// A column of nanoseconds that are added to the stamp, where seconds and nanoseconds have a column each.
    #[serde(default)]
    pub time_ns: Option<String>,
    /// The frame that the poses lead to, such as `tracker`.
    pub parent: String,
    /// The tools of a line.
    pub tools: Vec<Tool>,
}

/// The unit of stamps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TimeUnit {
    /// Seconds.
    S,
    /// Milliseconds.
    Ms,
    /// Microseconds.
    Us,
    /// Nanoseconds.
    Ns,
    /// Frames of the tracker.
    Frames,
}

/// The columns of a tool. One of `quaternion`, `matrix` and `euler_zyx_deg` is its rotation.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Tool {
    /// The frame that moves.
    pub child: Option<String>,
    /// The column with the name of the frame that moves, in a table with a line for each tool.
    pub child_column: Option<String>,
    /// The beginning of the name of a column behind which this tool's are, such as `Port 2`, in a table that has them for several.
    /// `child_column` may be this column itself.
    pub after: Option<String>,
    /// The columns of x, y and z.
    pub translation: [String; 3],
    /// The columns of a quaternion, each by its name, since programs differ in their order.
    pub quaternion: Option<QuaternionColumns>,
    /// The columns of a rotation matrix, row by row.
    pub matrix: Option<[String; 9]>,
    /// The columns of angles about z, y and x, degrees: the rotation is `Rz Ry Rx`, as NDI's are.
    pub euler_zyx_deg: Option<[String; 3]>,
    /// The column that says whether the tool was seen.
    pub status: Option<String>,
    /// Its words for a tool that was seen. Unset: `OK`.
    pub seen: Option<Vec<String>>,
}

/// The columns of a quaternion.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct QuaternionColumns {
    /// The scalar part, `Q0` of NDI.
    pub w: String,
    /// The first part of the vector.
    pub x: String,
    /// The second.
    pub y: String,
    /// The third.
    pub z: String,
}

/// The separators of tables, in the order in which they are tried.
pub(super) const SEPARATORS: [char; 3] = [';', '\t', ','];

/// A table, cut into cells.
struct Table<'a> {
    cursor: Cursor<'a>,
    separator: char,
    heading: Vec<String>,
    heading_line: usize,
}

/// The places of a tool's columns.
struct Places<'a> {
    tool: &'a Tool,
    /// The column of the port's name, which each line of NDI's tables repeats.
    port: Option<usize>,
    time: usize,
    time_ns: Option<usize>,
    child: Option<usize>,
    translation: [usize; 3],
    rotation: Rotation<usize>,
    status: Option<usize>,
}

/// The columns of a rotation, by name or by place.
enum Rotation<T> {
    /// w, x, y, z.
    Quaternion([T; 4]),
    Matrix([T; 9]),
    EulerZyx([T; 3]),
}

impl Columns {
    /// Refuses a description that is none of any table.
    ///
    /// # Errors
    /// The key at fault, and a message.
    pub fn check(&self, rate_hz: Option<f64>) -> Result<(), (&'static str, &'static str)> {
        self.time_unit.exponent(rate_hz).map(drop).map_err(|message| ("time_unit", message))?;
        if self.tools.is_empty() {
            return Err(("tools", "tools names no tool"));
        }
        self.tools.iter().try_for_each(|tool| tool.rotation().map(drop)).map_err(|message| ("tools", message))
    }
}

impl TimeUnit {
    /// A stamp is in units of `10^exponent` ns, or in frames of a rate.
    fn exponent(self, rate_hz: Option<f64>) -> Result<Result<i32, f64>, &'static str> {
        Ok(match self {
            Self::S => Ok(9),
            Self::Ms => Ok(6),
            Self::Us => Ok(3),
            Self::Ns => Ok(0),
            Self::Frames => {
                Err(rate_hz.ok_or("time_unit is frames; give the rate of the tracker in Hz (rate_hz, --rate)")?)
            }
        })
    }
}

impl Tool {
    /// The columns of its rotation; refuses a tool whose name or position is not described.
    fn rotation(&self) -> Result<Rotation<&str>, &'static str> {
        if self.child.is_some() == self.child_column.is_some() {
            return Err("a tool has either child, its name, or child_column, the column with its name");
        }
        if self.translation.iter().any(String::is_empty) {
            return Err("a tool has translation, the columns of x, y and z");
        }
        match (&self.quaternion, &self.matrix, &self.euler_zyx_deg) {
            (Some(QuaternionColumns { w, x, y, z }), None, None) => Ok(Rotation::Quaternion([w, x, y, z])),
            (None, Some(names), None) => Ok(Rotation::Matrix(names.each_ref().map(String::as_str))),
            (None, None, Some(names)) => Ok(Rotation::EulerZyx(names.each_ref().map(String::as_str))),
            _ => Err("a tool has one of quaternion, matrix and euler_zyx_deg"),
        }
    }
}

/// Reads a table.
pub(super) fn read(path: &Path, unit_mm: f64, options: &LogOptions, log: &mut Log) -> Result<(), FileError> {
    let bytes = input::read(path)?;
    let cursor = Cursor::text(path, &bytes)?;
    let of_ndi = Ndi::find(cursor);
    let described = options.columns.as_ref();
    let is_capture = described.is_none() && motion_capture::is_it(&String::from_utf8_lossy(&bytes));
    let capture = is_capture.then(|| Capture::of(cursor).map_err(|(line, message)| cursor.fault_at(line, message)));
    let capture = capture.transpose()?;
    let found = of_ndi.as_ref().map(|ndi| &ndi.columns).or(capture.as_ref().map(|capture| &capture.columns));
    let Some(columns) = described.or(found) else {
        let message =
            "a table of poses needs columns, which say what is in its heading: time, time_unit, parent and tools";
        return Err(FileError::content(path, "columns", message));
    };
    let fault = |message| FileError::content(path, "columns", message);
    let rate_hz = options.rate_hz.or(capture.as_ref().and_then(|capture| capture.rate_hz));
    columns.check(rate_hz).map_err(|(_, message)| fault(message))?;
    let exponent = columns.time_unit.exponent(rate_hz).map_err(fault)?;
    let stated_mm = capture.as_ref().map(|capture| capture.unit_mm);
    if let (Some(stated_mm), Some(unit_mm)) = (stated_mm, options.unit_mm)
        && !is_same(stated_mm, unit_mm)
    {
        let message =
            format!("it states a unit of {stated_mm} mm, and unit_mm is {unit_mm}; leave unit_mm (--scale) away");
        return Err(FileError::content(path, "heading", message));
    }
    let unit_mm = stated_mm.unwrap_or(unit_mm);
    let mut table = match &capture {
        Some(Capture { names, cursor, .. }) => {
            Table { cursor: *cursor, separator: ',', heading: names.clone(), heading_line: cursor.line }
        }
        None => Table::open(cursor, columns)?,
    };
    let tools = columns.tools.iter().map(|tool| Places::of(tool, columns, &table)).collect::<Result<Vec<_>, _>>()?;
    while let Some((cells, line)) = table.row() {
        let row = Row { table: &table, cells: &cells, line };
        if let Some(ndi) = of_ndi.as_ref().filter(|_| described.is_none()) {
            ndi.check(&cells).map_err(|message| row.fault(message))?;
        }
        for tool in &tools {
            tool.check_port(&row)?;
            let from = match (tool.child, &tool.tool.child) {
                (Some(place), _) => row.cell(place)?,
                (None, child) => child.as_deref().unwrap_or_default(),
            };
            if from.is_empty() {
                return Err(row.fault("the line does not name its tool".into()));
            }
            let stamp_ns = tool.stamp_ns(&row, exponent)?;
            let pose = tool.pose(&row, unit_mm, (&columns.parent, from), stamp_ns)?;
            log.push(pose, || format!("line {line}"));
        }
        let (n, n_columns) = (cells.len(), table.heading.len());
        if n < n_columns && table.cursor.rest().is_empty() && !bytes.ends_with(b"\n") {
            let message =
                format!("the last line has no end, and {n} cells of {n_columns}; was the file cut short? remove it");
            return Err(row.fault(message));
        }
    }
    log.notes.extend(cut::last_number(path, &bytes)?);
    Ok(())
}

impl<'a> Table<'a> {
    /// Finds the heading: the first line with the column of stamps and the first tool's.
    fn open(mut cursor: Cursor<'a>, columns: &Columns) -> Result<Self, FileError> {
        let start = cursor;
        let first = columns.tools.first().map(|tool| bare(&tool.translation[0])).unwrap_or_default();
        while let Some(line) = cursor.filled_line() {
            for separator in SEPARATORS {
                let heading = named(&quoted_cells(&line, separator));
                if [bare(&columns.time), first].iter().all(|name| heading.iter().any(|cell| cell == name)) {
                    return Ok(Self { cursor, separator, heading_line: cursor.line, heading });
                }
            }
        }
        let message = format!(
            "no line names the columns \"{}\" and \"{first}\", between semicolons, tabs or commas",
            columns.time
        );
        Err(start.header_fault(message))
    }

    /// The place of a column; `name#2` is the second of that name behind `start`.
    fn place(&self, name: &str, start: usize) -> Result<usize, FileError> {
        let (plain, nth) = match counted(name) {
            Some(counted) if !self.heading.iter().any(|cell| cell == name) => counted,
            _ => (name, 0),
        };
        let mut places = (start..self.heading.len()).filter(|k| self.heading[*k] == plain);
        let found = places.nth(nth);
        found.ok_or_else(|| {
            let message = format!("no column is called \"{name}\"; there are: {}", self.heading.join(", "));
            self.cursor.fault_at(self.heading_line, message)
        })
    }

    /// The cells of the next line that is no comment.
    fn row(&mut self) -> Option<(Vec<String>, usize)> {
        loop {
            let line = self.cursor.filled_line()?;
            if !line.trim_start().starts_with('#') {
                let cells = quoted_cells(&line, self.separator).iter().map(|cell| cell.trim().to_owned()).collect();
                return Some((cells, self.cursor.line));
            }
        }
    }
}

/// The names of a heading.
pub(super) fn named(cells: &[String]) -> Vec<String> {
    let mut names: Vec<_> = cells.iter().map(|cell| cell.trim().trim_start_matches('#').trim().to_owned()).collect();
    names.truncate(names.iter().rposition(|name| !name.is_empty()).map_or(0, |last| last + 1));
    names
}

/// A column's name without the count behind it, and the number of columns of that name before it.
fn counted(name: &str) -> Option<(&str, usize)> {
    let (plain, n) = name.rsplit_once('#')?;
    Some((plain, n.parse::<usize>().ok()?.max(1) - 1))
}

/// A column's name without the count behind it.
fn bare(name: &str) -> &str {
    counted(name).map_or(name, |(plain, _)| plain)
}

/// A line of a table.
struct Row<'a> {
    table: &'a Table<'a>,
    cells: &'a [String],
    line: usize,
}

impl Row<'_> {
    fn fault(&self, message: String) -> FileError {
        self.table.cursor.fault_at(self.line, message)
    }

    fn cell(&self, place: usize) -> Result<&str, FileError> {
        self.cells.get(place).map(String::as_str).ok_or_else(|| {
            let (n, name) = (self.cells.len(), &self.table.heading[place]);
            self.fault(format!("the line has {n} cells, and \"{name}\" is cell {}; was the file cut short?", place + 1))
        })
    }

    /// A number with a decimal point, where commas do not separate.
    fn decimal(&self, cell: &str) -> String {
        if self.table.separator == ',' { cell.to_owned() } else { cell.replace(',', ".") }
    }

    /// A number; NaN where the cell is empty.
    fn number(&self, place: usize) -> Result<f64, FileError> {
        let cell = self.cell(place)?;
        if cell.is_empty() {
            return Ok(f64::NAN);
        }
        let name = &self.table.heading[place];
        scalar::number(&self.decimal(cell))
            .ok_or_else(|| self.fault(format!("{name} is \"{cell}\", a number is expected")))
    }

    fn numbers<const N: usize>(&self, places: [usize; N]) -> Result<[f64; N], FileError> {
        let mut numbers = [0.0; N];
        for (number, place) in numbers.iter_mut().zip(places) {
            *number = self.number(place)?;
        }
        Ok(numbers)
    }
}

/// The places of several columns.
fn places<const N: usize>(table: &Table, names: [&str; N], start: usize) -> Result<[usize; N], FileError> {
    let mut places = [0; N];
    for (place, name) in places.iter_mut().zip(names) {
        *place = table.place(name, start)?;
    }
    Ok(places)
}

impl<'a> Places<'a> {
    fn of(tool: &'a Tool, columns: &Columns, table: &Table) -> Result<Self, FileError> {
        let start = match tool.after.as_deref() {
            None => 0,
            Some(after) => {
                // `Port 1` is also the beginning of `Port 10`.
                let exact = table.heading.iter().position(|cell| cell == after);
                let begins = |plain: &str, nth| {
                    (0..table.heading.len()).filter(|k| table.heading[*k].starts_with(plain)).nth(nth)
                };
                let by_number = || counted(after).and_then(|(plain, nth)| begins(plain, nth));
                let column = exact.or_else(|| begins(after, 0)).or_else(by_number);
                1 + column.ok_or_else(|| {
                    let message = format!("no column begins with \"{after}\"; there are: {}", table.heading.join(", "));
                    table.cursor.fault_at(table.heading_line, message)
                })?
            }
        };
        // Stamps of its own, or those of the line.
        let stamp = |name: &str| table.place(name, start).or_else(|_| table.place(name, 0));
        let optional = |name: &Option<String>| name.as_deref().map(|name| table.place(name, start)).transpose();
        let rotation = match tool.rotation().map_err(|message| table.cursor.header_fault(message))? {
            Rotation::Quaternion(names) => Rotation::Quaternion(places(table, names, start)?),
            Rotation::Matrix(names) => Rotation::Matrix(places(table, names, start)?),
            Rotation::EulerZyx(names) => Rotation::EulerZyx(places(table, names, start)?),
        };
        let child = tool.child_column.as_deref().map(|name| table.place(name, start.saturating_sub(1))).transpose()?;
        let port = start.checked_sub(1).filter(|place| ndi::is_port(&table.heading[*place]));
        Ok(Self {
            tool,
            port,
            time: stamp(&columns.time)?,
            time_ns: columns.time_ns.as_deref().map(stamp).transpose()?,
            child,
            translation: places(table, tool.translation.each_ref().map(String::as_str), start)?,
            rotation,
            status: optional(&tool.status)?,
        })
    }

    /// Refuses a line in which the tool's columns are those of another port.
    fn check_port(&self, row: &Row) -> Result<(), FileError> {
        let Some(place) = self.port else { return Ok(()) };
        let (cell, heading) = (row.cell(place)?, &row.table.heading[place]);
        if ndi::is_same_port(cell, heading) {
            return Ok(());
        }
        let found = if cell.is_empty() { "names no port".into() } else { format!("has \"{cell}\"") };
        Err(row.fault(format!(
            "the line {found} where the heading has \"{heading}\", so that its poses are not of that tool; was a tool plugged in anew? split \
             the file there, with a heading of its own for each part"
        )))
    }

    /// The stamp of this tool: in units of `10^exponent` ns, or frames of a rate.
    fn stamp_ns(&self, row: &Row, exponent: Result<i32, f64>) -> Result<StampNs, FileError> {
        let exponent = match exponent {
            Ok(exponent) => exponent,
            Err(rate_hz) => return Ok((row.number(self.time)? * 1e9 / rate_hz).round() as StampNs),
        };
        let stamp = |place, exponent| {
            nanoseconds(&row.decimal(row.cell(place)?), exponent).map_err(|message| row.fault(message))
        };
        let more = self.time_ns.map_or(Ok(0), |place| stamp(place, 0))?;
        stamp(self.time, exponent)?
            .checked_add(more)
            .ok_or_else(|| row.fault("the stamp is beyond the year 2262".into()))
    }

    fn pose(
        &self,
        row: &Row,
        unit_mm: f64,
        (to, from): (&str, &str),
        stamp_ns: StampNs,
    ) -> Result<Result<osteoflow_geometry::Nearest<osteoflow_geometry::Pose>, LostPose>, FileError> {
        let lost = |reason: String| Ok(Err(LostPose { to: to.into(), from: from.into(), stamp_ns, reason }));
        if let Some(status) = self.status {
            let (status, ok) = (row.cell(status)?, ["OK".to_owned()]);
            if !self.tool.seen.as_deref().unwrap_or(&ok).iter().any(|seen| seen == status) {
                return lost(format!("the status {}", if status.is_empty() { "\"\"" } else { status }));
            }
        }
        let translation_mm = row.numbers(self.translation)?.map(|c| c * unit_mm);
        if translation_mm.iter().any(|c| c.abs() > FARTHEST_MM) {
            return lost("a position beyond a kilometre, which trackers write for a tool that they do not see".into());
        }
        let turn = match self.rotation {
            Rotation::Quaternion(places) => {
                let [w, x, y, z] = row.numbers(places)?;
                Turn::Quaternion(Quaternion::new(w, x, y, z))
            }
            Rotation::Matrix(places) => Turn::Matrix(Matrix3::from_row_slice(&row.numbers(places)?)),
            Rotation::EulerZyx(places) => {
                let [z, y, x] = row.numbers(places)?.map(f64::to_radians);
                let about = |axis: Vector3<f64>, angle: f64| Rotation3::new(axis * angle).into_inner();
                Turn::Matrix(about(Vector3::z(), z) * about(Vector3::y(), y) * about(Vector3::x(), x))
            }
        };
        let sample = Sample { to: to.into(), from: from.into(), stamp_ns, translation_mm, turn };
        sample.pose().map_err(|message| row.fault(message))
    }
}

#[cfg(test)]
mod tests {
    use crate::{
        FileError,
        pose_log::{Columns, LogFormat, LogOptions, PoseLog, read_log},
        probe::{Kind, probe},
    };
    use nalgebra::Vector3;

    fn read(text: &str, columns: Option<&str>) -> Result<PoseLog, FileError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        let columns: Option<Columns> = columns.map(|columns| toml::from_str(columns).unwrap());
        read_log(file.path(), &LogOptions { columns, ..LogOptions::default() })
    }

    /// Frames, stamp, x and the angle in degrees of each pose, or why it is lost.
    fn words(log: &PoseLog) -> Vec<String> {
        let word = |pose: &Result<osteoflow_geometry::Nearest<osteoflow_geometry::Pose>, crate::LostPose>| match pose {
            Ok(pose) => {
                let (pose, turn) = (&pose.value, pose.value.isometry.rotation.scaled_axis().map(f64::to_degrees));
                let at = pose.isometry.translation.vector;
                format!("{} {} {} {at:.1?} {turn:.1?}", pose.to, pose.from, pose.stamp_ns).replace('\n', "")
            }
            Err(lost) => format!("{} {} {} {}", lost.to, lost.from, lost.stamp_ns, lost.reason),
        };
        log.poses.iter().map(word).collect()
    }

    const NDI: &str = "Tools,Port 0x01: Probe  s/n:1,Frame,Time [sec],Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,Markers,State,Tx,Ty,Tz,\
                       Port 0x02: Bone,Frame,Time [sec],Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,Markers,State,Tx,Ty,Tz\r\n\
                       2,Port 0x01: Probe  s/n:1,650,1778067471.318767388,1,OK,0.70710678,0,0,0.70710678,-42.1,-236.3,-1655.3,0.2,3,OK,\
                       -54.0,-355.1,-1630.0,Port 0x02: Bone,650,1778067471.318767388,1,OK,1,0,0,0,82.6,-64.0,-1575.9,0.3,3,OK,1,2,3\r\n\
                       2,Port 0x01: Probe  s/n:1,653,1778067471.368767388,1,Too Few Markers,-3.697314E28,-3.697314E28,-3.697314E28,\
                       -3.697314E28,-3.697314E28,-3.697314E28,-3.697314E28,0,3,OK,1,2,3,Port 0x02: Bone,653,1778067471.368767388,1,OK,\
                       0,1,0,0,82.7,-64.1,-1575.8,0.3,3,Off Angle,1,2,3\r\n";

    #[test]
    fn a_table_of_ndi_is_known_by_its_heading_and_a_state_other_than_ok_is_a_lost_tool() {
        let log = read(NDI, None).unwrap();
        assert_eq!((log.format, &log.notes[..]), (LogFormat::Ndi, &[][..]));
        let found = words(&log);
        let stamps = ["1778067471318767388", "1778067471368767388"];
        let probe = &log.poses[0].as_ref().unwrap().value;
        assert_eq!((probe.from.as_str(), probe.stamp_ns.to_string().as_str()), ("Probe  s/n:1", stamps[0]));
        assert_eq!(probe.isometry.translation.vector, Vector3::new(-42.1, -236.3, -1655.3));
        assert!((probe.isometry.rotation.scaled_axis() - Vector3::z() * 90_f64.to_radians()).norm() < 1e-6);
        assert_eq!(found[2], format!("tracker Probe  s/n:1 {} the status Too Few Markers", stamps[1]));
        let bone = &log.poses[3].as_ref().unwrap().value;
        assert_eq!((bone.from.as_str(), bone.isometry.translation.x), ("Bone", 82.7));
        assert!((bone.isometry.rotation * Vector3::y() + Vector3::y()).norm() < 1e-12, "half a turn about x");
    }

    #[test]
    fn a_described_table_may_have_words_before_it_semicolons_decimal_commas_and_a_line_for_each_tool() {
        let text = "\u{feff}Atracsys fusionTrack\n\nt_us;marker;geom;status;R00;R01;R02;R10;R11;R12;R20;R21;R22;px;py;pz\n\
                    1500,5;\"my probe\";7;1;0;-1;0;1;0;0;0;0;1;10,25;20;30\n3000;bone;8;0;;;;;;;;;;;;\n";
        let columns = "time = \"t_us\"\ntime_unit = \"us\"\nparent = \"tracker\"\n[[tools]]\nchild_column = \"marker\"\n\
                       translation = [\"px\", \"py\", \"pz\"]\nmatrix = [\"R00\", \"R01\", \"R02\", \"R10\", \"R11\", \"R12\", \
                       \"R20\", \"R21\", \"R22\"]\nstatus = \"status\"\nseen = [\"1\"]\n";
        let log = read(text, Some(columns)).unwrap();
        let pose = &log.poses[0].as_ref().unwrap().value;
        assert_eq!((pose.from.as_str(), pose.stamp_ns, pose.isometry.translation.x), ("my probe", 1_500_500, 10.25));
        assert!((pose.isometry.rotation * Vector3::x() - Vector3::y()).norm() < 1e-12, "row by row");
        assert_eq!(words(&log)[1], "tracker bone 3000000 the status 0");
        // Without the status the empty cells are a lost tool, too.
        let blind = columns.replace("status = \"status\"\nseen = [\"1\"]\n", "");
        assert_eq!(words(&read(text, Some(&blind)).unwrap())[1], "tracker bone 3000000 a position that is not finite");
    }

    #[test]
    fn columns_of_one_name_are_told_apart_by_their_number_or_by_what_is_before_them() {
        let text = "frame,A,x,y,z,w,i,j,k,B,x,y,z,w,i,j,k\n30,a,1,2,3,1,0,0,0,b,4,5,6,1,0,0,0\n";
        let tool = |child: &str, more: &str, n: &str| {
            format!(
                "[[tools]]\nchild = \"{child}\"\n{more}translation = [\"x{n}\", \"y{n}\", \"z{n}\"]\nquaternion = \
                 {{ w = \"w{n}\", x = \"i{n}\", y = \"j{n}\", z = \"k{n}\" }}\n"
            )
        };
        let head = "time = \"frame\"\ntime_unit = \"frames\"\nparent = \"tracker\"\n";
        let columns = format!("{head}{}{}{}", tool("a", "", ""), tool("b", "", "#2"), tool("c", "after = \"B\"\n", ""));
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        let columns: Columns = toml::from_str(&columns).unwrap();
        let mut options = LogOptions { columns: Some(columns), ..LogOptions::default() };
        let error = read_log(file.path(), &options).unwrap_err().to_string();
        assert!(error.contains("time_unit is frames; give the rate of the tracker in Hz"), "{error}");
        options.rate_hz = Some(60.0);
        let log = read_log(file.path(), &options).unwrap();
        let places: Vec<_> =
            log.poses.iter().map(|pose| pose.as_ref().unwrap()).map(|pose| pose.value.isometry.translation.x).collect();
        assert_eq!((places, log.poses[0].as_ref().unwrap().value.stamp_ns), (vec![1.0, 4.0, 4.0], 500_000_000));
    }

    #[test]
    fn angles_turn_about_z_of_the_result_of_y_of_the_result_of_x() {
        let columns = "time = \"t\"\ntime_unit = \"s\"\nparent = \"tracker\"\n[[tools]]\nchild = \"a\"\ntranslation = [\"x\", \"y\", \"z\"]\n\
                       euler_zyx_deg = [\"Rz\", \"Ry\", \"Rx\"]\n";
        let log = read("t\tRz\tRy\tRx\tx\ty\tz\n1,5\t90\t0\t90\t1\t2\t3\n", Some(columns)).unwrap();
        let turn = log.poses[0].as_ref().unwrap().value.isometry.rotation;
        // About x first: y to z, then about z: z stays.
        assert!(
            (turn * Vector3::y() - Vector3::z()).norm() < 1e-12 && (turn * Vector3::x() - Vector3::y()).norm() < 1e-12
        );
    }

    #[test]
    fn a_fault_names_line_and_column() {
        let columns = "time = \"t\"\ntime_unit = \"s\"\nparent = \"p\"\n[[tools]]\nchild = \"a\"\ntranslation = [\"x\", \"y\", \"z\"]\n\
                       quaternion = { w = \"w\", x = \"i\", y = \"j\", z = \"k\" }\n";
        let head = "t,x,y,z,w,i,j,k\n";
        for (text, expected) in [
            (
                format!("{head}1,2,3,4,1,0,0,0\n2,2,3,4,1,0"),
                "line 3: the line has 6 cells, and \"j\" is cell 7; was the file cut short?",
            ),
            (format!("{head}1,2,3,4,9,0,0,0\n"), "line 2: the quaternion has length 9"),
            (format!("{head}soon,2,3,4,1,0,0,0\n"), "line 2: the stamp \"soon\" is not a number"),
            (format!("{head}1,2,3,up,1,0,0,0\n"), "line 2: z is \"up\", a number is expected"),
            (
                "t,x,y,z,w,i,j\n1,2,3,4,1,0,0\n".into(),
                "line 1: no column is called \"k\"; there are: t, x, y, z, w, i, j",
            ),
            ("a,b\n1,2\n".into(), "header: no line names the columns \"t\" and \"x\""),
        ] {
            let error = read(&text, Some(columns)).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}\n{expected}");
        }
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), NDI).unwrap();
        assert_eq!(probe(file.path()).unwrap().kind, Kind::Poses(LogFormat::Ndi));
    }
}
