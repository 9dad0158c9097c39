use super::{
    Exit, Global, GraphArgs, PluginArgs,
    content::is_volume,
    progress::Progress,
    run::Run,
    run_path,
    running::{self, Ran},
    serve::{self, Admission},
};
use anyhow::{Context, Result};
use clap::Args;
use osteoflow_engine::Recording;
use osteoflow_viewer::{Playback, Stream};
use std::{
    fs,
    net::SocketAddr,
    path::{Path, PathBuf},
    sync::Arc,
};

/// Two files and nothing else.
const TWO_FILES: &str = include_str!("../../graphs/two_files.toml");

/// Show a recording in the browser, or register a scan onto a bone and show that.
///
/// With a run or a recording: play, stop, go to any time. With BONE and SCAN: registers the scan by the shape of the bone alone, as
/// graphs/two_files.toml does, shows how sure it is, and writes the pose as a run does, with export/ for 3D Slicer.
///
/// Prints the address of a page that needs nothing but this program, and one for Foxglove and Lichtblick. Both end with Ctrl-C.
/// Only this machine reaches them, and only with the token in the address.
#[derive(Debug, Clone, Args)]
#[command(after_help = "\
Examples:
  osteoflow view runs/fibula-20260314-092653
  osteoflow view run.mcap --address 8765
  osteoflow view bone.stl scan.ply
  osteoflow view ct.nrrd scan.ply --set bone.threshold_hu=250 --out DIR
  osteoflow run graphs/variants/fibula_live.toml --serve        a run while it goes on")]
pub(crate) struct View {
    /// The folder of a run, or a recording; or the bone: a surface, or a CT.
    #[arg(value_name = "RUN|BONE")]
    what: PathBuf,

    /// The scan to register onto the bone.
    scan: Option<PathBuf>,

    /// Change a parameter of the registration of SCAN: a key of graphs/two_files.toml, as of `run`; may be given again.
    #[arg(long = "set", value_name = "KEY=VALUE", requires = "scan")]
    sets: Vec<String>,

    /// The folder to write the registration of SCAN into. Default: runs/two_files-TIME.
    #[arg(long, value_name = "DIR", requires = "scan")]
    out: Option<PathBuf>,

    /// Where to serve: HOST:PORT, or a PORT of the loopback. Default: a free port of the loopback.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:0", value_parser = serve::address)]
    address: SocketAddr,

    #[command(flatten)]
    admission: Admission,
}

impl View {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        match &self.scan {
            None => self.play(global),
            Some(scan) => self.register(scan, global),
        }
    }

    fn register(&self, scan: &Path, global: &Global) -> Result<Exit> {
        let is_ct = self.what.is_dir() || is_volume(&self.what);
        let set = |key: &str, file: &Path| {
            let absolute = std::path::absolute(file).with_context(|| format!("{} has no path", file.display()))?;
            anyhow::Ok(format!("{key}={:?}", absolute.display().to_string()))
        };
        let mut sets = vec![set("bone.path", &self.what)?, set("scan.path", scan)?];
        if is_ct {
            sets.push("bone.kind=surface.ct".into());
        }
        sets.extend(self.sets.iter().cloned());
        let folder = tempfile::tempdir().context("a temporary folder cannot be made")?;
        let graph = folder.path().join("two_files.toml");
        fs::write(&graph, TWO_FILES).with_context(|| format!("{} cannot be written", graph.display()))?;
        let graph = GraphArgs { graph, sets, plugins: PluginArgs::default() };
        Run::served(graph, self.out.clone(), self.address, self.admission.clone()).execute(global)
    }

    fn play(&self, global: &Global) -> Result<Exit> {
        let path = run_path::recording(&self.what)?;
        let stream = Arc::new(Stream::default());
        let opened = Playback::open(&path, stream.clone());
        let playback = opened.with_context(|| format!("{} cannot be shown", path.display()))?;
        // A recording of other programs has neither a name nor results.
        let recording = Recording::open(&path).ok();
        let file = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let name = recording.as_ref().map_or(&file, |recording| &recording.name);
        serve::recorded(&stream, name, recording.as_ref(), playback.problem());
        let server = self.admission.serve(self.address, name, stream, Arc::new(playback), global)?;
        let cancelled = Arc::default();
        let (until, global) = (Arc::clone(&cancelled), global.clone());
        match running::watch(Progress::hidden(), cancelled, move |_| serve::wait(server, &until, &global))? {
            Ran::Ended(()) | Ran::Left => Ok(Exit::Done),
        }
    }
}
