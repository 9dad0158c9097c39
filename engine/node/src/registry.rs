use crate::{
    BuildContext, Built, CachePolicy, Describe, Description, Function, Inputs, Node, Outputs, ParamError, Payload,
    PayloadType, Role, SchemaEntry, Source, erased::Erased, traits::FunctionNode,
};
use std::{collections::BTreeMap, fmt, sync::Arc};

/// The kinds and payload types that a graph may name.
#[derive(Default, Clone)]
pub struct Registry {
    kinds: BTreeMap<&'static str, Arc<Kind>>,
    payloads: BTreeMap<&'static str, &'static PayloadType>,
    launcher: Option<Arc<dyn Launch>>,
}

/// Builds nodes that fire in processes of their own.
pub trait Launch: Send + Sync {
    /// Whether a node of this kind fires in a process of its own where the graph does not say.
    fn is_wanted(&self, kind: &Kind) -> bool;

    /// Starts the process and builds the node in it.
    ///
    /// # Errors
    /// [`ParamError`] if the process cannot be started, or the node not be built there.
    fn launch(&self, kind: &Kind, params: &serde_json::Value, context: &BuildContext) -> Result<Built, ParamError>;
}

impl fmt::Debug for Registry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_set().entries(self.kinds.keys()).entries(self.payloads.keys()).finish()
    }
}

/// Two payload types of one name whose versions or schemas differ.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct PayloadClash(String);

/// A kind of node: its description and its constructor.
pub struct Kind {
    /// What is known without building a node.
    pub description: Description,
    /// SHA-256 of the plugin library; `None` if the kind is built in.
    pub plugin: Option<Arc<str>>,
    build: Box<Build>,
}

/// Builds a node from checked parameters.
type Build = dyn Fn(&serde_json::Value, &BuildContext) -> Result<Built, ParamError> + Send + Sync;

