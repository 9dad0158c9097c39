use super::common::{Exit, Format, Global, print_json, progress::Reading, run_path, terminal, text_table::TextTable};
use anyhow::Result;
use clap::Args;
use osteoflow_engine::recording::digest::{DigestReport, digest};
use serde_json::{Value, json};
use std::{
    io::Write,
    path::{Path, PathBuf},
};

/// Print the digest (checksum) of a recording: one of all its wires, and one for each wire.
///
/// SHA-256 over each wire's items by number, then over the wires by name: independent of the order of messages in the file,
/// of chunks, compression and log times. Equal digests mean equal bits on every recorded wire. The definition is in
/// docs/use/recording.md. Exit code 0 only for complete recordings.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow digest runs/fibula-20260314-092653
  osteoflow digest -q runs/*                     one line per file, as printed by sha256sum
  osteoflow digest run.mcap --format json")]
pub(crate) struct Digest {
    /// A run's folder or its run.mcap, or a file of `osteoflow record`.
    #[arg(required = true, value_name = "RUN")]
    files: Vec<PathBuf>,
}

impl Digest {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let mut exit = Exit::Done;
        let mut answers = Vec::new();
        for file in &self.files {
            let file = &run_path::recording(file)?;
            let report = Reading::of("reading", file, global, |progress| digest(file, progress));
            match &report {
                Ok(report) if report.incomplete.is_none() => {}
                _ => exit = Exit::Failed,
            }
            match (global.format, report) {
                (Format::Json, Ok(report)) => answers.push(as_json(file, &report)),
                (Format::Json, Err(error)) => {
                    answers.push(json!({ "file": file.display().to_string(), "error": error.to_string() }));
                }
                (Format::Text, Ok(report)) => print_text(file, &report, global)?,
                (Format::Text, Err(error)) => global.say("error", error)?,
            }
        }
        if global.format == Format::Json {
            print_json(&json!({ "outcome": exit.to_json(), "files": answers }))?;
        }
        Ok(exit)
    }
}

fn print_text(file: &Path, report: &DigestReport, global: &Global) -> Result<()> {
    for warning in report.incomplete.iter().chain(&report.partial) {
        global.say("warning", format!("{}: {warning}; the digest is of the remaining items", file.display()))?;
    }
    let mut out = terminal::stdout().lock();
    if !global.quiet {
        let mut table = TextTable::new("wires", &["payload", "items", "values", "digest"]);
        for wire in &report.wires {
            let payload = format!("{}@{}", wire.payload, wire.version);
            let digest = wire.digest.map_or("none".into(), |digest| digest.to_string());
            table.row(&wire.wire, [payload, wire.n_items.to_string(), wire.n_values.to_string(), digest]);
        }
        writeln!(out, "{}", table.lines())?;
    }
    let digest = report.digest.map_or("none".into(), |digest| digest.to_string());
    writeln!(out, "{digest}  {}", file.display())?;
    if !global.quiet {
        writeln!(out)?;
    }
    Ok(())
}

fn as_json(file: &Path, report: &DigestReport) -> Value {
    let wires = report.wires.iter().map(|wire| {
        json!({
            "wire": wire.wire,
            "payload": wire.payload,
            "version": wire.version,
            "items": wire.n_items,
            "values": wire.n_values,
            "missing": wire.missing.iter().map(|hole| [*hole.start(), *hole.end()]).collect::<Vec<_>>(),
            "digest": wire.digest.map(|digest| digest.to_string()),
        })
    });
    json!({
        "file": file.display().to_string(),
        "digest": report.digest.map(|digest| digest.to_string()),
        "incomplete": report.incomplete,
        "partial": report.partial,
        "wires": wires.collect::<Value>(),
    })
}
