//! Loads a shared library and reads its plugin description.
#![allow(unsafe_code, reason = "loads a library and reads what it describes")]

use super::description::{InputDescription, KindDescription, OutputsDescription, PluginDescription, PortDescription};
use crate::{activity::Name, plan::Loads};
use osteoflow_node::{
    CachePolicy, Join, Role,
    abi::{self, AbiError, kind, panics},
};
use std::{
    path::{Path, PathBuf},
    sync::Once,
};

/// A library that is not a plugin for this program.
#[derive(Debug, thiserror::Error)]
#[error("{}: {why}", path.display())]
pub struct LibraryError {
    /// The file.
    pub path: PathBuf,
    /// The cause.
    pub why: Why,
}

/// Why a library is not a plugin for this program.
#[derive(Debug, thiserror::Error)]
pub enum Why {
    /// The system cannot load it.
    #[error("the system cannot load it: {0}")]
    Load(String),
    /// It does not export the entry function.
    #[error(
        "it has no function osteoflow_describe, so it is no plugin; close the crate with osteoflow_node::export!, or export the function of osteoflow.h"
    )]
    NoSymbol,
    /// The entry function returned null.
    #[error("its description is a null pointer; what it printed may say why")]
    NoDescription,
    /// The description does not begin with the magic bytes.
    #[error("its description does not begin with OSTEOPLG, so it is no plugin of this program")]
    Magic,
    /// It uses an incompatible version of the interface.
    #[error("it speaks version {}.{} of the plugin interface, this program {}.{}; build it with the SDK of this program", found.0, found.1, ours.0, ours.1)]
    Version {
        /// The plugin's version.
        found: (u32, u32),
        /// The program's version.
        ours: (u32, u32),
    },
    /// Its structs are smaller than the interface requires.
    #[error("its {what} has {found} bytes, at least {needed} are needed by version {}.{}; it speaks {}.{}", ours.0, ours.1, theirs.0, theirs.1)]
    Size {
        /// The struct.
        what: &'static str,
        /// Size as compiled into the plugin.
        found: u32,
        /// Minimum size.
        needed: u32,
        /// The program's version.
        ours: (u32, u32),
        /// The plugin's version.
        theirs: (u32, u32),
    },
    /// It aborts on panic, which would end the program.
    #[error(
        "it was built with panic = \"abort\", so that a panic of a node would end the program; build it with panic = \"unwind\""
    )]
    PanicAbort,
    /// A part of the description is invalid.
    #[error("its description is not sound: {0}")]
    Unsound(String),
}

impl From<AbiError> for Why {
    fn from(error: AbiError) -> Self {
        Self::Unsound(error.to_string())
    }
}

/// A loaded plugin.
pub struct Library {
    /// The file as it is shown, for reports of calls into it.
    file: Name,
    description: PluginDescription,
    kinds: Vec<abi::Kind>,
    start: Option<unsafe extern "C" fn(*const abi::Host)>,
    started: Once,
}

// SAFETY: the pointers are valid and their targets constant as long as the library, which is never unloaded.
unsafe impl Send for Library {}
// SAFETY: as above.
unsafe impl Sync for Library {}

const OURS: (u32, u32) = (abi::MAJOR, abi::MINOR);

impl Library {
    /// Loads the library at `path` and reads its description. Runs its initialisers: a crash there ends the process.
    ///
    /// # Errors
    /// [`LibraryError`] naming the file.
    pub fn load(path: &Path) -> Result<Self, LibraryError> {
        let absolute = std::path::absolute(path).unwrap_or_else(|_| path.into());
        let library = Self::of(&absolute).map_err(|why| LibraryError { path: path.into(), why })?;
        Ok(library.shown_as(path))
    }

    fn of(path: &Path) -> Result<Self, Why> {
        // SAFETY: the safety of a library's initialisers is its author's responsibility, as documented.
        let library = unsafe { open(path) }.map_err(|error| Why::Load(system_message(&error)))?;
        // Never unloaded: its descriptions, buffers and threads may outlive any use.
        let library = Box::leak(Box::new(library));
        // SAFETY: the header declares the function with this type.
        let describe = unsafe { library.get::<abi::DescribeFn>(abi::SYMBOL.as_bytes()) };
        let describe = describe.map_err(|_| Why::NoSymbol)?;
        // SAFETY: as above.
        let plugin = unsafe { describe() };
        // SAFETY: the function returns a description, or something distinguishable from one by its first bytes.
        unsafe { Self::read(plugin) }
    }

