//! Live sources in a cell: asks the source when there is room, and sends the answers that arrive from its thread.

use super::{
    Cell, Core, Firing, Phase, call_node,
    output::{Late, Output},
    stamp_or_zero,
};
use crate::{
    activity::{Doing, Name},
    plan::Plan,
    report::{Failure, Warning},
    runtime::Runtime,
    scheduler::Turn,
};
use osteoflow_node::{AnySource, Context, Emission, NodeError, StampNs};
use std::time::Instant;

/// The cell's state of a live source.
pub(crate) struct LiveCore {
    /// Maximum delay of an item relative to the newest.
    pub(crate) max_delay_ns: StampNs,
    /// Newest stamp of all outputs.
    pub(crate) newest_ns: StampNs,
    /// It is not asked, because an output has no room.
    pub(crate) waits: bool,
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

    /// Sends an answer of a live source.
    pub(crate) fn answered(&mut self, answer: Reply, run: &Runtime<'_>, turn: &mut Turn<'_>) {
        self.started(run);
        answer.warnings.into_iter().for_each(|warning| self.context.warn(warning));
        if matches!(answer.answered, Ok(Ok(false))) {
            if run.cancelled() {
                // It ended because it was asked to.
                run.note_interrupted();
            }
            self.pass_warnings_on(answer.firing.item, run);
            return self.end(run, turn);
        }
        self.item += 1;
        self.emissions = answer.emissions;
        self.after(answer.firing, answer.answered.map(|answer| answer.map(drop)), run, turn);
    }

    /// Whether a live source can be asked for its next answer; ends it where it has to end.
    pub(crate) fn ask(&mut self, run: &Runtime<'_>, turn: &mut Turn<'_>) -> NextRequest {
        if !self.is_live() {
            return NextRequest::Never;
        }
        let has_room = self.has_room(run);
        if let Core::Live(live) = &mut self.core
            && !has_room
        {
            live.waits = true;
            return NextRequest::WhenThereIsRoom;
        }
        match &self.phase {
            Phase::Failing(empty) => {
                let empty = empty.clone();
                self.send_empties(empty, run, turn);
                self.end(run, turn);
                NextRequest::Never
            }
            Phase::Open if !run.cancelled() => {
                NextRequest::Next { item: self.item, stamp_ns: stamp_or_zero(self.stamp_ns) }
            }
            _ => {
                self.interrupt(run, turn);
                NextRequest::Never
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
