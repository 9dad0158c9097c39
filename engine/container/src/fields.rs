use std::collections::BTreeMap;

/// The little-endian fields of a record, each checked to be there before it is taken.
///
/// What the `mcap` crate offers for this makes room for a text before it looks how many bytes there are.
pub(super) struct Fields<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Fields<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    pub(super) fn at(&self) -> usize {
        self.at
    }

    #[inline]
    pub(super) fn take(&mut self, n: u64) -> Result<&'a [u8], String> {
        let left = self.bytes.len() - self.at;
        if n > left as u64 {
            return Err(format!("a field of {n} bytes at its byte {} goes beyond its end, {left} are left", self.at));
        }
        let field = &self.bytes[self.at..self.at + n as usize];
        self.at += n as usize;
        Ok(field)
    }

    #[inline]
    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        Ok(self.take(N as u64)?.try_into().expect("as many bytes were taken"))
    }

    pub(super) fn u16(&mut self) -> Result<u16, String> {
        self.array().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Result<u32, String> {
        self.array().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Result<u64, String> {
        self.array().map(u64::from_le_bytes)
    }

    pub(super) fn text(&mut self) -> Result<&'a str, String> {
        let n = self.u32()?;
        std::str::from_utf8(self.take(n.into())?).map_err(|_| "a text is not UTF-8".into())
    }

    /// A run of entries, led by their length in bytes.
    pub(super) fn entries(&mut self) -> Result<&'a [u8], String> {
        let n = self.u32()?;
        self.take(n.into())
    }

    pub(super) fn map(&mut self) -> Result<BTreeMap<String, String>, String> {
        let mut entries = Fields::new(self.entries()?);
        let mut map = BTreeMap::new();
        while entries.at < entries.bytes.len() {
            let key = entries.text()?.to_owned();
            if map.insert(key, entries.text()?.to_owned()).is_some() {
                return Err("a key stands twice in a map".into());
            }
        }
        Ok(map)
    }

    pub(super) fn rest(self) -> &'a [u8] {
        &self.bytes[self.at..]
    }

    /// That nothing follows.
    pub(super) fn end(self) -> Result<(), String> {
        match self.bytes.len() - self.at {
            0 => Ok(()),
            left => Err(format!("{left} bytes follow its last field")),
        }
    }
}
