//! Points whose depth their neighbours in the camera's image contradict.
//!
//! A camera errs by millimetres in the depth of single points where a surface ends in its image. Such a point says that
//! something was seen in its direction, but not where: counted where it is, it makes the rim of a hole out of the empty space beside a
//! silhouette, or takes from the surface what no laser hides.

use super::sight::LEAST_COS;
use crate::median::median;
use crate::nearest::Nearest;
use nalgebra::{Matrix3, Point3, Vector3};
use osteoflow_geometry::Cloud;
use rayon::prelude::*;

/// Neighbours in the image to which a plane is fitted.
const AROUND: usize = 16;

/// Steps of the robust fit.
const STEPS: usize = 6;

/// Distance from the plane of the neighbours beyond which a point is an outlier, in standard deviations of the scan's points...
const FAR: f64 = 6.0;

/// ...and at least, in spacings of the points: what is closer counts at the same place.
const LEAST_SPACINGS: f64 = 1.0;

/// Share of the neighbours that have to lie on their plane: elsewhere nothing is known.
const AGREEING: f64 = 0.6;

/// Share of that distance within which all neighbours of a point lie on a least-squares plane, so that none is an outlier: it would
/// move the plane by less than half of its own distance.
const CLOSE: f64 = 0.5;

/// Approximate number of points by which the noise is measured.
const SAMPLED: usize = 500;

/// The points of a scan, those with a contradicted depth moved along their line of sight onto the plane of their neighbours.
///
/// A scan without a viewpoint stays as it is. `O(n log n)`.
pub(super) fn corrected(scan: &Cloud) -> Vec<Point3<f64>> {
    let mut points = scan.points().to_vec();
    let Some(t_scan_camera) = scan.viewpoint else { return points };
    let in_camera: Vec<Point3<f64>> = points.iter().map(|p| t_scan_camera.inverse_transform_point(p)).collect();
    if points.len() <= AROUND || in_camera.iter().any(|p| p.z <= 0.0) {
        return points;
    }
    let image = Image::of(&in_camera);
    let far_mm = (FAR * image.noise_mm()).max(LEAST_SPACINGS * image.spacing_mm());
    let depths: Vec<(usize, f64)> = image
        .unclear(CLOSE * far_mm)
        .into_par_iter()
        .filter_map(|i| Some((i, image.contradicted(i, far_mm)?)))
        .collect();
    for (i, depth_mm) in depths {
        points[i] = t_scan_camera * (in_camera[i] * (depth_mm / in_camera[i].z));
    }
    points
}

/// Points in their camera's image.
struct Image<'a> {
    in_camera: &'a [Point3<f64>],
    /// x / z and y / z at the median depth, mm.
    flat: Vec<Point3<f64>>,
    tree: Nearest,
    depth_mm: f64,
}

/// A point's neighbours, and the plane through them.
struct Around<'a> {
    image: &'a Image<'a>,
    middle: usize,
    /// Neighbours, not the point itself.
    near: Vec<usize>,
    /// Extent of the neighbours in the image, mm.
    reach_mm: f64,
}

/// A plane: the inverse of its depth is linear in the image, in units of the inverse median depth.
struct Plane {
    inverse: Vector3<f64>,
    /// Depth in the direction of the point, mm.
    depth_mm: f64,
    /// Cosine of the angle between its normal and the line of sight.
    cos: f64,
    /// Distance from the plane per difference of the inverse depth.
    mm: f64,
}

impl<'a> Image<'a> {
    fn of(in_camera: &'a [Point3<f64>]) -> Self {
        let depth_mm = median(&mut in_camera.iter().map(|p| p.z).collect::<Vec<_>>());
        let flat: Vec<Point3<f64>> =
            in_camera.iter().map(|p| Point3::new(p.x / p.z * depth_mm, p.y / p.z * depth_mm, 0.0)).collect();
        Self { in_camera, tree: Nearest::new(&flat), flat, depth_mm }
    }

