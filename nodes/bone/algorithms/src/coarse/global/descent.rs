//! Point-to-plane steps on a [`NearMap`].

use crate::downsample::thinned;
use crate::target::NearMap;
use nalgebra::{Isometry3, Matrix6, Point3, UnitQuaternion, Vector3, Vector6};
use rayon::prelude::*;

/// Cosine between a normal and the direction to the camera below which a sample is on the far side.
const FAR_SIDE: f64 = -0.2;

/// Damping of a step, as a share of each diagonal entry of the normal matrix.
const DAMPING: f64 = 1e-3;

/// A scan about its centroid, and the place of its camera there.
pub(crate) struct Points {
    pub(crate) points: Vec<Vector3<f64>>,
    pub(crate) camera: Option<Vector3<f64>>,
}

impl Points {
    /// About `n` of the points, about their centroid.
    pub(crate) fn thinned(
        points: &[Point3<f64>],
        n: usize,
        centroid: &Point3<f64>,
        camera: Option<Point3<f64>>,
    ) -> Self {
        let points = thinned(points, n).iter().map(|p| p - centroid).collect();
        Self { points, camera: camera.map(|camera| camera - centroid) }
    }
}

/// A pose that takes points about their centroid to positions about the map's centre.
pub(crate) type Placed = Isometry3<f64>;

/// The motion that takes points with this centroid onto the map's surface.
pub(crate) fn motion(map: &NearMap, centroid: &Point3<f64>, placed: &Placed) -> Isometry3<f64> {
    let to = map.centre().coords + placed.translation.vector;
    Isometry3::from_parts((to - placed.rotation * centroid.coords).into(), placed.rotation)
}

/// The starts after up to `n_steps` on the map with their scores, best first.
pub(crate) fn descended(
    map: &NearMap,
    scan: &Points,
    starts: &[Placed],
    reach_mm: f64,
    n_steps: usize,
) -> Vec<(f64, Placed)> {
    let one = |start: &Placed| {
        let placed = descend(map, scan, start, reach_mm, n_steps);
        (score(map, scan, &placed, reach_mm), placed)
    };
    let mut ends: Vec<(f64, Placed)> = starts.par_iter().map(one).collect();
    ends.sort_by(|a, b| a.0.total_cmp(&b.0));
    ends
}

/// The first `n` of the poses that are no closer than `apart_mm` (RMS over `n_probes` points) to an earlier one.
pub(crate) fn distinct(
    sorted: Vec<(f64, Placed)>,
    scan: &Points,
    n_probes: usize,
    apart_mm: f64,
    n: usize,
) -> Vec<Placed> {
    let points = &scan.points;
    let probes: Vec<Point3<f64>> =
        points.iter().step_by((points.len() / n_probes).max(1)).map(|p| Point3::from(*p)).collect();
    let square = |a: &Placed, b: &Placed| probes.iter().map(|p| (a * p - b * p).norm_squared()).sum::<f64>();
    let limit = apart_mm * apart_mm * probes.len() as f64;
    let mut kept: Vec<Placed> = Vec::new();
    for (_, placed) in sorted {
        if kept.len() >= n {
            break;
        }
        if kept.iter().all(|other| square(other, &placed) > limit) {
            kept.push(placed);
        }
    }
    kept
}

/// RMS distance from the surface, with distances limited to `reach_mm`.
fn score(map: &NearMap, scan: &Points, placed: &Placed, reach_mm: f64) -> f64 {
    let camera = scan.camera.map(|camera| placed.rotation * camera + placed.translation.vector);
    let squares = scan.points.iter().map(|p| {
        let moved = placed.rotation * p + placed.translation.vector;
        residual(map, &moved, camera.as_ref(), reach_mm).map_or(reach_mm * reach_mm, |(_, r)| r * r)
    });
    (squares.sum::<f64>() / scan.points.len().max(1) as f64).sqrt()
}

/// The direction and length of a point's distance from the surface, if it is within reach on the near side.
#[inline]
fn residual(
    map: &NearMap,
    moved: &Vector3<f64>,
    camera: Option<&Vector3<f64>>,
    reach_mm: f64,
) -> Option<(Vector3<f64>, f64)> {
    let sample = map.near(moved)?;
    let off = moved - sample.point;
    if sample.normal == Vector3::zeros() {
        let distance = off.norm();
        return (distance <= reach_mm && distance > 0.0).then(|| (off / distance, distance));
    }
    if camera.is_some_and(|camera| sample.normal.dot(&(camera - moved).normalize()) < FAR_SIDE) {
        return None;
    }
    let along = off.dot(&sample.normal);
    // A sample may be half a voxel aside of the closest point.
    (along.abs() <= reach_mm && off.norm_squared() <= (reach_mm + map.grid().1).powi(2))
        .then_some((sample.normal, along))
}

