//! Cost of recording a megabyte thirty times a second: processor time of the process, as a percentage of a core.
//!
//! The cost is the difference between runs with and without a recording. Processor time, because other programs disturb it
//! less than wall time, and because the writer has its own thread. Writing the same bytes to a plain file shows the share
//! of the operating system.
//!
//! `cargo bench -p osteoflow-engine --bench record -- 20` runs 20 seconds of each case; the default is 5.

#[allow(dead_code, reason = "the other benches use the rest")]
mod graph;

use osteoflow_container::Compression;
use osteoflow_engine::{
    plan::{OutputId, Plan, RecordSettings},
    run::{RunOptions, run},
};
use osteoflow_node::{
    Buffer, Column, ColumnType, Context, Describe, Display, NodeError, Outputs, ParamError, Payload, Registry,
    SchemaEntry, Source, StampNs, View, ViewError, schemars, serde, serde_json,
};
use std::{
    fs::File,
    io::Write,
    path::Path,
    sync::Arc,
    time::{Duration, Instant},
};

const PERIOD: Duration = Duration::from_nanos(1_000_000_000 / 30);
/// 43 690 points of three numbers.
const N_NUMBERS: usize = 3 * 43_690;
/// Number of different clouds.
const N_CLOUDS: usize = 8;

/// Points in one buffer.
#[derive(Clone)]
struct Cloud(Buffer);

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
        })
    }

    /// Metres in 32 bits, as viewers expect.
    fn to_display(&self, _: StampNs) -> Option<Vec<u8>> {
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
struct Camera {
    params: Params,
    began: Option<Instant>,
    clouds: Vec<Cloud>,
    n: u32,
}

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
struct Params {
    n_items: u32,
}

#[derive(Outputs)]
struct Out {
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
fn cloud(seed: u64) -> Cloud {
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

/// A plan of a camera, recorded with `recording`.
fn plan(registry: &Registry, n_items: u32, recording: Option<RecordSettings>) -> Plan {
    let plan = graph::plan(registry, &[(Camera::KIND, serde_json::json!({ "n_items": n_items }), None)]);
    let record = recording.map(|_| OutputId { node: 0, port: 0 }).into_iter().collect();
    Plan { record, recording: recording.unwrap_or_default(), ..plan }
}

/// Processor time of all threads of this process: total, and user mode only.
#[derive(Clone, Copy)]
struct Spent {
    all: Duration,
    own: Duration,
}

impl Spent {
    fn now() -> Self {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
        // The fourteenth entry. The second one, the program name in brackets, may contain spaces.
        let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
        let ticks = stat.rsplit(')').next().and_then(|rest| rest.split_whitespace().nth(11)?.parse::<f64>().ok());
        let per_second = rustix::param::clock_ticks_per_second() as f64;
        let own = Duration::from_secs_f64(ticks.unwrap_or(0.0) / per_second);
        Self { all: Duration::new(time.tv_sec as u64, time.tv_nsec as u32), own }
    }

    fn since(self, before: Self) -> Self {
        Self { all: self.all.saturating_sub(before.all), own: self.own.saturating_sub(before.own) }
    }
}

/// Processor time of `work`.
fn measured(work: impl FnOnce()) -> Spent {
    let before = Spent::now();
    work();
    Spent::now().since(before)
}

fn run_case(dir: &Path, n_items: u32, recording: Option<RecordSettings>) -> Spent {
    let mut registry = Registry::default();
    registry.payload::<Cloud, _>().source::<Camera>();
    let plan = plan(&registry, n_items, recording);
    let out_dir = recording.map(|_| dir.to_owned());
    let _ = std::fs::remove_file(dir.join("run.mcap"));
    touch(dir, n_items);
    let options = RunOptions { record: out_dir.is_some(), out_dir, ..RunOptions::default() };
    measured(|| drop(run(&plan, &registry, &options, &()).expect("the camera runs")))
}

/// Writes and removes a file as large as the recording. In a virtual machine the first use of a page is ten times as
/// expensive as writing to it, which is not a cost of recording.
fn touch(dir: &Path, n_items: u32) {
    let path = dir.join("touched");
    let mut file = File::create(&path).expect("the folder is writable");
    (0..2 * n_items).for_each(|_| file.write_all(&vec![1; 1 << 20]).expect("the disk has room"));
    drop(file);
    std::fs::remove_file(path).expect("the file was written");
}

/// Writes the same bytes at the same times to a plain file.
fn bare(dir: &Path, n_items: u32) -> Spent {
    let clouds: Vec<_> = (0..N_CLOUDS).map(|i| cloud(i as u64)).collect();
    touch(dir, n_items);
    let mut file = File::create(dir.join("bare")).expect("the folder is writable");
    measured(|| {
        let began = Instant::now();
        for n in 0..n_items {
            std::thread::sleep((began + PERIOD * n).saturating_duration_since(Instant::now()));
            let bytes: &[u8] = (*clouds[n as usize % N_CLOUDS].0).as_ref();
            file.write_all(bytes).expect("the disk has room");
        }
    })
}

fn main() {
    // `cargo test --benches` and `cargo bench` add their own options.
    let seconds = std::env::args().skip(1).find_map(|argument| argument.parse().ok()).unwrap_or(5_u32);
    let n_items = 30 * seconds;
    let dir = tempfile::tempdir().expect("a temporary folder");
    let share = |time: Duration| 100.0 * time.as_secs_f64() / f64::from(seconds);
    let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20) / f64::from(seconds);
    let idle = run_case(dir.path(), n_items, None);
    let title = format!("30 Hz x 1 MiB, {seconds} s");
    println!("{title:<28}{:>12}{:>18}{:>12}", "% of a core", "own, no system", "MiB/s");
    let row = |what: &str, spent: Spent, mib_s: f64| {
        println!("{what:<28}{:>12.2}{:>18.2}{mib_s:>12.1}", share(spent.all), share(spent.own));
    };
    row("run without recording", idle, 0.0);
    row("plain file", bare(dir.path(), n_items), 30.0);
    for views in [false, true] {
        for compression in Compression::ALL {
            let settings = RecordSettings { compression, views, ..RecordSettings::default() };
            let spent = run_case(dir.path(), n_items, Some(settings)).since(idle);
            let size = std::fs::metadata(dir.path().join("run.mcap")).map_or(0, |file| file.len());
            let what = format!("{}{}", compression.name(), if views { ", with pictures" } else { "" });
            row(&what, spent, mib(size));
        }
    }
}
