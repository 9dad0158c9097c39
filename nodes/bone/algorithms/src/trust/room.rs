//! Whether files may hold a room in metres: a bone may be as small, so the sizes of both files and their places decide.

use super::Registered;
use nalgebra::Point3;

/// A bone or phantom spans at least this, mm; less is a bone in metres, which the reader of the file tells.
const LEAST_MM: f64 = 3.0;

/// A scan of a room spans less, in metres read as mm, and the surface at most twice that.
const MOST_MM: f64 = 75.0;

/// A scan of a room has at least this many points.
const MIN_POINTS: usize = 1000;

/// From the sensor in a room some things are as many times as far as others (a tenth of the points is farther, a tenth nearer). A socket or a
/// ball about its own centre has 1.1 to 2.3, a room seen by a turning laser 4.2.
const FAR_PER_NEAR: f64 = 3.0;

/// The note that scan and surface may be of a room in metres: both are points, small for a bone, about a sensor at the origin, and near and far
/// from it.
///
/// A surface of faces is a bone's, whose unit its own size tells, and a scan no longer than it has the same unit: in metres it would be a
/// thousand times as long.
pub fn room_note(registered: &Registered<'_>) -> Option<String> {
    let Registered { target, source, .. } = *registered;
    if target.mesh().is_some() {
        return None;
    }
    let scan_mm = room_span_mm(source.points(), MOST_MM)?;
    let surface_mm = room_span_mm(target.points(), 2.0 * MOST_MM)?;
    Some(format!(
        "scan and surface are points that span {scan_mm:.1} and {surface_mm:.1} mm about the origin, near and far from it: small for a bone, but as a room \
         has them in metres; if they are, give unit_mm = 1000 for both (register: --unit-mm 1000), since distances in mm decide what is a pair"
    ))
}

/// The span of points that may be a room's in metres.
pub fn room_span(points: &[Point3<f64>]) -> Option<f64> {
    room_span_mm(points, MOST_MM)
}

fn room_span_mm(points: &[Point3<f64>], most_mm: f64) -> Option<f64> {
    let first = points.first().filter(|_| points.len() >= MIN_POINTS)?;
    let (low, high) = points.iter().fold((*first, *first), |(low, high), p| (low.inf(p), high.sup(p)));
    let span_mm = (high - low).norm();
    let is_about_origin = nalgebra::center(&low, &high).coords.norm() < span_mm;
    if !is_about_origin || !(LEAST_MM..most_mm).contains(&span_mm) {
        return None;
    }
    let mut distances: Vec<f64> = points.iter().map(|p| p.coords.norm()).collect();
    let mut at = |share: f64| {
        let place = (share * distances.len() as f64) as usize;
        *distances.select_nth_unstable_by(place, f64::total_cmp).1
    };
    (at(0.9) > FAR_PER_NEAR * at(0.1)).then_some(span_mm)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh_query::MeshQuery;
    use crate::shapes::cuboid;
    use crate::target::Target;
    use nalgebra::Isometry3;
    use osteoflow_geometry::{Cloud, SurfaceOrigin};

    /// A hall of 50 by 20 by 6 about a sensor 1.5 above its floor, in metres.
    fn hall(scale: f64) -> Vec<Point3<f64>> {
        let ray = |k: u32| {
            let (turn, height) = (f64::from(k) * 2.399_963, f64::from(k % 101) / 51.0 - 0.98);
            let flat = (1.0 - height * height).sqrt();
            let [x, y, z] = [flat * turn.cos(), flat * turn.sin(), height];
            let wall = |c: f64, low: f64, high: f64| if c < 0.0 { low / c } else { high / c };
            let far = wall(x, -10.0, 40.0).min(wall(y, -8.0, 12.0)).min(wall(z, -1.5, 4.5));
            Point3::new(x, y, z) * (far * scale)
        };
        (0..3000).map(ray).collect()
    }

    /// Points all around a ball of this radius.
    fn ball(radius_mm: f64) -> Vec<Point3<f64>> {
        hall(1.0).iter().map(|p| Point3::from(p.coords.normalize() * radius_mm)).collect()
    }

    fn note(surface: &[Point3<f64>], scan: &[Point3<f64>], with_faces: bool) -> Option<String> {
        let target = Target::new("ct", SurfaceOrigin::User, surface.to_vec(), None).unwrap();
        let cuboid = cuboid([-20.0; 3], [20.0; 3]);
        let target = if with_faces { target.with_mesh(MeshQuery::new(&cuboid)) } else { target };
        let source = Cloud::new("scan", scan.to_vec()).unwrap();
        room_note(&Registered { target: &target, source: &source, t_target_source: &Isometry3::identity(), at: &[] })
    }

    #[test]
    fn a_room_in_metres_on_another_is_told_and_a_bone_of_its_size_is_not() {
        let told = note(&hall(1.0), &hall(0.9), false).unwrap();
        assert!(told.contains("span 48.8 and 54.2 mm about the origin") && told.contains("--unit-mm 1000"), "{told}");
        assert_eq!(note(&hall(1.0), &hall(0.9), true), None, "a surface of faces");
        assert_eq!(note(&ball(30.0), &ball(30.0), false), None, "a ball about its centre");
        assert_eq!(note(&hall(1.0), &ball(30.0), false), None, "a ball on a room");
        assert_eq!(note(&hall(1000.0), &hall(1000.0), false), None, "a room in millimetres");
        assert_eq!(note(&hall(1.0), &hall(0.9)[..999], false), None, "few points");
        let before_its_camera: Vec<_> = hall(1.0).iter().map(|p| Point3::new(p.x, p.y, p.z + 300.0)).collect();
        assert_eq!(note(&hall(1.0), &before_its_camera, false), None, "a scan in its camera's frame");
    }
}
