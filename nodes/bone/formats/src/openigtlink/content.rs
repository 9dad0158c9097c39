//! The content of each type of message.

use super::{
    bytes::{EncodeError, Reader, put_floats, put_name},
    image::PixelImage,
    metadata::encoding_of,
    poly_data::PolyData,
};
use nalgebra::{Isometry3, Matrix4};
use osteoflow_geometry::{Nearest, RigidError, nearest_isometry};

/// The content of a message.
#[derive(Debug, Clone, PartialEq)]
pub enum Body {
    /// TRANSFORM.
    Transform(Affine),
    /// TDATA.
    Tracking(Vec<TrackedTool>),
    /// POSITION: one, but pyigtl sends lists.
    Positions(Vec<Position>),
    /// POINT.
    Points(Vec<Fiducial>),
    /// POLYDATA.
    PolyData(PolyData),
    /// IMAGE.
    Image(PixelImage),
    /// STATUS.
    Status(Status),
    /// STRING.
    Text(String),
    /// STT_TDATA: asks a server for TDATA.
    StartTracking {
        /// The least time between two, ms.
        interval_ms: u32,
        /// The name of the coordinates; empty for those of the server.
        coordinates: String,
    },
    /// A type that is not decoded.
    Other {
        /// The type.
        type_name: String,
        /// The size of its content.
        n_bytes: usize,
    },
}

/// The upper three rows of a 4 × 4 matrix, mm, column by column as they are sent: R11 R21 R31 R12 .. R33 TX TY TZ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Affine(pub [f32; 12]);

impl Affine {
    /// A rigid motion in single precision.
    pub fn of(isometry: &Isometry3<f64>) -> Self {
        let matrix = isometry.to_homogeneous();
        Self(std::array::from_fn(|k| matrix[(k % 3, k / 3)] as f32))
    }

    /// The matrix, with 0 0 0 1 as its last row.
    pub fn matrix(&self) -> Matrix4<f64> {
        Matrix4::from_fn(|row, column| match row {
            3 => f64::from(u8::from(column == 3)),
            _ => f64::from(self.0[3 * column + row]),
        })
    }

    /// The nearest rigid motion.
    ///
    /// # Errors
    /// [`RigidError`] if a number is not finite, or the matrix mirrors, scales or shears by more than rounding explains.
    pub fn rigid(&self) -> Result<Nearest<Isometry3<f64>>, RigidError> {
        nearest_isometry(&self.matrix())
    }
}

/// A tool of a TDATA.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackedTool {
    /// Its name.
    pub name: String,
    /// 1 tracker, 2 instrument of 6 degrees of freedom, 3 tip alone, 4 tip and handle.
    pub kind: u8,
    /// Its pose.
    pub matrix: Affine,
}

/// A position, with an orientation if it has one.
#[derive(Debug, Clone, PartialEq)]
pub struct Position {
    /// Its name; empty in a POSITION by the specification.
    pub name: String,
    /// mm.
    pub position: [f32; 3],
    /// x, y, z, w.
    pub quaternion: Option<[f32; 4]>,
}

/// A point of a POINT.
#[derive(Debug, Clone, PartialEq)]
pub struct Fiducial {
    /// Its name.
    pub name: String,
    /// Its group, such as `Fiducial`.
    pub group: String,
    /// Red, green, blue, opacity.
    pub rgba: [u8; 4],
    /// mm.
    pub position: [f32; 3],
    /// mm.
    pub diameter: f32,
    /// The image it belongs to.
    pub owner: String,
}

impl Fiducial {
    /// A point without an owner.
    pub fn new(name: impl Into<String>, position: [f32; 3]) -> Self {
        let (group, rgba) = ("Fiducial".into(), [255, 255, 0, 255]);
        Self { name: name.into(), group, rgba, position, diameter: 0.0, owner: String::new() }
    }
}

/// A STATUS.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Status {
    /// 1 OK, 13 not ready, 10 configuration error, 16 device not present, 19 exiting; the rest is in the specification.
    pub code: u16,
    /// A number of the sender.
    pub sub_code: i64,
    /// A name of the sender.
    pub name: String,
    /// A sentence.
    pub message: String,
}

impl Status {
    /// All is well.
    pub const OK: u16 = 1;
    /// The device is starting up.
    pub const NOT_READY: u16 = 13;
    /// The device is disabled.
    pub const DISABLED: u16 = 15;
    /// The sender ends.
    pub const EXITING: u16 = 19;

    /// A status without a number of the sender.
    pub fn new(code: u16, name: impl Into<String>, message: impl Into<String>) -> Self {
        Self { code, sub_code: 0, name: name.into(), message: message.into() }
    }
}

impl Body {
    /// The name of the type.
    pub fn type_name(&self) -> &str {
        match self {
            Self::Transform(_) => "TRANSFORM",
            Self::Tracking(_) => "TDATA",
            Self::Positions(_) => "POSITION",
            Self::Points(_) => "POINT",
            Self::PolyData(_) => "POLYDATA",
            Self::Image(_) => "IMAGE",
            Self::Status(_) => "STATUS",
            Self::Text(_) => "STRING",
            Self::StartTracking { .. } => "STT_TDATA",
            Self::Other { type_name, .. } => type_name,
        }
    }

