//! The elements of a DICOM data set, in order, with those inside sequences passed over.

use super::super::numbers::{MAX_EXPANSION, drain};
use super::syntax::{Compression, Syntax, guessed, name_of_unread, shown_uid, transfer_syntax};
use crate::FileError;
use flate2::read::DeflateDecoder;
use std::{borrow::Cow, io::Read, path::Path};

/// Group and element number.
pub(super) type Tag = u32;

const ITEM: Tag = 0xfffe_e000;
const END_OF_ITEM: Tag = 0xfffe_e00d;
const END_OF_SEQUENCE: Tag = 0xfffe_e0dd;
const UNDEFINED: u32 = u32::MAX;
/// Sequences in sequences deeper than this are no data set.
const MAX_DEPTH: usize = 64;
/// A deflated data set of one image is smaller.
const MAX_INFLATED: u64 = 1 << 29;

/// An element of the data set.
pub(super) struct Element<'a> {
    pub(super) tag: Tag,
    /// The value; of pixel data in fragments, all of them with their headers.
    pub(super) value: &'a [u8],
    /// Whether the value is a sequence of items or fragments.
    pub(super) is_items: bool,
    /// Byte of the data set at which the value begins.
    pub(super) start: usize,
    /// How the elements inside a sequence are written.
    pub(super) syntax: Syntax,
}

/// The data set behind the file's meta information, inflated if need be.
pub(super) struct DataSet<'a> {
    pub(super) bytes: Cow<'a, [u8]>,
    /// Byte of the file at which it begins.
    pub(super) start: usize,
    pub(super) syntax: Syntax,
    /// What becomes of the pixels.
    pub(super) compression: Compression,
}

impl<'a> DataSet<'a> {
    pub(super) fn of_file(path: &Path, file: &'a [u8]) -> Result<Self, FileError> {
        let fault = |place: String, message: String| FileError::content(path, place, message);
        let meta = Syntax { is_explicit: true, is_big: false };
        let start = if file.get(128..132) == Some(b"DICM") { 132 } else { 0 };
        let mut reader = Reader { bytes: file, at: start, syntax: meta, is_unknown: false };
        let mut uid = None;
        while file.get(reader.at..reader.at + 2) == Some(&[2, 0]) {
            let at = reader.at;
            let element = reader.next().map_err(|m| fault(format!("byte {at}"), m))?;
            if let Some(Element { tag: 0x0002_0010, value, .. }) = element {
                uid = Some(text(value));
            }
        }
        let (start, uid) = (reader.at, uid.unwrap_or_default());
        let (syntax, compression) = match transfer_syntax(&uid) {
            // Some writers state the one and write the other.
            Some((stated, Compression::Deflated)) => (stated, Compression::Deflated),
            Some((stated, pixels)) => (guessed(&file[start.min(file.len())..]).unwrap_or(stated), pixels),
            None if uid.is_empty() => {
                let first = &file[start.min(file.len())..];
                let syntax = guessed(first).ok_or_else(|| {
                    let message =
                        "no transfer syntax is stated, and the first element shows none; export the series again";
                    fault(format!("byte {start}"), message.into())
                })?;
                (syntax, Compression::None)
            }
            None => {
                let (uid, name) = (shown_uid(&uid), name_of_unread(&uid));
                let message = format!("transfer syntax {uid}{name} is not read; export the series uncompressed");
                return Err(fault("(0002,0010)".into(), message));
            }
        };
        let bytes = if compression == Compression::Deflated {
            let deflated = &file[start..];
            let limit = (deflated.len() as u64).saturating_mul(MAX_EXPANSION).min(MAX_INFLATED);
            let mut inflated = Vec::new();
            let mut decoder = DeflateDecoder::new(deflated).take(limit);
            decoder.read_to_end(&mut inflated).map_err(|error| {
                fault(format!("byte {start}"), format!("{error} in the deflated data set; copy the file again"))
            })?;
            if drain(&mut decoder.into_inner(), 1).is_ok_and(|n| n > 0) {
                return Err(fault(
                    format!("byte {start}"),
                    format!("the deflated data set is larger than {limit} bytes"),
                ));
            }
            Cow::Owned(inflated)
        } else {
            Cow::Borrowed(&file[start..])
        };
        Ok(Self { bytes, start, syntax, compression })
    }

    pub(super) fn reader(&self) -> Reader<'_> {
        Reader { bytes: &self.bytes, at: 0, syntax: self.syntax, is_unknown: false }
    }
}

/// A reader of elements.
pub(super) struct Reader<'a> {
    bytes: &'a [u8],
    pub(super) at: usize,
    syntax: Syntax,
    /// Whether the last header had the value representation UN, whose items have none.
    is_unknown: bool,
}

