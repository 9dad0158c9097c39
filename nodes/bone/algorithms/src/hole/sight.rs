//! Points as the camera of a scan sees them.

use crate::median::median;
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_geometry::Cloud;

/// Factor of depths. A camera samples its image evenly, so points on a slanted surface are far apart along it; with depths
/// reduced to this they are at most 1.1 times as far apart at 72 degrees as where the surface faces the camera. Surfaces
/// one behind the other stay apart.
const DEPTH_SHARE: f64 = 0.15;

/// Cosine of the largest angle of incidence at which a surface still gives points.
pub(super) const LEAST_COS: f64 = 0.25;

/// Depth, as a share of the median, up to which points are scaled by their depth: a point beside the camera has no image.
const NEAREST: f64 = 0.2;

/// Flattens points along a camera's lines of sight: the coordinates of its image at the scan's median depth, in mm, and
/// the depth on a smaller scale. Without a viewpoint, points stay as they are.
#[derive(Clone)]
pub(super) struct Sight(Option<Camera>);

#[derive(Clone)]
struct Camera {
    t_camera_cloud: Isometry3<f64>,
    depth_mm: f64,
    nearest_mm: f64,
}

impl Sight {
    /// The sight of the camera that took `cloud`.
    pub(super) fn of(cloud: &Cloud) -> Self {
        Self(cloud.viewpoint.and_then(|viewpoint| {
            let t_camera_cloud = viewpoint.inverse();
            let mut depths: Vec<f64> = cloud.points().iter().map(|p| (t_camera_cloud * p).z).collect();
            let depth_mm = median(&mut depths);
            (depth_mm > 0.0).then_some(Camera { t_camera_cloud, depth_mm, nearest_mm: NEAREST * depth_mm })
        }))
    }

    /// Whether there is a camera.
    pub(super) fn is_known(&self) -> bool {
        self.0.is_some()
    }

    /// Factor of the distance between two scans when flattened, on a surface at 60 degrees.
    pub(super) fn depth_share(&self) -> f64 {
        if self.is_known() { 2.0 * DEPTH_SHARE } else { 1.0 }
    }

    /// The flattened point.
    pub(super) fn flatten(&self, point: &Point3<f64>) -> Point3<f64> {
        let Some(camera) = &self.0 else { return *point };
        let p = camera.t_camera_cloud * point;
        let scale = camera.depth_mm / p.z.max(camera.nearest_mm);
        Point3::new(p.x * scale, p.y * scale, DEPTH_SHARE * p.z)
    }

    /// The scale of the flattened image at a point's depth, and its depth, mm; `None` without a camera.
    pub(super) fn image(&self, point: &Point3<f64>) -> Option<(f64, f64)> {
        let camera = self.0.as_ref()?;
        let z = (camera.t_camera_cloud * point).z;
        Some((camera.depth_mm / z.max(camera.nearest_mm), z))
    }

    /// A distance that points within `radius_mm` of `point` in space are within when flattened, mm.
    pub(super) fn reach_mm(&self, point: &Point3<f64>, radius_mm: f64) -> f64 {
        let Some(camera) = &self.0 else { return radius_mm };
        let p = camera.t_camera_cloud * point;
        let scale = camera.depth_mm / (p.z - radius_mm).max(camera.nearest_mm);
        let aside = p.x.hypot(p.y) / p.z.max(camera.nearest_mm);
        radius_mm * (scale * 1f64.hypot(aside)).hypot(DEPTH_SHARE)
    }

    /// Area of a surface with this normal, per area of its flattened points.
    pub(super) fn slant(&self, point: &Point3<f64>, normal: &Vector3<f64>) -> f64 {
        let Some(camera) = &self.0 else { return 1.0 };
        let p = camera.t_camera_cloud * point;
        let cos = (camera.t_camera_cloud * normal).dot(&p.coords.normalize()).abs();
        (p.z / camera.depth_mm).powi(2) / cos.max(LEAST_COS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};

    /// A sight along -x of the world from 200 mm, and what the camera's pixels see of a plane through the origin.
    fn plane(slant_deg: f64) -> (Cloud, Vector3<f64>) {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -std::f64::consts::FRAC_PI_2);
        let viewpoint = Translation3::new(200.0, 0.0, 0.0) * turn;
        let normal = Vector3::new(slant_deg.to_radians().cos(), slant_deg.to_radians().sin(), 0.0);
        let origin = Point3::from(viewpoint.translation.vector);
        let mut points = Vec::new();
        for row in -10..=10 {
            for column in -10..=10 {
                let ray = viewpoint * Vector3::new(f64::from(column) * 0.002, f64::from(row) * 0.002, 1.0);
                points.push(origin - ray * (origin.coords.dot(&normal) / ray.dot(&normal)));
            }
        }
        (Cloud::new("world", points).unwrap().seen_from(viewpoint), normal)
    }

    #[test]
    fn a_slanted_grid_is_nearly_square_when_flattened_and_as_large_as_its_slant_says() {
        for slant_deg in [0.0, 30.0, 60.0, 72.0] {
            let (cloud, normal) = plane(slant_deg);
            let sight = Sight::of(&cloud);
            let [here, right, up] = [220, 221, 241].map(|i| cloud.points()[i]);
            let flat = [right, up].map(|p| (sight.flatten(&p) - sight.flatten(&here)).norm());
            let (least, most) = (flat[0].min(flat[1]), flat[0].max(flat[1]));
            assert!((least - 0.4).abs() < 0.01 && most < 0.45, "{slant_deg} degrees: {flat:?} mm");
            let area = (right - here).cross(&(up - here)).norm();
            let slant = sight.slant(&here, &normal);
            assert!((slant / (area / 0.16) - 1.0).abs() < 0.03, "{slant_deg} degrees: {slant}, {area} mm²");
        }
    }

    #[test]
    fn points_within_a_radius_are_within_its_reach_when_flattened() {
        let (cloud, _) = plane(72.0);
        let sight = Sight::of(&cloud);
        let mut closest = f64::MAX;
        for a in cloud.points() {
            for b in cloud.points() {
                for shift_mm in [-4.0, 0.0, 4.0] {
                    let b = b + Vector3::x() * shift_mm;
                    let reach_mm = sight.reach_mm(a, (a - b).norm());
                    let flat_mm = (sight.flatten(a) - sight.flatten(&b)).norm();
                    assert!(flat_mm <= reach_mm + 1e-9, "{a} and {b}: {flat_mm} mm, {reach_mm} mm reached");
                    closest = closest.min((reach_mm - flat_mm) / reach_mm.max(1e-9));
                }
            }
        }
        assert!(closest < 0.1, "the reach is never used: {closest}");
    }

    #[test]
    fn without_a_camera_and_with_one_behind_the_points_nothing_is_flattened() {
        let (seen, normal) = plane(60.0);
        let from_behind = Translation3::new(-200.0, 0.0, 0.0) * seen.viewpoint.unwrap().rotation;
        let unseen = Cloud::new("world", seen.points().to_vec()).unwrap();
        let behind = unseen.clone().seen_from(from_behind);
        for sight in [Sight::of(&unseen), Sight::of(&behind)] {
            let p = Point3::new(1.0, 2.0, 3.0);
            assert!(!sight.is_known());
            assert_eq!((sight.flatten(&p), sight.reach_mm(&p, 2.0), sight.slant(&p, &normal)), (p, 2.0, 1.0));
        }
    }
}
