mod watch;

use super::common::{
    Exit, Global,
    graph_args::or_faults,
    progress::Progress,
    run_end::print_end,
    running,
    serve::{self, Admission, Serving},
    terminal,
};
use crate::app::{ArchiveArgs, RunRequest, UsageError, out_dir, run_error};
use anyhow::Result;
use clap::Args;
use osteoflow_engine::{
    plugin::check_lent_memory,
    run::{Injection, Listener, RunOptions, run},
};
use osteoflow_viewer::{NoApp, Stream};
use std::{
    io::Write,
    net::SocketAddr,
    num::NonZeroUsize,
    path::{Path, PathBuf},
    sync::{Arc, atomic::Ordering},
};

/// Run a graph: check it, run it, write the results, how they came about, and a recording of the data between its nodes.
///
/// Without --out the files are written to runs/GRAPH-TIME in the current folder.
#[derive(Debug, Clone, Args)]
#[command(after_help = "\
Examples:
  osteoflow run graphs/fibula.toml
  osteoflow run graphs/fibula.toml --set icp.kind=icp.point_to_point --set graph.seed=7
  osteoflow run graphs/fibula_recorded.toml --set recording.path=R.mcap --set bone.path=B.stl \\
      --set phantom.path=P.stl --set plan.path=R.plan.json --out DIR
  osteoflow run graphs/variants/fibula_live.toml --serve    and open the page that it prints
  osteoflow run graphs/fibula.toml --watch              then edit the graph: each save is run within the second
  osteoflow run graphs/fibula.toml --inject icp --out R && osteoflow repro R/repro/icp-0
  osteoflow run graphs/fibula.toml --format json --quiet | jq .metrics.tre_true_mm")]
pub(crate) struct Run {
    #[command(flatten)]
    request: RunRequest,

    /// A second file, which no graph is: for the words of the fault.
    #[arg(hide = true)]
    scan: Option<PathBuf>,

    #[command(flatten)]
    archive: ArchiveArgs,

    /// Run again, from the first changed node on, whenever the graph, a file that it names or a plugin is saved. Each run writes
    /// results.json and manifest.json into a new folder under runs/, or with --out DIR into DIR-2, DIR-3 and so on. Ctrl-C ends it with
    /// exit code 0 between two runs, 130 during one. With --format json each run is a line. Live sources are refused.
    #[arg(long, conflicts_with = "inject")]
    watch: bool,

    /// Show the run while it goes on: a page for the browser, and a stream for Foxglove and Lichtblick, until Ctrl-C. ADDR is HOST:PORT or
    /// a PORT of this machine alone; default: a free one. A slow viewer loses messages and never holds up the run.
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = "127.0.0.1:0", value_parser = serve::address,
          conflicts_with_all = ["no_record", "watch"])]
    serve: Option<SocketAddr>,

    #[command(flatten)]
    admission: Admission,

    /// For tests of failures: make a node panic, or return an error, instead of processing this item (default: 0); may be
    /// given again.
    #[arg(long, value_name = "NODE[@ITEM][=panic|error]")]
    inject: Vec<String>,

    /// Check after each firing of a plugin's node that it did not write into its inputs, which are lent to be read. A node
    /// that did is an error that names the input and the column. The inputs are copied before each firing, and nodes run on
    /// one thread, so that the writer is told from other readers.
    #[arg(long, conflicts_with_all = ["watch", "workers"])]
    check_plugins: bool,

    /// For tests: delay threads, wake them without reason and reorder nodes, at random from this seed. The results are the
    /// same with any seed and without, on any number of workers.
    #[arg(long, value_name = "SEED")]
    shuffle: Option<u64>,
}

impl Run {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let mut request = self.request.clone();
        if let Some(scan) = &self.scan {
            let is_graph = |file: &Path| file.extension().is_some_and(|ending| ending == "toml");
            if is_graph(scan) || is_graph(&request.graph.graph) {
                let (first, second) = (request.graph.graph.display(), scan.display());
                usage!(
                    "run takes one graph, and {first} and {second} are named: run each by itself; a file with extends, or --set, changes a graph"
                );
            }
            let (bone, scan) = (request.graph.graph.display(), scan.display());
            usage!(
                "run takes one graph; two files are registered by\n  osteoflow register {bone} {scan}\nor, with a recording of \
                 the run, by\n  osteoflow run graphs/two_files.toml --set bone.path={bone} --set scan.path={scan}"
            );
        }
        if let Some((graph, _)) = self.archive.open(&request.graph.graph, &mut request.graph.plugins)? {
            request.graph.graph = graph;
        }
        if self.watch {
            return watch::execute(&Self { request, ..self.clone() }, global);
        }
        if self.check_plugins {
            check_lent_memory();
            request.leave.workers = Some(NonZeroUsize::MIN);
            // A cached answer would not show what the node does.
            request.keep.no_cache = true;
        }
        let graph = or_faults(request.check(), |graph| &graph.checked.warnings, global)?;
        let Some(graph) = graph else { return Ok(Exit::Usage) };
        let plan = graph.plan();
        let inject = self.inject.iter().map(|text| Injection::parse(text, plan)).collect::<Result<_, _>>();
        let inject = inject.map_err(|message| UsageError(format!("--inject: {message}")))?;
        let cancelled = Arc::default();
        running::make_pool(graph.request.leave.workers)?;
        let options = graph.options(&cancelled)?;
        let dir = out_dir::make(graph.request.leave.out.as_deref(), &plan.name, graph.request.leave.force)?;
        let stream = self.serve.map(|_| Arc::new(Stream::default()));
        // Before the first viewer can connect, so that each finds the channel of the state.
        let nodes = serve::graph_json(plan, graph.registry());
        let mut serving = stream.clone().map(|stream| Serving::begin(stream, plan, &nodes));
        let server = self
            .serve
            .zip(stream.clone())
            .map(|(address, stream)| self.admission.serve(address, &plan.name, stream, Arc::new(NoApp), global));
        let server = server.transpose()?;
        let options = RunOptions {
            out_dir: Some(dir.to_path_buf()),
            listener: stream.map(|stream| stream as Arc<dyn Listener>),
            latency: options.latency || global.verbose > 0,
            inject,
            shuffle: self.shuffle,
            ..options
        };
        let progress = Progress::of_run(plan, options.workers, global);
        let (of_run, folder) = (global.clone(), dir.to_path_buf());
        let ran = running::watch(progress, cancelled, move |progress| {
            let shown = running::WithUrgent { progress, is_quiet: of_run.quiet };
            let report = run(graph.plan(), graph.registry(), &options, &shown).map_err(run_error)?;
            progress.end();
            if let Some(serving) = &mut serving {
                serving.ended(&report);
            }
            let exit = print_end(&report, &folder, &of_run)?;
            if let Some(server) = server {
                if !options.cancelled.load(Ordering::Relaxed) && !of_run.quiet {
                    writeln!(terminal::stderr(), "the page stays until Ctrl-C")?;
                }
                serve::wait(server, &options.cancelled, &of_run)?;
            }
            Ok(exit)
        })?;
        if ran.is_none() {
            running::print_left_files(&dir, global);
        }
        Ok(ran.unwrap_or(Exit::Interrupted))
    }
}
