//! Images and depth images: Foxglove's in protobuf, those of ROS 2 in CDR.

use super::{
    COMPRESSED_IMAGE, Calibration, CloudRead, Encoded, MessageError, RAW_IMAGE, ROS2_COMPRESSED_IMAGE, ROS2_IMAGE, cdr,
    decode, is_sensor_frame, nanoseconds, no_such, raw_pixels::RawPixels,
};
use crate::{jpeg::read_jpeg, pixels::Pixels, png::read_png, ros2};
use bytes::Bytes;
use foxglove::messages::{CompressedImage, RawImage, Timestamp};
use nalgebra::{Isometry3, Point3};
use osteoflow_geometry::{Cloud, Correction, Frame, Image, StampNs, TooFar};

const SCHEMAS: [&str; 4] = [RAW_IMAGE, COMPRESSED_IMAGE, ROS2_IMAGE, ROS2_COMPRESSED_IMAGE];

/// Whether messages of this schema are images.
pub fn is_image(schema_name: &str) -> bool {
    SCHEMAS.contains(&schema_name)
}

/// A message of either family.
struct Shot {
    frame: String,
    timestamp: Option<Timestamp>,
    content: Content,
}

enum Content {
    Raw(RawPixels),
    Packed { format: String, data: Bytes },
}

/// The image in a `foxglove.RawImage`, `foxglove.CompressedImage`, `sensor_msgs/msg/Image` or `sensor_msgs/msg/CompressedImage`, with the
/// camera of a calibration. Encodings are `rgb8`, `bgr8`, `rgba8`, `bgra8`, `8UC3` (blue, green, red), `mono8`, `8UC1` and `mono16`, of
/// which the upper 8 bits count; formats are JPEG and PNG. Opacity is left out.
///
/// # Errors
/// [`MessageError`] if the encoding or format is another, which is named, if the bytes do not fill the image, or if the
/// calibration is for another size or frame. Otherwise if schema or encoding is another.
pub fn read_image<'a>(message: impl Into<Encoded<'a>>, calibration: &Calibration) -> Result<Image, MessageError> {
    let message = message.into();
    let refuse = |reason: String| no_such(&message, reason);
    let shot = Shot::of(&message)?;
    let pixels = match &shot.content {
        Content::Raw(raw) => raw.picture(),
        Content::Packed { format, data } => unpacked(format, data),
    };
    let Pixels { width, height, channels, bytes } = pixels.map_err(refuse)?;
    shot.check([width, height], calibration).map_err(refuse)?;
    let image = Image::new(shot.frame, [width, height], channels, calibration.intrinsics, bytes);
    let stamp_ns = nanoseconds(shot.timestamp).unwrap_or(message.publish_time_ns);
    Ok(image.map_err(|error| refuse(error.to_string()))?.at(stamp_ns))
}

/// The cloud of a depth image in a `foxglove.RawImage` or `sensor_msgs/msg/Image` (`16UC1`, `mono16`: mm; `32FC1`: m; or steps of `unit_mm`),
/// by the camera of a calibration, row by row. Pixels without depth, which are 0, NaN or infinite, give no point.
///
/// # Errors
/// [`MessageError`] if the encoding is another, if no pixel has a depth, and as [`read_image`].
pub fn read_depth<'a>(
    message: impl Into<Encoded<'a>>,
    calibration: &Calibration,
    unit_mm: Option<f64>,
) -> Result<CloudRead, MessageError> {
    let message = message.into();
    let refuse = |reason: String| no_such(&message, reason);
    let shot = Shot::of(&message)?;
    let Content::Raw(raw) = &shot.content else {
        return Err(refuse(
            "a compressed image has no depth that is read; record the topic of the image itself".into(),
        ));
    };
    let depths_mm = raw.depths_mm(unit_mm).map_err(refuse)?;
    shot.check([raw.width, raw.height], calibration).map_err(refuse)?;
    let width = raw.width as usize;
    let n_pixels = depths_mm.len();
    let (mut points, mut n_beyond) = (Vec::with_capacity(n_pixels), 0);
    for (i, depth_mm) in depths_mm.into_iter().enumerate() {
        let Some(depth_mm) = depth_mm else { continue };
        let Some(ray) = calibration.intrinsics.ray([(i % width) as f64, (i / width) as f64]) else {
            n_beyond += 1;
            continue;
        };
        let point = Point3::from(ray * depth_mm);
        TooFar::check(point.coords.as_slice())
            .map_err(|far| refuse(format!("pixel {}, {}: {far}", i % width, i / width)))?;
        points.push(point);
    }
    if points.is_empty() {
        return Err(refuse(format!("none of its {n_pixels} pixels has a depth")));
    }
    let notes = (n_beyond > 0)
        .then(|| format!("{n_beyond} pixels with a depth are beyond the angle up to which the distortion holds"));
    let mut cloud = Cloud::new(shot.frame, points).map_err(|error| refuse(error.to_string()))?;
    cloud.stamp_ns = nanoseconds(shot.timestamp).unwrap_or(message.publish_time_ns);
    cloud.viewpoint = is_sensor_frame(cloud.frame.as_str()).then(Isometry3::identity);
    let correction = Correction::default();
    Ok(CloudRead { cloud, n_points_in_message: n_pixels, n_dropped: 0, correction, notes: notes.into_iter().collect() })
}

