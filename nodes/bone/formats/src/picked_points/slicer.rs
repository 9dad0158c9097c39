//! Markups of 3D Slicer.
//!
//! # Source
//! The JSON schema "markups-schema-v1.0.3" of 3D Slicer, and its storage nodes for the fields that the schema leaves open:
//! coordinate system 0 is RAS and 1 is LPS; position status 2 is defined.

use super::collected::{Collected, PickedPlane, PickedPoints, PickedRoi, to_lps};
use crate::{
    FileError, Space,
    columns::{quoted_cells, twice},
    cursor::Cursor,
    json, scalar,
};
use nalgebra::{Matrix3, Point3, Rotation3, Unit, Vector3};
use osteoflow_geometry::{TooFar, direction, nearest_isometry};
use serde_json::Value;
use std::path::Path;

pub(super) fn is_fcsv(bytes: &[u8]) -> bool {
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(1024)]);
    head.lines().take_while(|line| line.starts_with('#')).any(|line| {
        let line = line.trim_start_matches('#').trim();
        line.starts_with("Markups fiducial file") || line.starts_with("CoordinateSystem") || line.starts_with("columns")
    })
}

fn space_of(value: &str) -> Result<Space, String> {
    match value.trim() {
        "LPS" | "1" => Ok(Space::Lps),
        "RAS" | "0" => Ok(Space::Ras),
        other => Err(format!("\"{other}\" is no coordinate system that is known; LPS (1) or RAS (0) is expected")),
    }
}

const UNSTATED: &str = "the file states no coordinate system; its numbers are taken as they are";

/// The markups in a `.mrk.json` file.
pub(super) fn markups(path: &Path, bytes: &[u8]) -> Result<PickedPoints, FileError> {
    let text = std::str::from_utf8(bytes)
        .map_err(|error| FileError::content(path, format!("byte {}", error.valid_up_to()), "the file is no UTF-8"))?;
    let whole: Value = json::parse(text).map_err(|error| {
        FileError::content(path, format!("line {} column {}", error.line(), error.column()), error.to_string())
    })?;
    let fault = |place: &str, message: &str| FileError::content(path, place, message);
    let Some(markups) = whole.get("markups").and_then(Value::as_array) else {
        return Err(fault("markups", "there is no list \"markups\"; is it a markups file of 3D Slicer?"));
    };
    let mut collected = Collected::default();
    let (mut planes, mut rois) = (Vec::new(), Vec::new());
    let mut spaces: Vec<Space> = Vec::new();
    for (k, markup) in markups.iter().enumerate() {
        let item = Item { path, place: format!("markups[{k}]"), value: markup };
        let space = match markup.get("coordinateSystem") {
            None | Some(Value::Null) => Space::Unknown,
            Some(value) => space_of(&plain(value)).map_err(|message| item.fault("coordinateSystem", message))?,
        };
        if let Some(&first) = spaces.first()
            && first != space
        {
            return Err(
                item.fault("coordinateSystem", format!("it is {space}, but {first} for the first; save all alike"))
            );
        }
        spaces.push(space);
        item.check_units()?;
        let kind = markup.get("type").and_then(Value::as_str).unwrap_or_default();
        match kind {
            "Fiducial" | "Line" | "Curve" | "ClosedCurve" | "Angle" => {
                for point in item.control_points()? {
                    match point.position()? {
                        Some(position) => collected
                            .push(point.label(), position, space)
                            .map_err(|message| fault(&point.place, &message))?,
                        None => collected.n_skipped += 1,
                    }
                }
            }
            "Plane" => match item.plane(space, planes.len(), &mut collected.notes)? {
                Some(plane) => planes.push(plane),
                None => collected.n_skipped += 1,
            },
            "ROI" => rois.push(item.roi(space, rois.len(), &mut collected.notes)?),
            other => {
                return Err(item
                    .fault("type", format!("\"{other}\" is not read; fiducials, lines, curves, planes and ROIs are")));
            }
        }
    }
    for names in [
        planes.iter().map(|plane: &PickedPlane| &*plane.name).collect::<Vec<_>>(),
        rois.iter().map(|roi: &PickedRoi| &*roi.name).collect(),
    ] {
        if let Some((k, name)) = names.iter().enumerate().find(|(k, name)| names[..*k].contains(name)) {
            return Err(fault(
                "markups",
                &format!("name \"{name}\" is given twice, at last to plane or ROI {}", k + 1),
            ));
        }
    }
    let space = spaces.first().copied().unwrap_or_default();
    if space == Space::Unknown && !markups.is_empty() {
        collected.notes.push(UNSTATED.into());
    }
    Ok(PickedPoints { planes, rois, ..collected.finish(space) })
}

