//! The landmark under a laser spot, from the hole that it leaves in a scan: every kind takes the same ports.

pub mod cloud_difference;
pub mod range_image;

use osteoflow_algorithms::hole::{Hole, HoleError, HoleReport};
use osteoflow_geometry::{Cloud, FrameError, NamedPoint, Points};
use osteoflow_node::{Context, Inputs, NodeError, Outputs};

/// Inputs of every hole detector.
#[derive(Inputs)]
pub struct In {
    /// The full scan.
    #[port(join = "once", frame = "cloud")]
    reference: Cloud,
    /// A scan with the laser spot, labelled with the landmark's name.
    #[port(frame = "reference")]
    cloud: Cloud,
}

/// Outputs of every hole detector.
#[derive(Outputs)]
pub struct Out {
    /// The landmark under the spot, with its name and confidence.
    #[port(frame = "cloud")]
    point: Points,
    /// How it was found.
    report: HoleReport,
}

impl In {
    fn check(&self) -> Result<(), FrameError> {
        self.cloud.frame.expect(&self.reference.frame, "the scan with the laser")
    }

    /// The landmark's name: the scan's label, else by order.
    fn name(&self, ctx: &Context) -> String {
        self.cloud.label.as_ref().map_or_else(|| format!("P{}", ctx.item() + 1), ToString::to_string)
    }

    fn refusal(&self, error: HoleError, ctx: &Context) -> NodeError {
        NodeError::new(format!("{}: {error}", self.name(ctx)))
    }

    fn out(&self, hole: Hole, ctx: &Context) -> Out {
        let point = NamedPoint {
            name: self.name(ctx).into(),
            position: hole.centre,
            stamp_ns: self.cloud.stamp_ns,
            confidence: Some(hole.confidence),
        };
        Out { point: Points::new(&self.cloud.frame, vec![point]), report: hole.report }
    }
}
