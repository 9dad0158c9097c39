//! The PLY format itself: header and elements, in ASCII and in both binary orders.
//!
//! Read by our own code because scanners write files that stricter readers refuse: `nan` for a pixel without depth, numbers such as
//! `.5` and `1.`, CRLF, blank lines. Counts are checked against the bytes that follow before anything is allocated.

use crate::FileError;
use std::path::Path;

/// The elements of a file, in its order.
pub(crate) struct Ply {
    elements: Vec<Element>,
}

/// One kind of element: its scalar properties as columns, its list properties as runs.
#[derive(Default)]
pub(crate) struct Element {
    pub(crate) name: String,
    pub(crate) count: usize,
    properties: Vec<Property>,
}

struct Property {
    name: String,
    kind: Kind,
    values: Vec<f64>,
    /// For a list: where each element's run ends in `values`.
    ends: Vec<usize>,
}

#[derive(Clone, Copy)]
enum Kind {
    Scalar(Type),
    List(Type, Type),
}

#[derive(Clone, Copy)]
enum Type {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

impl Ply {
    /// Reads all of a file's elements.
    pub(crate) fn read(path: &Path) -> Result<Self, FileError> {
        let bytes = std::fs::read(path).map_err(FileError::read(path))?;
        Self::parse(path, &bytes)
    }

    pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<Self, FileError> {
        let mut lines = Lines { path, bytes, at: 0, line: 0 };
        let (encoding, mut elements) = header(&mut lines)?;
        for element in &mut elements {
            element.reserve(&lines, encoding)?;
            match encoding {
                Encoding::Ascii => element.read_ascii(&mut lines)?,
                _ => element.read_binary(&mut lines, encoding == Encoding::Big)?,
            }
        }
        Ok(Self { elements })
    }

    /// The first element of that name.
    pub(crate) fn element(&self, name: &str) -> Option<&Element> {
        self.elements.iter().find(|e| e.name == name)
    }
}

impl Element {
    /// The values of a scalar property, one for each element.
    pub(crate) fn scalars(&self, name: &str) -> Option<&[f64]> {
        let found = self.properties.iter().find(|p| p.name == name && matches!(p.kind, Kind::Scalar(_)));
        found.map(|p| p.values.as_slice())
    }

    /// The runs of a list property, one for each element.
    pub(crate) fn lists(&self, name: &str) -> Option<impl Iterator<Item = &[f64]>> {
        let property = self.properties.iter().find(|p| p.name == name && matches!(p.kind, Kind::List(..)))?;
        let starts = std::iter::once(0).chain(property.ends.iter().copied());
        Some(starts.zip(&property.ends).map(|(start, &end)| &property.values[start..end]))
    }

    /// The names of the properties, for messages.
    pub(crate) fn property_names(&self) -> String {
        self.properties.iter().map(|p| p.name.as_str()).collect::<Vec<_>>().join(", ")
    }

    /// Reserves memory, after checking that the file is long enough for the elements that its header announces.
    fn reserve(&mut self, lines: &Lines, encoding: Encoding) -> Result<(), FileError> {
        if self.count > 0 && self.properties.is_empty() {
            return Err(lines.fault(format!("the header gives element \"{}\" no properties", self.name)));
        }
        let size = |t: Type| if encoding == Encoding::Ascii { 2 } else { t.n_bytes() };
        let least: usize = self
            .properties
            .iter()
            .map(|p| match p.kind {
                Kind::Scalar(t) | Kind::List(t, _) => size(t),
            })
            .sum();
        // The last line may lack its line break.
        let left = (lines.bytes.len() - lines.at + 1) as u64;
        if (self.count as u64).saturating_mul(least as u64) > left {
            let message = format!(
                "the header promises {} elements \"{}\" of at least {least} bytes, but {} bytes are left; \
                 was the file cut short?",
                self.count,
                self.name,
                left - 1
            );
            return Err(lines.fault(message));
        }
        for property in &mut self.properties {
            property.values.reserve(self.count);
        }
        Ok(())
    }

    fn read_ascii(&mut self, lines: &mut Lines) -> Result<(), FileError> {
        for index in 0..self.count {
            let text = loop {
                match lines.next()? {
                    Some(text) if text.trim().is_empty() => {}
                    Some(text) => break text,
                    None => {
                        let message = format!(
                            "the file ends after {index} of {} elements \"{}\"; was it cut short?",
                            self.count, self.name
                        );
                        return Err(lines.fault(message));
                    }
                }
            };
            let mut words = text.split_ascii_whitespace();
            let mut number = |name: &str| -> Result<f64, FileError> {
                let word = words.next().ok_or_else(|| lines.fault(format!("no value for property \"{name}\"")))?;
                word.parse().map_err(|_| lines.fault(format!("\"{word}\" is not a number for \"{name}\"")))
            };
            for property in &mut self.properties {
                match property.kind {
                    Kind::Scalar(_) => property.values.push(number(&property.name)?),
                    Kind::List(..) => {
                        let n = number(&property.name)?;
                        // More values than the line has characters cannot be there.
                        if n.fract() != 0.0 || !(0.0..=text.len() as f64).contains(&n) {
                            return Err(lines.fault(format!("list \"{}\" claims {n} values", property.name)));
                        }
                        for _ in 0..n as usize {
                            property.values.push(number(&property.name)?);
                        }
                        property.ends.push(property.values.len());
                    }
                }
            }
            if let Some(word) = words.next() {
                return Err(lines.fault(format!(
                    "\"{word}\" follows the {} properties of element \"{}\"; do header and data belong together?",
                    self.properties.len(),
                    self.name
                )));
            }
        }
        Ok(())
    }