    /// # Safety
    /// `plugin` is null, or points to a description as in the header, at least to the bytes of magic, version and
    /// sizes.
    unsafe fn read(plugin: *const abi::Plugin) -> Result<Self, Why> {
        if plugin.is_null() {
            return Err(Why::NoDescription);
        }
        if !plugin.is_aligned() {
            return Err(Why::Unsound("it is not aligned".into()));
        }
        // SAFETY: guaranteed by the caller: magic and version have the same offsets in every version.
        let (magic, theirs) = unsafe { ((*plugin).magic, ((*plugin).abi_major, (*plugin).abi_minor)) };
        if magic != abi::MAGIC {
            return Err(Why::Magic);
        }
        if theirs.0 != abi::MAJOR {
            return Err(Why::Version { found: theirs, ours: OURS });
        }
        // SAFETY: within this major version, the sizes follow.
        let sizes = unsafe { (*plugin).sizes };
        check_sizes(&sizes, theirs)?;
        // SAFETY: the description is as large as its size field says.
        let raw = unsafe { abi::entries(plugin, 1, sizes.plugin, "the description") }?[0];
        if raw.panic == panics::ABORT {
            return Err(Why::PanicAbort);
        }
        // SAFETY: guaranteed by the caller, here and below.
        let kinds = unsafe { abi::entries(raw.kinds, raw.n_kinds, sizes.kind, "the kinds") }?;
        // SAFETY: as above.
        let payloads = unsafe { abi::entries(raw.payloads, raw.n_payloads, sizes.payload, "the payloads") }?;
        // SAFETY: as above.
        let payloads = payloads.iter().map(|payload| unsafe { abi::schema::read(payload, sizes.part) });
        // SAFETY: as above.
        let text = |text, what| unsafe { abi::text(text, what) }.map(|text| text.unwrap_or_default().to_owned());
        let described = PluginDescription {
            name: text(raw.name, "the plugin's name")?,
            version: text(raw.version, "the plugin's version")?,
            sdk: text(raw.sdk, "the plugin's SDK")?,
            compiler: text(raw.compiler, "the plugin's compiler")?,
            abi: theirs,
            // SAFETY: as above.
            kinds: kinds.iter().map(|kind| unsafe { read_kind(kind, &sizes) }).collect::<Result<_, _>>()?,
            payloads: payloads.collect::<Result<_, _>>()?,
            loads: Loads::default(),
            watched: Vec::new(),
        };
        Ok(Self { description: described, kinds, start: raw.start, started: Once::new(), file: Name::of("") })
    }

    /// The plugin's description.
    pub fn description(&self) -> &PluginDescription {
        &self.description
    }

    /// The same library, reported by another path than that of the copy it was loaded from.
    pub(super) fn shown_as(self, path: &Path) -> Self {
        Self { file: Name::of(&path.display().to_string()), ..self }
    }

    /// The file, for reports of calls into it.
    pub(super) fn file(&self) -> Name {
        self.file
    }

    /// The kind at an index of [`PluginDescription::kinds`].
    pub(super) fn kind(&self, index: usize) -> &abi::Kind {
        &self.kinds[index]
    }

    /// Calls the plugin's `start` once, before its first node is built.
    pub(super) fn start(&self, host: &'static abi::Host) {
        self.started.call_once(|| {
            if let Some(start) = self.start {
                // SAFETY: the plugin calls it as the header requires.
                unsafe { start(host) };
            }
        });
    }
}

/// # Safety
/// Runs the library's initialisers.
#[cfg(unix)]
unsafe fn open(path: &Path) -> Result<libloading::Library, libloading::Error> {
    use libloading::os::unix::{Library, RTLD_LOCAL, RTLD_NOW};
    // RTLD_NOW reports missing symbols immediately. RTLD_LOCAL keeps equal symbols of two plugins apart.
    // SAFETY: guaranteed by the caller.
    unsafe { Library::open(Some(path), RTLD_NOW | RTLD_LOCAL) }.map(Into::into)
}

/// # Safety
/// Runs the library's initialisers.
#[cfg(not(unix))]
unsafe fn open(path: &Path) -> Result<libloading::Library, libloading::Error> {
    // SAFETY: guaranteed by the caller.
    unsafe { libloading::Library::new(path) }
}

/// The system's error message, which libloading stores as the source.
fn system_message(error: &libloading::Error) -> String {
    std::error::Error::source(error).map_or_else(|| error.to_string(), ToString::to_string)
}

fn check_sizes(found: &abi::Sizes, theirs: (u32, u32)) -> Result<(), Why> {
    // The sizes of minor version 0, which are the current ones.
    let minimum = abi::Sizes::OURS;
    let pairs = [
        ("osteoflow_plugin", found.plugin, minimum.plugin),
        ("osteoflow_kind", found.kind, minimum.kind),
        ("osteoflow_input", found.input, minimum.input),
        ("osteoflow_output", found.output, minimum.output),
        ("osteoflow_payload", found.payload, minimum.payload),
        ("osteoflow_part", found.part, minimum.part),
        ("osteoflow_host", found.host, minimum.host),
        ("osteoflow_firing", found.firing, minimum.firing),
        ("osteoflow_slot", found.slot, minimum.slot),
        ("osteoflow_item", found.item, minimum.item),
        ("osteoflow_view", found.view, minimum.view),
        ("osteoflow_column", found.column, minimum.column),
        ("osteoflow_param", found.param, minimum.param),
        ("osteoflow_declared", found.declared, minimum.declared),
    ];
    match pairs.into_iter().find(|(_, found, needed)| found < needed) {
        Some((what, found, needed)) => Err(Why::Size { what, found, needed, ours: OURS, theirs }),
        None => Ok(()),
    }
}

