//! The scripts of the page: those of the live page that draw, and three.js, so that both show the same pictures.
//!
//! A page opens from disk without a network, where a module cannot import a file beside it. So the texts are in the page,
//! compressed, and its only inline script gives each an address of its own (`blob:`), after those that it imports.

use base64::{Engine, engine::general_purpose::STANDARD};
use flate2::{Compression, write::GzEncoder};
use osteoflow_viewer::{THREE_LICENSE, script};
use serde_json::{Value as Json, json};
use std::io::Write;

/// The modules of the live page that are used here; each imports only those before it.
const SHARED: [&str; 13] = [
    "three/three.core.min.js",
    "three/three.module.min.js",
    "drawables.js",
    "residual_colours.js",
    "eye.js",
    "frames.js",
    "message.js",
    "shapes.js",
    "trackball.js",
    "scene.js",
    "devices.js",
    "layers.js",
    "verdict.js",
];

/// The modules of this crate.
const OWN: [(&str, &str); 2] =
    [("shown.js", include_str!("../page/shown.js")), ("views.js", include_str!("../page/views.js"))];

/// The script that loads the modules.
pub(crate) const LOADER: &str = include_str!("../page/loader.js");

/// All modules with their names, in an order in which each imports only those before it.
fn modules() -> impl Iterator<Item = (&'static str, &'static str)> {
    SHARED.into_iter().filter_map(|name| Some((name, script(name)?))).chain(OWN)
}

/// The modules for the loader, and the licence of three.js.
pub(crate) fn packed() -> String {
    let texts: Vec<Json> = modules().map(|(name, text)| json!([name, text])).collect();
    pack(&json!({ "modules": texts, "three_license": THREE_LICENSE }))
}

/// JSON, compressed, as a text that cannot end a script element.
pub(crate) fn pack(json: &Json) -> String {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    // Writing to memory does not fail.
    let written = encoder.write_all(json.to_string().as_bytes()).and_then(|()| encoder.finish());
    STANDARD.encode(written.unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_module_is_there_and_imports_only_those_before_it() {
        assert_eq!(modules().count(), SHARED.len() + OWN.len());
        let mut known = vec!["three"];
        for (name, text) in modules() {
            let folder = name.rsplit_once('/').map_or("", |(folder, _)| folder);
            for import in text.split("from").skip(1).filter_map(|rest| rest.trim_start().split(['"', '\'']).nth(1)) {
                let Some(file) = import.strip_prefix("./") else {
                    assert!(!text.contains(&format!("from \"{import}\"")) || import == "three", "{name}: {import}");
                    continue;
                };
                let path = if folder.is_empty() { file.to_owned() } else { format!("{folder}/{file}") };
                let typed = text.contains(&format!("import(\"{import}\")"));
                assert!(
                    typed || known.contains(&path.as_str()),
                    "{name} imports {path}, which comes later or not at all"
                );
            }
            known.push(name);
        }
    }
}
