//! The surgical plan on the bone: landmarks, assessment points and two cuts, by distances from the malleolus tip.

use crate::{SimulationError, phantom, ranges};
use nalgebra::{Isometry3, Point3, Rotation3, UnitQuaternion, Vector3};
use osteoflow_algorithms::landmarks::{self, RecipeParams};
use osteoflow_algorithms::{axes, mesh_query::MeshQuery, section};
use osteoflow_geometry::{Anatomy, Axes, Mesh, NamedPoint, Plane, Planes, Points, Pose, SurgicalPlan};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A face of the bone.
#[derive(Debug, Clone, Copy)]
enum Face {
    Lateral,
    Posterior,
}

/// Assessment points, within and beside the stretch between the landmarks.
const ASSESSMENT: [(&str, f64, Face); 5] = [
    ("M1", 85.0, Face::Lateral),
    ("M2", 107.0, Face::Lateral),
    ("M3", 118.0, Face::Posterior),
    ("M4", 142.0, Face::Lateral),
    ("M5", 155.0, Face::Posterior),
];

/// Cuts: mm from the malleolus tip along the bone, and tilt of the normal towards lateral and posterior. A segment of
/// 34 mm beyond the stripped stretch, as between the osteotomies of a jaw reconstruction.
const CUTS: [(&str, f64, f64, f64); 2] = [("plane_1", 180.0, -0.05, 0.24), ("plane_2", 214.0, 0.27, -0.08)];

/// A plan on any right or left fibula whose anatomy is known, in the frame of `bone`.
///
/// Landmarks and assessment points are on the surface, where a ray from the section's centre leaves it on the named
/// face. `O(n)` in the number of faces for each point.
///
/// # Errors
/// [`SimulationError`] if the bone does not reach as far as a point or cut.
pub fn plan(bone: &Mesh, anatomy: &Anatomy) -> Result<SurgicalPlan, SimulationError> {
    plan_on(&MeshQuery::new(bone), anatomy)
}

/// [`plan`] on a prepared surface.
pub(crate) fn plan_on(surface: &MeshQuery, anatomy: &Anatomy) -> Result<SurgicalPlan, SimulationError> {
    let bone = surface.mesh();
    let place = |&(name, height_mm, face): &(&str, f64, Face)| -> Result<NamedPoint, SimulationError> {
        let centre = section_centre(bone, anatomy, height_mm)?;
        let way = match face {
            Face::Lateral => anatomy.lateral,
            Face::Posterior => anatomy.posterior,
        };
        // From outside, so that the wall of the marrow cavity is never hit.
        const OUTSIDE_MM: f64 = 60.0;
        let from = centre + way.into_inner() * OUTSIDE_MM;
        let hit = surface.cast_ray(&from, &-way.into_inner()).ok_or_else(|| SimulationError::no_section(height_mm))?;
        Ok(NamedPoint::new(name, hit.point))
    };
    let landmarks = landmarks::paper_recipe(surface, anatomy, &RecipeParams::default())?;
    let assessment = ASSESSMENT.iter().map(place).collect::<Result<Vec<_>, _>>()?;
    let planes = CUTS.iter().map(|&(name, height_mm, to_lateral, to_posterior)| {
        let centre = section_centre(bone, anatomy, height_mm)?;
        let normal = *anatomy.proximal + *anatomy.lateral * to_lateral + *anatomy.posterior * to_posterior;
        Ok(Plane::new(name, Isometry3::from_parts(centre.into(), frame_along(&normal, &anatomy.posterior))))
    });
    let planes = Planes::new(&bone.frame, planes.collect::<Result<Vec<_>, SimulationError>>()?);
    Ok(SurgicalPlan {
        landmarks: Points::new(&bone.frame, landmarks),
        assessment: Points::new(&bone.frame, assessment),
        planes,
        axes: Some(axes::towards(&axes::principal_axes(bone), &anatomy.proximal)),
        anatomy: Some(anatomy.clone()),
        t_phantom_phantom_marker: Some(phantom_marker()),
        t_camera_camera_marker_nominal: Some(nominal_camera_marker()),
        surface: None,
    })
}

/// A plan that is not where it was meant to be: drawn in another series of the same CT study, whose origin differs.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DisplacedParams {
    /// Displacement of the whole plan along the bone, towards proximal. 0: off.
    #[schemars(range(min = -100.0, max = 100.0))]
    pub along_mm: f64,
    /// Displacement of the whole plan across the bone, towards lateral. 0: off.
    #[schemars(range(min = -100.0, max = 100.0))]
    pub across_mm: f64,
}

