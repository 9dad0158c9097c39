//! Named numbers with units that a node reports.

use crate::{
    Table,
    columns::{from_column, to_column},
    geometry_views::{LINE, invalid},
};
use osteoflow_node::{ColumnType, Payload, SchemaEntry, View, ViewError};
use serde_json::{Map, Value as Json};
use std::{collections::BTreeSet, sync::Arc};

/// A number with its name and unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Metric {
    /// Its name, such as `surface_rms`.
    pub name: Arc<str>,
    /// The number.
    pub value: f64,
    /// Its unit, such as `mm`; empty for a count or a ratio.
    pub unit: Arc<str>,
}

impl Metric {
    /// Its key in `results.json`: the name, with the unit as a suffix unless it ends so already. `surface_rms` in `mm`
    /// and `surface_rms_mm` in `mm` are both `surface_rms_mm`.
    pub fn key(&self) -> String {
        let has_unit = self.name.strip_suffix(&*self.unit).is_some_and(|stem| stem.ends_with('_'));
        if self.unit.is_empty() || has_unit { self.name.to_string() } else { format!("{}_{}", self.name, self.unit) }
    }
}

/// Numbers that a node reports, in order. In `results.json` an object with a [`Metric::key`] for each.
///
/// ```
/// use osteoflow_node::{NodeError, Payload};
/// use osteoflow_payloads::Metrics;
///
/// let metrics = Metrics::new([("surface_rms", 0.25, "mm"), ("tilt_rad", 0.5, "rad"), ("n_pairs", 812.0, "")])?;
/// assert_eq!(metrics.to_result().to_string(), r#"{"surface_rms_mm":0.25,"tilt_rad":0.5,"n_pairs":812.0}"#);
/// # Ok::<(), NodeError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Metrics(Arc<[Metric]>);

/// Numbers that cannot be reported.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct MetricsError(String);

impl Metrics {
    /// The numbers: name, value and unit of each.
    ///
    /// # Errors
    /// [`MetricsError`] if a number is not finite, a name is no name, or two would have one key in the results.
    pub fn new<N: Into<Arc<str>>, U: Into<Arc<str>>>(
        metrics: impl IntoIterator<Item = (N, f64, U)>,
    ) -> Result<Self, MetricsError> {
        let of = |(name, value, unit): (N, f64, U)| Metric { name: name.into(), value, unit: unit.into() };
        let metrics: Arc<[Metric]> = metrics.into_iter().map(of).collect();
        let mut keys = BTreeSet::new();
        for metric in &*metrics {
            let (name, unit) = (&metric.name, &metric.unit);
            let message = if name.is_empty() || [name, unit].iter().any(|text| text.contains(char::is_control)) {
                let (name, unit) = (name.escape_debug(), unit.escape_debug());
                format!("a metric is called \"{name}\" with the unit \"{unit}\"; one line is needed, and a name")
            } else if !metric.value.is_finite() {
                let value = metric.value;
                format!("metric \"{name}\" is {value}; leave out what could not be computed, or say why in an error")
            } else if !keys.insert(metric.key()) {
                let key = metric.key();
                format!("two metrics would both be \"{key}\" in the results; give one of them another name")
            } else {
                continue;
            };
            return Err(MetricsError(message));
        }
        Ok(Self(metrics))
    }
}

impl std::ops::Deref for Metrics {
    type Target = [Metric];

    fn deref(&self) -> &[Metric] {
        &self.0
    }
}

impl Payload<Table> for Metrics {
    const NAME: &'static str = "report/Metrics";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[
        SchemaEntry::text("names").doc("one a line"),
        SchemaEntry::text("units").doc("one a line, nothing for a count or a ratio"),
        SchemaEntry::column("values", ColumnType::F64, 1),
    ];

    fn to_view(&self) -> View {
        let lines = |of: fn(&Metric) -> &str| self.iter().map(of).collect::<Vec<_>>().join(LINE);
        let values: Vec<f64> = self.iter().map(|metric| metric.value).collect();
        View::new()
            .with("names", lines(|metric| &metric.name))
            .with("units", lines(|metric| &metric.unit))
            .with_column(to_column("values", ColumnType::F64, &values.into()))
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        let values = from_column::<f64>(view, "values")?;
        let lines = |name| view.text(name).map(|text| text.split(LINE).collect::<Vec<_>>());
        let (names, units) = if values.is_empty() { (vec![], vec![]) } else { (lines("names")?, lines("units")?) };
        if [names.len(), units.len()] != [values.len(); 2] {
            let (n_names, n_units, n) = (names.len(), units.len(), values.len());
            return Err(invalid(format!(
                "{n_names} names and {n_units} units of {n} values; as many lines are needed"
            )));
        }
        Self::new((0..values.len()).map(|i| (names[i], values[i], units[i]))).map_err(invalid)
    }

    fn to_result(&self) -> Json {
        self.iter().map(|metric| (metric.key(), metric.value.into())).collect::<Map<_, _>>().into()
    }

    fn n_bytes(&self) -> usize {
        size_of::<Self>() + size_of_val(&*self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metrics_survive_their_view_in_their_order() {
        let metrics = [("surface_rms", 0.1 + 0.2, "mm"), ("area", 1e-300, "mm²"), ("n_pairs", -0.0, "")];
        for metrics in
            [Metrics::new(metrics).unwrap(), Metrics::new(metrics.into_iter().take(1)).unwrap(), Metrics::default()]
        {
            let view = metrics.to_view();
            assert_eq!(view.check(Metrics::SCHEMA), Ok(()));
            let back = Metrics::from_view(&view).unwrap();
            assert_eq!((back.to_view(), back), (view, metrics));
        }
    }

    #[test]
    fn a_key_ends_in_the_unit_once() {
        let keys = |name, unit| Metrics::new([(name, 1.0, unit)]).unwrap()[0].key();
        assert_eq!(keys("surface_rms", "mm"), "surface_rms_mm");
        assert_eq!(keys("surface_rms_mm", "mm"), "surface_rms_mm");
        assert_eq!(keys("hmm", "mm"), "hmm_mm", "letters at the end are no unit");
        assert_eq!(keys("n_pairs", ""), "n_pairs");
    }

    #[test]
    fn numbers_that_would_be_lost_or_are_none_are_refused() {
        let error = |metrics: &[(&'static str, f64, &'static str)]| {
            Metrics::new(metrics.iter().copied()).unwrap_err().to_string()
        };
        assert_eq!(
            error(&[("rms", 1.0, "mm"), ("rms_mm", 2.0, "")]),
            "two metrics would both be \"rms_mm\" in the results; give one of them another name"
        );
        assert!(error(&[("rms", f64::NAN, "mm")]).starts_with("metric \"rms\" is NaN; leave out"));
        assert!(error(&[("a\nb", 1.0, "")]).starts_with("a metric is called \"a\\nb\""));
        let two_units = Metrics::new([("rms", 1.0, "mm")]).unwrap().to_view();
        let mut two_units = View { head: vec![], ..two_units };
        two_units = two_units.with("names", "rms").with("units", "mm\nmm");
        let message = Metrics::from_view(&two_units).unwrap_err().to_string();
        assert!(message.contains("1 names and 2 units of 1 values"), "{message}");
    }
}
