use super::common::{Exit, Format, Global, print_json, terminal, text_table::TextTable};
use anyhow::{Context, Result};
use clap::Args;
use serde::Serialize;
use serde_json::Value;
use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
};

/// List the runs in a folder: graph, when, how long, verdict and error.
///
/// The error is the mean TRE where the truth is known (simulated), else that measured with the stylus, else empty.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow runs
  osteoflow runs study --format json | jq '.[] | select(.verdict != \"trusted\")'")]
pub(crate) struct Runs {
    /// The folder that holds the folders of runs.
    #[arg(default_value = "runs", value_name = "DIR")]
    folder: PathBuf,
}

/// A run, from its manifest and results.
#[derive(Debug, Serialize)]
struct Row {
    folder: String,
    graph: Option<String>,
    began: Option<String>,
    elapsed_ms: Option<f64>,
    status: Option<String>,
    verdict: Option<String>,
    tre_mm: Option<f64>,
    /// `true`, `measured`, or none.
    tre: Option<&'static str>,
    /// Why manifest or results could not be read.
    problem: Option<String>,
}

impl Runs {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let entries =
            fs::read_dir(&self.folder).with_context(|| format!("{} cannot be read", self.folder.display()))?;
        let mut folders: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
        folders.retain(|path| path.join("manifest.json").is_file());
        folders.sort();
        let mut rows: Vec<Row> = folders.iter().map(|folder| Row::of(folder)).collect();
        rows.sort_by(|a, b| (&a.began, &a.folder).cmp(&(&b.began, &b.folder)));
        match global.format {
            Format::Json => print_json(&serde_json::to_value(&rows)?)?,
            Format::Text => print_text(&self.folder, &rows)?,
        }
        Ok(Exit::Done)
    }
}

impl Row {
    fn of(folder: &Path) -> Self {
        let (manifest, bad_manifest) = json(&folder.join("manifest.json"));
        let (results, bad_results) = json(&folder.join("results.json"));
        let text = |value: &Value, key: &str| value.pointer(key).and_then(Value::as_str).map(String::from);
        let mean = |key: &str| results.pointer(key).and_then(Value::as_f64);
        let known = mean("/metrics/tre_true_mm/mean_abs/norm").map(|mm| (mm, "true"));
        let tre = known.or_else(|| mean("/metrics/tre_measured_mm/mean_abs/norm").map(|mm| (mm, "measured")));
        Self {
            folder: folder.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned()),
            graph: text(&manifest, "/graph/name"),
            began: text(&manifest, "/began"),
            elapsed_ms: manifest.get("elapsed_ms").and_then(Value::as_f64),
            status: text(&manifest, "/outcome/status"),
            verdict: text(&results, "/verdict/answer"),
            tre_mm: tre.map(|(mm, _)| mm),
            tre: tre.map(|(_, which)| which),
            problem: bad_manifest.or(bad_results),
        }
    }
}

/// The file as JSON, or null with the reason.
fn json(file: &Path) -> (Value, Option<String>) {
    let problem = |error: &dyn std::fmt::Display| (Value::Null, Some(format!("{}: {error}", file.display())));
    match osteoflow_engine::regular(file).and_then(fs::read) {
        Ok(bytes) => match serde_json::from_slice(&bytes) {
            Ok(value) => (value, None),
            Err(error) => problem(&error),
        },
        Err(error) => problem(&error),
    }
}

fn print_text(folder: &Path, rows: &[Row]) -> Result<()> {
    let mut out = terminal::stdout().lock();
    if rows.is_empty() {
        writeln!(out, "no runs in {}", folder.display())?;
        return Ok(());
    }
    let mut table = TextTable::new("run", &["graph", "began", "s", "status", "verdict", "TRE mm"]);
    for row in rows {
        let text = |text: &Option<String>| text.clone().unwrap_or_default();
        let began = text(&row.began).replace('T', " ").split('.').next().unwrap_or_default().to_owned();
        let tre = row.tre_mm.zip(row.tre).map_or_else(String::new, |(mm, which)| format!("{mm:.2} {which}"));
        let seconds = row.elapsed_ms.map_or_else(String::new, |ms| format!("{:.1}", ms * 1e-3));
        table.row(&row.folder, [text(&row.graph), began, seconds, text(&row.status), text(&row.verdict), tre]);
    }
    write!(out, "{}", table.lines())?;
    for problem in rows.iter().filter_map(|row| row.problem.as_ref()) {
        writeln!(out, "problem: {problem}")?;
    }
    Ok(())
}
