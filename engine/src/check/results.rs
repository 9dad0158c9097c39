use super::{
    context::Check,
    parsed_nodes::ParsedNode,
    wires::{self, OutputIndex},
};
use crate::{
    fault::{Fault, Span},
    graph::{
        Entry, Graph, Value,
        extract::{self, Section},
        grammar::{self, REASONS, REQUIRE, VERDICT},
    },
    plan::Require,
};

/// The keys that the engine writes, and what they say.
const TAKEN: [(&str, &str); 2] =
    [("refused", "says why a run has no results"), (REASONS, "lists the signs that inputs are wrong")];

/// Most words with dots between them in a result's key: each is a level of `results.json`, and readers of JSON stop at 128.
const MAX_PARTS: usize = 32;

/// An entry of `[results]`.
pub(super) struct Result {
    pub(super) key: String,
    pub(super) key_at: Span,
    pub(super) from: OutputIndex,
    pub(super) all: bool,
    pub(super) optional: bool,
}

/// The contents of `[results]`.
#[derive(Default)]
pub(super) struct Results {
    /// The entries, in the order of the file.
    pub(super) entries: Vec<Result>,
    pub(super) require: Require,
}

impl Check<'_> {
    /// Reads `[results]`.
    pub(super) fn results(&mut self, graph: &Graph, parsed_nodes: &[ParsedNode<'_>]) -> Results {
        let Some(entry) = graph.table.get("results") else { return Results::default() };
        let Some(table) = extract::table(&entry.value, "results", &mut self.faults) else { return Results::default() };
        for (index, entry) in table.0.iter().enumerate() {
            self.key(entry, &table.0[..index]);
        }
        let require = table.get(REQUIRE).map(|entry| self.require(entry, table.get(VERDICT).is_some()));
        let entries = table.0.iter().filter(|entry| entry.key != REQUIRE);
        let entries = entries.filter_map(|entry| self.result(entry, parsed_nodes)).collect();
        Results { entries, require: require.unwrap_or_default() }
    }

    /// The answer that the verdict must give at least.
    fn require(&mut self, entry: &Entry, has_verdict: bool) -> Require {
        if !has_verdict {
            let fault = Fault::new("[results] says what it requires of the verdict, but the graph has no verdict");
            let removed = self.names.removed.at("results.verdict");
            let fault = removed.into_iter().fold(fault.at(&entry.key_at, "of no verdict"), |fault, at| {
                fault.also(at, "the verdict is removed here")
            });
            let help = "add verdict = \"node.port\", a wire with the verdict on the results, or remove require";
            self.faults.push(fault.help(help));
        }
        match entry.value.as_text() {
            Some("doubtful") => Require::Doubtful,
            Some("trusted") => Require::Trusted,
            text => {
                let found = text.map_or_else(|| entry.value.found(), |text| format!("\"{text}\""));
                let fault = Fault::new(format!("require takes \"doubtful\" or \"trusted\", found {found}"));
                let help = "\"trusted\" refuses doubtful results, \"doubtful\" lets them pass; no result can be called \
                            require";
                self.faults.push(fault.at(&entry.value.at, "not known").help(help));
                Require::default()
            }
        }
    }

    fn key(&mut self, entry: &Entry, before: &[Entry]) {
        let key = &entry.key;
        let n_parts = key.split('.').count();
        if n_parts > MAX_PARTS {
            let message = format!("a result's key has {n_parts} parts, at most {MAX_PARTS} are possible");
            self.faults.push(
                Fault::new(message).at(&entry.key_at, "too many").help("write fewer words with dots between them"),
            );
        }
        if key.split('.').any(str::is_empty) {
            let fault = Fault::new(format!("a result cannot be called {key:?}")).at(&entry.key_at, "a part is empty");
            self.faults.push(fault.help("write words with dots between them: \"poses.t_ct_world\""));
        }
        if let Some((taken, what)) = TAKEN.iter().find(|(taken, _)| key.split('.').next() == Some(taken)) {
            let fault = Fault::new(format!("a result cannot be called \"{key}\"")).at(&entry.key_at, "taken");
            self.faults.push(fault.help(format!("\"{taken}\" {what}; choose another name")));
        }
        let inside = |outer: &str, inner: &str| inner.strip_prefix(outer).is_some_and(|rest| rest.starts_with('.'));
        if inside(VERDICT, key) || inside(REQUIRE, key) {
            let fault = Fault::new(format!("a result cannot be called \"{key}\"")).at(&entry.key_at, "taken");
            let help = match inside(VERDICT, key) {
                true => "\"verdict\" is one wire, with the verdict on the results: verdict = \"node.port\"",
                false => "\"require\" is the answer that the verdict must give at least; choose another name",
            };
            self.faults.push(fault.help(help));
            return;
        }
        let clash = before.iter().find(|other| inside(&other.key, key) || inside(key, &other.key));
        if let Some(other) = clash {
            let (outer, inner) = if inside(&other.key, key) { (&other.key, key) } else { (key, &other.key) };
            let message = format!("result \"{inner}\" lies inside \"{outer}\", which is a result itself");
            let fault = Fault::new(message).at(&entry.key_at, "one of them has to go");
            self.faults.push(fault.also(&other.key_at, "the other").help("give one of them another name"));
        }
    }

    fn result(&mut self, entry: &Entry, parsed_nodes: &[ParsedNode<'_>]) -> Option<Result> {
        let owner = format!("result \"{}\"", entry.key);
        let (mut all, mut optional) = (false, false);
        if let Value::Table(table) = &entry.value.value {
            let table = Section::new(table, &grammar::RESULT, &owner, &owner, &mut self.faults);
            for (key, slot) in [("all", &mut all), ("optional", &mut optional)] {
                *slot = table.flag(key, &mut self.faults);
                if *slot && entry.key == VERDICT {
                    self.refuse_flag_of_verdict(key, &table);
                }
            }
        }
        let (text, at) = wires::named(entry, &owner, "wire", &mut self.faults)?;
        if let Some(fault) = self.lost_result(entry, parsed_nodes) {
            self.faults.push(fault);
            return None;
        }
        let from = wires::find(text, at, &owner, parsed_nodes, &self.names, &mut self.faults)?;
        Some(Result { key: entry.key.clone(), key_at: entry.key_at.clone(), from, all, optional })
    }

    /// A fault for `all` or `optional` of the verdict.
    fn refuse_flag_of_verdict(&mut self, key: &str, table: &Section<'_>) {
        let Some(flag) = table.get(key) else { return };
        let (message, help) = match key {
            "all" => ("there is one verdict, the last value of its wire", "remove all"),
            _ => ("the verdict is never optional: results without one would pass unjudged", "remove optional"),
        };
        self.faults.push(Fault::new(message).at(&flag.key_at, "not here").help(help));
    }
}
