use std::sync::Arc;

/// Bytes with shared ownership, such as the rows of a column.
pub type SharedBytes = Arc<dyn AsRef<[u8]> + Send + Sync>;

/// Longer slices are kept as segments of their own; shorter ones are cheaper to copy.
const MIN_SEGMENT_BYTES: usize = 4 << 10;

/// Bytes of a message as a list of segments, so that long buffers are written without being copied.
#[derive(Default)]
pub struct Segments {
    segments: Vec<Segment>,
    tail: Vec<u8>,
    /// Bytes in `segments`.
    n_bytes: usize,
}

enum Segment {
    Owned(Vec<u8>),
    Shared(SharedBytes),
}

impl Segment {
    fn bytes(&self) -> &[u8] {
        match self {
            Self::Owned(bytes) => bytes,
            Self::Shared(bytes) => (**bytes).as_ref(),
        }
    }
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
        } else {
            self.end_tail();
            self.n_bytes += bytes.len();
            self.segments.push(Segment::Shared(shared.clone()));
        }
    }

    /// Appends owned bytes; long ones are not copied.
    pub fn push(&mut self, bytes: Vec<u8>) {
        if bytes.len() < MIN_SEGMENT_BYTES {
            self.tail.extend_from_slice(&bytes);
        } else {
            self.end_tail();
            self.n_bytes += bytes.len();
            self.segments.push(Segment::Owned(bytes));
        }
    }

    /// All bytes in one buffer.
    pub fn into_vec(self) -> Vec<u8> {
        if self.segments.is_empty() {
            return self.tail;
        }
        let mut all = Vec::with_capacity(self.len());
        self.slices().for_each(|slice| all.extend_from_slice(slice));
        all
    }

    /// The segments in order.
    pub fn slices(&self) -> impl Iterator<Item = &[u8]> {
        self.segments.iter().map(Segment::bytes).chain([&*self.tail]).filter(|slice| !slice.is_empty())
    }

    /// Closes the tail, so that the next segment follows it.
    pub(crate) fn end_tail(&mut self) {
        if !self.tail.is_empty() {
            self.n_bytes += self.tail.len();
            self.segments.push(Segment::Owned(std::mem::take(&mut self.tail)));
        }
    }

    pub(crate) fn append(&mut self, other: Self) {
        for segment in other.segments {
            match segment {
                Segment::Owned(bytes) => self.push(bytes),
                Segment::Shared(bytes) => self.push_shared(&bytes),
            }
        }
        self.tail.extend_from_slice(&other.tail);
    }
}

impl From<Vec<u8>> for Segments {
    fn from(bytes: Vec<u8>) -> Self {
        let mut segments = Self::default();
        segments.push(bytes);
        segments
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_bytes_stay_where_they_are_and_short_ones_are_gathered_in_order() {
        let mut parts = Segments::default();
        assert!(parts.is_empty());
        for n in [1, MIN_SEGMENT_BYTES - 1, MIN_SEGMENT_BYTES, 2] {
            parts.push(vec![n as u8; n]);
        }
        parts.push_shared(&(std::sync::Arc::new(vec![7_u8; MIN_SEGMENT_BYTES]) as SharedBytes));
        let lengths: Vec<_> = parts.slices().map(<[u8]>::len).collect();
        assert_eq!(lengths, [MIN_SEGMENT_BYTES, MIN_SEGMENT_BYTES, 2, MIN_SEGMENT_BYTES]);
        assert_eq!(parts.len(), 3 * MIN_SEGMENT_BYTES + 2);
        let all = parts.into_vec();
        assert_eq!(
            (all[0], all[1], all[MIN_SEGMENT_BYTES * 2], all.last()),
            (1, (MIN_SEGMENT_BYTES - 1) as u8, 2, Some(&7))
        );
    }

    #[test]
    fn appended_bytes_keep_their_order_and_long_ones_their_place() {
        let shared = |n: usize, byte: u8| std::sync::Arc::new(vec![byte; n]) as SharedBytes;
        let mut other = Segments::from(vec![1; MIN_SEGMENT_BYTES]);
        other.push_shared(&shared(MIN_SEGMENT_BYTES - 1, 2));
        other.push_shared(&shared(MIN_SEGMENT_BYTES, 3));
        other.push(vec![4; 5]);
        let mut all = Segments::from(vec![0; 3]);
        assert_eq!((all.len(), all.is_empty()), (3, false));
        all.append(other);
        let found: Vec<_> = all.slices().map(|slice| (slice[0], slice.len())).collect();
        let n = MIN_SEGMENT_BYTES;
        assert_eq!(found, [(0, 3), (1, n), (2, n - 1), (3, n), (4, 5)]);
        assert_eq!(all.len(), 3 + n + n - 1 + n + 5);
        all.end_tail();
        all.end_tail();
        assert_eq!((all.len(), all.slices().count(), all.tail().len()), (3 + n + n - 1 + n + 5, 5, 0));
        let bytes = all.into_vec();
        assert_eq!((bytes.len(), bytes[3], bytes[2 + n], bytes.last()), (3 + n + n - 1 + n + 5, 1, 1, Some(&4)));
        assert_eq!(Segments::from(vec![7; 2]).into_vec(), [7, 7]);
    }
}
