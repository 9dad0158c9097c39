use super::{Exit, Format, Global, PluginArgs, UsageError, print_json};
use anyhow::Result;
use clap::Args;
use osteoflow_engine::{run::files, sweep};
use serde_json::json;
use std::{
    io::Write,
    path::{Path, PathBuf},
};

/// Write one HTML page of a run or a sweep: figures, views that turn under the mouse, tables, methods, provenance.
///
/// The page opens without a network. Beside it lie its drawings and its views from one side (figures/*.svg), and the literature of the nodes that were
/// used (citations.bib). Of a run it shows the recorded wires; what was not recorded is named, with what to record.
/// Of a sweep two runs are run once more, for their surfaces.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow report runs/fibula-20260314-092653
  osteoflow report runs/sensitivity-20260314-101500 --out sensitivity.html
What it shows: docs/report.md")]
pub(crate) struct Report {
    /// The folder of a run or of a sweep.
    dir: PathBuf,

    #[command(flatten)]
    plugins: PluginArgs,

    /// The page. Default: report.html in DIR.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

impl Report {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let registry = super::registry();
        let report = match self.holds() {
            Holds::Sweep => osteoflow_report::of_sweep(&self.dir, &registry, &self.plugins.kinds()?, true)?,
            Holds::Run => osteoflow_report::of_run(&self.dir, &registry)?,
            Holds::Neither => {
                let said = format!(
                    "{} is no folder of a run ({} is missing) or of a sweep ({} is missing); name one that `osteoflow run` \
                     or `osteoflow sweep` has left",
                    self.dir.display(),
                    files::MANIFEST,
                    sweep::DESIGN
                );
                return Err(UsageError(said).into());
            }
        };
        let page = self.out.clone().unwrap_or_else(|| self.dir.join(osteoflow_report::PAGE));
        report.write(&self.dir, &page)?;
        tell(&page, &report, global)
    }

    fn holds(&self) -> Holds {
        match () {
            () if self.dir.join(sweep::DESIGN).is_file() => Holds::Sweep,
            () if self.dir.join(files::MANIFEST).is_file() => Holds::Run,
            () => Holds::Neither,
        }
    }
}

enum Holds {
    Run,
    Sweep,
    Neither,
}

fn tell(page: &Path, report: &osteoflow_report::Report, global: &Global) -> Result<Exit> {
    let figures: Vec<_> = report.figures.iter().map(|figure| figure.name.as_str()).collect();
    if global.format == Format::Json {
        let exit = Exit::Done;
        let said = json!({ "outcome": exit.to_json(), "page": page.display().to_string(), "figures": figures });
        print_json(&said)?;
        return Ok(exit);
    }
    if !global.quiet {
        let size = report.html.len() as f64 / 1e6;
        writeln!(std::io::stdout(), "{} ({size:.1} MB), {} drawings beside it", page.display(), figures.len())?;
    }
    Ok(Exit::Done)
}
