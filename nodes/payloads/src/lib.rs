//! The one table of what may travel on a wire: name, version, exact view, Foxglove view.
//!
//! ```
//! use osteoflow_geometry::{Pose, nalgebra::Isometry3};
//! use osteoflow_node::{Payload, Registry, Value};
//!
//! let mut registry = Registry::default();
//! osteoflow_payloads::register(&mut registry);
//! let pose = Pose::new("world", "camera", Isometry3::translation(1.0, 2.0, 3.0));
//! let value = Value::new(pose.clone());
//! let back = registry.payload_type("geometry/Pose").unwrap().from_view(&value.to_view()).unwrap();
//! assert_eq!(back.get::<Pose>(), Some(&pose));
//! ```

mod columns;
mod foxglove;
mod geometry;
mod report;
mod target;
mod words;

pub use words::{Flag, Text};

use osteoflow_node::Registry;

/// The mark of this table: `impl Payload<Table> for Cloud`.
pub struct Table;

/// Adds every payload type of the table to a registry.
pub fn register(registry: &mut Registry) {
    use osteoflow_geometry::{Axes, Cloud, Mesh, Planes, Points, Pose, Region};
    registry
        .payload::<Cloud, _>()
        .payload::<Mesh, _>()
        .payload::<Pose, _>()
        .payload::<Points, _>()
        .payload::<Planes, _>()
        .payload::<Region, _>()
        .payload::<Axes, _>()
        .payload::<osteoflow_algorithms::target::Target, _>()
        .payload::<Text, _>()
        .payload::<Flag, _>();
    report::register(registry);
}
