//! Tables of poses whose heading is described, such as those of NDI's and Atracsys' programs.

use super::{FARTHEST_MM, Log, LogOptions, Sample, Turn, stamp::nanoseconds};
use crate::{FileError, LostPose, columns::quoted_cells, cursor::Cursor, input, scalar};
use nalgebra::{Matrix3, Quaternion, Rotation3, Vector3};
use osteoflow_geometry::StampNs;
use schemars::JsonSchema;
use serde::Deserialize;
use std::path::Path;

/// What the columns of a table of poses are. Columns are named as in the heading; of several with one name, `Tx#2` is the second.
///
/// The separator (semicolon, tab or comma), a decimal comma between semicolons or tabs, and lines before the heading are found.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Columns {
    /// The column of the stamps.
    pub time: String,
    /// The unit of the stamps: `s`, `ms`, `us`, `ns`, or `frames`, which `rate_hz` turns into seconds.
    pub time_unit: TimeUnit,
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
const SEPARATORS: [char; 3] = [';', '\t', ','];

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
    child: Option<usize>,
    translation: [usize; 3],
    rotation: Rotation,
    status: Option<usize>,
}

enum Rotation {
    /// w, x, y, z.
    Quaternion([usize; 4]),
    Matrix([usize; 9]),
    EulerZyx([usize; 3]),
}

/// Reads a table.
pub(super) fn read(path: &Path, unit_mm: f64, options: &LogOptions, log: &mut Log) -> Result<(), FileError> {
    let Some(columns) = &options.columns else {
        let message = "a table needs columns, which say what is in its heading: time, time_unit, parent and tools";
        return Err(FileError::content(path, "columns", message));
    };
    let bytes = input::read(path)?;
    let mut table = Table::open(Cursor::text(path, &bytes)?, columns)?;
    let exponent = match (columns.time_unit, options.rate_hz) {
        (TimeUnit::S, _) => Ok(9),
        (TimeUnit::Ms, _) => Ok(6),
        (TimeUnit::Us, _) => Ok(3),
        (TimeUnit::Ns, _) => Ok(0),
        (TimeUnit::Frames, Some(rate_hz)) => Err(rate_hz),
        (TimeUnit::Frames, None) => {
            let message = "time_unit is frames; give the rate of the tracker in Hz (rate_hz, --rate)";
            return Err(FileError::content(path, "columns", message));
        }
    };
    let time = table.place(&columns.time)?;
    if columns.tools.is_empty() {
        return Err(FileError::content(path, "columns", "tools names no tool"));
    }
    let tools = columns.tools.iter().map(|tool| Places::of(tool, &table)).collect::<Result<Vec<_>, _>>()?;
    while let Some((cells, line)) = table.row() {
        let row = Row { table: &table, cells: &cells, line };
        let stamp = row.cell(time)?;
        let stamp_ns = match exponent {
            Ok(exponent) => nanoseconds(&row.decimal(stamp), exponent).map_err(|message| row.fault(message))?,
            Err(rate_hz) => (row.number(time)? * 1e9 / rate_hz).round() as StampNs,
        };
        for tool in &tools {
            let from = match (tool.child, &tool.tool.child) {
                (Some(place), _) => row.cell(place)?,
                (None, child) => child.as_deref().unwrap_or_default(),
            };
            if from.is_empty() {
                return Err(row.fault("the line does not name its tool".into()));
            }
            let pose = tool.pose(&row, unit_mm, (&columns.parent, from), stamp_ns)?;
            log.push(pose, || format!("line {line}"));
        }
    }
    Ok(())
}

impl<'a> Table<'a> {
    /// Finds the heading: the first line with the column of stamps and the first tool's.
    fn open(mut cursor: Cursor<'a>, columns: &Columns) -> Result<Self, FileError> {
        let start = cursor;
        let first = columns.tools.first().map(|tool| bare(&tool.translation[0])).unwrap_or_default();
        while let Some(line) = cursor.filled_line() {
            for separator in SEPARATORS {
                let heading: Vec<String> = quoted_cells(&line, separator)
                    .iter()
                    .map(|cell| cell.trim().trim_start_matches('#').trim().to_owned())
                    .collect();
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

    /// The place of a column; `name#2` is the second of that name.
    fn place(&self, name: &str) -> Result<usize, FileError> {
        let (plain, nth) = match name.rsplit_once('#').and_then(|(plain, n)| Some((plain, n.parse::<usize>().ok()?))) {
            Some((plain, nth)) if !self.heading.iter().any(|cell| cell == name) => (plain, nth.max(1) - 1),
            _ => (name, 0),
        };
        let mut places = (0..self.heading.len()).filter(|k| self.heading[*k] == plain);
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

/// A column's name without the count behind it.
fn bare(name: &str) -> &str {
    name.rsplit_once('#').filter(|(_, n)| n.parse::<usize>().is_ok()).map_or(name, |(plain, _)| plain)
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
fn places<const N: usize>(table: &Table, names: &[String; N]) -> Result<[usize; N], FileError> {
    let mut places = [0; N];
    for (place, name) in places.iter_mut().zip(names) {
        *place = table.place(name)?;
    }
    Ok(places)
}

impl<'a> Places<'a> {
    fn of(tool: &'a Tool, table: &Table) -> Result<Self, FileError> {
        let fault = |message: &str| Err(table.cursor.header_fault(message));
        let optional = |name: &Option<String>| name.as_deref().map(|name| table.place(name)).transpose();
        if tool.child.is_some() == tool.child_column.is_some() {
            return fault("columns: a tool has either child, its name, or child_column, the column with its name");
        }
        let rotation = match (&tool.quaternion, &tool.matrix, &tool.euler_zyx_deg) {
            (Some(QuaternionColumns { w, x, y, z }), None, None) => {
                Rotation::Quaternion([table.place(w)?, table.place(x)?, table.place(y)?, table.place(z)?])
            }
            (None, Some(names), None) => Rotation::Matrix(places(table, names)?),
            (None, None, Some(names)) => Rotation::EulerZyx(places(table, names)?),
            _ => return fault("columns: a tool has one of quaternion, matrix and euler_zyx_deg"),
        };
        Ok(Self {
            tool,
            child: optional(&tool.child_column)?,
            translation: places(table, &tool.translation)?,
            rotation,
            status: optional(&tool.status)?,
        })
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
