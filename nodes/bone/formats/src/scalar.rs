//! Binary numbers in rows of equal length, and numbers in text.

/// The type of a binary number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scalar {
    /// 8 bits, signed.
    I8,
    /// 8 bits.
    U8,
    /// 16 bits, signed.
    I16,
    /// 16 bits.
    U16,
    /// 32 bits, signed.
    I32,
    /// 32 bits.
    U32,
    /// 64 bits, signed.
    I64,
    /// 64 bits.
    U64,
    /// Single precision.
    F32,
    /// Double precision.
    F64,
}

/// What depth images of 16 bits have where nothing was measured, besides 0.
pub const NO_DEPTH_16: f64 = 65535.0;

/// Rows of equal length, one after the other.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rows<'a> {
    pub(crate) bytes: &'a [u8],
    /// Bytes of a row, at least 1.
    pub(crate) stride: usize,
    pub(crate) big: bool,
}

// Evaluates `$body` with `$number` as a function from the bytes of one number to its value.
macro_rules! with_type {
    ($scalar:expr, $big:expr, $n:ident, $number:ident => $body:expr) => {
        with_type!(@ $scalar, $big, $n, $number, $body;
            I8 i8, U8 u8, I16 i16, U16 u16, I32 i32, U32 u32, I64 i64, U64 u64, F32 f32, F64 f64)
    };
    (@ $scalar:expr, $big:expr, $n:ident, $number:ident, $body:expr; $($name:ident $t:ty),*) => {
        match ($scalar, $big) {
            $((Scalar::$name, false) => {
                const $n: usize = size_of::<$t>();
                let $number = |bytes: &[u8; $n]| <$t>::from_le_bytes(*bytes) as f64;
                $body
            })*
            $((Scalar::$name, true) => {
                const $n: usize = size_of::<$t>();
                let $number = |bytes: &[u8; $n]| <$t>::from_be_bytes(*bytes) as f64;
                $body
            })*
        }
    };
}

impl Scalar {
    /// Number of bytes.
    pub fn n_bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// The name that numpy has for it.
    pub fn name(self) -> &'static str {
        match self {
            Self::I8 => "int8",
            Self::U8 => "uint8",
            Self::I16 => "int16",
            Self::U16 => "uint16",
            Self::I32 => "int32",
            Self::U32 => "uint32",
            Self::I64 => "int64",
            Self::U64 => "uint64",
            Self::F32 => "float32",
            Self::F64 => "float64",
        }
    }

    /// The number at the start of `bytes`; none if they are too few.
    pub(crate) fn first(self, bytes: &[u8], big: bool) -> Option<f64> {
        with_type!(self, big, N, number => bytes.first_chunk::<N>().map(number))
    }
}

impl Rows<'_> {
    /// The numbers at `offset` of each row.
    ///
    /// # Panics
    /// If they are not within a row.
    pub(crate) fn column(&self, scalar: Scalar, offset: usize) -> Vec<f64> {
        let rows = self.bytes.chunks_exact(self.stride);
        with_type!(scalar, self.big, N, number => {
            rows.map(|row| number(row[offset..offset + N].first_chunk().expect("N bytes"))).collect()
        })
    }

    /// Three numbers of each row, all of one type.
    ///
    /// # Panics
    /// If they are not within a row.
    pub(crate) fn triples<T: From<[f64; 3]>>(&self, scalar: Scalar, offsets: [usize; 3]) -> Vec<T> {
        let rows = self.bytes.chunks_exact(self.stride);
        let [a, b, c] = offsets;
        with_type!(scalar, self.big, N, number => {
            if b == a + N && c == b + N {
                // One check of the bounds instead of three.
                rows.map(|row| {
                    let row = &row[a..a + 3 * N];
                    T::from([0, 1, 2].map(|k| number(row[k * N..(k + 1) * N].first_chunk().expect("N bytes"))))
                })
                .collect()
            } else {
                rows.map(|row| T::from(offsets.map(|at| number(row[at..at + N].first_chunk().expect("N bytes")))))
                    .collect()
            }
        })
    }
}

/// A number as programs print it, also `-nan(ind)` and `1.#QNAN`; none if it is no number.
pub(crate) fn number(word: &str) -> Option<f64> {
    word.parse().ok().or_else(|| {
        let bare = word.trim_start_matches(['-', '+']).to_ascii_lowercase();
        let is_nan =
            matches!(&*bare, "nan(ind)" | "nan(snan)") || bare.starts_with("1.#qnan") || bare.starts_with("1.#ind");
        (is_nan || bare.starts_with("1.#inf")).then_some(f64::NAN)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_every_type_and_order_are_read_at_their_offset() {
        let mut bytes = vec![9];
        bytes.extend((-2_i16).to_be_bytes());
        bytes.extend(1.5_f32.to_be_bytes());
        bytes.extend(u64::MAX.to_be_bytes());
        let rows = Rows { bytes: &bytes.repeat(2), stride: bytes.len(), big: true };
        assert_eq!(rows.column(Scalar::U8, 0), [9.0; 2]);
        assert_eq!(rows.column(Scalar::I16, 1), [-2.0; 2]);
        assert_eq!(rows.column(Scalar::F32, 3), [1.5; 2]);
        assert_eq!(rows.column(Scalar::U64, 7), [u64::MAX as f64; 2]);
        let bytes: Vec<u8> = [1.0_f32, 2.0, 3.0, 4.0].iter().flat_map(|c| c.to_le_bytes()).collect();
        let rows = Rows { bytes: &bytes, stride: 16, big: false };
        assert_eq!(rows.triples::<[f64; 3]>(Scalar::F32, [4, 8, 12]), [[2.0, 3.0, 4.0]]);
        assert_eq!(rows.triples::<[f64; 3]>(Scalar::F32, [12, 0, 4]), [[4.0, 1.0, 2.0]]);
    }

    #[test]
    fn not_a_number_is_read_in_the_spellings_of_several_compilers() {
        for word in ["nan", "NaN", "-nan", "-nan(ind)", "1.#QNAN", "-1.#IND00", "1.#INF"] {
            assert!(number(word).unwrap().is_nan(), "{word}");
        }
        assert_eq!((number("+.5"), number("1."), number("-2e3")), (Some(0.5), Some(1.0), Some(-2000.0)));
        assert_eq!((number("1,5"), number("x"), number("")), (None, None, None));
    }
}
