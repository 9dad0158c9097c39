use crate::{
    Built, Describe, Description, Inputs, Kept, Node, Outputs, ParamError, Part, Payload, PayloadType, Role, Site,
    Source, erased::Erased,
};
use std::{collections::BTreeMap, fmt, sync::Arc};

/// The kinds and payload types that a graph may name.
#[derive(Default, Clone)]
pub struct Registry {
    kinds: BTreeMap<&'static str, Arc<Kind>>,
    payloads: BTreeMap<&'static str, &'static PayloadType>,
}

impl fmt::Debug for Registry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_set().entries(self.kinds.keys()).entries(self.payloads.keys()).finish()
    }
}

/// Two payload types of one name, which cannot both be known.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PayloadClash {
    /// They have two versions.
    #[error(
        "payload {name} is known with version {known} and comes with version {new}; build both against one of them"
    )]
    Version {
        /// The name.
        name: &'static str,
        /// The version known before.
        known: u32,
        /// The version that was to be added.
        new: u32,
    },
    /// Their views hold different things.
    #[error(
        "payload {name}@{version} is known with {known} and comes with {new}; raise the version where a view changes"
    )]
    Schema {
        /// The name.
        name: &'static str,
        /// The version of both.
        version: u32,
        /// The first part that differs, of the type known before.
        known: String,
        /// The same of the type that was to be added.
        new: String,
    },
}

/// A kind: its description, and how to build it.
pub struct Kind {
    /// Everything known without building.
    pub description: Description,
    /// The SHA-256 of the library that brings it; `None` if it is built in.
    pub plugin: Option<Arc<str>>,
    build: Box<Build>,
}

/// Builds a node from checked parameters.
type Build = dyn Fn(&serde_json::Value, &Site) -> Result<Built, ParamError> + Send + Sync;

/// A kind that is known already.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is a kind \"{0}\" already")]
pub struct KindClash(pub &'static str);

impl Kind {
    /// Builds a node from checked parameters.
    ///
    /// # Errors
    /// [`ParamError`] if the parameters do not fit together.
    pub fn build(&self, params: &serde_json::Value, site: &Site) -> Result<Built, ParamError> {
        (self.build)(params, site)
    }
}

impl Registry {
    /// Adds a kind of node.
    ///
    /// # Panics
    /// If the kind is there already: two nodes of one name are a bug of whoever collects them. If its answers are kept
    /// although a parameter names a file, whose content would not decide them.
    pub fn node<N: Node>(&mut self) -> &mut Self {
        self.add::<N>(
            N::KIND,
            Role::Node,
            N::Inputs::ports(),
            N::Outputs::ports(),
            params_schema::<N::Params>(),
            |p, _| Ok(Built::Node(Box::new(Erased(N::new(read(p)?)?)))),
        );
        if let Some(kind) = self.kinds.get_mut(N::KIND).and_then(Arc::get_mut) {
            kind.description.kept = N::KEPT;
            let reads = N::KEPT != Kept::No && kind.description.names_files();
            assert!(!reads, "{} reads a file, so its answers cannot be kept; let a source read it", N::KIND);
        }
        self
    }

    /// Adds a kind of source.
    ///
    /// # Panics
    /// If the kind is there already: two nodes of one name are a bug of whoever collects them.
    pub fn source<S: Source>(&mut self) -> &mut Self {
        let role = if S::LIVE { Role::LiveSource } else { Role::Source };
        self.add::<S>(S::KIND, role, Vec::new(), S::Outputs::ports(), params_schema::<S::Params>(), |p, _| {
            Ok(Built::Source(Box::new(Erased(S::new(read(p)?)?))))
        });
        if let Some(kind) = self.kinds.get_mut(S::KIND).and_then(Arc::get_mut) {
            kind.description.constant = S::CONSTANT;
        }
        self
    }

    /// Adds a payload type, so that graphs may declare ports of it and recordings of it can be read.
    pub fn payload<T: Payload<By>, By: 'static>(&mut self) -> &mut Self {
        self.payloads.insert(T::NAME, PayloadType::of::<T, By>());
        self
    }

    /// Adds a payload type that was made at run time, and gives the one that is known from now on: the one before, where
    /// there was one with the same version and schema.
    ///
    /// # Errors
    /// [`PayloadClash`] if another version or schema is known by that name.
    pub fn add_payload_type(&mut self, ty: &'static PayloadType) -> Result<&'static PayloadType, PayloadClash> {
        let name = ty.name;
        let known = *self.payloads.entry(name).or_insert(ty);
        if known.version != ty.version {
            return Err(PayloadClash::Version { name, known: known.version, new: ty.version });
        }
        match Part::first_difference(known.schema, ty.schema) {
            None => Ok(known),
            Some((known, new)) => {
                let told = |part: Option<Part>| part.map_or("nothing there".into(), |part| part.to_string());
                Err(PayloadClash::Schema { name, version: ty.version, known: told(known), new: told(new) })
            }
        }
    }

    /// Adds a kind that the library with this SHA-256 brings.
    ///
    /// # Errors
    /// [`KindClash`] if a kind is known by that name.
    pub fn add_kind(
        &mut self,
        description: Description,
        plugin: Arc<str>,
        build: impl Fn(&serde_json::Value, &Site) -> Result<Built, ParamError> + Send + Sync + 'static,
    ) -> Result<(), KindClash> {
        let kind = description.kind;
        if self.kinds.contains_key(kind) {
            return Err(KindClash(kind));
        }
        let added = Kind { description, plugin: Some(plugin), build: Box::new(build) };
        self.kinds.insert(kind, Arc::new(added));
        Ok(())
    }

    /// The kind of that name.
    pub fn kind(&self, kind: &str) -> Option<&Kind> {
        self.kinds.get(kind).map(|kind| &**kind)
    }

    /// All kinds, by name.
    pub fn kinds(&self) -> impl Iterator<Item = &Kind> {
        self.kinds.values().map(|kind| &**kind)
    }

    /// The payload type of that name.
    pub fn payload_type(&self, name: &str) -> Option<&'static PayloadType> {
        self.payloads.get(name).copied()
    }

    /// All payload types, by name.
    pub fn payload_types(&self) -> impl Iterator<Item = &'static PayloadType> {
        self.payloads.values().copied()
    }

    fn add<D: Describe>(
        &mut self,
        kind: &'static str,
        role: Role,
        inputs: Vec<crate::InputPort>,
        outputs: crate::OutputPorts,
        params: serde_json::Value,
        build: fn(&serde_json::Value, &Site) -> Result<Built, ParamError>,
    ) -> &mut Self {
        let (summary, details) = D::DOC.split_once("\n\n").unwrap_or((D::DOC, ""));
        let description = Description {
            kind,
            summary: summary.replace('\n', " ").trim().into(),
            details: details.trim().into(),
            role,
            constant: false,
            kept: Kept::No,
            inputs,
            outputs,
            params,
            example: D::EXAMPLE,
            literature: D::LITERATURE,
        };
        let added = Kind { description, plugin: None, build: Box::new(build) };
        let before = self.kinds.insert(kind, Arc::new(added));
        assert!(before.is_none(), "two nodes are called {kind}");
        self
    }
}

fn params_schema<P: crate::Parameters>() -> serde_json::Value {
    schemars::schema_for!(P).to_value()
}

fn read<P: crate::Parameters>(params: &serde_json::Value) -> Result<P, ParamError> {
    P::deserialize(params).map_err(|error| ParamError::new("", error.to_string()))
}
