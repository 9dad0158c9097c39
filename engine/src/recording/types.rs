//! Payload types described by a recording, for reading it without their crates.

use super::wires::Wire;
use osteoflow_node::{PayloadType, Registry, SchemaEntry};
use std::collections::BTreeMap;

/// Payload types made from the schemas of a recording's wires, by name and version, or why a schema makes none.
#[derive(Debug, Clone, Default)]
pub(crate) struct RecordedTypes(BTreeMap<(String, u32), Result<&'static PayloadType, String>>);

impl RecordedTypes {
    /// Adds the payload of a wire's channel. Channels of wires that take anything describe none.
    pub(crate) fn add(&mut self, wire: &Wire) {
        let Some(schema) = &wire.header.schema else { return };
        let of = || {
            let schema: Vec<SchemaEntry> = serde_json::from_str(schema).map_err(|error| error.to_string())?;
            PayloadType::dynamic(&wire.header.payload, wire.header.version, schema).map_err(|error| error.to_string())
        };
        self.0.entry((wire.header.payload.clone(), wire.header.version)).or_insert_with(of);
    }

    /// The type with that name and version.
    pub(crate) fn get(&self, name: &str, version: u32) -> Option<&'static PayloadType> {
        self.0.get(&(name.to_owned(), version))?.as_ref().ok().copied()
    }

    /// Payloads whose schemas make no type, and why.
    pub(crate) fn faults(&self) -> impl Iterator<Item = (String, &str)> {
        let all = self.0.iter();
        all.filter_map(|((name, version), ty)| Some((format!("{name}@{version}"), ty.as_ref().err()?.as_str())))
    }

    /// Extends the registry by the recording's unknown payloads. A payload registered under the same name, or used on a
    /// port of a kind, takes precedence over the recorded schema.
    pub(crate) fn registry(&self, known: &Registry) -> Registry {
        let mut registry = known.clone();
        let ports = known.kinds().flat_map(|kind| {
            let inputs = kind.description.inputs.iter().map(|port| port.payload);
            inputs.chain(kind.description.outputs.fixed().iter().map(|port| port.payload))
        });
        for ty in
            ports.filter_map(|payload| payload.ty()).chain(self.0.values().filter_map(|ty| ty.as_ref().ok().copied()))
        {
            if registry.payload_type(ty.name).is_none() {
                // No type is registered from which it could differ.
                let _ = registry.add_payload_type(ty);
            }
        }
        registry
    }
}
