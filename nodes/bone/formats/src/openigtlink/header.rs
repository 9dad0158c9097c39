//! The header, and which bytes may be one.

use super::bytes::{Reader, name_of};
use osteoflow_geometry::StampNs;

/// Longest body that is decoded or encoded: a POLYDATA of five million points.
pub const MAX_BODY_BYTES: usize = 64 << 20;

/// Size of a header.
pub const HEADER_BYTES: usize = 58;

/// Longest metadata of a message whose content has a fixed size.
const MAX_METADATA_BYTES: usize = 1 << 20;

/// The least size of an extended header.
pub(super) const EXTENDED_BYTES: usize = 12;

/// A header that can be the one of a message.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Header {
    pub(super) version: u16,
    pub(super) type_name: String,
    pub(super) device: String,
    pub(super) stamp_ns: StampNs,
    pub(super) n_body: usize,
    pub(super) crc: u64,
}

impl Header {
    /// The type and the device.
    pub(super) fn name(&self) -> String {
        format!("{} of \"{}\"", self.type_name, self.device)
    }

    /// The header in the first [`HEADER_BYTES`] of `bytes`.
    ///
    /// Everything is checked that a header shows by itself, so that random bytes are hardly ever one: it has no checksum.
    pub(super) fn parse(bytes: &[u8; HEADER_BYTES]) -> Result<Self, String> {
        let version = u16::from_be_bytes([bytes[0], bytes[1]]);
        if !(1..=3).contains(&version) {
            return Err(format!("the header version is {version}, and 1 to 3 are known"));
        }
        let type_name = name_of(&bytes[2..14]);
        let is_padded = bytes[2 + type_name.len().min(12)..14].iter().all(|&b| b == 0);
        let is_type = |c: char| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_';
        if type_name.is_empty() || !is_padded || !type_name.chars().all(is_type) {
            return Err("the type of the message is no name".into());
        }
        let device = name_of(&bytes[14..34]);
        if device.chars().any(|c| c.is_control() || c == char::REPLACEMENT_CHARACTER) {
            return Err(format!("the device of the {type_name} is no name"));
        }
        let word = |at: usize| {
            let mut word = [0; 8];
            word.copy_from_slice(&bytes[at..at + 8]);
            u64::from_be_bytes(word)
        };
        let (stamp_ns, n_body, crc) = (nanoseconds(word(34)), word(42), word(50));
        match usize::try_from(n_body) {
            Ok(n) if can_have(&type_name, version, n) => {
                Ok(Self { version, type_name, device, stamp_ns, n_body: n, crc })
            }
            _ => Err(format!("{type_name} of \"{device}\" has a body of {n_body} bytes, which it cannot have")),
        }
    }
}

/// Whether a message of this type can have a body of `n` bytes.
fn can_have(type_name: &str, version: u16, n: usize) -> bool {
    let is_content = |n: usize| match type_name {
        "TRANSFORM" => n == 48,
        "TDATA" => n.is_multiple_of(70),
        "POSITION" => matches!(n, 12 | 24 | 28) || n.is_multiple_of(152),
        "POINT" => n.is_multiple_of(136),
        "IMAGE" => n >= 72,
        "STATUS" => (30..=30 + (1 << 16)).contains(&n),
        "STRING" => (4..=4 + (1 << 16)).contains(&n),
        _ => true,
    };
    if n > MAX_BODY_BYTES {
        return false;
    }
    match (version, type_name) {
        (1, _) => is_content(n),
        (_, "TRANSFORM" | "POSITION" | "STATUS" | "STRING") => {
            (EXTENDED_BYTES..=MAX_METADATA_BYTES + (1 << 17)).contains(&n)
        }
        _ => n >= EXTENDED_BYTES,
    }
}

/// Nanoseconds of a timestamp: seconds in the upper 32 bits, fractions of 2⁻³² s in the lower.
fn nanoseconds(timestamp: u64) -> StampNs {
    let (seconds, fraction) = ((timestamp >> 32) as i64, timestamp & 0xffff_ffff);
    seconds * 1_000_000_000 + ((fraction * 1_000_000_000 + (1 << 31)) >> 32) as i64
}

