//! The shipped graphs and the example data as files.

use super::print_next;
use crate::app::{out_dir, shipped};
use crate::commands::common::{Exit, Global};
use anyhow::Result;
use clap::Args;
use serde_json::json;
use std::path::PathBuf;

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
        shipped::write(dir)?;
        let commands = [
            format!("cd {}", dir.display()),
            "osteoflow register tests/data/folder/bone.stl tests/data/folder/scan.ply --camera 0,0,0".to_owned(),
            "osteoflow run graphs/fibula.toml".to_owned(),
        ];
        print_next(&json!({ "folder": dir, "commands": commands }), "written, SIMULATED", &commands, global)
    }
}
