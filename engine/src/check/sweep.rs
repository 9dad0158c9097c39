//! Reads `[sweep]` of a graph file; all faults at once, each at its line.

mod draw;
mod factor;
mod files;
mod paths;
mod sets;
mod spec;

pub use crate::graph::Variant;
pub use spec::{Column, Compare, Distribution, Draw, Factor, Level, PointColumn, Spec};

use crate::{
    fault::{Fault, Span},
    graph::{
        Entry, Graph, Spanned, Table, Value,
        extract::{self, Section},
        grammar,
    },
    names::nearest,
};

/// Default of `twice`: a hundred runs cost two more, and a kind that differs in one run of twenty is found in most sweeps of a
/// thousand.
const TWICE: f64 = 0.02;

/// Default name of the repeats in the tables.
const REPEAT: &str = "repeat";

/// Columns that the sweep writes itself; no factor or column may have these names.
const OWN: [&str; 10] = ["run", "seed", "status", "verdict", "reason", "measure", "point", "axis", "value", "value_mm"];

/// Maximum number of repeats, and of runs of a sweep.
const MAX_RUNS: u64 = 1_000_000;

/// Reads `[sweep]` of a graph; `None` if it has none.
pub(crate) fn read(graph: &Graph, faults: &mut Vec<Fault>) -> Option<Spec> {
    let table = &graph.table;
    let entry = table.get("sweep")?;
    let results = table.get("results").and_then(|entry| entry.value.as_table());
    let results = results.into_iter().flat_map(Table::keys).filter(|key| *key != grammar::REQUIRE);
    let results = results.map(str::to_owned).collect();
    let nodes = table.get("node").and_then(|entry| entry.value.as_table());
    let nodes = nodes.into_iter().flat_map(Table::keys).map(str::to_owned).collect();
    let table = extract::table(&entry.value, "sweep", faults)?;
    Reader { graph, at: &entry.key_at, faults }.spec(table, results, nodes)
}

struct Reader<'a> {
    graph: &'a Graph,
    at: &'a Span,
    faults: &'a mut Vec<Fault>,
}

