//! Motions after which a surface lies on itself.

use super::{Reach, distance_mm, radius_about, refined};
use crate::downsample::thinned;
use crate::kabsch::centroid;
use crate::target::Target;
use nalgebra::Isometry3;

/// Number of points of the surface that are laid on it.
const N_POINTS: usize = 2000;

/// A motion is a symmetry if this share of the surface then lies on itself, within this, mm, or this share of its radius if that is less.
/// Edges between samples leave some of it off.
const SHARE: f64 = 0.95;
const SYMMETRIC_MM: f64 = 0.2;
const OF_RADIUS: f64 = 0.02;

/// Pairs are up to this many times farther apart than at the end of a search: where a noisy scan came to lie is off by as much.
const REACHES: f64 = 3.0;

/// The symmetry of a surface that a motion is near to, which may be none at all: the identity.
pub(crate) fn symmetry(target: &Target, near: &Isometry3<f64>) -> Option<Isometry3<f64>> {
    let points = thinned(target.points(), N_POINTS);
    let radius_mm = radius_about(&centroid(&points), &points);
    let reach_mm = Reach::new(radius_mm).end;
    let near = refined(target, &points, near, None, REACHES * reach_mm)?;
    let motion = refined(target, &points, &near, None, reach_mm)?;
    let limit_mm = SYMMETRIC_MM.min(OF_RADIUS * radius_mm);
    let n_on = points.iter().filter(|p| distance_mm(target, p, &motion, reach_mm) <= limit_mm).count();
    (n_on as f64 >= SHARE * points.len() as f64).then_some(motion)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes;
    use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
    use osteoflow_geometry::{Mesh, SurfaceOrigin};
    use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

    fn target(mesh: &Mesh) -> Target {
        let samples = crate::sample::surface(mesh, 20_000, &mut ChaCha8Rng::seed_from_u64(1));
        Target::new("ct", SurfaceOrigin::Exact, samples.points, Some(samples.normals.into())).unwrap()
    }

    /// A block of 20 x 20 x 60 mm with one corner as much inward.
    fn block(inward_mm: f64) -> Mesh {
        let corner = |k: usize| {
            let [x, y, z] = [0, 1, 2].map(|axis| ((k >> axis) & 1) as f64);
            Point3::new(20.0 * x - 10.0 - inward_mm * x * y * z, 20.0 * y - 10.0, 60.0 * z - 30.0)
        };
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let faces: Vec<[u32; 3]> = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        Mesh::new("ct", SurfaceOrigin::Exact, (0..8).map(corner).collect::<Vec<_>>(), faces).unwrap()
    }

    /// A turn that a noisy scan leaves 3 degrees and 1.5 mm off.
    fn turn(axis: Vector3<f64>, degrees: f64) -> Isometry3<f64> {
        let off = UnitQuaternion::new(Vector3::new(0.03, -0.04, 0.02));
        let turn = UnitQuaternion::new(axis.normalize() * degrees.to_radians());
        Isometry3::from_parts(Translation3::new(1.0, -1.0, 0.5), off * turn)
    }

    #[test]
    fn turns_of_a_square_block_are_symmetries_and_one_with_a_dent_and_a_bone_have_none() {
        let straight = target(&block(0.0));
        for (axis, degrees, is_symmetric) in [
            (Vector3::z(), 90.0, true),
            (Vector3::x(), 180.0, true),
            (Vector3::new(1.0, 1.0, 0.0), 180.0, true),
            (Vector3::x(), 90.0, false),
        ] {
            let found = symmetry(&straight, &turn(axis, degrees));
            let exact = UnitQuaternion::new(axis.normalize() * degrees.to_radians());
            let is_exact = |s: &Isometry3<f64>| s.rotation.angle_to(&exact) < 0.02 && s.translation.vector.norm() < 0.5;
            assert_eq!(found.as_ref().is_some_and(is_exact), is_symmetric, "{axis:?} by {degrees} degrees: {found:?}");
            assert_eq!(found.is_some(), is_symmetric);
        }
        let dented = target(&block(4.0));
        assert_eq!(symmetry(&dented, &turn(Vector3::z(), 90.0)), None);
        assert_eq!(symmetry(&dented, &turn(Vector3::z(), 180.0)), None);
        assert!(symmetry(&dented, &turn(Vector3::x(), 0.0)).is_some(), "at rest it lies on itself");
        let bone = target(&shapes::shaft());
        for degrees in [30.0, 90.0, 180.0] {
            let found = symmetry(&bone, &turn(Vector3::z(), degrees));
            assert!(found.is_none_or(|motion| motion.rotation.angle() < 0.01), "{degrees} degrees: {found:?}");
        }
    }
}