    pub(super) fn parse(type_name: &str, reader: &mut Reader<'_>) -> Result<Self, String> {
        Ok(match type_name {
            "TRANSFORM" => Self::Transform(Affine(reader.floats()?)),
            "TDATA" => Self::Tracking(list(reader, 70, tool)?),
            "POSITION" => Self::Positions(positions(reader)?),
            "POINT" => Self::Points(list(reader, 136, fiducial)?),
            "POLYDATA" => Self::PolyData(PolyData::parse(reader)?),
            "IMAGE" => Self::Image(PixelImage::parse(reader)?),
            "STATUS" => Self::Status(Status {
                code: reader.u16()?,
                sub_code: reader.i64()?,
                name: reader.name(20)?,
                message: reader.name(reader.left())?,
            }),
            "STRING" => {
                let (_encoding, n) = (reader.u16()?, reader.u16()?);
                Self::Text(String::from_utf8_lossy(reader.take(usize::from(n))?).into_owned())
            }
            "STT_TDATA" => Self::StartTracking { interval_ms: reader.u32()?, coordinates: reader.name(32)? },
            _ => Self::Other { type_name: type_name.into(), n_bytes: reader.take(reader.left())?.len() },
        })
    }

    pub(super) fn put(&self, out: &mut Vec<u8>) -> Result<(), EncodeError> {
        match self {
            Self::Transform(matrix) => put_floats(out, &matrix.0),
            Self::Tracking(tools) => {
                for tool in tools {
                    put_name(out, "the tool", &tool.name, 20)?;
                    out.extend([tool.kind, 0]);
                    put_floats(out, &tool.matrix.0);
                }
            }
            Self::Positions(positions) => match &positions[..] {
                [Position { name, position, quaternion: Some(quaternion) }] if name.is_empty() => {
                    put_floats(out, position);
                    put_floats(out, quaternion);
                }
                _ => {
                    let message = "a POSITION is one position without a name, with a quaternion";
                    return Err(EncodeError(message.into()));
                }
            },
            Self::Points(points) => {
                for point in points {
                    put_name(out, "the point", &point.name, 64)?;
                    put_name(out, "the group", &point.group, 32)?;
                    out.extend(point.rgba);
                    put_floats(out, &point.position);
                    put_floats(out, &[point.diameter]);
                    put_name(out, "the owner", &point.owner, 20)?;
                }
            }
            Self::PolyData(poly_data) => poly_data.put(out)?,
            Self::Image(image) => image.put(out)?,
            Self::Status(Status { code, sub_code, name, message }) => {
                out.extend(code.to_be_bytes());
                out.extend(sub_code.to_be_bytes());
                put_name(out, "the name of the status", name, 20)?;
                if message.len() >= 1 << 16 || message.contains('\0') {
                    return Err(EncodeError::too_long("the message of the status", message, (1 << 16) - 1));
                }
                out.extend(message.as_bytes());
                out.push(0);
            }
            Self::Text(text) => {
                let too_long = |_| EncodeError::too_long("the text", text, usize::from(u16::MAX));
                let n = u16::try_from(text.len()).map_err(too_long)?;
                out.extend(encoding_of(text).to_be_bytes());
                out.extend(n.to_be_bytes());
                out.extend(text.as_bytes());
            }
            Self::StartTracking { interval_ms, coordinates } => {
                out.extend(interval_ms.to_be_bytes());
                put_name(out, "the coordinates", coordinates, 32)?;
            }
            Self::Other { type_name, .. } => {
                return Err(EncodeError(format!("{type_name} cannot be written")));
            }
        }
        Ok(())
    }
}

/// Items of `n_bytes` each, to the end.
fn list<T>(
    reader: &mut Reader<'_>,
    n_bytes: usize,
    item: impl Fn(&mut Reader<'_>) -> Result<T, String>,
) -> Result<Vec<T>, String> {
    if !reader.left().is_multiple_of(n_bytes) {
        return Err(format!("{} bytes are not a multiple of {n_bytes}", reader.left()));
    }
    (0..reader.left() / n_bytes).map(|_| item(reader)).collect()
}

fn tool(reader: &mut Reader<'_>) -> Result<TrackedTool, String> {
    let (name, [kind, _reserved]) = (reader.name(20)?, reader.array()?);
    Ok(TrackedTool { name, kind, matrix: Affine(reader.floats()?) })
}

fn fiducial(reader: &mut Reader<'_>) -> Result<Fiducial, String> {
    Ok(Fiducial {
        name: reader.name(64)?,
        group: reader.name(32)?,
        rgba: reader.array()?,
        position: reader.floats()?,
        diameter: reader.floats::<1>()?[0],
        owner: reader.name(20)?,
    })
}

fn positions(reader: &mut Reader<'_>) -> Result<Vec<Position>, String> {
    let n = reader.left();
    if matches!(n, 12 | 24 | 28) {
        let position = reader.floats()?;
        let quaternion = match n {
            28 => Some(reader.floats()?),
            24 => {
                let [x, y, z] = reader.floats()?;
                Some([x, y, z, (1.0 - (x * x + y * y + z * z)).max(0.0).sqrt()])
            }
            _ => None,
        };
        return Ok(vec![Position { name: String::new(), position, quaternion }]);
    }
    list(reader, 152, |reader| {
        let name = reader.name(64)?;
        reader.take(36)?;
        let (position, quaternion) = (reader.floats()?, Some(reader.floats()?));
        reader.take(24)?;
        Ok(Position { name, position, quaternion })
    })
}
