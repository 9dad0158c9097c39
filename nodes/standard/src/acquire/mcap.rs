//! The kind `acquire.mcap`.

use super::{
    mcap_ports::PortParams,
    playback::{Event, Playback, silences},
};
use osteoflow_formats::{
    PoseError,
    foxglove_read::{
        FoxgloveError, POSE_IN_FRAME, procedure_region, read_cloud, read_cloud_head, read_pose_in_frame,
        read_transforms,
    },
    mcap_read::{Message, Recording},
};
use osteoflow_geometry::{Corrections, Frame, NamedPoint, Nearest, Points, Pose, StampNs};
use osteoflow_node::{
    Context, Declared, DeclaredPort, Describe, Emission, FilePath, NodeError, ParamError, Source, schemars::JsonSchema,
    serde::Deserialize,
};
use osteoflow_payloads::Flag;
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

/// The streams of a recording in MCAP with Foxglove's schemas, in the order of sensor time.
///
/// Each entry of `out` is a port with a `type` and a topic. Protobuf and JSON, any chunk compression, with or without an
/// index. Metres become millimetres; points that are not finite are left out, counted and reported. A pose that the tracker
/// wrote without seeing the marker is an empty with the reason. A rounded rotation is replaced by the nearest one, and each
/// topic reports its largest correction; a deviation above 0.001 is an error that names topic and message. Topics that no
/// port reads are listed in the log.
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
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct Params {
    /// The recording.
    pub path: FilePath,
    /// Whether the intact part of a damaged recording is used, with a warning. false: a damaged recording is an error.
    #[serde(default)]
    pub allow_truncated: bool,
}

/// The body of an event. Clouds are decoded when they are due.
pub(super) enum EventBody {
    Cloud { message: Message, label: Option<Arc<str>> },
    Ready(Emission),
}

impl Source for Mcap {
    const KIND: &'static str = "acquire.mcap";
    type Params = Params;
    type Outputs = Declared<PortParams>;

    fn new(params: Params) -> Result<Self, ParamError> {
        Ok(Self { params, playback: None })
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<Self::Outputs>, NodeError> {
        if self.playback.is_none() {
            self.playback = Some(self.playback(ctx)?);
        }
        let Some(event) = self.playback.as_mut().and_then(Iterator::next) else { return Ok(None) };
        ctx.set_stamp_ns(event.stamp_ns);
        Ok(Some(Declared::one(event.port, Self::emission(event, ctx)?)))
    }
}

impl Mcap {
    /// The streams of the recording at `path`.
    pub(super) fn of(path: FilePath, allow_truncated: bool) -> Self {
        Self { params: Params { path, allow_truncated }, playback: None }
    }

    /// All events in the order of their stamps.
    pub(super) fn playback(&self, ctx: &mut Context) -> Result<Playback<EventBody>, NodeError> {
        Ok(Playback::new(self.open(ctx)?))
    }

    /// The emission of an event.
    pub(super) fn emission(event: Event<EventBody>, ctx: &mut Context) -> Result<Emission, NodeError> {
        match event.body {
            EventBody::Ready(emission) => Ok(emission),
            EventBody::Cloud { message, label } => cloud(&message, label, &ctx.declared()[event.port].name, ctx),
        }
    }

    fn open(&self, ctx: &mut Context) -> Result<Vec<Event<EventBody>>, NodeError> {
        let ports = ctx.declared();
        let params = ports.iter().map(DeclaredPort::params).collect::<Result<Vec<PortParams>, _>>()?;
        let wanted = |topic: &str| {
            params.iter().any(|p| p.topics().iter().any(|(t, _)| *t == topic) || p.present.as_deref() == Some(topic))
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
        let (mut events, mut corrections) = (Vec::new(), BTreeMap::new());
        for (port, (declared, params)) in ports.iter().zip(&params).enumerate() {
            let mut stream = Port { recording: &recording, declared, params, corrections: &mut corrections };
            events.extend(stream.events()?.into_iter().map(|(stamp_ns, body)| Event { stamp_ns, port, body }));
        }
        for (topic, corrections) in corrections {
            corrections.note().into_iter().for_each(|note| ctx.warn(format!("topic {topic}: {note}")));
        }
        Ok(events)
    }
}

/// One declared port over a recording.
struct Port<'a> {
    recording: &'a Recording,
    declared: &'a DeclaredPort,
    params: &'a PortParams,
    /// The corrections of rotations by topic, of all ports.
    corrections: &'a mut BTreeMap<String, Corrections>,
}

impl Port<'_> {
    fn events(&mut self) -> Result<Vec<(StampNs, EventBody)>, NodeError> {
        let start_ns = self.start_ns();
        match self.declared.payload.name {
            "geometry/Region" => Ok(vec![(start_ns, EventBody::Ready(self.region()?))]),
            "report/Flag" => Ok(vec![(start_ns, EventBody::Ready(Emission::value(Flag(self.flag()))))]),
            "geometry/Cloud" => self.streams(start_ns, Self::clouds),
            "geometry/Pose" => self.streams(start_ns, Self::poses),
            "geometry/Points" => self.streams(start_ns, Self::points),
            other => Err(self.fault(format!(
                "a recording gives geometry/Cloud, Pose, Points, Region and report/Flag, but not {other}"
            ))),
        }
    }

