//! Points picked in target and source, matched by name.

use super::files::space_of;
use anyhow::{Result, anyhow};
use osteoflow_algorithms::{coarse::UNITS, target::Target, trust::span};
use osteoflow_formats::{
    Space,
    picked_points::{PickedPoints, read_picked_points},
};
use osteoflow_geometry::{
    Cloud, NamedPoint,
    nalgebra::{Isometry3, Point3, Vector3},
};
use std::path::{Path, PathBuf};

/// Number of points needed for a start.
const N_NEEDED: usize = 3;

/// Distance from the surface above which a picked point is doubted, mm: as far as a careful pick is off.
const OFF_SURFACE_MM: f64 = 2.0;

/// A file of picked points, and the space that the file whose points were picked states.
pub(super) struct Picked<'a> {
    pub(super) file: &'a Path,
    pub(super) stated: Space,
}

/// Reads points picked in target and source, and matches them by name, or by order where they have none in common.
///
/// # Errors
/// A file cannot be read, or there are fewer than three pairs.
pub(super) fn read(
    [target, source]: [Picked<'_>; 2],
    unit_mm: [f64; 2],
    option: Option<Space>,
    notes: &mut Vec<String>,
) -> Result<[Vec<NamedPoint>; 2]> {
    let files: [PathBuf; 2] = [target.file.into(), source.file.into()];
    let target = points(&target, unit_mm[0], option, notes)?;
    let source = points(&source, unit_mm[1], option, notes)?;
    let names = |points: &[NamedPoint]| points.iter().map(|p| p.name.to_string()).collect::<Vec<_>>().join(", ");
    let [of_target, of_source] = files.map(|file| file.display().to_string());
    let is_named = target.1 && source.1;
    let (target, source) = (target.0, source.0);
    let in_both: Vec<NamedPoint> =
        target.iter().filter(|p| is_named && source.iter().any(|s| s.name == p.name)).cloned().collect();
    if in_both.len() >= N_NEEDED {
        let left_out = target.len() + source.len() - 2 * in_both.len();
        if left_out > 0 {
            notes.push(format!(
                "--landmarks: {} are in both files and used; the {left_out} others are not",
                names(&in_both)
            ));
        }
        let source = in_both.iter().filter_map(|p| source.iter().find(|s| s.name == p.name)).cloned().collect();
        return Ok([in_both, source]);
    }
    if !in_both.is_empty() || target.len() != source.len() || target.len() < N_NEEDED {
        return Err(anyhow!(
            "--landmarks: {N_NEEDED} points with the same names are needed in both files; {of_target} has {}, {of_source} has {}",
            names(&target),
            names(&source)
        ));
    }
    notes.push(format!(
        "--landmarks: no name is in both files, so the points are matched by their order: {} with {}",
        names(&target),
        names(&source)
    ));
    let renamed = source.iter().zip(&target).map(|(s, t)| NamedPoint { name: t.name.clone(), ..s.clone() });
    let source = renamed.collect();
    Ok([target, source])
}

/// The points in the coordinates of the file in which they were picked, and whether they have names.
pub(super) fn points(
    picked: &Picked<'_>,
    unit_mm: f64,
    option: Option<Space>,
    notes: &mut Vec<String>,
) -> Result<(Vec<NamedPoint>, bool)> {
    let PickedPoints { mut points, is_named, space, notes: of_file, .. } =
        read_picked_points(picked.file).map_err(|error| anyhow!("{error}"))?;
    let name = picked.file.display();
    notes.extend(of_file.iter().map(|note| format!("{name}: {note}")));
    // What states a space was turned to LPS.
    let turned = match (space, picked.stated, space_of(picked.stated, option)) {
        (Space::Unknown, Space::Ras, _) => {
            notes.push(format!("{name}: it states no space and is taken to be in RAS, as the file it belongs to"));
            true
        }
        (Space::Lps | Space::Ras, _, Space::Ras) => true,
        (Space::Lps | Space::Ras, _, Space::Unknown) => {
            notes.push(format!(
                "{name}: it is {space}, and the file it belongs to states no space; that is taken for LPS"
            ));
            false
        }
        _ => false,
    };
    for point in &mut points {
        // Formats that state a space are always in mm.
        if space == Space::Unknown {
            point.position *= unit_mm;
        }
        if turned {
            point.position = Space::Ras.turn() * point.position;
        }
    }
    Ok((points, is_named))
}

/// Targets farther from the surface than its own size, which are hardly of this patient.
pub(super) fn far_targets(target: &Target, targets: &[NamedPoint]) -> Option<String> {
    let size_mm = span(target.points())?;
    let far_mm = |p: &NamedPoint| target.nearest(&p.position, f64::INFINITY).map_or(f64::INFINITY, |(_, mm)| mm);
    let (name, mm) = targets.iter().map(|p| (&p.name, far_mm(p))).max_by(|a, b| a.1.total_cmp(&b.1))?;
    (mm > size_mm).then(|| {
        format!("--targets: {name} lies {mm:.0} mm from the surface, which is {size_mm:.0} mm long; is it in the target's frame, in mm, and in \
                 LPS as the target?")
    })
}

/// Distance from every point of the scan above which a point is not seen by it, mm: as far as picks lie beside its points.
const UNSEEN_MM: f64 = 5.0;

/// Points at which the scan, moved into their frame, shows no bone, and what follows.
pub(super) fn unseen(points: &[NamedPoint], scan: &Cloud, t: &Isometry3<f64>, follows: &str) -> Option<String> {
    let off_mm = |p: &NamedPoint| nearest_mm(scan, &t.inverse_transform_point(&p.position));
    let far: Vec<_> = points.iter().map(|p| (&*p.name, off_mm(p))).filter(|(_, mm)| *mm > UNSEEN_MM).collect();
    let most_mm = far.iter().map(|(_, mm)| *mm).reduce(f64::max)?;
    let names = far.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ");
    Some(format!("the scan shows no bone at {names}, up to {most_mm:.0} mm from its nearest point: {follows}"))
}

fn nearest_mm(cloud: &Cloud, p: &Point3<f64>) -> f64 {
    cloud.points().iter().map(|q| (p - q).norm()).fold(f64::INFINITY, f64::min)
}

/// Points picked on the target that are far from it, with the likely cause.
pub(super) fn off_surface(
    target: &Target,
    source: Option<&Cloud>,
    picked: &[NamedPoint],
    in_source: &[NamedPoint],
) -> Option<String> {
    let surface_mm = |p: &Point3<f64>| match target.mesh().and_then(|mesh| mesh.closest_point(p)) {
        Some(closest) => closest.distance_mm,
        None => target.nearest(p, f64::INFINITY).map_or(f64::INFINITY, |(_, mm)| mm),
    };
    let scaled = |p: &NamedPoint, by: [f64; 3]| Point3::from(p.position.coords.component_mul(&Vector3::from(by)));
    let farthest = |by| picked.iter().map(|p| surface_mm(&scaled(p, by))).fold(0.0, f64::max);
    let off_mm = farthest([1.0; 3]);
    if off_mm <= OFF_SURFACE_MM {
        return None;
    }
    let causes = [
        ("with x and y negated they lie on it: RAS and LPS are mixed up", [-1.0, -1.0, 1.0]),
        ("with x negated they lie on it: left and right are mixed up", [-1.0, 1.0, 1.0]),
        ("with y negated they lie on it: an axis is flipped", [1.0, -1.0, 1.0]),
        ("with z negated they lie on it: an axis is flipped", [1.0, 1.0, -1.0]),
        (
            "a thousandth as large they lie on it: they are in micrometres, or are given the unit of another file",
            [1e-3; 3],
        ),
    ];
    let in_unit = |(mm, name): &(f64, &str)| {
        let scale = "write them in mm: osteoflow convert POINTS OUT.csv --scale";
        (format!("{mm} times as large they lie on it: they are in {name}; {scale} {mm}"), [*mm; 3])
    };
    let scan_mm = |p: &Point3<f64>| source.map_or(f64::INFINITY, |scan| nearest_mm(scan, p));
    let all_near = |points: &[NamedPoint], mm: &dyn Fn(&Point3<f64>) -> f64| {
        !points.is_empty() && points.iter().all(|p| mm(&p.position) <= OFF_SURFACE_MM)
    };
    if all_near(in_source, &surface_mm) && all_near(picked, &scan_mm) {
        let cause = "they lie on the source, and those picked there on the target: are the two files of --landmarks exchanged? The target's \
                     comes first";
        return Some(format!("points picked in the target are up to {off_mm:.1} mm off its surface; {cause}"));
    }
    // Points that a smaller unit gathers in one place lie on any surface that passes there.
    let is_spread = |by| picked.iter().any(|p| (scaled(p, by) - scaled(&picked[0], by)).norm() > OFF_SURFACE_MM);
    let mut causes = causes.map(|(cause, by)| (cause.to_owned(), by)).into_iter().chain(UNITS.iter().map(in_unit));
    let cause = causes.find(|(_, by)| farthest(*by) <= OFF_SURFACE_MM && is_spread(*by)).map_or_else(
        || "were they picked on this surface? Fiducials that lie off it are given by --fiducials".to_owned(),
        |(cause, _)| cause,
    );
    Some(format!("points picked in the target are up to {off_mm:.1} mm off its surface; {cause}"))
}
