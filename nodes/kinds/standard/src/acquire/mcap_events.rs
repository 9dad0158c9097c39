//! The events of one declared port over a recording.

use super::{
    mcap::EventBody,
    mcap_ports::PortParams,
    playback::silences,
    sifted::{self, sifted},
    topics::{self, Constants, FrameNames, TransformFilter, last_part, named_transforms},
    unstamped::{MissingStamps, without_publish_time},
};
use osteoflow_formats::{
    PoseError, Sign, Spellings, StampOrder,
    mcap_read::{Message, Recording},
    message_read::{
        Calibration, MessageError, is_image, procedure_region, read_calibration, read_cloud_head, read_image_head,
        read_pose_in_frame, read_transforms,
    },
    without_slash,
};
use osteoflow_geometry::{Corrections, Frame, Pose, StampNs, TransformTree};
use osteoflow_node::{DeclaredPort, Emission, NodeError};
use osteoflow_payloads::Flag;
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

/// One declared port over a recording.
pub(super) struct Port<'a> {
    pub(super) recording: &'a Recording,
    /// Its file name.
    pub(super) name: &'a str,
    pub(super) declared: &'a DeclaredPort,
    pub(super) params: &'a PortParams,
    pub(super) found: &'a mut Findings,
}

/// What all ports of a recording met.
#[derive(Default)]
pub(super) struct Findings {
    /// The corrections of rotations by topic.
    pub(super) corrections: BTreeMap<String, Corrections>,
    pub(super) frames: FrameNames,
    /// What the user should know.
    pub(super) notes: Vec<String>,
    /// Signs that the recording is wrong.
    pub(super) signs: Vec<Sign>,
    /// The names of its frames.
    pub(super) spellings: Spellings,
    /// Messages without a stamp.
    pub(super) stamps: MissingStamps,
}

