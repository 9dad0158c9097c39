//! Encoding of an item in a recording: number, stamp, and its view or the reason why it has none.
//!
//! The layout of the bytes is [`LAYOUT`]. A value names its payload on a wire that takes any; columns are aligned to 8 bytes
//! from the start of the message, so that their rows can be used in place.

use super::format::EXACT_ENCODING;
use osteoflow_container::Segments;
use osteoflow_node::{
    Body, Buffer, Column, ColumnType, Empty, Field, Item, PayloadType, PortPayload, StampNs, View, ViewError,
};
use std::{ops::Range, sync::Arc};

/// Layout of messages, the text of an exact channel's schema.
pub(crate) const LAYOUT: &str = "\
Little-endian. Head, 40 bytes: 'OSTEOVW1'; i64 stamp_ns; u64 number on the wire; u8 body (0 value, 1 empty, 2 value \
that names its payload); 3 zero bytes; u32 n_fields; u32 n_columns; 4 zero bytes.
text = u32 length, UTF-8 bytes.
Empty: text node, text reason.
Value: where body is 2, first text payload, u32 version; then fields, then columns.
Field (n_fields times): u8 type (1 bool, 2 i64, 3 f64, 4 f64 list, 5 text), text name, then u8 | i64 | f64 | u32 count and \
count x f64 | text.
Column (n_columns times): text name; u8 type (1 f64, 2 f32, 3 i64, 4 u32, 5 u8); u32 width (values in a row); u64 n_bytes; \
zero bytes up to a multiple of 8 from the start of the message; n_bytes of rows.
Lengths are millimetres, angles radians, times nanoseconds.
";

/// The text of an exact channel's schema: what the bytes are, as comments, and the one field that holds them.
pub(crate) fn schema_text() -> String {
    let lines = LAYOUT.lines().flat_map(|line| ["# ", line, "\n"]);
    lines.chain(["uint8[] view\n"]).collect()
}

/// The head of a little-endian message in CDR; the number of bytes follows.
const CDR_HEAD: [u8; 4] = [0, 1, 0, 0];

/// An item as a sequence of bytes in CDR, which viewers read without knowing what it holds.
pub(crate) fn framed(item: Segments) -> Segments {
    let n_bytes = item.len() as u32;
    item.behind([CDR_HEAD, n_bytes.to_le_bytes()].concat())
}

/// The item in a sequence of bytes in CDR; the bytes as they are if they are no such sequence, for a reader to refuse.
pub(crate) fn unframed(message: &[u8]) -> &[u8] {
    match message.split_at_checked(8) {
        Some((head, item)) if head[..4] == CDR_HEAD && head[4..] == (item.len() as u32).to_le_bytes() => item,
        _ => message,
    }
}

/// The item in a message of an exact channel with this encoding; `None` if it is none that exact channels have.
pub fn item_bytes<'a>(encoding: &str, message: &'a [u8]) -> Option<&'a [u8]> {
    (encoding == EXACT_ENCODING).then(|| unframed(message))
}

const MAGIC: &[u8; 8] = b"OSTEOVW1";
/// Maximum number of fields and of columns. A larger number is damage, and each would cost more memory than it has
/// bytes.
const MAX_PARTS: u32 = 1 << 16;

const VALUE: u8 = 0;
const EMPTY: u8 = 1;
const NAMED_VALUE: u8 = 2;

/// A message that is not an item.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct CodecError(String);

impl CodecError {
    /// For a message that is too short, or has a length that exceeds its bytes.
    pub(crate) fn short(needed: u64, left: usize) -> Self {
        Self(format!("the message holds {left} more bytes where {needed} are needed; it is damaged"))
    }

    /// For a code or a text that the format does not define.
    fn invalid(what: &str) -> Self {
        Self(format!("the message is damaged: {what}"))
    }
}

