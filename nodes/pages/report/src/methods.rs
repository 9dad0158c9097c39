//! The methods section, from the graph as it ran.

use crate::{cell::Cell, format::number, html::Page, run_folder::RunFolder};
use osteoflow_node::Registry;
use serde_json::Value as Json;
use std::collections::{BTreeMap, BTreeSet};

/// The methods of a run.
pub(crate) fn of_run(page: &mut Page, run: &RunFolder, registry: &Registry) {
    let graph = &run.manifest["graph"];
    let command = &run.manifest["command"];
    let origin = if run.is_simulated() { "All data were simulated" } else { "Data were read from files" };
    let mut words = format!(
        "{origin}. The graph \"{}\" was run with osteoflow {} (git {}), seed {}. ",
        graph["name"].as_str().unwrap_or("?"),
        command["version"].as_str().unwrap_or("?"),
        command["git_revision"].as_str().unwrap_or("not known"),
        graph["seed"],
    );
    let icp = &run.results["icp"];
    if let (Some(iterations), Some(pairs)) = (icp["iterations"].as_u64(), icp["n_pairs"].as_u64()) {
        let (n, stopped) = (icp["n_source"].as_u64().unwrap_or(pairs), icp["stop_reason"].as_str().unwrap_or("?"));
        words += &format!(
            "The fine registration paired {pairs} of {n} scan points in its last of {iterations} iterations, with an RMS \
             residual of {} mm, and stopped by its rule \"{stopped}\". ",
            number(icp["rms_mm"].as_f64().unwrap_or(f64::NAN))
        );
    }
    if let Some(surface) = run.results["ct_surface"].as_str() {
        words += &format!("The CT surface was of origin \"{surface}\". ");
    }
    let resolved = run.manifest["resolved_graph"].as_str().unwrap_or_default();
    let nodes = nodes_of(resolved);
    words += &used(&nodes);
    words += &main_terms(&nodes, registry, "");
    words += "TRE is the distance at points that were not used to fit; FRE and surface residuals do not predict it. Lengths \
              are in millimetres, along the axes of the bone where z runs along it. One run is one procedure on one bone: \
              n = 1, whatever the number of points.";
    page.text(&words);
    steps(page, &nodes, registry);
    error_terms(page, &nodes, registry);
}

/// The methods of a sweep: its design, then the steps of the graphs that its runs ran.
pub(crate) fn of_sweep(page: &mut Page, words: &str, nodes: &[(String, toml::Table)], registry: &Registry) {
    let terms = main_terms(nodes, registry, ", where the design sets no other value,");
    page.text(format!("{words} {}{terms}", used(nodes)).trim_end());
    steps(page, nodes, registry);
    error_terms(page, nodes, registry);
}

/// The stages whose kinds the paragraph names.
const STAGES: [(&str, &str); 3] =
    [("hole.", "Holes of the laser were found by"), ("coarse.", "Coarse fit:"), ("icp.", "Fine registration:")];

/// A sentence for each stage with the kinds of its nodes, also where a kind of a plugin takes the place of a built-in one.
fn used(nodes: &[(String, toml::Table)]) -> String {
    let mut words = String::new();
    for (stage, what) in STAGES {
        let is_of = |(name, table): &&(String, toml::Table)| {
            kind_of(table).starts_with(stage) || *name == stage.trim_end_matches('.')
        };
        let names: BTreeSet<_> = nodes.iter().filter(is_of).map(|(name, _)| name).collect();
        let of: Vec<_> = nodes.iter().filter(|(name, _)| names.contains(name)).cloned().collect();
        let of = kinds_of(&of);
        if !of.is_empty() {
            words += &format!("{what} {}. ", of.join(", "));
        }
    }
    words
}

