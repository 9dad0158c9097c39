//! Patches of a scan, small enough that some hold nothing but the bone.

use super::axis::connected;
use crate::axes::principal;
use crate::downsample::thinned;
use nalgebra::Point3;

/// Number of scan points, evenly through their order, that patches are made of.
const N_LOOKED_AT: usize = 20_000;

/// Number of points, evenly through their order, that patches are looked for about.
const N_CENTRES: usize = 128;

/// Minimum number of points of a patch.
const MIN_POINTS: usize = 60;

/// Minimum distance between centres of patches of one part, as a share of their radius.
const APART: f64 = 0.7;

/// A patch whose thickness is less than this share of its width is flat, and fits anywhere.
const FLAT: f64 = 0.04;

/// Up to `n` patches, those of most points: the points of one connected part of the scan within a ball.
pub(super) fn patches(points: &[Point3<f64>], radius_mm: f64, n: usize) -> Vec<Vec<Point3<f64>>> {
    let some = thinned(points, N_LOOKED_AT);
    let mut found: Vec<Vec<Point3<f64>>> = Vec::new();
    for part in connected(&some) {
        let n_centres = N_CENTRES * part.len() / some.len();
        let mut centres: Vec<Point3<f64>> = Vec::new();
        for centre in thinned(&part, n_centres.max(1)) {
            if centres.iter().any(|other| (other - centre).norm() < APART * radius_mm) {
                continue;
            }
            let patch: Vec<Point3<f64>> = part.iter().filter(|p| (*p - centre).norm() <= radius_mm).copied().collect();
            let (_, _, variances) = principal(&patch);
            if patch.len() >= MIN_POINTS && variances[2] > FLAT * FLAT * variances[1] {
                centres.push(centre);
                found.push(patch);
            }
        }
    }
    found.sort_by_key(|patch| std::cmp::Reverse(patch.len()));
    found.truncate(n);
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    /// A dome of radius 20 mm, a point in about a millimetre, its foot at the origin.
    fn dome() -> Vec<Point3<f64>> {
        let at = |k: i32| (f64::from(k % 37) - 18.0, f64::from(k / 37) - 18.0);
        let on = (0..37 * 37).map(at).filter(|(x, y)| x * x + y * y < 18.0 * 18.0);
        on.map(|(x, y)| Point3::new(x, y, (400.0 - x * x - y * y).sqrt())).collect()
    }

    #[test]
    fn a_patch_is_of_one_part_within_the_ball_and_flat_ones_are_left_out() {
        let table = (0..60 * 60).map(|k| Point3::new(f64::from(k % 60) - 30.0, f64::from(k / 60) - 30.0, -10.0));
        let beside = dome().into_iter().map(|p| p + Vector3::new(60.0, 0.0, 0.0));
        let points: Vec<Point3<f64>> = table.chain(dome()).chain(beside).collect();
        let found = patches(&points, 25.0, 16);
        assert!(found.len() >= 2, "{} patches", found.len());
        for patch in &found {
            assert!(patch.iter().all(|p| p.z > 0.0), "a patch has points of the table");
            let is_left = patch[0].x < 30.0;
            assert!(patch.iter().all(|p| (p.x < 30.0) == is_left), "a patch has points of both domes");
            let apart = |p: &Point3<f64>| patch.iter().map(|q| (p - q).norm()).fold(0.0, f64::max);
            assert!(patch.iter().all(|p| apart(p) <= 50.0) && patch.len() >= MIN_POINTS);
        }
        assert!(found.windows(2).all(|two| two[0].len() >= two[1].len()));
        assert_eq!(patches(&points, 25.0, 1), found[..1]);
        assert!(patches(&points, 3.0, 16).is_empty(), "balls of few points");
    }
}
