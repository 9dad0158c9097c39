use crate::Refusal;
use crate::mesh_query::MeshQuery;
use nalgebra::{Point3, Unit, Vector3};
use osteoflow_geometry::NamedPoint;
use osteoflow_node_macros::params;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Radius in which triangles determine the tangent of the face, mm: about the width of a fibula's lateral face, so that
/// neither one triangle nor the meshing decides.
const FACE_REACH_MM: f64 = 3.0;

/// Maximum distance of a mark from the surface, mm: a fibula bends by less in 50 mm.
const MAX_OFF_MM: f64 = 10.0;

/// The mark from which the third one is ruled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ThirdFrom {
    /// From the first: it shares the first one's error.
    #[default]
    First,
    /// From the second: it shares the second one's error as well.
    Second,
}

/// Errors of a surgeon's ruler at each of the three marks.
#[params]
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
pub struct RulerErrors {
    /// Error of the first mark along the bone, and of all marks ruled from it. 0: as planned. The paper draws it within 10 mm
    /// both ways, as the malleolus is hard to find.
    #[param(0.0, -100.0..=100.0)]
    pub first_mm: f64,
    /// Error of the second mark from the first, along the bone. 0: as planned. The paper: within 2 mm both ways.
    #[param(0.0, -100.0..=100.0)]
    pub second_mm: f64,
    /// Error of the third mark from the one it is ruled from, along the bone. 0: as planned. The paper: within 2 mm both ways.
    #[param(0.0, -100.0..=100.0)]
    pub third_mm: f64,
    /// Error of the second mark across the bone, along the tangent of its face (the paper's x). 0: as planned. The paper:
    /// within 3 mm both ways.
    #[param(0.0, -20.0..=20.0)]
    pub across_mm: f64,
    /// The mark from which the third one is ruled. `first`: our reading of the paper's d13; `second`: the other.
    pub third_from: ThirdFrom,
    /// Whether each mark is moved to the closest point of the surface. true: a surgeon marks bone. false: displaced by the
    /// errors alone, as the paper prints; the start then differs by 0.1 mm along the bone and 3 degrees about it on average on
    /// a straight fibula, by 0.3 mm and 10 degrees on a bent one.
    #[param(true)]
    pub on_surface: bool,
}

/// Marks on the bone and their errors.
#[derive(Debug, Clone, PartialEq)]
pub struct Ruled {
    /// The marks, with the planned names in the planned order, on the surface.
    pub points: Vec<NamedPoint>,
    /// Their errors.
    pub report: RuledReport,
}

/// Errors of ruled marks against the planned landmarks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RuledReport {
    /// The first mark's error along the bone on the surface, mm: the reference for the registration's error along the
    /// bone.
    pub first_along_mm: f64,
    /// The first mark's nominal error along the bone, mm.
    pub first_asked_mm: f64,
    /// Each mark.
    pub points: Vec<RuledPoint>,
    /// The tangent of the second landmark's face across the bone, a unit vector in the bone's frame.
    pub across: [f64; 3],
}

/// Errors of one mark.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RuledPoint {
    /// Its name.
    pub name: String,
    /// Nominal error along the bone, including that of the marks it is ruled from, mm.
    pub asked_along_mm: f64,
    /// Nominal error across the bone, mm.
    pub asked_across_mm: f64,
    /// Actual error along the bone.
    pub along_mm: f64,
    /// Actual error across the bone.
    pub across_mm: f64,
    /// Distance of the displaced mark from the surface, mm.
    pub off_surface_mm: f64,
    /// Distance of the mark from the planned landmark, mm.
    pub moved_mm: f64,
}

