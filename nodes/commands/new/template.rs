//! The templates of plugins, in `nodes/template`: a source for each language and kind of node, a graph for each kind of node, and
//! the files that all plugins of a language share.

use super::{FIBULA, without_schema};
use clap::ValueEnum;

/// The name of the plugin in all templates.
const NAME: &str = "my_plugin";

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Lang {
    /// A crate.
    Rust,
    /// A folder with a Makefile.
    C,
    /// One file, which is not built.
    Python,
    /// A folder with a Makefile; exceptions become errors of the node.
    Cpp,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Like {
    /// Registers a scan onto a surface: source, target, init -> t_target_source, report.
    Icp,
    /// Finds the landmark under a laser spot: reference, cloud -> point, report.
    Hole,
    /// Selects points of a cloud: cloud, region -> cloud.
    Crop,
    /// Judges a registration in numbers of results.json: planned, t_ct_world, t_ct_world_true -> report.
    Metric,
    /// Reads a file of points, a path in the graph: -> cloud.
    Source,
    /// Writes a file of points into the folder of the run: cloud -> file, its name.
    Sink,
}

/// What all sources of a language have, for each kind of node.
macro_rules! sources {
    ($like:expr, $folder:literal, $end:literal) => {
        match $like {
            Like::Icp => include_str!(concat!("../../template/", $folder, "/icp", $end)),
            Like::Hole => include_str!(concat!("../../template/", $folder, "/hole", $end)),
            Like::Crop => include_str!(concat!("../../template/", $folder, "/crop", $end)),
            Like::Metric => include_str!(concat!("../../template/", $folder, "/metric", $end)),
            Like::Source => include_str!(concat!("../../template/", $folder, "/source", $end)),
            Like::Sink => include_str!(concat!("../../template/", $folder, "/sink", $end)),
        }
    };
}

impl Lang {
    /// The kind of node that a plugin is written like unless the command line names one.
    pub(super) fn default_like(self) -> Like {
        match self {
            Self::Rust | Self::Python => Like::Icp,
            Self::C | Self::Cpp => Like::Crop,
        }
    }

    /// The command that makes the plugin ready to run.
    pub(super) fn build(self, like: Like) -> &'static str {
        match (self, like) {
            (Self::Rust, _) => "cargo build --release",
            (Self::C | Self::Cpp, _) => "make",
            (Self::Python, Like::Icp | Like::Hole) => "python3 -m pip install numpy scipy",
            (Self::Python, _) => "python3 -m pip install numpy",
        }
    }

    /// The files of the language, by path.
    fn files(self, like: Like) -> Vec<(&'static str, &'static str)> {
        const HEADER: (&str, &str) = ("osteoflow.h", include_str!("../../../engine/node/include/osteoflow.h"));
        const GEOMETRY: (&str, &str) =
            ("osteoflow_geometry.h", include_str!("../../kinds/payloads/include/osteoflow_geometry.h"));
        match self {
            Self::Rust => vec![
                ("Cargo.toml", include_str!("../../template/rust/Cargo.toml")),
                ("src/lib.rs", sources!(like, "rust", ".rs")),
                ("README.md", include_str!("../../template/rust/README.md")),
                (".gitignore", "/target\n/runs\n"),
            ],
            Self::C => vec![
                ("Makefile", include_str!("../../template/c/Makefile")),
                ("my_plugin.c", sources!(like, "c", ".c")),
                ("my_plugin_test.c", sources!(like, "c", "_test.c")),
                HEADER,
                GEOMETRY,
                ("README.md", include_str!("../../template/c/README.md")),
                (".gitignore", "/build\n/runs\n"),
            ],
            Self::Python => vec![
                ("my_plugin.py", sources!(like, "python", ".py")),
                ("README.md", include_str!("../../template/python/README.md")),
                (".gitignore", "/runs\n__pycache__\n"),
            ],
            Self::Cpp => vec![
                ("Makefile", include_str!("../../template/cpp/Makefile")),
                ("my_plugin.cpp", sources!(like, "cpp", ".cpp")),
                ("osteoflow.hpp", include_str!("../../../engine/node/include/osteoflow.hpp")),
                HEADER,
                GEOMETRY,
                ("README.md", include_str!("../../template/cpp/README.md")),
                (".gitignore", "/build\n/runs\n"),
            ],
        }
    }
}

