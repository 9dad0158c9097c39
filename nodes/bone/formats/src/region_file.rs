//! A region of interest drawn by hand, as JSON: lengths in mm, in the frame of the cloud that it was drawn on.
//!
//! ```json
//! { "format": "osteoflow-region", "version": 1, "units": "mm", "frame": "camera",
//!   "drawn_on": { "n_points": 20000, "n_inside": 15210 },
//!   "keep": [ { "shape": "outline", "eye": [0, 0, 0], "right": [1, 0, 0], "down": [0, 1, 0],
//!               "corners": [[-0.3, -0.1], [0.3, -0.1], [0.3, 0.1], [-0.3, 0.1]] },
//!             { "shape": "box", "min": [-60, -40, 150], "max": [60, 40, 250] },
//!             { "shape": "slab", "origin": [0, 0, 0], "direction": [0, 0, 1], "from": -50, "to": 50 } ],
//!   "cut":  [ { "shape": "brush", "centres": [[1, 2, 200], [3, 2, 200]], "radius": 4 } ] }
//! ```
//!
//! A point is in the region if it is in one of `keep`, or `keep` is empty, and in none of `cut`. An outline is what an eye sees
//! inside the corners, as [`Shape::Outline`] says; with `eye`, `right` and `down` as above it is the camera itself.

use crate::{FileError, input};
use nalgebra::Point3;
use osteoflow_geometry::{DrawnOn, DrawnRegion, FARTHEST_MM, Shape, direction};
use serde::{Deserialize, Serialize};
use std::path::Path;

pub(crate) const FORMAT: &str = "osteoflow-region";
const VERSION: u32 = 1;
/// Largest deviation of `right` and `down` from unit length and a right angle.
const MAX_SKEW: f64 = 1e-6;
/// Most shapes, centres or corners: more than a hand draws.
const MAX_PARTS: usize = 100_000;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    format: String,
    version: u32,
    units: String,
    frame: String,
    #[serde(default)]
    drawn_on: Option<DrawnOn>,
    #[serde(default)]
    keep: Vec<Shape>,
    #[serde(default)]
    cut: Vec<Shape>,
    #[serde(default, skip_serializing)]
    #[allow(dead_code, reason = "for people")]
    description: Option<String>,
}

/// Reads a region.
///
/// # Errors
/// [`FileError`] as [`parse_region`], or if the file cannot be read.
pub fn read_region(path: &Path) -> Result<DrawnRegion, FileError> {
    let text = input::read_text(path)?;
    parse_region(path, &text)
}

/// Reads a region from its text; `path` is named in errors.
///
/// # Errors
/// [`FileError`] naming the key: another format, version or unit, unknown keys, numbers that are not finite or beyond 10⁷ mm, a
/// shape without an inside, image axes that are not perpendicular and of length 1, no shape at all.
pub fn parse_region(path: &Path, text: &str) -> Result<DrawnRegion, FileError> {
    let fault = |place: String, message: String| FileError::content(path, place, message);
    let region: Document = serde_json::from_str(text.trim_start_matches('\u{feff}'))
        .map_err(|error| fault(format!("line {}, column {}", error.line(), error.column()), error.to_string()))?;
    if region.format != FORMAT || region.version != VERSION {
        let other = format!("\"{}\" of version {}", region.format, region.version);
        return Err(fault(
            "key \"format\"".into(),
            format!("\"{FORMAT}\" of version {VERSION} is read, found {other}"),
        ));
    }
    if region.units != "mm" {
        return Err(fault("key \"units\"".into(), format!("a region is in \"mm\", found \"{}\"", region.units)));
    }
    if region.keep.is_empty() && region.cut.is_empty() {
        return Err(fault("key \"keep\"".into(), "neither keep nor cut has a shape".into()));
    }
    if region.frame.trim().is_empty() {
        return Err(fault("key \"frame\"".into(), "the frame of the cloud is missing".into()));
    }
    let shapes = |key: &str, shapes: Vec<Shape>| {
        let check = |(k, shape): (usize, Shape)| checked(shape).map_err(|why| fault(format!("{key}[{k}]"), why));
        shapes.into_iter().enumerate().map(check).collect::<Result<Vec<_>, _>>()
    };
    Ok(DrawnRegion {
        frame: region.frame.as_str().into(),
        drawn_on: region.drawn_on,
        keep: shapes("keep", region.keep)?,
        cut: shapes("cut", region.cut)?,
    })
}

/// Writes a region so that [`read_region`] gives it back.
///
/// # Errors
/// [`FileError::Io`] if the file cannot be written.
pub fn write_region(path: &Path, region: &DrawnRegion) -> Result<(), FileError> {
    let document = Document {
        format: FORMAT.into(),
        version: VERSION,
        units: "mm".into(),
        frame: region.frame.as_str().into(),
        drawn_on: region.drawn_on,
        keep: region.keep.clone(),
        cut: region.cut.clone(),
        description: None,
    };
    let mut text = serde_json::to_string_pretty(&document).expect("a region is made of numbers and text");
    text.push('\n');
    osteoflow_container::durable::write(path, text).map_err(FileError::write(path))
}

