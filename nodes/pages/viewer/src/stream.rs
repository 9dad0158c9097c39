//! Channels with the last message of each, and the queues of the viewers.
//!
//! Publishing never waits: a viewer that reads too slowly loses messages of its own, the oldest first, but never the
//! last one of a channel. Clouds that are late are lost where a newer one waits, so that no viewer shows the past as the present.

use crate::protocol::{self, Level};
use osteoflow_engine::run::{ListenedChannel, Listener};
use serde_json::{Value, json};
use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

/// Bytes that may wait for a viewer: two seconds of 20,000 points with normals at 20 Hz, twice.
const MAX_WAITING_BYTES: usize = 64 << 20;
/// Bytes of replies that may wait for a viewer; one that asks and does not read is left.
const MAX_WAITING_REPLIES: usize = 16 << 20;
/// How long a bulky message may wait where a newer one of its channel does, too.
const MAX_WAIT: Duration = Duration::from_secs(1);
/// Bytes of a bulky message. Smaller ones, such as poses and warnings, do not keep a viewer from the present.
const BULKY: usize = 16 << 10;

/// Channels of the server itself are numbered down from here, those of runs and recordings up from 1.
const OWN_CHANNELS: u32 = u32::MAX;

/// Channels of a run whose messages add up, and the one that has their sums.
pub(crate) const TIMING: &str = "/run/timing";
pub(crate) const DROPS: &str = "/run/drops";
/// The schema of transforms.
pub(crate) const TRANSFORM: &str = "foxglove.FrameTransform";
const NODES: &str = "/viewer/nodes";

/// What a node has done so far.
#[derive(Debug, Clone, Copy, Default)]
struct NodeSum {
    n_firings: u64,
    ms: f64,
    n_dropped: u64,
}

/// A message of a channel.
#[derive(Debug)]
struct Message {
    channel: u32,
    log_time_ns: u64,
    data: Vec<u8>,
}

/// The channels of a run or a recording, and who views them.
#[derive(Debug, Default)]
pub struct Stream(Mutex<Hub>);

#[derive(Debug, Default)]
struct Hub {
    /// Channels by the number that viewers know.
    channels: BTreeMap<u32, ListenedChannel>,
    /// Added to the number that a run has for a channel: no number is used again after [`Stream::restart`].
    offset: u32,
    last: BTreeMap<u32, Arc<Message>>,
    own: BTreeMap<String, u32>,
    nodes: BTreeMap<String, NodeSum>,
    viewers: Vec<Arc<Viewer>>,
    totals: Totals,
}

/// Numbers of messages of all viewers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Totals {
    /// Messages that were sent.
    pub n_sent: u64,
    /// Messages that slow viewers have lost.
    pub n_dropped: u64,
}

impl Stream {
    fn hub(&self) -> MutexGuard<'_, Hub> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Publishes JSON on a channel of the server itself.
    pub fn publish(&self, topic: &str, value: &Value) {
        self.hub().publish_own(topic, value);
    }

    /// Forgets the last message of each channel, and what waits for viewers: the time of a recording jumps.
    pub fn forget(&self) {
        let mut hub = self.hub();
        let own: BTreeSet<u32> = hub.own.values().copied().collect();
        hub.last.retain(|channel, _| own.contains(channel));
        hub.nodes.clear();
        hub.viewers.iter().for_each(|viewer| viewer.forget());
    }

    /// Removes the channels of a run that has ended: another run begins.
    pub fn restart(&self) {
        self.forget();
        let mut hub = self.hub();
        let own: BTreeSet<u32> = hub.own.values().copied().collect();
        let gone: Vec<u32> = hub.channels.keys().copied().filter(|id| !own.contains(id)).collect();
        hub.channels.retain(|id, _| own.contains(id));
        hub.offset = gone.iter().copied().max().unwrap_or(hub.offset);
        for viewer in &hub.viewers {
            gone.iter().for_each(|channel| viewer.unsubscribe_from(*channel));
            viewer.send(Out::Text(protocol::unadvertise(&gone)));
        }
    }

