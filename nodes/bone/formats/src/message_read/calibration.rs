//! Calibrations of cameras: Foxglove's in protobuf, those of ROS 2 in CDR.

use super::{CAMERA_CALIBRATION, CAMERA_INFO, Encoded, MessageError, cdr, decode, image::check, no_such};
use crate::ros2::CameraInfo;
use foxglove::messages::CameraCalibration;
use osteoflow_geometry::{Distortion, Intrinsics};

/// Maximum deviation of an entry of `R` from that of the identity, for rectified images: a tenth of a pixel at a focal length of 1000.
const NO_TURN: f64 = 1e-4;

/// The calibration of a camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// The frame of the camera.
    pub frame: String,
    /// The size of the images that it is for.
    pub size: [u32; 2],
    /// The camera.
    pub intrinsics: Intrinsics,
}

impl Calibration {
    /// Why some pixels of its images show no known ray; `None` where all do.
    pub fn note(&self) -> Option<String> {
        let share = self.intrinsics.share_without_ray(self.size);
        let distortion = self.intrinsics.distortion;
        let name = distortion.name().filter(|_| share > 0.0)?;
        Some(format!(
            "the distortion of camera \"{}\" ({name}) holds up to {:.1} degrees from its axis: {:.0} % of its pixels are beyond and show \
             nothing",
            self.frame,
            distortion.limit_rad().to_degrees(),
            (100.0 * share).ceil()
        ))
    }
}

/// The numbers of a calibration, by the names that both families have for them.
struct Numbers {
    frame: String,
    size: [u32; 2],
    model: String,
    d: Vec<f64>,
    k: Vec<f64>,
    r: Vec<f64>,
    p: Vec<f64>,
}

const SCHEMAS: [&str; 2] = [CAMERA_CALIBRATION, CAMERA_INFO];

/// Whether messages of this schema are calibrations.
pub fn is_calibration(schema_name: &str) -> bool {
    SCHEMAS.contains(&schema_name)
}

/// The calibration in a `foxglove.CameraCalibration` or `sensor_msgs/msg/CameraInfo`: `K` and `D` for images as the camera takes
/// them, or, where they are `rectified`, `P` without distortion.
///
/// # Errors
/// [`MessageError`] if `K` or `P` is missing, skewed or not a pinhole's, if the distortion is of an unknown model, if the images are a
/// part of the sensor or of joined pixels, or if a rectified camera is turned or beside its frame. Otherwise if schema or encoding
/// is another.
pub fn read_calibration<'a>(message: impl Into<Encoded<'a>>, rectified: bool) -> Result<Calibration, MessageError> {
    let message = message.into();
    check(&message, "a camera's calibration", &SCHEMAS)?;
    let refuse = |reason: String| no_such(&message, reason);
    let read = if message.schema_name == CAMERA_INFO { ros2(&message)? } else { foxglove(&message)? };
    let intrinsics = if rectified { read.rectified() } else { read.as_taken() }.map_err(refuse)?;
    check_size(read.size, &intrinsics).map_err(refuse)?;
    Ok(Calibration { frame: read.frame, size: read.size, intrinsics })
}

/// Refuses intrinsics of images of another size: their principal point is off the middle in both directions by one factor.
fn check_size([width, height]: [u32; 2], intrinsics: &Intrinsics) -> Result<(), String> {
    let (u, v) = (intrinsics.cx / f64::from(width), intrinsics.cy / f64::from(height));
    let factor = u + v;
    if (u - v).abs() < 0.1 && !(0.6..=1.4).contains(&factor) {
        return Err(format!(
            "its principal point is at {:.1}, {:.1}, but its images have {width} x {height} pixels: its numbers are of images about \
             {factor:.2} times as large; record the calibration that the driver publishes for this resolution",
            intrinsics.cx, intrinsics.cy
        ));
    }
    Ok(())
}

