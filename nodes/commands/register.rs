//! `register`: two files to a pose and a verdict.

mod text;

use super::common::{Exit, Format, Global, graph_args::or_faults, progress::Progress, running, terminal};
use crate::app::{Register as Checked, RegisterRequest, Registration, is_said_by_verdict, without_reason};
use anyhow::Result;
use clap::Args;
use std::{io::Write, sync::Arc};

/// Register one file onto another, without a graph: the SOURCE moves, the TARGET stays.
///
/// TARGET is the bone: a surface (points are sampled from it), a cloud of points, or a CT. SOURCE is the scan: points, or a surface,
/// whose vertices are taken. Surfaces and points are PLY, STL, OBJ, OFF, VTK, PCD or text. A CT is NIfTI, NRRD, MetaImage, or a folder
/// with a DICOM series (docs/use/formats.md). Normals (directions at right angles to the surface) are estimated if a file has none. Lengths are
/// millimetres. Each file has a frame of its own, and the pose takes coordinates in the source's frame to the target's. Methods,
/// parameters and defaults are those of the nodes `icp.*`.
///
/// The first line is the verdict: trusted, doubtful or refused, with reasons (docs/begin/can-i-trust-it.md). A refused pose is not
/// given. A warning says if the registration has not converged, or if the scan can slide or turn without a change of the residuals
/// (undetermined). The exit code is 3 if there is no pose: it is refused, or there are too few pairs, no points, or no surface to estimate normals from.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow register bone.stl scan.ply                        starts by the shape of the bone alone
  osteoflow register bone.stl scan.ply --out DIR              and writes pose and moved scan
  osteoflow register bone.stl scan.ply --landmarks plan.mrk.json picked.txt
  osteoflow register bone.stl scan.ply --targets screws.mrk.json   predicts the error there
  osteoflow register bone.stl scan.ply --init init.txt
  osteoflow register bone.stl scan.ply --init coarse.tfm --method point_to_point -v
  osteoflow register bone.stl scan.xyz --source-unit-mm 1000 --camera 0,0,0 --out pose.txt
  osteoflow register bone.stl scan.ply --init pose.json --set trim_fraction=0.2 --trace steps.csv
  osteoflow register bone.stl scan.ply --plugin my_icp/my_icp.py   registers by your own method
  osteoflow register legs.stl scan.ply --component 2 --box=-60,-40,150,60,40,250
  osteoflow register bone.stl scan.ply --region region.json        a region drawn by hand
  osteoflow register bone.stl scan.ply --repeat 10 --workers 1 --format json | jq .align_ms

The parameters for --set: osteoflow inspect icp.point_to_plane

Timings:
  load         reading and parsing the files
  prep_target  sampling a surface, its normals and search structures; or reading all from the store
  start        finding the start by shape or from picked points, once
  prep_source  zero: part of align
  align        the registration; cpu is its processor time
  verdict      judging the pose; --no-verdict saves it

Exit codes:
    0  there is a pose; heed the verdict and the warnings
    1  a file is missing or cannot be written, or that of --init, --landmarks or --fiducials is bad
    2  a fault of the command line
    3  the pose is refused, or no registration is possible; the reason is printed
  130  interrupted")]
pub(crate) struct Register {
    #[command(flatten)]
    request: RegisterRequest,
}

impl Register {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let checked = self.request.clone().check();
        let Some(checked) = or_faults(checked, |_| &[], global)?.map(Arc::new) else { return Ok(Exit::Usage) };
        running::make_pool(self.request.workers)?;
        let progress = Progress::begin("", Some(checked.plan().nodes.len()), global);
        let cancelled = Arc::default();
        let (work, until) = (checked.clone(), Arc::clone(&cancelled));
        let registration = running::watch(progress, cancelled, move |progress| work.run(progress, &until))?;
        let Some(mut registration) = registration else { return Ok(Exit::Interrupted) };
        let not_written = registration.not_written.take();
        let exit = self.print(&registration, &checked, global)?;
        // The pose took a while, and the disk may be full only now.
        not_written.map_or(Ok(exit), |error| Err(error.context("the pose is printed, and not written")))
    }

    /// Prints the answer, and returns the exit code.
    fn print(&self, registration: &Registration, checked: &Checked, global: &Global) -> Result<Exit> {
        let exit = Exit::of(&registration.run.outcome);
        if !global.quiet {
            if global.format == Format::Text {
                for note in registration.notes(checked) {
                    global.say("note", note)?;
                }
            }
            let is_text = global.format == Format::Text;
            let results = &registration.run.results;
            let is_new = |warning: &String| !(is_text && is_said_by_verdict(warning, results));
            for warning in registration.warnings(checked).iter().filter(|warning| is_new(warning)) {
                global.say("warning", warning)?;
            }
        }
        match (exit, registration.refusal_text(checked)) {
            (Exit::Interrupted, _) => global.say("interrupted", "there is no pose")?,
            (_, Some(why)) if global.format == Format::Text => {
                global.say("refused", without_reason(why, &registration.run.results))?
            }
            (_, Some(why)) => global.say("refused", why)?,
            (_, None) => {}
        }
        let mut out = terminal::stdout().lock();
        match global.format {
            // One line, so that the last line is the answer wherever others print before it.
            Format::Json => {
                writeln!(out, "{}", registration.to_json(checked, exit.to_json(), global.verbose > 0))?;
            }
            Format::Text if registration.has_ended() => {
                write!(out, "{}", text::text(registration, checked, global))?;
            }
            Format::Text => {}
        }
        Ok(exit)
    }
}
