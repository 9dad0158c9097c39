//! `info`: what a file or folder holds.

mod contents;
mod poses;

use super::common::{Exit, Format, Global, LogArgs, print_json, terminal, text_table::TextTable};
use anyhow::Result;
use clap::Args;
use contents::{Contents, Topic};
use std::{io::Write, path::PathBuf};

/// Say what a file or folder is: what it holds, and the command that would use it.
///
/// Surfaces, clouds, picked points, CTs, poses, logs of poses, plans, recordings, graphs, folders of a procedure, of a run or of a ROS 2 bag, archives of `osteoflow export`; recognised by content, not
/// by name. A damaged file that can be read in part is read in part, and what is wrong with it is listed under problems; one
/// that cannot be read is refused with the reason. Exit code 0 if it can be used, problems or not.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow info scan.ply
  osteoflow info procedure.mcap
  osteoflow info study --series 201
  osteoflow info pivot.igs.mha
  osteoflow info polaris.csv --columns polaris.toml
  osteoflow info bone.stl --format json | jq .extent_mm

Keys of --format json, where they apply:
  kind        mesh, cloud, points, ct, study, pose, poses, plan, region, recording, procedure, run, results, archive, graph
  n_points    number of points, those that were dropped left out; n_dropped: those that were not finite
  parts       of a surface or a cloud, the largest first: number, n_points, n_faces, area_mm2, extent_mm, centre_mm; n_parts
  extent_mm   edges of the box around the points
  series      of a study: name, choice (what --series takes), why_not where it is no CT
  space       LPS or RAS where the file states it, else unknown
  topics      with schema, encoding, number of messages, rate, times, and the pairs of frames, parent -> child
  transforms  of a log of poses: parent, child, n_poses, n_lost, rate_hz, first_ns, last_ns, extent_mm
  problems    what is wrong with it, one sentence each
  use         commands that would use it")]
pub(crate) struct Info {
    /// The file or folder.
    file: PathBuf,

    /// Which DICOM series of a folder: its number, or the ending of its identifier. Without it, several are listed.
    #[arg(long, value_name = "SERIES")]
    series: Option<String>,

    #[command(flatten)]
    log: LogArgs,
}

impl Info {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let contents = contents::of(&self.file, self.series.as_deref(), &self.log)?;
        match global.format {
            Format::Json => print_json(&contents.to_json())?,
            Format::Text => self.print_text(&contents, global)?,
        }
        Ok(Exit::Done)
    }

    fn print_text(&self, contents: &Contents, global: &Global) -> Result<()> {
        let mut out = terminal::stdout().lock();
        writeln!(out, "{}: {}", self.file.display(), contents.about)?;
        for (name, value) in &contents.lines {
            writeln!(out, "  {name:<11} {value}")?;
        }
        if !contents.topics.is_empty() {
            let mut table = TextTable::new("topics", &["schema", "encoding", "messages", "per second", "frame"]);
            for topic in &contents.topics {
                let Topic { name, schema, encoding, n_messages, rate_hz, frame, .. } = topic;
                let rate = rate_hz.map_or_else(String::new, |hz| format!("{hz:.1}"));
                let frame = frame.clone().unwrap_or_default();
                table.row(name, [schema.clone(), encoding.clone(), n_messages.to_string(), rate, frame]);
            }
            write!(out, "\n{}", table.lines())?;
        }
        for problem in &contents.problems {
            writeln!(out, "{}: {problem}", global.paint_out("problem", "1;31"))?;
        }
        for note in &contents.notes {
            writeln!(out, "note: {note}")?;
        }
        if !global.quiet && !contents.used_by.is_empty() {
            writeln!(out, "\nuse it with")?;
            contents.used_by.iter().try_for_each(|command| writeln!(out, "  {command}"))?;
        }
        Ok(())
    }
}
