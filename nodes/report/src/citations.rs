//! The literature of the nodes in a graph, as BibTeX.

use crate::html::Page;
use osteoflow_node::Registry;

/// The literature: entries separated by empty lines, each below a comment with the name that nodes use for it.
const BIBLIOGRAPHY: &str = include_str!("citations.bib");

/// What nodes say of the paper whose method the graphs follow: `section 2.3 of the paper`.
const THE_PAPER: &str = "of the paper";

/// The works of the bibliography: name and BibTeX entry.
fn works() -> impl Iterator<Item = (&'static str, &'static str)> {
    let entries = BIBLIOGRAPHY.trim_end().split("\n\n").skip(1);
    entries.filter_map(|entry| entry.strip_prefix("% ")?.split_once('\n'))
}

/// The entry of the program itself, which every report cites.
fn program() -> String {
    let (authors, version, url) = (env!("CARGO_PKG_AUTHORS"), env!("CARGO_PKG_VERSION"), env!("CARGO_PKG_REPOSITORY"));
    format!(
        "@software{{osteoflow,\n  author  = {{{{{authors}}}}},\n  title   = {{Osteoflow: surface registration experiments for \
         computer-assisted surgery, run as graphs of nodes}},\n  version = {{{version}}},\n  url     = {{{url}}}\n}}"
    )
}

/// The entry of the work that a literature reference of a node begins with.
fn entry_of(literature: &str) -> Option<&'static str> {
    works().find(|(name, _)| literature.starts_with(name)).map(|(_, entry)| entry)
}

/// Writes the references of these kinds to the page and returns them as BibTeX.
pub(crate) fn section(page: &mut Page, kinds: &[&str], registry: &Registry) -> String {
    let mut used: Vec<(&str, Vec<&str>)> = Vec::new();
    let (mut paper, mut unknown) = (false, Vec::new());
    for kind in kinds {
        let literature = registry.kind(kind).map_or(&[][..], |kind| kind.description.literature);
        for source in literature {
            match entry_of(source) {
                Some(entry) => match used.iter_mut().find(|(used, _)| *used == entry) {
                    Some((_, by)) if by.contains(kind) => {}
                    Some((_, by)) => by.push(kind),
                    None => used.push((entry, vec![kind])),
                },
                None if source.contains(THE_PAPER) => paper = true,
                None => unknown.push(format!("{source} (named by {kind})")),
            }
        }
    }
    used.sort();
    let mut entries = vec![program()];
    entries.extend(used.iter().map(|(entry, _)| (*entry).to_owned()));
    page.text("Literature of this graph's nodes; citations.bib holds the same entries.");
    if paper {
        page.text(
            "Some nodes follow \u{201c}the paper\u{201d}, the published method of contactless registration that the shipped \
             graphs rebuild; this program holds no entry of it, so add yours.",
        );
    }
    if !unknown.is_empty() {
        page.text(&format!("Literature without an entry here: {}.", unknown.join("; ")));
    }
    let text = entries.join("\n\n") + "\n";
    page.code(&text);
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_work_that_a_built_in_node_names_has_an_entry() {
        let registry = osteoflow_standard::registry();
        let mut n = 0;
        for kind in registry.kinds() {
            for source in kind.description.literature {
                let known = entry_of(source).is_some() || source.contains(THE_PAPER);
                assert!(known, "{} names \"{source}\"; give it an entry in citations.bib", kind.description.kind);
                n += 1;
            }
        }
        assert!(n > 10);
    }

    #[test]
    fn entries_are_whole_and_their_keys_are_their_own() {
        let mut keys = Vec::new();
        assert_eq!(works().count(), BIBLIOGRAPHY.matches('@').count(), "each entry has its name above it");
        for (name, entry) in works() {
            let (open, close) = (entry.matches('{').count(), entry.matches('}').count());
            assert_eq!(open, close, "{}", entry);
            for field in ["author", "title", "year"] {
                assert!(entry.contains(&format!("  {field} ")), "{} lacks {field}", name);
            }
            let key = entry.split(['{', ',']).nth(1).unwrap();
            assert!(!keys.contains(&key), "{key} twice");
            keys.push(key);
        }
    }
}
