//! Nodes that use every function of a context: built in, and exported as a plugin by `examples/plugin_kinds.rs`.

use crate::NoParams;
use osteoflow_node::{
    Context, Declared, Describe, Emission, Emit, Function, Inputs, Node, NodeError, Outputs, ParamError, Payload,
    Registry, SchemaEntry, Source, View, ViewError, rand::RngExt, schemars, serde, tracing,
};
use std::time::Duration;

/// A number that the program knows only by the schema of the plugin.
#[derive(Clone)]
pub struct Number(f64);

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
}

#[derive(Inputs)]
pub struct NumberIn {
    /// A number.
    number: Number,
}

#[derive(Outputs)]
pub struct NumberOut {
    /// A number.
    out: Number,
}

/// Counts from 0 to 8 and repeats every third number on a second port, which is empty or silent otherwise.
#[derive(Describe)]
pub struct Count(u32);

#[derive(Outputs)]
pub struct CountOut {
    /// Every number.
    number: Number,
    /// Every third number; of the others, one is empty and one silent.
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
pub struct Always(bool);

impl Source for Always {
    const KIND: &'static str = "ask.always";
    const CONSTANT: bool = true;
    type Params = NoParams;
    type Outputs = NumberOut;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self(false))
    }

    fn next(&mut self, _: &mut Context) -> Result<Option<NumberOut>, NodeError> {
        let is_over = std::mem::replace(&mut self.0, true);
        Ok((!is_over).then_some(NumberOut { out: Number(0.5) }))
    }
}

#[derive(serde::Deserialize, schemars::JsonSchema)]
#[serde(crate = "serde")]
#[schemars(crate = "schemars")]
pub struct PortParams {
    /// The number to give.
    value: f64,
}

/// Gives the number of each declared port once, one port after the other.
#[derive(Describe)]
pub struct Declare(usize);

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

/// Draws from the generator, logs it, and warns at the third item.
#[derive(Describe)]
pub struct Draw;

impl Function for Draw {
    const KIND: &'static str = "ask.draw";
    type Params = NoParams;
    type Inputs = NumberIn;
    type Outputs = NumberOut;

    fn process(_: &NoParams, i: NumberIn, ctx: &mut Context) -> Result<NumberOut, NodeError> {
        let drawn: f64 = ctx.rng().random();
        // The lower half of the third draw.
        let bits = f64::from(ctx.random(2) as u32);
        tracing::info!(target: "asks", item = ctx.item(), name = "draw", "drew once");
        tracing::debug!(target: "asks", "nobody listens to this");
        if ctx.item() == 2 {
            ctx.warn(format!("the third item of {} at {} ns", ctx.node(), ctx.stamp_ns()));
        }
        Ok(NumberOut { out: Number(i.number.0 + drawn + bits) })
    }
}

/// Reads the clock and checks a budget until it is over.
#[derive(Describe)]
pub struct Clock;

impl Function for Clock {
    const KIND: &'static str = "ask.clock";
    type Params = NoParams;
    type Inputs = NumberIn;
    type Outputs = NumberOut;

    fn process(_: &NoParams, _: NumberIn, ctx: &mut Context) -> Result<NumberOut, NodeError> {
        let began_ns = ctx.clock_ns();
        let mut budget = ctx.budget(Duration::from_micros(200));
        let mut n_checks = 0;
        while !budget.is_over() {
            n_checks += 1;
        }
        Ok(NumberOut { out: Number((began_ns % 1_000_000_007) as f64 + f64::from(n_checks) / 16_777_216.0) })
    }
}

/// Passes its number on, and warns of the input of its optional port, or why there is none.
#[derive(Describe)]
pub struct Perhaps;

#[derive(Inputs)]
pub struct PerhapsIn {
    /// A number.
    number: Number,
    /// Another.
    #[port(join = "latest")]
    other: Option<Number>,
}

impl Function for Perhaps {
    const KIND: &'static str = "ask.perhaps";
    type Params = NoParams;
    type Inputs = PerhapsIn;
    type Outputs = NumberOut;

    fn process(_: &NoParams, i: PerhapsIn, ctx: &mut Context) -> Result<NumberOut, NodeError> {
        let why = ctx.absent_reason("other").unwrap_or("there");
        let other = i.other.map(|other| other.0);
        ctx.warn(format!("{}: {other:?}, {why}", i.number.0));
        Ok(NumberOut { out: i.number })
    }
}

/// Sums four numbers at a time and a constant.
#[derive(Describe)]
pub struct Four;

#[derive(Inputs)]
pub struct FourIn {
    /// The numbers.
    #[port(join = "collect", n = 4)]
    numbers: Vec<Number>,
    /// The constant.
    #[port(join = "once")]
    constant: Number,
}

impl Function for Four {
    const KIND: &'static str = "ask.four";
    type Params = NoParams;
    type Inputs = FourIn;
    type Outputs = NumberOut;

    fn process(_: &NoParams, i: FourIn, _: &mut Context) -> Result<NumberOut, NodeError> {
        Ok(NumberOut { out: Number(i.numbers.iter().map(|n| n.0).sum::<f64>() + i.constant.0) })
    }
}

/// Counts its firings, panics at 3 and fails at 5.
#[derive(Describe)]
pub struct Panic(u32);

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

pub fn registry() -> Registry {
    let mut registry = Registry::default();
    registry.payload::<Number, _>().source::<Count>().source::<Always>().source::<Declare>();
    registry.function::<Draw>().function::<Clock>().function::<Perhaps>().function::<Four>().node::<Panic>();
    registry
}
