//! An output of a node: numbers its items and sends them over each link.

use super::{contracts::Silence, source_clock::MAX_STAMP_NS};
use crate::{
    channel::{LinkState, SendEnd},
    plan::OutputId,
    report::Failure,
    runtime::Runtime,
    scheduler::Turn,
    tap::Tap,
};
use osteoflow_node::{Body, Emission, Item, PortPayload, StampNs};

/// An output and the links it feeds.
pub(crate) struct Output {
    pub(crate) id: OutputId,
    pub(crate) payload: PortPayload,
    pub(crate) links: Vec<SendEnd>,
    /// Indices of the run's taps that listen to the wire.
    listeners: Vec<usize>,
    next_number: u64,
    /// Number of items that are values.
    pub(crate) n_values: u64,
    /// No further item may have an earlier stamp.
    pub(crate) floor: StampNs,
    pub(crate) late: Late,
    /// How long it may be silent.
    pub(crate) silence: Option<Box<Silence>>,
}

/// Items that a live source gave later than promised.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Late {
    /// Number of items.
    pub(crate) n_items: u64,
    /// Largest delay beyond the promise.
    pub(crate) most_ns: StampNs,
    /// The first: its number, its stamp, and the stamp up to which the wire was complete.
    pub(crate) first: (u64, StampNs, StampNs),
}

impl Output {
    pub(crate) fn new(id: OutputId, payload: PortPayload, links: Vec<SendEnd>, silence: Option<Box<Silence>>) -> Self {
        Self {
            id,
            payload,
            links,
            listeners: Vec::new(),
            next_number: 0,
            n_values: 0,
            floor: StampNs::MIN,
            late: Late::default(),
            silence,
        }
    }

    /// Number of items that a live source gave later than promised.
    pub(crate) fn n_late(&self) -> u64 {
        self.late.n_items
    }

    /// Number of items sent on the wire.
    pub(crate) fn n_items(&self) -> u64 {
        self.next_number
    }

    pub(crate) fn listen(&mut self, taps: &[&dyn Tap]) {
        self.listeners = (0..taps.len()).filter(|tap| taps[*tap].listens(self.id)).collect();
    }

    pub(crate) fn has_room(&mut self, states: &[LinkState]) -> bool {
        let mut room = true;
        for send in &mut self.links {
            // Checks every link, so that each full one notes that its producer is blocked.
            room &= send.has_room(&states[send.link]);
        }
        room
    }

    /// # Errors
    /// Index of a link that was full and must not be.
    pub(crate) fn send(
        &mut self,
        stamp_ns: StampNs,
        body: Body,
        run: &Runtime<'_>,
        turn: &mut Turn<'_>,
    ) -> Result<(), usize> {
        let item = Item { number: self.next_number, stamp_ns, body };
        self.next_number += 1;
        self.n_values += u64::from(item.body.value().is_some());
        self.floor = stamp_ns;
        if let Some(silence) = &mut self.silence
            && let Some(reason) = silence.note(&item, run.now())
        {
            run.fail(Failure::of_contract(self.id.node, item.number, &reason));
        }
        self.listeners.iter().for_each(|tap| run.taps[*tap].item(self.id, &item));
        let Some((last, others)) = self.links.split_last_mut() else { return Ok(()) };
        let mut full = None;
        let mut put = |send: &mut SendEnd, item: Item| {
            let link = send.link;
            if send.send(item, &run.links[link], &mut |number| run.dropped(link, number)).is_err() {
                full = full.or(Some(link));
            }
            turn.wake(run.plan.links[link].to_node);
        };
        others.iter_mut().for_each(|send| put(send, item.clone()));
        put(last, item);
        full.map_or(Ok(()), Err)
    }

    pub(crate) fn promise(&mut self, stamp_ns: StampNs, run: &Runtime<'_>, turn: &mut Turn<'_>) {
        if stamp_ns > self.floor {
            self.floor = stamp_ns;
            for send in self.links.iter().filter(|send| send.promise(&run.links[send.link], stamp_ns)) {
                turn.wake(run.plan.links[send.link].to_node);
            }
        }
    }

    pub(crate) fn close(&mut self, run: &Runtime<'_>, turn: &mut Turn<'_>) {
        for send in &mut self.links {
            send.close(&run.links[send.link]);
            turn.wake(run.plan.links[send.link].to_node);
        }
    }
}

/// Checks what every node promises of its emissions: one answer on each output, of its type, in the order of time.
/// Returns the violation.
pub fn emission_fault(
    payload: &PortPayload,
    floor: StampNs,
    emission: &Emission,
    is_source: bool,
    stamp_ns: StampNs,
) -> Option<String> {
    match (emission, payload) {
        _ if stamp_ns.unsigned_abs() > MAX_STAMP_NS => {
            Some(format!("gave stamp {stamp_ns} ns, more than 146 years from 1970; is it in nanoseconds?"))
        }
        (Emission::Silent, _) if is_source => None,
        (Emission::Silent, _) => Some("stayed silent, which only a source may".into()),
        (Emission::Value(value), PortPayload::Type(ty)) if value.ty() != *ty => {
            Some(format!("gave {:?}, {ty:?} expected", value.ty()))
        }
        _ if stamp_ns < floor => {
            Some(format!("gave stamp {stamp_ns} ns after {floor} ns; stamps never decrease along a wire"))
        }
        _ => None,
    }
}
