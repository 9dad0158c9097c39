//! The ports of a source over a network, and the items on their way to them.

use crate::acquire::{
    frozen::Frozen,
    live_marker::LiveMarker,
    one_stamp::OneStamp,
    playback::Event,
    sifted::{self, Sifted, Sign},
};
use osteoflow_algorithms::marker_stream::MotionLimits;
use osteoflow_formats::openigtlink::{ClockNote, ClockOffset};
use osteoflow_geometry::{Correction, Pose, StampNs};
use osteoflow_node::{Context, DeclaredPort, Emission, Payload, schemars::JsonSchema, serde::Deserialize};
use osteoflow_payloads::Flag;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Warnings of each sort; more are counted.
const N_WARNINGS: usize = 10;

/// Parameters of a port of every source over a network.
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default)]
pub struct StreamParams {
    /// Names of clouds and points: one for each of several devices; with one, one for each message in order. Default: the names
    /// in the message, else the device's.
    pub labels: Vec<String>,
    /// Time of the sender without the tool, while other messages come, after which a pose is lost and the port gives an empty.
    /// Unset: never.
    #[schemars(range(min = 1.0, max = 3_600_000.0))]
    pub lost_after_ms: Option<f64>,
    /// Time for which poses may be the same to the last bit while their stamps go on. Beyond it the tracker is frozen, and the
    /// port gives empties that say why until the pose changes. Unset: 2000, forty samples of a slow tracker: at rest one that
    /// rounds to 0.1 mm repeats a pose for up to 0.85 s. 0: never, for a constant.
    #[schemars(range(min = 0.0, max = 3_600_000.0))]
    pub frozen_after_ms: Option<f64>,
    /// How a marker moves at most: poses that contradict it, or those before them, are left out and counted. Where nothing is given for
    /// 100 ms, the port gives an empty that says why.
    pub motion: MotionLimits,
    /// The value of a `report/Flag` with the first item of another port, if no message gave one before. Unset: it waits for
    /// one.
    pub default: Option<bool>,
}

/// A declared port of a source over a network; `T` is what its protocol knows of it.
pub(crate) struct Port<T> {
    pub(crate) name: String,
    pub(crate) payload: &'static str,
    /// The devices or topics that the port reads.
    pub(crate) streams: Vec<String>,
    /// Topics that it reads beside them, which may be missing.
    pub(crate) beside: Vec<String>,
    /// What the port gives with the first item of another port, if it has given nothing before, by the topic that is missing till then.
    pub(crate) at_first: Vec<(String, Emission)>,
    /// Whether it has given it.
    pub(crate) has_begun: bool,
    pub(crate) content: T,
    /// Number of messages so far.
    pub(crate) n_messages: usize,
    labels: Vec<String>,
    frozen: Frozen,
    one_stamp: OneStamp,
    motion: MotionLimits,
    /// By the name of the pose.
    markers: BTreeMap<String, LiveMarker>,
    lost_after_ns: Option<StampNs>,
    /// The newest stamp of an item.
    last_ns: Option<StampNs>,
    /// Whether an item said that the tool was not sent.
    is_lost: bool,
    /// Those of `streams` that the peer has.
    present: BTreeSet<String>,
}

/// The items of a message on one port, and what the user should know of it.
#[derive(Default)]
pub(crate) struct PortItems {
    pub(crate) items: Vec<(StampNs, Emission)>,
    pub(crate) notes: Vec<String>,
    /// The signs that what comes is wrong.
    pub(crate) signs: Vec<Sign>,
    /// Why the graph cannot read what comes; the source fails with it.
    pub(crate) fault: Option<String>,
}

/// The ports, and their items in the order in which they are given.
pub(crate) struct Inbox<T> {
    pub(crate) ports: Vec<Port<T>>,
    events: VecDeque<Event<Emission>>,
    /// The items of the message that is read.
    message: Vec<Event<Emission>>,
    clock: ClockOffset,
    /// What is added to the sender's stamps, if they are corrected.
    shift_ns: Option<StampNs>,
    arrived_ns: StampNs,
    /// The newest stamp.
    newest_ns: StampNs,
    /// Why the graph cannot read what came.
    fault: Option<String>,
    /// Number of warnings by sort.
    n_warnings: BTreeMap<String, usize>,
}

