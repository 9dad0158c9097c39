//! A metric as a starting point: change it, build it, and run the graph again.

use osteoflow_node::{
    Context, Describe, Function, Inputs, NodeError, Outputs, schemars::JsonSchema, serde::Deserialize,
};
use osteoflow_payloads::{
    Metrics,
    geometry::{Points, Pose, nalgebra::distance},
};

/// Target registration error: the distances by which a registration misplaces points, where the true one is known.
#[derive(Describe)]
#[describe(example = r#"
kind = "my_plugin.tre"
in   = { planned = "plan.assessment", t_ct_world = "planes_at_scan.t_ct_world", t_ct_world_true = "recording.t_ct_world_true" }
limit_mm = 1.5
"#)]
pub struct Tre;

/// Parameters of [`Tre`].
#[osteoflow_node::params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(crate = "osteoflow_node::serde", default, deny_unknown_fields)]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct Params {
    /// Points off by at most this much are good. 1.5: half of what a cut may be off.
    #[param(1.5, 0.0..=1000.0)]
    limit_mm: f64,
}

/// The inputs.
#[derive(Inputs)]
pub struct In {
    /// Points on the bone at which the error is evaluated.
    #[port(join = "once")]
    planned: Points,
    /// The registration.
    #[port(to = "planned", from = "t_ct_world_true.from")]
    t_ct_world: Pose,
    /// The true registration.
    #[port(join = "once", to = "planned", from = "t_ct_world.from")]
    t_ct_world_true: Pose,
}

/// The outputs.
#[derive(Outputs)]
pub struct Out {
    /// Mean and largest error, and the share of good points.
    report: Metrics,
}

impl Function for Tre {
    const KIND: &'static str = "my_plugin.tre";
    type Params = Params;
    type Inputs = In;
    type Outputs = Out;

    fn process(params: &Params, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let error = i.t_ct_world.compose(&i.t_ct_world_true.inverse())?;
        let error = error.expect(&i.planned.frame, &i.planned.frame)?;
        let off_mm: Vec<f64> = i.planned.positions().iter().map(|p| distance(&(error * p), p)).collect();
        if off_mm.is_empty() {
            return Err(NodeError::new("there are no points to evaluate the error at; does the plan have some?"));
        }
        let n = off_mm.len() as f64;
        let max_mm = off_mm.iter().copied().fold(0.0, f64::max);
        let n_good = off_mm.iter().filter(|&&off_mm| off_mm <= params.limit_mm).count() as f64;
        let report =
            [("mean", off_mm.iter().sum::<f64>() / n, "mm"), ("max", max_mm, "mm"), ("share_good", n_good / n, "")];
        Ok(Out { report: Metrics::new(report)? })
    }
}

osteoflow_node::export!(Tre);

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_payloads::geometry::{
        NamedPoint,
        nalgebra::{Isometry3, Point3, Vector3},
    };

    fn report(points: &[[f64; 3]]) -> Result<Out, NodeError> {
        let named: Vec<_> = points.iter().map(|&p| NamedPoint::new("M", Point3::from(p))).collect();
        let truth = Isometry3::new(Vector3::new(40.0, -3.0, 7.0), Vector3::new(0.3, 1.0, -2.0));
        let turn = Isometry3::rotation(Vector3::z() * std::f64::consts::FRAC_PI_2);
        let input = In {
            planned: Points::new("ct", named),
            t_ct_world: Pose::new("ct", "world", turn * truth),
            t_ct_world_true: Pose::new("ct", "world", truth),
        };
        Tre::process(&Params::default(), input, &mut Context::for_test("tre"))
    }

    #[test]
    fn a_quarter_turn_moves_a_point_by_root_two_of_its_distance_from_the_axis() {
        let report = report(&[[1.0, 0.0, 5.0], [0.0, 3.0, -5.0]]).unwrap().report;
        let expected = [2.0 * 2.0_f64.sqrt(), 3.0 * 2.0_f64.sqrt(), 0.5];
        for (metric, expected) in report.iter().zip(expected) {
            assert!((metric.value - expected).abs() < 1e-12, "{}: {} instead of {expected}", metric.name, metric.value);
        }
    }

    #[test]
    fn no_points_are_an_error_and_no_mean() {
        let message = report(&[]).map(|_| ()).unwrap_err().to_string();
        assert!(message.starts_with("there are no points"), "{message}");
    }
}