    /// Sends the values of parameters to all viewers.
    pub fn publish_parameters(&self, values: &[(String, Value)]) {
        self.send_to_all(&Out::Text(protocol::parameter_values(values, None)));
    }

    /// Sends a control message to all viewers.
    pub(crate) fn send_to_all(&self, message: &Out) {
        self.hub().viewers.iter().for_each(|viewer| viewer.send(message.clone()));
    }

    /// Numbers of viewers and messages so far.
    pub fn totals(&self) -> Totals {
        let hub = self.hub();
        hub.viewers.iter().fold(hub.totals, |totals, viewer| totals.with(viewer))
    }

    pub(crate) fn join(&self) -> Arc<Viewer> {
        let viewer = Arc::new(Viewer::default());
        let mut hub = self.hub();
        viewer.send(Out::Text(protocol::advertise(&hub.channels)));
        hub.viewers.push(viewer.clone());
        viewer
    }

    pub(crate) fn leave(&self, viewer: &Arc<Viewer>) {
        viewer.close();
        let mut hub = self.hub();
        hub.totals = hub.totals.with(viewer);
        hub.viewers.retain(|other| !Arc::ptr_eq(other, viewer));
    }

    /// Subscribes, and sends the last message of the channel.
    ///
    /// # Errors
    /// A sentence if there is no such channel, or the viewer has used this number already.
    pub(crate) fn subscribe(&self, viewer: &Viewer, subscription: u32, channel: u32) -> Result<(), String> {
        let hub = self.hub();
        if !hub.channels.contains_key(&channel) {
            return Err(format!("there is no channel {channel}"));
        }
        viewer.subscribe(subscription, channel)?;
        if let Some(last) = hub.last.get(&channel) {
            viewer.offer(last);
        }
        Ok(())
    }

    /// Closes all viewers after what they have not received yet.
    pub(crate) fn end(&self) {
        self.hub().viewers.iter().for_each(|viewer| viewer.end());
    }
}

impl Listener for Stream {
    fn channel(&self, channel: ListenedChannel) {
        let mut hub = self.hub();
        let id = hub.offset + u32::from(channel.id);
        hub.add(id, channel);
    }

    fn message(&self, channel: u16, log_time_ns: u64, data: Vec<u8>) {
        let mut hub = self.hub();
        let message = Message { channel: hub.offset + u32::from(channel), log_time_ns, data };
        hub.add_up(&message);
        hub.publish(message);
    }
}

impl Hub {
    fn publish_own(&mut self, topic: &str, value: &Value) {
        let known = self.own.get(topic).copied();
        let id = known.unwrap_or_else(|| {
            let id = OWN_CHANNELS - self.own.len() as u32;
            self.own.insert(topic.into(), id);
            let channel = ListenedChannel {
                id: 0,
                topic: topic.into(),
                encoding: "json".into(),
                schema_name: topic.trim_start_matches('/').replace('/', "."),
                schema_encoding: "jsonschema".into(),
                schema: protocol::ANY_OBJECT.as_bytes().into(),
                metadata: BTreeMap::new(),
            };
            self.add(id, channel);
            id
        });
        self.publish(Message { channel: id, log_time_ns: 1, data: value.to_string().into_bytes() });
    }

