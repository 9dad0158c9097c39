//! Nodes that do almost nothing, for measuring the engine.

use crate::{Number, NumberIn, NumberOut};
use osteoflow_node::{
    Context, Describe, Function, Inputs, NodeError, Outputs, ParamError, Payload, Registry, SchemaEntry, Source, Value,
    View, ViewError, schemars, serde, serde_json,
};
use std::{
    sync::Arc,
    time::{Duration, Instant},
};

/// A megabyte behind a handle.
#[derive(Clone)]
pub struct Megabyte(pub Arc<Vec<u8>>);

impl Megabyte {
    /// Bytes of a repeating pattern.
    pub fn filled() -> Self {
        Self(Arc::new((0..1 << 20).map(|i: u32| i as u8).collect()))
    }
}

impl Payload<Megabyte> for Megabyte {
    const NAME: &'static str = "bench/Megabyte";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[SchemaEntry::float("bytes")];

    fn to_view(&self) -> View {
        View::new().with("bytes", self.0.len() as f64)
    }

    fn from_view(_: &View) -> Result<Self, ViewError> {
        Ok(Self::filled())
    }

    fn to_result(&self) -> serde_json::Value {
        self.0.len().into()
    }

    fn n_bytes(&self) -> usize {
        self.0.len()
    }
}

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
pub struct Items {
    /// Number of items.
    items: u64,
}

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
pub struct Spin {
    /// Computing time of a firing.
    spin_us: u64,
}

/// Counts up from 1.
#[derive(Describe)]
pub struct Count {
    n: u64,
    items: u64,
}

impl Source for Count {
    const KIND: &'static str = "bench.count";
    type Params = Items;
    type Outputs = NumberOut;

    fn new(params: Items) -> Result<Self, ParamError> {
        Ok(Self { n: 0, items: params.items })
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<NumberOut>, NodeError> {
        self.n += 1;
        ctx.set_stamp_ns(self.n as i64);
        Ok((self.n <= self.items).then_some(NumberOut { out: Number(self.n as f64) }))
    }
}

#[derive(Outputs)]
pub struct AnyOut {
    /// A value.
    out: Value,
}

/// Gives handles on one megabyte.
#[derive(Describe)]
pub struct Frames {
    n: u64,
    items: u64,
    megabyte: Value,
}

impl Source for Frames {
    const KIND: &'static str = "bench.frames";
    type Params = Items;
    type Outputs = AnyOut;

    fn new(params: Items) -> Result<Self, ParamError> {
        Ok(Self { n: 0, items: params.items, megabyte: Value::new(Megabyte::filled()) })
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<AnyOut>, NodeError> {
        self.n += 1;
        ctx.set_stamp_ns(self.n as i64);
        Ok((self.n <= self.items).then(|| AnyOut { out: self.megabyte.clone() }))
    }
}

/// Computes for `us` microseconds.
pub fn spin(us: u64) {
    if us > 0 {
        let began = Instant::now();
        while began.elapsed() < Duration::from_micros(us) {
            std::hint::spin_loop();
        }
    }
}

#[derive(Inputs)]
pub struct AnyIn {
    /// A value.
    value: Value,
}

/// Passes on its value.
#[derive(Describe)]
pub struct Relay;

impl Function for Relay {
    const KIND: &'static str = "bench.relay";
    type Params = Spin;
    type Inputs = AnyIn;
    type Outputs = AnyOut;

    fn process(params: &Spin, i: AnyIn, _: &mut Context) -> Result<AnyOut, NodeError> {
        spin(params.spin_us);
        Ok(AnyOut { out: i.value })
    }
}

#[derive(Inputs)]
pub struct MegabyteIn {
    /// The megabyte.
    megabyte: Megabyte,
}

#[derive(Outputs)]
pub struct MegabyteOut {
    /// The megabyte.
    out: Megabyte,
}

/// Takes the payload out of its value and makes a value of it again.
#[derive(Describe)]
pub struct Look;

impl Function for Look {
    const KIND: &'static str = "bench.look";
    type Params = Spin;
    type Inputs = MegabyteIn;
    type Outputs = MegabyteOut;

    fn process(_: &Spin, i: MegabyteIn, _: &mut Context) -> Result<MegabyteOut, NodeError> {
        Ok(MegabyteOut { out: i.megabyte })
    }
}

/// Adds one to a number.
#[derive(Describe)]
pub struct Next;

impl Function for Next {
    const KIND: &'static str = "bench.next";
    type Params = Spin;
    type Inputs = NumberIn;
    type Outputs = NumberOut;

    fn process(_: &Spin, i: NumberIn, _: &mut Context) -> Result<NumberOut, NodeError> {
        Ok(NumberOut { out: Number(i.number.0 + 1.0) })
    }
}

/// Sources and payloads, to which nodes of a plugin can be added.
pub fn sources() -> Registry {
    let mut registry = Registry::default();
    registry.payload::<Number, _>().payload::<Megabyte, _>();
    registry.source::<Count>().source::<Frames>();
    registry
}

pub fn registry() -> Registry {
    let mut registry = sources();
    registry.function::<Relay>().function::<Next>().function::<Look>();
    registry
}
