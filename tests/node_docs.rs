//! docs/nodes is generated from the nodes' descriptions; `UPDATE=1` rewrites it.

use crate::common::{osteoflow, root};
use std::{collections::BTreeMap, fs, path::Path};

fn pages(folder: &Path) -> BTreeMap<String, String> {
    let Ok(entries) = fs::read_dir(folder) else { return BTreeMap::new() };
    let paths = entries.map(|e| e.unwrap().path());
    paths.map(|p| (p.file_name().unwrap().to_string_lossy().into_owned(), fs::read_to_string(p).unwrap())).collect()
}

#[test]
fn docs_nodes_matches_the_descriptions_of_the_nodes() {
    let kept = root().join("docs/nodes");
    if std::env::var_os("UPDATE").is_some() {
        osteoflow().args(["inspect", "--write-docs"]).arg(&kept).assert().success();
        return;
    }
    let fresh = tempfile::tempdir().unwrap();
    osteoflow().args(["inspect", "--write-docs"]).arg(fresh.path()).assert().success();
    let (kept, fresh) = (pages(&kept), pages(fresh.path()));
    assert_eq!(
        Vec::from_iter(kept.keys()),
        Vec::from_iter(fresh.keys()),
        "`osteoflow inspect --write-docs docs/nodes`"
    );
    for (name, text) in &fresh {
        assert!(kept[name] == *text, "docs/nodes/{name} is stale: `osteoflow inspect --write-docs docs/nodes`");
    }
}

#[test]
fn every_port_and_parameter_of_a_built_in_node_is_documented() {
    let registry = osteoflow_standard::registry();
    let mut silent = Vec::new();
    for kind in registry.kinds() {
        let d = &kind.description;
        silent.extend(d.inputs.iter().filter(|p| p.doc.is_empty()).map(|p| format!("{}: input {}", d.kind, p.name)));
        if let osteoflow_node::OutputPorts::Fixed(ports) = &d.outputs {
            silent.extend(ports.iter().filter(|p| p.doc.is_empty()).map(|p| format!("{}: output {}", d.kind, p.name)));
        }
        for (name, property) in d.params["properties"].as_object().into_iter().flatten() {
            if property["description"].as_str().is_none_or(str::is_empty) && property.get("$ref").is_none() {
                silent.push(format!("{}: parameter {name}", d.kind));
            }
        }
        if d.example.trim().is_empty() {
            silent.push(format!("{}: no example", d.kind));
        }
    }
    assert!(silent.is_empty(), "{silent:#?}");
}

#[test]
fn every_example_names_its_kind_and_its_ports_and_builds_the_node() {
    let registry = osteoflow_standard::registry();
    for kind in registry.kinds() {
        let d = &kind.description;
        let table: toml::Table = d.example.parse().unwrap_or_else(|e| panic!("{}: {e}\n{}", d.kind, d.example));
        assert_eq!(table["kind"].as_str(), Some(d.kind));
        let ports = |key: &str| table.get(key).and_then(|t| t.as_table()).map(|t| Vec::from_iter(t.keys().cloned()));
        for port in ports("in").unwrap_or_default() {
            assert!(d.inputs.iter().any(|p| p.name == port), "{}: the example wires \"{port}\"", d.kind);
        }
        let needed = d.inputs.iter().filter(|p| !p.optional && !p.unused).map(|p| p.name.to_owned());
        for port in needed {
            assert!(ports("in").unwrap_or_default().contains(&port), "{}: the example lacks \"{port}\"", d.kind);
        }
        let params = table.into_iter().filter(|(key, _)| !["kind", "in", "out", "on_error"].contains(&key.as_str()));
        let params: toml::Table = params.collect();
        let known = d.params["properties"].as_object();
        for name in params.keys() {
            assert!(known.is_some_and(|k| k.contains_key(name)), "{}: the example sets \"{name}\"", d.kind);
        }
        let params = serde_json::to_value(params).unwrap();
        if let Err(error) = kind.build(&params, &osteoflow_node::BuildContext::detached("example")) {
            panic!("{}: the example does not build: {error}", d.kind);
        }
    }
}
