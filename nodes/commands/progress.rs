//! Progress of a run: an updated line on a terminal, a few plain lines elsewhere.

use super::{Format, Global};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use osteoflow_engine::{
    plan::Plan,
    run::{Event, Observer},
};
use std::{
    io::{IsTerminal, Write},
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

/// Refresh interval of the line; nodes that fire more often are counted only.
const REFRESH: Duration = Duration::from_millis(60);

/// An observer that shows the progress of a run.
pub(crate) struct Progress {
    bar: ProgressBar,
    state: Mutex<State>,
}

struct State {
    /// Nodes in their first activation, the latest last.
    busy: Vec<String>,
    n_ended: u64,
    n_items: u64,
    shown: Instant,
}

impl Progress {
    /// Begins to show progress; `n_nodes` if known.
    pub(crate) fn begin(what: &str, n_nodes: Option<usize>, global: &Global) -> Self {
        let shown = !global.quiet && global.format == Format::Text;
        let terminal = std::io::stderr().is_terminal();
        if shown && !terminal {
            let _ = writeln!(std::io::stderr(), "{what}");
        }
        let target = if shown && terminal { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let bar = ProgressBar::with_draw_target(n_nodes.map(|n| n as u64), target);
        let template = match n_nodes {
            Some(_) => "{spinner} {bar:24} {pos}/{len} nodes  {wide_msg}",
            None => "{spinner} {pos} nodes ended  {wide_msg}",
        };
        let style = ProgressStyle::with_template(template).expect("the templates are fixed");
        bar.set_style(style.progress_chars("=> "));
        if shown && terminal {
            // Keeps the spinner turning while one node works for long.
            bar.enable_steady_tick(Duration::from_millis(120));
        }
        Self { bar, state: Mutex::new(State { busy: Vec::new(), n_ended: 0, n_items: 0, shown: Instant::now() }) }
    }

    /// Begins to show the progress of a run.
    pub(crate) fn of_run(plan: &Plan, workers: usize, global: &Global) -> Self {
        let (name, nodes, seed) = (&plan.name, plan.nodes.len(), plan.seed);
        let what = format!("running {name}: {nodes} nodes, seed {seed}, {workers} workers");
        Self::begin(&what, Some(nodes), global)
    }

    /// Shows nothing, for runs that are displayed otherwise.
    pub(crate) fn hidden() -> Self {
        let state = State { busy: Vec::new(), n_ended: 0, n_items: 0, shown: Instant::now() };
        Self { bar: ProgressBar::hidden(), state: Mutex::new(state) }
    }

    /// Removes the line.
    pub(crate) fn end(&self) {
        self.bar.finish_and_clear();
    }

    /// Writes a line to stderr without disturbing the progress line.
    pub(crate) fn println(&self, line: &str) {
        self.bar.suspend(|| {
            let _ = writeln!(std::io::stderr(), "{line}");
        });
    }
}

impl Observer for Progress {
    fn event(&self, event: &Event<'_>) {
        if self.bar.is_hidden() {
            return;
        }
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let mut latest = None;
        match event {
            Event::Started { node } => state.busy.push((*node).into()),
            Event::Fired { node, .. } | Event::Skipped { node, .. } => {
                state.busy.retain(|busy| busy != node);
                state.n_items += 1;
                latest = Some(*node);
            }
            Event::Ended { node } => {
                state.busy.retain(|busy| busy != node);
                state.n_ended += 1;
            }
            _ => {}
        }
        if state.shown.elapsed() < REFRESH && !matches!(event, Event::Started { .. }) {
            return;
        }
        state.shown = Instant::now();
        let node = state.busy.last().map(String::as_str).or(latest).unwrap_or_default();
        self.bar.set_position(state.n_ended);
        self.bar.set_message(format!("{} items  {node}", state.n_items));
    }
}