/// A recorded item, with its view still untyped.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedItem {
    /// Its number on the wire, from 0.
    pub number: u64,
    /// Its stamp: the time at which its content held.
    pub stamp_ns: StampNs,
    /// The payload's name and the version of its view, on a wire that takes any payload.
    pub payload: Option<(String, u32)>,
    /// The view of its value, or why there is none.
    pub body: Result<View, Empty>,
}

impl RecordedItem {
    /// Converts the view to its payload.
    ///
    /// # Errors
    /// [`ViewError`] if the view is not one of `ty`.
    pub fn into_item(self, ty: &'static PayloadType) -> Result<Item, ViewError> {
        let body = match self.body {
            Ok(view) => Body::Value(ty.from_view(&view)?),
            Err(empty) => Body::Empty(Arc::new(empty)),
        };
        Ok(Item { number: self.number, stamp_ns: self.stamp_ns, body })
    }
}

/// Encodes an item of a wire whose payload is known.
#[cfg(test)]
pub(crate) fn encode(item: &Item) -> Vec<u8> {
    named_parts(item, false).into_vec()
}

/// Encodes an item of a wire of this payload; on a wire that takes any, values name their payload.
pub(crate) fn encode_on(payload: PortPayload, item: &Item) -> Vec<u8> {
    parts_on(payload, item).into_vec()
}

/// Like [`encode_on`], without copying the rows of columns.
pub(crate) fn parts_on(payload: PortPayload, item: &Item) -> Segments {
    named_parts(item, matches!(payload, PortPayload::Any))
}

fn named_parts(item: &Item, names_payload: bool) -> Segments {
    let (kind, view) = match &item.body {
        Body::Value(value) if names_payload => (NAMED_VALUE, Ok((value.ty(), value.to_view()))),
        Body::Value(value) => (VALUE, Ok((value.ty(), value.to_view()))),
        Body::Empty(empty) => (EMPTY, Err(empty)),
    };
    let mut parts = Segments::default();
    let out = parts.tail();
    out.reserve(256);
    out.extend_from_slice(MAGIC);
    out.extend_from_slice(&item.stamp_ns.to_le_bytes());
    out.extend_from_slice(&item.number.to_le_bytes());
    out.extend_from_slice(&[kind, 0, 0, 0]);
    let (n_fields, n_columns) = view.as_ref().map_or((0, 0), |(_, v)| (v.head.len(), v.columns.len()));
    put_count(out, n_fields);
    put_count(out, n_columns);
    put_count(out, 0);
    match view {
        Ok((ty, view)) => {
            if names_payload {
                put_text(out, ty.name);
                out.extend_from_slice(&ty.version.to_le_bytes());
            }
            put_view(&mut parts, &view);
        }
        Err(empty) => {
            put_text(out, &empty.node);
            put_text(out, &empty.reason);
        }
    }
    parts
}

fn put_view(parts: &mut Segments, view: &View) {
    let out = parts.tail();
    for (name, field) in &view.head {
        out.push(match field {
            Field::Bool(_) => 1,
            Field::Int(_) => 2,
            Field::Float(_) => 3,
            Field::Floats(_) => 4,
            Field::Text(_) => 5,
        });
        put_text(out, name);
        match field {
            Field::Bool(value) => out.push(u8::from(*value)),
            Field::Int(value) => out.extend_from_slice(&value.to_le_bytes()),
            Field::Float(value) => out.extend_from_slice(&value.to_le_bytes()),
            Field::Floats(values) => {
                put_count(out, values.len());
                values.iter().for_each(|value| out.extend_from_slice(&value.to_le_bytes()));
            }
            Field::Text(text) => put_text(out, text),
        }
    }
    for column in &view.columns {
        let out = parts.tail();
        put_text(out, &column.name);
        out.push(column.kind as u8);
        out.extend_from_slice(&column.width.to_le_bytes());
        out.extend_from_slice(&(column.bytes().len() as u64).to_le_bytes());
        let n_zeros = parts.len().next_multiple_of(8) - parts.len();
        parts.tail().extend_from_slice(&[0; 8][..n_zeros]);
        put_rows(parts, column);
    }
}

