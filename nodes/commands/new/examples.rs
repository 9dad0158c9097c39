//! The shipped graphs and the example data as files.

use super::{print_next, write};
use crate::app::{SimulateRequest, StreamFormat, out_dir, registry, shipped};
use crate::commands::common::{Exit, Global};
use anyhow::{Context, Result};
use clap::Args;
use osteoflow_engine::schema;
use serde_json::json;
use std::path::{Path, PathBuf};

/// The schema of graph files, which is generated from the nodes.
const SCHEMA: &str = "graphs/osteoflow.schema.json";

/// Write the shipped graphs and the example data, at the paths that README and documentation name: every command there can be typed
/// in the folder.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow new examples osteoflow-examples && cd osteoflow-examples
  osteoflow register tests/data/folder/bone.stl tests/data/folder/scan.ply --camera 0,0,0
  osteoflow run graphs/fibula.toml")]
pub(super) struct Examples {
    /// The folder to write into, new or empty; about 11 MB.
    dir: PathBuf,
}

impl Examples {
    pub(super) fn execute(&self, global: &Global) -> Result<Exit> {
        let dir = &self.dir;
        out_dir::make_plain(dir, false, "name another folder")?;
        for (path, text) in shipped::FILES {
            write(dir, path, text)?;
            if text.starts_with("#!") {
                make_executable(&dir.join(path)).with_context(|| format!("{path} cannot be made a program"))?;
            }
        }
        let schema = serde_json::to_string_pretty(&schema::schema(&registry()))?;
        write(dir, SCHEMA, &format!("{schema}\n"))?;
        for (folder, format) in [(shipped::FOLDER, StreamFormat::Folder), (shipped::RECORDING, StreamFormat::Mcap)] {
            SimulateRequest::of_readme(format).simulate(Some(&dir.join(folder)), &mut |_| {})?;
        }
        let commands = [
            format!("cd {}", dir.display()),
            "osteoflow register tests/data/folder/bone.stl tests/data/folder/scan.ply --camera 0,0,0".to_owned(),
            "osteoflow run graphs/fibula.toml".to_owned(),
        ];
        print_next(&json!({ "folder": dir, "commands": commands }), "written, SIMULATED", &commands, global)
    }
}

#[cfg(unix)]
fn make_executable(file: &Path) -> std::io::Result<()> {
    std::fs::set_permissions(file, std::os::unix::fs::PermissionsExt::from_mode(0o755))
}

/// Systems without such permissions go by the file's ending.
#[cfg(not(unix))]
fn make_executable(_: &Path) -> std::io::Result<()> {
    Ok(())
}
