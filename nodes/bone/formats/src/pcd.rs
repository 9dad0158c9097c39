//! PCD, the format of the Point Cloud Library: ASCII, binary and compressed, with any fields.

use crate::{
    FileError,
    cursor::Cursor,
    scalar::{self, Rows, Scalar},
    shape::{Places, Shape},
    space::StatedSpace,
};
use std::path::Path;

/// The most that LZF can unpack from one byte, rounded up: a copy of 264 bytes takes three.
const LZF_RATIO: u64 = 100;

/// More zeros than this behind the points are no padding: the largest page of memory of common machines.
const MAX_PADDING_BYTES: usize = 64 << 10;

/// One field of each point.
struct Field {
    name: String,
    scalar: Scalar,
    count: usize,
    /// Offset in a point, bytes.
    offset: usize,
    /// Number of numbers before it in a point.
    n_before: usize,
}

#[derive(Default)]
struct Header {
    fields: Vec<Field>,
    n_points: usize,
    /// Bytes of a point.
    stride: usize,
    data: String,
    stated: StatedSpace,
    notes: Vec<String>,
}

/// The cloud in a PCD file.
pub(crate) fn shape(path: &Path, bytes: &[u8]) -> Result<Shape, FileError> {
    let mut cursor = Cursor::new(path, bytes);
    let mut header = header(&mut cursor, bytes.len())?;
    let (columns, places) = match header.data.as_str() {
        "ascii" => ascii(&mut cursor, &header)?,
        "binary" => {
            let first = cursor.at;
            let n_bytes = header.n_bytes(&mut cursor)?;
            let bytes = cursor.take(n_bytes, &format!("the data of {} points", header.n_points))?;
            let rows = Rows { bytes, stride: header.stride, big: false };
            let columns =
                columns(&header, |field, k| rows.column(field.scalar, field.offset + k * field.scalar.n_bytes()));
            (columns, Places::Rows { first, stride: header.stride })
        }
        "binary_compressed" => (compressed(&mut cursor, &header)?, Places::Order),
        other => {
            let message = format!("DATA is \"{other}\"; ascii, binary or binary_compressed is expected");
            return Err(cursor.fault(message));
        }
    };
    // PCL makes a binary file longer by the rest of the page that its header takes.
    let padding = cursor.rest();
    if cursor.is_binary && padding.len() < MAX_PADDING_BYTES && padding.iter().all(|&byte| byte == 0) {
        cursor.at += padding.len();
    }
    let stride = Some(header.stride).filter(|_| header.data == "binary");
    header.notes.extend(cursor.end("point", "points", stride)?);
    let place = |name: &str| {
        columns.iter().position(|(column, _)| column == name).ok_or_else(|| {
            let names: Vec<&str> = header.fields.iter().map(|field| field.name.as_str()).collect();
            cursor.header_fault(format!("no field is called \"{name}\"; there are: {}", names.join(", ")))
        })
    };
    let columns_of_points = [place("x")?, place("y")?, place("z")?];
    let shape = Shape::of_columns(columns, columns_of_points);
    Ok(Shape { places, stated: header.stated, notes: header.notes, ..shape })
}

type Columns = Vec<(String, Vec<f64>)>;

/// The columns of compressed data: field after field, not point after point.
fn compressed(cursor: &mut Cursor, header: &Header) -> Result<Columns, FileError> {
    let n_bytes = header.n_bytes(cursor)?;
    let start = *cursor;
    let sizes = Rows { bytes: cursor.take(8, "the two sizes of compressed data")?, stride: 4, big: false };
    let sizes = sizes.column(Scalar::U32, 0);
    let (n_packed, n_unpacked) = (sizes[0] as usize, sizes[1] as usize);
    if n_unpacked != n_bytes {
        return Err(start.fault(format!(
            "the data unpack to {n_unpacked} bytes, but {} points need {n_bytes}; is the header another file's?",
            header.n_points
        )));
    }
    let mut place = *cursor;
    let unpacked = lzf(cursor.take(n_packed, "the compressed data")?, n_unpacked).map_err(|(at, message)| {
        place.at += at;
        place.fault(format!("{message}; is the file damaged?"))
    })?;
    Ok(columns(header, |field, k| {
        let n = field.scalar.n_bytes();
        let (start, stride) = (field.offset * header.n_points, field.count * n);
        let bytes = &unpacked[start..start + stride * header.n_points];
        Rows { bytes, stride, big: false }.column(field.scalar, k * n)
    }))
}

