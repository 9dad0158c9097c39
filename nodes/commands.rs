//! The subcommands, one file each, and their common switches, exit codes and registry.

mod busy;
mod check;
mod compare;
mod completions;
pub(crate) mod content;
pub(crate) mod convert;
pub(crate) mod crash;
mod diff;
mod digest;
mod exit;
mod expand;
mod folder_lock;
mod graph;
pub(crate) mod graph_args;
mod info;
mod inspect;
pub(crate) mod log;
mod module_docs;
mod new;
mod node_docs;
mod other_numbers;
pub(crate) mod out_dir;
pub(crate) mod plugins;
pub(crate) mod progress;
mod reading;
mod record;
mod recover;
pub(crate) mod register;
mod replay;
mod report;
mod repro;
mod reproduce;
pub(crate) mod result_table;
pub(crate) mod run;
mod run_path;
mod run_table;
pub(crate) mod running;
mod runs;
mod schema;
mod serve;
pub(crate) mod simulate;
mod simulate_folder;
mod simulate_openigtlink;
mod simulate_set;
mod steer;
mod summary_table;
pub(crate) mod sweep;
pub(crate) mod terminal;
mod text_table;
mod validate;
pub(crate) mod verdict_lines;
mod view;
mod watch;

pub(crate) use exit::{Exit, UsageError, with_causes};
use graph_args::{GraphArgs, print_json};
use plugins::PluginArgs;

use anyhow::Result;
use clap::{ArgAction, Args, Parser, Subcommand, ValueEnum};
use std::io::IsTerminal;

/// Register a bone surface by running a graph of nodes.
///
/// A graph file names nodes (acquire, calibrate, crop, find the laser spots, fit, ICP, planes, metrics) and wires them.
/// It is checked before anything runs; a run writes its results, their provenance, and a recording of its wires.
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
    1  a file could not be read or written or is not sound, or there was an internal error
    2  the command line or the graph has a fault; nothing was run
    3  the run was refused or a node failed, or a registration has no answer; the reason is printed
    4  a replay or a recording differs from another, or a repro from the original failure
  130  interrupted; everything written until then is valid

Research software, not a medical device."
)]
pub(crate) struct Cli {
    #[command(flatten)]
    pub(crate) global: Global,

    #[command(subcommand)]
    pub(crate) command: Command,
}

/// Switches of every command.
#[derive(Debug, Clone, Args)]
pub(crate) struct Global {
    /// Format of the output on stdout.
    #[arg(long, global = true, value_enum, default_value_t = Format::Text, value_name = "FORMAT")]
    pub(crate) format: Format,

    /// Print only results and errors.
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    pub(crate) quiet: bool,

    /// Print more: tables of nodes and wires, then (-vv, -vvv) log lines; OSTEOFLOW_LOG=debug sets a level.
    #[arg(short, long, global = true, action = ArgAction::Count)]
    pub(crate) verbose: u8,

    /// When to use colours; auto: on a terminal, unless NO_COLOR is set.
    #[arg(long, global = true, value_enum, default_value_t = Colour::Auto, value_name = "WHEN")]
    pub(crate) color: Colour,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Format {
    /// Text for people.
    Text,
    /// One JSON value on stdout, and nothing else there.
    Json,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Colour {
    Auto,
    Always,
    Never,
}

impl Global {
    /// Whether to use colours on stderr.
    pub(crate) fn colour_err(&self) -> bool {
        self.color.allows(std::io::stderr().is_terminal())
    }

    /// `text` in an ANSI style such as `1;31`, if colours are used on stdout.
    pub(crate) fn paint_out(&self, text: &str, style: &str) -> String {
        paint(self.color.allows(std::io::stdout().is_terminal()), text, style)
    }

    /// `text` in an ANSI style such as `1;31`, if colours are used on stderr.
    pub(crate) fn paint_err(&self, text: &str, style: &str) -> String {
        paint(self.colour_err(), text, style)
    }
}

impl Colour {
    fn allows(self, terminal: bool) -> bool {
        match self {
            Self::Always => true,
            Self::Never => false,
            Self::Auto => terminal && std::env::var_os("NO_COLOR").is_none_or(|v| v.is_empty()),
        }
    }
}

fn paint(coloured: bool, text: &str, style: &str) -> String {
    if coloured { format!("\x1b[{style}m{text}\x1b[0m") } else { text.into() }
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
    Sweep(sweep::Sweep),
    Report(report::Report),
    View(view::View),
    Compare(compare::Compare),
    Reproduce(reproduce::Reproduce),
    Simulate(simulate::Simulate),
    New(new::New),
    Completions(completions::Completions),
    PluginProbe(plugins::PluginProbe),
    Worker(plugins::Worker),
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
            Self::Report(command) => command.execute(global),
            Self::View(command) => command.execute(global),
            Self::Reproduce(command) => command.execute(global),
            Self::Compare(command) => command.execute(global),
            Self::Simulate(command) => command.execute(global),
            Self::New(command) => command.execute(global),
            Self::Completions(command) => command.execute(global),
            Self::PluginProbe(command) => command.execute(),
            Self::Worker(command) => command.execute(),
        }
    }
}

/// The built-in nodes and payloads.
pub(crate) fn registry() -> osteoflow_node::Registry {
    osteoflow_standard::registry()
}
