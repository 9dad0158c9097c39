//! The surgical plan as JSON, mm, in the CT's coordinates; also [of what was drawn in 3D Slicer](plan_of_picked).
//!
//! ```json
//! { "units": "mm",
//!   "landmarks":  { "P1": [-86.0, -84.7, -954.7], "P2": [-92.4, -90.0, -924.6], "P3": [-85.0, -83.2, -929.7] },
//!   "assessment": { "M1": [-94.2, -90.7, -969.7] },
//!   "planes":     [ [[1,0,0,-85.6], [0,1,0,-85.3], [0,0,1,-874.6], [0,0,0,1]] ],
//!   "pca_axes_columns_xyz":        [[1,0,0], [0,1,0], [0,0,1]],
//!   "malleolus_tip": [-92.7, -85.2, -1054.9], "proximal": [0,0,1], "lateral": [-1,0,0], "posterior": [0,1,0],
//!   "phantom_marker_in_phantom":   [[1,0,0,-55], [0,1,0,-48], [0,0,1,30], [0,0,0,1]],
//!   "camera_marker_nominal_C_T_Mc": [[1,0,0,32], [0,1,0,-61], [0,0,1,-18], [0,0,0,1]],
//!   "surface": { "sha256": "9f86d0..", "frame_of_reference_uid": "1.2.840.1", "points": [[-86.0, -84.7, -954.7]] } }
//! ```
//!
//! Matrices are written row by row. Planes are `t_ct_plane`, the plane's own z axis being its normal; they are called
//! `plane_1`, `plane_2` .. unless `planes` is an object of names, or its entries are objects with `name` and `matrix`.
//! `proximal`, `lateral` and `posterior` are directions of any length. Every key may be missing, but not all of them; keys that are not
//! read are noted. `surface` binds the plan to the surface that it was drawn on; one of its keys suffices. A file for several bones has such an object under each bone's name, as [`read_plan_of`] takes it.

mod picked;

pub use picked::{PlanRole, plan_of_picked};

use crate::{
    FileError, input, json,
    picked_points::parse_picked_points,
    scene_header::{is_bundle, is_scene},
};
use nalgebra::{Isometry3, Matrix3, Matrix4, Point3, Unit, Vector3};
use osteoflow_geometry::{
    Anatomy, Axes, Corrections, NamedPoint, Plane, Planes, Points, Pose, SurfaceKey, SurgicalPlan, TooFar, direction,
    matrix_rows, nearest_isometry,
};
use serde_json::{Map, Value, json};
use std::{cell::RefCell, path::Path};

/// A plan read from a file.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanRead {
    /// The plan.
    pub plan: SurgicalPlan,
    /// Changes to the numbers and keys that were not read, one sentence each.
    pub notes: Vec<String>,
    /// The keys that were not read.
    pub unread: Vec<String>,
}

/// Reads a plan: its own JSON, or markups and scenes of 3D Slicer as [`plan_of_picked`] takes them. Its rotations may be
/// rounded: the nearest ones are taken, and a note says how far they are.
///
/// # Errors
/// [`FileError`] naming the key: a unit other than mm, a number that is none, a matrix that mirrors or scales.
pub fn read_plan(path: &Path) -> Result<PlanRead, FileError> {
    let bytes = input::read(path)?;
    let drawn = |bytes: &[u8]| plan_of_picked(path, &parse_picked_points(path, bytes)?, &[]);
    if is_bundle(&bytes) || is_scene(&bytes) {
        return drawn(&bytes);
    }
    let text = input::text_of(path, bytes)?;
    let root = parse_root(path, &text)?;
    if root.contains_key("markups") && !has_keys(&root) { drawn(text.as_bytes()) } else { noted(path, &root) }
}

impl PlanRead {
    /// With what the plan in a file has and this one lacks, see [`SurgicalPlan::completed_by`]; a note says what that is.
    ///
    /// # Errors
    /// As [`read_plan`].
    pub fn completed_by(mut self, file: Option<&Path>) -> Result<Self, FileError> {
        if let Some(file) = file {
            let other = read_plan(file)?;
            self.notes.extend(other.notes);
            let before = parts_of_rest(&self.plan);
            let taken: Vec<&str> =
                parts_of_rest(&other.plan).into_iter().filter(|part| !before.contains(part)).collect();
            self.plan = self.plan.completed_by(other.plan);
            self.notes.push(match &taken[..] {
                [] => format!("{}: it has nothing that the plan lacks, so nothing of it is taken", file.display()),
                _ => {
                    let is_of_patient = taken.iter().any(|part| ["axes", "anatomy"].contains(part));
                    let whose = if is_of_patient { "; axes and anatomy are right on the same CT only" } else { "" };
                    format!("{}: taken from it: {}{whose}", file.display(), taken.join(", "))
                }
            });
        }
        Ok(self)
    }
}

