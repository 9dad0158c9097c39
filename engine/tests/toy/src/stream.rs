//! Nodes that do almost nothing, for measuring the engine.

use crate::{Number, NumberIn, NumberOut, json_display};
use osteoflow_node::{
    Buffer, Column, ColumnType, Context, Describe, Display, DisplayContext, Function, Inputs, NodeError, Outputs,
    ParamError, Payload, Registry, SchemaEntry, Source, Value, View, ViewError, schemars, serde,
};
use std::{
    sync::Arc,
    time::{Duration, Instant},
};

/// Time between two items of a source that keeps to the time.
pub const PERIOD: Duration = Duration::from_nanos(1_000_000_000 / 30);
/// Number of different megabytes that such a source gives.
pub const N_DIFFERENT: usize = 8;
/// 43 690 points of three numbers.
const N_NUMBERS: usize = 3 * 43_690;

/// A megabyte of points behind a handle.
#[derive(Clone)]
pub struct Megabyte(pub Buffer);

impl Megabyte {
    /// A bone-like surface seen from 300 mm, with scanner noise of 0.05 mm.
    pub fn scan(seed: u64) -> Self {
        let mut state = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut noise = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1u64 << 53) as f64 * 0.1 - 0.05
        };
        let mut bytes = Vec::with_capacity(N_NUMBERS * 8);
        for i in 0..N_NUMBERS / 3 {
            let (x, y) = ((i % 210) as f64 * 0.5 - 52.0, (i / 210) as f64 * 0.5 - 52.0);
            for number in [x + noise(), y + noise(), 300.0 + (x * 0.1).sin() * 6.0 + noise()] {
                bytes.extend_from_slice(&number.to_ne_bytes());
            }
        }
        Self(Arc::new(bytes))
    }

    pub fn bytes(&self) -> &[u8] {
        (*self.0).as_ref()
    }
}

impl Payload<Megabyte> for Megabyte {
    const NAME: &'static str = "bench/Megabyte";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[SchemaEntry::column("points", ColumnType::F64, 3)];

    fn to_view(&self) -> View {
        View::new().with_column(Column::new("points", ColumnType::F64, 3, self.0.clone()))
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        Ok(Self(view.column("points")?.data.clone()))
    }

    fn n_bytes(&self) -> usize {
        self.bytes().len()
    }

    fn display() -> Option<Display> {
        Some(json_display("bench.Megabyte"))
    }

    /// Metres in 32 bits, as viewers expect.
    fn to_display(&self, _: &DisplayContext<'_>) -> Option<Vec<u8>> {
        let mut out = Vec::with_capacity(self.bytes().len() / 2);
        for number in self.bytes().chunks_exact(8) {
            let mm = f64::from_ne_bytes(number.try_into().ok()?);
            out.extend_from_slice(&((mm / 1000.0) as f32).to_le_bytes());
        }
        Some(out)
    }
}

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
pub struct Items {
    /// Number of items.
    items: u64,
    /// Whether thirty different items come in a second, instead of one as often as it is taken.
    in_time: bool,
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

/// Gives handles on a megabyte.
#[derive(Describe)]
pub struct Frames {
    n: u64,
    params: Items,
    began: Option<Instant>,
    megabytes: Vec<Value>,
}

impl Source for Frames {
    const KIND: &'static str = "bench.frames";
    type Params = Items;
    type Outputs = AnyOut;

    fn new(params: Items) -> Result<Self, ParamError> {
        let n = if params.in_time { N_DIFFERENT } else { 1 };
        let megabytes = (0..n).map(|i| Value::new(Megabyte::scan(i as u64))).collect();
        Ok(Self { n: 0, params, began: None, megabytes })
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<AnyOut>, NodeError> {
        if self.n == self.params.items {
            return Ok(None);
        }
        if self.params.in_time {
            let then = *self.began.get_or_insert_with(Instant::now) + PERIOD * self.n as u32;
            std::thread::sleep(then.saturating_duration_since(Instant::now()));
        }
        self.n += 1;
        ctx.set_stamp_ns(self.n as i64 * PERIOD.as_nanos() as i64);
        Ok(Some(AnyOut { out: self.megabytes[self.n as usize % self.megabytes.len()].clone() }))
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
