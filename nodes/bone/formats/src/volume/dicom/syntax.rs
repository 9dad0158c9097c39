//! Transfer syntaxes: how a data set is written, and how its pixels are compressed.

use crate::foreign_recording::quoted;
use std::path::Path;

/// How the elements of a data set are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Syntax {
    pub(super) is_explicit: bool,
    pub(super) is_big: bool,
}

/// How the pixels are compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Compression {
    None,
    /// The whole data set is.
    Deflated,
    /// No compression, but in fragments.
    Encapsulated,
    /// Each frame is.
    DeflatedFrames,
    RunLength,
    JpegLossless,
    /// `is_lossy`: the values may not be those of the scanner.
    Jpeg2000 {
        is_lossy: bool,
    },
    /// Its name, and what to do.
    Refused(&'static str, Remedy),
}

/// How pixels that are not read become such that are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Remedy {
    /// A program of dcmtk for each file.
    Dcmtk(&'static str),
    /// pydicom with a decoder, by the names of their Python packages, for each file.
    Pydicom(&'static str),
    /// The archive exports it in another way.
    Export,
}

/// The Python packages by which pydicom decodes JPEG 2000 and its high-throughput form.
const OPENJPEG: &str = " pylibjpeg pylibjpeg-openjpeg";

const EXPLICIT: Syntax = Syntax { is_explicit: true, is_big: false };

/// The transfer syntax of a unique identifier; none if it is unknown, so that not even the elements can be read.
pub(super) fn transfer_syntax(uid: &str) -> Option<(Syntax, Compression)> {
    use Compression::{
        Deflated, DeflatedFrames, Encapsulated, Jpeg2000, JpegLossless, None as Plain, Refused, RunLength,
    };
    use Remedy::{Dcmtk, Export, Pydicom};
    let pixels = match uid.strip_prefix("1.2.840.10008.1.2")? {
        "" => return Some((Syntax { is_explicit: false, is_big: false }, Plain)),
        ".1" => Plain,
        ".1.98" => Encapsulated,
        ".1.99" => Deflated,
        ".2" => return Some((Syntax { is_explicit: true, is_big: true }, Plain)),
        ".5" => RunLength,
        ".4.57" | ".4.70" => JpegLossless,
        ".4.90" => Jpeg2000 { is_lossy: false },
        ".4.91" => Jpeg2000 { is_lossy: true },
        ".4.50" => Refused("JPEG, lossy, of 8 bits (baseline)", Dcmtk("dcmdjpeg")),
        ".4.51" => Refused("JPEG, lossy, of 8 or 12 bits (extended)", Dcmtk("dcmdjpeg")),
        ".4.53" => Refused("JPEG, lossy, of spectral selection", Dcmtk("dcmdjpeg")),
        ".4.55" => Refused("JPEG, lossy, of full progression", Dcmtk("dcmdjpeg")),
        ".4.52" | ".4.54" | ".4.56" | ".4.58" => Refused("JPEG in arithmetic coding (retired)", Export),
        ".4.59" | ".4.60" | ".4.61" | ".4.62" | ".4.63" | ".4.64" | ".4.65" | ".4.66" => {
            Refused("hierarchical JPEG (retired)", Export)
        }
        ".4.80" => Refused("JPEG-LS lossless", Dcmtk("dcmdjpls")),
        ".4.81" => Refused("JPEG-LS near-lossless", Dcmtk("dcmdjpls")),
        ".4.92" | ".4.93" => Refused("JPEG 2000 of several components (part 2)", Export),
        ".4.94" | ".4.204" => Refused("a reference to another server (JPIP)", Export),
        ".4.110" => Refused("JPEG XL lossless", Export),
        ".4.111" => Refused("JPEG XL of a JPEG", Export),
        ".4.112" => Refused("JPEG XL", Export),
        ".4.201" => Refused("high-throughput JPEG 2000, lossless", Pydicom(OPENJPEG)),
        ".4.202" => Refused("high-throughput JPEG 2000, lossless, by resolution", Pydicom(OPENJPEG)),
        ".4.203" => Refused("high-throughput JPEG 2000", Pydicom(OPENJPEG)),
        ".8.1" => DeflatedFrames,
        other => {
            let number = other.strip_prefix(".4.").and_then(|rest| rest.split('.').next()?.parse::<u32>().ok());
            match number {
                Some(100..=106) => Refused("MPEG video", Export),
                Some(107 | 108) => Refused("HEVC video", Export),
                Some(95 | 205) => return None,
                _ if other.starts_with(".4.") => Refused("a compression that is not known here", Export),
                _ => return None,
            }
        }
    };
    Some((EXPLICIT, pixels))
}

/// The name of a transfer syntax of which not even the elements are read, with a blank and brackets; empty if it is unknown.
pub(super) fn name_of_unread(uid: &str) -> &'static str {
    match uid {
        "1.2.840.10008.1.2.4.95" | "1.2.840.10008.1.2.4.205" => " (references to another server, JPIP, deflated)",
        "1.2.840.10008.1.2.6.1" => " (MIME, retired)",
        "1.2.840.10008.1.2.6.2" => " (XML, retired)",
        "1.2.840.10008.1.2.7.1" | "1.2.840.10008.1.2.7.2" | "1.2.840.10008.1.2.7.3" => " (a stream of SMPTE ST 2110)",
        "1.2.840.10008.1.20" => " (Papyrus 3, retired)",
        "1.2.840.113619.5.2" => " (private, of GE: implicit, pixels big-endian)",
        _ => "",
    }
}

