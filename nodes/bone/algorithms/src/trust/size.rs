//! Whether the bone is too small for the scan that is registered onto it: another unit, or the two files exchanged.

use super::{Evidence, Registered};
use crate::coarse::UNITS;
use nalgebra::Point3;
use osteoflow_verdict::{Answer, Reason};

/// A scan that is longer than this many bones is no scan of it alone.
const LONGER: f64 = 1.5;

/// Misfit above which the scan is measured not to be of this surface, mm: beyond any sensor, segmentation or film.
const MISFIT_MM: f64 = 1.0;

/// Lengths of whole bones that are registered, mm.
pub(super) const BONE_MM: std::ops::RangeInclusive<f64> = 60.0..=600.0;

/// The reason against a bone that is much smaller than the scan, neither of which fits the other.
pub(super) fn size_reason(registered: &Registered<'_>, evidence: &Evidence) -> Option<Reason> {
    let (bone_mm, scan_mm) = (span(registered.target.points())?, span(registered.source.points())?);
    if scan_mm < LONGER * bone_mm || evidence.misfit.rms_mm < MISFIT_MM {
        return None;
    }
    let spans = format!("the scan spans {scan_mm:.0} mm and the bone {bone_mm:.0} mm");
    let is_bone = |mm: f64| BONE_MM.contains(&mm) && mm > scan_mm;
    let units = if BONE_MM.contains(&bone_mm) { None } else { in_units(bone_mm, is_bone) };
    Some(match (units, registered.target.mesh()) {
        (Some([names, lengths, factors, first]), _) => {
            let reason = format!(
                "{spans}, and they differ by {:.1} mm where they meet: is the bone in {names}? It would then span {lengths}",
                evidence.misfit.rms_mm,
            );
            let remedy = format!(
                "give its unit (register: --target-unit-mm {factors}; in a graph: bone.unit_mm = {first}); if surroundings make the scan \
                 longer than the bone, crop it"
            );
            Reason::new("size", Answer::Refused, reason, remedy)
        }
        (None, None) => {
            let reason =
                format!("{spans}, which is points without a surface; likely cause: bone and scan are exchanged");
            Reason::new("size", Answer::Refused, reason, "name the bone first and the scan second (register BONE SCAN)")
        }
        (None, Some(_)) => {
            let reason = format!(
                "{spans}, shorter than what was scanned; likely cause: bone and scan are exchanged, or surroundings are in the scan"
            );
            let remedy = "name the bone first and the scan second (register BONE SCAN), or crop the scan to the bone";
            Reason::new("size", Answer::Doubtful, reason, remedy)
        }
    })
}

/// Units in which a length is one that `is_due` takes, joined by "or": their names, the lengths and the sizes; and the size of the first.
pub(super) fn in_units(mm: f64, is_due: impl Fn(f64) -> bool) -> Option<[String; 4]> {
    let units: Vec<_> = UNITS.iter().filter(|(unit_mm, _)| is_due(mm * unit_mm)).collect();
    let joined =
        |words: &dyn Fn(&(f64, &str)) -> String| units.iter().map(|unit| words(unit)).collect::<Vec<_>>().join(" or ");
    let lengths = joined(&|(unit_mm, _)| format!("{:.0} mm", mm * unit_mm));
    let first = format!("{:?}", units.first()?.0);
    Some([joined(&|(_, name)| (*name).to_owned()), lengths, joined(&|(unit_mm, _)| unit_mm.to_string()), first])
}

/// The diagonal of the box around points, mm.
pub fn span(points: &[Point3<f64>]) -> Option<f64> {
    let first = points.first()?;
    let (low, high) = points.iter().fold((*first, *first), |(low, high), p| (low.inf(p), high.sup(p)));
    Some((high - low).norm())
}
