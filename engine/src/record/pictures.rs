//! The messages for viewers beside the exact ones: channels `/view/<wire>`, and the transforms on `/run/frames`.

use super::{
    answers::Answers,
    frame_tree::FrameTree,
    layout::{Focus, layout},
    output::{Output, Schema},
};
use crate::{
    plan::{OutputId, Plan},
    recording::format::Topic,
};
use osteoflow_container::MessageHeader;
use osteoflow_node::{Body, Display, DisplayContext, Item, PortPayload, StampNs, Value};
use serde_json::Value as Json;
use std::{collections::BTreeMap, io};

/// The channels for viewers, and what they wait for.
pub(super) struct Pictures {
    wires: BTreeMap<OutputId, Channel>,
    tree: FrameTree,
    answers: Answers,
}

/// The channel of a wire.
struct Channel {
    id: u16,
    wire: String,
    display: Display,
    /// The frame of the wire's payloads; `None` for poses, and if it is not known before the run.
    frame: Option<String>,
    /// Whether the payloads are poses with known frames.
    is_pose: bool,
    first: Option<Value>,
}

impl Pictures {
    /// Adds a channel for each recorded wire whose payload viewers can show.
    pub(super) fn begin(file: &mut Output, plan: &Plan) -> io::Result<Self> {
        let (mut wires, mut answers) = (BTreeMap::new(), Answers::new(plan));
        for &id in plan.record.iter().filter(|_| plan.recording.views) {
            let output = &plan.nodes[id.node].outputs[id.port];
            let PortPayload::Type(ty) = output.payload else { continue };
            let Some(display) = ty.display() else { continue };
            let wire = plan.wire_name(id);
            let channel = add_channel(file, &Topic::View(&wire).name(), &display)?;
            if display.answer {
                answers.add(channel, &display.removal);
            }
            let frames = &output.frames;
            let is_pose = frames.to.is_some() && frames.from.is_some();
            let frame = frames.frame.clone();
            wires.insert(id, Channel { id: channel, wire, display, frame, is_pose, first: None });
        }
        let tree = FrameTree::new(plan);
        Ok(Self { wires, tree, answers })
    }

    /// Writes the picture of a value, or holds it until the end if it shows an answer.
    pub(super) fn write(
        &mut self,
        file: &mut Output,
        wire: OutputId,
        (item, value): (&Item, &Value),
        time_ns: u64,
    ) -> io::Result<()> {
        let Some(channel) = self.wires.get_mut(&wire) else { return Ok(()) };
        let about = DisplayContext { stamp_ns: time_ns as StampNs, wire: &channel.wire, edge: self.tree.edge(wire) };
        let Some(picture) = value.to_display(&about) else { return Ok(()) };
        if channel.first.is_none() {
            channel.first = Some(value.clone());
        }
        let (channel_id, sequence) = (channel.id, item.number as u32);
        let head = MessageHeader { channel_id, sequence, log_time: time_ns, publish_time: time_ns };
        if !channel.display.answer {
            return file.write_message(head, picture.into());
        }
        if let Some((head, picture)) = self.answers.hold((head, picture)) {
            file.send(head, picture);
        }
        Ok(())
    }

    /// Follows the verdict of the run, and removes what listeners were shown of an answer that has no value now.
    pub(super) fn follow(&mut self, file: &Output, wire: OutputId, item: &Item, time_ns: u64) {
        let lost = self.wires.get(&wire).filter(|_| matches!(item.body, Body::Empty(_)));
        let lost = lost.and_then(|channel| self.answers.lost(channel.id, time_ns));
        let judged = self.answers.judge(wire, item, time_ns);
        lost.into_iter().chain(judged).for_each(|(head, picture)| file.send(head, picture));
    }

