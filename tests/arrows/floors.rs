//! The floors of the crates: a module imports lower floors only, and no circle of files is larger than a room may have.
//!
//! Read from the `use` lines of their sources. Code for tests is left out: it may look at the whole crate.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

type Floors = &'static [&'static [&'static str]];

/// The sources of a crate, and its floors from the ground up; the modules of one floor do not know each other. A module is on the
/// floor of the longest path that names it or a module around it; `*` is each module of a folder.
const CRATES: &[(&str, Floors)] = &[
    (
        "engine/node/src",
        &[
            &["display", "error", "file", "intern", "log_forward"],
            &["schema"],
            &["view"],
            &["payload"],
            &["abi", "dynamic", "item", "port"],
            &["build_context", "description", "host"],
            &["clock"],
            &["context"],
            &["traits"],
            &["declared", "erased"],
            &["registry"],
            &["plugin"],
        ],
    ),
    (
        "engine/container/src",
        &[
            &["allowance", "compression", "damage", "durable", "fields", "input", "op", "regular", "segments"],
            &["record"],
            &["chunk", "descriptions", "resync", "write"],
            &["read"],
        ],
    ),
    ("engine/draw/src", &[&["layout", "xml"], &["svg", "text"]]),
    (
        "engine/tests/toy/src",
        &[
            &["NoParams", "context", "number", "samples"],
            &["devices", "judge", "script", "stages", "stream"],
            &["arithmetic", "wave"],
            &["cached"],
        ],
    ),
    (
        "engine/runtime/src",
        &[
            &["activity", "histogram", "join", "names", "panics", "plan", "sync"],
            &["channel", "inject", "report", "scheduler"],
            &["sign"],
            &["messages", "outcome", "tap"],
            &["latency"],
            &["runtime"],
        ],
    ),
    (
        "engine/src",
        &[
            // The crate `osteoflow-runtime`, by the names under which the engine hands it on.
            &["activity", "durable", "irregular", "names", "panics", "plan", "regular", "runtime"],
            &["cpu_time", "fault", "hash", "temporary"],
            &["graph", "recording"],
            &["store"],
            &["process"],
            &["options", "plugin"],
            &["shown_paths"],
            &["answer_cache", "check", "record"],
            &["repro"],
            &["diff", "recover", "run", "schema", "validate"],
            &["ages", "partial"],
            &["inputs", "replay", "watch"],
            &["sweep"],
        ],
    ),
    (
        "nodes",
        &[
            // Typed requests, which state their options and know no terminal.
            &["app::error", "app::host"],
            &["app::files", "app::folder_lock", "app::program", "app::shipped"],
            &["app::out_dir", "app::plugins"],
            &["app::options"],
            &["app::run", "app::simulate", "app::sweep"],
            &["app::archive", "app::register"],
            &["app::sensor"],
            &["app"],
            // What subcommands share.
            &["commands::common::terminal"],
            &[
                "commands::common::busy",
                "commands::common::exit",
                "commands::common::global",
                "commands::common::other_numbers",
                "commands::common::run_path",
                "commands::common::text_table",
            ],
            &[
                "commands::common::crash",
                "commands::common::log",
                "commands::common::log_args",
                "commands::common::plugins",
                "commands::common::progress",
                "commands::common::run_table",
                "commands::common::serve",
                "commands::common::summary_table",
                "commands::common::verdict_lines",
            ],
            &[
                "commands::common::graph_args",
                "commands::common::rerun",
                "commands::common::result_table",
                "commands::common::running",
            ],
            &["commands::common::run_end"],
            &["commands::common"],
            // A subcommand knows no other, but for the one that replay uses.
            &["commands", "commands::*"],
            &["commands::replay"],
            &["commands::command_line"],
        ],
    ),
    (
        "nodes/bone/geometry/src",
        &[
            &["column", "distortion", "farthest", "frame", "time_column", "units"],
            &["axes", "region", "rigid"],
            &["cloud", "drawn_region", "image", "mesh", "plane", "points", "pose"],
            &["plan", "transform_tree"],
        ],
    ),
    (
        "nodes/bone/simulation/src",
        &[
            &["draws", "error", "phantom", "procedure"],
            &["ranges", "waves"],
            &["bone"],
            &["ct", "params", "plan"],
            &["distortion"],
            &["other_bone"],
            &["camera", "subject", "surroundings", "tissue", "tracker"],
            &["check_piece", "image", "stylus"],
            &["scene"],
            &["simulate"],
        ],
    ),
    (
        "nodes/bone/statistics/src",
        &[
            &["counted", "error", "quantile", "ranks"],
            &["distributions", "summary"],
            &["anova", "hodges_lehmann", "holm", "units"],
            &["interval"],
            &["bland_altman", "bootstrap", "correlation", "tost", "wilcoxon", "wilson"],
            &["repeatability"],
        ],
    ),
    (
        "nodes/kinds/payloads/src",
        &[&["table"], &["columns", "foxglove", "plain_values", "report"], &["geometry_views"], &["metrics", "target"]],
    ),
    (
        "nodes/kinds/standard/src",
        &[
            &["constant", "moved", "own_bone", "params", "parts"],
            &["calibrate", "crop", "hole", "icp", "output", "plane", "pose", "transform"],
            &["acquire", "cloud", "coarse", "metrics", "plan", "refine", "surface", "track", "verdict"],
            &["landmarks", "send"],
        ],
    ),
    (
        "nodes/pages/report/src",
        &[
            &["degrees", "error", "format", "modules", "paths"],
            &["cell", "chart", "diagram", "run_folder"],
            &["scene", "summary"],
            &["html"],
            &["citations", "methods", "provenance", "tables"],
            &["report", "sensor"],
            &["run"],
            &["sweep"],
        ],
    ),
    (
        "nodes/pages/viewer/src",
        &[
            &["door"],
            &["access", "http", "indexed", "protocol"],
            &["page", "still", "stream"],
            &["playback"],
            &["server"],
        ],
    ),
    (
        "nodes/bone/formats/src",
        &[
            // Names that `lib.rs` hands on are on the floor of their module.
            &[
                "FileError",
                "LostPose",
                "PoseError",
                "Sign",
                "Space",
                "Spellings",
                "StampOrder",
                "foreign_recording",
                "without_slash",
                "unit",
            ],
            &["error", "invalid", "json", "lost", "normals", "pixels", "ros2", "scalar", "spellings", "stamp_order"],
            &["metaimage_header", "scene_header", "space"],
            &["kind"],
            &["cursor", "foxglove_json", "input", "jpeg", "png", "shape"],
            &[
                "columns",
                "cut",
                "mcap_read",
                "obj",
                "off",
                "openigtlink",
                "pcd",
                "ply",
                "stl",
                "volume",
                "vtk",
                "write",
            ],
            &["cloud_text", "message_read", "table"],
            &["pose_file", "recording_write", "region_file"],
            &["picked_points", "pose_log"],
            &["plan_file", "scene_file"],
            &["probe"],
            &["mesh_or_cloud"],
            &["folder"],
        ],
    ),
    (
        "nodes/bone/algorithms/src",
        &[
            // A name that `lib.rs` hands on is on the floor of its module.
            &["Refusal", "median", "product", "refusal"],
            &[
                "bvh",
                "downsample",
                "iso_surface",
                "kabsch",
                "marker_stream",
                "merge",
                "point_grid",
                "point_times",
                "roi",
                "sample",
                "section",
                "sensor",
                "still_average",
                "union_find",
            ],
            &["axes", "ct_surface", "mesh_topology", "morton", "nearest", "perturb"],
            &["fragment", "mesh_query", "point_blocks", "sensor_noise"],
            &["landmarks", "normals", "parts"],
            &["hole", "target"],
            &["icp", "metrics", "tables"],
            &["calibrate", "coarse", "track"],
            &["slide"],
            &["trust"],
            &["sensor_error"],
        ],
    ),
];

/// Most files that may import each other in a circle.
const MAX_CIRCLE: usize = 6;

type Module = Vec<String>;

/// A file of a crate.
struct File {
    path: PathBuf,
    /// The full paths that it imports, from the crate's root.
    imports: Vec<Module>,
    /// What it hands on from elsewhere: the name, and the full path.
    exports: BTreeMap<String, Module>,
}

/// Every file of a crate by its module: those of the modules that its root declares, as other crates may lie beside them. A name
/// that the root hands on is taken for what it stands for.
fn files(sources: &str) -> BTreeMap<Module, File> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join(sources);
    let lib = fs::read_to_string(root.join("lib.rs")).unwrap();
    let handed_on = read(&root, root.join("lib.rs"), &Module::new(), &lib).exports;
    let declared: BTreeSet<&str> =
        lib.lines().filter_map(|line| line.rsplit_once("mod ")?.1.strip_suffix(';')).collect();
    let mut found = BTreeMap::new();
    let mut folders = vec![root.clone()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
            let stem = entry.file_stem().unwrap().to_string_lossy().into_owned();
            if entry.parent() == Some(&root) && !declared.contains(&*stem) {
                continue;
            }
            if entry.is_dir() {
                folders.push(entry);
            } else if entry.extension().is_some_and(|end| end == "rs") && !(stem == "lib" || stem.ends_with("tests")) {
                let inner = entry.strip_prefix(&root).unwrap().with_extension("");
                let module: Module = inner.iter().map(|name| name.to_string_lossy().into_owned()).collect();
                let text = fs::read_to_string(&entry).unwrap();
                let mut file = read(&root, entry, &module, &text);
                for path in file.imports.iter_mut().chain(file.exports.values_mut()) {
                    if let Some(full) = handed_on.get(&path[0]) {
                        path.splice(..1, full.iter().cloned());
                    }
                }
                // What the root itself defines is of no module.
                file.imports.retain(|path| path.len() > 1 || declared.contains(&*path[0]));
                found.insert(module.clone(), file);
            }
        }
    }
    found
}

