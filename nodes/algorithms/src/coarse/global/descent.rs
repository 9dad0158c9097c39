//! Point-to-plane steps on a [`NearMap`].

use super::near_map::NearMap;
use nalgebra::{Isometry3, Matrix6, UnitQuaternion, Vector3, Vector6};

/// Cosine between a normal and the direction to the camera below which a sample is on the far side.
const FAR_SIDE: f64 = -0.2;

/// Damping of a step, as a share of each diagonal entry of the normal matrix.
const DAMPING: f64 = 1e-3;

/// A scan about its centroid, and the place of its camera there.
pub(crate) struct Points<'a> {
    pub(crate) points: &'a [Vector3<f64>],
    pub(crate) camera: Option<Vector3<f64>>,
}

/// A pose that takes points about their centroid to positions about the map's centre.
pub(crate) type Placed = Isometry3<f64>;

/// RMS distance from the surface, with distances limited to `reach_mm`.
pub(crate) fn score(map: &NearMap, scan: &Points<'_>, placed: &Placed, reach_mm: f64) -> f64 {
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
    // A sample may be a millimetre aside of the closest point.
    (along.abs() <= reach_mm && off.norm_squared() <= (reach_mm + 2.0).powi(2)).then_some((sample.normal, along))
}

/// `n_steps` point-to-plane steps with pairs no farther than `reach_mm`; ends early where too few pairs are left.
pub(crate) fn descend(map: &NearMap, scan: &Points<'_>, start: &Placed, reach_mm: f64, n_steps: usize) -> Placed {
    let mut placed = *start;
    for _ in 0..n_steps {
        let camera = scan.camera.map(|camera| placed.rotation * camera + placed.translation.vector);
        let (mut h, mut b, mut n_pairs) = (Matrix6::zeros(), Vector6::zeros(), 0);
        for p in scan.points {
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
    use nalgebra::Point3;
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
        let rms = |points: &[Vector3<f64>]| score(&map, &Points { points, camera: None }, &Placed::identity(), 3.0);
        for (i, distance) in [0.0, 2.0, 3.0, 3.0].into_iter().enumerate() {
            assert!((rms(&points[i..=i]) - distance).abs() < 1e-12, "{i}: {}", rms(&points[i..=i]));
        }
        assert!((rms(&points) - f64::sqrt((4.0 + 9.0 + 9.0) / 4.0)).abs() < 1e-12);
    }
}
