//! Fine registration of the scan onto the CT surface: every kind takes the same ports, and all but `icp.published` the same
//! parameters.

pub mod generalized;
pub mod point_to_mesh;
pub mod point_to_plane;
pub mod point_to_point;
pub mod published;
pub mod symmetric;

use osteoflow_algorithms::{
    icp::{self, Halt, IcpError, IcpFit, IcpParams, IcpReport, IcpStep, IcpTrace, Method},
    tables::off_tables,
    target::Target,
};
use osteoflow_geometry::{Cloud, Pose, nalgebra::Isometry3};
use osteoflow_node::{Context, Inputs, NodeError, Outputs};
use std::{ops::ControlFlow, time::Duration};

/// Called after each step.
type Observer<'a> = dyn FnMut(&IcpStep) -> ControlFlow<Halt> + 'a;

/// Inputs of every fine registration.
#[derive(Inputs)]
pub struct In {
    /// The surface that moves: the scan, cropped.
    pub(crate) source: Cloud,
    /// The surface that stays: the CT surface, prepared once.
    #[port(join = "once", frame = "init.to")]
    pub(crate) target: Target,
    /// The start, such as the coarse fit.
    #[port(to = "target", from = "source")]
    pub(crate) init: Pose,
}

/// Outputs of every ICP.
#[derive(Outputs)]
pub struct Out {
    /// The registration.
    #[port(to = "target", from = "source")]
    t_target_source: Pose,
    /// Convergence, stop reason, pairs, residual and observability.
    report: IcpReport,
    /// The steps.
    trace: IcpTrace,
}

impl In {
    /// Registers by a variant.
    fn register(&self, method: Method, params: &IcpParams, ctx: &mut Context) -> Result<Out, NodeError> {
        self.run(params.stop_after_ms, ctx, |target, source, init, observer| {
            icp::register(method, target, source, init, params, observer)
        })
    }

    /// Registers until the user stops the run or the time is up.
    fn run(
        &self,
        stop_after_ms: f64,
        ctx: &mut Context,
        register: impl FnOnce(&Target, &Cloud, &Isometry3<f64>, &mut Observer<'_>) -> Result<IcpFit, IcpError>,
    ) -> Result<Out, NodeError> {
        let init = self.init.expect(&self.target.frame, &self.source.frame)?; // the one check of frames
        let rest = off_tables(&self.target, &self.source);
        if let Some(rest) = &rest {
            let (n, all) = (self.source.len() - rest.len(), self.source.len());
            ctx.warn(format!(
                "{n} of {all} points are on a plane on which the scan is wider than the whole surface, such as a table, and are left out"
            ));
        }
        let source = rest.as_ref().unwrap_or(&self.source);
        let limit = Some(stop_after_ms).filter(|ms| *ms > 0.0);
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
        let fit = register(&self.target, source, &init, &mut observer)?;
        let pose = Pose::new(&self.target.frame, &self.source.frame, fit.t_target_source);
        Ok(Out { t_target_source: pose.at(ctx.stamp_ns()), report: fit.report, trace: fit.trace })
    }
}
