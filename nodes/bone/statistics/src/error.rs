//! The error of all statistics.

/// Why a statistic could not be computed: what was found, what is needed, and what to do.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct StatisticsError(pub(crate) String);

impl StatisticsError {
    /// `Err` if there are fewer than `needed`.
    pub(crate) fn too_few(what: &str, found: usize, needed: usize) -> Result<(), Self> {
        if found >= needed {
            return Ok(());
        }
        Err(Self(format!("{found} {what}, at least {needed} needed; measure more, or report the single values")))
    }

    /// `Err` at the first value that is not finite.
    pub(crate) fn not_finite(values: &[f64]) -> Result<(), Self> {
        let Some(index) = values.iter().position(|v| !v.is_finite()) else { return Ok(()) };
        let value = values[index];
        Err(Self(format!("value {index} is {value}; leave rows without a number out, and say how many they were")))
    }

    /// `Err` if two columns differ in length.
    pub(crate) fn lengths(left: usize, right: usize) -> Result<(), Self> {
        if left == right {
            return Ok(());
        }
        Err(Self(format!("one column has {left} rows, the other {right}; give both for the same rows")))
    }

    /// `Err` if `value` is not strictly between 0 and `below`.
    pub(crate) fn out_of_range(name: &str, value: f64, below: f64) -> Result<(), Self> {
        if value > 0.0 && value < below {
            return Ok(());
        }
        Err(Self(format!("{name} is {value}, but must lie between 0 and {below}; 95 % is 0.95")))
    }

    /// `Err` if all values are equal; `values` is not empty.
    pub(crate) fn constant(what: &str, values: &[f64]) -> Result<(), Self> {
        let differ = values.iter().any(|v| *v != values[0]);
        if differ { Ok(()) } else { Err(Self::without_spread(what, values.len(), values[0])) }
    }

    pub(crate) fn without_spread(what: &str, n: usize, value: f64) -> Self {
        Self(format!("all {n} {what} are {value}, without any spread; state that instead of a test"))
    }
}
