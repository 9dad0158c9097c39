//! The messages for viewers beside the exact ones: channels `/view/<wire>`, and what a registration shows of its scan.

use super::{
    answers::Answers,
    frame_tree::FrameTree,
    layout::{Content, Focus, Shown, layout},
    output::{Output, Schema},
};
use crate::{
    plan::{OutputId, Plan},
    recording::format::{OPENING, Topic},
};
use osteoflow_container::MessageHeader;
use osteoflow_node::{Body, Display, DisplayContext, Item, PayloadType, PortPayload, Role, StampNs, Value};
use serde_json::{Value as Json, json};
use std::{collections::BTreeMap, io};

/// The channels for viewers, and what they wait for.
pub(super) struct Pictures {
    wires: BTreeMap<OutputId, Channel>,
    tree: FrameTree,
    answers: Answers,
    registered: Option<Registered>,
    verdict: Option<Verdict>,
}

/// The scan where its registration places it.
struct Registered {
    channel: u16,
    n: u32,
    fit: OutputId,
    cloud: OutputId,
    /// The wires of surfaces in the root, in the order of the graph.
    surfaces: Vec<OutputId>,
    scan: Option<Value>,
    surface: Option<Value>,
}

/// The verdict so far.
struct Verdict {
    channel: u16,
    n: u32,
    wire: OutputId,
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
    /// Whether a node computed them; a source's are measured, planned or, in a simulation, true.
    is_computed: bool,
    first: Option<Value>,
}

impl Pictures {
    /// Adds a channel for each recorded wire whose payload viewers can show.
    pub(super) fn begin(file: &mut Output, plan: &Plan) -> io::Result<Self> {
        let (mut wires, mut answers, tree) = (BTreeMap::new(), Answers::new(plan), FrameTree::new(plan));
        for &id in plan.record.iter().filter(|_| plan.recording.views) {
            let output = &plan.nodes[id.node].outputs[id.port];
            let PortPayload::Type(ty) = output.payload else { continue };
            let Some(display) = ty.display() else { continue };
            let wire = plan.wire_name(id);
            let is_pose = output.frames.to.is_some() && output.frames.from.is_some();
            // Our own page shows the world around the bone in the tracker's frame, where a lost marker takes the bone away.
            let origin = tree.origin().filter(|_| is_pose && tree.is_anchored());
            let metadata = origin.map(|origin| (ORIGIN.to_owned(), origin.to_owned())).into_iter().collect();
            let channel = add_channel(file, &Topic::View(&wire).name(), &display, &metadata)?;
            if display.answer {
                answers.add(channel, &display.removal);
            }
            let frames = &output.frames;
            let frame = frames.frame.clone();
            let is_computed = plan.nodes[id.node].role == Role::Node;
            wires.insert(id, Channel { id: channel, wire, display, frame, is_pose, is_computed, first: None });
        }
        let registered = if plan.recording.views { Registered::begin(file, plan, &tree)? } else { None };
        let verdict = match answers.verdict().filter(|_| plan.recording.views) {
            Some(wire) => {
                let schema =
                    Schema { name: "osteoflow.Verdict", encoding: "jsonschema", data: VERDICT_SCHEMA.as_bytes() };
                let channel = file.add_channel(&schema, &Topic::Verdict.name(), "json", &BTreeMap::new())?;
                Some(Verdict { channel, n: 0, wire })
            }
            None => None,
        };
        Ok(Self { wires, tree, answers, registered, verdict })
    }

    /// Writes the picture of a value, or holds it until the end if it shows an answer.
    pub(super) fn write(
        &mut self,
        file: &mut Output,
        wire: OutputId,
        (item, value): (&Item, &Value),
        time_ns: u64,
    ) -> io::Result<()> {
        self.write_picture(file, wire, (item, value), time_ns)?;
        if let Some(verdict) = self.verdict.as_mut().filter(|verdict| verdict.wire == wire) {
            verdict.write(file, &value.to_result(), time_ns)?;
        }
        // Behind the pose that places it.
        self.write_registered(file, wire, (item, value), time_ns)
    }

