//! Payloads and nodes of a few lines, for the tests, benches and example plugins of the engine.
//!
//! The crate depends on `osteoflow-node` only, so that unit tests of the engine, its integration tests and plugins share
//! it. Each module has its own registry, because messages about unknown kinds suggest the registered ones.
#![allow(missing_docs, clippy::unwrap_used, reason = "test code")]

mod arithmetic;
mod cached;
pub mod context;
pub mod devices;
mod judge;
mod number;
mod samples;
mod script;
pub mod stages;
pub mod stream;
pub mod wave;

pub use arithmetic::{Add, Sum, SumOfSome};
pub use cached::{Cached, n_fired};
pub use judge::{Judge, Judgement, Remark};
pub use number::Number;
pub use samples::Samples;
pub use script::{Gate, LiveScript, Script};

use osteoflow_node::{Display, Inputs, Outputs, Registry, schemars, serde};

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields, crate = "serde")]
#[schemars(crate = "schemars")]
pub struct NoParams {}

#[derive(Inputs)]
pub struct NumberIn {
    /// A number.
    number: Number,
}

#[derive(Outputs)]
pub struct NumberOut {
    /// The number.
    out: Number,
}

/// Numbers, samples, scripted sources, arithmetic, cached answers and verdicts.
pub fn registry() -> Registry {
    let mut registry = Registry::default();
    registry.payload::<Number, _>().payload::<Samples, _>().node::<Cached<false>>().node::<Cached<true>>();
    registry.payload::<Judgement, _>().payload::<Remark, _>().function::<Judge>();
    registry.source::<Script>().source::<LiveScript>().node::<Add>().function::<Sum>().function::<SumOfSome>();
    registry.source::<devices::Device>().node::<devices::Follow>();
    registry
}

fn json_display(schema_name: &str) -> Display {
    Display {
        schema_name: schema_name.into(),
        schema_encoding: "jsonschema".into(),
        schema_data: b"{}".to_vec(),
        message_encoding: "json".into(),
        answer: false,
        anchor: false,
        removal: Vec::new(),
    }
}
