//! Markups of 3D Slicer.
//!
//! # Source
//! The JSON schema "markups-schema-v1.0.3" of 3D Slicer, and its storage nodes for the fields that the schema leaves open, at 583e9b37:
//! coordinate system 0 is RAS and 1 is LPS; position status 2 is defined; a coded unit is of two or three texts, the second `UCUM`
//! (`vtkMRMLMarkupsJsonStorageNode.cxx`, `vtkMRMLJsonElement.cxx`). A plane is `baseToNode` times `objectToBase`, in LPS with two
//! rows of both negated, and `threePoints` span it from the first (`vtkMRMLMarkupsPlaneNode.cxx`). A name is not written; labels
//! begin with it, by `labelFormat`.

use super::collected::{Collected, PickedList, PickedPoints, PickedRoi, to_lps};
use crate::{
    FileError, Space,
    columns::{quoted_cells, twice},
    cursor::Cursor,
    json, scalar,
};
use nalgebra::{Isometry3, Matrix3, Matrix4, Point3, Rotation3, UnitQuaternion, Vector3, Vector4};
use osteoflow_geometry::{MM_PER_M, Plane, TooFar, direction, nearest_isometry};
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

/// How far the statements about a plane may be apart, mm and rad: beyond what six digits leave.
const CONTRADICTION_MM: f64 = 0.01;
const CONTRADICTION_RAD: f64 = 1e-3;

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
    let (mut planes, mut rois, mut lists) = (Vec::new(), Vec::new(), Vec::new());
    let mut spaces: Vec<Space> = Vec::new();
    for (k, markup) in markups.iter().enumerate() {
        let mut item = Item { path, place: format!("markups[{k}]"), value: markup, unit_mm: 1.0 };
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
        item.unit_mm = item.stated_unit()?;
        if item.unit_mm != 1.0 {
            collected
                .notes
                .push(format!("{}: its lengths were multiplied by {}, which gives mm", item.place, item.unit_mm));
        }
        let kind = markup.get("type").and_then(Value::as_str).unwrap_or_default();
        match kind {
            "Fiducial" | "Line" | "Curve" | "ClosedCurve" | "Angle" => {
                let begin = collected.points.len();
                for point in item.control_points()? {
                    match point.position()? {
                        Some(position) => collected
                            .push(point.label(), position, space)
                            .map_err(|message| fault(&point.place, &message))?,
                        None => collected.n_skipped += 1,
                    }
                }
                let points = begin..collected.points.len();
                let name = item.name()?.unwrap_or_default().into();
                lists.push(PickedList { name, kind: kind.into(), n_points: points.len(), points });
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
        planes.iter().map(|plane: &Plane| &*plane.name).collect::<Vec<_>>(),
        rois.iter().map(|roi: &PickedRoi| &*roi.name).collect(),
    ] {
        if let Some((k, name)) = names.iter().enumerate().find(|(k, name)| names[..*k].contains(name)) {
            return Err(fault(
                "markups",
                &format!("name \"{name}\" is given twice, at last to plane or ROI {}; name each once", k + 1),
            ));
        }
    }
    let space = spaces.first().copied().unwrap_or_default();
    if space == Space::Unknown && !markups.is_empty() {
        collected.notes.push(UNSTATED.into());
    }
    Ok(PickedPoints { planes, rois, lists, ..collected.finish(space) })
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
    /// The unit of its lengths.
    unit_mm: f64,
}

impl<'a> Item<'a> {
    fn fault(&self, key: &str, message: impl Into<String>) -> FileError {
        FileError::content(self.path, format!("{}.{key}", self.place), message)
    }

    /// The unit of length that `coordinateUnits` states, mm: a text, or a code, its scheme and perhaps its meaning.
    fn stated_unit(&self) -> Result<f64, FileError> {
        let texts =
            |list: &Vec<Value>| list.iter().map(|text| text.as_str().map(str::to_owned)).collect::<Option<Vec<_>>>();
        let unit = match self.value.get("coordinateUnits") {
            None | Some(Value::Null) => return Ok(1.0),
            Some(Value::String(unit)) => unit.clone(),
            Some(Value::Array(list)) => match texts(list).as_deref() {
                Some([code, scheme] | [code, scheme, _]) if scheme == "UCUM" => code.clone(),
                _ => {
                    let message =
                        format!("{}: a code, \"UCUM\" and a meaning are expected", Value::Array(list.clone()));
                    return Err(self.fault("coordinateUnits", message));
                }
            },
            Some(other) => {
                let message = format!("{other}: a text, or a list of code, \"UCUM\" and meaning is expected");
                return Err(self.fault("coordinateUnits", message));
            }
        };
        match unit.as_str() {
            "mm" | "millimeter" | "millimetre" => Ok(1.0),
            "um" => Ok(1e-3),
            "cm" => Ok(10.0),
            "m" => Ok(MM_PER_M),
            _ => {
                let message =
                    format!("the unit is \"{unit}\", which is none of mm, um, cm and m; save the markups in mm");
                Err(self.fault("coordinateUnits", message))
            }
        }
    }

    fn control_points(&self) -> Result<Vec<Item<'a>>, FileError> {
        match self.value.get("controlPoints") {
            None | Some(Value::Null) => Ok(Vec::new()),
            Some(Value::Array(points)) => Ok(points
                .iter()
                .enumerate()
                .map(|(k, value)| Item { value, place: format!("{}.controlPoints[{k}]", self.place), ..*self })
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
        self.lengths("position").map(Some)
    }

    fn numbers<const N: usize>(&self, key: &str) -> Result<[f64; N], FileError> {
        let numbers = self.value.get(key).and_then(json::numbers);
        numbers.ok_or_else(|| self.fault(key, format!("{N} finite numbers are expected")))
    }

    /// Three lengths, mm.
    fn lengths(&self, key: &str) -> Result<[f64; 3], FileError> {
        Ok(self.numbers(key)?.map(|length: f64| length * self.unit_mm))
    }

    fn has(&self, key: &str) -> bool {
        self.value.get(key).is_some_and(|value| !value.is_null())
    }

    /// Its name: its own, or what the label of its first control point begins with.
    fn name(&self) -> Result<Option<String>, FileError> {
        let text = |key: &str| self.value.get(key).and_then(Value::as_str);
        let own = text("name").filter(|name| !name.trim().is_empty());
        let first = self.control_points()?.first().map(|point| point.label()).filter(|label| !label.trim().is_empty());
        let before_number = |label: &'a str| match text("labelFormat") {
            Some("%N-%d") => label.rsplit_once('-').filter(|(_, number)| number.parse::<u64>().is_ok()),
            _ => None,
        };
        Ok(own.or(first.and_then(before_number).map(|(name, _)| name)).map(|name| name.trim().to_owned()))
    }

    /// The name of a plane or box: its own, or that of its first control point.
    fn name_or_label(&self, otherwise: String) -> Result<String, FileError> {
        let first = self.control_points()?.first().map(|point| point.label().trim().to_owned());
        Ok(self.name()?.or(first.filter(|label| !label.is_empty())).unwrap_or(otherwise))
    }

    /// Three coordinates.
    fn place(&self, key: &str, space: Space) -> Result<Point3<f64>, FileError> {
        let numbers = self.lengths(key)?;
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

    /// A 4 x 4 matrix, its lengths in mm.
    fn matrix(&self, key: &str) -> Result<Matrix4<f64>, FileError> {
        let mut matrix = Matrix4::from_row_slice(&self.numbers::<16>(key)?);
        matrix.fixed_view_mut::<3, 1>(0, 3).scale_mut(self.unit_mm);
        Ok(matrix)
    }

    /// The plane's pose by its matrices, in LPS.
    fn by_matrices(&self, space: Space) -> Result<Isometry3<f64>, FileError> {
        let turned = Matrix4::from_diagonal(&Vector4::new(-1.0, -1.0, 1.0, 1.0));
        let base = self.matrix("baseToNode")?;
        let object = if self.has("objectToBase") { self.matrix("objectToBase")? } else { turned };
        let pose = if space == Space::Ras { turned * base * object } else { base * turned * object };
        let nearest = nearest_isometry(&pose).map_err(|error| self.fault("baseToNode", error.to_string()))?;
        TooFar::check(nearest.value.translation.vector.as_slice())
            .map_err(|far| self.fault("baseToNode", far.to_string()))?;
        Ok(nearest.value)
    }

    /// The plane; none if it was not placed.
    fn plane(&self, space: Space, k: usize, notes: &mut Vec<String>) -> Result<Option<Plane>, FileError> {
        let name = self.name_or_label(format!("plane_{}", k + 1))?;
        let unit = |key: &str, vector| direction(vector).map_err(|error| self.fault(key, error));
        let points = self.control_points()?;
        let positions = points.iter().map(Item::position).collect::<Result<Vec<_>, _>>()?;
        let defined: Vec<Point3<f64>> = positions.into_iter().flatten().map(|p| to_lps(p, space)).collect();
        if let Some(far) = defined.iter().find_map(|p| TooFar::check(p.coords.as_slice()).err()) {
            return Err(self.fault("controlPoints", far.to_string()));
        }
        let kind = self.value.get("planeType").and_then(Value::as_str);
        let is_of_points = kind.is_none_or(|kind| kind == "threePoints");
        let by_points = match defined[..] {
            [a, b, c] if is_of_points => Some((a, unit("controlPoints", (b - a).cross(&(c - a)))?)),
            _ => None,
        };
        let by_matrices = if self.has("baseToNode") { Some(self.by_matrices(space)?) } else { None };
        let axes = if self.has("orientation") { Some(self.axes(space)?) } else { None };
        let normal = if self.has("normal") {
            Some(unit("normal", to_lps(self.numbers("normal")?, space).coords)?)
        } else {
            None
        };
        let center = if self.has("center") || self.has("origin") { Some(self.center(space)?) } else { None };
        let rotation = axes.map(UnitQuaternion::from).or(by_matrices.map(|pose| pose.rotation));
        let stated = normal.or(rotation.map(|rotation| rotation * Vector3::z_axis()));
        let (origin, normal) = match (center.or(by_matrices.map(|pose| pose * Point3::origin())), stated, by_points) {
            (Some(origin), Some(normal), _) => (origin, normal),
            (.., Some(of_points)) => {
                notes.push(format!("plane \"{name}\" has no normal; it is taken through its three points"));
                of_points
            }
            _ if defined.is_empty() && center.is_none() => return Ok(None),
            _ => {
                let message =
                    format!("neither center and normal nor three points are given, but {} points", defined.len());
                return Err(self.fault("center", message));
            }
        };
        // What a program reads must not depend on which of the statements it takes.
        let on_it: &[Point3<f64>] = if is_of_points {
            &defined
        } else {
            &defined[..usize::from(kind == Some("pointNormal")).min(defined.len())]
        };
        let others = [by_points, by_matrices.map(|pose| (pose * Point3::origin(), pose * Vector3::z_axis()))];
        let off = others.iter().flatten().map(|(point, _)| *point).chain(on_it.iter().copied());
        let off_mm = off.map(|point| (point - origin).dot(&normal).abs()).fold(0.0, f64::max);
        let other_normals =
            others.iter().flatten().map(|(_, other)| *other).chain(rotation.map(|r| r * Vector3::z_axis()));
        let off_rad = other_normals.map(|other| other.angle(&normal)).fold(0.0, f64::max);
        if off_mm > CONTRADICTION_MM || off_rad > CONTRADICTION_RAD {
            let message = format!(
                "center and normal are not those of its matrices, orientation and control points: {off_mm:.3} mm and {:.3} degrees off; \
                 which is meant? Load it in 3D Slicer, look, and save it again",
                off_rad.to_degrees()
            );
            return Err(self.fault("normal", message));
        }
        let leaning = rotation.unwrap_or_else(UnitQuaternion::identity);
        let z = leaning * Vector3::z();
        let half_turn = || UnitQuaternion::from_axis_angle(&(leaning * Vector3::x_axis()), std::f64::consts::PI);
        let rotation = UnitQuaternion::rotation_between(&z, &normal).unwrap_or_else(half_turn) * leaning;
        Ok(Some(Plane::new(name, Isometry3::from_parts(origin.into(), rotation))))
    }

    fn roi(&self, space: Space, k: usize, notes: &mut Vec<String>) -> Result<PickedRoi, FileError> {
        let name: std::sync::Arc<str> = self.name_or_label(format!("roi_{}", k + 1))?.into();
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
