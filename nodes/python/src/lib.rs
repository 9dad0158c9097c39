//! The Python package `osteoflow`: thin functions over [`osteoflow::app`], which the files in `python/osteoflow` complete.

mod errors;
mod foreign;
mod functions;
mod settings;
mod shapes;
mod views;

use errors::{exception, watched};
use osteoflow::{
    app::{
        self, Ask, GraphArgs, Keep, Leave, RegisterInput, RegisterRequest, RunRequest, ShardFault, SimulateRequest,
        StreamFormat, SweepRequest, WireInputs,
    },
    progress::{self, Progress},
};
use osteoflow_engine::Recording;
use osteoflow_node::{Item, PortPayload};
use pyo3::{
    exceptions::{PyKeyError, PyValueError},
    prelude::*,
    types::{PyDict, PyList},
};
use std::{
    collections::{BTreeMap, BTreeSet},
    ffi::OsString,
    path::PathBuf,
    sync::{Arc, Mutex, PoisonError},
};

/// Registers as the command does, and returns its JSON. `target` and `source` are a name and, if they are in memory, the content.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "named where they are given, in Python")]
fn register(
    py: Python<'_>,
    target: (PathBuf, Option<Bound<'_, PyAny>>),
    source: (PathBuf, Option<Bound<'_, PyAny>>),
    init: Option<[[f64; 4]; 4]>,
    options: Bound<'_, PyAny>,
    set: Option<Bound<'_, PyAny>>,
    workers: Option<usize>,
    space: Option<&str>,
    trace: bool,
    progress: bool,
) -> PyResult<String> {
    errors::check_threads()?;
    let input = |(path, content): (PathBuf, Option<Bound<'_, PyAny>>), what: &str| -> PyResult<RegisterInput> {
        let content = content.map(|shape| shapes::given(&shape, what)).transpose()?;
        Ok(RegisterInput { path, content })
    };
    let request = RegisterRequest {
        target: input(target, "target")?,
        source: input(source, "source")?,
        init_pose: init.map(|rows| shapes::rigid(&rows, "init")).transpose()?,
        sets: settings::settings(set.as_ref())?,
        workers: settings::workers(workers)?,
        space: space.map(shapes::space_of).transpose()?,
        ..RegisterRequest::of(settings::value_of(&options)?).map_err(|error| exception(py, error))?
    };
    let cancelled = Arc::default();
    let json = watched(py, &cancelled, || -> Result<_, app::Error> {
        let checked = request.check()?;
        let progress = Progress::on_terminal(checked.plan(), progress);
        let registration = checked.register(&progress, &cancelled, trace);
        progress.end();
        registration
    })?;
    Ok(json.to_string())
}

/// A checked graph.
#[pyclass(frozen, module = "osteoflow._core")]
struct Graph(app::Graph);

/// Results, warnings, folder, and the wires of a run.
type RunOutput = (String, Vec<String>, Option<PathBuf>, Wires);

/// Names of inputs, outputs with their payloads, and the run's seed.
type NodePorts = (Vec<String>, Vec<(String, Option<&'static str>)>, u64);

#[pymethods]
impl Graph {
    #[new]
    #[allow(clippy::too_many_arguments, reason = "named where they are given, in Python")]
    fn new(
        py: Python<'_>,
        graph: PathBuf,
        set: Option<Bound<'_, PyAny>>,
        plugins: Vec<PathBuf>,
        out: Option<PathBuf>,
        force: bool,
        record: bool,
        workers: Option<usize>,
        cache: bool,
    ) -> PyResult<Self> {
        let (sets, workers) = (settings::settings(set.as_ref())?, settings::workers(workers)?);
        let request = RunRequest {
            graph: GraphArgs { graph, sets, plugins: settings::plugins(plugins) },
            leave: Leave { out, force, workers },
            keep: Keep { no_cache: !cache },
            no_record: !record,
        };
        watched(py, &Arc::default(), || request.check()).map(Self)
    }

    /// Warnings about the graph.
    fn warnings(&self) -> Vec<String> {
        self.0.warnings()
    }

    /// Each wire with its payload (None for any) and its frames, as far as they are known: frame, to, from.
    fn wires(&self, py: Python<'_>) -> PyResult<Py<PyDict>> {
        let all = PyDict::new(py);
        let plan = self.0.plan();
        for (node, index) in plan.nodes.iter().zip(0..) {
            for (output, port) in node.outputs.iter().zip(0..) {
                let name = plan.wire_name(osteoflow_engine::plan::OutputId { node: index, port });
                let frames = &output.frames;
                let payload = output.payload.ty().map(|ty| ty.name);
                let about = (payload, frames.frame.clone(), frames.to.clone(), frames.from.clone());
                all.set_item(name, about)?;
            }
        }
        Ok(all.unbind())
    }

    /// The full name of a wire, or of the one output of a node.
    fn wire(&self, py: Python<'_>, name: &str) -> PyResult<String> {
        let id = self.0.output(name).map_err(|error| exception(py, error))?;
        Ok(self.0.plan().wire_name(id))
    }

    /// The names of a node's inputs, and its outputs with their payloads; None if there is no such node.
    fn ports(&self, node: &str) -> Option<NodePorts> {
        let plan = self.0.plan();
        let node = &plan.nodes[plan.node(node)?];
        let inputs = node.inputs.iter().map(|input| input.port.name.to_string()).collect();
        let outputs =
            node.outputs.iter().map(|output| (output.name.to_string(), output.payload.ty().map(|ty| ty.name)));
        Some((inputs, outputs.collect(), plan.seed))
    }

    /// Runs it: items by wire in place of those of its nodes, functions by node with the outputs that they do not give, and the wires
    /// to keep (None: all).
    fn run(
        &self,
        py: Python<'_>,
        inputs: Bound<'_, PyDict>,
        functions: BTreeMap<String, (Py<PyAny>, Vec<String>)>,
        keep: Option<BTreeSet<String>>,
        progress: bool,
    ) -> PyResult<RunOutput> {
        errors::check_threads()?;
        let mut given = WireInputs::default();
        for (wire, items) in inputs.iter() {
            let id = self.0.output(&wire.extract::<String>()?).map_err(|error| exception(py, error))?;
            let (payload, items): (String, Bound<'_, PyList>) = items.extract()?;
            let port = &self.0.plan().nodes[id.node].outputs[id.port].payload;
            let ty = match port {
                PortPayload::Type(ty) => Some(*ty),
                PortPayload::Any => self.0.registry().payload_type(&payload),
            };
            let ty = ty.filter(|ty| ty.name == payload).ok_or_else(|| {
                let wire = self.0.plan().wire_name(id);
                let carries = port.ty().map_or("any payload", |ty| ty.name);
                errors::UsageError::new_err(format!("wire \"{wire}\" carries {carries}, but {payload} was given"))
            })?;
            let items = items.iter().zip(0..).map(|(item, number)| views::given_item(ty, number, &item));
            let items: Vec<Item> = items.collect::<PyResult<_>>()?;
            given.add(self.0.plan(), id, items).map_err(errors::UsageError::new_err)?;
        }
        let keeps = |wire: &str| keep.as_ref().is_none_or(|keep| keep.contains(wire));
        let cancelled = Arc::default();
        let mut by_node = BTreeMap::new();
        for (node, (function, without)) in functions {
            for output in without {
                let id = self.0.output(&format!("{node}.{output}")).map_err(|error| exception(py, error))?;
                given.leave_out(id);
            }
            by_node.insert(node, function);
        }
        let functions = (!by_node.is_empty()).then(|| functions::registry(&self.0, by_node, &cancelled)).transpose()?;
        let ran = watched(py, &cancelled, || {
            let progress = Progress::on_terminal(self.0.plan(), progress);
            let ran = self.0.run(given, functions.as_ref(), &keeps, &progress, &cancelled);
            progress.end();
            ran
        })?;
        Ok((ran.results.to_string(), ran.warnings, ran.out_dir, Wires(Source::Run(ran.wires))))
    }
}

enum Source {
    Run(BTreeMap<String, Vec<Item>>),
    File(Box<Recording>),
}

/// The items of wires, of a run or of a recording.
#[pyclass(frozen, module = "osteoflow._core")]
struct Wires(Source);

#[pymethods]
impl Wires {
    /// Opens a recording.
    #[staticmethod]
    fn open(py: Python<'_>, file: PathBuf) -> PyResult<Self> {
        let cancelled = Arc::default();
        let recording = watched(py, &cancelled, || app::recording(&file))?;
        Ok(Self(Source::File(Box::new(recording))))
    }

    /// The wires.
    fn names(&self) -> Vec<String> {
        match &self.0 {
            Source::Run(wires) => wires.keys().cloned().collect(),
            Source::File(recording) => recording.wires.keys().cloned().collect(),
        }
    }

    /// The items of a wire.
    fn items<'py>(&self, py: Python<'py>, wire: &str) -> PyResult<Bound<'py, PyList>> {
        let missing = || PyKeyError::new_err(wire.to_owned());
        let items: Vec<views::PyItem> = match &self.0 {
            Source::Run(wires) => {
                let items = wires.get(wire).ok_or_else(missing)?.iter();
                items.map(|item| views::item_of_run(py, item)).collect::<PyResult<_>>()?
            }
            Source::File(recording) => {
                let recorded = recording.wires.get(wire).ok_or_else(missing)?;
                let items = recorded.items().map_err(|(number, error)| {
                    errors::OsteoflowError::new_err(format!("wire {wire}, item {number}: {error}"))
                })?;
                let items = items.iter().map(|item| {
                    let payload = item.payload.as_ref().map_or(&*recorded.payload, |(name, _)| name);
                    views::item(py, item.number, item.stamp_ns, payload, item.body.as_ref())
                });
                items.collect::<PyResult<_>>()?
            }
        };
        PyList::new(py, items)
    }

    /// What a recording says of its run, as JSON; None for a run.
    fn about(&self) -> Option<String> {
        let Source::File(recording) = &self.0 else { return None };
        let about = serde_json::json!({
            "name": recording.run.name, "graph": recording.run.graph, "seed": recording.run.seed, "version": recording.run.version,
            "results": recording.results, "interrupted": recording.interrupted, "truncated": recording.truncated,
        });
        Some(about.to_string())
    }
}

/// Simulates a procedure into a folder; returns notes on the bone.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "named where they are given, in Python")]
fn simulate(
    py: Python<'_>,
    out: PathBuf,
    seed: u64,
    n_points: u64,
    bone: Option<PathBuf>,
    plan: Option<PathBuf>,
    set: Option<Bound<'_, PyAny>>,
    shape: &str,
    force: bool,
) -> PyResult<Vec<String>> {
    let format = settings::choice("shape", shape, [("mcap", StreamFormat::Mcap), ("folder", StreamFormat::Folder)])?;
    if bone.is_some() != plan.is_some() {
        return Err(errors::UsageError::new_err("bone and plan belong together; give both, or neither"));
    }
    let sets = settings::settings(set.as_ref())?;
    let request = SimulateRequest { seed, points: n_points, bone, plan, sets, format, force };
    watched(py, &Arc::default(), || -> Result<_, app::Error> {
        let mut notes = Vec::new();
        request.write(&out, &mut |note| notes.push(note.to_owned()))?;
        Ok(notes)
    })
}

/// A sweep of a graph.
#[pyclass(frozen, module = "osteoflow._core")]
struct Sweep(SweepRequest);

#[pymethods]
impl Sweep {
    #[new]
    #[allow(clippy::too_many_arguments, reason = "named where they are given, in Python")]
    fn new(
        graph: PathBuf,
        set: Option<Bound<'_, PyAny>>,
        plugins: Vec<PathBuf>,
        out: PathBuf,
        resume: bool,
        retry_failed: bool,
        workers: Option<usize>,
        share: bool,
        cache: bool,
    ) -> PyResult<Self> {
        Ok(Self(SweepRequest {
            graph: Some(graph),
            sets: settings::settings(set.as_ref())?,
            plugins: settings::plugins(plugins),
            out: Some(out),
            resume,
            retry_failed,
            shard: None,
            only: Vec::new(),
            record: None,
            workers: settings::workers(workers)?,
            no_share: !share,
            keep: Keep { no_cache: !cache },
            spec: None,
        }))
    }

    /// Makes the runs.
    fn run(&self, py: Python<'_>, progress: bool) -> PyResult<()> {
        let cancelled = Arc::default();
        errors::check_threads()?;
        watched(py, &cancelled, || -> Result<_, app::Error> {
            let run = self.0.begin(self.0.check()?, &cancelled)?;
            let bar = progress::SweepProgress::on_terminal(run.n_left()?, progress);
            let swept = run.run(&bar);
            bar.end();
            swept
        })
    }

    /// Begins or resumes the folder as a study.
    fn study(&self, py: Python<'_>) -> PyResult<Study> {
        watched(py, &Arc::default(), || self.0.study()).map(|study| Study(Mutex::new(study)))
    }

    /// Begins the folder of a sweep whose shards are run elsewhere; returns the numbers of the runs of each shard.
    fn shards(&self, py: Python<'_>, n_shards: Option<usize>) -> PyResult<Vec<Vec<usize>>> {
        watched(py, &Arc::default(), || self.0.shards(n_shards))
    }
}

/// A sweep whose rows are asked for one by one.
#[pyclass(frozen, module = "osteoflow._core")]
struct Study(Mutex<app::OpenStudy>);

#[pymethods]
impl Study {
    /// The rows of settings with the number of the repeat, each as JSON.
    fn run(&self, py: Python<'_>, asks: Vec<(Bound<'_, PyAny>, usize)>, progress: bool) -> PyResult<Vec<String>> {
        errors::check_threads()?;
        let ask = |(settings, repeat): (Bound<'_, PyAny>, usize)| {
            Ok(Ask { settings: settings::settings(Some(&settings))?, repeat })
        };
        let asks = asks.into_iter().map(ask).collect::<PyResult<Vec<_>>>()?;
        let cancelled = Arc::default();
        watched(py, &cancelled, || -> Result<_, app::Error> {
            // One thread at a time: the rows of a call are run on all workers.
            let mut study = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            let bar = progress::SweepProgress::on_terminal(asks.len(), progress && asks.len() > 1);
            let rows = study.run(&asks, &bar, &cancelled);
            bar.end();
            Ok(rows?.iter().map(|row| study.row(row).to_string()).collect())
        })
    }

    /// Writes tables and summary.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        watched(py, &Arc::default(), || self.0.lock().unwrap_or_else(PoisonError::into_inner).close())
    }
}

/// Merges the shards of a sweep.
#[pyfunction]
fn merge(py: Python<'_>, shards: Vec<PathBuf>, out: PathBuf) -> PyResult<()> {
    watched(py, &Arc::default(), || app::summary(&app::merge(&shards, &out)?).map(drop))
}

/// Checks the folder of a shard: UsageError if it is of another sweep, ValueError if it is damaged.
#[pyfunction]
fn check_shard(py: Python<'_>, sweep: PathBuf, shard: PathBuf, runs: Vec<usize>) -> PyResult<()> {
    py.detach(|| app::check_shard(&sweep, &shard, &runs)).map_err(|fault| match fault {
        ShardFault::Other(what) => errors::UsageError::new_err(what),
        ShardFault::Damaged(what) => PyValueError::new_err(what),
    })
}

/// The progress of a sweep whose runs end elsewhere.
#[pyclass(frozen, module = "osteoflow._core")]
struct SweepProgress(progress::SweepProgress);

#[pymethods]
impl SweepProgress {
    #[new]
    fn new(n_runs: usize, shown: bool) -> Self {
        Self(progress::SweepProgress::on_terminal(n_runs, shown))
    }

    /// Counts runs that have ended.
    fn ended(&self, n_runs: usize) {
        self.0.ended_elsewhere(n_runs);
    }

    /// Shows a message.
    fn message(&self, what: &str) {
        self.0.message(what);
    }

    /// Removes the line.
    fn end(&self) {
        self.0.end();
    }
}

/// The exit code of a program in Rust that panics.
const PANICKED: u8 = 101;

/// Runs the command with these arguments, the program's name first, as all that this process does; returns its exit code.
#[pyfunction]
fn command(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| std::panic::catch_unwind(|| osteoflow::main(arguments)).unwrap_or(PANICKED))
}

