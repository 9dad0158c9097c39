//! Points picked in target and source, matched by name.

use super::files::space_of;
use anyhow::{Result, anyhow};
use osteoflow_algorithms::target::Target;
use osteoflow_formats::{
    Space,
    picked_points::{PickedPoints, read_picked_points},
};
use osteoflow_geometry::{Cloud, NamedPoint, nalgebra::Point3};
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
    let (min, max) =
        target.points().iter().fold((target.points()[0], target.points()[0]), |(a, b), p| (a.inf(p), b.sup(p)));
    let size_mm = (max - min).norm();
    let far_mm = |p: &NamedPoint| target.nearest(&p.position, f64::INFINITY).map_or(f64::INFINITY, |(_, mm)| mm);
    let (name, mm) = targets.iter().map(|p| (&p.name, far_mm(p))).max_by(|a, b| a.1.total_cmp(&b.1))?;
    (mm > size_mm).then(|| {
        format!("--targets: {name} lies {mm:.0} mm from the surface, which is {size_mm:.0} mm long; is it in the target's frame, in mm, and in \
                 LPS as the target?")
    })
}

/// A change of coordinates that is tried.
type Moved = fn(&Point3<f64>) -> Point3<f64>;

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
    let farthest = |moved: Moved| picked.iter().map(|p| surface_mm(&moved(&p.position))).fold(0.0, f64::max);
    let off_mm = farthest(|p| *p);
    if off_mm <= OFF_SURFACE_MM {
        return None;
    }
    let causes: [(&str, Moved); 6] = [
        ("with x and y negated they lie on it: RAS and LPS are mixed up", |p| Point3::new(-p.x, -p.y, p.z)),
        ("with x negated they lie on it: left and right are mixed up", |p| Point3::new(-p.x, p.y, p.z)),
        ("with y negated they lie on it: an axis is flipped", |p| Point3::new(p.x, -p.y, p.z)),
        ("with z negated they lie on it: an axis is flipped", |p| Point3::new(p.x, p.y, -p.z)),
        ("a thousand times as large they lie on it: they are in metres", |p| p * 1e3),
        ("a thousandth as large they lie on it: they are in micrometres", |p| p * 1e-3),
    ];
    let scan_mm = |p: &Point3<f64>| {
        let points = source.map_or(&[][..], Cloud::points).iter();
        points.map(|q| (p - q).norm()).fold(f64::INFINITY, f64::min)
    };
    let all_near = |points: &[NamedPoint], mm: &dyn Fn(&Point3<f64>) -> f64| {
        !points.is_empty() && points.iter().all(|p| mm(&p.position) <= OFF_SURFACE_MM)
    };
    if all_near(in_source, &surface_mm) && all_near(picked, &scan_mm) {
        let cause = "they lie on the source, and those picked there on the target: are the two files of --landmarks exchanged? The target's \
                     comes first";
        return Some(format!("points picked in the target are up to {off_mm:.1} mm off its surface; {cause}"));
    }
    // Points that a smaller unit gathers in one place lie on any surface that passes there.
    let is_spread = |moved: Moved| {
        let apart = |p: &NamedPoint| (moved(&p.position) - moved(&picked[0].position)).norm();
        picked.iter().map(apart).fold(0.0, f64::max) > OFF_SURFACE_MM
    };
    let cause = causes.iter().find(|(_, moved)| farthest(*moved) <= OFF_SURFACE_MM && is_spread(*moved));
    let cause = cause.map_or(
        "were they picked on this surface? Fiducials that lie off it are given by --fiducials",
        |(cause, _)| cause,
    );
    Some(format!("points picked in the target are up to {off_mm:.1} mm off its surface; {cause}"))
}
