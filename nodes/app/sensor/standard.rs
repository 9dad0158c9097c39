//! Numbers of ASTM F2554, by its published abstract: precision at a point, and distances between points.

use super::Measured;
use anyhow::{Context, Result, bail};
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
        let n_divots = counted(readings.len(), "divot");
        bail!("{n_divots} of {} were read more than once, and two are needed at least", known.len());
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
    let lines = [
        ("single point, RMS", precision.rms),
        ("single point, maximum", precision.max),
        ("distance, bias", distances.mean),
        ("distance, mean absolute", distances.mean_abs),
        ("distance, SD", distances.sd.unwrap_or(f64::NAN)),
        ("distance, RMS", distances.rms),
        ("distance, maximum absolute", distances.max.max(-distances.min)),
    ];
    let lines = lines.map(|(name, mm)| format!("{name:<27} {mm:.3} mm")).into();
    let (n, of, pairs) =
        (counted(precision.n, "reading"), counted(means.len(), "divot"), counted(errors.len(), "distance"));
    let notes = vec![
        format!("{n} of {of} ({} in the reference), {pairs}", known.len()),
        "names and procedure are by the published abstract of ASTM F2554, not by its text".into(),
        "the pointer's orientations, its visible range and places in the working volume are not told apart".into(),
    ];
    let json = serde_json::json!({ "n_divots": means.len(), "single_point_mm": precision, "distance_mm": distances });
    Ok(Measured { lines, notes, json })
}

/// Adds the readings of a file: a heading, and NAME,x,y,z in mm on each line.
fn read(file: &Path, readings: &mut Readings) -> Result<()> {
    let bytes = input::read(file)?;
    let mut rows = csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_reader(&bytes[..]);
    for row in rows.deserialize() {
        let expected =
            || format!("{}: a heading, then NAME,x,y,z in mm are expected, such as D1,10.5,-3.2,40", file.display());
        let (name, [x, y, z]): (String, [f64; 3]) = row.with_context(expected)?;
        readings.entry(name).or_default().push(Point3::new(x, y, z));
    }
    Ok(())
}
