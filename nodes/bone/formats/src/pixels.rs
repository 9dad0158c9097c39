//! Pixels of an image, without its camera.

/// The largest image that is unpacked: a file of a few bytes can claim any size.
pub(crate) const MAX_BYTES: usize = 1 << 29;

/// An image without its camera.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Pixels {
    /// Number of columns.
    pub(crate) width: u32,
    /// Number of rows.
    pub(crate) height: u32,
    /// Bytes of a pixel: 1 (grey) or 3 (red, green, blue).
    pub(crate) channels: u32,
    /// Row by row from the top left.
    pub(crate) bytes: Vec<u8>,
}

impl Pixels {
    /// Exchanges red and blue.
    pub(crate) fn swap_red_blue(&mut self) {
        if self.channels == 3 {
            self.bytes.chunks_exact_mut(3).for_each(|pixel| pixel.swap(0, 2));
        }
    }
}
