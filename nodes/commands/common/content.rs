//! What a file holds, where the readers do not tell: picked points, an image, or a surface or cloud.

use osteoflow_formats::{
    FileError, input,
    picked_points::{PickedPoints, parse_picked_points},
};
use std::{io::Read as _, path::Path};

/// Nobody picks more points by hand; longer lists of numbers are clouds.
const N_PICKED: usize = 1000;

/// The picked points in the bytes of a file; `None` if it is something else.
///
/// A text of numbers may be a list of points or a cloud. It is a list if its points have names that are not numbers, or if it is
/// short and its lines are an index, a comma, and three coordinates, as CloudCompare writes them.
pub(crate) fn picked_points(file: &Path, bytes: &[u8]) -> Option<Result<PickedPoints, FileError>> {
    let start = bytes.trim_ascii_start();
    let head = String::from_utf8_lossy(&start[..start.len().min(4096)]);
    let is_markups = head.starts_with('{') && String::from_utf8_lossy(bytes).contains("\"markups\"");
    let is_fcsv = head.starts_with("# Markups fiducial file");
    let is_pp = head.starts_with('<') && head.contains("PickedPoints");
    if is_markups || is_fcsv || is_pp {
        return Some(parse_picked_points(file, bytes));
    }
    let read = parse_picked_points(file, bytes).ok()?;
    let has_names = read.is_named && read.points.iter().any(|point| point.name.parse::<f64>().is_err());
    let indexed = |line: &str| {
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        cells.len() == 4 && cells[0].parse::<u64>().is_ok()
    };
    let is_indexed = head.lines().take(3).all(indexed);
    (read.points.len() <= N_PICKED && (has_names || is_indexed)).then_some(Ok(read))
}

/// Whether a file is an image in three dimensions: NIfTI, NRRD or DICOM.
pub(crate) fn is_volume(file: &Path) -> bool {
    let mut head = [0; 352];
    let n = input::open(file).ok().and_then(|mut file| file.read(&mut head).ok()).unwrap_or(0);
    let head = &head[..n];
    let at = |from: usize, magic: &[&[u8]]| magic.iter().any(|m| head.get(from..from + m.len()) == Some(*m));
    // NIfTI and its gzip, NRRD, DICOM.
    at(0, &[b"\x1f\x8b", b"NRRD"]) || at(344, &[b"n+1", b"ni1"]) || at(4, &[b"n+2", b"ni2"]) || at(128, &[b"DICM"])
}
