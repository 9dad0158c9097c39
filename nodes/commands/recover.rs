use super::common::{Exit, Format, Global, print_json, progress::Reading, terminal, text_table::TextTable};
use crate::app::UsageError;
use anyhow::Result;
use clap::Args;
use osteoflow_engine::recover::{RecoverError, RecoverReport, RecoveredWire, recover};
use serde_json::{Value, json};
use std::{io::Write, path::PathBuf};

/// Copy what is intact in a damaged recording into a new file: what is missing is reported.
///
/// Every chunk with a valid CRC is kept, also behind damage. Items keep their numbers; gaps stay gaps. A replay of the new
/// file computes everything before the first damage; `digest`, `diff` and `validate` accept all of it and report that it is
/// partial. Nothing is overwritten.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow recover killed/run.mcap saved.mcap
  osteoflow validate saved.mcap && osteoflow replay saved.mcap")]
pub(crate) struct Recover {
    /// The damaged file; it is only read.
    #[arg(value_name = "IN")]
    from: PathBuf,

    /// The file to write; it must not exist.
    #[arg(value_name = "OUT")]
    to: PathBuf,
}

impl Recover {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let report = Reading::of("recovering", &self.from, global, |progress| recover(&self.from, &self.to, progress));
        let report = report.map_err(|error| match error {
            RecoverError::Exists { .. } => UsageError(error.to_string()).into(),
            other => anyhow::Error::from(other),
        })?;
        match global.format {
            Format::Json => print_json(&self.as_json(&report))?,
            Format::Text => self.print_text(&report, global)?,
        }
        Ok(Exit::Done)
    }

    fn print_text(&self, report: &RecoverReport, global: &Global) -> Result<()> {
        let mut out = terminal::stdout().lock();
        if !global.quiet {
            let mut table = TextTable::new("wires", &["items"]);
            for wire in &report.wires {
                table.row(&wire.wire, [wire.n_items.to_string(), missing(wire)]);
            }
            writeln!(out, "{}", table.lines())?;
        }
        for damage in &report.damages {
            writeln!(out, "lost: {damage}")?;
        }
        for finding in &report.unsound {
            writeln!(
                out,
                "not sound: {finding}; graph, results and hashes in the new file may not be those of the run"
            )?;
        }
        for lost in &report.lost {
            writeln!(out, "lost: {lost}")?;
        }
        if report.n_unknown > 0 {
            writeln!(out, "lost: {} messages of channels whose description is lost", report.n_unknown)?;
        }
        if !report.is_recording() {
            writeln!(out, "it can be digested and compared, but not replayed, because the graph is lost")?;
        }
        let (n, of) = (report.bytes_lost(), report.n_bytes);
        let what = match report.is_whole() {
            true => "nothing is missing".into(),
            false if !report.unsound.is_empty() => "it is not whole".into(),
            false => format!("{n} of {of} bytes are lost"),
        };
        writeln!(out, "{} messages in {}; {what}", report.n_messages, self.to.display())?;
        Ok(())
    }

    fn as_json(&self, report: &RecoverReport) -> Value {
        let damages = report
            .damages
            .iter()
            .map(|damage| json!({ "from_byte": damage.bytes.start, "to_byte": damage.bytes.end, "what": damage.cause.to_string() }));
        let wires = report.wires.iter().map(|wire| {
            json!({
                "wire": wire.wire,
                "items": wire.n_items,
                "before_damage": wire.before_damage,
                "missing": wire.missing.iter().map(|hole| [*hole.start(), *hole.end()]).collect::<Vec<_>>(),
                "open_end": wire.open_end,
            })
        });
        json!({
            "outcome": Exit::Done.to_json(),
            "file": self.to.display().to_string(),
            "whole": report.is_whole(),
            "messages": report.n_messages,
            "bytes": report.n_bytes,
            "bytes_lost": report.bytes_lost(),
            "damages": damages.collect::<Value>(),
            "unsound": report.unsound.iter().map(ToString::to_string).collect::<Vec<_>>(),
            "lost": report.lost,
            "messages_of_unknown_channels": report.n_unknown,
            "wires": wires.collect::<Value>(),
        })
    }
}

/// Formats the missing numbers.
fn missing(wire: &RecoveredWire) -> String {
    let range = |r: &std::ops::RangeInclusive<u64>| match (*r.start(), *r.end()) {
        (first, last) if first == last => first.to_string(),
        (first, last) => format!("{first} to {last}"),
    };
    let mut parts: Vec<_> = wire.missing.iter().take(5).map(range).collect();
    if wire.missing.len() > 5 {
        parts.push(format!("{} more runs", wire.missing.len() - 5));
    }
    match (parts.is_empty(), wire.open_end) {
        (true, true) => "its end may be missing".into(),
        (true, false) => String::new(),
        (false, true) => format!("missing: {}; its end may be missing too", parts.join(", ")),
        (false, false) => format!("missing: {}", parts.join(", ")),
    }
}