/// Columns are in native byte order in memory and little-endian in the file.
fn put_rows(parts: &mut Segments, column: &Column) {
    if cfg!(target_endian = "big") {
        let mut rows = column.bytes().to_vec();
        swap(&mut rows, column.kind.size());
        parts.push_shared(&(Arc::new(rows) as Buffer));
    } else {
        parts.push_shared(&column.data);
    }
}

fn swap(bytes: &mut [u8], size: usize) {
    bytes.chunks_exact_mut(size).for_each(<[u8]>::reverse);
}

fn put_count(out: &mut Vec<u8>, count: usize) {
    // A header of four billion fields does not fit in memory.
    out.extend_from_slice(&(count as u32).to_le_bytes());
}

fn put_text(out: &mut Vec<u8>, text: &str) {
    put_count(out, text.len());
    out.extend_from_slice(text.as_bytes());
}

/// Decodes an item; its columns share one copy of the bytes.
///
/// # Errors
/// [`CodecError`] if the bytes are damaged. Lengths are checked against the available bytes before memory is allocated.
pub(crate) fn decode(bytes: &[u8]) -> Result<RecordedItem, CodecError> {
    decode_borrowed(bytes, None)
}

/// Decodes an item whose columns are borrowed: `borrow` returns a range of the bytes as a buffer without a copy.
///
/// # Errors
/// See [`decode`].
pub(crate) fn decode_borrowed(bytes: &[u8], borrow: Option<&Borrow<'_>>) -> Result<RecordedItem, CodecError> {
    let mut reader = Reader { bytes, at: 0, borrow };
    if reader.take(8).is_ok_and(|magic| magic != MAGIC) || bytes.len() < 8 {
        let what = "the message does not begin with OSTEOVW1, so it is no recorded item of this format version";
        return Err(CodecError(what.into()));
    }
    let (stamp_ns, number) = (reader.i64()?, reader.i64()? as u64);
    let [kind, ..] = reader.array::<4>()?;
    let (n_fields, n_columns) = (reader.count()?, reader.count()?);
    reader.count()?;
    if n_fields > MAX_PARTS || n_columns > MAX_PARTS {
        return Err(CodecError::invalid("it claims more than 65536 fields or columns"));
    }
    let payload = match kind {
        NAMED_VALUE => Some((reader.text()?.to_owned(), reader.count()?)),
        _ => None,
    };
    let body = match kind {
        VALUE | NAMED_VALUE => Ok(reader.view(n_fields, n_columns)?),
        EMPTY => Err(Empty { node: reader.text()?.into(), reason: reader.text()?.into() }),
        _ => return Err(CodecError::invalid("its body is neither value nor empty")),
    };
    if reader.at != bytes.len() {
        return Err(CodecError::invalid("bytes follow its last part"));
    }
    Ok(RecordedItem { number, stamp_ns, payload, body })
}

/// Fields with which every message begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Head {
    pub(crate) number: u64,
    pub(crate) stamp_ns: StampNs,
    pub(crate) is_empty: bool,
}

/// Decodes only the header of a message; `None` if it is not an item.
pub(crate) fn head(bytes: &[u8]) -> Option<Head> {
    let head = bytes.get(..40)?.strip_prefix(MAGIC)?;
    let word = |at: usize| head[at..at + 8].try_into().expect("eight bytes");
    let (stamp_ns, number) = (i64::from_le_bytes(word(0)), u64::from_le_bytes(word(8)));
    (head[16] <= NAMED_VALUE).then_some(Head { number, stamp_ns, is_empty: head[16] == EMPTY })
}

/// Number of the item in a message; `None` if it is not an item.
pub(crate) fn number(bytes: &[u8]) -> Option<u64> {
    head(bytes).map(|head| head.number)
}

/// Returns a range of a message as a buffer without a copy.
pub(crate) type Borrow<'a> = dyn Fn(Range<usize>) -> Buffer + 'a;

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Used for columns that need no copy.
    borrow: Option<&'a Borrow<'a>>,
}