/// What a plan has of that which another may be completed by.
fn parts_of_rest(plan: &SurgicalPlan) -> Vec<&'static str> {
    let parts = [
        ("axes", plan.axes.is_some()),
        ("anatomy", plan.anatomy.is_some()),
        ("pose of the phantom's marker", plan.t_phantom_phantom_marker.is_some()),
        ("nominal pose of the camera's marker", plan.t_camera_camera_marker_nominal.is_some()),
    ];
    parts.into_iter().filter(|(_, is_there)| *is_there).map(|(name, _)| name).collect()
}

/// Reads the plan of one bone: from the object under the key `bone` if the file has one, else as [`read_plan`].
///
/// # Errors
/// As [`read_plan`]; and if the file is for several bones, but not for this one.
pub fn read_plan_of(path: &Path, bone: &str) -> Result<PlanRead, FileError> {
    let text = input::read_text(path)?;
    let root = parse_root(path, &text)?;
    if let Some(Value::Object(own)) = root.get(bone) {
        // What else a table of bones holds is not the plan's.
        return plan_of(path, own).map(|read| PlanRead { unread: Vec::new(), ..read });
    }
    let bones: Vec<&str> = root.iter().filter(|(_, value)| value.is_object()).map(|(key, _)| key.as_str()).collect();
    if !bones.is_empty() && !OWN_KEYS.iter().any(|key| root.contains_key(*key)) {
        let message = format!(
            "the file has plans for {}, not for \"{bone}\"; give the bone's file and its key the same name",
            bones.join(", ")
        );
        return Err(FileError::content(path, "the outermost object", message));
    }
    noted(path, &root)
}

/// Keys by which the outermost object is a plan itself.
const OWN_KEYS: [&str; 6] = ["units", "landmarks", "assessment", "planes", "malleolus_tip", "proximal"];

/// Reads a plan from its text, such as a recording's attachment `plan.json`; `path` stands for the file in errors.
///
/// # Errors
/// As [`read_plan`].
pub fn parse_plan(path: &Path, text: &str) -> Result<PlanRead, FileError> {
    noted(path, &parse_root(path, text)?)
}

/// The plan, with a note on the keys that were not read.
fn noted(path: &Path, root: &Map<String, Value>) -> Result<PlanRead, FileError> {
    let mut read = plan_of(path, root)?;
    if !read.unread.is_empty() {
        let message = "a plan has no such keys, and they were not read";
        read.notes.push(format!(
            "{}: {message}: {}; a plan's are {}",
            path.display(),
            read.unread.join(", "),
            KEYS.join(", ")
        ));
    }
    Ok(read)
}

fn parse_root(path: &Path, text: &str) -> Result<Map<String, Value>, FileError> {
    let text = text.trim_start_matches('\u{feff}');
    let root: Value = json::parse(text).map_err(|error| {
        let place = format!("line {}, column {}", error.line(), error.column());
        FileError::content(
            path,
            place,
            format!("this is no JSON of a plan (which knows no NaN, no comments and no key twice): {error}"),
        )
    })?;
    let Value::Object(root) = root else {
        return Err(FileError::content(path, "line 1", "a plan is a JSON object with keys such as \"landmarks\""));
    };
    Ok(root)
}

/// The keys that are read, but for units and frame.
const KEYS: [&str; 12] = [
    "landmarks",
    "assessment",
    "planes",
    "pca_axes_columns_xyz",
    "pca_axes_centre",
    "malleolus_tip",
    "proximal",
    "lateral",
    "posterior",
    "phantom_marker_in_phantom",
    "camera_marker_nominal_C_T_Mc",
    SURFACE,
];

/// The key of the surface that the plan was drawn on.
pub const SURFACE: &str = "surface";

/// Minimum number of points that identify a surface: the fewest corners of a closed one.
const MIN_POINTS: usize = 4;

/// Keys that state the unit of length, as [`names`] compares them.
const UNITS: [&str; 4] = ["units", "unit", "lengthunit", "coordinateunits"];

/// Keys that state the space, as [`names`] compares them.
const SPACES: [&str; 3] = ["frame", "space", "coordinatesystem"];

/// Keys for people.
const REMARKS: [&str; 7] = ["$schema", "mesh", "name", "side", "description", "comment", "note"];

fn has_keys(root: &Map<String, Value>) -> bool {
    KEYS.iter().any(|key| *key != SURFACE && root.contains_key(*key))
}

/// Whether an object is a plan, or holds those of several bones.
pub(crate) fn is_plan(root: &Map<String, Value>) -> bool {
    has_keys(root) || root.values().filter_map(Value::as_object).any(has_keys)
}

