use proc_macro2::TokenStream;
use quote::quote;
use syn::{Attribute, DeriveInput, Error, Expr, ExprArray, ExprLit, Lit, LitStr, Meta, Result};

pub(crate) fn describe(input: &DeriveInput) -> Result<TokenStream> {
    let doc = doc_of(&input.attrs);
    if doc.is_empty() {
        return Err(Error::new_spanned(&input.ident, "a node needs a doc comment that says what it gives"));
    }
    let mut example = LitStr::new("", input.ident.span());
    let mut literature = Vec::new();
    for attr in input.attrs.iter().filter(|a| a.path().is_ident("describe")) {
        attr.parse_nested_meta(|meta| {
            if meta.path.is_ident("example") {
                example = meta.value()?.parse()?;
            } else if meta.path.is_ident("literature") {
                let list: ExprArray = meta.value()?.parse()?;
                literature.extend(list.elems);
            } else {
                return Err(meta.error("known here: example, literature"));
            }
            Ok(())
        })?;
    }
    let name = &input.ident;
    let (generics, types, bounds) = input.generics.split_for_impl();
    Ok(quote! {
        impl #generics ::osteoflow_node::Describe for #name #types #bounds {
            const DOC: &'static str = #doc;
            const EXAMPLE: &'static str = #example;
            const LITERATURE: &'static [&'static str] = &[#(#literature),*];
        }
    })
}

/// The text of a doc comment, without the space after the slashes.
pub(crate) fn doc_of(attrs: &[Attribute]) -> String {
    let lines = attrs.iter().filter(|a| a.path().is_ident("doc")).filter_map(|a| match &a.meta {
        Meta::NameValue(pair) => match &pair.value {
            Expr::Lit(ExprLit { lit: Lit::Str(text), .. }) => Some(text.value()),
            _ => None,
        },
        _ => None,
    });
    let lines: Vec<_> = lines.map(|l| l.strip_prefix(' ').unwrap_or(&l).to_owned()).collect();
    lines.join("\n").trim().to_owned()
}
