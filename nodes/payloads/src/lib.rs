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
mod metrics;
mod report;
mod target;
mod words;

pub use metrics::{Metric, Metrics, MetricsError};
pub use words::{Flag, Json, Text};

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
        .payload::<Flag, _>()
        .payload::<Json, _>()
        .payload::<Metrics, _>();
    report::register(registry);
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_node::{Part, Value};

    #[test]
    fn every_payload_of_the_table_has_a_schema_whose_names_are_unique() {
        let mut registry = Registry::default();
        register(&mut registry);
        assert!(registry.payload_types().count() > 20);
        for ty in registry.payload_types() {
            assert!(!ty.schema.is_empty(), "{ty:?} shows nothing");
            assert_eq!(Part::check_all(ty.schema), Ok(()), "{ty:?}");
        }
    }

    #[test]
    fn words_and_reports_fit_their_schemas() {
        // One macro writes the views of all reports.
        let report = osteoflow_algorithms::icp::IcpTrace::default();
        let json = Json(serde_json::json!({ "n": 1 }).into());
        for value in [Value::new(Text("here".into())), Value::new(Flag(true)), Value::new(json), Value::new(report)] {
            assert_eq!(value.to_view().check(value.ty().schema), Ok(()), "{value:?}");
        }
    }
}