/// The columns of all fields but padding; a field of several numbers gives `name_0`, `name_1` and so on, and a packed
/// colour gives `red`, `green` and `blue`.
fn columns(header: &Header, mut column: impl FnMut(&Field, usize) -> Vec<f64>) -> Columns {
    let mut columns = Vec::new();
    for field in header.fields.iter().filter(|field| field.name != "_") {
        let is_colour =
            matches!(field.name.as_str(), "rgb" | "rgba") && field.count == 1 && field.scalar.n_bytes() == 4;
        for k in 0..field.count {
            let values = column(field, k);
            if is_colour {
                let bits: Vec<u32> = values.iter().map(|&value| colour_bits(field.scalar, value)).collect();
                for (name, shift) in [("red", 16), ("green", 8), ("blue", 0)] {
                    columns.push((name.into(), bits.iter().map(|bits| f64::from((bits >> shift) & 0xff)).collect()));
                }
                continue;
            }
            let name = if field.count == 1 { field.name.clone() } else { format!("{}_{k}", field.name) };
            columns.push((name, values));
        }
    }
    columns
}

/// The bits of a packed colour: those of a whole number, or those of the float that they were stored as.
fn colour_bits(scalar: Scalar, value: f64) -> u32 {
    if scalar == Scalar::F32 && !(value >= 1.0 && value.fract() == 0.0) {
        (value as f32).to_bits()
    } else {
        value as i64 as u32
    }
}

/// The columns of data in ASCII, a point on each line, and the lines.
fn ascii(cursor: &mut Cursor, header: &Header) -> Result<(Columns, Places), FileError> {
    let (n_points, width) = (header.n_points, header.fields.iter().map(|field| field.count).sum::<usize>());
    // Each number takes a digit and a blank.
    cursor.promised(n_points, 2 * width, "points")?;
    let mut values: Vec<Vec<f64>> = vec![Vec::with_capacity(n_points); width];
    let mut lines = Vec::with_capacity(n_points);
    while let Some(line) = cursor.filled_line() {
        if line.trim_start().starts_with('#') {
            continue;
        }
        if lines.len() == n_points {
            return Err(cursor.more("more lines"));
        }
        lines.push(cursor.line);
        let mut words = line.split_ascii_whitespace();
        for (k, column) in values.iter_mut().enumerate() {
            let Some(word) = words.next() else {
                return Err(cursor.fault(format!("{width} numbers are expected, this line has {k}")));
            };
            column.push(cursor.number(word)?);
        }
        if let Some(word) = words.next() {
            return Err(cursor.fault(format!("\"{word}\" follows the {width} numbers of a point")));
        }
    }
    if lines.len() < n_points {
        return Err(cursor.cut_short(lines.len(), n_points, "points"));
    }
    let columns = columns(header, |field, k| std::mem::take(&mut values[field.n_before + k]));
    Ok((columns, Places::Lines(lines)))
}

impl Header {
    /// Bytes of the points, which begin at the cursor.
    fn n_bytes(&self, cursor: &mut Cursor) -> Result<usize, FileError> {
        cursor.is_binary = true;
        let Self { n_points, stride, .. } = self;
        let fault = || cursor.fault(format!("{n_points} points of {stride} bytes are more than a file can hold"));
        n_points.checked_mul(*stride).ok_or_else(fault)
    }
}

/// The lines of a header, as they are written.
#[derive(Default)]
struct Lines {
    names: Vec<String>,
    sizes: Vec<usize>,
    types: Vec<String>,
    counts: Option<Vec<usize>>,
    width: Option<usize>,
    height: Option<usize>,
    points: Option<usize>,
}