fn foxglove(message: &Encoded) -> Result<Numbers, MessageError> {
    let read: CameraCalibration = decode(message)?;
    Ok(Numbers {
        frame: read.frame_id,
        size: [read.width, read.height],
        model: read.distortion_model,
        d: read.d,
        k: read.k,
        r: read.r,
        p: read.p,
    })
}

fn ros2(message: &Encoded) -> Result<Numbers, MessageError> {
    let read: CameraInfo = cdr::decode(message)?;
    let (binning, roi) = ([read.binning_x, read.binning_y], read.roi);
    let is_all = [roi.x_offset, roi.y_offset] == [0, 0]
        && (roi.width == 0 || roi.width == read.width)
        && (roi.height == 0 || roi.height == read.height);
    if binning.iter().any(|b| *b > 1) || !is_all {
        return Err(no_such(
            message,
            format!(
                "its images are a part of the sensor (roi {} x {} at {}, {}) or of joined pixels (binning {} x {}), and K is for the \
                 whole; record whole images",
                roi.width, roi.height, roi.x_offset, roi.y_offset, binning[0], binning[1]
            ),
        ));
    }
    Ok(Numbers {
        frame: read.header.frame_id.into(),
        size: [read.width, read.height],
        model: read.distortion_model.into(),
        d: read.d,
        k: read.k.into(),
        r: read.r.into(),
        p: read.p.into(),
    })
}

impl Numbers {
    fn as_taken(&self) -> Result<Intrinsics, String> {
        let k = &self.k;
        let [fx, skew, cx, a, fy, cy, b, c, one] = k[..] else {
            return Err(format!("K has {} numbers, 9 are expected", k.len()));
        };
        if fx == 0.0 {
            return Err("K[0] is 0, which means that the camera is not calibrated".into());
        }
        if skew != 0.0 || [a, b, c, one] != [0.0, 0.0, 0.0, 1.0] {
            return Err(format!("K is {k:?}; [fx, 0, cx, 0, fy, cy, 0, 0, 1] is expected"));
        }
        let distortion = Distortion::named(&self.model, &self.d).map_err(|error| error.to_string())?;
        Ok(Intrinsics { fx, fy, cx, cy, distortion })
    }

    fn rectified(&self) -> Result<Intrinsics, String> {
        let p = &self.p;
        let [fx, skew, cx, tx, a, fy, cy, ty, b, c, one, d] = p[..] else {
            return Err(format!("P has {} numbers, 12 are expected of rectified images", p.len()));
        };
        if fx == 0.0 {
            return Err("P[0] is 0, which means that the camera is not calibrated".into());
        }
        if [skew, tx, a, ty, b, c, one, d] != [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
            return Err(format!(
                "P is {p:?}; [fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0] is expected: the first camera of a pair, or a single one"
            ));
        }
        let is_turned = |(i, r): (usize, &f64)| (r - if i % 4 == 0 { 1.0 } else { 0.0 }).abs() > NO_TURN;
        if self.r.iter().any(|r| *r != 0.0) && self.r.iter().enumerate().any(is_turned) {
            return Err(format!(
                "R is {:?}: rectified images are turned against the frame of their camera, which is not read; use the images as they \
                 were taken, with rectified = false",
                self.r
            ));
        }
        Ok(Intrinsics::pinhole(fx, fy, cx, cy))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intrinsics_of_images_of_another_size_are_refused_with_the_factor() {
        let check = |size, cx, cy| check_size(size, &Intrinsics::pinhole(600.0, 600.0, cx, cy));
        for (cx, cy) in [(320.0, 240.0), (300.0, 260.0), (420.0, 180.0), (200.0, 240.0)] {
            assert_eq!(check([640, 480], cx, cy), Ok(()), "{cx} {cy}");
        }
        for (cx, cy, factor) in [(640.0, 480.0, "2.00"), (160.0, 120.0, "0.50"), (480.0, 362.0, "1.50")] {
            let said = check([640, 480], cx, cy).unwrap_err();
            assert!(
                said.contains("images have 640 x 480 pixels") && said.contains(&format!("about {factor} times")),
                "{said}"
            );
        }
    }
}
