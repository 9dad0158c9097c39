//! Compares two items with the same number.

use super::numbers::{Distance, Scalar};
use crate::recording::codec::RecordedItem;
use osteoflow_node::{Column, ColumnType, Field, View};
use serde::Serialize;
use serde_json::Value as Json;
use std::collections::BTreeMap;

/// Suffixes of names that give a number's unit.
const SUFFIXES: [&str; 9] = ["mm", "rad", "deg", "ns", "us", "ms", "s", "px", "hz"];
/// Translation x, y, z in mm and quaternion x, y, z, w.
const POSE: &str = "pose";
const POSE_PARTS: [&str; 7] = [
    "x of the translation",
    "y of the translation",
    "z of the translation",
    "x of the quaternion",
    "y of the quaternion",
    "z of the quaternion",
    "w of the quaternion",
];

/// First difference of two items.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// The place: the stamp, a header field and its index, or a column, its row and its component.
    pub field: String,
    /// The value in the first recording.
    pub a: String,
    /// The value in the second one.
    pub b: String,
    /// How many representable numbers lie between them.
    pub ulp: Option<u64>,
    /// Absolute difference, in `unit`.
    pub distance: Option<f64>,
    /// The unit, from the name or the payload.
    pub unit: Option<String>,
    /// Additional note.
    pub note: Option<String>,
}

impl Difference {
    /// A difference of something that is not a number.
    pub(crate) fn other(field: impl Into<String>, a: impl Into<String>, b: impl Into<String>) -> Self {
        let (field, a, b) = (field.into(), a.into(), b.into());
        Self { field, a, b, ulp: None, distance: None, unit: None, note: None }
    }
}

/// All differences of two items.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct ItemDifference {
    pub(super) first: Option<Difference>,
    /// Whether anything but numbers differs.
    pub(super) other: bool,
    pub(super) stamp: bool,
    pub(super) emptiness: bool,
    pub(super) n_numbers: u64,
    /// Count of numbers that differ by no more than the tolerance.
    pub(super) n_within: u64,
    pub(super) largest: Largest,
}

/// The largest differences among many numbers.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Largest {
    /// In steps between adjacent representable numbers.
    pub ulp: u64,
    /// By unit; the empty unit is for numbers without one.
    pub by_unit: BTreeMap<String, f64>,
}

impl Largest {
    pub(super) fn add(&mut self, ulp: Option<u64>, distance: Option<f64>, unit: &str) {
        self.ulp = self.ulp.max(ulp.unwrap_or(0));
        if let Some(distance) = distance {
            let largest = self.by_unit.entry(unit.into()).or_default();
            *largest = largest.max(distance);
        }
    }

    pub(super) fn merge(&mut self, other: &Self) {
        self.ulp = self.ulp.max(other.ulp);
        for (unit, distance) in &other.by_unit {
            let largest = self.by_unit.entry(unit.clone()).or_default();
            *largest = largest.max(*distance);
        }
    }
}

impl ItemDifference {
    /// Whether anything differs by more than the tolerance.
    pub(super) fn counts(&self) -> bool {
        self.other || self.n_numbers > self.n_within
    }
}

/// Units of a payload's fields and columns, from the recording.
#[derive(Debug, Default)]
pub(super) struct Units(BTreeMap<String, String>);

impl Units {
    pub(super) fn of(json: &str) -> Self {
        Self(serde_json::from_str(json).unwrap_or_default())
    }

    pub(super) fn given(units: &[(&str, &str)]) -> Self {
        Self(units.iter().map(|(name, unit)| ((*name).into(), (*unit).into())).collect())
    }

    fn of_name(&self, name: &str) -> Option<&str> {
        if let Some(unit) = self.0.get(name) {
            return Some(unit);
        }
        let (_, suffix) = name.rsplit_once('_')?;
        SUFFIXES.into_iter().find(|unit| *unit == suffix)
    }
}

/// A comparison of two items in progress.
pub(super) struct Compare<'a> {
    units: &'a Units,
    tolerance: f64,
    found: ItemDifference,
}

/// Place of a number: its name, which may give the unit, and its description.
struct NumberPlace<'a> {
    name: &'a str,
    index: usize,
    describe: &'a dyn Fn() -> String,
}

impl<'a> Compare<'a> {
    pub(super) fn items(a: &RecordedItem, b: &RecordedItem, units: &'a Units, tolerance: f64) -> ItemDifference {
        let mut compare = Self { units, tolerance, found: ItemDifference::default() };
        if a.stamp_ns != b.stamp_ns {
            compare.found.stamp = true;
            let distance = a.stamp_ns.abs_diff(b.stamp_ns) as f64;
            compare.other("stamp", a.stamp_ns.to_string(), b.stamp_ns.to_string());
            if let Some(first) = &mut compare.found.first {
                (first.distance, first.unit) = (Some(distance), Some("ns".into()));
            }
        }
        if a.payload != b.payload {
            let describe = |item: &RecordedItem| match &item.payload {
                Some((name, version)) => format!("{name}@{version}"),
                None => "none".into(),
            };
            compare.other("payload", describe(a), describe(b));
        }
        match (&a.body, &b.body) {
            (Ok(a), Ok(b)) => compare.views(a, b),
            (Err(a), Err(b)) if a == b => {}
            (a, b) => {
                compare.found.emptiness = true;
                let describe = |body: &Result<View, osteoflow_node::Empty>| match body {
                    Ok(_) => "a value".into(),
                    Err(empty) => format!("empty: {}: {}", empty.node, empty.reason),
                };
                compare.other("presence", describe(a), describe(b));
            }
        }
        compare.found
    }

