use crate::Refusal;
use nalgebra::Point3;
use osteoflow_geometry::NamedPoint;

/// Name, target and source position of a point.
pub(super) type PointPair = (String, Point3<f64>, Point3<f64>);

/// The pair of each target point.
pub(super) fn paired(target: &[NamedPoint], source: &[NamedPoint]) -> Result<Vec<PointPair>, Refusal> {
    if target.is_empty() {
        return Err(nothing("point"));
    }
    target
        .iter()
        .map(|t| match source.iter().find(|s| s.name == t.name) {
            Some(s) => Ok((t.name.to_string(), t.position, s.position)),
            None => Err(unpaired(&t.name, "measured", source.iter().map(|s| &*s.name))),
        })
        .collect()
}

/// The refusal of a name that is not among the names of a side.
pub(super) fn unpaired<'a>(name: &str, side: &str, names: impl Iterator<Item = &'a str>) -> Refusal {
    let names = names.collect::<Vec<_>>().join(", ");
    Refusal::of(format!("{name} is not among the {side} points ({names}); name both sets alike"))
}

/// The refusal of an empty input.
pub(super) fn nothing(what: &str) -> Refusal {
    Refusal::of(format!("there is no {what}; nothing can be measured"))
}

/// The refusal of a number that is NaN or infinite.
pub(super) fn not_finite(what: &str) -> Refusal {
    Refusal::of(format!("{what} is not finite; look at where it comes from"))
}
