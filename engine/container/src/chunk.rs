use crate::{Cause, MAX_RECORD_BYTES, record::ChunkHeader};
use crc32fast::Hasher;
use std::io::Read;

/// Memory that is reserved for the claimed size of a compressed chunk; the rest grows with the bytes that come out.
const MAX_RESERVED_BYTES: u64 = 4 << 20;

/// Refuses a chunk whose header claims impossible sizes.
pub(crate) fn check_sizes(header: &ChunkHeader) -> Result<(), Cause> {
    let sizes = [("the packed chunk", header.n_packed), ("the unpacked chunk", header.n_unpacked)];
    match sizes.into_iter().find(|(_, length)| *length > MAX_RECORD_BYTES) {
        Some((what, length)) => Err(Cause::Length { what, length, limit: MAX_RECORD_BYTES }),
        None => Ok(()),
    }
}

/// Unpacks a compressed chunk into `out`; the claimed size bounds the bytes that are taken, and reserves few of them.
pub(crate) fn unpack(header: &ChunkHeader, packed: &[u8], out: &mut Vec<u8>) -> Result<(), Cause> {
    out.clear();
    out.reserve_exact(header.n_unpacked.min(MAX_RESERVED_BYTES) as usize);
    // One more byte than claimed shows that there are more.
    let limit = header.n_unpacked + 1;
    let unpacked = match header.compression.as_str() {
        "zstd" => zstd::stream::read::Decoder::with_buffer(packed).and_then(|d| d.take(limit).read_to_end(out)),
        "lz4" => lz4::Decoder::new(packed).and_then(|d| d.take(limit).read_to_end(out)),
        _ => return Err(cannot(header, "its name is not known; none, lz4 and zstd are".into())),
    };
    unpacked.map(drop).map_err(|error| cannot(header, error.to_string()))
}

/// Compares the size of the unpacked records with the header.
pub(crate) fn check_unpacked(header: &ChunkHeader, records: &[u8]) -> Result<(), Cause> {
    let amount = match (records.len() as u64).cmp(&header.n_unpacked) {
        std::cmp::Ordering::Equal => return Ok(()),
        std::cmp::Ordering::Greater => "more",
        std::cmp::Ordering::Less => "fewer",
    };
    Err(cannot(header, format!("it holds {amount} than the {} bytes it claims", header.n_unpacked)))
}

/// Computes the CRC of the unpacked records and compares it with the header.
pub(crate) fn check_crc(header: &ChunkHeader, records: &[u8]) -> Result<Hasher, Cause> {
    let mut crc = Hasher::new();
    crc.update(records);
    crate::record::check_crc("the unpacked chunk", header.crc, crc.clone().finalize())?;
    Ok(crc)
}

fn cannot(header: &ChunkHeader, reason: String) -> Cause {
    Cause::Compression { name: header.compression.clone(), reason }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sizes_of_a_chunk_end_at_the_longest_record() {
        let check = |n_packed: u64, n_unpacked: u64| {
            let (compression, n_head, n_record) = (String::new(), 49, 49 + n_packed);
            let header =
                ChunkHeader { start_time: 0, end_time: 0, n_unpacked, crc: 0, compression, n_packed, n_head, n_record };
            check_sizes(&header).map_err(|cause| cause.to_string())
        };
        let (most, more) = (MAX_RECORD_BYTES, MAX_RECORD_BYTES + 1);
        assert_eq!(check(most, most), Ok(()));
        let too_long = |what: &str| Err(format!("{what} claims {more} bytes, but at most {most} are possible"));
        assert_eq!(check(more, most), too_long("the packed chunk"));
        assert_eq!(check(most, more), too_long("the unpacked chunk"));
    }
}