/// The error terms of the simulation that the paragraph names; the table has all of them.
const MAIN_TERMS: [(&str, &str, &str); 13] = [
    ("camera.depth_noise_mm", "depth noise", "mm"),
    ("camera.depth_bias_mm", "depth bias", "mm"),
    ("camera.dropout", "dropout", "%"),
    ("tracker.placement_mm", "marker placement", "mm"),
    ("tracker.placement_deg", "marker placement about each axis", "\u{b0}"),
    ("tracker.noise_mm", "tracker noise", "mm"),
    ("tracker.noise_deg", "tracker noise about each axis", "\u{b0}"),
    ("phantom.print_mm", "the phantom's print", "mm"),
    ("laser.aim_across_mm", "laser aim across the bone", "mm"),
    ("laser.aim_along_mm", "laser aim along it", "mm"),
    ("stylus.tip_mm", "stylus tip", "mm"),
    ("stylus.touch_mm", "each touch of the stylus", "mm"),
    ("ruler.shared_mm", "ruler error that all marks share", "mm"),
];

/// A sentence with the main error terms and their values; empty if none is simulated.
fn main_terms(nodes: &[(String, toml::Table)], registry: &Registry, unless: &str) -> String {
    let Some((_, table)) = nodes.iter().find(|(_, table)| kind_of(table) == "acquire.simulated") else {
        return String::new();
    };
    let Some(known) = registry.kind("acquire.simulated") else { return String::new() };
    let terms = values(&known.description.params, table);
    let terms = MAIN_TERMS.iter().filter_map(|(key, name, unit)| {
        // A term of 0 is disabled.
        let value = terms.get(*key)?.value.as_f64().filter(|value| *value != 0.0)?;
        Some(match *unit {
            "mm" => format!("{name} {value} mm"),
            "%" => format!("{name} {} %", number(100.0 * value)),
            unit => format!("{name} {value}{unit}"),
        })
    });
    let terms: Vec<_> = terms.collect();
    format!(
        "Simulated errors{unless} were: {} (lengths and angles as standard deviations, the bias as RMS); the table below has \
         all terms. ",
        terms.join(", ")
    )
}

/// Names and tables of the nodes of a resolved graph, in order.
pub(crate) fn nodes_of(resolved: &str) -> Vec<(String, toml::Table)> {
    let graph: toml::Table = resolved.parse().unwrap_or_default();
    let nodes = graph.get("node").and_then(toml::Value::as_table).cloned().unwrap_or_default();
    nodes.into_iter().filter_map(|(name, table)| Some((name, table.as_table()?.clone()))).collect()
}

fn kind_of(table: &toml::Table) -> &str {
    table.get("kind").and_then(toml::Value::as_str).unwrap_or("?")
}

/// The kinds of these nodes, each once.
pub(crate) fn kinds_of(nodes: &[(String, toml::Table)]) -> Vec<&str> {
    let kinds: BTreeSet<_> = nodes.iter().map(|(_, table)| kind_of(table)).collect();
    kinds.into_iter().collect()
}

/// A table of the nodes with kind, summary and the parameters that differ from their defaults.
fn steps(page: &mut Page, nodes: &[(String, toml::Table)], registry: &Registry) {
    let mut rows = Vec::new();
    for (name, table) in nodes {
        let kind = kind_of(table);
        let known = registry.kind(kind);
        let summary = known.map_or_else(|| "of a plugin".into(), |kind| kind.description.summary.clone());
        let defaults = known.map(|kind| values(&kind.description.params, &toml::Table::new())).unwrap_or_default();
        let set = known.map(|kind| values(&kind.description.params, table)).unwrap_or_default();
        let differs = set.iter().filter(|(key, term)| defaults.get(*key).is_none_or(|d| d.value != term.value));
        let differs: Vec<_> = differs.map(|(key, term)| format!("{key} = {}", term.value)).collect();
        rows.push(vec![
            Cell::Code(name.clone()),
            Cell::Code(kind.into()),
            Cell::word(summary),
            Cell::word(differs.join(", ")),
        ]);
    }
    let title = "Every step with its method and its parameters that are not default";
    page.folded_table(title, "The steps in their order.", &["node", "kind", "purpose", "parameters"], &rows);
}

