/// Why an algorithm has no result: what was expected, what was found, and a next step.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Refusal(String);

impl Refusal {
    pub(crate) fn of(reason: impl ToString) -> Self {
        Self(reason.to_string())
    }
}
