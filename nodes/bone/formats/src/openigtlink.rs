//! Messages of OpenIGTLink, header versions 1 and 2 (protocol versions 1 to 3), as bytes and back.
//!
//! Lengths are millimetres, as in the protocol; numbers are single precision, which is 0.00003 mm at 500 mm and 0.00006 mm at
//! 1 m. The protocol does not state axes: a transform is between frames that its sender named, and coordinates in the frame of
//! a patient are RAS by the convention of 3D Slicer. [`Space`](crate::Space) converts.
//!
//! The CRC of a message covers its body, not its header: a flipped bit in the body is always found, one in the name of a
//! device or in a stamp is not.
//!
//! | Type | Decoded | Encoded |
//! |---|---|---|
//! | TRANSFORM | yes | yes |
//! | TDATA | yes | yes |
//! | POSITION | position alone, with a quaternion of 3 or 4 numbers, and the list of named positions that pyigtl sends | one, with 4 numbers |
//! | POINT | yes | yes |
//! | POLYDATA | yes | yes |
//! | IMAGE | yes | yes |
//! | STATUS | yes | yes |
//! | STRING | yes | yes |
//! | STT_TDATA | yes | yes |
//! | any other | type and size | no |
//!
//! ```
//! use osteoflow_formats::openigtlink::{Affine, Body, Decoder, Message};
//! use nalgebra::Isometry3;
//!
//! let t_reference_stylus = Isometry3::translation(10.0, 20.0, 30.0);
//! let sent = Message::new("StylusToReference", 1_750_000_011_000_000_000, Body::Transform(Affine::of(&t_reference_stylus)));
//! let mut decoder = Decoder::default();
//! decoder.push(&sent.to_bytes()?);
//! assert_eq!(decoder.next(), Some(Ok(sent)));
//! # Ok::<(), osteoflow_formats::openigtlink::EncodeError>(())
//! ```

mod bytes;
mod clock;
mod content;
mod crc;
mod decoder;
mod header;
mod image;
mod metadata;
mod poly_data;

pub use crate::scalar::{NO_DEPTH_16, Scalar};
pub use bytes::EncodeError;
pub use clock::{ClockNote, ClockOffset};
pub use content::{Affine, Body, Fiducial, Position, Status, TrackedTool};
pub use crc::crc64;
pub use decoder::{Damage, Decoder};
pub use header::{HEADER_BYTES, MAX_BODY_BYTES};
pub use image::PixelImage;
pub use metadata::{Extended, Metadata};
pub use poly_data::{Attribute, Cells, PolyData};

use bytes::{Reader, put_name};
use header::Header;
use osteoflow_geometry::StampNs;

/// Longest name of a device.
pub const MAX_DEVICE_BYTES: usize = 20;

/// A message.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    /// The name of the device, at most [`MAX_DEVICE_BYTES`].
    pub device: String,
    /// The sender's time since the Unix epoch; 0 if it gives none. The protocol has fractions of 2⁻³² s, so a nanosecond
    /// survives.
    pub stamp_ns: StampNs,
    /// Message number and metadata of header version 2; `None` is header version 1.
    pub extended: Option<Extended>,
    /// The content.
    pub body: Body,
}

impl Message {
    /// A message of header version 1.
    pub fn new(device: impl Into<String>, stamp_ns: StampNs, body: Body) -> Self {
        Self { device: device.into(), stamp_ns, extended: None, body }
    }

    /// The message in header version 2, with this number and metadata.
    pub fn extended(mut self, message_id: u32, metadata: Vec<Metadata>) -> Self {
        self.extended = Some(Extended { message_id, metadata });
        self
    }

    /// The value of a key of the metadata.
    pub fn metadata(&self, key: &str) -> Option<&str> {
        let metadata = &self.extended.as_ref()?.metadata;
        metadata.iter().find(|entry| entry.key == key).map(|entry| entry.value.as_str())
    }

    /// The bytes of the message.
    ///
    /// # Errors
    /// [`EncodeError`] if a text, a stamp or the content does not fit.
    pub fn to_bytes(&self) -> Result<Vec<u8>, EncodeError> {
        let mut body = Vec::new();
        match &self.extended {
            None => self.body.put(&mut body)?,
            Some(extended) => extended.put(&mut body, |out| self.body.put(out))?,
        }
        if body.len() > MAX_BODY_BYTES {
            return Err(EncodeError(format!("a body of {} bytes, and {MAX_BODY_BYTES} are the limit", body.len())));
        }
        let mut out = Vec::with_capacity(HEADER_BYTES + body.len());
        out.extend(if self.extended.is_some() { 2u16 } else { 1 }.to_be_bytes());
        put_name(&mut out, "the type", self.body.type_name(), 12)?;
        put_name(&mut out, "the device", &self.device, MAX_DEVICE_BYTES)?;
        let stamp_ns = self.stamp_ns;
        let timestamp = header::timestamp(stamp_ns).ok_or_else(|| {
            EncodeError(format!(
                "the stamp {stamp_ns} ns does not fit a timestamp, which begins in 1970 and ends in 2106"
            ))
        })?;
        out.extend(timestamp.to_be_bytes());
        out.extend((body.len() as u64).to_be_bytes());
        out.extend(crc64(&body).to_be_bytes());
        out.extend(body);
        Ok(out)
    }

    /// The message of a header and its body, whose CRC is right.
    fn parse(header: &Header, body: &[u8]) -> Result<Self, String> {
        let (extended, content) = match header.version {
            1 => (None, body),
            _ => {
                let (extended, content) = Extended::parse(body)?;
                (Some(extended), content)
            }
        };
        let mut reader = Reader::new(content);
        let body = Body::parse(&header.type_name, &mut reader)?;
        if reader.left() > 0 {
            return Err(format!("{} bytes are left after its content", reader.left()));
        }
        Ok(Self { device: header.device.clone(), stamp_ns: header.stamp_ns, extended, body })
    }
}

/// The device of the pose `t_to_from` as PLUS names it: `CameraMarkerToWorld` takes coordinates in `camera_marker` to `world`.
pub fn device_name(to: &str, from: &str) -> String {
    format!("{}To{}", device_word(from), device_word(to))
}

/// A name as a part of a device: `CameraMarker` of `camera_marker`.
pub fn device_word(name: &str) -> String {
    let capitalized = |word: &str| {
        let mut letters = word.chars();
        letters.next().map(|first| first.to_uppercase().chain(letters).collect()).unwrap_or_default()
    };
    name.split(['_', '-', '.']).map(capitalized).collect::<Vec<String>>().concat()
}

#[cfg(test)]
mod tests;
