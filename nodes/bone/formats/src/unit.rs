//! Units of length, and how the comments and headers of files state them.

/// The names of units in the singular, and each unit in mm.
const UNITS: [(f64, &[&str]); 7] = [
    (0.001, &["um", "\u{b5}m", "\u{3bc}m", "micron", "micrometre"]),
    (1.0, &["mm", "millimetre"]),
    (10.0, &["cm", "centimetre"]),
    (100.0, &["dm", "decimetre"]),
    (1000.0, &["m", "metre"]),
    (25.4, &["in", "inch", "inche"]),
    (304.8, &["ft", "foot", "feet"]),
];

/// Words before `unit` that say that it is one of length.
const OF_LENGTH: [&str; 12] = [
    "length",
    "lengths",
    "linear",
    "distance",
    "coordinate",
    "coordinates",
    "position",
    "positions",
    "file",
    "model",
    "mesh",
    "point",
];

/// Words before `in mm` that say of what.
const LENGTHS: [&str; 9] =
    ["coordinates", "coords", "points", "positions", "vertices", "lengths", "distances", "dimensions", "xyz"];

/// A unit of length in mm, by its name or symbol in any case; none if it is no such.
pub(crate) fn length_mm(word: &str) -> Option<f64> {
    let word = word.to_lowercase().replace("meter", "metre");
    let singular = word.strip_suffix('s').filter(|_| word.len() > 3).unwrap_or(&word);
    UNITS.iter().find(|(_, names)| names.contains(&singular)).map(|(mm, _)| *mm)
}

/// A statement such as `units: inches`, as it is written, and the length of one unit in mm.
pub(crate) type Statement = (String, f64);

/// What a comment states of its unit of length: `UNIT=m`, `Units: inches`, `units are mm`, `1 unit = 10 mm`, `10 mm = 1 unit`,
/// `10 mm per unit`, `unit: 0.1 mm`, `coordinates in metres`. Units of something else, such as `time unit: s`, are passed over.
///
/// # Errors
/// A message, if the comment begins a statement with a word that is no unit.
pub(crate) fn stated(comment: &str) -> Result<Vec<Statement>, String> {
    let words = words(comment);
    let at = |k: usize| words.get(k).map_or("", String::as_str);
    let before = |k: usize, back: usize| k.checked_sub(back).map_or("", at);
    let mut found = Vec::new();
    for k in 0..words.len() {
        let lower = at(k).to_lowercase();
        let of = lower.trim_end_matches('s').strip_suffix("unit").map(|of| of.trim_end_matches(['_', '-']));
        let is_key = of.is_some_and(|of| of.is_empty() || OF_LENGTH.contains(&of));
        if !is_key && !LENGTHS.contains(&lower.as_str()) {
            continue;
        }
        // A count before the key: `1 unit = 10 mm`.
        let count = positive(before(k, 1)).filter(|_| is_key);
        let is_equal = |word: &str| ["=", ":", "per", "equals", "is"].contains(&word.to_lowercase().as_str());
        let back = if count.is_some() { 2 } else { 1 };
        if is_key
            && is_equal(before(k, back))
            && let (Some(mm), Some(n)) = (length_mm(before(k, back + 1)), positive(before(k, back + 2)))
        {
            found.push((words[k - back - 2..=k].join(" "), n * mm / count.unwrap_or(1.0)));
            continue;
        }
        let is_strong = is_key && ["=", ":"].contains(&at(k + 1));
        let is_filler = |word: &str| ["=", ":", "is", "are", "in", "equals"].contains(&word.to_lowercase().as_str());
        let mut next = k + 1;
        while is_filler(at(next)) && !(length_mm(at(next)).is_some() && length_mm(at(next + 1)).is_none()) {
            next += 1;
        }
        let factor = positive(at(next));
        let unit = next + usize::from(factor.is_some());
        // `units mm`, but not `points m` or `the unit in the room`.
        let is_bare_in = at(unit).eq_ignore_ascii_case("in") && !is_strong && factor.is_none();
        let is_joined = (next > k + 1 || is_key) && !is_bare_in;
        if let Some(mm) = length_mm(at(unit)).filter(|_| is_joined) {
            let joined = words[k..=unit].join(" ");
            let text = joined.replace(" = ", "=").replace(" : ", ": ");
            let text = count.map_or(text.clone(), |_| format!("{} {text}", before(k, 1)));
            found.push((text, factor.unwrap_or(1.0) * mm / count.unwrap_or(1.0)));
            continue;
        }
        let first = before(k, 1).to_lowercase();
        let begins = ["", ";", ",", "comment", "obj_info", "solid"].contains(&first.as_str())
            || ["=", ":"].contains(&before(k, 2))
            || OF_LENGTH.contains(&first.as_str())
            || of.is_some_and(|of| !of.is_empty())
            || count.is_some();
        let is_silent = ["", ";", ",", "unknown", "none", "unspecified"].contains(&at(unit).to_lowercase().as_str());
        if is_strong && begins && !(is_silent && factor.is_none()) {
            let word = words[next..=unit.min(words.len() - 1)].join(" ");
            return Err(format!(
                "the file states {}={word}, which is not mm, cm, m, um, dm, in or ft; write it in mm, or remove the statement",
                at(k)
            ));
        }
    }
    Ok(found)
}

