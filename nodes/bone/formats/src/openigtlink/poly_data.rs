//! POLYDATA.

use super::bytes::{EncodeError, Reader, put_floats};

/// Points with cells and attributes, as VTK has them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PolyData {
    /// mm.
    pub points: Vec<[f32; 3]>,
    /// Vertices.
    pub vertices: Cells,
    /// Lines.
    pub lines: Cells,
    /// Polygons.
    pub polygons: Cells,
    /// Strips of triangles.
    pub strips: Cells,
    /// Numbers of points or cells.
    pub attributes: Vec<Attribute>,
}

/// Lists of point numbers, one after the other: their length, then the numbers.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Cells(Vec<u32>);

/// A column of numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Attribute {
    /// 0 to 4: scalars, vectors, normals, tensors and colours of points; 16 to 20: of cells.
    pub kind: u8,
    /// Numbers for each point or cell.
    pub n_components: u8,
    /// Its name.
    pub name: String,
    /// The numbers.
    pub values: Vec<f32>,
}

impl Cells {
    /// Cells of these point numbers.
    pub fn new<const N: usize>(cells: impl IntoIterator<Item = [u32; N]>) -> Self {
        Self(cells.into_iter().flat_map(|cell| std::iter::once(N as u32).chain(cell)).collect())
    }

    /// The cells in their order.
    pub fn iter(&self) -> impl Iterator<Item = &[u32]> {
        let mut rest = &self.0[..];
        std::iter::from_fn(move || {
            let (&n, tail) = rest.split_first()?;
            let (cell, tail) = tail.split_at(n as usize);
            rest = tail;
            Some(cell)
        })
    }

    fn parse(reader: &mut Reader<'_>, (n, n_bytes): (u32, u32), n_points: u32) -> Result<Self, String> {
        let bytes = reader.take(n_bytes as usize)?;
        let (words, rest) = bytes.as_chunks::<4>();
        let words: Vec<u32> = words.iter().map(|word| u32::from_be_bytes(*word)).collect();
        let (mut at, mut n_cells) = (0, 0);
        while at < words.len() {
            let end = at.saturating_add(1).saturating_add(words[at] as usize);
            let cell =
                words.get(at + 1..end).ok_or("the lists of its cells do not add up; is the byte order wrong?")?;
            if let Some(index) = cell.iter().find(|index| **index >= n_points) {
                return Err(format!("a cell names point {index}, and there are {n_points}"));
            }
            (at, n_cells) = (end, n_cells + 1);
        }
        if !rest.is_empty() || n_cells != n {
            return Err(format!("{n} cells are announced, and {n_cells} are in {n_bytes} bytes"));
        }
        Ok(Self(words))
    }
}

impl PolyData {
    /// Points alone.
    pub fn of_points(points: Vec<[f32; 3]>) -> Self {
        Self { points, ..Self::default() }
    }

    pub(super) fn parse(reader: &mut Reader<'_>) -> Result<Self, String> {
        let n_points = reader.u32()?;
        let mut sizes = [(0, 0); 4];
        for size in &mut sizes {
            *size = (reader.u32()?, reader.u32()?);
        }
        let n_attributes = reader.u32()?;
        let n_bytes = (n_points as usize).checked_mul(12).ok_or("more points than a message holds")?;
        let mut points = Reader::new(reader.take(n_bytes)?);
        let points = (0..n_points).map(|_| points.floats()).collect::<Result<_, _>>()?;
        let [vertices, lines, polygons, strips] = sizes.map(|size| Cells::parse(reader, size, n_points));
        let (vertices, lines, polygons, strips) = (vertices?, lines?, polygons?, strips?);
        Ok(Self { points, vertices, lines, polygons, strips, attributes: attributes(reader, n_attributes)? })
    }

    pub(super) fn put(&self, out: &mut Vec<u8>) -> Result<(), EncodeError> {
        let n = |n: usize| {
            u32::try_from(n).map_err(|_| EncodeError(format!("{n} does not fit a POLYDATA"))).map(u32::to_be_bytes)
        };
        let all = [&self.vertices, &self.lines, &self.polygons, &self.strips];
        out.extend(n(self.points.len())?);
        for cells in all {
            out.extend(n(cells.iter().count())?);
            out.extend(n(4 * cells.0.len())?);
        }
        out.extend(n(self.attributes.len())?);
        self.points.iter().for_each(|point| put_floats(out, point));
        for cells in all {
            cells.0.iter().for_each(|word| out.extend(word.to_be_bytes()));
        }
        let mut n_names = 0;
        for attribute in &self.attributes {
            let n_components = usize::from(attribute.n_components);
            if n_components == 0 || !attribute.values.len().is_multiple_of(n_components) {
                let Attribute { name, values, .. } = attribute;
                let message = format!("attribute \"{name}\" has {} values of {n_components} components", values.len());
                return Err(EncodeError(message));
            }
            out.extend([attribute.kind, attribute.n_components]);
            out.extend(n(attribute.values.len() / n_components)?);
        }
        for attribute in &self.attributes {
            if attribute.name.len() > 255 || attribute.name.contains('\0') {
                return Err(EncodeError::too_long("the attribute", &attribute.name, 255));
            }
            out.extend(attribute.name.as_bytes());
            out.push(0);
            n_names += attribute.name.len() + 1;
        }
        if n_names % 2 == 1 {
            out.push(0);
        }
        self.attributes.iter().for_each(|attribute| put_floats(out, &attribute.values));
        Ok(())
    }
}

fn attributes(reader: &mut Reader<'_>, n: u32) -> Result<Vec<Attribute>, String> {
    let mut heads = Vec::new();
    for _ in 0..n {
        let (kind, n_components, n_values) = (reader.u8()?, reader.u8()?, reader.u32()?);
        heads.push((kind, n_components, n_values));
    }
    let (mut names, mut n_names) = (Vec::new(), 0);
    for _ in 0..n {
        let mut name = Vec::new();
        loop {
            match reader.u8()? {
                0 => break,
                _ if name.len() == 255 => return Err("the name of an attribute has more than 255 bytes".into()),
                byte => name.push(byte),
            }
        }
        n_names += name.len() + 1;
        names.push(String::from_utf8_lossy(&name).into_owned());
    }
    if n_names % 2 == 1 {
        reader.u8()?;
    }
    let mut attributes = Vec::new();
    for ((kind, n_components, n_values), name) in heads.into_iter().zip(names) {
        let n_bytes = (n_values as usize).checked_mul(4 * usize::from(n_components)).ok_or("too many attributes")?;
        let mut values = Reader::new(reader.take(n_bytes)?);
        let values = (0..n_bytes / 4).map(|_| Ok(values.floats::<1>()?[0])).collect::<Result<_, String>>()?;
        attributes.push(Attribute { kind, n_components, name, values });
    }
    Ok(attributes)
}
