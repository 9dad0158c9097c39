//! Messages of topics to the payloads of declared ports, one by one.

use super::protocol::Channel;
use crate::acquire::{
    network::{Port, PortItems, StreamParams},
    sifted,
    topic_port::{Findings, Item, TopicPort},
    topics,
    topics::TransformFilter,
};
use osteoflow_formats::{
    mcap_read::{Message, Recording},
    message_read::{is_calibration, is_image, procedure_region},
};
use osteoflow_geometry::{Nearest, ROTATION_NOISE, StampNs, Step, TransformTree};
use osteoflow_node::{DeclaredPort, Emission, ParamError};
use osteoflow_payloads::Flag;
use std::collections::BTreeMap;

/// Encodings of messages that are read.
const ENCODINGS: [&str; 3] = ["protobuf", "json", "cdr"];
/// Images that wait for the calibration of their camera: a second of them.
const N_HELD: usize = 30;
/// Time for which transforms are kept until others join them to the frames of the port, ns: a latched `/tf_static` may come late.
const KEPT_NS: StampNs = 10_000_000_000;

/// What this protocol knows of a port.
pub(crate) struct Content {
    topic_port: TopicPort,
    /// Images that came before the calibration of their camera, with their topics.
    held: Vec<(String, Message)>,
    tree: TransformTree,
    /// Whether one transform is the port's, so that none are joined.
    is_direct: bool,
    /// The transforms that are joined, and the newest stamp of their product.
    path: Vec<Step>,
    joined_ns: Option<StampNs>,
}

impl Content {
    /// The port that a graph declares.
    ///
    /// # Errors
    /// [`ParamError`] if no topic can fill it.
    pub(super) fn port(declared: &DeclaredPort) -> Result<Port<Self>, ParamError> {
        let topic_port = TopicPort::new(declared)?;
        let params = &topic_port.params;
        let is_stated = params.default.is_some() || params.present.is_some() || params.metadata.is_some();
        if declared.payload.name == "report/Flag" && !is_stated {
            return Err(declared.refused("default", "default is not given, and no topic states a flag"));
        }
        let mut streams: Vec<String> = params.topics().into_iter().map(|(topic, _)| topic.to_owned()).collect();
        let beside = params.read_topics().into_iter().filter(|topic| !streams.contains(topic)).collect();
        let missing = |topic: &String| (topic.clone(), Emission::Empty(format!("the server has no topic {topic}")));
        let at_first = streams.iter().filter(|_| params.optional).map(missing).collect();
        streams.extend(params.calibration.clone());
        let stream = StreamParams {
            lost_after_ms: params.stream.lost_after_ms,
            frozen_after_ms: params.stream.frozen_after_ms,
            motion: params.stream.motion.clone(),
            ..StreamParams::default()
        };
        let (held, tree, path) = Default::default();
        let content = Self { topic_port, held, tree, is_direct: false, path, joined_ns: None };
        let mut port = Port::new(declared, stream, streams, content);
        (port.beside, port.at_first) = (beside, at_first);
        port.inform(&BTreeMap::new())?;
        Ok(port)
    }
}

impl Port<Content> {
    /// Sets what the port gives of the metadata of the server.
    ///
    /// # Errors
    /// [`ParamError`] if the region of interest in it is none.
    pub(super) fn inform(&mut self, metadata: &BTreeMap<String, String>) -> Result<(), ParamError> {
        let params = &self.content.topic_port.params;
        let stated = match self.payload {
            "report/Flag" => Emission::value(Flag(params.flag(|_| false, Some(metadata)))),
            "geometry/Region" => {
                let mut recording = Recording::default();
                recording.metadata.insert("procedure".into(), metadata.clone());
                let region =
                    procedure_region(&recording).map_err(|error| ParamError::new("metadata", error.to_string()))?;
                let none = || Emission::Empty("the server gives no region of interest".into());
                region.map_or_else(none, Emission::value)
            }
            _ => return Ok(()),
        };
        if self.has_begun {
            return Ok(());
        }
        self.at_first = vec![(params.present.clone().unwrap_or_default(), stated)];
        Ok(())
    }

    /// Takes note that a topic is there.
    ///
    /// # Errors
    /// The port has given a flag that says it is not.
    pub(super) fn advertised(&mut self, topic: &str) -> Result<Option<String>, String> {
        let Some(k) = self.at_first.iter().position(|(missing, _)| missing == topic) else { return Ok(None) };
        self.at_first.remove(k);
        let late =
            format!("port \"{}\": {topic} is advertised after the port has said that it is not there", self.name);
        if self.payload == "report/Flag" {
            if self.has_begun {
                return Err(format!("{late}; start its publisher before the run"));
            }
            self.at_first.push((String::new(), Emission::value(Flag(true))));
        }
        Ok(self.has_begun.then_some(late))
    }