    /// Writes the first transform of each wire of poses at `first_ns`, before everything else in the file, and the answers
    /// if the run is `complete`; else removes at `last_ns` those that listeners have. Returns what viewers cannot show.
    pub(super) fn finish(
        &mut self,
        file: &mut Output,
        (first_ns, last_ns): (u64, u64),
        complete: bool,
    ) -> io::Result<Vec<String>> {
        let mut notes = self.not_connected();
        let (held, n_left_out) = self.answers.take_held();
        if !complete {
            self.answers.remove_all(last_ns).into_iter().for_each(|(head, removal)| file.send(head, removal));
        }
        if !complete && !held.is_empty() {
            let n = held.len() + n_left_out;
            notes.push(format!("the run has no answer: {n} pictures of planes are not drawn"));
        } else {
            held.into_iter().try_for_each(|(head, picture)| file.write_message(head, picture.into()))?;
            if n_left_out > 0 {
                let n = n_left_out;
                notes.push(format!("{n} later pictures of planes are not drawn: no more than 64 MB wait for the end"));
            }
        }
        let mut channel_id = None;
        for (sequence, (&id, channel)) in (0..).zip(self.wires.iter().filter(|(_, channel)| channel.is_pose)) {
            let Some(value) = &channel.first else { continue };
            let about = DisplayContext { stamp_ns: first_ns as StampNs, wire: &channel.wire, edge: self.tree.edge(id) };
            let Some(picture) = value.to_display(&about) else { continue };
            let channel_id = match channel_id {
                Some(id) => id,
                None => *channel_id.insert(add_channel(file, &Topic::Frames.name(), &channel.display)?),
            };
            let head = MessageHeader { channel_id, sequence, log_time: first_ns, publish_time: first_ns };
            file.write_message(head, picture.into())?;
        }
        Ok(notes)
    }

    /// The layout of viewers for this recording; `None` if it has no channel for them. It looks at the first surface that
    /// is connected to the root, otherwise at the first cloud.
    pub(super) fn layout(&self) -> Option<Json> {
        if self.wires.is_empty() {
            return None;
        }
        let channels = self.wires.values();
        let shown: Vec<_> =
            channels.map(|channel| (Topic::View(&channel.wire).name(), channel.display.schema_name.as_str())).collect();
        let has_pose = |wire| self.wires.get(&wire).is_some_and(|channel| channel.first.is_some());
        let candidates = self.wires.values().filter_map(|channel| {
            let (frame, value) = (channel.frame.as_deref()?, channel.first.as_ref()?);
            let is_surface = channel.display.schema_name == "foxglove.SceneUpdate";
            let rank = (self.tree.connected(frame, has_pose).is_err(), !is_surface);
            Some((rank, Focus { frame, centre_m: value.display_centre()? }))
        });
        // Of equal ranks the first is taken.
        let focus = candidates.min_by_key(|(rank, _)| *rank).map(|(_, focus)| focus);
        Some(layout(&shown, focus.as_ref()))
    }

    /// For each frame with pictures that no pose joins to the root: the pictures, and the wire that is missing.
    fn not_connected(&self) -> Vec<String> {
        let mut shown: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
        for channel in self.wires.values().filter(|channel| channel.first.is_some()) {
            if let Some(frame) = &channel.frame {
                shown.entry(frame).or_default().push(&channel.wire);
            }
        }
        let Some(root) = self.tree.root().or_else(|| shown.keys().next().copied()) else { return Vec::new() };
        let has_pose = |wire| self.wires.get(&wire).is_some_and(|channel| channel.first.is_some());
        let note = |(frame, wires): (&str, Vec<&str>)| {
            if frame == root {
                return None;
            }
            let why = match self.tree.connected(frame, has_pose).err()? {
                Some(wire) => format!("{} gave no pose", self.wires.get(&wire).map_or("a wire", |c| &c.wire)),
                None => "no wire in [record] has its pose".into(),
            };
            let wires = wires.join(", ");
            Some(format!("frame {frame} is not connected to {root}: {why}; viewers cannot show {wires} with the rest"))
        };
        shown.into_iter().filter_map(note).collect()
    }
}

fn add_channel(file: &mut Output, topic: &str, display: &Display) -> io::Result<u16> {
    let Display { schema_name: name, schema_encoding: encoding, schema_data: data, .. } = display;
    file.add_channel(&Schema { name, encoding, data }, topic, &display.message_encoding, &BTreeMap::new())
}