impl Reader<'_> {
    fn spec(&mut self, table: &Table, mut results: Vec<String>, nodes: Vec<String>) -> Option<Spec> {
        let before = self.faults.len();
        let own = Section::new(table, &grammar::SWEEP, "[sweep]", "", self.faults);
        let repeat = own.whole("repeat", MAX_RUNS, self.faults).unwrap_or(1);
        let same_seed = own.flag("same_seed", self.faults);
        let twice = own.share("twice", self.faults).unwrap_or(TWICE);
        let factors = self.tables(table, "factor", Self::factor);
        let draws = self.tables(table, "draw", Self::draw);
        let columns = self.tables(table, "columns", Self::column);
        let points = self.tables(table, "points", Self::points);
        self.unique(table);
        let (units, repeat_name) = self.units(table, &factors);
        let pair = self.pair(table, &factors);
        results.extend(self.sets(table, &factors, &draws, &pair, same_seed));
        self.paths(table, &results, &nodes);
        let limits = self.numbers(table.get("limit"), "limit", &columns);
        let compare = table.get("compare").map(|entry| self.comparisons(&entry.value, &factors, &columns));
        let compare = compare.unwrap_or_default();
        let spec = Spec {
            repeat,
            repeat_name,
            same_seed,
            twice,
            factors,
            pair,
            draws,
            units,
            columns,
            points,
            limits,
            compare,
        };
        if self.faults.len() == before && spec.n_runs().is_none_or(|n| n as u64 > MAX_RUNS) {
            let fault = Fault::new(format!("the sweep has more than {MAX_RUNS} runs")).at(self.at, "too many");
            self.faults.push(fault.help("take fewer values, or pair factors that go together"));
        }
        (self.faults.len() == before).then_some(spec)
    }

    fn fault(&mut self, at: &Span, message: impl Into<String>, label: &str, help: &str) {
        self.faults.push(Fault::new(message).at(at, label).help(help));
    }

    fn tables<T>(&mut self, table: &Table, key: &str, read: fn(&mut Self, &Entry) -> Option<T>) -> Vec<T> {
        let Some(entry) = table.get(key) else { return Vec::new() };
        let Some(inner) = extract::table(&entry.value, &format!("sweep.{key}"), self.faults) else { return Vec::new() };
        inner.0.iter().filter_map(|entry| read(self, entry)).collect()
    }

    /// Checks that each column of the tables has a unique name.
    fn unique(&mut self, table: &Table) {
        let mut seen: Vec<&Entry> = Vec::new();
        for key in ["factor", "draw", "columns"] {
            let entries = table.get(key).and_then(|entry| entry.value.as_table()).into_iter().flat_map(|t| &t.0);
            for entry in entries {
                if OWN.contains(&entry.key.as_str()) || !extract::is_name(&entry.key) {
                    let message = format!("a column of the sweep cannot be called \"{}\"", entry.key);
                    let help = "take letters, digits, _ and -, and none of the names that every table has: run, seed, \
                                status, verdict, reason, measure, point, axis, value";
                    self.fault(&entry.key_at, message, "taken, or no plain name", help);
                }
                if let Some(first) = seen.iter().find(|first| first.key == entry.key) {
                    let fault = Fault::new(format!("two columns of the sweep are called \"{}\"", entry.key));
                    let fault = fault.at(&entry.key_at, "the second").also(&first.key_at, "the first");
                    self.faults.push(fault.help("give one of them another name"));
                }
                seen.push(entry);
            }
        }
    }

    fn keys(&mut self, table: &Section<'_>, owner: &str, needed: bool) -> Vec<String> {
        match (table.get("key"), table.get("keys")) {
            (Some(_), None) => table.text("key", self.faults).map(str::to_owned).into_iter().collect(),
            (None, Some(entry)) => self.texts(&entry.value, &table.what("keys")),
            (Some(_), Some(second)) => {
                self.fault(&second.key_at, format!("{owner} has key and keys"), "the second", "keep one of them");
                Vec::new()
            }
            (None, None) => {
                if needed {
                    let help = "add key = \"NODE.PARAMETER\", as --set takes it, or keys = [..] for several at once";
                    let at = table.first().map_or(self.at, |entry| &entry.key_at).clone();
                    self.fault(&at, format!("{owner} does not say what it sets"), "no key here", help);
                }
                Vec::new()
            }
        }
    }

    fn texts(&mut self, value: &Spanned, what: &str) -> Vec<String> {
        let Value::Array(items) = &value.value else {
            self.faults.push(extract::refused(value, format!("{what} takes a list of texts"), "a list is needed"));
            return Vec::new();
        };
        items.iter().filter_map(|item| extract::text(item, what, self.faults).map(str::to_owned)).collect()
    }

    fn column(&mut self, entry: &Entry) -> Option<Column> {
        let path = extract::text(&entry.value, &format!("column \"{}\"", entry.key), self.faults)?;
        Some(Column { name: entry.key.clone(), path: path.into() })
    }

    fn points(&mut self, entry: &Entry) -> Option<PointColumn> {
        let owner = format!("points \"{}\"", entry.key);
        let table = extract::table(&entry.value, &owner, self.faults)?;
        let table = Section::new(table, &grammar::POINTS, &owner, &*owner, self.faults);
        if table.get("from").is_none() {
            let help = "add from = \"metrics.tre_true_mm.points\", a list in results.json";
            self.fault(&entry.key_at, format!("{owner} does not say its list"), "no from", help);
            return None;
        }
        let path = table.text("from", self.faults)?.to_owned();
        let label = match table.get("name") {
            Some(_) => table.text("name", self.faults)?.to_owned(),
            None => "name".into(),
        };
        let axes = match table.get("axes") {
            Some(entry) => self.texts(&entry.value, &table.what("axes")),
            None => ["x", "y", "z"].map(str::to_owned).to_vec(),
        };
        Some(PointColumn { name: entry.key.clone(), path, label, axes })
    }

    /// The units, and the name of the repeats.
    fn units(&mut self, table: &Table, factors: &[Factor]) -> (Vec<String>, String) {
        let Some(entry) = table.get("units") else { return (vec![REPEAT.into()], REPEAT.into()) };
        let units = self.texts(&entry.value, "units");
        let is_factor = |unit: &String| factors.iter().any(|factor| factor.name == *unit);
        let others: Vec<_> = units.iter().filter(|unit| !is_factor(unit)).cloned().collect();
        if others.len() > 1 {
            let message = format!(
                "units {} and {} are no factors",
                quoted(&others[..others.len() - 1]),
                quoted(&others[others.len() - 1..])
            );
            let fault = Fault::new(message).at(&entry.value.at, "one name at most may stand for the repeats");
            let factors = || factors.iter().map(|factor| factor.name.as_str());
            let help = nearest::help(&others[1], factors());
            self.faults.push(fault.help_if(help).note_if(nearest::list("factors", factors())));
        } else if let Some(other) = others.first() {
            // Suggest only factors that are not already listed.
            let unnamed =
                factors.iter().map(|factor| factor.name.as_str()).filter(|name| !units.iter().any(|u| u == name));
            if let Some(near) = nearest::name(other, unnamed) {
                let fault = Fault::new(format!("unit \"{other}\" is no factor, but nearly the factor \"{near}\""));
                let fault = fault.at(&entry.value.at, "one name may stand for the repeats, but hardly this");
                let help = format!("did you mean \"{near}\"? else give the repeats a name that is not so near");
                self.faults.push(fault.help(help));
            }
        }
        let name = others.into_iter().next().unwrap_or_else(|| REPEAT.into());
        let mut units = units;
        if !units.contains(&name) {
            // Repeats are nested in the factors unless `units` places them.
            units.push(name.clone());
        }
        (units, name)
    }

    fn pair(&mut self, table: &Table, factors: &[Factor]) -> Vec<Vec<String>> {
        let Some(entry) = table.get("pair") else { return Vec::new() };
        let Value::Array(items) = &entry.value.value else {
            let fault = extract::refused(&entry.value, "pair takes lists of factors", "a list is needed");
            self.faults.push(fault.help("write pair = [[\"a\", \"b\"]]"));
            return Vec::new();
        };
        // `pair = ["a", "b"]` means one pair.
        let flat = items.iter().all(|item| item.as_text().is_some());
        let groups: Vec<_> = match flat {
            true => vec![self.texts(&entry.value, "pair")],
            false => items.iter().map(|item| self.texts(item, "pair")).collect(),
        };
        let mut seen: Vec<&String> = Vec::new();
        for group in &groups {
            let mut lengths = Vec::new();
            for name in group {
                let Some(factor) = factors.iter().find(|factor| factor.name == *name) else {
                    let fault = Fault::new(format!("there is no factor \"{name}\" to pair"));
                    let help = nearest::help(name, factors.iter().map(|factor| factor.name.as_str()));
                    self.faults.push(fault.at(&entry.value.at, "no factor").help_if(help));
                    continue;
                };
                if seen.contains(&name) {
                    self.fault(&entry.value.at, format!("factor \"{name}\" is paired twice"), "twice", "name it once");
                }
                seen.push(name);
                lengths.push(factor.levels.len());
            }
            if lengths.iter().any(|n| *n != lengths[0]) {
                let message = format!("paired factors {} have different numbers of values: {lengths:?}", quoted(group));
                self.fault(&entry.value.at, message, "value by value", "give them equally many values, or cross them");
            }
        }
        groups
    }

    fn numbers(&mut self, entry: Option<&Entry>, what: &str, columns: &[Column]) -> Vec<(String, f64)> {
        let Some(entry) = entry else { return Vec::new() };
        let Some(table) = extract::table(&entry.value, what, self.faults) else { return Vec::new() };
        let mut out = Vec::new();
        for entry in &table.0 {
            let number = entry.value.as_number().unwrap_or(f64::NAN);
            if !columns.iter().any(|column| column.name == entry.key) {
                let fault = Fault::new(format!("{what}: there is no column \"{}\"", entry.key));
                let help = nearest::help(&entry.key, columns.iter().map(|column| column.name.as_str()));
                self.faults.push(fault.at(&entry.key_at, "no column").help_if(help));
            } else if !(number.is_finite() && number > 0.0) {
                let message = format!("{what} of \"{}\" takes a number above zero", entry.key);
                self.faults.push(Fault::new(message).at(&entry.value.at, "another is needed"));
            } else {
                out.push((entry.key.clone(), number));
            }
        }
        out
    }

    /// One comparison, or a list of comparisons of distinct factors.
    fn comparisons(&mut self, value: &Spanned, factors: &[Factor], columns: &[Column]) -> Vec<Compare> {
        let items = match &value.value {
            Value::Array(items) => items.as_slice(),
            _ => std::slice::from_ref(value),
        };
        let mut comparisons: Vec<Compare> = Vec::new();
        for item in items {
            let Some(compare) = self.compare(item, factors, columns) else { continue };
            if comparisons.iter().any(|earlier| earlier.factor == compare.factor) {
                let message = format!("factor \"{}\" is compared twice", compare.factor);
                self.fault(&item.at, message, "twice", "compare it with one of its values");
            }
            comparisons.push(compare);
        }
        comparisons
    }

    fn compare(&mut self, value: &Spanned, factors: &[Factor], columns: &[Column]) -> Option<Compare> {
        let table = extract::table(value, "compare", self.faults)?;
        let table = Section::new(table, &grammar::COMPARE, "sweep.compare", "compare", self.faults);
        let margins = self.numbers(table.get("margin"), "margin", columns);
        let name = table.text("factor", self.faults);
        let factor = name.and_then(|name| factors.iter().find(|factor| factor.name == name));
        let Some(factor) = factor else {
            self.fault(&value.at, "compare needs the name of a factor", "no factor", "add factor = \"icp\"");
            return None;
        };
        let to = table.get("to").map_or(factor.levels[0].label.clone(), |entry| entry.value.to_json());
        if !factor.levels.iter().any(|level| level.label == to) {
            let message = format!("factor \"{}\" has no value {to} to compare with", factor.name);
            self.fault(&value.at, message, "no such value", "name one of its values or labels");
        }
        Some(Compare { factor: factor.name.clone(), to, margins })
    }
}

fn quoted(names: &[String]) -> String {
    names.iter().map(|name| format!("\"{name}\"")).collect::<Vec<_>>().join(", ")
}
