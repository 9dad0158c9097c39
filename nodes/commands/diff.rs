use super::common::{Exit, Format, Global, print_json, progress::Reading, run_path, terminal, text_table::TextTable};
use anyhow::Result;
use clap::Args;
use osteoflow_engine::diff::{DiffOptions, DiffReport, Difference, Largest, WireDiff, diff};
use serde_json::{Value, json};
use std::{io::Write, path::PathBuf};

/// Compare two recordings: where they diverge first, and by how much each wire differs.
///
/// What differs in what made them comes first: entries of the graph, seed, program, plugins with what they load, input files.
/// The first divergence is the earliest in the topological order of the graph in A, then by item number. Bits are compared,
/// so NaN equals NaN and -0.0 differs from 0.0. Exit code 0: equal; 4: different.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow diff runs/first runs/second
  osteoflow diff a.mcap b.mcap --wires 'icp.*' 'planes.*'
  osteoflow diff a.mcap b.mcap --tolerance 1e-9  equal within 1e-9 mm and 1e-9 rad")]
pub(crate) struct Diff {
    /// The first run's folder or recording; its graph gives the order.
    a: PathBuf,

    /// The second run's folder or recording.
    b: PathBuf,

    /// Wires as NODE.PORT; * matches any characters. Default: all.
    #[arg(long, value_name = "GLOB", num_args = 1..)]
    wires: Vec<String>,

    /// Numbers that differ by at most this, each in its own unit, count as equal.
    #[arg(long, value_name = "VALUE", default_value_t = 0.0)]
    tolerance: f64,
}

impl Diff {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        if !(self.tolerance >= 0.0 && self.tolerance.is_finite()) {
            usage!("--tolerance takes a number that is not negative, not {}", self.tolerance);
        }
        let options = DiffOptions { wires: self.wires.clone(), tolerance: self.tolerance };
        let [a, b] = [run_path::recording(&self.a)?, run_path::recording(&self.b)?];
        let report = Reading::of("comparing", &a, global, |progress| diff(&a, &b, &options, progress))?;
        if report.wires.is_empty() && !self.wires.is_empty() {
            usage!("no wire of either recording is called {}", self.wires.join(" or "));
        }
        let exit = if report.is_equal() { Exit::Done } else { Exit::Differs };
        match global.format {
            Format::Json => print_json(&as_json(&report, exit))?,
            Format::Text => self.print_text(&report, global)?,
        }
        Ok(exit)
    }

    fn print_text(&self, report: &DiffReport, global: &Global) -> Result<()> {
        for (path, side) in [&self.a, &self.b].into_iter().zip(&report.sides) {
            if let Some(reason) = &side.incomplete {
                let path = path.display();
                global.say("warning", format!("{path} may lack items ({reason}); the rest is compared"))?;
            }
        }
        let mut out = terminal::stdout().lock();
        if !global.quiet && !report.made.is_empty() {
            writeln!(out, "made by")?;
            report.made.iter().try_for_each(|difference| writeln!(out, "  {difference}"))?;
            writeln!(out)?;
        }
        if let Some(first) = &report.first {
            let (wire, item) = (&first.wire, first.item);
            writeln!(out, "{}: wire {wire}, item {item}", global.paint_out("first divergence", "1;31"))?;
            writeln!(out, "  {}", first.what.field)?;
            writeln!(out, "  A  {}", first.what.a)?;
            writeln!(out, "  B  {}", first.what.b)?;
            let apart = apart(&first.what);
            if !apart.is_empty() {
                writeln!(out, "  {apart}")?;
            }
            writeln!(out)?;
        }
        if !global.quiet {
            let mut table = TextTable::new("wires", &["A", "B", "differ", "largest ulp"]);
            for wire in &report.wires {
                let [n_a, n_b] = wire.n_items;
                let ulp = if wire.largest == Largest::default() { String::new() } else { wire.largest.ulp.to_string() };
                let differ = (wire.n_differ + wire.n_only[0] + wire.n_only[1]).to_string();
                table.row(&wire.wire, [n_a.to_string(), n_b.to_string(), differ, ulp, remark(wire)]);
            }
            writeln!(out, "{}", table.lines())?;
            if report.same_results == Some(false) {
                writeln!(out, "the results differ")?;
            }
        }
        let n_differ = report.wires.iter().filter(|wire| !wire.is_equal()).count();
        let n = report.wires.len();
        match n_differ {
            0 if report.wires.iter().any(|wire| wire.n_within > 0) => {
                writeln!(out, "equal within {:e}: {n} wires", self.tolerance)?;
            }
            0 => writeln!(out, "equal: {n} wires")?,
            _ => writeln!(out, "{n_differ} of {n} wires differ")?,
        }
        Ok(())
    }
}

/// Formats the difference between two values.
pub(super) fn apart(what: &Difference) -> String {
    let mut parts = Vec::new();
    if let Some(distance) = what.distance {
        parts.push(format!("{distance:e} {}", what.unit.as_deref().unwrap_or("")).trim_end().to_owned() + " apart");
    }
    parts.extend(what.ulp.map(|ulp| format!("{ulp} ulp")));
    parts.extend(what.note.clone());
    parts.join(", ")
}

/// Remarks about a wire, beside its counts.
fn remark(wire: &WireDiff) -> String {
    let mut parts = Vec::new();
    match wire.present {
        [true, false] => parts.push("only in A".into()),
        [false, true] => parts.push("only in B".into()),
        _ => {
            for (side, n) in ["A", "B"].iter().zip(wire.n_only).filter(|(_, n)| *n > 0) {
                parts.push(format!("{n} only in {side}"));
            }
            if wire.payloads[0] != wire.payloads[1] {
                parts.push(format!("{} and {}", wire.payloads[0], wire.payloads[1]));
            }
        }
    }
    parts
        .extend(wire.largest.by_unit.iter().map(|(unit, distance)| format!("{distance:.3e} {unit}").trim().to_owned()));
    let counts = [(wire.n_stamps, "stamps"), (wire.n_empties, "empties"), (wire.n_within, "within the tolerance")];
    parts.extend(counts.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")));
    if parts.is_empty() && wire.is_equal() { "equal".into() } else { parts.join(", ") }
}

fn as_json(report: &DiffReport, exit: Exit) -> Value {
    let wires = report.wires.iter().map(|wire| {
        json!({
            "wire": wire.wire,
            "equal": wire.is_equal(),
            "in_a": wire.present[0], "in_b": wire.present[1],
            "items_a": wire.n_items[0], "items_b": wire.n_items[1],
            "payload_a": wire.payloads[0], "payload_b": wire.payloads[1],
            "differ": wire.n_differ,
            "within_tolerance": wire.n_within,
            "only_in_a": wire.n_only[0], "only_in_b": wire.n_only[1],
            "stamps": wire.n_stamps,
            "empties": wire.n_empties,
            "largest_ulp": wire.largest.ulp,
            "largest_by_unit": wire.largest.by_unit,
            "first": wire.first.as_ref().map(|(item, what)| json!({ "item": item, "what": what })),
        })
    });
    json!({
        "outcome": exit.to_json(),
        "equal": report.is_equal(),
        "first": report.first,
        "made": report.made,
        "same_graph": report.same_graph,
        "same_results": report.same_results,
        "a": report.sides[0],
        "b": report.sides[1],
        "wires": wires.collect::<Value>(),
    })
}
