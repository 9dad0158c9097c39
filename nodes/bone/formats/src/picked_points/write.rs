//! Lists of points for other programs.

use crate::{FileError, Space, write::NOTICE};
use nalgebra::{Isometry3, Matrix4, Point3, Vector3};
use osteoflow_geometry::NamedPoint;
use serde_json::json;
use std::{fmt::Write as _, path::Path, sync::Arc};

/// The schema that a JSON of markups names.
const SCHEMA: &str = "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/markups-schema-v1.0.3.json#";

fn fault(path: &Path, place: impl Into<String>, message: &str) -> FileError {
    FileError::content(path, place, message)
}

/// The position in the space that the file states.
fn stated(path: &Path, space: Space, point: &NamedPoint) -> Result<[f64; 3], FileError> {
    if space == Space::Unknown {
        let message = "the format states LPS or RAS, but the space of the points is unknown; write CSV instead";
        return Err(fault(path, "space", message));
    }
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
    let control_points = points.iter().enumerate().map(|(k, point)| {
        Ok(json!({
            "id": (k + 1).to_string(),
            "label": &*point.name,
            "description": NOTICE,
            "associatedNodeID": "",
            "position": stated(path, space, point)?,
            "selected": true,
            "locked": false,
            "visibility": true,
            "positionStatus": "defined",
        }))
    });
    let control_points = control_points.collect::<Result<Vec<_>, FileError>>()?;
    if space == Space::Unknown {
        return Err(fault(path, "space", "the format states LPS or RAS, but the space of the points is unknown"));
    }
    let whole = json!({
        "@schema": SCHEMA,
        "markups": [{
            "type": "Fiducial",
            "coordinateSystem": space.to_string(),
            "coordinateUnits": "mm",
            "controlPoints": control_points,
        }],
    });
    let text = serde_json::to_string_pretty(&whole).expect("numbers and texts can be written") + "\n";
    std::fs::write(path, text).map_err(FileError::write(path))
}

/// Writes a box along the axes as a region of interest of 3D Slicer in JSON; mm, called LPS.
///
/// # Errors
/// [`FileError`] if the file cannot be written.
pub fn write_roi_mrk_json(path: &Path, name: &str, min: &Point3<f64>, max: &Point3<f64>) -> Result<(), FileError> {
    let center = nalgebra::center(min, max);
    let whole = json!({
        "@schema": SCHEMA,
        "markups": [{
            "type": "ROI",
            "name": name,
            "description": NOTICE,
            "coordinateSystem": "LPS",
            "coordinateUnits": "mm",
            "roiType": "Box",
            "center": center.coords.as_slice(),
            "orientation": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            "size": (max - min).as_slice(),
            "insideOut": false,
            "controlPoints": [{
                "id": "1",
                "label": name,
                "description": NOTICE,
                "position": center.coords.as_slice(),
                "selected": true,
                "locked": false,
                "visibility": true,
                "positionStatus": "defined",
            }],
        }],
    });
    let text = serde_json::to_string_pretty(&whole).expect("numbers and texts can be written") + "\n";
    std::fs::write(path, text).map_err(FileError::write(path))
}

/// The edge with which a plane is drawn, mm: wider than a fibula.
const PLANE_MM: f64 = 50.0;

/// Writes planes, by name and pose, as plane markups of 3D Slicer in JSON; mm, LPS. A plane's own z axis is its normal.
///
/// # Errors
/// [`FileError`] if the file cannot be written.
pub fn write_planes_mrk_json(path: &Path, planes: &[(Arc<str>, Isometry3<f64>)]) -> Result<(), FileError> {
    let half = PLANE_MM / 2.0;
    let rows = |matrix: &Matrix4<f64>| matrix.transpose().iter().copied().collect::<Vec<f64>>();
    let markups = planes.iter().map(|(name, pose)| {
        let center = pose.translation.vector.as_slice();
        let rotation: Vec<f64> = pose.rotation.to_rotation_matrix().matrix().transpose().iter().copied().collect();
        json!({
            "type": "Plane",
            "name": &**name,
            "coordinateSystem": "LPS",
            "coordinateUnits": "mm",
            "planeType": "pointNormal",
            "sizeMode": "absolute",
            "autoScalingSizeFactor": 1.0,
            "center": center,
            "normal": (pose.rotation * Vector3::z()).as_slice(),
            "objectToBase": rows(&Matrix4::identity()),
            "baseToNode": rows(&pose.to_homogeneous()),
            "orientation": rotation,
            "size": [PLANE_MM, PLANE_MM],
            "planeBounds": [-half, half, -half, half],
            "controlPoints": [{
                "id": "1",
                "label": &**name,
                "description": NOTICE,
                "position": center,
                "orientation": rotation,
                "selected": true,
                "locked": false,
                "visibility": true,
                "positionStatus": "defined",
            }],
        })
    });
    let whole = json!({ "@schema": SCHEMA, "markups": markups.collect::<Vec<_>>() });
    let text = serde_json::to_string_pretty(&whole).expect("numbers and texts can be written") + "\n";
    std::fs::write(path, text).map_err(FileError::write(path))
}

/// Writes points as a fiducial list of 3D Slicer in its older text form; `points` are mm, LPS, and the file states `space`.
///
/// # Errors
/// [`FileError`] if the space is unknown, a point is not finite, a name holds a line break, or the file cannot be written.
pub fn write_fcsv(path: &Path, points: &[NamedPoint], space: Space) -> Result<(), FileError> {
    if space == Space::Unknown {
        return Err(fault(path, "space", "the format states LPS or RAS, but the space of the points is unknown"));
    }
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
    std::fs::write(path, text).map_err(FileError::write(path))
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
    std::fs::write(path, text).map_err(FileError::write(path))
}

/// The name as a cell of CSV.
fn quoted(path: &Path, name: &str) -> Result<String, FileError> {
    if name.contains(['\n', '\r']) {
        return Err(fault(path, format!("point \"{}\"", name.escape_debug()), "its name holds a line break"));
    }
    let plain = !name.contains([',', ';', '"', '#']) && name.trim() == name;
    Ok(if plain { name.to_owned() } else { format!("\"{}\"", name.replace('"', "\"\"")) })
}
