//! `view GRAPH`: runs a graph, shows it on the page, and runs it again whenever its files change or the user changes it there.
//!
//! Each run is a whole one, with a recording of its own, so that what the page shows can always be replayed; expensive answers come
//! from the store (docs/decisions/0034).

mod changes;
mod two_files;
mod write_back;

pub(crate) use two_files::TwoFiles;

use crate::app::{GraphArgs, Keep, Leave, run_error};
use crate::commands::common::{
    Exit, Global, graph_args,
    progress::Progress,
    rerun::{Rerun, Runs, Turn, rerun},
    run_end, running,
    serve::{
        self, Admission, Serving, known_plan,
        picks::{self, Known, Picks},
    },
    terminal,
};
use anyhow::Result;
use changes::{Changes, sentence};
use osteoflow_engine::{
    Checked, Faults,
    run::{Outcome, RunOptions, run as run_graph},
    watch::Stamps,
};
use osteoflow_geometry::SurgicalPlan;
use osteoflow_node::Role as NodeRole;
use osteoflow_viewer::{App, Door, Role, Stream};
use serde_json::{Value, json};
use std::{
    io::Write,
    net::SocketAddr,
    path::Path,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Instant,
};

/// What the page may do.
const DOORS: [Door; 7] =
    [Door::Set, Door::Revert, Door::Write, Door::Region, Door::Picks, Door::SavePlan, Door::SavePairs];

/// A graph to show and change.
pub(crate) struct SteerRequest {
    pub(crate) graph: GraphArgs,
    pub(crate) leave: Leave,
    pub(crate) keep: Keep,
    pub(crate) address: SocketAddr,
    pub(crate) admission: Admission,
    /// The graph of a bone and a scan, which is not the user's.
    pub(crate) two_files: Option<TwoFiles>,
    pub(crate) picks: Picks,
}

/// What the page shows, and what it may change.
struct Steering {
    changes: Changes,
    shown: Mutex<Shown>,
    picks: Picks,
    two_files: Option<TwoFiles>,
}

/// What the page shows of the graph that is run.
#[derive(Default)]
struct Shown {
    /// The parameters as the page lists them, by node.
    graph: Value,
    /// The plan that the graph reads, with what the page does not see of it.
    plan: Option<SurgicalPlan>,
    /// The plan that the procedure was made for, if the graph reads another one.
    made_for: Option<SurgicalPlan>,
}

impl Steering {
    /// Sets what the page asks for.
    ///
    /// # Errors
    /// A sentence for the user.
    fn set(&self, request: &Value, role: Role) -> Result<Value, String> {
        let values = request["values"].as_object().ok_or("\"values\" is missing: an object of keys and values")?;
        let values: Vec<_> = values.iter().map(|(key, value)| (key.clone(), value.clone())).collect();
        self.changes.ask(&values, role)
    }

    /// Saves what was picked, and lets the graph use it.
    ///
    /// # Errors
    /// A sentence for the user.
    fn save(&self, door: Door, body: &[u8]) -> Result<Value, String> {
        let (plan, made_for) = {
            let shown = self.shown();
            (shown.plan.clone(), shown.made_for.clone())
        };
        let known = Known { plan: plan.as_ref(), made_for: made_for.as_ref() };
        let mut saved = self.picks.save(door, body, known)?;
        let more = self.use_picks(door, &saved)?;
        saved["message"] = format!("{}{more}", saved["message"].as_str().unwrap_or_default()).into();
        Ok(saved)
    }

    /// Where picks are saved, and which the graph is run with.
    fn picks(&self) -> Value {
        let plans = self.plan_nodes();
        let runs = [(!plans.is_empty(), "plan"), (self.two_files.is_some(), "pairs")];
        let runs: Vec<&str> = runs.into_iter().filter_map(|(is, what)| is.then_some(what)).collect();
        self.picks.describe(self.shown().plan.as_ref(), &runs)
    }

    fn shown(&self) -> MutexGuard<'_, Shown> {
        self.shown.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Saves a region that was drawn on the page, and lets a crop use it.
    ///
    /// # Errors
    /// A sentence for the user.
    fn save_region(&self, request: &Value) -> Result<Value, String> {
        let node = request["node"].as_str().ok_or("\"node\" is missing: the crop that uses the region")?;
        let is_crop = |known: &Value| {
            known["name"] == node && known["kind"].as_str().is_some_and(|kind| kind.starts_with("crop."))
        };
        if !self.shown().graph["nodes"].as_array().into_iter().flatten().any(is_crop) {
            return Err(format!("the graph has no crop \"{node}\" that could use the region"));
        }
        let path = self.picks.save_region(&request["region"].to_string())?;
        let changes = self.use_file(node, "crop.file", &path)?;
        Ok(json!({ "changes": changes, "message": format!("saved in {}", path.display()) }))
    }

