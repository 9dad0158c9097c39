//! The public items of a crate, from its sources.

use quote::ToTokens;
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};
use syn::{Attribute, ImplItem, Item, ItemImpl, TraitItem, UseTree, Visibility};

/// The attributes that are part of an item for its users.
const SHOWN: [&str; 6] =
    ["derive", "params", "non_exhaustive", "must_use", "proc_macro_attribute", "proc_macro_derive"];

/// A crate as a tree of modules.
pub(super) struct Crate {
    root: Module,
}

#[derive(Default)]
struct Module {
    items: Vec<Item>,
    modules: BTreeMap<String, Module>,
}

/// An item under one of its public paths, with the lines that belong to it.
struct Listed {
    sorted_by: String,
    lines: Vec<String>,
}

impl Crate {
    /// Reads `lib.rs` in the folder and the modules that it names.
    pub(super) fn read(src: &Path) -> Self {
        Self { root: Module::of(parse(&src.join("lib.rs")), src) }
    }

    /// One line for each item, field, variant, method and implementation that users of the crate can name.
    pub(super) fn public_items(&self) -> Vec<String> {
        let mut found = Vec::new();
        self.list(&self.root, &[], "", &mut BTreeSet::new(), &mut found);
        found.sort_by(|a: &Listed, b| a.sorted_by.cmp(&b.sorted_by));
        found.into_iter().flat_map(|listed| listed.lines).collect()
    }

    /// Lists the public items of a module, whose names begin with `prefix` for users.
    fn list(
        &self,
        module: &Module,
        at: &[String],
        prefix: &str,
        open: &mut BTreeSet<Vec<String>>,
        out: &mut Vec<Listed>,
    ) {
        // A module that exports itself again would not end.
        if !open.insert(at.to_vec()) {
            return;
        }
        for item in module.items.iter().filter(|item| !is_left_out(attributes(item))) {
            match item {
                Item::Mod(inner) if is_public(&inner.vis) => {
                    let name = inner.ident.to_string();
                    out.push(Listed::line(format!("pub mod {prefix}{name}")));
                    let at: Vec<_> = at.iter().cloned().chain([name.clone()]).collect();
                    self.list(&module.modules[&name], &at, &format!("{prefix}{name}::"), open, out);
                }
                Item::Use(used) if is_public(&used.vis) => self.list_use(&used.tree, at, Vec::new(), prefix, open, out),
                _ => self.list_item(item, None, prefix, out),
            }
        }
        open.remove(at);
    }

    /// Lists what a `pub use` names: items of this crate under their new names, others by their path.
    fn list_use(
        &self,
        tree: &UseTree,
        at: &[String],
        path: Vec<String>,
        prefix: &str,
        open: &mut BTreeSet<Vec<String>>,
        out: &mut Vec<Listed>,
    ) {
        let extended = |name: &dyn ToString| path.iter().cloned().chain([name.to_string()]).collect::<Vec<_>>();
        match tree {
            UseTree::Path(inner) => self.list_use(&inner.tree, at, extended(&inner.ident), prefix, open, out),
            UseTree::Group(group) => {
                group.items.iter().for_each(|tree| self.list_use(tree, at, path.clone(), prefix, open, out));
            }
            UseTree::Name(name) => {
                self.list_named(&extended(&name.ident), &name.ident.to_string(), at, prefix, open, out)
            }
            UseTree::Rename(name) => {
                self.list_named(&extended(&name.ident), &name.rename.to_string(), at, prefix, open, out);
            }
            UseTree::Glob(_) => match self.resolve(at, &path) {
                Some((to, module)) => self.list(module, &to, prefix, open, out),
                None => out.push(Listed::line(format!("pub use {}::* as {prefix}*", path.join("::")))),
            },
        }
    }

    fn list_named(
        &self,
        path: &[String],
        name: &str,
        at: &[String],
        prefix: &str,
        open: &mut BTreeSet<Vec<String>>,
        out: &mut Vec<Listed>,
    ) {
        let (last, before) = path.split_last().expect("a path has a name");
        if let Some((to, module)) = self.resolve(at, path) {
            out.push(Listed::line(format!("pub mod {prefix}{name}")));
            self.list(module, &to, &format!("{prefix}{name}::"), open, out);
            return;
        }
        let Some((to, module)) = self.resolve(at, before).filter(|_| !before.is_empty()) else {
            out.push(Listed::line(format!("pub use {} as {prefix}{name}", path.join("::"))));
            return;
        };
        let (n_before, of_module) = (out.len(), module.items.iter());
        for item in
            of_module.filter(|item| ident(item).is_some_and(|ident| ident == *last) && !matches!(item, Item::Use(_)))
        {
            self.list_item(item, Some(name), prefix, out);
        }
        // It is itself exported from elsewhere.
        for item in module.items.iter().filter(|_| out.len() == n_before) {
            if let Item::Use(used) = item
                && let Some(onward) = find_in_use(&used.tree, last, Vec::new())
            {
                self.list_named(&onward, name, &to, prefix, open, out);
                return;
            }
        }
        assert!(out.len() > n_before, "{} is not found in the sources", path.join("::"));
    }

