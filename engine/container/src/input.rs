use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};

/// Buffered reads at offsets of a file; `Read` and `Seek` alone would ask the system for the position at each step.
pub(crate) struct Input<R> {
    reader: BufReader<R>,
    at: u64,
    n_bytes: u64,
}

impl<R: Read + Seek> Input<R> {
    pub(crate) fn new(reader: R, n_bytes: u64) -> Self {
        Self { reader: BufReader::with_capacity(1 << 16, reader), at: 0, n_bytes }
    }

    /// Length of the file.
    pub(crate) fn n_bytes(&self) -> u64 {
        self.n_bytes
    }

    fn seek(&mut self, to: u64) -> io::Result<()> {
        match i64::try_from(i128::from(to) - i128::from(self.at)) {
            Ok(0) => {}
            // Keeps the buffer where it can.
            Ok(by) => self.reader.seek_relative(by)?,
            Err(_) => drop(self.reader.seek(SeekFrom::Start(to))?),
        }
        self.at = to;
        Ok(())
    }

    /// Replaces `out` by `n` bytes at offset `at`. The bytes are within the file, so the memory is bounded by it.
    pub(crate) fn read_into(&mut self, at: u64, n: u64, out: &mut Vec<u8>) -> io::Result<()> {
        self.seek(at)?;
        out.clear();
        out.reserve_exact(usize::try_from(n.min(self.n_bytes)).unwrap_or(usize::MAX));
        let result = self.reader.by_ref().take(n).read_to_end(out);
        self.at += out.len() as u64;
        if result? as u64 == n { Ok(()) } else { Err(io::ErrorKind::UnexpectedEof.into()) }
    }

    /// Reads `n` bytes at offset `at`.
    pub(crate) fn read(&mut self, at: u64, n: u64) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.read_into(at, n, &mut bytes)?;
        Ok(bytes)
    }

    /// Reads `N` bytes at offset `at`.
    pub(crate) fn array<const N: usize>(&mut self, at: u64) -> io::Result<[u8; N]> {
        self.seek(at)?;
        let mut bytes = [0; N];
        self.reader.read_exact(&mut bytes)?;
        self.at += N as u64;
        Ok(bytes)
    }

    /// Opcode and length of the record at offset `at`.
    pub(crate) fn head(&mut self, at: u64) -> io::Result<(u8, u64)> {
        let head: [u8; 9] = self.array(at)?;
        Ok((head[0], u64::from_le_bytes(head[1..].try_into().expect("eight bytes follow the opcode"))))
    }

    /// Adds the bytes from `start` to `end` to a CRC.
    pub(crate) fn hash(&mut self, start: u64, end: u64, crc: &mut crc32fast::Hasher) -> io::Result<()> {
        self.seek(start)?;
        while self.at < end {
            let buffer = self.reader.fill_buf()?;
            if buffer.is_empty() {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
            let n = buffer.len().min(usize::try_from(end - self.at).unwrap_or(usize::MAX));
            crc.update(&buffer[..n]);
            self.reader.consume(n);
            self.at += n as u64;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
