//! Images and the calibrations of their cameras, Foxglove's in protobuf.

use super::{Encoded, MessageError, decode, nanoseconds, no_such};
use crate::png::{Pixels, read_png};
use foxglove::messages::{CameraCalibration, CompressedImage, RawImage};
use osteoflow_geometry::{Image, Intrinsics};

/// The schema of an image without compression.
pub const RAW_IMAGE: &str = "foxglove.RawImage";
/// The schema of a compressed image.
pub const COMPRESSED_IMAGE: &str = "foxglove.CompressedImage";
/// The schema of a camera's calibration.
pub const CAMERA_CALIBRATION: &str = "foxglove.CameraCalibration";

/// The calibration of a camera: a pinhole without distortion.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// The frame of the camera.
    pub frame: String,
    /// The size of the images that it is for.
    pub size: [u32; 2],
    /// The camera.
    pub intrinsics: Intrinsics,
}

/// The calibration in a `foxglove.CameraCalibration`: `K` alone. `R` and `P` belong to rectified stereo images and are not used.
///
/// # Errors
/// [`MessageError`] if `K` is missing, skewed or not a pinhole's, or if a coefficient of `D` is not 0: the pixels of a
/// distorted image lie elsewhere, so it has to be rectified first. Otherwise if schema or encoding is another.
pub fn read_calibration<'a>(message: impl Into<Encoded<'a>>) -> Result<Calibration, MessageError> {
    let message = message.into();
    check(&message, "a camera's calibration", &[CAMERA_CALIBRATION])?;
    let read: CameraCalibration = decode(&message)?;
    let refuse = |reason: String| no_such(&message, reason);
    if let Some(d) = read.d.iter().find(|d| **d != 0.0) {
        let model = if read.distortion_model.is_empty() { "unnamed" } else { &read.distortion_model };
        return Err(refuse(format!(
            "distortion ({model}) with a coefficient {d}, but only a pinhole without is read; record the rectified image, with its \
             calibration and D = 0"
        )));
    }
    let [fx, skew, cx, a, fy, cy, b, c, one] = *read.k else {
        return Err(refuse(format!("K has {} numbers, 9 are expected", read.k.len())));
    };
    if fx == 0.0 {
        return Err(refuse("K[0] is 0, which means that the camera is not calibrated".into()));
    }
    if skew != 0.0 || [a, b, c, one] != [0.0, 0.0, 0.0, 1.0] {
        return Err(refuse(format!("K is {:?}; [fx, 0, cx, 0, fy, cy, 0, 0, 1] is expected", read.k)));
    }
    let intrinsics = Intrinsics { fx, fy, cx, cy };
    Ok(Calibration { frame: read.frame_id, size: [read.width, read.height], intrinsics })
}

/// The image in a `foxglove.RawImage` (`rgb8`, `bgr8`, `8UC3`, `mono8`, `8UC1`) or `foxglove.CompressedImage` (`png`), with the
/// camera of a calibration.
///
/// # Errors
/// [`MessageError`] if the encoding or format is another, which is named, if the bytes do not fill the image, or if the
/// calibration is for another size or frame. Otherwise if schema or encoding is another.
pub fn read_image<'a>(message: impl Into<Encoded<'a>>, calibration: &Calibration) -> Result<Image, MessageError> {
    let message = message.into();
    check(&message, "an image", &[RAW_IMAGE, COMPRESSED_IMAGE])?;
    let refuse = |reason: String| no_such(&message, reason);
    let (frame, timestamp, pixels) = if message.schema_name == RAW_IMAGE {
        let raw: RawImage = decode(&message)?;
        let pixels = raw_pixels(&raw).map_err(refuse)?;
        (raw.frame_id, raw.timestamp, pixels)
    } else {
        let packed: CompressedImage = decode(&message)?;
        if !packed.format.eq_ignore_ascii_case("png") {
            let format = &packed.format;
            return Err(refuse(format!("format \"{format}\" is not read; record png, or foxglove.RawImage")));
        }
        let pixels = read_png(&packed.data).map_err(|reason| refuse(format!("the PNG image {reason}")))?;
        (packed.frame_id, packed.timestamp, pixels)
    };
    let Pixels { width, height, channels, bytes } = pixels;
    if [width, height] != calibration.size {
        let [w, h] = calibration.size;
        return Err(refuse(format!(
            "the image has {width} x {height} pixels, but its camera's calibration is for {w} x {h}; K would not fit"
        )));
    }
    if frame != calibration.frame {
        let other = &calibration.frame;
        return Err(refuse(format!("the image is in \"{frame}\", but the calibration is that of \"{other}\"")));
    }
    let stamp_ns = nanoseconds(timestamp).unwrap_or(message.publish_time_ns);
    let image = Image::new(frame, [width, height], channels, calibration.intrinsics, bytes);
    Ok(image.map_err(|error| refuse(error.to_string()))?.at(stamp_ns))
}

