//! A source of waves, and a node that cuts them.

use crate::{json_display, samples::float_column, stream::Relay};
use osteoflow_node::{
    ColumnType, Context, Describe, Display, DisplayContext, Emit, Inputs, Node, NodeError, Outputs, ParamError,
    Payload, Registry, SchemaEntry, Source, View, ViewError, schemars, serde, serde_json,
};

/// Samples with a label and a JSON text, which viewers can show.
#[derive(Debug, Clone)]
pub struct Wave {
    pub label: String,
    pub samples: Vec<f64>,
}

impl Payload<Wave> for Wave {
    const NAME: &'static str = "toy/Wave";
    const VERSION: u32 = 3;
    const SCHEMA: &'static [SchemaEntry] = &[
        SchemaEntry::text("label"),
        SchemaEntry::float("gain_mm"),
        SchemaEntry::text("json"),
        SchemaEntry::column("samples_mm", ColumnType::F64, 2),
    ];

    fn to_view(&self) -> View {
        let report = serde_json::json!({ "n": self.samples.len(), "first_mm": self.samples.first() });
        View::new()
            .with("label", self.label.as_str())
            .with("gain_mm", self.samples.first().copied().unwrap_or(0.0))
            .with("json", report.to_string())
            .with_column(float_column("samples_mm", 2, &self.samples))
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        let samples = view.column("samples_mm")?.rows_of::<[f64; 2]>()?;
        Ok(Self { label: view.text("label")?.into(), samples: samples.iter().flatten().copied().collect() })
    }

    fn to_result(&self) -> serde_json::Value {
        self.label.as_str().into()
    }

    fn display() -> Option<Display> {
        Some(json_display("toy.Wave"))
    }

    fn to_display(&self, about: &DisplayContext<'_>) -> Option<Vec<u8>> {
        let stamp_ns = about.stamp_ns;
        Some(format!("{{\"stamp_ns\": {stamp_ns}, \"n\": {}}}", self.samples.len()).into_bytes())
    }
}

#[derive(serde::Deserialize, schemars::JsonSchema)]
#[serde(crate = "serde")]
#[schemars(crate = "schemars")]
pub struct BeatParams {
    /// Number of waves.
    n: u64,
    /// Rows of each wave.
    #[serde(default = "rows")]
    rows: usize,
    /// The first stamp.
    #[serde(default = "first_ns")]
    first_ns: i64,
    /// Number of a wave with a small offset in every sample.
    #[serde(default)]
    odd: Option<u64>,
}

fn rows() -> usize {
    50
}

fn first_ns() -> i64 {
    1_000
}

/// Gives waves, a millisecond apart.
#[derive(Describe)]
pub struct Beat {
    params: BeatParams,
    given: u64,
}

#[derive(Outputs)]
pub struct WaveOut {
    /// The wave.
    wave: Wave,
}

impl Source for Beat {
    const KIND: &'static str = "toy.beat";
    type Params = BeatParams;
    type Outputs = WaveOut;

    fn new(params: BeatParams) -> Result<Self, ParamError> {
        Ok(Self { params, given: 0 })
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<WaveOut>, NodeError> {
        if self.given == self.params.n {
            return Ok(None);
        }
        let number = self.given;
        self.given += 1;
        ctx.set_stamp_ns(self.params.first_ns + 1_000_000 * number as i64);
        let odd = if self.params.odd == Some(number) { 1e-9 } else { 0.0 };
        // Barely compressible, as measured coordinates are.
        let sample = |i: usize| ((number * 7919 + i as u64 * 104_729) as f64).sin() * 100.0 + odd;
        let samples = (0..2 * self.params.rows).map(sample).collect();
        Ok(Some(WaveOut { wave: Wave { label: format!("wave {number}"), samples } }))
    }
}

#[derive(Inputs)]
pub struct WaveIn {
    /// The wave.
    wave: Wave,
}

#[derive(Outputs)]
pub struct ShortOut {
    /// The first rows, unless the wave is refused.
    short: Emit<Wave>,
}

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
pub struct CutParams {
    /// Factor of the samples.
    gain: Option<f64>,
}

/// Keeps the first rows; refuses every fifth wave.
#[derive(Describe)]
pub struct Cut(f64);

impl Node for Cut {
    const KIND: &'static str = "toy.cut";
    type Params = CutParams;
    type Inputs = WaveIn;
    type Outputs = ShortOut;

    fn new(params: CutParams) -> Result<Self, ParamError> {
        Ok(Self(params.gain.unwrap_or(1.0)))
    }

    fn process(&mut self, i: WaveIn, ctx: &mut Context) -> Result<ShortOut, NodeError> {
        if ctx.item() % 5 == 4 {
            return Ok(ShortOut { short: Emit::Empty("every fifth is refused".into()) });
        }
        let samples = i.wave.samples.iter().take(6).map(|s| s * self.0).collect();
        Ok(ShortOut { short: Wave { label: i.wave.label, samples }.into() })
    }
}

pub fn registry() -> Registry {
    let mut registry = Registry::default();
    registry.payload::<Wave, _>();
    registry.source::<Beat>().node::<Cut>().function::<Relay>();
    registry
}
