//! The table of payloads: name, version, exact view, Foxglove view.
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
//!
//! A plugin depends on this crate and `osteoflow-node` only; it uses the [`geometry`] and [`algorithms`] re-exported here. Two
//! features, both on by default, can be left out for a shorter build: `viewer` (views for Foxglove, which the program makes,
//! never a plugin) and `algorithms` (`algorithms/Target`, and the reports of algorithms).

mod columns;
#[cfg(feature = "viewer")]
mod foxglove;
mod geometry_views;
mod metrics;
mod plain_values;
#[cfg(feature = "algorithms")]
mod report;
mod table;
#[cfg(feature = "algorithms")]
mod target;

pub use metrics::{Metric, Metrics, MetricsError};
#[cfg(feature = "algorithms")]
pub use osteoflow_algorithms as algorithms;
pub use osteoflow_geometry as geometry;
pub use plain_values::{Flag, Json, Text};
pub use table::Table;

use osteoflow_node::Registry;

/// Adds every payload type of the table to a registry.
pub fn register(registry: &mut Registry) {
    use osteoflow_geometry::{Axes, Cloud, Image, Mesh, Planes, Points, Pose, Region};
    registry
        .payload::<Cloud, _>()
        .payload::<Mesh, _>()
        .payload::<Pose, _>()
        .payload::<Points, _>()
        .payload::<Planes, _>()
        .payload::<Region, _>()
        .payload::<Axes, _>()
        .payload::<Image, _>()
        .payload::<Text, _>()
        .payload::<Flag, _>()
        .payload::<Json, _>()
        .payload::<Metrics, _>();
    #[cfg(feature = "algorithms")]
    {
        registry.payload::<algorithms::target::Target, _>();
        report::register(registry);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_node::SchemaEntry;

    #[test]
    fn every_payload_of_the_table_has_a_schema_whose_names_are_unique() {
        let mut registry = Registry::default();
        register(&mut registry);
        assert!(registry.payload_types().count() > 10);
        for ty in registry.payload_types() {
            assert!(!ty.schema.is_empty(), "{ty:?} shows nothing");
            assert_eq!(SchemaEntry::check_all(ty.schema), Ok(()), "{ty:?}");
        }
    }

    #[cfg(feature = "algorithms")]
    #[test]
    fn plain_values_and_reports_fit_their_schemas() {
        use osteoflow_node::Value;
        // One macro writes the views of all reports.
        let report = osteoflow_algorithms::icp::IcpTrace::default();
        let json = Json(serde_json::json!({ "n": 1 }).into());
        for value in [Value::new(Text("here".into())), Value::new(Flag(true)), Value::new(json), Value::new(report)] {
            assert_eq!(value.to_view().check(value.ty().schema), Ok(()), "{value:?}");
        }
    }
}
