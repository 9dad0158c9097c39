//! Pictures of answers, such as planes. Whether a run is refused is known at its end only, so the file gets them then; listeners
//! get them while the run goes on, as long as its verdict so far trusts them.

use crate::plan::{OutputId, Plan};
use osteoflow_container::MessageHeader;
use osteoflow_node::Item;
use std::collections::BTreeMap;

/// Maximum size of the pictures that wait for the end of the run; later ones are left out and counted.
const MAX_HELD_BYTES: usize = 64 << 20;
/// The key of the verdict in the results, the key of its answer, and the answer that lets pictures pass.
const VERDICT: &str = "verdict";
const ANSWER: &str = "answer";
const TRUSTED: &str = "trusted";

/// A message for viewers.
pub(super) type Message = (MessageHeader, Vec<u8>);

/// The pictures of answers of a run.
#[derive(Debug, Default)]
pub(super) struct Answers {
    /// The wire of the run's verdict.
    verdict: Option<OutputId>,
    is_trusted: bool,
    channels: BTreeMap<u16, Channel>,
    held: Vec<Message>,
    n_held_bytes: usize,
    n_left_out: usize,
}

/// A channel of answers.
#[derive(Debug)]
struct Channel {
    /// The message that removes what was shown.
    removal: Vec<u8>,
    last: Option<Message>,
    /// Whether listeners have a picture.
    is_shown: bool,
}

impl Answers {
    /// Of a run whose verdict is recorded; without one listeners get no pictures before the end.
    pub(super) fn new(plan: &Plan) -> Self {
        let entry = plan.results.iter().find(|entry| entry.key == VERDICT);
        Self { verdict: entry.map(|entry| entry.from), ..Self::default() }
    }

    /// Adds a channel; a payload without a `removal` is not shown before the end.
    pub(super) fn add(&mut self, id: u16, removal: &[u8]) {
        if !removal.is_empty() {
            self.channels.insert(id, Channel { removal: removal.into(), last: None, is_shown: false });
        }
    }

    /// Holds a picture for the end. Returns what listeners get now.
    pub(super) fn hold(&mut self, picture: Message) -> Option<Message> {
        let now = self.channels.get_mut(&picture.0.channel_id).and_then(|channel| {
            channel.last = Some(picture.clone());
            channel.is_shown |= self.is_trusted;
            self.is_trusted.then(|| picture.clone())
        });
        if self.n_held_bytes.saturating_add(picture.1.len()) > MAX_HELD_BYTES {
            self.n_left_out += 1;
        } else {
            self.n_held_bytes += picture.1.len();
            self.held.push(picture);
        }
        now
    }

    /// A channel has no value now. Returns what listeners get.
    pub(super) fn lost(&mut self, id: u16, time_ns: u64) -> Option<Message> {
        let channel = self.channels.get_mut(&id)?;
        channel.last = None;
        channel.removed(id, time_ns)
    }

    /// The wire of the run's verdict.
    pub(super) fn verdict(&self) -> Option<OutputId> {
        self.verdict
    }

    /// Follows the verdict. Returns what listeners get: the last pictures once it trusts, their removal once it does not.
    pub(super) fn judge(&mut self, wire: OutputId, item: &Item, time_ns: u64) -> Vec<Message> {
        if self.verdict != Some(wire) {
            return Vec::new();
        }
        let was_trusted = self.is_trusted;
        self.is_trusted = item.body.value().is_some_and(|value| value.to_result()[ANSWER] == TRUSTED);
        match (was_trusted, self.is_trusted) {
            (false, true) => self.channels.values_mut().filter_map(Channel::shown).collect(),
            (true, false) => self.remove_all(time_ns),
            _ => Vec::new(),
        }
    }

    /// The removal of all pictures that listeners have.
    pub(super) fn remove_all(&mut self, time_ns: u64) -> Vec<Message> {
        self.channels.iter_mut().filter_map(|(id, channel)| channel.removed(*id, time_ns)).collect()
    }

    /// The pictures that waited for the end, and the number of those that were left out.
    pub(super) fn take_held(&mut self) -> (Vec<Message>, usize) {
        (std::mem::take(&mut self.held), self.n_left_out)
    }
}

