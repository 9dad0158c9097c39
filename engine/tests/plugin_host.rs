//! Host functions of plugins: the same nodes, loaded and built in, give the same answers, warnings, reasons and log lines.

use crate::plugins::build;
use osteoflow_engine::{
    Recording, ReplayOptions, RunOptions, RunReport, check_text,
    plugin::{Library, provide},
    replay, run,
};
use osteoflow_node::{Registry, tracing};
use osteoflow_toy::context::registry as built_in;
use serde_json::Value;
use std::{
    fmt::{Debug, Write},
    path::Path,
    sync::{Mutex, Once, OnceLock},
};

/// A registry with the nodes of [`osteoflow_toy::context`] from the library.
fn loaded() -> Registry {
    static LIBRARY: OnceLock<Library> = OnceLock::new();
    listen();
    let library: &'static Library =
        LIBRARY.get_or_init(|| Library::load(&build::example("plugin_kinds")).expect("the library is a plugin"));
    let mut registry = Registry::default();
    provide(&mut registry, library.description(), &"0".into(), move || Ok(library)).unwrap();
    registry
}

const HEAD: &str = "[graph]\nformat = 1\nname = \"asks\"\nseed = 7\n\n[node.count]\nkind = \"ask.count\"\n\n";

/// Runs the graph of [`HEAD`] and `rest`.
fn ran(registry: &Registry, rest: &str, options: &RunOptions) -> RunReport {
    let checked = check_text(&format!("{HEAD}{rest}"), Path::new("asks.toml"), &[], registry);
    let plan = checked.unwrap_or_else(|faults| panic!("{faults:?}")).plan;
    run(&plan, registry, options, &()).unwrap()
}

/// Results, warnings and outcome of a run.
fn format(report: &RunReport) -> String {
    format!("{}\n{:?}\n{:?}", report.results, report.warnings, report.outcome)
}

/// Runs a graph with built-in nodes, and asserts that loaded ones give the same on one worker and on four.
fn same(rest: &str) -> (RunReport, Value) {
    let expected = ran(&built_in(), rest, &RunOptions::default());
    for workers in [1, 4] {
        let found = ran(&loaded(), rest, &RunOptions { workers, ..RunOptions::default() });
        assert_eq!(format(&found), format(&expected), "{workers} workers");
    }
    let results = expected.results.clone();
    (expected, results)
}

#[test]
fn draws_warnings_and_stamps_are_equal_loaded_and_built_in() {
    let (report, results) = same(
        "[node.draw]\nkind = \"ask.draw\"\nin = { number = \"count.number\" }\n\n[results]\ndrawn = { from = \"draw.out\", \
         all = true }\n",
    );
    assert_eq!(results["drawn"].as_array().unwrap().len(), 9);
    assert_eq!(report.warnings.len(), 1);
    assert_eq!(report.warnings[0].message, "the third item of draw at 12 ns");
}

#[test]
fn sources_of_a_plugin_give_constants_empties_silence_and_declared_ports() {
    let (_, results) = same(
        "[node.always]\nkind = \"ask.always\"\n\n[node.declare]\nkind = \"ask.declare\"\nout = { a = { type = \"ask/Number\", \
         value = 1.5 }, b = { type = \"ask/Number\", value = -2.0 } }\n\n[results]\nalways = \"always.out\"\na = \
         \"declare.a\"\nb = \"declare.b\"\nthird = { from = \"count.third\", all = true, optional = true }\n",
    );
    assert_eq!(results["always"]["value"], 0.5);
    assert_eq!([&results["a"]["value"], &results["b"]["value"]], [1.5, -2.0]);
}

#[test]
fn optional_ports_get_a_reason_and_collecting_ports_their_items() {
    let (report, results) = same(
        "[node.always]\nkind = \"ask.always\"\n\n[node.perhaps]\nkind = \"ask.perhaps\"\nin = { number = \"count.number\", \
         other = \"count.third\" }\n\n[node.four]\nkind = \"ask.four\"\nin = { numbers = \"count.number\", constant = \
         \"always.out\" }\n\n[results]\nperhaps = { from = \"perhaps.out\", all = true }\nfours = { from = \"four.out\", \
         all = true }\n",
    );
    let warned = |item: usize| report.warnings[item].message.as_str();
    assert_eq!([warned(0), warned(2)], ["0: Some(0.0), there", "2: None, 1 is no third"]);
    assert_eq!(results["fours"][0]["value"], 0.5 + 1.0 + 2.0 + 3.0);
}

