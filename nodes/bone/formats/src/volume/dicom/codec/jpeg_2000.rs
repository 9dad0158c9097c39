//! JPEG 2000, by the crate `hayro-jpeg2000`.
//!
//! # Source
//! ITU-T T.800, annexes A and G; DICOM PS3.5 section 8.2.4.

use hayro_jpeg2000::{DecodeSettings, DecoderContext, Image};

/// Pixels of a frame beyond which no CT goes: 4096 x 4096. A few bytes may stand for any number of equal ones.
const MAX_PIXELS: usize = 1 << 24;

/// Tiles of an image: each has a number of 16 bits (T.800, A.4.2).
const MAX_TILES: usize = (1 << 16) - 1;
/// Precincts of an image, of all resolutions: 4096 x 4096 pixels in those of 16 x 16, and as many again.
const MAX_PRECINCTS: usize = 1 << 17;

/// What is stored for each pixel of a frame of columns and rows.
pub(in super::super) fn decode(frame: &[u8], [n_columns, n_rows]: [usize; 2]) -> Result<Vec<u32>, String> {
    let codestream = codestream(frame)?;
    let size = Size::read(codestream)?;
    if size.size != [n_columns, n_rows] {
        let [nx, ny] = size.size;
        return Err(format!(
            "the JPEG 2000 has {nx} x {ny} pixels, the image {n_columns} x {n_rows}; export the series again"
        ));
    }
    if n_columns * n_rows > MAX_PIXELS {
        return Err(format!("{n_columns} x {n_rows} pixels in JPEG 2000; at most {MAX_PIXELS} are read"));
    }
    check_segments(codestream, size.size)?;
    let broken = |error: &dyn std::fmt::Display| format!("JPEG 2000: {error}; copy the file again");
    let settings = DecodeSettings { resolve_palette_indices: false, strict: true, target_resolution: None };
    let image = Image::new(codestream, &settings).map_err(|error| broken(&error))?;
    let mut context = DecoderContext::default();
    let decoded = image.decode(&mut context).map_err(|error| broken(&error))?;
    let [component] = decoded.components() else {
        return Err(format!("{} values per pixel in the JPEG 2000; 1 is read", decoded.components().len()));
    };
    let samples = component.samples();
    if samples.len() != n_columns * n_rows {
        return Err(format!("JPEG 2000: {} values for {n_columns} x {n_rows} pixels", samples.len()));
    }
    // The decoder lifts all values by half of their range, as unsigned ones need it, and signed ones do not.
    let half = f64::from(1u32 << (size.precision - 1));
    let (low, high, lift) = if size.is_signed { (-half, half - 1.0, half) } else { (0.0, 2.0 * half - 1.0, 0.0) };
    let cell = |sample: &f32| (f64::from(*sample) - lift).round().clamp(low, high) as i32 as u32;
    Ok(samples.iter().map(cell).collect())
}

/// The codestream, which may be in a JP2 file.
fn codestream(frame: &[u8]) -> Result<&[u8], String> {
    const START: &[u8] = b"\xff\x4f\xff\x51";
    if frame.starts_with(START) {
        return Ok(frame);
    }
    let is_file = frame.get(4..8) == Some(b"jP  ");
    let start = frame.windows(4).position(|window| window == START).filter(|_| is_file);
    start.map(|start| &frame[start..]).ok_or_else(|| {
        "the pixels are no JPEG 2000, though the transfer syntax says so; export the series again".into()
    })
}

/// What the codestream says of its only component.
struct Size {
    size: [usize; 2],
    precision: u32,
    is_signed: bool,
}

impl Size {
    fn read(codestream: &[u8]) -> Result<Self, String> {
        let cut = || "the JPEG 2000 is cut short before its data; copy the file again".to_owned();
        let number = |at: usize, n: usize| {
            let bytes = codestream.get(at..at + n).ok_or_else(cut)?;
            Ok::<_, String>(bytes.iter().fold(0usize, |sum, byte| sum << 8 | usize::from(*byte)))
        };
        let [right, bottom, left, top] = [number(8, 4)?, number(12, 4)?, number(16, 4)?, number(20, 4)?];
        let (n_components, depth) = (number(40, 2)?, number(42, 1)?);
        let precision = (depth & 0x7f) as u32 + 1;
        if n_components != 1 || precision > 16 {
            return Err(format!(
                "{n_components} values per pixel of {precision} bits in the JPEG 2000; 1 of up to 16 bits is read"
            ));
        }
        let [width, height, tiles_left, tiles_top] = [number(24, 4)?, number(28, 4)?, number(32, 4)?, number(36, 4)?];
        let along = |end: usize, begin: usize, edge: usize| end.saturating_sub(begin).checked_div(edge);
        let n_tiles = along(right + width.saturating_sub(1), tiles_left, width)
            .zip(along(bottom + height.saturating_sub(1), tiles_top, height))
            .map_or(usize::MAX, |(across, down)| across.saturating_mul(down));
        if n_tiles > MAX_TILES {
            return Err(format!(
                "tiles of {width} x {height} pixels in the JPEG 2000, more than its numbers can count ({MAX_TILES}); copy the file again"
            ));
        }
        Ok(Self {
            size: [right.saturating_sub(left), bottom.saturating_sub(top)],
            precision,
            is_signed: depth & 0x80 != 0,
        })
    }
}

