use crate::moved::Moved;
use osteoflow_geometry::{Axes, Planes, Points, Pose, SurgicalPlan};
use osteoflow_node::{Emit, Outputs};
use osteoflow_payloads::Json;
use serde_json::json;
use std::sync::Arc;

/// A plan, port by port. A part that the plan lacks is an empty that says why.
#[derive(Outputs)]
pub struct Out {
    /// The landmarks P1..P3 where the procedure located them: the start of the registration.
    #[port(frame = "@ct")]
    landmarks: Points,
    /// The assessment points M1..M5, which are not used to fit.
    #[port(frame = "@ct")]
    assessment: Points,
    /// The cutting planes.
    #[port(frame = "@ct")]
    planes: Planes,
    /// The axes along which errors are resolved.
    #[port(frame = "@ct")]
    axes: Emit<Axes>,
    /// `t_phantom_phantom_marker` by the phantom's CAD.
    #[port(to = "@phantom", from = "@phantom_marker")]
    t_phantom_phantom_marker: Emit<Pose>,
    /// `t_camera_camera_marker` as designed, where the calibration starts.
    #[port(to = "@camera", from = "@camera_marker")]
    t_camera_camera_marker_nominal: Emit<Pose>,
    /// What binds the plan to its surface, for `verdict.registration`: the plan's key `surface`, and `confirm`. With `made_for`
    /// also what has moved since, for `metrics.tre_measured`, `metrics.tre_true` and `metrics.cuts`, and where moved landmarks
    /// are planned now.
    report: Json,
}

impl Out {
    /// The ports of a plan; `confirm` says whether the user has checked that it belongs to its surface, `moved` what is elsewhere than
    /// in the plan that the procedure was made for, and the landmarks as they are planned now if they are not those of the plan.
    pub(super) fn new(plan: SurgicalPlan, confirm: bool, moved: Option<(&Moved, Option<&Points>)>) -> Self {
        let mut report = json!({ "surface": plan.surface, "confirm": confirm });
        if let Some((moved, now)) = moved {
            report["moved"] = json!(moved);
            if let Some(now) = now {
                let places = now.points.iter().map(|p| (p.name.to_string(), json!(p.position.coords.as_slice())));
                report["planned_landmarks"] = places.collect::<serde_json::Map<_, _>>().into();
            }
        }
        Self {
            report: Json(Arc::new(report)),
            landmarks: plan.landmarks,
            assessment: plan.assessment,
            planes: plan.planes,
            axes: or_empty(plan.axes, "axes"),
            t_phantom_phantom_marker: or_empty(plan.t_phantom_phantom_marker, "phantom marker pose"),
            t_camera_camera_marker_nominal: or_empty(plan.t_camera_camera_marker_nominal, "nominal camera marker pose"),
        }
    }
}

fn or_empty<T>(value: Option<T>, what: &str) -> Emit<T> {
    value.map_or_else(|| Emit::Empty(format!("the plan gives no {what}")), Emit::Value)
}
