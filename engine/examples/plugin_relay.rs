//! A plugin of two kinds that do next to nothing, for the benches and for the tests of loading.

use osteoflow_node::{
    Context, Describe, Inputs, Node, NodeError, Outputs, ParamError, Part, Payload, Value, View, ViewError, schemars,
    serde, serde_json,
};

/// A number, described as the benches describe theirs.
#[derive(Clone)]
struct Number(f64);

impl Payload<Number> for Number {
    const NAME: &'static str = "bench/Number";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [Part] = &[Part::float("value")];

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

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
struct Params {
    /// Not looked at.
    #[allow(dead_code)]
    spin_us: u64,
}

/// Hands on the value it gets.
#[derive(Describe)]
struct Relay;

#[derive(Inputs)]
struct AnyIn {
    /// A value.
    value: Value,
}

#[derive(Outputs)]
struct AnyOut {
    /// The same.
    out: Value,
}

impl Node for Relay {
    const KIND: &'static str = "rust.relay";
    type Params = Params;
    type Inputs = AnyIn;
    type Outputs = AnyOut;

    fn new(_: Params) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: AnyIn, _: &mut Context) -> Result<AnyOut, NodeError> {
        Ok(AnyOut { out: i.value })
    }
}

/// Makes a number one larger.
#[derive(Describe)]
struct Next;

#[derive(Inputs)]
struct NumberIn {
    /// A number.
    number: Number,
}

#[derive(Outputs)]
struct NumberOut {
    /// One more.
    out: Number,
}

impl Node for Next {
    const KIND: &'static str = "rust.next";
    type Params = Params;
    type Inputs = NumberIn;
    type Outputs = NumberOut;

    fn new(_: Params) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: NumberIn, _: &mut Context) -> Result<NumberOut, NodeError> {
        Ok(NumberOut { out: Number(i.number.0 + 1.0) })
    }
}

osteoflow_node::export!(Relay, Next);
