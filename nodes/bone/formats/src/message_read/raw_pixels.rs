//! Pixels without compression, by the encodings of ROS and Foxglove.

use crate::pixels::Pixels;
use crate::scalar::{NO_DEPTH_16, Scalar};
use bytes::Bytes;
use osteoflow_geometry::MM_PER_M;

/// Encodings of a picture that are read.
const PICTURES: &str = "rgb8, bgr8, rgba8, bgra8, 8UC3, mono8, 8UC1 and mono16 are";

/// Depth images farther than this in half of their pixels are in another unit.
const FARTHEST_SEEN_MM: f64 = 100.0 * MM_PER_M;

/// Pixels as a message has them.
pub(super) struct RawPixels {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) encoding: String,
    pub(super) big_endian: bool,
    /// Bytes from one row to the next.
    pub(super) step: u32,
    pub(super) data: Bytes,
}

impl RawPixels {
    /// The pixels in the order red, green, blue. 16 bits of grey become 8, of which the highest value is white in both.
    pub(super) fn picture(&self) -> Result<Pixels, String> {
        let (n_bytes, channels) = match self.encoding.as_str() {
            "rgb8" | "bgr8" | "8UC3" => (3, 3),
            "rgba8" | "bgra8" => (4, 3),
            "mono8" | "8UC1" => (1, 1),
            "mono16" => (2, 1),
            other => return Err(not_read(other)),
        };
        let rows = self.rows(n_bytes)?;
        let (width, height) = (self.width, self.height);
        let bytes: Vec<u8> = match (n_bytes, channels) {
            (4, _) => rows.flat_map(|row| row.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]])).collect(),
            (2, _) => {
                let white = f64::from(u16::MAX) / f64::from(u8::MAX);
                let grey = |p: &[u8]| (self.number(Scalar::U16, p) / white).round() as u8;
                rows.flat_map(|row| row.chunks_exact(2).map(grey).collect::<Vec<u8>>()).collect()
            }
            _ => rows.flatten().copied().collect(),
        };
        let mut pixels = Pixels { width, height, channels, bytes };
        // OpenCV's order where it is not named.
        if self.encoding.starts_with("bgr") || self.encoding == "8UC3" {
            pixels.swap_red_blue();
        }
        Ok(pixels)
    }

    /// Depth along the optical axis, mm, of each pixel; `None` where the camera measured none. `unit_mm` is the depth of one step;
    /// without it 16 bits are millimetres and floats metres. The highest value of 16 bits is no measurement.
    ///
    /// # Errors
    /// Another encoding, bytes that do not fill the image, or floats in metres of which half are beyond [`FARTHEST_SEEN_MM`].
    ///
    /// # Source
    /// REP 118 for the units, REP 117 for values that are no depth.
    pub(super) fn depths_mm(&self, unit_mm: Option<f64>) -> Result<Vec<Option<f64>>, String> {
        let (scalar, default_mm) = match self.encoding.as_str() {
            "16UC1" | "mono16" => (Scalar::U16, 1.0),
            "32FC1" => (Scalar::F32, MM_PER_M),
            other => {
                return Err(format!(
                    "encoding \"{other}\" is no depth; 16UC1, mono16 and 32FC1 are, and a picture is of type = \"geometry/Image\""
                ));
            }
        };
        let stated_mm = unit_mm.unwrap_or(default_mm);
        let n_bytes = scalar.n_bytes();
        let depth = |bytes: &[u8]| {
            let steps = Some(self.number(scalar, bytes)).filter(|steps| scalar != Scalar::U16 || *steps != NO_DEPTH_16);
            steps.map(|steps| steps * stated_mm).filter(|mm| *mm > 0.0 && mm.is_finite())
        };
        let rows = self.rows(n_bytes)?;
        let depths: Vec<_> = rows.flat_map(|row| row.chunks_exact(n_bytes).map(depth).collect::<Vec<_>>()).collect();
        let n = depths.iter().flatten().count();
        let is_far = |mm: &&f64| **mm > FARTHEST_SEEN_MM;
        if unit_mm.is_none() && scalar == Scalar::F32 && 2 * depths.iter().flatten().filter(is_far).count() > n {
            return Err(format!(
                "its 32-bit floats, in metres by REP 118, are mostly beyond {} m, where no depth camera sees; if they are in mm, give \
                 depth_unit_mm = 1",
                FARTHEST_SEEN_MM / MM_PER_M
            ));
        }
        Ok(depths)
    }

    fn number(&self, scalar: Scalar, bytes: &[u8]) -> f64 {
        scalar.first(bytes, self.big_endian).expect("a pixel has its bytes")
    }

    /// The rows without padding.
    fn rows(&self, pixel_bytes: usize) -> Result<impl Iterator<Item = &[u8]>, String> {
        let Self { width, height, step, .. } = *self;
        let row = u64::from(width) * pixel_bytes as u64;
        if width == 0 || height == 0 || u64::from(step) < row {
            return Err(format!(
                "{width} x {height} pixels in rows of {step} bytes (step); {row} or more are expected"
            ));
        }
        // The last row needs no padding.
        let (expected, n_bytes) = (u64::from(step) * u64::from(height - 1) + row, self.data.len() as u64);
        if n_bytes < expected || n_bytes > u64::from(step) * u64::from(height) {
            return Err(format!(
                "{n_bytes} bytes for {height} rows of {step} bytes (step); was the message cut short?"
            ));
        }
        Ok(self.data.chunks(step as usize).map(move |line| &line[..row as usize]))
    }
}

fn not_read(encoding: &str) -> String {
    let remedy = match encoding {
        "16UC1" | "32FC1" => "it is depth, which a port of type = \"geometry/Cloud\" with this calibration takes",
        _ if encoding.starts_with("bayer_") => {
            "it is the sensor's mosaic; record the image of colours that is made of it (image_proc)"
        }
        _ if encoding.starts_with("yuv") || encoding.starts_with("nv") || encoding.starts_with("uyvy") => {
            "let the camera's driver give rgb8, or record the compressed image"
        }
        _ => return format!("encoding \"{encoding}\" is not read; {PICTURES}"),
    };
    format!("encoding \"{encoding}\" is not read; {PICTURES}: {remedy}")
}
