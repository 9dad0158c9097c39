use super::common::{Exit, Format, Global, plugins, print_json, run_path, terminal};
use crate::app::{Plugins, UsageError, registry};
use anyhow::Result;
use clap::Args;
use osteoflow_engine::{plugin::Kinds, run::files, sweep};
use serde_json::json;
use std::{
    collections::BTreeSet,
    io::Write,
    path::{Path, PathBuf},
};

/// Write an HTML page about a run or a sweep: figures, 3D views, tables, methods, provenance.
///
/// The page opens without a network. Its figures and a drawing of each view (figures/*.svg), the numbers of each chart
/// (figures/*.csv) and the literature of the nodes (citations.bib) are written beside it. The page of a run shows its recorded wires and lists those that were not recorded.
/// For the page of a sweep two runs are repeated, because its folder holds no surfaces.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow report runs/fibula-20260314-092653
  osteoflow report runs/sensitivity-20260314-101500 --out sensitivity.html
  osteoflow report runs/mine --plugin my_icp.py          with the documentation of its kinds
What it shows: docs/use/report.md")]
pub(crate) struct Report {
    /// The folder of a run or of a sweep, or the run.mcap in it.
    #[arg(value_name = "RUN")]
    dir: PathBuf,

    /// The file to write. Default: report.html in the folder.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,

    /// Plugins, which are loaded: their kinds have documentation, parameters and literature on the page, and a sweep's graphs are
    /// checked and repeated with them. None that the folder names is loaded.
    #[command(flatten)]
    plugins: Plugins,
}

impl Report {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let dir = run_path::folder(&self.dir);
        self.out.as_deref().map_or(Ok(()), check_out)?;
        let kinds = match self.plugins.files.is_empty() {
            true => Kinds::from(&registry()),
            false => Plugins { only: Some(BTreeSet::new()), ..self.plugins.clone() }.kinds()?,
        };
        let known = kinds.known();
        if plugins::print_refused(&known, global)? == Exit::Usage {
            return Ok(Exit::Usage);
        }
        let registry = known.registry;
        let report = if dir.join(sweep::DESIGN).is_file() {
            osteoflow_report::of_sweep(&dir, &registry, &kinds)?
        } else if dir.join(files::MANIFEST).is_file() {
            osteoflow_report::of_run(&dir, &registry)?
        } else {
            usage!(
                "{} is not the folder of a run ({} is missing) or of a sweep ({} is missing); name one that `osteoflow run` \
                 or `osteoflow sweep` has left",
                dir.display(),
                files::MANIFEST,
                sweep::DESIGN
            );
        };
        let page = self.out.clone().unwrap_or_else(|| dir.join(osteoflow_report::PAGE));
        report.write(&dir, &page)?;
        if let Some(fault) = &report.fault {
            global.say("warning", fault)?;
        }
        print_end(&page, &report, global)
    }
}

/// Refuses to write over a file that is no page: a recording is not made again.
fn check_out(page: &Path) -> Result<(), UsageError> {
    let is_page = |bytes: Vec<u8>| bytes.trim_ascii_start().to_ascii_lowercase().starts_with(b"<!doctype html");
    match page.exists() && !osteoflow_engine::regular(page).and_then(std::fs::read).is_ok_and(is_page) {
        true => Err(UsageError(format!("{} exists already and is no page; name another file", page.display()))),
        false => Ok(()),
    }
}

fn print_end(page: &Path, report: &osteoflow_report::Report, global: &Global) -> Result<Exit> {
    let figures: Vec<_> = report.figures.iter().map(|figure| figure.name.as_str()).collect();
    let exit = if report.fault.is_some() { Exit::Unsound } else { Exit::Done };
    if global.format == Format::Json {
        let message = json!({
            "outcome": exit.to_json(), "page": page.display().to_string(), "figures": figures, "fault": report.fault,
        });
        print_json(&message)?;
        return Ok(exit);
    }
    if !global.quiet {
        let size = report.html.len() as f64 / 1e6;
        writeln!(terminal::stdout(), "{} ({size:.1} MB), {} figures", page.display(), figures.len())?;
    }
    Ok(exit)
}
