//! Landmarks by the paper's recipe, and marks ruled off with errors.

mod ruled;

pub use ruled::{Ruled, RuledPoint, RuledReport, RulerErrors, ThirdFrom, ruled};

use crate::Refusal;
use crate::mesh_query::MeshQuery;
use crate::section;
use nalgebra::{Isometry3, Point3, Rotation3, UnitQuaternion, Vector3};
use osteoflow_geometry::{Anatomy, NamedPoint};
use osteoflow_node_macros::params;
use schemars::JsonSchema;
use serde::Deserialize;

/// Distance from the bone's axis at which the ray to a landmark starts, mm: outside any long bone, inside the body.
const OUTSIDE_MM: f64 = 200.0;

/// Maximum distance of a section from the bone's axis, mm: excludes a tibia in the same file.
const SECTION_REACH_MM: f64 = 60.0;

/// Positions of the paper's landmarks on a fibula.
#[params]
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
pub struct RecipeParams {
    /// P1 above the tip of the malleolus, along the bone. 100: clear of the ankle, where a graft may be taken.
    #[param(100.0, 1.0..=1000.0)]
    pub p1_from_tip_mm: f64,
    /// P2 above P1, along the bone. 30: the paper's d12.
    #[param(30.0, -500.0..=500.0)]
    pub p2_from_p1_mm: f64,
    /// P3 above P1, along the bone. 25: the paper's d13, read as from P1.
    #[param(25.0, -500.0..=500.0)]
    pub p3_from_p1_mm: f64,
}

/// P1, P2 and P3 by the paper's recipe, on any surface of a fibula.
///
/// As we read it: P1 on the posterior face, `p1_from_tip_mm` above the tip of the malleolus along the bone;
/// P2 on the lateral face, `p2_from_p1_mm` above P1; P3 on the posterior face, `p3_from_p1_mm` above P1. The three then
/// lie on two faces and thus not on a line. A face is met by a ray from outside, perpendicular to the bone, towards the
/// centre of the bone's outline at that height. The side (left or right) is in the directions of the anatomy.
///
/// # Errors
/// [`Refusal`] if the bone does not reach that far, or a direction runs along the bone.
///
/// # Source
/// Section 2.3 of the paper.
pub fn paper_recipe(bone: &MeshQuery, anatomy: &Anatomy, params: &RecipeParams) -> Result<Vec<NamedPoint>, Refusal> {
    let p1 = params.p1_from_tip_mm;
    let lateral = across(&anatomy.lateral, anatomy, "lateral")?;
    let posterior = across(&anatomy.posterior, anatomy, "posterior")?;
    [("P1", p1, posterior), ("P2", p1 + params.p2_from_p1_mm, lateral), ("P3", p1 + params.p3_from_p1_mm, posterior)]
        .into_iter()
        .map(|(name, height_mm, direction)| {
            let position =
                on_face(bone, anatomy, height_mm, &direction).ok_or_else(|| {
                    Refusal::of(format!(
                        "{name} would lie {height_mm} mm above the malleolus tip, where there is no bone; is it cut, or in metres?"
                    ))
                })?;
            Ok(NamedPoint::new(name, position))
        })
        .collect()
}

/// The point of the surface seen from `direction` at a height above the malleolus tip.
fn on_face(bone: &MeshQuery, anatomy: &Anatomy, height_mm: f64, direction: &Vector3<f64>) -> Option<Point3<f64>> {
    let at = anatomy.malleolus_tip + anatomy.proximal.into_inner() * height_mm;
    let turn = Rotation3::rotation_between(&Vector3::z(), &anatomy.proximal)
        .unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
    let plane = Isometry3::from_parts(at.coords.into(), UnitQuaternion::from_rotation_matrix(&turn));
    let middle = section::middle(bone.mesh(), &plane, Some(SECTION_REACH_MM))?;
    bone.cast_ray(&(middle + direction * OUTSIDE_MM), &-direction).map(|hit| hit.point)
}

/// The component of a direction perpendicular to the bone, of unit length.
fn across(direction: &Vector3<f64>, anatomy: &Anatomy, what: &'static str) -> Result<Vector3<f64>, Refusal> {
    let along = anatomy.proximal.into_inner();
    (direction - along * direction.dot(&along)).try_normalize(0.1).ok_or_else(|| {
        Refusal::of(format!("{what} runs along the bone; the anatomy needs three directions across each other"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::cuboid;
    use nalgebra::Unit;

    fn anatomy(proximal: Vector3<f64>) -> Anatomy {
        Anatomy {
            malleolus_tip: Point3::new(0.0, 0.0, 0.0),
            proximal: Unit::new_normalize(proximal),
            lateral: Vector3::x_axis(),
            posterior: Vector3::y_axis(),
        }
    }

    #[test]
    fn landmarks_lie_on_their_faces_at_their_heights_either_way_up() {
        for up in [1.0, -1.0] {
            let (low, high) = if up > 0.0 { (0.0, 300.0) } else { (-300.0, 0.0) };
            let bone = MeshQuery::new(&cuboid([-4.0, -5.0, low], [6.0, 7.0, high]));
            let points = paper_recipe(&bone, &anatomy(Vector3::z() * up), &RecipeParams::default()).unwrap();
            let expected = [[1.0, 7.0, 100.0], [6.0, 1.0, 130.0], [1.0, 7.0, 125.0]];
            for (point, [x, y, z]) in points.iter().zip(expected) {
                assert!((point.position - Point3::new(x, y, z * up)).norm() < 1e-9, "{point:?}");
            }
        }
    }

    #[test]
    fn a_bone_too_short_and_a_direction_along_it_are_refused() {
        let bone = MeshQuery::new(&cuboid([-4.0, -5.0, 0.0], [6.0, 7.0, 120.0]));
        let short = paper_recipe(&bone, &anatomy(Vector3::z()), &RecipeParams::default());
        assert!(short.unwrap_err().to_string().starts_with("P2 would lie "));
        let along = paper_recipe(&bone, &anatomy(Vector3::x()), &RecipeParams::default());
        assert!(along.unwrap_err().to_string().starts_with("lateral runs along the bone"));
    }
}
