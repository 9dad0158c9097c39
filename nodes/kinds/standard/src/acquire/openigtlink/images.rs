//! Images to the payloads of declared ports: point images, depth images, and pictures.

use super::ports::{Content, finite};
use crate::acquire::network::{Port, PortItems};
use osteoflow_formats::openigtlink::{NO_DEPTH_16, PixelImage, Scalar};
use osteoflow_geometry::{
    Distortion, Image, Intrinsics, StampNs,
    nalgebra::{Matrix3, Point3},
    nearest_isometry,
};

/// The camera of fx, fy, cx and cy, px, with the coefficients of its distortion; `None` of no numbers.
///
/// # Errors
/// The parameter of another number of numbers, or of some that no camera has, and the message.
pub(super) fn camera_of(
    numbers: &[f64],
    model: Option<&str>,
    coefficients: &[f64],
) -> Result<Option<Intrinsics>, (&'static str, String)> {
    if model.is_some() && coefficients.is_empty() {
        return Err(("distortion_model", "distortion_model is given, and distortion, its coefficients, is not".into()));
    }
    let distortion = match coefficients {
        [] => Distortion::NONE,
        _ if numbers.is_empty() => {
            return Err(("distortion", "distortion is that of a camera, whose intrinsics are not given".into()));
        }
        _ => Distortion::named(model.unwrap_or("plumb_bob"), coefficients)
            .map_err(|error| ("distortion", error.to_string()))?,
    };
    let fault = |message| Err(("intrinsics", message));
    let &[fx, fy, cx, cy] = numbers else {
        return match numbers.len() {
            0 => Ok(None),
            n => fault(format!("intrinsics have {n} numbers, and are fx, fy, cx and cy, px")),
        };
    };
    if numbers.iter().any(|c| !c.is_finite()) || fx <= 0.0 || fy <= 0.0 {
        return fault(format!(
            "intrinsics fx {fx}, fy {fy}, cx {cx}, cy {cy}: finite numbers and positive focal lengths are expected"
        ));
    }
    Ok(Some(Intrinsics { fx, fy, cx, cy, distortion }))
}

/// What a port knows of the camera whose images it reads.
#[derive(Default)]
pub(super) struct Camera {
    pub(super) intrinsics: Option<Intrinsics>,
    pub(super) depth_unit_mm: Option<f64>,
    pub(super) use_matrix: bool,
    /// Whether it was reported that the matrix of a message is not used.
    pub(super) has_told: bool,
}

/// Why an image gives no item.
pub(super) enum Refusal {
    /// The graph has to say more, or something else.
    Graph(String),
    /// This message alone.
    Message(String),
}

impl From<String> for Refusal {
    fn from(message: String) -> Self {
        Self::Message(message)
    }
}

impl Port<Content> {
    /// The cloud of a point image or a depth image.
    pub(super) fn image_cloud(
        &mut self,
        image: &PixelImage,
        device: &str,
        stamp_ns: StampNs,
    ) -> Result<PortItems, Refusal> {
        let camera = &self.content.camera;
        let form = image.form();
        if image.part_size[2] != 1 {
            return Err(Refusal::Graph(format!("{device} sends {form}: a volume, and a cloud is of one slice")));
        }
        let points: Vec<Option<Point3<f64>>> = match (image.n_components, image.scalar) {
            (3, Scalar::F32 | Scalar::F64) => {
                check_byte_order(image)?;
                triples(image).collect()
            }
            (1, Scalar::U16 | Scalar::I16 | Scalar::U32 | Scalar::I32 | Scalar::F32 | Scalar::F64) => {
                let (Some(intrinsics), Some(unit_mm)) = (camera.intrinsics, camera.depth_unit_mm) else {
                    return Err(Refusal::Graph(format!(
                        "{device} sends an IMAGE of {form}: depth, for which the port needs intrinsics = [fx, fy, cx, cy] and depth_unit_mm, the depth of one step (0.1 for Revopoint, 1 for Kinect and RealSense)"
                    )));
                };
                depths(image, intrinsics, unit_mm).collect()
            }
            _ => {
                return Err(Refusal::Graph(format!(
                    "{device} sends an IMAGE of {form}: a picture; a cloud is of 3 float32 (x, y, z) or 1 uint16 (depth), and a \
                     picture is of type = \"geometry/Image\""
                )));
            }
        };
        let n_all = points.len();
        let kept: Vec<Point3<f64>> = points.into_iter().flatten().collect();
        if kept.is_empty() {
            return Err(Refusal::Message(format!("none of its {n_all} pixels has a point")));
        }
        let (n_kept, t_space_index) = (kept.len(), image.t_space_index());
        osteoflow_node::tracing::debug!(device, n_all, n_kept, "pixels with a point");
        let has_matrix = (t_space_index.fixed_view::<3, 3>(0, 0) - Matrix3::identity()).amax() > 1e-6;
        let mut note = None;
        let kept = if camera.use_matrix {
            let moved = nearest_isometry(&t_space_index).map_err(|error| {
                Refusal::Message(format!("use_matrix = true, and its matrix is no rigid motion: {error}"))
            })?;
            kept.into_iter().map(|point| moved.value * point).collect()
        } else {
            if has_matrix && !self.content.camera.has_told {
                self.content.camera.has_told = true;
                note = Some(format!(
                    "{device}: its coordinates are taken as they are, and the matrix of the IMAGE, which turns or scales, is not used; \
                     set use_matrix = true if it takes them to {}",
                    self.content.frame
                ));
            }
            kept
        };
        let mut items = self.cloud_of(kept, n_all, device, stamp_ns)?;
        items.notes.extend(note);
        Ok(items)
    }

