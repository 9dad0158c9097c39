//! The surgical plan as JSON, mm, in the CT's coordinates.
//!
//! ```json
//! { "units": "mm",
//!   "landmarks":  { "P1": [-86.0, -84.7, -954.7], "P2": [-92.4, -90.0, -924.6], "P3": [-85.0, -83.2, -929.7] },
//!   "assessment": { "M1": [-94.2, -90.7, -969.7] },
//!   "planes":     [ [[1,0,0,-85.6], [0,1,0,-85.3], [0,0,1,-874.6], [0,0,0,1]] ],
//!   "pca_axes_columns_xyz":        [[1,0,0], [0,1,0], [0,0,1]],
//!   "malleolus_tip": [-92.7, -85.2, -1054.9], "proximal": [0,0,1], "lateral": [-1,0,0], "posterior": [0,1,0],
//!   "phantom_marker_in_phantom":   [[1,0,0,-55], [0,1,0,-48], [0,0,1,30], [0,0,0,1]],
//!   "camera_marker_nominal_C_T_Mc": [[1,0,0,32], [0,1,0,-61], [0,0,1,-18], [0,0,0,1]] }
//! ```
//!
//! Matrices are written row by row. Planes are `t_ct_plane`, the plane's own z axis being its normal; they are called
//! `plane_1`, `plane_2` .. unless `planes` is an object of names, or its entries are objects with `name` and `matrix`.
//! Every key may be missing; unknown keys are ignored.

use crate::FileError;
use nalgebra::{Matrix3, Matrix4, Point3, Unit, Vector3};
use osteoflow_geometry::{
    Anatomy, Axes, NamedPoint, Plane, Planes, Points, Pose, SurgicalPlan, isometry_from_matrix, matrix_rows,
};
use serde_json::{Map, Value, json};
use std::path::Path;

/// Reads a plan.
///
/// # Errors
/// [`FileError`] naming the key: a unit other than mm, a number that is none, a matrix that mirrors or scales.
pub fn read_plan(path: &Path) -> Result<SurgicalPlan, FileError> {
    let text = std::fs::read_to_string(path).map_err(FileError::read(path))?;
    parse_plan(path, &text)
}

/// Reads a plan from its text, such as a recording's attachment `plan.json`; `path` stands for the file in errors.
///
/// # Errors
/// As [`read_plan`].
pub fn parse_plan(path: &Path, text: &str) -> Result<SurgicalPlan, FileError> {
    let text = text.trim_start_matches('\u{feff}');
    let root: Value = serde_json::from_str(text).map_err(|error| {
        let place = format!("line {}, column {}", error.line(), error.column());
        FileError::content(path, place, format!("this is no JSON (which knows no NaN and no comments): {error}"))
    })?;
    let Value::Object(root) = root else {
        return Err(FileError::content(path, "line 1", "a plan is a JSON object with keys such as \"landmarks\""));
    };
    let plan = Keys { path, root: &root };
    plan.check_units()?;
    let landmarks = plan.points("landmarks")?;
    let assessment = plan.points("assessment")?;
    let axes = plan.axes(&landmarks, &assessment)?;
    Ok(SurgicalPlan {
        planes: plan.planes()?,
        anatomy: plan.anatomy()?,
        t_phantom_phantom_marker: plan.pose("phantom_marker_in_phantom", "phantom", "phantom_marker")?,
        t_camera_camera_marker_nominal: plan.pose("camera_marker_nominal_C_T_Mc", "camera", "camera_marker")?,
        landmarks,
        assessment,
        axes,
    })
}

/// Writes a plan so that [`read_plan`] gives it back; planes whose place is unknown are left out.
///
/// # Errors
/// [`FileError::Io`] if the file cannot be written.
pub fn write_plan(path: &Path, plan: &SurgicalPlan) -> Result<(), FileError> {
    let mut text = serde_json::to_string_pretty(&plan_json(plan)).expect("a plan is made of numbers and text");
    text.push('\n');
    std::fs::write(path, text).map_err(FileError::write(path))
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
    root
}

