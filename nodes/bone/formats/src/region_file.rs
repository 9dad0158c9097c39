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
use nalgebra::{Point2, Point3, Vector3};
use osteoflow_geometry::{DrawnOn, DrawnRegion, FARTHEST_MM, Shape, direction};
use serde::{Deserialize, Serialize};
use std::{fs, path::Path};

const FORMAT: &str = "osteoflow-region";
const VERSION: u32 = 1;
/// Largest deviation of `right` and `down` from unit length and a right angle.
const MAX_SKEW: f64 = 1e-6;
/// Most shapes, centres or corners: more than a hand draws.
const MAX_PARTS: usize = 100_000;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    format: String,
    version: u32,
    units: String,
    frame: String,
    #[serde(default)]
    drawn_on: Option<WrittenDrawnOn>,
    #[serde(default)]
    keep: Vec<WrittenShape>,
    #[serde(default)]
    cut: Vec<WrittenShape>,
    #[serde(default, skip_serializing)]
    #[allow(dead_code, reason = "for people")]
    description: Option<String>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct WrittenDrawnOn {
    n_points: usize,
    n_inside: usize,
}

#[derive(Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "lowercase", deny_unknown_fields)]
enum WrittenShape {
    Box { min: [f64; 3], max: [f64; 3] },
    Slab { origin: [f64; 3], direction: [f64; 3], from: f64, to: f64 },
    Brush { centres: Vec<[f64; 3]>, radius: f64 },
    Outline { eye: [f64; 3], right: [f64; 3], down: [f64; 3], corners: Vec<[f64; 2]> },
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
    let written: Written = serde_json::from_str(text.trim_start_matches('\u{feff}'))
        .map_err(|error| fault(format!("line {}, column {}", error.line(), error.column()), error.to_string()))?;
    if written.format != FORMAT || written.version != VERSION {
        let found = format!("\"{}\" of version {}", written.format, written.version);
        return Err(fault(
            "key \"format\"".into(),
            format!("\"{FORMAT}\" of version {VERSION} is read, found {found}"),
        ));
    }
    if written.units != "mm" {
        return Err(fault("key \"units\"".into(), format!("a region is in \"mm\", found \"{}\"", written.units)));
    }
    if written.keep.is_empty() && written.cut.is_empty() {
        return Err(fault("key \"keep\"".into(), "neither keep nor cut has a shape".into()));
    }
    if written.frame.trim().is_empty() {
        return Err(fault("key \"frame\"".into(), "the frame of the cloud is missing".into()));
    }
    let shapes = |key: &str, shapes: Vec<WrittenShape>| {
        let read = |(k, shape): (usize, WrittenShape)| shape.read().map_err(|why| fault(format!("{key}[{k}]"), why));
        shapes.into_iter().enumerate().map(read).collect::<Result<Vec<_>, _>>()
    };
    Ok(DrawnRegion {
        frame: written.frame.as_str().into(),
        drawn_on: written.drawn_on.map(|on| DrawnOn { n_points: on.n_points, n_inside: on.n_inside }),
        keep: shapes("keep", written.keep)?,
        cut: shapes("cut", written.cut)?,
    })
}

/// Writes a region so that [`read_region`] gives it back.
///
/// # Errors
/// [`FileError::Io`] if the file cannot be written.
pub fn write_region(path: &Path, region: &DrawnRegion) -> Result<(), FileError> {
    let shapes = |shapes: &[Shape]| shapes.iter().map(WrittenShape::of).collect();
    let written = Written {
        format: FORMAT.into(),
        version: VERSION,
        units: "mm".into(),
        frame: region.frame.as_str().into(),
        drawn_on: region.drawn_on.map(|on| WrittenDrawnOn { n_points: on.n_points, n_inside: on.n_inside }),
        keep: shapes(&region.keep),
        cut: shapes(&region.cut),
        description: None,
    };
    let mut text = serde_json::to_string_pretty(&written).expect("a region is made of numbers and text");
    text.push('\n');
    fs::write(path, text).map_err(FileError::write(path))
}

impl WrittenShape {
    fn of(shape: &Shape) -> Self {
        let three = |v: &Vector3<f64>| [v.x, v.y, v.z];
        match shape {
            Shape::Box { min, max } => Self::Box { min: three(&min.coords), max: three(&max.coords) },
            Shape::Slab { origin, direction, from, to } => {
                Self::Slab { origin: three(&origin.coords), direction: three(direction), from: *from, to: *to }
            }
            Shape::Brush { centres, radius } => {
                Self::Brush { centres: centres.iter().map(|c| three(&c.coords)).collect(), radius: *radius }
            }
            Shape::Outline { eye, right, down, corners } => Self::Outline {
                eye: three(&eye.coords),
                right: three(right),
                down: three(down),
                corners: corners.iter().map(|c| [c.x, c.y]).collect(),
            },
        }
    }

    /// # Errors
    /// What is wrong with the shape.
    fn read(self) -> Result<Shape, String> {
        match self {
            Self::Box { min, max } => {
                let (min, max) = (point("min", min)?, point("max", max)?);
                if (0..3).any(|k| min[k] >= max[k]) {
                    return Err(format!("min {min} is not below max {max}"));
                }
                Ok(Shape::Box { min, max })
            }
            Self::Slab { origin, direction: along, from, to } => {
                let origin = point("origin", origin)?;
                let direction = direction(along.into()).map_err(|error| format!("direction: {error}"))?;
                if !(usable(from) && usable(to) && from < to) {
                    return Err(format!("from {from} is not below to {to}"));
                }
                Ok(Shape::Slab { origin, direction, from, to })
            }
            Self::Brush { centres, radius } => {
                if !(usable(radius) && radius > 0.0) {
                    return Err(format!("a radius of {radius} mm"));
                }
                if centres.is_empty() || centres.len() > MAX_PARTS {
                    return Err(format!("{} centres, 1 to {MAX_PARTS} are read", centres.len()));
                }
                let centres = centres.into_iter().map(|centre| point("centres", centre));
                Ok(Shape::Brush { centres: centres.collect::<Result<_, _>>()?, radius })
            }
            Self::Outline { eye, right, down, corners } => {
                let eye = point("eye", eye)?;
                let (right, down) = (Vector3::from(right), Vector3::from(down));
                let skew = [right.norm() - 1.0, down.norm() - 1.0, right.dot(&down)];
                if !skew.iter().all(|s| s.abs() <= MAX_SKEW) {
                    return Err("right and down are not perpendicular and of length 1".into());
                }
                if corners.len() < 3 || corners.len() > MAX_PARTS {
                    return Err(format!("an outline has 3 to {MAX_PARTS} corners, found {}", corners.len()));
                }
                if !corners.iter().flatten().all(|c| usable(*c)) {
                    return Err("a corner is no finite number".into());
                }
                let corners = corners.into_iter().map(Point2::from).collect();
                Ok(Shape::Outline { eye, right, down, corners })
            }
        }
    }
}

fn usable(number: f64) -> bool {
    number.abs() <= FARTHEST_MM
}

fn point(key: &str, at: [f64; 3]) -> Result<Point3<f64>, String> {
    let is_usable = at.iter().all(|c| usable(*c));
    is_usable.then(|| at.into()).ok_or_else(|| format!("{key} {at:?} is not finite, or beyond {FARTHEST_MM:e} mm"))
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
