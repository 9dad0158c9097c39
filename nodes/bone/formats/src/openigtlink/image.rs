//! The content of an IMAGE.

use super::{
    bytes::{EncodeError, Reader, put_floats},
    content::Affine,
};
use nalgebra::{Matrix4, Vector3};

/// Bytes before the pixels.
const HEAD_BYTES: usize = 72;
/// Version of the content that is read and written.
const VERSION: u16 = 1;
/// The value of `endian` for numbers that are sent with their lowest byte first.
const LITTLE: u8 = 2;

/// Type of a component of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scalar {
    /// 8 bits, signed.
    I8,
    /// 8 bits.
    U8,
    /// 16 bits, signed.
    I16,
    /// 16 bits.
    U16,
    /// 32 bits, signed.
    I32,
    /// 32 bits.
    U32,
    /// Single precision.
    F32,
    /// Double precision.
    F64,
}

impl Scalar {
    const ALL: [(u8, Self, usize, &'static str); 8] = [
        (2, Self::I8, 1, "int8"),
        (3, Self::U8, 1, "uint8"),
        (4, Self::I16, 2, "int16"),
        (5, Self::U16, 2, "uint16"),
        (6, Self::I32, 4, "int32"),
        (7, Self::U32, 4, "uint32"),
        (10, Self::F32, 4, "float32"),
        (11, Self::F64, 8, "float64"),
    ];

    fn row(self) -> (u8, Self, usize, &'static str) {
        // Every variant is in the table.
        Self::ALL.into_iter().find(|row| row.1 == self).unwrap_or(Self::ALL[1])
    }

    /// Number of bytes.
    pub fn n_bytes(self) -> usize {
        self.row().2
    }

    /// The name that numpy has for it.
    pub fn name(self) -> &'static str {
        self.row().3
    }
}

/// An image, a depth image, or an image whose components are coordinates.
///
/// Pixels are row by row, the first axis fastest, the components of a pixel side by side. A sender may send a part of a larger
/// image; `pixels` are those of the part.
#[derive(Debug, Clone, PartialEq)]
pub struct PixelImage {
    /// Number of components of a pixel.
    pub n_components: u8,
    /// Type of a component.
    pub scalar: Scalar,
    /// Whether the axes of `matrix` are LPS; else they are RAS.
    pub is_lps: bool,
    /// Number of pixels along each axis of the whole image.
    pub size: [u16; 3],
    /// Index to space: axes with their spacing, mm, and the centre of the image.
    pub matrix: Affine,
    /// First pixel of the part that is sent.
    pub part_offset: [u16; 3],
    /// Number of pixels along each axis of the part that is sent.
    pub part_size: [u16; 3],
    /// Whether numbers are sent with their lowest byte first, as most senders do.
    pub is_little_endian: bool,
    /// The bytes as sent.
    pub pixels: Vec<u8>,
}

impl PixelImage {
    /// A whole image of one slice at the origin, of pixels of 1 mm, with its lowest byte first.
    pub fn new(size: [u16; 2], n_components: u8, scalar: Scalar, pixels: Vec<u8>) -> Self {
        let size = [size[0], size[1], 1];
        let centre = |k: usize| (f32::from(size[k]) - 1.0) / 2.0;
        let matrix = Affine([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, centre(0), centre(1), centre(2)]);
        let (part_offset, part_size) = ([0; 3], size);
        Self {
            n_components,
            scalar,
            is_lps: true,
            size,
            matrix,
            part_offset,
            part_size,
            is_little_endian: true,
            pixels,
        }
    }

    /// Whether all of the image is sent.
    pub fn is_whole(&self) -> bool {
        self.part_offset == [0; 3] && self.part_size == self.size
    }

    /// Takes the index of a pixel of the whole image to space, mm; the centre that is sent is moved to the first pixel.
    pub fn t_space_index(&self) -> Matrix4<f64> {
        let mut matrix = self.matrix.matrix();
        let half = Vector3::from(self.size.map(|n| (f64::from(n) - 1.0) / 2.0));
        let first = matrix.fixed_view::<3, 1>(0, 3) - matrix.fixed_view::<3, 3>(0, 0) * half;
        matrix.fixed_view_mut::<3, 1>(0, 3).copy_from(&first);
        matrix
    }