impl Like {
    /// The variant of the kind: `my_plugin.VARIANT`.
    fn variant(self, lang: Lang) -> &'static str {
        match (self, lang) {
            (Self::Icp, Lang::Rust) => "point_to_point",
            (Self::Icp, _) => "point_to_plane",
            (Self::Hole, _) => "difference",
            (Self::Crop, _) => "sphere",
            (Self::Metric, _) => "tre",
            (Self::Source | Self::Sink, _) => "xyz",
        }
    }

    /// The node in a few words, and what the graph does with it.
    fn words(self) -> [&'static str; 2] {
        match self {
            Self::Icp => ["a plain ICP", "with this ICP instead of the built-in one"],
            Self::Hole => ["a detector of laser spots", "with this hole detector instead of the built-in one"],
            Self::Crop => ["a crop to a sphere", "with this crop instead of the built-in one"],
            Self::Metric => ["the error of a registration at points", "with this metric beside the built-in ones"],
            Self::Source => ["the points of a text file", "and its registration checked on the points of a file"],
            Self::Sink => ["a text file of points", "and its scan in a file"],
        }
    }

    /// The nodes and results that the graph adds to `graphs/fibula.toml`.
    fn graph(self) -> &'static str {
        sources!(self, "graphs", ".toml")
    }
}

/// The files of a plugin, by path.
pub(super) fn files(name: &str, lang: Lang, like: Like) -> Vec<(String, String)> {
    let library = match lang {
        Lang::Rust => "target/release/my_plugin",
        Lang::C | Lang::Cpp => "build/my_plugin",
        Lang::Python => "my_plugin.py",
    };
    let [summary, use_of_it] = like.words();
    let first = if lang == Lang::Python { String::new() } else { format!("{} && ", lang.build(like)) };
    let graph = format!(
        "# The simulated procedure of fibula.toml, {use_of_it}.\n#\n#   {first}osteoflow run graphs/my_plugin.toml\n\n\
         extends = \"fibula.toml\"\nplugins = [\"../{library}\"]\n\n[graph]\nname = \"my_plugin\"\n\n{}",
        like.graph()
    );
    let points = ("graphs/points.xyz", include_str!("../../template/graphs/points.xyz"));
    let row = "| `graphs/points.xyz` | points of the bone that the graph reads |\n";
    let has_points = like == Like::Source;
    let study = ("graphs/study.toml", include_str!("../../template/graphs/study.toml"));
    let row_of_study = "| `graphs/study.toml` | both beside each other on simulated procedures: `osteoflow sweep graphs/study.toml --out S`, `osteoflow report S` |\n";
    let has_study = like == Like::Icp;
    let written = |text: &str| {
        text.replace("BUILD", lang.build(like))
            .replace("SUMMARY", summary)
            .replace("USE", use_of_it)
            .replace("| POINTS |\n", if has_points { row } else { "" })
            .replace("| STUDY |\n", if has_study { row_of_study } else { "" })
            .replace("VARIANT", like.variant(lang))
            .replace(NAME, name)
    };
    let shared = [(FIBULA.0, without_schema(FIBULA.1)), ("graphs/my_plugin.toml", &graph)];
    let more = has_points.then_some(points).into_iter().chain(has_study.then_some(study));
    let files = lang.files(like).into_iter().chain(shared).chain(more);
    files
        .map(|(path, text)| {
            // Only these have placeholders beside the name.
            let has_placeholders = ["README.md", "graphs/my_plugin.toml", study.0].contains(&path);
            (path.replace(NAME, name), if has_placeholders { written(text) } else { text.replace(NAME, name) })
        })
        .collect()
}