/// Frame and sensor time of an image, without its pixels.
///
/// # Errors
/// As [`read_image`], but for the pixels.
pub fn read_image_head<'a>(message: impl Into<Encoded<'a>>) -> Result<(Frame, StampNs), MessageError> {
    let message = message.into();
    let shot = Shot::of(&message)?;
    Ok((shot.frame.into(), nanoseconds(shot.timestamp).unwrap_or(message.publish_time_ns)))
}

/// Refuses another schema than those given, and the encoding of the other family.
pub(super) fn check(message: &Encoded, expected: &'static str, schemas: &[&str]) -> Result<(), MessageError> {
    if !schemas.contains(&message.schema_name) {
        return Err(super::wrong_schema(expected, message));
    }
    match (message.message_encoding, message.schema_name.starts_with("foxglove.")) {
        ("protobuf", true) | ("cdr", false) => Ok(()),
        _ => Err(super::wrong_encoding(message)),
    }
}

impl Shot {
    fn of(message: &Encoded) -> Result<Self, MessageError> {
        check(message, "an image", &SCHEMAS)?;
        Ok(match message.schema_name {
            RAW_IMAGE => {
                let RawImage { timestamp, frame_id, width, height, encoding, step, data } = decode(message)?;
                let raw = RawPixels { width, height, encoding, big_endian: false, step, data };
                Self { frame: frame_id, timestamp, content: Content::Raw(raw) }
            }
            COMPRESSED_IMAGE => {
                let CompressedImage { timestamp, frame_id, data, format } = decode(message)?;
                Self { frame: frame_id, timestamp, content: Content::Packed { format, data } }
            }
            ROS2_IMAGE => {
                let read: ros2::Image = cdr::decode(message)?;
                let raw = RawPixels {
                    width: read.width,
                    height: read.height,
                    encoding: read.encoding.into(),
                    big_endian: read.is_bigendian != 0,
                    step: read.step,
                    data: message.data.slice_ref(read.data),
                };
                Self::stamped(&read.header, Content::Raw(raw))
            }
            _ => {
                let read: ros2::CompressedImage = cdr::decode(message)?;
                let data = message.data.slice_ref(read.data);
                Self::stamped(&read.header, Content::Packed { format: read.format.into(), data })
            }
        })
    }

    fn stamped(header: &ros2::Header, content: Content) -> Self {
        Self { frame: header.frame_id.into(), timestamp: header.stamp.timestamp(), content }
    }

    /// Refuses the calibration of another camera or resolution.
    fn check(&self, [width, height]: [u32; 2], calibration: &Calibration) -> Result<(), String> {
        let ([w, h], other) = (calibration.size, &calibration.frame);
        if [width, height] != [w, h] {
            return Err(format!(
                "the image has {width} x {height} pixels, but its camera's calibration is for {w} x {h}; K would not fit"
            ));
        }
        if self.frame != *other {
            return Err(format!("the image is in \"{}\", but the calibration is that of \"{other}\"", self.frame));
        }
        Ok(())
    }
}