    fn sampled(&self) -> impl Iterator<Item = usize> {
        (0..self.flat.len()).step_by(self.flat.len().div_ceil(SAMPLED))
    }

    /// Median distance of the nearest neighbours but one.
    fn spacing_mm(&self) -> f64 {
        let second = |i: usize| self.tree.nearest_n(&self.flat[i], 3).last().map_or(0.0, |(_, square)| square.sqrt());
        median(&mut self.sampled().map(second).collect::<Vec<_>>())
    }

    /// Standard deviation of the points from the planes of their neighbours.
    fn noise_mm(&self) -> f64 {
        let off = |i: usize| {
            let around = self.around(i);
            Some(around.off_mm(i, &around.robust()?).abs())
        };
        // Of a normal distribution half is within 0.674 standard deviations.
        median(&mut self.sampled().filter_map(off).collect::<Vec<_>>()) / 0.674
    }

    /// The points that have no surroundings in which all points are within `close_mm` of one plane.
    fn unclear(&self, close_mm: f64) -> Vec<usize> {
        let mut is_clear = vec![false; self.flat.len()];
        for i in 0..self.flat.len() {
            if !is_clear[i] {
                let around = self.around(i);
                let plane = around.plane(|_| 1.0);
                let all = || std::iter::once(i).chain(around.near.iter().copied());
                if plane.is_some_and(|plane| all().all(|j| around.off_mm(j, &plane).abs() < close_mm)) {
                    all().for_each(|j| is_clear[j] = true);
                }
            }
        }
        (0..is_clear.len()).filter(|&i| !is_clear[i]).collect()
    }

    /// The depth of the plane of a point's neighbours, if most of them agree and the point does not.
    fn contradicted(&self, i: usize, far_mm: f64) -> Option<f64> {
        let around = self.around(i);
        // A plane more slanted than surfaces that a camera sees is one through a step in depth.
        let plane = around.robust().filter(|plane| plane.cos >= LEAST_COS)?;
        let n_agreeing = around.near.iter().filter(|&&j| around.off_mm(j, &plane).abs() < far_mm).count();
        let agree = n_agreeing as f64 >= AGREEING * around.near.len() as f64;
        (agree && around.off_mm(i, &plane).abs() > far_mm).then_some(plane.depth_mm)
    }

    fn around(&'a self, middle: usize) -> Around<'a> {
        let near = self.tree.nearest_n(&self.flat[middle], AROUND + 1);
        let reach_mm = near.last().map_or(0.0, |(_, square)| square.sqrt()).max(f64::MIN_POSITIVE);
        let near = near.into_iter().map(|(j, _)| j).filter(|j| *j != middle).collect();
        Around { image: self, middle, near, reach_mm }
    }
}

impl Around<'_> {
    /// Where a point is in the image, from the middle, and its inverse depth.
    fn row(&self, j: usize) -> (Vector3<f64>, f64) {
        let across = (self.image.flat[j] - self.image.flat[self.middle]) / self.reach_mm;
        (Vector3::new(1.0, across.x, across.y), self.image.depth_mm / self.image.in_camera[j].z)
    }

    /// The least-squares plane of the neighbours, the k-th with a weight; `None` where they are on a line in the image.
    fn plane(&self, weight: impl Fn(usize) -> f64) -> Option<Plane> {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for (k, &j) in self.near.iter().enumerate() {
            let (row, inverse) = self.row(j);
            normal += row * row.transpose() * weight(k);
            right += row * (inverse * weight(k));
        }
        let inverse = (normal + Matrix3::identity() * 1e-9).cholesky()?.solve(&right);
        let depth_mm = self.image.depth_mm / inverse.x;
        // Slope of the depth, mm per mm across the line of sight.
        let slope = inverse.yz().norm() * depth_mm / self.reach_mm;
        let cos = 1.0 / 1f64.hypot(slope);
        (inverse.x > 0.0).then(|| Plane { inverse, depth_mm, cos, mm: depth_mm / inverse.x * cos })
    }

