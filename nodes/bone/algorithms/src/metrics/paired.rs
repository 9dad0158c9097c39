use super::MetricsError;
use nalgebra::Point3;
use osteoflow_geometry::NamedPoint;

/// Name, target and source position of a point.
pub(super) type PointPair = (String, Point3<f64>, Point3<f64>);

/// The pair of each target point.
pub(super) fn paired(target: &[NamedPoint], source: &[NamedPoint]) -> Result<Vec<PointPair>, MetricsError> {
    if target.is_empty() {
        return Err(MetricsError::Empty { what: "point" });
    }
    target
        .iter()
        .map(|t| match source.iter().find(|s| s.name == t.name) {
            Some(s) => Ok((t.name.to_string(), t.position, s.position)),
            None => Err(MetricsError::Unpaired {
                name: t.name.to_string(),
                side: "measured",
                found: source.iter().map(|s| &*s.name).collect::<Vec<_>>().join(", "),
            }),
        })
        .collect()
}
