//! The kind `transform.first_of`.

use osteoflow_geometry::Pose;
use osteoflow_node::{
    Context, Describe, Inputs, NodeError, Outputs, function, params, schemars::JsonSchema, serde::Deserialize,
};

/// The first of two poses that has a value, such as that of the recording, or else of the plan.
///
/// If both have one and they differ, one is wrong, and the node fails.
#[derive(Describe)]
#[describe(example = r#"
kind = "transform.first_of"
in   = { first = "recording.phantom_marker_cad", second = "plan.t_phantom_phantom_marker" }
"#)]
pub struct FirstOf;

/// Parameters of [`FirstOf`].
#[params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// Maximum distance between the origins of both poses. 0.5: rounding of files and units, far below a mistake.
    #[param(0.5, 0.0..=1000.0)]
    pub max_apart_mm: f64,
    /// Maximum angle between both poses. 0.2: as much.
    #[param(0.2, 0.0..=180.0)]
    pub max_apart_deg: f64,
}

/// Inputs of [`FirstOf`].
#[derive(Inputs)]
pub struct In {
    /// Taken where it has a value.
    #[port(join = "once", to = "second.to", from = "second.from")]
    first: Option<Pose>,
    /// Taken where `first` has none.
    #[port(join = "once", to = "first.to", from = "first.from")]
    second: Option<Pose>,
}

/// Outputs of [`FirstOf`].
#[derive(Outputs)]
pub struct Out {
    /// The pose.
    #[port(to = "first.to", from = "first.from")]
    pose: Pose,
}

#[function("transform.first_of")]
impl FirstOf {
    fn process(params: &Params, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        if let (Some(first), Some(second)) = (&i.first, &i.second) {
            let between = first.isometry.inverse() * second.isometry;
            let (mm, deg) = (between.translation.vector.norm(), between.rotation.angle().to_degrees());
            if mm > params.max_apart_mm || deg > params.max_apart_deg {
                return Err(NodeError::new(format!(
                    "the two poses of {} in {} differ by {mm:.1} mm and {deg:.1} degrees, so one of them is wrong; correct it, or \
                     wire the right one alone",
                    first.from, first.to
                )));
            }
        }
        match i.first.or(i.second) {
            Some(pose) => Ok(Out { pose }),
            None => Err(NodeError::new(format!(
                "neither pose has a value: {}; {}",
                ctx.absent_reason("first").unwrap_or("the first is not wired"),
                ctx.absent_reason("second").unwrap_or("the second is not wired"),
            ))),
        }
    }
}
