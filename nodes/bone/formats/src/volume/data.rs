//! The voxels behind a header, or in a file beside it: raw, compressed or text.

use super::numbers::{Encoding, StreamError, drain, gzip_limit, read_all};
use crate::{FileError, input};
use flate2::read::{MultiGzDecoder, ZlibDecoder};
use std::{
    fs::File,
    io::{BufRead, BufReader, Read, Seek, SeekFrom},
    path::{Path, PathBuf},
};

/// The data of a volume, from their beginning on.
pub(super) struct Data {
    pub(super) path: PathBuf,
    pub(super) reader: BufReader<File>,
    /// Bytes from there to the end of the file.
    pub(super) n_there: u64,
    /// Number of voxels.
    pub(super) n: usize,
    /// Bytes of the voxels.
    pub(super) n_bytes: u64,
    /// What the header promises, for messages.
    pub(super) promise: String,
    pub(super) encoding: Encoding,
}

impl Data {
    fn fault(&self, place: &str, message: impl Into<String>) -> FileError {
        FileError::content(&self.path, place, message)
    }

    fn too_short(&self, there: &str) -> FileError {
        self.fault("data", format!("cut short: {}, {there}; copy the file again", self.promise))
    }

    fn broken(&self, error: StreamError) -> FileError {
        match error {
            StreamError::Short(n) => {
                self.too_short(&format!("but only {} are there", n * self.encoding.scalar.n_bytes()))
            }
            StreamError::Io(error) => self.fault("compressed data", format!("{error}; copy the file again")),
        }
    }

    pub(super) fn skip_lines(&mut self, n_lines: i64) -> Result<(), FileError> {
        for _ in 0..n_lines {
            if self.reader.skip_until(b'\n').map_err(FileError::read(&self.path))? == 0 {
                let message = format!("the file ends before the {n_lines} lines that \"line skip\" leaves out");
                return Err(self.fault("data", message));
            }
        }
        Ok(())
    }

    /// The voxels of raw data, and the number of bytes behind them; those before them are skipped, -1 for all.
    pub(super) fn raw(mut self, n_skipped: i64) -> Result<(Vec<f32>, u64), FileError> {
        if self.n_bytes > self.n_there {
            return Err(self.too_short(&format!("but only {} are there", self.n_there)));
        }
        let skipped = match u64::try_from(n_skipped) {
            Ok(n) => drain(&mut self.reader, n),
            Err(_) => self.reader.seek(SeekFrom::End(-(self.n_bytes as i64))),
        };
        skipped.map_err(FileError::read(&self.path))?;
        read_all(&mut self.reader, self.n, &self.encoding).map_err(|error| match error {
            StreamError::Io(error) => FileError::read(&self.path)(error),
            short => self.broken(short),
        })
    }

    /// The voxels of data in gzip or zlib, and the number of bytes behind them; those before them, decompressed, are skipped.
    pub(super) fn compressed(mut self, n_skipped: u64) -> Result<(Vec<f32>, u64), FileError> {
        if self.n_bytes > gzip_limit(self.n_there) {
            return Err(self.too_short(&format!("{} compressed bytes cannot hold them", self.n_there)));
        }
        let is_gzip = self.reader.fill_buf().map_err(FileError::read(&self.path))?.starts_with(&[0x1f, 0x8b]);
        let mut decoder: Box<dyn Read + '_> = match is_gzip {
            true => Box::new(MultiGzDecoder::new(&mut self.reader)),
            false => Box::new(ZlibDecoder::new(&mut self.reader)),
        };
        let skipped = drain(&mut decoder, n_skipped).map_err(StreamError::Io);
        let voxels = skipped.and_then(|_| read_all(&mut decoder, self.n, &self.encoding));
        drop(decoder);
        voxels.map_err(|error| self.broken(error))
    }

    /// The voxels of numbers as text, and the number of bytes behind them.
    pub(super) fn text(mut self, n_skipped: u64) -> Result<(Vec<f32>, u64), FileError> {
        let n = self.n;
        // Each number but the last takes two bytes.
        if (n as u64).saturating_mul(2) > self.n_there.saturating_add(1) {
            return Err(self.too_short(&format!("{} bytes of text cannot hold {n} numbers", self.n_there)));
        }
        drain(&mut self.reader, n_skipped).map_err(FileError::read(&self.path))?;
        let (mut voxels, mut line, mut n_line) = (Vec::new(), Vec::new(), 0);
        while voxels.len() < n {
            line.clear();
            n_line += 1;
            let n_read = self.reader.read_until(b'\n', &mut line).map_err(FileError::read(&self.path))?;
            let fault = |message: String| self.fault(&format!("line {n_line} of the data"), message);
            if n_read == 0 {
                return Err(fault(format!("cut short: {} of {n} numbers; copy the file again", voxels.len())));
            }
            for word in line.split(|b| b.is_ascii_whitespace() || *b == b',').filter(|word| !word.is_empty()) {
                let number = std::str::from_utf8(word).ok().and_then(|word| word.parse::<f32>().ok());
                voxels.push(number.ok_or_else(|| fault(format!("\"{}\" is no number", shown(word))))?);
            }
            if voxels.len() > n {
                return Err(fault(format!("{} numbers, but the sizes promise {n}", voxels.len())));
            }
        }
        let n_extra = drain(&mut self.reader, 1 << 20).map_err(FileError::read(&self.path))?;
        Ok((voxels, n_extra))
    }
}

/// The file of this name beside a header, where it really is.
///
/// # Errors
/// It cannot be found, or a message for the field that names it.
pub(super) fn beside(header: &Path, name: &str) -> Result<Result<PathBuf, &'static str>, FileError> {
    if name.is_empty() || name == "." || name == ".." || name.contains(['/', '\\', ':', '\0']) {
        return Ok(Err("the data must be in a file beside the header: a name without a folder"));
    }
    let folder = folder_of(header);
    let beside = folder.join(name);
    let real = std::fs::canonicalize(&beside).map_err(FileError::read(&beside))?;
    let real_folder = std::fs::canonicalize(folder).map_err(FileError::read(folder))?;
    if real.parent() != Some(&real_folder) {
        return Ok(Err("the data file is a link out of the header's folder; copy the data beside the header"));
    }
    input::check(&real)?;
    Ok(Ok(real))
}

/// The folder of a file.
pub(super) fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The beginning of a word that is no number.
pub(super) fn shown(word: &[u8]) -> String {
    String::from_utf8_lossy(&word[..word.len().min(20)]).escape_default().to_string()
}
