use super::{
    context::Check,
    inputs::{self, Input},
    parsed_nodes::ParsedNode,
    wires,
};
use crate::{
    fault::Fault,
    graph::{Entry, Spanned, Table, Value, extract, grammar, header::Header},
    names::nearest,
    plan::Policy,
};
use osteoflow_node::{Join, PortPayload, Role};

impl Check<'_> {
    /// Reads the settings of an input: join, capacity, policy.
    pub(super) fn options(
        &mut self,
        input: &mut Input,
        entry: &Entry,
        owner: &str,
        parsed_nodes: &[ParsedNode<'_>],
        header: &Header,
    ) {
        let Value::Table(table) = &entry.value.value else { return };
        extract::only(table, &grammar::INPUT, &format!("{owner}: an input"), &mut self.faults);
        self.join(input, table, owner, parsed_nodes);
        self.capacity(input, table, owner);
        self.policy(input, table, owner, parsed_nodes, header);
    }

    fn join(&mut self, input: &mut Input, table: &Table, owner: &str, parsed_nodes: &[ParsedNode<'_>]) {
        let declared = input.port.join;
        let mut join = declared;
        if let Some(entry) = table.get("join") {
            let what = format!("{owner}: join");
            let Some(found) = extract::text(&entry.value, &what, &mut self.faults) else { return };
            join = match found {
                "each" => Join::Each,
                "latest" => Join::Latest,
                "once" => Join::Once,
                _ if found == declared.name() => declared,
                "stamp" => Join::Stamp { tolerance_ns: 0 },
                "collect" => Join::Collect { n: None },
                "interpolate" => Join::Interpolate { max_gap_ns: None },
                _ => return self.faults.push(not_a_word(&what, &grammar::JOINS, found, &entry.value)),
            };
            if let Some(fault) = refuse_join(input, join, owner, &entry.value, parsed_nodes) {
                self.faults.push(fault);
                join = declared;
            }
        }
        let stamps = matches!(join, Join::Stamp { .. });
        if let Some(entry) = self.goes_with(table, "tolerance_ms", stamps, "stamp", owner, join)
            && let Some(ns) = extract::milliseconds(&entry.value, &format!("{owner}: tolerance_ms"), &mut self.faults)
        {
            join = Join::Stamp { tolerance_ns: ns };
        }
        let interpolates = matches!(join, Join::Interpolate { .. });
        if let Some(entry) = self.goes_with(table, "max_gap_ms", interpolates, "interpolate", owner, join)
            && let Some(ns) = extract::milliseconds(&entry.value, &format!("{owner}: max_gap_ms"), &mut self.faults)
        {
            join = Join::Interpolate { max_gap_ns: Some(ns) };
        }
        let collects = matches!(join, Join::Collect { .. });
        if let Some(entry) = self.goes_with(table, "n", collects, "collect", owner, join)
            && let Some(n) = extract::whole(&entry.value, &format!("{owner}: n"), 1, u32::MAX.into(), &mut self.faults)
        {
            join = Join::Collect { n: u32::try_from(n).ok() };
        }
        input.port.join = join;
    }

    /// The entry of a key that is valid with one join only.
    fn goes_with<'t>(
        &mut self,
        table: &'t Table,
        key: &str,
        goes: bool,
        with: &str,
        owner: &str,
        join: Join,
    ) -> Option<&'t Entry> {
        let entry = table.get(key)?;
        if goes {
            return Some(entry);
        }
        let message = format!("{owner}: {key} goes with join = \"{with}\", but this input joins by {}", join.name());
        self.faults.push(Fault::new(message).at(&entry.key_at, format!("only with join = \"{with}\"")));
        None
    }

    fn capacity(&mut self, input: &mut Input, table: &Table, owner: &str) {
        if let Some(entry) = table.get("capacity") {
            let most = u64::try_from(usize::MAX / 2).unwrap_or(u64::MAX);
            let n = extract::whole(&entry.value, &format!("{owner}: capacity"), 1, most, &mut self.faults);
            input.capacity = n.and_then(|n| usize::try_from(n).ok()).unwrap_or(input.capacity);
        }
        if let Some(entry) = table.get("max_bytes") {
            let n = extract::bytes(&entry.value, &format!("{owner}: max_bytes"), &mut self.faults);
            input.max_bytes = n.unwrap_or(input.max_bytes);
        }
    }

    fn policy(
        &mut self,
        input: &mut Input,
        table: &Table,
        owner: &str,
        parsed_nodes: &[ParsedNode<'_>],
        header: &Header,
    ) {
        let every = table.get("every");
        let named = table.get("policy");
        let Some(entry) = named else {
            if let Some(every) = every {
                let message = format!("{owner}: every goes with policy = \"sample\", but this wire blocks");
                self.faults.push(Fault::new(message).at(&every.key_at, "only with policy = \"sample\""));
            }
            return;
        };
        let what = format!("{owner}: policy");
        let Some(found) = extract::text(&entry.value, &what, &mut self.faults) else { return };
        let n = every
            .and_then(|e| extract::whole(&e.value, &format!("{owner}: every"), 1, u32::MAX.into(), &mut self.faults));
        input.policy = match found {
            "block" => Policy::Block,
            "drop_old" => Policy::DropOld,
            "drop_new" => Policy::DropNew,
            "fail" => Policy::Fail,
            "sample" => {
                if every.is_none() {
                    let fault = Fault::new(format!("{what} = \"sample\" does not say how many are one too many"));
                    self.faults.push(
                        fault.at(&entry.value.at, "no every here").help("add every = 2 to keep every second item"),
                    );
                }
                Policy::Sample(n.and_then(|n| u32::try_from(n).ok()).unwrap_or(1))
            }
            _ => return self.faults.push(not_a_word(&what, &grammar::POLICIES, found, &entry.value)),
        };
        if let Some(every) = every.filter(|_| found != "sample") {
            let message = format!("{owner}: every goes with policy = \"sample\", but the policy is \"{found}\"");
            self.faults.push(Fault::new(message).at(&every.key_at, "only with policy = \"sample\""));
        }
        let Some(producer) = input.from.map(|(node, _)| &parsed_nodes[node]) else { return };
        let live = producer.role().is_none_or(|role| role == Role::LiveSource);
        if input.policy != Policy::Block && !live && !header.lossy {
            let message = format!("{owner} may lose items, but \"{}\" is no live source", producer.name);
            let fault = Fault::new(message).at(&entry.value.at, "loses items");
            let note = "a producer that does not follow the world's clock can wait: with \"block\" nothing is lost";
            let help = "take policy away, or allow loss everywhere by lossy = true in [graph]";
            self.faults.push(fault.note(note).help(help));
        }
    }
}