/// The plan displaced as a whole: points, planes, axes and anatomy; marker poses stay.
///
/// # Errors
/// [`SimulationError`] if a parameter is out of range, or the plan has no anatomy, by which directions are known.
pub fn displaced(plan: SurgicalPlan, params: &DisplacedParams) -> Result<SurgicalPlan, SimulationError> {
    ranges::check("displaced", params)?;
    if *params == DisplacedParams::default() {
        return Ok(plan);
    }
    let anatomy = plan.anatomy.as_ref().ok_or_else(SimulationError::no_anatomy)?;
    let shift = *anatomy.proximal * params.along_mm + *anatomy.lateral * params.across_mm;
    let anatomy = Anatomy { malleolus_tip: anatomy.malleolus_tip + shift, ..anatomy.clone() };
    let motion = Isometry3::from_parts(shift.into(), UnitQuaternion::identity());
    Ok(SurgicalPlan {
        landmarks: plan.landmarks.transformed(&plan.landmarks.frame, &motion),
        assessment: plan.assessment.transformed(&plan.assessment.frame, &motion),
        planes: plan.planes.transformed(&plan.planes.frame, &motion),
        axes: plan.axes.map(|axes| Axes { centre: axes.centre + shift, ..axes }),
        anatomy: Some(anatomy),
        ..plan
    })
}

fn phantom_marker() -> Pose {
    Pose::new("phantom", "phantom_marker", phantom::t_phantom_phantom_marker())
}

fn nominal_camera_marker() -> Pose {
    Pose::new("camera", "camera_marker", phantom::t_camera_camera_marker_nominal())
}

/// Completes a user's plan: with all points and cuts if it is an anatomy alone (as [`plan`]); with the bone's axes;
/// with the marker poses of the built-in phantom and support.
///
/// # Errors
/// As [`plan`]; and if there is no anatomy, since without one no camera can be placed.
pub(crate) fn complete(plan: SurgicalPlan, surface: &MeshQuery) -> Result<SurgicalPlan, SimulationError> {
    let anatomy = plan.anatomy.as_ref().ok_or_else(SimulationError::no_anatomy)?;
    if plan.landmarks.points.is_empty() && plan.assessment.points.is_empty() && plan.planes.planes.is_empty() {
        return plan_on(surface, anatomy);
    }
    let axes = plan.axes.unwrap_or_else(|| axes::towards(&axes::principal_axes(surface.mesh()), &anatomy.proximal));
    Ok(SurgicalPlan {
        axes: Some(axes),
        t_phantom_phantom_marker: Some(plan.t_phantom_phantom_marker.unwrap_or_else(phantom_marker)),
        t_camera_camera_marker_nominal: Some(plan.t_camera_camera_marker_nominal.unwrap_or_else(nominal_camera_marker)),
        ..plan
    })
}

/// The rotation whose z axis is `z` and whose y axis is as close to `about_y` as that allows.
pub(crate) fn frame_along(z: &Vector3<f64>, about_y: &Vector3<f64>) -> UnitQuaternion<f64> {
    let z = z.normalize();
    let x = about_y.cross(&z).normalize();
    let axes = Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]);
    UnitQuaternion::from_rotation_matrix(&axes)
}

/// The centre of the bone's outline at a height above the malleolus tip; `None` if the bone does not reach it.
pub(crate) fn section_centre(bone: &Mesh, anatomy: &Anatomy, height_mm: f64) -> Result<Point3<f64>, SimulationError> {
    // Farther sections belong to another bone of the same file.
    const REACH_MM: f64 = 60.0;
    let at = anatomy.malleolus_tip + *anatomy.proximal * height_mm;
    let across = Isometry3::from_parts(at.into(), frame_along(&anatomy.proximal, &anatomy.posterior));
    section::middle(bone, &across, Some(REACH_MM)).ok_or_else(|| SimulationError::no_section(height_mm))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bone::{BoneParams, anatomy, fibula};

    #[test]
    fn planned_points_lie_on_the_surface_at_their_distance_from_the_tip() {
        let params = BoneParams::default();
        let (bone, axes) = (fibula(&params), anatomy(&params));
        let surface = MeshQuery::new(&bone);
        let plan = plan(&bone, &axes).unwrap();
        let landmarks = [("P1", 100.0), ("P2", 130.0), ("P3", 125.0)];
        let assessment = ASSESSMENT.map(|(name, height_mm, _)| (name, height_mm));
        for (points, rows) in [(&plan.landmarks, &landmarks[..]), (&plan.assessment, &assessment[..])] {
            assert_eq!(points.points.len(), rows.len());
            for (point, (name, height_mm)) in points.points.iter().zip(rows) {
                assert_eq!(&*point.name, *name);
                let off = surface.closest_point(&point.position).unwrap().distance_mm;
                assert!(off < 1e-9, "{name} is {off} mm off the surface");
                let height = (point.position - axes.malleolus_tip).dot(&axes.proximal);
                assert!((height - height_mm).abs() < 1e-6, "{name} at {height} mm");
            }
        }
        let along = plan.axes.as_ref().unwrap().columns.column(2).dot(&axes.proximal);
        assert!(along > 0.99, "the long axis runs proximally: {along}");
        let [first, second] = [0, 1].map(|i| plan.planes.planes[i].normal().unwrap());
        assert!(first.dot(&axes.proximal) > 0.95 && second.dot(&axes.proximal) > 0.95);
    }

    #[test]
    fn a_bone_too_short_for_the_plan_is_refused_with_the_height() {
        let params = BoneParams::default();
        let bone = fibula(&BoneParams { length_mm: 150.0, ..params.clone() });
        let axes = anatomy(&BoneParams { length_mm: 150.0, ..params });
        assert_eq!(plan(&bone, &axes), Err(SimulationError::no_section(155.0)));
    }
}