fn positive(word: &str) -> Option<f64> {
    word.parse().ok().filter(|value: &f64| *value > 0.0 && value.is_finite())
}

/// The words of a comment; `=`, `:`, `;` and `,` are words of their own.
fn words(comment: &str) -> Vec<String> {
    let mut spaced = String::with_capacity(comment.len());
    for c in comment.chars() {
        match c {
            '=' | ':' | ';' | ',' => spaced.extend([' ', c, ' ']),
            '[' | ']' | '(' | ')' | '"' | '\'' | '#' | '%' => spaced.push(' '),
            c => spaced.push(c),
        }
    }
    spaced
        .split_whitespace()
        .map(|word| word.trim_end_matches('.').to_owned())
        .filter(|word| !word.is_empty())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_is_found_in_every_form_in_which_it_is_written() {
        for (text, mm) in [
            ("3D Slicer output. SPACE=RAS;UNIT=mm", 1.0),
            ("UNIT=in", 25.4),
            ("UNITS=mm COLOR=...", 1.0),
            ("solid bone units=inches", 25.4),
            (" units: inches", 25.4),
            ("comment Units: m", 1000.0),
            ("comment units (feet)", 304.8),
            ("Units: Millimeters", 1.0),
            ("Unit : \"cm\"", 10.0),
            ("1 unit = 10 mm", 10.0),
            ("10 units = 1 mm", 0.1),
            ("1 mm = 10 units", 0.1),
            ("scale: 10 mm per unit", 10.0),
            ("unit: 0.1 mm", 0.1),
            ("UNIT = 1e-3 m", 1.0),
            ("units in metres", 1000.0),
            ("all units are in cm.", 10.0),
            ("length_unit=m", 1000.0),
            ("coordinate units: \u{b5}m", 0.001),
            ("coordinates are in metres", 1000.0),
            ("lengths: mm", 1.0),
            ("units: in", 25.4),
        ] {
            let found = stated(text).unwrap_or_else(|error| panic!("{error}: {text}"));
            let [(_, found)] = found[..] else { panic!("{text}: {found:?}") };
            assert!((found / mm - 1.0).abs() < 1e-12, "{text}: {found}");
        }
    }

    #[test]
    fn a_unit_of_something_else_is_none_and_an_unknown_one_is_refused_by_name() {
        for text in [
            "",
            "no unit; LASTUNIT=m",
            "time unit: s",
            "intensity units: counts",
            "units: unknown",
            "UNIT=",
            "the unit in the theatre",
            "points in front of the camera",
            "this unit: a scanner",
            "acquired at unit 5",
            "1 2 3",
        ] {
            assert_eq!(stated(text), Ok(Vec::new()), "{text}");
        }
        for (text, word) in [
            ("UNIT=furlong", "UNIT=furlong"),
            ("units: pixels", "units=pixels"),
            ("1 unit = 3 voxels", "unit=3 voxels"),
            ("length unit: 7", "unit=7"),
            ("comment Units: lightyears", "Units=lightyears"),
        ] {
            let said = stated(text).unwrap_err();
            assert!(said.starts_with(&format!("the file states {word}, which is not mm, cm, m")), "{said}");
        }
    }
}
