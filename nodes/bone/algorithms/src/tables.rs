//! Planes in a scan on which it is wider than the whole surface: a table under the part, or a wall behind it.

use crate::axes::{directions, principal};
use crate::downsample::thinned;
use crate::target::Target;
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::Cloud;

/// Number of points, evenly through their order, that planes are looked for by, and that widths are taken of.
const N_LOOKED_AT: usize = 2000;
const N_WIDTH: usize = 5000;

/// Number of planes through three points that are looked at: of one with a fifth of the points, four on average.
const N_PLANES: usize = 500;

/// A plane has at least this share of the points...
const SHARE: f64 = 0.2;

/// ...within this distance, mm, which a depth camera's noise leaves; in a scan of a smaller radius than 10 mm in proportion...
const WITHIN_MM: f64 = 2.0;

/// ...and at its two ends, of this share of its width, at most so many times as many points as far again to both sides: else it is a slice
/// of something thick there.
const END: f64 = 0.15;
const BESIDE: f64 = 0.5;

/// As many times the surface's width a plane is at least wide: at the edges of what they see, cameras see it wider than it is.
const WIDER: f64 = 1.03;

/// Outermost points that tell no width.
const N_STRAY: usize = 3;

/// Maximum number of planes, and minimum number of points that are left.
const MAX_TABLES: usize = 3;
const MIN_REST: usize = 200;

/// The scan without the planes on which it is wider than the whole surface, which are none of the surface's; `None` if there are none, or
/// hardly anything else.
///
/// `O(n)`. The order of the other points stays.
///
/// # Source
/// Fischler and Bolles 1981, Random sample consensus; the samples are a sequence of low discrepancy.
pub fn off_tables(target: &Target, scan: &Cloud) -> Option<Cloud> {
    // Of most scans of a part of the surface this is all.
    if extent(scan.points()).norm() <= extent(target.points()).max() {
        return None;
    }
    let width_mm = WIDER * width(&thinned(target.points(), N_WIDTH), 0).0;
    let mut rest: Option<Vec<usize>> = None;
    for _ in 0..MAX_TABLES {
        let kept = rest.clone().unwrap_or_else(|| (0..scan.len()).collect());
        let points: Vec<Point3<f64>> = kept.iter().map(|&k| scan.points()[k]).collect();
        if points.len() < 3 || width(&thinned(&points, N_WIDTH), N_STRAY).0 <= width_mm {
            break;
        }
        let Some((at, normal, within_mm)) = plane(&thinned(&points, N_LOOKED_AT)) else { break };
        let is_within = |p: &Point3<f64>, mm: f64| (p - at).dot(&normal).abs() <= mm;
        let on: Vec<Point3<f64>> = points.iter().filter(|p| is_within(p, within_mm)).copied().collect();
        let (on_mm, middle_mm, way) = width(&thinned(&on, N_WIDTH), N_STRAY);
        let at_ends = |p: &&Point3<f64>| (p.coords.dot(&way) - middle_mm).abs() > (0.5 - END) * on_mm;
        let [n_on, n_near] = [1.0, 2.0]
            .map(|times| points.iter().filter(at_ends).filter(|p| is_within(p, times * within_mm)).count() as f64);
        if on_mm <= width_mm || n_near - n_on > BESIDE * n_on {
            break;
        }
        rest = Some(kept.into_iter().filter(|&k| !is_within(&scan.points()[k], within_mm)).collect());
    }
    rest.filter(|rest| rest.len() >= MIN_REST).map(|rest| scan.selected(&rest))
}

/// The lengths of the box around points along the axes.
fn extent(points: &[Point3<f64>]) -> Vector3<f64> {
    let first = points.first().copied().unwrap_or_default();
    let (low, high) = points.iter().fold((first, first), |(low, high), p| (low.inf(p), high.sup(p)));
    high - low
}

/// The largest distance between points along any of some directions, but for some outermost ones at either end; the height of their
/// middle along it, and the direction.
fn width(points: &[Point3<f64>], n_stray: usize) -> (f64, f64, Vector3<f64>) {
    // Of the whole sphere the upper half.
    const N: usize = 96;
    let along = |way: Vector3<f64>| {
        let mut heights: Vec<f64> = points.iter().map(|p| p.coords.dot(&way)).collect();
        let last = heights.len().checked_sub(1 + n_stray).filter(|last| *last > n_stray)?;
        let high = *heights.select_nth_unstable_by(last, f64::total_cmp).1;
        let low = *heights.select_nth_unstable_by(n_stray, f64::total_cmp).1;
        Some((high - low, (high + low) / 2.0, way))
    };
    directions(2 * N).take(N).filter_map(along).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or_default()
}