/// The pixels of a file, red, green, blue.
///
/// ROS says in `format` what it compressed, such as `rgb8; jpeg compressed bgr8`: the colours are right where it compressed `bgr8`, and red
/// and blue exchanged where it compressed `rgb8`.
///
/// # Source
/// The subscriber of `compressed_image_transport`, which decodes by `cv::imdecode`.
fn unpacked(format: &str, data: &Bytes) -> Result<Pixels, String> {
    let (original, codec) = format.split_once(';').unwrap_or(("", format));
    let codec = codec.to_ascii_lowercase();
    let is_png = data.starts_with(b"\x89PNG");
    let mut pixels = if codec.contains("compresseddepth") {
        return Err(format!("format \"{format}\" is not read; record the topic of the depth image itself"));
    } else if codec.contains("jpeg") || codec.contains("jpg") {
        if is_png {
            return Err(format!("its format is \"{format}\", but its bytes are those of a PNG image"));
        }
        read_jpeg(data).map_err(|reason| format!("the JPEG image {reason}"))?
    } else if codec.contains("png") {
        read_png(data).map_err(|reason| format!("the PNG image {reason}"))?
    } else {
        return Err(format!("format \"{format}\" is not read; record jpeg or png, or the image without compression"));
    };
    let is_colour = original.starts_with("rgb") || original.starts_with("bgr");
    if is_colour && pixels.channels == 3 {
        if codec.contains("compressed rgb") {
            pixels.swap_red_blue();
        } else if !codec.contains("compressed bgr") {
            return Err(format!(
                "format \"{format}\" does not say in which order the colours were compressed; \"{original}; jpeg compressed bgr8\" is \
                 expected"
            ));
        }
    }
    Ok(pixels)
}

#[cfg(test)]
mod tests {
    use super::super::{CAMERA_CALIBRATION, read_calibration};
    use super::*;
    use foxglove::{Encode, messages::CameraCalibration};
    use osteoflow_geometry::Intrinsics;

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
        read_calibration(encoded(CAMERA_CALIBRATION, &calibration_message()), false).unwrap()
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
        assert_eq!(rgb.intrinsics(), &Intrinsics::pinhole(100.0, 110.0, 1.5, 0.5));
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
    fn opacity_is_left_out_and_sixteen_bits_of_grey_become_eight() {
        let rgba: Vec<u8> = (0..32).collect();
        let read_rgba = read(&raw("rgba8", 16, rgba.clone())).unwrap();
        assert_eq!((read_rgba.channels(), read_rgba.rgb(1, 0), read_rgba.rgb(0, 1)), (3, [4, 5, 6], [16, 17, 18]));
        assert_eq!(read(&raw("bgra8", 16, rgba)).unwrap().rgb(1, 0), [6, 5, 4]);
        let levels = [0_u16, 128, 129, 257, 65_534, 65_535, 0x1234, 300];
        let bytes: Vec<u8> = levels.iter().flat_map(|v| v.to_le_bytes()).collect();
        let grey = read(&raw("mono16", 8, bytes)).unwrap();
        assert_eq!(grey.pixels(), [0, 0, 1, 1, 255, 255, 18, 1]);
    }

