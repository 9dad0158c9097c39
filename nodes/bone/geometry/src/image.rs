use crate::{Column, Distortion, Frame, StampNs};
use nalgebra::{Point3, Vector3};
use std::sync::Arc;

/// Largest width and height, pixels: a product of two is far from overflowing.
const MAX_SIDE: u32 = 16_384;

/// A pinhole camera behind a lens that may distort, in pixels. The centre of the top left pixel is (0, 0), as in OpenCV and ROS.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    /// Focal length along x.
    pub fx: f64,
    /// Focal length along y.
    pub fy: f64,
    /// Principal point, x.
    pub cx: f64,
    /// Principal point, y.
    pub cy: f64,
    /// What the lens does to the image coordinates.
    pub distortion: Distortion,
}

impl Intrinsics {
    /// A camera without distortion.
    pub const fn pinhole(fx: f64, fy: f64, cx: f64, cy: f64) -> Self {
        Self { fx, fy, cx, cy, distortion: Distortion::NONE }
    }

    /// The direction of the ray through a pixel, camera frame (x right, y down, z forward), of depth 1; `None` for a pixel at which no
    /// point is seen, beyond the angle up to which the distortion holds.
    pub fn ray(&self, [u, v]: [f64; 2]) -> Option<Vector3<f64>> {
        let [x, y] = self.distortion.undistorted([(u - self.cx) / self.fx, (v - self.cy) / self.fy])?;
        Some(Vector3::new(x, y, 1.0))
    }

    /// The pixel that shows a point of the camera's frame; `None` for one that is not in front of the camera, or beyond the angle up
    /// to which the distortion holds.
    pub fn pixel(&self, point: &Point3<f64>) -> Option<[f64; 2]> {
        let [x, y] = self.distortion.distorted([point.x / point.z, point.y / point.z])?;
        let seen = [self.fx * x + self.cx, self.fy * y + self.cy];
        (point.z > 0.0 && seen.iter().all(|c| c.is_finite())).then_some(seen)
    }

    /// Share of an image's pixels through which no ray is known, from about a thousand of them.
    pub fn share_without_ray(&self, [width, height]: [u32; 2]) -> f64 {
        const N: u32 = 33;
        let at = |k: u32, side: u32| f64::from(side.saturating_sub(1)) * f64::from(k) / f64::from(N - 1);
        let pixels = (0..N * N).map(|k| [at(k % N, width), at(k / N, height)]);
        pixels.filter(|pixel| self.ray(*pixel).is_none()).count() as f64 / f64::from(N * N)
    }
}

/// An image of a camera: 8 bits, grey or red, green, blue, rows from the top.
///
/// A cheap handle: clones share the pixels. It is in the frame of its own camera; a cloud of another sensor is registered to
/// it by the pose between both frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    /// The frame of its camera: x right, y down, z forward.
    pub frame: Frame,
    /// The time at which it was taken.
    pub stamp_ns: StampNs,
    /// The subject, if a stream carries several: `P1` for the image with the laser on P1.
    pub label: Option<Arc<str>>,
    width: u32,
    height: u32,
    channels: u32,
    intrinsics: Intrinsics,
    pixels: Column<u8>,
}

/// An invalid image: what was expected, and what was found.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ImageError(String);

impl Image {
    /// An image in the frame of its camera; `pixels` are row by row from the top left, each of `channels` bytes, 1 (grey) or
    /// 3 (red, green, blue).
    ///
    /// # Errors
    /// [`ImageError`] if the sizes do not match or the intrinsics cannot be those of this image.
    pub fn new(
        frame: impl Into<Frame>,
        [width, height]: [u32; 2],
        channels: u32,
        intrinsics: Intrinsics,
        pixels: impl Into<Column<u8>>,
    ) -> Result<Self, ImageError> {
        let pixels = pixels.into();
        let Intrinsics { fx, fy, cx, cy, .. } = intrinsics;
        let refused = |message: String| Err(ImageError(message));
        if !(1..=MAX_SIDE).contains(&width) || !(1..=MAX_SIDE).contains(&height) {
            return refused(format!("the image is {width} x {height} pixels; 1 to 16384 each are expected"));
        }
        if channels != 1 && channels != 3 {
            return refused(format!("a pixel has {channels} channels; 1 (grey) or 3 (red, green, blue) are expected"));
        }
        let expected = width as usize * height as usize * channels as usize;
        if pixels.len() != expected {
            let n_bytes = pixels.len();
            return refused(format!(
                "{n_bytes} bytes for {width} x {height} pixels of {channels} bytes; {expected} are expected"
            ));
        }
        if ![fx, fy, cx, cy].iter().all(|c| c.is_finite()) || fx <= 0.0 || fy <= 0.0 {
            return refused(format!(
                "intrinsics fx {fx}, fy {fy}, cx {cx}, cy {cy}: finite numbers and positive focal lengths are expected"
            ));
        }
        let inside = |c: f64, side: u32| (0.0..=f64::from(side - 1)).contains(&c);
        if !inside(cx, width) || !inside(cy, height) {
            return refused(format!(
                "the principal point ({cx:.1}, {cy:.1}) is outside of the image of {width} x {height} pixels; do the intrinsics \
                 belong to another resolution?"
            ));
        }
        Ok(Self { frame: frame.into(), stamp_ns: 0, label: None, width, height, channels, intrinsics, pixels })
    }