/// How a data set without a stated syntax is written, by its first element, which is of group 8.
pub(super) fn guessed(start: &[u8]) -> Option<Syntax> {
    let first = start.get(..8)?;
    let is_vr = matches!(&first[4..6], b"AE" | b"CS" | b"DA" | b"LO" | b"SH" | b"TM" | b"UI" | b"UL" | b"SQ" | b"OB");
    let length = u32::from_le_bytes([first[4], first[5], first[6], first[7]]);
    match (&first[..2], first[3]) {
        ([8, 0], 0) if is_vr => Some(EXPLICIT),
        ([8, 0], 0) if length < 1 << 12 && length.is_multiple_of(2) => {
            Some(Syntax { is_explicit: false, is_big: false })
        }
        ([0, 8], _) if is_vr && first[2] == 0 => Some(Syntax { is_explicit: true, is_big: true }),
        _ => None,
    }
}

/// Whether a file without the 128 bytes before the mark begins as a data set or its meta information does.
pub(super) fn is_bare(start: &[u8]) -> bool {
    start.starts_with(&[2, 0]) && start.get(3..6) == Some(b"\0UL") || guessed(start).is_some_and(|_| is_likely(start))
}

/// Whether the first element of group 8 is one that data sets begin with.
fn is_likely(start: &[u8]) -> bool {
    let number = if start[0] == 8 { start[2] } else { start[3] };
    matches!(number, 0 | 1 | 5 | 6 | 8 | 0x12..=0x14 | 0x16 | 0x18 | 0x20)
}

impl Compression {
    /// Why pixels cannot be read, and what to do, for a file in this folder.
    pub(super) fn refusal(self, folder: &Path) -> Option<String> {
        let Self::Refused(name, remedy) = self else { return None };
        Some(remedy.sentence(name, folder))
    }
}

impl Remedy {
    /// That pixels of this kind are not read, and what to do.
    pub(super) fn sentence(self, kind: &str, folder: &Path) -> String {
        match self {
            Self::Dcmtk(program) => format!(
                "pixels in {kind} are not read; convert the whole series with {program} of dcmtk: mkdir RAW; for f in {}/*; do \
                 {program} \"$f\" \"RAW/$(basename \"$f\")\"; done",
                quoted(folder)
            ),
            Self::Pydicom(more) => format!(
                "pixels in {kind} are not read; convert the whole series with pydicom (pip install pydicom numpy{more}): mkdir RAW; python3 -c \
                 'import pathlib, pydicom, pydicom.misc, sys; [(d := pydicom.dcmread(f), d.decompress(), d.save_as(\"RAW/\" + f.name)) \
                 for f in pathlib.Path(sys.argv[1]).iterdir() if f.is_file() and pydicom.misc.is_dicom(f)]' {}",
                quoted(folder)
            ),
            Self::Export => format!("pixels in {kind} are not read; export the series uncompressed"),
        }
    }
}

/// A unique identifier, or what it is instead: the file may be damaged.
pub(super) fn shown_uid(uid: &str) -> &str {
    let is_uid = !uid.is_empty() && uid.len() <= 64 && uid.bytes().all(|b| b.is_ascii_digit() || b == b'.');
    if is_uid { uid } else { "(not a unique identifier)" }
}