/// A table of the error terms of simulated sources, with their values and the reasons for them.
fn error_terms(page: &mut Page, nodes: &[(String, toml::Table)], registry: &Registry) {
    let mut rows = Vec::new();
    for (name, table) in nodes {
        let kind = kind_of(table);
        let Some(known) = registry.kind(kind).filter(|_| kind.contains("simulated")) else { continue };
        for (key, term) in values(&known.description.params, table) {
            let off = term.value.as_f64() == Some(0.0) || term.value == Json::Bool(false);
            let value = if off { Cell::word(format!("{} (off)", term.value)) } else { Cell::of(&term.value) };
            rows.push(vec![Cell::Code(format!("{name}.{key}")), value, Cell::word(term.about)]);
        }
    }
    if rows.is_empty() {
        return;
    }
    let title = format!("Terms of the simulation: {} values with their sources", rows.len());
    let head = ["term", "value", "meaning, and where the value comes from"];
    page.folded_table(&title, "Terms of the simulation. \u{201c}Assumed\u{201d} means not measured.", &head, &rows);
}

#[derive(Debug, Clone)]
struct Term {
    value: Json,
    about: String,
}

/// The parameters of a kind by dotted key, with their values in this table or their defaults.
fn values(schema: &Json, table: &toml::Table) -> BTreeMap<String, Term> {
    let set = serde_json::to_value(table).unwrap_or_default();
    let mut out = BTreeMap::new();
    gather(schema, schema, &set, "", &mut out);
    out
}

fn gather(root: &Json, schema: &Json, set: &Json, prefix: &str, out: &mut BTreeMap<String, Term>) {
    for (key, property) in schema["properties"].as_object().into_iter().flatten() {
        let path = format!("{prefix}{key}");
        let followed = property["$ref"].as_str().and_then(|to| root.pointer(to.strip_prefix('#')?)).unwrap_or(property);
        if followed["properties"].is_object() {
            gather(root, followed, &set[key], &format!("{path}."), out);
            continue;
        }
        let value = match &set[key] {
            Json::Null => property["default"].clone(),
            given => given.clone(),
        };
        let about = property["description"].as_str().unwrap_or_default().replace('\n', " ");
        out.insert(path, Term { value, about });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terms_have_the_value_that_ran_or_their_default() {
        let registry = osteoflow_standard::registry();
        let params = &registry.kind("acquire.simulated").unwrap().description.params;
        let table: toml::Table = "camera.depth_noise_mm = 0.0".parse().unwrap();
        let terms = values(params, &table);
        assert_eq!(terms["camera.depth_noise_mm"].value, 0.0);
        assert_eq!(terms["laser.hole_radius_mm"].value, 2.0);
        assert!(terms["laser.hole_radius_mm"].about.contains("the paper's hole"));
    }

    #[test]
    fn the_paragraph_names_the_main_errors_with_their_values_and_the_methods_that_ran() {
        let registry = osteoflow_standard::registry();
        let graph = "[node.recording]\nkind = \"acquire.simulated\"\ncamera.depth_noise_mm = 0.2";
        let words = main_terms(&nodes_of(graph), &registry, "");
        for sentence in
            ["depth noise 0.2 mm", "depth bias 0.05 mm", "dropout 2 %", "tracker noise about each axis 0.0115\u{b0}"]
        {
            assert!(words.contains(sentence), "{sentence}: {words}");
        }
        assert_eq!(main_terms(&nodes_of("[node.a]\nkind = \"acquire.files\""), &registry, ""), "");
        let nodes = |kinds: &[(&str, &str)]| {
            let text: String = kinds.iter().map(|(name, kind)| format!("[node.{name}]\nkind = \"{kind}\"\n")).collect();
            nodes_of(&text)
        };
        let [graph, others] = [
            &[("a", "coarse.three_point"), ("b", "crop.box"), ("fine", "icp.point_to_plane")][..],
            &[("fine", "my.fit"), ("icp", "my.other"), ("b", "my.crop")],
        ]
        .map(nodes);
        assert_eq!(used(&graph), "Coarse fit: coarse.three_point. Fine registration: icp.point_to_plane. ");
        assert_eq!(used(&others), "Fine registration: my.other. ", "a node is known by its name or a kind that it has");
        let both = "Coarse fit: coarse.three_point. Fine registration: icp.point_to_plane, my.fit, my.other. ";
        assert_eq!(used(&[graph, others].concat()), both);
    }
}