/// True positions of marks that a surgeon puts at the `planned` landmarks with an inexact ruler.
///
/// The first mark errs along the bone, the second and third by this error and by their own, the second also across the
/// bone, along `z × n` where n is the normal of the face around the second landmark. Each displaced mark is then moved
/// to the closest point of the surface, as a surgeon marks bone; see [`RulerErrors::on_surface`]. `planned` and `bone`
/// are in one frame; `along` is the bone's direction there. `O(m)`.
///
/// # Errors
/// [`Refusal`] if there are not three landmarks, the second does not lie on the side of a shaft, or a mark misses
/// the bone.
///
/// # Source
/// Section 3.2.3 of the paper, which displaces the planned points and does not mention the surface.
pub fn ruled(
    bone: &MeshQuery,
    planned: &[NamedPoint],
    along: &Unit<Vector3<f64>>,
    errors: &RulerErrors,
) -> Result<Ruled, Refusal> {
    let [_, second, _] = planned else {
        let n = planned.len();
        return Err(Refusal::of(format!(
            "three landmarks are ruled one from the other, but the plan gives {n}; plan.landmarks places P1..P3"
        )));
    };
    let no_tangent = || {
        let name = &second.name;
        Refusal::of(format!(
            "the surface at {name} faces along the bone, so nothing there runs across it; is it the landmark of a shaft?"
        ))
    };
    let normal = face_normal(bone, &second.position).ok_or_else(no_tangent)?;
    let across = along.cross(&normal).try_normalize(0.1).ok_or_else(no_tangent)?;
    let shared_mm = match errors.third_from {
        ThirdFrom::First => errors.first_mm,
        ThirdFrom::Second => errors.first_mm + errors.second_mm,
    };
    let requests = [
        (errors.first_mm, 0.0),
        (errors.first_mm + errors.second_mm, errors.across_mm),
        (shared_mm + errors.third_mm, 0.0),
    ];
    let (mut points, mut marks) = (Vec::with_capacity(3), Vec::with_capacity(3));
    for (landmark, (asked_along_mm, asked_across_mm)) in planned.iter().zip(requests) {
        let displaced = landmark.position + along.into_inner() * asked_along_mm + across * asked_across_mm;
        let closest = bone.closest_point(&displaced);
        let off_surface_mm = closest.map_or(f64::INFINITY, |c| c.distance_mm);
        let closest = closest.filter(|_| off_surface_mm <= MAX_OFF_MM).ok_or_else(|| {
            let name = &landmark.name;
            Refusal::of(format!(
                "{name} would lie {off_surface_mm:.1} mm off the bone, {MAX_OFF_MM} mm is allowed; is the bone as long as ruled?"
            ))
        })?;
        let mark = if errors.on_surface { closest.point } else { displaced };
        let moved = mark - landmark.position;
        marks.push(RuledPoint {
            name: landmark.name.to_string(),
            asked_along_mm,
            asked_across_mm,
            along_mm: moved.dot(along),
            across_mm: moved.dot(&across),
            off_surface_mm,
            moved_mm: moved.norm(),
        });
        points.push(NamedPoint::new(landmark.name.clone(), mark));
    }
    let report = RuledReport {
        first_along_mm: marks[0].along_mm,
        first_asked_mm: errors.first_mm,
        points: marks,
        across: across.into(),
    };
    Ok(Ruled { points, report })
}

