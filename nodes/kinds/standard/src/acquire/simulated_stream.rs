//! The kind `acquire.simulated_stream`.

use super::playback::{Event, Playback, in_order};
use crate::own_bone::{OwnBone, refused};
use osteoflow_geometry::{Cloud, Pose};
use osteoflow_node::{
    Context, Describe, Emit, NodeError, Outputs, ParamError, Source, schemars::JsonSchema, serde::Deserialize,
};
use osteoflow_simulation::{Procedure, ProcedureParams, StreamParams};

/// The bone of a simulated procedure, scanned again and again while it moves.
///
/// The procedure is that of `acquire.simulated` with the same parameters and seed. The scans begin a second before its last
/// motion.
#[derive(Describe)]
#[describe(example = r#"
kind = "acquire.simulated_stream"
stream = { rate_hz = 5.0, n_scans = 40 }
"#)]
pub struct SimulatedStream {
    params: Params,
    playback: Option<Playback<Out>>,
}

/// Parameters of [`SimulatedStream`].
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default)]
pub struct Params {
    /// A bone of your own.
    #[serde(flatten)]
    pub own: OwnBone,
    /// Every error term of the procedure.
    #[serde(flatten)]
    pub procedure: ProcedureParams,
    /// The scans.
    pub stream: StreamParams,
}

/// Outputs of [`SimulatedStream`].
#[derive(Outputs, Default)]
pub struct Out {
    /// The bone, seen by the camera.
    #[port(frame = "@camera")]
    scan: Emit<Cloud>,
    /// The marker on the camera, tracked.
    #[port(to = "@world", from = "@camera_marker")]
    camera_marker: Emit<Pose>,
    /// The true registration at each scan, for scoring.
    #[port(to = "@ct", from = "@world")]
    t_ct_world_true: Emit<Pose>,
}

impl Source for SimulatedStream {
    const KIND: &'static str = "acquire.simulated_stream";
    type Params = Params;
    type Outputs = Out;

    fn new(params: Params) -> Result<Self, ParamError> {
        params.own.check(&params.procedure.bone)?;
        params.procedure.check().map_err(refused)?;
        Ok(Self { params, playback: None })
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<Out>, NodeError> {
        if self.playback.is_none() {
            let Params { own, procedure, stream } = &self.params;
            let subject = own.subject(&procedure.bone)?;
            let scans = Procedure::stream_for(&subject, procedure, stream, ctx.seed())?;
            let markers = scans.camera_marker.into_iter().map(|pose| Event {
                stamp_ns: pose.stamp_ns,
                port: 1,
                body: Out { camera_marker: Emit::Value(pose), ..Out::default() },
            });
            let clouds = scans.scans.into_iter().zip(scans.t_ct_world).map(|(scan, truth)| Event {
                stamp_ns: scan.stamp_ns,
                port: 0,
                body: Out { scan: Emit::Value(scan), t_ct_world_true: Emit::Value(truth), ..Out::default() },
            });
            self.playback = Some(in_order(clouds.chain(markers).collect()));
        }
        let Some(event) = self.playback.as_mut().and_then(Iterator::next) else { return Ok(None) };
        ctx.set_stamp_ns(event.stamp_ns);
        Ok(Some(event.body))
    }
}
