mod examples;
mod procedure;
mod slicer;
mod template;

use super::common::{Exit, Format, Global, print_json, terminal};
use crate::app::{UsageError, out_dir, registry};
use anyhow::{Context, Result};
use clap::{Args, Subcommand};
use osteoflow_engine::hash::program;
use serde_json::{Value, json};
use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
};
use template::{Lang, Like};

/// Create a project from a template: a plugin, a procedure in files, the module for 3D Slicer, or the shipped graphs with the example data.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow new plugin my_icp                 a crate with an ICP of its own, a test and a graph
  osteoflow new plugin my_crop --lang c
  osteoflow new plugin my_icp --lang python   one file that is not built; needs numpy and scipy
  osteoflow new procedure my_procedure        a procedure in files that runs, to replace by yours
  osteoflow new slicer DIR                    the module for 3D Slicer
  osteoflow new examples DIR                  the shipped graphs and example data, as README and documentation name them")]
pub(crate) struct New {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Plugin(Plugin),
    Procedure(procedure::Procedure),
    Slicer(slicer::Slicer),
    Examples(examples::Examples),
}

/// Create a plugin: one node, its test, a graph that runs it, and a README.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow new plugin my_icp                 in Rust; the SDK is that of the checkout of this program
  osteoflow new plugin my_icp --sdk ~/osteoflow     the SDK of a checkout
  osteoflow new plugin my_crop --lang c       in C or C++ (cpp); the headers are written beside it
  osteoflow new plugin my_spots --lang python --like hole     in Python, with the ports of a hole detector")]
struct Plugin {
    /// The name of the crate, of its folder and of the stage of its kind, as in `my_icp.point_to_point`.
    name: String,

    /// The programming language.
    #[arg(long, value_enum, default_value_t = Lang::Rust)]
    lang: Lang,

    /// The kind of node: its ports, and a short method of its own. Default: icp, in C and C++ crop.
    #[arg(long, value_enum, value_name = "KIND")]
    like: Option<Like>,

    /// A checkout of Osteoflow to build against. Default: the checkout that this program lies in; elsewhere the revision that
    /// it was built from, which the first build fetches over the network.
    #[arg(long, value_name = "PATH")]
    sdk: Option<PathBuf>,

    /// The folder to write into, new or empty. Default: NAME.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// A file of a template: path and content.
type File = (&'static str, &'static str);

/// The graph that the graphs of the templates extend.
const FIBULA: File = ("graphs/fibula.toml", include_str!("../../graphs/fibula.toml"));

/// The dependency on `osteoflow-node` in the manifest of the template.
const NODE_PATH: &str = "path = \"../../../engine/node\"";
const PAYLOADS_PATH: &str = "path = \"../../kinds/payloads\"";

/// The line of that manifest that names one of the sources.
const LIB_PATH: &str = "path = \"icp.rs\"\n";

/// A file that every checkout has.
const NODE_PATH_IN_CHECKOUT: &str = "engine/node/Cargo.toml";

/// Sections that a manifest needs outside of this repository.
const ALONE: &str = "
# A crate of its own, not part of a workspace in a folder above.
[workspace]

[profile.release]
# The program makes a panic an error of its node; a library that aborts is refused.
panic = \"unwind\"
";

/// Names that a crate cannot have.
const NOT_FOR_CRATES: &str = "\
    abstract alloc as async await become box break const continue core crate do dyn else enum extern \
    false final fn for gen if impl in let loop macro match mod move mut osteoflow_node \
    osteoflow_payloads override priv proc_macro pub ref return self static std struct super test trait \
    true try type typeof unsafe unsized use virtual where while yield";

/// Names whose files would replace others: `graphs/fibula.toml`, `graphs/study.toml`, and packages of Python.
const WRITTEN_OR_IMPORTED: &[&str] = &["fibula", "study", "numpy", "scipy"];

/// A graph without the line that names its schema, which editors find only beside the shipped graphs.
fn without_schema(text: &'static str) -> &'static str {
    text.split_once('\n').filter(|(line, _)| line.starts_with("#:schema")).map_or(text, |(_, rest)| rest)
}

impl New {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        match &self.what {
            What::Plugin(plugin) => plugin.execute(global),
            What::Procedure(procedure) => procedure.execute(global),
            What::Slicer(slicer) => slicer.execute(global),
            What::Examples(examples) => examples.execute(global),
        }
    }
}

impl Plugin {
    fn execute(&self, global: &Global) -> Result<Exit> {
        check_name(&self.name)?;
        let dir = self.out.clone().unwrap_or_else(|| PathBuf::from(&self.name));
        let like = self.like.unwrap_or_else(|| self.lang.default_like());
        let sdk = match self.lang {
            Lang::Rust => self.sdk()?,
            Lang::C | Lang::Cpp | Lang::Python if self.sdk.is_some() => {
                usage!(
                    "--sdk is for Rust; in C and C++ the headers of this program are written beside the plugin, and in \
                               Python its module comes from the program"
                );
            }
            Lang::C | Lang::Cpp | Lang::Python => Sdk::default(),
        };
        out_dir::make_plain(&dir, false, "name another folder with --out")?;
        for (path, mut text) in template::files(&self.name, self.lang, like) {
            if path == "Cargo.toml" {
                text = text.replace(NODE_PATH, &sdk.node).replace(PAYLOADS_PATH, &sdk.payloads).replace(LIB_PATH, "")
                    + ALONE;
            }
            write(&dir, &path, &text)?;
        }
        if let Some(lock) = &sdk.lock {
            write(&dir, "Cargo.lock", lock)?;
        }
        let commands = [
            format!("cd {}", dir.display()),
            self.lang.build(like).to_owned(),
            format!("osteoflow run graphs/{}.toml", self.name),
        ];
        print_next(&json!({ "folder": dir, "note": sdk.note, "commands": commands }), "written", &commands, global)
    }