impl PortItems {
    /// A value.
    pub(crate) fn value<V: Payload<By>, By: 'static>(stamp_ns: StampNs, value: V) -> Self {
        Self { items: vec![(stamp_ns, Emission::value(value))], ..Self::default() }
    }

    /// An empty.
    pub(crate) fn empty(stamp_ns: StampNs, reason: String) -> Self {
        Self { items: vec![(stamp_ns, Emission::Empty(reason))], ..Self::default() }
    }

    /// A message that the graph has to be changed for.
    pub(crate) fn fault(fault: String) -> Self {
        Self { fault: Some(fault), ..Self::default() }
    }

    /// An empty for a message that cannot be used, of which the user is told.
    pub(crate) fn refused(stamp_ns: StampNs, reason: String) -> Self {
        Self { notes: vec![reason.clone()], ..Self::empty(stamp_ns, reason) }
    }
}

impl<T> Port<T> {
    pub(crate) fn new(declared: &DeclaredPort, params: StreamParams, streams: Vec<String>, content: T) -> Self {
        Self {
            name: declared.name.clone(),
            payload: declared.payload.name,
            streams,
            beside: Vec::new(),
            at_first: params.default.map(|flag| (String::new(), Emission::value(Flag(flag)))).into_iter().collect(),
            has_begun: false,
            content,
            n_messages: 0,
            labels: params.labels,
            frozen: Frozen::new(params.frozen_after_ms),
            one_stamp: OneStamp::default(),
            motion: params.motion,
            markers: BTreeMap::new(),
            lost_after_ns: params.lost_after_ms.map(|ms| (ms * 1e6).round() as StampNs),
            last_ns: None,
            is_lost: false,
            present: BTreeSet::new(),
        }
    }

    pub(crate) fn reads(&self, stream: &str) -> bool {
        self.streams.iter().chain(&self.beside).any(|known| known == stream)
    }

    /// The label of the message that is read.
    pub(crate) fn label(&self, stream: &str) -> Option<&str> {
        let index = match self.streams.len() {
            1 => self.n_messages,
            _ => self.streams.iter().position(|known| known == stream)?,
        };
        self.labels.get(index).map(String::as_str)
    }

    /// Whether a pose called `what` repeats one of its stamp; one that contradicts another is told.
    pub(crate) fn is_repeat(&mut self, what: &str, pose: &Pose, out: &mut PortItems) -> bool {
        let is_repeat = self.one_stamp.is_repeat(what, pose);
        out.signs.extend(self.one_stamp.first_note(what).map(|note| ("stamps_contradict", note)));
        is_repeat
    }

    /// A pose called `what`, unless it is left out, and why it is no measurement, if it is none; `correction` is reported if it is above
    /// `limit`.
    pub(crate) fn sifted(
        &mut self,
        what: &str,
        pose: Pose,
        correction: Correction,
        limit: f64,
        out: &mut PortItems,
    ) -> Option<Sifted> {
        if correction.deviation > limit {
            out.notes.push(format!("{what}: a rotation is rounded, and the nearest one is used: {correction}"));
        }
        let mut notes = Vec::new();
        let frozen = self.frozen.take(what, &pose.isometry, pose.stamp_ns, &mut notes);
        out.signs.extend(notes.into_iter().map(|note| ("marker_frozen", note)));
        match frozen {
            Some(reason) => Some((pose, Some(reason))),
            None => self.markers.entry(what.into()).or_default().take(what, pose, &self.motion, &mut out.signs),
        }
    }

    /// Adds the item of a pose, as [`Self::sifted`].
    pub(crate) fn put_pose(&mut self, what: &str, pose: Pose, correction: Correction, limit: f64, out: &mut PortItems) {
        let sifted = self.sifted(what, pose, correction, limit, out);
        out.items.extend(sifted.map(sifted::emission));
    }

    /// The newest stamp, or a later one.
    pub(crate) fn not_before_last(&self, stamp_ns: StampNs) -> StampNs {
        stamp_ns.max(self.last_ns.unwrap_or(0))
    }

    /// Those of the port's devices or topics that the peer does not have.
    pub(crate) fn missing(&self) -> Vec<&str> {
        self.streams.iter().map(String::as_str).filter(|stream| !self.present.contains(*stream)).collect()
    }
}

