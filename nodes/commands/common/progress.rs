//! Progress of a run, of a sweep and of reading a long file: an updated line on a terminal, a few plain lines elsewhere.

use super::{
    busy::Longest,
    global::{Format, Global},
    terminal,
};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use osteoflow_engine::{
    plan::Plan,
    run::{Event, Observer},
    sweep::{Done, Watcher},
};
use std::{
    io::{self, IsTerminal, Write},
    path::Path,
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

/// Refresh interval of the line; nodes that fire more often are counted only.
const REFRESH: Duration = Duration::from_millis(60);
/// Interval at which the spinner turns while one node works for long.
const TICK: Duration = Duration::from_millis(120);
/// Files that are read faster show no progress.
const PATIENCE: Duration = Duration::from_millis(400);
/// Time after which a busy node is named on a terminal.
const NAMED_AFTER: Duration = Duration::from_secs(3);
/// Time after which a busy node is named in a line of its own elsewhere; the next line comes after twice the time.
const LINE_AFTER: Duration = Duration::from_secs(30);

/// How progress is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shown {
    No,
    Lines,
    Bar,
}

impl Shown {
    fn of(global: &Global) -> Self {
        match global.quiet || global.format != Format::Text {
            true => Self::No,
            false if io::stderr().is_terminal() => Self::Bar,
            false => Self::Lines,
        }
    }

    /// For programs that call this one: on a terminal only.
    fn on_terminal(is_wanted: bool) -> Self {
        if is_wanted && io::stderr().is_terminal() { Self::Bar } else { Self::No }
    }

    /// A line, if there is a terminal.
    fn bar(self, length: Option<u64>, template: &str) -> ProgressBar {
        if self != Self::Bar {
            return ProgressBar::hidden();
        }
        let bar = ProgressBar::with_draw_target(length, ProgressDrawTarget::stderr());
        let style = ProgressStyle::with_template(template).expect("the templates are fixed");
        bar.set_style(style.progress_chars("=> "));
        bar.enable_steady_tick(TICK);
        bar
    }
}

/// An observer that shows the progress of a run.
pub struct Progress {
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
    fn new(what: &str, n_nodes: Option<usize>, shown: Shown) -> Self {
        if shown == Shown::Lines {
            let _ = writeln!(terminal::stderr(), "{what}");
        }
        let template = match n_nodes {
            Some(_) => "{spinner} {bar:24} {pos}/{len} nodes  {wide_msg}",
            None => "{spinner} {pos} nodes ended  {wide_msg}",
        };
        let bar = shown.bar(n_nodes.map(|n| n as u64), template);
        Self { bar, has_lines: shown == Shown::Lines, state: Mutex::new(State::new()) }
    }

    /// Begins to show progress; `n_nodes` if known.
    pub(crate) fn begin(what: &str, n_nodes: Option<usize>, global: &Global) -> Self {
        Self::new(what, n_nodes, Shown::of(global))
    }

    /// Begins to show the progress of a run.
    pub(crate) fn of_run(plan: &Plan, workers: usize, global: &Global) -> Self {
        let (name, nodes, seed) = (&plan.name, plan.nodes.len(), plan.seed);
        let what = format!("running {name}: {nodes} nodes, seed {seed}, {workers} workers");
        Self::begin(&what, Some(nodes), global)
    }

    /// Begins to show the progress of a run on a terminal, if there is one.
    pub fn on_terminal(plan: &Plan, is_wanted: bool) -> Self {
        Self::new("", Some(plan.nodes.len()), Shown::on_terminal(is_wanted))
    }

    /// Shows nothing, for runs that are displayed otherwise.
    pub(crate) fn hidden() -> Self {
        Self::new("", None, Shown::No)
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
    pub fn end(&self) {
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

/// The progress of a sweep and its remaining time.
pub struct SweepProgress(ProgressBar);

impl SweepProgress {
    fn new(n_runs: usize, shown: Shown) -> Self {
        Self(shown.bar(Some(n_runs as u64), "{spinner} {bar:24} {pos}/{len} runs  {elapsed} gone, {eta} left  {msg}"))
    }

    /// Begins to show the progress of `n_runs` runs.
    pub(crate) fn begin(n_runs: usize, what: &str, workers: usize, global: &Global) -> Self {
        let shown = Shown::of(global);
        if shown == Shown::Lines {
            let _ = writeln!(terminal::stderr(), "{what}: {n_runs} runs, {workers} at a time");
        }
        Self::new(n_runs, shown)
    }

    /// Begins to show the progress of `n_runs` runs on a terminal, if there is one.
    pub fn on_terminal(n_runs: usize, is_wanted: bool) -> Self {
        Self::new(n_runs, Shown::on_terminal(is_wanted))
    }

    /// Shows the current step.
    pub fn message(&self, what: &str) {
        self.0.set_message(terminal::escape(what));
    }

    /// Counts runs that have ended on other machines.
    pub fn ended_elsewhere(&self, n_runs: usize) {
        self.0.inc(n_runs as u64);
    }

    /// Removes the line.
    pub fn end(&self) {
        self.0.finish_and_clear();
    }
}

impl Watcher for SweepProgress {
    fn ended(&self, done: &Done) {
        if let Some(reason) = &done.reason {
            self.message(&format!("run {}: {reason}", done.run));
        }
        self.0.inc(1);
    }
}

/// The progress of reading a long file, on a terminal; nothing elsewhere.
pub(crate) struct Reading {
    bar: ProgressBar,
    what: String,
    began: Instant,
    shown: Shown,
}

impl Reading {
    /// Shows the progress of `read`, which reads `file` and calls its argument with the bytes so far and all bytes.
    pub(crate) fn of<T>(
        doing: &str,
        file: &Path,
        global: &Global,
        read: impl FnOnce(&mut dyn FnMut(u64, u64)) -> T,
    ) -> T {
        let what = format!("{doing} {}", file.display());
        let mut reading = Self { bar: ProgressBar::hidden(), what, began: Instant::now(), shown: Shown::of(global) };
        read(&mut |n_bytes, of| reading.at(n_bytes, of))
    }

    fn at(&mut self, n_bytes: u64, of: u64) {
        if self.bar.is_hidden() && self.began.elapsed() >= PATIENCE {
            let template = "{spinner} {bar:24} {bytes}/{total_bytes} {binary_bytes_per_sec}  {wide_msg}";
            self.bar = self.shown.bar(Some(of), template);
            self.bar.set_message(self.what.clone());
        }
        self.bar.set_length(of);
        self.bar.set_position(n_bytes);
    }
}

impl Drop for Reading {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
