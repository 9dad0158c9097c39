use super::*;
use crate::{
    check::{context::Check, schema::Files},
    graph::{header, load_text},
    plugin::{KindDescription, OutputsDescription, Plugin, PluginDescription, provide},
};
use osteoflow_node::Registry;
use std::sync::Arc;

/// A plugin with a source of this kind.
fn plugin(name: &str, kind: &str, named: bool) -> Plugin {
    let kind = KindDescription {
        kind: kind.into(),
        doc: String::new(),
        params: serde_json::json!({}),
        example: String::new(),
        literature: Vec::new(),
        role: Role::Source,
        constant: false,
        unsteady: false,
        kept: Default::default(),
        inputs: Vec::new(),
        outputs: OutputsDescription::Fixed(Vec::new()),
    };
    let description = PluginDescription {
        name: name.into(),
        version: "1".into(),
        sdk: String::new(),
        compiler: String::new(),
        abi: (1, 0),
        kinds: vec![kind],
        payloads: Vec::new(),
        loads: Default::default(),
        watched: Vec::new(),
    };
    let (path, sha256) = (name.into(), Arc::<str>::from(format!("sha of {name}")));
    let (identity, copy) = (sha256.clone(), None);
    Plugin { path, sha256, identity, copy, description, named, script: None, names_interpreter: false }
}

#[test]
fn a_plan_names_the_plugins_that_the_graph_names_and_those_whose_kinds_it_uses() {
    let mut known = Known { registry: Registry::default(), plugins: Vec::new(), refused: Vec::new() };
    for (name, named) in [("named_used", true), ("named", true), ("used", false), ("unused", false)] {
        let plugin = plugin(name, &format!("{name}.kind"), named);
        provide(&mut known.registry, &plugin.description, &plugin.sha256, || Err("is not loaded".into())).unwrap();
        known.plugins.push(Arc::new(plugin));
    }
    let text = "[graph]\nformat = 1\n[node.a]\nkind = \"used.kind\"\n[node.b]\nkind = \"named_used.kind\"\n\
                [node.c]\nkind = \"used.kind\"\n";
    let graph = load_text(text.into(), Path::new("x.toml"), &[], &mut Vec::new());
    let mut check = Check::new(&known, Files::Needed, Vec::new());
    let header = header::read(&graph.table, &graph.main, &mut check.faults);
    let parsed_nodes = check.parsed_nodes(&graph, &header);
    let found: Vec<_> = plugins(&known, &parsed_nodes).into_iter().map(|p| (p.name, p.kinds)).collect();
    let expected = [("named_used", vec!["named_used.kind"]), ("named", vec![]), ("used", vec!["used.kind"])];
    let expected = expected.map(|(name, kinds)| (name.to_owned(), kinds.into_iter().map(str::to_owned).collect()));
    assert_eq!(found, expected);
}
