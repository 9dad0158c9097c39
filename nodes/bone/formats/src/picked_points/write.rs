//! Lists of points for other programs.

use crate::{FileError, Space, write::NOTICE};
use nalgebra::{Isometry3, Matrix4, Point3, Vector3, Vector4};
use osteoflow_geometry::NamedPoint;
use serde_json::{Value, json};
use std::{fmt::Write as _, path::Path, sync::Arc};

/// The schema that a JSON of markups names.
const SCHEMA: &str = "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/markups-schema-v1.0.3.json#";

fn fault(path: &Path, place: impl Into<String>, message: &str) -> FileError {
    FileError::content(path, place, message)
}

/// Checks that the space can be stated.
fn check_stated(path: &Path, space: Space) -> Result<(), FileError> {
    if space == Space::Unknown {
        let message = "the format states LPS or RAS, but the space of the points is unknown; write CSV instead";
        return Err(fault(path, "space", message));
    }
    Ok(())
}

/// The position in the space that the file states.
fn stated(path: &Path, space: Space, point: &NamedPoint) -> Result<[f64; 3], FileError> {
    let sign = space.x_y_sign();
    let p = point.position;
    if !p.iter().all(|c| c.is_finite()) {
        return Err(fault(path, format!("point \"{}\"", point.name), "its position is not finite"));
    }
    Ok([sign * p.x, sign * p.y, p.z])
}

/// Writes points as a fiducial list of 3D Slicer in JSON; `points` are mm, LPS, and the file states `space`.
///
/// # Errors
/// [`FileError`] if the space is unknown, a point is not finite, or the file cannot be written.
pub fn write_mrk_json(path: &Path, points: &[NamedPoint], space: Space) -> Result<(), FileError> {
    osteoflow_container::durable::write(path, points_text(path, points, space)?).map_err(FileError::write(path))
}

/// The text of such a list.
pub(crate) fn points_text(path: &Path, points: &[NamedPoint], space: Space) -> Result<String, FileError> {
    check_stated(path, space)?;
    let control_point = |(k, point): (usize, &NamedPoint)| {
        Ok(control_point(k + 1, &point.name, json!({ "position": stated(path, space, point)? })))
    };
    let control_points = points.iter().enumerate().map(control_point).collect::<Result<Vec<_>, FileError>>()?;
    Ok(markups_text(&[markup("Fiducial", space, json!({ "controlPoints": control_points }))]))
}

/// Writes a box along the axes as a region of interest of 3D Slicer in JSON; mm, called LPS.
///
/// # Errors
/// [`FileError`] if the file cannot be written.
pub fn write_roi_mrk_json(path: &Path, name: &str, min: &Point3<f64>, max: &Point3<f64>) -> Result<(), FileError> {
    let center = nalgebra::center(min, max);
    let roi = json!({
        "name": name,
        "description": NOTICE,
        "roiType": "Box",
        "center": center.coords.as_slice(),
        "orientation": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "size": (max - min).as_slice(),
        "insideOut": false,
        "controlPoints": [control_point(1, name, json!({ "position": center.coords.as_slice() }))],
    });
    let text = markups_text(&[markup("ROI", Space::Lps, roi)]);
    osteoflow_container::durable::write(path, text).map_err(FileError::write(path))
}

/// The edge with which a plane is drawn, mm: wider than a fibula.
const PLANE_MM: f64 = 50.0;

/// Writes planes, by name and pose, as plane markups of 3D Slicer in JSON; mm, LPS. A plane's own z axis is its normal.
///
/// # Source
/// `vtkMRMLMarkupsPlaneJsonStorageNode.cxx` of 3D Slicer at 583e9b37: `size` has three numbers, and the first two rows of both
/// matrices change their sign in LPS, so that an `objectToBase` of no effect is -1, -1, 1, 1 in an LPS file.
///
/// # Errors
/// [`FileError`] if the file cannot be written.
pub fn write_planes_mrk_json(path: &Path, planes: &[(Arc<str>, Isometry3<f64>)]) -> Result<(), FileError> {
    osteoflow_container::durable::write(path, planes_text(planes)).map_err(FileError::write(path))
}

