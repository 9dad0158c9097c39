//! Progress of a run, of a sweep and of reading a long file: an updated line on a terminal, a plain line now and then elsewhere.

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
    collections::HashSet,
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
/// Time after which a line elsewhere says how far the work is; the next line comes after twice the time.
const LINE_AFTER: Duration = Duration::from_secs(5);
/// Longest time between two lines.
const LINE_AT_LEAST: Duration = Duration::from_secs(60);
/// Time from which on the remaining time is said.
const LEFT_AFTER: Duration = Duration::from_secs(2);

/// The times at which lines are written: after 5 s, 15 s, 35 s, then every minute.
struct Lines {
    began: Instant,
    next: Duration,
    step: Duration,
}

impl Lines {
    fn new() -> Self {
        Self { began: Instant::now(), next: LINE_AFTER, step: LINE_AFTER }
    }

    /// Whether a line is due, after so much time.
    fn is_due(&mut self, gone: Duration) -> bool {
        let is_due = gone >= self.next;
        if is_due {
            self.step = (self.step * 2).min(LINE_AT_LEAST);
            self.next = gone + self.step;
        }
        is_due
    }

    /// The time gone and, if `n` of `all` parts are done, about how much is left.
    fn times(&self, n: u64, all: u64) -> String {
        let gone = self.began.elapsed();
        if gone < LEFT_AFTER || n == 0 || n >= all {
            return format!("{} gone", seconds(gone));
        }
        let left = gone.mul_f64((all - n) as f64 / n as f64);
        format!("{} gone, about {} left", seconds(gone), seconds(left))
    }
}

/// Whole seconds, or minutes and seconds.
fn seconds(time: Duration) -> String {
    match time.as_secs_f64().round() as u64 {
        s if s < 100 => format!("{s} s"),
        s if s < 6000 => format!("{} min {} s", s / 60, s % 60),
        s => format!("{} h {} min", s / 3600, s % 3600 / 60),
    }
}

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
    /// Nodes that have fired or ended. Most fire once, and all stay until nothing more can come to them, so that the number of
    /// ended nodes would stand still until the end.
    fired: HashSet<String>,
    n_nodes: u64,
    n_items: u64,
    shown: Instant,
    /// The node that has been busy for long, as it is shown.
    busy_for_long: Option<String>,
    lines: Lines,
}

impl State {
    fn new(n_nodes: u64) -> Self {
        Self {
            busy: Vec::new(),
            fired: HashSet::new(),
            n_nodes,
            n_items: 0,
            shown: Instant::now(),
            busy_for_long: None,
            lines: Lines::new(),
        }
    }

    fn n_fired(&self) -> u64 {
        self.fired.len() as u64
    }

    fn message(&self, latest: Option<&str>) -> String {
        let node = self.busy.last().map(String::as_str).or(latest).unwrap_or_default();
        let times = self.lines.times(self.n_fired(), self.n_nodes);
        format!("{} items  {times}  {}", self.n_items, self.busy_for_long.as_deref().unwrap_or(node))
    }

    /// How far the work is, as a line of its own.
    fn line(&self, longest: Option<Longest>) -> String {
        let of = if self.n_nodes > 0 { format!(" of {}", self.n_nodes) } else { String::new() };
        let times = self.lines.times(self.n_fired(), self.n_nodes);
        let node = longest.map_or_else(String::new, |longest| format!("; {longest}"));
        format!("{}{of} nodes have worked, {} items, {times}{node}", self.n_fired(), self.n_items)
    }
}

impl Progress {
    fn new(what: &str, n_nodes: Option<usize>, shown: Shown) -> Self {
        if shown == Shown::Lines && !what.is_empty() {
            let _ = writeln!(terminal::stderr(), "{what}");
        }
        let template = match n_nodes {
            Some(_) => "{spinner} {bar:24} {pos}/{len} nodes  {wide_msg}",
            None => "{spinner} {pos} nodes  {wide_msg}",
        };
        let bar = shown.bar(n_nodes.map(|n| n as u64), template);
        Self {
            bar,
            has_lines: shown == Shown::Lines,
            state: Mutex::new(State::new(n_nodes.unwrap_or_default() as u64)),
        }
    }