/// The outward normal of the face around a point: the mean over near triangles of similar orientation.
fn face_normal(bone: &MeshQuery, at: &Point3<f64>) -> Option<Vector3<f64>> {
    let here = bone.closest_point(at)?;
    let mesh = bone.mesh();
    let mut sum = Vector3::zeros();
    for face in 0..mesh.faces().len() {
        let [a, b, c] = mesh.corners(face);
        let middle = Point3::from((a.coords + b.coords + c.coords) / 3.0);
        let area = mesh.area_vector(face);
        if (middle - here.point).norm() <= FACE_REACH_MM && area.dot(&here.normal) > 0.0 {
            sum += area;
        }
    }
    // A mesh coarser than the radius: the one triangle.
    Some(sum.try_normalize(0.0).unwrap_or(here.normal))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::{cuboid, shaft};
    use nalgebra::Isometry3;

    fn named(points: [[f64; 3]; 3]) -> Vec<NamedPoint> {
        points.iter().enumerate().map(|(k, p)| NamedPoint::new(format!("P{}", k + 1), Point3::from(*p))).collect()
    }

    fn on_a_box() -> (MeshQuery, Vec<NamedPoint>) {
        let bone = MeshQuery::new(&cuboid([-5.0, -6.0, 0.0], [5.0, 6.0, 200.0]));
        (bone, named([[0.0, 6.0, 80.0], [5.0, 0.0, 110.0], [0.0, 6.0, 105.0]]))
    }

    const ERRORS: RulerErrors = RulerErrors {
        first_mm: 7.0,
        second_mm: -1.5,
        third_mm: 2.0,
        across_mm: 2.5,
        third_from: ThirdFrom::First,
        on_surface: true,
    };

    #[test]
    fn marks_share_the_first_ones_error_and_only_the_second_errs_across() {
        let (bone, planned) = on_a_box();
        let ruled = ruled(&bone, &planned, &Vector3::z_axis(), &ERRORS).unwrap();
        // The lateral face looks along x, so that across is z × x = y.
        for (point, expected) in ruled.points.iter().zip([[0.0, 6.0, 87.0], [5.0, 2.5, 115.5], [0.0, 6.0, 114.0]]) {
            assert!((point.position - Point3::from(expected)).norm() < 1e-9, "{point:?}");
        }
        let report = ruled.report;
        assert!((report.first_along_mm - 7.0).abs() < 1e-9 && report.first_asked_mm == 7.0);
        assert!((report.points[1].across_mm - 2.5).abs() < 1e-9 && report.points[1].off_surface_mm < 1e-9);
        assert_eq!(report.points[2].asked_along_mm, 9.0);
        assert!((report.points[2].moved_mm - 9.0).abs() < 1e-9);
    }

    #[test]
    fn a_third_mark_ruled_from_the_second_shares_its_error_too() {
        let (bone, planned) = on_a_box();
        let errors = RulerErrors { third_from: ThirdFrom::Second, ..ERRORS };
        let ruled = ruled(&bone, &planned, &Vector3::z_axis(), &errors).unwrap();
        assert!((ruled.report.points[2].along_mm - 7.5).abs() < 1e-9, "{:?}", ruled.report.points[2]);
    }

    #[test]
    fn marks_lie_on_the_bone_and_move_with_it() {
        let bone = MeshQuery::new(&shaft());
        let on = |p: [f64; 3]| bone.closest_point(&Point3::from(p)).unwrap().point;
        let planned: Vec<_> = [[0.0, 20.0, 40.0], [20.0, 0.0, 70.0], [0.0, 20.0, 65.0]]
            .iter()
            .enumerate()
            .map(|(k, p)| NamedPoint::new(format!("P{}", k + 1), on(*p)))
            .collect();
        let here = ruled(&bone, &planned, &Vector3::z_axis(), &ERRORS).unwrap();
        for (point, marks) in here.points.iter().zip(&here.report.points) {
            assert!(bone.closest_point(&point.position).unwrap().distance_mm < 1e-9);
            assert!((marks.along_mm - marks.asked_along_mm).abs() < 0.6 && marks.off_surface_mm < 1.5, "{marks:?}");
        }
        let as_printed = RulerErrors { on_surface: false, ..ERRORS };
        for marks in ruled(&bone, &planned, &Vector3::z_axis(), &as_printed).unwrap().report.points {
            assert!((marks.along_mm - marks.asked_along_mm).abs() < 1e-9 && marks.off_surface_mm > 1e-3, "{marks:?}");
        }
        let motion = Isometry3::new(Vector3::new(300.0, -20.0, -900.0), Vector3::new(0.4, 1.1, -2.0));
        let there = ruled(
            &MeshQuery::new(&shaft().transformed("ct", &motion)),
            &planned.iter().map(|p| NamedPoint::new(p.name.clone(), motion * p.position)).collect::<Vec<_>>(),
            &Unit::new_normalize(motion * Vector3::z()),
            &ERRORS,
        )
        .unwrap();
        for (here, there) in here.points.iter().zip(&there.points) {
            assert!((motion * here.position - there.position).norm() < 1e-6, "moving the bone moves its marks");
        }
    }

    #[test]
    fn landmarks_that_cannot_be_ruled_are_refused() {
        let (bone, planned) = on_a_box();
        let two = ruled(&bone, &planned[..2], &Vector3::z_axis(), &ERRORS);
        assert!(two.unwrap_err().to_string().contains("the plan gives 2"));
        let along = ruled(&bone, &planned, &Vector3::x_axis(), &ERRORS);
        assert!(along.unwrap_err().to_string().starts_with("the surface at P2 faces along the bone"));
        let beyond = RulerErrors { first_mm: 100.0, second_mm: 5.0, ..ERRORS };
        let error = ruled(&bone, &planned, &Vector3::z_axis(), &beyond).unwrap_err();
        assert!(error.to_string().starts_with("P2 would lie 15.0 mm off the bone"), "{error}");
    }
}