/// Text or number as text.
fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// A value with its place.
struct Item<'a> {
    path: &'a Path,
    place: String,
    value: &'a Value,
}

impl<'a> Item<'a> {
    fn fault(&self, key: &str, message: impl Into<String>) -> FileError {
        FileError::content(self.path, format!("{}.{key}", self.place), message)
    }

    fn check_units(&self) -> Result<(), FileError> {
        let units = match self.value.get("coordinateUnits") {
            None | Some(Value::Null) => return Ok(()),
            Some(Value::Array(units)) => units.iter().map(plain).collect(),
            Some(unit) => vec![plain(unit)],
        };
        match units.iter().find(|unit| !matches!(unit.as_str(), "mm" | "millimeter" | "millimetre")) {
            Some(unit) => Err(self.fault("coordinateUnits", format!("the unit is \"{unit}\"; save the markups in mm"))),
            None => Ok(()),
        }
    }

    fn control_points(&self) -> Result<Vec<Item<'a>>, FileError> {
        match self.value.get("controlPoints") {
            None | Some(Value::Null) => Ok(Vec::new()),
            Some(Value::Array(points)) => Ok(points
                .iter()
                .enumerate()
                .map(|(k, value)| Item { path: self.path, place: format!("{}.controlPoints[{k}]", self.place), value })
                .collect()),
            Some(_) => Err(self.fault("controlPoints", "a list is expected")),
        }
    }

    fn label(&self) -> &'a str {
        self.value.get("label").and_then(Value::as_str).unwrap_or_default()
    }

    /// The position; none if it was not set.
    fn position(&self) -> Result<Option<[f64; 3]>, FileError> {
        match self.value.get("positionStatus").map(plain).as_deref() {
            None | Some("defined") => {}
            Some("undefined" | "missing" | "preview") => return Ok(None),
            Some(other) => {
                let message = format!("\"{other}\" is unknown; defined, undefined, missing or preview is expected");
                return Err(self.fault("positionStatus", message));
            }
        }
        self.numbers::<3>("position").map(Some)
    }

    fn numbers<const N: usize>(&self, key: &str) -> Result<[f64; N], FileError> {
        let numbers = self.value.get(key).and_then(json::numbers);
        numbers.ok_or_else(|| self.fault(key, format!("{N} finite numbers are expected")))
    }

    fn has(&self, key: &str) -> bool {
        self.value.get(key).is_some_and(|value| !value.is_null())
    }

    /// The name of a plane or box: its own, or that of its first control point.
    fn name(&self, otherwise: String) -> Result<String, FileError> {
        let own = self.value.get("name").and_then(Value::as_str).filter(|name| !name.trim().is_empty());
        let first = self.control_points()?.first().map(|point| point.label()).filter(|label| !label.trim().is_empty());
        Ok(own.or(first).map_or(otherwise, |name| name.trim().to_owned()))
    }

    /// Three coordinates.
    fn place(&self, key: &str, space: Space) -> Result<Point3<f64>, FileError> {
        let numbers = self.numbers(key)?;
        TooFar::check(&numbers).map_err(|far| self.fault(key, far.to_string()))?;
        Ok(to_lps(numbers, space))
    }

    fn center(&self, space: Space) -> Result<Point3<f64>, FileError> {
        self.place(if self.has("center") { "center" } else { "origin" }, space)
    }

    /// The rotation from the box's or plane's own axes to LPS.
    fn axes(&self, space: Space) -> Result<Rotation3<f64>, FileError> {
        let rows = self.numbers::<9>("orientation")?;
        let sign = space.x_y_sign();
        let matrix = Matrix3::from_diagonal(&Vector3::new(sign, sign, 1.0)) * Matrix3::from_row_slice(&rows);
        let nearest =
            nearest_isometry(&matrix.to_homogeneous()).map_err(|error| self.fault("orientation", error.to_string()))?;
        Ok(nearest.value.rotation.to_rotation_matrix())
    }

    /// The plane; none if it was not placed.
    fn plane(&self, space: Space, k: usize, notes: &mut Vec<String>) -> Result<Option<PickedPlane>, FileError> {
        let name = self.name(format!("plane_{}", k + 1))?.into();
        let (origin, normal) = if self.has("center") || self.has("origin") {
            let normal = if self.has("normal") {
                to_lps(self.numbers("normal")?, space).coords
            } else {
                self.axes(space)? * Vector3::z()
            };
            (self.center(space)?, normal)
        } else {
            // Before version 5 a plane was three points.
            let points = self.control_points()?;
            let positions = points.iter().map(Item::position).collect::<Result<Vec<_>, _>>()?;
            let defined: Vec<Point3<f64>> = positions.into_iter().flatten().map(|p| to_lps(p, space)).collect();
            if let Some(far) = defined.iter().find_map(|p| TooFar::check(p.coords.as_slice()).err()) {
                return Err(self.fault("controlPoints", far.to_string()));
            }
            match defined[..] {
                [] => return Ok(None),
                [a, b, c] => {
                    notes.push(format!("plane \"{name}\" has no normal; it is taken through its three points"));
                    (a, (b - a).cross(&(c - a)))
                }
                _ => {
                    let message =
                        format!("neither center and normal nor three points are given, but {} points", defined.len());
                    return Err(self.fault("center", message));
                }
            }
        };
        let normal: Unit<Vector3<f64>> = direction(normal).map_err(|error| self.fault("normal", error))?;
        Ok(Some(PickedPlane { name, origin, normal }))
    }

    fn roi(&self, space: Space, k: usize, notes: &mut Vec<String>) -> Result<PickedRoi, FileError> {
        let name: std::sync::Arc<str> = self.name(format!("roi_{}", k + 1))?.into();
        let axes = if self.has("orientation") {
            self.axes(space)?
        } else {
            notes.push(format!("ROI \"{name}\" has no orientation; it is taken along the axes"));
            Rotation3::identity()
        };
        let size_mm = self.place("size", Space::Lps)?.coords;
        if size_mm.iter().any(|&edge| edge <= 0.0) {
            return Err(self.fault("size", "three edges above 0 are expected"));
        }
        if self.value.get("insideOut").and_then(Value::as_bool) == Some(true) {
            notes.push(format!("ROI \"{name}\" is inside out: what is outside of it is meant"));
        }
        Ok(PickedRoi { name, center: self.center(space)?, axes, size_mm })
    }
}

