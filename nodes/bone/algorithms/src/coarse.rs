//! Coarse registration, from a few named points or by shape alone.

mod doubtful;
mod global;

pub use doubtful::{DoubtParams, confirm};
pub(crate) use global::CROP;
pub use global::{CLEAR, GlobalFit, GlobalParams, GlobalReport, RunnerUp, Searched, global};
pub(crate) use global::{Placed, Points, descended, distinct, global_by, is_sparse, motion, symmetry};

use crate::Refusal;
use crate::kabsch::{centroid, kabsch};
use nalgebra::{Isometry3, Matrix3, Point3};
use osteoflow_geometry::NamedPoint;
use serde::{Deserialize, Serialize};

/// Minimum RMS distance of the points from their best line, mm: with points located to half a millimetre, the turn
/// about that line would be known to no better than 30 degrees.
const MIN_OFF_LINE_MM: f64 = 1.0;

/// Another pairing is reported if its RMS residual is below this share of that of the pairing by name...
const HINT_SHARE: f64 = 0.5;

/// ...and the latter exceeds this, mm, which laser holes or a stylus do not.
const HINT_ABOVE_MM: f64 = 1.5;

/// Maximum number of points of which all permutations are tried.
const MAX_PERMUTED: usize = 6;

/// Units of files that are not in mm, with their names.
pub const UNITS: [(f64, &str); 3] = [(10.0, "cm"), (25.4, "inches"), (1000.0, "metres")];

/// A ratio of distances that differs by less than this share from that of two units is theirs: as far as picks are off.
const UNIT_TOLERANCE: f64 = 0.1;

/// A coarse fit and its report.
#[derive(Debug, Clone, PartialEq)]
pub struct CoarseFit {
    /// The motion that takes the source points onto the target points.
    pub t_target_source: Isometry3<f64>,
    /// Residuals and conditioning.
    pub report: CoarseReport,
}

/// Residuals and conditioning of a coarse fit.
///
/// The residuals (and their RMS, the FRE) do not measure accuracy: a shift common to all points leaves them unchanged,
/// and so does a mirror image of the whole configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CoarseReport {
    /// The pairs, in the target's order.
    pub pairs: Vec<CoarsePair>,
    /// RMS residual of the pairs, mm. Not an accuracy.
    pub fre_mm: f64,
    /// Distances between the points in the target and in the source, which do not depend on the fit.
    pub sides: Vec<CoarseSide>,
    /// RMS distance of the target points from their best line, mm: second singular value over √n. The smaller it is,
    /// the less is known of the turn about that line.
    pub target_off_line_mm: f64,
    /// RMS distance of the source points from their best line, mm.
    pub source_off_line_mm: f64,
    /// An order of the source names that would fit far better, if there is one: were two points swapped?
    pub permutation: Option<Permutation>,
}

/// One pair of a coarse fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CoarsePair {
    /// The name of both points.
    pub name: String,
    /// Moved source point minus target point, mm, in the target's frame.
    pub residual: [f64; 3],
    /// Norm of the residual, mm.
    pub residual_mm: f64,
}

/// The distance between two of the points.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CoarseSide {
    /// One end.
    pub from: String,
    /// The other end.
    pub to: String,
    /// Its length between the target points, mm.
    pub target_mm: f64,
    /// Its length between the source points, mm.
    pub source_mm: f64,
    /// Source minus target, mm.
    pub difference_mm: f64,
}

/// A pairing that would fit far better than that by name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Permutation {
    /// For each target point in order, the source point that fits it.
    pub source_names: Vec<String>,
    /// RMS residual of that pairing, mm.
    pub fre_mm: f64,
}

