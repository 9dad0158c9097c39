//! The plugin's side: kinds written as built-in ones are, described and called through the C interface.
//!
//! [`crate::export!`] closes a crate of type `cdylib`. Everything here runs in the plugin, with the plugin's own copies of
//! the standard library, of this crate and of `tracing`; only what [`crate::abi`] defines crosses.

mod describe;
mod host;
mod instance;
mod log;
mod panic;

pub(crate) use host::{Host, HostBudget};

use crate::{Node, Registry, Source, abi};
use std::{marker::PhantomData, sync::OnceLock};

/// Exports kinds of nodes and sources from a crate of type `cdylib`: `osteoflow_node::export!(MyIcp, MyHole);`
///
/// Payload types of the plugin's own need no mention: those that ports name are described with them.
#[macro_export]
macro_rules! export {
    ($($kind:ty),+ $(,)?) => {
        // SAFETY: the name is the one that the header promises, and a plugin has one such function.
        #[allow(unsafe_code)]
        #[unsafe(no_mangle)]
        extern "C" fn osteoflow_describe() -> *const $crate::abi::Plugin {
            use $crate::plugin::{ViaNode as _, ViaSource as _};
            static PLUGIN: $crate::plugin::Described = $crate::plugin::Described::new();
            let about = $crate::plugin::About { name: env!("CARGO_PKG_NAME"), version: env!("CARGO_PKG_VERSION") };
            PLUGIN.get(&about, |registry| {
                $((&$crate::plugin::Exported::<$kind>::new()).add(registry);)+
            })
        }
    };
}

/// The crate that exports.
pub struct About {
    /// Its name.
    pub name: &'static str,
    /// Its version.
    pub version: &'static str,
}

/// A kind named in [`crate::export!`]: a node or a source.
pub struct Exported<K>(PhantomData<K>);

impl<K> Exported<K> {
    /// The kind.
    #[allow(clippy::new_without_default, reason = "named by a macro only")]
    pub fn new() -> Self {
        Self(PhantomData)
    }
}

/// Adds a node; the method that the macro finds if the kind is one.
pub trait ViaNode {
    /// Adds it.
    fn add(&self, registry: &mut Registry);
}

impl<N: Node> ViaNode for Exported<N> {
    fn add(&self, registry: &mut Registry) {
        registry.node::<N>();
    }
}

/// Adds a source; the method that the macro finds if the kind is no node.
pub trait ViaSource {
    /// Adds it.
    fn add(&self, registry: &mut Registry);
}

impl<S: Source> ViaSource for &Exported<S> {
    fn add(&self, registry: &mut Registry) {
        registry.source::<S>();
    }
}

/// The plugin's description, made once.
pub struct Described(OnceLock<describe::Description>);

impl Described {
    /// One that is not made yet.
    #[allow(clippy::new_without_default, reason = "named by a macro only")]
    pub const fn new() -> Self {
        Self(OnceLock::new())
    }

    /// The description; null if it panics, which is printed.
    pub fn get(&'static self, about: &About, add: impl FnOnce(&mut Registry)) -> *const abi::Plugin {
        let made = panic::catch(|| {
            self.0.get_or_init(|| {
                let mut registry = Registry::default();
                add(&mut registry);
                describe::Description::new(about, registry)
            })
        });
        match made {
            Ok(description) => description.plugin(),
            Err(said) => {
                eprintln!("{} {said}", about.name);
                std::ptr::null()
            }
        }
    }
}
