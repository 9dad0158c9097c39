//! The table of error terms in docs/method/simulation.md is the parameters' own words. `UPDATE=1 cargo test` writes it anew.

#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use osteoflow_simulation::{CtParams, ProcedureParams};
use serde_json::Value;
use std::fmt::Write;

const BEGIN: &str = "<!-- error terms: written by the test `docs` of osteoflow-simulation -->\n";
const END: &str = "<!-- end of the error terms -->\n";

/// One row for each number, in the order of the tables of a graph file.
fn rows(schema: &Value, of: &Value, prefix: &str, out: &mut String) {
    for (name, property) in of["properties"].as_object().unwrap() {
        let reference = property["$ref"].as_str().or_else(|| property["allOf"][0]["$ref"].as_str());
        let inner = reference.map(|reference| &schema["$defs"][reference.rsplit('/').next().unwrap()]);
        // An enum is a value like a number; a table has its own rows.
        if let Some(inner) = inner.filter(|inner| inner["properties"].is_object()) {
            rows(schema, inner, &format!("{prefix}{name}."), out);
            continue;
        }
        let default = property.get("default").unwrap_or_else(|| panic!("{prefix}{name} has no default in its schema"));
        let default = if default.is_null() { "none".to_owned() } else { default.to_string() };
        let words = property["description"].as_str().unwrap().replace('\n', " ");
        writeln!(out, "| `{prefix}{name}` | {default} | {words} |").unwrap();
    }
}

#[test]
fn the_documented_error_terms_are_the_parameters_own_words() {
    let schema = schemars::schema_for!(ProcedureParams).to_value();
    let mut table =
        "| parameter | default | meaning, and where the value comes from |\n| --- | --- | --- |\n".to_owned();
    rows(&schema, &schema, "", &mut table);
    let ct = schemars::schema_for!(CtParams).to_value();
    rows(&ct, &ct, "ct.", &mut table);
    for table_name in [
        "bone",
        "ct",
        "camera",
        "tracker",
        "laser",
        "image",
        "phantom",
        "check",
        "stylus",
        "ruler",
        "periosteum",
        "tissue",
        "motion",
    ] {
        assert!(table.contains(&format!("| `{table_name}.")), "{table_name} has no row");
    }
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../docs/method/simulation.md");
    let page = std::fs::read_to_string(path).unwrap();
    let (before, rest) = page.split_once(BEGIN).expect("the page marks where the table begins");
    let (found, after) = rest.split_once(END).expect("the page marks where the table ends");
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(path, format!("{before}{BEGIN}{table}{END}{after}")).unwrap();
    } else {
        assert_eq!(found, table, "docs/method/simulation.md is stale; UPDATE=1 cargo test writes it anew");
    }
}
