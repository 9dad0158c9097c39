//! Errors of all statistics.

use thiserror::Error;

/// The reason why a statistic could not be computed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum StatisticsError {
    /// Fewer values, pairs or units than the statistic needs.
    #[error("{found} {what}, at least {needed} needed; measure more, or report the single values")]
    TooFew {
        /// The kind of things counted.
        what: String,
        /// Their number.
        found: usize,
        /// The number needed.
        needed: usize,
    },
    /// A value is NaN or infinite.
    #[error("value {index} is {value}; leave rows without a number out, and say how many they were")]
    NotFinite {
        /// Its index in the column.
        index: usize,
        /// The value.
        value: f64,
    },
    /// A statistic passed to the bootstrap is NaN or infinite for all rows.
    #[error("the statistic of all {n_rows} rows is {value}; can it be computed from so few or such equal values?")]
    Statistic {
        /// Rows of the table.
        n_rows: usize,
        /// The value of the statistic.
        value: f64,
    },
    /// Two paired columns have different lengths.
    #[error("one column has {left} rows, the other {right}; give both for the same rows")]
    Lengths {
        /// Rows of the first column.
        left: usize,
        /// Rows of the second column.
        right: usize,
    },
    /// All values are equal, so there is no spread to compare with.
    #[error("all {n} {what} are {value}, without any spread; state that instead of a test")]
    Constant {
        /// The kind of values.
        what: &'static str,
        /// Their number.
        n: usize,
        /// The value.
        value: f64,
    },
    /// A level, alpha or p-value is not between 0 and 1.
    #[error("{name} is {value}, but must lie between 0 and {below}; 95 % is 0.95")]
    OutOfRange {
        /// The parameter.
        name: &'static str,
        /// Its value.
        value: f64,
        /// The upper bound.
        below: f64,
    },
    /// The margin of equivalence is not a positive number.
    #[error("the margin of equivalence is {0}; state the largest difference that does not matter, above 0")]
    Margin(f64),
    /// There are more hits than rows.
    #[error("{n_hits} hits in {n} rows; a share counts hits among rows")]
    Hits {
        /// Number of hits.
        n_hits: usize,
        /// Number of rows.
        n: usize,
    },
    /// A row has more or fewer labels than there are levels.
    #[error("row {row} names {found} units for the levels {levels}; give one label for each level")]
    Path {
        /// Index of the row.
        row: usize,
        /// Number of its labels.
        found: usize,
        /// The levels, highest first.
        levels: String,
    },
    /// Units without a level.
    #[error("no level of units is named; name at least the highest, such as \"bone\"")]
    NoLevel,
}

impl StatisticsError {
    /// `Err` if there are fewer than `needed`.
    pub(crate) fn too_few(what: &str, found: usize, needed: usize) -> Result<(), Self> {
        if found >= needed { Ok(()) } else { Err(Self::TooFew { what: what.into(), found, needed }) }
    }

    /// `Err` at the first value that is not finite.
    pub(crate) fn not_finite(values: &[f64]) -> Result<(), Self> {
        match values.iter().position(|v| !v.is_finite()) {
            None => Ok(()),
            Some(index) => Err(Self::NotFinite { index, value: values[index] }),
        }
    }

    /// `Err` if two columns differ in length.
    pub(crate) fn lengths(left: usize, right: usize) -> Result<(), Self> {
        if left == right { Ok(()) } else { Err(Self::Lengths { left, right }) }
    }

    /// `Err` if `value` is not strictly between 0 and `below`.
    pub(crate) fn out_of_range(name: &'static str, value: f64, below: f64) -> Result<(), Self> {
        if value > 0.0 && value < below { Ok(()) } else { Err(Self::OutOfRange { name, value, below }) }
    }

    /// `Err` if all values are equal; `values` is not empty.
    pub(crate) fn constant(what: &'static str, values: &[f64]) -> Result<(), Self> {
        if values.iter().any(|v| *v != values[0]) {
            return Ok(());
        }
        Err(Self::Constant { what, n: values.len(), value: values[0] })
    }
}