/// `n_steps` point-to-plane steps with pairs no farther than `reach_mm`; ends early where too few pairs are left.
fn descend(map: &NearMap, scan: &Points, start: &Placed, reach_mm: f64, n_steps: usize) -> Placed {
    let mut placed = *start;
    for _ in 0..n_steps {
        let camera = scan.camera.map(|camera| placed.rotation * camera + placed.translation.vector);
        let (mut h, mut b, mut n_pairs) = (Matrix6::zeros(), Vector6::zeros(), 0);
        for p in &scan.points {
            let arm = placed.rotation * p;
            let moved = arm + placed.translation.vector;
            let Some((normal, along)) = residual(map, &moved, camera.as_ref(), reach_mm) else { continue };
            let turn = arm.cross(&normal);
            let row = Vector6::new(normal.x, normal.y, normal.z, turn.x, turn.y, turn.z);
            // Falls to zero at the reach, so that a pair that leaves it does not jump.
            let weight = (1.0 - (along / reach_mm).powi(2)).powi(2);
            h.syger(weight, &row, &row, 1.0);
            b += row * (weight * along);
            n_pairs += 1;
        }
        if n_pairs < 12 {
            return placed;
        }
        h.fill_upper_triangle_with_lower_triangle();
        for k in 0..6 {
            h[(k, k)] *= 1.0 + DAMPING;
        }
        let Some(step) = h.cholesky().map(|h| h.solve(&-b)) else { return placed };
        let turn = UnitQuaternion::new(step.fixed_rows::<3>(3).into_owned());
        placed.rotation = turn * placed.rotation;
        placed.translation.vector += step.fixed_rows::<3>(0);
        if step.norm() < 1e-4 {
            break;
        }
    }
    placed
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::target::Target;
    use osteoflow_geometry::SurfaceOrigin;

    #[test]
    fn distances_count_up_to_the_reach_and_points_beyond_as_the_reach() {
        let plane: Vec<_> = (-50..=50)
            .flat_map(|x| (-50..=50).map(move |y| Point3::new(f64::from(x) * 0.5, f64::from(y) * 0.5, 0.0)))
            .collect();
        let target =
            Target::new("ct", SurfaceOrigin::Exact, plane.clone(), Some(vec![Vector3::z(); plane.len()].into()));
        let map = NearMap::new(&target.unwrap());
        // The last is out of the map.
        let points = [0.0, 2.0, 4.0, 1000.0].map(|z| Vector3::new(1.0, 1.0, z) - map.centre().coords);
        let rms = |points: &[Vector3<f64>]| {
            score(&map, &Points { points: points.to_vec(), camera: None }, &Placed::identity(), 3.0)
        };
        for (i, distance) in [0.0, 2.0, 3.0, 3.0].into_iter().enumerate() {
            assert!((rms(&points[i..=i]) - distance).abs() < 1e-12, "{i}: {}", rms(&points[i..=i]));
        }
        assert!((rms(&points) - f64::sqrt((4.0 + 9.0 + 9.0) / 4.0)).abs() < 1e-12);
    }

    #[test]
    fn points_are_taken_evenly_about_their_centroid_with_their_camera() {
        let points: Vec<Point3<f64>> = (0..10).map(|k| Point3::new(f64::from(k), 0.0, 5.0)).collect();
        let of = |n: usize| Points::thinned(&points, n, &Point3::new(1.0, 0.0, 5.0), Some(Point3::new(1.0, 2.0, 3.0)));
        let xs: Vec<f64> = of(3).points.iter().map(|p| p.x).collect();
        assert_eq!((xs, of(100).points.len()), (vec![-1.0, 3.0, 7.0], 10));
        assert_eq!(of(3).camera, Some(Vector3::new(0.0, 2.0, -2.0)));
    }

    /// A map with voxels of 2 mm.
    fn map_of(target: &Target) -> NearMap {
        NearMap::of(NearMap::samples_of(target, 20_000), target.index().centre, 2.0, 8.0)
    }

    /// A plate of 25 mm, 0.5 mm between samples, with edges of the heights of a bowl.
    fn bowl() -> (NearMap, Vec<Vector3<f64>>) {
        let at = |k: i32| (f64::from(k % 101 - 50) * 0.5, f64::from(k / 101 - 50) * 0.5);
        let height = |x: f64, y: f64| 0.02 * x * x + 0.01 * y * y + 0.004 * x * y;
        let points: Vec<Point3<f64>> = (0..101 * 101).map(at).map(|(x, y)| Point3::new(x, y, height(x, y))).collect();
        let normals: Vec<Vector3<f64>> = (0..101 * 101)
            .map(at)
            .map(|(x, y)| Vector3::new(-0.04 * x - 0.004 * y, -0.02 * y - 0.004 * x, 1.0).normalize())
            .collect();
        let target = Target::new("ct", SurfaceOrigin::Exact, points.clone(), Some(normals.into())).unwrap();
        let map = map_of(&target);
        let scan = points.iter().step_by(17).map(|p| p - map.centre()).filter(|p| p.xy().amax() < 15.0).collect();
        (map, scan)
    }

    #[test]
    fn a_step_is_the_minimum_of_the_linearised_cost_and_more_of_them_come_back() {
        let (map, points) = bowl();
        let scan = Points { points: points.clone(), camera: None };
        let start = Placed::new(Vector3::new(0.3, -0.2, 0.5), Vector3::new(0.02, -0.03, 0.01));
        // Nothing is lowered by a step of another length along its direction.
        let one = descend(&map, &scan, &start, 3.0, 1);
        let along = |share: f64| {
            let turn = (one.rotation * start.rotation.inverse()).scaled_axis() * share;
            let shift = (one.translation.vector - start.translation.vector) * share;
            Placed::from_parts((start.translation.vector + shift).into(), UnitQuaternion::new(turn) * start.rotation)
        };
        let scores = [0.0, 0.8, 1.0, 1.2].map(|share| score(&map, &scan, &along(share), 3.0));
        assert!(scores[2] < 0.2 * scores[0] && scores[2] < scores[1] && scores[2] < scores[3], "{scores:?}");
        let end = descend(&map, &scan, &start, 3.0, 30);
        let off = (end.translation.vector.norm(), end.rotation.angle());
        // The samples nearest on the map are up to a millimetre aside of the closest, on a bowl that hardly holds it sideways.
        assert!(off.0 < 0.4 && off.1 < 0.01, "{off:?}");
        assert_eq!(descend(&map, &scan, &start, 3.0, 0), start);
        let text = format!(
            "{:.6?} {:.6?}",
            <[f64; 3]>::from(one.translation.vector),
            <[f64; 3]>::from(one.rotation.scaled_axis())
        );
        assert_eq!(text, "[0.267242, -0.174015, -0.006467] [-0.002548, -0.011321, 0.001385]");
    }

    #[test]
    fn eleven_pairs_are_too_few_for_a_step_and_those_beyond_the_reach_are_none() {
        let (map, points) = bowl();
        let start = Placed::translation(0.0, 0.0, 0.4);
        let some = |n: usize| points.iter().step_by(points.len() / 12).take(n).copied().collect::<Vec<_>>();
        let moves = |points: &[Vector3<f64>], reach_mm: f64, camera: Option<Vector3<f64>>| {
            descend(&map, &Points { points: points.to_vec(), camera }, &start, reach_mm, 1) != start
        };
        assert!(!moves(&some(11), 3.0, None) && moves(&some(12), 3.0, None));
        assert!(!moves(&points, 0.3, None) && moves(&points, 0.41, None));
        // The far side of the plate is not seen by a camera below it.
        let far = [Vector3::z() * 500.0, -Vector3::z() * 500.0].map(|camera| moves(&points, 3.0, Some(camera)));
        assert_eq!(far, [true, false]);
        let score =
            |z: f64| score(&map, &Points { points: points.clone(), camera: Some(Vector3::z() * z) }, &start, 2.0);
        assert!((score(-500.0) - 2.0).abs() < 1e-12 && score(500.0) < 0.41, "{} {}", score(-500.0), score(500.0));
    }

    #[test]
    fn samples_without_normals_pull_along_the_distance_to_them() {
        let points = vec![Point3::origin(), Point3::new(0.0, 0.0, 40.0)];
        let map = map_of(&Target::new("ct", SurfaceOrigin::Exact, points, None).unwrap());
        let near = |x: f64, y: f64| residual(&map, &Vector3::new(x, y, -20.0), None, 5.0);
        assert_eq!(near(3.0, 4.0), Some((Vector3::new(0.6, 0.8, 0.0), 5.0)));
        assert_eq!(near(3.0, 4.01), None);
        assert_eq!(near(0.0, 0.0), None);
    }
}
