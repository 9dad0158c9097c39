use std::{borrow::Cow, sync::Arc};

/// Bytes with shared ownership, such as the rows of a column.
pub type SharedBytes = Arc<dyn AsRef<[u8]> + Send + Sync>;

/// Longer slices are kept as segments of their own; shorter ones are cheaper to copy.
const MIN_SEGMENT_BYTES: usize = 4 << 10;

/// Bytes of a message as a list of segments, so that long buffers are passed on without being copied.
#[derive(Default)]
pub struct Segments {
    segments: Vec<SharedBytes>,
    tail: Vec<u8>,
    /// Bytes in `segments`.
    n_bytes: usize,
}

impl Segments {
    /// Number of bytes in all segments.
    pub fn len(&self) -> usize {
        self.n_bytes + self.tail.len()
    }

    /// Whether there are no bytes.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Buffer at the end, to which short values are appended.
    pub fn tail(&mut self) -> &mut Vec<u8> {
        &mut self.tail
    }

    /// Appends shared bytes; long ones are not copied.
    pub fn push_shared(&mut self, shared: &SharedBytes) {
        let bytes: &[u8] = (**shared).as_ref();
        if bytes.len() < MIN_SEGMENT_BYTES {
            self.tail.extend_from_slice(bytes);
            return;
        }
        self.n_bytes += self.tail.len() + bytes.len();
        if !self.tail.is_empty() {
            self.segments.push(Arc::new(std::mem::take(&mut self.tail)));
        }
        self.segments.push(shared.clone());
    }

    /// The bytes with others before them; none are copied.
    pub fn behind(mut self, prefix: Vec<u8>) -> Self {
        self.n_bytes += prefix.len();
        self.segments.insert(0, Arc::new(prefix));
        self
    }

    /// All bytes in one buffer.
    pub fn into_vec(self) -> Vec<u8> {
        if self.segments.is_empty() { self.tail } else { self.contiguous().into_owned() }
    }

    /// All bytes in one slice; a single segment is not copied.
    pub fn contiguous(&self) -> Cow<'_, [u8]> {
        match self.slices().collect::<Vec<_>>()[..] {
            [one] => one.into(),
            ref several => several.concat().into(),
        }
    }

    /// The segments in order.
    pub fn slices(&self) -> impl Iterator<Item = &[u8]> {
        let segments = self.segments.iter().map(|segment| (**segment).as_ref());
        segments.chain([&*self.tail]).filter(|slice| !slice.is_empty())
    }
}

impl From<Vec<u8>> for Segments {
    fn from(tail: Vec<u8>) -> Self {
        Self { tail, ..Self::default() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shared(n: usize, byte: u8) -> SharedBytes {
        Arc::new(vec![byte; n])
    }

    #[test]
    fn long_bytes_stay_where_they_are_and_short_ones_are_gathered_in_order() {
        let n = MIN_SEGMENT_BYTES;
        let mut parts = Segments::from(vec![0; 3]);
        assert_eq!((parts.len(), parts.is_empty(), Segments::default().is_empty()), (3, false, true));
        assert_eq!(&*parts.contiguous(), [0; 3]);
        for (n_bytes, byte) in [(1, 1), (n - 1, 2), (n, 3), (n, 4), (2, 5)] {
            parts.push_shared(&shared(n_bytes, byte));
        }
        parts.tail().push(6);
        let slices: Vec<_> = parts.slices().map(|slice| (slice[0], slice.len())).collect();
        assert_eq!(slices, [(0, 3 + n), (3, n), (4, n), (5, 3)]);
        assert_eq!(parts.len(), 3 * n + 6);
        let all = parts.into_vec();
        assert_eq!((all.len(), all[2], all[3], all[4], all[3 + n]), (3 * n + 6, 0, 1, 2, 3));
        assert_eq!(all[3 + 3 * n..], [5, 5, 6]);
        assert_eq!(Segments::from(vec![7; 2]).into_vec(), [7, 7]);
    }
}