    /// The module at a path as a module at `at` writes it, if it is one of this crate.
    fn resolve(&self, at: &[String], path: &[String]) -> Option<(Vec<String>, &Module)> {
        let mut whole = at.to_vec();
        for (k, name) in path.iter().enumerate() {
            match &**name {
                "crate" => whole.clear(),
                "self" => {}
                "super" => drop(whole.pop()),
                _ => whole.extend(path[k..=k].iter().cloned()),
            }
        }
        let mut module = &self.root;
        for name in &whole {
            module = module.modules.get(name)?;
        }
        Some((whole, module))
    }

    /// The line of an item that is public, under the name, and the lines of what belongs to it.
    fn list_item(&self, item: &Item, name: Option<&str>, prefix: &str, out: &mut Vec<Listed>) {
        let Some(own) = ident(item).filter(|_| is_seen(item)) else { return };
        let name = name.unwrap_or(&own);
        let path = format!("{prefix}{name}");
        let (words, rest) = described(item);
        let mut listed = Listed::line(format!("pub {words} {path}{rest}"));
        let derived: Vec<String> = attributes(item)
            .iter()
            .filter(|a| a.path().segments.last().is_some_and(|name| SHOWN.iter().any(|shown| name.ident == shown)))
            .map(|attribute| text(&attribute.meta))
            .collect();
        listed.lines.extend(derived.iter().map(|attribute| format!("#[{attribute}] {path}")));
        let mut of_traits = Vec::new();
        let mut methods = Vec::new();
        if matches!(item, Item::Struct(_) | Item::Enum(_) | Item::Union(_) | Item::Type(_)) {
            self.root.each_impl(&mut |found| {
                let of = match &*found.self_ty {
                    syn::Type::Path(path) => path.path.segments.last().map(|last| last.ident.to_string()),
                    _ => None,
                };
                if of.as_deref() != Some(&*own) || is_left_out(&found.attrs) {
                    return;
                }
                match &found.trait_ {
                    Some((_, of_trait, _)) => of_traits.push(format!("impl {} for {path}", text(of_trait))),
                    None => methods.extend(found.items.iter().filter_map(|item| associated(item, &path))),
                }
            });
        }
        of_traits.sort();
        listed.lines.extend(of_traits);
        listed.lines.extend(members(item, &path));
        listed.lines.extend(methods);
        out.push(listed);
    }
}

impl Listed {
    fn line(line: String) -> Self {
        Self { sorted_by: line.clone(), lines: vec![line] }
    }
}

impl Module {
    /// The module of a file's items; `folder` is where the files of its modules are.
    fn of(items: Vec<Item>, folder: &Path) -> Self {
        let mut modules = BTreeMap::new();
        for item in &items {
            let Item::Mod(inner) = item else { continue };
            if is_left_out(&inner.attrs) {
                continue;
            }
            let name = inner.ident.to_string();
            let below = folder.join(&name);
            let module = match &inner.content {
                Some((_, items)) => Self::of(items.clone(), &below),
                None => Self::of(parse(&folder.join(format!("{name}.rs"))), &below),
            };
            modules.insert(name, module);
        }
        Self { items, modules }
    }

    fn each_impl(&self, see: &mut dyn FnMut(&ItemImpl)) {
        for item in &self.items {
            if let Item::Impl(found) = item {
                see(found);
            }
        }
        self.modules.values().for_each(|module| module.each_impl(see));
    }
}

fn parse(file: &PathBuf) -> Vec<Item> {
    let text = fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    syn::parse_file(&text).unwrap_or_else(|error| panic!("{}: {error}", file.display())).items
}

