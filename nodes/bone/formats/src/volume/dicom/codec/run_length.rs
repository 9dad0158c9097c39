//! Run-length encoding.
//!
//! # Source
//! DICOM PS3.5, annex G.

/// Decodes one frame: segments of the most significant bytes first, each packed.
pub(in super::super) fn decode(frame: &[u8], n: usize, width: usize) -> Result<Vec<u8>, String> {
    let word = |k: usize| frame.get(4 * k..4 * k + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    let n_segments = word(0).ok_or("the run-length header is cut short")?;
    if n_segments != width {
        return Err(format!("{n_segments} run-length segments for values of {width} bytes"));
    }
    // Packing gives at most 128 bytes for two.
    if n * width > frame.len().saturating_mul(64) {
        return Err(format!("cut short: {} run-length bytes cannot hold {n} values of {width} bytes", frame.len()));
    }
    let mut cells = vec![0u8; n * width];
    for segment in 0..width {
        let start = word(segment + 1).unwrap_or(usize::MAX);
        let end = if segment + 1 < width { word(segment + 2).unwrap_or(0) } else { frame.len() };
        let packed =
            frame.get(start..end).filter(|_| start >= 64).ok_or("a run-length segment lies outside the frame")?;
        let (mut at, mut filled) = (0, 0);
        let place = |k: usize| k * width + (width - 1 - segment);
        while filled < n {
            let control = *packed
                .get(at)
                .ok_or_else(|| format!("cut short: run-length segment {segment} gives {filled} of {n} bytes"))?;
            at += 1;
            match control as i8 {
                count @ 0.. => {
                    let literal = packed.get(at..at + count as usize + 1).ok_or("a literal run is cut short")?;
                    for byte in literal.iter().take(n - filled) {
                        cells[place(filled)] = *byte;
                        filled += 1;
                    }
                    at += literal.len();
                }
                -128 => {}
                count => {
                    let byte = *packed.get(at).ok_or("a repeated run is cut short")?;
                    at += 1;
                    for _ in 0..(1 - i32::from(count)).min((n - filled) as i32) {
                        cells[place(filled)] = byte;
                        filled += 1;
                    }
                }
            }
        }
    }
    Ok(cells)
}