    /// Adds up what nodes have done, so that a viewer that comes late knows it, too.
    fn add_up(&mut self, message: &Message) {
        let Some(topic) = self.channels.get(&message.channel).map(|channel| channel.topic.as_str()) else { return };
        let (is_timing, is_drops) = (topic == TIMING, topic == DROPS);
        if !is_timing && !is_drops {
            return;
        }
        let Ok(record) = serde_json::from_slice::<Value>(&message.data) else { return };
        for firing in record["firings"].as_array().into_iter().flatten().filter(|_| is_timing) {
            let Some(node) = firing[0].as_str() else { continue };
            let sum = self.nodes.entry(node.into()).or_default();
            sum.n_firings += 1;
            sum.ms += firing[3].as_f64().unwrap_or(0.0) / 1e6;
        }
        for drop in record["drops"].as_array().into_iter().flatten().filter(|_| is_drops) {
            let Some((node, _)) = drop[1].as_str().and_then(|input| input.rsplit_once('.')) else { continue };
            self.nodes.entry(node.into()).or_default().n_dropped += 1;
        }
        let row = |(name, sum): (&String, &NodeSum)| (name.clone(), json!([sum.n_firings, sum.ms, sum.n_dropped]));
        let rows: serde_json::Map<String, Value> = self.nodes.iter().map(row).collect();
        self.publish_own(NODES, &Value::Object(rows));
    }

    fn add(&mut self, id: u32, channel: ListenedChannel) {
        let text = protocol::advertise([(&id, &channel)]);
        self.viewers.iter().for_each(|viewer| viewer.send(Out::Text(text.clone())));
        self.channels.insert(id, channel);
    }

    fn publish(&mut self, message: Message) {
        let message = Arc::new(message);
        self.viewers.iter().for_each(|viewer| viewer.offer(&message));
        self.last.insert(message.channel, message);
    }
}

impl Totals {
    fn with(self, viewer: &Viewer) -> Self {
        let queue = viewer.queue();
        Self { n_sent: self.n_sent + queue.n_sent, n_dropped: self.n_dropped + queue.n_dropped }
    }
}

/// A message of the protocol.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Out {
    Text(String),
    Binary(Vec<u8>),
}

/// A viewer's queue.
#[derive(Debug, Default)]
pub(crate) struct Viewer {
    queue: Mutex<Queue>,
    filled: Condvar,
}

#[derive(Debug, Default)]
struct Queue {
    control: VecDeque<Out>,
    n_control_bytes: usize,
    /// With the time since when they wait.
    messages: VecDeque<(Instant, Arc<Message>)>,
    n_bytes: usize,
    /// Number of waiting messages of each channel.
    n_of: BTreeMap<u32, usize>,
    /// Channel of each subscription.
    subscriptions: BTreeMap<u32, u32>,
    /// Whether the viewer has asked for the state of a playback.
    takes_playback: bool,
    n_sent: u64,
    n_dropped: u64,
    /// Messages lost when the viewer was last informed.
    n_informed: u64,
    ends: bool,
    is_closed: bool,
}

impl Viewer {
    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sends the state of a playback from now on. Viewers that have not asked for it take it for an error.
    pub(crate) fn take_playback(&self) {
        self.queue().takes_playback = true;
    }

    pub(crate) fn send(&self, message: Out) {
        let mut queue = self.queue();
        if queue.is_closed {
            return;
        }
        if queue.takes_playback
            || !matches!(&message, Out::Binary(bytes) if bytes.first() == Some(&protocol::PLAYBACK_STATE))
        {
            queue.n_control_bytes += match &message {
                Out::Text(text) => text.len(),
                Out::Binary(bytes) => bytes.len(),
            };
            queue.is_closed |= queue.n_control_bytes > MAX_WAITING_REPLIES;
            queue.control.push_back(message);
            self.filled.notify_one();
        }
    }

    fn subscribe(&self, subscription: u32, channel: u32) -> Result<(), String> {
        let mut queue = self.queue();
        // Each would be sent every message.
        if queue.subscriptions.iter().any(|(id, subscribed)| *subscribed == channel && *id != subscription) {
            return Err(format!("channel {channel} is subscribed already; once is enough"));
        }
        match queue.subscriptions.insert(subscription, channel) {
            None => Ok(()),
            Some(_) => Err(format!("subscription {subscription} is used twice")),
        }
    }

    pub(crate) fn unsubscribe(&self, subscription: u32) {
        self.queue().subscriptions.remove(&subscription);
    }

    fn unsubscribe_from(&self, channel: u32) {
        self.queue().subscriptions.retain(|_, subscribed| *subscribed != channel);
    }

