//! Serving the page and the stream to viewers: the options, and what is said about the run.

mod graph;
pub(crate) mod known_plan;
pub(crate) mod picks;

pub(crate) use graph::{as_json as graph_json, stage};

use super::{global::Global, terminal};
use crate::app::refusal_in_short;
use anyhow::{Context, Result};
use clap::Args;
use osteoflow_engine::{
    Recording,
    plan::Plan,
    run::{Outcome, RunReport},
};
use osteoflow_node::Role as NodeRole;
use osteoflow_viewer::{App, Role, ServeOptions, Server, Stream};
use serde_json::{Map, Value, json};
use std::{
    io::Write,
    net::{IpAddr, Ipv4Addr, SocketAddr},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::Duration,
};

/// The topic that the page reads first: what is shown, and how it ended.
pub(crate) const STATE: &str = "/viewer/state";
/// The topic with the nodes of the graph.
const GRAPH: &str = "/viewer/graph";
/// Interval at which the end is looked for.
const LOOK: Duration = Duration::from_millis(50);

/// Who may connect to the page and the stream.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct Admission {
    /// Serve on an address that other machines reach, without encryption: everyone in the network who has the address
    /// with its token may do what its role says.
    #[arg(long)]
    serve_public: bool,

    /// What the printed address allows, each role what those before it do: see; steer (numbers, switches and kinds, and playing); write
    /// (paths, and saving picks and the graph). see,steer prints two addresses. Default: write, with --serve-public see.
    #[arg(long, value_name = "ROLE", value_delimiter = ',', value_parser = |word: &str| word.parse::<Role>())]
    role: Vec<Role>,

    /// Let web pages of this origin connect, such as https://app.foxglove.dev, or show the page in a frame: to see, with =steer or =write to
    /// do as much as the address. May be given again. Desktop viewers need no permission.
    #[arg(long, value_name = "ORIGIN[=ROLE]")]
    allow_origin: Vec<String>,
}

impl Admission {
    /// Listens, and prints the addresses.
    pub(crate) fn serve(
        &self,
        address: SocketAddr,
        name: &str,
        stream: Arc<Stream>,
        app: Arc<dyn App>,
        global: &Global,
    ) -> Result<Server> {
        if !address.ip().is_loopback() && !self.serve_public {
            usage!(
                "{} is reached by other machines, without encryption; add --serve-public if that is wanted, or serve on \
                 the loopback and forward the port by ssh",
                address.ip()
            );
        }
        let mut allowed_origins = Vec::new();
        for given in &self.allow_origin {
            let (origin, role) = given.split_once('=').unwrap_or((given, "see"));
            let rest = origin.split_once("://").map_or("", |(_, rest)| rest);
            if rest.is_empty() || rest.contains(['/', '*', ' ', ';', ',', '\r', '\n']) {
                usage!("--allow-origin {given}: an origin is a scheme and a host, such as https://app.foxglove.dev");
            }
            match role.parse() {
                Ok(role) => allowed_origins.push((origin.to_owned(), role)),
                Err(why) => usage!("--allow-origin {given}: {why}"),
            }
        }
        let options = ServeOptions { address, allowed_origins, name: name.to_owned() };
        let server = Server::start(options, stream, app).with_context(|| format!("{address} cannot be served"))?;
        let default = [if self.serve_public { Role::See } else { Role::Write }];
        for role in if self.role.is_empty() { &default[..] } else { &self.role } {
            let may = match role {
                Role::See => " may see; --role steer or write prints one that may more",
                Role::Steer => " may see and steer",
                Role::Write => "",
            };
            global.say("page", format!("{}{may}", server.page(*role)))?;
            let viewers = "for Foxglove and Lichtblick on the desktop; for their web pages add --allow-origin ORIGIN";
            global.say("stream", format!("{} {viewers}", server.stream_address(*role)))?;
        }
        Ok(server)
    }
}

/// Reads an address: `HOST:PORT`, `:PORT` or `PORT` on the loopback, or `HOST` with a free port.
pub(crate) fn address(text: &str) -> Result<SocketAddr, String> {
    let port = |text: &str| text.strip_prefix(':').unwrap_or(text).parse().ok();
    let known = text
        .parse()
        .ok()
        .or_else(|| port(text).map(|port: u16| (Ipv4Addr::LOCALHOST, port).into()))
        .or_else(|| text.parse::<IpAddr>().ok().map(|ip| (ip, 0).into()))
        .or_else(|| (text == "localhost").then(|| (Ipv4Addr::LOCALHOST, 0).into()));
    known.ok_or_else(|| "an address is HOST:PORT, such as 127.0.0.1:8765, or a PORT of the loopback".into())
}

