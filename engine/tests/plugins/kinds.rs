//! Kinds that ask for all that a context gives: built into the test, and exported by `examples/plugin_kinds.rs`.

use osteoflow_node::{
    Context, Declared, Describe, Emission, Emit, Inputs, Node, NodeError, Outputs, ParamError, Payload, SchemaEntry,
    Source, View, ViewError, rand::RngExt, schemars, serde, serde_json, tracing,
};
use std::time::Duration;

/// A number, of which the program knows nothing but its description.
#[derive(Clone)]
pub(crate) struct Number(f64);

impl Payload<Number> for Number {
    const NAME: &'static str = "ask/Number";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[SchemaEntry::float("value")];

    fn to_view(&self) -> View {
        View::new().with("value", self.0)
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        Ok(Self(view.float("value")?))
    }

    // As the program shows a payload of which it knows the description only.
    fn to_result(&self) -> serde_json::Value {
        serde_json::json!({ "value": self.0 })
    }
}

/// Words.
#[derive(Clone)]
pub(crate) struct Words(String);

impl Payload<Words> for Words {
    const NAME: &'static str = "ask/Words";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[SchemaEntry::text("words")];

    fn to_view(&self) -> View {
        View::new().with("words", self.0.as_str())
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        Ok(Self(view.text("words")?.into()))
    }

    fn to_result(&self) -> serde_json::Value {
        serde_json::json!({ "words": self.0 })
    }
}

/// Nothing to choose.
#[derive(serde::Deserialize, schemars::JsonSchema)]
#[serde(crate = "serde", deny_unknown_fields)]
#[schemars(crate = "schemars")]
pub(crate) struct NoParams {}

/// A number goes in.
#[derive(Inputs)]
pub(crate) struct NumberIn {
    /// A number.
    number: Number,
}

/// A number comes out.
#[derive(Outputs)]
pub(crate) struct NumberOut {
    /// A number.
    out: Number,
}

/// Counts from 0 to 8, and says every third number a second time: the next port has nothing, or is silent.
#[derive(Describe)]
pub(crate) struct Count(u32);

/// What it counts.
#[derive(Outputs)]
pub(crate) struct CountOut {
    /// Every number.
    number: Number,
    /// Every third; of those between, one is empty and one is not said at all.
    third: Emit<Number>,
}

impl Source for Count {
    const KIND: &'static str = "ask.count";
    type Params = NoParams;
    type Outputs = CountOut;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self(0))
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<CountOut>, NodeError> {
        let n = self.0;
        self.0 += 1;
        ctx.set_stamp_ns(i64::from(n) + 10);
        let third = match n % 3 {
            0 => Emit::Value(Number(f64::from(n))),
            1 => Emit::Empty(format!("{n} is no third")),
            _ => Emit::Silent,
        };
        Ok((n < 9).then(|| CountOut { number: Number(f64::from(n)), third }))
    }
}

/// A constant.
#[derive(Describe)]
pub(crate) struct Always(bool);

impl Source for Always {
    const KIND: &'static str = "ask.always";
    const CONSTANT: bool = true;
    type Params = NoParams;
    type Outputs = NumberOut;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self(false))
    }

    fn next(&mut self, _: &mut Context) -> Result<Option<NumberOut>, NodeError> {
        let said = std::mem::replace(&mut self.0, true);
        Ok((!said).then_some(NumberOut { out: Number(0.5) }))
    }
}

/// What a declared port gives.
#[derive(serde::Deserialize, schemars::JsonSchema)]
#[serde(crate = "serde")]
#[schemars(crate = "schemars")]
pub(crate) struct PortParams {
    /// The number.
    value: f64,
}

/// Gives on each port that the graph declares what the graph says there, once, the ports one after the other.
#[derive(Describe)]
pub(crate) struct Declare(usize);

impl Source for Declare {
    const KIND: &'static str = "ask.declare";
    type Params = NoParams;
    type Outputs = Declared<PortParams>;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self(0))
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<Declared<PortParams>>, NodeError> {
        let (at, ports) = (self.0, ctx.declared());
        let Some(port) = ports.get(at) else { return Ok(None) };
        self.0 += 1;
        ctx.set_stamp_ns(at as i64);
        Ok(Some(Declared::one(at, Emission::value(Number(port.params::<PortParams>()?.value)))))
    }
}

