//! Nodes: the traits they implement, the ports and parameters they declare, and the views of their payloads.
//!
//! The engine, the built-in nodes and every plugin share this crate. A node is a struct with a doc
//! comment, an `Inputs` and an `Outputs` struct with derived ports, a parameter struct, and [`Node::process`]:
//!
//! ```
//! use osteoflow_node::{Context, Describe, Inputs, Node, NodeError, Outputs, ParamError, Parameters, Payload, SchemaEntry, View, ViewError};
//! use osteoflow_node::{schemars, serde};
//!
//! // A payload: any cheap handle with a name, a version, and a view with a schema.
//! #[derive(Clone)]
//! struct Length(f64);
//!
//! impl Payload<Length> for Length {
//!     const NAME: &'static str = "example/Length";
//!     const VERSION: u32 = 1;
//!     const SCHEMA: &'static [SchemaEntry] = &[SchemaEntry::float("mm")];
//!     fn to_view(&self) -> View { View::new().with("mm", self.0) }
//!     fn from_view(view: &View) -> Result<Self, ViewError> { Ok(Self(view.float("mm")?)) }
//!     fn to_result(&self) -> serde_json::Value { self.0.into() }
//! }
//!
//! /// Makes a length longer.
//! #[derive(Describe)]
//! #[describe(example = r#"kind = "example.stretch""#)]
//! struct Stretch(Params);
//!
//! #[osteoflow_node::params]
//! #[derive(serde::Deserialize, schemars::JsonSchema)]
//! #[serde(default, deny_unknown_fields, crate = "serde")]
//! #[schemars(crate = "schemars")]
//! struct Params {
//!     /// Factor of the length. 2: doubling shows an effect.
//!     #[param(2.0, 1.0..=100.0)]
//!     factor: f64,
//! }
//!
//! #[derive(Inputs)]
//! struct In {
//!     /// The length to stretch.
//!     length: Length,
//! }
//!
//! #[derive(Outputs)]
//! struct Out {
//!     /// The stretched length.
//!     length: Length,
//! }
//!
//! impl Node for Stretch {
//!     const KIND: &'static str = "example.stretch";
//!     type Params = Params;
//!     type Inputs = In;
//!     type Outputs = Out;
//!     fn new(params: Params) -> Result<Self, ParamError> { Ok(Self(params)) }
//!     fn process(&mut self, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
//!         Ok(Out { length: Length(i.length.0 * self.0.factor) })
//!     }
//! }
//!
//! let mut registry = osteoflow_node::Registry::default();
//! registry.payload::<Length, _>().node::<Stretch>();
//! assert_eq!(registry.kind("example.stretch").unwrap().description.summary, "Makes a length longer.");
//! ```

// The derives use the public name of this crate, also within it.
extern crate self as osteoflow_node;

// Linked for its symbols alone: the functions of C are the same on every processor.
use osteoflow_libm as _;
pub use osteoflow_node_macros::{Describe, Inputs, Outputs, function, params};
pub use {rand, rand_chacha, schemars, serde, serde_json, tracing};

pub mod abi;
mod build_context;
mod clock;
mod context;
mod declared;
mod description;
mod display;
mod dynamic;
mod erased;
mod error;
mod file;
mod host;
mod intern;
mod item;
mod log_forward;
mod payload;
#[doc(hidden)]
pub mod plugin;
mod port;
mod registry;
mod schema;
mod traits;
mod view;

pub use build_context::{BuildContext, Place};
pub use clock::{Budget, ClockReading};
pub use context::{Context, FiringDone, FiringSent, sign};
pub use declared::Declared;
pub use description::{CachePolicy, Description, Role};
pub use display::{Display, DisplayContext, FrameEdge, frame_edge, own_frame};
pub use dynamic::DynamicPayload;
pub use erased::{AnyNode, AnySource, Built};
pub use error::{NodeError, ParamError};
pub use file::FilePath;
pub use item::{Body, Emission, Empty, Item, Joined, Slot};
pub use log_forward::LogForward;
pub use payload::{Payload, PayloadType, Value};
pub use port::{DeclaredPort, FrameExpr, InputPort, Join, OutputPort, OutputPorts, PortPayload, Unused};
pub use registry::{Kind, KindClash, Launch, PayloadClash, Registry};
pub use schema::{ColumnType, EntryType, SchemaEntry, SchemaError};
pub use traits::{Describe, Emit, Function, Inputs, Node, Outputs, Parameters, SILENT_AFTER, Source};
pub use view::{Buffer, Column, Field, Name, View, ViewError};

/// Nanoseconds since the Unix epoch; 0 for constants.
pub type StampNs = i64;

/// Called by the derives only.
#[doc(hidden)]
pub mod derive {
    pub use crate::port::{any_payload, payload_of};
    pub use crate::traits::{
        into_emission, put_value, take_any, take_many, take_many_optional, take_one, take_optional, take_optional_any,
    };
}