    fn read_binary(&mut self, lines: &mut Lines, big: bool) -> Result<(), FileError> {
        for index in 0..self.count {
            for property in &mut self.properties {
                let cut = |lines: &Lines| {
                    lines.fault(format!(
                        "the file ends within element {index} of {} \"{}\"; was it cut short?",
                        self.count, self.name
                    ))
                };
                match property.kind {
                    Kind::Scalar(t) => {
                        property.values.push(lines.number(t, big).ok_or_else(|| cut(lines))?);
                    }
                    Kind::List(count, item) => {
                        let n = lines.number(count, big).ok_or_else(|| cut(lines))?;
                        let left = (lines.bytes.len() - lines.at) / item.n_bytes();
                        if n.fract() != 0.0 || !(0.0..=left as f64).contains(&n) {
                            let name = &property.name;
                            return Err(lines.fault(format!("list \"{name}\" claims {n} values, {left} can follow")));
                        }
                        for _ in 0..n as usize {
                            property.values.push(lines.number(item, big).ok_or_else(|| cut(lines))?);
                        }
                        property.ends.push(property.values.len());
                    }
                }
            }
        }
        Ok(())
    }
}

fn header(lines: &mut Lines) -> Result<(Encoding, Vec<Element>), FileError> {
    if lines.next()?.map(str::trim) != Some("ply") {
        return Err(lines.fault("a PLY file begins with the line \"ply\"; is it another kind of file?".into()));
    }
    let (mut encoding, mut elements) = (None, Vec::<Element>::new());
    loop {
        let Some(text) = lines.next()? else {
            return Err(lines.fault("the header has no \"end_header\"; was the file cut short?".into()));
        };
        match text.split_ascii_whitespace().collect::<Vec<_>>()[..] {
            [] | ["comment" | "obj_info", ..] => {}
            ["format", "ascii", ..] => encoding = Some(Encoding::Ascii),
            ["format", "binary_little_endian", ..] => encoding = Some(Encoding::Little),
            ["format", "binary_big_endian", ..] => encoding = Some(Encoding::Big),
            ["element", name, count] => {
                let count = count.parse().map_err(|_| lines.fault(format!("\"{count}\" is no count of elements")))?;
                elements.push(Element { name: name.into(), count, properties: Vec::new() });
            }
            ["property", ref words @ .., name] => {
                let kind = match *words {
                    [t] => Type::named(t).map(Kind::Scalar),
                    ["list", count, item] => Type::named(count).zip(Type::named(item)).map(|(c, i)| Kind::List(c, i)),
                    _ => None,
                };
                let kind =
                    kind.ok_or_else(|| lines.fault(format!("\"{}\" is no known property type", words.join(" "))))?;
                let Some(element) = elements.last_mut() else {
                    return Err(lines.fault("a property precedes the first element".into()));
                };
                let name = name.into();
                element.properties.push(Property { name, kind, values: Vec::new(), ends: Vec::new() });
            }
            ["end_header"] => break,
            _ => return Err(lines.fault(format!("\"{}\" is no line of a PLY header", text.trim()))),
        }
    }
    let encoding = encoding.ok_or_else(|| lines.fault("the header has no \"format\" line".into()))?;
    Ok((encoding, elements))
}

impl Type {
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn n_bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

/// A place in a file: lines while it is text, bytes behind a binary header.
struct Lines<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    at: usize,
    line: usize,
}

impl<'a> Lines<'a> {
    /// The next line without its line break; none at the end.
    fn next(&mut self) -> Result<Option<&'a str>, FileError> {
        let rest = &self.bytes[self.at..];
        if rest.is_empty() {
            return Ok(None);
        }
        self.line += 1;
        let n = rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
        self.at += (n + 1).min(rest.len());
        let text = std::str::from_utf8(&rest[..n]).or_else(|_| {
            // Only comments may be in another encoding than ASCII.
            if rest.starts_with(b"comment") || rest.starts_with(b"obj_info") { Ok("comment") } else { Err(()) }
        });
        text.map(|t| Some(t.trim_end_matches('\r'))).map_err(|()| self.fault("the line is no text".into()))
    }

    fn number(&mut self, kind: Type, big: bool) -> Option<f64> {
        let bytes = self.bytes.get(self.at..self.at + kind.n_bytes())?;
        self.at += bytes.len();
        macro_rules! read {
            ($t:ty) => {{
                let bytes = bytes.try_into().expect("as many bytes as the type has");
                f64::from(if big { <$t>::from_be_bytes(bytes) } else { <$t>::from_le_bytes(bytes) })
            }};
        }
        Some(match kind {
            Type::I8 => read!(i8),
            Type::U8 => read!(u8),
            Type::I16 => read!(i16),
            Type::U16 => read!(u16),
            Type::I32 => read!(i32),
            Type::U32 => read!(u32),
            Type::F32 => read!(f32),
            Type::F64 => read!(f64),
        })
    }

    fn fault(&self, message: String) -> FileError {
        FileError::content(self.path, format!("line {}", self.line), message)
    }
}
