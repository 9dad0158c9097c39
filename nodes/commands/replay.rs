use super::{
    Exit, Format, Global, UsageError, out_dir, print_json,
    progress::Progress,
    registry, result_table,
    run::Leave,
    run_table,
    running::{self, Ran},
    text_table::TextTable,
};
use anyhow::Result;
use clap::Args;
use osteoflow_engine::{
    replay::{ReplayError, ReplayReport, WireComparison},
    run::{Outcome, RunOptions},
};
use serde_json::{Value, json};
use std::{io::Write, path::PathBuf, sync::Arc};

/// Run again from a recording alone, and compare every recorded wire bit for bit.
///
/// The sources' recorded items stand for their nodes, everything downstream is computed anew. The files that the graph
/// named need not be there. Without --out nothing is written.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow replay runs/fibula-20260314-092653/run.mcap
  osteoflow replay run.mcap --workers 1 --out again")]
pub(crate) struct Replay {
    /// The run.mcap of a run, or a file of `osteoflow record`.
    file: PathBuf,

    #[command(flatten)]
    leave: Leave,
}

impl Replay {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let cancelled = Arc::default();
        let dir =
            self.leave.out.as_deref().map(|dir| out_dir::make(Some(dir), "replay", self.leave.force)).transpose()?;
        let options = RunOptions {
            out_dir: dir.clone(),
            record: dir.is_some(),
            ..running::options(self.leave.workers, &cancelled)?
        };
        let what = format!("replaying {}: {} workers", self.file.display(), options.workers);
        let (progress, file) = (Progress::begin(&what, None, global), self.file.clone());
        let colour = global.colour_err();
        let ran = running::watch(progress, cancelled, move |progress| {
            osteoflow_engine::replay::replay(&file, &registry(), &options, progress).map_err(|error| match error {
                ReplayError::Graph(faults) => {
                    let said = format!("the recorded graph does not fit this program\n{}", faults.render(colour));
                    UsageError(said).into()
                }
                ReplayError::Run(error) => running::told(error),
                other => other.into(),
            })
        })?;
        let report = match ran {
            Ran::Ended(report) => report,
            Ran::Left => {
                if let Some(dir) = &dir {
                    running::say_left(dir, global);
                }
                return Ok(Exit::Interrupted);
            }
        };
        let exit = match &report.run.outcome {
            Outcome::Interrupted => Exit::Interrupted,
            _ if !report.is_equal() => Exit::Differs,
            Outcome::Refused(_) => Exit::Refused,
            Outcome::Complete => Exit::Done,
        };
        match global.format {
            Format::Json => print_json(&as_json(&report, exit))?,
            Format::Text => print_text(&report, exit, global)?,
        }
        Ok(exit)
    }
}

fn print_text(report: &ReplayReport, exit: Exit, global: &Global) -> Result<()> {
    let mut err = std::io::stderr().lock();
    if let Some(reason) = &report.truncated {
        let word = global.paint_err("warning", "1;33");
        writeln!(err, "{word}: the recording ends early ({reason}); what is before that is compared")?;
    }
    if let Outcome::Refused(refusal) = &report.run.outcome {
        writeln!(err, "{}: {refusal}", global.paint_err("refused", "1;31"))?;
    }
    if exit == Exit::Interrupted {
        writeln!(err, "{}: nothing is compared", global.paint_err("interrupted", "1;33"))?;
    }
    drop(err);
    let mut out = std::io::stdout().lock();
    if global.verbose > 0 {
        writeln!(out, "{}", run_table::text(&report.run))?;
    }
    let mut table = TextTable::new("wires", &["recorded", "replayed"]);
    for wire in &report.wires {
        table.row(&wire.wire, [wire.n_recorded.to_string(), wire.n_replayed.to_string(), verdict(wire)]);
    }
    writeln!(out, "{}", table.lines())?;
    if report.run.outcome == Outcome::Complete {
        writeln!(out, "{}", result_table::text(&report.run.results))?;
    }
    let (computed, played): (Vec<_>, Vec<_>) = report.wires.iter().partition(|wire| !wire.source);
    let n_different = computed.iter().filter(|wire| wire.first_difference.is_some()).count();
    let results = match report.results_equal {
        Some(true) => ", results equal",
        Some(false) => ", results differ",
        None => ", no recorded results to compare",
    };
    let (n_computed, n_played) = (computed.len(), played.len());
    writeln!(out, "{n_played} wires played, {n_computed} computed anew, {n_different} of these differ{results}")?;
    Ok(())
}

fn verdict(wire: &WireComparison) -> String {
    match (&wire.first_difference, wire.source) {
        (Some((number, what)), _) => format!("differs first at item {number}: {what}"),
        (None, true) => "played".into(),
        (None, false) => "equal".into(),
    }
}

fn as_json(report: &ReplayReport, exit: Exit) -> Value {
    let wires = report.wires.iter().map(|wire| {
        let difference = wire.first_difference.as_ref();
        json!({
            "wire": wire.wire,
            "source": wire.source,
            "recorded": wire.n_recorded,
            "replayed": wire.n_replayed,
            "first_difference": difference.map(|(number, what)| json!({ "item": number, "what": what })),
        })
    });
    json!({
        "outcome": exit.to_json(),
        "equal": report.is_equal(),
        "results_equal": report.results_equal,
        "truncated": report.truncated,
        "wires": wires.collect::<Value>(),
        "results": report.run.results,
    })
}