/// The plan, without a note on the keys that were not read.
fn plan_of(path: &Path, root: &Map<String, Value>) -> Result<PlanRead, FileError> {
    if !has_keys(root) {
        let advice = if root.contains_key("markups") {
            "these are markups of 3D Slicer; osteoflow convert makes a plan of them"
        } else {
            "is this a plan?"
        };
        let message = format!("none of a plan's keys is there ({}); {advice}", KEYS.join(", "));
        return Err(FileError::content(path, "the outermost object", message));
    }
    let plan = Keys { path, root, corrections: RefCell::default() };
    plan.check_units()?;
    plan.check_frame()?;
    let landmarks = plan.points("landmarks")?;
    let assessment = plan.points("assessment")?;
    let axes = plan.axes(&landmarks, &assessment)?;
    let read = SurgicalPlan {
        planes: plan.planes()?,
        anatomy: plan.anatomy()?,
        t_phantom_phantom_marker: plan.pose("phantom_marker_in_phantom", "phantom", "phantom_marker")?,
        t_camera_camera_marker_nominal: plan.pose("camera_marker_nominal_C_T_Mc", "camera", "camera_marker")?,
        surface: plan.surface()?,
        landmarks,
        assessment,
        axes,
    };
    let notes = plan.corrections.take().note().map(|note| format!("{}: {note}", path.display()));
    let is_read = |key: &str| KEYS.contains(&key) || names(key, &UNITS) || names(key, &SPACES);
    let unread = root.keys().filter(|key| !is_read(key) && !is_remark(key));
    let mut notes: Vec<String> = notes.into_iter().collect();
    let anatomy = ["malleolus_tip", "proximal", "lateral", "posterior"];
    let missing: Vec<&str> = anatomy.into_iter().filter(|key| plan.get(key).is_none()).collect();
    if (1..anatomy.len()).contains(&missing.len()) {
        notes.push(format!("{}: the anatomy is not used, for it lacks {}", path.display(), missing.join(", ")));
    }
    Ok(PlanRead { plan: read, notes, unread: unread.cloned().collect() })
}

/// Whether a key is for people.
fn is_remark(key: &str) -> bool {
    REMARKS.contains(&key) || key.ends_with("_note")
}

/// Writes a plan so that [`read_plan`] gives it back; planes whose place is unknown are left out.
///
/// # Errors
/// [`FileError::Io`] if the file cannot be written.
pub fn write_plan(path: &Path, plan: &SurgicalPlan) -> Result<(), FileError> {
    let mut text = serde_json::to_string_pretty(&plan_json(plan)).expect("a plan is made of numbers and text");
    text.push('\n');
    osteoflow_container::durable::write(path, text).map_err(FileError::write(path))
}

/// A plan as [`write_plan`] writes it.
pub fn plan_json(plan: &SurgicalPlan) -> Value {
    let points = |points: &Points| -> Map<String, Value> {
        points.points.iter().map(|p| (p.name.to_string(), json!(p.position.coords.as_slice()))).collect()
    };
    let planes =
        plan.planes.planes.iter().filter_map(|p| Some(json!({"name": &*p.name, "matrix": matrix_rows(p.isometry()?)})));
    let mut root = json!({
        "units": "mm",
        "landmarks": points(&plan.landmarks),
        "assessment": points(&plan.assessment),
        "planes": planes.collect::<Vec<_>>(),
    });
    if let Some(axes) = &plan.axes {
        let row = |k: usize| axes.columns.row(k).iter().copied().collect::<Vec<f64>>();
        root["pca_axes_columns_xyz"] = json!([row(0), row(1), row(2)]);
        root["pca_axes_centre"] = json!(axes.centre.coords.as_slice());
    }
    if let Some(anatomy) = &plan.anatomy {
        root["malleolus_tip"] = json!(anatomy.malleolus_tip.coords.as_slice());
        root["proximal"] = json!(anatomy.proximal.as_slice());
        root["lateral"] = json!(anatomy.lateral.as_slice());
        root["posterior"] = json!(anatomy.posterior.as_slice());
    }
    if let Some(pose) = &plan.t_phantom_phantom_marker {
        root["phantom_marker_in_phantom"] = json!(matrix_rows(&pose.isometry));
    }
    if let Some(pose) = &plan.t_camera_camera_marker_nominal {
        root["camera_marker_nominal_C_T_Mc"] = json!(matrix_rows(&pose.isometry));
    }
    if let Some(key) = &plan.surface {
        root[SURFACE] = json!(key);
    }
    root
}

/// The text of a plan with this key of its surface in place of what it has; all else is as it was.
///
/// # Errors
/// As [`parse_plan`].
pub fn bound_to(path: &Path, text: &str, surface: &SurfaceKey) -> Result<String, FileError> {
    let mut root = parse_root(path, text)?;
    plan_of(path, &root)?;
    root.insert(SURFACE.into(), json!(surface));
    Ok(format!("{:#}\n", Value::Object(root)))
}

/// Whether a key is one of the names, in any case and with or without `_`.
fn names(key: &str, names: &[&str]) -> bool {
    names.contains(&key.replace('_', "").to_lowercase().as_str())
}

