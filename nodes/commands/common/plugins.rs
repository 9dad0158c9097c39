//! Plugins of a command: search, inspection and listing.

use super::{
    exit::{Exit, UsageError},
    global::{Format, Global, registry},
    terminal::{self, print_json},
    text_table::TextTable,
};
use anyhow::{Context, Result};
use clap::Args;
use osteoflow_engine::{
    Faults,
    fault::Severity,
    plugin::{Finder, Kinds, Known, Launcher, Prober, Scripts},
    store::{Settings, Store},
};
use serde_json::{Value, json};
use std::{
    env,
    ffi::OsString,
    io::Write,
    path::PathBuf,
    sync::{Arc, OnceLock},
    time::Duration,
};

/// Environment variable with folders whose libraries are all inspected.
const FOLDERS: &str = "OSTEOFLOW_PLUGIN_PATH";
/// Environment variable with the interpreter for plugins in Python.
const PYTHON: &str = "OSTEOFLOW_PYTHON";
/// Environment variable with the maximum time to load a library.
const TIMEOUT: &str = "OSTEOFLOW_PLUGIN_TIMEOUT_S";

/// The program that runs this library, and the arguments with which it runs a command, if it is not the command itself.
pub(crate) static HOST: OnceLock<(PathBuf, Vec<OsString>)> = OnceLock::new();

/// Plugins in addition to those of the graph.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct PluginArgs {
    /// A library with kinds of nodes, in addition to those that the graph names, or instead of one with the same file name;
    /// may be given again. OSTEOFLOW_PLUGIN_PATH names folders whose libraries are all loaded.
    #[arg(long = "plugin", value_name = "FILE")]
    plugins: Vec<PathBuf>,

    /// Load no plugins, whatever the graph, the environment or a recording names; kinds of plugins are then unknown.
    #[arg(long, conflicts_with_all = ["plugins", "python"])]
    no_plugins: bool,

    /// The interpreter for plugins in Python. Otherwise OSTEOFLOW_PYTHON, that of the active environment (VIRTUAL_ENV), or python3.
    #[arg(long, value_name = "FILE")]
    python: Option<PathBuf>,
}

/// What serves nodes in Python, passed to the interpreter.
const PYTHON_HELPER: &str = include_str!("../../kinds/payloads/python/osteoflow_node.py");

impl PluginArgs {
    /// The libraries that the command line names.
    pub(crate) fn files(&self) -> &[PathBuf] {
        &self.plugins
    }

    /// The kinds of this program and of all plugins that are found.
    pub(crate) fn kinds(&self) -> Result<Kinds> {
        self.kinds_of(false)
    }

    /// As [`Self::kinds`], for commands that run many times: kinds of plugins fire in processes of their own unless the graph
    /// says otherwise, so that one that crashes costs a run and not the command.
    pub(crate) fn kinds_apart(&self) -> Result<Kinds> {
        self.kinds_of(true)
    }

    /// The interpreter of plugins in Python: the one asked for, that of the active environment, or the one that is found first.
    fn interpreter(&self) -> PathBuf {
        let of_environment = || env::var_os("VIRTUAL_ENV").map(|dir| PathBuf::from(dir).join("bin/python"));
        let named = self.python.clone().or_else(|| env::var_os(PYTHON).filter(|name| !name.is_empty()).map(Into::into));
        named.or_else(|| of_environment().filter(|python| python.is_file())).unwrap_or("python3".into())
    }

    fn kinds_of(&self, plugins_apart: bool) -> Result<Kinds> {
        if self.no_plugins {
            return Ok(Kinds::from(&registry()));
        }
        let folders = env::var_os(FOLDERS).map(|folders| env::split_paths(&folders).collect()).unwrap_or_default();
        // A wrong setting of the store is reported by commands that use it.
        let store = Settings::from_env().ok().flatten().map(|settings| Arc::new(Store::open(settings)));
        let prober = prober()?;
        let launcher = Some(own("worker")?);
        let asked = self.plugins.clone();
        let interpreter = Launcher { program: self.interpreter(), arguments: vec!["-c".into(), PYTHON_HELPER.into()] };
        let scripts = Some(Scripts { ending: "py", interpreter });
        Ok(Kinds::new(
            registry(),
            Finder { prober, store, asked, folders, launcher, scripts, only: None, plugins_apart },
        ))
    }
}