/// Rigid motion from three or more points located both in the target (planned on the CT) and in the source (laser holes
/// or stylus), paired by name; their order does not matter.
///
/// # Errors
/// [`Refusal`] if names do not pair, there are fewer than three pairs, or the points lie close to a line.
///
/// # Source
/// Section 2.3 of the paper. That FRE does not predict TRE: Fitzpatrick 2009.
pub fn three_point(target: &[NamedPoint], source: &[NamedPoint]) -> Result<CoarseFit, Refusal> {
    let source = paired(target, source)?;
    let t: Vec<Point3<f64>> = target.iter().map(|p| p.position).collect();
    let s: Vec<Point3<f64>> = source.iter().map(|p| p.position).collect();
    let sides = sides(target, &source);
    if let Some(refusal) = other_unit(&sides) {
        return Err(refusal);
    }
    let t_target_source = kabsch(&t, &s)?;
    let (target_off_line_mm, source_off_line_mm) = (off_line_mm(&t), off_line_mm(&s));
    for (side, off_line_mm) in [("target", target_off_line_mm), ("source", source_off_line_mm)] {
        if off_line_mm < MIN_OFF_LINE_MM {
            return Err(Refusal::of(format!(
                "the {side} points lie {off_line_mm:.2} mm (RMS) off a line, {MIN_OFF_LINE_MM} mm is needed to fix the turn about \
                 it; choose landmarks off the line, in mm"
            )));
        }
    }
    let pairs: Vec<CoarsePair> = target
        .iter()
        .zip(&s)
        .map(|(target, s)| {
            let residual = t_target_source * s - target.position;
            let name = target.name.to_string();
            CoarsePair { name, residual: residual.into(), residual_mm: residual.norm() }
        })
        .collect();
    let fre_mm = rms(&t_target_source, &t, &s);
    let report = CoarseReport {
        pairs,
        fre_mm,
        sides,
        target_off_line_mm,
        source_off_line_mm,
        permutation: better_order(&t, &source, fre_mm),
    };
    Ok(CoarseFit { t_target_source, report })
}

/// The refusal of points of which one side is as much smaller than the other as another unit makes it.
fn other_unit(sides: &[CoarseSide]) -> Option<Refusal> {
    let mean = |mm: fn(&CoarseSide) -> f64| sides.iter().map(mm).sum::<f64>() / sides.len() as f64;
    let [target_mm, source_mm] = [mean(|side| side.target_mm), mean(|side| side.source_mm)];
    let ratio = (target_mm / source_mm).max(source_mm / target_mm);
    let (unit_mm, name) = UNITS.iter().find(|(unit_mm, _)| (ratio / unit_mm - 1.0).abs() < UNIT_TOLERANCE)?;
    let small = if target_mm < source_mm { "target" } else { "source" };
    Some(Refusal::of(format!(
        "the target points lie {target_mm:.2} mm apart (mean) and the source points {source_mm:.2} mm: are the {small} points in {name}? \
         Write them in mm: osteoflow convert POINTS OUT.csv --scale {unit_mm}"
    )))
}

/// The source points in the order of the target's names.
fn paired<'a>(target: &[NamedPoint], source: &'a [NamedPoint]) -> Result<Vec<&'a NamedPoint>, Refusal> {
    for (side, points) in [("target", target), ("source", source)] {
        for (k, point) in points.iter().enumerate() {
            if points[..k].iter().any(|p| p.name == point.name) {
                let name = &point.name;
                return Err(Refusal::of(format!(
                    "{name} is there twice among the {side} points; name each point once"
                )));
            }
        }
    }
    let names = |points: &[NamedPoint]| points.iter().map(|p| &*p.name).collect::<Vec<_>>().join(", ");
    let lonely = |side: &str, name: &str| {
        Refusal::of(format!(
            "{side} point {name} has no point of that name on the other side; the target has {}, the source has {}",
            names(target),
            names(source)
        ))
    };
    if let Some(extra) = source.iter().find(|s| target.iter().all(|t| t.name != s.name)) {
        return Err(lonely("source", &extra.name));
    }
    target.iter().map(|t| source.iter().find(|s| s.name == t.name).ok_or_else(|| lonely("target", &t.name))).collect()
}

