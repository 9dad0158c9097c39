use super::{
    context::Check,
    inputs::{self, Input},
    parsed_nodes::ParsedNode,
    wires,
};
use crate::{
    fault::Fault,
    graph::{Entry, Spanned, Value, extract::Section, grammar, header::Header},
    plan::Policy,
};
use osteoflow_node::{Join, PortPayload, Role};

/// Most items that wait on a wire: queues count twice as many.
const MAX_CAPACITY: u64 = (usize::MAX / 2) as u64;

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
        let place = format!("{owner}: an input");
        let table = Section::new(table, &grammar::INPUT, &place, owner, &mut self.faults);
        self.join(input, &table, owner, parsed_nodes);
        input.capacity = table.whole("capacity", MAX_CAPACITY, &mut self.faults).unwrap_or(input.capacity);
        input.max_bytes = table.bytes("max_bytes", &mut self.faults).unwrap_or(input.max_bytes);
        self.policy(input, &table, owner, parsed_nodes, header);
        self.contract(input, &table, owner, parsed_nodes);
    }

    fn join(&mut self, input: &mut Input, table: &Section<'_>, owner: &str, parsed_nodes: &[ParsedNode<'_>]) {
        let declared = input.port.join;
        let mut join = declared;
        if let Some(entry) = table.get("join") {
            let Some(word) = table.word("join", &mut self.faults) else { return };
            join = match word {
                "each" => Join::Each,
                "once" => Join::Once,
                "previous" => Join::Previous,
                _ if word == declared.name() => declared,
                "latest" => Join::Latest,
                "stamp" => Join::Stamp { tolerance_ns: 0 },
                "collect" => Join::Collect { n: None },
                _ => Join::Interpolate { max_gap_ns: None },
            };
            if let Some(fault) = refuse_join(input, join, owner, &entry.value, parsed_nodes) {
                self.faults.push(fault);
                join = declared;
            }
        }
        let stamps = matches!(join, Join::Stamp { .. });
        if self.goes_with(table, "tolerance_ms", stamps, "stamp", join)
            && let Some(ns) = table.milliseconds("tolerance_ms", &mut self.faults)
        {
            join = Join::Stamp { tolerance_ns: ns };
        }
        let interpolates = matches!(join, Join::Interpolate { .. });
        if self.goes_with(table, "max_gap_ms", interpolates, "interpolate", join)
            && let Some(ns) = table.milliseconds("max_gap_ms", &mut self.faults)
        {
            join = Join::Interpolate { max_gap_ns: Some(ns) };
        }
        let is_latest = matches!(join, Join::Latest | Join::LatestAfter { .. });
        if self.goes_with(table, "after_ms", is_latest, "latest", join)
            && let Some(ns) = table.milliseconds("after_ms", &mut self.faults)
        {
            join = Join::LatestAfter { after_ns: ns };
        }
        input.port.join = self.window(table, join);
    }

    /// Reads the windows of a port that collects.
    fn window(&mut self, table: &Section<'_>, join: Join) -> Join {
        let keys = ["n", "step", "span_ms", "step_ms"];
        if keys.map(|key| self.goes_with(table, key, join.collects(), "collect", join)).contains(&false) {
            return join;
        }
        for (key, with) in [("step", "n"), ("step_ms", "span_ms")] {
            if let Some(entry) = table.get(key).filter(|_| table.get(with).is_none()) {
                let message = format!("{} is given without {with}", table.what(key));
                let fault = Fault::new(message).at(&entry.key_at, format!("only with {with}"));
                self.faults.push(fault.help(format!("add {with}: the length of a window")));
                return join;
            }
        }
        if let (Some(n), Some(span)) = (table.get("n"), table.get("span_ms")) {
            let fault = Fault::new(format!("{} and span_ms are two lengths of one window", table.what("n")));
            let fault = fault.at(&span.key_at, "in time").also(&n.key_at, "in items");
            self.faults.push(fault.help("take one of them away"));
            return join;
        }
        let mut whole = |key: &str| table.whole(key, u32::MAX.into(), &mut self.faults);
        let (n, step) = (whole("n"), whole("step"));
        let mut time = |key: &str| table.milliseconds(key, &mut self.faults);
        let (span_ns, step_ns) = (time("span_ms"), time("step_ms"));
        match (n, span_ns) {
            (Some(n), _) => match step.filter(|step| *step != n) {
                Some(step) => Join::CollectEvery { n, step },
                None => Join::Collect { n: Some(n) },
            },
            (_, Some(span_ns)) => {
                let step_ns = step_ns.unwrap_or(span_ns);
                for (key, ns) in [("span_ms", span_ns), ("step_ms", step_ns)] {
                    if let Some(entry) = table.get(key).filter(|_| ns <= 0) {
                        let fault = Fault::new(format!("{} is no length of time", table.what(key)));
                        self.faults
                            .push(fault.at(&entry.value.at, "shorter than a nanosecond").help("write a longer one"));
                        return join;
                    }
                }
                Join::CollectSpan { span_ns, step_ns }
            }
            _ => join,
        }
    }

    /// Whether a key that is valid with one join only goes with the join of the input; a fault if not.
    fn goes_with(&mut self, table: &Section<'_>, key: &str, goes: bool, with: &str, join: Join) -> bool {
        if let Some(entry) = table.get(key).filter(|_| !goes) {
            let (what, join) = (table.what(key), join.name());
            let message = format!("{what} goes with join = \"{with}\", but this input joins by {join}");
            self.faults.push(Fault::new(message).at(&entry.key_at, format!("only with join = \"{with}\"")));
        }
        goes
    }

    fn policy(
        &mut self,
        input: &mut Input,
        table: &Section<'_>,
        owner: &str,
        parsed_nodes: &[ParsedNode<'_>],
        header: &Header,
    ) {
        let every = table.get("every");
        let only_sample = |every: &Entry, but: &str| {
            let message = format!("{} goes with policy = \"sample\", but {but}", table.what("every"));
            Fault::new(message).at(&every.key_at, "only with policy = \"sample\"")
        };
        let Some(entry) = table.get("policy") else {
            self.faults.extend(every.map(|every| only_sample(every, "this wire blocks")));
            return;
        };
        let n = table.whole("every", u32::MAX.into(), &mut self.faults);
        let Some(word) = table.word("policy", &mut self.faults) else { return };
        input.policy = match word {
            "block" => Policy::Block,
            "drop_old" => Policy::DropOld,
            "drop_new" => Policy::DropNew,
            "fail" => Policy::Fail,
            _ => {
                if every.is_none() {
                    let what = table.what("policy");
                    let fault = Fault::new(format!("{what} = \"sample\" does not say how many are one too many"));
                    self.faults.push(
                        fault.at(&entry.value.at, "no every here").help("add every = 2 to keep every second item"),
                    );
                }
                Policy::Sample(n.unwrap_or(1))
            }
        };
        if let Some(every) = every.filter(|_| word != "sample") {
            self.faults.push(only_sample(every, &format!("the policy is \"{word}\"")));
        }
        // Which items a sample of a stream keeps depends on their numbers alone.
        let is_sample = matches!(input.policy, Policy::Sample(_));
        let may_lose = |node: &usize| {
            let producer = &parsed_nodes[*node];
            producer.role().is_none_or(|role| role == Role::LiveSource) || is_sample && producer.is_source()
        };
        let Some(producer) = input.producers().find(|node| !may_lose(node)).map(|node| &parsed_nodes[node]) else {
            return;
        };
        if input.policy != Policy::Block && !header.lossy {
            let message = format!("{owner} may lose items, but \"{}\" is no live source", producer.name);
            let fault = Fault::new(message).at(&entry.value.at, "loses items");
            let note = "a producer that does not follow the world's clock can wait: with \"block\" nothing is lost";
            let help = "take policy away, or allow loss everywhere by lossy = true in [graph]";
            self.faults.push(fault.note(note).help(help));
        }
    }
}

/// The fault if the port or its producer does not support the join.
fn refuse_join(
    input: &Input,
    join: Join,
    owner: &str,
    value: &Spanned,
    parsed_nodes: &[ParsedNode<'_>],
) -> Option<Fault> {
    let (many, collects) = (input.port.join.collects(), join.collects());
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
    let wire = input.known_wires().next();
    let gives = wire.and_then(|(wire, _)| Some((wire, inputs::output(wire, parsed_nodes)?.payload?)));
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