/// This program with a subcommand, to be started as another process.
fn own(subcommand: &str) -> Result<Launcher> {
    let (program, mut arguments) = match HOST.get() {
        Some((program, before)) => (program.clone(), before.clone()),
        None => {
            let own = env::current_exe().context("the path of this program is unknown")?;
            // This is the running program even if its file was replaced since. Not under valgrind, where it is valgrind
            // itself.
            (if own.is_file() { own } else { "/proc/self/exe".into() }, Vec::new())
        }
    };
    arguments.push(subcommand.into());
    Ok(Launcher { program, arguments })
}

/// What inspects a library.
fn prober() -> Result<Prober> {
    let value = env::var(TIMEOUT).ok().filter(|value| !value.is_empty());
    let timeout = match value.as_deref().map(str::parse::<f64>) {
        None => Prober::TIMEOUT,
        Some(Ok(seconds)) if seconds > 0.0 && seconds <= 86_400.0 => Duration::from_secs_f64(seconds),
        Some(_) => {
            let value = value.unwrap_or_default();
            let message = format!("{TIMEOUT} is \"{value}\", but must be a number of seconds, such as 10");
            return Err(UsageError(message).into());
        }
    };
    let Launcher { program, arguments } = own("plugin-probe")?;
    Ok(Prober { program, arguments, timeout })
}

/// Prints refused plugins on stderr; a plugin that was named explicitly is a fault.
pub(crate) fn print_refused(known: &Known, global: &Global) -> Result<Exit> {
    let faults = known.faults();
    let exit = match faults.iter().any(|fault| fault.severity == Severity::Error) {
        true => Exit::Usage,
        false => Exit::Done,
    };
    let shown: Vec<_> = faults.into_iter().filter(|f| !global.quiet || f.severity == Severity::Error).collect();
    if !shown.is_empty() {
        writeln!(terminal::stderr(), "{}\n", Faults(shown).render(global.colour_err()))?;
    }
    Ok(exit)
}

/// Prints a table of the plugins.
pub(crate) fn table(known: &Known, global: &Global) -> Result<Exit> {
    if global.format == Format::Json {
        let found = known.plugins.iter().map(|plugin| {
            let description = &plugin.description;
            json!({
                "name": description.name, "version": description.version, "abi": description.abi, "sdk": description.sdk,
                "compiler": description.compiler, "file": plugin.path.to_string_lossy(), "sha256": &*plugin.sha256,
                "kinds": description.kinds.iter().map(|kind| &kind.kind).collect::<Vec<_>>(),
                "payloads": description.payloads.iter().map(|p| format!("{}@{}", p.name, p.version)).collect::<Vec<_>>(),
            })
        });
        let refused = known.refused.iter().map(|r| json!({ "file": r.path.to_string_lossy(), "why": r.why }));
        print_json(&json!({ "plugins": found.collect::<Value>(), "refused": refused.collect::<Value>() }))?;
        return print_refused(known, &Global { quiet: true, ..global.clone() });
    }
    let mut out = terminal::stdout().lock();
    if known.plugins.is_empty() {
        writeln!(out, "no plugins; name one by --plugin FILE, or folders of them by {FOLDERS}")?;
    } else {
        let mut table = TextTable::new("plugin", &["version", "abi", "sdk", "compiler"]);
        for plugin in &known.plugins {
            let description = &plugin.description;
            let abi = format!("{}.{}", description.abi.0, description.abi.1);
            let kinds: Vec<_> = description.kinds.iter().map(|kind| kind.kind.as_str()).collect();
            let file = plugin.path.display().to_string();
            let about_it = format!("{} in {file}", kinds.join(", "));
            let cells =
                [description.version.clone(), abi, description.sdk.clone(), description.compiler.clone(), about_it];
            table.row(&description.name, cells);
        }
        writeln!(out, "{}", table.lines())?;
    }
    drop(out);
    print_refused(known, global)
}