/// The path behind a name that a `use` brings in.
fn find_in_use(tree: &UseTree, name: &str, path: Vec<String>) -> Option<Vec<String>> {
    let extended = |next: &dyn ToString| path.iter().cloned().chain([next.to_string()]).collect::<Vec<_>>();
    match tree {
        UseTree::Path(inner) => find_in_use(&inner.tree, name, extended(&inner.ident)),
        UseTree::Group(group) => group.items.iter().find_map(|tree| find_in_use(tree, name, path.clone())),
        UseTree::Name(found) if found.ident == name => Some(extended(&found.ident)),
        UseTree::Rename(found) if found.rename == name => Some(extended(&found.ident)),
        _ => None,
    }
}

/// Tests, and what is hidden from users.
fn is_left_out(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        let text = text(&attribute.meta);
        text == "cfg(test)" || text.starts_with("cfg(all(test") || text == "cfg(doctest)" || text == "doc(hidden)"
    })
}

fn is_public(visibility: &Visibility) -> bool {
    matches!(visibility, Visibility::Public(_))
}

fn is_seen(item: &Item) -> bool {
    match item {
        Item::Fn(i) => is_public(&i.vis),
        Item::Struct(i) => is_public(&i.vis),
        Item::Enum(i) => is_public(&i.vis),
        Item::Union(i) => is_public(&i.vis),
        Item::Trait(i) => is_public(&i.vis),
        Item::Type(i) => is_public(&i.vis),
        Item::Const(i) => is_public(&i.vis),
        Item::Static(i) => is_public(&i.vis),
        Item::Macro(i) => i.attrs.iter().any(|attribute| attribute.path().is_ident("macro_export")),
        _ => false,
    }
}

fn ident(item: &Item) -> Option<String> {
    let ident = match item {
        Item::Fn(i) => &i.sig.ident,
        Item::Struct(i) => &i.ident,
        Item::Enum(i) => &i.ident,
        Item::Union(i) => &i.ident,
        Item::Trait(i) => &i.ident,
        Item::Type(i) => &i.ident,
        Item::Const(i) => &i.ident,
        Item::Static(i) => &i.ident,
        Item::Macro(i) => i.ident.as_ref()?,
        _ => return None,
    };
    Some(ident.to_string())
}

fn attributes(item: &Item) -> &[Attribute] {
    match item {
        Item::Fn(i) => &i.attrs,
        Item::Struct(i) => &i.attrs,
        Item::Enum(i) => &i.attrs,
        Item::Union(i) => &i.attrs,
        Item::Trait(i) => &i.attrs,
        Item::Type(i) => &i.attrs,
        Item::Const(i) => &i.attrs,
        Item::Static(i) => &i.attrs,
        Item::Macro(i) => &i.attrs,
        Item::Mod(i) => &i.attrs,
        Item::Use(i) => &i.attrs,
        Item::Impl(i) => &i.attrs,
        _ => &[],
    }
}

/// What an item is, and what follows its name.
fn described(item: &Item) -> (String, String) {
    let generics = |g: &syn::Generics| {
        format!("{}{}", text(g), g.where_clause.as_ref().map_or(String::new(), |w| format!(" {}", text(w))))
    };
    match item {
        Item::Fn(i) => signature(&i.sig),
        Item::Struct(i) => {
            let fields = match &i.fields {
                syn::Fields::Unnamed(fields) => {
                    format!("({})", fields.unnamed.iter().map(field).collect::<Vec<_>>().join(", "))
                }
                _ => String::new(),
            };
            ("struct".into(), format!("{}{fields}", generics(&i.generics)))
        }
        Item::Enum(i) => ("enum".into(), generics(&i.generics)),
        Item::Union(i) => ("union".into(), generics(&i.generics)),
        Item::Trait(i) => {
            let above: Vec<_> = i.supertraits.iter().map(text).collect();
            let above = if above.is_empty() { String::new() } else { format!(": {}", above.join(" + ")) };
            (
                if i.unsafety.is_some() { "unsafe trait" } else { "trait" }.into(),
                format!("{}{above}", generics(&i.generics)),
            )
        }
        Item::Type(i) => ("type".into(), format!("{} = {}", generics(&i.generics), text(&i.ty))),
        Item::Const(i) => ("const".into(), format!(": {}", text(&i.ty))),
        Item::Static(i) => ("static".into(), format!(": {}", text(&i.ty))),
        Item::Macro(_) => ("macro".into(), "!".into()),
        _ => unreachable!("only these are listed"),
    }
}

/// A field of a tuple, `_` if it is private.
fn field(field: &syn::Field) -> String {
    if is_public(&field.vis) { format!("pub {}", text(&field.ty)) } else { "_".into() }
}

