//! Points that stand for pixels without depth.

use nalgebra::Point3;

/// A value that more than this share of the points have is no place on a surface.
const SHARED: f64 = 0.01;

/// Points that are farther from all others than this many times the distance between neighbours are no part of their surface.
const ISOLATED: f64 = 20.0;

/// Number of points that are looked at for values that many of them share.
const LOOKED_AT: usize = 4096;

/// Number of points whose nearest neighbours tell the distance between neighbours.
const MEDIAN_OF: usize = 50;

/// Pixels without depth among points.
pub(crate) struct Invalid {
    /// For each point whether it is none of them.
    pub(crate) keep: Vec<bool>,
    /// Number of them.
    pub(crate) n: usize,
    /// Says how many there are, and where.
    pub(crate) note: String,
}

/// The pixels without depth among the finite ones of `n_points` points, if there are some.
pub(crate) fn invalid(points: &[Point3<f64>], n_points: usize) -> Option<Invalid> {
    let values = values(points);
    let keep: Vec<bool> = points.iter().map(|p| values.iter().all(|(value, _)| value != p)).collect();
    let n = values.iter().map(|(_, n)| n).sum();
    let shown: Vec<String> =
        values.iter().map(|(p, n)| format!("{n} at {}, {}, {}", p.x + 0.0, p.y + 0.0, p.z + 0.0)).collect();
    let shown = shown.join(", ");
    let note =
        format!("{n} of {n_points} points are pixels without depth, far from all others ({shown}), and were left out");
    (n > 0).then_some(Invalid { keep, n, note })
}

/// Values of pixels without depth, in the scanner's own numbers, and how many points have each.
///
/// That is a value that more than 1 % of the points share, if it is farther from each of the others than 20 times the median distance between
/// neighbours; and 0, 0, 0 of fewer, if it is also outside of the box around all others. `O(n)`.
fn values(points: &[Point3<f64>]) -> Vec<(Point3<f64>, usize)> {
    let mut values = shared(points);
    let n_shared = values.len();
    if points.contains(&Point3::origin()) && !values.contains(&Point3::origin()) {
        values.push(Point3::origin());
    }
    if values.is_empty() {
        return Vec::new();
    }
    let others: Vec<Point3<f64>> = points.iter().filter(|p| !values.contains(p)).copied().collect();
    let Some(&first) = others.first() else { return Vec::new() };
    let (low, high) = others.iter().fold((first, first), |(low, high), p| (low.inf(p), high.sup(p)));
    let far_mm = ISOLATED * spacing(&others);
    let is_invalid = |(k, value): &(usize, Point3<f64>)| {
        let is_outside = (0..3).any(|axis| value[axis] < low[axis] || value[axis] > high[axis]);
        (*k < n_shared || is_outside) && others.iter().all(|p| (p - value).norm() > far_mm)
    };
    let counted = |(_, value): (usize, Point3<f64>)| (value, points.iter().filter(|p| **p == value).count());
    values.into_iter().enumerate().filter(is_invalid).map(counted).collect()
}

/// The values that more than [`SHARED`] of the points, and at least two, have.
fn shared(points: &[Point3<f64>]) -> Vec<Point3<f64>> {
    let step = points.len().div_ceil(LOOKED_AT).max(1);
    let mut sample: Vec<Point3<f64>> = points.iter().step_by(step).copied().collect();
    let key = |p: &Point3<f64>| (p.x + 0.0, p.y + 0.0, p.z + 0.0);
    sample.sort_unstable_by(|a, b| {
        let (a, b) = (key(a), key(b));
        a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.total_cmp(&b.2))
    });
    // Half the share, as the sample may have fewer of them.
    let enough = (sample.len() as f64 * SHARED / 2.0).max(1.0);
    let often = sample.chunk_by(|a, b| a == b).filter(|same| same.len() as f64 > enough).map(|same| same[0]);
    let n_of = |value: &Point3<f64>| points.iter().filter(|p| *p == value).count();
    often.filter(|value| n_of(value) as f64 > (SHARED * points.len() as f64).max(1.0)).collect()
}

/// Median distance of points to the nearest that is elsewhere.
fn spacing(points: &[Point3<f64>]) -> f64 {
    let nearest = |at: &Point3<f64>| {
        let squares = points.iter().map(|p| (p - at).norm_squared()).filter(|square| *square > 0.0);
        squares.fold(f64::INFINITY, f64::min).sqrt()
    };
    let mut all: Vec<f64> = points.iter().step_by(points.len().div_ceil(MEDIAN_OF).max(1)).map(nearest).collect();
    all.sort_unstable_by(f64::total_cmp);
    all[all.len() / 2]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sheet of 1 mm, 300 mm in front of the camera.
    fn sheet() -> Vec<Point3<f64>> {
        (0..2500).map(|k| Point3::new(f64::from(k % 50) - 25.0, f64::from(k / 50) - 25.0, 300.0)).collect()
    }

    #[test]
    fn pixels_without_depth_are_those_at_zero_or_at_one_value_that_nothing_surrounds() {
        let with = |more: &[(Point3<f64>, usize)]| {
            let mut points = sheet();
            more.iter().for_each(|(value, n)| points.splice(7..7, vec![*value; *n]).for_each(drop));
            values(&points)
        };
        let (zero, clipped) = (Point3::origin(), Point3::new(0.0, 0.0, 9999.0));
        assert_eq!(with(&[]), []);
        assert_eq!(with(&[(zero, 1)]), [(zero, 1)]);
        assert_eq!(with(&[(zero, 700), (clipped, 900)]), [(zero, 700), (clipped, 900)]);
        // Too few of a value that is not zero, a value on the surface, and one beside it.
        assert_eq!(with(&[(clipped, 20)]), []);
        assert_eq!(with(&[(Point3::new(0.0, 0.0, 300.0), 400)]), []);
        assert_eq!(with(&[(Point3::new(0.0, 0.0, 310.0), 400)]), []);
        // A corner of a surface at the origin, and a scan around it.
        let moved: Vec<_> = sheet().iter().map(|p| Point3::new(p.x + 25.0, p.y + 25.0, 0.0)).collect();
        assert_eq!(values(&moved), []);
        let around: Vec<_> = sheet().iter().flat_map(|p| [*p, Point3::new(p.x, p.y, -300.0)]).chain([zero]).collect();
        assert_eq!(values(&around), []);
        // A laser that turns in a room gives its own place for what it does not see.
        let in_room: Vec<_> = around.iter().copied().chain([zero; 200]).collect();
        assert_eq!(values(&in_room), [(zero, 201)]);
        assert_eq!(values(&[zero; 9]), []);
        assert_eq!(values(&[]), []);
    }

    #[test]
    fn the_note_counts_them_and_the_others_are_kept() {
        let points: Vec<_> = sheet().into_iter().chain([Point3::origin(); 3]).collect();
        let Invalid { keep, n, note } = invalid(&points, 2600).unwrap();
        assert_eq!((n, keep.iter().filter(|keep| **keep).count(), keep[2500..].to_vec()), (3, 2500, vec![false; 3]));
        assert!(note.starts_with("3 of 2600 points are pixels without depth"), "{note}");
        assert!(note.contains("(3 at 0, 0, 0)"), "{note}");
        assert!(invalid(&sheet(), 2500).is_none());
    }
}
