//! JPEG images, as cameras' programs write them.

use crate::pixels::{MAX_BYTES, Pixels};
use zune_jpeg::{
    JpegDecoder,
    zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions},
};

/// The most pixels that a byte of a JPEG file can hold: a unit of 32 x 32 pixels takes at least a bit of each component.
const MAX_PIXELS_PER_BYTE: usize = 4096;

/// Markers of the end of an image, and of the segment that holds Exif.
const END: [u8; 2] = [0xff, 0xd9];
/// The tag of the orientation in Exif.
const ORIENTATION: u16 = 0x0112;

/// The pixels of a JPEG file: 8 bits, baseline or progressive, grey or colour. `O(pixels)`.
///
/// # Errors
/// What is wrong or not read, as a sentence without a subject. A file that was cut short is refused, never filled with grey; only of one
/// that was cut and given an end of its own, the last blocks, the last interval between restarts, or the later scans of a progressive
/// file may be missing. Refused is, too, one that asks to be turned or mirrored: viewers do that, and which pixels a calibration means is not known then.
pub(crate) fn read_jpeg(data: &[u8]) -> Result<Pixels, String> {
    let wrong = |error: &dyn std::fmt::Display| format!("cannot be read: {error}");
    // Some cameras pad with zeros.
    let n_used = data.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    if !data[..n_used].ends_with(&END) {
        return Err(format!("of {} bytes has no end (ff d9); was it cut short?", data.len()));
    }
    let options = DecoderOptions::default().set_strict_mode(true).set_use_unsafe(false);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(data), options);
    decoder.decode_headers().map_err(|error| wrong(&error))?;
    let info = decoder.info().ok_or("has no header")?;
    let (width, height) = (usize::from(info.width), usize::from(info.height));
    let (channels, colours) = match info.components {
        1 => (1, ColorSpace::Luma),
        3 => (3, ColorSpace::RGB),
        n => return Err(format!("has {n} components (CMYK?); grey and colour are read")),
    };
    if width * height > data.len().saturating_mul(MAX_PIXELS_PER_BYTE) || width * height * channels > MAX_BYTES {
        return Err(format!("claims {width} x {height} pixels, more than {} bytes can hold", data.len()));
    }
    if let Some(turned) = info.exif_data.as_deref().and_then(orientation).filter(|turned| *turned != 1) {
        return Err(format!(
            "is to be turned or mirrored (Exif orientation {turned}), and which pixels its calibration means is not known; record it as \
             the sensor gives it, without that tag"
        ));
    }
    // At its end the decoder goes on with zeros: a picture cut short, with an end of its own, would be filled with grey. Of data
    // without an end it finds that they are exhausted.
    let data = if info.sof.is_progressive() { data } else { &data[..n_used - END.len()] };
    let options = options.jpeg_set_out_colorspace(colours);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(data), options);
    let bytes = decoder.decode().map_err(|error| wrong(&error))?;
    if bytes.len() != width * height * channels {
        return Err(format!("gives {} bytes for {width} x {height} pixels of {channels}", bytes.len()));
    }
    Ok(Pixels { width: width as u32, height: height as u32, channels: channels as u32, bytes })
}

