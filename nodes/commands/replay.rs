use super::common::{
    Exit, Format, Global, graph_args, print_json, progress::Progress, result_table, run_end, run_path, run_table,
    running, terminal, text_table::TextTable,
};
use super::diff;
use crate::app::{Leave, Plugins, UsageError, out_dir, refusal_in_short, run_error};
use anyhow::Result;
use clap::Args;
use osteoflow_engine::{
    replay::{
        Difference, Mapping, Moment, ReplayError, ReplayOptions, ReplayReport, TopicReader, WireComparison, WirePart,
    },
    run::{Outcome, RunOptions},
};
use osteoflow_node::Source;
use osteoflow_standard::acquire::mcap::{self, Mcap};
use serde_json::{Value, json};
use std::{io::Write, path::PathBuf, sync::Arc};

/// Run again from a recording alone: each result is computed again and compared with the recorded one, bit for bit.
///
/// The recorded items of sources replace their nodes; everything downstream is computed again. The files that the graph names
/// need not exist, unless it says `[record] sources = "hash"`: these are read again if they are unchanged. The first divergence
/// is the first in the order of the graph. Without --out nothing is written.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow replay runs/fibula-20260314-092653
  osteoflow replay run.mcap --set icp.max_pair_distance_mm=1     what a parameter changes, and where first
  osteoflow replay run.mcap --from icp --set icp.kind=icp.point_to_point --out again
  osteoflow replay run.mcap --graph other.toml                   the recorded streams through another graph
  osteoflow replay bag.mcap --graph G --map scanner.cloud=/camera/scan   a file of ROS 2 or Foxglove, a port of G
  osteoflow replay run.mcap --rate 1 --start 10 --end 20.5       ten seconds of it, as fast as they went

Exit codes: 0 equal, 4 differs; 3 if the run is refused again, for the same reason.")]
pub(crate) struct Replay {
    /// A run's folder or its run.mcap, or a file of `osteoflow record`; with --graph also an MCAP of ROS 2 or Foxglove.
    #[arg(value_name = "RUN")]
    file: PathBuf,

    /// Compute only this node and everything downstream; its inputs are played as recorded.
    #[arg(long, value_name = "NODE")]
    from: Option<String>,

    /// Change any key of the recorded graph, as `osteoflow run` does; may be given again.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,

    /// Play the recorded wires into this graph: those with the name of a wire of one of its sources.
    #[arg(long, value_name = "OTHER.toml")]
    graph: Option<PathBuf>,

    /// Play this wire of the recording, or this topic of another program's, as this wire of the graph; may be given again.
    #[arg(long = "map", value_name = "NODE.PORT=TOPIC")]
    maps: Vec<Mapping>,

    /// Seconds of the recording per second of real time, or max; the result does not depend on it.
    #[arg(long, value_name = "RATE", default_value = "max", value_parser = rate)]
    rate: Rate,

    /// Start of playback: seconds after the first stamp, or a stamp such as 1750000000418500000ns. Constants are always played.
    /// A part of a run is another run, so nothing is compared then.
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    start: Option<Moment>,

    /// End of playback, as for --from.
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    end: Option<Moment>,

    /// Run plugins in Python from the text that the recording carries. It is code of whoever wrote the file, with your rights.
    #[arg(long, conflicts_with = "no_plugins")]
    allow_plugins: bool,

    #[command(flatten)]
    plugins: Plugins,

    #[command(flatten)]
    leave: Leave,
}

/// Speed of playback; `None`: as fast as possible.
#[derive(Debug, Clone, Copy)]
struct Rate(Option<f64>);

fn rate(text: &str) -> Result<Rate, String> {
    match text.parse::<f64>() {
        _ if text == "max" => Ok(Rate(None)),
        Ok(rate) if rate > 0.0 && rate.is_finite() => Ok(Rate(Some(rate))),
        _ => Err("a rate must be a number above 0, such as 1 or 0.5, or max".into()),
    }
}

impl Replay {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let file = run_path::recording(&self.file)?;
        let cancelled = Arc::default();
        let dir =
            self.leave.out.as_deref().map(|dir| out_dir::make(Some(dir), "replay", self.leave.force)).transpose()?;
        let options = RunOptions {
            out_dir: dir.as_ref().map(|dir| dir.to_path_buf()),
            record: dir.is_some(),
            ..running::options(self.leave.workers, &cancelled)?
        };
        let changes = ReplayOptions {
            from: self.from.clone(),
            sets: self.sets.clone(),
            graph: self.graph.clone(),
            maps: self.maps.clone(),
            allows_plugins: self.allow_plugins,
            reader: Some(TopicReader { kind: Mcap::KIND.into(), reads: mcap::reads }),
            rate: self.rate.0,
            start: self.start,
            end: self.end,
        };
        let what = format!("replaying {}: {} workers", file.display(), options.workers);
        let progress = Progress::begin(&what, None, global);
        let (colour, kinds) = (global.colour_err(), self.plugins.kinds()?);
        let ran = running::watch(progress, cancelled, move |progress| {
            let replayed = osteoflow_engine::replay::replay(&file, &changes, kinds, &options, progress);
            replayed.map_err(|error| replay_error(error, colour))
        })?;
        let Some(report) = ran else {
            dir.iter().for_each(|dir| running::print_left_files(dir, global));
            return Ok(Exit::Interrupted);
        };
        let exit = match &report.run.outcome {
            Outcome::Complete | Outcome::Refused(_) if !report.is_equal() => Exit::Differs,
            outcome => Exit::of(outcome),
        };
        match global.format {
            Format::Json => print_json(&as_json(&report, exit))?,
            Format::Text => print_text(&report, exit, global)?,
        }
        Ok(exit)
    }
}