impl<'a> Reader<'a> {
    fn take(&mut self, n: u64) -> Result<&'a [u8], CodecError> {
        let left = &self.bytes[self.at..];
        let fits = usize::try_from(n).ok().filter(|n| *n <= left.len());
        let n = fits.ok_or_else(|| CodecError::short(n, left.len()))?;
        self.at += n;
        Ok(&left[..n])
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], CodecError> {
        Ok(self.take(N as u64)?.try_into().expect("as many bytes were taken"))
    }

    fn u8(&mut self) -> Result<u8, CodecError> {
        Ok(self.array::<1>()?[0])
    }

    fn count(&mut self) -> Result<u32, CodecError> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    fn i64(&mut self) -> Result<i64, CodecError> {
        Ok(i64::from_le_bytes(self.array()?))
    }

    fn f64(&mut self) -> Result<f64, CodecError> {
        Ok(f64::from_le_bytes(self.array()?))
    }

    fn text(&mut self) -> Result<&'a str, CodecError> {
        let n = self.count()?;
        std::str::from_utf8(self.take(n.into())?).map_err(|_| CodecError::invalid("a text is not UTF-8"))
    }

    fn view(&mut self, n_fields: u32, n_columns: u32) -> Result<View, CodecError> {
        let mut view = View::new();
        for _ in 0..n_fields {
            let kind = self.u8()?;
            let name = self.text()?.to_owned();
            let field = match kind {
                1 => Field::Bool(self.u8()? != 0),
                2 => Field::Int(self.i64()?),
                3 => Field::Float(self.f64()?),
                4 => {
                    let n = self.count()?;
                    let values = self.take(u64::from(n) * 8)?.chunks_exact(8);
                    Field::Floats(values.map(|b| f64::from_le_bytes(b.try_into().expect("eight bytes"))).collect())
                }
                5 => Field::Text(self.text()?.into()),
                _ => return Err(CodecError::invalid("a head field has an unknown type")),
            };
            view.head.push((name.into(), field));
        }
        for _ in 0..n_columns {
            view.columns.push(self.column()?);
        }
        Ok(view)
    }

    fn column(&mut self) -> Result<Column, CodecError> {
        let name = self.text()?.to_owned();
        let kind =
            ColumnType::from_code(self.u8()?).ok_or_else(|| CodecError::invalid("a column has an unknown type"))?;
        let width = self.count()?;
        let n_bytes = self.i64()? as u64;
        self.take((self.at.next_multiple_of(8) - self.at) as u64)?;
        let rows = self.take(n_bytes)?;
        if !(rows.len() as u64).is_multiple_of((kind.size() as u64 * u64::from(width)).max(1)) {
            return Err(CodecError::invalid("a column ends within a row"));
        }
        let data: Buffer = match self.borrow {
            Some(borrow) if cfg!(target_endian = "little") => borrow(self.at - rows.len()..self.at),
            _ => Arc::new(Aligned::new(rows, kind.size())),
        };
        Ok(Column::new(name, kind, width, data))
    }
}

/// Bytes aligned for any column type, so that rows are borrowed and not copied again.
struct Aligned {
    words: Vec<u64>,
    n_bytes: usize,
}

impl Aligned {
    fn new(bytes: &[u8], size: usize) -> Self {
        let mut words = vec![0_u64; bytes.len().div_ceil(8)];
        let rows = &mut bytemuck::cast_slice_mut(&mut words)[..bytes.len()];
        rows.copy_from_slice(bytes);
        if cfg!(target_endian = "big") {
            swap(rows, size);
        }
        Self { words, n_bytes: bytes.len() }
    }
}

impl AsRef<[u8]> for Aligned {
    fn as_ref(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.words)[..self.n_bytes]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_node::{Payload, Value};
    use osteoflow_toy::{Number, Samples};
    use proptest::prelude::*;

