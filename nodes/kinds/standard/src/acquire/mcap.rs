//! The kind `acquire.mcap`.

use super::{
    mcap_events::Port,
    playback::{Event, Playback, in_order},
    topic_params::PortParams,
    topic_port::{Findings, Scan, TopicPort},
    topics::{self, FrameNames},
};
use osteoflow_formats::mcap_read::Recording;
use osteoflow_node::{
    Context, Declared, DeclaredPort, Describe, Emission, FilePath, NodeError, ParamError, Source, params,
    schemars::JsonSchema, serde::Deserialize,
};
use std::collections::BTreeMap;

pub use topics::reads;

/// The streams of a recording in MCAP, of Foxglove's schemas or ROS 2's, in the order of sensor time.
///
/// Each entry of `out` is a port with a `type` and a topic. Protobuf, JSON and CDR, any chunk compression, with or without an
/// index. Transforms of a topic named `tf_static` hold from the beginning. Metres become millimetres; points that are not
/// finite are left out, counted and reported. A pose that was written without seeing the marker is an empty that says why. A
/// rounded rotation is replaced by the nearest one, and each topic reports its largest correction; above 0.001 it is an error.
/// Topics that no port reads, and transforms that are joined (`max_gap_ms`), are listed in the log.
#[derive(Describe)]
#[describe(example = r#"
kind = "acquire.mcap"
path = "recording.mcap"
out.scan          = { type = "geometry/Cloud", topic = "/camera/scan", frame = "camera" }
out.laser         = { type = "geometry/Cloud", topics = ["/camera/laser_p1", "/camera/laser_p2"], labels = ["P1", "P2"] }
out.camera_marker = { type = "geometry/Pose", topic = "/tracker/camera_marker", to = "world", from = "camera_marker" }
"#)]
pub struct Mcap {
    params: Params,
    playback: Option<Playback<EventBody>>,
}

/// Parameters of [`Mcap`].
#[params(path)]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// The recording, or the folder of a ROS 2 bag.
    pub path: FilePath,
    /// Whether the intact part of a damaged recording is used, with a warning. false: it is an error.
    pub allow_truncated: bool,
    /// Frames with another name in the graph, such as `{ camera_depth_optical_frame = "camera" }`.
    pub frames: BTreeMap<String, String>,
}

/// The body of an event. Clouds and images are decoded when they are due.
pub(super) enum EventBody {
    Scan(Scan),
    Ready(Emission),
}

impl Source for Mcap {
    const KIND: &'static str = "acquire.mcap";
    type Params = Params;
    type Outputs = Declared<PortParams>;

    fn new(params: Params) -> Result<Self, ParamError> {
        Ok(Self { params, playback: None })
    }

    fn check_ports(ports: &[DeclaredPort]) -> Result<(), ParamError> {
        ports.iter().try_for_each(|port| PortParams::of(port).map(drop))
    }

    fn is_timed(&self, port: &DeclaredPort) -> bool {
        PortParams::is_timed(port)
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<Self::Outputs>, NodeError> {
        if self.playback.is_none() {
            self.playback = Some(self.playback(ctx)?);
        }
        let Some(event) = self.playback.as_mut().and_then(Iterator::next) else { return Ok(None) };
        ctx.set_stamp_ns(event.stamp_ns);
        Ok(Some(Declared::one(event.port, self.emission(event, ctx)?)))
    }
}

impl Mcap {
    /// All events in the order of their stamps.
    pub(super) fn playback(&self, ctx: &mut Context) -> Result<Playback<EventBody>, NodeError> {
        Ok(in_order(self.open(ctx).map_err(|error| self.named(error))?))
    }

    /// The error with the recording it speaks of.
    fn named(&self, NodeError { message }: NodeError) -> NodeError {
        let name = self.params.path.as_ref().display().to_string();
        NodeError::new(if message.contains(&name) { message } else { format!("{name}: {message}") })
    }

    /// The emission of an event.
    pub(super) fn emission(&self, event: Event<EventBody>, ctx: &mut Context) -> Result<Emission, NodeError> {
        Self::decoded(event, ctx).map_err(|error| self.named(error))
    }

    fn decoded(event: Event<EventBody>, ctx: &mut Context) -> Result<Emission, NodeError> {
        let scan = match event.body {
            EventBody::Ready(emission) => return Ok(emission),
            EventBody::Scan(scan) => scan,
        };
        let label = scan.label.clone();
        let (emission, notes) = scan.emission().map_err(|error| {
            let port = &ctx.declared()[event.port].name;
            NodeError::new(format!("port \"{port}\", {label}: {error}"))
        })?;
        notes.into_iter().for_each(|note| ctx.warn(format!("{label}: {note}")));
        Ok(emission)
    }

    fn open(&self, ctx: &mut Context) -> Result<Vec<Event<EventBody>>, NodeError> {
        let ports = ctx.declared();
        let topic_ports = ports.iter().map(TopicPort::new).collect::<Result<Vec<_>, _>>()?;
        let params: Vec<_> = topic_ports.iter().map(|port| port.params.clone()).collect();
        let wanted = |topic: &str| {
            let is_named = |p: &PortParams| {
                [&p.present, &p.calibration].into_iter().any(|name| name.as_deref() == Some(topic))
                    || p.read_topics().iter().any(|t| t == topic)
            };
            params.iter().any(is_named)
        };
        let recording = Recording::open_topics(self.params.path.as_ref(), self.params.allow_truncated, wanted)?;
        for note in &recording.notes {
            ctx.warn(note.clone());
        }
        for topic in recording.topics().iter().filter(|t| !wanted(&t.name)) {
            osteoflow_node::tracing::info!(
                topic = topic.name,
                schema = topic.schema_name,
                n_messages = topic.n_messages,
                "no port reads this topic"
            );
        }
        let frames = FrameNames::new(&self.params.frames);
        let (mut events, mut found) = (Vec::new(), Findings { frames, ..Findings::default() });
        let path = self.params.path.as_ref();
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy();
        for (port, topic_port) in topic_ports.into_iter().enumerate() {
            let mut of_port = Port { recording: &recording, name: &name, port: topic_port, found: &mut found };
            events.extend(of_port.events()?.into_iter().map(|(stamp_ns, body)| Event { stamp_ns, port, body }));
        }
        for (topic, corrections) in found.corrections {
            corrections.note().into_iter().for_each(|note| ctx.warn(format!("topic {topic}: {note}")));
        }
        found.notes.into_iter().chain(found.spellings.notes).for_each(|note| ctx.warn(note));
        found.signs.into_iter().chain(found.spellings.signs).for_each(|(rule, sign)| ctx.sign(rule, sign));
        found.stamps.notes().map_err(NodeError::new)?.into_iter().for_each(|note| ctx.warn(note));
        found.frames.check_met("message").map(|()| events)
    }
}
