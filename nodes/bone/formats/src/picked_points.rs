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

mod collected;
mod slicer;
mod text;
mod write;

pub use collected::{PickedPlane, PickedPoints, PickedRoi};
pub use write::{write_fcsv, write_mrk_json, write_planes_mrk_json, write_points_csv, write_roi_mrk_json};

use crate::{FileError, cursor::is_text, input, refused};
use std::path::Path;

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
        Some(b'<') => text::meshlab(path, bytes)?,
        _ if start.starts_with(b"ply") || start.starts_with(b"solid") => {
            return refuse("this is a surface or a cloud; give a list of points");
        }
        Some(b'#') if slicer::is_fcsv(start) => slicer::fcsv(path, bytes)?,
        _ => match refused::refusal(path, bytes) {
            Some(message) => return refuse(&message),
            None if !is_text(bytes) => return refuse("no text; a list of points is expected"),
            None => text::list(path, bytes)?,
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

#[cfg(test)]
mod tests;