/// The words before the name of a function, and what follows it.
fn signature(signature: &syn::Signature) -> (String, String) {
    let mut unnamed = signature.clone();
    let name = unnamed.ident.to_string();
    let whole = text(&{
        unnamed.ident = syn::Ident::new("NAME", unnamed.ident.span());
        unnamed
    });
    let (before, after) = whole.split_once("NAME").unwrap_or_else(|| panic!("{name}: {whole}"));
    (before.trim().to_owned(), after.to_owned())
}

/// The lines of public fields, of variants, and of what a trait asks for.
fn members(item: &Item, path: &str) -> Vec<String> {
    let is_named = |field: &&syn::Field| field.ident.is_some() && is_public(&field.vis) && !is_left_out(&field.attrs);
    let named = |field: &syn::Field| format!("pub {path}::{}: {}", text(&field.ident), text(&field.ty));
    match item {
        Item::Struct(i) => i.fields.iter().filter(is_named).map(named).collect(),
        Item::Union(i) => i.fields.named.iter().filter(is_named).map(named).collect(),
        Item::Enum(i) => {
            let fields = |variant: &syn::Variant| {
                let types = variant.fields.iter().map(|field| match &field.ident {
                    Some(name) => format!("{name}: {}", text(&field.ty)),
                    None => text(&field.ty),
                });
                let types = types.collect::<Vec<_>>().join(", ");
                match &variant.fields {
                    syn::Fields::Unit => String::new(),
                    syn::Fields::Named(_) => format!(" {{ {types} }}"),
                    syn::Fields::Unnamed(_) => format!("({types})"),
                }
            };
            let value = |variant: &syn::Variant| {
                variant.discriminant.as_ref().map_or(String::new(), |(_, v)| format!(" = {}", text(v)))
            };
            i.variants.iter().map(|v| format!("pub {path}::{}{}{}", v.ident, fields(v), value(v))).collect()
        }
        Item::Trait(i) => i.items.iter().filter_map(|item| required(item, path)).collect(),
        _ => Vec::new(),
    }
}

fn required(item: &TraitItem, path: &str) -> Option<String> {
    let provided = |is: bool| if is { " (provided)" } else { "" };
    match item {
        TraitItem::Fn(i) => {
            let (before, after) = signature(&i.sig);
            Some(format!("{before} {path}::{}{after}{}", i.sig.ident, provided(i.default.is_some())))
        }
        TraitItem::Const(i) => {
            Some(format!("const {path}::{}: {}{}", i.ident, text(&i.ty), provided(i.default.is_some())))
        }
        TraitItem::Type(i) => {
            let bounds: Vec<_> = i.bounds.iter().map(text).collect();
            Some(format!("type {path}::{}: {}", i.ident, bounds.join(" + ")))
        }
        _ => None,
    }
}

fn associated(item: &ImplItem, path: &str) -> Option<String> {
    match item {
        ImplItem::Fn(i) if is_public(&i.vis) && !is_left_out(&i.attrs) => {
            let (before, after) = signature(&i.sig);
            Some(format!("pub {before} {path}::{}{after}", i.sig.ident))
        }
        ImplItem::Const(i) if is_public(&i.vis) && !is_left_out(&i.attrs) => {
            Some(format!("pub const {path}::{}: {}", i.ident, text(&i.ty)))
        }
        _ => None,
    }
}

/// Tokens as people write them: without the spaces that are between all of them.
fn text(tokens: &impl ToTokens) -> String {
    let mut out = tokens.to_token_stream().to_string().replace('\n', " ");
    for (spaced, tight) in [
        (" ::", "::"),
        (":: ", "::"),
        (" <", "<"),
        ("< ", "<"),
        (" >", ">"),
        ("& ", "&"),
        (" ,", ","),
        (" :", ":"),
        (" (", "("),
        ("( ", "("),
        (" )", ")"),
        ("[ ", "["),
        (" ]", "]"),
        (" ;", ";"),
        ("' ", "'"),
        ("? ", "?"),
        ("- >", "->"),
        ("* const", "*const"),
        ("* mut", "*mut"),
    ] {
        out = out.replace(spaced, tight);
    }
    // These were closed too much, or stand before a word.
    for (tight, spaced) in [
        ("->", " -> "),
        ("impl<", "impl <"),
        ("=(", "= ("),
        ("->  ", "-> "),
        (">where", "> where"),
        (",)", ")"),
        (",>", ">"),
    ] {
        out = out.replace(tight, spaced);
    }
    while out.contains("  ") {
        out = out.replace("  ", " ");
    }
    out.trim().to_owned()
}
