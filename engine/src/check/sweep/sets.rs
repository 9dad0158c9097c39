//! Checks that no two factors or draws set one key: only the last would take effect, but the tables would list both.

use super::{
    Reader,
    spec::{Draw, Factor, Level},
};
use crate::{
    fault::{Fault, Span},
    graph::{SetKey, Table, grammar},
};
use std::collections::BTreeSet;

/// A factor or a draw.
struct Setter<'a> {
    what: &'static str,
    name: &'a str,
    at: Span,
    /// The keys set by each value; a draw has one entry.
    levels: Vec<Vec<SetKey>>,
}

impl Setter<'_> {
    fn all(&self) -> BTreeSet<&SetKey> {
        self.levels.iter().flatten().collect()
    }
}

impl Reader<'_> {
    /// Faults for keys set by two factors or draws of one run, and for keys that a sweep may not set; returns the
    /// results that factors or draws add.
    pub(super) fn sets(
        &mut self,
        table: &Table,
        factors: &[Factor],
        draws: &[Draw],
        pair: &[Vec<String>],
        same_seed: bool,
    ) -> Vec<String> {
        let mut setters: Vec<Setter> = Vec::new();
        let at = |kind, name| Some(table.get(kind)?.value.as_table()?.get(name)?.key_at.clone());
        for factor in factors {
            let levels = factor.levels.iter().map(Level::keys_set).collect();
            let Some(at) = at("factor", &factor.name) else { continue };
            setters.push(Setter { what: "factor", name: &factor.name, at, levels });
        }
        for draw in draws {
            let Some(at) = at("draw", &draw.name) else { continue };
            setters.push(Setter { what: "draw", name: &draw.name, at, levels: vec![draw.keys_set()] });
        }
        for (index, later) in setters.iter().enumerate() {
            self.taken(later, same_seed);
            for earlier in &setters[..index] {
                let paired = |name: &str| pair.iter().position(|group| group.iter().any(|known| known == name));
                let together = later.what == earlier.what
                    && paired(later.name).is_some_and(|group| paired(earlier.name) == Some(group));
                let both = match together {
                    true => earlier.levels.iter().zip(&later.levels).find_map(|(a, b)| overridden(a, b)),
                    false => overridden(earlier.all(), later.all()),
                };
                if let Some(key) = both {
                    let (first, second) = (describe(earlier), describe(later));
                    let fault =
                        Fault::new(format!("{first} and {second} both set {key}, of which a run has one value"))
                            .at(&later.at, "would be run")
                            .also(&earlier.at, "would not be run, and stand in the tables");
                    self.faults.push(fault.help(format!(
                        "take {key} out of one of them, or make one factor of both, whose values are tables of settings"
                    )));
                }
            }
        }
        let results = setters.iter().flat_map(Setter::all).filter(|key| key.parts()[0] == "results");
        results.filter_map(|key| key.parts().get(1).cloned()).filter(|key| key != grammar::REQUIRE).collect()
    }

    /// Faults for keys that factors and draws may not set.
    fn taken(&mut self, setter: &Setter<'_>, same_seed: bool) {
        for key in setter.all() {
            let parts: Vec<_> = key.parts().iter().map(String::as_str).collect();
            let (label, help) = match parts[..] {
                ["sweep", ..] => ("not of a run", "set what a run has: parameters of nodes, graph.seed, results"),
                ["graph", "seed"] if !same_seed => (
                    "each repeat sets it: graph.seed, +1, +2 ...",
                    "say same_seed = true, or leave the seeds to repeat = N",
                ),
                _ => continue,
            };
            self.fault(&setter.at, format!("{} cannot set {key}", describe(setter)), label, help);
        }
    }
}

/// A key of `earlier` whose value a key of `later` overrides.
fn overridden<'k>(
    earlier: impl IntoIterator<Item = &'k SetKey>,
    later: impl IntoIterator<Item = &'k SetKey> + Clone,
) -> Option<&'k SetKey> {
    earlier.into_iter().find(|a| later.clone().into_iter().any(|b| b.overrides(a)))
}

fn describe(setter: &Setter<'_>) -> String {
    format!("{} \"{}\"", setter.what, setter.name)
}
