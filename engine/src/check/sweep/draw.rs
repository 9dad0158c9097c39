//! Reads `[sweep.draw]`: random values and their distributions.

use super::{
    Reader,
    spec::{Distribution, Draw},
};
use crate::{
    fault::Fault,
    graph::{
        Entry,
        extract::{self, Section},
        grammar,
    },
};

impl Reader<'_> {
    pub(super) fn draw(&mut self, entry: &Entry) -> Option<Draw> {
        let owner = format!("draw \"{}\"", entry.key);
        let table = extract::table(&entry.value, &owner, self.faults)?;
        let table = Section::new(table, &grammar::DRAW, &owner, &*owner, self.faults);
        let keys = self.keys(&table, &owner, true);
        let mut ways = grammar::names(&grammar::DISTRIBUTIONS).filter_map(|way| table.get(way));
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
