//! A camera that gives a megabyte thirty times a second, for measuring what recording costs.

use osteoflow_node::{
    Buffer, Column, ColumnType, Context, Describe, Display, DisplayContext, NodeError, Outputs, ParamError, Payload,
    SchemaEntry, Source, View, ViewError, schemars, serde, serde_json,
};
use std::{
    sync::Arc,
    time::{Duration, Instant},
};

/// Time between two clouds.
pub const PERIOD: Duration = Duration::from_nanos(1_000_000_000 / 30);
/// 43 690 points of three numbers.
const N_NUMBERS: usize = 3 * 43_690;
/// Number of different clouds.
pub const N_CLOUDS: usize = 8;

/// Points in one buffer.
#[derive(Clone)]
pub struct Cloud(pub Buffer);

impl Payload<Cloud> for Cloud {
    const NAME: &'static str = "bench/Cloud";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] =
        &[SchemaEntry::text("frame"), SchemaEntry::column("points", ColumnType::F64, 3)];

    fn to_view(&self) -> View {
        View::new().with("frame", "camera").with_column(Column::new("points", ColumnType::F64, 3, self.0.clone()))
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        Ok(Self(view.column("points")?.data.clone()))
    }

    fn to_result(&self) -> serde_json::Value {
        serde_json::Value::Null
    }

    fn n_bytes(&self) -> usize {
        (*self.0).as_ref().len()
    }

    fn display() -> Option<Display> {
        Some(Display {
            schema_name: "bench.Cloud".into(),
            schema_encoding: "jsonschema".into(),
            schema_data: b"{\"type\":\"object\"}".to_vec(),
            message_encoding: "raw".into(),
            answer: false,
            removal: Vec::new(),
        })
    }

    /// Metres in 32 bits, as viewers expect.
    fn to_display(&self, _: &DisplayContext<'_>) -> Option<Vec<u8>> {
        let bytes: &[u8] = (*self.0).as_ref();
        let mut out = Vec::with_capacity(bytes.len() / 2);
        for number in bytes.chunks_exact(8) {
            let mm = f64::from_ne_bytes(number.try_into().ok()?);
            out.extend_from_slice(&((mm / 1000.0) as f32).to_le_bytes());
        }
        Some(out)
    }
}

/// Gives thirty clouds a second.
#[derive(Describe)]
pub struct Camera {
    params: Params,
    began: Option<Instant>,
    clouds: Vec<Cloud>,
    n: u32,
}

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
pub struct Params {
    n_items: u32,
}

#[derive(Outputs)]
pub struct Out {
    /// The cloud.
    cloud: Cloud,
}

impl Source for Camera {
    const KIND: &'static str = "bench.camera";
    type Params = Params;
    type Outputs = Out;

    fn new(params: Params) -> Result<Self, ParamError> {
        Ok(Self { params, began: None, clouds: (0..N_CLOUDS).map(|i| cloud(i as u64)).collect(), n: 0 })
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<Out>, NodeError> {
        if self.n == self.params.n_items {
            return Ok(None);
        }
        let then = *self.began.get_or_insert_with(Instant::now) + PERIOD * self.n;
        std::thread::sleep(then.saturating_duration_since(Instant::now()));
        self.n += 1;
        ctx.set_stamp_ns(i64::from(self.n) * PERIOD.as_nanos() as i64);
        Ok(Some(Out { cloud: self.clouds[self.n as usize % N_CLOUDS].clone() }))
    }
}

/// A bone-like surface seen from 300 mm, with scanner noise of 0.05 mm.
pub fn cloud(seed: u64) -> Cloud {
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
    Cloud(Arc::new(bytes))
}