impl Channel {
    fn shown(&mut self) -> Option<Message> {
        self.is_shown |= self.last.is_some();
        self.last.clone()
    }

    fn removed(&mut self, channel_id: u16, time_ns: u64) -> Option<Message> {
        let head = MessageHeader { channel_id, sequence: 0, log_time: time_ns, publish_time: time_ns };
        std::mem::take(&mut self.is_shown).then(|| (head, self.removal.clone()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_node::{Body, Empty, Value};
    use osteoflow_toy::Judgement;
    use serde_json::json;
    use std::sync::Arc;

    const WIRE: OutputId = OutputId { node: 3, port: 0 };
    const GONE: &[u8] = b"gone";

    fn answers() -> Answers {
        let mut answers = Answers { verdict: Some(WIRE), ..Answers::default() };
        answers.add(7, GONE);
        answers.add(8, b"");
        answers
    }

    fn picture(channel_id: u16, byte: u8) -> Message {
        (MessageHeader { channel_id, sequence: 0, log_time: 1, publish_time: 1 }, vec![byte])
    }

    fn bytes(messages: impl IntoIterator<Item = Message>) -> Vec<(u16, Vec<u8>)> {
        messages.into_iter().map(|(head, bytes)| (head.channel_id, bytes)).collect()
    }

    fn judged(answers: &mut Answers, answer: Option<&str>) -> Vec<(u16, Vec<u8>)> {
        let body = match answer {
            Some(answer) => Body::Value(Value::new(Judgement(json!({ "answer": answer })))),
            None => Body::Empty(Arc::new(Empty { node: "n".into(), reason: "why".into() })),
        };
        bytes(answers.judge(WIRE, &Item { number: 0, stamp_ns: 5, body }, 5))
    }

    #[test]
    fn pictures_pass_while_the_verdict_trusts_and_are_removed_once_it_does_not() {
        for (other, n_held) in [(Some("refused"), 3), (Some("doubtful"), 3), (None, 3)] {
            let mut answers = answers();
            assert_eq!(bytes(answers.hold(picture(7, 1))), [], "not judged yet");
            assert_eq!(judged(&mut answers, other), []);
            assert_eq!(judged(&mut answers, Some("trusted")), [(7, vec![1])], "the last one, once it is trusted");
            assert_eq!(judged(&mut answers, Some("trusted")), []);
            assert_eq!(bytes(answers.hold(picture(7, 2))), [(7, vec![2])]);
            assert_eq!(judged(&mut answers, other), [(7, GONE.to_vec())], "{other:?}");
            assert_eq!(bytes(answers.hold(picture(7, 3))), []);
            assert_eq!(judged(&mut answers, other), [], "removed once");
            assert_eq!(answers.take_held().0.len(), n_held, "the file gets all of them at the end");
        }
    }

    #[test]
    fn a_lost_answer_is_removed_and_does_not_come_back_with_the_next_verdict() {
        let mut answers = answers();
        judged(&mut answers, Some("trusted"));
        answers.hold(picture(7, 1));
        assert_eq!(bytes(answers.lost(7, 9)), [(7, GONE.to_vec())]);
        judged(&mut answers, Some("refused"));
        assert_eq!(judged(&mut answers, Some("trusted")), []);
    }

    #[test]
    fn what_cannot_be_removed_is_not_shown_before_the_end_and_other_wires_judge_nothing() {
        let mut answers = answers();
        judged(&mut answers, Some("trusted"));
        assert_eq!(bytes(answers.hold(picture(8, 1))), []);
        answers.hold(picture(7, 1));
        let other = OutputId { node: 4, port: 0 };
        let empty = Body::Empty(Arc::new(Empty { node: "n".into(), reason: "why".into() }));
        assert_eq!(bytes(answers.judge(other, &Item { number: 0, stamp_ns: 5, body: empty }, 5)), []);
        assert_eq!(bytes(answers.remove_all(5)), [(7, GONE.to_vec())], "a run that ends without an answer");
    }
}
