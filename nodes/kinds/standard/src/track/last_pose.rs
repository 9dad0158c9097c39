//! The kind `track.last_pose`.

use osteoflow_algorithms::{
    icp::IcpReport,
    track::{TrackLimits, TrackReport, TrackStart},
};
use osteoflow_geometry::{Cloud, Pose};
use osteoflow_node::{
    Context, Describe, Inputs, Node, NodeError, Outputs, ParamError,
    schemars::JsonSchema,
    serde::{Deserialize, Serialize},
};

/// The start for the registration of each scan of a stream: the pose of the previous scan; for the first scan, `start`.
///
/// A pose is lost if it was not computed, or if its `report` breaks a limit. The next scan then starts, with a warning, from
/// the last pose that was not lost, or from `start`. The output is a start for a registration, never a result.
#[derive(Describe)]
#[describe(example = r#"
kind = "track.last_pose"
in   = { scan = "to_world.cloud", previous = "icp.t_target_source", report = "icp.report", start = "coarse.t_target_source" }
"#)]
pub struct LastPose {
    params: Params,
    last_good: Option<Pose>,
    n_lost: u32,
}

/// Parameters of [`LastPose`].
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// What a scan starts from after a lost one. `last_good`: the bone is nearer to where it was last seen than to the start of
    /// the track.
    pub when_lost: WhenLost,
    /// When a registration counts as lost; needs `report`.
    pub limits: TrackLimits,
}

/// What a scan starts from after one that was lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum WhenLost {
    /// The last pose that was not lost.
    #[default]
    LastGood,
    /// The start of the whole track.
    Start,
}

/// Inputs of [`LastPose`].
#[derive(Inputs)]
pub struct In {
    /// The scan to register.
    #[port(frame = "start.from")]
    scan: Cloud,
    /// The pose of the scan before.
    #[port(join = "previous", to = "start.to", from = "scan")]
    previous: Option<Pose>,
    /// The report of that pose. Unwired: every pose that was computed is taken.
    #[port(join = "previous")]
    report: Option<IcpReport>,
    /// The start of the whole track, such as the landmark fit.
    #[port(join = "once", from = "scan")]
    start: Pose,
}

/// Outputs of [`LastPose`].
#[derive(Outputs)]
pub struct Out {
    /// Where to start.
    #[port(to = "start.to", from = "scan")]
    pose: Pose,
    /// Which of them it is, and why the scan before is lost if it is.
    report: TrackReport,
}

impl Node for LastPose {
    const KIND: &'static str = "track.last_pose";
    type Params = Params;
    type Inputs = In;
    type Outputs = Out;

    fn new(params: Params) -> Result<Self, ParamError> {
        Ok(Self { params, last_good: None, n_lost: 0 })
    }

    fn process(&mut self, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        i.start.expect(&i.start.to, &i.scan.frame)?;
        let lost = match &i.previous {
            None if ctx.item() == 0 => None,
            None => Some(ctx.absent_reason("previous").unwrap_or("it is not wired").to_owned()),
            Some(pose) => {
                pose.expect(&i.start.to, &i.scan.frame)?;
                i.report.as_ref().and_then(|report| self.params.limits.lost(report))
            }
        };
        let was_lost = self.n_lost > 0;
        self.n_lost = if lost.is_some() { self.n_lost + 1 } else { 0 };
        let previous = i.previous.filter(|_| lost.is_none());
        if previous.is_some() {
            self.last_good.clone_from(&previous);
        }
        let last_good = self.last_good.clone().filter(|_| self.params.when_lost == WhenLost::LastGood);
        let (starts_from, pose) = match (previous, last_good) {
            (Some(pose), _) => (TrackStart::Previous, pose),
            (None, Some(pose)) => (TrackStart::LastGood, pose),
            (None, None) => (TrackStart::Start, i.start),
        };
        if let Some(reason) = lost.as_ref().filter(|_| !was_lost) {
            let from = if starts_from == TrackStart::LastGood { "the last pose that was not lost" } else { "start" };
            ctx.warn(format!("the pose of the scan before is lost: {reason}; this scan starts from {from}"));
        }
        let report = TrackReport { starts_from, lost, n_lost: self.n_lost };
        Ok(Out { pose: pose.at(ctx.stamp_ns()), report })
    }
}