/// The timestamp nearest to `stamp_ns`; `None` outside of its range.
pub(super) fn timestamp(stamp_ns: StampNs) -> Option<u64> {
    let ns = u64::try_from(stamp_ns).ok()?;
    let (seconds, ns) = (ns / 1_000_000_000, ns % 1_000_000_000);
    let fraction = ((ns << 32) + 500_000_000) / 1_000_000_000;
    u32::try_from(seconds).ok().map(|seconds| u64::from(seconds) << 32 | fraction)
}

/// Where the first header after the beginning of `bytes` may be, if one is there as a whole.
///
/// Only types that are decoded, with a body: among zeros, any two letters are a message whose empty body has the CRC 0.
pub(super) fn find(bytes: &[u8]) -> Option<usize> {
    const TYPES: [&str; 8] = ["TRANSFORM", "TDATA", "POSITION", "POINT", "POLYDATA", "IMAGE", "STATUS", "STRING"];
    bytes.windows(HEADER_BYTES).enumerate().skip(1).find_map(|(at, window)| {
        // Nearly all bytes fail here.
        let may_be = window[0] == 0 && (1..=3).contains(&window[1]) && window[2].is_ascii_uppercase();
        let header = may_be.then(|| Header::parse(&Reader::new(window).array().ok()?).ok()).flatten()?;
        (header.n_body > 0 && TYPES.contains(&&*header.type_name)).then_some(at)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_type_has_the_bodies_that_its_content_allows() {
        for (type_name, sizes, others) in [
            ("TRANSFORM", vec![48], vec![0, 47, 49, 96]),
            ("TDATA", vec![0, 70, 140], vec![69, 71]),
            ("POSITION", vec![12, 24, 28, 152, 304], vec![11, 13, 25, 29, 151]),
            ("POINT", vec![136, 272], vec![135]),
            ("STATUS", vec![30, 30 + (1 << 16)], vec![29, 31 + (1 << 16)]),
            ("STRING", vec![4, 4 + (1 << 16)], vec![3, 5 + (1 << 16)]),
            ("IMAGE", vec![72, 79, MAX_BODY_BYTES], vec![0, 71, MAX_BODY_BYTES + 1]),
            ("SENSOR", vec![0, 7, MAX_BODY_BYTES], vec![MAX_BODY_BYTES + 1]),
        ] {
            assert!(sizes.iter().all(|&n| can_have(type_name, 1, n)), "{type_name}: {sizes:?}");
            assert!(!others.iter().any(|&n| can_have(type_name, 1, n)), "{type_name}: {others:?}");
        }
        // With an extended header of 12 bytes or more, and up to 1 MiB of metadata where the content has a fixed size.
        let most = (1 << 20) + (1 << 17);
        for version in [2, 3] {
            for type_name in ["TRANSFORM", "POSITION", "STATUS", "STRING"] {
                let answers = [11, 12, most, most + 1].map(|n| can_have(type_name, version, n));
                assert_eq!(answers, [false, true, true, false], "{type_name}");
            }
            assert_eq!([11, 12, 13, most + 1].map(|n| can_have("TDATA", version, n)), [false, true, true, true]);
            assert!(!can_have("IMAGE", version, MAX_BODY_BYTES + 1));
        }
    }

    #[test]
    fn fractions_of_a_second_are_rounded_to_the_nearest_nanosecond() {
        for (timestamp_of, ns) in
            [(0, 0), (1 << 32, 1_000_000_000), (1 << 31, 500_000_000), (2, 0), (3, 1), (7 << 32 | 4, 7_000_000_001)]
        {
            assert_eq!(nanoseconds(timestamp_of), ns, "{timestamp_of}");
        }
        assert_eq!((timestamp(500_000_000), timestamp(1)), (Some(1 << 31), Some(4)));
        assert_eq!((timestamp(2_000_000_000), timestamp(-1)), (Some(2 << 32), None));
    }
}