    /// Sets the stamp.
    pub fn at(mut self, stamp_ns: StampNs) -> Self {
        self.stamp_ns = stamp_ns;
        self
    }

    /// Sets the label.
    pub fn labelled(mut self, label: impl Into<Arc<str>>) -> Self {
        self.label = Some(label.into());
        self
    }

    /// Number of columns.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Bytes of a pixel: 1 (grey) or 3 (red, green, blue).
    pub fn channels(&self) -> u32 {
        self.channels
    }

    /// The camera.
    pub fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// The bytes, row by row.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// The bytes as a column that can be shared.
    pub fn pixel_column(&self) -> &Column<u8> {
        &self.pixels
    }

    /// Red, green and blue of the pixel at column `x`, row `y`; three times the same where the image is grey.
    ///
    /// # Panics
    /// If the pixel is outside of the image.
    pub fn rgb(&self, x: usize, y: usize) -> [u8; 3] {
        assert!(x < self.width as usize, "column {x} of {}", self.width);
        let first = (y * self.width as usize + x) * self.channels as usize;
        match self.channels {
            1 => [self.pixels[first]; 3],
            _ => [self.pixels[first], self.pixels[first + 1], self.pixels[first + 2]],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PINHOLE: Intrinsics = Intrinsics::pinhole(100.0, 110.0, 1.5, 0.5);

    #[test]
    fn a_pixel_and_its_ray_agree_and_what_is_behind_has_no_pixel() {
        let image = Image::new("camera", [4, 2], 3, PINHOLE, (0..24).collect::<Vec<u8>>()).unwrap();
        let ray = image.intrinsics().ray([3.0, 1.0]).unwrap();
        assert_eq!(image.intrinsics().pixel(&Point3::from(ray * 200.0)), Some([3.0, 1.0]));
        assert_eq!(image.intrinsics().pixel(&Point3::new(0.0, 0.0, -1.0)), None);
        assert_eq!(image.rgb(3, 1), [21, 22, 23]);
        let grey = Image::new("camera", [4, 2], 1, PINHOLE, (0..8).collect::<Vec<u8>>()).unwrap();
        assert_eq!(grey.rgb(1, 1), [5; 3]);
    }

    #[test]
    fn sizes_that_do_not_match_and_impossible_intrinsics_make_no_image() {
        let image = |size, channels, intrinsics, n: usize| {
            Image::new("camera", size, channels, intrinsics, vec![0u8; n]).map(drop).unwrap_err().to_string()
        };
        assert!(image([4, 2], 3, PINHOLE, 8).starts_with("8 bytes for 4 x 2 pixels of 3 bytes; 24 are expected"));
        assert!(image([0, 2], 3, PINHOLE, 0).starts_with("the image is 0 x 2 pixels"));
        assert!(image([u32::MAX, u32::MAX], 3, PINHOLE, 0).starts_with("the image is 4294967295 x"));
        assert!(image([4, 2], 4, PINHOLE, 32).starts_with("a pixel has 4 channels"));
        for bad in [
            Intrinsics { fx: 0.0, ..PINHOLE },
            Intrinsics { fy: -100.0, ..PINHOLE },
            Intrinsics { fx: f64::INFINITY, ..PINHOLE },
            Intrinsics { cx: f64::NAN, ..PINHOLE },
        ] {
            assert!(image([4, 2], 3, bad, 24).starts_with("intrinsics fx"), "{bad:?}");
        }
        // A calibration at twice the resolution.
        let twice = Intrinsics::pinhole(200.0, 220.0, 3.5, 1.5);
        assert!(image([4, 2], 3, twice, 24).ends_with("do the intrinsics belong to another resolution?"));
    }
}