    /// Lets a crop read a file.
    ///
    /// # Errors
    /// A sentence for the user.
    fn use_file(&self, node: &str, kind: &str, path: &Path) -> Result<Value, String> {
        let path = path.display().to_string();
        let settings = [(format!("{node}.kind"), kind.into()), (format!("{node}.path"), path.as_str().into())];
        self.changes.set(&settings).map_err(|why| format!("{path} is saved, but the graph cannot use it: {why}"))
    }

    /// The nodes that give plans.
    fn plan_nodes(&self) -> Vec<String> {
        let shown = self.shown();
        let nodes = shown.graph["nodes"].as_array().into_iter().flatten().filter(|node| {
            let mut outputs = node["outputs"].as_array().into_iter().flatten();
            node["kind"].as_str().is_some_and(|kind| kind.starts_with("plan."))
                && outputs.any(|output| output["name"] == "planes")
        });
        nodes.filter_map(|node| node["name"].as_str().map(str::to_owned)).collect()
    }

    /// Lets the graph use picks that were saved: the plan of its plan nodes, or the pairs of a registration of two files.
    ///
    /// # Errors
    /// A sentence for the user.
    fn use_picks(&self, door: Door, saved: &Value) -> Result<&'static str, String> {
        let file = |name: &str| {
            let files = saved["files"].as_array().into_iter().flatten().filter_map(Value::as_str).map(Path::new);
            let mut of_name = files.filter(|file| file.file_name().is_some_and(|known| known == name));
            of_name.next().ok_or(format!("{name} was not saved")).and_then(picks::absolute)
        };
        if door == Door::SavePairs {
            let Some(graph) = &self.two_files else { return Ok("") };
            let (bone, scan) = (file("bone_points.mrk.json")?, file("scan_points.mrk.json")?);
            return graph.start_from_pairs(&bone, &scan).map(|()| "; the registration starts from them");
        }
        let nodes = self.plan_nodes();
        if nodes.is_empty() {
            return Ok("; the graph has no node of a plan that could use it");
        }
        let plan = file("plan.json")?.display().to_string();
        // What was measured before was measured for the plan as it was.
        let made_for = saved["made_for"].as_str().map(|path| picks::absolute(Path::new(path))).transpose()?;
        let mut settings: Vec<(String, Value)> = Vec::new();
        for node in &nodes {
            settings.push((format!("{node}.kind"), "plan.file".into()));
            settings.push((format!("{node}.path"), plan.as_str().into()));
            let made_for = made_for.iter().map(|path| path.display().to_string());
            settings.extend(made_for.map(|path| (format!("{node}.made_for"), path.into())));
        }
        let used = self.changes.set(&settings);
        used.map_err(|why| format!("{plan} is saved, but the graph cannot use it: {why}"))?;
        Ok("; the graph runs with it")
    }
}

impl App for Steering {
    fn doors(&self) -> &'static [Door] {
        &DOORS
    }

    fn act(&self, door: Door, role: Role, body: &[u8]) -> Result<Value, String> {
        let request = || -> Result<Value, String> {
            serde_json::from_slice(body).map_err(|error| format!("the request is no JSON: {error}"))
        };
        match door {
            Door::Set => self.set(&request()?, role),
            Door::Revert => self.changes.revert(),
            Door::Write => self.changes.write(),
            Door::Region => self.save_region(&request()?),
            Door::Picks => Ok(self.picks()),
            _ => self.save(door, body),
        }
    }

    fn parameters(&self) -> Vec<(String, Value)> {
        let shown = self.shown();
        let mut all = Vec::new();
        for node in shown.graph["nodes"].as_array().into_iter().flatten() {
            let name = node["name"].as_str().unwrap_or_default();
            all.push((format!("{name}.kind"), node["kind"].clone()));
            for param in node["params"].as_array().into_iter().flatten() {
                all.push((format!("{name}.{}", param["name"].as_str().unwrap_or_default()), param["value"].clone()));
            }
        }
        drop(shown);
        // What was set counts before it has been run.
        self.changes.overlay(&mut all);
        all
    }

    fn set_parameters(&self, values: &[(String, Value)], role: Role) -> Result<(), String> {
        self.changes.ask(values, role).map(drop)
    }
}

/// Runs, shows and runs again until Ctrl-C.
pub(crate) fn execute(request: SteerRequest, global: &Global) -> Result<Exit> {
    let cancelled = Arc::default();
    let options = RunOptions {
        store: request.keep.store()?,
        record: true,
        latency: true,
        ..running::options(request.leave.workers, &cancelled)?
    };
    let stream = Arc::new(Stream::default());
    let built_in = request.two_files.as_ref();
    let no_file = built_in.map(|_| "this graph is built in; show graphs/two_files.toml to change a file");
    let changes = Changes::new(request.graph.clone(), no_file, request.picks.folder().into());
    let steering =
        Arc::new(Steering { changes, shown: Mutex::default(), picks: request.picks, two_files: request.two_files });
    let name = request.graph.graph.file_stem().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let server = request.admission.serve(request.address, &name, stream.clone(), steering.clone(), global)?;
    let runs = Runs { options, global: global.clone(), leave: request.leave, n: 0 };
    let mut session = Session { steering, stream, runs, before: None };
    let (until, global) = (Arc::clone(&cancelled), global.clone());
    let exit = running::watch(Progress::hidden(), cancelled, move |_| {
        let exit = rerun(&mut session, &until)?;
        if exit != Exit::Usage {
            serve::wait(server, &until, &global)?;
        }
        Ok(exit)
    })?;
    Ok(exit.unwrap_or(Exit::Interrupted))
}

