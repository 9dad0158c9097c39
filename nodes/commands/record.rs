use super::common::{Exit, Format, Global, graph_args, print_json, progress::Progress, running, terminal};
use crate::app::{GraphArgs, Keep, out_dir, run_error};
use anyhow::{Context, Result};
use clap::Args;
use osteoflow_engine::run::{Outcome, RunOptions, files};
use serde_json::json;
use std::{fs, io::Write, num::NonZeroUsize, path::PathBuf, sync::Arc};

/// Run a graph and write only a recording: one MCAP file with the wires (outputs of nodes) that you name.
///
/// The outputs of sources are always recorded, so the file alone can be replayed.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow record graphs/fibula.toml --wires 'icp.*' 'planes.*' --out icp.mcap
  osteoflow record graphs/fibula.toml --wires '*' --out all.mcap
  osteoflow replay icp.mcap")]
pub(crate) struct Record {
    #[command(flatten)]
    graph: GraphArgs,

    /// Wires as NODE.PORT; * matches any characters.
    #[arg(long, value_name = "GLOB", num_args = 1.., required = true)]
    wires: Vec<String>,

    /// The file to write.
    #[arg(long, value_name = "FILE.mcap")]
    out: PathBuf,

    /// Replace the file if it exists.
    #[arg(long)]
    force: bool,

    /// How many threads run nodes; the recording does not depend on it. Default: the number of cores.
    #[arg(long, value_name = "N")]
    workers: Option<NonZeroUsize>,

    #[command(flatten)]
    keep: Keep,
}

impl Record {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let file = &self.out;
        if file.exists() && !self.force {
            usage!("{} exists already; name another file, or replace it with --force", file.display());
        }
        let mut sets = self.graph.sets.clone();
        sets.push(format!("record.wires={}", json!(self.wires)));
        let graph = GraphArgs { sets, ..self.graph.clone() };
        let Some(checked) = graph_args::check(&graph, global)? else { return Ok(Exit::Usage) };
        let (plan, registry) = (checked.plan, checked.registry);

        // A run writes into a folder; the complete recording is then moved out of it.
        let mut name = file.file_name().context("--out does not name a file")?.to_owned();
        name.push(".part");
        let part = file.with_file_name(name);
        let part = out_dir::make(Some(&part), "record", true)?;
        let cancelled = Arc::default();
        let options = RunOptions {
            out_dir: Some(part.to_path_buf()),
            record: true,
            store: self.keep.store()?,
            ..running::options(self.workers, &cancelled)?
        };
        let progress = Progress::of_run(&plan, options.workers, global);
        let n_wires = plan.record.len();
        let ran = running::watch(progress, cancelled, move |progress| {
            osteoflow_engine::run::run(&plan, &registry, &options, progress).map_err(run_error)
        })?;
        let Some(report) = ran else {
            running::print_left_files(&part, global);
            return Ok(Exit::Interrupted);
        };
        fs::rename(part.join(files::RECORDING), file)
            .with_context(|| format!("{} cannot be written", file.display()))?;
        fs::remove_dir_all(&*part).with_context(|| format!("{} cannot be removed", part.display()))?;
        if let Outcome::Refused(refusal) = &report.outcome {
            global.say("refused", refusal)?;
        }
        let exit = Exit::of(&report.outcome);
        match global.format {
            Format::Json => print_json(&json!({
                "outcome": exit.to_json(),
                "file": file.display().to_string(),
                "wires": n_wires,
            }))?,
            Format::Text if global.quiet => {}
            Format::Text => writeln!(terminal::stdout(), "{n_wires} wires in {}", file.display())?,
        }
        Ok(exit)
    }
}