/// A point and the normal of the plane that most of the points are on, and the distance within which they are; `None` if those are few.
fn plane(points: &[Point3<f64>]) -> Option<(Point3<f64>, Vector3<f64>, f64)> {
    let n = points.len();
    let (_, _, variances) = principal(points);
    let within_mm = WITHIN_MM * (variances.iter().sum::<f64>().sqrt() / 10.0).min(1.0);
    let on = |at: &Point3<f64>, normal: &Vector3<f64>| -> Vec<Point3<f64>> {
        points.iter().filter(|p| (*p - at).dot(normal).abs() <= within_mm).copied().collect()
    };
    let through = |k: usize| {
        // Powers of the inverse of the root of x^4 = x + 1, whose multiples are spread evenly.
        let [a, b, c] = [0.819_172_513_396_164_4, 0.671_043_606_703_789_3, 0.549_700_477_901_970_3_f64]
            .map(|by| points[((k as f64 * by).fract() * n as f64) as usize % n]);
        let normal = (b - a).cross(&(c - a)).try_normalize(1e-9)?;
        Some((points.iter().filter(|p| (*p - a).dot(&normal).abs() <= within_mm).count(), a, normal))
    };
    let (_, mut at, mut normal) = (1..=N_PLANES).filter_map(through).max_by_key(|(n, ..)| *n)?;
    for _ in 0..3 {
        let (middle, axes, _) = principal(&on(&at, &normal));
        (at, normal) = (middle, axes[2]);
    }
    (on(&at, &normal).len() as f64 >= SHARE * n as f64).then_some((at, normal, within_mm))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Isometry3;
    use osteoflow_geometry::SurfaceOrigin;
    use rand::RngExt;
    use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

    /// Points of a block of 60 x 40 x 30 mm on the plane z = 0, of its upper half only or of all.
    fn block(n: usize, is_seen_from_above: bool, rng: &mut ChaCha8Rng) -> Vec<Point3<f64>> {
        let half = Vector3::new(30.0, 20.0, 15.0);
        let mut one = || {
            let way = Vector3::from_fn(|_, _| 2.0 * rng.random::<f64>() - 1.0);
            Point3::from((way / way.amax()).component_mul(&half) + Vector3::z() * 15.0)
        };
        let is_seen = |p: &Point3<f64>| !is_seen_from_above || p.z > 4.0;
        std::iter::from_fn(|| Some(one())).filter(is_seen).take(n).collect()
    }

    /// A sheet of this width about the block with noise of up to `noise_mm` to either side.
    fn sheet(n: usize, width_mm: [f64; 2], noise_mm: f64, rng: &mut ChaCha8Rng) -> Vec<Point3<f64>> {
        let mut one = || {
            let [x, y, z] = [(); 3].map(|()| 2.0 * rng.random::<f64>() - 1.0);
            Point3::new(x * width_mm[0] / 2.0, y * width_mm[1] / 2.0, z * noise_mm)
        };
        let is_beside = |p: &Point3<f64>| p.x.abs() > 30.0 || p.y.abs() > 20.0;
        std::iter::from_fn(|| Some(one())).filter(is_beside).take(n).collect()
    }

    /// Number of points of the block and of what is around it that are left, in lengths of `unit_mm`; `None` if nothing is left out.
    fn left(around: &[Point3<f64>], unit_mm: f64) -> Option<(usize, usize)> {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let scaled = |points: &[Point3<f64>]| points.iter().map(|p| p * unit_mm).collect::<Vec<_>>();
        let target = Target::new("ct", SurfaceOrigin::Exact, scaled(&block(9000, false, &mut rng)), None).unwrap();
        let n = 3000;
        let t = Isometry3::new(Vector3::new(80.0, -300.0, 500.0), Vector3::new(1.0, -0.4, 2.0));
        let all = [block(n, true, &mut rng), around.to_vec()].concat();
        // In another order than that of the parts.
        let order: Vec<usize> = (0..all.len()).map(|k| k * 7919 % all.len()).collect();
        let moved =
            scaled(&order.iter().map(|&k| all[k]).collect::<Vec<_>>()).iter().map(|p| t * p).collect::<Vec<_>>();
        let rest = off_tables(&target, &Cloud::new("scan", moved.clone()).unwrap())?;
        let mut from = moved.iter().zip(&order);
        let kept = rest.points().iter().map(|p| *from.find(|(q, _)| *q == p).expect("points in their order").1);
        let (own, other): (Vec<usize>, Vec<usize>) = kept.partition(|k| *k < n);
        Some((own.len(), other.len()))
    }

    #[test]
    fn a_table_wider_than_the_part_is_left_out_at_any_scale_and_the_part_stays() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let table = sheet(4001, [130.0, 90.0], 1.5, &mut rng);
        let wall: Vec<Point3<f64>> = sheet(4001, [130.0, 90.0], 0.5, &mut rng)
            .iter()
            .map(|p| Point3::new(p.x, 28.0 + p.z, p.y + 30.0))
            .collect();
        let (own, other) = left(&table, 1.0).expect("there is a table");
        assert!(own == 3000 && other < 40, "{own} and {other} points left");
        let (own, other) = left(&[table.clone(), wall].concat(), 1.0).expect("there are two planes");
        assert!(own == 3000 && other < 200, "{own} and {other} points left of two");
        // Of a part of 6 mm what is within 1 mm of the table goes with it.
        let (own, other) = left(&table, 0.1).expect("there is a table");
        assert!((2000..3000).contains(&own) && other < 40, "{own} and {other} points left of a small part");
    }

    #[test]
    fn the_part_alone_narrow_planes_and_what_is_thick_are_left_as_they_are() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        assert_eq!(left(&[], 1.0), None);
        // Its box is as wide as the part.
        assert_eq!(left(&sheet(4001, [60.0, 46.0], 1.0, &mut rng), 1.0), None);
        assert_eq!(left(&sheet(4001, [130.0, 90.0], 30.0, &mut rng), 1.0), None);
        // Beside the part 2.5 mm apart, and few.
        assert_eq!(left(&sheet(500, [130.0, 90.0], 1.0, &mut rng), 1.0), None);
        let nothing = Cloud::new("scan", Vec::<Point3<f64>>::new()).unwrap();
        let target = Target::new("ct", SurfaceOrigin::Exact, block(900, false, &mut rng), None).unwrap();
        assert_eq!(off_tables(&target, &nothing), None);
        // A table alone.
        let table = Cloud::new("scan", sheet(3000, [130.0, 90.0], 1.0, &mut rng)).unwrap();
        assert_eq!(off_tables(&target, &table), None);
    }
}