    /// The events of all topics of the port; one empty for an optional topic without messages.
    fn streams(
        &mut self,
        start_ns: StampNs,
        read: impl Fn(&mut Self, &str, Option<&str>) -> Result<Vec<(StampNs, EventBody)>, NodeError>,
    ) -> Result<Vec<(StampNs, EventBody)>, NodeError> {
        let params = self.params;
        let topics = params.topics();
        if topics.is_empty() {
            return Err(self.fault("neither topic nor topics is given".into()));
        }
        let mut events = Vec::new();
        for (topic, label) in topics {
            if !self.recording.messages(topic).is_empty() {
                events.extend(read(self, topic, label)?);
            } else if params.optional {
                let reason = format!("the recording has no messages on {topic}");
                events.push((start_ns, EventBody::Ready(Emission::Empty(reason))));
            } else {
                return Err(self.missing(topic, label));
            }
        }
        Ok(events)
    }

    fn clouds(&mut self, topic: &str, label: Option<&str>) -> Result<Vec<(StampNs, EventBody)>, NodeError> {
        let mut events = Vec::new();
        for (i, message) in self.recording.messages(topic).iter().enumerate() {
            let head = read_cloud_head(message).map_err(|error| self.at(topic, i, error))?;
            self.corrections.entry(topic.into()).or_default().add(head.correction);
            let label = label.or_else(|| self.params.labels.get(i).map(String::as_str)).unwrap_or(last_part(topic));
            events.push((head.stamp_ns, EventBody::Cloud { message: message.clone(), label: Some(label.into()) }));
        }
        Ok(events)
    }

    fn poses(&mut self, topic: &str, _label: Option<&str>) -> Result<Vec<(StampNs, EventBody)>, NodeError> {
        let (mut events, mut published_ns) = (Vec::new(), StampNs::MIN);
        for (i, message) in self.recording.messages(topic).iter().enumerate() {
            let n_before = events.len();
            for read in self.poses_of(topic, message).map_err(|error| self.at(topic, i, error))? {
                events.push(match read {
                    Ok(pose) => {
                        let pose = self.corrections.entry(topic.into()).or_default().take(pose);
                        (pose.stamp_ns, EventBody::Ready(Emission::value(pose)))
                    }
                    Err(PoseError::Lost(lost)) => (lost.stamp_ns, EventBody::Ready(Emission::Empty(lost.to_string()))),
                    Err(error @ PoseError::NotRigid { .. }) => return Err(self.at(topic, i, error)),
                });
            }
            if events.len() > n_before {
                published_ns = published_ns.max(message.publish_time_ns);
            }
        }
        if events.is_empty() {
            return Err(self.no_such_transform(topic));
        }
        if let Some(lost_after_ms) = self.params.lost_after_ms {
            let stamps: Vec<StampNs> = events.iter().map(|(stamp, _)| *stamp).collect();
            // Stamps and publish times may be of two clocks, so the silence at the end is measured by one.
            let ended_ns = self.recording.last_publish_time_ns.unwrap_or(published_ns);
            let last_ns = stamps.iter().copied().max().unwrap_or(published_ns);
            let end_ns = last_ns.saturating_add(ended_ns.saturating_sub(published_ns));
            let what = last_part(topic).replace('_', " ");
            let lost = silences(&stamps, (lost_after_ms * 1e6) as StampNs, end_ns, &format!("the {what}"));
            events.extend(lost.into_iter().map(|(stamp, empty)| (stamp, EventBody::Ready(empty))));
        }
        Ok(events)
    }

    /// The poses of a message between the frames of the port.
    fn poses_of(&self, topic: &str, message: &Message) -> Result<Vec<Result<Nearest<Pose>, PoseError>>, FoxgloveError> {
        if &*message.schema_name == POSE_IN_FRAME {
            let child = self.params.child.as_deref().unwrap_or(last_part(topic));
            return Ok(vec![read_pose_in_frame(message)?.pose(child)]);
        }
        let wanted = |to: &Frame, from: &Frame| {
            self.params.parent.as_deref().is_none_or(|p| p == to.as_str())
                && self.params.child.as_deref().is_none_or(|c| c == from.as_str())
        };
        let reads = read_transforms(message)?.into_iter().filter(|read| match read {
            Ok(pose) => wanted(&pose.value.to, &pose.value.from),
            Err(PoseError::Lost(lost)) => wanted(&lost.to, &lost.from),
            Err(PoseError::NotRigid { to, from, .. }) => wanted(to, from),
        });
        Ok(reads.collect())
    }

