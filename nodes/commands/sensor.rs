//! `sensor`: how a sensor errs, from scans of parts whose shape is known.

use super::common::{Exit, Format, Global, print_json, progress::Progress, running, terminal};
use crate::app::SensorRequest;
use anyhow::Result;
use clap::Args;
use std::{io::Write, sync::Arc};

/// Measure how a sensor errs, from scans of a part whose shape is known.
///
/// Each scan is registered onto the part as by `register`, and what remains is told apart: noise of single points, what neighbours share, what
/// a whole scan shares, scale, outliers. The profile holds these for `register --sensor FILE`. A scan that is not of the part, or whose place on
/// it is in doubt, is left out by name. What is measured, and what is not: docs/method/sensors.md.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow sensor scans --part gauge.stl --out my_camera.toml --page my_camera.html
  osteoflow sensor scans --part ball:12.7 --like laser
  osteoflow sensor traces --part gauge.stl --like stylus --out my_stylus.toml
  osteoflow sensor scans --part gauge.stl --part plate.stl          gauge_1.ply is of gauge.stl, plate_1.ply of plate.stl
  osteoflow register bone.stl scan.ply --sensor my_camera.toml
  osteoflow sensor readings.csv --standard f2554 --reference divots.csv")]
pub(crate) struct Sensor {
    #[command(flatten)]
    request: SensorRequest,
}

impl Sensor {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let (request, cancelled) = (self.request.clone(), Arc::default());
        let until = Arc::clone(&cancelled);
        let progress = Progress::begin("", None, global);
        let work = move |progress: &Progress| request.run(progress, &until);
        let Some(measured) = running::watch(progress, cancelled, work)? else { return Ok(Exit::Interrupted) };
        if global.format == Format::Json {
            print_json(&measured.json)?;
            return Ok(Exit::Done);
        }
        measured.lines.iter().try_for_each(|line| writeln!(terminal::stdout(), "{line}"))?;
        measured.notes.iter().filter(|_| !global.quiet).try_for_each(|note| global.say("note", note))?;
        Ok(Exit::Done)
    }
}
