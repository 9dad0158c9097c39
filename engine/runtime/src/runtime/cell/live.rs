//! Live sources in a cell: asks the source when there is room, and sends the answers that arrive from its thread.

use super::{
    Cell, Core, Firing, Phase, call_node,
    output::{Late, Output},
    source_clock::{Judged, SourceClock},
    stamp_or_zero,
};
use crate::{
    activity::{Doing, Name},
    plan::Plan,
    report::{Event, Failure, Warning},
    runtime::Runtime,
    scheduler::Turn,
};
use osteoflow_node::{AnySource, Context, Emission, NodeError, StampNs};
use std::{
    collections::VecDeque,
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

/// The cell's state of a live source.
pub(crate) struct LiveCore {
    /// Maximum delay of an item relative to the newest.
    pub(crate) max_delay_ns: StampNs,
    /// Newest stamp of all outputs.
    pub(crate) newest_ns: StampNs,
    /// It is not asked, because an output has no room.
    pub(crate) waits: bool,
    /// When it was asked again after that; none while it is not.
    pub(crate) resumed: Option<Duration>,
    /// What its stamps follow.
    clock: SourceClock<Reply>,
    /// Answers that wait for room.
    ready: VecDeque<Reply>,
}

impl LiveCore {
    pub(crate) fn new(max_delay_ns: StampNs) -> Self {
        let (clock, ready) = (SourceClock::default(), VecDeque::new());
        Self { max_delay_ns, newest_ns: StampNs::MIN, waits: false, resumed: Some(Duration::ZERO), clock, ready }
    }

    /// Since when it has been asked without a break; none where it or an answer waits for room.
    pub(crate) fn asked_since(&self) -> Option<Duration> {
        self.resumed.filter(|_| self.ready.is_empty())
    }

    /// Makes an answer ready, unless it is held back by its stamp; what the user should know, with the number of the item.
    fn take(&mut self, answer: Reply) -> Vec<(u64, String)> {
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let today_ns = StampNs::try_from(since_1970.as_nanos()).unwrap_or(StampNs::MAX);
        let Firing { item, stamp_ns, timed } = answer.firing;
        let is_silent = answer.emissions.iter().all(|emission| matches!(emission, Emission::Silent));
        let judged = match (&answer.answered, is_silent) {
            (Ok(Ok(true)), false) => {
                let at = timed.map_or_else(Instant::now, |(began, took)| began + took);
                self.clock.take(stamp_ns, answer, (at, today_ns))
            }
            (Ok(Ok(true)), true) => vec![Judged::Fits(answer)],
            _ => self.clock.end(today_ns).into_iter().chain([Judged::Fits(answer)]).collect(),
        };
        let mut notes = Vec::new();
        for judged in judged {
            match judged {
                Judged::Fits(reply) => self.ready.push_back(reply),
                Judged::Refused(reply, stamp_ns, reason) => {
                    notes.push((reply.item(), reason.clone()));
                    self.ready.push_back(reply.refused(stamp_ns, &reason));
                }
                Judged::Note(note) => notes.push((item, note)),
            }
        }
        notes
    }
}

/// An answer of a live source.
pub(crate) struct Reply {
    firing: Firing,
    emissions: Vec<Emission>,
    warnings: Vec<String>,
    answered: Result<Result<bool, NodeError>, String>,
}

/// Whether a live source is asked for its next answer.
pub(crate) enum NextRequest {
    Next {
        item: u64,
        stamp_ns: StampNs,
    },
    /// An output has no room.
    WhenThereIsRoom,
    /// It has ended.
    Never,
}

impl Reply {
    /// Number of the answer.
    pub(crate) fn item(&self) -> u64 {
        self.firing.item
    }

    /// Whether the source has ended without an item, or was stopped.
    pub(crate) fn is_end(&self) -> bool {
        matches!(self.answered, Ok(Ok(false)))
    }

    /// The answer with empties in place of its items.
    fn refused(mut self, stamp_ns: StampNs, reason: &str) -> Self {
        self.firing.stamp_ns = stamp_ns;
        let given = self.emissions.iter_mut().filter(|emission| !matches!(emission, Emission::Silent));
        given.for_each(|emission| *emission = Emission::Empty(reason.to_owned()));
        self
    }

    /// The failure of a source whose thread panicked.
    pub(crate) fn of_panic(item: u64, stamp_ns: StampNs, n_ports: usize, panic: String) -> Self {
        let firing = Firing { item, stamp_ns, timed: None };
        Self { firing, emissions: vec![Emission::Silent; n_ports], warnings: Vec::new(), answered: Err(panic) }
    }

    /// Asks the source.
    pub(crate) fn of(
        name: Name,
        source: &mut dyn AnySource,
        context: &mut Context,
        n_ports: usize,
        item: u64,
        stamp_ns: StampNs,
    ) -> Self {
        context.begin(item, stamp_ns);
        let mut emissions = vec![Emission::Silent; n_ports];
        let began = Instant::now();
        let answered = call_node(name, Doing::Waiting, item, context, |context| source.next(&mut emissions, context));
        let firing = Firing { item, stamp_ns: context.stamp_ns(), timed: Some((began, began.elapsed())) };
        Self { firing, emissions, warnings: context.take_warnings(), answered }
    }
}

impl Cell {
    pub(crate) fn is_live(&self) -> bool {
        matches!(self.core, Core::Live(_))
    }

    /// Takes the flag that a live source waited for room.
    pub(crate) fn take_waits(&mut self) -> bool {
        match &mut self.core {
            Core::Live(live) => std::mem::take(&mut live.waits),
            _ => false,
        }
    }

    /// Takes an answer of a live source, to be sent as soon as its stamp fits and there is room.
    pub(crate) fn answered(&mut self, mut answer: Reply, run: &Runtime<'_>) {
        self.started(run);
        run.warn(self.index, answer.item(), std::mem::take(&mut answer.warnings));
        self.item += u64::from(!answer.is_end());
        let Core::Live(live) = &mut self.core else { return };
        for (item, message) in live.take(answer) {
            run.event(&Event::Urgent(&Warning { node: self.context.node().into(), item, message: message.clone() }));
            run.warn(self.index, item, vec![message]);
        }
    }

    /// Sends an answer of a live source.
    fn send_answer(&mut self, answer: Reply, run: &Runtime<'_>, turn: &mut Turn<'_>) {
        if answer.is_end() {
            if run.cancelled() {
                // It ended because it was asked to.
                run.note_interrupted();
            }
            return self.end(run, turn);
        }
        self.emissions = answer.emissions;
        if let Some((began, took)) = answer.firing.timed {
            run.note_arrival(self.index, answer.firing.stamp_ns, began + took);
        }
        self.after(answer.firing, answer.answered.map(|answer| answer.map(drop)), run, turn);
    }

    /// Sends what is ready, and whether a live source can be asked for its next answer; ends it where it has to end.
    pub(crate) fn ask(&mut self, run: &Runtime<'_>, turn: &mut Turn<'_>) -> NextRequest {
        loop {
            let has_room = self.has_room(run);
            let Core::Live(live) = &mut self.core else { return NextRequest::Never };
            // The end is not an item and needs no room.
            if !has_room && !live.ready.front().is_some_and(Reply::is_end) {
                (live.waits, live.resumed) = (true, None);
                return NextRequest::WhenThereIsRoom;
            }
            match &self.phase {
                Phase::Failing(empty) => {
                    let empty = empty.clone();
                    self.send_empties(empty, run, turn);
                    self.end(run, turn);
                    return NextRequest::Never;
                }
                Phase::Open => {
                    if let Some(answer) = live.ready.pop_front() {
                        self.send_answer(answer, run, turn);
                    } else if run.cancelled() {
                        self.interrupt(run, turn);
                        return NextRequest::Never;
                    } else {
                        live.resumed = live.resumed.or_else(|| Some(run.now()));
                        let stamp_ns = live.clock.held_ns().unwrap_or(self.stamp_ns);
                        return NextRequest::Next { item: self.item, stamp_ns: stamp_or_zero(stamp_ns) };
                    }
                }
                _ => return NextRequest::Never,
            }
        }
    }

    /// Ends a live source on a stop request; returns `false` if it has failed and has still to report that.
    pub(crate) fn interrupt(&mut self, run: &Runtime<'_>, turn: &mut Turn<'_>) -> bool {
        let ends = matches!(self.phase, Phase::Open);
        if ends {
            run.note_interrupted();
            self.end(run, turn);
        }
        ends
    }

    /// Fails a live source that cannot be asked.
    pub(crate) fn fail_live(&mut self, reason: String, run: &Runtime<'_>) {
        self.fail(Failure::error(self.index, self.item, reason), run);
    }

    /// Replaces items that a live source gives later than promised by empties, stamped with the promise that they
    /// broke.
    pub(crate) fn empty_late_items(&mut self, stamp_ns: StampNs) {
        let Core::Live(live) = &mut self.core else { return };
        live.newest_ns = live.newest_ns.max(stamp_ns);
        for (output, emission) in self.outputs.iter_mut().zip(&mut self.emissions) {
            if stamp_ns >= output.floor || matches!(emission, Emission::Silent) {
                continue;
            }
            let late_ns = output.floor.saturating_sub(stamp_ns);
            if output.late.n_items == 0 {
                let (node, late) = (self.context.node(), milliseconds(late_ns));
                tracing::warn!(node, "an item came {late} late and is an empty; further ones are counted");
                output.late.first = (output.n_items(), stamp_ns, output.floor);
            }
            output.late.n_items += 1;
            output.late.most_ns = output.late.most_ns.max(late_ns);
            if let Emission::Value(_) = emission {
                *emission = Emission::Empty(format!(
                    "it came {} after its wire had been promised to be complete; the source promises a delay of at most {}",
                    milliseconds(late_ns),
                    milliseconds(live.max_delay_ns)
                ));
            }
        }
    }

    /// Warnings about items that came later than promised.
    pub(crate) fn late_warning(&self, plan: &Plan) -> Vec<(usize, Warning)> {
        let late = self.outputs.iter().filter(|output| output.late.n_items > 0);
        let message = |output: &Output| {
            let Late { n_items, most_ns, first: (item, stamp_ns, floor_ns) } = output.late;
            let items = if n_items == 1 { "item" } else { "items" };
            let (wire, most) = (plan.wire_name(output.id), milliseconds(most_ns));
            format!(
                "{wire}: {n_items} {items} came late, by up to {most} more than promised, and are empties; the first was item \
                 {item}, stamped {stamp_ns} ns after {floor_ns} ns"
            )
        };
        let warning = |message| Warning { node: self.context.node().to_owned(), item: self.item, message };
        late.map(|output| (self.index, warning(message(output)))).collect()
    }
}

fn milliseconds(ns: StampNs) -> String {
    format!("{} ms", ns as f64 / 1e6)
}
