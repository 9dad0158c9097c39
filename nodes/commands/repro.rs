use super::common::{Exit, Format, Global, print_json, running, terminal, text_table::TextTable};
use crate::app::{Plugins, UsageError};
use anyhow::Result;
use clap::Args;
use osteoflow_engine::{
    repro::{self, Bundle, Given, Input, Program, ReproError, ReproReport, Shown},
    run::Injected,
};
use osteoflow_node::Role;
use serde_json::{Value, json};
use std::{io::Write, num::NonZeroUsize, path::PathBuf, sync::Arc};

/// Run a failed node again, alone, on the data (the item) at which it failed.
///
/// A run saves the items of a failing node in its folder under repro/NODE-ITEM, at most five for each node. A source is
/// called from its start to the call that failed. With RUST_BACKTRACE=1 a panic prints its backtrace.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow repro runs/fibula-20260314-092653/repro/icp-0
  RUST_BACKTRACE=1 osteoflow repro runs/fibula-20260314-092653/repro/icp-0
  osteoflow repro DIR --plugin my_icp.py --set icp.kind=my_icp.fit   the item through another kind
  osteoflow repro DIR --format json | jq .same

Exit codes:
    0  the same failure
    1  the bundle could not be read
    2  this program lacks the kind, or cannot build it from the bundle's parameters
    4  another failure, or none")]
pub(crate) struct Repro {
    /// The bundle: a folder repro/NODE-ITEM of a run.
    dir: PathBuf,

    /// How many threads algorithms use; the results do not depend on it. Default: the number of cores.
    #[arg(long, value_name = "N")]
    workers: Option<NonZeroUsize>,

    /// Change a key of the node, as `osteoflow run` does, such as its kind: is the item difficult, or the method? May be given again.
    #[arg(long = "set", value_name = "NODE.KEY=VALUE")]
    sets: Vec<String>,

    #[command(flatten)]
    plugins: Plugins,
}

impl Repro {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let options = running::options(self.workers, &Arc::default())?;
        let backtrace = std::env::var_os("RUST_BACKTRACE").is_some_and(|value| value != "0");
        let program = Program::current(options.command);
        let report = repro::repro(&self.dir, self.plugins.kinds()?, program, backtrace, &self.sets).map_err(
            |error| match error {
                ReproError::Unfit(why) => UsageError(why).into(),
                other => anyhow::Error::from(other),
            },
        )?;
        let exit = if report.same { Exit::Done } else { Exit::Differs };
        match global.format {
            Format::Json => print_json(&as_json(&report, exit))?,
            Format::Text => print_text(&report, backtrace, global)?,
        }
        Ok(exit)
    }
}

fn print_text(report: &ReproReport, backtrace: bool, global: &Global) -> Result<()> {
    let bundle = &report.bundle;
    for difference in &report.differences {
        global.say("warning", difference)?;
    }
    for warning in &report.warnings {
        global.say("warning", format!("node \"{}\": {warning}", bundle.node.name))?;
    }
    let mut out = terminal::stdout().lock();
    let (name, kind) = (&bundle.node.name, &bundle.node.kind);
    writeln!(out, "node \"{name}\" ({kind}), item {}, {}", bundle.item, bundle.location)?;
    if report.kind != bundle.node.kind {
        writeln!(out, "run again as {}", report.kind)?;
    }
    if global.verbose > 0 {
        writeln!(out, "\n{}", bundle.node.table)?;
    }
    if bundle.node.role == Role::Node {
        writeln!(out, "{}", inputs(bundle))?;
    } else {
        writeln!(out, "a source, called {} times before the call that failed\n", bundle.item)?;
    }
    let (red, green) = (global.paint_out("failed", "1;31"), global.paint_out("same", "1;32"));
    writeln!(out, "{red} then: {}", bundle.failure.reason)?;
    match &report.failure {
        Some(_) if report.same => writeln!(out, "{red} now:  the {green}")?,
        Some(failure) if bundle.node.role != Role::Node && report.n_calls != bundle.item => {
            writeln!(out, "{red} now:  at call {} already: {}", report.n_calls, failure.reason)?;
        }
        Some(failure) => writeln!(out, "{red} now:  another failure: {}", failure.reason)?,
        None => writeln!(out, "now it does not fail")?,
    }
    if let Some(how) = bundle.injected {
        writeln!(out, "the {} was injected for a test (run --inject)", how.name())?;
    }
    if report.same && bundle.failure.panicked && !backtrace {
        writeln!(out, "RUST_BACKTRACE=1 shows the backtrace")?;
    }
    if !report.same && !report.is_changed {
        writeln!(out, "{}", bundle.why_not_again())?;
    }
    Ok(())
}

/// A row for each port, or for each of the first items of a list.
fn inputs(bundle: &Bundle) -> String {
    let mut table = TextTable::new("inputs", &["join", "item", "stamp s", "bytes"]);
    for Input { port, join, given, items, .. } in &bundle.inputs {
        const SHOWN: usize = 5;
        for Shown { number, stamp_ns, bytes, about } in items.iter().take(SHOWN) {
            let numbers = match given {
                Given::Absent => ["-".into(), "-".into(), "-".into()],
                _ => [number.to_string(), format!("{:.6}", *stamp_ns as f64 / 1e9), bytes.to_string()],
            };
            let [number, stamp, bytes] = numbers;
            let about = if *given == Given::Absent { about.replacen("empty", "absent", 1) } else { about.clone() };
            table.row(port, [join.clone(), number, stamp, bytes, about]);
        }
        if items.len() > SHOWN {
            let rest: u64 = items[SHOWN..].iter().map(|item| item.bytes).sum();
            let more = format!("... {} more", items.len() - SHOWN);
            table.row(port, [join.clone(), more, String::new(), rest.to_string()]);
        }
        if items.is_empty() {
            table.row(port, [join.clone(), "none".into(), String::new(), String::new()]);
        }
    }
    table.lines()
}

fn as_json(report: &ReproReport, exit: Exit) -> Value {
    let failure = |failure: &repro::Failure| {
        let (place, message) = failure.place();
        json!({ "reason": failure.reason, "panicked": failure.panicked, "place": place, "message": message })
    };
    let bundle = &report.bundle;
    json!({
        "outcome": exit.to_json(),
        "run_as": report.kind,
        "same": report.same,
        "node": bundle.node.name,
        "kind": bundle.node.kind,
        "item": bundle.item,
        "location": bundle.location,
        "stamp_ns": bundle.stamp_ns,
        "seed": bundle.seed,
        "inputs": bundle.inputs,
        "failed_then": failure(&bundle.failure),
        "failed_now": report.failure.as_ref().map(failure),
        "injected": bundle.injected.map(Injected::name),
        "calls": (bundle.node.role != Role::Node).then_some(report.n_calls),
        "warnings": report.warnings,
        "differences": report.differences,
        "took_ms": report.took.as_secs_f64() * 1e3,
    })
}
