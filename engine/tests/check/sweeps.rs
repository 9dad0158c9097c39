//! The contents of `[sweep]` as they are read.

use super::golden::compare;
use osteoflow_engine::check_text;
use osteoflow_toy::stages;
use std::path::Path;

const HEAD: &str = r#"
[graph]
format = 1
[node.camera]
kind = "acquire.camera"
[node.crop]
kind = "crop.box"
in   = { cloud = "camera.cloud" }
[results]
"poses.cloud" = "crop.cloud"
report = "crop.report"
"#;

/// The sweep as debug text, or its faults.
fn read(sweep: &str) -> Result<String, String> {
    let text = format!("{HEAD}{sweep}");
    let checked = check_text(&text, Path::new("tests/graphs/sweep.toml"), &[], &stages::registry());
    let checked = checked.map_err(|faults| faults.to_string())?;
    Ok(format!("{:#?}", checked.sweep.as_deref()))
}

#[test]
fn a_sweep_with_every_key_is_read_as_the_golden_text_says() {
    let sweep = r#"
[sweep]
repeat    = 3
same_seed = true
units     = ["keep", "procedure"]
pair      = [["size", "width"], ["word", "label"]]
limit     = { mean_mm = 2, share = 0.5 }
compare   = [{ factor = "size", to = 2.0, margin = { mean_mm = 1e-3 } }, { factor = "keep" }, { factor = "label", to = "two" }]
[sweep.factor]
size   = { key = "crop.threshold", values = [1.0, 2.0, 4e0] }
width  = { keys = ["crop.half_mm[0]", "crop.half_mm[1]"], from = 1, to = 2.0, n = 3 }
keep   = { key = "crop.keep", values = ["inside", "outside"] }
word   = { values = [{ crop.region.shape = "sphere", crop.region.radius_mm = 2 }, { "crop"."region" = { shape = "slab" } }], labels = ["ball", "slab"] }
label  = { key = "crop.label", values = ["a \"b\"", "c"], labels = ["one", "two"] }
region = { key = "crop.rounds[7]", values = [{ n = 3, step_mm = 0.5 }] }
log    = { key = "crop.margin", from = 1, to = 100, n = 2, log = true }
down   = { key = "crop.offsets_mm.up", from = 0, to = -1, n = 2, log = false }
[sweep.draw]
uniform = { key = "crop.rounds[0].step_mm", uniform = [1, 1] }
normal  = { keys = ["crop.rounds[1].step_mm", "crop.rounds[2].step_mm"], normal = [-1.5, 0] }
ratio   = { key = "crop.offsets_mm.left", log_uniform = [0.1, 0.1] }
whole   = { key = "crop.rounds[1].n", integers = [-1, -1] }
choice  = { key = "crop.offsets_mm.right", choice = [1, 2.5] }
[sweep.columns]
mean_mm = "report.mean"
share   = "report"
[sweep.points]
tre = { from = "report.points" }
fre = { from = "poses.cloud.list", name = "id", axes = ["r"] }
"#;
    compare(&read(sweep).unwrap(), Path::new("tests/check/sweep.txt")).unwrap();
}

#[test]
fn what_a_sweep_leaves_out_has_defaults_and_a_graph_may_have_none() {
    assert_eq!(read("").unwrap(), "None");
    let empty = read("[sweep]\n").unwrap();
    for line in ["repeat: 1,", "repeat_name: \"repeat\",", "same_seed: false,", "factors: [],", "compare: [],"] {
        assert!(empty.contains(line), "{line}\n{empty}");
    }
    let units = |text: &str| {
        let factors = "[sweep.factor]\nkeep = { key = \"crop.keep\", values = [\"inside\"] }\n\
                       deep = { key = \"crop.label\", values = [\"a\"] }\n";
        let read = read(&format!("[sweep]\n{text}\n{factors}")).unwrap();
        let units = read.split("units: [").nth(1).unwrap().split(']').next().unwrap();
        units
            .split(',')
            .map(|unit| unit.trim().trim_matches('"').to_owned())
            .filter(|u| !u.is_empty())
            .collect::<Vec<_>>()
    };
    assert_eq!(units(""), ["repeat"]);
    assert_eq!(units("units = []"), ["repeat"]);
    assert_eq!(units("units = [\"keep\", \"deep\"]"), ["keep", "deep", "repeat"], "repeats are within the factors");
    assert_eq!(units("units = [\"patient\", \"deep\"]"), ["patient", "deep"]);
    assert_eq!(units("units = [\"keep\", \"keeep\"]"), ["keep", "keeep"], "the factor that is near is named too");
}

#[test]
fn a_sweep_has_at_most_a_million_runs_and_a_factor_ten_thousand_values() {
    let keep = |values: &str| format!("[sweep.factor]\nkeep = {{ key = \"crop.label\", values = {values} }}\n");
    for (repeat, values) in [(1_000_000, "[\"a\"]"), (500_000, "[\"a\", \"b\"]")] {
        read(&format!("[sweep]\nrepeat = {repeat}\n{}", keep(values))).unwrap();
    }
    let texts = |n: usize| format!("{:?}", (0..n).map(|k| k.to_string()).collect::<Vec<_>>());
    let said = read(&keep(&texts(10_001))).unwrap_err();
    assert!(said.contains("factor \"keep\" has 10001 values, at most 10000 are possible"), "{said}");
    assert!(read(&keep(&texts(10_000))).is_ok());
}

#[test]
fn a_factor_sets_graph_seed_only_if_all_repeats_have_one_seed() {
    let seeds = "[sweep.factor]\nseeds = { key = \"graph.seed\", values = [1, 2] }\n";
    read(&format!("[sweep]\nsame_seed = true\n{seeds}")).unwrap();
    let said = read(seeds).unwrap_err();
    assert!(said.contains("each repeat sets it: graph.seed, +1, +2 ..."), "{said}");
}

#[test]
fn paired_factors_may_set_one_key_in_values_that_never_meet() {
    let factors = |pair: &str, first: &str, second: &str| {
        read(&format!(
            "[sweep]\npair = {pair}\n[sweep.factor]\n\
             a = {{ values = [{first}], labels = [\"1\", \"2\"] }}\nb = {{ values = [{second}], labels = [\"1\", \"2\"] }}\n\
             c = {{ key = \"crop.threshold\", values = [1, 2] }}\n"
        ))
        .err()
        .unwrap_or_default()
    };
    let (label, keep) = ("{ crop.label = \"x\" }", "{ crop.keep = \"inside\" }");
    let (first, second) = (format!("{label}, {keep}"), format!("{keep}, {label}"));
    let both = "factor \"a\" and factor \"b\" both set crop.keep, of which a run has one value";
    assert_eq!(factors("[\"a\", \"b\"]", &first, &second), "", "one pair");
    assert!(factors("[\"a\", \"b\"]", &first, &first).contains("both set crop.label"), "the same value of both");
    assert!(factors("[]", &first, &second).contains(both), "crossed");
    assert!(factors("[\"a\", \"c\"]", &first, &second).contains(both), "paired with another one only");
    assert!(factors("[[\"a\", \"c\"], [\"b\"]]", &first, &second).contains(both), "in two pairs");
}