fn not_a_word(what: &str, words: &[&str], found: &str, value: &Spanned) -> Fault {
    let list: Vec<_> = words.iter().map(|word| format!("\"{word}\"")).collect();
    let fault = Fault::new(format!("{what} takes one of {}, found the text {found:?}", list.join(", ")));
    fault.at(&value.at, "not one of them").help_if(nearest::help(found, words.iter().copied()))
}

/// The fault if the port or its producer does not support the join.
fn refuse_join(
    input: &Input,
    join: Join,
    owner: &str,
    value: &Spanned,
    parsed_nodes: &[ParsedNode<'_>],
) -> Option<Fault> {
    let (many, collects) = (matches!(input.port.join, Join::Collect { .. }), matches!(join, Join::Collect { .. }));
    if many != collects {
        let declared = input.port.join.name();
        let (takes, label) =
            if many { ("several items", "gives one item") } else { ("one item", "gives several items") };
        let fault = Fault::new(format!("{owner} takes {takes} at a time, and cannot join by \"{}\"", join.name()));
        return Some(fault.at(&value.at, label).help(format!("take join away: its kind joins it by {declared}")));
    }
    if !matches!(join, Join::Interpolate { .. }) {
        return None;
    }
    let gives = input.from.and_then(|wire| Some((wire, inputs::output(wire, parsed_nodes)?.payload?)));
    let (name, payload) = match gives {
        Some((wire, payload)) => (wires::name(wire, parsed_nodes), payload),
        None => (input.port.name.to_owned(), input.port.payload),
    };
    match payload {
        PortPayload::Type(ty) if !ty.interpolates => {
            let message = format!("{owner} cannot join by \"interpolate\": there is nothing between two {}", ty.name);
            let fault = Fault::new(message).at(&value.at, format!("\"{name}\" gives {}", ty.name));
            Some(fault.help("write join = \"latest\" for the newest, or join = \"stamp\" for the one of that time"))
        }
        _ => None,
    }
}
