use crate::describe::doc_of;
use proc_macro2::TokenStream;
use quote::quote;
use syn::{
    Data, DeriveInput, Error, Field, Fields, GenericArgument, Ident, LitFloat, LitInt, LitStr, PathArguments, Result,
    Type,
};

/// The keys of `#[port(...)]`.
#[derive(Default)]
struct PortAttr {
    join: Option<LitStr>,
    n: Option<u32>,
    tolerance_ms: Option<f64>,
    max_gap_ms: Option<f64>,
    after_ms: Option<f64>,
    frame: Option<LitStr>,
    to: Option<LitStr>,
    from: Option<LitStr>,
}

/// The type of a field, classified by its outermost name.
enum FieldType<'a> {
    Plain(&'a Type),
    Optional(&'a Type),
    Many(&'a Type),
    ManyOptional(&'a Type),
    Unused(&'a Type),
    Emit(&'a Type),
    Any,
    OptionalAny,
}

pub(crate) fn inputs(input: &DeriveInput) -> Result<TokenStream> {
    let mut ports = Vec::new();
    let mut takes = Vec::new();
    for (index, field) in named_fields(input)?.iter().enumerate() {
        let (ident, name) = name_of(field)?;
        let attr = attr_of(field)?;
        let ty = field_type(&field.ty);
        let (payload, take, optional, unused) = match &ty {
            FieldType::Plain(t) => (payload(t), quote!(take_one::<#t>), false, false),
            FieldType::Optional(t) => (payload(t), quote!(take_optional::<#t>), true, false),
            FieldType::Many(t) => (payload(t), quote!(take_many::<#t>), false, false),
            FieldType::ManyOptional(t) => (payload(t), quote!(take_many_optional::<#t>), true, false),
            FieldType::Unused(t) => (payload(t), quote!(), true, true),
            FieldType::Any => (quote!(::osteoflow_node::derive::any_payload()), quote!(take_any), false, false),
            FieldType::OptionalAny => {
                (quote!(::osteoflow_node::derive::any_payload()), quote!(take_optional_any), true, false)
            }
            FieldType::Emit(t) => return Err(Error::new_spanned(t, "Emit is for outputs; an input is Option<T>")),
        };
        // An unused port joins like those of the kinds that use it, so that the same graph works with both.
        let many = matches!(ty, FieldType::Many(_) | FieldType::ManyOptional(_))
            || unused && attr.join.as_ref().is_some_and(|join| join.value() == "collect");
        let join = join_of(&attr, many, field)?;
        if !optional && attr.join.as_ref().is_some_and(|join| join.value() == "previous") {
            let message = "a port that joins by previous is an Option<T>: nothing comes to the first firing";
            return Err(Error::new_spanned(field, message));
        }
        let (doc, frames) = (doc_of(&field.attrs), frames_of(&attr));
        ports.push(quote! {
            ::osteoflow_node::InputPort {
                name: #name, doc: #doc, payload: #payload, join: #join, optional: #optional, unused: #unused,
                frames: #frames,
            }
        });
        takes.push(if unused {
            quote!(#ident: ::core::default::Default::default())
        } else {
            quote!(#ident: ::osteoflow_node::derive::#take(joined, #index, #name)?)
        });
    }
    let name = &input.ident;
    Ok(quote! {
        impl ::osteoflow_node::Inputs for #name {
            fn ports() -> ::std::vec::Vec<::osteoflow_node::InputPort> {
                ::std::vec![#(#ports),*]
            }
            fn take(joined: &mut ::osteoflow_node::Joined) -> ::core::result::Result<Self, ::osteoflow_node::NodeError> {
                let _ = joined;
                ::core::result::Result::Ok(Self { #(#takes),* })
            }
        }
    })
}

pub(crate) fn outputs(input: &DeriveInput) -> Result<TokenStream> {
    let mut ports = Vec::new();
    let mut puts = Vec::new();
    for field in named_fields(input)? {
        let (ident, name) = name_of(field)?;
        let attr = attr_of(field)?;
        let times = [attr.tolerance_ms, attr.max_gap_ms, attr.after_ms];
        if attr.join.is_some() || attr.n.is_some() || times.iter().any(Option::is_some) {
            return Err(Error::new_spanned(field, "an output does not join; only frame, to and from are known here"));
        }
        let (payload, put) = match field_type(&field.ty) {
            FieldType::Plain(t) => (
                payload(t),
                quote!(::osteoflow_node::derive::put_value(place, ::osteoflow_node::Value::new(self.#ident))),
            ),
            FieldType::Emit(t) => (payload(t), quote!(*place = ::osteoflow_node::derive::into_emission(self.#ident))),
            FieldType::Any => {
                let any = quote!(::osteoflow_node::derive::any_payload());
                (any, quote!(::osteoflow_node::derive::put_value(place, self.#ident)))
            }
            _ => return Err(Error::new_spanned(&field.ty, "an output is T, or Emit<T> where there may be no value")),
        };
        let (doc, frames) = (doc_of(&field.attrs), frames_of(&attr));
        ports.push(quote! {
            ::osteoflow_node::OutputPort { name: #name, doc: #doc, payload: #payload, frames: #frames }
        });
        puts.push(put);
    }
    let name = &input.ident;
    let places = 0..puts.len();
    Ok(quote! {
        impl ::osteoflow_node::Outputs for #name {
            fn ports() -> ::osteoflow_node::OutputPorts {
                ::osteoflow_node::OutputPorts::Fixed(::std::vec![#(#ports),*])
            }
            fn put(self, out: &mut [::osteoflow_node::Emission]) {
                let _ = &out;
                #({
                    let place = &mut out[#places];
                    #puts;
                })*
            }
        }
    })
}

fn named_fields(input: &DeriveInput) -> Result<Vec<&Field>> {
    match &input.data {
        Data::Struct(data) => match &data.fields {
            Fields::Named(fields) => Ok(fields.named.iter().collect()),
            Fields::Unit => Ok(Vec::new()),
            Fields::Unnamed(_) => {
                Err(Error::new_spanned(&input.ident, "ports have names; use a struct with named fields"))
            }
        },
        _ => Err(Error::new_spanned(&input.ident, "ports are the fields of a struct")),
    }
}

fn name_of(field: &Field) -> Result<(&Ident, String)> {
    let ident = field.ident.as_ref().ok_or_else(|| Error::new_spanned(field, "ports have names"))?;
    Ok((ident, ident.to_string()))
}

fn payload(t: &Type) -> TokenStream {
    quote!(::osteoflow_node::derive::payload_of::<#t, _>())
}

fn field_type(ty: &Type) -> FieldType<'_> {
    match generic(ty) {
        Some(("Option", inner)) if is_value(inner) => FieldType::OptionalAny,
        Some(("Option", inner)) => FieldType::Optional(inner),
        Some(("Unused", inner)) => FieldType::Unused(inner),
        Some(("Emit", inner)) => FieldType::Emit(inner),
        Some(("Vec", inner)) => match generic(inner) {
            Some(("Option", inner)) => FieldType::ManyOptional(inner),
            _ => FieldType::Many(inner),
        },
        _ if is_value(ty) => FieldType::Any,
        _ => FieldType::Plain(ty),
    }
}

/// Whether a type is [`Value`](osteoflow_node::Value), which any payload is.
fn is_value(ty: &Type) -> bool {
    last_segment(ty).is_some_and(|s| s == "Value")
}

fn last_segment(ty: &Type) -> Option<&Ident> {
    match ty {
        Type::Path(path) => path.path.segments.last().map(|s| &s.ident),
        _ => None,
    }
}

/// The outer name and the inner type of `Outer<Inner>`, for the names that the derives know.
fn generic(ty: &Type) -> Option<(&'static str, &Type)> {
    let Type::Path(path) = ty else { return None };
    let segment = path.path.segments.last()?;
    let outer = ["Option", "Vec", "Unused", "Emit"].into_iter().find(|name| segment.ident == name)?;
    let PathArguments::AngleBracketed(arguments) = &segment.arguments else { return None };
    match arguments.args.first()? {
        GenericArgument::Type(inner) => Some((outer, inner)),
        _ => None,
    }
}

fn attr_of(field: &Field) -> Result<PortAttr> {
    let mut out = PortAttr::default();
    for attr in field.attrs.iter().filter(|a| a.path().is_ident("port")) {
        attr.parse_nested_meta(|meta| {
            if meta.path.is_ident("join") {
                out.join = Some(meta.value()?.parse()?);
            } else if meta.path.is_ident("n") {
                out.n = Some(meta.value()?.parse::<LitInt>()?.base10_parse()?);
            } else if meta.path.is_ident("tolerance_ms") {
                out.tolerance_ms = Some(meta.value()?.parse::<LitFloat>()?.base10_parse()?);
            } else if meta.path.is_ident("max_gap_ms") {
                out.max_gap_ms = Some(meta.value()?.parse::<LitFloat>()?.base10_parse()?);
            } else if meta.path.is_ident("after_ms") {
                out.after_ms = Some(meta.value()?.parse::<LitFloat>()?.base10_parse()?);
            } else if meta.path.is_ident("frame") {
                out.frame = Some(meta.value()?.parse()?);
            } else if meta.path.is_ident("to") {
                out.to = Some(meta.value()?.parse()?);
            } else if meta.path.is_ident("from") {
                out.from = Some(meta.value()?.parse()?);
            } else {
                return Err(meta.error("known here: join, n, tolerance_ms, max_gap_ms, after_ms, frame, to, from"));
            }
            Ok(())
        })?;
    }
    Ok(out)
}

fn join_of(attr: &PortAttr, many: bool, field: &Field) -> Result<TokenStream> {
    let name = attr.join.as_ref().map_or(if many { "collect".into() } else { "each".into() }, LitStr::value);
    let ns = |ms: f64| (ms * 1e6).round() as i64;
    let join = match name.as_str() {
        "each" => quote!(Each),
        "stamp" => {
            let tolerance = ns(attr.tolerance_ms.unwrap_or(0.0));
            quote!(Stamp { tolerance_ns: #tolerance })
        }
        "collect" => match attr.n {
            Some(n) => quote!(Collect { n: ::core::option::Option::Some(#n) }),
            None => quote!(Collect { n: ::core::option::Option::None }),
        },
        "latest" => match attr.after_ms.map(ns) {
            Some(after) => quote!(LatestAfter { after_ns: #after }),
            None => quote!(Latest),
        },
        "interpolate" => match attr.max_gap_ms.map(ns) {
            Some(gap) => quote!(Interpolate { max_gap_ns: ::core::option::Option::Some(#gap) }),
            None => quote!(Interpolate { max_gap_ns: ::core::option::Option::None }),
        },
        "once" => quote!(Once),
        "previous" => quote!(Previous),
        _ => {
            let known = "a port joins by each, stamp, collect, latest, interpolate, once or previous";
            return Err(Error::new_spanned(&attr.join, known));
        }
    };
    if many != (name == "collect") {
        return Err(Error::new_spanned(field, "a port that collects is a Vec, and a Vec collects"));
    }
    Ok(quote!(::osteoflow_node::Join::#join))
}

fn frames_of(attr: &PortAttr) -> TokenStream {
    let option = |text: &Option<LitStr>| match text {
        Some(text) => quote!(::core::option::Option::Some(#text)),
        None => quote!(::core::option::Option::None),
    };
    let (frame, to, from) = (option(&attr.frame), option(&attr.to), option(&attr.from));
    quote!(::osteoflow_node::FrameExpr { frame: #frame, to: #to, from: #from })
}