    /// The picture of an image of 8 bits.
    pub(super) fn picture(
        &mut self,
        image: &PixelImage,
        device: &str,
        stamp_ns: StampNs,
    ) -> Result<PortItems, Refusal> {
        let form = image.form();
        let (8, 1 | 3 | 4, [width, height, 1], Some(intrinsics)) =
            (8 * image.scalar.n_bytes(), image.n_components, image.part_size, self.content.camera.intrinsics)
        else {
            return Err(Refusal::Graph(format!(
                "{device} sends an IMAGE of {form}, and geometry/Image is of 1, 3 or 4 uint8; is it the device of another port?"
            )));
        };
        if !image.is_whole() {
            return Err(Refusal::Message(format!("it is a part of {} x {} pixels", image.size[0], image.size[1])));
        }
        let (channels, pixels) = match image.n_components {
            // Red, green, blue, opacity.
            4 => (3, image.pixels.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect::<Vec<u8>>()),
            n => (u32::from(n), image.pixels.clone()),
        };
        let size = [u32::from(width), u32::from(height)];
        let picture = Image::new(&self.content.frame, size, channels, intrinsics, pixels)
            .map_err(|error| Refusal::Graph(format!("{device}: {error}")))?;
        let label = self.label(device).unwrap_or(device);
        Ok(PortItems::value(stamp_ns, picture.at(stamp_ns).labelled(label)))
    }
}

/// Refuses coordinates that make sense in the other byte order alone: the library of the protocol states the highest byte first unless
/// it is told otherwise, whatever is sent.
fn check_byte_order(image: &PixelImage) -> Result<(), Refusal> {
    // From a thousandth of a millimetre to ten metres.
    let largest = |image: &PixelImage| image.values().iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
    let is_length = |length: f64| length == 0.0 || (1e-3..1e4).contains(&length);
    let stated = largest(image);
    if is_length(stated) {
        return Ok(());
    }
    let other = largest(&PixelImage { is_little_endian: !image.is_little_endian, ..image.clone() });
    if !is_length(other) {
        return Ok(());
    }
    let (is, not) = if image.is_little_endian { ("lowest", "highest") } else { ("highest", "lowest") };
    Err(Refusal::Message(format!(
        "its largest coordinate is {stated:.1e} mm with the {is} byte first, as it states, and {other:.1} mm with the {not} first; let its \
         sender state the byte order of its numbers (SetEndian)"
    )))
}

/// The points of three components; `None` where a camera saw nothing: not finite, or zero to the bit.
fn triples(image: &PixelImage) -> impl Iterator<Item = Option<Point3<f64>>> {
    let mut values = image.values().into_iter();
    std::iter::from_fn(move || {
        let point = [values.next()?, values.next()?, values.next()?];
        Some(finite(point).filter(|point| point.coords.norm_squared() > 0.0))
    })
}

/// The points of depths along the optical axis; `None` where there is none.
fn depths(image: &PixelImage, intrinsics: Intrinsics, unit_mm: f64) -> impl Iterator<Item = Option<Point3<f64>>> {
    let ([u0, v0, _], width) = (image.part_offset, usize::from(image.part_size[0]));
    image.values().into_iter().enumerate().map(move |(k, depth)| {
        let pixel = [f64::from(u0) + (k % width) as f64, f64::from(v0) + (k / width) as f64];
        let z_mm = depth * unit_mm;
        let is_depth = depth > 0.0 && z_mm.is_finite() && !(image.scalar == Scalar::U16 && depth == NO_DEPTH_16);
        Some(Point3::from(intrinsics.ray(pixel)? * z_mm)).filter(|_| is_depth)
    })
}
