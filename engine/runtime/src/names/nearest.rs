//! Finds the nearest known name, and lists the known names.

use std::path::Path;

/// Maximum number of names listed beside a suggestion.
const SHORT: usize = 16;

/// Maximum number of names listed without a suggestion.
const LONG: usize = 40;

/// Number of known names from which only those are compared that one slip makes of the found one: faults times names are many.
const MANY: usize = 512;

/// The known name that was probably meant.
pub fn name<'a>(found: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let found_lower = found.to_lowercase();
    let mut best: Option<(usize, &str)> = None;
    let known: Vec<&str> = known.into_iter().collect();
    let is_many = known.len() > MANY;
    for name in known.into_iter().filter(|name| !is_many || is_one_slip(found, name)) {
        let distance = if is_end_of(&found_lower, name) {
            1
        } else {
            strsim::damerau_levenshtein(&found_lower, &name.to_lowercase())
        };
        let near = distance <= (found.chars().count().max(name.chars().count()) / 3).max(1);
        if near && best.is_none_or(|(nearest, _)| distance < nearest) {
            best = Some((distance, name));
        }
    }
    best.map(|(_, name)| name)
}

/// Whether the names are equal but for at most two letters in one place, or end alike.
fn is_one_slip(found: &str, name: &str) -> bool {
    let (a, b) = (found.as_bytes(), name.as_bytes());
    let alike = |(a, b): &(&u8, &u8)| a.eq_ignore_ascii_case(b);
    let from_begin = a.iter().zip(b).take_while(alike).count();
    let from_end = a.iter().rev().zip(b.iter().rev()).take_while(alike).count();
    from_begin + from_end + 2 >= a.len().max(b.len()) || from_end == a.len()
}

/// Whether `found` is `name` without its first words: `point_to_plane` for `icp.point_to_plane`.
fn is_end_of(found: &str, name: &str) -> bool {
    let rest = name.strip_suffix(found).unwrap_or_default();
    found.len() > 2 && rest.ends_with(['.', '/', '_'])
}

/// `did you mean "x"?`, if a known name is near.
pub fn help<'a>(found: &str, known: impl IntoIterator<Item = &'a str>) -> Option<String> {
    name(found, known).map(|name| format!("did you mean \"{name}\"?"))
}

/// `known here: a, b, c`, if there are at most [`SHORT`].
pub fn list<'a>(what: &str, known: impl IntoIterator<Item = &'a str>) -> Option<String> {
    list_of(what, known, SHORT)
}

/// A suggestion and the list of known names; without a suggestion the list may be longer.
pub fn hint<'a>(
    found: &str,
    what: &str,
    known: impl IntoIterator<Item = &'a str> + Clone,
) -> (Option<String>, Option<String>) {
    let help = help(found, known.clone());
    let max = if help.is_some() { SHORT } else { LONG };
    (help, list_of(what, known, max))
}

/// The list of known names, if there are at most [`LONG`].
pub fn all<'a>(what: &str, known: impl IntoIterator<Item = &'a str>) -> Option<String> {
    list_of(what, known, LONG)
}

fn list_of<'a>(what: &str, known: impl IntoIterator<Item = &'a str>, max: usize) -> Option<String> {
    let known: Vec<_> = known.into_iter().collect();
    (!known.is_empty() && known.len() <= max).then(|| format!("{what}: {}", known.join(", ")))
}

/// Suggests a similar file name, or names the missing folder.
pub fn file(path: &Path) -> Option<String> {
    let folder = match path.parent() {
        Some(parent) if parent.as_os_str().is_empty() => Path::new("."),
        Some(parent) => parent,
        None => return None,
    };
    if folder.is_file() {
        return Some(format!("{} is a file, not a folder", folder.display()));
    }
    let Ok(entries) = std::fs::read_dir(folder) else {
        return Some(format!("there is no folder {} either", folder.display()));
    };
    let mut names: Vec<_> =
        entries.filter_map(|e| e.ok()?.file_name().into_string().ok()).filter(|n| !n.starts_with('.')).collect();
    names.sort();
    let file_name = path.file_name()?.to_str()?;
    help(file_name, names.iter().map(String::as_str))
}
