//! The content of an IMAGE.

use super::{
    bytes::{EncodeError, Reader, put_floats},
    content::Affine,
};
use crate::scalar::{Rows, Scalar};
use nalgebra::{Matrix4, Vector3};

/// Bytes before the pixels.
const HEAD_BYTES: usize = 72;
/// Version of the content that is read and written.
const VERSION: u16 = 1;
/// The value of `endian` for numbers that are sent with their lowest byte first.
const LITTLE: u8 = 2;

/// The types of a component, by the protocol's number.
const TYPES: [(u8, Scalar); 8] = [
    (2, Scalar::I8),
    (3, Scalar::U8),
    (4, Scalar::I16),
    (5, Scalar::U16),
    (6, Scalar::I32),
    (7, Scalar::U32),
    (10, Scalar::F32),
    (11, Scalar::F64),
];

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
    pub fn values(&self) -> Vec<f64> {
        let rows = Rows { bytes: &self.pixels, stride: self.scalar.n_bytes(), big: !self.is_little_endian };
        rows.column(self.scalar, 0)
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
        let (_, scalar) = TYPES
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
        let expected = part_size.iter().map(|&n| u64::from(n)).product::<u64>()
            * u64::from(n_components)
            * scalar.n_bytes() as u64;
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
        let (code, _) = TYPES.into_iter().find(|(_, scalar)| *scalar == self.scalar).ok_or_else(|| {
            EncodeError(format!("an IMAGE has no components of {}; send float64", self.scalar.name()))
        })?;
        out.reserve(HEAD_BYTES + expected);
        out.extend(VERSION.to_be_bytes());
        let endian = if self.is_little_endian { LITTLE } else { 1 };
        out.extend([self.n_components, code, endian, if self.is_lps { 2 } else { 1 }]);
        let put = |out: &mut Vec<u8>, triple: [u16; 3]| triple.iter().for_each(|n| out.extend(n.to_be_bytes()));
        put(out, self.size);
        put_floats(out, &self.matrix.0);
        put(out, self.part_offset);
        put(out, self.part_size);
        out.extend(&self.pixels);
        Ok(())
    }
}