fn print_text(report: &ReplayReport, exit: Exit, global: &Global) -> Result<()> {
    graph_args::warn(&report.warnings, global)?;
    if let Some(reason) = &report.truncated {
        global.say("warning", format!("the recording ends early ({reason}); everything before is compared"))?;
    }
    // The log says these before the run, unless it is quiet.
    let before = report.differences.iter().filter(|_| global.quiet);
    for difference in report.unsound.iter().chain(before).chain(&report.late_differences) {
        global.say("warning", difference)?;
    }
    if let Some(reason) = &report.not_compared {
        global.say("note", format!("nothing is compared: {reason}"))?;
    }
    for (nodes, why) in [
        (&report.computed_too, "also computed, because their outputs were not recorded"),
        (&report.own_sources, "run as the graph has them, because nothing recorded is played as theirs"),
    ] {
        if !nodes.is_empty() {
            global.say("note", format!("{why}: {}", nodes.join(", ")))?;
        }
    }
    if let Outcome::Refused(refusal) = &report.run.outcome {
        global.say("refused", refusal_in_short(refusal, &report.run.results))?;
    }
    if exit == Exit::Interrupted {
        global.say("interrupted", "nothing is compared")?;
    }
    let mut out = terminal::stdout().lock();
    if global.verbose > 0 {
        writeln!(out, "{}", run_table::text(&report.run))?;
    }
    let mut table = TextTable::new("wires", &["recorded", "replayed"]);
    for wire in &report.wires {
        table.row(&wire.wire, [wire.n_recorded.to_string(), wire.n_replayed.to_string(), comparison(wire)]);
    }
    writeln!(out, "{}", table.lines())?;
    if run_end::has_table(&report.run) {
        writeln!(out, "{}", result_table::text(&report.run.results, global))?;
    }
    if let Some(wire) = report.first_divergence()
        && let Some(Difference { item, what }) = &wire.first_difference
    {
        let word = global.paint_out("first divergence", "1;31");
        writeln!(out, "{word}: wire {}, item {item}: {}", wire.wire, format_difference(what))?;
    }
    let count = |part: WirePart| report.wires.iter().filter(|wire| wire.part == part).count();
    let n_different = report.wires.iter().filter(|wire| wire.first_difference.is_some()).count();
    let results = match report.results_equal {
        Some(true) => ", results equal",
        Some(false) => ", results differ",
        None => ", no recorded results to compare",
    };
    let not_comparable = match report.wires.iter().filter(|wire| wire.not_comparable.is_some()).count() {
        0 => String::new(),
        n => format!(", {n} not comparable"),
    };
    let (n_computed, n_played) = (count(WirePart::Computed), count(WirePart::Played));
    write!(out, "{n_played} wires played, {n_computed} computed anew")?;
    match &report.not_compared {
        Some(_) => writeln!(out, ", none compared")?,
        None => writeln!(out, ", {n_different} differ{not_comparable}{results}")?,
    }
    Ok(())
}

/// Converts an error: requests that the recording does not support are faults of the command line.
fn replay_error(error: ReplayError, colour: bool) -> anyhow::Error {
    match error {
        ReplayError::Graph { faults, recorded } => {
            let what = if recorded { "the recorded graph does not fit this program" } else { "the graph has faults" };
            UsageError(format!("{what}\n{}", faults.render(colour))).into()
        }
        ReplayError::Unfit(message) => UsageError(message).into(),
        ReplayError::Run(error) => run_error(error),
        other => other.into(),
    }
}

/// Formats a difference: field, both values and their distance.
fn format_difference(what: &osteoflow_engine::diff::Difference) -> String {
    let apart = diff::apart(what);
    let apart = if apart.is_empty() { apart } else { format!(" ({apart})") };
    format!("{}: {} was recorded, {} came{apart}", what.field, what.a, what.b)
}

fn comparison(wire: &WireComparison) -> String {
    if let Some(why) = &wire.not_comparable {
        return format!("not comparable: {why}");
    }
    match (&wire.first_difference, wire.part) {
        (Some(Difference { item, what }), _) => format!("differs first at item {item}, in {}", what.field),
        (None, WirePart::Played) => "played".into(),
        (None, WirePart::Absent) => "not in this graph".into(),
        (None, WirePart::Computed) if wire.n_compared == wire.n_recorded => "equal".into(),
        (None, WirePart::Computed) if wire.n_compared == 0 => "not compared".into(),
        (None, WirePart::Computed) => format!("{} compared, equal", wire.n_compared),
    }
}

fn as_json(report: &ReplayReport, exit: Exit) -> Value {
    let difference = |wire: &WireComparison| {
        let difference = wire.first_difference.as_ref();
        difference.map(|d| json!({ "wire": wire.wire, "item": d.item, "what": d.what }))
    };
    let wires = report.wires.iter().map(|wire| {
        json!({
            "wire": wire.wire,
            "part": wire.part,
            "recorded": wire.n_recorded,
            "replayed": wire.n_replayed,
            "compared": wire.n_compared,
            "first_difference": difference(wire),
            "not_comparable": wire.not_comparable,
        })
    });
    json!({
        "outcome": exit.to_json(),
        "equal": report.is_equal(),
        "results_equal": report.results_equal,
        "first_divergence": report.first_divergence().and_then(difference),
        "not_compared": report.not_compared,
        "truncated": report.truncated,
        "unsound": report.unsound,
        "computed_too": report.computed_too,
        "own_sources": report.own_sources,
        "differences": (report.differences.iter().chain(&report.late_differences).collect::<Vec<_>>()),
        "wires": wires.collect::<Value>(),
        "results": report.run.results,
    })
}
