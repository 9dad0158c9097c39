//! What the program does, as typed requests: the ground of the command line and of the Python package.
//!
//! A request is the one struct of its options, each with its help: the command line fills it in by clap, other programs by its fields.
//! It checks what it names, does the work and returns values; it prints nothing.
//! Progress goes to the observer that the caller hands over.

pub(crate) mod archive;
pub(crate) mod bind;
mod error;
pub(crate) mod files;
pub(crate) mod folder_lock;
pub(crate) mod host;
mod options;
pub(crate) mod out_dir;
mod plugins;
pub(crate) mod program;
pub(crate) mod register;
pub(crate) mod run;
pub(crate) mod sensor;
pub(crate) mod shipped;
pub(crate) mod simulate;
pub(crate) mod sweep;

pub use archive::{ArchiveArgs, ExportRequest, Exported, Sameness, same};
pub use error::Error;
pub use files::{Content, read, write_cloud, write_mesh, write_points, write_pose};
pub use host::hosted_by;
pub use options::{GraphArgs, Keep, Leave, SettingValue};
pub use osteoflow_engine::{inputs::WireInputs, sweep::Ask};
pub use osteoflow_formats::{
    Space,
    mesh_or_cloud::{CloudFileRead, MeshOrCloud, MeshRead},
    write::Precision,
};
pub use plugins::{PYTHON_HELPER, Plugins};
pub use register::{Register, RegisterInput, RegisterRequest, Registration, Require, Stop};
pub use run::{Functions, Graph, GraphRun, RunRequest};
pub use sensor::SensorRequest;
pub use simulate::{SimulateRequest, StreamFormat};
pub use sweep::{OneRun, OpenStudy, ShardFault, SweepRequest, SweepRun, check_shard, merge, summary};

pub(crate) use error::{UsageError, with_causes};
pub(crate) use options::space;
pub(crate) use plugins::FOLDERS;
pub(crate) use program::{NOTICE, registry, run_error};
pub(crate) use run::{is_said_by_verdict, is_settled, judged, refusal_in_short, without_reason};

use std::path::Path;

/// A recording of a run.
///
/// # Errors
/// [`Error::Failed`] if it cannot be read.
pub fn recording(file: &Path) -> Result<osteoflow_engine::Recording, Error> {
    osteoflow_engine::Recording::open(file).map_err(|error| anyhow::anyhow!("{error}").into())
}
