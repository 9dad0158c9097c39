//! What a node is: the traits it implements, the ports and parameters it declares, and the views it hands across.
//!
//! This crate is the leaf that the engine, the built-in nodes and every plugin share. A node is a struct with a doc
//! comment, an `Inputs` and an `Outputs` struct with derived ports, a parameter struct, and [`Node::process`]:
//!
//! ```
//! use osteoflow_node::{Context, Describe, Inputs, Node, NodeError, Outputs, ParamError, Parameters, Part, Payload, View, ViewError};
//! use osteoflow_node::{schemars, serde};
//!
//! // What travels: any cheap handle with a name, a version and a view, of which it says what the view holds.
//! #[derive(Clone)]
//! struct Length(f64);
//!
//! impl Payload<Length> for Length {
//!     const NAME: &'static str = "example/Length";
//!     const VERSION: u32 = 1;
//!     const SCHEMA: &'static [Part] = &[Part::float("mm")];
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
//! #[derive(serde::Deserialize, schemars::JsonSchema)]
//! #[serde(default, deny_unknown_fields, crate = "serde")]
//! #[schemars(crate = "schemars")]
//! struct Params {
//!     /// How many times longer. 2: doubling shows that something happened.
//!     #[schemars(range(min = 1.0, max = 100.0))]
//!     factor: f64,
//! }
//!
//! impl Default for Params {
//!     fn default() -> Self { Self { factor: 2.0 } }
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

// The derives name this crate by its public name, so that they work in it as everywhere else.
extern crate self as osteoflow_node;

pub use osteoflow_node_macros::{Describe, Inputs, Outputs};
pub use {rand, rand_chacha, schemars, serde, serde_json, tracing};

pub mod abi;
mod context;
mod description;
mod erased;
mod error;
mod file;
mod free;
mod item;
mod part;
mod payload;
#[doc(hidden)]
pub mod plugin;
mod port;
mod reading;
mod registry;
mod site;
mod traits;
mod view;

pub use context::Context;
pub use description::{Description, Kept, Role};
pub use erased::{AnyNode, AnySource, Built};
pub use error::{NodeError, ParamError};
pub use file::FilePath;
pub use free::FreePayload;
pub use item::{Body, Emission, Empty, Item, Joined, Slot};
pub use part::{Part, SchemaError, Shape};
pub use payload::{Display, Payload, PayloadType, Value};
pub use port::{Declared, DeclaredPort, FrameExpr, InputPort, Join, OutputPort, OutputPorts, PortPayload, Unused};
pub use reading::{Budget, Reading};
pub use registry::{Kind, KindClash, PayloadClash, Registry};
pub use site::Site;
pub use traits::{Describe, Emit, Inputs, Node, Outputs, Parameters, SILENT_AFTER, Source};
pub use view::{Buffer, Column, ColumnType, Field, Name, View, ViewError};

/// Nanoseconds since the Unix epoch; 0 for what has no time.
pub type StampNs = i64;

/// What the derives call; not for use by hand.
#[doc(hidden)]
pub mod derive {
    pub use crate::port::{any_payload, payload_of};
    pub use crate::traits::{
        into_emission, put_value, take_any, take_many, take_many_optional, take_one, take_optional,
    };
}