    #[test]
    fn a_depth_image_is_a_cloud_along_the_rays_of_its_camera() {
        let millimetres = [65_535_u16, 200, 210, 220, 230, 240, 250, 65_534];
        let bytes: Vec<u8> = millimetres.iter().flat_map(|v| v.to_le_bytes()).collect();
        let depth = |message: &RawImage, unit_mm| read_depth(encoded(RAW_IMAGE, message), &calibration(), unit_mm);
        let of_integers = depth(&raw("16UC1", 8, bytes.clone()), None).unwrap();
        // Column 3 of the second row, where fx is 100, fy 110, cx 1.5 and cy 0.5.
        let last = Point3::new(1.5 / 100.0 * 65_534.0, 0.5 / 110.0 * 65_534.0, 65_534.0);
        assert_eq!((of_integers.cloud.len(), of_integers.n_points_in_message), (7, 8), "65535 is no depth");
        assert!((of_integers.cloud.points()[6] - last).norm() < 1e-9);
        assert_eq!(of_integers.cloud.points()[0].z, 200.0);
        assert_eq!(of_integers.cloud.viewpoint, Some(Isometry3::identity()));
        let tenths = depth(&raw("mono16", 8, bytes), Some(0.1)).unwrap();
        assert!((tenths.cloud.points()[0].z - 20.0).abs() < 1e-12);
        let zeros = depth(&raw("16UC1", 8, [0_u16, 1, 0, 1, 0, 1, 0, 1].map(u16::to_le_bytes).concat()), None).unwrap();
        assert_eq!(zeros.cloud.len(), 4, "a depth of 0 is none");
        let floats = |values: [f32; 8]| raw("32FC1", 16, values.map(f32::to_le_bytes).concat());
        let in_mm = floats([0.0, 300.0, 812.0, 3000.0, 500.0, 0.0, 700.0, f32::NAN]);
        let said = depth(&in_mm, None).unwrap_err().to_string();
        assert!(said.contains("mostly beyond 100 m") && said.contains("give depth_unit_mm = 1"), "{said}");
        assert_eq!(depth(&in_mm, Some(1.0)).unwrap().cloud.points()[0].z, 300.0);
        assert!(depth(&floats([0.3, 0.8, 0.9, 3000.0, 0.7, 0.6, 0.0, 0.5]), None).is_ok(), "one far value is noise");
        let metres = [f32::NAN, 0.2, f32::INFINITY, f32::NEG_INFINITY, 0.23, -0.1, 0.0, 0.25];
        let bytes: Vec<u8> = metres.iter().flat_map(|v| v.to_le_bytes()).collect();
        let of_floats = depth(&raw("32FC1", 16, bytes), None).unwrap();
        assert_eq!(of_floats.cloud.points().iter().map(|p| p.z.round()).collect::<Vec<_>>(), [200.0, 230.0, 250.0]);
        let refused = |message: &RawImage| depth(message, None).unwrap_err().to_string();
        assert!(refused(&raw("rgb8", 12, vec![9; 24])).contains("\"rgb8\" is no depth"));
        assert!(refused(&raw("16UC1", 8, vec![0; 16])).contains("none of its 8 pixels has a depth"));
        let far: Vec<u8> = [1e6_f32, 0.2, 0.2, 0.2, 0.2, 0.2, 0.2, 0.2].iter().flat_map(|v| v.to_le_bytes()).collect();
        assert!(refused(&raw("32FC1", 16, far)).contains("pixel 0, 0: "));
    }

    #[test]
    fn colours_of_a_compressed_image_are_those_that_ros_compressed() {
        let picture = include_bytes!("../../tests/data/jpeg/colour_rgb.png");
        let red_patch = |format: &str| {
            unpacked(format, &Bytes::from_static(picture)).map(|p| p.bytes[(5 * 37 + 7) * 3..][..3].to_vec())
        };
        let red = red_patch("png").unwrap();
        assert!(red[0] > 200 && red[2] < 60, "{red:?}");
        let blue = [red[2], red[1], red[0]];
        for format in ["rgb8; png compressed bgr8", "bgr8; png compressed bgr8", "PNG", "bgra8; png compressed bgr8"] {
            assert_eq!(red_patch(format).unwrap(), red, "{format}");
        }
        for format in ["rgb8; png compressed rgb8", "bgr8; png compressed rgb8"] {
            assert_eq!(red_patch(format).unwrap(), blue, "{format}");
        }
        let refused = |format: &str| red_patch(format).unwrap_err();
        assert!(refused("rgb8; png").contains("does not say in which order"));
        assert!(refused("16UC1; compressedDepth png").contains("record the topic of the depth image"));
        assert!(refused("h264").contains("format \"h264\" is not read; record jpeg or png"));
        assert!(refused("jpeg").contains("its bytes are those of a PNG image"));
    }