    /// Queues a message if it is subscribed to.
    fn offer(&self, message: &Arc<Message>) {
        let mut queue = self.queue();
        if queue.is_closed || !queue.subscriptions.values().any(|channel| *channel == message.channel) {
            return;
        }
        queue.n_bytes += message.data.len();
        *queue.n_of.entry(message.channel).or_default() += 1;
        queue.messages.push_back((Instant::now(), message.clone()));
        while queue.n_bytes > MAX_WAITING_BYTES && queue.leave_out(|_, _| true) {}
        drop(queue);
        self.filled.notify_one();
    }

    fn forget(&self) {
        let mut queue = self.queue();
        queue.messages.clear();
        queue.n_of.clear();
        queue.n_bytes = 0;
    }

    /// Next messages to send, at most one item of data; `None` if there will be no more. Empty after `patience`.
    pub(crate) fn take(&self, patience: Duration) -> Option<Vec<Out>> {
        let mut queue = self.queue();
        if queue.control.is_empty() && queue.messages.is_empty() && !queue.is_closed && !queue.ends {
            queue = self.filled.wait_timeout(queue, patience).unwrap_or_else(PoisonError::into_inner).0;
        }
        if queue.is_closed {
            return None;
        }
        queue.leave_out_late(Instant::now());
        let mut out: Vec<Out> = queue.control.drain(..).collect();
        queue.n_control_bytes = 0;
        if let Some((_, message)) = queue.messages.pop_front() {
            queue.took(&message);
            let of_channel = |(_, channel): &(&u32, &u32)| **channel == message.channel;
            let subscriptions: Vec<u32> = queue.subscriptions.iter().filter(of_channel).map(|(id, _)| *id).collect();
            queue.n_sent += subscriptions.len() as u64;
            out.extend(
                subscriptions.iter().map(|id| Out::Binary(protocol::message(*id, message.log_time_ns, &message.data))),
            );
        } else if queue.ends && out.is_empty() {
            return None;
        }
        if queue.n_dropped > queue.n_informed {
            queue.n_informed = queue.n_dropped;
            let (n_dropped, n_all) = (queue.n_dropped, queue.n_dropped + queue.n_sent);
            let text = format!("this viewer reads too slowly: {n_dropped} of {n_all} messages were left out");
            out.push(Out::Text(protocol::status(Level::Warning, &text, "slow")));
        }
        Some(out)
    }

    fn end(&self) {
        self.queue().ends = true;
        self.filled.notify_one();
    }

    /// Whether it is left, as one that asks and does not read.
    pub(crate) fn is_closed(&self) -> bool {
        self.queue().is_closed
    }

    fn close(&self) {
        self.queue().is_closed = true;
        self.filled.notify_one();
    }
}

impl Queue {
    /// Leaves out the first message for which this holds and after which another of its channel waits.
    fn leave_out(&mut self, may_go: impl Fn(Instant, &Message) -> bool) -> bool {
        let is_replaced = |message: &Message| self.n_of.get(&message.channel) > Some(&1);
        let at = self.messages.iter().position(|(since, message)| is_replaced(message) && may_go(*since, message));
        let Some((_, message)) = at.and_then(|at| self.messages.remove(at)) else { return false };
        self.n_dropped += 1;
        self.took(&message);
        true
    }

    fn leave_out_late(&mut self, now: Instant) {
        while self.leave_out(|since, message| message.data.len() >= BULKY && now.duration_since(since) > MAX_WAIT) {}
    }

