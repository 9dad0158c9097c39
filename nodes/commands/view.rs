use super::{
    Exit, Global,
    progress::Progress,
    run_path,
    running::{self, Ran},
    serve::{self, Admission},
};
use anyhow::{Context, Result};
use clap::Args;
use osteoflow_engine::Recording;
use osteoflow_viewer::{Playback, Stream};
use std::{net::SocketAddr, path::PathBuf, sync::Arc};

/// Show a recording in the browser: play, stop, go to any time.
///
/// Prints the address of a page that needs nothing but this program, and one for Foxglove and Lichtblick. Both end with Ctrl-C.
/// Only this machine reaches them, and only with the token in the address.
#[derive(Debug, Clone, Args)]
#[command(after_help = "\
Examples:
  osteoflow view runs/fibula-20260314-092653
  osteoflow view run.mcap --address 8765
  osteoflow run graphs/variants/fibula_live.toml --serve        a run while it goes on")]
pub(crate) struct View {
    /// The folder of a run, or a recording.
    what: PathBuf,

    /// Where to serve: HOST:PORT, or a PORT of the loopback. Default: a free port of the loopback.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:0", value_parser = serve::address)]
    address: SocketAddr,

    #[command(flatten)]
    admission: Admission,
}

impl View {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let path = run_path::recording(&self.what)?;
        let stream = Arc::new(Stream::default());
        let opened = Playback::open(&path, stream.clone());
        let playback = opened.with_context(|| format!("{} cannot be shown", path.display()))?;
        // A recording of other programs has neither a name nor results.
        let recording = Recording::open(&path).ok();
        let results = recording.as_ref().and_then(|recording| recording.results.as_ref());
        let file = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let name = recording.as_ref().map_or(&file, |recording| &recording.name);
        serve::recorded(&stream, name, results, playback.problem());
        let server = self.admission.serve(self.address, name, stream, Arc::new(playback), global)?;
        let cancelled = Arc::default();
        let (until, global) = (Arc::clone(&cancelled), global.clone());
        match running::watch(Progress::hidden(), cancelled, move |_| serve::wait(server, &until, &global))? {
            Ran::Ended(()) | Ran::Left => Ok(Exit::Done),
        }
    }
}
