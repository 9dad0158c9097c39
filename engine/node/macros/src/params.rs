use proc_macro2::TokenStream;
use quote::{ToTokens, format_ident, quote};
use syn::{
    Error, Expr, ExprLit, ExprRange, Field, Ident, ItemStruct, Lit, RangeLimits, Result, Token, parse_quote,
    punctuated::Punctuated,
};

pub(crate) fn params(required: &[Ident], mut item: ItemStruct) -> Result<TokenStream> {
    let name = &item.ident;
    let (mut names, mut values, mut functions) = (Vec::new(), Vec::new(), Vec::new());
    for field in &mut item.fields {
        let Some(field_name) = field.ident.clone() else {
            return Err(Error::new_spanned(field, "a parameter has a name"));
        };
        if required.contains(&field_name) {
            continue;
        }
        let value = default_of(field)?;
        if !required.is_empty() {
            let (function, ty) = (format_ident!("default_{field_name}"), &field.ty);
            let path = format!("{name}::{function}");
            field.attrs.push(parse_quote!(#[serde(default = #path)]));
            functions.push(quote!(fn #function() -> #ty { #value }));
        }
        names.push(field_name);
        values.push(value);
    }
    let read = item
        .attrs
        .iter()
        .any(|a| a.path().is_ident("derive") && a.to_token_stream().to_string().contains("Deserialize"));
    if read && !item.attrs.iter().any(|a| a.path().is_ident("serde")) {
        let defaults = required.is_empty().then(|| quote!(default,));
        item.attrs.push(parse_quote!(#[serde(#defaults deny_unknown_fields)]));
    }
    Ok(if required.is_empty() {
        quote! {
            #item
            impl ::core::default::Default for #name {
                fn default() -> Self { Self { #(#names: #values),* } }
            }
        }
    } else {
        quote!(#item impl #name { #(#functions)* })
    })
}

/// Takes `#[param(default)]` or `#[param(default, min..=max)]` from a field, and leaves the range to its schema.
fn default_of(field: &mut Field) -> Result<Expr> {
    let Some(at) = field.attrs.iter().position(|a| a.path().is_ident("param")) else {
        if matches!(field.ty.to_token_stream().to_string().as_str(), "f64" | "i64" | "u32" | "u64" | "usize") {
            return Err(Error::new_spanned(field, "a number states its default: #[param(1.0)]"));
        }
        return Ok(parse_quote!(::core::default::Default::default()));
    };
    let attr = field.attrs.remove(at);
    let parts = attr.parse_args_with(Punctuated::<Expr, Token![,]>::parse_terminated)?;
    let mut parts = parts.into_iter();
    let value = parts.next().map(|value| match value {
        Expr::Lit(ExprLit { lit: Lit::Str(text), .. }) => parse_quote!(#text.into()),
        value => value,
    });
    match (value, parts.next(), parts.next()) {
        (Some(value), None, None) => Ok(value),
        (
            Some(value),
            Some(Expr::Range(ExprRange { start: Some(min), limits: RangeLimits::Closed(_), end: Some(max), .. })),
            None,
        ) => {
            field.attrs.push(parse_quote!(#[schemars(range(min = #min, max = #max))]));
            Ok(value)
        }
        _ => Err(Error::new_spanned(attr, "expected #[param(default)] or #[param(default, min..=max)]")),
    }
}
