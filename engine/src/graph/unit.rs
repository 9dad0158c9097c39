//! Unit suffixes of names, and suggestions where a name has the wrong unit.

/// A unit, and its size relative to the first unit of the same quantity.
struct Unit {
    suffix: &'static str,
    kind: u8,
    size: f64,
}

const UNITS: &[Unit] = &[
    Unit { suffix: "mm", kind: 0, size: 1.0 },
    Unit { suffix: "um", kind: 0, size: 1e-3 },
    Unit { suffix: "cm", kind: 0, size: 10.0 },
    Unit { suffix: "m", kind: 0, size: 1000.0 },
    Unit { suffix: "rad", kind: 1, size: 1.0 },
    Unit { suffix: "deg", kind: 1, size: std::f64::consts::PI / 180.0 },
    Unit { suffix: "ns", kind: 2, size: 1.0 },
    Unit { suffix: "us", kind: 2, size: 1e3 },
    Unit { suffix: "ms", kind: 2, size: 1e6 },
    Unit { suffix: "s", kind: 2, size: 1e9 },
    Unit { suffix: "hz", kind: 3, size: 1.0 },
    Unit { suffix: "khz", kind: 3, size: 1e3 },
];

fn split(name: &str) -> (&str, Option<&'static Unit>) {
    match name.rsplit_once('_') {
        Some((stem, suffix)) => match UNITS.iter().find(|unit| unit.suffix == suffix) {
            Some(unit) => (stem, Some(unit)),
            None => (name, None),
        },
        None => (name, None),
    }
}

/// The known name of the same quantity in another unit, and the value in it.
pub(crate) struct SameQuantity<'a> {
    /// The known name.
    pub(crate) name: &'a str,
    /// Its unit.
    pub(crate) unit: &'static str,
    /// The value converted to that unit, if it was a number in a convertible unit.
    pub(crate) value: Option<f64>,
}

/// The known name that differs from `found` only in its unit, if there is one.
pub(crate) fn same_quantity<'a>(
    found: &str,
    value: Option<f64>,
    known: impl IntoIterator<Item = &'a str>,
) -> Option<SameQuantity<'a>> {
    let (stem, from) = split(found);
    known.into_iter().find_map(|name| match split(name) {
        (known_stem, Some(to)) if known_stem == stem && from.is_none_or(|from| from.kind == to.kind) => {
            let value = value.zip(from).map(|(value, from)| round(value * from.size / to.size));
            Some(SameQuantity { name, unit: to.suffix, value })
        }
        _ => None,
    })
}

/// Rounds away floating-point noise: 0.005 m is 5 mm, not 5.000000000000001.
fn round(value: f64) -> f64 {
    format!("{value:.14e}").parse().unwrap_or(value)
}

/// Splits a text such as `5 mm` into number and unit.
pub(crate) fn with_unit(text: &str) -> Option<(f64, &str)> {
    let text = text.trim();
    let end = text.find(|c: char| c.is_alphabetic() && c != 'e' && c != 'E')?;
    let (number, unit) = text.split_at(end);
    let known = UNITS.iter().any(|u| u.suffix == unit);
    let number = number.trim().parse::<f64>().ok().filter(|n| n.is_finite())?;
    known.then_some((number, unit))
}

/// Converts `number` from `unit` to the unit that `name` ends in.
pub(crate) fn in_unit_of(name: &str, number: f64, unit: &str) -> Option<f64> {
    let (_, to) = split(name);
    let from = UNITS.iter().find(|u| u.suffix == unit)?;
    let to = to.filter(|to| to.kind == from.kind)?;
    Some(round(number * from.size / to.size))
}
