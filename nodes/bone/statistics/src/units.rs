//! The bone, procedure and point of each row.

use std::collections::BTreeSet;

use serde::Serialize;

use crate::{StatisticsError, summary::mean};

/// The unit of each level that the rows of a table belong to, highest level first: `bone > procedure > point`.
///
/// A unit is identified by its whole path: procedure 1 on bone A is not procedure 1 on bone B. Units are numbered in the order
/// of their labels, whatever the order of the rows.
#[derive(Debug, Clone, PartialEq)]
pub struct Units {
    levels: Vec<Level>,
    n_rows: usize,
}

#[derive(Debug, Clone, PartialEq)]
struct Level {
    name: String,
    /// Path of each unit.
    paths: Vec<Vec<String>>,
    /// Unit of each row.
    unit_of: Vec<usize>,
}

impl Units {
    /// Units from the names of the levels and the path of each row, with one label per level. `O(n log n)`.
    ///
    /// # Errors
    /// [`StatisticsError`] without a level, or if a row does not have one label per level.
    pub fn new<N: AsRef<str>, L: AsRef<str>, P: AsRef<[L]>>(names: &[N], paths: &[P]) -> Result<Self, StatisticsError> {
        let names: Vec<&str> = names.iter().map(AsRef::as_ref).collect();
        if names.is_empty() {
            let message = "no level of units is named; name at least the highest, such as \"bone\"";
            return Err(StatisticsError(message.into()));
        }
        let mut rows: Vec<Vec<&str>> = Vec::with_capacity(paths.len());
        for (row, path) in paths.iter().enumerate() {
            let path: Vec<&str> = path.as_ref().iter().map(AsRef::as_ref).collect();
            if path.len() != names.len() {
                let (n, levels) = (path.len(), names.join(" > "));
                return Err(StatisticsError(format!(
                    "row {row} names {n} units for the levels {levels}; give one label for each level"
                )));
            }
            rows.push(path);
        }
        let levels = names.iter().enumerate().map(|(depth, name)| {
            let known: BTreeSet<&[&str]> = rows.iter().map(|path| &path[..=depth]).collect();
            let known: Vec<&[&str]> = known.into_iter().collect();
            let unit =
                |path: &Vec<&str>| known.binary_search(&&path[..=depth]).expect("it was collected from the rows");
            Level {
                name: (*name).into(),
                unit_of: rows.iter().map(unit).collect(),
                paths: known.iter().map(|path| path.iter().map(|label| (*label).into()).collect()).collect(),
            }
        });
        Ok(Self { levels: levels.collect(), n_rows: rows.len() })
    }

    /// Each row is a unit, such as runs that share nothing: `Units::each_row("procedure", 10)`.
    pub fn each_row(name: &str, n_rows: usize) -> Self {
        let paths = (0..n_rows).map(|row| vec![row.to_string()]).collect();
        Self { levels: vec![Level { name: name.into(), paths, unit_of: (0..n_rows).collect() }], n_rows }
    }

    /// Rows of the table.
    pub fn n_rows(&self) -> usize {
        self.n_rows
    }

    /// Names of the levels, highest first.
    pub fn levels(&self) -> impl Iterator<Item = &str> {
        self.levels.iter().map(|level| level.name.as_str())
    }

    /// Number of units at each level, highest first. The first is the n of a statement about other units.
    pub fn n_units(&self) -> Vec<usize> {
        self.levels.iter().map(|level| level.paths.len()).collect()
    }

    /// Name of the highest level.
    pub fn highest(&self) -> &str {
        &self.levels[0].name
    }

    /// Labels of the highest level's units, in order.
    pub fn labels(&self) -> impl Iterator<Item = &str> {
        self.levels[0].paths.iter().map(|path| path[0].as_str())
    }

    /// The index of each row's unit at level `depth` (0 is the highest).
    ///
    /// # Panics
    /// If there is no such level.
    pub fn unit_of(&self, depth: usize) -> &[usize] {
        &self.levels[depth].unit_of
    }

    /// Splits `column` by the units of the highest level, in order.
    pub(crate) fn split<T: Copy>(&self, column: &[T]) -> Result<Vec<Vec<T>>, StatisticsError> {
        StatisticsError::lengths(self.n_rows, column.len())?;
        let mut parts = vec![Vec::new(); self.levels[0].paths.len()];
        for (unit, value) in self.unit_of(0).iter().zip(column) {
            parts[*unit].push(*value);
        }
        Ok(parts)
    }

    /// Splits a column of numbers and sorts them within each unit, so that sums do not depend on the order of the rows.
    pub(crate) fn split_sorted(&self, values: &[f64]) -> Result<Vec<Vec<f64>>, StatisticsError> {
        StatisticsError::not_finite(values)?;
        let mut parts = self.split(values)?;
        parts.iter_mut().for_each(|part| part.sort_unstable_by(f64::total_cmp));
        Ok(parts)
    }
}

/// The mean of the rows of each unit of the highest level.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UnitMeans {
    /// Name of the highest level.
    pub unit: String,
    /// Number of rows before averaging.
    pub n_rows: usize,
    /// Label of each unit, in order.
    pub labels: Vec<String>,
    /// Mean of each unit's rows. Their number is the n of a test on them.
    pub means: Vec<f64>,
}

/// Averages the rows within each unit of the highest level, for tests that assume independent values.
///
/// For paired rows, average the differences, so that the pairs are kept.
///
/// # Errors
/// [`StatisticsError`] if the lengths differ, or a value is not finite.
pub fn unit_means(units: &Units, values: &[f64]) -> Result<UnitMeans, StatisticsError> {
    let means = units.split_sorted(values)?.iter().map(|part| mean(part)).collect();
    let labels = units.labels().map(String::from).collect();
    Ok(UnitMeans { unit: units.highest().into(), n_rows: units.n_rows(), labels, means })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_is_its_whole_path() {
        let paths = [["B", "1", "M1"], ["A", "1", "M1"], ["A", "2", "M1"], ["A", "1", "M2"]];
        let units = Units::new(&["bone", "procedure", "point"], &paths).unwrap();
        assert_eq!(units.n_units(), [2, 3, 4]);
        assert_eq!(units.unit_of(0), [1, 0, 0, 0]);
        assert_eq!(units.unit_of(1), [2, 0, 1, 0]);
        assert_eq!(units.levels().collect::<Vec<_>>(), ["bone", "procedure", "point"]);
    }

    #[test]
    fn rows_of_a_unit_are_averaged_and_the_units_counted() {
        let units = Units::new(&["bone"], &[["B"], ["A"], ["B"]]).unwrap();
        let means = unit_means(&units, &[1.0, 5.0, 2.0]).unwrap();
        assert_eq!(means.labels, ["A", "B"]);
        assert_eq!((means.means, means.n_rows, means.unit.as_str()), (vec![5.0, 1.5], 3, "bone"));
    }

    #[test]
    fn a_row_without_a_label_for_each_level_is_refused() {
        let refused = Units::new(&["bone", "procedure"], &[vec!["A", "1"], vec!["A"]]).unwrap_err();
        assert_eq!(
            refused.to_string(),
            "row 1 names 1 units for the levels bone > procedure; give one label for each level"
        );
        assert!(
            Units::new::<&str, &str, [&str; 0]>(&[], &[])
                .unwrap_err()
                .to_string()
                .contains("no level of units is named")
        );
    }

    #[test]
    fn a_column_of_another_length_is_refused() {
        let units = Units::each_row("run", 3);
        assert!(unit_means(&units, &[1.0]).unwrap_err().to_string().contains("one column has 3 rows, the other 1"));
    }
}