struct Keys<'a> {
    path: &'a Path,
    root: &'a Map<String, Value>,
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
        match self.get("units") {
            None => Ok(()),
            Some(Value::String(unit)) if unit == "mm" => Ok(()),
            Some(other) => {
                Err(self.fault("units", format!("a plan is in \"mm\", found {other}; convert its lengths to mm")))
            }
        }
    }

    /// `N` finite numbers.
    fn numbers<const N: usize>(&self, key: &str, value: &Value) -> Result<[f64; N], FileError> {
        let numbers: Option<Vec<f64>> =
            value.as_array().map(|a| a.iter().filter_map(Value::as_f64).filter(|n| n.is_finite()).collect());
        let whole = numbers.filter(|n| value.as_array().is_some_and(|a| a.len() == n.len()));
        whole
            .and_then(|n| n.try_into().ok())
            .ok_or_else(|| self.fault(key, format!("{N} numbers are expected, found {value}")))
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

    fn isometry(&self, key: &str, value: &Value) -> Result<nalgebra::Isometry3<f64>, FileError> {
        let rows = self.rows::<4, 4>(key, value)?;
        let matrix = Matrix4::from_fn(|row, column| rows[row][column]);
        isometry_from_matrix(&matrix).map_err(|error| self.fault(key, error.to_string()))
    }

    fn points(&self, key: &str) -> Result<Points, FileError> {
        let mut points = Vec::new();
        match self.get(key) {
            None => {}
            Some(Value::Object(named)) => {
                for (name, value) in named {
                    let place: [f64; 3] = self.numbers(&format!("{key}.{name}"), value)?;
                    points.push(NamedPoint::new(name.as_str(), place.into()));
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
                    let name = value["name"].as_str().map_or_else(|| format!("plane_{}", k + 1), str::to_owned);
                    (name, format!("planes[{k}]"), value)
                });
                keyed.collect()
            }
            Some(_) => return Err(self.fault("planes", "a list of 4 x 4 matrices is expected")),
        };
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

    /// The axes; where they cross only matters for drawing, so the mean of the plan's points does where no centre is given.
    fn axes(&self, landmarks: &Points, assessment: &Points) -> Result<Option<Axes>, FileError> {
        let key = "pca_axes_columns_xyz";
        let Some(value) = self.get(key) else { return Ok(None) };
        let rows = self.rows::<3, 3>(key, value)?;
        let mut matrix = Matrix4::identity();
        matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::from_fn(|row, column| rows[row][column]));
        let rotation = isometry_from_matrix(&matrix).map_err(|error| self.fault(key, error.to_string()))?;
        let centre = match self.get("pca_axes_centre") {
            Some(value) => self.numbers("pca_axes_centre", value)?.into(),
            None => {
                let places: Vec<Point3<f64>> =
                    landmarks.positions().into_iter().chain(assessment.positions()).collect();
                let sum: Vector3<f64> = places.iter().map(|p| p.coords).sum();
                (sum / places.len().max(1) as f64).into()
            }
        };
        Ok(Some(Axes { frame: "ct".into(), centre, columns: *rotation.rotation.to_rotation_matrix().matrix() }))
    }

    /// The anatomy, where the plan gives all of it.
    fn anatomy(&self) -> Result<Option<Anatomy>, FileError> {
        let direction = |key: &str| -> Result<Option<Unit<Vector3<f64>>>, FileError> {
            let Some(value) = self.get(key) else { return Ok(None) };
            let vector = Vector3::from(self.numbers::<3>(key, value)?);
            let unit = Unit::try_new(vector, 1e-6).ok_or_else(|| self.fault(key, "a direction cannot be zero"))?;
            Ok(Some(unit))
        };
        let tip = self.get("malleolus_tip").map(|value| self.numbers::<3>("malleolus_tip", value)).transpose()?;
        let (proximal, lateral, posterior) = (direction("proximal")?, direction("lateral")?, direction("posterior")?);
        let (Some(tip), Some(proximal), Some(lateral), Some(posterior)) = (tip, proximal, lateral, posterior) else {
            return Ok(None);
        };
        Ok(Some(Anatomy { malleolus_tip: tip.into(), proximal, lateral, posterior }))
    }
}
