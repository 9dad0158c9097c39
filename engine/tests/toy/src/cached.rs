//! Nodes whose answers are cached across runs, and a count of their firings.

use crate::{Number, arithmetic::PairIn};
use osteoflow_node::{
    CachePolicy, Context, Describe, Emit, Node, NodeError, Outputs, ParamError, rand::RngExt, schemars, serde,
};
use std::{
    collections::BTreeMap,
    sync::{Mutex, MutexGuard},
};

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
pub struct CachedParams {
    /// The counter of its firings.
    counter: String,
    /// What it uses of its context: `draws`, `stamp`, `clock`.
    takes: Option<String>,
}

#[derive(Outputs)]
pub struct CachedOut {
    /// The double.
    out: Number,
    /// The double, if it is positive.
    positive: Emit<Number>,
}

fn counts() -> MutexGuard<'static, BTreeMap<String, u64>> {
    static COUNTS: Mutex<BTreeMap<String, u64>> = Mutex::new(BTreeMap::new());
    COUNTS.lock().unwrap()
}

/// Number of firings of nodes with this counter. Tests run in parallel, so each uses its own names.
pub fn n_fired(counter: &str) -> u64 {
    counts().get(counter).copied().unwrap_or(0)
}

/// Doubles, cached by inputs or by inputs and seed; refuses 13, panics at 666.
#[derive(Describe)]
pub struct Cached<const WITH_SEED: bool>(CachedParams);

impl<const WITH_SEED: bool> Node for Cached<WITH_SEED> {
    const KIND: &'static str = if WITH_SEED { "toy.kept_with_seed" } else { "toy.kept" };
    const CACHE: CachePolicy = if WITH_SEED { CachePolicy::ByInputsAndSeed } else { CachePolicy::ByInputs };
    type Params = CachedParams;
    type Inputs = PairIn;
    type Outputs = CachedOut;

    fn new(params: CachedParams) -> Result<Self, ParamError> {
        Ok(Self(params))
    }

    fn process(&mut self, i: PairIn, ctx: &mut Context) -> Result<CachedOut, NodeError> {
        *counts().entry(self.0.counter.clone()).or_default() += 1;
        if i.a.0 == 13.0 {
            return Err(NodeError::new("13 is not a number to double"));
        }
        assert!(i.a.0 != 666.0, "the beast");
        if i.a.0 == 99.0 {
            ctx.warn("99 is nearly 100");
        }
        if i.a.0 < -1.0 {
            ctx.sign("number_negative", format!("{} is below -1", i.a.0));
        }
        let used = match self.0.takes.as_deref() {
            Some("draws") => ctx.rng().random(),
            Some("stamp") => ctx.stamp_ns() as f64,
            Some("clock") => ctx.clock_ns() as f64,
            _ => 0.0,
        };
        let out = Number(2.0 * i.a.0 + i.b.as_ref().map_or(0.0, |b| b.0) + used);
        let positive = if out.0 > 0.0 { out.clone().into() } else { Emit::Empty("it is not positive".into()) };
        Ok(CachedOut { out, positive })
    }
}