/// The orientation in the first directory of Exif, 1 (as it is) to 8.
///
/// # Source
/// Exif 2.32, sections 4.5.4 and 4.6.4; TIFF 6.0, section 2.
fn orientation(exif: &[u8]) -> Option<u16> {
    let tiff = exif.strip_prefix(b"Exif\0\0").unwrap_or(exif);
    let little = match tiff.get(..2)? {
        b"II" => true,
        b"MM" => false,
        _ => return None,
    };
    let u16_at = |at: usize| {
        let bytes = tiff.get(at..at.checked_add(2)?)?.try_into().ok()?;
        Some(if little { u16::from_le_bytes(bytes) } else { u16::from_be_bytes(bytes) })
    };
    let u32_at = |at: usize| {
        let bytes = tiff.get(at..at.checked_add(4)?)?.try_into().ok()?;
        Some(if little { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) })
    };
    let first = u32_at(4)? as usize;
    (0..usize::from(u16_at(first)?))
        .map(|entry| first + 2 + 12 * entry)
        .find(|entry| u16_at(*entry) == Some(ORIENTATION))
        .and_then(|entry| u16_at(entry + 8))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::png::read_png;

    macro_rules! file {
        ($name:literal) => {
            &include_bytes!(concat!("../tests/data/jpeg/", $name))[..]
        };
    }

    #[test]
    fn what_opencv_and_pillow_wrote_is_read_as_opencv_reads_it() {
        let files = [
            ("grey", file!("grey.jpg"), file!("grey.png"), 1),
            ("4:2:0", file!("colour_420.jpg"), file!("colour_420.png"), 3),
            ("4:2:2 with restarts", file!("colour_422_restarts.jpg"), file!("colour_422_restarts.png"), 3),
            ("4:4:4, progressive", file!("colour_444_progressive.jpg"), file!("colour_444_progressive.png"), 3),
            ("red, green, blue", file!("colour_rgb.jpg"), file!("colour_rgb.png"), 3),
            // By Pillow, of the same pixels as 4:2:0 of OpenCV.
            ("with Exif", file!("colour_exif.jpg"), file!("colour_420.png"), 3),
        ];
        for (what, jpeg, png, channels) in files {
            let (read, expected) = (read_jpeg(jpeg).unwrap(), read_png(png).unwrap());
            assert_eq!((read.width, read.height, read.channels), (37, 22, channels), "{what}");
            assert_eq!((expected.width, expected.height, expected.channels), (37, 22, channels), "{what}");
            let off = |(a, b): (&u8, &u8)| a.abs_diff(*b);
            let largest = read.bytes.iter().zip(&expected.bytes).map(off).max().unwrap();
            // Decoders round the transform and blend halved colours in their own ways.
            assert!(largest <= 4, "{what}: {largest} levels");
        }
    }

    #[test]
    fn a_file_cut_at_any_byte_is_refused_and_never_filled_up() {
        for file in
            [file!("colour_420.jpg"), file!("colour_444_progressive.jpg"), file!("grey.jpg"), file!("colour_exif.jpg")]
        {
            for n in 0..file.len() {
                assert!(read_jpeg(&file[..n]).is_err(), "{n} of {} bytes", file.len());
            }
            let padded = [file, &[0; 9]].concat();
            assert_eq!(read_jpeg(&padded), read_jpeg(file));
        }
    }

    #[test]
    fn a_file_that_was_cut_and_given_an_end_is_not_filled_with_grey() {
        for file in [file!("colour_420.jpg"), file!("grey.jpg"), file!("colour_exif.jpg")] {
            // What is decoded ahead of the end are the last blocks.
            for n in file.len() / 2..file.len() - 24 {
                let ended = [&file[..n], &END].concat();
                assert!(read_jpeg(&ended).is_err(), "{n} of {} bytes, ended", file.len());
            }
        }
    }

    #[test]
    fn turned_and_printed_pictures_are_refused_by_name() {
        let refused = |data: &[u8]| read_jpeg(data).unwrap_err();
        assert!(refused(file!("turned.jpg")).contains("(Exif orientation 6)"));
        assert!(refused(file!("cmyk.jpg")).contains("has 4 components (CMYK?)"));
        assert!(refused(b"").contains("has no end (ff d9)"));
        assert!(refused(b"\x89PNG\r\n\x1a\n").contains("has no end"));
    }

    #[test]
    fn a_header_that_claims_more_than_its_bytes_can_hold_is_refused() {
        let mut huge = file!("colour_420.jpg").to_vec();
        let frame = huge.windows(2).position(|marker| marker == [0xff, 0xc0]).unwrap();
        huge[frame + 5..frame + 9].copy_from_slice(&[0x3f, 0xff, 0x3f, 0xff]);
        assert!(read_jpeg(&huge).unwrap_err().contains("claims 16383 x 16383 pixels"), "{:?}", read_jpeg(&huge));
    }

    #[test]
    fn what_is_damaged_never_panics() {
        for file in [file!("colour_420.jpg"), file!("colour_444_progressive.jpg"), file!("colour_exif.jpg")] {
            for at in 0..file.len() {
                for flip in [0x01, 0x80, 0xff] {
                    let mut damaged = file.to_vec();
                    damaged[at] ^= flip;
                    let _ = read_jpeg(&damaged);
                }
            }
        }
    }
}