fn header(cursor: &mut Cursor, n_bytes: usize) -> Result<Header, FileError> {
    let (mut header, mut lines, mut keys) = (Header::default(), Lines::default(), Vec::<String>::new());
    loop {
        let Some(line) = cursor.line() else {
            return Err(cursor.fault("the header has no DATA line; was the file cut short?"));
        };
        let line = line.trim();
        let (key, values) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        if line.is_empty() || key.starts_with('#') {
            header.stated.take(line).map_err(|message| cursor.fault(message))?;
            continue;
        }
        if keys.iter().any(|before| before == key) {
            return Err(cursor.fault(format!("the header has a second line {key}")));
        }
        keys.push(key.to_owned());
        let words: Vec<&str> = values.split_ascii_whitespace().collect();
        let counts = || words.iter().map(|word| cursor.count(word)).collect::<Result<Vec<_>, _>>();
        let one = || match counts()?[..] {
            [count] => Ok(Some(count)),
            _ => Err(cursor.fault(format!("{key} has {} values, one is expected", words.len()))),
        };
        match key {
            "VERSION" => {}
            "FIELDS" | "COLUMNS" => lines.names = words.iter().map(|&word| word.into()).collect(),
            "SIZE" => lines.sizes = counts()?,
            "TYPE" => lines.types = words.iter().map(|&word| word.into()).collect(),
            "COUNT" => lines.counts = Some(counts()?),
            "WIDTH" => lines.width = one()?,
            "HEIGHT" => lines.height = one()?,
            "POINTS" => lines.points = one()?,
            "VIEWPOINT" => {
                let values: Option<Vec<f64>> = words.iter().map(|word| scalar::number(word)).collect();
                match values.as_deref() {
                    Some([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]) => {}
                    Some(_) if words.len() == 7 => header.notes.push(format!(
                        "VIEWPOINT is {}, not the identity; it was not applied to the points",
                        words.join(" ")
                    )),
                    _ => return Err(cursor.fault("VIEWPOINT needs seven numbers: a position and a quaternion")),
                }
            }
            "DATA" => {
                header.data = words.first().map_or_else(String::new, |word| word.to_ascii_lowercase());
                break;
            }
            _ => return Err(cursor.fault(format!("\"{line}\" is no line of a PCD header"))),
        }
    }
    header.n_points = lines.n_points().map_err(|message| cursor.fault(message))?;
    lines.fields(n_bytes, &mut header).map_err(|message| cursor.fault(message))?;
    Ok(header)
}

impl Lines {
    fn n_points(&self) -> Result<usize, String> {
        let n_points = match (self.width, self.points) {
            (Some(width), points) => {
                let height = self.height.unwrap_or(1);
                let n = width.checked_mul(height);
                if let Some(points) = points.filter(|&points| Some(points) != n) {
                    return Err(format!("POINTS is {points}, but WIDTH × HEIGHT is {width} × {height}"));
                }
                n.ok_or_else(|| format!("WIDTH × HEIGHT is {width} × {height}, more than a file can hold"))?
            }
            (None, Some(points)) => points,
            (None, None) => return Err("the header has neither WIDTH nor POINTS".into()),
        };
        if n_points == 0 { Err("the header counts no point".into()) } else { Ok(n_points) }
    }