    /// All components as numbers, in their order.
    pub fn values(&self) -> impl Iterator<Item = f64> + '_ {
        let (scalar, is_little) = (self.scalar, self.is_little_endian);
        self.pixels.chunks_exact(scalar.n_bytes()).map(move |bytes| number(scalar, bytes, is_little))
    }

    /// What it is, in messages: `200 x 100 pixels of 3 float32`.
    pub fn form(&self) -> String {
        let [width, height, depth] = self.part_size;
        let slices = if depth == 1 { String::new() } else { format!(" x {depth}") };
        format!("{width} x {height}{slices} pixels of {} {}", self.n_components, self.scalar.name())
    }

    pub(super) fn parse(reader: &mut Reader<'_>) -> Result<Self, String> {
        let version = reader.u16()?;
        if version != VERSION {
            return Err(format!("an IMAGE of version {version}, and version {VERSION} is read"));
        }
        let [n_components, scalar, endian, space] = reader.array()?;
        let (_, scalar, n_bytes, _) = Scalar::ALL
            .into_iter()
            .find(|row| row.0 == scalar)
            .ok_or_else(|| format!("its scalars are of the type {scalar}, which the protocol does not have"))?;
        if n_components == 0 || !(1..=2).contains(&endian) || !(1..=2).contains(&space) {
            return Err(format!(
                "{n_components} components, byte order {endian} and coordinates {space}; at least one component and 1 or 2 each are \
                 expected"
            ));
        }
        let triple = |reader: &mut Reader<'_>| Ok::<_, String>([reader.u16()?, reader.u16()?, reader.u16()?]);
        let (size, matrix) = (triple(reader)?, Affine(reader.floats()?));
        let (part_offset, part_size) = (triple(reader)?, triple(reader)?);
        let is_inside = |k: usize| u32::from(part_offset[k]) + u32::from(part_size[k]) <= u32::from(size[k]);
        if !(0..3).all(is_inside) {
            return Err(format!(
                "the part of {part_size:?} pixels at {part_offset:?} is outside of its {size:?} pixels"
            ));
        }
        // Three numbers of 16 bits, one of 8 and at most 8 bytes do not overflow 64 bits.
        let expected =
            part_size.iter().map(|&n| u64::from(n)).product::<u64>() * u64::from(n_components) * n_bytes as u64;
        if expected != reader.left() as u64 {
            return Err(format!("{} bytes of pixels are there, and its size asks for {expected}", reader.left()));
        }
        let pixels = reader.take(reader.left())?.to_vec();
        let (is_little_endian, is_lps) = (endian == LITTLE, space == 2);
        Ok(Self { n_components, scalar, is_lps, size, matrix, part_offset, part_size, is_little_endian, pixels })
    }

    pub(super) fn put(&self, out: &mut Vec<u8>) -> Result<(), EncodeError> {
        let n_pixels = self.part_size.iter().map(|&n| usize::from(n)).product::<usize>();
        let expected = n_pixels * usize::from(self.n_components) * self.scalar.n_bytes();
        if expected != self.pixels.len() {
            return Err(EncodeError(format!(
                "{} have {expected} bytes, and {} are given",
                self.form(),
                self.pixels.len()
            )));
        }
        out.reserve(HEAD_BYTES + expected);
        out.extend(VERSION.to_be_bytes());
        let endian = if self.is_little_endian { LITTLE } else { 1 };
        out.extend([self.n_components, self.scalar.row().0, endian, if self.is_lps { 2 } else { 1 }]);
        let put = |out: &mut Vec<u8>, triple: [u16; 3]| triple.iter().for_each(|n| out.extend(n.to_be_bytes()));
        put(out, self.size);
        put_floats(out, &self.matrix.0);
        put(out, self.part_offset);
        put(out, self.part_size);
        out.extend(&self.pixels);
        Ok(())
    }
}

/// A number of its bytes, as many as its type has.
fn number(scalar: Scalar, bytes: &[u8], is_little: bool) -> f64 {
    let mut word = [0; 8];
    let n = bytes.len().min(8);
    word[..n].copy_from_slice(&bytes[..n]);
    if !is_little {
        word[..n].reverse();
    }
    let bits = u64::from_le_bytes(word);
    match scalar {
        Scalar::I8 => f64::from(bits as i8),
        Scalar::U8 => f64::from(bits as u8),
        Scalar::I16 => f64::from(bits as i16),
        Scalar::U16 => f64::from(bits as u16),
        Scalar::I32 => f64::from(bits as i32),
        Scalar::U32 => f64::from(bits as u32),
        Scalar::F32 => f64::from(f32::from_bits(bits as u32)),
        Scalar::F64 => f64::from_bits(bits),
    }
}
