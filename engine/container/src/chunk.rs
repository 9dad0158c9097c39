use crate::{
    MAX_RECORD_BYTES,
    record::{ChunkHeader, check_crc},
};
use std::io::{self, BufRead, Read};

/// Why a chunk's records are not to be had.
pub(super) enum Unpacking {
    /// The file could not be read.
    Io(io::Error),
    /// The chunk is damaged.
    Damaged(String),
}

/// Unpacks a chunk into `out`, from a reader that stands at its packed bytes and ends behind them.
///
/// What the chunk claims to hold is not believed: `out` grows with what comes out, up to the claim and the limit.
pub(super) fn unpack(head: &ChunkHeader, packed: impl BufRead, out: &mut Vec<u8>) -> Result<(), Unpacking> {
    let damaged = Unpacking::Damaged;
    out.clear();
    if head.n_unpacked > MAX_RECORD_BYTES || head.n_packed > MAX_RECORD_BYTES {
        let n_bytes = head.n_unpacked.max(head.n_packed);
        return Err(damaged(format!("it claims {n_bytes} bytes; at most {MAX_RECORD_BYTES} are read at once")));
    }
    // One byte more than the claim shows that there is more.
    let limit = head.n_unpacked + 1;
    let read = match head.compression.as_str() {
        "" => packed.take(limit).read_to_end(out),
        "zstd" => zstd::stream::read::Decoder::with_buffer(packed).and_then(|d| d.take(limit).read_to_end(out)),
        "lz4" => lz4::Decoder::new(packed).and_then(|d| d.take(limit).read_to_end(out)),
        other => {
            let known = "none, lz4 and zstd are known";
            return Err(damaged(format!("its compression \"{other}\" is unknown; {known}")));
        }
    };
    if let Err(error) = read {
        // What the disk says has a code of the system; what the unpacker says has none.
        return Err(match error.raw_os_error() {
            Some(_) => Unpacking::Io(error),
            None => damaged(format!("its \"{}\" bytes cannot be unpacked: {error}", head.compression)),
        });
    }
    if out.len() as u64 != head.n_unpacked {
        let less = if (out.len() as u64) < head.n_unpacked { out.len().to_string() } else { "more".into() };
        return Err(damaged(format!("it claims {} unpacked bytes, {less} came", head.n_unpacked)));
    }
    check_crc("the unpacked chunk", head.crc, || crc32fast::hash(out)).map_err(damaged)
}
