//! Named points that were picked in other programs, also planes and boxes, and back to such files.
//!
//! | File | Taken |
//! |---|---|
//! | 3D Slicer `.mrk.json` | control points of fiducials, lines, curves and angles; planes; boxes (ROI) |
//! | 3D Slicer `.fcsv` | fiducials |
//! | MeshLab `.pp` | active points |
//! | CloudCompare's picking list | `x,y,z`, an index or a label before them |
//! | CSV with the heading `label,x,y,z` | points |
//! | text, `x y z` on each line | points without names |
//!
//! The format is recognised by the content. Slicer's files state LPS or RAS; RAS is turned to LPS. The others state nothing
//! unless a comment says `SPACE=LPS` or `SPACE=RAS`, and their numbers are taken as they are. All lengths are mm.

mod slicer;
mod text;
mod write;

pub use write::{write_fcsv, write_mrk_json, write_planes_mrk_json, write_points_csv, write_roi_mrk_json};

use crate::{
    FileError, Space, input,
    mesh_or_cloud::{is_text, text as decoded},
    refused,
};
use nalgebra::{Point3, Rotation3, Unit, Vector3};
use osteoflow_geometry::{NamedPoint, TooFar};
use std::{collections::HashSet, path::Path, sync::Arc};

/// The points, planes and boxes of a file; mm, LPS if the file states its space.
#[derive(Debug, Clone, PartialEq)]
pub struct PickedPoints {
    /// The points, in the file's order.
    pub points: Vec<NamedPoint>,
    /// Whether the file names every point; those without a name are called by their place in the list, from "1" on.
    pub is_named: bool,
    /// Planes; only Slicer's JSON has them.
    pub planes: Vec<PickedPlane>,
    /// Boxes; only Slicer's JSON has them.
    pub rois: Vec<PickedRoi>,
    /// The space that the file states.
    pub space: Space,
    /// How many points were passed over because they are inactive, or their position was not set.
    pub n_skipped: usize,
    /// Changes to the content and what is doubtful, one sentence each.
    pub notes: Vec<String>,
}

/// A plane by a point on it and its normal.
#[derive(Debug, Clone, PartialEq)]
pub struct PickedPlane {
    /// Its name; `plane_1` and so on if the file gives none.
    pub name: Arc<str>,
    /// A point on it, mm.
    pub origin: Point3<f64>,
    /// The direction of its normal.
    pub normal: Unit<Vector3<f64>>,
}

/// A box, in general not along the axes.
#[derive(Debug, Clone, PartialEq)]
pub struct PickedRoi {
    /// Its name; `roi_1` and so on if the file gives none.
    pub name: Arc<str>,
    /// Its center, mm.
    pub center: Point3<f64>,
    /// Its axes, the columns of the rotation.
    pub axes: Rotation3<f64>,
    /// Its edges along its axes, mm.
    pub size_mm: Vector3<f64>,
}

/// Reads the points of a file of [these formats](self).
///
/// # Errors
/// [`FileError`] if the file cannot be read, or as [`parse_picked_points`].
pub fn read_picked_points(path: &Path) -> Result<PickedPoints, FileError> {
    parse_picked_points(path, &input::read(path)?)
}

/// The points in the bytes of a file; `path` is used in messages only.
///
/// # Errors
/// [`FileError`] with the place, if the file is of none of these formats, gives a label twice, a number that is not finite,
/// an unknown coordinate system, another unit than mm, or holds nothing.
pub fn parse_picked_points(path: &Path, bytes: &[u8]) -> Result<PickedPoints, FileError> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let start = bytes.trim_ascii_start();
    let refuse = |message: &str| Err(FileError::content(path, "byte 0", message));
    let picked = match start.first() {
        None => return refuse("the file is empty; was it written to the end?"),
        Some(b'{') => slicer::markups(path, bytes)?,
        Some(b'<') => text::meshlab(path, &decoded(path, bytes)?)?,
        _ if start.starts_with(b"ply") || start.starts_with(b"solid") => {
            return refuse("this is a surface or a cloud; give a list of points");
        }
        Some(b'#') if slicer::is_fcsv(start) => slicer::fcsv(path, &decoded(path, bytes)?)?,
        _ => match refused::refusal(bytes) {
            Some(message) => return refuse(&message),
            None if !is_text(bytes) => return refuse("no text; a list of points is expected"),
            None => text::list(path, &decoded(path, bytes)?)?,
        },
    };
    if picked.points.is_empty() && picked.planes.is_empty() && picked.rois.is_empty() {
        let skipped = match picked.n_skipped {
            0 => String::new(),
            n => format!("; {n} were passed over because they are inactive or not placed"),
        };
        return Err(FileError::content(path, "points", format!("there is no point in the file{skipped}")));
    }
    Ok(picked)
}

/// Points as they are read, with unique names.
#[derive(Default)]
struct Collected {
    points: Vec<NamedPoint>,
    names: HashSet<Arc<str>>,
    n_unnamed: usize,
    n_skipped: usize,
    notes: Vec<String>,
}

impl Collected {
    /// Adds a point; without a name it is called by its place in the list.
    ///
    /// # Errors
    /// A message, if the name is there already or a number is not finite.
    fn push(&mut self, name: &str, position: [f64; 3], space: Space) -> Result<(), String> {
        if !position.iter().all(|c| c.is_finite()) {
            return Err(format!("point \"{name}\" is at {position:?}; three finite numbers are expected"));
        }
        TooFar::check(&position).map_err(|far| format!("point \"{name}\": {far}"))?;
        let name: Arc<str> = match name.trim() {
            "" => {
                self.n_unnamed += 1;
                (self.points.len() + 1).to_string().into()
            }
            name => name.into(),
        };
        if !self.names.insert(name.clone()) {
            return Err(format!("label \"{name}\" is given twice; name each point once"));
        }
        self.points.push(NamedPoint::new(name, to_lps(position, space)));
        Ok(())
    }

    fn finish(mut self, space: Space) -> PickedPoints {
        if self.n_unnamed > 0 && self.n_unnamed < self.points.len() {
            let (n, of) = (self.n_unnamed, self.points.len());
            self.notes.push(format!("{n} of {of} points have no name and are called by their place in the list"));
        }
        if space == Space::Ras {
            self.notes.push("the file states RAS; x and y were negated, which gives LPS".into());
        }
        let is_named = self.n_unnamed == 0;
        let Self { points, n_skipped, notes, .. } = self;
        PickedPoints { points, is_named, planes: Vec::new(), rois: Vec::new(), space, n_skipped, notes }
    }
}

fn to_lps([x, y, z]: [f64; 3], space: Space) -> Point3<f64> {
    let sign = space.x_y_sign();
    Point3::new(sign * x, sign * y, z)
}

#[cfg(test)]
mod tests;
