mod player;
mod steer;

use super::common::{
    Exit, Global,
    progress::Progress,
    run_path, running,
    serve::{self, Admission, known_plan, picks::Picks},
};
use crate::app::{GraphArgs, Plugins, UsageError};
use anyhow::{Context, Result};
use clap::Args;
use osteoflow_engine::{Recording, names::nearest};
use osteoflow_viewer::{Playback, Stream};
use player::Player;
use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    sync::Arc,
};
use steer::{SteerRequest, TwoFiles};

/// Show a graph, a run or a recording in the browser, or register a scan onto a bone and show that.
///
/// With GRAPH: runs it, and runs it again whenever its files change, or a parameter or kind is changed on the page, from where the
/// changes can be written into the file. Each run is a whole one in a folder of its own. With a run or a recording: play, stop, go to
/// any time. With BONE and SCAN: registers the scan by the shape of the bone alone, as graphs/two_files.toml does, shows how sure it
/// is, and writes the pose as a run does, with export/ for 3D Slicer.
///
/// Prints the address of a page that needs nothing but this program, and one for Foxglove and Lichtblick. Both end with Ctrl-C.
/// Only this machine reaches them, and only with the token in the address.
#[derive(Debug, Clone, Args)]
#[command(after_help = "\
Examples:
  osteoflow view graphs/fibula.toml
  osteoflow view runs/fibula-20260314-092653
  osteoflow view run.mcap --address 8765
  osteoflow view bone.stl scan.ply
  osteoflow view ct.nrrd scan.ply --set bone.threshold_hu=250 --out DIR
  osteoflow run graphs/variants/fibula_live.toml --serve        a run while it goes on")]
pub(crate) struct View {
    /// A graph (.toml), the folder of a run, or a recording; or the bone: a surface, or a CT.
    #[arg(value_name = "GRAPH|RUN|BONE")]
    what: PathBuf,

    /// The scan to register onto the bone.
    scan: Option<PathBuf>,

    /// Change a key of GRAPH, or of graphs/two_files.toml for SCAN, as of `run`; may be given again.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,

    /// The folder to write the first run of GRAPH or SCAN into; those after a change are written into DIR-2, DIR-3 and so on. Default:
    /// runs/GRAPH-TIME.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,

    /// Where to serve: HOST:PORT, or a PORT of the loopback. Default: a free port of the loopback.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:0", value_parser = serve::address)]
    address: SocketAddr,

    /// The plan of RUN, for its anatomy: a run does not record where a plan was that the command line named.
    #[arg(long, value_name = "FILE", conflicts_with = "scan")]
    plan: Option<PathBuf>,

    /// The folder for what is drawn and picked on the page: each save makes a new folder in it, picks-1, picks-2 and so on.
    #[arg(long, value_name = "DIR", default_value = "picks")]
    picks: PathBuf,

    #[command(flatten)]
    admission: Admission,

    #[command(flatten)]
    plugins: Plugins,
}

impl View {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let is_graph = self.what.extension().is_some_and(|ending| ending == "toml");
        match &self.scan {
            Some(scan) => self.register(scan, global),
            None if is_graph && self.plan.is_some() => {
                Err(UsageError("--plan is for a RUN; a graph names its plan".into()).into())
            }
            None if is_graph && !self.what.exists() => {
                let help = nearest::file(&self.what).map_or_else(String::new, |help| format!("; {help}"));
                Err(UsageError(format!("there is no graph file {}{help}", self.what.display())).into())
            }
            None if is_graph => self.steer(self.what.clone(), self.sets.clone(), None, global),
            None if self.out.is_some() || !self.sets.is_empty() => {
                Err(UsageError("--out and --set are for a graph, or for BONE and SCAN".into()).into())
            }
            None => self.play(global),
        }
    }

    fn register(&self, scan: &Path, global: &Global) -> Result<Exit> {
        let set = |key: &str, file: &Path| {
            let absolute = std::path::absolute(file).with_context(|| format!("{} has no path", file.display()))?;
            anyhow::Ok(format!("{key}={:?}", absolute.display().to_string()))
        };
        let mut sets = vec![set("bone.path", &self.what)?, set("scan.path", scan)?];
        sets.extend(self.sets.iter().cloned());
        let two_files = TwoFiles::new()?;
        self.steer(two_files.graph(), sets, Some(two_files), global)
    }

    /// Runs a graph that the page can change.
    fn steer(&self, graph: PathBuf, sets: Vec<String>, two_files: Option<TwoFiles>, global: &Global) -> Result<Exit> {
        let graph = GraphArgs { graph, sets, plugins: self.plugins.clone() };
        let (out, admission, picks) = (self.out.clone(), self.admission.clone(), Picks::new(&self.picks));
        steer::execute(SteerRequest { graph, out, address: self.address, admission, two_files, picks }, global)
    }

    fn play(&self, global: &Global) -> Result<Exit> {
        let path = run_path::recording(&self.what)?;
        let stream = Arc::new(Stream::default());
        let opened = Playback::open(&path, stream.clone());
        let playback = opened.with_context(|| format!("{} cannot be shown", path.display()))?;
        // A recording of other programs has neither a name nor results.
        let recording = Recording::open(&path).ok();
        let file = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let name = recording.as_ref().map_or(&file, |recording| &recording.run.name);
        serve::recorded(&stream, name, recording.as_ref(), playback.problem());
        let plan = match &self.plan {
            Some(file) => Some(known_plan::given(file, recording.as_ref())?),
            None => recording.as_ref().and_then(known_plan::of),
        };
        let player = Player { playback, picks: Picks::new(&self.picks), plan };
        let server = self.admission.serve(self.address, name, stream, Arc::new(player), global)?;
        let cancelled = Arc::default();
        let (until, global) = (Arc::clone(&cancelled), global.clone());
        running::watch(Progress::hidden(), cancelled, move |_| serve::wait(server, &until, &global))?;
        Ok(Exit::Done)
    }
}