    fn points(&mut self, topic: &str, label: Option<&str>) -> Result<Vec<(StampNs, EventBody)>, NodeError> {
        let mut tips = Vec::new();
        for (i, message) in self.recording.messages(topic).iter().enumerate() {
            tips.push(read_pose_in_frame(message).map_err(|error| self.at(topic, i, error))?);
        }
        // Labels are in the order in which the points were touched.
        tips.sort_by_key(|tip| tip.stamp_ns);
        let events = tips.into_iter().enumerate().map(|(i, tip)| {
            let name = match label.or_else(|| self.params.labels.get(i).map(String::as_str)) {
                Some(label) => label.to_owned(),
                None => format!("{}_{}", last_part(topic), i + 1),
            };
            let mut point = NamedPoint::new(name, tip.position);
            point.stamp_ns = tip.stamp_ns;
            (tip.stamp_ns, EventBody::Ready(Emission::value(Points::new(tip.frame, vec![point]))))
        });
        Ok(events.collect())
    }

    fn region(&self) -> Result<Emission, NodeError> {
        Ok(match procedure_region(self.recording)? {
            Some(region) => Emission::value(region),
            None => Emission::Empty("the recording gives no region of interest".into()),
        })
    }

    fn flag(&self) -> bool {
        if let Some(topic) = &self.params.present {
            return !self.recording.messages(topic).is_empty();
        }
        let record = self.params.metadata.as_ref().and_then(|name| self.recording.metadata.get(name));
        let value = self.params.key.as_ref().and_then(|key| record?.get(key));
        value.is_some_and(|value| value == "true")
    }

    /// First publish time of the messages that were read.
    fn start_ns(&self) -> StampNs {
        let times = self.recording.topics().iter().flat_map(|t| self.recording.messages(&t.name));
        times.map(|m| m.publish_time_ns).min().unwrap_or(0)
    }

    /// The error for a topic without a transform between the frames of the port.
    fn no_such_transform(&self, topic: &str) -> NodeError {
        let read = self.recording.messages(topic).iter().filter_map(|message| read_transforms(message).ok()).flatten();
        let there: BTreeSet<String> =
            read.filter_map(Result::ok).map(|t| format!("{} -> {}", t.value.from, t.value.to)).collect();
        let (parent, child) = (self.params.parent.as_deref(), self.params.child.as_deref());
        let wanted = format!("{} -> {}", child.unwrap_or("any"), parent.unwrap_or("any"));
        let there: Vec<String> = there.into_iter().collect();
        self.fault(format!("{topic} has no transform {wanted}, but {}; set child and parent", there.join(", ")))
    }

    fn missing(&self, topic: &str, label: Option<&str>) -> NodeError {
        let what = label.map_or_else(String::new, |label| format!(" ({label})"));
        let topics = self.recording.topics().iter().filter(|t| t.n_messages > 0);
        let there: Vec<String> = topics.map(|t| format!("{} ({})", t.name, t.schema_name)).collect();
        self.fault(format!(
            "the recording has no messages on {topic}{what}; it has: {}",
            if there.is_empty() { "none at all".into() } else { there.join(", ") }
        ))
    }

    fn at(&self, topic: &str, index: usize, error: impl std::fmt::Display) -> NodeError {
        let n_messages = self.recording.messages(topic).len();
        self.fault(format!("topic {topic}, message {} of {n_messages}: {error}", index + 1))
    }

    fn fault(&self, message: String) -> NodeError {
        NodeError::new(format!("port \"{}\": {message}", self.declared.name))
    }
}

fn cloud(message: &Message, label: Option<Arc<str>>, port: &str, ctx: &mut Context) -> Result<Emission, NodeError> {
    let read = read_cloud(message).map_err(|error| NodeError::new(format!("port \"{port}\": {error}")))?;
    let name = label.as_deref().unwrap_or(port);
    if read.n_dropped > 0 {
        let (dropped, all) = (read.n_dropped, read.n_points_in_message);
        ctx.warn(format!("{name}: {dropped} of {all} points are NaN or infinite and were left out"));
    }
    read.notes.iter().for_each(|note| ctx.warn(format!("{name}: {note}")));
    let mut cloud = read.cloud;
    cloud.label = label;
    Ok(Emission::value(cloud))
}

/// `camera_marker` of `/tracker/camera_marker`.
fn last_part(topic: &str) -> &str {
    topic.rsplit('/').next().unwrap_or(topic)
}
