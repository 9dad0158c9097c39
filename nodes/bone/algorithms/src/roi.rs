//! Points of a cloud in a region of interest, as indices in the cloud's order.

use crate::Refusal;
use nalgebra::{Point2, Point3, Unit, Vector3};
use osteoflow_geometry::{Cloud, Region, encloses};

/// Points inside `region` or on its boundary; both in one frame.
pub fn in_box(cloud: &Cloud, region: &Region) -> Vec<usize> {
    select(cloud, |p| region.contains(p))
}

/// Points no farther than `radius_mm` from `centre`.
pub fn in_sphere(cloud: &Cloud, centre: &Point3<f64>, radius_mm: f64) -> Vec<usize> {
    select(cloud, |p| (p - centre).norm() <= radius_mm)
}

/// Points whose height over `origin` along `direction` is in `from_mm..=to_mm`: a slab of the bone.
pub fn in_slab(
    cloud: &Cloud,
    origin: &Point3<f64>,
    direction: &Unit<Vector3<f64>>,
    from_mm: f64,
    to_mm: f64,
) -> Vec<usize> {
    select(cloud, |p| (from_mm..=to_mm).contains(&(p - origin).dot(direction)))
}

/// Points that the camera sees inside `polygon`; points behind the camera are outside.
///
/// The corners are image coordinates without a unit, `x / z` right and `y / z` down as the camera at the cloud's
/// viewpoint sees them, in order around the region; the even-odd rule decides where the outline crosses itself.
///
/// # Errors
/// [`Refusal`] if the cloud has no viewpoint or the polygon fewer than three corners.
pub fn in_polygon(cloud: &Cloud, polygon: &[Point2<f64>]) -> Result<Vec<usize>, Refusal> {
    if polygon.len() < 3 {
        return Err(Refusal::of(format!("the polygon has {} corners, at least 3 are needed", polygon.len())));
    }
    let t_cloud_camera = cloud.viewpoint.ok_or_else(|| {
        Refusal::of("the cloud has no viewpoint, so what its camera saw is unknown; crop it where its reader set one")
    })?;
    let t_camera_cloud = t_cloud_camera.inverse();
    Ok(select(cloud, |p| {
        let seen = t_camera_cloud * p;
        seen.z > 0.0 && encloses(polygon, seen.x / seen.z, seen.y / seen.z)
    }))
}

fn select(cloud: &Cloud, keep: impl Fn(&Point3<f64>) -> bool) -> Vec<usize> {
    (0..cloud.len()).filter(|&i| keep(&cloud.points()[i])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Isometry3;

    fn grid() -> Cloud {
        let points: Vec<_> = (0..11).map(|i| Point3::new(f64::from(i) - 5.0, 0.0, 100.0)).collect();
        Cloud::new("camera", points).unwrap()
    }

    #[test]
    fn box_sphere_and_slab_hold_their_boundary() {
        let region =
            Region { frame: "camera".into(), min: Point3::new(-2.0, 0.0, 0.0), max: Point3::new(2.0, 0.0, 100.0) };
        assert_eq!(in_box(&grid(), &region), [3, 4, 5, 6, 7]);
        assert_eq!(in_sphere(&grid(), &Point3::new(5.0, 0.0, 100.0), 1.0), [9, 10]);
        assert_eq!(in_slab(&grid(), &Point3::origin(), &Vector3::x_axis(), 3.0, 4.0), [8, 9]);
        assert!(in_slab(&grid(), &Point3::origin(), &Vector3::x_axis(), 4.0, 3.0).is_empty());
    }

    #[test]
    fn a_polygon_follows_the_camera_that_took_the_cloud() {
        let square = [(-0.025, -1.0), (0.025, -1.0), (0.025, 1.0), (-0.025, 1.0)].map(|(x, y)| Point2::new(x, y));
        assert!(in_polygon(&grid(), &square).unwrap_err().to_string().starts_with("the cloud has no viewpoint"));
        let seen = grid().seen_from(Isometry3::identity());
        assert_eq!(in_polygon(&seen, &square).unwrap(), [3, 4, 5, 6, 7]);
        let moved =
            seen.transformed("world", &Isometry3::new(Vector3::new(7.0, 8.0, 9.0), Vector3::new(0.1, 2.0, 0.3)));
        assert_eq!(in_polygon(&moved, &square).unwrap(), [3, 4, 5, 6, 7]);
        let behind = seen.seen_from(Isometry3::translation(0.0, 0.0, 200.0));
        assert!(in_polygon(&behind, &square).unwrap().is_empty());
        assert!(in_polygon(&behind, &square[..2]).unwrap_err().to_string().contains("2 corners"));
    }
}