    /// The plane of most of the neighbours: weights of a Cauchy distribution as wide as half of them.
    fn robust(&self) -> Option<Plane> {
        let mut plane = self.plane(|_| 1.0)?;
        for _ in 1..STEPS {
            let off: Vec<f64> = self.near.iter().map(|&j| self.off_mm(j, &plane).abs()).collect();
            let half_mm = median(&mut off.clone()).max(f64::MIN_POSITIVE);
            plane = self.plane(|k| 1.0 / (1.0 + (off[k] / half_mm).powi(2)))?;
        }
        Some(plane)
    }

    /// Distance of a point from a plane, mm, positive in front of it.
    fn off_mm(&self, j: usize, plane: &Plane) -> f64 {
        let (row, inverse) = self.row(j);
        (inverse - row.dot(&plane.inverse)) * plane.mm
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};

    const SLANT_DEG: f64 = 60.0;

    /// What a camera 200 mm away sees of a slanted plane that ends, the errors of which these points have, and its pose.
    fn scan(error_mm: impl Fn(usize) -> f64) -> (Cloud, Vec<Point3<f64>>) {
        let slope = SLANT_DEG.to_radians().tan();
        let viewpoint = Translation3::new(7.0, -3.0, 11.0) * UnitQuaternion::from_euler_angles(0.4, -1.0, 0.2);
        let grid = (0..60 * 60).map(|k| (k % 60, k / 60)).map(|(x, y)| (f64::from(x), f64::from(y)));
        let rays: Vec<Vector3<f64>> = grid.map(|(x, y)| Vector3::new(x * 0.0012, y * 0.0012, 1.0)).collect();
        let truth: Vec<Point3<f64>> =
            rays.iter().map(|ray| Point3::from(ray * (200.0 / (1.0 - slope * ray.x)))).collect();
        let wrong = truth.iter().enumerate().map(|(k, p)| viewpoint * (p + p.coords.normalize() * error_mm(k)));
        let cloud = Cloud::new("world", wrong.collect::<Vec<_>>()).unwrap().seen_from(viewpoint);
        (cloud, truth.iter().map(|p| viewpoint * p).collect())
    }

    /// A tenth of the points beside the left end are off by millimetres, all by hundredths.
    fn errs(k: usize) -> f64 {
        let noise = 0.02 * ((k * 7919 % 101) as f64 / 50.0 - 1.0);
        if k % 60 < 2 && (k / 60).is_multiple_of(5) { [4.0, -5.0, 2.5][k / 60 % 3] + noise } else { noise }
    }

    #[test]
    fn a_contradicted_depth_at_the_end_of_a_surface_becomes_that_of_the_neighbours_and_the_others_stay() {
        let (cloud, truth) = scan(errs);
        let corrected = corrected(&cloud);
        let mut n_moved = 0;
        for (k, (point, (seen, truth))) in corrected.iter().zip(cloud.points().iter().zip(&truth)).enumerate() {
            let is_outlier = errs(k).abs() > 0.4;
            n_moved += usize::from(point != seen);
            assert_eq!(point != seen, is_outlier, "point {k}, off by {:.2} mm", errs(k));
            // Noise of 0.02 mm in depth, extrapolated to the end.
            assert!((point - truth).norm() < 0.15, "point {k} is {:.2} mm off", (point - truth).norm());
        }
        assert!(n_moved > 15, "{n_moved} are moved");
    }

    #[test]
    fn a_step_in_depth_and_a_scan_without_a_viewpoint_stay() {
        let step = |k: usize| if k % 60 < 30 { 0.0 } else { 6.0 };
        let (cloud, _) = scan(step);
        assert_eq!(corrected(&cloud), cloud.points());
        let (cloud, _) = scan(errs);
        let unseen = Cloud::new("world", cloud.points().to_vec()).unwrap();
        assert_eq!(corrected(&unseen), cloud.points());
    }
}
