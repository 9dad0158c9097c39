//! `ro-crate-metadata.json`: RO-Crate 1.1 with the profile Workflow Run Crate 0.5.

use super::{
    GRAPH, README, RESULTS,
    index::{Entry, Index, Role},
};
use serde_json::{Value as Json, json};

pub(super) const FILE: &str = "ro-crate-metadata.json";

/// The profiles, with name and version.
const PROFILES: [(&str, &str, &str); 3] = [
    ("https://w3id.org/ro/wfrun/process/0.5", "Process Run Crate", "0.5"),
    ("https://w3id.org/ro/wfrun/workflow/0.5", "Workflow Run Crate", "0.5"),
    ("https://w3id.org/workflowhub/workflow-ro-crate/1.0", "Workflow RO-Crate", "1.0"),
];

const BIOSCHEMAS: &str = "https://bioschemas.org/profiles/ComputationalWorkflow/1.0-RELEASE";
const LANGUAGE: &str = "#osteoflow-graph";
const PROGRAM: &str = env!("CARGO_PKG_REPOSITORY");
const ACTION: &str = "#run";

/// The metadata of an archive. `about` is its `sweep.json` or `manifest.json`; `ended`: when it ended.
pub(super) fn metadata(index: &Index, about: &Json, ended: &str, licence: Option<&str>) -> Json {
    let files: Vec<_> = index.files.iter().filter(|entry| entry.included).collect();
    let ids = |entries: &[&Entry]| entries.iter().map(|entry| json!({ "@id": id(entry) })).collect::<Vec<_>>();
    let with = |role| index.of(role).collect::<Vec<_>>();
    let (inputs, results) = (with(Role::Input), with(Role::Result));
    let (name, word) = (&index.name, index.what.name());
    let command = &about["command"];
    let version = command["version"].as_str().unwrap_or(&index.version);
    let mut object: Vec<Json> = ids(&inputs);
    object.extend(ids(&with(Role::Plugin)));
    let mut action = json!({
        "@id": ACTION, "@type": "CreateAction", "name": format!("The {word} of {name}"),
        "description": format!("osteoflow {}", arguments(command)),
        "instrument": { "@id": GRAPH }, "object": one_or_all(object), "result": one_or_all(ids(&results)), "endTime": time(ended),
        "actionStatus": "http://schema.org/CompletedActionStatus",
    });
    if let Some(began) = about["began"].as_str() {
        action["startTime"] = time(began).into();
    }
    if let Some(reason) = about["outcome"]["reason"].as_str() {
        action["actionStatus"] = "http://schema.org/FailedActionStatus".into();
        action["error"] = reason.into();
    }
    let licence = licence.unwrap_or("No licence is stated; ask whoever gave you this archive.");
    let is_page = licence.starts_with("https://") || licence.starts_with("http://");
    let licence_or_its_page = if is_page { json!({ "@id": licence }) } else { licence.into() };
    let mut graph = vec![
        json!({
            "@id": FILE, "@type": "CreativeWork", "about": { "@id": "./" },
            "conformsTo": [{ "@id": "https://w3id.org/ro/crate/1.1" }, { "@id": PROFILES[2].0 }],
        }),
        json!({
            "@id": "./", "@type": "Dataset", "name": format!("{name}: a {word} of osteoflow"),
            "description": format!("Graph, plugins, inputs, results and provenance of a {word} of the graph {name}. Research use only."),
            "datePublished": time(ended),
            "license": licence_or_its_page,
            "conformsTo": PROFILES.map(|(id, ..)| json!({ "@id": id })),
            "hasPart": ids(&files), "mainEntity": { "@id": GRAPH }, "mentions": { "@id": ACTION },
        }),
        json!({
            "@id": LANGUAGE, "@type": "ComputerLanguage", "name": "osteoflow graph", "alternateName": "TOML",
            "url": { "@id": env!("CARGO_PKG_REPOSITORY") }, "version": version,
        }),
        json!({
            "@id": PROGRAM, "@type": "SoftwareApplication", "name": "osteoflow", "softwareVersion": version,
            "url": { "@id": env!("CARGO_PKG_REPOSITORY") }, "identifier": command["git_revision"],
        }),
        action,
    ];
    graph
        .extend(PROFILES.map(
            |(id, name, version)| json!({ "@id": id, "@type": "CreativeWork", "name": name, "version": version }),
        ));
    graph.push(json!({ "@id": BIOSCHEMAS, "@type": "CreativeWork", "name": "Bioschemas ComputationalWorkflow", "version": "1.0-RELEASE" }));
    if is_page {
        graph.push(json!({ "@id": licence, "@type": "CreativeWork", "name": licence }));
    }
    graph.extend(index.files.iter().map(|entry| file(entry, name, version)));
    json!({ "@context": ["https://w3id.org/ro/crate/1.1/context", "https://w3id.org/ro/terms/workflow-run/context"], "@graph": graph })
}

/// A file by its path; one that was left out by its content.
fn id(entry: &Entry) -> String {
    match entry.included {
        true => entry.path.split('/').map(escaped).collect::<Vec<_>>().join("/"),
        false => format!("#sha256-{}", entry.sha256),
    }
}

/// Percent-encodes what may not stand in a path of a URI.
fn escaped(part: &str) -> String {
    let plain = |byte: &u8| byte.is_ascii_alphanumeric() || b"-._~".contains(byte);
    part.bytes().map(|byte| if plain(&byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") }).collect()
}

fn file(entry: &Entry, name: &str, version: &str) -> Json {
    let mut file = json!({
        "@id": id(entry), "@type": "File", "name": entry.path, "contentSize": entry.bytes.to_string(), "sha256": entry.sha256,
        "encodingFormat": format_of(&entry.path),
    });
    match entry.role {
        Role::Graph => {
            file["@type"] = json!(["File", "SoftwareSourceCode", "ComputationalWorkflow"]);
            file["name"] = name.into();
            file["programmingLanguage"] = json!({ "@id": LANGUAGE });
            file["conformsTo"] = json!({ "@id": BIOSCHEMAS });
            file["version"] = version.into();
            file["url"] = json!({ "@id": env!("CARGO_PKG_REPOSITORY") });
            file["softwareRequirements"] = json!({ "@id": PROGRAM });
        }
        Role::About if entry.path == README => file["about"] = json!({ "@id": "./" }),
        Role::Plugin | Role::Module => file["@type"] = json!(["File", "SoftwareSourceCode"]),
        _ => {}
    }
    if !entry.included {
        file["@type"] = "CreativeWork".into();
        file["description"] = "An input that was left out of the archive.".into();
    }
    file
}

/// A list of one is written as its entry.
fn one_or_all(mut list: Vec<Json>) -> Json {
    if list.len() == 1 { list.remove(0) } else { list.into() }
}

/// A time in UTC with its offset.
fn time(text: &str) -> String {
    text.replace('Z', "+00:00")
}

fn arguments(command: &Json) -> String {
    let words = command["arguments"].as_array().into_iter().flatten().filter_map(Json::as_str);
    words.collect::<Vec<_>>().join(" ")
}

fn format_of(path: &str) -> &'static str {
    match path.rsplit('.').next().unwrap_or_default() {
        "json" => "application/json",
        "toml" => "application/toml",
        "csv" => "text/csv",
        "md" => "text/markdown",
        "py" => "text/x-python",
        "txt" | "lock" => "text/plain",
        "stl" => "model/stl",
        "png" => "image/png",
        _ if path.starts_with(RESULTS) => "application/x-mcap",
        _ => "application/octet-stream",
    }
}