impl<T> Inbox<T> {
    pub(super) fn new(ports: Vec<Port<T>>) -> Self {
        Self {
            ports,
            events: VecDeque::new(),
            message: Vec::new(),
            clock: ClockOffset::default(),
            shift_ns: None,
            arrived_ns: 0,
            newest_ns: 0,
            fault: None,
            n_warnings: BTreeMap::new(),
        }
    }

    /// Why the graph cannot read what came, if it cannot.
    pub(super) fn take_fault(&mut self) -> Option<String> {
        self.fault.take()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.events.is_empty()
    }

    pub(super) fn pop(&mut self) -> Option<Event<Emission>> {
        self.events.pop_front()
    }

    /// Whether an item with a stamp came.
    pub(crate) fn has_items(&self) -> bool {
        self.newest_ns > 0
    }

    /// Warns, at most [`N_WARNINGS`] times of each sort.
    pub(crate) fn warn(&mut self, sort: &str, message: String, ctx: &mut Context) {
        if let Some(message) = self.counted(sort, message) {
            ctx.warn(message);
        }
    }

    /// The message, unless there were enough of its sort.
    fn counted(&mut self, sort: &str, message: String) -> Option<String> {
        let n = self.n_warnings.entry(sort.into()).or_default();
        *n += 1;
        match *n {
            n if n < N_WARNINGS => Some(message),
            N_WARNINGS => Some(format!("{message}; more of these are not reported")),
            _ => None,
        }
    }

    /// Bytes have arrived now.
    pub(crate) fn arrive(&mut self, ctx: &mut Context) {
        self.arrived_ns = ctx.clock_ns();
    }

    /// The stamp of a message in this run, from the sender's stamp: the only place where one becomes the other.
    ///
    /// Stamps are taken as they are, or with the offset of the sender's clock once [`Inbox::settle`] was called; the offset is
    /// reported. Without a stamp it is the time of arrival.
    pub(crate) fn stamp(&mut self, sent_ns: Option<StampNs>, ctx: &mut Context) -> StampNs {
        self.observe(sent_ns, ctx);
        self.corrected(sent_ns)
    }

    /// Takes the stamp of a message that has just arrived into account for the offset of the sender's clock.
    pub(crate) fn observe(&mut self, sent_ns: Option<StampNs>, ctx: &mut Context) {
        let note = sent_ns.and_then(|sent_ns| self.clock.add(sent_ns, self.arrived_ns));
        self.note_clock(note, ctx);
    }

    /// The stamp of a message that was [observed](Inbox::observe).
    pub(crate) fn corrected(&self, sent_ns: Option<StampNs>) -> StampNs {
        sent_ns.map_or(self.arrived_ns, |sent_ns| sent_ns.saturating_add(self.shift_ns.unwrap_or(0)))
    }

    /// From here on stamps are corrected by the offset that is known, and by that after each jump.
    pub(crate) fn settle(&mut self, ctx: &mut Context) {
        let note = self.clock.settle();
        self.note_clock(note, ctx);
        let shift_ns = self.clock.offset_ns().unwrap_or(0);
        self.shift_ns = Some(shift_ns);
        ctx.warn(format!("stamps are corrected by {:.3} s, the offset of the sender's clock", shift_ns as f64 * 1e-9));
    }

    /// Whether stamps are corrected.
    pub(crate) fn is_corrected(&self) -> bool {
        self.shift_ns.is_some()
    }

    /// Whether the offset of the sender's clock was reported.
    pub(crate) fn knows_clock(&self) -> bool {
        self.clock.offset_ns().is_some()
    }

    /// When the last bytes arrived.
    pub(crate) fn arrived_ns(&self) -> StampNs {
        self.arrived_ns
    }

    /// Goes back to a message that arrived then.
    pub(crate) fn arrived_at(&mut self, arrived_ns: StampNs) {
        self.arrived_ns = arrived_ns;
    }

    fn note_clock(&mut self, note: Option<ClockNote>, ctx: &mut Context) {
        let Some(note) = note else { return };
        let corrected = match (note, &mut self.shift_ns) {
            (ClockNote::Offset(now) | ClockNote::Jump(_, now), Some(shift_ns)) => {
                *shift_ns = now;
                "; stamps are corrected by the new offset"
            }
            (ClockNote::Rate(_), Some(_)) => "; stamps are corrected by the last offset, which does not hold",
            (_, None) => "",
        };
        ctx.warn(format!("of the sender: {note}{corrected}"));
    }

