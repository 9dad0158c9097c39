//! Where the kinds of plugins come from: which libraries, which interpreter, and which program looks at them.

use super::{host, program::registry};
use anyhow::Result;
use clap::Args;
use osteoflow_engine::{
    plugin::{Finder, Kinds, Launcher, Prober, Scripts},
    store::{Settings, Store},
};
use std::{collections::BTreeSet, env, path::PathBuf, sync::Arc, time::Duration};

/// Environment variable with folders whose libraries are all inspected.
pub(crate) const FOLDERS: &str = "OSTEOFLOW_PLUGIN_PATH";
/// Environment variable with the interpreter for plugins in Python.
const PYTHON: &str = "OSTEOFLOW_PYTHON";
/// Environment variable with the maximum time to load a library.
const TIMEOUT: &str = "OSTEOFLOW_PLUGIN_TIMEOUT_S";

/// What serves nodes in Python, passed to the interpreter.
pub const PYTHON_HELPER: &str = include_str!("../kinds/payloads/python/osteoflow_node.py");

/// Plugins in addition to those of a graph.
#[derive(Debug, Clone, Default, Args)]
pub struct Plugins {
    /// A plugin: a library or Python file with nodes of your own, such as an ICP. It replaces a graph's plugin with the same file name. May
    /// be given again. The environment variable OSTEOFLOW_PLUGIN_PATH names folders of plugins.
    #[arg(id = "plugins", long = "plugin", value_name = "FILE")]
    pub files: Vec<PathBuf>,

    /// Load no plugins, not even those of a graph or a recording.
    #[arg(id = "no_plugins", long = "no-plugins", conflicts_with_all = ["plugins", "python"])]
    pub none: bool,

    /// The Python that runs plugins. Default: OSTEOFLOW_PYTHON, else that of the active environment, else the one whose pip installed
    /// this command, else python3.
    #[arg(long, value_name = "FILE")]
    pub python: Option<PathBuf>,

    /// The SHA-256 of the files that the graph may name; `None` for all.
    #[arg(skip)]
    pub only: Option<BTreeSet<String>>,
}

impl Plugins {
    /// The kinds of this program and of all plugins that are found.
    pub(crate) fn kinds(&self) -> Result<Kinds> {
        self.kinds_of(false)
    }

    /// As [`Self::kinds`], for commands that run many times: kinds of plugins fire in processes of their own unless the graph
    /// says otherwise, so that one that crashes costs a run and not the command.
    pub(crate) fn kinds_apart(&self) -> Result<Kinds> {
        self.kinds_of(true)
    }

    /// The interpreter of plugins in Python: the one asked for, that of the active environment, the one that runs this program, or
    /// the one that is found first.
    fn interpreter(&self) -> PathBuf {
        let [in_environment, on_path] =
            if cfg!(windows) { ["Scripts/python.exe", "python"] } else { ["bin/python", "python3"] };
        let of_environment = || env::var_os("VIRTUAL_ENV").map(|dir| PathBuf::from(dir).join(in_environment));
        let named = self.python.clone().or_else(|| env::var_os(PYTHON).filter(|name| !name.is_empty()).map(Into::into));
        let named = named.or_else(|| of_environment().filter(|python| python.is_file()));
        named.or_else(|| host::interpreter().map(Into::into)).unwrap_or(on_path.into())
    }

    fn kinds_of(&self, plugins_apart: bool) -> Result<Kinds> {
        if self.none {
            return Ok(Kinds::from(&registry()));
        }
        let folders = env::var_os(FOLDERS).map(|folders| env::split_paths(&folders).collect()).unwrap_or_default();
        // A wrong setting of the store is reported by commands that use it.
        let store = Settings::from_env().ok().flatten().map(|settings| Arc::new(Store::open(settings)));
        let prober = prober()?;
        let launcher = Some(host::launcher("worker")?);
        let asked = self.files.clone();
        let interpreter = Launcher::new(self.interpreter(), vec!["-c".into(), PYTHON_HELPER.into()]);
        let scripts = Some(Scripts { ending: "py", interpreter });
        let only = self.only.clone();
        let finder = Finder {
            prober,
            store,
            asked,
            folders,
            launcher,
            scripts,
            only,
            recorded: Vec::new(),
            carried: Default::default(),
            plugins_apart,
            held: None,
        };
        Ok(Kinds::new(registry(), finder))
    }
}

/// What inspects a library.
fn prober() -> Result<Prober> {
    let value = env::var(TIMEOUT).ok().filter(|value| !value.is_empty());
    let timeout = match value.as_deref().map(str::parse::<f64>) {
        None => Prober::TIMEOUT,
        Some(Ok(seconds)) if seconds > 0.0 && seconds <= 86_400.0 => Duration::from_secs_f64(seconds),
        Some(_) => {
            let value = value.unwrap_or_default();
            usage!("{TIMEOUT} is \"{value}\", but must be a number of seconds, such as 10");
        }
    };
    Ok(Prober { launcher: host::launcher("plugin-probe")?, timeout })
}
