//! JPEG lossless (process 14), by the crate `jpeg-decoder`.
//!
//! # Source
//! ITU-T T.81, annexes B and H; DICOM PS3.5 section 8.2.1.

use jpeg_decoder::{CodingProcess, Decoder};

/// Why a frame is not read.
pub(in super::super) enum Unread {
    /// It is of a kind that the decoder would decode wrongly without a word.
    Kind(&'static str),
    /// It is damaged, with a sentence.
    Broken(String),
}

impl From<String> for Unread {
    fn from(message: String) -> Self {
        Self::Broken(message)
    }
}

/// What is stored for each pixel of a frame of columns and rows.
pub(in super::super) fn decode(frame: &[u8], [n_columns, n_rows]: [usize; 2]) -> Result<Vec<u32>, Unread> {
    let header = Header::read(frame)?;
    if header.size != [n_columns, n_rows] {
        let [nx, ny] = header.size;
        return Err(format!(
            "the JPEG has {nx} x {ny} pixels, the image {n_columns} x {n_rows}; export the series again"
        )
        .into());
    }
    // A pixel takes a bit at least.
    let n = n_columns * n_rows;
    if n > frame.len().saturating_mul(8) {
        return Err(
            format!("cut short: {} bytes of JPEG cannot hold {n} pixels; copy the file again", frame.len()).into()
        );
    }
    let broken = |error: &dyn std::fmt::Display| format!("JPEG lossless: {error}; copy the file again");
    let mut decoder = Decoder::new(frame);
    decoder.read_info().map_err(|error| broken(&error))?;
    if decoder.info().is_none_or(|info| info.coding_process != CodingProcess::Lossless) {
        return Err(broken(&"another process than lossless").into());
    }
    let bytes = decoder.decode().map_err(|error| broken(&error))?;
    // Values of up to eight bits are bytes, others two in the machine's order.
    let cells: Vec<u32> = if bytes.len() == n {
        bytes.into_iter().map(u32::from).collect()
    } else {
        bytes.chunks_exact(2).map(|pair| u32::from(u16::from_ne_bytes([pair[0], pair[1]]))).collect()
    };
    if cells.len() != n {
        return Err(format!("JPEG lossless: {} values for {n} pixels; export the series again", cells.len()).into());
    }
    Ok(cells)
}

/// What a frame says before its data.
struct Header {
    size: [usize; 2],
}

impl Header {
    /// Reads the markers up to the data, and refuses what the decoder would decode wrongly without a word.
    fn read(frame: &[u8]) -> Result<Self, Unread> {
        let cut = || "the JPEG is cut short before its data; copy the file again".to_owned();
        let byte = |at: usize| frame.get(at).copied().map(usize::from).ok_or_else(cut);
        let word = |at: usize| Ok::<_, String>(byte(at)? << 8 | byte(at + 1)?);
        if word(0)? != 0xffd8 {
            return Err(Unread::Broken(
                "the pixels are no JPEG, though the transfer syntax says so; export the series again".into(),
            ));
        }
        let (mut at, mut size) = (2, None);
        loop {
            while byte(at)? == 0xff && byte(at + 1)? == 0xff {
                at += 1;
            }
            let (marker, length) = (word(at)?, word(at + 2)?);
            match marker {
                0xffc3 => {
                    if byte(at + 9)? != 1 {
                        return Err(Unread::Broken(format!(
                            "{} values per pixel in the JPEG; 1 is read",
                            byte(at + 9)?
                        )));
                    }
                    size = Some([word(at + 7)?, word(at + 5)?]);
                }
                0xffc0..=0xffcf if !matches!(marker, 0xffc4 | 0xffc8 | 0xffcc) => {
                    return Err(Unread::Kind("JPEG of another process than lossless"));
                }
                0xffdd if word(at + 4)? != 0 => {
                    return Err(Unread::Kind("JPEG lossless with restart intervals"));
                }
                0xffda => {
                    let n = byte(at + 4)?;
                    if byte(at + 7 + 2 * n)? & 15 != 0 {
                        return Err(Unread::Kind("JPEG lossless with a point transform"));
                    }
                    return size.map(|size| Self { size }).ok_or_else(|| cut().into());
                }
                0xff00.. => {}
                _ => return Err(Unread::Broken("a marker of the JPEG is damaged; copy the file again".into())),
            }
            at += 2 + length.max(2);
        }
    }
}