    /// The sources to build the crate against.
    fn sdk(&self) -> Result<Sdk> {
        if let Some(checkout) = self.sdk.clone().or_else(own_checkout) {
            let crate_in = |folder: &str| -> Result<String> {
                let path = checkout.join(folder);
                if !path.join("Cargo.toml").is_file() {
                    usage!("--sdk: there is no {}; name a checkout of Osteoflow", path.display());
                }
                let path = path.canonicalize().with_context(|| format!("{} cannot be read", path.display()))?;
                Ok(format!("path = {:?}", path))
            };
            let (node, payloads) = (crate_in("engine/node")?, crate_in("nodes/kinds/payloads")?);
            return Ok(Sdk { node, payloads, lock: fs::read_to_string(checkout.join("Cargo.lock")).ok(), note: None });
        }
        let revision = env!("OSTEOFLOW_BUILD_GIT_REVISION");
        let (commit, changed) = revision.split_once(',').map_or((revision, false), |(commit, _)| (commit, true));
        if commit.is_empty() {
            usage!(
                "this program was built outside git, so it does not know the revision of its SDK; name a checkout of \
                        Osteoflow with --sdk"
            );
        }
        let git = format!("git = {:?}, rev = {commit:?}", env!("CARGO_PKG_REPOSITORY"));
        let mut note = "the first build fetches the SDK over the network; --sdk names a checkout instead".to_owned();
        if changed {
            note += &format!("; this program was built from sources that differ from their commit {commit}");
        }
        Ok(Sdk { node: git.clone(), payloads: git, lock: None, note: Some(note) })
    }
}

/// The checkout whose `target` folder this program lies in.
fn own_checkout() -> Option<PathBuf> {
    let program = program::file().ok()?;
    let has_sdk = |folder: &&Path| folder.join(NODE_PATH_IN_CHECKOUT).is_file();
    program.ancestors().find(has_sdk).map(Path::to_owned)
}

/// The location of the SDK's crates, as a manifest states it.
#[derive(Default)]
struct Sdk {
    node: String,
    payloads: String,
    /// The versions that the checkout was built with, which this machine has.
    lock: Option<String>,
    note: Option<String>,
}

/// Refuses names that a crate or a stage cannot have.
fn check_name(name: &str) -> Result<()> {
    let snake = name.starts_with(|c: char| c.is_ascii_lowercase())
        && name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
    let registry = registry();
    let is_stage = |kind: &str| kind.split_once('.').is_some_and(|(stage, _)| stage == name);
    let message = if !snake {
        format!(
            "\"{name}\" is not in snake case, such as my_icp: a lowercase letter, then lowercase letters, digits and _"
        )
    } else if NOT_FOR_CRATES.split_whitespace().any(|word| word == name) {
        format!("\"{name}\" is a keyword of Rust or an existing crate; choose another, such as my_{name}")
    } else if registry.kinds().any(|kind| is_stage(kind.description.kind)) {
        format!("\"{name}\" is a stage of built-in nodes; choose another name, such as my_{name}")
    } else if WRITTEN_OR_IMPORTED.contains(&name) {
        format!(
            "\"{name}\" is a graph beside the plugin or a package that it imports; choose another name, such as my_{name}"
        )
    } else {
        return Ok(());
    };
    Err(UsageError(message).into())
}

/// Says what was written, and the commands that use it.
fn print_next(written: &Value, heading: &str, commands: &[String], global: &Global) -> Result<Exit> {
    if global.format == Format::Json {
        print_json(written)?;
        return Ok(Exit::Done);
    }
    let mut out = terminal::stdout().lock();
    if let Some(note) = written["note"].as_str().filter(|_| !global.quiet) {
        writeln!(out, "note: {note}\n")?;
    }
    writeln!(out, "{heading}; next:")?;
    commands.iter().try_for_each(|command| writeln!(out, "  {command}"))?;
    Ok(Exit::Done)
}

fn write(dir: &Path, path: &str, text: &str) -> Result<()> {
    let path = dir.join(path);
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).with_context(|| format!("{} cannot be made a folder", folder.display()))?;
    }
    fs::write(&path, text).with_context(|| format!("{} cannot be written", path.display()))
}
