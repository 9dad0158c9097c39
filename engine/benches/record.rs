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
use osteoflow_node::{Registry, serde_json::json};
use osteoflow_toy::stream::{Megabyte, N_DIFFERENT, PERIOD, registry};
use std::{
    fs::File,
    io::Write,
    path::Path,
    time::{Duration, Instant},
};

/// A plan of a camera whose clouds are recorded with `recording`, behind a node of their type.
fn plan(registry: &Registry, n_items: u32, recording: Option<RecordSettings>) -> Plan {
    let camera = ("bench.frames", json!({ "items": n_items, "in_time": true }), None);
    let plan = graph::plan(registry, &[camera, ("bench.look", json!({}), Some(0))]);
    let record = recording.map(|_| OutputId { node: 1, port: 0 }).into_iter().collect();
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
    let registry = registry();
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
    let clouds: Vec<_> = (0..N_DIFFERENT).map(|i| Megabyte::scan(i as u64)).collect();
    touch(dir, n_items);
    let mut file = File::create(dir.join("bare")).expect("the folder is writable");
    measured(|| {
        let began = Instant::now();
        for n in 0..n_items {
            std::thread::sleep((began + PERIOD * n).saturating_duration_since(Instant::now()));
            file.write_all(clouds[n as usize % N_DIFFERENT].bytes()).expect("the disk has room");
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
