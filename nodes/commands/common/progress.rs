//! Progress of a run: an updated line on a terminal, a few plain lines elsewhere.

use super::{
    busy::Longest,
    global::{Format, Global},
    terminal,
};
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

/// Time after which a busy node is named on a terminal.
const NAMED_AFTER: Duration = Duration::from_secs(3);
/// Time after which a busy node is named in a line of its own elsewhere; the next line comes after twice the time.
const LINE_AFTER: Duration = Duration::from_secs(30);

/// An observer that shows the progress of a run.
pub(crate) struct Progress {
    bar: ProgressBar,
    /// Progress is shown as plain lines.
    has_lines: bool,
    state: Mutex<State>,
}

struct State {
    /// Nodes in their first activation, the latest last.
    busy: Vec<String>,
    n_ended: u64,
    n_items: u64,
    shown: Instant,
    /// The node that has been busy for long, as it is shown.
    busy_for_long: Option<String>,
    /// Time after which the next line names a busy node.
    next_line: Duration,
}

impl State {
    fn new() -> Self {
        Self {
            busy: Vec::new(),
            n_ended: 0,
            n_items: 0,
            shown: Instant::now(),
            busy_for_long: None,
            next_line: LINE_AFTER,
        }
    }

    fn message(&self, latest: Option<&str>) -> String {
        let node = self.busy.last().map(String::as_str).or(latest).unwrap_or_default();
        format!("{} items  {}", self.n_items, self.busy_for_long.as_deref().unwrap_or(node))
    }
}

impl Progress {
    /// Begins to show progress; `n_nodes` if known.
    pub(crate) fn begin(what: &str, n_nodes: Option<usize>, global: &Global) -> Self {
        let shown = !global.quiet && global.format == Format::Text;
        let terminal = std::io::stderr().is_terminal();
        if shown && !terminal {
            let _ = writeln!(terminal::stderr(), "{what}");
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
        Self { bar, has_lines: shown && !terminal, state: Mutex::new(State::new()) }
    }

    /// Begins to show the progress of a run.
    pub(crate) fn of_run(plan: &Plan, workers: usize, global: &Global) -> Self {
        let (name, nodes, seed) = (&plan.name, plan.nodes.len(), plan.seed);
        let what = format!("running {name}: {nodes} nodes, seed {seed}, {workers} workers");
        Self::begin(&what, Some(nodes), global)
    }

    /// Shows nothing, for runs that are displayed otherwise.
    pub(crate) fn hidden() -> Self {
        Self { bar: ProgressBar::hidden(), has_lines: false, state: Mutex::new(State::new()) }
    }

    /// Names the node that has been busy for longest, if that is long.
    pub(crate) fn busy(&self, longest: Option<Longest>) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if self.has_lines {
            match longest {
                Some(longest) if longest.took >= state.next_line => {
                    state.next_line *= 2;
                    let _ = writeln!(terminal::stderr(), "{longest}");
                }
                Some(longest) if longest.took >= LINE_AFTER => {}
                _ => state.next_line = LINE_AFTER,
            }
            return;
        }
        let named = longest.filter(|longest| longest.took >= NAMED_AFTER).map(|longest| longest.to_string());
        if named != state.busy_for_long {
            state.busy_for_long = named;
            self.bar.set_message(terminal::escape(&state.message(None)));
        }
    }

    /// Removes the line.
    pub(crate) fn end(&self) {
        self.bar.finish_and_clear();
    }

    /// Writes a line to stderr without disturbing the progress line.
    pub(crate) fn println(&self, line: &str) {
        self.bar.suspend(|| {
            let _ = writeln!(terminal::stderr(), "{line}");
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
        self.bar.set_position(state.n_ended);
        self.bar.set_message(terminal::escape(&state.message(latest)));
    }
}