/// The text of such planes.
pub(crate) fn planes_text(planes: &[(Arc<str>, Isometry3<f64>)]) -> String {
    let half = PLANE_MM / 2.0;
    let rows = |matrix: &Matrix4<f64>| matrix.transpose().iter().copied().collect::<Vec<f64>>();
    let markups = planes.iter().map(|(name, pose)| {
        let center = pose.translation.vector.as_slice();
        let rotation: Vec<f64> = pose.rotation.to_rotation_matrix().matrix().transpose().iter().copied().collect();
        let plane = json!({
            "name": &**name,
            "planeType": "pointNormal",
            "sizeMode": "absolute",
            "autoScalingSizeFactor": 1.0,
            "center": center,
            "normal": (pose.rotation * Vector3::z()).as_slice(),
            "objectToBase": rows(&Matrix4::from_diagonal(&Vector4::new(-1.0, -1.0, 1.0, 1.0))),
            "baseToNode": rows(&pose.to_homogeneous()),
            "orientation": rotation,
            "size": [PLANE_MM, PLANE_MM, 0.0],
            "planeBounds": [-half, half, -half, half],
            "controlPoints": [control_point(1, name, json!({ "position": center, "orientation": rotation }))],
        });
        markup("Plane", Space::Lps, plane)
    });
    markups_text(&markups.collect::<Vec<_>>())
}

fn markup(kind: &str, space: Space, own: Value) -> Value {
    merged(json!({ "type": kind, "coordinateSystem": space.to_string(), "coordinateUnits": "mm" }), own)
}

fn control_point(id: usize, label: &str, own: Value) -> Value {
    let point = json!({ "id": id.to_string(), "label": label, "description": NOTICE, "associatedNodeID": "" });
    let state = json!({ "selected": true, "locked": false, "visibility": true, "positionStatus": "defined" });
    merged(merged(point, own), state)
}

/// An object with the keys of another behind its own.
fn merged(mut object: Value, other: Value) -> Value {
    if let (Value::Object(object), Value::Object(other)) = (&mut object, other) {
        object.extend(other);
    }
    object
}

fn markups_text(markups: &[Value]) -> String {
    let whole = json!({ "@schema": SCHEMA, "markups": markups });
    serde_json::to_string_pretty(&whole).expect("numbers and texts can be written") + "\n"
}

/// Writes points as a fiducial list of 3D Slicer in its older text form; `points` are mm, LPS, and the file states `space`.
///
/// # Errors
/// [`FileError`] if the space is unknown, a point is not finite, a name holds a line break, or the file cannot be written.
pub fn write_fcsv(path: &Path, points: &[NamedPoint], space: Space) -> Result<(), FileError> {
    check_stated(path, space)?;
    let mut text = format!(
        "# Markups fiducial file version = 4.11\n# CoordinateSystem = {space}\n# {NOTICE}\n\
         # columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n"
    );
    for (k, point) in points.iter().enumerate() {
        let [x, y, z] = stated(path, space, point)?;
        let name = quoted(path, &point.name)?;
        writeln!(text, "vtkMRMLMarkupsFiducialNode_{k},{x},{y},{z},0,0,0,1,1,1,0,{name},,")
            .expect("a string takes any text");
    }
    osteoflow_container::durable::write(path, text).map_err(FileError::write(path))
}

/// Writes points as CSV with the heading `label,x,y,z`; the numbers as they are. A known space is stated in a comment.
///
/// # Errors
/// [`FileError`] if a name holds a line break, or the file cannot be written.
pub fn write_points_csv(path: &Path, points: &[NamedPoint], space: Space) -> Result<(), FileError> {
    let mut text = space.tag().map_or_else(String::new, |tag| format!("# {tag}\n# {NOTICE}\n"));
    text.push_str("label,x,y,z\n");
    let sign = space.x_y_sign();
    for point in points {
        let (name, p) = (quoted(path, &point.name)?, point.position);
        writeln!(text, "{name},{},{},{}", sign * p.x, sign * p.y, p.z).expect("a string takes any text");
    }
    osteoflow_container::durable::write(path, text).map_err(FileError::write(path))
}

/// The name as a cell of CSV.
fn quoted(path: &Path, name: &str) -> Result<String, FileError> {
    if name.contains(['\n', '\r']) {
        return Err(fault(path, format!("point \"{}\"", name.escape_debug()), "its name holds a line break"));
    }
    let plain = !name.contains([',', ';', '"', '#']) && name.trim() == name;
    Ok(if plain { name.to_owned() } else { format!("\"{}\"", name.replace('"', "\"\"")) })
}