/// The shape with a direction of length 1.
///
/// # Errors
/// What is wrong with the shape.
fn checked(mut shape: Shape) -> Result<Shape, String> {
    match &mut shape {
        Shape::Box { min, max } => {
            check_point("min", min)?;
            check_point("max", max)?;
            if (0..3).any(|k| min[k] >= max[k]) {
                return Err(format!("min {min} is not below max {max}"));
            }
        }
        Shape::Slab { origin, direction: along, from, to } => {
            check_point("origin", origin)?;
            *along = direction(along.into_inner()).map_err(|error| format!("direction: {error}"))?;
            if !(usable(*from) && usable(*to) && from < to) {
                return Err(format!("from {from} is not below to {to}"));
            }
        }
        Shape::Brush { centres, radius } => {
            if !(usable(*radius) && *radius > 0.0) {
                return Err(format!("a radius of {radius} mm"));
            }
            if centres.is_empty() || centres.len() > MAX_PARTS {
                return Err(format!("{} centres, 1 to {MAX_PARTS} are read", centres.len()));
            }
            centres.iter().try_for_each(|centre| check_point("centres", centre))?;
        }
        Shape::Outline { eye, right, down, corners } => {
            check_point("eye", eye)?;
            let skew = [right.norm() - 1.0, down.norm() - 1.0, right.dot(down)];
            if !skew.iter().all(|s| s.abs() <= MAX_SKEW) {
                return Err("right and down are not perpendicular and of length 1".into());
            }
            if corners.len() < 3 || corners.len() > MAX_PARTS {
                return Err(format!("an outline has 3 to {MAX_PARTS} corners, found {}", corners.len()));
            }
            if !corners.iter().all(|corner| usable(corner.x) && usable(corner.y)) {
                return Err("a corner is no finite number".into());
            }
        }
    }
    Ok(shape)
}

fn usable(number: f64) -> bool {
    number.abs() <= FARTHEST_MM
}

fn check_point(key: &str, at: &Point3<f64>) -> Result<(), String> {
    let message = || format!("{key} {:?} is not finite, or beyond {FARTHEST_MM:e} mm", at.coords.as_slice());
    if at.iter().all(|c| usable(*c)) { Ok(()) } else { Err(message()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const REGION: &str = r#"{ "format": "osteoflow-region", "version": 1, "units": "mm", "frame": "camera",
        "drawn_on": { "n_points": 20000, "n_inside": 15210 },
        "keep": [ { "shape": "outline", "eye": [0, 0, 0], "right": [1, 0, 0], "down": [0, 1, 0],
                    "corners": [[-0.3, -0.1], [0.3, -0.1], [0.3, 0.1]] },
                  { "shape": "box", "min": [-60, -40, 150], "max": [60, 40, 250] } ],
        "cut": [ { "shape": "brush", "centres": [[1, 2, 200], [3, 2, 200]], "radius": 4 },
                 { "shape": "slab", "origin": [0, 0, 0], "direction": [0, 0, 2], "from": -50, "to": 50 } ] }"#;

    fn parse(text: &str) -> Result<DrawnRegion, FileError> {
        parse_region(Path::new("region.json"), text)
    }

    #[test]
    fn a_region_is_what_was_written() {
        let region = parse(REGION).unwrap();
        assert_eq!((region.frame.as_str(), region.keep.len(), region.cut.len()), ("camera", 2, 2));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("region.json");
        write_region(&path, &region).unwrap();
        assert_eq!(read_region(&path).unwrap(), region);
    }

    #[test]
    fn every_damage_is_an_error_that_names_its_place() {
        for (from, to, expected) in [
            ("osteoflow-region", "region", "key \"format\": \"osteoflow-region\" of version 1 is read"),
            ("\"version\": 1", "\"version\": 2", "of version 2"),
            ("\"units\": \"mm\"", "\"units\": \"m\"", "key \"units\": a region is in \"mm\", found \"m\""),
            ("\"frame\": \"camera\"", "\"frame\": \" \"", "key \"frame\""),
            ("\"cut\"", "\"cuts\"", "unknown field `cuts`"),
            ("\"n_inside\"", "\"inside\"", "unknown field `inside`"),
            ("[-60, -40, 150]", "[60, -40, 150]", "keep[1]: min"),
            ("[-60, -40, 150]", "[-60, -40]", "invalid length 2"),
            ("[-60, -40, 150]", "[-60, -40, -1e9]", "keep[1]: min [-60.0, -40.0, -1000000000.0] is not finite"),
            ("\"right\": [1, 0, 0]", "\"right\": [1, 0.01, 0]", "keep[0]: right and down"),
            ("\"right\": [1, 0, 0]", "\"right\": [0, 1, 0]", "keep[0]: right and down"),
            (", [0.3, 0.1]]", "]", "keep[0]: an outline has 3"),
            ("\"radius\": 4", "\"radius\": 0", "cut[0]: a radius of 0 mm"),
            ("[[1, 2, 200], [3, 2, 200]]", "[]", "cut[0]: 0 centres"),
            ("[0, 0, 2]", "[0, 0, 0]", "cut[1]: direction"),
            ("\"from\": -50", "\"from\": 50", "cut[1]: from 50 is not below to 50"),
            ("\"shape\": \"slab\"", "\"shape\": \"sphere\"", "unknown variant `sphere`"),
        ] {
            let text = REGION.replacen(from, to, 1);
            assert_ne!(text, REGION, "{from}");
            let message = parse(&text).unwrap_err().to_string();
            assert!(message.contains(expected), "{from} -> {to}: {message}");
        }
        let empty = r#"{ "format": "osteoflow-region", "version": 1, "units": "mm", "frame": "camera" }"#;
        assert!(parse(empty).unwrap_err().to_string().contains("neither keep nor cut"));
        for n in 0..REGION.len() {
            assert!(parse(&REGION[..n]).is_err(), "the first {n} bytes");
        }
    }
}