    /// Gives the header its fields and stride; the file has `n_bytes`.
    fn fields(self, n_bytes: usize, header: &mut Header) -> Result<(), String> {
        let Self { names, sizes, types, counts, .. } = self;
        if names.is_empty() {
            return Err("the header has no FIELDS".into());
        }
        let counts = counts.unwrap_or_else(|| vec![1; names.len()]);
        for (key, n) in [("SIZE", sizes.len()), ("TYPE", types.len()), ("COUNT", counts.len())] {
            if n != names.len() {
                return Err(format!("{key} has {n} values for {} fields", names.len()));
            }
        }
        if let Some((_, name)) = names.iter().enumerate().find(|(k, name)| *name != "_" && names[..*k].contains(name)) {
            return Err(format!("FIELDS names \"{name}\" twice"));
        }
        let mut n_before = 0;
        for (k, name) in names.into_iter().enumerate() {
            let scalar = match (types[k].as_str(), sizes[k]) {
                ("I", 1) => Scalar::I8,
                ("I", 2) => Scalar::I16,
                ("I", 4) => Scalar::I32,
                ("I", 8) => Scalar::I64,
                ("U", 1) => Scalar::U8,
                ("U", 2) => Scalar::U16,
                ("U", 4) => Scalar::U32,
                ("U", 8) => Scalar::U64,
                ("F", 4) => Scalar::F32,
                ("F", 8) => Scalar::F64,
                (kind, size) => {
                    return Err(format!(
                        "field \"{name}\" has TYPE {kind} and SIZE {size}; I or U of 1 to 8, F of 4 or 8 is expected"
                    ));
                }
            };
            let count = counts[k];
            // A field of more numbers than the file has bytes cannot be there.
            if count == 0 || count > n_bytes {
                return Err(format!("field \"{name}\" has COUNT {count}"));
            }
            header.fields.push(Field { name, scalar, count, offset: header.stride, n_before });
            n_before += count;
            header.stride = header.stride.saturating_add(count.saturating_mul(scalar.n_bytes()));
        }
        Ok(())
    }
}

