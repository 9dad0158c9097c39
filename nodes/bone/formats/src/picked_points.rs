//! Named points that were picked in other programs, also planes and boxes, and back to such files.
//!
//! | File | Taken |
//! |---|---|
//! | 3D Slicer `.mrk.json` | control points of fiducials, lines, curves and angles; planes; boxes (ROI) |
//! | 3D Slicer `.fcsv` | fiducials |
//! | 3D Slicer `.mrb`, `.mrml` | the same of a whole scene, moved by its linear transforms |
//! | MeshLab `.pp` | active points |
//! | CloudCompare's picking list | `x,y,z`, an index or a label before them |
//! | CSV with the heading `label,x,y,z` | points |
//! | text, `x y z` on each line | points without names |
//!
//! The format is recognised by the content. Slicer's files state LPS or RAS; RAS is turned to LPS. The others state nothing
//! unless a comment says `SPACE=LPS` or `SPACE=RAS`, and their numbers are taken as they are. All lengths are mm.

mod collected;
mod scene;
mod slicer;
mod text;
mod write;

pub use collected::{PickedList, PickedPoints, PickedRoi};
pub(crate) use write::{planes_text, points_text};
pub use write::{write_fcsv, write_mrk_json, write_planes_mrk_json, write_points_csv, write_roi_mrk_json};

use crate::{
    FileError,
    cursor::{is_text, without_byte_order_mark},
    cut, input,
    kind::{Kind, Probe, TEXT, marked},
    pose_file::is_pose,
    scene_header::{is_bundle, is_scene},
    space::check_comments,
};
use std::path::Path;

/// Nobody picks more points by hand; longer lists of numbers are clouds.
const MAX_PICKED: usize = 1000;
/// A text of as many points is shorter.
const MAX_LIST_BYTES: usize = 1 << 20;

/// The format of a text that is a list of picked points; none if it is something else.
///
/// A text of numbers may be a list of points or a cloud. It is a list if its points have names that are not numbers, or if it is
/// short and its lines are an index, a comma, and three coordinates, as CloudCompare writes them.
pub(crate) fn format_of(path: &Path, bytes: &[u8]) -> Option<&'static str> {
    let start = bytes.trim_ascii_start();
    if slicer::is_fcsv(start) {
        return Some("fiducials of 3D Slicer");
    }
    if start.starts_with(b"<") {
        return Some("a list of MeshLab");
    }
    let read = if bytes.len() <= MAX_LIST_BYTES { text::list(path, bytes).ok()? } else { return None };
    let has_names = read.is_named && read.points.iter().any(|point| point.name.parse::<f64>().is_err());
    let indexed = |line: &str| {
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        // Decimal commas cut numbers, too, but what is between them is no number.
        let is_number = |cell: &&str| cell.parse::<f64>().is_ok();
        cells.len() == 4 && cells[0].parse::<u64>().is_ok() && cells[1..].iter().all(is_number)
    };
    let is_indexed = || String::from_utf8_lossy(start).lines().take(3).all(indexed);
    let n_points = read.points.len();
    ((1..=MAX_PICKED).contains(&n_points) && (has_names || is_indexed())).then_some(TEXT)
}

/// Reads the points of a file of [these formats](self).
///
/// # Errors
/// [`FileError`] if the file cannot be read, or as [`parse_picked_points`].
pub fn read_picked_points(path: &Path) -> Result<PickedPoints, FileError> {
    parse_picked_points(path, &input::read(path)?)
}

/// Reads a file of [these formats](self), also a scene that names files beside it.
///
/// # Errors
/// As [`read_picked_points`], or with the file or node of the scene.
pub fn read_scene(path: &Path) -> Result<PickedPoints, FileError> {
    if is_scene(&input::head(path, 4096)?) { filled(path, scene::beside(path)?) } else { read_picked_points(path) }
}

/// The points in the bytes of a file; `path` is used in messages only.
///
/// # Errors
/// [`FileError`] with the place, if the file is of none of these formats, gives a label twice, a number that is not finite,
/// an unknown coordinate system, another unit than mm, or holds nothing.
pub fn parse_picked_points(path: &Path, bytes: &[u8]) -> Result<PickedPoints, FileError> {
    let bytes = without_byte_order_mark(bytes);
    let start = bytes.trim_ascii_start();
    if is_bundle(bytes) {
        return filled(path, scene::bundle(path, bytes)?);
    }
    if is_scene(bytes) {
        let shown = path.display();
        let message = format!(
            "a scene names further files, which are no part of what is read here; save it as .mrb, or take what osteoflow convert {shown} OUT writes"
        );
        return Err(FileError::content(path, "byte 0", message));
    }
    let other = match start.first() {
        Some(b'{' | b'<') => None,
        _ if is_pose(bytes) => Some(Probe::new(Kind::Pose, "", path)),
        _ => marked(path, bytes).or_else(|| (!is_text(bytes)).then(|| Probe::new(Kind::Unknown, "", path))),
    };
    if let Some(other) = other {
        return Err(other.refusal(path, "a list of points"));
    }
    let open = cut::last_number(path, bytes)?;
    if !matches!(start.first(), Some(b'{' | b'<')) {
        check_comments(path, bytes, 1.0)?;
    }
    let mut picked = match start.first() {
        Some(b'{') => slicer::markups(path, bytes)?,
        Some(b'<') => text::meshlab(path, bytes)?,
        Some(b'#') if slicer::is_fcsv(start) => slicer::fcsv(path, bytes)?,
        _ => text::list(path, bytes)?,
    };
    picked.notes.extend(open);
    filled(path, picked)
}

/// Refuses a file in which nothing is picked.
fn filled(path: &Path, picked: PickedPoints) -> Result<PickedPoints, FileError> {
    if picked.points.is_empty() && picked.planes.is_empty() && picked.rois.is_empty() {
        let skipped = match picked.n_skipped {
            0 => String::new(),
            n => format!("; {n} were passed over because they are inactive or not placed"),
        };
        return Err(FileError::content(path, "points", format!("there is no point in the file{skipped}")));
    }
    Ok(picked)
}

#[cfg(test)]
mod tests;
