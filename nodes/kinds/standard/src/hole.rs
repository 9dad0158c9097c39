//! Detection of the landmark under a laser spot, from the hole that it leaves in a scan, or from a colour
//! image. All kinds have the same ports, `hole.rgb_spot` two more for the image.

pub mod boundary;
pub mod cloud_difference;
pub mod range_image;
pub mod rgb_spot;

use osteoflow_algorithms::hole::{Hole, HoleReport};
use osteoflow_geometry::{Cloud, FrameError, NamedPoint, Points};
use osteoflow_node::{Context, Inputs, NodeError, Outputs};

/// Inputs of every hole detector that compares two scans.
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
    /// The landmark under the spot, with its name and confidence; below `min_confidence` it is of the second tier.
    #[port(frame = "cloud")]
    point: Points,
    /// How it was found.
    report: HoleReport,
}

impl In {
    fn check(&self) -> Result<(), FrameError> {
        self.cloud.frame.expect(&self.reference.frame, "the scan with the laser")
    }
}

/// The landmark's name: the scan's label, or `P1`, `P2`, .. by item.
fn name(cloud: &Cloud, ctx: &Context) -> String {
    cloud.label.as_ref().map_or_else(|| format!("P{}", ctx.item() + 1), ToString::to_string)
}

/// The landmark at the hole.
///
/// One of the second tier is reported, so that none counts without anybody's knowledge where nothing confirms it.
fn answer(cloud: &Cloud, found: Result<Hole, impl std::fmt::Display>, ctx: &mut Context) -> Result<Out, NodeError> {
    let name = name(cloud, ctx);
    let hole = found.map_err(|error| NodeError::new(format!("{name}: {error}")))?;
    if hole.report.tier > 1 {
        let what = match hole.report.centre_uncertainty_mm.filter(|mm| *mm > 0.0) {
            Some(mm) => format!(
                "the spot may be up to {mm:.1} mm from the centre found, as a disc on the surface or a slanted beam explains the hole \
                 there too, and its confidence is {:.2}",
                hole.confidence
            ),
            None => format!("the only candidate has a confidence of {:.2}", hole.confidence),
        };
        ctx.warn(format!(
            "{name}: {what}, which is not enough by itself: coarse.three_point takes it if its distances to the other landmarks are as \
             planned, and nothing else checks it"
        ));
    }
    let point = NamedPoint {
        name: name.into(),
        position: hole.centre,
        stamp_ns: cloud.stamp_ns,
        confidence: Some(hole.confidence),
    };
    Ok(Out { point: Points::new(&cloud.frame, vec![point]), report: hole.report })
}
