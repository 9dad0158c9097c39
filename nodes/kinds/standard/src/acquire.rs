//! Sources of data: recordings, folders of files, a simulated procedure.

pub mod cloud;
pub mod folder;
pub mod foxglove_ws;
mod frozen;
mod live_marker;
pub mod mcap;
mod mcap_events;
pub mod mcap_live;
pub mod network;
mod one_stamp;
pub mod openigtlink;
mod playback;
pub mod points;
pub mod poses;
mod procedure_ports;
mod sifted;
pub mod simulated;
pub mod simulated_stream;
mod topic_params;
mod topic_port;
mod topics;
mod unstamped;

pub use procedure_ports::{ProcedureOut, ProcedurePorts};