/// A kind of that name is already registered.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is a kind \"{0}\" already")]
pub struct KindClash(pub &'static str);

impl Kind {
    /// Builds a node from checked parameters.
    ///
    /// # Errors
    /// [`ParamError`] if the parameters do not fit together.
    pub fn build(&self, params: &serde_json::Value, context: &BuildContext) -> Result<Built, ParamError> {
        (self.build)(params, context)
    }
}

impl Registry {
    /// Adds a kind of node.
    ///
    /// # Panics
    /// If the kind is registered already, or if its answers are cached although a parameter names a file, whose content is
    /// not part of the cache key.
    pub fn node<N: Node>(&mut self) -> &mut Self {
        let (inputs, outputs) = (N::Inputs::ports(), N::Outputs::ports());
        let mut description = description::<N, N::Params>(N::KIND, Role::Node, inputs, outputs);
        (description.cache, description.unsteady) = (N::CACHE, N::UNSTEADY);
        let reads = N::CACHE != CachePolicy::Never && description.names_files();
        assert!(!reads, "{} reads a file, so its answers cannot be cached; let a source read it", N::KIND);
        self.add(description, |p, _| Ok(Built::Node(Box::new(Erased(N::new(read(p)?)?)))))
    }

    /// Adds a kind of node that has no memory.
    ///
    /// # Panics
    /// As [`Self::node`].
    pub fn function<F: Function>(&mut self) -> &mut Self {
        self.node::<FunctionNode<F>>()
    }

    /// Adds a kind of source.
    ///
    /// # Panics
    /// If the kind is registered already.
    pub fn source<S: Source>(&mut self) -> &mut Self {
        let role = if S::LIVE { Role::LiveSource } else { Role::Source };
        let mut description = description::<S, S::Params>(S::KIND, role, Vec::new(), S::Outputs::ports());
        (description.constant, description.unsteady) = (S::CONSTANT, S::UNSTEADY);
        self.add(description, |p, context| {
            S::check_ports(&context.declared)?;
            Ok(Built::Source(Box::new(Erased(S::new(read(p)?)?))))
        })
    }

    /// Adds a payload type, so that graphs may declare ports of it and recordings with it can be read.
    pub fn payload<T: Payload<By>, By: 'static>(&mut self) -> &mut Self {
        self.payloads.insert(T::NAME, PayloadType::of::<T, By>());
        self
    }

    /// Adds a payload type and returns the registered one, which is an earlier one if name, version and schema are equal.
    ///
    /// # Errors
    /// [`PayloadClash`] if the name is registered with another version or schema.
    pub fn add_payload_type(&mut self, ty: &'static PayloadType) -> Result<&'static PayloadType, PayloadClash> {
        let (name, version) = (ty.name, ty.version);
        let known = *self.payloads.entry(name).or_insert(ty);
        if known.version != version {
            let versions = format!("is known with version {} and comes with version {version}", known.version);
            return Err(PayloadClash(format!("payload {name} {versions}; build both against one of them")));
        }
        match SchemaEntry::first_difference(known.schema, ty.schema) {
            None => Ok(known),
            Some((known, new)) => {
                let describe =
                    |entry: Option<SchemaEntry>| entry.map_or("no entry".to_owned(), |entry| entry.to_string());
                let schemas = format!("is known with {} and comes with {}", describe(known), describe(new));
                Err(PayloadClash(format!("payload {name}@{version} {schemas}; raise the version where a view changes")))
            }
        }
    }

    /// Adds a kind of the plugin library with this SHA-256.
    ///
    /// # Errors
    /// [`KindClash`] if a kind of that name is registered.
    pub fn add_kind(
        &mut self,
        description: Description,
        plugin: Arc<str>,
        build: impl Fn(&serde_json::Value, &BuildContext) -> Result<Built, ParamError> + Send + Sync + 'static,
    ) -> Result<(), KindClash> {
        let kind = description.kind;
        if self.kinds.contains_key(kind) {
            return Err(KindClash(kind));
        }
        let added = Kind { description, plugin: Some(plugin), build: Box::new(build) };
        self.kinds.insert(kind, Arc::new(added));
        Ok(())
    }

    /// Sets what builds nodes that fire in processes of their own.
    pub fn set_launcher(&mut self, launcher: Arc<dyn Launch>) {
        self.launcher = Some(launcher);
    }

    /// Builds a node of `kind` from checked parameters, in this process or one of its own.
    ///
    /// # Errors
    /// [`ParamError`] if the parameters do not fit together, or the process cannot be started.
    pub fn build(&self, kind: &Kind, params: &serde_json::Value, context: &BuildContext) -> Result<Built, ParamError> {
        let is_wanted = |launcher: &Arc<dyn Launch>| context.place.process.unwrap_or_else(|| launcher.is_wanted(kind));
        match &self.launcher {
            Some(launcher) if is_wanted(launcher) => launcher.launch(kind, params, context),
            None if context.place.process == Some(true) => {
                Err(ParamError::new("process", "this program runs no nodes in processes of their own"))
            }
            _ => kind.build(params, context),
        }
    }

    /// The kind with this name.
    pub fn kind(&self, kind: &str) -> Option<&Kind> {
        self.kinds.get(kind).map(|kind| &**kind)
    }

    /// All kinds, ordered by name.
    pub fn kinds(&self) -> impl Iterator<Item = &Kind> {
        self.kinds.values().map(|kind| &**kind)
    }

    /// The payload type with this name.
    pub fn payload_type(&self, name: &str) -> Option<&'static PayloadType> {
        self.payloads.get(name).copied()
    }

    /// All payload types, ordered by name.
    pub fn payload_types(&self) -> impl Iterator<Item = &'static PayloadType> {
        self.payloads.values().copied()
    }

    fn add(
        &mut self,
        description: Description,
        build: fn(&serde_json::Value, &BuildContext) -> Result<Built, ParamError>,
    ) -> &mut Self {
        let kind = description.kind;
        let added = Kind { description, plugin: None, build: Box::new(build) };
        let before = self.kinds.insert(kind, Arc::new(added));
        assert!(before.is_none(), "the kind {kind} is registered twice");
        self
    }
}

fn description<D: Describe, P: crate::Parameters>(
    kind: &'static str,
    role: Role,
    inputs: Vec<crate::InputPort>,
    outputs: crate::OutputPorts,
) -> Description {
    let (summary, details) = D::DOC.split_once("\n\n").unwrap_or((D::DOC, ""));
    Description {
        kind,
        summary: summary.replace('\n', " ").trim().into(),
        details: details.trim().into(),
        role,
        constant: false,
        unsteady: false,
        cache: CachePolicy::Never,
        inputs,
        outputs,
        params: schemars::schema_for!(P).to_value(),
        example: D::EXAMPLE,
        literature: D::LITERATURE,
    }
}

fn read<P: crate::Parameters>(params: &serde_json::Value) -> Result<P, ParamError> {
    P::deserialize(params).map_err(|error| ParamError::new("", error.to_string()))
}
