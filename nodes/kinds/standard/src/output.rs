//! Files for other programs, written into the run's folder.

pub mod csv;
pub mod export;
pub mod mesh;
pub mod planes;
pub mod ply;
pub mod points;
pub mod transform;

use osteoflow_algorithms::trust::{Answer, Verdict};
use osteoflow_formats::Space;
use osteoflow_geometry::Frame;
use osteoflow_node::{Context, NodeError, Outputs};
use std::path::PathBuf;

/// No outputs.
#[derive(Outputs)]
pub struct NoOutputs {}

/// What every file for other programs says, where it can.
const NOTICE: &str = "osteoflow; research use only, not for clinical use";

/// LPS, for a format that claims a space; an error for coordinates in another frame than CT's.
fn lps(frame: &Frame, what: &str, remedy: &str) -> Result<Space, NodeError> {
    match Space::of(frame) {
        Space::Unknown => {
            Err(NodeError::new(format!("{what} in {frame}, and the file is LPS, as only ct is; {remedy}")))
        }
        known => Ok(known),
    }
}

/// Whether the verdict forbids to write, with a warning.
fn is_refused(verdict: Option<&Verdict>, ctx: &mut Context) -> bool {
    let refused = verdict.is_some_and(|verdict| verdict.answer == Answer::Refused);
    if refused {
        ctx.warn("nothing is written, since the verdict is refused");
    }
    refused
}

/// The path of a file in the run's folder, named after the node; numbered from the second item on.
fn file_of(ctx: &Context, extension: &str) -> Result<Option<PathBuf>, NodeError> {
    let Some(dir) = ctx.out_dir() else { return Ok(None) };
    std::fs::create_dir_all(dir)?;
    let number = if ctx.item() == 0 { String::new() } else { format!("-{}", ctx.item()) };
    not_a_link(dir.join(format!("{}{number}.{extension}", ctx.node()))).map(Some)
}

/// The path, where a link is removed: its target may be any file of the user.
fn not_a_link(path: PathBuf) -> Result<PathBuf, NodeError> {
    if path.is_symlink() {
        std::fs::remove_file(&path)?;
    }
    Ok(path)
}
