mod openigtlink;

use super::common::{Exit, Global, terminal};
use crate::app::SimulateRequest;
use anyhow::Result;
use clap::Args;
use openigtlink::ScanType;
use std::{io::Write, path::PathBuf};

/// Write a simulated procedure as files that other programs can read: on the built-in bone, or on your own.
///
/// A recording in Foxglove's schemas (or a folder of plain files), the CT surface, the phantom, the plan, and the ground
/// truth, with a README that explains how they were made; or the streams over OpenIGTLink, as their devices would send them.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow simulate --seed 7 --out /tmp/procedure
  osteoflow simulate --points 4000 --out /tmp/small
  osteoflow simulate --bone fibula.stl --plan anatomy.json --out /tmp/mine
  osteoflow simulate --set ct_bone.mirrored=true --set tissue.share=0.2 --out /tmp/wrong_leg
  osteoflow simulate --openigtlink 18944 --rate 10
  osteoflow run graphs/fibula_recorded.toml --set recording.path=/tmp/procedure/procedure.mcap \\
      --set bone.path=/tmp/procedure/bone.stl --set phantom.path=/tmp/procedure/phantom.stl \\
      --set plan.path=/tmp/procedure/plan.json")]
pub(crate) struct Simulate {
    #[command(flatten)]
    request: SimulateRequest,

    /// Play the procedure over OpenIGTLink, as a PLUS server would: wait at this port of 127.0.0.1 for one client, send, and end.
    /// 0 is a free port, which is printed.
    #[arg(long, value_name = "PORT")]
    openigtlink: Option<u16>,

    /// The speed of --openigtlink relative to the procedure's own time.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, requires = "openigtlink", value_parser = rate)]
    rate: f64,

    /// The type of the scans of --openigtlink.
    #[arg(long, value_enum, default_value_t = ScanType::Image, value_name = "TYPE", requires = "openigtlink")]
    scans: ScanType,

    /// The folder to write into.
    #[arg(long, value_name = "DIR", required_unless_present = "openigtlink")]
    out: Option<PathBuf>,
}

impl Simulate {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let mut warn = |note: &str| drop(writeln!(terminal::stderr(), "warning: {note}"));
        let procedure = self.request.simulate(self.out.as_deref(), &mut warn)?;
        if let Some(dir) = self.out.as_ref().filter(|_| !global.quiet) {
            writeln!(terminal::stderr(), "SIMULATED procedure of seed {} in {}", self.request.seed, dir.display())?;
        }
        if let Some(port) = self.openigtlink {
            openigtlink::serve(&procedure, port, self.rate, self.scans, global)?;
        }
        Ok(Exit::Done)
    }
}

fn rate(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(rate) if (0.001..=1e9).contains(&rate) => Ok(rate),
        _ => Err("a speed is a number from 0.001 to 1e9".into()),
    }
}