/// Unpacks LZF data to exactly `n` bytes.
///
/// # Errors
/// The byte and a message, if the data give more or fewer bytes, or copy from before their start.
///
/// # Source
/// The format of Marc Lehmann's liblzf: a control byte below 32 is followed by one more literal bytes than it says; another
/// holds in its upper three bits the length of a copy less two (7: a byte with a further length follows), and with the
/// next byte how far back the copy begins.
fn lzf(packed: &[u8], n: usize) -> Result<Vec<u8>, (usize, String)> {
    if n as u64 > LZF_RATIO * packed.len() as u64 {
        return Err((0, format!("{} bytes cannot unpack to the {n} bytes that are stated", packed.len())));
    }
    let mut out = Vec::with_capacity(n);
    let mut at = 0;
    while let Some(&control) = packed.get(at) {
        let start = at;
        let mut byte = || {
            at += 1;
            packed.get(at).map(|&b| usize::from(b)).ok_or((at, "the compressed data end within a copy".to_owned()))
        };
        let control = usize::from(control);
        if control < 32 {
            let literals = packed.get(at + 1..at + 2 + control);
            out.extend(literals.ok_or((at, "the compressed data end within literal bytes".to_owned()))?);
            at += 2 + control;
        } else {
            let length = match control >> 5 {
                7 => 9 + byte()?,
                short => 2 + short,
            };
            let back = ((control & 31) << 8) + byte()? + 1;
            at += 1;
            let from = out
                .len()
                .checked_sub(back)
                .ok_or((start, format!("a copy begins {back} bytes back of {}", out.len())))?;
            if length > n - out.len().min(n) {
                return Err((start, format!("the data unpack to more than the {n} bytes that are stated")));
            }
            // A copy may overlap what it writes.
            (from..from + length).for_each(|k| out.push(out[k]));
        }
        if out.len() > n {
            return Err((start, format!("the data unpack to more than the {n} bytes that are stated")));
        }
    }
    if out.len() < n {
        return Err((at, format!("the data unpack to {} of the {n} bytes that are stated", out.len())));
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::CloudFileRead;
    use nalgebra::{Point3, Vector3};

    fn read(bytes: &[u8]) -> Result<CloudFileRead, FileError> {
        let path = "a.pcd".as_ref();
        shape(path, bytes)?.into_cloud(path, 1.0, "camera".into())
    }

    fn said(bytes: &[u8]) -> String {
        read(bytes).unwrap_err().to_string()
    }

    const HEAD: &str = "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z id _ normal_x normal_y normal_z\n\
                        SIZE 4 8 4 2 1 4 4 4\nTYPE F F I U U F F F\nCOUNT 1 1 1 2 3 1 1 1\nWIDTH 2\nHEIGHT 1\n\
                        VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\n";

    fn rows() -> [Vec<u8>; 2] {
        [(1.5_f32, 2.25_f64, -3_i32, [7_u16, 8]), (4.5, 5.25, -6, [9, 65535])].map(|(x, y, z, id)| {
            let mut row = Vec::new();
            row.extend(x.to_le_bytes());
            row.extend(y.to_le_bytes());
            row.extend(z.to_le_bytes());
            id.iter().for_each(|id| row.extend(id.to_le_bytes()));
            row.extend([1, 2, 3]);
            [0.0_f32, 0.0, 1.0].iter().for_each(|n| row.extend(n.to_le_bytes()));
            row
        })
    }

    /// The literal form of LZF, without copies.
    fn literal(bytes: &[u8]) -> Vec<u8> {
        bytes.chunks(32).flat_map(|chunk| std::iter::once(chunk.len() as u8 - 1).chain(chunk.iter().copied())).collect()
    }

    fn compressed() -> Vec<u8> {
        let [a, b] = rows();
        let mut columns = Vec::new();
        for range in [0..4, 4..12, 12..16, 16..20, 20..23, 23..27, 27..31, 31..35] {
            columns.extend(&a[range.clone()]);
            columns.extend(&b[range]);
        }
        let packed = literal(&columns);
        let mut bytes = format!("{HEAD}DATA binary_compressed\n").into_bytes();
        bytes.extend((packed.len() as u32).to_le_bytes());
        bytes.extend((columns.len() as u32).to_le_bytes());
        bytes.extend(packed);
        bytes
    }

    #[test]
    fn the_same_cloud_is_read_from_all_three_encodings_with_fields_of_any_type() {
        let ascii =
            format!("{HEAD}DATA ascii\n1.5 2.25 -3 7 8 1 2 3 0 0 1\n4.5 5.25 -6 9 65535 1 2 3 0 0 1\n").into_bytes();
        let mut binary = format!("{HEAD}DATA binary\n").into_bytes();
        rows().iter().for_each(|row| binary.extend(row));
        for bytes in [ascii, binary, compressed()] {
            let content = read(&bytes).unwrap();
            assert_eq!(content.cloud.points(), [Point3::new(1.5, 2.25, -3.0), Point3::new(4.5, 5.25, -6.0)]);
            assert_eq!(content.cloud.normals(), Some(&[Vector3::z(); 2][..]));
            let extras: Vec<(&str, &[f64])> = content.cloud.extras().iter().map(|(n, v)| (&**n, &**v)).collect();
            assert_eq!(extras, [("id_0", &[7.0, 9.0][..]), ("id_1", &[8.0, 65535.0][..])]);
            assert_eq!(content.notes, [""; 0]);
        }
    }

    #[test]
    fn the_zeros_that_pcl_writes_behind_the_points_are_no_points_and_anything_else_is_told() {
        let mut bytes = format!("{HEAD}DATA binary\n").into_bytes();
        rows().iter().for_each(|row| bytes.extend(row));
        // 4060 zeros are 116 rows.
        bytes.extend([0; 4060]);
        let content = read(&bytes).unwrap();
        assert_eq!((content.cloud.len(), content.notes), (2, vec![]));
        bytes.push(1);
        assert_eq!(
            read(&bytes).unwrap().notes,
            ["4061 bytes follow the last point, from byte 296 on, and were not read"]
        );
        bytes.pop();
        *bytes.last_mut().unwrap() = 1;
        assert!(said(&bytes).contains("116 more points follow"), "{}", said(&bytes));
    }

    #[test]
    fn an_organised_cloud_drops_its_points_without_depth_and_a_viewpoint_is_noted() {
        let text = "VERSION .7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nWIDTH 2\nHEIGHT 2\nVIEWPOINT 0 0 5 1 0 0 0\n\
                    # SPACE=LPS\nDATA ascii\n1 2 3 16711935\nnan nan nan 0\n-nan(ind) 0 0 0\n4 5 6 255\n";
        let content = read(text.as_bytes()).unwrap();
        assert_eq!((content.n_points_in_file, content.n_dropped, content.space), (4, 2, crate::Space::Lps));
        assert_eq!(content.notes, ["VIEWPOINT is 0 0 5 1 0 0 0, not the identity; it was not applied to the points"]);
        let red = &content.cloud.extras()[0];
        assert_eq!((&*red.0, &*red.1), ("red", &[255.0, 0.0][..]));
    }

    #[test]
    fn lzf_copies_are_unpacked_and_bounded() {
        // "ab", then a copy of 7 bytes from 2 back, then a long copy of 9 + 1 bytes from 1 back.
        let packed = [1, b'a', b'b', 5 << 5, 1, 7 << 5, 1, 0];
        assert_eq!(lzf(&packed, 19).unwrap(), b"ababababaaaaaaaaaaa");
        assert!(lzf(&packed, 18).unwrap_err().1.contains("more than the 18 bytes"));
        assert!(lzf(&packed, 20).unwrap_err().1.contains("19 of the 20 bytes"));
        assert_eq!(lzf(&packed[..7], 19).unwrap_err(), (7, "the compressed data end within a copy".into()));
        assert_eq!(lzf(&[32, 0], 3).unwrap_err(), (0, "a copy begins 1 bytes back of 0".into()));
        assert!(lzf(&[0], usize::MAX).unwrap_err().1.contains("cannot unpack"));
    }

    #[test]
    fn a_broken_file_says_where_and_why() {
        let binary = format!("{HEAD}DATA binary\n");
        let ascii = format!("{HEAD}DATA ascii\n");
        for (text, expected) in [
            (
                binary.clone() + "0123",
                "byte 226: the data of 2 points needs 70 bytes, but 4 are left; was the file cut short?",
            ),
            (ascii.clone() + "1 2 3\n", "line 11: 2 points are promised, but 6 bytes are left"),
            (
                ascii.clone() + "1 2 3 70 80 1 2 3 0 0 1\n1 2 3 7 8 1 2 3 0 0\n",
                "line 13: 11 numbers are expected, this line has 10",
            ),
            (ascii.clone() + &"1 2 3 7 8 1 2 3 0 0 1\n".repeat(3), "line 14: more lines follow than the header counts"),
            (
                ascii.clone() + "1 2 3 7 8 1 2 3 0 0 1\n                      \n",
                "line 13: the file ends after 1 of 2 points",
            ),
            (ascii.replace("POINTS 2", "POINTS 3"), "line 11: POINTS is 3, but WIDTH × HEIGHT is 2 × 1"),
            (ascii.replace("SIZE 4", "SIZE 3"), "line 11: field \"x\" has TYPE F and SIZE 3"),
            (ascii.replace("SIZE 4 8", "SIZE 4"), "line 11: SIZE has 7 values for 8 fields"),
            (ascii.replace("FIELDS x y", "FIELDS x x"), "FIELDS names \"x\" twice"),
            (
                ascii.replace("FIELDS x", "FIELDS u") + &"1 2 3 7 8 1 2 3 0 0 1\n".repeat(2),
                "no field is called \"x\"; there are: u, y",
            ),
            (
                ascii.replace("POINTS 2", "POINTS 0").replace("WIDTH 2", "WIDTH 0"),
                "line 11: the header counts no point",
            ),
            (ascii.replace("DATA ascii", "DATA zip"), "line 11: DATA is \"zip\""),
            (HEAD.into(), "the header has no DATA line"),
        ] {
            let message = said(text.as_bytes());
            assert!(message.contains(expected), "{expected}\n{message}");
        }
        let mut sizes = compressed();
        let at = format!("{HEAD}DATA binary_compressed\n").len();
        sizes[at + 4] = 71;
        assert!(said(&sizes).contains("the data unpack to 71 bytes, but 2 points need 70"), "{}", said(&sizes));
        let cut = compressed();
        assert!(
            said(&cut[..cut.len() - 1]).contains("the compressed data needs 73 bytes, but 72 are left"),
            "{}",
            said(&cut[..cut.len() - 1])
        );
    }
}
