//! The kind `transform.first_of`.

use osteoflow_geometry::Pose;
use osteoflow_node::{Context, Describe, Inputs, Node, NodeError, Outputs, ParamError};

/// The first of two poses that has a value, such as the recording's, else the plan's.
#[derive(Describe)]
#[describe(example = r#"
kind = "transform.first_of"
in   = { first = "recording.phantom_marker_cad", second = "plan.t_phantom_phantom_marker" }
"#)]
pub struct FirstOf;

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

impl Node for FirstOf {
    const KIND: &'static str = "transform.first_of";
    type Params = crate::NoParams;
    type Inputs = In;
    type Outputs = Out;

    fn new(_: crate::NoParams) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
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