impl Port<'_> {
    /// All events of the port, in no order.
    pub(super) fn events(&mut self) -> Result<Vec<(StampNs, EventBody)>, NodeError> {
        let start_ns = self.start_ns();
        match self.declared.payload.name {
            "geometry/Region" => Ok(vec![(start_ns, EventBody::Ready(self.region()?))]),
            "report/Flag" => Ok(vec![(start_ns, EventBody::Ready(Emission::value(Flag(self.flag()))))]),
            "geometry/Cloud" => self.streams(start_ns, Self::clouds),
            "geometry/Image" => {
                let calibration = self.calibration()?;
                self.streams(start_ns, move |port, topic, label| {
                    port.images(topic, label, &calibration, |message, calibration, label, frame| EventBody::Image {
                        message,
                        calibration,
                        label,
                        frame,
                    })
                })
            }
            "geometry/Pose" => match self.chained()? {
                Some(events) => Ok(events),
                None => self.streams(start_ns, Self::poses),
            },
            _ => self.streams(start_ns, Self::points),
        }
    }

    /// The events of all topics of the port; one empty for an optional topic without messages.
    fn streams(
        &mut self,
        start_ns: StampNs,
        read: impl Fn(&mut Self, &str, Option<&str>) -> Result<Vec<(StampNs, EventBody)>, NodeError>,
    ) -> Result<Vec<(StampNs, EventBody)>, NodeError> {
        let params = self.params;
        let mut events = Vec::new();
        for (topic, label) in params.topics() {
            if !self.recording.messages(topic).is_empty() {
                events.extend(read(self, topic, label)?);
            } else if params.optional {
                let reason = format!("the recording {} has no messages on {topic}", self.name);
                events.push((start_ns, EventBody::Ready(Emission::Empty(reason))));
            } else {
                return Err(self.missing(topic, label));
            }
        }
        Ok(events)
    }

    fn clouds(&mut self, topic: &str, label: Option<&str>) -> Result<Vec<(StampNs, EventBody)>, NodeError> {
        if self.recording.messages(topic).first().is_some_and(|message| is_image(&message.schema_name)) {
            let (calibration, unit_mm) = (self.calibration()?, self.params.depth_unit_mm);
            return self.images(topic, label, &calibration, |message, calibration, label, frame| EventBody::Depth {
                message,
                camera: (calibration, unit_mm),
                label,
                frame,
            });
        }
        let head = |port: &mut Self, message: &Message| {
            let head = read_cloud_head(without_publish_time(message))?;
            port.found.corrections.entry(topic.into()).or_default().add(head.correction);
            Ok((head.frame, head.stamp_ns))
        };
        self.scans(topic, label, head, |message, label, frame| EventBody::Cloud { message, label, frame })
    }

    /// The events of messages that are decoded when they are due; `head` reads frame and stamp.
    fn scans(
        &mut self,
        topic: &str,
        label: Option<&str>,
        head: impl Fn(&mut Self, &Message) -> Result<(Frame, StampNs), MessageError>,
        body: impl Fn(Message, Arc<str>, Option<Frame>) -> EventBody,
    ) -> Result<Vec<(StampNs, EventBody)>, NodeError> {
        let (mut events, mut stamps) = (Vec::new(), Stamps::default());
        for (i, message) in self.recording.messages(topic).iter().enumerate() {
            let (frame, stamp_ns) = head(self, message).map_err(|error| self.at(topic, i, error))?;
            let stamp_ns = self.stamp(topic, message, stamp_ns);
            stamps.add(message, i, format!("topic {topic}"), stamp_ns);
            let label = label.or_else(|| self.params.labels.get(i).map(String::as_str)).unwrap_or(last_part(topic));
            events.push((stamp_ns, body(message.clone(), label.into(), self.renamed(&frame))));
        }
        self.found.signs.extend(stamps.signs());
        Ok(events)
    }

    /// The stamp of a message, as read from [`without_publish_time`].
    fn stamp(&mut self, topic: &str, message: &Message, read_ns: StampNs) -> StampNs {
        let port = (self.declared.name.as_str(), topic);
        self.found.stamps.stamp(port, message, read_ns, self.params.unstamped)
    }

    /// The calibration of the images' camera; of a recording without images it is not needed.
    fn calibration(&mut self) -> Result<Option<Arc<Calibration>>, NodeError> {
        let topic = self.params.calibration(self.declared).map_err(|error| self.fault(error.message))?;
        let rectified = self.params.rectified.unwrap_or(false);
        let mut found: Option<Calibration> = None;
        for (i, message) in self.recording.messages(topic).iter().enumerate() {
            let read = read_calibration(message, rectified).map_err(|error| self.at(topic, i, error))?;
            match &found {
                Some(first) if *first != read => {
                    return Err(self.at(topic, i, "it differs from the first one, but a port has one camera"));
                }
                _ => found = Some(read),
            }
        }
        self.found.notes.extend(found.as_ref().and_then(Calibration::note));
        Ok(found.map(Arc::new))
    }

    fn images(
        &mut self,
        topic: &str,
        label: Option<&str>,
        calibration: &Option<Arc<Calibration>>,
        body: impl Fn(Message, Arc<Calibration>, Arc<str>, Option<Frame>) -> EventBody,
    ) -> Result<Vec<(StampNs, EventBody)>, NodeError> {
        let Some(calibration) = calibration else {
            return Err(self.missing(self.params.calibration.as_deref().unwrap_or_default(), None));
        };
        let distortion = calibration.intrinsics.distortion;
        if let (Some(name), None, true) = (distortion.name(), self.params.rectified, last_part(topic).contains("rect"))
        {
            return Err(self.fault(format!(
                "topic {topic} is rectified by its name, and its calibration has a distortion ({name}), which would be undone twice; set \
                 rectified = true if its images are rectified, false if they are not"
            )));
        }
        let head = |_: &mut Self, message: &Message| read_image_head(without_publish_time(message));
        self.scans(topic, label, head, |message, label, frame| body(message, calibration.clone(), label, frame))
    }

    /// The name of a frame in the graph, if it is another.
    fn renamed(&mut self, frame: &Frame) -> Option<Frame> {
        let plain = self.found.spellings.take(frame);
        self.found.frames.of(&plain).or_else(|| (plain != *frame).then_some(plain))
    }

    fn rename(&mut self, to: &mut Frame, from: &mut Frame) {
        for frame in [to, from] {
            if let Some(renamed) = self.renamed(frame) {
                *frame = renamed;
            }
        }
    }

    fn poses(&mut self, topic: &str, _label: Option<&str>) -> Result<Vec<(StampNs, EventBody)>, NodeError> {
        if Constants::are_on(topic) {
            return self.static_poses(topic);
        }
        let (mut events, mut published_ns) = (Vec::new(), StampNs::MIN);
        let mut stamps = Stamps::default();
        let mut poses = Vec::new();
        for (i, message) in self.recording.messages(topic).iter().enumerate() {
            let n_before = events.len() + poses.len();
            let (message_read, spellings) = (without_publish_time(message), &mut self.found.spellings);
            let read = self.params.transforms.poses(topic, message_read, spellings);
            for read in read.map_err(|error| self.at(topic, i, error))? {
                let (to, from, stamp_ns) = match read {
                    Ok(pose) => {
                        let mut pose = self.found.corrections.entry(topic.into()).or_default().take(pose);
                        self.rename(&mut pose.to, &mut pose.from);
                        pose.stamp_ns = self.stamp(topic, message, pose.stamp_ns);
                        self.found.stamps.track(topic, &pose);
                        let head = (pose.to.clone(), pose.from.clone(), pose.stamp_ns);
                        poses.push(pose);
                        head
                    }
                    Err(PoseError::Lost(mut lost)) => {
                        self.rename(&mut lost.to, &mut lost.from);
                        lost.stamp_ns = self.stamp(topic, message, lost.stamp_ns);
                        events.push((lost.stamp_ns, EventBody::Ready(Emission::Empty(lost.to_string()))));
                        (lost.to, lost.from, lost.stamp_ns)
                    }
                    Err(error @ PoseError::NotRigid { .. }) => return Err(self.at(topic, i, error)),
                };
                stamps.add(message, i, format!("topic {topic}: t_{to}_{from}"), stamp_ns);
            }
            if events.len() + poses.len() > n_before {
                published_ns = published_ns.max(message.publish_time_ns);
            }
        }
        self.found.signs.extend(stamps.signs());
        events.extend(self.unless_frozen(topic, poses));
        if events.is_empty() {
            return Err(self.no_such_transform(topic));
        }
        let silent = self.silent(topic, &events, published_ns);
        events.extend(silent);
        Ok(events)
    }

    /// The poses of a topic in the order of their stamps, equal ones of one stamp once, with empties in place of those of a frozen
    /// tracker.
    fn unless_frozen(&mut self, topic: &str, poses: Vec<Pose>) -> Vec<(StampNs, EventBody)> {
        let (poses, signs) = sifted(poses, &self.params.stream);
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
        let params = self.params;
        let (Some(parent), Some(child)) = (&params.transforms.parent, &params.transforms.child) else {
            return Ok(None);
        };
        let (parent, child) = (without_slash(parent), without_slash(child));
        let topics: Vec<String> = params.read_topics();
        let (mut tree, mut moving, mut statics, mut last_ns) =
            (TransformTree::default(), Vec::new(), Vec::new(), StampNs::MIN);
        let is_named = |topic: &String| params.topics().iter().any(|(named, _)| named == topic);
        for topic in &topics {
            if Constants::are_on(topic) {
                statics.extend(self.statics(topic, &TransformFilter::default())?);
                continue;
            }
            for (i, message) in self.recording.messages(topic).iter().enumerate() {
                let unstamped = without_publish_time(message);
                let Ok(read) = named_transforms(unstamped, &mut self.found.spellings) else { return Ok(None) };
                for mut read in read {
                    let [to, from] = topics::frames_mut(&mut read);
                    if is_named(topic) && params.transforms.wants(to, from) {
                        return Ok(None);
                    }
                    match read {
                        Ok(pose) => {
                            let mut pose = self.found.corrections.entry(topic.clone()).or_default().take(pose);
                            pose.stamp_ns = self.stamp(topic, message, pose.stamp_ns);
                            last_ns = last_ns.max(message.publish_time_ns);
                            self.found.stamps.track(topic, &pose);
                            moving.push(pose);
                        }
                        Err(PoseError::Lost(mut lost)) => {
                            lost.stamp_ns = self.stamp(topic, message, lost.stamp_ns);
                            tree.add(&lost.to, &lost.from, lost.stamp_ns, Err(format!("has {}", lost.reason)));
                        }
                        Err(error @ PoseError::NotRigid { .. }) => return Err(self.at(topic, i, error)),
                    }
                }
            }
        }
        let is_direct = |pose: &Pose| params.transforms.wants(&pose.to, &pose.from);
        if topics.iter().any(|topic| is_named(topic) && Constants::are_on(topic)) && statics.iter().any(is_direct) {
            return Ok(None);
        }
        let (poses, signs) = sifted(moving, &params.stream);
        for (pose, reason) in poses {
            let motion = reason.map_or_else(|| Ok(pose.isometry), |reason| Err(format!("has no new pose: {reason}")));
            tree.add(&pose.to, &pose.from, pose.stamp_ns, motion);
        }
        for Pose { to, from, stamp_ns, isometry, .. } in &statics {
            if !tree.add_static(to, from, *stamp_ns, *isometry) {
                let message = format!(
                    "t_{to}_{from} is static on one topic and moves on another, whose poses are used; remove one"
                );
                self.found.signs.push(("static_moves", message));
            }
        }
        let read =
            sifted::through(&tree, (parent, child), params.stream.max_gap_ms).map_err(|message| self.fault(message))?;
        let Some((mut poses, note)) = read else { return Ok(None) };
        let name = topics.join(" and ");
        self.found.signs.extend(signs.into_iter().map(|(rule, sign)| (rule, format!("topic {name}: {sign}"))));
        self.found.notes.push(format!("port \"{}\": {name}: {note}", self.declared.name));
        for (pose, _) in &mut poses {
            self.rename(&mut pose.to, &mut pose.from);
        }
        let mut events: Vec<_> =
            poses.into_iter().map(sifted::emission).map(|(stamp, of)| (stamp, EventBody::Ready(of))).collect();
        events.extend(self.silent(child, &events, last_ns));
        Ok(Some(events))
    }

    /// Empties for the time in which a marker is silent; `published_ns` is when its last message was published.
    fn silent(&self, what: &str, events: &[(StampNs, EventBody)], published_ns: StampNs) -> Vec<(StampNs, EventBody)> {
        let Some(lost_after_ms) = self.params.stream.lost_after_ms else { return Vec::new() };
        let stamps: Vec<StampNs> = events.iter().map(|(stamp, _)| *stamp).collect();
        // Stamps and publish times may be of two clocks, so the silence at the end is measured by one.
        let ended_ns = self.recording.last_publish_time_ns.unwrap_or(published_ns);
        let last_ns = stamps.iter().copied().max().unwrap_or(published_ns);
        let end_ns = last_ns.saturating_add(ended_ns.saturating_sub(published_ns));
        let what = format!("the {}", last_part(what).replace('_', " "));
        let lost = silences(&stamps, (lost_after_ms * 1e6) as StampNs, end_ns, &what);
        lost.into_iter().map(|(stamp, empty)| (stamp, EventBody::Ready(empty))).collect()
    }

    /// The transforms that hold from the beginning, whenever they were sent: constants, without a stamp. One that is sent
    /// again with another value holds from its own stamp on.
    fn static_poses(&mut self, topic: &str) -> Result<Vec<(StampNs, EventBody)>, NodeError> {
        if self.params.stream.lost_after_ms.is_some() {
            return Err(self.fault(format!("{topic} holds for good, so nothing on it is lost; remove lost_after_ms")));
        }
        let mut events = Vec::new();
        for mut pose in self.statics(topic, &self.params.transforms)? {
            self.rename(&mut pose.to, &mut pose.from);
            events.push((pose.stamp_ns, EventBody::Ready(Emission::value(pose))));
        }
        if events.is_empty() {
            return Err(self.no_such_transform(topic));
        }
        Ok(events)
    }

    /// The static transforms of a topic, which need no stamps.
    fn statics(&mut self, topic: &str, filter: &TransformFilter) -> Result<Vec<Pose>, NodeError> {
        let (mut poses, mut constants, mut signs) = (Vec::new(), Constants::default(), Vec::new());
        for (i, message) in self.recording.messages(topic).iter().enumerate() {
            let read = filter.poses(topic, message, &mut self.found.spellings);
            for read in read.map_err(|error| self.at(topic, i, error))? {
                let pose = read.map_err(|error| self.at(topic, i, error))?;
                let pose = self.found.corrections.entry(topic.into()).or_default().take(pose);
                let tell = |sign| signs.push(("static_changes", format!("topic {topic}: {sign}")));
                poses.extend(constants.take(pose, tell));
            }
        }
        self.found.signs.extend(signs);
        Ok(poses)
    }

    fn points(&mut self, topic: &str, label: Option<&str>) -> Result<Vec<(StampNs, EventBody)>, NodeError> {
        let (mut tips, mut stamps) = (Vec::new(), Stamps::default());
        for (i, message) in self.recording.messages(topic).iter().enumerate() {
            let read = read_pose_in_frame(without_publish_time(message));
            let mut tip = read.map_err(|error| self.at(topic, i, error))?;
            tip.stamp_ns = self.stamp(topic, message, tip.stamp_ns);
            stamps.add(message, i, format!("topic {topic}"), tip.stamp_ns);
            tips.push(tip);
        }
        self.found.signs.extend(stamps.signs());
        // Labels are in the order in which the points were touched.
        tips.sort_by_key(|tip| tip.stamp_ns);
        let events = tips.into_iter().enumerate().map(|(i, tip)| {
            let name = match label.or_else(|| self.params.labels.get(i).map(String::as_str)) {
                Some(label) => label.to_owned(),
                None => format!("{}_{}", last_part(topic), i + 1),
            };
            let frame = self.renamed(&tip.frame).unwrap_or_else(|| tip.frame.clone());
            (tip.stamp_ns, EventBody::Ready(Emission::value(topics::point(&tip, name, frame))))
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
        value.map_or(self.params.default.unwrap_or(false), |value| value == "true")
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
        let (parent, child) = (self.params.transforms.parent.as_deref(), self.params.transforms.child.as_deref());
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
        NodeError::new(format!("port \"{}\": {message}", self.declared.name))
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
