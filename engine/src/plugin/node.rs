//! A plugin's node as a node of the engine.
#![allow(unsafe_code, reason = "calls a plugin's functions")]

use super::{
    Library,
    host::{CallContext, HOST, HeldValue, LentValue, Run},
    lent_check::Copies,
};
use crate::{activity::in_library, panics};
use osteoflow_node::{
    AnyNode, AnySource, Body, BuildContext, Built, Context, Emission, Empty, Item, Join, Joined, NodeError, ParamError,
    PayloadType, PortPayload, Role, SILENT_AFTER, Slot, StampNs,
    abi::{self, Text, slot, status},
    serde_json::Value as Json,
};
use std::{
    collections::BTreeMap,
    ffi::c_void,
    ptr,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

/// Properties of a kind needed to build its nodes.
pub(super) struct BuiltKind {
    /// JSON Schema of the parameters.
    pub(super) schema: Json,
    /// Names and payloads of the outputs.
    pub(super) outputs: Vec<(String, PortPayload)>,
    pub(super) declared: Vec<LentOutput>,
    /// The payload types that untyped outputs may give.
    pub(super) types: Arc<[&'static PayloadType]>,
}

/// A declared output, lent to a plugin.
pub(super) struct LentOutput {
    pub(super) name: String,
    pub(super) payload: *const abi::Payload,
    pub(super) params: String,
}

// SAFETY: payload descriptions passed to plugins are leaked and never change.
unsafe impl Send for LentOutput {}
// SAFETY: as above.
unsafe impl Sync for LentOutput {}

impl BuiltKind {
    /// A parameter by its dotted path: the given value, otherwise the schema's default.
    pub(super) fn param<'a>(&'a self, params: &'a Json, path: &str) -> Option<&'a Json> {
        let mut steps = path.split('.');
        let given = steps.try_fold(params, |at, step| at.get(step));
        given.or_else(|| {
            let mut schema = &self.schema;
            for step in path.split('.') {
                schema = schema.get("properties")?.get(step)?;
                if let Some(name) = schema.get("$ref").and_then(Json::as_str) {
                    schema = self.schema.pointer(name.trim_start_matches('#'))?;
                }
            }
            schema.get("default")
        })
    }
}

/// The C description of a payload type, created once.
fn crossing(ty: &'static PayloadType) -> *const abi::Payload {
    static KNOWN: Mutex<BTreeMap<usize, usize>> = Mutex::new(BTreeMap::new());
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    *known.entry(ptr::from_ref(ty) as usize).or_insert_with(|| ptr::from_ref(abi::schema::describe(ty)) as usize)
        as *const abi::Payload
}

/// Builds a node of the kind at `index` of the library.
pub(super) fn build(
    library: &'static Library,
    index: usize,
    outputs: &[(String, PortPayload)],
    types: Arc<[&'static PayloadType]>,
    params: &Json,
    context: &BuildContext,
) -> Result<Built, ParamError> {
    let _under = in_library(library.file());
    library.start(&HOST);
    let kind = library.kind(index);
    let described = &library.description().kinds[index];
    let declared = context.declared.iter().map(|port| LentOutput {
        name: port.name.clone(),
        payload: crossing(port.payload),
        params: port.params.to_string(),
    });
    let built = BuiltKind {
        schema: described.params.clone(),
        outputs: match context.declared.is_empty() {
            true => outputs.to_vec(),
            false => context.declared.iter().map(|p| (p.name.clone(), PortPayload::Type(p.payload))).collect(),
        },
        declared: declared.collect(),
        types,
    };
    let text = params.to_string();
    let mut node = ptr::null_mut();
    let mut run = Run {
        context: CallContext::Build(context),
        built: &built,
        params,
        out: &mut [],
        failed: None,
        lent: Vec::new(),
    };
    let firing = abi::Firing {
        size: size_of::<abi::Firing>() as u64,
        host: &HOST,
        run: run.handle(),
        slots: ptr::null(),
        n_slots: 0,
    };
    let create = kind.create.expect("a kind without it is refused when its library is read");
    // SAFETY: called as the header requires: with the plugin's own kind, and texts and a run that outlive the call.
    let answered = unsafe { create(kind, &firing, Text::of(&text), &mut node) };
    let (parameter, message) = run.failed.take().unwrap_or_default();
    match answered {
        status::OK if message.is_empty() && !node.is_null() => {}
        status::OK if message.is_empty() => {
            return Err(ParamError::new("", "the plugin built a node that is a null pointer"));
        }
        status::PANICKED => panics::resume_described(message),
        _ if message.is_empty() => {
            return Err(ParamError::new(
                "",
                format!("the plugin answers {answered} in the place of a node, and no reason"),
            ));
        }
        _ => return Err(ParamError::new(parameter, message)),
    }
    let n_inputs = described.inputs.len();
    let node = PluginNode {
        library,
        index,
        node,
        built,
        params: params.clone(),
        is_source: described.role != Role::Node,
        constants: (0..n_inputs)
            .map(|port| matches!(context.joins.get(port), Some(Join::Once)).then_some(Constant(None)))
            .collect(),
        values: Vec::new(),
        items: Vec::new(),
        slots: Vec::new(),
        payloads: Vec::new(),
    };
    Ok(match described.role {
        Role::Node => Built::Node(Box::new(node)),
        Role::Source | Role::LiveSource => Built::Source(Box::new(node)),
    })
}

/// The value of a port joined by `once`; its view is created once.
struct Constant(Option<Box<HeldValue>>);

struct PluginNode {
    library: &'static Library,
    index: usize,
    node: *mut c_void,
    built: BuiltKind,
    params: Json,
    is_source: bool,
    /// The cached constant of each input joined by `once`.
    constants: Vec<Option<Constant>>,
    // Buffers reused by firings.
    values: Vec<LentValue>,
    items: Vec<abi::Item>,
    slots: Vec<abi::Slot>,
    payloads: Vec<(*const PayloadType, *const abi::Payload)>,
}

// SAFETY: the header requires that one thread at a time uses a node; the lists are empty between firings.
unsafe impl Send for PluginNode {}

impl Drop for PluginNode {
    fn drop(&mut self) {
        let _under = in_library(self.library.file());
        let destroy = self.library.kind(self.index).destroy;
        // SAFETY: called once with the pointer returned by `create`.
        unsafe { destroy.expect("a kind without it is refused when its library is read")(self.node) };
    }
}

impl PluginNode {
    /// Fills the argument lists with the joined items.
    fn fill_arguments(&mut self, joined: &Joined) {
        for (port, brought) in joined.slots.iter().enumerate() {
            for item in brought.items() {
                if let Body::Value(value) = &item.body {
                    match self.constants.get_mut(port) {
                        Some(Some(Constant(known))) => {
                            if !known.as_ref().is_some_and(|known| known.is(value)) {
                                *known = Some(Box::new(HeldValue::new(value.clone())));
                            }
                        }
                        // SAFETY: `joined` outlives the call for which it is laid out, after which the list is emptied.
                        _ => self.values.push(unsafe { LentValue::borrowed(value) }),
                    }
                }
            }
        }
        // The values do not move from here on.
        let mut next = self.values.iter();
        for (port, brought) in joined.slots.iter().enumerate() {
            let constant = self.constants.get(port).and_then(Option::as_ref);
            let mut one = |item: &Item| match &item.body {
                Body::Empty(empty) => empty_item(item.number, item.stamp_ns, empty),
                Body::Value(value) => {
                    let lent = match constant {
                        Some(Constant(known)) => known.as_deref().map(HeldValue::lent),
                        None => next.next(),
                    };
                    abi::Item {
                        number: item.number,
                        stamp_ns: item.stamp_ns,
                        value: lent.map_or(ptr::null(), LentValue::handle),
                        payload: payload_of(&mut self.payloads, value.ty()),
                        empty_node: Text::NONE,
                        empty_reason: Text::NONE,
                    }
                }
            };
            match brought {
                Slot::Item(item) => self.items.push(one(item)),
                Slot::Items(items) => self.items.extend(items.iter().map(one)),
                Slot::Absent(empty) => self.items.push(empty_item(0, 0, empty)),
            }
        }
        // The items do not move from here on.
        let mut first = 0;
        for (port, brought) in joined.slots.iter().enumerate() {
            let (what, n_items) = match brought {
                Slot::Item(_) => (slot::ITEM, 1),
                Slot::Items(items) => (slot::ITEMS, items.len()),
                Slot::Absent(_) => (slot::ABSENT, 1),
            };
            let is_constant = self.constants.get(port).is_some_and(Option::is_some);
            let items = self.items[first..first + n_items].as_ptr();
            let flags = if is_constant { slot::CONSTANT } else { 0 };
            self.slots.push(abi::Slot { what, flags, items, n_items: n_items as u64 });
            first += n_items;
        }
    }

    /// The lent values, each with its input.
    fn lent(&self) -> impl Iterator<Item = (usize, &LentValue)> {
        self.slots.iter().enumerate().flat_map(|(port, slot)| {
            // SAFETY: the slots and items were laid out for this firing, and their values are lent until its end.
            let items = unsafe { std::slice::from_raw_parts(slot.items, slot.n_items as usize) };
            // SAFETY: as above.
            items.iter().filter_map(move |item| Some((port, unsafe { item.value.cast::<LentValue>().as_ref() }?)))
        })
    }

    /// Calls the plugin; `false` at the end of a source.
    fn call(&mut self, joined: &Joined, out: &mut [Emission], context: &mut Context) -> Result<bool, NodeError> {
        self.fill_arguments(joined);
        let copies = Copies::of(self.lent());
        let mut run = Run {
            context: CallContext::Firing(context),
            built: &self.built,
            params: &self.params,
            out,
            failed: None,
            lent: Vec::new(),
        };
        let firing = abi::Firing {
            size: size_of::<abi::Firing>() as u64,
            host: &HOST,
            run: run.handle(),
            slots: self.slots.as_ptr(),
            n_slots: self.slots.len() as u64,
        };
        let under = in_library(self.library.file());
        let fire = self.library.kind(self.index).fire;
        // SAFETY: called as the header requires: with the pointer returned by `create`, from one thread at a time, and
        // a firing that outlives the call.
        let answered =
            unsafe { fire.expect("a kind without it is refused when its library is read")(self.node, &firing) };
        drop(under);
        let failed = run.failed.take();
        let inputs = &self.library.description().kinds[self.index].inputs;
        let written = copies.changed(|port| inputs.get(port).map_or_else(String::new, |input| input.port.name.clone()));
        self.slots.clear();
        self.items.clear();
        self.values.clear();
        if let Some(written) = written {
            return Err(NodeError::new(written));
        }
        match (answered, failed) {
            (status::OK, None) => Ok(true),
            (status::END, None) if self.is_source => Ok(false),
            (status::PANICKED, failed) => {
                panics::resume_described(failed.map_or_else(|| "panicked".into(), |(_, said)| said))
            }
            (_, Some((parameter, message))) if parameter.is_empty() => Err(NodeError::new(message)),
            (_, Some((parameter, message))) => Err(NodeError::new(format!("{parameter}: {message}"))),
            (status::FAILED, None) => Err(NodeError::new("the plugin failed without saying why")),
            (unknown, None) => Err(NodeError::new(format!("the plugin answers {unknown}, which means nothing"))),
        }
    }
}

fn payload_of(
    known: &mut Vec<(*const PayloadType, *const abi::Payload)>,
    ty: &'static PayloadType,
) -> *const abi::Payload {
    if let Some((_, payload)) = known.iter().find(|(known, _)| ptr::eq(*known, ty)) {
        return *payload;
    }
    let payload = crossing(ty);
    known.push((ty, payload));
    payload
}

fn empty_item(number: u64, stamp_ns: StampNs, empty: &Empty) -> abi::Item {
    abi::Item {
        number,
        stamp_ns,
        value: ptr::null(),
        payload: ptr::null(),
        empty_node: Text::of(&empty.node),
        empty_reason: Text::of(&empty.reason),
    }
}

impl AnyNode for PluginNode {
    fn fire(&mut self, joined: &mut Joined, out: &mut [Emission], ctx: &mut Context) -> Result<(), NodeError> {
        self.call(joined, out, ctx)?;
        // A node must answer on every output.
        for emission in out.iter_mut().filter(|emission| matches!(emission, Emission::Silent)) {
            *emission = Emission::Empty("the node gave no value".into());
        }
        Ok(())
    }
}

impl AnySource for PluginNode {
    fn next(&mut self, out: &mut [Emission], ctx: &mut Context) -> Result<bool, NodeError> {
        self.call(&Joined::default(), out, ctx)
    }

    fn max_delay_ns(&self) -> StampNs {
        let ask = self.library.kind(self.index).max_delay_ns;
        // SAFETY: called with the pointer returned by `create`.
        ask.map_or(0, |ask| unsafe { ask(self.node) })
    }

    fn silent_after(&self) -> Duration {
        let ask = self.library.kind(self.index).silent_after_ns;
        // SAFETY: called with the pointer returned by `create`.
        let ns = ask.map(|ask| unsafe { ask(self.node) });
        ns.and_then(|ns| u64::try_from(ns).ok()).map_or(SILENT_AFTER, Duration::from_nanos)
    }
}
