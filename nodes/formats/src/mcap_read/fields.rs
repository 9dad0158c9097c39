use std::collections::BTreeMap;

/// The little-endian fields of a record, each checked to be there.
pub(super) struct Fields<'a> {
    bytes: &'a [u8],
    /// How many bytes have been taken.
    pub(super) at: usize,
}

impl<'a> Fields<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    pub(super) fn take(&mut self, n: u64) -> Result<&'a [u8], String> {
        let left = self.bytes.len() - self.at;
        if n > left as u64 {
            return Err(format!("a field of {n} bytes at its byte {} goes beyond its end, {left} are left", self.at));
        }
        let field = &self.bytes[self.at..self.at + n as usize];
        self.at += n as usize;
        Ok(field)
    }

    pub(super) fn u16(&mut self) -> Result<u16, String> {
        Ok(u16::from_le_bytes(self.take(2)?.try_into().expect("two bytes were taken")))
    }

    pub(super) fn u32(&mut self) -> Result<u32, String> {
        Ok(u32::from_le_bytes(self.take(4)?.try_into().expect("four bytes were taken")))
    }

    pub(super) fn u64(&mut self) -> Result<u64, String> {
        Ok(u64::from_le_bytes(self.take(8)?.try_into().expect("eight bytes were taken")))
    }

    pub(super) fn text(&mut self) -> Result<String, String> {
        let n = self.u32()?;
        let bytes = self.take(n.into())?;
        String::from_utf8(bytes.to_vec()).map_err(|_| "a text is not UTF-8".into())
    }

    pub(super) fn map(&mut self) -> Result<BTreeMap<String, String>, String> {
        let n = self.u32()?;
        let mut entries = Fields::new(self.take(n.into())?);
        let mut map = BTreeMap::new();
        while entries.at < entries.bytes.len() {
            let key = entries.text()?;
            map.insert(key, entries.text()?);
        }
        Ok(map)
    }
}