fn sides(target: &[NamedPoint], source: &[&NamedPoint]) -> Vec<CoarseSide> {
    let mut sides = Vec::new();
    for i in 0..target.len() {
        for j in i + 1..target.len() {
            let target_mm = (target[i].position - target[j].position).norm();
            let source_mm = (source[i].position - source[j].position).norm();
            sides.push(CoarseSide {
                from: target[i].name.to_string(),
                to: target[j].name.to_string(),
                target_mm,
                source_mm,
                difference_mm: source_mm - target_mm,
            });
        }
    }
    sides
}

/// RMS distance of the points from the line that fits them best, mm.
fn off_line_mm(points: &[Point3<f64>]) -> f64 {
    let centre = centroid(points);
    let scatter: Matrix3<f64> = points.iter().map(|p| (p - centre) * (p - centre).transpose()).sum();
    let mut squares: [f64; 3] = scatter.symmetric_eigenvalues().into();
    squares.sort_by(f64::total_cmp);
    // The two smaller singular values hold the distances from the line; of three points the smallest is zero.
    ((squares[0] + squares[1]).max(0.0) / points.len() as f64).sqrt()
}

pub(crate) fn rms(t_target_source: &Isometry3<f64>, target: &[Point3<f64>], source: &[Point3<f64>]) -> f64 {
    let squares: f64 = target.iter().zip(source).map(|(t, s)| (t_target_source * s - t).norm_squared()).sum();
    (squares / target.len() as f64).sqrt()
}

/// The order of the source points that fits best, if it fits far better than that by name.
fn better_order(target: &[Point3<f64>], source: &[&NamedPoint], fre_mm: f64) -> Option<Permutation> {
    if fre_mm <= HINT_ABOVE_MM {
        return None;
    }
    let (other_mm, source_names) = best_other_order(target, source)?;
    (other_mm < HINT_SHARE * fre_mm).then_some(Permutation { source_names, fre_mm: other_mm })
}