/// Frame and sensor time of an image, without its pixels.
///
/// # Errors
/// As [`read_image`], but for the pixels.
pub fn read_image_head<'a>(
    message: impl Into<Encoded<'a>>,
) -> Result<(osteoflow_geometry::Frame, osteoflow_geometry::StampNs), MessageError> {
    let message = message.into();
    check(&message, "an image", &[RAW_IMAGE, COMPRESSED_IMAGE])?;
    let (frame, timestamp) = if message.schema_name == RAW_IMAGE {
        let raw: RawImage = decode(&message)?;
        (raw.frame_id, raw.timestamp)
    } else {
        let packed: CompressedImage = decode(&message)?;
        (packed.frame_id, packed.timestamp)
    };
    Ok((frame.into(), nanoseconds(timestamp).unwrap_or(message.publish_time_ns)))
}

fn check(message: &Encoded, expected: &'static str, schemas: &[&str]) -> Result<(), MessageError> {
    if !schemas.contains(&message.schema_name) {
        return Err(super::wrong_schema(expected, message));
    }
    match message.message_encoding {
        "protobuf" => Ok(()),
        _ => Err(super::wrong_encoding(message)),
    }
}

/// Pixels in the order red, green, blue, without padding.
fn raw_pixels(raw: &RawImage) -> Result<Pixels, String> {
    let RawImage { width, height, ref encoding, step, .. } = *raw;
    let channels: u32 = match encoding.as_str() {
        "rgb8" | "bgr8" | "8UC3" => 3,
        "mono8" | "8UC1" => 1,
        other => return Err(format!("encoding \"{other}\" is not read; rgb8, bgr8, 8UC3, mono8 and 8UC1 are")),
    };
    let row = u64::from(width) * u64::from(channels);
    if width == 0 || height == 0 || u64::from(step) < row {
        return Err(format!("{width} x {height} pixels in rows of {step} bytes (step); {row} or more are expected"));
    }
    // The last row needs no padding.
    let (expected, n_bytes) = (u64::from(step) * u64::from(height - 1) + row, raw.data.len() as u64);
    if n_bytes < expected || n_bytes > u64::from(step) * u64::from(height) {
        return Err(format!("{n_bytes} bytes for {height} rows of {step} bytes (step); was the message cut short?"));
    }
    let mut bytes: Vec<u8> =
        raw.data.chunks(step as usize).flat_map(|line| line[..row as usize].iter().copied()).collect();
    if matches!(encoding.as_str(), "bgr8" | "8UC3") {
        bytes.chunks_exact_mut(3).for_each(|pixel| pixel.swap(0, 2));
    }
    Ok(Pixels { width, height, channels, bytes })
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytes::Bytes;
    use foxglove::{Encode, messages::Timestamp};

    fn encoded<'a, M: Encode>(schema_name: &'a str, message: &M) -> Encoded<'a> {
        let mut data = Vec::new();
        message.encode(&mut data).unwrap();
        Encoded { schema_name, message_encoding: "protobuf", publish_time_ns: 9, data: data.into() }
    }

    fn calibration_message() -> CameraCalibration {
        CameraCalibration {
            timestamp: None,
            frame_id: "camera".into(),
            width: 4,
            height: 2,
            distortion_model: "plumb_bob".into(),
            d: vec![0.0; 5],
            k: vec![100.0, 0.0, 1.5, 0.0, 110.0, 0.5, 0.0, 0.0, 1.0],
            r: Vec::new(),
            p: Vec::new(),
        }
    }

    fn calibration() -> Calibration {
        read_calibration(encoded(CAMERA_CALIBRATION, &calibration_message())).unwrap()
    }

    fn raw(encoding: &str, step: u32, data: Vec<u8>) -> RawImage {
        RawImage {
            timestamp: Some(Timestamp::new(2, 5)),
            frame_id: "camera".into(),
            width: 4,
            height: 2,
            encoding: encoding.into(),
            step,
            data: Bytes::from(data),
        }
    }

    fn read(message: &RawImage) -> Result<Image, MessageError> {
        read_image(encoded(RAW_IMAGE, message), &calibration())
    }

    #[test]
    fn raw_images_are_read_in_red_green_blue_whatever_their_order_and_padding() {
        let bytes: Vec<u8> = (0..24).collect();
        let rgb = read(&raw("rgb8", 12, bytes.clone())).unwrap();
        assert_eq!((rgb.pixels(), rgb.stamp_ns, rgb.frame.as_str()), (&bytes[..], 2_000_000_005, "camera"));
        assert_eq!(rgb.intrinsics(), &Intrinsics { fx: 100.0, fy: 110.0, cx: 1.5, cy: 0.5 });
        for name in ["bgr8", "8UC3"] {
            assert_eq!(read(&raw(name, 12, bytes.clone())).unwrap().rgb(1, 0), [5, 4, 3], "{name}");
        }
        let padded: Vec<u8> = bytes.chunks(12).flat_map(|row| [row, &[255; 4]].concat()).collect();
        assert_eq!(read(&raw("rgb8", 16, padded.clone())).unwrap(), rgb);
        assert_eq!(read(&raw("rgb8", 16, padded[..28].to_vec())).unwrap(), rgb, "without the last padding");
        let grey = read(&raw("mono8", 4, bytes[..8].to_vec())).unwrap();
        assert_eq!((grey.channels(), grey.rgb(1, 1)), (1, [5; 3]));
    }

    #[test]
    fn other_encodings_formats_and_sizes_are_refused_by_name() {
        let refused = |message: &RawImage| read(message).unwrap_err().to_string();
        assert!(refused(&raw("yuv422", 12, vec![0; 24])).contains("encoding \"yuv422\" is not read; rgb8"));
        assert!(refused(&raw("rgb8", 11, vec![0; 22])).contains("rows of 11 bytes (step); 12 or more"));
        assert!(refused(&raw("rgb8", 12, vec![0; 23])).contains("23 bytes for 2 rows of 12 bytes"));
        assert!(refused(&raw("rgb8", 12, vec![0; 25])).contains("25 bytes for 2 rows"));
        let wide = RawImage { width: u32::MAX, ..raw("rgb8", 12, vec![0; 24]) };
        assert!(refused(&wide).contains("4294967295 x 2 pixels"));
        let beside = RawImage { frame_id: "camera_color".into(), ..raw("rgb8", 12, vec![0; 24]) };
        assert!(refused(&beside).contains("in \"camera_color\", but the calibration is that of \"camera\""));
        let jpeg = CompressedImage {
            timestamp: None,
            frame_id: "camera".into(),
            data: Bytes::from_static(b"\xff\xd8"),
            format: "jpeg".into(),
        };
        let error = |message: &CompressedImage| {
            read_image(encoded(COMPRESSED_IMAGE, message), &calibration()).unwrap_err().to_string()
        };
        assert!(error(&jpeg).contains("format \"jpeg\" is not read; record png"));
        assert!(error(&CompressedImage { format: "png".into(), ..jpeg }).contains("the PNG image cannot be read"));
        let json = Encoded { message_encoding: "json", ..encoded(RAW_IMAGE, &raw("rgb8", 12, vec![0; 24])) };
        assert!(read_image(json, &calibration()).unwrap_err().to_string().contains("written as \"json\" is not read"));
    }

    #[test]
    fn a_calibration_for_another_resolution_or_with_distortion_is_refused() {
        let half = Calibration { size: [2, 1], ..calibration() };
        let error = read_image(encoded(RAW_IMAGE, &raw("rgb8", 12, vec![0; 24])), &half).unwrap_err().to_string();
        assert!(error.contains("4 x 2 pixels, but its camera's calibration is for 2 x 1"), "{error}");
        let refused = |change: &dyn Fn(&mut CameraCalibration)| {
            let mut message = calibration_message();
            change(&mut message);
            read_calibration(encoded(CAMERA_CALIBRATION, &message)).unwrap_err().to_string()
        };
        assert!(refused(&|c| c.d[1] = 0.1).contains("distortion (plumb_bob) with a coefficient 0.1"));
        assert!(refused(&|c| c.d[1] = f64::NAN).contains("distortion"));
        assert!(refused(&|c| c.k.clear()).contains("K has 0 numbers"));
        assert!(refused(&|c| c.k[0] = 0.0).contains("not calibrated"));
        assert!(refused(&|c| c.k[1] = 0.2).contains("K is [100.0, 0.2"));
    }
}
