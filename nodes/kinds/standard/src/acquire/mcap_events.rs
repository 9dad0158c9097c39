//! The events of one declared port over a recording.

use super::{
    mcap::EventBody,
    playback::silences,
    sifted::{self, sifted},
    topic_port::{Findings, Item, TopicPort},
    topics::{Constants, TransformFilter, last_part},
};
use osteoflow_formats::{
    Sign, StampOrder,
    mcap_read::{Message, Recording},
    message_read::{procedure_region, read_transforms},
};
use osteoflow_geometry::{Nearest, Pose, StampNs, TransformTree};
use osteoflow_node::{Emission, NodeError};
use osteoflow_payloads::Flag;
use std::collections::{BTreeMap, BTreeSet};

/// One declared port over a recording.
pub(super) struct Port<'a> {
    pub(super) recording: &'a Recording,
    /// Its file name.
    pub(super) name: &'a str,
    pub(super) port: TopicPort,
    pub(super) found: &'a mut Findings,
}

impl Port<'_> {
    /// All events of the port, in no order.
    pub(super) fn events(&mut self) -> Result<Vec<(StampNs, EventBody)>, NodeError> {
        let start_ns = self.start_ns();
        let ready = |emission| Ok(vec![(start_ns, EventBody::Ready(emission))]);
        match self.port.declared.payload.name {
            "geometry/Region" => return ready(self.region()?),
            "report/Flag" => return ready(Emission::value(Flag(self.flag()))),
            "geometry/Pose" => {
                let before = self.found.clone();
                if let Some(events) = self.chained()? {
                    return Ok(events);
                }
                *self.found = before;
            }
            _ => {}
        }
        if let Some(topic) = &self.port.params.calibration.clone() {
            for (i, message) in self.recording.messages(topic).iter().enumerate() {
                self.port.calibrate(message, self.found).map_err(|error| self.at(topic, i, error))?;
            }
        }
        let mut events = Vec::new();
        let params = self.port.params.clone();
        for (topic, label) in params.topics() {
            if !self.recording.messages(topic).is_empty() {
                events.extend(self.stream(topic)?);
            } else if params.optional {
                let reason = format!("the recording {} has no messages on {topic}", self.name);
                events.push((start_ns, EventBody::Ready(Emission::Empty(reason))));
            } else {
                return Err(self.missing(topic, label));
            }
        }
        Ok(events)
    }

    /// The events of a topic.
    fn stream(&mut self, topic: &str) -> Result<Vec<(StampNs, EventBody)>, NodeError> {
        let (mut events, mut poses, mut tips) = (Vec::new(), Vec::new(), Vec::new());
        let (mut stamps, mut published_ns) = (Stamps::default(), StampNs::MIN);
        for (i, message) in self.recording.messages(topic).iter().enumerate() {
            if let Some(calibration) = self.port.lacks_calibration(message) {
                return Err(self.missing(calibration, None));
            }
            let items = self.port.take(topic, message, self.found).map_err(|error| self.at(topic, i, error))?;
            if !items.is_empty() {
                published_ns = published_ns.max(message.publish_time_ns);
            }
            for item in items {
                let of_pose = |to, from| format!("topic {topic}: t_{to}_{from}");
                let (what, stamp_ns) = match item {
                    Item::Constant(pose) => {
                        events.push((pose.stamp_ns, EventBody::Ready(Emission::value(pose))));
                        continue;
                    }
                    Item::NotRigid(error) => return Err(self.at(topic, i, error)),
                    Item::Pose(Nearest { value: pose, .. }) => {
                        let head = (of_pose(&pose.to, &pose.from), pose.stamp_ns);
                        poses.push(pose);
                        head
                    }
                    Item::Lost(lost) => {
                        events.push((lost.stamp_ns, EventBody::Ready(Emission::Empty(lost.to_string()))));
                        (of_pose(&lost.to, &lost.from), lost.stamp_ns)
                    }
                    Item::Scan(stamp_ns, scan) => {
                        events.push((stamp_ns, EventBody::Scan(scan)));
                        (format!("topic {topic}"), stamp_ns)
                    }
                    Item::Tip(_, tip) => {
                        let stamp_ns = tip.stamp_ns;
                        tips.push(tip);
                        (format!("topic {topic}"), stamp_ns)
                    }
                };
                stamps.add(message, i, what, stamp_ns);
            }
        }
        self.found.signs.extend(stamps.signs());
        // Labels are in the order in which the points were touched.
        tips.sort_by_key(|tip| tip.stamp_ns);
        for (i, tip) in tips.iter().enumerate() {
            let points = self.port.point(topic, i, tip, self.found);
            events.push((tip.stamp_ns, EventBody::Ready(Emission::value(points))));
        }
        events.extend(self.unless_frozen(topic, poses));
        if events.is_empty() {
            return Err(self.no_such_transform(topic));
        }
        if !Constants::are_on(topic) {
            events.extend(self.silent(topic, &events, published_ns));
        }
        Ok(events)
    }

    /// The poses of a topic in the order of their stamps, equal ones of one stamp once, with empties in place of those of a frozen
    /// tracker.
    fn unless_frozen(&mut self, topic: &str, poses: Vec<Pose>) -> Vec<(StampNs, EventBody)> {
        let (poses, signs) = sifted(poses, &self.port.params.stream);
        self.found.signs.extend(signs.into_iter().map(|(rule, sign)| (rule, format!("topic {topic}: {sign}"))));
        let event = |pose| {
            let (stamp_ns, emission) = sifted::emission(pose);
            (stamp_ns, EventBody::Ready(emission))
        };
        poses.into_iter().map(event).collect()
    }

    /// The poses of a port that names two frames which no transform of its topics joins, as a product of several, or as an inverse;
    /// none if one transform joins them, or nothing does. With `/tf` belongs `/tf_static`.
    fn chained(&mut self) -> Result<Option<Vec<(StampNs, EventBody)>>, NodeError> {
        let mut port = TopicPort::new(&self.port.declared).map_err(|error| NodeError::new(error.message))?;
        let params = port.params.clone();
        let topics = params.read_topics();
        let (mut tree, mut moving, mut statics) = (TransformTree::default(), Vec::new(), Vec::new());
        let (mut frames, mut last_ns) = (None, StampNs::MIN);
        for topic in &topics {
            for (i, message) in self.recording.messages(topic).iter().enumerate() {
                frames = port.joins(message);
                let items = match port.transforms(topic, message, &TransformFilter::default(), self.found) {
                    _ if frames.is_none() => return Ok(None),
                    Err(_) if params.names(topic) => return Ok(None),
                    items => items.map_err(|error| self.at(topic, i, error))?,
                };
                for mut item in items {
                    let is_direct = item.frames_mut().is_some_and(|[to, from]| params.transforms.wants(to, from));
                    if is_direct && params.names(topic) {
                        return Ok(None);
                    }
                    match item {
                        Item::Constant(pose) => statics.push(pose),
                        Item::Pose(Nearest { value: pose, .. }) => {
                            last_ns = last_ns.max(message.publish_time_ns);
                            moving.push(pose);
                        }
                        Item::Lost(lost) => {
                            tree.add(&lost.to, &lost.from, lost.stamp_ns, Err(format!("has {}", lost.reason)));
                        }
                        Item::NotRigid(error) => return Err(self.at(topic, i, error)),
                        Item::Scan(..) | Item::Tip(..) => {}
                    }
                }
            }
        }
        let Some((parent, child)) = frames else { return Ok(None) };
        let (poses, signs) = sifted(moving, &params.stream);
        poses.iter().for_each(|pose| sifted::add(&mut tree, pose));
        self.found.signs.extend(statics.iter().filter_map(|pose| sifted::add_static(&mut tree, pose)));
        let read = sifted::through(&tree, (&parent, &child), params.stream.max_gap_ms);
        let Some((mut poses, chain)) = read.map_err(|message| self.fault(message))? else { return Ok(None) };
        let name = topics.join(" and ");
        self.found.signs.extend(signs.into_iter().map(|(rule, sign)| (rule, format!("topic {name}: {sign}"))));
        self.found.notes.push(format!("port \"{}\": {name}: {}", port.declared.name, chain.note));
        for (pose, _) in &mut poses {
            self.found.rename([&mut pose.to, &mut pose.from]);
        }
        let mut events: Vec<_> =
            poses.into_iter().map(sifted::emission).map(|(stamp, of)| (stamp, EventBody::Ready(of))).collect();
        events.extend(self.silent(&child, &events, last_ns));
        Ok(Some(events))
    }

    /// Empties for the time in which a marker is silent; `published_ns` is when its last message was published.
    fn silent(&self, what: &str, events: &[(StampNs, EventBody)], published_ns: StampNs) -> Vec<(StampNs, EventBody)> {
        let Some(lost_after_ms) = self.port.params.stream.lost_after_ms else { return Vec::new() };
        let stamps: Vec<StampNs> = events.iter().map(|(stamp, _)| *stamp).collect();
        // Stamps and publish times may be of two clocks, so the silence at the end is measured by one.
        let ended_ns = self.recording.last_publish_time_ns.unwrap_or(published_ns);
        let last_ns = stamps.iter().copied().max().unwrap_or(published_ns);
        let end_ns = last_ns.saturating_add(ended_ns.saturating_sub(published_ns));
        let what = format!("the {}", last_part(what).replace('_', " "));
        let lost = silences(&stamps, (lost_after_ms * 1e6) as StampNs, end_ns, &what);
        lost.into_iter().map(|(stamp, empty)| (stamp, EventBody::Ready(empty))).collect()
    }

    fn region(&self) -> Result<Emission, NodeError> {
        Ok(match procedure_region(self.recording)? {
            Some(region) => Emission::value(region),
            None => Emission::Empty("the recording gives no region of interest".into()),
        })
    }

    fn flag(&self) -> bool {
        let params = &self.port.params;
        let record = params.metadata.as_ref().and_then(|name| self.recording.metadata.get(name));
        params.flag(|topic| !self.recording.messages(topic).is_empty(), record)
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
        let (parent, child) =
            (self.port.params.transforms.parent.as_deref(), self.port.params.transforms.child.as_deref());
        let wanted = format!("{} -> {}", child.unwrap_or("any"), parent.unwrap_or("any"));
        let there: Vec<String> = there.into_iter().collect();
        self.fault(format!("{topic} has no transform {wanted}, but {}; set child and parent", there.join(", ")))
    }

    fn missing(&self, topic: &str, label: Option<&str>) -> NodeError {
        let what = label.map_or_else(String::new, |label| format!(" ({label})"));
        let topics = self.recording.topics().iter().filter(|t| t.n_messages > 0);
        let there: Vec<String> = topics.map(|t| format!("{} ({})", t.name, t.schema_name)).collect();
        self.fault(format!(
            "the recording {} has no messages on {topic}{what}; it has: {}",
            self.name,
            if there.is_empty() { "none at all".into() } else { there.join(", ") }
        ))
    }

    fn at(&self, topic: &str, index: usize, error: impl std::fmt::Display) -> NodeError {
        self.fault(format!("topic {topic}, {}: {error}", self.message(topic, index)))
    }

    fn message(&self, topic: &str, index: usize) -> String {
        format!("message {} of {}", index + 1, self.recording.messages(topic).len())
    }

    fn fault(&self, message: String) -> NodeError {
        NodeError::new(format!("port \"{}\": {message}", self.port.declared.name))
    }
}

/// The stamps of a topic's messages, by what they belong to.
#[derive(Default)]
struct Stamps(Vec<(StampNs, usize, String, StampNs)>);

impl Stamps {
    fn add(&mut self, message: &Message, index: usize, what: String, stamp_ns: StampNs) {
        self.0.push((message.log_time_ns, index, what, stamp_ns));
    }

    /// Stamps that run backwards in the order in which the messages were recorded, which is that of log times: a file may hold them in
    /// another.
    fn signs(mut self) -> Vec<Sign> {
        self.0.sort_by_key(|(log_time_ns, index, ..)| (*log_time_ns, *index));
        let mut orders: BTreeMap<&str, StampOrder> = BTreeMap::new();
        for (_, index, what, stamp_ns) in &self.0 {
            orders.entry(what).or_default().take(*stamp_ns, || format!("message {}", index + 1));
        }
        orders.iter().filter_map(|(what, order)| Some(("stamp_order", order.note(what)?))).collect()
    }
}
