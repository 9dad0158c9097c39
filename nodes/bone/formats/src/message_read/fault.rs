use osteoflow_geometry::TooFar;

/// A message that cannot be read.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MessageError {
    /// The topic carries something else.
    #[error("{expected} is needed here, but the topic carries {found}; name another topic")]
    Schema {
        /// The schemas that would do.
        expected: &'static str,
        /// The schema that is there.
        found: String,
    },
    /// The message is written in another way.
    #[error(
        "a {schema} written as \"{found}\" is not read; foxglove.* in protobuf and json are, those of ROS 2 in cdr"
    )]
    Encoding {
        /// The schema of the message.
        schema: String,
        /// The encoding that is there.
        found: String,
    },
    /// The bytes are no such message.
    #[error("the message is no {schema}: {reason}")]
    Decode {
        /// The schema it should follow.
        schema: String,
        /// The decoder's error.
        reason: String,
    },
    /// A point field is missing.
    #[error("the points have no field \"{missing}\"; there are: {found}")]
    MissingField {
        /// The field.
        missing: &'static str,
        /// The fields that are there.
        found: String,
    },
    /// A point field has a type that is no number.
    #[error("field \"{field}\" has numeric type {code}, but 1 (uint8) to 8 (float64) are known")]
    FieldType {
        /// The field.
        field: String,
        /// The type's code.
        code: i32,
    },
    /// A point field reaches beyond its point.
    #[error("field \"{field}\" ends at byte {end} of a point, but a point has {stride} bytes (point_stride)")]
    FieldEnd {
        /// The field.
        field: String,
        /// Where it ends.
        end: u64,
        /// The bytes of a point.
        stride: u32,
    },
    /// The data is not a whole number of points.
    #[error(
        "the data has {n_bytes} bytes, which is no whole number of points of {stride} bytes: {rest} remain; \
         was the message cut short?"
    )]
    Length {
        /// The bytes there are.
        n_bytes: usize,
        /// The bytes of a point.
        stride: u32,
        /// The bytes behind the last whole point.
        rest: usize,
    },
    /// A point that is too far.
    #[error("point {number}, at byte {byte} of the data: {far}")]
    Point {
        /// Its number, from 1.
        number: usize,
        /// Where it begins.
        byte: usize,
        /// Its coordinate.
        far: TooFar,
    },
    /// A pose that is no rigid motion.
    #[error("the {what} cannot be used: {reason}")]
    Pose {
        /// Which pose it is.
        what: &'static str,
        /// The reason.
        reason: String,
    },
    /// A region of interest that cannot be read.
    #[error(
        "metadata \"procedure\", key \"{key}\": {reason}; write three numbers in metres, such as \"-0.1 -0.1 0.2\""
    )]
    Region {
        /// The key.
        key: String,
        /// The reason.
        reason: String,
    },
}
