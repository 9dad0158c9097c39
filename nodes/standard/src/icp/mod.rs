//! Fine registration of the scan onto the CT surface: every kind takes the same ports and parameters.

pub mod point_to_plane;
pub mod point_to_point;

use osteoflow_algorithms::{
    icp::{IcpFit, IcpReport, IcpStep, IcpTrace},
    target::Target,
};
use osteoflow_geometry::{Cloud, FrameError, Pose, nalgebra::Isometry3};
use osteoflow_node::{Context, Inputs, Outputs};
use std::ops::ControlFlow;

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

impl In {
    /// The motion to start from: the one check of frames.
    fn init(&self) -> Result<Isometry3<f64>, FrameError> {
        self.init.expect(&self.target.frame, &self.source.frame)
    }

    fn out(&self, fit: IcpFit, ctx: &Context) -> Out {
        let pose = Pose::new(&self.target.frame, &self.source.frame, fit.t_target_source);
        Out { t_target_source: pose.at(ctx.stamp_ns()), report: fit.report, trace: fit.trace }
    }
}

/// Ends an ICP when the user stops the run.
fn observer(ctx: &Context) -> impl FnMut(&IcpStep) -> ControlFlow<()> {
    |_| if ctx.cancelled() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
}