    /// Records a difference of something that is not a number.
    fn other(&mut self, field: impl Into<String>, a: String, b: String) {
        self.found.other = true;
        self.found.first.get_or_insert_with(|| Difference::other(field, shortened(a), shortened(b)));
    }

    fn views(&mut self, a: &View, b: &View) {
        for (place, ((name, a), (other, b))) in a.head.iter().zip(&b.head).enumerate() {
            if name != other {
                return self.other(format!("name of head field {place}"), name.to_string(), other.to_string());
            }
            self.field(name, a, b);
        }
        if a.head.len() != b.head.len() {
            let names = |view: &View| view.head.iter().map(|(name, _)| &**name).collect::<Vec<_>>().join(", ");
            self.other("head fields", names(a), names(b));
        }
        for (a, b) in a.columns.iter().zip(&b.columns) {
            let form = |c: &Column| format!("{}: {} of {:?}, {} rows", c.name, c.width, c.kind, c.rows());
            if (&a.name, a.kind, a.width, a.rows()) != (&b.name, b.kind, b.width, b.rows()) {
                self.other(format!("column {}", a.name), form(a), form(b));
            } else if a.bytes() != b.bytes() {
                self.column(a, b);
            }
        }
        if a.columns.len() != b.columns.len() {
            let names = |view: &View| view.columns.iter().map(|c| &*c.name).collect::<Vec<_>>().join(", ");
            self.other("columns", names(a), names(b));
        }
    }

    fn field(&mut self, name: &str, a: &Field, b: &Field) {
        let at = NumberPlace { name, index: 0, describe: &|| name.into() };
        match (a, b) {
            (Field::Bool(a), Field::Bool(b)) if a == b => {}
            (Field::Int(a), Field::Int(b)) => self.number(&at, Scalar::Int(*a), Scalar::Int(*b)),
            (Field::Float(a), Field::Float(b)) => self.number(&at, Scalar::Double(*a), Scalar::Double(*b)),
            (Field::Floats(a), Field::Floats(b)) if a.len() == b.len() => {
                for (index, (x, y)) in a.iter().zip(b).enumerate() {
                    let at = NumberPlace { name, index, describe: &|| format!("{name}[{index}]") };
                    self.number(&at, Scalar::Double(*x), Scalar::Double(*y));
                }
                self.rotation(name, a, b);
            }
            (Field::Text(a), Field::Text(b)) if a == b => {}
            (Field::Text(a), Field::Text(b)) => match (report(a), report(b)) {
                (Some(x), Some(y)) => {
                    let n_before = self.found.n_numbers;
                    self.json(name, name, &x, &y);
                    if self.found.n_numbers == n_before && !self.found.other {
                        self.other(name, a.to_string(), b.to_string());
                    }
                }
                _ => self.other(name, a.to_string(), b.to_string()),
            },
            _ => self.other(name, format_field(a), format_field(b)),
        }
    }

    /// Compares reports number by number, so that distances are known.
    fn json(&mut self, path: &str, name: &str, a: &Json, b: &Json) {
        match (a, b) {
            (Json::Object(x), Json::Object(y)) => {
                for (key, a) in x {
                    match y.get(key) {
                        Some(b) => self.json(&format!("{path}.{key}"), key, a, b),
                        None => self.other(format!("{path}.{key}"), a.to_string(), "missing".into()),
                    }
                }
                for (key, b) in y.iter().filter(|(key, _)| !x.contains_key(*key)) {
                    self.other(format!("{path}.{key}"), "missing".into(), b.to_string());
                }
            }
            (Json::Array(x), Json::Array(y)) if x.len() == y.len() => {
                for (index, (a, b)) in x.iter().zip(y).enumerate() {
                    self.json(&format!("{path}[{index}]"), name, a, b);
                }
            }
            (Json::Number(x), Json::Number(y)) => {
                let at = NumberPlace { name, index: 0, describe: &|| path.into() };
                match (x.as_i64(), y.as_i64()) {
                    (Some(x), Some(y)) => self.number(&at, Scalar::Int(x), Scalar::Int(y)),
                    _ => {
                        let [x, y] = [x, y].map(|n| Scalar::Double(n.as_f64().unwrap_or(f64::NAN)));
                        self.number(&at, x, y);
                    }
                }
            }
            (a, b) if a == b => {}
            (a, b) => self.other(path, a.to_string(), b.to_string()),
        }
    }

