//! The literature of the nodes in a graph, as BibTeX.

use crate::html::Page;
use osteoflow_node::Registry;

/// The literature: entries separated by empty lines, each below a comment with the name that nodes use for it.
const BIBLIOGRAPHY: &str = include_str!("citations.bib");

/// What nodes say of the paper whose method the graphs follow: `section 2.3 of the paper`. Also the name of its entry.
const THE_PAPER: &str = "the paper";

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
    let is_of = |name: &str| literature.starts_with(name) || name == THE_PAPER && literature.contains(name);
    works().find(|(name, _)| is_of(name)).map(|(_, entry)| entry)
}

/// The title of the paper whose method the graphs follow.
fn paper_title() -> &'static str {
    let title = entry_of(THE_PAPER).and_then(|entry| entry.split_once("title  = {")?.1.split_once("},\n"));
    title.map_or("the paper", |(title, _)| title)
}

/// Writes the references of these kinds to the page and returns them as BibTeX.
pub(crate) fn section(page: &mut Page, kinds: &[&str], registry: &Registry) -> String {
    let mut used: Vec<(&str, Vec<&str>)> = Vec::new();
    let mut unknown = Vec::new();
    for kind in kinds {
        let literature = registry.kind(kind).map_or(&[][..], |kind| kind.description.literature);
        for source in literature {
            match entry_of(source) {
                Some(entry) => match used.iter_mut().find(|(used, _)| *used == entry) {
                    Some((_, by)) if by.contains(kind) => {}
                    Some((_, by)) => by.push(kind),
                    None => used.push((entry, vec![kind])),
                },
                None => unknown.push(format!("{source} (named by {kind})")),
            }
        }
    }
    used.sort();
    let mut entries = vec![program()];
    entries.extend(used.iter().map(|(entry, _)| (*entry).to_owned()));
    page.text("Literature of this graph's nodes; citations.bib holds the same entries.");
    if used.iter().any(|(entry, _)| Some(*entry) == entry_of(THE_PAPER)) {
        let title = paper_title();
        page.text(&format!(
            "\u{201c}The paper\u{201d} is: {title}. Its authors, journal and DOI are not known to this program."
        ));
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
                let known = entry_of(source).is_some();
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
                // The text at hand names neither authors nor year.
                if name == THE_PAPER && field != "title" {
                    continue;
                }
                assert!(entry.contains(&format!("  {field} ")), "{} lacks {field}", name);
            }
            let key = entry.split(['{', ',']).nth(1).unwrap();
            assert!(!keys.contains(&key), "{key} twice");
            keys.push(key);
        }
    }
}
