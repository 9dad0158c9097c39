//! What of a plan is elsewhere than it was when a procedure was made with it.

use osteoflow_geometry::{NamedPoint, Plane, SurgicalPlan};
use osteoflow_payloads::Json;
use serde::{Deserialize, Serialize};

/// Places nearer than this are the same, mm: what writing and reading a plan rounds.
const SAME_MM: f64 = 1e-3;
/// The same of directions, radians.
const SAME_RAD: f64 = 1e-5;

/// Names of what was planned elsewhere, or not at all, when the procedure was made.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Moved {
    /// Landmarks.
    #[serde(default)]
    pub(crate) landmarks: Vec<String>,
    /// Assessment points.
    pub(crate) assessment: Vec<String>,
    /// Cutting planes.
    pub(crate) planes: Vec<String>,
}

impl Moved {
    /// What is elsewhere in a plan than in the one that a procedure was made for.
    pub(crate) fn since(made_for: &SurgicalPlan, plan: &SurgicalPlan) -> Self {
        let points = |before: &[NamedPoint], now: &[NamedPoint]| {
            let is_same =
                |p: &NamedPoint, q: &NamedPoint| q.name == p.name && (q.position - p.position).norm() < SAME_MM;
            let moved = now.iter().filter(|p| !before.iter().any(|q| is_same(p, q)));
            moved.map(|p| p.name.to_string()).collect()
        };
        let is_plane = |p: &&Plane| {
            let mut before = made_for.planes.planes.iter().filter(|q| q.name == p.name);
            !before.any(|q| {
                q.isometry().zip(p.isometry()).is_some_and(|(a, b)| {
                    (a.translation.vector - b.translation.vector).norm() < SAME_MM
                        && a.rotation.angle_to(&b.rotation) < SAME_RAD
                })
            })
        };
        let planes = plan.planes.planes.iter().filter(is_plane).map(|p| p.name.to_string());
        Self {
            landmarks: points(&made_for.landmarks.points, &plan.landmarks.points),
            assessment: points(&made_for.assessment.points, &plan.assessment.points),
            planes: planes.collect(),
        }
    }

    /// What the report of a plan says of it; nothing where none is wired, or the plan is the procedure's own.
    pub(crate) fn of(report: Option<&Json>) -> Self {
        report.and_then(|report| Self::deserialize(&report.0["moved"]).ok()).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::{
        Planes, Points,
        nalgebra::{Isometry3, Point3, Vector3},
    };

    fn plan(points: &[(&str, f64)], planes: &[(&str, f64, f64)]) -> SurgicalPlan {
        let point = |(name, z): &(&str, f64)| NamedPoint::new(*name, Point3::new(1.0, 2.0, *z));
        let plane = |(name, z, turn): &(&str, f64, f64)| {
            Plane::new(*name, Isometry3::new(Vector3::new(0.0, 0.0, *z), Vector3::x() * *turn))
        };
        SurgicalPlan {
            landmarks: Points::new("ct", []),
            assessment: Points::new("ct", points.iter().map(point).collect::<Vec<_>>()),
            planes: Planes::new("ct", planes.iter().map(plane).collect::<Vec<_>>()),
            axes: None,
            anatomy: None,
            t_phantom_phantom_marker: None,
            t_camera_camera_marker_nominal: None,
            surface: None,
        }
    }

    #[test]
    fn what_is_elsewhere_new_or_renamed_has_moved_and_what_is_gone_has_not() {
        let before = plan(&[("M1", 0.0), ("M2", 5.0), ("M3", 9.0)], &[("a", 1.0, 0.0), ("b", 2.0, 0.0)]);
        assert_eq!(Moved::since(&before, &before), Moved::default());
        let after = plan(&[("M1", 1e-7), ("M2", 5.1), ("hole", 9.0)], &[("a", 1.0, 1e-3), ("b", 2.0, 1e-9)]);
        let moved = Moved::since(&before, &after);
        let expected =
            Moved { assessment: vec!["M2".into(), "hole".into()], planes: vec!["a".into()], ..Moved::default() };
        assert_eq!(moved, expected);
        // Two points that changed places both moved.
        let swapped = plan(&[("M1", 5.0), ("M2", 0.0)], &[]);
        assert_eq!(Moved::since(&before, &swapped).assessment, ["M1", "M2"]);
    }
}