    /// Begins to show progress; `n_nodes` if known. An empty `what`, for runs that are mostly short, writes no line at the beginning.
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
            let gone = state.lines.began.elapsed();
            if state.lines.is_due(gone) {
                let longest = longest.filter(|longest| longest.took >= NAMED_AFTER);
                let _ = writeln!(terminal::stderr(), "{}", state.line(longest));
            }
            return;
        }
        let named = longest.filter(|longest| longest.took >= NAMED_AFTER).map(|longest| longest.to_string());
        state.busy_for_long = named;
        self.bar.set_message(terminal::escape(&state.message(None)));
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
        if self.bar.is_hidden() && !self.has_lines {
            return;
        }
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let mut latest = None;
        match event {
            Event::Started { node } => state.busy.push((*node).into()),
            Event::Fired { node, .. } | Event::Skipped { node, .. } => {
                state.busy.retain(|busy| busy != node);
                state.n_items += 1;
                if !state.fired.contains(*node) {
                    state.fired.insert((*node).to_owned());
                }
                latest = Some(*node);
            }
            Event::Ended { node } => {
                state.busy.retain(|busy| busy != node);
                state.fired.insert((*node).to_owned());
            }
            _ => {}
        }
        if state.shown.elapsed() < REFRESH && !matches!(event, Event::Started { .. }) {
            return;
        }
        state.shown = Instant::now();
        self.bar.set_position(state.n_fired());
        self.bar.set_message(terminal::escape(&state.message(latest)));
    }
}

/// The progress of a sweep and its remaining time.
pub struct SweepProgress {
    bar: ProgressBar,
    /// Number of runs, and the times of the lines elsewhere than on a terminal.
    n_runs: u64,
    lines: Option<Mutex<(u64, Lines)>>,
}

impl SweepProgress {
    fn new(n_runs: usize, shown: Shown) -> Self {
        let template = "{spinner} {bar:24} {pos}/{len} runs  {elapsed} gone, {eta} left  {msg}";
        let lines = (shown == Shown::Lines).then(|| Mutex::new((0, Lines::new())));
        Self { bar: shown.bar(Some(n_runs as u64), template), n_runs: n_runs as u64, lines }
    }

    /// Counts runs that have ended, and writes a line if one is due.
    fn count(&self, n: u64) {
        self.bar.inc(n);
        let Some(lines) = &self.lines else { return };
        let mut lines = lines.lock().unwrap_or_else(PoisonError::into_inner);
        lines.0 += n;
        let n_ended = lines.0;
        let gone = lines.1.began.elapsed();
        if n_ended < self.n_runs && lines.1.is_due(gone) {
            let times = lines.1.times(n_ended, self.n_runs);
            let _ = writeln!(terminal::stderr(), "{n_ended} of {} runs, {times}", self.n_runs);
        }
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
        self.bar.set_message(terminal::escape(what));
    }

    /// Counts runs that have ended on other machines.
    pub fn ended_elsewhere(&self, n_runs: usize) {
        self.count(n_runs as u64);
    }

    /// Removes the line.
    pub fn end(&self) {
        self.bar.finish_and_clear();
    }
}

impl Watcher for SweepProgress {
    fn ended(&self, done: &Done) {
        if let Some(reason) = &done.reason {
            self.message(&format!("run {}: {reason}", done.run));
        }
        self.count(1);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_left_is_said_after_two_seconds_and_follows_the_work() {
        let lines = |gone_s: u64| Lines { began: Instant::now() - Duration::from_secs(gone_s), ..Lines::new() };
        assert_eq!(lines(1).times(5, 10), "1 s gone");
        assert_eq!(lines(6).times(0, 10), "6 s gone");
        assert_eq!(lines(6).times(6, 9), "6 s gone, about 3 s left");
        assert_eq!(lines(200).times(1, 31), "3 min 20 s gone, about 1 h 40 min left");
        assert_eq!(lines(6).times(9, 9), "6 s gone");
    }

    #[test]
    fn lines_come_now_and_then_and_never_more_than_a_minute_apart() {
        let mut lines = Lines::new();
        let mut due = Vec::new();
        for second in 0..400 {
            if lines.is_due(Duration::from_secs(second)) {
                due.push(second);
            }
        }
        assert_eq!(due, [5, 15, 35, 75, 135, 195, 255, 315, 375]);
    }

    #[test]
    fn nodes_count_as_soon_as_they_have_fired() {
        let mut state = State::new(4);
        state.fired.insert("scan".into());
        state.n_items = 7;
        assert_eq!(state.line(None), "1 of 4 nodes have worked, 7 items, 0 s gone");
    }
}