struct Keys<'a> {
    path: &'a Path,
    root: &'a Map<String, Value>,
    corrections: RefCell<Corrections>,
}

impl Keys<'_> {
    fn fault(&self, key: &str, message: impl Into<String>) -> FileError {
        FileError::content(self.path, format!("key \"{key}\""), message)
    }

    /// The value of a key; null counts as missing.
    fn get(&self, key: &str) -> Option<&Value> {
        self.root.get(key).filter(|v| !v.is_null())
    }

    fn check_units(&self) -> Result<(), FileError> {
        for (key, _) in self.root.iter().filter(|(key, _)| names(key, &UNITS)) {
            match self.get(key) {
                None => {}
                Some(Value::String(unit)) if unit == "mm" => {}
                Some(other) => {
                    let message = format!("a plan is in \"mm\", found {other}; convert its lengths to mm");
                    return Err(self.fault(key, message));
                }
            }
        }
        Ok(())
    }

    /// The frame, where it is stated, is CT's, in LPS.
    fn check_frame(&self) -> Result<(), FileError> {
        for (key, frame) in self.root {
            if !names(key, &SPACES) || frame.is_null() {
                continue;
            }
            let text = frame.as_str().unwrap_or_default().to_lowercase();
            let has = |word: &str| text.split(|c: char| !c.is_alphanumeric()).any(|other| other == word);
            if has("ras") {
                let message = format!("a plan is in LPS, found {frame}; negate x and y of its points and poses");
                return Err(self.fault(key, message));
            }
            if !has("ct") && !has("lps") {
                return Err(self.fault(key, format!("a plan is in \"ct\" (LPS), found {frame}")));
            }
        }
        Ok(())
    }

    /// `N` finite numbers.
    fn numbers<const N: usize>(&self, key: &str, value: &Value) -> Result<[f64; N], FileError> {
        json::numbers(value).ok_or_else(|| self.fault(key, format!("{N} numbers are expected, found {value}")))
    }

    /// A position, mm.
    fn place(&self, key: &str, value: &Value) -> Result<Point3<f64>, FileError> {
        let numbers: [f64; 3] = self.numbers(key, value)?;
        TooFar::check(&numbers).map_err(|far| self.fault(key, far.to_string()))?;
        Ok(numbers.into())
    }

    fn rows<const ROWS: usize, const COLUMNS: usize>(
        &self,
        key: &str,
        value: &Value,
    ) -> Result<[[f64; COLUMNS]; ROWS], FileError> {
        let rows = value.as_array().filter(|rows| rows.len() == ROWS);
        let rows = rows.ok_or_else(|| self.fault(key, format!("{ROWS} rows of {COLUMNS} numbers are expected")))?;
        let mut matrix = [[0.0; COLUMNS]; ROWS];
        for (k, (row, value)) in matrix.iter_mut().zip(rows).enumerate() {
            *row = self.numbers(&format!("{key}[{k}]"), value)?;
        }
        Ok(matrix)
    }

    fn isometry(&self, key: &str, value: &Value) -> Result<Isometry3<f64>, FileError> {
        let rows = self.rows::<4, 4>(key, value)?;
        self.rigid(key, &Matrix4::from_fn(|row, column| rows[row][column]))
    }

    fn rigid(&self, key: &str, matrix: &Matrix4<f64>) -> Result<Isometry3<f64>, FileError> {
        let nearest = nearest_isometry(matrix).map_err(|error| self.fault(key, error.to_string()))?;
        Ok(self.corrections.borrow_mut().take(nearest))
    }

    fn points(&self, key: &str) -> Result<Points, FileError> {
        let mut points = Vec::new();
        match self.get(key) {
            None => {}
            Some(Value::Object(named)) => {
                for (name, value) in named {
                    let place = self.place(&format!("{key}.{name}"), value)?;
                    points.push(NamedPoint::new(name.as_str(), place));
                }
            }
            Some(_) => {
                return Err(self.fault(key, "an object of named points is expected, such as {\"P1\": [x, y, z]}"));
            }
        }
        Ok(Points::new("ct", points))
    }

    fn planes(&self) -> Result<Planes, FileError> {
        // Each plane with its name and, for messages, its key.
        let named: Vec<(String, String, &Value)> = match self.get("planes") {
            None => Vec::new(),
            Some(Value::Object(named)) => {
                named.iter().map(|(name, value)| (name.clone(), format!("planes.{name}"), value)).collect()
            }
            Some(Value::Array(list)) => {
                let keyed = list.iter().enumerate().map(|(k, value)| {
                    let key = format!("planes[{k}]");
                    let name = match value.get("name") {
                        None | Some(Value::Null) => format!("plane_{}", k + 1),
                        Some(Value::String(name)) => name.clone(),
                        Some(other) => return Err(self.fault(&key, format!("a plane's name is a text, found {other}"))),
                    };
                    Ok((name, key, value))
                });
                keyed.collect::<Result<_, _>>()?
            }
            Some(_) => return Err(self.fault("planes", "a list of 4 x 4 matrices is expected")),
        };
        for (k, (name, key, value)) in named.iter().enumerate() {
            if named[..k].iter().any(|(other, ..)| other == name) {
                return Err(self.fault(key, format!("the name {name} is given twice; name each plane once")));
            }
            let is_known = |key: &str| ["name", "matrix"].contains(&key) || is_remark(key);
            if let Some(other) = value.as_object().and_then(|entry| entry.keys().find(|other| !is_known(other))) {
                let message = format!("a plane has no key \"{other}\"; its keys are name and matrix");
                return Err(self.fault(key, message));
            }
        }
        let plane = |(name, key, value): (String, String, &Value)| {
            let matrix = value.get("matrix").unwrap_or(value);
            Ok(Plane::new(name, self.isometry(&key, matrix)?))
        };
        Ok(Planes::new("ct", named.into_iter().map(plane).collect::<Result<Vec<_>, FileError>>()?))
    }

    fn pose(&self, key: &str, to: &str, from: &str) -> Result<Option<Pose>, FileError> {
        let isometry = self.get(key).map(|value| self.isometry(key, value)).transpose()?;
        Ok(isometry.map(|isometry| Pose::new(to, from, isometry)))
    }

    /// The axes. Their origin only matters for drawing; without a centre it is the mean of the plan's points.
    fn axes(&self, landmarks: &Points, assessment: &Points) -> Result<Option<Axes>, FileError> {
        let key = "pca_axes_columns_xyz";
        let Some(value) = self.get(key) else { return Ok(None) };
        let rows = self.rows::<3, 3>(key, value)?;
        let mut matrix = Matrix4::identity();
        matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::from_fn(|row, column| rows[row][column]));
        let rotation = self.rigid(key, &matrix)?;
        let centre = match self.get("pca_axes_centre") {
            Some(value) => self.place("pca_axes_centre", value)?,
            None => {
                let places: Vec<Point3<f64>> =
                    landmarks.positions().into_iter().chain(assessment.positions()).collect();
                let sum: Vector3<f64> = places.iter().map(|p| p.coords).sum();
                (sum / places.len().max(1) as f64).into()
            }
        };
        Ok(Some(Axes { frame: "ct".into(), centre, columns: *rotation.rotation.to_rotation_matrix().matrix() }))
    }

    /// The surface that the plan was drawn on.
    fn surface(&self) -> Result<Option<SurfaceKey>, FileError> {
        let parts = match self.get(SURFACE) {
            None => return Ok(None),
            Some(Value::Object(parts)) => parts,
            Some(other) => {
                let message =
                    format!("an object with sha256, frame_of_reference_uid or points is expected, found {other}");
                return Err(self.fault(SURFACE, message));
            }
        };
        let mut key = SurfaceKey::default();
        for (part, value) in parts.iter().filter(|(_, value)| !value.is_null()) {
            let name = format!("{SURFACE}.{part}");
            match part.as_str() {
                "sha256" => {
                    let is_digest = |text: &&str| text.len() == 64 && text.bytes().all(|b| b.is_ascii_hexdigit());
                    let digest = value.as_str().filter(is_digest);
                    let digest = digest.ok_or_else(|| {
                        self.fault(&name, format!("64 hexadecimal digits are expected, found {value}"))
                    })?;
                    key.sha256 = Some(digest.to_ascii_lowercase());
                }
                "frame_of_reference_uid" => {
                    let is_uid =
                        |text: &&str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit() || b == b'.');
                    let uid = value.as_str().filter(is_uid);
                    let uid =
                        uid.ok_or_else(|| self.fault(&name, format!("digits and dots are expected, found {value}")))?;
                    key.frame_of_reference_uid = Some(uid.into());
                }
                "points" => {
                    let list = value.as_array().ok_or_else(|| self.fault(&name, "a list of points is expected"))?;
                    let place = |(k, point)| Ok(self.place(&format!("{name}[{k}]"), point)?.into());
                    key.points = list.iter().enumerate().map(place).collect::<Result<_, FileError>>()?;
                    if key.points.len() < MIN_POINTS {
                        let message = format!(
                            "{} points are too few to tell one surface from another, {MIN_POINTS} are needed; write them with \
                             osteoflow convert PLAN OUT --bind BONE",
                            key.points.len()
                        );
                        return Err(self.fault(&name, message));
                    }
                }
                _ if is_remark(part) => {}
                _ => {
                    let message = "a surface has no such key; its keys are sha256, frame_of_reference_uid and points";
                    return Err(self.fault(&name, message));
                }
            }
        }
        Ok((key != SurfaceKey::default()).then_some(key))
    }

    /// The anatomy, if the plan has all of it.
    fn anatomy(&self) -> Result<Option<Anatomy>, FileError> {
        let unit = |key: &str| -> Result<Option<Unit<Vector3<f64>>>, FileError> {
            let Some(value) = self.get(key) else { return Ok(None) };
            let vector = Vector3::from(self.numbers::<3>(key, value)?);
            Ok(Some(direction(vector).map_err(|error| self.fault(key, error))?))
        };
        let tip = self.get("malleolus_tip").map(|value| self.place("malleolus_tip", value)).transpose()?;
        let (proximal, lateral, posterior) = (unit("proximal")?, unit("lateral")?, unit("posterior")?);
        let (Some(tip), Some(proximal), Some(lateral), Some(posterior)) = (tip, proximal, lateral, posterior) else {
            return Ok(None);
        };
        Ok(Some(Anatomy { malleolus_tip: tip, proximal, lateral, posterior }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(value: &Value) -> Result<SurgicalPlan, FileError> {
        parse_plan("plan.json".as_ref(), &value.to_string()).map(|read| read.plan)
    }

    fn example() -> SurgicalPlan {
        let point = |name: &str, x: f64| NamedPoint::new(name, Point3::new(x, -2.0 / 3.0, 1e-3));
        let motion = |x: f64| Isometry3::new(Vector3::new(x, 5.0, -900.0), Vector3::new(0.3, -1.0, x / 9.0));
        SurgicalPlan {
            landmarks: Points::new("ct", [point("P2", 1.0), point("P10", 2.0), point("P1", 3.0)]),
            assessment: Points::new("ct", [point("M1", 4.0)]),
            planes: Planes::new("ct", [Plane::new("distal", motion(1.0)), Plane::new("proximal", motion(2.0))]),
            axes: Some(Axes {
                frame: "ct".into(),
                centre: Point3::new(1.0, 2.0, 3.0),
                columns: *motion(3.0).rotation.to_rotation_matrix().matrix(),
            }),
            anatomy: Some(Anatomy {
                malleolus_tip: Point3::new(-92.0, -85.0, -1054.0),
                proximal: Vector3::z_axis(),
                lateral: -Vector3::x_axis(),
                posterior: Vector3::y_axis(),
            }),
            t_phantom_phantom_marker: Some(Pose::new("phantom", "phantom_marker", motion(4.0))),
            t_camera_camera_marker_nominal: Some(Pose::new("camera", "camera_marker", motion(5.0))),
            surface: Some(SurfaceKey {
                sha256: Some("0123456789abcdef".repeat(4)),
                frame_of_reference_uid: Some("1.2.840.113".into()),
                points: vec![[1.0 / 3.0, -2e-7, 955.125]; MIN_POINTS],
            }),
        }
    }

    #[test]
    fn a_plan_survives_being_written_with_its_points_in_their_order() {
        let file = tempfile::NamedTempFile::new().unwrap();
        write_plan(file.path(), &example()).unwrap();
        let PlanRead { plan: back, notes, .. } = read_plan(file.path()).unwrap();
        assert_eq!(notes, [""; 0]);
        assert_eq!(
            (&back.landmarks, &back.assessment, &back.anatomy, &back.surface),
            (&example().landmarks, &example().assessment, &example().anatomy, &example().surface)
        );
        let off = |a: &Isometry3<f64>, b: &Isometry3<f64>| (a.to_homogeneous() - b.to_homogeneous()).amax();
        for (a, b) in back.planes.planes.iter().zip(example().planes.planes.iter()) {
            assert_eq!(a.name, b.name);
            assert!(off(a.isometry().unwrap(), b.isometry().unwrap()) < 1e-12);
        }
        assert!((back.axes.as_ref().unwrap().columns - example().axes.unwrap().columns).amax() < 1e-12);
        let poses = |p: &SurgicalPlan| {
            [p.t_phantom_phantom_marker.clone().unwrap(), p.t_camera_camera_marker_nominal.clone().unwrap()]
        };
        for (a, b) in poses(&back).iter().zip(&poses(&example())) {
            assert!(a.to == b.to && a.from == b.from && off(&a.isometry, &b.isometry) < 1e-12);
        }
    }

    #[test]
    fn missing_keys_are_absent_and_keys_that_are_not_read_are_noted() {
        let text = json!({"surgeon": "N. N.", "planes": null, "planes_note": "two", "frame": "CT (LPS)"}).to_string();
        let read = parse_plan("plan.json".as_ref(), &text).unwrap();
        assert!(
            read.notes.len() == 1 && read.notes[0].contains("were not read: surgeon; a plan's are "),
            "{:?}",
            read.notes
        );
        let plan = read.plan;
        assert!(plan.landmarks.points.is_empty() && plan.planes.planes.is_empty());
        assert!(plan.axes.is_none() && plan.anatomy.is_none() && plan.t_phantom_phantom_marker.is_none());
    }

    #[test]
    fn a_file_for_several_bones_gives_the_one_asked_for_and_names_those_it_has() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let anatomy = |x: f64| json!({"malleolus_tip": [x, 0, 0], "proximal": [0, 0, 1], "lateral": [1, 0, 0], "posterior": [0, 1, 0]});
        let tip = |bone: &str| read_plan_of(file.path(), bone).map(|read| read.plan.anatomy.unwrap().malleolus_tip.x);
        std::fs::write(file.path(), json!({"left": anatomy(1.0), "right": anatomy(2.0)}).to_string()).unwrap();
        assert_eq!((tip("left").unwrap(), tip("right").unwrap()), (1.0, 2.0));
        let refusal = tip("middle").unwrap_err().to_string();
        assert!(refusal.contains("the file has plans for left, right, not for \"middle\""), "{refusal}");
        std::fs::write(file.path(), anatomy(3.0).to_string()).unwrap();
        assert_eq!(tip("middle").unwrap(), 3.0);
    }

    #[test]
    fn planes_are_numbered_unless_they_are_named() {
        let unit = json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 7], [0, 0, 0, 1]]);
        for (planes, names) in [
            (json!([unit, unit]), ["plane_1", "plane_2"]),
            (json!([unit, {"name": "proximal", "matrix": unit}]), ["plane_1", "proximal"]),
            (json!({"proximal": unit, "distal": unit}), ["proximal", "distal"]),
        ] {
            let plan = parse(&json!({"planes": planes})).unwrap();
            assert_eq!(plan.planes.planes.iter().map(|p| p.name.to_string()).collect::<Vec<_>>(), names);
            assert_eq!(plan.planes.planes[1].isometry().unwrap().translation.z, 7.0);
        }
    }

    #[test]
    fn units_and_spaces_under_any_name_are_heeded_and_nothing_is_given_twice() {
        let refusal = |text: &str| parse_plan("plan.json".as_ref(), text).unwrap_err().to_string();
        let plan = |more: &str| format!("{{ \"landmarks\": {{ \"P1\": [1, 2, 3] }}, {more} }}");
        let identity = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";
        for (more, expected) in [
            ("\"unit\": \"m\"".to_owned(), "key \"unit\": a plan is in \"mm\", found \"m\""),
            ("\"lengthUnit\": \"m\"".into(), "key \"lengthUnit\": a plan is in \"mm\""),
            ("\"coordinateUnits\": \"m\"".into(), "key \"coordinateUnits\": a plan is in \"mm\""),
            ("\"frame\": \"RAS\"".into(), "key \"frame\": a plan is in LPS, found \"RAS\""),
            ("\"coordinateSystem\": \"RAS\"".into(), "key \"coordinateSystem\": a plan is in LPS"),
            ("\"Space\": \"RAS\"".into(), "key \"Space\": a plan is in LPS"),
            ("\"landmarks\": {}".into(), "column 47: this is no JSON of a plan"),
            ("\"x\": { \"y\": 1, \"y\": 2 }".into(), "key \"y\" is given twice"),
            (
                format!(
                    "\"planes\": [{{\"name\": \"a\", \"matrix\": {identity}}}, {{\"name\": \"a\", \"matrix\": {identity}}}]"
                ),
                "key \"planes[1]\": the name a is given twice",
            ),
            (
                format!("\"planes\": [{{\"matrix\": {identity}, \"unit\": \"m\"}}]"),
                "key \"planes[0]\": a plane has no key \"unit\"",
            ),
            (format!("\"planes\": [{{\"name\": 7, \"matrix\": {identity}}}]"), "a plane's name is a text, found 7"),
            ("\"assessment\": { \"M1\": [1, 2, 1e8] }".into(), "key \"assessment.M1\": the coordinate 100000000.0 mm"),
            (
                "\"planes\": [[[1,0,0,0],[0,1,0,-1e45],[0,0,1,0],[0,0,0,1]]]".into(),
                "key \"planes[0]\": the translation: the coordinate -1e45 mm",
            ),
        ] {
            let refusal = refusal(&plan(&more));
            assert!(refusal.contains(expected), "{expected}\n{refusal}");
        }
        let read = parse_plan("plan.json".as_ref(), &plan("\"proximal\": [0, 0, 1]")).unwrap();
        assert!(read.notes[0].ends_with("the anatomy is not used, for it lacks malleolus_tip, lateral, posterior"));
    }

    #[test]
    fn rounded_matrices_give_the_nearest_rotations_and_one_note() {
        let text = plan_json(&example()).to_string();
        let mut value: Value = serde_json::from_str(&text).unwrap();
        let round = |cell: &mut Value| *cell = json!((cell.as_f64().unwrap() * 1e4).round() / 1e4);
        for plane in value["planes"].as_array_mut().unwrap() {
            plane["matrix"]
                .as_array_mut()
                .unwrap()
                .iter_mut()
                .flat_map(|row| row.as_array_mut().unwrap())
                .for_each(round);
        }
        let PlanRead { plan, notes, .. } = parse_plan("plan.json".as_ref(), &value.to_string()).unwrap();
        for (a, b) in plan.planes.planes.iter().zip(example().planes.planes.iter()) {
            let off = a.isometry().unwrap().rotation.angle_to(&b.isometry().unwrap().rotation);
            assert!(off > 1e-7 && off < 2e-4, "{off} rad: four decimals");
        }
        assert_eq!(notes.len(), 1, "{notes:?}");
        assert!(notes[0].starts_with("plan.json: 2 of 5 rotations are rounded"), "{}", notes[0]);
    }

    #[test]
    fn a_fault_names_its_key() {
        let matrix = |z: f64, last: f64| json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, z, 0], [0, 0, 0, last]]);
        for (plan, expected) in [
            (json!({"units": "m", "planes": []}), "key \"units\": a plan is in \"mm\", found \"m\""),
            (json!({"unit": "m", "planes": []}), "key \"unit\": a plan is in \"mm\", found \"m\""),
            (json!({"frame": "RAS", "planes": []}), "key \"frame\": a plan is in LPS, found \"RAS\"; negate x and y"),
            (json!({"frame": "world", "planes": []}), "key \"frame\": a plan is in \"ct\" (LPS), found \"world\""),
            (json!({"a": 1}), "the outermost object: none of a plan's keys is there (landmarks, "),
            (json!({"markups": []}), "these are markups of 3D Slicer; osteoflow convert makes a plan of them"),
            (json!({"landmarks": {"P1": [1, 2]}}), "key \"landmarks.P1\": 3 numbers are expected, found [1,2]"),
            (json!({"landmarks": {"P1": [1, 2, null]}}), "key \"landmarks.P1\": 3 numbers are expected"),
            (json!({"landmarks": [[1, 2, 3]]}), "key \"landmarks\": an object of named points is expected"),
            (
                json!({"planes": [matrix(1.0, 1.0), matrix(-1.0, 1.0)]}),
                "key \"planes[1]\": the matrix is a mirror image",
            ),
            (
                json!({"phantom_marker_in_phantom": matrix(2.0, 1.0)}),
                "key \"phantom_marker_in_phantom\": the upper left 3 x 3",
            ),
            (
                json!({"camera_marker_nominal_C_T_Mc": matrix(1.0, 0.0)}),
                "key \"camera_marker_nominal_C_T_Mc\": the last row",
            ),
            (json!({"planes": {"distal": [[1]]}}), "key \"planes.distal\": 4 rows of 4 numbers are expected"),
            (
                json!({"pca_axes_columns_xyz": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}),
                "key \"pca_axes_columns_xyz\": the matrix is a mirror",
            ),
            (json!({"proximal": [0, 0, 0]}), "key \"proximal\": a direction has a length above zero, this one has 0e0"),
            (
                json!({"lateral": [1e200, 0, 0]}),
                "key \"lateral\": a direction has a length above zero, this one has inf",
            ),
            (
                json!({"planes": {"distal": [[0, 0, 0, 1], [0, 0, 0, 2], [0, 0, 0, 3], [0, 0, 0, 1]]}}),
                "key \"planes.distal\": the matrix is zero",
            ),
            (
                json!({"planes": [matrix(1.0011, 1.0)]}),
                "key \"planes[0]\": the upper left 3 x 3 is not a rotation: it is off by 1.1e-3 where 1e-3 is allowed",
            ),
            (
                json!({"planes": [], "surface": {"sha256": "abc"}}),
                "key \"surface.sha256\": 64 hexadecimal digits are expected, found \"abc\"",
            ),
            (
                json!({"planes": [], "surface": {"frame_of_reference_uid": "my CT"}}),
                "key \"surface.frame_of_reference_uid\": digits and dots are expected",
            ),
            (
                json!({"planes": [], "surface": {"points": [[1, 2]]}}),
                "key \"surface.points[0]\": 3 numbers are expected",
            ),
            (json!({"planes": [], "surface": {"points": [[1, 2, 3]]}}), "key \"surface.points\": 1 points are too few"),
            (json!({"planes": [], "surface": {"hash": "abc"}}), "key \"surface.hash\": a surface has no such key"),
            (
                json!({"planes": [], "surface": "bone.stl"}),
                "key \"surface\": an object with sha256, frame_of_reference_uid or points",
            ),
            (json!([]), "line 1: a plan is a JSON object"),
        ] {
            let refusal = parse(&plan).unwrap_err().to_string();
            assert!(refusal.starts_with("plan.json: ") && refusal.contains(expected), "{expected}\n{refusal}");
        }
        let refusal =
            parse_plan("plan.json".as_ref(), "{\"landmarks\": {\n\"P1\": [NaN, 0, 0]}}").unwrap_err().to_string();
        assert!(refusal.contains("line 2, column 8") && refusal.contains("no NaN"), "{refusal}");
    }
}
