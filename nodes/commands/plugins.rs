//! Which plugins a command knows, and how they are looked at.

use super::{Exit, Format, Global, UsageError, print_json, registry, text_table::TextTable};
use anyhow::{Context, Result};
use clap::Args;
use osteoflow_engine::{
    Faults,
    fault::Severity,
    plugin::{Finder, Kinds, Known, Prober, answer},
    store::{Settings, Store},
};
use serde_json::{Value, json};
use std::{env, io::Write, path::PathBuf, sync::Arc, time::Duration};

/// Folders whose libraries are all looked at.
const FOLDERS: &str = "OSTEOFLOW_PLUGIN_PATH";
/// How long one may take to be loaded.
const TIMEOUT: &str = "OSTEOFLOW_PLUGIN_TIMEOUT_S";

/// Plugins beside those of the graph.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct PluginArgs {
    /// A library with kinds of nodes, beside those that the graph names, or in the place of one of the same file name;
    /// may be given again. OSTEOFLOW_PLUGIN_PATH names folders whose libraries are all looked at.
    #[arg(long = "plugin", value_name = "FILE")]
    plugins: Vec<PathBuf>,
}

impl PluginArgs {
    /// The kinds of this program, and of the plugins that are found.
    pub(crate) fn kinds(&self) -> Result<Kinds> {
        let folders = env::var_os(FOLDERS).map(|folders| env::split_paths(&folders).collect()).unwrap_or_default();
        // A setting of the store that is wrong is told by those who keep answers there.
        let store = Settings::from_env().ok().flatten().map(|settings| Arc::new(Store::open(settings)));
        let finder = Finder { prober: prober()?, store, asked: self.plugins.clone(), folders };
        Ok(Kinds::new(registry(), finder))
    }
}

/// This program itself, called to look at a library.
fn prober() -> Result<Prober> {
    let own = env::current_exe().context("the program's own file is not known")?;
    // Where another file has been put in its place since, this is still the one that runs. Not otherwise: in a program
    // that runs under valgrind it is valgrind.
    let program = if own.is_file() { own } else { "/proc/self/exe".into() };
    let said = env::var(TIMEOUT).ok().filter(|said| !said.is_empty());
    let timeout = match said.as_deref().map(str::parse::<f64>) {
        None => Prober::TIMEOUT,
        Some(Ok(seconds)) if seconds > 0.0 && seconds <= 86_400.0 => Duration::from_secs_f64(seconds),
        Some(_) => {
            let said = said.unwrap_or_default();
            let said = format!("{TIMEOUT} is \"{said}\", but a number of seconds was expected, such as 10");
            return Err(UsageError(said).into());
        }
    };
    Ok(Prober { program, arguments: vec!["plugin-probe".into()], timeout })
}

/// Look at a library, and print what it says of itself: what a process of its own is started for.
#[derive(Debug, Args)]
#[command(hide = true)]
pub(crate) struct PluginProbe {
    file: PathBuf,
}

impl PluginProbe {
    pub(crate) fn execute(&self) -> Result<Exit> {
        std::io::stdout().write_all(answer(&self.file).as_bytes())?;
        Ok(Exit::Done)
    }
}

/// Tells what was refused where no graph is checked: to people on stderr. What was asked for by name is a fault.
pub(crate) fn tell_refused(known: &Known, global: &Global) -> Result<Exit> {
    let faults = known.faults();
    let exit = match faults.iter().any(|fault| fault.severity == Severity::Error) {
        true => Exit::Usage,
        false => Exit::Done,
    };
    let shown: Vec<_> = faults.into_iter().filter(|f| !global.quiet || f.severity == Severity::Error).collect();
    if !shown.is_empty() {
        writeln!(std::io::stderr(), "{}\n", Faults(shown).render(global.colour_err()))?;
    }
    Ok(exit)
}

/// A table of what was found.
pub(crate) fn table(known: &Known, global: &Global) -> Result<Exit> {
    if global.format == Format::Json {
        let found = known.plugins.iter().map(|plugin| {
            let about = &plugin.about;
            json!({
                "name": about.name, "version": about.version, "abi": about.abi, "sdk": about.sdk,
                "compiler": about.compiler, "file": plugin.path.to_string_lossy(), "sha256": &*plugin.sha256,
                "kinds": about.kinds.iter().map(|kind| &kind.kind).collect::<Vec<_>>(),
                "payloads": about.payloads.iter().map(|p| format!("{}@{}", p.name, p.version)).collect::<Vec<_>>(),
            })
        });
        let refused = known.refused.iter().map(|r| json!({ "file": r.path.to_string_lossy(), "why": r.why }));
        print_json(&json!({ "plugins": found.collect::<Value>(), "refused": refused.collect::<Value>() }))?;
        return tell_refused(known, &Global { quiet: true, ..global.clone() });
    }
    let mut out = std::io::stdout().lock();
    if known.plugins.is_empty() {
        writeln!(out, "no plugins; --plugin FILE names one, {FOLDERS} folders of them")?;
    } else {
        let mut table = TextTable::new("plugin", &["version", "abi", "sdk", "compiler"]);
        for plugin in &known.plugins {
            let about = &plugin.about;
            let abi = format!("{}.{}", about.abi.0, about.abi.1);
            let kinds: Vec<_> = about.kinds.iter().map(|kind| kind.kind.as_str()).collect();
            let file = plugin.path.display().to_string();
            let about_it = format!("{} in {file}", kinds.join(", "));
            let cells = [about.version.clone(), abi, about.sdk.clone(), about.compiler.clone(), about_it];
            table.row(&about.name, cells);
        }
        writeln!(out, "{}", table.lines())?;
    }
    drop(out);
    tell_refused(known, global)
}