/// A run that is served.
pub(crate) struct Serving {
    stream: Arc<Stream>,
    /// The last state that was published.
    state: Value,
}

impl Serving {
    /// Says that the run begins.
    pub(crate) fn begin(stream: Arc<Stream>, plan: &Plan, graph: &Value) -> Self {
        let is_live = plan.nodes.iter().any(|node| node.role == NodeRole::LiveSource);
        let of_results =
            plan.results.iter().find(|entry| entry.key == "verdict").map(|entry| plan.wire_name(entry.from));
        let origin = if is_live { "live" } else { "recorded" };
        let state = json!({ "name": plan.name, "state": "running", "origin": origin, "verdict_wire": of_results });
        stream.publish(STATE, &state);
        stream.publish(GRAPH, graph);
        Self { stream, state }
    }

    /// Publishes something more about the run.
    pub(crate) fn add(&mut self, key: &str, value: Value) {
        self.state[key] = value;
        self.stream.publish(STATE, &self.state);
    }

    /// The last state that was published.
    pub(crate) fn state(&self) -> &Value {
        &self.state
    }

    /// Says that the run gave nothing.
    pub(crate) fn failed(&mut self) {
        self.add("state", "failed".into());
    }

    /// Says how the run ended.
    pub(crate) fn ended(&mut self, report: &RunReport) {
        self.state["state"] = report.outcome.status().into();
        if let Outcome::Refused(refusal) = &report.outcome {
            self.state["refusal"] = refusal_in_short(refusal, &report.results).into();
        }
        add_results(&mut self.state, &report.results);
        self.stream.publish(STATE, &self.state);
    }
}

/// Serves until Ctrl-C, then says how much was sent.
pub(crate) fn wait(server: Server, cancelled: &AtomicBool, global: &Global) -> Result<()> {
    while !cancelled.load(Ordering::Relaxed) {
        thread::sleep(LOOK);
    }
    let totals = server.end();
    if totals.n_dropped > 0 && !global.quiet {
        let n_all = totals.n_sent + totals.n_dropped;
        writeln!(
            terminal::stderr(),
            "note: slow viewers lost {} of {n_all} messages; the run lost none",
            totals.n_dropped
        )?;
    }
    Ok(())
}

/// Says what a recording is; its graph is listed if this program has its kinds.
pub(crate) fn recorded(stream: &Stream, name: &str, recording: Option<&Recording>, problem: Option<&str>) {
    let problem = problem.map(|problem| format!("the recording is damaged: {problem}"));
    let mut state = json!({ "name": name, "state": "recorded", "origin": "recorded", "problem": problem });
    if let Some(results) = recording.and_then(|recording| recording.results.as_ref()) {
        add_results(&mut state, results);
    }
    stream.publish(STATE, &state);
    if let Some(checked) = recording.and_then(known_plan::graph) {
        stream.publish(GRAPH, &graph_json(&checked.plan, &checked.registry));
    }
}

fn add_results(state: &mut Value, results: &Value) {
    state["verdict"] = results["verdict"].clone();
    if results["simulated"] == true {
        state["simulated"] = true.into();
    }
    state["numbers"] = numbers(results).into();
}

/// The numbers that a user looks at first.
fn numbers(results: &Value) -> Map<String, Value> {
    let mut numbers = Map::new();
    let mut put = |name: &str, value: &Value| {
        if value.is_number() {
            numbers.insert(name.to_owned(), value.clone());
        }
    };
    put("surface residual RMS, mm", &results["icp"]["rms_mm"]);
    put("pairs", &results["icp"]["n_pairs"]);
    put("weakest motion, mm per mm", &results["icp"]["observability"]["weakest"]["residual_per_mm"]);
    for (name, metric) in results["metrics"].as_object().into_iter().flatten() {
        let name = name.trim_end_matches("_mm").replace('_', " ");
        put(&format!("{name}, mean, mm"), &metric["mean_abs"]["norm"]);
    }
    numbers
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_may_lack_its_host_or_its_port() {
        for (text, expected) in [
            ("127.0.0.1:8765", "127.0.0.1:8765"),
            (":8765", "127.0.0.1:8765"),
            ("8765", "127.0.0.1:8765"),
            ("0.0.0.0", "0.0.0.0:0"),
            ("localhost", "127.0.0.1:0"),
            ("[::1]:80", "[::1]:80"),
        ] {
            assert_eq!(address(text), Ok(expected.parse().unwrap()), "{text}");
        }
        for text in ["", "example.org:80", "70000", "-1", "localhost:80:80"] {
            assert!(address(text).is_err(), "{text}");
        }
    }
}
