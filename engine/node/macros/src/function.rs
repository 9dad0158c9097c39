use proc_macro2::TokenStream;
use quote::quote;
use syn::{Error, FnArg, GenericArgument, ImplItem, ItemImpl, LitStr, PathArguments, Result, ReturnType, Type};

pub(crate) fn function(kind: &LitStr, block: &ItemImpl) -> Result<TokenStream> {
    let (node, items) = (&block.self_ty, &block.items);
    let Some([params, inputs, outputs]) = items.iter().find_map(types) else {
        let form = "fn process(params: &Params, inputs: In, ctx: &mut Context) -> Result<Out, NodeError>";
        return Err(Error::new_spanned(node, format!("a function needs `{form}`")));
    };
    Ok(quote! {
        impl ::osteoflow_node::Function for #node {
            const KIND: &'static str = #kind;
            type Params = #params;
            type Inputs = #inputs;
            type Outputs = #outputs;
            #(#items)*
        }
    })
}

/// Parameters, inputs and outputs by the signature of `process`.
fn types(item: &ImplItem) -> Option<[&Type; 3]> {
    let ImplItem::Fn(process) = item else { return None };
    let mut arguments = process.sig.inputs.iter().filter_map(|argument| match argument {
        FnArg::Typed(argument) => Some(&*argument.ty),
        FnArg::Receiver(_) => None,
    });
    let (Some(Type::Reference(params)), Some(inputs)) = (arguments.next(), arguments.next()) else { return None };
    let ReturnType::Type(_, result) = &process.sig.output else { return None };
    let Type::Path(result) = &**result else { return None };
    let PathArguments::AngleBracketed(of) = &result.path.segments.last()?.arguments else { return None };
    match of.args.first()? {
        GenericArgument::Type(outputs) if process.sig.ident == "process" => Some([&params.elem, inputs, outputs]),
        _ => None,
    }
}
