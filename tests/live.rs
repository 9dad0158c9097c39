//! Live sources from the command line: the shipped recording, played as if its devices sent it.

use crate::common::{is_slow_run, json, osteoflow, run, run_whole};
use serde_json::Value;

const RECORDED: &str = "graphs/fibula_recorded.toml";
const LIVE: &str = "graphs/variants/fibula_live.toml";
/// So fast that only the graph takes time.
const AT_ONCE: &str = "recording.rate=1e9";

#[test]
fn a_live_source_gives_the_results_of_the_recording_it_plays() {
    // The live graph's verdict does not wait for the stylus, which comes long after the planes are needed.
    let recorded = run_whole(
        RECORDED,
        &["--no-record", "--set", r#"remove=["node.verdict.in.measured", "node.verdict.in.followed"]"#],
    );
    let jitter = ["recording.jitter_ms=20", "recording.max_delay_ms=20"];
    for (sets, all_workers) in [(&[][..], ["1", "8"]), (&jitter, ["8", "1"])] {
        for workers in all_workers.into_iter().take(if is_slow_run() { 2 } else { 1 }) {
            let mut arguments = vec!["--no-record", "--workers", workers, "--set", AT_ONCE];
            arguments.extend(sets.iter().flat_map(|set| ["--set", set]));
            let live = run_whole(LIVE, &arguments);
            assert_eq!(live.results, recorded.results, "{sets:?} on {workers} workers");
            assert!(!live.stderr.contains("late"), "{}", live.stderr);
        }
    }
}

#[test]
fn late_items_are_counted_and_reported_and_replay_the_same() {
    let arguments = ["--set", AT_ONCE, "--set", "recording.jitter_ms=200", "--set", "recording.max_delay_ms=5"];
    let live = run(LIVE, &arguments);
    let late = "recording.region: 1 item came late, by up to ";
    assert!(live.stderr.contains(late), "{}", live.stderr);
    let manifest = json(&live.dir.path().join("manifest.json"));
    let of = |link: &Value, key: &str| link[key].as_u64().unwrap();
    let links = manifest["links"].as_array().unwrap();
    assert!(links.iter().any(|link| link["from"] == "recording.region" && of(link, "late") == 1), "{links:?}");
    assert!(links.iter().all(|link| of(link, "sent") == of(link, "received") + of(link, "dropped")));
    let replay = osteoflow().arg("replay").arg(live.dir.path().join("run.mcap")).output().unwrap();
    let printed = String::from_utf8_lossy(&replay.stdout);
    assert!(printed.contains(", 0 differ, "), "{printed}{}", String::from_utf8_lossy(&replay.stderr));
}
