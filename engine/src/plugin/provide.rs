//! Adds a plugin's kinds and payloads to the registry.

use super::{
    Library,
    description::{InputDescription, KindDescription, OutputsDescription, PluginDescription, PortDescription},
    node,
};
use crate::graph::extract;
use osteoflow_node::{
    CachePolicy, Description, FrameExpr, InputPort, KindClash, OutputPort, OutputPorts, PayloadClash, PayloadType,
    PortPayload, Registry, SchemaError,
};
use std::{collections::BTreeSet, sync::Arc};

/// Why a plugin cannot be added to the registry.
#[derive(Debug, thiserror::Error)]
pub enum ProvideError {
    /// A kind's name is taken or invalid.
    #[error(transparent)]
    Kind(#[from] KindClash),
    /// It was built against a different definition of a payload.
    #[error(transparent)]
    Payload(#[from] PayloadClash),
    /// A payload of its own has an invalid description.
    #[error("payload {payload}: {error}")]
    Schema {
        /// The payload.
        payload: String,
        /// What is wrong.
        error: SchemaError,
    },
    /// A port names an unknown payload.
    #[error("port \"{port}\" of kind {kind} names the payload {payload}@{version}, {known}")]
    Unknown {
        /// The kind.
        kind: String,
        /// The port.
        port: String,
        /// The payload.
        payload: String,
        /// Its version.
        version: u32,
        /// What is known instead.
        known: String,
    },
    /// The description of a kind is invalid.
    #[error("kind {kind}: {why}")]
    Unsound {
        /// The kind.
        kind: String,
        /// What is wrong.
        why: String,
    },
}

/// Adds the kinds and payloads of a plugin to a registry. `load` returns the library when the first node is built.
///
/// # Errors
/// [`ProvideError`]; kinds and payloads before the faulty one have then been added.
pub fn provide(
    registry: &mut Registry,
    description: &PluginDescription,
    sha256: &Arc<str>,
    load: impl Fn() -> Result<&'static Library, String> + Clone + Send + Sync + 'static,
) -> Result<(), ProvideError> {
    for payload in &description.payloads {
        let free = PayloadType::dynamic(&payload.name, payload.version, payload.schema.clone());
        let free = free.map_err(|error| ProvideError::Schema { payload: payload.name.clone(), error })?;
        registry.add_payload_type(free)?;
    }
    let types: Arc<[&'static PayloadType]> = registry.payload_types().collect();
    for (index, kind) in description.kinds.iter().enumerate() {
        let description = describe(registry, kind)?;
        let outputs: Vec<(String, PortPayload)> =
            description.outputs.payloads(&[]).map(|(name, payload)| (name.into(), payload)).collect();
        let (load, types) = (load.clone(), types.clone());
        registry.add_kind(description, sha256.clone(), move |params, context| {
            let library = load().map_err(|message| osteoflow_node::ParamError::new("", message))?;
            node::build(library, index, &outputs, types.clone(), params, context)
        })?;
    }
    Ok(())
}

/// Leaks a text: kinds live as long as the process, as does the library.
fn leak(text: &str) -> &'static str {
    String::leak(text.to_owned())
}

fn describe(registry: &Registry, kind: &KindDescription) -> Result<Description, ProvideError> {
    let unsound = |why: String| ProvideError::Unsound { kind: kind.kind.clone(), why };
    if !kind.kind.contains('.') || !kind.kind.split('.').all(extract::is_name) {
        return Err(unsound("a kind is called stage.variant, with letters, digits, _ and - only".into()));
    }
    let (summary, details) = kind.doc.split_once("\n\n").unwrap_or((&kind.doc, ""));
    let inputs = kind.inputs.iter().map(|input| input_port(registry, kind, input)).collect::<Result<Vec<_>, _>>()?;
    let outputs = match &kind.outputs {
        OutputsDescription::Fixed(ports) => {
            OutputPorts::Fixed(ports.iter().map(|port| output_port(registry, kind, port)).collect::<Result<_, _>>()?)
        }
        OutputsDescription::Declared(schema) => OutputPorts::Declared { schema: schema.clone() },
    };
    let given: Vec<_> = outputs.fixed().iter().map(|port| port.name).collect();
    for names in [inputs.iter().map(|port| port.name).collect(), given] {
        if let Some(name) = names.iter().find(|name| !extract::is_name(name)) {
            return Err(unsound(format!("a port is called {name:?}, but a name has letters, digits, _ and - only")));
        }
        if names.iter().collect::<BTreeSet<_>>().len() < names.len() {
            return Err(unsound("two of its ports have one name".into()));
        }
    }
    if !kind.params.is_object() {
        return Err(unsound("the schema of its parameters is no JSON object".into()));
    }
    let description = Description {
        kind: leak(&kind.kind),
        summary: summary.replace('\n', " ").trim().into(),
        details: details.trim().into(),
        role: kind.role,
        constant: kind.constant,
        unsteady: kind.unsteady,
        cache: kind.kept,
        inputs,
        outputs,
        params: kind.params.clone(),
        example: leak(&kind.example),
        literature: Vec::leak(kind.literature.iter().map(|source| leak(source)).collect()),
    };
    if kind.kept != CachePolicy::Never && description.names_files() {
        return Err(unsound("it reads a file, so its answers cannot be cached; let a source read it".into()));
    }
    Ok(description)
}

fn payload(registry: &Registry, kind: &KindDescription, port: &PortDescription) -> Result<PortPayload, ProvideError> {
    let Some((name, version)) = &port.payload else { return Ok(PortPayload::Any) };
    match registry.payload_type(name) {
        Some(ty) if ty.version == *version => Ok(PortPayload::Type(ty)),
        known => Err(ProvideError::Unknown {
            kind: kind.kind.clone(),
            port: port.name.clone(),
            payload: name.clone(),
            version: *version,
            known: match known {
                Some(ty) => {
                    format!("this program has version {}; build the plugin with the SDK of this program", ty.version)
                }
                None => "which nothing describes; describe it in the plugin, or load the plugin that does".into(),
            },
        }),
    }
}

fn frames(port: &PortDescription) -> FrameExpr {
    let [frame, to, from] = port.frames.each_ref().map(|frame| frame.as_deref().map(leak));
    FrameExpr { frame, to, from }
}

fn input_port(
    registry: &Registry,
    kind: &KindDescription,
    input: &InputDescription,
) -> Result<InputPort, ProvideError> {
    Ok(InputPort {
        name: leak(&input.port.name),
        doc: leak(&input.port.doc),
        payload: payload(registry, kind, &input.port)?,
        join: input.join,
        optional: input.optional,
        unused: input.unused,
        frames: frames(&input.port),
    })
}

fn output_port(
    registry: &Registry,
    kind: &KindDescription,
    port: &PortDescription,
) -> Result<OutputPort, ProvideError> {
    Ok(OutputPort {
        name: leak(&port.name),
        doc: leak(&port.doc),
        payload: payload(registry, kind, port)?,
        frames: frames(port),
    })
}