    fn wave(samples: Vec<f64>) -> Item {
        Item { number: 7, stamp_ns: -12, body: Body::Value(Value::new(Samples { label: "µ".into(), samples })) }
    }

    #[test]
    fn a_value_round_trips_with_number_stamp_and_columns() {
        let recorded = decode(&encode(&wave(vec![1.0, -0.0, f64::MIN_POSITIVE]))).unwrap();
        assert_eq!((recorded.number, recorded.stamp_ns), (7, -12));
        let wave = Samples::from_view(recorded.body.as_ref().unwrap()).unwrap();
        assert_eq!((wave.label.as_str(), wave.samples), ("µ", vec![1.0, -0.0, f64::MIN_POSITIVE]));
    }

    #[test]
    fn the_worked_example_of_the_docs_is_encoded_exactly() {
        let page = include_str!("../../../docs/use/recording.md");
        let example = page.split("```hex\n").nth(1).unwrap().split("```").next().unwrap();
        let bytes = |line: &str| -> Vec<u8> {
            let hex = line.get(5..28.min(line.len())).unwrap().split_whitespace();
            hex.map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
        };
        let mut written = Vec::new();
        for line in example.lines() {
            assert_eq!(line[..3].trim().parse(), Ok(written.len()), "{line}");
            written.extend(bytes(line));
        }
        let wave = Samples { label: "hello".into(), samples: vec![1.5, -0.0] };
        let item = Item { number: 7, stamp_ns: 1000, body: Body::Value(Value::new(wave)) };
        assert_eq!(written, encode(&item));
    }

    #[test]
    fn columns_are_aligned_to_eight_bytes() {
        let bytes = encode(&wave(vec![1.5]));
        let rows = bytes.windows(8).position(|w| w == 1.5f64.to_le_bytes()).unwrap();
        assert_eq!(rows % 8, 0, "rows begin at byte {rows}");
    }

    #[test]
    fn an_empty_round_trips_with_its_node_and_reason() {
        let empty = Empty { node: "hole".into(), reason: "no hole".into() };
        let item = Item { number: 1, stamp_ns: 5, body: Body::Empty(Arc::new(empty.clone())) };
        let recorded = RecordedItem { number: 1, stamp_ns: 5, payload: None, body: Err(empty) };
        assert_eq!(decode(&encode(&item)).unwrap(), recorded);
    }

    #[test]
    fn on_a_wire_that_takes_anything_a_value_names_its_payload() {
        let recorded = decode(&encode_on(PortPayload::Any, &wave(vec![2.5]))).unwrap();
        assert_eq!(recorded.payload, Some(("toy/Samples".into(), 2)));
        let item = recorded.into_item(PayloadType::of::<Samples, _>()).unwrap();
        let Body::Value(value) = item.body else { panic!("a value was recorded") };
        assert_eq!(value.get::<Samples>().unwrap().samples, [2.5]);
    }

    #[test]
    fn a_header_with_too_many_fields_is_refused() {
        let mut bytes = encode(&wave(vec![1.0]));
        bytes[28..32].copy_from_slice(&u32::MAX.to_le_bytes());
        assert_eq!(decode(&bytes), Err(CodecError::invalid("it claims more than 65536 fields or columns")));
    }

    #[test]
    fn a_view_of_another_payload_is_refused() {
        let recorded = decode(&encode(&wave(vec![1.0]))).unwrap();
        let ty = PayloadType::of::<Number, _>();
        assert!(recorded.into_item(ty).is_err());
    }

    proptest! {
        #[test]
        fn damaged_bytes_are_an_error_or_another_item_and_never_a_panic(
            at in 0usize..400, byte: u8, cut in 0usize..400,
        ) {
            let mut bytes = encode(&wave(vec![1.0, 2.0, 3.0]));
            let (at, cut) = (at % bytes.len(), cut % bytes.len());
            prop_assert!(decode(&bytes[..cut]).is_err(), "{cut} of {} bytes were taken for an item", bytes.len());
            bytes[at] = byte;
            let _ = decode(&bytes);
        }
    }
}
