mod player;
mod steer;

use super::common::{
    Exit, Global,
    graph_args::or_faults,
    progress::Progress,
    run_path, running,
    serve::{self, Admission, known_plan, picks::Picks},
};
use crate::app::{GraphArgs, Leave, RegisterInput, RegisterRequest};
use anyhow::{Context, Result, anyhow};
use clap::{
    Arg, Args,
    builder::{OsStringValueParser, TypedValueParser},
};
use osteoflow_engine::{Recording, names::nearest};
use osteoflow_viewer::{Playback, Stream};
use player::Player;
use std::{net::SocketAddr, path::PathBuf, sync::Arc};
use steer::{SteerRequest, TwoFiles};

/// Show a graph, a run or a recording in the browser: also a bone and a scan, which are registered there.
///
/// With GRAPH: runs it, and again whenever its files change, or a parameter or kind is changed on the page, which can write the changes
/// into the file. Each run has a folder of its own. With a run or a recording: play, stop, go to any time. With BONE and SCAN: registers
/// the scan as graphs/two_files.toml does, and writes the pose, with export/ for 3D Slicer. All options of `osteoflow register --help`
/// apply to them, but for --repeat, --write-source and --trace.
///
/// Prints the address of a page that needs nothing but this program, and one for Foxglove and Lichtblick. Both end with Ctrl-C.
/// Only this machine reaches them, and only with the token in the address, which says what its holder may do: see, steer or write.
#[derive(Debug, Clone, Args)]
#[command(
    mut_args(of_view),
    after_help = "\
Examples:
  osteoflow view graphs/fibula.toml
  osteoflow view runs/fibula-20260314-092653
  osteoflow view run.mcap --address 8765
  osteoflow view graphs/fibula.toml --address 0.0.0.0:8765 --serve-public --role see,write    one address for others, one for you
  osteoflow view bone.stl scan.ply
  osteoflow view bone.stl scan.ply --camera 0,0,0 --box=-60,-40,150,60,40,250
  osteoflow view ct.nrrd scan.ply --set bone.threshold_hu=250 --out DIR
  osteoflow run graphs/variants/fibula_live.toml --serve        a run while it goes on"
)]
pub(crate) struct View {
    #[command(flatten)]
    request: RegisterRequest,

    /// Where to serve: HOST:PORT, or a PORT of the loopback. Default: a free port of the loopback.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:0", value_parser = serve::address)]
    address: SocketAddr,

    /// The plan of RUN, for its anatomy: a run does not record where a plan was that the command line named.
    #[arg(long, value_name = "FILE", conflicts_with = "source")]
    plan: Option<PathBuf>,

    /// The folder for what is drawn and picked on the page: each save makes a new folder in it, picks-1, picks-2 and so on.
    #[arg(long, value_name = "DIR", default_value = "picks")]
    picks: PathBuf,

    #[command(flatten)]
    admission: Admission,
}

/// An option of `register` as `view` takes it.
fn of_view(arg: Arg) -> Arg {
    match arg.get_id().as_str() {
        "target" => arg
            .value_name("GRAPH|RUN|BONE")
            .help("A graph (.toml), the folder of a run, or a recording; or the bone: a surface, or a CT"),
        "source" => arg
            .value_name("SCAN")
            .help("The scan to register onto the bone")
            .value_parser(OsStringValueParser::new().map(|name| RegisterInput::from(PathBuf::from(name))))
            .required(false)
            .default_value("")
            .hide_default_value(true),
        "sets" => arg.help("Change a key of GRAPH, or of graphs/two_files.toml for SCAN, as of `run`; may be given again"),
        "out" => arg.value_name("DIR").help(
            "The folder to write the first run of GRAPH or SCAN into; those after a change are written into DIR-2, DIR-3 and so on. \
             Default: runs/GRAPH-TIME",
        ),
        // What is about the answer of `register`.
        "repeat" | "write_source" | "trace" => arg.hide(true),
        // Those that graphs take, too, and those of the page. The help of `register` has the others.
        "plugins" | "no_plugins" | "python" | "workers" | "no_cache" => arg,
        "address" | "plan" | "picks" | "serve_public" | "role" | "allow_origin" => arg,
        _ => arg.requires("source").hide_long_help(true).hide_short_help(true),
    }
}

impl View {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let what = &self.request.target.path;
        let is_graph = what.extension().is_some_and(|ending| ending == "toml");
        if !self.request.source.path.as_os_str().is_empty() {
            return self.register(global);
        }
        if is_graph && self.plan.is_some() {
            usage!("--plan is for a RUN; a graph names its plan");
        }
        if is_graph && !what.exists() {
            let help = nearest::file(what).map_or_else(String::new, |help| format!("; {help}"));
            usage!("there is no graph file {}{help}", what.display());
        }
        if is_graph {
            return self.steer(what.clone(), self.request.sets.clone(), None, global);
        }
        if self.request.out.is_some() || !self.request.sets.is_empty() {
            usage!("--out and --set are for a graph, or for BONE and SCAN");
        }
        self.play(global)
    }

    fn register(&self, global: &Global) -> Result<Exit> {
        let RegisterRequest { repeat, write_source, trace, .. } = &self.request;
        if *repeat != 1 || write_source.is_some() || trace.is_some() {
            usage!(
                "--repeat, --write-source and --trace are for register; view writes a run, with each step in run.mcap and the moved scan \
                 in export/"
            );
        }
        let request = RegisterRequest { sets: Vec::new(), out: None, ..self.request.clone() };
        let Some(checked) = or_faults(request.check(), |_| &[], global)? else { return Ok(Exit::Usage) };
        let two_files = TwoFiles::new()?;
        if let Some(pairs) = checked.pairs() {
            two_files.start_from(pairs).map_err(|why| anyhow!("{why}"))?;
        }
        if let Some(pose) = checked.given_start() {
            two_files.start_at(pose).map_err(|why| anyhow!("{why}"))?;
        }
        let of_targets = two_files.targets(&checked.targets).map_err(|why| anyhow!("{why}"))?;
        let sets = checked.sets.iter().chain(&of_targets).chain(&self.request.sets).cloned().collect();
        self.steer(two_files.graph(), sets, Some(two_files), global)
    }

    /// Runs a graph that the page can change.
    fn steer(&self, graph: PathBuf, sets: Vec<String>, two_files: Option<TwoFiles>, global: &Global) -> Result<Exit> {
        let RegisterRequest { plugins, out, workers, keep, .. } = self.request.clone();
        let graph = GraphArgs { graph, sets, plugins };
        let leave = Leave { out, force: false, workers };
        let (admission, picks) = (self.admission.clone(), Picks::new(&self.picks));
        steer::execute(SteerRequest { graph, leave, keep, address: self.address, admission, two_files, picks }, global)
    }

    fn play(&self, global: &Global) -> Result<Exit> {
        let path = run_path::recording(&self.request.target.path)?;
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