/// Names the Python program and its arguments that run the command, and the file of this library.
#[pyfunction]
fn hosted_by(program: PathBuf, before: Vec<OsString>, library: PathBuf) {
    app::hosted_by(program, before, library);
}

#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("OsteoflowError", py.get_type::<errors::OsteoflowError>())?;
    module.add("UsageError", py.get_type::<errors::UsageError>())?;
    module.add("Refused", py.get_type::<errors::Refused>())?;
    module.add_class::<Graph>()?;
    module.add_class::<Sweep>()?;
    module.add_class::<Study>()?;
    module.add_class::<Wires>()?;
    module.add_class::<SweepProgress>()?;
    module.add("NODE_MODULE", app::PYTHON_HELPER)?;
    for function in [
        wrap_pyfunction!(register, module)?,
        wrap_pyfunction!(simulate, module)?,
        wrap_pyfunction!(merge, module)?,
        wrap_pyfunction!(settings::setting_texts, module)?,
        wrap_pyfunction!(check_shard, module)?,
        wrap_pyfunction!(command, module)?,
        wrap_pyfunction!(hosted_by, module)?,
        wrap_pyfunction!(errors::forked, module)?,
        wrap_pyfunction!(shapes::seven, module)?,
        wrap_pyfunction!(shapes::matrix, module)?,
        wrap_pyfunction!(shapes::read, module)?,
        wrap_pyfunction!(shapes::write_shape, module)?,
        wrap_pyfunction!(shapes::write_points, module)?,
        wrap_pyfunction!(shapes::write_pose, module)?,
    ] {
        module.add_function(function)?;
    }
    Ok(())
}