    fn column(&mut self, a: &Column, b: &Column) {
        let (size, width) = (a.kind.size(), a.width as usize);
        let row_bytes = size * width;
        if row_bytes == 0 {
            return;
        }
        let name = &*a.name;
        let rows = a.bytes().chunks_exact(row_bytes).zip(b.bytes().chunks_exact(row_bytes)).enumerate();
        for (row, (x, y)) in rows.filter(|(_, (x, y))| x != y) {
            for (index, (x, y)) in x.chunks_exact(size).zip(y.chunks_exact(size)).enumerate() {
                let describe = || match width {
                    1 => format!("column {name}, row {row}"),
                    _ => format!("column {name}, row {row}, component {index}"),
                };
                self.number(&NumberPlace { name, index, describe: &describe }, scalar(a.kind, x), scalar(a.kind, y));
            }
            if a.kind == ColumnType::F64 {
                let doubles = |row: &[u8]| -> Vec<f64> { row.chunks_exact(8).map(double).collect() };
                self.rotation(name, &doubles(x), &doubles(y));
            }
        }
    }

    fn number(&mut self, at: &NumberPlace<'_>, a: Scalar, b: Scalar) {
        let Some(apart) = a.apart(b) else { return };
        let Distance { ulp, distance, note } = apart;
        let told_unit = self.units.of_name(at.name);
        let part = POSE_PARTS.get(at.index).filter(|_| told_unit == Some(POSE));
        let unit = match (told_unit, part) {
            (Some(POSE), _) if at.index < 3 => Some("mm"),
            (Some(POSE), _) => None,
            (unit, _) => unit,
        };
        self.found.n_numbers += 1;
        let within = distance.is_some_and(|distance| distance <= self.tolerance && self.tolerance > 0.0);
        self.found.n_within += u64::from(within);
        self.found.largest.add(ulp, distance, unit.unwrap_or(""));
        if within {
            return;
        }
        self.found.first.get_or_insert_with(|| Difference {
            field: match part {
                Some(part) => format!("{} ({part})", (at.describe)()),
                None => (at.describe)(),
            },
            a: a.format(),
            b: b.format(),
            ulp,
            distance,
            unit: unit.map(str::to_owned),
            note: note.map(str::to_owned),
        });
    }

    /// Angle between two poses.
    fn rotation(&mut self, name: &str, a: &[f64], b: &[f64]) {
        let (Some(POSE), [.., ax, ay, az, aw], [.., bx, by, bz, bw]) = (self.units.of_name(name), a, b) else { return };
        if a.len() != POSE_PARTS.len() || a[3..] == b[3..] {
            return;
        }
        // The rotation from one to the other is conj(a) * b.
        let w = aw * bw + ax * bx + ay * by + az * bz;
        let x = aw * bx - ax * bw - ay * bz + az * by;
        let y = aw * by + ax * bz - ay * bw - az * bx;
        let z = aw * bz - ax * by + ay * bx - az * bw;
        let angle = 2.0 * (x * x + y * y + z * z).sqrt().atan2(w.abs());
        self.found.largest.add(None, Some(angle).filter(|angle| angle.is_finite()), "rad");
    }
}

/// Parses a text that is a report in JSON.
fn report(text: &str) -> Option<Json> {
    if !text.starts_with(['{', '[']) {
        return None;
    }
    serde_json::from_str(text).ok()
}

fn format_field(field: &Field) -> String {
    match field {
        Field::Bool(value) => value.to_string(),
        Field::Int(value) => value.to_string(),
        Field::Float(value) => format!("{value:?}"),
        Field::Floats(values) => format!("{} numbers", values.len()),
        Field::Text(text) => format!("\"{text}\""),
    }
}

fn double(bytes: &[u8]) -> f64 {
    f64::from_ne_bytes(bytes.try_into().expect("rows were cut into eights"))
}

fn scalar(kind: ColumnType, bytes: &[u8]) -> Scalar {
    let four = || bytes.try_into().expect("rows were cut into fours");
    match kind {
        ColumnType::F64 => Scalar::Double(double(bytes)),
        ColumnType::F32 => Scalar::Single(f32::from_ne_bytes(four())),
        ColumnType::I64 => Scalar::Int(i64::from_ne_bytes(bytes.try_into().expect("rows were cut into eights"))),
        ColumnType::U32 => Scalar::Int(u32::from_ne_bytes(four()).into()),
        ColumnType::U8 => Scalar::Int(bytes[0].into()),
    }
}

/// Shortens a text to one line.
fn shortened(text: String) -> String {
    const MAX_CHARACTERS: usize = 200;
    match text.char_indices().nth(MAX_CHARACTERS) {
        Some((at, _)) => format!("{} ... ({} bytes)", &text[..at], text.len()),
        None => text,
    }
}
