//! PNG images, as cameras' programs write them.

use crate::pixels::{MAX_BYTES, Pixels};
use png::{BitDepth, ColorType, Decoder, Limits, Transformations};
use std::io::Cursor;

/// The most bytes that a byte of deflated data becomes (RFC 1951: 258 bytes of two bits), rounded up.
const MAX_RATIO: usize = 1032;

/// The pixels of a PNG file: 8 bits, grey or colour; a palette becomes colours, an alpha channel is left out. `O(pixels)`.
///
/// # Errors
/// What is wrong or not read, as a sentence without a subject.
pub(crate) fn read_png(data: &[u8]) -> Result<Pixels, String> {
    let wrong = |error: png::DecodingError| format!("cannot be read: {error}");
    let mut decoder = Decoder::new_with_limits(Cursor::new(data), Limits { bytes: MAX_BYTES });
    decoder.set_transformations(Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(wrong)?;
    if reader.info().bit_depth == BitDepth::Sixteen {
        return Err("has 16 bits per channel; at most 8 are read".into());
    }
    let (width, height) = reader.info().size();
    let n_packed = (reader.info().raw_row_length() - 1).checked_mul(height as usize);
    if n_packed.is_none_or(|n| n > data.len().saturating_mul(MAX_RATIO)) {
        return Err(format!("claims {width} x {height} pixels, more than {} bytes can hold", data.len()));
    }
    let n_bytes = reader.output_buffer_size().filter(|n| *n <= MAX_BYTES);
    let mut bytes = vec![0; n_bytes.ok_or("has too many pixels")?];
    let info = reader.next_frame(&mut bytes).map_err(wrong)?;
    reader.finish().map_err(wrong)?;
    let (channels, n_bytes) = match info.color_type {
        ColorType::Grayscale => (1, 1),
        ColorType::GrayscaleAlpha => (1, 2),
        ColorType::Rgb => (3, 3),
        ColorType::Rgba => (3, 4),
        ColorType::Indexed => return Err("has a palette that is not resolved".into()),
    };
    if n_bytes > channels {
        bytes = bytes.chunks_exact(n_bytes).flat_map(|pixel| pixel[..channels].iter().copied()).collect();
    }
    Ok(Pixels { width: info.width, height: info.height, channels: channels as u32, bytes })
}

#[cfg(test)]
mod tests {
    use super::*;
    use png::Encoder;

    fn written(color: ColorType, depth: BitDepth, bytes: &[u8]) -> Vec<u8> {
        let mut file = Vec::new();
        let mut encoder = Encoder::new(&mut file, 7, 11);
        encoder.set_color(color);
        encoder.set_depth(depth);
        encoder.add_text_chunk("Software".into(), "a camera".into()).unwrap();
        encoder.write_header().unwrap().write_image_data(bytes).unwrap();
        file
    }

    fn noise(n: usize) -> Vec<u8> {
        (0..n).map(|i| (i * i * 31 + i * 7) as u8).collect()
    }

    #[test]
    fn colour_and_grey_are_read_and_alpha_is_left_out() {
        use ColorType::{Grayscale, GrayscaleAlpha, Rgb, Rgba};
        for (color, n_bytes, channels) in [(Grayscale, 1, 1), (Rgb, 3, 3), (GrayscaleAlpha, 2, 1), (Rgba, 4, 3)] {
            let bytes = noise(7 * 11 * n_bytes);
            let read = read_png(&written(color, BitDepth::Eight, &bytes)).unwrap();
            let expected: Vec<u8> = bytes.chunks(n_bytes).flat_map(|p| p[..channels].to_vec()).collect();
            assert_eq!(read, Pixels { width: 7, height: 11, channels: channels as u32, bytes: expected }, "{color:?}");
        }
    }

    #[test]
    fn what_is_damaged_is_refused_or_read_as_it_was() {
        let good = written(ColorType::Rgb, BitDepth::Eight, &noise(7 * 11 * 3));
        let whole = read_png(&good).unwrap();
        for at in 0..good.len() {
            let mut damaged = good.clone();
            damaged[at] ^= 0x10;
            // A text beside the image may be damaged.
            assert!(read_png(&damaged).map_or(true, |read| read == whole), "byte {at}");
            assert!(read_png(&good[..at]).is_err(), "cut at {at}");
        }
        assert!(read_png(b"\xff\xd8\xff\xe0").is_err(), "JPEG");
        let deep = written(ColorType::Rgb, BitDepth::Sixteen, &noise(7 * 11 * 6));
        assert_eq!(read_png(&deep), Err("has 16 bits per channel; at most 8 are read".into()));
    }

    #[test]
    fn a_header_that_claims_more_than_its_bytes_can_hold_is_refused_before_memory_is_taken() {
        let good = written(ColorType::Rgb, BitDepth::Eight, &noise(7 * 11 * 3));
        for (width, height) in
            [(7_u32, 1 << 16), (1 << 12, 1 << 15), (1 << 15, 1 << 15), (u32::MAX >> 1, u32::MAX >> 1)]
        {
            let mut huge = good.clone();
            huge[16..20].copy_from_slice(&width.to_be_bytes());
            huge[20..24].copy_from_slice(&height.to_be_bytes());
            let mut crc = flate2::Crc::new();
            crc.update(&huge[12..29]);
            huge[29..33].copy_from_slice(&crc.sum().to_be_bytes());
            let error = read_png(&huge).unwrap_err();
            let expected = format!("claims {width} x {height} pixels, more than {} bytes can hold", huge.len());
            assert!(
                error == expected || error.contains("limits are exceeded") || error == "has too many pixels",
                "{error}"
            );
        }
        // The most that deflate can do is not too much.
        let white = vec![0; 7 * 11 * 3];
        assert_eq!(read_png(&written(ColorType::Rgb, BitDepth::Eight, &white)).unwrap().bytes, white);
        let mut file = Vec::new();
        let mut encoder = Encoder::new(&mut file, 8000, 4000);
        encoder.set_color(ColorType::Grayscale);
        encoder.set_depth(BitDepth::One);
        encoder.set_compression(png::Compression::High);
        encoder.write_header().unwrap().write_image_data(&vec![0; 1000 * 4000]).unwrap();
        assert_eq!(read_png(&file).unwrap().bytes.len(), 8000 * 4000, "in {} bytes", file.len());
    }
}
