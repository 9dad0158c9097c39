//! The module for 3D Slicer.

use super::{File, print_next, without_schema, write};
use crate::app::{out_dir, shipped};
use crate::commands::common::{Exit, Global};
use anyhow::Result;
use clap::Args;
use serde_json::json;
use std::path::PathBuf;

/// Write the module Osteoflow for 3D Slicer, with the graphs that it runs: it registers nodes of a scene and shows the answer there
/// (docs/use/slicer.md).
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow new slicer osteoflow-slicer
  Slicer --additional-module-path osteoflow-slicer")]
pub(super) struct Slicer {
    /// The folder to write into, new or empty.
    dir: PathBuf,
}

const FILES: [File; 3] = [
    ("Osteoflow.py", include_str!("../../python/slicer/Osteoflow.py")),
    ("OsteoflowLib/__init__.py", include_str!("../../python/slicer/OsteoflowLib/__init__.py")),
    ("OsteoflowLib/osteoflow_slicer.py", include_str!("../../python/slicer/OsteoflowLib/osteoflow_slicer.py")),
];

/// The graph of a registration by shape, and the one that landmarks start.
const GRAPHS: [&str; 2] = ["graphs/two_files.toml", "graphs/variants/two_files_picked.toml"];

impl Slicer {
    pub(super) fn execute(&self, global: &Global) -> Result<Exit> {
        out_dir::make_plain(&self.dir, false, "name another folder")?;
        for (path, text) in FILES {
            write(&self.dir, path, text)?;
        }
        for (path, text) in shipped::FILES.iter().filter(|(path, _)| GRAPHS.contains(path)) {
            write(&self.dir, path, without_schema(text))?;
        }
        let commands = [format!("Slicer --additional-module-path {}", self.dir.display())];
        print_next(&json!({ "folder": self.dir, "commands": commands }), "written", &commands, global)
    }
}