/// The columns of a `.fcsv` file that does not name them.
const COLUMNS: &str = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID";

/// The points in a `.fcsv` file.
pub(super) fn fcsv(path: &Path, bytes: &[u8]) -> Result<PickedPoints, FileError> {
    let mut cursor = Cursor::text(path, bytes)?;
    let mut collected = Collected::default();
    let mut space = None;
    let mut columns: Vec<String> = COLUMNS.split(',').map(str::to_owned).collect();
    while let Some(line) = cursor.filled_line() {
        let fault = |message: String| cursor.fault(message);
        if let Some(comment) = line.trim_start().strip_prefix('#') {
            match comment.split_once('=').map(|(key, value)| (key.trim(), value.trim())) {
                Some(("CoordinateSystem", value)) => {
                    let stated = space_of(value).map_err(fault)?;
                    if space.is_some_and(|space| space != stated) || !collected.points.is_empty() {
                        return Err(cursor.fault("the coordinate system is stated once, before the points"));
                    }
                    space = Some(stated);
                }
                Some(("columns", value)) => {
                    columns = value.split(',').map(|name| name.trim().to_owned()).collect();
                    twice(&columns, |a, b| a == b).map_err(fault)?;
                }
                _ => {}
            }
            continue;
        }
        let cells = quoted_cells(&line, ',');
        let wrong_width = || format!("{} columns are expected, this line has {}", columns.len(), cells.len());
        let cell = |name: &str| -> Result<&str, FileError> {
            let place = columns.iter().position(|column| column == name);
            let place = place.ok_or_else(|| fault(format!("\"# columns\" has no \"{name}\"")))?;
            Ok(cells.get(place).ok_or_else(|| fault(wrong_width()))?.trim())
        };
        // Newer versions add the status of the position and another number, without a name.
        if cells.len() > columns.len() + 2 {
            return Err(fault(wrong_width()));
        }
        let status = cells.get(columns.len()).map(|status| status.trim());
        if status.is_some_and(|status| !matches!(status, "2" | "")) {
            collected.n_skipped += 1;
            continue;
        }
        let value = |name: &str| {
            let cell = cell(name)?;
            scalar::number(cell).ok_or_else(|| fault(format!("{name} is \"{cell}\"; a number is expected")))
        };
        let position = [value("x")?, value("y")?, value("z")?];
        collected.push(cell("label")?, position, space.unwrap_or_default()).map_err(fault)?;
    }
    if space.is_none() {
        collected.notes.push(UNSTATED.into());
    }
    Ok(collected.finish(space.unwrap_or_default()))
}