    /// Whether the messages of a channel can be read.
    ///
    /// # Errors
    /// What is read instead.
    pub(super) fn check(&self, channel: &Channel) -> Result<(), String> {
        let Channel { topic, encoding, schema_name, .. } = channel;
        let (name, payload, port) = (&self.name, self.payload, &self.content.topic_port);
        let is_image = port.has_image(schema_name) && is_image(schema_name);
        let is_of_camera = port.params.calibration.as_ref() == Some(topic);
        let is_read =
            if is_of_camera { is_calibration(schema_name) } else { is_image || topics::reads(payload, schema_name) };
        let needed = match payload {
            _ if is_of_camera => "foxglove.CameraCalibration or sensor_msgs/msg/CameraInfo",
            "geometry/Cloud" => "foxglove.PointCloud, sensor_msgs/msg/PointCloud2 or, with calibration, a depth image",
            "geometry/Image" => "foxglove.RawImage or CompressedImage, sensor_msgs/msg/Image or CompressedImage",
            "geometry/Pose" => {
                "foxglove.FrameTransform(s), tf2_msgs/msg/TFMessage, geometry_msgs/msg/TransformStamped or a pose in a frame"
            }
            _ => "foxglove.PoseInFrame or geometry_msgs/msg/PoseStamped",
        };
        if !is_read {
            return Err(format!("port \"{name}\": {topic} has {schema_name}, but {payload} is read from {needed}"));
        }
        if is_image {
            port.params
                .calibration(&port.declared)
                .map_err(|error| format!("port \"{name}\": {topic}: {}", error.message))?;
        }
        if !ENCODINGS.contains(&&**encoding) {
            let known = ENCODINGS.join(", ");
            return Err(format!("port \"{name}\": {topic} is encoded as \"{encoding}\"; {known} are read"));
        }
        Ok(())
    }

    /// The items of a message, and of those that waited for it.
    pub(super) fn read(&mut self, topic: &str, message: &Message, found: &mut Findings) -> PortItems {
        let mut out = PortItems::default();
        let Content { topic_port, held, .. } = &mut self.content;
        let due = if topic_port.params.calibration.as_deref() == Some(topic) {
            if let Err(reason) = topic_port.calibrate(message, found) {
                return PortItems::fault(format!("port \"{}\": {topic}: {reason}", self.name));
            }
            std::mem::take(held)
        } else if topic_port.lacks_calibration(message).is_some() {
            held.push((topic.to_owned(), message.clone()));
            if held.len() > N_HELD { vec![held.remove(0)] } else { Vec::new() }
        } else {
            vec![(topic.to_owned(), message.clone())]
        };
        let notes =
            |found: &mut Findings| found.notes.drain(..).chain(found.spellings.notes.drain(..)).collect::<Vec<_>>();
        out.notes.extend(notes(found).into_iter().map(|note| format!("{topic}: {note}")));
        for (topic, message) in due {
            let n_notes = out.notes.len();
            let read = match self.content.topic_port.joins(&message).filter(|_| !self.content.is_direct) {
                Some((parent, child)) => self.join(&topic, &message, (&parent, &child), found, &mut out),
                None => self.content.topic_port.take(&topic, &message, found),
            };
            let put =
                read.and_then(|items| items.into_iter().try_for_each(|item| self.put(&topic, item, found, &mut out)));
            if let Err(reason) = put {
                let stamp_ns = self.not_before_last(message.publish_time_ns);
                out.items.push((stamp_ns, Emission::Empty(format!("{topic}: {reason}"))));
                out.notes.push(reason);
            }
            out.notes.extend(notes(found));
            out.notes[n_notes..].iter_mut().for_each(|note| *note = format!("{topic}: {note}"));
        }
        out.signs.extend(found.signs.drain(..).chain(found.spellings.signs.drain(..)));
        match found.stamps.notes() {
            Ok(notes) => out.notes.extend(notes),
            Err(fault) => out.fault = Some(fault),
        }
        out
    }

