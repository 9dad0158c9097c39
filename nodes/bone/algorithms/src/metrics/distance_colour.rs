//! Distances of points from a surface, signed by its normals, and the colours in which they are shown everywhere.

use crate::mesh_query::MeshQuery;
use nalgebra::Point3;

/// Distance at the ends of the colour scale, mm.
const END_MM: f64 = 1.0;
/// Points farther away are grey, mm: they are not on this bone.
const FAR_MM: f64 = 5.0;
/// The scale of the page: blue inside, white on the surface, orange outside.
const INSIDE: [f64; 3] = [0.0, 115.0, 178.0];
const ON: [f64; 3] = [247.0, 247.0, 242.0];
const OUTSIDE: [f64; 3] = [214.0, 94.0, 0.0];
const NONE: [u8; 3] = [140, 145, 153];

/// Distance of a point from a surface, mm, negative behind the nearest face; `None` for a surface without faces.
///
/// An open surface, such as a bone that the border of a CT cuts, has such a side everywhere. `O(log n)`.
pub fn distance_outside(point: &Point3<f64>, surface: &MeshQuery) -> Option<f64> {
    let nearest = surface.closest_point(point)?;
    let outside = (point - nearest.point).dot(&nearest.normal) >= 0.0;
    Some(if outside { nearest.distance_mm } else { -nearest.distance_mm })
}

/// Red, green and blue of a signed distance: blue 1 mm inside and deeper, white on the surface, orange 1 mm outside and beyond,
/// grey for a distance that is not finite or beyond 5 mm.
pub fn distance_colour(distance_mm: f64) -> [u8; 3] {
    if distance_mm.is_nan() || distance_mm.abs() > FAR_MM {
        return NONE;
    }
    let share = (distance_mm / END_MM).clamp(-1.0, 1.0);
    let end = if share < 0.0 { INSIDE } else { OUTSIDE };
    std::array::from_fn(|k| (ON[k] + share.abs() * (end[k] - ON[k])).round() as u8)
}

/// The scale as a table for other programs: the distance at its ends, mm, and the colours in the middles of 255 equal parts from minus
/// that to it.
pub fn distance_scale() -> (f64, [[u8; 3]; 255]) {
    (END_MM, std::array::from_fn(|k| distance_colour(END_MM * ((2 * k + 1) as f64 / 255.0 - 1.0))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use osteoflow_geometry::{Mesh, SurfaceOrigin};

    #[test]
    fn the_side_of_the_surface_is_the_sign_and_the_scale_ends_at_a_millimetre() {
        let corners = [[-9.0, -9.0], [9.0, -9.0], [0.0, 9.0]].map(|[x, y]| Point3::new(x, y, 3.0));
        let face = Mesh::new("ct", SurfaceOrigin::User, corners.to_vec(), vec![[0, 1, 2]]).unwrap();
        let surface = MeshQuery::new(&face);
        assert_eq!(surface.closest_point(&Point3::origin()).unwrap().normal, Vector3::z());
        let at = |z: f64| distance_outside(&Point3::new(0.5, 0.5, z), &surface).unwrap();
        assert!((at(3.5) - 0.5).abs() < 1e-12 && (at(2.75) + 0.25).abs() < 1e-12, "{} {}", at(3.5), at(2.75));
        assert_eq!(distance_colour(0.0), [247, 247, 242]);
        assert_eq!([distance_colour(-1.0), distance_colour(-4.9)], [[0, 115, 178]; 2]);
        assert_eq!([distance_colour(1.0), distance_colour(4.9)], [[214, 94, 0]; 2]);
        assert_eq!([distance_colour(5.1), distance_colour(f64::NAN)], [[140, 145, 153]; 2]);
        let (end_mm, colours) = distance_scale();
        assert_eq!((end_mm, colours[127]), (1.0, distance_colour(0.0)));
        assert_eq!((colours[0], colours[254]), (distance_colour(-254.0 / 255.0), distance_colour(254.0 / 255.0)));
    }
}
