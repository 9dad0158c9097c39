//! A graph of a few lines whose recording has values, empties, constants, columns, text and a wire that takes anything.

use osteoflow_engine::{Checked, RunOptions, check_text, run};
use osteoflow_node::{
    Column, ColumnType, Context, Declared, Describe, Display, Emit, Inputs, Node, NodeError, Outputs, ParamError,
    Payload, Registry, SchemaEntry, Source, StampNs, Value, View, ViewError, schemars, serde,
    serde_json::{self, Value as Json},
};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

/// Samples with a label and a place.
#[derive(Debug, Clone)]
pub(crate) struct Wave {
    pub(crate) label: String,
    pub(crate) samples: Vec<f64>,
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
        let bytes: Vec<u8> = self.samples.iter().flat_map(|s| s.to_ne_bytes()).collect();
        let report = serde_json::json!({ "n": self.samples.len(), "first_mm": self.samples.first() });
        View::new()
            .with("label", self.label.as_str())
            .with("gain_mm", self.samples.first().copied().unwrap_or(0.0))
            .with("json", report.to_string())
            .with_column(Column::new("samples_mm", ColumnType::F64, 2, Arc::new(bytes)))
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        let samples = view.column("samples_mm")?.rows_of::<[f64; 2]>()?;
        Ok(Self { label: view.text("label")?.into(), samples: samples.iter().flatten().copied().collect() })
    }

    fn to_result(&self) -> Json {
        self.label.as_str().into()
    }

    fn display() -> Option<Display> {
        Some(Display {
            schema_name: "toy.Wave".into(),
            schema_encoding: "jsonschema".into(),
            schema_data: b"{}".to_vec(),
            message_encoding: "json".into(),
        })
    }

    fn to_display(&self, stamp_ns: StampNs) -> Option<Vec<u8>> {
        Some(format!("{{\"stamp_ns\": {stamp_ns}, \"n\": {}}}", self.samples.len()).into_bytes())
    }
}

#[derive(serde::Deserialize, schemars::JsonSchema)]
#[serde(crate = "serde")]
#[schemars(crate = "schemars")]
pub(crate) struct BeatParams {
    /// Waves it gives.
    n: u64,
    /// Rows of each.
    #[serde(default = "rows")]
    rows: usize,
    /// The first stamp.
    #[serde(default = "first_ns")]
    first_ns: i64,
    /// Added to every sample of the wave with this number.
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
pub(crate) struct Beat {
    params: BeatParams,
    given: u64,
}

#[derive(Outputs)]
pub(crate) struct WaveOut {
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
        // Hardly compressible, as measured coordinates are.
        let sample = |i: usize| ((number * 7919 + i as u64 * 104_729) as f64).sin() * 100.0 + odd;
        let samples = (0..2 * self.params.rows).map(sample).collect();
        Ok(Some(WaveOut { wave: Wave { label: format!("wave {number}"), samples } }))
    }
}

#[derive(Inputs)]
pub(crate) struct WaveIn {
    /// The wave.
    wave: Wave,
}

#[derive(Outputs)]
pub(crate) struct ShortOut {
    /// The first rows, unless there is a reason not to.
    short: Emit<Wave>,
}

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
pub(crate) struct CutParams {
    /// Multiplies what it lets through.
    gain: Option<f64>,
}

/// Keeps the first rows; refuses every fifth wave.
#[derive(Describe)]
pub(crate) struct Cut(f64);

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

#[derive(Inputs)]
pub(crate) struct AnyIn {
    /// Anything.
    thing: Value,
}

#[derive(Outputs)]
pub(crate) struct AnyOut {
    /// The same.
    thing: Value,
}

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
pub(crate) struct NoParams {}

/// Hands on what comes, whatever it is.
#[derive(Describe)]
pub(crate) struct Pass;

impl Node for Pass {
    const KIND: &'static str = "toy.pass";
    type Params = NoParams;
    type Inputs = AnyIn;
    type Outputs = AnyOut;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: AnyIn, _: &mut Context) -> Result<AnyOut, NodeError> {
        Ok(AnyOut { thing: i.thing })
    }
}

/// Outputs that a graph declares, for what is played in its place.
#[derive(Describe)]
pub(crate) struct Played;

impl Source for Played {
    const KIND: &'static str = "toy.played";
    type Params = NoParams;
    type Outputs = Declared<NoParams>;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn next(&mut self, _: &mut Context) -> Result<Option<Declared<NoParams>>, NodeError> {
        Err(NodeError::new("only to be played"))
    }
}

pub(crate) fn registry() -> Registry {
    let mut registry = Registry::default();
    registry.payload::<Wave, _>();
    registry.source::<Beat>().node::<Cut>().node::<Pass>();
    registry
}

pub(crate) const GRAPH: &str = r#"
[graph]
format = 1
name   = "toy"
seed   = 5

[node.beat]
kind = "toy.beat"
n    = 40

[node.constant]
kind     = "toy.beat"
n        = 1
first_ns = 0

[node.cut]
kind = "toy.cut"
in   = { wave = "beat.wave" }

[node.pass]
kind = "toy.pass"
in   = { thing = "cut.short" }

[record]
wires = ["*"]

[results]
"last" = "beat.wave"
"#;

pub(crate) fn checked(sets: &[&str]) -> Checked {
    let sets: Vec<String> = sets.iter().map(|set| (*set).into()).collect();
    match check_text(GRAPH, Path::new("/graphs/toy.toml"), &sets, &registry()) {
        Ok(checked) => checked,
        Err(faults) => panic!("{faults}"),
    }
}

/// Runs the graph into the folder; answers the recording.
pub(crate) fn record(dir: &Path, sets: &[&str], workers: usize) -> PathBuf {
    let options = RunOptions { out_dir: Some(dir.into()), record: true, workers, ..RunOptions::default() };
    run(&checked(sets).plan, &registry(), &options, &()).unwrap();
    dir.join("run.mcap")
}
