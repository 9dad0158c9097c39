use super::{
    context::Check,
    frames,
    parsed_nodes::{Output, ParsedNode},
};
use crate::{
    fault::Fault,
    graph::{
        Entry,
        extract::{self, Section},
        grammar,
        header::Header,
    },
    names::nearest,
    plan::PortFrames,
};
use osteoflow_node::{DeclaredPort, FrameExpr, PayloadType, PortPayload};
use serde_json::Value as Json;

impl Check<'_> {
    /// Reads the outputs that a graph declares by `out`.
    pub(super) fn declared(&mut self, parsed_node: &mut ParsedNode<'_>, schema: &Json, header: &Header) {
        let (name, kind) = (parsed_node.name, parsed_node.kind_name());
        let example = "write out = { NAME = { type = \"PAYLOAD\" } } with what it shall give";
        let Some(out) = parsed_node.table.get("out") else {
            let fault = Fault::new(format!("node \"{name}\": {kind} gives what out declares, but there is no out"));
            self.faults.push(fault.at(parsed_node.name_at, "no out here").help(example).follows());
            return;
        };
        let Some(ports) = extract::table(&out.value, &format!("node \"{name}\": out"), &mut self.faults) else {
            return;
        };
        if ports.0.is_empty() {
            let fault = Fault::new(format!("node \"{name}\": out declares no output"));
            self.faults.push(fault.at(&out.value.at, "empty").help(example));
        }
        let outputs = ports.0.iter().map(|entry| self.port(parsed_node, entry, schema, header));
        parsed_node.outputs = Some(outputs.collect());
    }

    fn port(&mut self, parsed_node: &mut ParsedNode<'_>, entry: &Entry, schema: &Json, header: &Header) -> Output {
        let (node, name) = (parsed_node.name, entry.key.as_str());
        let (exprs, given) = (FrameExpr::default(), PortFrames::default());
        let mut output = Output { name: name.into(), payload: None, exprs, given, is_timed: false };
        if !extract::is_name(name) {
            let fault = Fault::new(format!("node \"{node}\": an output cannot be called {name:?}"));
            let fault = fault.at(&entry.key_at, "no name");
            self.faults.push(fault.help("a name has letters, digits, _ and - only"));
        }
        let owner = format!("node \"{node}\": out \"{name}\"");
        let Some(table) = extract::table(&entry.value, &owner, &mut self.faults) else { return output };
        let own = Section::known(table, &grammar::OUTPUT, owner.clone());
        let payload = self.payload(&owner, &own, entry);
        output.payload = payload.map(PortPayload::Type);
        output.given = PortFrames {
            frame: self.port_frame(&owner, &own, "frame", header),
            to: self.port_frame(&owner, &own, "to", header),
            from: self.port_frame(&owner, &own, "from", header),
        };
        let reserved: Vec<_> = grammar::names(&grammar::OUTPUT).collect();
        let path = format!("node.{node}.out.{name}");
        let mut params = self.read_params(parsed_node, schema, (owner, path), (table, &entry.key_at), &reserved);
        // A kind whose messages name no frames asks for those of the port by parameters of the same names.
        let asked = |key: &str| schema.pointer(&format!("/properties/{key}")).is_some();
        let given = [("frame", &output.given.frame), ("to", &output.given.to), ("from", &output.given.from)];
        for (key, frame) in given.into_iter().filter(|(key, _)| asked(key)) {
            if let (Some(params), Some(frame)) = (&mut params, frame) {
                params.insert(key.into(), frame.clone().into());
            }
        }
        if let (Some(payload), Some(params)) = (payload, params) {
            parsed_node.declared.push(DeclaredPort { name: name.into(), payload, params: Json::Object(params) });
        }
        output
    }

    fn payload(&mut self, owner: &str, table: &Section<'_>, entry: &Entry) -> Option<&'static PayloadType> {
        let Some(ty) = table.get("type") else {
            let fault = Fault::new(format!("{owner} does not say its type")).at(&entry.key_at, "no type here");
            let (_, list) = self.payloads("");
            self.faults.push(fault.help("add type = \"PAYLOAD\"").note_if(list).follows());
            return None;
        };
        let found = table.text("type", &mut self.faults)?;
        let known = self.known.registry.payload_type(found);
        if known.is_none() {
            let fault = Fault::new(format!("{owner}: there is no payload type \"{found}\""));
            self.faults.push(fault.at(&ty.value.at, "unknown").hint(self.payloads(found)));
        }
        known
    }

    fn payloads(&self, found: &str) -> (Option<String>, Option<String>) {
        let names: Vec<_> = self.known.registry.payload_types().map(|ty| ty.name).collect();
        nearest::hint(found, "payload types", names)
    }

    fn port_frame(&mut self, owner: &str, table: &Section<'_>, key: &str, header: &Header) -> Option<String> {
        let entry = table.get(key)?;
        let frame = table.text(key, &mut self.faults)?;
        let fault = frames::unknown(frame, &entry.value.at, owner, header);
        // An invalid frame is not propagated, to avoid a fault at every node downstream.
        let known = fault.is_none().then(|| frame.to_owned());
        self.faults.extend(fault);
        known
    }
}
