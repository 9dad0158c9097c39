//! The command line: parses and dispatches. Nothing below it imports it.

use super::common::{Exit, Global};
use super::{
    check, compare, completions, convert, diff, digest, expand, export, graph, info, inspect, new, record, recover,
    register, replay, report, repro, run, runs, schema, sensor, simulate, sweep, validate, view, worker,
};
use anyhow::Result;
use clap::{CommandFactory, Parser, Subcommand};

/// Register a bone surface, seen by a camera, onto the same bone in CT.
///
/// `register` needs only two files. A whole procedure is a graph: a text file that lists the steps, called nodes (acquire,
/// calibrate, crop, find the laser spots, fit, ICP, planes, metrics), and says which output goes into which input. It is checked
/// before anything runs. A run writes its results, how they came about, and a recording of the data between the nodes.
/// docs/begin/glossary.md explains each word.
#[derive(Debug, Parser)]
#[command(
    name = "osteoflow",
    version,
    max_term_width = 110,
    after_help = "\
Examples:
  osteoflow run graphs/fibula.toml               a simulated procedure, from scan to cutting planes
  osteoflow run graphs/fibula.toml --set icp.kind=icp.point_to_point --set graph.seed=7
  osteoflow check graphs/fibula.toml             every fault at its line; nothing is run
  osteoflow inspect icp.point_to_plane           what a node takes, gives and needs
  osteoflow register bone.stl scan.ply           two files, no graph
  osteoflow info FILE                            what a file holds, and the command that uses it

Exit codes:
    0  done
    1  a file could not be read or written or is damaged, or there was an internal error
    2  the command line or the graph has a fault; nothing was run
    3  the run was refused or a node failed, or a registration has no answer; the reason is printed
    4  a difference was found: between recordings, or between what was run again and its original
    5  some runs of a sweep failed: its tables lack them; --resume --retry-failed runs them again
  130  interrupted; everything written until then is valid

Research software, not a medical device."
)]
pub(crate) struct Cli {
    #[command(flatten)]
    pub(crate) global: Global,

    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    Run(run::Run),
    Register(Box<register::Register>),
    Info(info::Info),
    Convert(convert::Convert),
    Check(check::Check),
    Expand(expand::Expand),
    Inspect(inspect::Inspect),
    Graph(graph::Graph),
    Schema(schema::Schema),
    Runs(runs::Runs),
    Record(record::Record),
    Replay(replay::Replay),
    Digest(digest::Digest),
    Diff(diff::Diff),
    Validate(validate::Validate),
    Recover(recover::Recover),
    Repro(repro::Repro),
    Sweep(Box<sweep::Sweep>),
    Export(export::Export),
    Report(report::Report),
    View(Box<view::View>),
    Compare(compare::Compare),
    Simulate(simulate::Simulate),
    Sensor(sensor::Sensor),
    New(new::New),
    Completions(completions::Completions),
    PluginProbe(worker::PluginProbe),
    Worker(worker::Worker),
}

/// What one wants, and the commands that do it.
const GROUPS: [(&str, &[&str]); 6] = [
    ("To register:", &["register", "view", "info", "convert", "sensor"]),
    ("To run a graph:", &["run", "check", "graph", "inspect", "expand", "schema"]),
    ("To look at runs:", &["runs", "report", "compare"]),
    ("To study:", &["sweep", "simulate"]),
    ("To keep and repeat:", &["record", "replay", "digest", "diff", "validate", "recover", "repro", "export"]),
    ("To begin:", &["new", "completions", "help"]),
];

impl Cli {
    /// The command line, whose help lists the commands by what one wants.
    pub(crate) fn grouped() -> clap::Command {
        let mut command = Self::command();
        command.build();
        let mut list = String::from("Commands:\n");
        for (title, names) in GROUPS {
            list.push_str(&format!("{title}\n"));
            for name in names {
                let about = command.find_subcommand(name).and_then(|command| command.get_about());
                // What comes after the colon is in the command's own help.
                let about = about.map(ToString::to_string).unwrap_or_default();
                let about = about.split(": ").next().unwrap_or_default();
                list.push_str(&format!("  {name:<12} {about}\n"));
            }
        }
        Self::command().help_template(format!(
            "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{list}\nOptions:\n{{options}}{{after-help}}"
        ))
    }
}

impl Command {
    /// Whether it serves another process, which logs for it.
    pub(crate) fn is_worker(&self) -> bool {
        matches!(self, Self::Worker(_))
    }

    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        match self {
            Self::Run(command) => command.execute(global),
            Self::Register(command) => command.execute(global),
            Self::Info(command) => command.execute(global),
            Self::Convert(command) => command.execute(global),
            Self::Runs(command) => command.execute(global),
            Self::Record(command) => command.execute(global),
            Self::Replay(command) => command.execute(global),
            Self::Digest(command) => command.execute(global),
            Self::Diff(command) => command.execute(global),
            Self::Repro(command) => command.execute(global),
            Self::Validate(command) => command.execute(global),
            Self::Recover(command) => command.execute(global),
            Self::Check(command) => command.execute(global),
            Self::Expand(command) => command.execute(global),
            Self::Inspect(command) => command.execute(global),
            Self::Graph(command) => command.execute(global),
            Self::Schema(command) => command.execute(global),
            Self::Sweep(command) => command.execute(global),
            Self::Export(command) => command.execute(global),
            Self::Report(command) => command.execute(global),
            Self::View(command) => command.execute(global),
            Self::Compare(command) => command.execute(global),
            Self::Simulate(command) => command.execute(global),
            Self::Sensor(command) => command.execute(global),
            Self::New(command) => command.execute(global),
            Self::Completions(command) => command.execute(Cli::command()),
            Self::PluginProbe(command) => command.execute(),
            Self::Worker(command) => command.execute(),
        }
    }
}