impl<'a> Reader<'a> {
    fn take(&mut self, n: usize) -> Result<&'a [u8], String> {
        let left = &self.bytes[self.at.min(self.bytes.len())..];
        let taken = left.get(..n).ok_or_else(|| format!("cut short: {n} bytes are needed, {} are left", left.len()))?;
        self.at += n;
        Ok(taken)
    }

    fn u16(&mut self) -> Result<u16, String> {
        let bytes = [0, 1].map(|k| self.bytes.get(self.at + k).copied().unwrap_or_default());
        self.take(2)?;
        Ok(if self.syntax.is_big { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) })
    }

    fn u32(&mut self) -> Result<u32, String> {
        let (a, b) = (u32::from(self.u16()?), u32::from(self.u16()?));
        Ok(if self.syntax.is_big { a << 16 | b } else { b << 16 | a })
    }

    fn tag(&mut self) -> Result<Tag, String> {
        Ok(Tag::from(self.u16()?) << 16 | Tag::from(self.u16()?))
    }

    /// The tag and length of the next element, and whether it is a sequence.
    fn header(&mut self) -> Result<(Tag, u32, bool), String> {
        let tag = self.tag()?;
        self.is_unknown = false;
        // Items have no value representation.
        if !self.syntax.is_explicit || tag >> 16 == 0xfffe {
            let length = self.u32()?;
            return Ok((tag, length, length == UNDEFINED));
        }
        let vr: [u8; 2] = self.take(2)?.try_into().unwrap_or_default();
        if !vr.iter().all(u8::is_ascii_uppercase) {
            return Err(format!(
                "element ({:04x},{:04x}) has no value representation; is the file damaged?",
                tag >> 16,
                tag & 0xffff
            ));
        }
        let is_long = matches!(
            &vr,
            b"OB" | b"OD" | b"OF" | b"OL" | b"OV" | b"OW" | b"SQ" | b"SV" | b"UC" | b"UN" | b"UR" | b"UT" | b"UV"
        );
        self.is_unknown = &vr == b"UN";
        let length = if is_long {
            self.take(2)?;
            self.u32()?
        } else {
            u32::from(self.u16()?)
        };
        Ok((tag, length, &vr == b"SQ" || length == UNDEFINED))
    }

    /// The next element; `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<Element<'a>>, String> {
        if self.at >= self.bytes.len() {
            return Ok(None);
        }
        let (tag, length, is_items) = self.header()?;
        let start = self.at;
        let syntax = Syntax { is_explicit: self.syntax.is_explicit && !self.is_unknown, ..self.syntax };
        let value = if length == UNDEFINED {
            let is_pixels = tag == 0x7fe0_0010;
            let end = if is_pixels { self.pass_fragments()? } else { self.pass_items(0)? };
            &self.bytes[start..end]
        } else {
            self.take(length as usize)?
        };
        Ok(Some(Element { tag, value, is_items, start, syntax }))
    }

    /// Passes items up to the end of their sequence; returns where its mark begins.
    fn pass_items(&mut self, depth: usize) -> Result<usize, String> {
        let outside = self.syntax;
        self.syntax.is_explicit &= !self.is_unknown;
        let end = self.pass_items_alike(depth);
        self.syntax = outside;
        end
    }

    fn pass_items_alike(&mut self, depth: usize) -> Result<usize, String> {
        if depth > MAX_DEPTH {
            return Err("sequences lie too deep in each other".into());
        }
        loop {
            let end = self.at;
            match self.header()? {
                (END_OF_SEQUENCE, _, _) => return Ok(end),
                (ITEM, UNDEFINED, _) => {
                    self.pass_item(depth)?;
                }
                (ITEM, length, _) => {
                    self.take(length as usize)?;
                }
                _ => return Err("an item was expected in a sequence; is the file damaged?".into()),
            }
        }
    }

    /// Passes the elements of an item of undefined length and the mark of its end; returns where that begins.
    fn pass_item(&mut self, depth: usize) -> Result<usize, String> {
        loop {
            let end = self.at;
            match self.header()? {
                (END_OF_ITEM, _, _) => return Ok(end),
                (_, UNDEFINED, _) => {
                    self.pass_items(depth + 1)?;
                }
                (_, length, _) => {
                    self.take(length as usize)?;
                }
            }
        }
    }

    fn pass_fragments(&mut self) -> Result<usize, String> {
        loop {
            let end = self.at;
            match self.header()? {
                (END_OF_SEQUENCE, _, _) => return Ok(end),
                (ITEM, length, _) if length != UNDEFINED => {
                    self.take(length as usize)?;
                }
                _ => return Err("a fragment was expected in the pixel data; is the file damaged?".into()),
            }
        }
    }
}

/// The items of a sequence, each the bytes of its elements.
pub(super) fn items<'a>(sequence: &Element<'a>) -> Result<Vec<&'a [u8]>, String> {
    let bytes = sequence.value;
    let mut reader = Reader { bytes, at: 0, syntax: sequence.syntax, is_unknown: false };
    let mut items = Vec::new();
    while reader.at < bytes.len() {
        match reader.header()? {
            (ITEM, UNDEFINED, _) => {
                let start = reader.at;
                items.push(&bytes[start..reader.pass_item(0)?]);
            }
            (ITEM, length, _) => items.push(reader.take(length as usize)?),
            (END_OF_SEQUENCE, _, _) => break,
            _ => return Err("an item was expected in a sequence; is the file damaged?".into()),
        }
    }
    Ok(items)
}

/// The elements of an item.
pub(super) fn elements(item: &[u8], syntax: Syntax) -> Reader<'_> {
    Reader { bytes: item, at: 0, syntax, is_unknown: false }
}

/// The fragments of pixel data, the first of which is their table of offsets.
pub(super) fn fragments(value: &[u8]) -> Result<Vec<&[u8]>, String> {
    let syntax = Syntax { is_explicit: false, is_big: false };
    let mut reader = Reader { bytes: value, at: 0, syntax, is_unknown: false };
    let mut fragments = Vec::new();
    while reader.at < value.len() {
        let (_, length, _) = reader.header()?;
        fragments.push(reader.take(length as usize)?);
    }
    Ok(fragments)
}

/// Text without the padding at its end; only of codes, numbers and unique identifiers.
pub(super) fn text(value: &[u8]) -> String {
    let trimmed = String::from_utf8_lossy(value);
    trimmed.trim_matches(|c: char| c == '\0' || c.is_whitespace()).chars().take(200).collect()
}
