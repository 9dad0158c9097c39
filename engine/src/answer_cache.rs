//! Cached answers: taken from the store instead of firing, and written to it after a firing.
//!
//! The key of an answer covers everything that determines it: kind, program, parameters, what each port brought (the
//! payload's view, bit for bit; not number and stamp, which a cached node does not request) and, where the kind says
//! so, seed, node name and item. An answer consists of the node's emissions and warnings. A firing that fails or is
//! asked to stop is not cached.

#[cfg(test)]
mod tests;

use crate::{
    options::RunOptions,
    plan::{Plan, PlanNode},
    recording::codec,
    runtime::AnswerCache,
    store::{Key, KeyBuilder, Store, StoreEntry, decode, message, payload_of},
};
use osteoflow_container::Segments;
use osteoflow_node::{
    AnyNode, Body, CachePolicy, Context, Emission, Empty, Item, Joined, NodeError, PortPayload, Registry, Slot,
};
use std::{
    ops::Range,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
};

/// An answer that came from the store.
#[derive(Debug, Clone, PartialEq)]
pub struct CachedAnswer {
    /// The node that did not fire.
    pub node: String,
    /// Number of its activation.
    pub item: u64,
    /// The key of the answer.
    pub key: String,
}

/// The store as a run uses it.
pub(crate) struct StoredAnswers<'a> {
    store: Arc<Store>,
    plan: &'a Plan,
    registry: &'a Registry,
    /// Cache policy of each node; `None` where answers are not cached.
    nodes: Vec<Option<CachePolicy>>,
    cached_answers: Mutex<Vec<(usize, CachedAnswer)>>,
    /// The store cannot be written; the warning has been given.
    cannot_keep: AtomicBool,
}

/// Increase when the byte layout of an answer changes.
const LAYOUT: u64 = 1;

impl<'a> StoredAnswers<'a> {
    /// The answers in the store of the options, if they have one. Answers of a node with injected failures are not
    /// cached: it always fires.
    pub(crate) fn new(plan: &'a Plan, registry: &'a Registry, options: &RunOptions) -> Option<Self> {
        let policy = |node: &PlanNode| {
            let injected = options.inject.iter().any(|injection| *injection.node == *node.name);
            let policy = registry.kind(&node.kind).map_or(CachePolicy::Never, |kind| kind.description.cache);
            (policy != CachePolicy::Never && !injected).then_some(policy)
        };
        Some(Self {
            store: options.store.clone()?,
            plan,
            registry,
            nodes: plan.nodes.iter().map(policy).collect(),
            cached_answers: Mutex::default(),
            cannot_keep: AtomicBool::new(false),
        })
    }

    /// Cached answers used, in the order of the plan.
    pub(crate) fn finish(self) -> Vec<CachedAnswer> {
        let mut cached_answers = self.cached_answers.into_inner().unwrap_or_else(PoisonError::into_inner);
        cached_answers.sort_by_key(|(node, answer)| (*node, answer.item));
        cached_answers.into_iter().map(|(_, answer)| answer).collect()
    }

    /// Key of a firing's answer; `None` where the program is not known.
    fn key(&self, index: usize, kept: CachePolicy, joined: &Joined, context: &Context) -> Option<Key> {
        let node = &self.plan.nodes[index];
        let mut key = Key::of("answer")
            .number("layout", LAYOUT)
            .digest("program", self.store.program()?)
            .text("kind", &node.kind)
            .json("params", &node.params);
        if let Some(plugin) = &node.plugin {
            key = key.text("plugin", plugin);
        }
        if kept == CachePolicy::ByInputsAndSeed {
            key = key.number("seed", context.seed()).text("node", context.node()).number("item", context.item());
        }
        for (input, slot) in node.inputs.iter().zip(&joined.slots) {
            key = key.text("port", input.port.name);
            key = match slot {
                Slot::Item(item) => with_item(key, item),
                Slot::Items(items) => items.iter().fold(key.number("items", items.len() as u64), with_item),
                Slot::Absent(empty) => with_empty(key, "absent", empty),
            };
        }
        Some(key.done())
    }

    fn save(&self, key: &Key, out: &[Emission], context: &mut Context) {
        let Some(answer) = encode(out, context.warnings(), context.node()) else { return };
        let slices: Vec<&[u8]> = answer.iter().flat_map(Segments::slices).collect();
        if let Err(error) = self.store.put(key, &slices)
            && !self.cannot_keep.swap(true, Ordering::Relaxed)
        {
            context.warn(error.to_string());
        }
    }

