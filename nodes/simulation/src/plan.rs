//! What a surgeon plans on the bone: landmarks, assessment points and two cuts, all by distances from the malleolus tip.

use crate::rays::Surface;
use crate::{SimulationError, phantom, t_camera_camera_marker_nominal};
use nalgebra::{Isometry3, Point3, Rotation3, UnitQuaternion, Vector3};
use osteoflow_geometry::{Anatomy, Mesh, NamedPoint, Plane, Planes, Points, Pose, SurgicalPlan};

/// Which face of the bone a point lies on.
#[derive(Debug, Clone, Copy)]
enum Face {
    Lateral,
    Posterior,
}

/// Landmarks: mm from the malleolus tip along the bone, and the face.
const LANDMARKS: [(&str, f64, Face); 3] =
    [("P1", 100.0, Face::Posterior), ("P2", 130.0, Face::Lateral), ("P3", 125.0, Face::Posterior)];

/// Assessment points, within and beside the stretch between the landmarks.
const ASSESSMENT: [(&str, f64, Face); 5] = [
    ("M1", 85.0, Face::Lateral),
    ("M2", 107.0, Face::Lateral),
    ("M3", 118.0, Face::Posterior),
    ("M4", 142.0, Face::Lateral),
    ("M5", 155.0, Face::Posterior),
];

/// Cuts: mm from the malleolus tip along the bone, and how the normal leans from it towards lateral and posterior. A
/// segment of 34 mm beyond the stripped stretch, as between the osteotomies of a jaw reconstruction.
const CUTS: [(&str, f64, f64, f64); 2] = [("plane_1", 180.0, -0.05, 0.24), ("plane_2", 214.0, 0.27, -0.08)];

/// A plan on any right or left fibula whose anatomy is known, in the frame of `bone`.
///
/// Landmarks and assessment points lie on the surface, where a ray from the section's centre leaves it on the named
/// face. Deterministic; `O(n)` in the number of faces for each point.
///
/// # Errors
/// [`SimulationError::NoSection`] if the bone does not reach as far as a point or cut.
pub fn plan(bone: &Mesh, anatomy: &Anatomy) -> Result<SurgicalPlan, SimulationError> {
    let surface = Surface::new(bone).ok_or(SimulationError::NoSection { height_mm: 0.0 })?;
    let place = |&(name, height_mm, face): &(&str, f64, Face)| -> Result<NamedPoint, SimulationError> {
        let centre = section_centre(bone, anatomy, height_mm).ok_or(SimulationError::NoSection { height_mm })?;
        let way = match face {
            Face::Lateral => anatomy.lateral,
            Face::Posterior => anatomy.posterior,
        };
        // From outside, so that an inner wall of the marrow is never taken for the surface.
        const OUTSIDE_MM: f64 = 60.0;
        let from = centre + way.into_inner() * OUTSIDE_MM;
        let hit = surface.cast(&from, &-way.into_inner()).ok_or(SimulationError::NoSection { height_mm })?;
        Ok(NamedPoint::new(name, from - way.into_inner() * hit.distance_mm))
    };
    let points = |rows: &[(&str, f64, Face)]| -> Result<Points, SimulationError> {
        Ok(Points::new(&bone.frame, rows.iter().map(place).collect::<Result<Vec<_>, _>>()?))
    };
    let (landmarks, assessment) = (points(&LANDMARKS)?, points(&ASSESSMENT)?);
    let planes = CUTS.iter().map(|&(name, height_mm, to_lateral, to_posterior)| {
        let centre = section_centre(bone, anatomy, height_mm).ok_or(SimulationError::NoSection { height_mm })?;
        let normal = *anatomy.proximal + *anatomy.lateral * to_lateral + *anatomy.posterior * to_posterior;
        Ok(Plane::new(name, Isometry3::from_parts(centre.into(), frame_along(&normal, &anatomy.posterior))))
    });
    let planes = Planes::new(&bone.frame, planes.collect::<Result<Vec<_>, SimulationError>>()?);
    Ok(SurgicalPlan {
        landmarks,
        assessment,
        planes,
        axes: None,
        anatomy: Some(anatomy.clone()),
        t_phantom_phantom_marker: Some(Pose::new("phantom", "phantom_marker", phantom::t_phantom_phantom_marker())),
        t_camera_camera_marker_nominal: Some(Pose::new("camera", "camera_marker", t_camera_camera_marker_nominal())),
    })
}

/// The rotation whose z axis is `z` and whose y axis is as close to `about_y` as that allows.
pub(crate) fn frame_along(z: &Vector3<f64>, about_y: &Vector3<f64>) -> UnitQuaternion<f64> {
    let z = z.normalize();
    let x = about_y.cross(&z).normalize();
    let axes = Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]);
    UnitQuaternion::from_rotation_matrix(&axes)
}

/// The middle of the bone's outline at a height above the malleolus tip: where the plane across the bone meets each
/// face, weighted by length. `None` if it meets none.
pub(crate) fn section_centre(bone: &Mesh, anatomy: &Anatomy, height_mm: f64) -> Option<Point3<f64>> {
    let above = |p: &Point3<f64>| (p - anatomy.malleolus_tip).dot(&anatomy.proximal) - height_mm;
    let (mut sum, mut length) = (Vector3::zeros(), 0.0);
    for face in 0..bone.faces().len() {
        let corners = bone.corners(face);
        let heights = corners.map(|p| above(&p));
        let mut ends = [Vector3::zeros(); 2];
        let mut n = 0;
        for k in 0..3 {
            let (i, j) = (k, (k + 1) % 3);
            if (heights[i] < 0.0) != (heights[j] < 0.0) {
                ends[n] = corners[i].coords.lerp(&corners[j].coords, heights[i] / (heights[i] - heights[j]));
                n += 1;
            }
        }
        if n == 2 {
            let piece = (ends[1] - ends[0]).norm();
            sum += (ends[0] + ends[1]) * (0.5 * piece);
            length += piece;
        }
    }
    (length > 0.0).then(|| Point3::from(sum / length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bone::{BoneParams, anatomy, fibula};

    #[test]
    fn planned_points_lie_on_the_surface_at_their_distance_from_the_tip() {
        let params = BoneParams::default();
        let (bone, axes) = (fibula(&params), anatomy(&params));
        let surface = Surface::new(&bone).unwrap();
        let plan = plan(&bone, &axes).unwrap();
        for (points, rows) in [(&plan.landmarks, &LANDMARKS[..]), (&plan.assessment, &ASSESSMENT[..])] {
            assert_eq!(points.points.len(), rows.len());
            for (point, row) in points.points.iter().zip(rows) {
                let off = (surface.closest(&point.position).0 - point.position).norm();
                assert!(off < 1e-9, "{} is {off} mm off the surface", point.name);
                let height = (point.position - axes.malleolus_tip).dot(&axes.proximal);
                assert!((height - row.1).abs() < 1e-6, "{} at {height} mm", point.name);
            }
        }
        let [first, second] = [0, 1].map(|i| plan.planes.planes[i].normal().unwrap());
        assert!(first.dot(&axes.proximal) > 0.95 && second.dot(&axes.proximal) > 0.95);
    }

    #[test]
    fn a_bone_too_short_for_the_plan_is_refused_with_the_height() {
        let params = BoneParams::default();
        let bone = fibula(&BoneParams { length_mm: 150.0, ..params.clone() });
        let axes = anatomy(&BoneParams { length_mm: 150.0, ..params });
        assert_eq!(plan(&bone, &axes), Err(SimulationError::NoSection { height_mm: 155.0 }));
    }
}
