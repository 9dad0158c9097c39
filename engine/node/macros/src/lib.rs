//! The derives of `osteoflow-node`, and the defaults of parameters. The code of the derives names `osteoflow_node` only.

use proc_macro::TokenStream;
use quote::quote;
use syn::{DeriveInput, Ident, ItemImpl, ItemStruct, LitStr, Token, parse_macro_input, punctuated::Punctuated};

mod describe;
mod function;
mod params;
mod port;

/// Derives input ports from the fields of a struct.
///
/// A field of type `T` is a port that takes `T`; `Option<T>` may stay unwired and receives empties; `Vec<T>` collects;
/// `Unused<T>` is drained; `Value` takes any payload, and `Option<Value>` any or none. `#[port(join = "each" | "stamp" |
/// "collect" | "latest" | "interpolate" | "once" | "previous", tolerance_ms = .., n = .., max_gap_ms = .., after_ms = .., frame = "..", to = "..",
/// from = "..")]`.
#[proc_macro_derive(Inputs, attributes(port))]
pub fn inputs(input: TokenStream) -> TokenStream {
    expand(port::inputs(&parse_macro_input!(input as DeriveInput)))
}

/// Derives output ports from the fields of a struct: `T` always has a value, `Emit<T>` a value, an empty or nothing.
#[proc_macro_derive(Outputs, attributes(port))]
pub fn outputs(input: TokenStream) -> TokenStream {
    expand(port::outputs(&parse_macro_input!(input as DeriveInput)))
}

/// Derives the documentation of a kind from its doc comment and `#[describe(example = "...", literature = ["..."])]`.
#[proc_macro_derive(Describe, attributes(describe))]
pub fn describe(input: TokenStream) -> TokenStream {
    expand(describe::describe(&parse_macro_input!(input as DeriveInput)))
}

/// Reads parameters whose fields state their defaults and ranges: `#[param(5.0)]`, `#[param(5.0, 0.0..=10.0)]`; a field without it has
/// the default of its type.
///
/// Stands before the derives. The struct gets `Default`, the schema the ranges, and serde `default, deny_unknown_fields` unless the
/// struct has an attribute of serde. `#[params(path)]`: the field `path` must be given, so there is no `Default`.
#[proc_macro_attribute]
pub fn params(required: TokenStream, item: TokenStream) -> TokenStream {
    let required = parse_macro_input!(required with Punctuated::<Ident, Token![,]>::parse_terminated);
    expand(params::params(&Vec::from_iter(required), parse_macro_input!(item as ItemStruct)))
}

/// Implements `Function`, a kind without memory, by `process` alone: `#[function("icp.symmetric")] impl Symmetric { fn process(..) .. }`.
/// The types are those of its signature; other items of the trait, such as `const CACHE`, may stand beside it.
#[proc_macro_attribute]
pub fn function(kind: TokenStream, block: TokenStream) -> TokenStream {
    let (kind, block) = (parse_macro_input!(kind as LitStr), parse_macro_input!(block as ItemImpl));
    expand(function::function(&kind, &block))
}

fn expand(tokens: syn::Result<proc_macro2::TokenStream>) -> TokenStream {
    tokens
        .unwrap_or_else(|error| {
            let error = error.into_compile_error();
            quote!(#error)
        })
        .into()
}
