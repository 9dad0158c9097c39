//! Big-endian numbers and texts of fixed size.

/// A message that cannot be written.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct EncodeError(pub(super) String);

impl EncodeError {
    /// A name or text does not fit its field.
    pub(super) fn too_long(what: &str, text: &str, limit: usize) -> Self {
        Self(format!("{what} \"{text}\" has {} bytes, and {limit} fit", text.len()))
    }
}

/// Reads from the front of a slice; every length is checked before anything is allocated.
pub(super) struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    pub(super) fn left(&self) -> usize {
        self.0.len()
    }

    pub(super) fn take(&mut self, n: usize) -> Result<&'a [u8], String> {
        let (taken, rest) = self
            .0
            .split_at_checked(n)
            .ok_or_else(|| format!("{n} bytes are expected where {} are left", self.0.len()))?;
        self.0 = rest;
        Ok(taken)
    }

    pub(super) fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let mut out = [0; N];
        out.copy_from_slice(self.take(N)?);
        Ok(out)
    }

    pub(super) fn u8(&mut self) -> Result<u8, String> {
        Ok(self.array::<1>()?[0])
    }

    pub(super) fn u16(&mut self) -> Result<u16, String> {
        self.array().map(u16::from_be_bytes)
    }

    pub(super) fn u32(&mut self) -> Result<u32, String> {
        self.array().map(u32::from_be_bytes)
    }

    pub(super) fn i64(&mut self) -> Result<i64, String> {
        self.array().map(i64::from_be_bytes)
    }

    pub(super) fn floats<const N: usize>(&mut self) -> Result<[f32; N], String> {
        let bytes = self.take(4 * N)?;
        Ok(std::array::from_fn(|i| {
            f32::from_be_bytes([bytes[4 * i], bytes[4 * i + 1], bytes[4 * i + 2], bytes[4 * i + 3]])
        }))
    }

    /// A text in a field of `n` bytes, up to the first zero.
    pub(super) fn name(&mut self, n: usize) -> Result<String, String> {
        Ok(name_of(self.take(n)?))
    }
}

/// The text of a field, up to the first zero; bytes that are not UTF-8 become U+FFFD.
pub(super) fn name_of(field: &[u8]) -> String {
    let end = field.iter().position(|&b| b == 0).unwrap_or(field.len());
    String::from_utf8_lossy(&field[..end]).into_owned()
}

/// Writes a text into a field of `n` bytes, filled up with zeros.
pub(super) fn put_name(out: &mut Vec<u8>, what: &str, text: &str, n: usize) -> Result<(), EncodeError> {
    if text.len() > n || text.contains('\0') {
        return Err(EncodeError::too_long(what, text, n));
    }
    out.extend(text.as_bytes());
    out.extend(std::iter::repeat_n(0, n - text.len()));
    Ok(())
}

pub(super) fn put_floats(out: &mut Vec<u8>, values: &[f32]) {
    values.iter().for_each(|value| out.extend(value.to_be_bytes()));
}
