//! The description that a plugin returns, made from its registry.
#![allow(unsafe_code, reason = "shares pointers to immutable data")]

use super::{Package, instance, log};
use crate::abi::{Text, kind};
use crate::{
    CachePolicy, FrameExpr, InputPort, Join, OutputPort, OutputPorts, PayloadType, PortPayload, Registry, Role, abi,
};
use std::{collections::BTreeMap, ffi::c_void, ptr};

/// The description of a plugin. It is made once and never freed, because the library is never unloaded.
pub(super) struct Description(abi::Plugin);

// SAFETY: immutable once made, and the targets of its pointers are leaked.
unsafe impl Send for Description {}
// SAFETY: as above.
unsafe impl Sync for Description {}

impl Description {
    pub(super) fn new(package: &Package, registry: Registry) -> Self {
        let registry: &'static Registry = Box::leak(Box::new(registry));
        let mut payloads = BTreeMap::new();
        let kinds: Vec<_> = registry.kinds().map(|kind| kind_of(kind, &mut payloads)).collect();
        let payloads: Vec<_> = payloads.into_values().map(|ty| *abi::schema::describe(ty)).collect();
        let (n_kinds, n_payloads) = (kinds.len() as u64, payloads.len() as u64);
        Self(abi::Plugin {
            magic: abi::MAGIC,
            abi_major: abi::MAJOR,
            abi_minor: abi::MINOR,
            sizes: abi::Sizes::OURS,
            panic: if cfg!(panic = "abort") { abi::panics::ABORT } else { abi::panics::UNWIND },
            flags: 0,
            name: Text::of(package.name),
            version: Text::of(package.version),
            sdk: Text::of(concat!("osteoflow-node ", env!("CARGO_PKG_VERSION"))),
            compiler: Text::of(env!("OSTEOFLOW_RUSTC")),
            kinds: Vec::leak(kinds).as_ptr(),
            n_kinds,
            payloads: Vec::leak(payloads).as_ptr(),
            n_payloads,
            start: Some(log::start),
        })
    }

    pub(super) fn plugin(&'static self) -> *const abi::Plugin {
        &self.0
    }
}

fn leaked(text: String) -> Text {
    if text.is_empty() { Text::NONE } else { Text::of(String::leak(text)) }
}

fn kind_of(kind: &'static crate::Kind, payloads: &mut BTreeMap<&'static str, &'static PayloadType>) -> abi::Kind {
    let description = &kind.description;
    let mut note = |payload: PortPayload| {
        if let PortPayload::Type(ty) = payload {
            payloads.insert(ty.name, ty);
        }
    };
    let inputs: Vec<_> = description.inputs.iter().inspect(|port| note(port.payload)).map(input_of).collect();
    let (outputs, declared_schema) = match &description.outputs {
        OutputPorts::Fixed(ports) => {
            (ports.iter().inspect(|port| note(port.payload)).map(output_of).collect(), Text::NONE)
        }
        OutputPorts::Declared { schema } => (Vec::new(), leaked(schema.to_string())),
    };
    let literature: Vec<_> = description.literature.iter().map(|source| Text::of(source)).collect();
    let doc = if description.details.is_empty() {
        description.summary.clone()
    } else {
        format!("{}\n\n{}", description.summary, description.details)
    };
    abi::Kind {
        kind: Text::of(description.kind),
        doc: leaked(doc),
        params_schema: leaked(description.params.to_string()),
        example: Text::of(description.example),
        declared_schema,
        n_literature: literature.len() as u64,
        literature: Vec::leak(literature).as_ptr(),
        n_inputs: inputs.len() as u64,
        inputs: Vec::leak(inputs).as_ptr(),
        n_outputs: outputs.len() as u64,
        outputs: Vec::leak(outputs).as_ptr(),
        role: match description.role {
            Role::Node => kind::NODE,
            Role::Source => kind::SOURCE,
            Role::LiveSource => kind::LIVE_SOURCE,
        },
        kept: match description.cache {
            CachePolicy::Never => 0,
            CachePolicy::ByInputs => 1,
            CachePolicy::ByInputsAndSeed => 2,
        },
        flags: (u32::from(description.constant) * kind::CONSTANT) | (u32::from(description.unsteady) * kind::UNSTEADY),
        reserved: 0,
        data: ptr::from_ref(kind).cast::<c_void>(),
        create: Some(instance::create),
        fire: Some(instance::fire),
        destroy: Some(instance::destroy),
        max_delay_ns: Some(instance::max_delay_ns),
        silent_after_ns: Some(instance::silent_after_ns),
    }
}

fn payload_of(payload: PortPayload) -> (Text, u32) {
    match payload {
        PortPayload::Type(ty) => (Text::of(ty.name), ty.version),
        PortPayload::Any => (Text::NONE, 0),
    }
}

fn frames_of(frames: &FrameExpr) -> [Text; 3] {
    [frames.frame, frames.to, frames.from].map(Text::of_option)
}

fn input_of(port: &InputPort) -> abi::Input {
    let (payload, version) = payload_of(port.payload);
    let (join, join_n, join_ns) = match port.join {
        Join::Each => (kind::EACH, 0, 0),
        Join::Stamp { tolerance_ns } => (kind::STAMP, 0, tolerance_ns),
        Join::Collect { n } => (kind::COLLECT, n.unwrap_or(0), 0),
        Join::Latest => (kind::LATEST, 0, 0),
        Join::LatestAfter { after_ns } => (kind::LATEST, 0, after_ns),
        Join::Interpolate { max_gap_ns } => (kind::INTERPOLATE, 0, max_gap_ns.unwrap_or(-1)),
        Join::Once => (kind::ONCE, 0, 0),
        Join::Previous => (kind::PREVIOUS, 0, 0),
        // A kind declares no windows: `#[port]` has no such keys.
        Join::CollectEvery { n, .. } => (kind::COLLECT, n, 0),
        Join::CollectSpan { .. } => (kind::COLLECT, 0, 0),
    };
    let [frame, to, from] = frames_of(&port.frames);
    let flag = |is: bool, flag: u32| if is { flag } else { 0 };
    abi::Input {
        name: Text::of(port.name),
        doc: Text::of(port.doc),
        payload,
        version,
        flags: flag(port.optional, kind::OPTIONAL) | flag(port.unused, kind::UNUSED),
        join,
        join_n,
        join_ns,
        frame,
        to,
        from,
    }
}

fn output_of(port: &OutputPort) -> abi::Output {
    let (payload, version) = payload_of(port.payload);
    let [frame, to, from] = frames_of(&port.frames);
    abi::Output { name: Text::of(port.name), doc: Text::of(port.doc), payload, version, flags: 0, frame, to, from }
}
