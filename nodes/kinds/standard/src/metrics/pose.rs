//! The kind `metrics.pose`.

use osteoflow_algorithms::{
    kabsch::centroid,
    metrics::{PoseErrorReport, pose_error},
};
use osteoflow_geometry::{Cloud, Pose as PosePayload};
use osteoflow_node::{
    Context, Describe, Inputs, NodeError, Outputs, function, params, schemars::JsonSchema, serde::Deserialize,
};
use osteoflow_payloads::Json;
use serde_json::json;
use std::sync::Arc;

/// The error of a registration whose answer is known: at the centroid of the scan, and as an angle.
///
/// It is right if both are below their limits; a mean over runs of `right`, 1 or 0, is the recall.
#[derive(Describe)]
#[describe(example = r#"
kind = "metrics.pose"
in   = { cloud = "perturb.cloud", t_target_source = "icp.t_target_source", t_target_source_true = "perturb.pose" }
"#)]
pub struct Pose;

/// Parameters of [`Pose`].
#[params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// A right pose is off by less at the centroid. 4: as published for bones of a hip.
    #[param(4.0, 1e-6..=1e6)]
    pub right_mm: f64,
    /// A right pose is turned by less. 5: as published for bones of a hip.
    #[param(5.0, 1e-6..=180.0)]
    pub right_deg: f64,
}

/// Inputs of [`Pose`].
#[derive(Inputs)]
pub struct In {
    /// The scan that was registered.
    cloud: Cloud,
    /// The registration.
    #[port(to = "t_target_source_true.to", from = "cloud")]
    t_target_source: PosePayload,
    /// The true pose.
    #[port(from = "cloud")]
    t_target_source_true: PosePayload,
}

/// Outputs of [`Pose`].
#[derive(Outputs)]
pub struct Out {
    /// `error_mm` at the centroid, `error_deg`, and `right`, 1 or 0.
    report: Json,
}

#[function("metrics.pose")]
impl Pose {
    fn process(params: &Params, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let (t, truth) = (i.t_target_source, i.t_target_source_true);
        let error = t.compose(&truth.inverse())?.expect(&truth.to, &truth.to)?;
        let PoseErrorReport { at_point_mm, rotation_deg, .. } =
            pose_error(&error, &(truth.isometry * centroid(i.cloud.points())));
        let is_right = at_point_mm < params.right_mm && rotation_deg < params.right_deg;
        let report = json!({ "error_mm": at_point_mm, "error_deg": rotation_deg, "right": u8::from(is_right) });
        Ok(Out { report: Json(Arc::new(report)) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::nalgebra::{Isometry3, Point3, Vector3};
    use osteoflow_node::Function;

    #[test]
    fn a_pose_is_right_below_both_limits_at_the_centroid() {
        let points = [[90.0, 0.0, 0.0], [110.0, 0.0, 0.0]].map(Point3::from);
        let report = |shift_mm: f64, turn_deg: f64| {
            let cloud = Cloud::new("camera", points.to_vec()).expect("a cloud");
            let pose = |isometry| PosePayload::new("ct", "camera", isometry);
            let truth = Isometry3::new(Vector3::new(7.0, 8.0, 9.0), Vector3::new(0.3, 2.0, 0.1));
            // About the centroid, so that the turn does not move it.
            let turn = Isometry3::rotation(Vector3::z() * turn_deg.to_radians());
            let about = Isometry3::translation(100.0, shift_mm, 0.0) * turn * Isometry3::translation(-100.0, 0.0, 0.0);
            let i = In { cloud, t_target_source: pose(truth * about), t_target_source_true: pose(truth) };
            let Out { report } =
                Pose::process(&Params::default(), i, &mut Context::for_test("score")).expect("a report");
            let of = |key: &str| report.0[key].as_f64().expect("a number");
            assert!(
                (of("error_mm") - shift_mm).abs() < 1e-9 && (of("error_deg") - turn_deg).abs() < 1e-6,
                "{report:?}"
            );
            of("right")
        };
        assert_eq!([report(3.9, 4.9), report(4.1, 0.0), report(0.0, 5.1)], [1.0, 0.0, 0.0]);
    }
}
