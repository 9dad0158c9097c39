//! The example folder of a procedure.

use super::{FIBULA, File, print_next, without_schema, write};
use crate::app::{SimulateRequest, StreamFormat, out_dir};
use crate::commands::common::{Exit, Global};
use anyhow::Result;
use clap::Args;
use serde_json::json;
use std::path::PathBuf;

/// Create a folder with a simulated procedure as plain files, the graph that registers it, and a README that says which file to
/// replace by which of yours.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow new procedure my_procedure
  cd my_procedure && osteoflow run run.toml
The formats: docs/use/formats.md; `osteoflow schema --plan` writes the JSON Schema of plan.json.")]
pub(super) struct Procedure {
    /// The folder to write into, new or empty.
    dir: PathBuf,
}

/// The graphs that `run.toml` extends.
const GRAPHS: [File; 3] = [
    FIBULA,
    ("graphs/fibula_recorded.toml", include_str!("../../../graphs/fibula_recorded.toml")),
    ("graphs/fibula_folder.toml", include_str!("../../../graphs/fibula_folder.toml")),
];

const RUN: &str = "\
# The registration of the procedure in data/; its procedure.toml maps files to roles.
#
#   osteoflow run run.toml
extends = \"graphs/fibula_folder.toml\"

[graph]
name = \"procedure\"

[node.recording]
path = \"data\"

[node.plan]
path = \"data/plan.json\"

# A CT in place of the surface: kind = \"surface.ct\", path = \"CT\", threshold_hu = 600.
[node.bone]
path = \"data/bone.stl\"

[node.phantom]
path = \"data/phantom.stl\"
";

const README: &str = "\
# A procedure in files

    osteoflow run run.toml

registers the simulated procedure in `data/`: SIMULATED, research use only, not for clinical use. Replace the files
by yours, all of one procedure, and run again; what does not fit is refused by name.

| File | Content |
|---|---|
| `data/procedure.toml` | which file has which role, units and times |
| `data/scan.ply` | the scan of the bone, in the camera's coordinates |
| `data/laser_p1.ply` .. | the scans with the laser spot on each landmark, labelled as in the plan |
| `data/phantom_scan.ply` | the scan of the calibration phantom |
| `data/poses.csv` | the tracker: `t_ns,parent,child,x,y,z,qx,qy,qz,qw`, mm, a row without numbers where a marker was not seen |
| `data/stylus_*.csv` | points touched with the stylus: `name,x,y,z,t_ns`; leave them out if there are none |
| `data/plan.json` | landmarks, assessment points and cutting planes in the CT's coordinates, mm, LPS |
| `data/bone.stl` | the bone's surface from CT, mm, LPS |
| `data/phantom.stl` | the phantom's CAD |
| `data/truth.json` | where the simulated bone really was; no input |
";

impl Procedure {
    pub(super) fn execute(&self, global: &Global) -> Result<Exit> {
        let dir = &self.dir;
        out_dir::make_plain(dir, false, "name another folder")?;
        SimulateRequest::of_readme(StreamFormat::Folder).simulate(Some(&dir.join("data")), &mut |_| {})?;
        for (path, text) in GRAPHS {
            write(dir, path, without_schema(text))?;
        }
        write(dir, "run.toml", RUN)?;
        write(dir, "README.md", README)?;
        let commands = [format!("cd {}", dir.display()), "osteoflow run run.toml".to_owned()];
        print_next(&json!({ "folder": dir, "commands": commands }), "written, SIMULATED", &commands, global)
    }
}
