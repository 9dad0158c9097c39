//! The plugin side of the C interface: describes and runs kinds that are written like built-in ones.
//!
//! [`crate::export!`] exports kinds from a `cdylib`. All of this runs in the plugin, with its own copies of the standard
//! library, of this crate and of `tracing`; only the types of [`crate::abi`] cross the boundary.

mod describe;
mod instance;
mod log;
mod panic;

use crate::{Function, Node, Registry, Source, abi};
use std::{marker::PhantomData, sync::OnceLock};

/// Exports kinds of nodes and sources from a crate of type `cdylib`: `osteoflow_node::export!(MyIcp, MyHole);`
///
/// Payload types of the ports are exported with them.
#[macro_export]
macro_rules! export {
    ($($kind:ty),+ $(,)?) => {
        // SAFETY: the name is prescribed by the header, and a plugin has one such function.
        #[allow(unsafe_code)]
        #[unsafe(no_mangle)]
        extern "C" fn osteoflow_describe() -> *const $crate::abi::Plugin {
            use $crate::plugin::{ViaFunction as _, ViaNode as _, ViaSource as _};
            static PLUGIN: $crate::plugin::Described = $crate::plugin::Described::new();
            let package = $crate::plugin::Package { name: env!("CARGO_PKG_NAME"), version: env!("CARGO_PKG_VERSION") };
            PLUGIN.get(&package, |registry| {
                $((&&$crate::plugin::Exported::<$kind>::new()).add(registry);)+
            })
        }
    };
}

/// The exporting crate.
pub struct Package {
    /// The crate name.
    pub name: &'static str,
    /// The crate version.
    pub version: &'static str,
}

/// A node, function or source named in [`crate::export!`].
pub struct Exported<K>(PhantomData<K>);

impl<K> Exported<K> {
    /// A marker for the kind.
    #[allow(clippy::new_without_default, reason = "used by a macro only")]
    pub fn new() -> Self {
        Self(PhantomData)
    }
}

/// Adds a node. Method resolution picks the trait that holds for the kind.
pub trait ViaNode {
    /// Adds the kind to the registry.
    fn add(&self, registry: &mut Registry);
}

impl<N: Node> ViaNode for Exported<N> {
    fn add(&self, registry: &mut Registry) {
        registry.node::<N>();
    }
}

/// Adds a source.
pub trait ViaSource {
    /// Adds the kind to the registry.
    fn add(&self, registry: &mut Registry);
}

impl<S: Source> ViaSource for &Exported<S> {
    fn add(&self, registry: &mut Registry) {
        registry.source::<S>();
    }
}

/// Adds a node without memory.
pub trait ViaFunction {
    /// Adds the kind to the registry.
    fn add(&self, registry: &mut Registry);
}

impl<F: Function> ViaFunction for &&Exported<F> {
    fn add(&self, registry: &mut Registry) {
        registry.function::<F>();
    }
}

/// The description of the plugin, made once.
pub struct Described(OnceLock<describe::Description>);

impl Described {
    /// An empty cell.
    #[allow(clippy::new_without_default, reason = "used by a macro only")]
    pub const fn new() -> Self {
        Self(OnceLock::new())
    }

    /// The description; null if making it panics, after printing the panic.
    pub fn get(&'static self, package: &Package, add: impl FnOnce(&mut Registry)) -> *const abi::Plugin {
        let made = panic::catch(|| {
            self.0.get_or_init(|| {
                let mut registry = Registry::default();
                add(&mut registry);
                describe::Description::new(package, registry)
            })
        });
        match made {
            Ok(description) => description.plugin(),
            Err(message) => {
                eprintln!("{} {message}", package.name);
                std::ptr::null()
            }
        }
    }
}