    fn took(&mut self, message: &Message) {
        self.n_bytes -= message.data.len();
        if let Some(n) = self.n_of.get_mut(&message.channel) {
            *n -= 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: Duration = Duration::ZERO;

    fn channel(id: u16) -> ListenedChannel {
        ListenedChannel {
            id,
            topic: format!("/{id}"),
            encoding: "json".into(),
            schema_name: "s".into(),
            schema_encoding: String::new(),
            schema: [].into(),
            metadata: BTreeMap::new(),
        }
    }

    /// The first byte of data of the messages that come out.
    fn received(viewer: &Viewer) -> Vec<u8> {
        received_and_status(viewer).0
    }

    /// The same, and the last status.
    fn received_and_status(viewer: &Viewer) -> (Vec<u8>, String) {
        let (mut out, mut status) = (Vec::new(), String::new());
        while let Some(messages) = viewer.take(NOW).filter(|messages| !messages.is_empty()) {
            out.extend(messages.into_iter().filter_map(|message| match message {
                Out::Binary(bytes) => Some(bytes[13]),
                Out::Text(text) => {
                    status = text;
                    None
                }
            }));
        }
        (out, status)
    }

    #[test]
    fn who_comes_late_gets_the_last_message_of_each_channel() {
        let stream = Stream::default();
        [1, 2].into_iter().for_each(|id| stream.channel(channel(id)));
        [(1, 10), (1, 11), (2, 20)].into_iter().for_each(|(id, byte)| stream.message(id, 1, vec![byte]));
        let viewer = stream.join();
        assert!(stream.subscribe(&viewer, 5, 1).is_ok() && stream.subscribe(&viewer, 6, 2).is_ok());
        assert_eq!(received(&viewer), [11, 20]);
        stream.message(1, 1, vec![12]);
        assert_eq!(received(&viewer), [12]);
        viewer.unsubscribe(5);
        stream.message(1, 1, vec![13]);
        assert_eq!(received(&viewer), [] as [u8; 0]);
        assert!(stream.subscribe(&viewer, 6, 1).is_err(), "a number twice");
        assert!(stream.subscribe(&viewer, 7, 3).is_err() && stream.subscribe(&viewer, 7, 70_000).is_err());
    }

    #[test]
    fn late_clouds_are_left_out_where_a_newer_one_waits_and_nothing_else() {
        let stream = Stream::default();
        [1, 2, 3].into_iter().for_each(|id| stream.channel(channel(id)));
        let viewer = stream.join();
        [1, 2, 3].into_iter().for_each(|id| stream.subscribe(&viewer, id, id).unwrap());
        // Clouds on the first channel, the only one of the second, poses on the third.
        stream.message(2, 1, vec![20; BULKY]);
        for k in 0..3 {
            stream.message(1, 1, vec![10 + k; BULKY]);
            stream.message(3, 1, vec![30 + k; BULKY - 1]);
        }
        viewer.queue().leave_out_late(Instant::now());
        assert_eq!(viewer.queue().messages.len(), 7, "nothing is late");
        viewer.queue().leave_out_late(Instant::now() + 2 * MAX_WAIT);
        let (got, status) = received_and_status(&viewer);
        assert_eq!(got, [20, 30, 31, 12, 32]);
        assert!(status.contains("too slowly: 2 of "), "{status}");
    }

    #[test]
    fn a_slow_viewer_loses_its_oldest_messages_but_the_last_of_no_channel() {
        let stream = Stream::default();
        [1, 2].into_iter().for_each(|id| stream.channel(channel(id)));
        let (slow, quick) = (stream.join(), stream.join());
        for viewer in [&slow, &quick] {
            [1, 2].into_iter().for_each(|id| stream.subscribe(viewer, id, id).unwrap());
        }
        stream.message(2, 1, vec![200; MAX_WAITING_BYTES / 4]);
        let mut quick_got = received(&quick);
        for k in 0..10 {
            stream.message(1, 1, vec![k; MAX_WAITING_BYTES / 4]);
            quick_got.extend(received(&quick));
        }
        assert_eq!(quick_got, [200, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9]);
        let (got, status) = received_and_status(&slow);
        assert_eq!(got, [200, 7, 8, 9], "the only message of channel 2 stays");
        assert!(status.contains("too slowly: 7 of 8"), "{status}");
        assert_eq!(stream.totals(), Totals { n_sent: 15, n_dropped: 7 });
        [slow, quick].into_iter().for_each(|viewer| stream.leave(&viewer));
        assert_eq!(stream.totals(), Totals { n_sent: 15, n_dropped: 7 });
    }

    #[test]
    fn what_nodes_have_done_is_added_up_for_who_comes_late() {
        let stream = Stream::default();
        for (id, topic) in [(1, TIMING), (2, DROPS)] {
            stream.channel(ListenedChannel { topic: topic.into(), ..channel(id) });
        }
        let records = [
            (1, json!({ "firings": [["icp", 0, 5, 2_000_000], ["crop", 0, 5, 500_000]] })),
            (1, json!({ "firings": [["icp", 1, 9, 4_000_000]] })),
            (2, json!({ "drops": [["scan.cloud", "m.crop.cloud", 3]] })),
            (1, json!("nonsense")),
        ];
        records.into_iter().for_each(|(id, message)| stream.message(id, 1, message.to_string().into_bytes()));
        stream.message(1, 1, b"{".to_vec());
        let sums = |stream: &Stream| {
            let hub = stream.hub();
            let last = hub.last[&hub.own[NODES]].clone();
            serde_json::from_slice::<Value>(&last.data).unwrap()
        };
        assert_eq!(sums(&stream), json!({ "crop": [1, 0.5, 0], "icp": [2, 6.0, 0], "m.crop": [0, 0.0, 1] }));
        stream.forget();
        stream.message(1, 1, json!({ "firings": [["icp", 1, 9, 4_000_000]] }).to_string().into_bytes());
        assert_eq!(sums(&stream), json!({ "icp": [1, 4.0, 0] }));
    }

    #[test]
    fn a_restart_takes_the_channels_away_and_uses_no_number_again() {
        let stream = Stream::default();
        stream.publish("/own", &json!({}));
        [1, 2].into_iter().for_each(|id| stream.channel(channel(id)));
        let viewer = stream.join();
        [1, 2, OWN_CHANNELS].into_iter().for_each(|id| stream.subscribe(&viewer, id, id).unwrap());
        received(&viewer);
        stream.message(1, 1, vec![1]);
        stream.restart();
        let (got, text) = received_and_status(&viewer);
        assert_eq!((got.as_slice(), text.as_str()), (&[][..], r#"{"op":"unadvertise","channelIds":[1,2]}"#));
        // A request that was under way names a channel that is gone, and gets none of the next run.
        assert!(stream.subscribe(&viewer, 1, 1).is_err());
        stream.channel(channel(1));
        stream.message(1, 1, vec![3]);
        assert_eq!(received(&viewer), [] as [u8; 0]);
        stream.subscribe(&viewer, 3, 3).unwrap();
        assert_eq!(received(&viewer), [3]);
        stream.publish("/own", &json!({}));
        assert_eq!(received(&viewer).len(), 1, "channels of the server stay");
        stream.restart();
        stream.restart();
        stream.channel(channel(1));
        assert!(stream.subscribe(&viewer, 4, 4).is_ok());
    }

    #[test]
    fn a_viewer_that_asks_and_does_not_read_is_left() {
        let stream = Stream::default();
        let (asks, reads) = (stream.join(), stream.join());
        for _ in 0..17 {
            [&asks, &reads].into_iter().for_each(|viewer| viewer.send(Out::Binary(vec![0; 1 << 20])));
            assert!(reads.take(NOW).is_some());
        }
        assert_eq!(asks.take(NOW), None);
    }

    #[test]
    fn a_stream_that_ends_is_sent_to_its_end() {
        let stream = Stream::default();
        stream.channel(channel(1));
        let viewer = stream.join();
        stream.subscribe(&viewer, 1, 1).unwrap();
        [1, 2].into_iter().for_each(|byte| stream.message(1, 1, vec![byte]));
        stream.end();
        assert_eq!(received(&viewer), [1, 2]);
        assert_eq!(viewer.take(NOW), None);
    }
}
