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
}

/// The content of a file takes more memory than is allowed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TooLarge {
    /// The limit in bytes.
    pub limit: u64,
}

impl fmt::Display for TooLarge {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
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
        Self { limit, used: 0 }
    }

    /// The allowance that the environment sets. A setting that is no number counts as none.
    pub fn from_env() -> Self {
        let megabytes = std::env::var(SETTING).ok().and_then(|text| text.trim().parse::<u64>().ok());
        Self::new(megabytes.map_or(Self::DEFAULT_BYTES, |megabytes| megabytes.saturating_mul(1 << 20)))
    }

    /// Takes the memory of something that is kept, such as a message of `n_bytes`. Breaks if there is none left.
    pub fn take(&mut self, n_bytes: usize) -> ControlFlow<()> {
        self.used = self.used.saturating_add(n_bytes as u64 + Self::OVERHEAD);
        if self.used > self.limit { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    /// Whether more was taken than is allowed.
    pub fn exceeded(&self) -> Option<TooLarge> {
        (self.used > self.limit).then_some(TooLarge { limit: self.limit })
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
}
