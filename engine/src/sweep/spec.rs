//! What `[sweep]` says: which values a graph is run with, and which numbers are taken out of each run.

use crate::{
    check::{nearest, take},
    fault::{Fault, Span},
    graph::{Entry, Spanned, Table, Value},
};
use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

/// What the repeats are called where `units` does not name them.
const REPEAT: &str = "repeat";

/// Columns of the tables that the sweep writes itself.
pub(crate) const OWN: [&str; 9] = ["run", "seed", "status", "reason", "measure", "point", "axis", "value", "value_mm"];

/// The most repeats, and the most runs of a sweep.
pub(super) const MOST_RUNS: usize = 1_000_000;

/// The table `[sweep]` of a graph file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Spec {
    /// How often every setting is run.
    pub repeat: usize,
    /// What a repeat is, such as `procedure`.
    pub repeat_name: String,
    /// Whether all repeats have the graph's seed, so that only what is drawn tells them apart.
    pub same_seed: bool,
    /// What is varied by a list of values, in the order of the file: the first varies slowest.
    pub factors: Vec<Factor>,
    /// Factors that go together, value by value; all others are crossed.
    pub pair: Vec<Vec<String>>,
    /// What is drawn anew for each repeat, and is the same under all factors.
    pub draws: Vec<Draw>,
    /// What is resampled and counted, the highest first: names of factors, and of the repeats.
    pub units: Vec<String>,
    /// Numbers and words taken out of the results of each run.
    pub columns: Vec<Column>,
    /// Lists of points taken out of the results of each run.
    pub points: Vec<PointColumn>,
    /// Limits of columns: the share of runs below is told.
    pub limits: Vec<(String, f64)>,
    /// What is compared, paired by all that is not this factor.
    pub compare: Option<Compare>,
}

/// Something that is varied by a list of values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Factor {
    /// Its name, and that of its column.
    pub name: String,
    /// Its values.
    pub levels: Vec<Level>,
}

/// A value of a factor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Level {
    /// What stands in the table.
    pub label: Json,
    /// What it sets in the graph, as `--set` takes it.
    pub sets: Vec<String>,
}

/// Something that is drawn at random.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Draw {
    /// Its name, and that of its column.
    pub name: String,
    /// The keys that it sets.
    pub keys: Vec<String>,
    /// How it is distributed.
    #[serde(flatten)]
    pub distribution: Distribution,
}

/// How a value is distributed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Distribution {
    /// Evenly from the first number to the second.
    Uniform([f64; 2]),
    /// Normally, by mean and standard deviation.
    Normal([f64; 2]),
    /// Evenly in the logarithm, from the first number to the second, both above zero.
    LogUniform([f64; 2]),
    /// A whole number from the first to the second, both included.
    Integers([i64; 2]),
    /// One of a list.
    Choice(Vec<Json>),
}

/// A number or word of each run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Column {
    /// Its name, which ends in its unit: `tre_z_mm`.
    pub name: String,
    /// Where it stands in `results.json`: `metrics.tre_true_mm.mean_signed.z`.
    pub path: String,
}

/// A list of points of each run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PointColumn {
    /// What is measured at the points, with its unit: `tre_mm`.
    pub name: String,
    /// Where the list stands in `results.json`.
    pub path: String,
    /// The key of a point's name; its number where it has none.
    pub label: String,
    /// The keys of its values.
    pub axes: Vec<String>,
}

/// What is compared with what.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Compare {
    /// The factor whose values are compared.
    pub factor: String,
    /// The value that all others are compared with.
    pub to: Json,
    /// For a column, the largest difference that does not matter: for the test of equivalence.
    pub margins: Vec<(String, f64)>,
}

/// Reads `[sweep]` of a graph; `None` if it has none.
pub(crate) fn read(table: &Table, faults: &mut Vec<Fault>) -> Option<Spec> {
    let entry = table.get("sweep")?;
    let table = take::table(&entry.value, "sweep", faults)?;
    Reader { at: &entry.key_at, faults }.spec(table)
}

const KEYS: [&str; 10] =
    ["repeat", "same_seed", "units", "pair", "factor", "draw", "columns", "points", "limit", "compare"];

struct Reader<'a> {
    at: &'a Span,
    faults: &'a mut Vec<Fault>,
}