/// Checks that all tile parts are there, as a decoder fills up what is missing with values near zero, and that none divides the image into
/// more precincts than memory may hold.
fn check_segments(codestream: &[u8], size: [usize; 2]) -> Result<(), String> {
    let number = |at: usize, n: usize| {
        let bytes = codestream.get(at..at + n)?;
        Some(bytes.iter().fold(0usize, |sum, byte| sum << 8 | usize::from(*byte)))
    };
    let cut = |at: usize| {
        format!("the JPEG 2000 is cut short: part of a tile is missing from byte {at} of it on; copy the file again")
    };
    // Where the tile part that is read ends.
    let (mut at, mut end) = (2, 0);
    loop {
        match number(at, 2) {
            // A tile part, which says how long it is; 0: up to the end.
            Some(0xff90) => {
                end = match number(at + 6, 4).ok_or_else(|| cut(at))? {
                    0 => end_mark(codestream).ok_or_else(|| cut(codestream.len()))?,
                    length if length < 12 || at + length > codestream.len() => return Err(cut(at)),
                    length => at + length,
                };
                at += 12;
            }
            // The data of a tile part, which are behind its header.
            Some(0xff93) if end > at => at = end,
            Some(0xffd9) => return Ok(()),
            Some(marker @ 0xff30..=0xffff) => {
                let length = number(at + 2, 2).ok_or_else(|| cut(at))?.max(2);
                let segment = codestream.get(at + 4..at + 2 + length).ok_or_else(|| cut(at))?;
                // COD and COC, whose numbers begin behind those of all components and of one.
                match marker {
                    0xff52 => check_precincts(segment, 5, size)?,
                    0xff53 => check_precincts(segment.get(1..).unwrap_or_default(), 1, size)?,
                    _ => {}
                }
                at += 2 + length;
            }
            _ => return Err(cut(at)),
        }
    }
}

/// Checks the number of precincts that a coding style states (T.800, A.6.1); `at` is where its number of levels is.
fn check_precincts(style: &[u8], at: usize, size: [usize; 2]) -> Result<(), String> {
    let has_sizes = style.first().is_some_and(|flags| flags & 1 == 1);
    let (Some(&levels), Some(sizes)) = (style.get(at), style.get(at + 5..).filter(|_| has_sizes)) else {
        return Ok(());
    };
    let n_of = |(resolution, exponents): (usize, &u8)| {
        let less = u32::from(levels).saturating_sub(resolution as u32);
        let along = |n: usize, exponent: u8| n.div_ceil(1 << less.min(31)).div_ceil(1 << exponent);
        along(size[0], exponents & 15) * along(size[1], exponents >> 4)
    };
    let n: usize = sizes.iter().enumerate().map(n_of).sum();
    if n > MAX_PRECINCTS {
        return Err(format!("{n} precincts in the JPEG 2000; at most {MAX_PRECINCTS} are read"));
    }
    Ok(())
}

/// Where the mark of the end is, with at most the zero behind it that makes the length even.
fn end_mark(codestream: &[u8]) -> Option<usize> {
    const END: [u8; 2] = [0xff, 0xd9];
    let all = if codestream.ends_with(&END) { codestream } else { codestream.strip_suffix(&[0])? };
    all.ends_with(&END).then(|| all.len() - END.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A codestream of one component of 512 x 512 pixels, with this edge of a tile, and precincts of these exponents.
    fn header(tile: u32, precincts: &[u8]) -> Vec<u8> {
        let numbers = [512, 512, 0, 0, tile, tile, 0, 0];
        let size = numbers.iter().flat_map(|n: &u32| n.to_be_bytes()).chain([0, 1, 15, 1, 1]);
        let mut bytes = vec![0xff, 0x4f, 0xff, 0x51, 0, 41, 0, 0];
        bytes.extend(size);
        let levels = precincts.len().saturating_sub(1) as u8;
        bytes.extend([0xff, 0x52, 0, 12 + precincts.len() as u8, u8::from(!precincts.is_empty()), 0, 0, 1, 0]);
        bytes.extend([levels, 4, 4, 0, 1]);
        bytes.extend(precincts);
        bytes.extend([0xff, 0xd9]);
        bytes
    }

    #[test]
    fn more_tiles_than_have_numbers_and_precincts_that_fill_the_memory_are_refused_before_they_are_made() {
        let of = |tile, precincts: &[u8]| {
            let bytes = header(tile, precincts);
            Size::read(&bytes).and_then(|size| check_segments(&bytes, size.size))
        };
        for (tile, precincts) in [(512, &[][..]), (4, &[]), (512, &[0x11, 0x22, 0x33])] {
            assert_eq!(of(tile, precincts), Ok(()), "{tile}, {precincts:?}");
        }
        for tile in [0, 1, 2] {
            let said = of(tile, &[]).unwrap_err();
            assert!(
                said.starts_with(&format!("tiles of {tile} x {tile} pixels in the JPEG 2000, more than")),
                "{said}"
            );
        }
        // One and four pixels each.
        assert_eq!(of(512, &[0x00]).unwrap_err(), "262144 precincts in the JPEG 2000; at most 131072 are read");
        assert!(of(512, &[0x00, 0x00]).unwrap_err().starts_with("327680 precincts"));
    }
}