/// # Safety
/// `kind` belongs to a plugin's description.
unsafe fn read_kind(given: &abi::Kind, sizes: &abi::Sizes) -> Result<KindDescription, AbiError> {
    // SAFETY: guaranteed by the caller, here and below.
    let name = unsafe { abi::required_text(given.kind, "the name of a kind") }?.to_owned();
    let what = |part: &str| format!("{part} of kind {name}");
    // SAFETY: as above.
    let text = |text, part: &str| unsafe { abi::text(text, &what(part)) }.map(|t| t.map(str::to_owned));
    let missing = |part: &str| AbiError::null(what(part));
    let has = (given.create.is_some(), given.fire.is_some(), given.destroy.is_some());
    if let Some(part) = match has {
        (false, ..) => Some("the function create"),
        (_, false, _) => Some("the function fire"),
        (.., false) => Some("the function destroy"),
        _ => None,
    } {
        return Err(missing(part));
    }
    let json = |given: Option<String>, part: &str| match given {
        None => Ok(None),
        Some(given) => serde_json::from_str(&given)
            .map(Some)
            .map_err(|error| AbiError(format!("{} is not JSON: {error}", what(part)))),
    };
    let params = json(text(given.params_schema, "the parameters' schema")?, "the parameters' schema")?;
    let declared = json(text(given.declared_schema, "the outputs' schema")?, "the outputs' schema")?;
    // SAFETY: as above.
    let literature = unsafe { abi::list(given.literature, given.n_literature, &what("the literature")) }?;
    // SAFETY: as above.
    let inputs = unsafe { abi::entries(given.inputs, given.n_inputs, sizes.input, &what("the inputs")) }?;
    // SAFETY: as above.
    let outputs = unsafe { abi::entries(given.outputs, given.n_outputs, sizes.output, &what("the outputs")) }?;
    let code = |part: &str, code| AbiError::code(what(part), code);
    let port = |name: abi::Text, doc, payload, version, frames: [abi::Text; 3]| -> Result<PortDescription, AbiError> {
        let port = text(name, "the name of a port")?.ok_or_else(|| missing("the name of a port"))?;
        let [frame, to, from] = frames.map(|frame| text(frame, "a frame of a port"));
        Ok(PortDescription {
            doc: text(doc, &format!("the doc of port \"{port}\""))?.unwrap_or_default(),
            payload: text(payload, &format!("the payload of port \"{port}\""))?.map(|name| (name, version)),
            frames: [frame?, to?, from?],
            name: port,
        })
    };
    let input = |input: &abi::Input| -> Result<InputDescription, AbiError> {
        let frames = [input.frame, input.to, input.from];
        let port = port(input.name, input.doc, input.payload, input.version, frames)?;
        let join = match input.join {
            kind::EACH => Join::Each,
            kind::STAMP => Join::Stamp { tolerance_ns: input.join_ns },
            kind::COLLECT => Join::Collect { n: Some(input.join_n).filter(|n| *n > 0) },
            kind::LATEST if input.join_ns > 0 => Join::LatestAfter { after_ns: input.join_ns },
            kind::LATEST => Join::Latest,
            kind::INTERPOLATE => Join::Interpolate { max_gap_ns: Some(input.join_ns).filter(|ns| *ns >= 0) },
            kind::ONCE => Join::Once,
            kind::PREVIOUS => Join::Previous,
            unknown => return Err(code(&format!("the join of port \"{}\"", port.name), unknown)),
        };
        let (optional, unused) = (input.flags & kind::OPTIONAL != 0, input.flags & kind::UNUSED != 0);
        Ok(InputDescription { port, join, optional, unused })
    };
    let output = |output: &abi::Output| {
        let frames = [output.frame, output.to, output.from];
        port(output.name, output.doc, output.payload, output.version, frames)
    };
    Ok(KindDescription {
        doc: text(given.doc, "the doc")?.unwrap_or_default(),
        params: params.unwrap_or_else(|| serde_json::json!({ "type": "object", "additionalProperties": false })),
        example: text(given.example, "the example")?.unwrap_or_default(),
        literature: literature
            .iter()
            .map(|source| text(*source, "the literature").map(Option::unwrap_or_default))
            .collect::<Result<_, _>>()?,
        role: match given.role {
            kind::NODE => Role::Node,
            kind::SOURCE => Role::Source,
            kind::LIVE_SOURCE => Role::LiveSource,
            unknown => return Err(code("the role", unknown)),
        },
        constant: given.flags & kind::CONSTANT != 0,
        unsteady: given.flags & kind::UNSTEADY != 0,
        kept: match given.kept {
            0 => CachePolicy::Never,
            1 => CachePolicy::ByInputs,
            2 => CachePolicy::ByInputsAndSeed,
            unknown => return Err(code("what is kept", unknown)),
        },
        inputs: inputs.iter().map(input).collect::<Result<_, _>>()?,
        outputs: match declared {
            Some(schema) => OutputsDescription::Declared(schema),
            None => OutputsDescription::Fixed(outputs.iter().map(output).collect::<Result<_, _>>()?),
        },
        kind: name,
    })
}
