use super::common::{Exit, Format, Global, print_json, progress::Reading, run_path, terminal, text_table::TextTable};
use crate::app::registry;
use anyhow::Result;
use clap::Args;
use osteoflow_engine::validate::{Finding, ValidateReport, validate};
use serde_json::{Value, json};
use std::{
    io::Write,
    path::{Path, PathBuf},
};

/// Check a recording from its first byte to its last: everything that is wrong with it is listed.
///
/// Checks CRCs of chunks and of the file, schemas, indexes and counts; for each wire that numbers have no gaps, stamps never
/// decrease and items decode; and the metadata of the run. What damage takes with it is counted once. Exit code 0: sound; 1:
/// not. For an MCAP file of another program only the container is checked, and habits of its writer are notes.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow validate runs/fibula-20260314-092653
  osteoflow validate run.mcap --format json
  osteoflow recover run.mcap saved.mcap          what to do with one that is not sound")]
pub(crate) struct Validate {
    /// A run's folder or its run.mcap, or any MCAP file.
    #[arg(value_name = "RUN")]
    file: PathBuf,
}

impl Validate {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let file = run_path::recording(&self.file)?;
        let report = Reading::of("checking", &file, global, |progress| validate(&file, &registry(), progress))?;
        let exit = if report.is_sound() { Exit::Done } else { Exit::Unsound };
        match global.format {
            Format::Json => print_json(&as_json(&file, &report, exit))?,
            Format::Text => print_text(&file, &report, global)?,
        }
        Ok(exit)
    }
}

fn print_text(path: &Path, report: &ValidateReport, global: &Global) -> Result<()> {
    let mut out = terminal::stdout().lock();
    if !global.quiet && !report.wires.is_empty() {
        let mut table = TextTable::new("wires", &["payload", "items", "values", "views"]);
        for wire in &report.wires {
            let counts = [wire.n_items, wire.n_values, wire.n_views].map(|n| n.to_string());
            table.row(&wire.wire, std::iter::once(wire.payload.clone()).chain(counts));
        }
        writeln!(out, "{}", table.lines())?;
    }
    for finding in &report.findings {
        writeln!(out, "{}: {finding}", global.paint_out("wrong", "1;31"))?;
    }
    let n_more = report.n_findings - report.findings.len() as u64;
    if n_more > 0 {
        writeln!(out, "{}: {n_more} more of these kinds", global.paint_out("wrong", "1;31"))?;
    }
    if !global.quiet {
        report.notes.iter().try_for_each(|note| writeln!(out, "note: {note}"))?;
    }
    let verdict = match report.n_findings {
        0 => "sound".to_owned(),
        n => format!("not sound: {n} findings"),
    };
    let (file, n_messages, n_chunks) = (path.display(), report.n_messages, report.n_chunks);
    writeln!(out, "{file}: {verdict}; {n_messages} messages in {n_chunks} chunks, {} bytes", report.n_bytes)?;
    Ok(())
}

fn as_json(path: &Path, report: &ValidateReport, exit: Exit) -> Value {
    let finding = |finding: &Finding| {
        json!({
            "wire": finding.wire,
            "item": finding.item,
            "byte": finding.place.map(|place| place.offset),
            "byte_in_chunk": finding.place.and_then(|place| place.in_chunk),
            "what": finding.what,
        })
    };
    let wires = report.wires.iter().map(|wire| {
        json!({
            "wire": wire.wire,
            "payload": wire.payload,
            "items": wire.n_items,
            "values": wire.n_values,
            "views": wire.n_views,
        })
    });
    json!({
        "outcome": exit.to_json(),
        "file": path.display().to_string(),
        "sound": report.is_sound(),
        "recording": report.is_recording,
        "findings": report.findings.iter().map(finding).collect::<Value>(),
        "n_findings": report.n_findings,
        "notes": report.notes,
        "messages": report.n_messages,
        "chunks": report.n_chunks,
        "bytes": report.n_bytes,
        "wires": wires.collect::<Value>(),
    })
}
