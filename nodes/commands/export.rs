use super::common::{Exit, Format, Global, print_json, progress::Reading, terminal};
use crate::app::ExportRequest;
use anyhow::Result;
use clap::Args;
use serde_json::json;
use std::io::Write;

/// Pack a run or a sweep into one file, which can be run again elsewhere: graph, plugins, inputs, results, provenance.
///
/// The archive is a zip that names no folder of this machine; ro-crate-metadata.json in it describes it as a Workflow Run RO-Crate.
/// The same folder gives the same bytes. Nothing is overwritten.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow export runs/sensitivity-20260314-101500 sensitivity.zip
  osteoflow export S S.zip --no-data            without the scans; the reader has them, or asks for them
  osteoflow sweep S.zip --allow-plugins --out again && osteoflow compare S.zip again
What it holds: docs/use/archives.md")]
pub(crate) struct Export {
    #[command(flatten)]
    request: ExportRequest,
}

impl Export {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let exported = Reading::of("packing", &self.request.from, global, |progress| self.request.export(progress))?;
        let to = self.request.to.display().to_string();
        if global.format == Format::Json {
            print_json(&json!({
                "outcome": Exit::Done.to_json(), "archive": to, "bytes": exported.bytes, "files": exported.n_files,
                "inputs_left_out": exported.n_without, "notes": exported.notes,
            }))?;
            return Ok(Exit::Done);
        }
        if !global.quiet {
            for note in &exported.notes {
                global.say("warning", note)?;
            }
            let without = match exported.n_without {
                0 => String::new(),
                n => format!(", without {n} inputs"),
            };
            let size = exported.bytes as f64 / 1e6;
            writeln!(terminal::stdout(), "{to} ({size:.1} MB), {} files{without}", exported.n_files)?;
        }
        Ok(Exit::Done)
    }
}
