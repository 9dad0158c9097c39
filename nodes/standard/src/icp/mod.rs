//! Fine registration of the scan onto the CT surface: every kind takes the same ports and parameters.

pub mod generalized;
pub mod point_to_mesh;
pub mod point_to_plane;
pub mod point_to_point;
pub mod symmetric;

use osteoflow_algorithms::{
    icp::{self, Halt, IcpParams, IcpReport, IcpStep, IcpTrace, Method, PublishedReading},
    target::Target,
};
use osteoflow_geometry::{Cloud, Pose};
use osteoflow_node::{Context, Inputs, NodeError, Outputs, ParamError};
use std::{ops::ControlFlow, time::Duration};

/// Inputs of every ICP.
#[derive(Inputs)]
pub struct In {
    /// Moves: the scanned surface, cropped.
    source: Cloud,
    /// Stays: the CT surface, prepared once (points, normals, tree).
    #[port(join = "once", frame = "init.to")]
    target: Target,
    /// Where to start: from the coarse fit.
    #[port(to = "target", from = "source")]
    init: Pose,
}

/// Outputs of every ICP.
#[derive(Outputs)]
pub struct Out {
    /// The registration.
    #[port(to = "target", from = "source")]
    t_target_source: Pose,
    /// How it ended: converged or not and why, pairs, residual, what is observable.
    report: IcpReport,
    /// How it got there, step by step.
    trace: IcpTrace,
}

/// Refuses what only `point_to_point` knows.
fn own_rules(params: IcpParams) -> Result<IcpParams, ParamError> {
    match params.published_reading {
        PublishedReading::None => Ok(params),
        _ => Err(ParamError::new(
            "published_reading",
            "this is what the paper may have done with icp.point_to_point; leave it out, or use that kind",
        )),
    }
}

impl In {
    /// Registers by a variant, until the user stops the run or the time is up.
    fn register(&self, method: Method, params: &IcpParams, ctx: &mut Context) -> Result<Out, NodeError> {
        let init = self.init.expect(&self.target.frame, &self.source.frame)?; // the one check of frames
        let limit = Some(params.stop_after_ms).filter(|ms| *ms > 0.0);
        let mut budget = limit.map(|ms| ctx.budget(Duration::from_secs_f64(ms / 1e3)));
        let mut observer = |_: &IcpStep| {
            if ctx.cancelled() {
                ControlFlow::Break(Halt::Cancelled)
            } else if budget.as_mut().is_some_and(|budget| budget.is_over()) {
                ControlFlow::Break(Halt::Time)
            } else {
                ControlFlow::Continue(())
            }
        };
        let fit = icp::register(method, &self.target, &self.source, &init, params, &mut observer)?;
        let pose = Pose::new(&self.target.frame, &self.source.frame, fit.t_target_source);
        Ok(Out { t_target_source: pose.at(ctx.stamp_ns()), report: fit.report, trace: fit.trace })
    }
}
