//! The extended header and the metadata of header version 2.

use super::{
    bytes::{EncodeError, Reader},
    header::EXTENDED_BYTES,
};

/// MIBenum of US-ASCII.
pub(super) const ASCII: u16 = 3;
/// MIBenum of UTF-8.
pub(super) const UTF_8: u16 = 106;

/// What header version 2 adds to a message.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Extended {
    /// A number that the sender chose.
    pub message_id: u32,
    /// Keys and values, in their order.
    pub metadata: Vec<Metadata>,
}

/// An entry of the metadata.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Metadata {
    /// The key.
    pub key: String,
    /// The value.
    pub value: String,
}

impl Metadata {
    /// An entry.
    pub fn new(key: impl Into<String>, value: impl Into<String>) -> Self {
        Self { key: key.into(), value: value.into() }
    }
}

/// The character set of a text that this crate writes.
pub(super) fn encoding_of(text: &str) -> u16 {
    if text.is_ascii() { ASCII } else { UTF_8 }
}

impl Extended {
    /// Reads a body of header version 2; gives its content too.
    pub(super) fn parse(body: &[u8]) -> Result<(Self, &[u8]), String> {
        let mut reader = Reader::new(body);
        let n_extended = usize::from(reader.u16()?);
        let (n_index, n_metadata) = (usize::from(reader.u16()?), reader.u32()? as usize);
        let message_id = reader.u32()?;
        // The lengths are at most 16, 16 and 32 bits, so the sum does not overflow 64.
        let around = n_extended as u64 + n_index as u64 + n_metadata as u64;
        if n_extended < EXTENDED_BYTES || around > body.len() as u64 {
            return Err(format!(
                "extended header, index and metadata have {n_extended}, {n_index} and {n_metadata} bytes, and the body {}",
                body.len()
            ));
        }
        let (content, rest) = body[n_extended..].split_at(body.len() - around as usize);
        let (index, texts) = rest.split_at(n_index);
        Ok((Self { message_id, metadata: entries(index, texts)? }, content))
    }

    /// Writes a body of header version 2.
    pub(super) fn put(
        &self,
        out: &mut Vec<u8>,
        content: impl FnOnce(&mut Vec<u8>) -> Result<(), EncodeError>,
    ) -> Result<(), EncodeError> {
        let (mut index, mut texts) = (Vec::new(), Vec::<u8>::new());
        let n = u16::try_from(self.metadata.len())
            .ok()
            .filter(|n| *n < u16::MAX / 8)
            .ok_or_else(|| EncodeError(format!("{} entries of metadata, and 8190 fit", self.metadata.len())))?;
        index.extend(n.to_be_bytes());
        for Metadata { key, value } in &self.metadata {
            let n_key = u16::try_from(key.len()).map_err(|_| EncodeError::too_long("a key", key, 65_535))?;
            let n_value = u32::try_from(value.len())
                .map_err(|_| EncodeError::too_long("the value of", key, u32::MAX as usize))?;
            index.extend(n_key.to_be_bytes());
            index.extend(encoding_of(value).to_be_bytes());
            index.extend(n_value.to_be_bytes());
            texts.extend(key.as_bytes());
            texts.extend(value.as_bytes());
        }
        out.extend((EXTENDED_BYTES as u16).to_be_bytes());
        out.extend((index.len() as u16).to_be_bytes());
        out.extend((texts.len() as u32).to_be_bytes());
        out.extend(self.message_id.to_be_bytes());
        content(out)?;
        out.extend(index);
        out.extend(texts);
        Ok(())
    }
}

fn entries(index: &[u8], texts: &[u8]) -> Result<Vec<Metadata>, String> {
    if index.is_empty() {
        return if texts.is_empty() { Ok(Vec::new()) } else { Err("metadata without an index".into()) };
    }
    let (mut index, mut texts) = (Reader::new(index), Reader::new(texts));
    let n = usize::from(index.u16()?);
    if index.left() != 8 * n {
        return Err(format!("the index of {n} entries of metadata has {} bytes", index.left()));
    }
    let mut entries = Vec::with_capacity(n);
    for _ in 0..n {
        let (n_key, _encoding, n_value) = (index.u16()?, index.u16()?, index.u32()?);
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        let key = text(texts.take(usize::from(n_key))?);
        entries.push(Metadata { key, value: text(texts.take(n_value as usize)?) });
    }
    match texts.left() {
        0 => Ok(entries),
        left => Err(format!("{left} bytes of metadata belong to no entry")),
    }
}