    #[test]
    fn other_encodings_formats_and_sizes_are_refused_by_name() {
        let refused = |message: &RawImage| read(message).unwrap_err().to_string();
        assert!(refused(&raw("yuv422", 12, vec![0; 24])).contains("encoding \"yuv422\" is not read; rgb8"));
        assert!(refused(&raw("bayer_rggb8", 4, vec![0; 8])).contains("it is the sensor's mosaic"));
        assert!(refused(&raw("16UC1", 8, vec![0; 16])).contains("a port of type = \"geometry/Cloud\""));
        assert!(refused(&raw("rgb16", 24, vec![0; 48])).contains("\"rgb16\" is not read; rgb8"));
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
        assert!(error(&jpeg).contains("the JPEG image of 2 bytes has no end"));
        assert!(error(&CompressedImage { format: "png".into(), ..jpeg }).contains("the PNG image cannot be read"));
        let json = Encoded { message_encoding: "json", ..encoded(RAW_IMAGE, &raw("rgb8", 12, vec![0; 24])) };
        assert!(read_image(json, &calibration()).unwrap_err().to_string().contains("written as \"json\" is not read"));
    }

    #[test]
    fn a_calibration_for_another_resolution_or_an_unknown_lens_is_refused() {
        let half = Calibration { size: [2, 1], ..calibration() };
        let error = read_image(encoded(RAW_IMAGE, &raw("rgb8", 12, vec![0; 24])), &half).unwrap_err().to_string();
        assert!(error.contains("4 x 2 pixels, but its camera's calibration is for 2 x 1"), "{error}");
        let refused = |change: &dyn Fn(&mut CameraCalibration)| {
            let mut message = calibration_message();
            change(&mut message);
            read_calibration(encoded(CAMERA_CALIBRATION, &message), false).unwrap_err().to_string()
        };
        assert!(refused(&|c| c.d[1] = f64::NAN).contains("coefficient 2 of the distortion is NaN"));
        assert!(refused(&|c| c.k.clear()).contains("K has 0 numbers"));
        assert!(refused(&|c| c.k[0] = 0.0).contains("not calibrated"));
        assert!(refused(&|c| c.k[1] = 0.2).contains("K is [100.0, 0.2"));
        assert!(
            refused(&|c| (c.distortion_model, c.d) = ("fisheye62".into(), vec![0.1; 8]))
                .contains("\"fisheye62\" is not read")
        );
    }

    #[test]
    fn rectified_images_have_the_camera_of_p_and_no_distortion() {
        let mut message = calibration_message();
        message.d[0] = -0.2;
        message.p = vec![90.0, 0.0, 1.4, 0.0, 0.0, 91.0, 0.6, 0.0, 0.0, 0.0, 1.0, 0.0];
        message.r = vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        let read = |message: &CameraCalibration, rectified| {
            read_calibration(encoded(CAMERA_CALIBRATION, message), rectified).map(|c| c.intrinsics)
        };
        assert_eq!(read(&message, true).unwrap(), Intrinsics::pinhole(90.0, 91.0, 1.4, 0.6));
        let bent = read(&message, false).unwrap();
        assert_eq!((bent.fx, bent.distortion.name()), (100.0, Some("plumb_bob")));
        let refused = |change: &dyn Fn(&mut CameraCalibration)| {
            let mut other = message.clone();
            change(&mut other);
            read(&other, true).unwrap_err().to_string()
        };
        assert!(refused(&|c| c.p.clear()).contains("P has 0 numbers, 12 are expected"));
        assert!(refused(&|c| c.p[3] = -4.2).contains("the first camera of a pair"));
        assert!(refused(&|c| c.r[1] = 0.01).contains("turned against the frame of their camera"));
    }

    #[test]
    fn a_wide_lens_tells_that_its_corners_show_nothing() {
        let mut message = calibration_message();
        (message.width, message.height) = (641, 481);
        message.k = vec![300.0, 0.0, 320.0, 0.0, 300.0, 240.0, 0.0, 0.0, 1.0];
        message.d = vec![-0.3, 0.0, 0.0, 0.0, 0.0];
        let note = read_calibration(encoded(CAMERA_CALIBRATION, &message), false).unwrap().note().unwrap();
        assert!(note.contains("(plumb_bob) holds up to 46.5 degrees from its axis: "), "{note}");
        message.d[0] = -0.05;
        assert_eq!(read_calibration(encoded(CAMERA_CALIBRATION, &message), false).unwrap().note(), None);
    }
}