    /// Gives an item of a message.
    fn put(&mut self, topic: &str, item: Item, found: &mut Findings, out: &mut PortItems) -> Result<(), String> {
        match item {
            Item::Scan(stamp_ns, scan) => {
                let (emission, notes) = scan.emission().map_err(|error| error.to_string())?;
                out.notes.extend(notes);
                out.items.push((stamp_ns, emission));
            }
            Item::Tip(index, tip) => {
                let points = self.content.topic_port.point(topic, index, &tip, found);
                out.items.push((tip.stamp_ns, Emission::value(points)));
            }
            Item::Constant(pose) => out.items.push((pose.stamp_ns, Emission::value(pose))),
            Item::Lost(lost) => out.items.push((lost.stamp_ns, Emission::Empty(lost.to_string()))),
            Item::Pose(Nearest { value: pose, correction }) => {
                let what = format!("t_{}_{}", pose.to, pose.from);
                if !self.is_repeat(&what, &pose, out) {
                    self.put_pose(&what, pose, correction, ROTATION_NOISE, out);
                }
            }
            Item::NotRigid(error) => {
                out.notes.push(error.to_string());
                // A message has no other time for it than its neighbours'.
                out.items.push((self.not_before_last(0), Emission::Empty(error.to_string())));
            }
        }
        Ok(())
    }

    /// Gives the poses that transforms of a message settle, where several lead from one frame of the port to the other; or the items of
    /// the one that does.
    fn join(
        &mut self,
        topic: &str,
        message: &Message,
        (parent, child): (&str, &str),
        found: &mut Findings,
        out: &mut PortItems,
    ) -> Result<Vec<Item>, String> {
        let mut items = self.content.topic_port.transforms(topic, message, &TransformFilter::default(), found)?;
        let params = self.content.topic_port.params.clone();
        let is_direct = |item: &mut Item| {
            params.names(topic) && item.frames_mut().is_some_and(|[to, from]| params.transforms.wants(to, from))
        };
        if items.iter_mut().any(is_direct) {
            if self.content.joined_ns.is_some() {
                let fault = "comes as one transform after it was joined of several; choose one of them";
                out.fault = Some(format!("port \"{}\": {topic}: t_{parent}_{child} {fault}", self.name));
            }
            self.content.is_direct = true;
            items.retain_mut(is_direct);
            items.iter_mut().filter_map(Item::frames_mut).for_each(|frames| found.rename(frames));
            return Ok(items);
        }
        for item in items {
            match item {
                Item::Constant(pose) => out.signs.extend(sifted::add_static(&mut self.content.tree, &pose)),
                Item::Lost(lost) => {
                    let reason = format!("has {}", lost.reason);
                    self.content.tree.add(&lost.to, &lost.from, lost.stamp_ns, Err(reason));
                }
                Item::Pose(Nearest { value: pose, correction }) => {
                    let (what, stamp_ns) = (format!("t_{}_{}", pose.to, pose.from), pose.stamp_ns);
                    let is_on_path = |step: &Step| (&step.parent, &step.child) == (&pose.to, &pose.from);
                    let is_late = self.content.joined_ns.is_some_and(|joined_ns| stamp_ns <= joined_ns);
                    if stamp_ns != 0 && is_late && self.content.path.iter().any(is_on_path) {
                        let late = format!("{what} of {stamp_ns} ns comes after it was needed");
                        out.items.push((stamp_ns, Emission::Empty(late)));
                    } else if !self.is_repeat(&what, &pose, out)
                        && let Some(pose) = self.sifted(&what, pose, correction, ROTATION_NOISE, out)
                    {
                        sifted::add(&mut self.content.tree, &pose);
                        self.content.tree.forget(stamp_ns.saturating_sub(KEPT_NS));
                    }
                }
                Item::NotRigid(error) => out.notes.push(error.to_string()),
                Item::Scan(..) | Item::Tip(..) => {}
            }
        }
        let Content { tree, path, joined_ns, .. } = &mut self.content;
        let read = sifted::through(tree, (parent, child), params.stream.max_gap_ms);
        let read = read.unwrap_or_else(|fault| {
            out.fault = Some(format!("port \"{}\": {fault}", self.name));
            None
        });
        let Some((poses, chain)) = read else { return Ok(Vec::new()) };
        let is_new = |stamp_ns| joined_ns.is_none_or(|joined_ns| stamp_ns > joined_ns);
        let settled = poses.into_iter().filter(|(pose, _)| pose.stamp_ns <= chain.settled_ns && is_new(pose.stamp_ns));
        let settled: Vec<_> = settled.collect();
        if joined_ns.is_none() && !settled.is_empty() {
            out.notes.push(chain.note);
        }
        *joined_ns = settled.last().map(|(pose, _)| pose.stamp_ns).or(*joined_ns);
        *path = chain.steps;
        tree.forget(chain.settled_ns);
        for (mut pose, reason) in settled {
            found.rename([&mut pose.to, &mut pose.from]);
            out.items.push(sifted::emission((pose, reason)));
        }
        Ok(Vec::new())
    }
}