/// The order of the source points, other than the given one, that fits best, by name, with its RMS residual in mm; `None`
/// with more than six points. Orders are tried in lexicographic order.
pub(crate) fn best_other_order(target: &[Point3<f64>], source: &[&NamedPoint]) -> Option<(f64, Vec<String>)> {
    let n = source.len();
    let mut order: Vec<usize> = (0..n).collect();
    let mut best: Option<(f64, Vec<usize>)> = None;
    while n <= MAX_PERMUTED
        && let Some(i) = (1..n).rev().find(|&i| order[i - 1] < order[i])
    {
        let j = (i..n).rev().find(|&j| order[j] > order[i - 1]).unwrap_or(i);
        order.swap(i - 1, j);
        order[i..].reverse();
        let moved: Vec<Point3<f64>> = order.iter().map(|&k| source[k].position).collect();
        let Ok(t) = kabsch(target, &moved) else { continue };
        let fre_mm = rms(&t, target, &moved);
        if best.as_ref().is_none_or(|(least, _)| fre_mm < *least) {
            best = Some((fre_mm, order.clone()));
        }
    }
    best.map(|(fre_mm, order)| (fre_mm, order.iter().map(|&k| source[k].name.to_string()).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn named(points: &[[f64; 3]]) -> Vec<NamedPoint> {
        points.iter().enumerate().map(|(k, p)| NamedPoint::new(format!("P{}", k + 1), Point3::from(*p))).collect()
    }

    fn triangle() -> Vec<NamedPoint> {
        named(&[[0.0, 0.0, 100.0], [6.0, -6.0, 130.0], [-1.0, 1.0, 125.0]])
    }

    fn moved(points: &[NamedPoint], by: &Isometry3<f64>) -> Vec<NamedPoint> {
        points.iter().map(|p| NamedPoint::new(p.name.clone(), by * p.position)).collect()
    }

    #[test]
    fn points_pair_by_name_whatever_their_order() {
        let truth = Isometry3::new(Vector3::new(3.0, 4.0, 5.0), Vector3::new(0.1, 2.0, -0.4));
        let mut source = moved(&triangle(), &truth.inverse());
        source.rotate_left(1);
        let fit = three_point(&triangle(), &source).unwrap();
        assert!((fit.t_target_source.to_homogeneous() - truth.to_homogeneous()).amax() < 1e-12);
        assert_eq!(fit.report.pairs[0].name, "P1");
        assert!(fit.report.fre_mm < 1e-12 && fit.report.permutation.is_none());
        assert!(fit.report.sides.iter().all(|s| s.difference_mm.abs() < 1e-12));
    }

    #[test]
    fn the_sides_are_the_distances_between_the_points() {
        let target = named(&[[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [0.0, 4.0, 0.0]]);
        let source = named(&[[1.0, 1.0, 1.0], [1.0, 7.0, 9.0], [1.0, 7.0, 1.0]]);
        let sides = three_point(&target, &source).unwrap().report.sides;
        let side = |from: &str, to: &str, target_mm, source_mm, difference_mm| CoarseSide {
            from: from.into(),
            to: to.into(),
            target_mm,
            source_mm,
            difference_mm,
        };
        let expected =
            [side("P1", "P2", 5.0, 10.0, 5.0), side("P1", "P3", 4.0, 6.0, 2.0), side("P2", "P3", 3.0, 8.0, 5.0)];
        assert_eq!(sides, expected);
    }

    #[test]
    fn a_shift_of_all_points_leaves_the_fre_unchanged() {
        let noisy = named(&[[0.4, 0.0, 100.0], [6.0, -6.3, 130.0], [-1.0, 1.0, 125.5]]);
        let here = three_point(&triangle(), &noisy).unwrap().report;
        let there = three_point(&triangle(), &moved(&noisy, &Isometry3::translation(0.0, 0.0, 10.0))).unwrap().report;
        assert!(here.fre_mm > 0.1 && (here.fre_mm - there.fre_mm).abs() < 1e-12);
    }

    #[test]
    fn swapped_points_are_reported_with_the_better_order() {
        let mut source = triangle();
        let (a, b) = (source[0].position, source[2].position);
        (source[0].position, source[2].position) = (b, a);
        let hint = three_point(&triangle(), &source).unwrap().report.permutation.unwrap();
        assert_eq!(hint.source_names, ["P3", "P2", "P1"]);
        assert!(hint.fre_mm < 1e-12);
    }

    #[test]
    fn collinearity_is_judged_in_millimetres() {
        let nearly = named(&[[0.0, 0.0, 0.0], [0.0, 0.8, 15.0], [0.0, 0.0, 30.0]]);
        let error = three_point(&nearly, &nearly).unwrap_err();
        assert!(error.to_string().starts_with("the target points lie 0.38 mm"), "{error}");
        // An apex 9 mm off a base lies 6 mm off the best line, the base 3 mm: √((36 + 9 + 9) / 3).
        let apex = named(&[[0.0, 0.0, 0.0], [0.0, 9.0, 15.0], [0.0, 0.0, 30.0]]);
        let report = three_point(&apex, &apex).unwrap().report;
        assert!((report.target_off_line_mm - 18_f64.sqrt()).abs() < 1e-12, "{}", report.target_off_line_mm);
    }

    #[test]
    fn names_that_do_not_pair_are_named() {
        let three = triangle();
        let mut other = three.clone();
        other[1].name = "Q2".into();
        let message = three_point(&three, &other).unwrap_err().to_string();
        assert!(message.contains("Q2") && message.contains("P1, P2, P3"), "{message}");
        other[1].name = "P1".into();
        assert!(three_point(&three, &other).unwrap_err().to_string().contains("twice among the source points"));
        let two = three_point(&three[..2], &three[..2]).unwrap_err().to_string();
        assert_eq!(two, "three or more pairs are needed, but there are 2 target and 2 source points");
    }
}