impl Reader<'_> {
    fn spec(&mut self, table: &Table) -> Option<Spec> {
        let before = self.faults.len();
        take::only(table, &KEYS, "[sweep]", self.faults);
        let repeat = table.get("repeat").map_or(Some(1), |entry| {
            take::whole(&entry.value, "repeat", 1, MOST_RUNS as u64, self.faults).map(|n| n as usize)
        });
        let same_seed = table.get("same_seed").and_then(|entry| take::boolean(&entry.value, "same_seed", self.faults));
        let factors = self.tables(table, "factor", Self::factor);
        let draws = self.tables(table, "draw", Self::draw);
        let columns = self.tables(table, "columns", Self::column);
        let points = self.tables(table, "points", Self::points);
        self.unique(table);
        let (units, repeat_name) = self.units(table, &factors);
        let pair = self.pair(table, &factors);
        let limits = self.numbers(table.get("limit"), "limit", &columns);
        let compare = table.get("compare").and_then(|entry| self.compare(entry, &factors, &columns));
        let spec = Spec {
            repeat: repeat?,
            repeat_name,
            same_seed: same_seed.unwrap_or(false),
            factors,
            pair,
            draws,
            units,
            columns,
            points,
            limits,
            compare,
        };
        if self.faults.len() == before && spec.n_runs().is_none_or(|n| n > MOST_RUNS) {
            let fault = Fault::new(format!("the sweep has more than {MOST_RUNS} runs")).at(self.at, "too many");
            self.faults.push(fault.help("take fewer values, or pair factors that go together"));
        }
        (self.faults.len() == before).then_some(spec)
    }

    fn fault(&mut self, at: &Span, message: impl Into<String>, label: &str, help: &str) {
        self.faults.push(Fault::new(message).at(at, label).help(help));
    }

    fn tables<T>(&mut self, table: &Table, key: &str, read: fn(&mut Self, &Entry) -> Option<T>) -> Vec<T> {
        let Some(entry) = table.get(key) else { return Vec::new() };
        let Some(inner) = take::table(&entry.value, &format!("sweep.{key}"), self.faults) else { return Vec::new() };
        inner.0.iter().filter_map(|entry| read(self, entry)).collect()
    }

    /// Every column of the tables has a name of its own.
    fn unique(&mut self, table: &Table) {
        let mut seen: Vec<&Entry> = Vec::new();
        for key in ["factor", "draw", "columns"] {
            let entries = table.get(key).and_then(|entry| entry.value.as_table()).into_iter().flat_map(|t| &t.0);
            for entry in entries {
                if OWN.contains(&entry.key.as_str()) || !take::is_name(&entry.key) {
                    let message = format!("a column of the sweep cannot be called \"{}\"", entry.key);
                    let help = "take letters, digits, _ and -, and none of the names that every table has: run, seed, \
                                status, reason, measure, point, axis, value";
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

    fn keys(&mut self, table: &Table, owner: &str, needed: bool) -> Vec<String> {
        let (one, many) = (table.get("key"), table.get("keys"));
        match (one, many) {
            (Some(entry), None) => {
                take::text(&entry.value, &format!("{owner}: key"), self.faults).map(str::to_owned).into_iter().collect()
            }
            (None, Some(entry)) => self.texts(&entry.value, &format!("{owner}: keys")),
            (Some(_), Some(second)) => {
                self.fault(&second.key_at, format!("{owner} has key and keys"), "the second", "keep one of them");
                Vec::new()
            }
            (None, None) => {
                if needed {
                    let help = "add key = \"NODE.PARAMETER\", as --set takes it, or keys = [..] for several at once";
                    self.fault(
                        &table.0.first().map_or(self.at.clone(), |e| e.key_at.clone()),
                        format!("{owner} does not say what it sets"),
                        "no key here",
                        help,
                    );
                }
                Vec::new()
            }
        }
    }

    fn texts(&mut self, value: &Spanned, what: &str) -> Vec<String> {
        let Value::Array(items) = &value.value else {
            let message = format!("{what} takes a list of texts, found {}", value.found());
            self.faults.push(Fault::new(message).at(&value.at, "a list is needed"));
            return Vec::new();
        };
        items.iter().filter_map(|item| take::text(item, what, self.faults).map(str::to_owned)).collect()
    }

    fn factor(&mut self, entry: &Entry) -> Option<Factor> {
        let owner = format!("factor \"{}\"", entry.key);
        let table = take::table(&entry.value, &owner, self.faults)?;
        take::only(table, &["key", "keys", "values", "labels", "from", "to", "n", "log"], &owner, self.faults);
        let levels = match table.get("values") {
            Some(values) => self.listed(table, values, &owner)?,
            None => self.grid(table, entry, &owner)?,
        };
        if levels.is_empty() {
            self.fault(&entry.key_at, format!("{owner} has no value"), "empty", "give at least one value");
            return None;
        }
        for (index, level) in levels.iter().enumerate() {
            if levels[..index].iter().any(|before| before.label == level.label) {
                let message = format!("{owner} has the value {} twice", level.label);
                self.fault(&entry.key_at, message, "twice", "take one away, or tell them apart by labels = [..]");
                return None;
            }
        }
        Some(Factor { name: entry.key.clone(), levels })
    }

    /// `values = [..]`: a table as a value sets keys of its own.
    fn listed(&mut self, table: &Table, values: &Entry, owner: &str) -> Option<Vec<Level>> {
        let Value::Array(items) = &values.value.value else {
            let message = format!("{owner}: values takes a list, found {}", values.value.found());
            self.faults.push(Fault::new(message).at(&values.value.at, "a list is needed"));
            return None;
        };
        let keyed = table.get("key").is_some() || table.get("keys").is_some();
        let keys = self.keys(table, owner, items.iter().any(|item| item.as_table().is_none()));
        let labels = match table.get("labels") {
            None => None,
            Some(labels) => {
                let texts = self.texts(&labels.value, &format!("{owner}: labels"));
                if texts.len() != items.len() {
                    let message = format!("{owner} has {} values and {} labels", items.len(), texts.len());
                    self.fault(&labels.key_at, message, "one for each value", "give each value its label");
                    return None;
                }
                Some(texts)
            }
        };
        if let Some(entry) = ["from", "to", "n", "log"].iter().find_map(|key| table.get(key)) {
            self.fault(&entry.key_at, format!("{owner} has values and a range"), "a range", "keep one of them");
        }
        let level = |(index, item): (usize, &Spanned)| {
            let sets = match (item.as_table(), keyed) {
                (Some(table), false) => leaves(table, ""),
                _ => keys.iter().map(|key| format!("{key}={}", literal(item))).collect(),
            };
            let label = match &labels {
                Some(labels) => labels[index].clone().into(),
                None => item.to_json(),
            };
            Level { label, sets }
        };
        Some(items.iter().enumerate().map(level).collect())
    }

    /// `from = 0.0, to = 0.2, n = 5`, evenly spaced, with `log = true` in the logarithm.
    fn grid(&mut self, table: &Table, entry: &Entry, owner: &str) -> Option<Vec<Level>> {
        let keys = self.keys(table, owner, true);
        let mut number = |key: &str| match table.get(key).map(|entry| (&entry.value.value, &entry.value)) {
            Some((Value::Int(n), _)) => Some(*n as f64),
            Some((Value::Float(x), _)) if x.is_finite() => Some(*x),
            found => {
                let at = found.map_or(&entry.key_at, |(_, value)| &value.at);
                let fault = Fault::new(format!("{owner} needs values = [..], or from, to and n"));
                self.faults
                    .push(fault.at(at, format!("no number for {key}")).help("such as from = 0.0, to = 1.0, n = 5"));
                None
            }
        };
        let (from, to) = (number("from")?, number("to")?);
        let n = table.get("n").and_then(|e| take::whole(&e.value, "n", 2, MOST_RUNS as u64, self.faults));
        let Some(n) = n else {
            self.fault(&entry.key_at, format!("{owner} does not say how many values"), "no n", "add n = 5");
            return None;
        };
        let log = table.get("log").and_then(|e| take::boolean(&e.value, "log", self.faults)).unwrap_or(false);
        if log && (from <= 0.0 || to <= 0.0) {
            self.fault(
                &entry.key_at,
                format!("{owner}: a range by logarithm lies above zero"),
                "not above zero",
                "begin above zero",
            );
            return None;
        }
        let value = |k: u64| {
            let s = k as f64 / (n - 1) as f64;
            let even = |a: f64, b: f64| a + s * (b - a);
            match (k, log) {
                (0, _) => from,
                (k, _) if k == n - 1 => to,
                (_, false) => even(from, to),
                (_, true) => even(from.ln(), to.ln()).exp(),
            }
        };
        let level = |k| {
            let value = value(k);
            Level { label: value.into(), sets: keys.iter().map(|key| format!("{key}={value:?}")).collect() }
        };
        Some((0..n).map(level).collect())
    }

    fn draw(&mut self, entry: &Entry) -> Option<Draw> {
        let owner = format!("draw \"{}\"", entry.key);
        let table = take::table(&entry.value, &owner, self.faults)?;
        const WAYS: [&str; 5] = ["uniform", "normal", "log_uniform", "integers", "choice"];
        take::only(table, &[&["key", "keys"], &WAYS[..]].concat(), &owner, self.faults);
        let keys = self.keys(table, &owner, true);
        let mut ways = WAYS.iter().filter_map(|way| table.get(way));
        let (Some(way), None) = (ways.next(), ways.next()) else {
            let help = "add one of uniform = [FROM, TO], normal = [MEAN, SD], log_uniform = [FROM, TO], integers = [FROM, TO], choice = [..]";
            self.fault(&entry.key_at, format!("{owner} needs one distribution"), "none, or more than one", help);
            return None;
        };
        let distribution = distribution(way);
        if distribution.is_none() {
            let takes = match way.key.as_str() {
                "normal" => "mean and standard deviation, the latter not below zero",
                "log_uniform" => "two numbers above zero, the smaller first",
                "integers" => "two whole numbers, the smaller first",
                "choice" => "a list of values",
                _ => "two numbers, the smaller first",
            };
            let message = format!("{owner}: {} takes {takes}", way.key);
            self.faults.push(Fault::new(message).at(&way.value.at, "another is needed"));
        }
        Some(Draw { name: entry.key.clone(), keys, distribution: distribution? })
    }

    fn column(&mut self, entry: &Entry) -> Option<Column> {
        let path = take::text(&entry.value, &format!("column \"{}\"", entry.key), self.faults)?;
        Some(Column { name: entry.key.clone(), path: path.into() })
    }

    fn points(&mut self, entry: &Entry) -> Option<PointColumn> {
        let owner = format!("points \"{}\"", entry.key);
        let table = take::table(&entry.value, &owner, self.faults)?;
        take::only(table, &["from", "name", "axes"], &owner, self.faults);
        let Some(from) = table.get("from") else {
            let help = "add from = \"metrics.tre_true_mm.points\", a list in results.json";
            self.fault(&entry.key_at, format!("{owner} does not say its list"), "no from", help);
            return None;
        };
        let path = take::text(&from.value, &format!("{owner}: from"), self.faults)?.to_owned();
        let label = match table.get("name") {
            Some(entry) => take::text(&entry.value, &format!("{owner}: name"), self.faults)?.to_owned(),
            None => "name".into(),
        };
        let axes = match table.get("axes") {
            Some(entry) => self.texts(&entry.value, &format!("{owner}: axes")),
            None => ["x", "y", "z"].map(str::to_owned).to_vec(),
        };
        Some(PointColumn { name: entry.key.clone(), path, label, axes })
    }

    /// The units, and what the repeats are called.
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
            let factors: Vec<_> = factors.iter().map(|factor| factor.name.as_str()).collect();
            let help = nearest::help(&others[1], factors.iter().copied());
            self.faults.push(fault.help_if(help).note_if(nearest::list("factors", factors.iter().copied())));
        }
        let name = others.into_iter().next().unwrap_or_else(|| REPEAT.into());
        let mut units = units;
        if !units.contains(&name) {
            // Where only factors are named, the repeats lie below them.
            units.push(name.clone());
        }
        (units, name)
    }

    fn pair(&mut self, table: &Table, factors: &[Factor]) -> Vec<Vec<String>> {
        let Some(entry) = table.get("pair") else { return Vec::new() };
        let Value::Array(items) = &entry.value.value else {
            let message = format!("pair takes lists of factors, found {}", entry.value.found());
            let fault = Fault::new(message).at(&entry.value.at, "a list is needed");
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
                    let known: Vec<_> = factors.iter().map(|factor| factor.name.as_str()).collect();
                    let help = nearest::help(name, known.iter().copied());
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
        let Some(table) = take::table(&entry.value, what, self.faults) else { return Vec::new() };
        let mut out = Vec::new();
        for entry in &table.0 {
            let number = match entry.value.value {
                Value::Int(n) => n as f64,
                Value::Float(x) => x,
                _ => f64::NAN,
            };
            if !columns.iter().any(|column| column.name == entry.key) {
                let fault = Fault::new(format!("{what}: there is no column \"{}\"", entry.key));
                let known: Vec<_> = columns.iter().map(|column| column.name.as_str()).collect();
                let help = nearest::help(&entry.key, known.iter().copied());
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

    fn compare(&mut self, entry: &Entry, factors: &[Factor], columns: &[Column]) -> Option<Compare> {
        let table = take::table(&entry.value, "compare", self.faults)?;
        take::only(table, &["factor", "to", "margin"], "sweep.compare", self.faults);
        let margins = self.numbers(table.get("margin"), "margin", columns);
        let name = table.get("factor").and_then(|e| take::text(&e.value, "compare: factor", self.faults));
        let factor = name.and_then(|name| factors.iter().find(|factor| factor.name == name));
        let Some(factor) = factor else {
            self.fault(&entry.key_at, "compare needs the name of a factor", "no factor", "add factor = \"icp\"");
            return None;
        };
        let to = table.get("to").map_or(factor.levels[0].label.clone(), |entry| entry.value.to_json());
        if !factor.levels.iter().any(|level| level.label == to) {
            let message = format!("factor \"{}\" has no value {to} to compare with", factor.name);
            self.fault(&entry.key_at, message, "no such value", "name one of its values or labels");
        }
        Some(Compare { factor: factor.name.clone(), to, margins })
    }
}

impl Spec {
    /// How many runs there are; `None` if nobody can count them.
    pub(super) fn n_runs(&self) -> Option<usize> {
        let blocks = self.blocks();
        let n = |block: &Vec<usize>| self.factors[block[0]].levels.len();
        blocks.iter().map(n).try_fold(self.repeat, usize::checked_mul)
    }

    /// The factors by index, those that go together in one block, in the order of the file.
    pub(super) fn blocks(&self) -> Vec<Vec<usize>> {
        let mut blocks: Vec<Vec<usize>> = Vec::new();
        let index = |name: &String| self.factors.iter().position(|factor| factor.name == *name);
        for (k, factor) in self.factors.iter().enumerate() {
            if blocks.iter().any(|block| block.contains(&k)) {
                continue;
            }
            let group = self.pair.iter().find(|group| group.contains(&factor.name));
            blocks.push(group.map_or_else(|| vec![k], |group| group.iter().filter_map(index).collect()));
        }
        blocks
    }
}

fn quoted(names: &[String]) -> String {
    names.iter().map(|name| format!("\"{name}\"")).collect::<Vec<_>>().join(", ")
}

fn distribution(entry: &Entry) -> Option<Distribution> {
    let json = entry.value.to_json();
    let two = || {
        let list = json.as_array().filter(|list| list.len() == 2)?;
        let [a, b] = [list[0].as_f64()?, list[1].as_f64()?];
        (a.is_finite() && b.is_finite()).then_some([a, b])
    };
    Some(match entry.key.as_str() {
        "uniform" => Distribution::Uniform(two().filter(|[a, b]| a <= b)?),
        "normal" => Distribution::Normal(two().filter(|[_, sd]| *sd >= 0.0)?),
        "log_uniform" => Distribution::LogUniform(two().filter(|[a, b]| 0.0 < *a && a <= b)?),
        "integers" => {
            let list = json.as_array().filter(|list| list.len() == 2)?;
            let (a, b) = (list[0].as_i64()?, list[1].as_i64()?);
            Distribution::Integers((a <= b && b.checked_sub(a).is_some()).then_some([a, b])?)
        }
        _ => Distribution::Choice(json.as_array().filter(|list| !list.is_empty())?.clone()),
    })
}

/// A value as a graph file writes it.
fn literal(value: &Spanned) -> String {
    match &value.value {
        // A text on the command line may have come without quotes.
        Value::Text(text) => Json::from(text.as_str()).to_string(),
        _ => value.at.text().to_owned(),
    }
}

/// `{ a.b = 1, "c.d" = 2 }` as `a.b=1` and `c.d=2`.
fn leaves(table: &Table, prefix: &str) -> Vec<String> {
    let leaf = |entry: &Entry| {
        let key = format!("{prefix}{}", entry.key);
        match entry.value.as_table() {
            Some(inner) => leaves(inner, &format!("{key}.")),
            None => vec![format!("{key}={}", literal(&entry.value))],
        }
    };
    table.0.iter().flat_map(leaf).collect()
}