/// Draws from the generator; says what it drew, and warns of the third item.
#[derive(Describe)]
pub(crate) struct Draw;

impl Node for Draw {
    const KIND: &'static str = "ask.draw";
    type Params = NoParams;
    type Inputs = NumberIn;
    type Outputs = NumberOut;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: NumberIn, ctx: &mut Context) -> Result<NumberOut, NodeError> {
        let drawn: f64 = ctx.rng().random();
        // The second half of the bits of the third draw, by its place.
        let bits = f64::from(ctx.random(2) as u32);
        tracing::info!(target: "asks", item = ctx.item(), name = "draw", "drew once");
        tracing::debug!(target: "asks", "nobody listens to this");
        if ctx.item() == 2 {
            ctx.warn(format!("the third item of {} at {} ns", ctx.node(), ctx.stamp_ns()));
        }
        Ok(NumberOut { out: Number(i.number.0 + drawn + bits) })
    }
}

/// Reads the clock and looks at a budget until it is over.
#[derive(Describe)]
pub(crate) struct Clock;

impl Node for Clock {
    const KIND: &'static str = "ask.clock";
    type Params = NoParams;
    type Inputs = NumberIn;
    type Outputs = NumberOut;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, _: NumberIn, ctx: &mut Context) -> Result<NumberOut, NodeError> {
        let began_ns = ctx.clock_ns();
        let mut budget = ctx.budget(Duration::from_micros(200));
        let mut n_looks = 0;
        while !budget.is_over() {
            n_looks += 1;
        }
        Ok(NumberOut { out: Number((began_ns % 1_000_000_007) as f64 + f64::from(n_looks) / 16_777_216.0) })
    }
}

/// Says what its optional port brings, or why it brings nothing.
#[derive(Describe)]
pub(crate) struct Perhaps;

/// A number and perhaps another.
#[derive(Inputs)]
pub(crate) struct PerhapsIn {
    /// A number.
    number: Number,
    /// Another.
    #[port(join = "latest")]
    other: Option<Number>,
}

/// Words come out.
#[derive(Outputs)]
pub(crate) struct WordsOut {
    /// What there was.
    out: Words,
}

impl Node for Perhaps {
    const KIND: &'static str = "ask.perhaps";
    type Params = NoParams;
    type Inputs = PerhapsIn;
    type Outputs = WordsOut;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: PerhapsIn, ctx: &mut Context) -> Result<WordsOut, NodeError> {
        let why = ctx.absent_reason("other").unwrap_or("there");
        let other = i.other.map(|other| other.0);
        Ok(WordsOut { out: Words(format!("{}: {other:?}, {why}", i.number.0)) })
    }
}

/// Adds four at a time, and a constant.
#[derive(Describe)]
pub(crate) struct Four;

/// Several numbers and a constant.
#[derive(Inputs)]
pub(crate) struct FourIn {
    /// The numbers.
    #[port(join = "collect", n = 4)]
    numbers: Vec<Number>,
    /// The constant.
    #[port(join = "once")]
    constant: Number,
}

impl Node for Four {
    const KIND: &'static str = "ask.four";
    type Params = NoParams;
    type Inputs = FourIn;
    type Outputs = NumberOut;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: FourIn, _: &mut Context) -> Result<NumberOut, NodeError> {
        Ok(NumberOut { out: Number(i.numbers.iter().map(|n| n.0).sum::<f64>() + i.constant.0) })
    }
}

/// Counts its firings, panics at 3 and fails at 5.
#[derive(Describe)]
pub(crate) struct Panic(u32);

impl Node for Panic {
    const KIND: &'static str = "ask.panic";
    type Params = NoParams;
    type Inputs = NumberIn;
    type Outputs = NumberOut;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self(0))
    }

    fn process(&mut self, i: NumberIn, _: &mut Context) -> Result<NumberOut, NodeError> {
        self.0 += 1;
        assert!(i.number.0 != 3.0, "three is a crowd");
        if i.number.0 == 5.0 {
            return Err(NodeError::new("five is refused; send four"));
        }
        Ok(NumberOut { out: Number(f64::from(self.0)) })
    }
}
