//! Poses of the camera, the bone, the phantom and the bone's marker.

use crate::ProcedureParams;
use crate::draws::{Term, attitude, direction, normal, normal3, stream};
use crate::plan::frame_along;
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_geometry::{Anatomy, Mesh};
use rand_chacha::ChaCha8Rng;

/// The nominal direction from the bone to the camera, of unit length.
pub(super) fn towards_camera(anatomy: &Anatomy, params: &ProcedureParams) -> Vector3<f64> {
    let azimuth = params.camera.view_azimuth_deg.to_radians();
    (*anatomy.lateral * azimuth.cos() + *anatomy.posterior * azimuth.sin()).normalize()
}

/// `t_ct_camera` of the scans: at working distance from the surface, x along the bone, with the error of a hand.
pub(crate) fn scan_pose(
    surface: &MeshQuery,
    anatomy: &Anatomy,
    focus: &Point3<f64>,
    params: &ProcedureParams,
    seed: u64,
) -> Option<Isometry3<f64>> {
    let towards_camera = towards_camera(anatomy, params);
    const OUTSIDE_MM: f64 = 60.0;
    let from = focus + towards_camera * OUTSIDE_MM;
    let on_surface = surface.cast_ray(&from, &-towards_camera)?.point;
    // Camera z points to the bone, x is proximal, y = z x x.
    let z = -towards_camera;
    let looking = frame_along(&z, &z.cross(&anatomy.proximal));
    let held = normal3(&mut stream(seed, Term::Setup, 1)) * params.camera.view_spread_deg.to_radians();
    let about_focus = Translation3::from(on_surface.coords) * UnitQuaternion::from_scaled_axis(held);
    let back = Translation3::new(0.0, 0.0, -params.camera.working_distance_mm);
    Some(about_focus * looking * back)
}

/// `t_world_ct`: in any attitude, about 1.2 m from the localiser's origin.
pub(super) fn bone_pose(focus: &Point3<f64>, rng: &mut ChaCha8Rng) -> Isometry3<f64> {
    let place = direction(rng) * (1200.0 + 100.0 * normal(rng));
    Translation3::from(place) * attitude(rng) * Translation3::from(-focus.coords)
}

/// The camera's pose at the phantom relative to that at the bone.
pub(super) fn camera_offset_at_phantom(rng: &mut ChaCha8Rng) -> Isometry3<f64> {
    Isometry3::new(normal3(rng) * 60.0, normal3(rng) * 0.2)
}

/// `t_camera_phantom`: a corner of the phantom towards the camera, so that three faces with blocks are seen, half its
/// radius beyond `phantom.distance_mm`.
pub(super) fn phantom_pose(phantom: &Mesh, params: &ProcedureParams, rng: &mut ChaCha8Rng) -> Isometry3<f64> {
    let toward = Vector3::new(1.0, 1.0, 1.0).normalize();
    let corner_on = UnitQuaternion::rotation_between(&toward, &-Vector3::z())
        .unwrap_or_else(|| UnitQuaternion::from_rotation_matrix(&Rotation3::identity()));
    let radius = phantom.vertices().iter().map(|v| v.coords.norm()).fold(0.0, f64::max);
    let spread = params.camera.view_spread_deg.to_radians();
    let held = UnitQuaternion::from_scaled_axis(normal3(rng) * spread);
    let aside = normal3(rng) * 4.0;
    let away = params.phantom.distance_mm.unwrap_or(params.camera.working_distance_mm) + radius / 2.0;
    Translation3::from(Vector3::new(0.0, 0.0, away) + aside) * held * corner_on
}

/// `t_ct_bone_marker`: on a pin in the bone's proximal part, 110 mm from the centre of the scan and 45 mm off the bone.
pub(super) fn bone_marker_pose(anatomy: &Anatomy, focus: &Point3<f64>, rng: &mut ChaCha8Rng) -> Isometry3<f64> {
    let place = focus + *anatomy.proximal * 110.0 + *anatomy.lateral * 45.0;
    Isometry3::from_parts(place.into(), attitude(rng))
}