    fn write_picture(
        &mut self,
        file: &mut Output,
        wire: OutputId,
        (item, value): (&Item, &Value),
        time_ns: u64,
    ) -> io::Result<()> {
        let Some(channel) = self.wires.get_mut(&wire) else { return Ok(()) };
        let about = DisplayContext {
            stamp_ns: time_ns as StampNs,
            wire: &channel.wire,
            edge: self.tree.edge(wire),
            anchored: self.tree.is_anchored(),
        };
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

    /// Follows scan and surface, and shows the one on the other when a registration gives its pose.
    fn write_registered(
        &mut self,
        file: &mut Output,
        wire: OutputId,
        (item, value): (&Item, &Value),
        time_ns: u64,
    ) -> io::Result<()> {
        let Some(registered) = &mut self.registered else { return Ok(()) };
        if wire == registered.cloud {
            registered.scan = Some(value.clone());
        } else if registered.surfaces.contains(&wire) {
            // The last in the graph is prepared for searches.
            registered.surface = Some(value.clone());
        }
        let (Some(scan), Some(surface)) = (&registered.scan, &registered.surface) else { return Ok(()) };
        if wire != registered.fit {
            return Ok(());
        }
        let about = DisplayContext {
            stamp_ns: item.stamp_ns.max(1),
            wire: "",
            edge: self.tree.edge(wire),
            anchored: self.tree.is_anchored(),
        };
        let Some(picture) = scan.to_display_on(surface, value, &about) else { return Ok(()) };
        let (channel_id, sequence) = (registered.channel, registered.n);
        registered.n += 1;
        file.write_message(
            MessageHeader { channel_id, sequence, log_time: time_ns, publish_time: time_ns },
            picture.into(),
        )
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
        if let Some(verdict) = self.verdict.as_mut().filter(|_| !complete) {
            let none = json!({ "answer": "refused", "sentence": "the run has no answer" });
            verdict.write(file, &none, last_ns)?;
        }
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
        // On the channel of its wire, since a viewer may take each channel for another source of its frames.
        for (&id, channel) in self.wires.iter().filter(|(_, channel)| channel.is_pose) {
            let Some(value) = &channel.first else { continue };
            let about = DisplayContext {
                stamp_ns: first_ns as StampNs,
                wire: &channel.wire,
                edge: self.tree.edge(id),
                anchored: self.tree.is_anchored(),
            };
            let Some(picture) = value.to_display(&about) else { continue };
            let head =
                MessageHeader { channel_id: channel.id, sequence: OPENING, log_time: first_ns, publish_time: first_ns };
            file.write_unheard(head, picture)?;
        }
        Ok(notes)
    }

    /// The layout of viewers for this recording; `None` if it has no channel for them. It looks at the first surface that
    /// is connected to the root, otherwise at the first cloud.
    pub(super) fn layout(&self) -> Option<Json> {
        if self.wires.is_empty() {
            return None;
        }
        let shown = self.shown();
        let has_pose = |wire| self.wires.get(&wire).is_some_and(|channel| channel.first.is_some());
        let candidates = self.wires.values().filter_map(|channel| {
            let (frame, value) = (channel.frame.as_deref()?, channel.first.as_ref()?);
            let is_surface = channel.display.schema_name == "foxglove.SceneUpdate";
            let rank = (self.tree.connected(frame, has_pose).is_err(), !is_surface);
            Some((rank, Focus { frame, centre_m: value.display_centre()? }))
        });
        // Of equal ranks the first is taken.
        let focus = candidates.min_by_key(|(rank, _)| *rank).map(|(_, focus)| focus);
        Some(layout(&shown, self.verdict.is_some(), &self.tree.frames(), focus.as_ref()))
    }

    /// The topics of the 3D view. What the page shows is visible at first: a surface, the scan on it, points, the last planes.
    fn shown(&self) -> Vec<Shown> {
        let root = self.tree.root();
        let is_in_root = |channel: &&Channel| channel.frame.as_deref() == root;
        let surface = self.wires.values().find(|channel| channel.display.anchor && is_in_root(channel));
        let planes = self.wires.values().rfind(|channel| channel.display.answer && channel.is_computed);
        let is_registered = self.registered.as_ref().is_some_and(|registered| registered.n > 0);
        let shown = |channel: &Channel| {
            let is = |other: Option<&Channel>| other.is_some_and(|other| other.id == channel.id);
            let content = match channel.display.schema_name.as_str() {
                "foxglove.PointCloud" => Content::Cloud,
                "foxglove.SceneUpdate" => Content::Scene,
                _ => Content::Other,
            };
            let visible = match content {
                // A scan in its own frame is drawn again where it belongs.
                Content::Cloud => !is_registered && channel.is_computed,
                Content::Scene if channel.display.anchor => is(surface),
                Content::Scene if channel.display.answer => is(planes),
                Content::Scene => channel.is_computed,
                Content::Coloured | Content::Other => false,
            };
            Shown { topic: Topic::View(&channel.wire).name(), content, visible }
        };
        let mut all: Vec<_> = self.wires.values().map(shown).collect();
        if self.registered.is_some() {
            all.push(Shown { topic: Topic::Registered.name(), content: Content::Coloured, visible: true });
        }
        all
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

/// The schema of the verdict so far.
const VERDICT_SCHEMA: &str =
    r#"{"type":"object","properties":{"answer":{"type":"string"},"sentence":{"type":"string"}}}"#;

impl Verdict {
    fn write(&mut self, file: &mut Output, verdict: &Json, time_ns: u64) -> io::Result<()> {
        let short = json!({ "answer": verdict["answer"], "sentence": verdict["sentence"] });
        let sequence = self.n;
        self.n += 1;
        let head = MessageHeader { channel_id: self.channel, sequence, log_time: time_ns, publish_time: time_ns };
        file.write_message(head, short.to_string().into_bytes().into())
    }
}

impl Registered {
    /// Adds the channel, if the plan has a registration onto the surface in the root whose scan, surface and pose are recorded.
    fn begin(file: &mut Output, plan: &Plan, tree: &FrameTree) -> io::Result<Option<Self>> {
        let (Some(fit), Some(root)) = (tree.fit(), tree.root()) else { return Ok(None) };
        let display = |id: OutputId| plan.nodes[id.node].outputs[id.port].payload.ty().and_then(PayloadType::display);
        let frame = |id: OutputId| plan.nodes[id.node].outputs[id.port].frames.frame.as_deref();
        let of = &plan.nodes[fit.node].outputs[fit.port].frames;
        let moved = if of.to.as_deref() == Some(root) { of.from.as_deref() } else { of.to.as_deref() };
        let inputs =
            plan.nodes[fit.node].inputs.iter().flat_map(|input| &input.links).map(|&link| plan.links[link].from);
        let cloud = inputs.filter(|&id| frame(id) == moved && plan.record.contains(&id)).find_map(|id| {
            let display = display(id).filter(|display| display.schema_name == "foxglove.PointCloud")?;
            Some((id, display))
        });
        let surfaces = plan.record.iter().copied();
        let surfaces: Vec<_> = surfaces
            .filter(|&id| frame(id) == Some(root) && display(id).is_some_and(|display| display.anchor))
            .collect();
        let Some((cloud, display)) = cloud.filter(|_| !surfaces.is_empty()) else { return Ok(None) };
        let channel = add_channel(file, &Topic::Registered.name(), &display, &BTreeMap::new())?;
        Ok(Some(Self { channel, n: 0, fit, cloud, surfaces, scan: None, surface: None }))
    }
}

/// The key of the tracker's frame in the metadata of channels of transforms.
const ORIGIN: &str = "origin";

fn add_channel(
    file: &mut Output,
    topic: &str,
    display: &Display,
    metadata: &BTreeMap<String, String>,
) -> io::Result<u16> {
    let Display { schema_name: name, schema_encoding: encoding, schema_data: data, .. } = display;
    file.add_channel(&Schema { name, encoding, data }, topic, &display.message_encoding, metadata)
}
