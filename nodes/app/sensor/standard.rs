//! Numbers of ASTM F2554, by its published abstract: precision at a point, and distances between points.

use super::Measured;
use anyhow::{Result, bail};
use osteoflow_algorithms::kabsch::centroid;
use osteoflow_formats::{input, picked_points::read_picked_points};
use osteoflow_geometry::nalgebra::Point3;
use osteoflow_statistics::{Summary, counted};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// Readings by name.
type Readings = BTreeMap<String, Vec<Point3<f64>>>;

/// Precision and distance errors of repeated readings of named divots.
pub(super) fn f2554(files: &[PathBuf], reference: &Path) -> Result<Measured> {
    let picked = read_picked_points(reference)?.points;
    let known: BTreeMap<String, Point3<f64>> = picked.iter().map(|p| (p.name.to_string(), p.position)).collect();
    let mut readings = Readings::new();
    let is_reference = |file: &Path| file.canonicalize().ok() == reference.canonicalize().ok();
    files.iter().filter(|file| !is_reference(file)).try_for_each(|file| read(file, &mut readings))?;
    if let Some(name) = readings.keys().find(|name| !known.contains_key(*name)) {
        bail!("{}: no divot is named {name}, which was read; name it there as in the readings", reference.display());
    }
    readings.retain(|_, points| points.len() > 1);
    if readings.len() < 2 {
        let found = counted(readings.len(), "divot");
        bail!("{found} of {} were read more than once, and two are needed at least", known.len());
    }
    let means: Vec<(&str, Point3<f64>)> = readings.iter().map(|(name, of)| (name.as_str(), centroid(of))).collect();
    let spread =
        |(of, (_, mean)): (&Vec<Point3<f64>>, &(&str, Point3<f64>))| of.iter().map(|p| (p - mean).norm()).collect();
    let repeats: Vec<Vec<f64>> = readings.values().zip(&means).map(spread).collect();
    let mut errors = Vec::new();
    for (k, (a, at)) in means.iter().enumerate() {
        errors.extend(means[..k].iter().map(|(b, from)| (at - from).norm() - (known[*a] - known[*b]).norm()));
    }
    let (precision, distances) = (Summary::of(&repeats.concat())?, Summary::of(&errors)?);
    let absolute = distances.max.max(-distances.min);
    let mm = |value: f64| format!("{value:.3} mm");
    let rows = [
        ("single point, RMS", precision.rms),
        ("single point, maximum", precision.max),
        ("distance, bias", distances.mean),
        ("distance, mean absolute", distances.mean_abs),
        ("distance, SD", distances.sd.unwrap_or(f64::NAN)),
        ("distance, RMS", distances.rms),
        ("distance, maximum absolute", absolute),
    ];
    let mut rows: Vec<(String, String)> = rows.map(|(name, value)| (name.into(), mm(value))).into();
    let n = format!(
        "{} of {}, {}",
        counted(precision.n, "reading"),
        counted(means.len(), "divot"),
        counted(errors.len(), "distance")
    );
    rows.push(("n".into(), n));
    let notes = [
        "names and procedure are those of the published abstract of ASTM F2554, not of its text",
        "it is no test by that standard: the rotations about each axis, the extremes of the working volume and the reference phantom are not stated",
    ];
    let lost = known.len() - means.len();
    let unread =
        (lost > 0).then(|| format!("{} of the reference were not read twice and do not count", counted(lost, "divot")));
    let json = serde_json::json!({
        "standard": "ASTM F2554", "n_divots": means.len(), "single_point_mm": precision, "distance_mm": distances,
    });
    Ok(Measured { rows, notes: notes.map(String::from).into_iter().chain(unread).collect(), json })
}

/// Adds the readings of a file: NAME,x,y,z on each line, in mm; a heading and lines that begin with # are passed over.
fn read(file: &Path, readings: &mut Readings) -> Result<()> {
    for (k, line) in input::read_text(file)?.lines().enumerate() {
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let numbers: Vec<f64> =
            cells.iter().skip(1).filter_map(|cell| cell.parse().ok()).filter(|x: &f64| x.is_finite()).collect();
        match numbers[..] {
            [x, y, z] if cells.len() == 4 => readings.entry(cells[0].into()).or_default().push(Point3::new(x, y, z)),
            _ if line.trim().is_empty() || line.starts_with('#') || (k == 0 && numbers.is_empty()) => {}
            _ => bail!("{}:{}: NAME,x,y,z in mm is expected, such as D1,10.5,-3.2,40", file.display(), k + 1),
        }
    }
    Ok(())
}