fn read(root: &Path, path: PathBuf, module: &Module, text: &str) -> File {
    let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap();
    let code: String = code.lines().filter(|line| !line.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n");
    let mut file = File { path, imports: Vec::new(), exports: BTreeMap::new() };
    let mut rest = code.as_str();
    while let Some(at) = rest.find("use ") {
        let (before, after) = (&rest[..at], &rest[at + 4..]);
        let line = before.rsplit('\n').next().unwrap().trim();
        let end = after.find(';').unwrap_or(after.len());
        rest = &after[end..];
        if line.is_empty() || line.starts_with("pub") {
            for (path, name) in leaves(&after[..end]) {
                if let Some(path) = absolute(root, &path, module) {
                    if line.starts_with("pub") {
                        file.exports.insert(name, path.clone());
                    }
                    file.imports.push(path);
                }
            }
        }
    }
    // Paths in the code itself; the groups of a `use` are read above, and a visibility is no import.
    for (at, prefix) in code.match_indices("crate::").filter(|(at, _)| !code[..*at].ends_with("pub(in ")) {
        let after = &code[at + prefix.len()..];
        let path = after.split(|c: char| !c.is_alphanumeric() && !"_:".contains(c)).next().unwrap_or_default();
        if after[path.len()..].starts_with('{') {
            continue;
        }
        let path: Module = path.split("::").filter(|name| !name.is_empty()).map(str::to_owned).collect();
        if !path.is_empty() {
            file.imports.push(path);
        }
    }
    file
}

/// The paths of a `use` tree, each with the name that it brings.
fn leaves(tree: &str) -> Vec<(Module, String)> {
    let tree = tree.trim();
    if let Some((head, group)) = tree.split_once('{') {
        let head: Module = head.split("::").map(str::trim).filter(|s| !s.is_empty()).map(str::to_owned).collect();
        let (mut parts, mut depth, mut part) = (Vec::new(), 0, String::new());
        for c in group.trim_end().strip_suffix('}').unwrap_or(group).chars() {
            match c {
                '{' => depth += 1,
                '}' => depth -= 1,
                ',' if depth == 0 => {
                    parts.push(std::mem::take(&mut part));
                    continue;
                }
                _ => {}
            }
            part.push(c);
        }
        parts.push(part);
        let inner = parts.iter().filter(|part| !part.trim().is_empty()).flat_map(|part| leaves(part));
        return inner.map(|(path, name)| ([head.clone(), path].concat(), name)).collect();
    }
    let (path, alias) = tree.split_once(" as ").map_or((tree, None), |(path, alias)| (path, Some(alias)));
    let mut path: Module = path.split("::").map(|name| name.trim().to_owned()).collect();
    if path.len() > 1 && path.last().is_some_and(|name| name == "self") {
        path.pop();
    }
    let name = alias.map_or_else(|| path.last().unwrap().clone(), |alias| alias.trim().to_owned());
    vec![(path, name)]
}

/// The path from the crate's root; `None` for another crate's.
fn absolute(root: &Path, path: &Module, module: &Module) -> Option<Module> {
    match path[0].as_str() {
        "crate" => Some(path[1..].to_vec()),
        "self" => Some([module, &path[1..]].concat()),
        "super" => {
            let up = path.iter().take_while(|name| *name == "super").count();
            Some([&module[..module.len() - up], &path[up..]].concat())
        }
        child => {
            let is_child = root.join(module.iter().collect::<PathBuf>()).join(format!("{child}.rs")).exists();
            is_child.then(|| [module.as_slice(), path].concat())
        }
    }
}

/// The file in which the path is defined, as far as it is handed on by name.
fn definition(files: &BTreeMap<Module, File>, path: &Module) -> Option<Module> {
    let longest = (1..=path.len()).rev().find(|n| files.contains_key(&path[..*n]))?;
    let (module, rest) = path.split_at(longest);
    match rest.first().and_then(|name| files[module].exports.get(name)) {
        Some(elsewhere) if *elsewhere != *path => definition(files, &[elsewhere, &rest[1..]].concat()),
        _ => Some(module.to_vec()),
    }
}

/// The floor of a path, and the path of the module that is there.
fn room(floors: Floors, path: &Module) -> Option<(usize, Module)> {
    (1..=path.len()).rev().find_map(|n| {
        let (name, any) = (path[..n].join("::"), [&path[..n - 1], &["*".to_owned()]].concat().join("::"));
        let floor = [name, any].iter().find_map(|name| floors.iter().position(|floor| floor.contains(&&**name)))?;
        Some((floor, path[..n].to_vec()))
    })
}

#[test]
fn a_module_imports_lower_floors_only() {
    let mut wrong = BTreeSet::new();
    let mut n_files = 0;
    for (sources, floors) in CRATES {
        let files = files(sources);
        n_files += files.len();
        for (module, file) in &files {
            let (own, own_room) =
                room(floors, module).unwrap_or_else(|| panic!("{} is on no floor", file.path.display()));
            for path in &file.imports {
                match room(floors, path) {
                    Some((_, room)) if room == own_room => {}
                    Some((floor, _)) if floor < own => {}
                    _ => drop(wrong.insert(format!("{} imports crate::{}", file.path.display(), path.join("::")))),
                }
            }
        }
    }
    assert!(n_files > 100, "{n_files} files were found");
    assert!(wrong.is_empty(), "not on a lower floor:\n{}", wrong.into_iter().collect::<Vec<_>>().join("\n"));
}

#[test]
fn no_circle_of_files_is_larger_than_six() {
    CRATES.iter().for_each(|(sources, floors)| check_circles(sources, &files(sources), floors));
}

fn check_circles(sources: &str, files: &BTreeMap<Module, File>, floors: Floors) {
    let arrows: BTreeMap<&Module, BTreeSet<Module>> = files
        .iter()
        .map(|(module, file)| {
            let imports = file.imports.iter().filter_map(|path| definition(files, path));
            (module, imports.filter(|import| import != module).collect())
        })
        .collect();
    let reached = |from: &Module| {
        let (mut seen, mut open) = (BTreeSet::new(), vec![from.clone()]);
        while let Some(module) = open.pop() {
            for next in &arrows[&module] {
                if seen.insert(next.clone()) {
                    open.push(next.clone());
                }
            }
        }
        seen
    };
    let all: BTreeMap<_, _> = files.keys().map(|module| (module, reached(module))).collect();
    for module in files.keys() {
        let circle: Vec<_> = all[module].iter().filter(|other| all[other].contains(module)).collect();
        let names: Vec<_> = circle.iter().map(|module| module.join("::")).collect();
        assert!(circle.len() <= MAX_CIRCLE, "{sources}: a circle of {}: {}", circle.len(), names.join(", "));
        assert!(
            circle.iter().all(|other| room(floors, other) == room(floors, module)),
            "{sources}: a circle over rooms: {}",
            names.join(", ")
        );
    }
}
