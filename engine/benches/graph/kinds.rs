//! The payloads and kinds themselves: built into benches and tests, and exported by `examples/plugin_relay.rs`.

use osteoflow_node::{
    Context, Describe, Inputs, Node, NodeError, Outputs, ParamError, Payload, SchemaEntry, Source, Value, View,
    ViewError, schemars, serde, serde_json,
};
use std::sync::Arc;

/// A number.
#[derive(Clone)]
pub(crate) struct Number(pub(crate) f64);

impl Payload<Number> for Number {
    const NAME: &'static str = "bench/Number";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[SchemaEntry::float("value")];

    fn to_view(&self) -> View {
        View::new().with("value", self.0)
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        Ok(Self(view.float("value")?))
    }

    fn to_result(&self) -> serde_json::Value {
        self.0.into()
    }
}

/// A megabyte behind a handle.
#[derive(Clone)]
pub(crate) struct Megabyte(pub(crate) Arc<Vec<u8>>);

impl Megabyte {
    /// One with something in it.
    pub(crate) fn new() -> Self {
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
        Ok(Self::new())
    }

    fn to_result(&self) -> serde_json::Value {
        self.0.len().into()
    }

    fn n_bytes(&self) -> usize {
        self.0.len()
    }
}

/// How many items a source gives.
#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
pub(crate) struct Items {
    items: u64,
}

/// How long a firing computes.
#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
pub(crate) struct Spin {
    spin_us: u64,
}

/// Counts up.
#[derive(Describe)]
pub(crate) struct Count(u64, u64);

/// A number.
#[derive(Outputs)]
pub(crate) struct NumberOut {
    /// The number.
    out: Number,
}

impl Source for Count {
    const KIND: &'static str = "bench.count";
    type Params = Items;
    type Outputs = NumberOut;

    fn new(params: Items) -> Result<Self, ParamError> {
        Ok(Self(0, params.items))
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<NumberOut>, NodeError> {
        self.0 += 1;
        ctx.set_stamp_ns(self.0 as i64);
        Ok((self.0 <= self.1).then_some(NumberOut { out: Number(self.0 as f64) }))
    }
}

/// Gives the same megabyte again and again: a handle on it, made once.
#[derive(Describe)]
pub(crate) struct Frames(u64, u64, Value);

/// Whatever it is.
#[derive(Outputs)]
pub(crate) struct AnyOut {
    /// A value.
    out: Value,
}

impl Source for Frames {
    const KIND: &'static str = "bench.frames";
    type Params = Items;
    type Outputs = AnyOut;

    fn new(params: Items) -> Result<Self, ParamError> {
        Ok(Self(0, params.items, Value::new(Megabyte::new())))
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<AnyOut>, NodeError> {
        self.0 += 1;
        ctx.set_stamp_ns(self.0 as i64);
        Ok((self.0 <= self.1).then(|| AnyOut { out: self.2.clone() }))
    }
}

/// Computes for so long.
pub(crate) fn spin(us: u64) {
    if us > 0 {
        let began = std::time::Instant::now();
        while began.elapsed().as_micros() < us.into() {
            std::hint::spin_loop();
        }
    }
}

/// Hands on the value it gets.
#[derive(Describe)]
pub(crate) struct Relay(Spin);

/// Whatever it is.
#[derive(Inputs)]
pub(crate) struct AnyIn {
    /// A value.
    value: Value,
}

impl Node for Relay {
    const KIND: &'static str = "bench.relay";
    type Params = Spin;
    type Inputs = AnyIn;
    type Outputs = AnyOut;

    fn new(params: Spin) -> Result<Self, ParamError> {
        Ok(Self(params))
    }

    fn process(&mut self, i: AnyIn, _: &mut Context) -> Result<AnyOut, NodeError> {
        spin(self.0.spin_us);
        Ok(AnyOut { out: i.value })
    }
}

/// Takes a megabyte and hands on the very same.
#[derive(Describe)]
pub(crate) struct Look;

/// A megabyte.
#[derive(Inputs)]
pub(crate) struct MegabyteIn {
    /// The megabyte.
    megabyte: Megabyte,
}

/// The megabyte.
#[derive(Outputs)]
pub(crate) struct MegabyteOut {
    /// The megabyte.
    out: Megabyte,
}

impl Node for Look {
    const KIND: &'static str = "bench.look";
    type Params = Spin;
    type Inputs = MegabyteIn;
    type Outputs = MegabyteOut;

    fn new(_: Spin) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: MegabyteIn, _: &mut Context) -> Result<MegabyteOut, NodeError> {
        Ok(MegabyteOut { out: i.megabyte })
    }
}

/// Makes a new number of the one it gets.
#[derive(Describe)]
pub(crate) struct Next;

/// A number.
#[derive(Inputs)]
pub(crate) struct NumberIn {
    /// A number.
    number: Number,
}

impl Node for Next {
    const KIND: &'static str = "bench.next";
    type Params = Spin;
    type Inputs = NumberIn;
    type Outputs = NumberOut;

    fn new(_: Spin) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: NumberIn, _: &mut Context) -> Result<NumberOut, NodeError> {
        Ok(NumberOut { out: Number(i.number.0 + 1.0) })
    }
}
