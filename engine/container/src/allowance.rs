use std::{fmt, ops::ControlFlow};

/// Environment variable with the limit in megabytes (2²⁰ bytes).
const SETTING: &str = "OSTEOFLOW_MAX_RECORDING_MB";

/// Memory that the content of a file may take where a program keeps it.
///
/// Chunks are compressed, and a message takes memory beside its bytes: 100 kB of a file can become gigabytes. The limit is
/// 4 GiB, which holds 8,900 scans of 20,000 points and leaves a machine of 8 GiB usable; the environment variable
/// `OSTEOFLOW_MAX_RECORDING_MB` sets another. The chunk that is being read comes on top, at most
/// [`MAX_RECORD_BYTES`](crate::MAX_RECORD_BYTES).
#[derive(Debug, Clone)]
pub struct Allowance {
    limit: u64,
    used: u64,
    /// A setting that is no number; nothing is then allowed.
    faulty: Option<String>,
}

/// The content of a file takes more memory than is allowed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TooLarge {
    /// The limit in bytes.
    pub limit: u64,
    /// The setting, if it is no number.
    pub faulty: Option<String>,
}

impl fmt::Display for TooLarge {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(found) = &self.faulty {
            return write!(f, "{SETTING} is {found:?}, but a whole number of megabytes is expected");
        }
        write!(
            f,
            "its content takes more than {} MB of memory; if this machine has more, set {SETTING} to that many megabytes",
            self.limit >> 20
        )
    }
}

impl std::error::Error for TooLarge {}

impl Allowance {
    /// The limit without a setting.
    pub const DEFAULT_BYTES: u64 = 4 << 30;

    /// Memory beside the bytes of a message: its place in a list that may have grown to twice its length, and what the
    /// allocator adds.
    const OVERHEAD: u64 = 128;

    /// An allowance of `limit` bytes.
    pub fn new(limit: u64) -> Self {
        Self { limit, used: 0, faulty: None }
    }

    /// The allowance that the environment sets. If the setting is no number, nothing is allowed, and [`TooLarge`] says so.
    pub fn from_env() -> Self {
        Self::of(std::env::var_os(SETTING).map(|set| set.to_string_lossy().into_owned()).as_deref())
    }

    fn of(set: Option<&str>) -> Self {
        match set.map(str::trim).filter(|set| !set.is_empty()).map(|set| (set, set.parse::<u64>())) {
            None => Self::new(Self::DEFAULT_BYTES),
            Some((_, Ok(megabytes))) => Self::new(megabytes.saturating_mul(1 << 20)),
            Some((found, Err(_))) => Self { faulty: Some(found.to_owned()), ..Self::new(0) },
        }
    }

    /// Takes the memory of something that is kept, such as a message of `n_bytes`. Breaks if there is none left.
    pub fn take(&mut self, n_bytes: usize) -> ControlFlow<()> {
        self.used = self.used.saturating_add(n_bytes as u64).saturating_add(Self::OVERHEAD);
        if self.used > self.limit { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    /// Whether more was taken than is allowed.
    pub fn exceeded(&self) -> Option<TooLarge> {
        (self.used > self.limit).then(|| TooLarge { limit: self.limit, faulty: self.faulty.clone() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_things_count_with_what_they_take_beside_their_bytes() {
        let mut allowance = Allowance::new(1000);
        assert!((0..7).all(|_| allowance.take(0).is_continue()) && allowance.exceeded().is_none());
        assert!(allowance.take(0).is_break());
        assert!(allowance.exceeded().unwrap().to_string().contains(SETTING));
        assert!(Allowance::new(1 << 20).take(1 << 20).is_break());
        assert!(Allowance::new(u64::MAX).take(usize::MAX).is_continue());
    }

    #[test]
    fn the_limit_may_be_taken_whole_and_is_named_in_megabytes() {
        let mut allowance = Allowance::new((5 << 20) + Allowance::OVERHEAD);
        assert!(allowance.take(5 << 20).is_continue() && allowance.exceeded().is_none());
        assert!(allowance.take(0).is_break());
        let expected = "its content takes more than 5 MB of memory; if this machine has more, set \
                        OSTEOFLOW_MAX_RECORDING_MB to that many megabytes";
        assert_eq!(allowance.exceeded().unwrap().to_string(), expected);
        let set = std::env::var(SETTING).ok();
        assert_eq!(Allowance::from_env().limit, Allowance::of(set.as_deref()).limit);
    }

    #[test]
    fn a_setting_that_is_no_number_allows_nothing_and_is_named() {
        assert_eq!(Allowance::of(None).limit, 4 << 30);
        assert_eq!(Allowance::of(Some("")).limit, 4 << 30);
        assert_eq!(Allowance::of(Some(" 64 ")).limit, 64 << 20);
        let mut faulty = Allowance::of(Some("5 GB"));
        assert!(faulty.take(0).is_break());
        let message = faulty.exceeded().unwrap().to_string();
        assert_eq!(message, "OSTEOFLOW_MAX_RECORDING_MB is \"5 GB\", but a whole number of megabytes is expected");
    }
}
