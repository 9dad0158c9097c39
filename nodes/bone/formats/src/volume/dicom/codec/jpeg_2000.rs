//! JPEG 2000, by the crate `hayro-jpeg2000`.
//!
//! # Source
//! ITU-T T.800, annexes A and G; DICOM PS3.5 section 8.2.4.

use hayro_jpeg2000::{DecodeSettings, DecoderContext, Image};

/// Pixels of a frame beyond which no CT goes: 4096 x 4096. A few bytes may stand for any number of equal ones.
const MAX_PIXELS: usize = 1 << 24;

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
    check_length(codestream)?;
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
        Ok(Self {
            size: [right.saturating_sub(left), bottom.saturating_sub(top)],
            precision,
            is_signed: depth & 0x80 != 0,
        })
    }
}

/// Checks that all tile parts are there: a decoder fills up what is missing with values near zero.
fn check_length(codestream: &[u8]) -> Result<(), String> {
    let number = |at: usize, n: usize| {
        let bytes = codestream.get(at..at + n)?;
        Some(bytes.iter().fold(0usize, |sum, byte| sum << 8 | usize::from(*byte)))
    };
    let cut = |at: usize| {
        format!("the JPEG 2000 is cut short: part of a tile is missing from byte {at} of it on; copy the file again")
    };
    let mut at = 2;
    loop {
        match number(at, 2) {
            // A tile part, which says how long it is; 0: up to the end.
            Some(0xff90) => match number(at + 6, 4).ok_or_else(|| cut(at))? {
                0 if is_ended(codestream) => return Ok(()),
                0 => return Err(cut(codestream.len())),
                length if length < 12 || at + length > codestream.len() => return Err(cut(at)),
                length => at += length,
            },
            Some(0xffd9) => return Ok(()),
            Some(0xff30..=0xffff) => at += 2 + number(at + 2, 2).ok_or_else(|| cut(at))?.max(2),
            _ => return Err(cut(at)),
        }
    }
}

/// Whether the mark of the end is there, with at most the zero behind it that makes the length even.
fn is_ended(codestream: &[u8]) -> bool {
    const END: [u8; 2] = [0xff, 0xd9];
    codestream.ends_with(&END) || codestream.strip_suffix(&[0]).is_some_and(|all| all.ends_with(&END))
}
