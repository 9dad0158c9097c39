//! What is printed at the end of a run.

use super::{
    exit::Exit,
    global::{Format, Global},
    result_table, run_table,
    terminal::{self, print_json},
};
use crate::app::{is_said_by_verdict, is_settled, judged, refusal_in_short, without_reason};
use anyhow::Result;
use osteoflow_engine::run::{Outcome, RunReport, Warning, files};
use serde_json::Value;
use std::{io::Write, path::Path};

/// Words of warnings that follow from a refusal: of a node that has nothing to write, and of the reason that names a file.
const FOLLOW: [&str; 2] = ["since it is not registered", "the result \"verdict\" holds the whole path of a file"];

/// Prints the end of a run: results on stdout, everything else on stderr.
pub(crate) fn print_end(report: &RunReport, dir: &Path, global: &Global) -> Result<Exit> {
    let exit = print_warnings_and_failure(report, global)?;
    match global.format {
        Format::Json => print_json(&with_outcome(report, exit, dir))?,
        Format::Text => print_text(report, &result_table::text(&report.results, global), dir, global)?,
    }
    Ok(exit)
}

/// Prints warnings, and the reason if there are no results, to stderr.
pub(crate) fn print_warnings_and_failure(report: &RunReport, global: &Global) -> Result<Exit> {
    let exit = Exit::of(&report.outcome);
    // What the verdict is printed to say is said once.
    let is_text = global.format == Format::Text;
    let is_new = |message: &str| {
        // What follows from a refusal is not said beside it.
        let follows = exit == Exit::Refused && FOLLOW.iter().any(|words| message.contains(words));
        let is_open = global.verbose > 0 || !(follows || is_settled(message, &report.results));
        !is_text || is_open && !is_said_by_verdict(message, &report.results)
    };
    // The cause of a refusal comes before what follows from it.
    match &report.outcome {
        Outcome::Refused(refusal) => {
            let refusal = refusal_in_short(refusal, &report.results);
            let refusal = if is_text { without_reason(refusal, &report.results) } else { refusal };
            global.say("refused", refusal)?
        }
        Outcome::Interrupted => global.say("interrupted", "there are no results")?,
        Outcome::Complete => {}
    }
    let is_refusal = |warning: &&Warning| matches!((&report.outcome, warning.sign()), (Outcome::Refused(refusal), Some(sign)) if (&refusal.node, &refusal.reason) == (&sign.node, &sign.reason));
    for warning in report.warnings.iter().filter(|warning| is_new(&warning.message) && !is_refusal(warning)) {
        global.say("warning", format!("node \"{}\", item {}: {}", warning.node, warning.item, warning.message))?;
    }
    if !global.quiet {
        print_repro_commands(&mut terminal::stderr(), report)?;
    }
    Ok(exit)
}

/// Prints the commands that repeat the failures.
fn print_repro_commands(err: &mut impl Write, report: &RunReport) -> Result<()> {
    for bundle in &report.saved.bundles {
        writeln!(err, "repeat it alone with: osteoflow repro {}", bundle.dir.display())?;
    }
    for (node, n) in &report.saved.more {
        writeln!(err, "node \"{node}\" failed {n} more times; these failures are not saved")?;
    }
    Ok(())
}

/// Whether there is something to show: results, or a verdict that refuses them.
pub(crate) fn has_table(report: &RunReport) -> bool {
    report.outcome == Outcome::Complete || judged(&report.results).is_some()
}

/// Prints the tables and the paths of the files.
pub(crate) fn print_text(report: &RunReport, table: &str, dir: &Path, global: &Global) -> Result<()> {
    let mut out = terminal::stdout().lock();
    if global.verbose > 0 {
        writeln!(out, "{}", run_table::text(report))?;
    }
    if has_table(report) {
        writeln!(out, "{table}")?;
    }
    if global.verbose == 0 && !report.contracts.is_empty() {
        writeln!(out, "{}", run_table::contracts(report))?;
    }
    let files = [files::RESULTS, files::MANIFEST, files::RECORDING].into_iter().filter(|f| dir.join(f).exists());
    let files = files.collect::<Vec<_>>().join(", ");
    writeln!(out, "{files} in {} after {:.2} s", dir.display(), report.elapsed.as_secs_f64())?;
    Ok(())
}

/// The content of `results.json` with the outcome and the folder.
pub(crate) fn with_outcome(report: &RunReport, exit: Exit, dir: &Path) -> Value {
    let mut outcome = exit.to_json();
    outcome["out_dir"] = dir.display().to_string().into();
    let mut all = serde_json::Map::from_iter([("outcome".to_owned(), outcome)]);
    all.extend(report.results.as_object().cloned().unwrap_or_default());
    Value::Object(all)
}
