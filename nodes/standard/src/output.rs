//! Files for other programs, written into the run's folder.

pub mod csv;
pub mod ply;

use osteoflow_node::{Context, NodeError};
use std::path::PathBuf;

/// The path of a file in the run's folder, named after the node; numbered from the second item on.
fn file_of(ctx: &Context, extension: &str) -> Result<Option<PathBuf>, NodeError> {
    let Some(dir) = ctx.out_dir() else { return Ok(None) };
    std::fs::create_dir_all(dir)?;
    let number = if ctx.item() == 0 { String::new() } else { format!("-{}", ctx.item()) };
    Ok(Some(dir.join(format!("{}{number}.{extension}", ctx.node()))))
}
