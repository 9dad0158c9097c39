use crate::{Gate, NoParams, Number, NumberOut};
use osteoflow_node::{
    Context, Describe, Emit, Function, Inputs, Node, NodeError, Outputs, ParamError, rand::RngExt, schemars, serde,
};
use std::time::Duration;

#[derive(Inputs)]
pub struct PairIn {
    /// The first.
    pub(crate) a: Number,
    /// The second.
    pub(crate) b: Option<Number>,
}

#[derive(serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
pub struct AddParams {
    /// Whether to add noise from the generator of the context.
    noise: bool,
    /// Refused when the node is built.
    bad: bool,
    /// Duration of a firing.
    sleep_us: u64,
    /// The gate that each firing passes.
    gate: Option<String>,
    /// Adds the time of day, and 1024 times the number of checks that found time left in this budget.
    budget_us: Option<u64>,
    /// Maximum number of checks of the budget.
    most_looks: u64,
}

#[allow(clippy::derivable_impls)]
impl Default for AddParams {
    fn default() -> Self {
        Self { noise: false, bad: false, sleep_us: 0, gate: None, budget_us: None, most_looks: u64::MAX }
    }
}

/// Adds two numbers; refuses 13, panics at 666.
#[derive(Describe)]
pub struct Add(AddParams);

impl Node for Add {
    const KIND: &'static str = "toy.add";
    type Params = AddParams;
    type Inputs = PairIn;
    type Outputs = NumberOut;

    fn new(params: AddParams) -> Result<Self, ParamError> {
        match params.bad {
            true => Err(ParamError::new("bad", "expected false, found true")),
            false => Ok(Self(params)),
        }
    }

    fn process(&mut self, i: PairIn, ctx: &mut Context) -> Result<NumberOut, NodeError> {
        if self.0.sleep_us > 0 {
            std::thread::sleep(Duration::from_micros(self.0.sleep_us));
        }
        if let Some(gate) = &self.0.gate {
            Gate::of(gate).pass(ctx);
        }
        if i.a.0 == 13.0 {
            return Err(NodeError::new("13 is not a number to add to"));
        }
        assert!(i.a.0 != 666.0, "the beast of item {}", ctx.item());
        if i.b.is_none() && ctx.absent_reason("b").is_none() {
            return Err(NodeError::new("input b is absent without a reason"));
        }
        if i.a.0 == 99.0 {
            ctx.warn("99 is nearly 100");
        }
        if i.a.0 < -1.0 {
            ctx.sign("number_negative", format!("{} is below -1", i.a.0));
        }
        let mut from_clock = 0.0;
        if let Some(us) = self.0.budget_us {
            let mut budget = ctx.budget(Duration::from_micros(us));
            let n_checks = (0..self.0.most_looks).take_while(|_| !budget.is_over()).count();
            from_clock = ctx.clock_ns() as f64 + n_checks as f64 * 1024.0;
        }
        let noise: f64 = if self.0.noise { ctx.rng().random() } else { 0.0 };
        Ok(NumberOut { out: Number(i.a.0 + i.b.map_or(0.0, |b| b.0) + noise + from_clock) })
    }
}

/// Sums what it collects.
#[derive(Describe)]
pub struct Sum;

#[derive(Inputs)]
pub struct SumIn {
    /// The summands.
    all: Vec<Number>,
}

#[derive(Outputs)]
pub struct SumOut {
    /// The sum, if it is positive.
    out: Emit<Number>,
}

impl Function for Sum {
    const KIND: &'static str = "toy.sum";
    type Params = NoParams;
    type Inputs = SumIn;
    type Outputs = SumOut;

    fn process(_: &NoParams, i: SumIn, _: &mut Context) -> Result<SumOut, NodeError> {
        let sum: f64 = i.all.iter().map(|n| n.0).sum();
        Ok(SumOut { out: if sum > 0.0 { Number(sum).into() } else { Emit::Empty("the sum is not positive".into()) } })
    }
}

/// Sums the values among what it collects, ignoring empties.
#[derive(Describe)]
pub struct SumOfSome;

#[derive(Inputs)]
pub struct SomeIn {
    /// The summands.
    all: Vec<Option<Number>>,
}

impl Function for SumOfSome {
    const KIND: &'static str = "toy.some";
    type Params = NoParams;
    type Inputs = SomeIn;
    type Outputs = NumberOut;

    fn process(_: &NoParams, i: SomeIn, _: &mut Context) -> Result<NumberOut, NodeError> {
        Ok(NumberOut { out: Number(i.all.iter().flatten().map(|n| n.0).sum()) })
    }
}