#[test]
fn a_panic_in_a_plugin_is_reported_with_its_location_and_a_skipped_node_is_rebuilt() {
    let graph = |on_error: &str| {
        format!(
            "[node.panic]\nkind = \"ask.panic\"\nin = {{ number = \"count.number\" }}\non_error = \"{on_error}\"\n\n[results]\n\
             firings = {{ from = \"panic.out\", all = true, optional = true }}\n"
        )
    };
    let (skipped, results) = same(&graph("skip"));
    let firings: Vec<_> = results["firings"].as_array().unwrap().iter().map(|f| f["value"].as_f64()).collect();
    // A rebuilt node counts from 1 again.
    assert_eq!(firings.into_iter().flatten().collect::<Vec<_>>(), [1.0, 2.0, 3.0, 1.0, 1.0, 2.0, 3.0]);
    let failed = skipped.nodes.iter().find(|node| node.name == "panic").unwrap();
    assert_eq!(failed.failed, 2);

    let stopped = ran(&loaded(), &graph("stop").replace(", optional = true", ""), &RunOptions::default());
    let outcome = format!("{:?}", stopped.outcome);
    assert!(outcome.contains("three is a crowd") && outcome.contains("context.rs:"), "{outcome}");
    assert!(outcome.contains("panicked: true"), "{outcome}");
}

#[test]
fn clock_readings_of_a_plugin_are_recorded_and_replayed() {
    let dir = tempfile::tempdir().unwrap();
    let rest = "[node.clock]\nkind = \"ask.clock\"\nin = { number = \"count.number\" }\n\n[record]\nwires = [\"clock.*\"]\n\n\
                [results]\nread = { from = \"clock.out\", all = true }\n";
    let options = RunOptions { out_dir: Some(dir.path().into()), record: true, ..RunOptions::default() };
    let report = ran(&loaded(), rest, &options);
    let recording = dir.path().join("run.mcap");
    assert_eq!(Recording::open(&recording).unwrap().readings.len(), 9, "each firing read the clock");
    let again = replay(&recording, &ReplayOptions::default(), &loaded(), &RunOptions::default(), &()).unwrap();
    assert!(again.is_equal() && again.results_equal == Some(true), "{:#?}", again.wires);
    assert_eq!(again.run.results["read"], report.results["read"]);
    assert!(again.run.warnings.is_empty(), "{:?}", again.run.warnings);
}

/// The log lines of this process.
static LINES: Mutex<Vec<String>> = Mutex::new(Vec::new());

struct Listener;

impl tracing::Subscriber for Listener {
    fn enabled(&self, about: &tracing::Metadata<'_>) -> bool {
        *about.level() <= tracing::Level::INFO
    }

    fn max_level_hint(&self) -> Option<tracing::level_filters::LevelFilter> {
        Some(tracing::level_filters::LevelFilter::INFO)
    }

    fn new_span(&self, _: &tracing::span::Attributes<'_>) -> tracing::span::Id {
        tracing::span::Id::from_u64(1)
    }

    fn record(&self, _: &tracing::span::Id, _: &tracing::span::Record<'_>) {}

    fn record_follows_from(&self, _: &tracing::span::Id, _: &tracing::span::Id) {}

    fn event(&self, event: &tracing::Event<'_>) {
        struct Fields(String);
        impl tracing::field::Visit for Fields {
            fn record_debug(&mut self, field: &tracing::field::Field, value: &dyn Debug) {
                write!(self.0, " {field}={value:?}").unwrap();
            }
        }
        let metadata = event.metadata();
        let mut line = Fields(format!("{} {}:", metadata.level(), metadata.target()));
        event.record(&mut line);
        LINES.lock().unwrap().push(line.0);
    }

    fn enter(&self, _: &tracing::span::Id) {}

    fn exit(&self, _: &tracing::span::Id) {}
}

/// Installs the listener. Call before loading the library, which reads the log level once.
fn listen() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| tracing::subscriber::set_global_default(Listener).unwrap());
}

#[test]
fn log_lines_of_a_plugin_reach_the_program_with_target_and_fields() {
    ran(
        &loaded(),
        "[node.logged]\nkind = \"ask.draw\"\nin = { number = \"count.number\" }\n\n[results]\nlast = \"logged.out\"\n",
        &RunOptions::default(),
    );
    let lines = LINES.lock().unwrap();
    let from_plugin: Vec<_> = lines.iter().filter(|line| line.starts_with("INFO plugin:")).collect();
    let found = from_plugin.iter().any(|line| line.contains("asks: drew once item=8 name=\"draw\""));
    assert!(found, "{from_plugin:#?}");
    assert!(!lines.iter().any(|line| line.contains("nobody listens")), "{lines:#?}");
}