    /// Decodes the emissions and warnings of the answer in an entry; `None` if it is not an answer of this node.
    fn read(&self, index: usize, entry: &StoreEntry) -> Option<(Vec<Emission>, Vec<String>)> {
        let outputs = &self.plan.nodes[index].outputs;
        let mut at = 0;
        let mut word = || -> Option<usize> {
            let bytes = entry.bytes().get(at..at + 8)?;
            at += 8;
            usize::try_from(u64::from_le_bytes(bytes.try_into().ok()?)).ok()
        };
        let (n_outputs, n_warnings) = (word()?, word()?);
        if n_outputs != outputs.len() || n_warnings > entry.bytes().len() {
            return None;
        }
        let lengths = (0..n_outputs + n_warnings).map(|_| word()).collect::<Option<Vec<_>>>()?;
        let mut ranges = lengths.into_iter().map(|n_bytes| {
            let range = at..at.checked_add(n_bytes)?;
            at = range.end.checked_next_multiple_of(8)?;
            Some(range)
        });
        let emissions = outputs.iter().map(|output| self.emission(output.payload, entry, ranges.next()??));
        let emissions = emissions.collect::<Option<Vec<_>>>()?;
        let text = |range: Option<Range<usize>>| String::from_utf8(entry.bytes().get(range?)?.to_vec()).ok();
        let warnings = ranges.map(text).collect::<Option<Vec<_>>>()?;
        Some((emissions, warnings))
    }

    fn emission(&self, port: PortPayload, entry: &StoreEntry, range: Range<usize>) -> Option<Emission> {
        let message = decode(entry, range).ok()?;
        if let Err(empty) = message.body {
            return Some(Emission::Empty(empty.reason));
        }
        let ty = match port {
            PortPayload::Type(ty) => ty,
            PortPayload::Any => self.registry.payload_type(&message.payload.as_ref()?.0)?,
        };
        payload_of(message, ty).map(Emission::Value)
    }
}

impl AnswerCache for StoredAnswers<'_> {
    fn caches(&self, node: usize) -> bool {
        self.nodes[node].is_some()
    }

    fn fire(
        &self,
        index: usize,
        node: &mut dyn AnyNode,
        joined: &mut Joined,
        out: &mut [Emission],
        context: &mut Context,
    ) -> Result<(), NodeError> {
        let key = self.nodes[index].and_then(|kept| Some((kept, self.key(index, kept, joined, context)?)));
        let Some((kept, key)) = key else { return node.fire(joined, out, context) };
        if let Some((emissions, warnings)) = self.store.get(&key).and_then(|entry| self.read(index, &entry)) {
            out.iter_mut().zip(emissions).for_each(|(place, emission)| *place = emission);
            warnings.into_iter().for_each(|warning| context.warn(warning));
            let node = self.plan.nodes[index].name.to_string();
            let answer = CachedAnswer { node, item: context.item(), key: key.to_string() };
            self.cached_answers.lock().unwrap_or_else(PoisonError::into_inner).push((index, answer));
            return Ok(());
        }
        context.track_use();
        node.fire(joined, out, context)?;
        if !context.is_cacheable(kept) {
            let kind = &self.plan.nodes[index].kind;
            context.warn(format!(
                "this answer is not kept: {kind} says that it is decided {}, but took more from its context",
                if kept == CachePolicy::ByInputs { "by its inputs" } else { "by its inputs and its seed" }
            ));
        } else if !context.saw_stop() && !self.cannot_keep.load(Ordering::Relaxed) {
            self.save(&key, out, context);
        }
        Ok(())
    }
}

fn with_item(key: KeyBuilder, item: &Item) -> KeyBuilder {
    match &item.body {
        Body::Value(value) => key.value("value", value),
        Body::Empty(empty) => with_empty(key, "empty", empty),
    }
}

fn with_empty(key: KeyBuilder, what: &str, empty: &Empty) -> KeyBuilder {
    key.text(what, &empty.node).text("reason", &empty.reason)
}

/// Encodes an answer for the store: the number of outputs and of warnings and the length of each (u64, little-endian),
/// then the messages of the outputs and the texts of the warnings, each at a multiple of 8. `None` if an output was
/// silent.
fn encode(out: &[Emission], warnings: &[String], node: &str) -> Option<Vec<Segments>> {
    let empty = |empty: Empty| {
        let item = Item { number: 0, stamp_ns: 0, body: Body::Empty(Arc::new(empty)) };
        codec::parts_on(PortPayload::Any, &item)
    };
    let mut messages = Vec::with_capacity(1 + out.len() + warnings.len());
    messages.push(Segments::default());
    for emission in out {
        messages.push(match emission {
            Emission::Value(value) => message(value),
            Emission::Empty(reason) => empty(Empty { node: node.into(), reason: reason.clone() }),
            Emission::PassedOn(_) | Emission::Silent => return None,
        });
    }
    for warning in warnings {
        let mut text = Segments::default();
        text.tail().extend_from_slice(warning.as_bytes());
        messages.push(text);
    }
    let lengths = messages[1..].iter().map(|message| message.len() as u64).collect::<Vec<_>>();
    let head = [out.len() as u64, warnings.len() as u64].into_iter().chain(lengths);
    messages[0].tail().extend(head.flat_map(u64::to_le_bytes));
    for message in &mut messages {
        let n_zeros = message.len().next_multiple_of(8) - message.len();
        message.tail().extend_from_slice(&[0; 8][..n_zeros]);
    }
    Some(messages)
}