    /// The peer has this device or topic.
    pub(crate) fn note_present(&mut self, stream: &str) {
        for port in self.ports.iter_mut().filter(|port| port.reads(stream)) {
            port.present.insert(stream.into());
        }
    }

    /// Offers a message of a device or topic to the ports that read it; `read` gives `None` where the port does not read messages
    /// of this type. Returns the newest stamp of the items if any port took it.
    pub(crate) fn offer(
        &mut self,
        stream: &str,
        ctx: &mut Context,
        mut read: impl FnMut(&mut Port<T>) -> Option<PortItems>,
    ) -> Option<StampNs> {
        let (mut newest_ns, mut notes, mut signs) = (None, Vec::new(), Vec::new());
        for (index, port) in self.ports.iter_mut().enumerate().filter(|(_, port)| port.reads(stream)) {
            let Some(out) = read(port) else { continue };
            newest_ns = newest_ns.max(out.items.iter().map(|(stamp_ns, _)| *stamp_ns).max().or(Some(0)));
            port.n_messages += 1;
            port.present.insert(stream.into());
            port.at_first.retain(|(topic, _)| !topic.is_empty() && topic != stream);
            notes.extend(out.notes);
            signs.extend(out.signs);
            self.fault = self.fault.take().or(out.fault);
            for (stamp_ns, body) in out.items {
                port.last_ns = port.last_ns.max(Some(stamp_ns));
                port.is_lost = false;
                self.message.push(Event { stamp_ns, port: index, body });
            }
        }
        notes.into_iter().for_each(|note| self.warn(stream, note, ctx));
        for (rule, sign) in signs {
            if let Some(sign) = self.counted(&format!("{rule} of {stream}"), sign) {
                ctx.sign(rule, sign);
            }
        }
        newest_ns
    }

    /// Hands the items of a message on; before them what it shows: flags that did not come, and tools that are lost by now.
    pub(super) fn flush(&mut self) {
        let message = std::mem::take(&mut self.message);
        let stamps = message.iter().map(|event| event.stamp_ns);
        // Constants have no time.
        let newest_ns = stamps.clone().max().unwrap_or(0);
        if newest_ns > 0 {
            let first_ns = stamps.filter(|ns| *ns > 0).min().unwrap_or(newest_ns);
            let has_item = message.iter().any(|event| self.ports[event.port].payload != "report/Flag");
            let mut before = Vec::new();
            for (index, port) in self.ports.iter_mut().enumerate() {
                if has_item && !std::mem::replace(&mut port.has_begun, true) {
                    for (_, body) in &port.at_first {
                        port.last_ns = port.last_ns.max(Some(first_ns));
                        before.push(Event { stamp_ns: first_ns, port: index, body: body.clone() });
                    }
                }
                let (Some(lost_after_ns), Some(last_ns)) = (port.lost_after_ns, port.last_ns) else { continue };
                let lost_ns = last_ns.saturating_add(lost_after_ns);
                if lost_ns < newest_ns && !std::mem::replace(&mut port.is_lost, true) {
                    let (streams, seconds) = (port.streams.join(", "), lost_after_ns as f64 * 1e-9);
                    let body = Emission::Empty(format!("{streams} was not sent for {seconds:.2} s"));
                    before.push(Event { stamp_ns: lost_ns, port: index, body });
                }
            }
            before.sort_by_key(|event| event.stamp_ns);
            self.events.extend(before);
            self.newest_ns = self.newest_ns.max(newest_ns);
        }
        self.events.extend(message);
    }

    /// Makes the poses of ports unknown: where a tool is while nobody says is unknown.
    pub(crate) fn lose(&mut self, reason: &str, is_lost: impl Fn(&Port<T>) -> bool) {
        for (index, port) in self.ports.iter().enumerate() {
            let was_seen = port.last_ns.is_some_and(|ns| ns > 0);
            if port.payload == "geometry/Pose" && was_seen && is_lost(port) {
                let body = Emission::Empty(format!("{}: {reason}", port.streams.join(", ")));
                self.events.push_back(Event { stamp_ns: self.newest_ns, port: index, body });
            }
        }
    }
}