/// A graph that the page shows, each run a whole one.
struct Session {
    steering: Arc<Steering>,
    stream: Arc<Stream>,
    runs: Runs,
    /// The state that the page showed after the last run, and the graph of that run.
    before: Option<(Value, String)>,
}

impl Rerun for Session {
    fn graph(&self) -> GraphArgs {
        self.steering.changes.graph()
    }

    fn n_changes(&self) -> u64 {
        self.steering.changes.count()
    }

    fn show_faults(&mut self, faults: &Faults) -> Result<Option<Exit>> {
        graph_args::print_faults(faults, &self.runs.global)?;
        let changes = &self.steering.changes;
        // A graph of the user's may be mended; a file that was named wrongly on the command line is not.
        if self.runs.n == 0 && (self.steering.two_files.is_some() || !changes.path().exists()) {
            return Ok(Some(Exit::Usage));
        }
        let mut state = self.before.as_ref().map_or(json!({}), |(state, _)| state.clone());
        state["problem"] = format!("the graph has a fault and was not run: {}", sentence(faults)).into();
        // What is shown is of the run before.
        state["outdated"] = self.before.is_some().into();
        state["changes"] = changes.describe();
        self.stream.publish(serve::STATE, &state);
        Ok(None)
    }

    fn run(&mut self, checked: Checked, _: Instant) -> Result<Turn> {
        let Checked { plan, warnings, registry, .. } = checked;
        let (changes, global) = (&self.steering.changes, self.runs.global.clone());
        let stamps = Stamps::of_plan(&plan);
        let resolved = format!("{}{stamps:?}", plan.resolved);
        if let Some((state, before)) = &mut self.before
            && *before == resolved
        {
            state["changes"] = changes.describe();
            if let Some(state) = state.as_object_mut() {
                state.remove("problem");
            }
            self.stream.publish(serve::STATE, state);
            return Ok(Turn::Wait(stamps));
        }
        graph_args::warn(&warnings, &global)?;
        if let Some(node) = plan.nodes.iter().find(|node| node.role == NodeRole::LiveSource) {
            changes.fix(format!(
                "node \"{}\" is a live source, whose items cannot be repeated; change the graph, and start again",
                node.name
            ));
        }
        let dir = self.runs.folder(&plan)?;
        let graph = serve::graph_json(&plan, &registry);
        let (known, made_for) = (known_plan::of_graph(&plan), known_plan::made_for(&plan));
        *self.steering.shown() = Shown { graph: graph.clone(), plan: known, made_for };
        self.stream.restart();
        self.stream.publish_parameters(&self.steering.parameters());
        let mut serving = Serving::begin(self.stream.clone(), &plan, &graph);
        serving.add("changes", changes.describe());
        let is_first = self.runs.n == 0;
        let options = RunOptions { listener: Some(self.stream.clone()), ..self.runs.options.clone() };
        let progress = Progress::of_run(&plan, options.workers, &global);
        let run = |options: &RunOptions| run_graph(&plan, &registry, options, &progress);
        let (report, dir) = match self.runs.run(dir, options, &progress, run) {
            Ok(ran) => ran,
            Err(error) if is_first => return Err(run_error(error)),
            Err(error) => {
                serving.add("problem", format!("{error}").into());
                serving.failed();
                self.before = None;
                return Ok(self.turn(stamps));
            }
        };
        let was =
            self.before.take().map(|(state, _)| json!({ "numbers": state["numbers"], "verdict": state["verdict"] }));
        serving.add("was", was.unwrap_or(Value::Null));
        serving.add("run", dir.file_name().map(|name| name.to_string_lossy()).into());
        serving.ended(&report);
        self.before = Some((serving.state().clone(), resolved));
        run_end::print_end(&report, &dir, &global)?;
        if report.outcome == Outcome::Interrupted {
            return Ok(Turn::End(Exit::Interrupted));
        }
        if is_first && !global.quiet {
            let again = format!("; {} is run again when it changes", changes.path().display());
            let is_seen = !changes.is_fixed() && self.steering.two_files.is_none();
            let again = if is_seen { &again } else { "" };
            writeln!(terminal::stderr(), "the page stays until Ctrl-C{again}")?;
        }
        Ok(self.turn(stamps))
    }
}

impl Session {
    /// The items of a live source cannot be repeated.
    fn turn(&self, stamps: Stamps) -> Turn {
        if self.steering.changes.is_fixed() { Turn::End(Exit::Done) } else { Turn::Wait(stamps) }
    }
}
