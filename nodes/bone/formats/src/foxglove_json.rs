//! The Foxglove messages in the JSON of several writers; the types also hold decoded protobuf.

use base64::{
    Engine,
    alphabet::{STANDARD, URL_SAFE},
    engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig},
};
use foxglove::messages::{
    PackedElementField, PointCloud, Pose, Quaternion, Timestamp, Vector3, packed_element_field::NumericType,
};
use osteoflow_geometry::StampNs;
use serde::{Deserialize, Deserializer, de::DeserializeOwned};

/// Reads JSON, also with the bare `NaN` and `Infinity` of Python's writer, which the standard forbids.
pub(crate) fn parse<T: DeserializeOwned>(data: &[u8]) -> Result<T, serde_json::Error> {
    serde_json::from_slice(data).or_else(|error| match without_bare_nan(data) {
        Some(mended) => serde_json::from_slice(&mended),
        None => Err(error),
    })
}

/// The text with null for each bare `NaN`, `Infinity` and `-Infinity`; `None` if there is none.
fn without_bare_nan(data: &[u8]) -> Option<Vec<u8>> {
    let (mut mended, mut in_text, mut at, mut any) = (Vec::with_capacity(data.len()), false, 0, false);
    while at < data.len() {
        if !in_text {
            let word = [&b"NaN"[..], b"Infinity", b"-Infinity"].into_iter().find(|word| data[at..].starts_with(word));
            if let Some(word) = word {
                mended.extend_from_slice(b"null");
                at += word.len();
                any = true;
                continue;
            }
        }
        match data[at] {
            b'"' => in_text = !in_text,
            b'\\' if in_text && at + 1 < data.len() => {
                mended.push(data[at]);
                at += 1;
            }
            _ => {}
        }
        mended.push(data[at]);
        at += 1;
    }
    any.then_some(mended)
}

#[derive(Deserialize)]
pub(crate) struct JsonCloud {
    #[serde(default)]
    timestamp: Time,
    #[serde(default, alias = "frameId")]
    frame_id: String,
    #[serde(default)]
    pose: Option<JsonPose>,
    #[serde(default, alias = "pointStride")]
    point_stride: u32,
    #[serde(default)]
    fields: Vec<JsonField>,
    #[serde(default)]
    data: String,
}

#[derive(Deserialize)]
struct JsonField {
    name: String,
    #[serde(default)]
    offset: u32,
    #[serde(default, rename = "type")]
    kind: JsonFieldType,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum JsonFieldType {
    Code(i32),
    Name(String),
}

impl Default for JsonFieldType {
    fn default() -> Self {
        Self::Code(0)
    }
}

#[derive(Deserialize)]
pub(crate) struct JsonPose {
    #[serde(default, deserialize_with = "vector")]
    pub(crate) position: Option<Vector3>,
    #[serde(default, deserialize_with = "quaternion")]
    pub(crate) orientation: Option<Quaternion>,
}

#[derive(Deserialize)]
pub(crate) struct JsonPoseInFrame {
    #[serde(default)]
    pub(crate) timestamp: Time,
    #[serde(default, alias = "frameId")]
    pub(crate) frame_id: String,
    #[serde(default)]
    pub(crate) pose: Option<JsonPose>,
}

#[derive(Deserialize)]
pub(crate) struct JsonTransform {
    #[serde(default)]
    pub(crate) timestamp: Time,
    #[serde(default, alias = "parentFrameId")]
    pub(crate) parent_frame_id: String,
    #[serde(default, alias = "childFrameId")]
    pub(crate) child_frame_id: String,
    #[serde(default, deserialize_with = "vector")]
    pub(crate) translation: Option<Vector3>,
    #[serde(default, deserialize_with = "quaternion")]
    pub(crate) rotation: Option<Quaternion>,
}

#[derive(Deserialize)]
pub(crate) struct JsonTransforms {
    #[serde(default)]
    pub(crate) transforms: Vec<JsonTransform>,
}

impl JsonCloud {
    /// The message that protobuf would have given.
    pub(crate) fn into_message(self) -> Result<PointCloud, String> {
        let field = |f: JsonField| {
            let kind = match f.kind {
                JsonFieldType::Code(code) => code,
                JsonFieldType::Name(name) => NumericType::from_str_name(&name)
                    .ok_or_else(|| format!("field \"{}\" has the unknown type \"{name}\"", f.name))?
                    .into(),
            };
            Ok(PackedElementField { name: f.name, offset: f.offset, r#type: kind })
        };
        Ok(PointCloud {
            timestamp: self.timestamp.nanoseconds().and_then(|ns| {
                let sec = u32::try_from(ns / 1_000_000_000).ok()?;
                Some(Timestamp::new(sec, (ns % 1_000_000_000) as u32))
            }),
            frame_id: self.frame_id,
            pose: self.pose.map(|p| Pose { position: p.position, orientation: p.orientation }),
            point_stride: self.point_stride,
            fields: self.fields.into_iter().map(field).collect::<Result<_, String>>()?,
            data: bytes_of(&self.data)?.into(),
        })
    }
}

/// Base64 of either alphabet, padded or not.
fn bytes_of(text: &str) -> Result<Vec<u8>, String> {
    let config = GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent);
    let alphabet = if text.contains(['-', '_']) { URL_SAFE } else { STANDARD };
    let text = text.trim();
    GeneralPurpose::new(&alphabet, config).decode(text).map_err(|error| format!("data is no base64: {error}"))
}

/// A timestamp, if the writer set it.
#[derive(Default)]
pub(crate) struct Time(Option<StampNs>);

impl Time {
    /// Nanoseconds since the epoch; `None` if absent or zero, which means unset.
    pub(crate) fn nanoseconds(&self) -> Option<StampNs> {
        self.0.filter(|&ns| ns != 0)
    }
}

impl From<Option<Timestamp>> for Time {
    fn from(timestamp: Option<Timestamp>) -> Self {
        Self(timestamp.map(|t| StampNs::from(t.sec()) * 1_000_000_000 + StampNs::from(t.nsec())))
    }
}

impl<'de> Deserialize<'de> for Time {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Spelling {
            Text(String),
            Parts {
                #[serde(alias = "seconds", alias = "secs", default)]
                sec: Number,
                #[serde(alias = "nanos", alias = "nsecs", alias = "nanosec", default)]
                nsec: Number,
            },
        }
        let parts = |sec: Number, nsec: Number| {
            let whole = |n: Number| (n.0.fract() == 0.0 && n.0.abs() < 9e9).then_some(n.0 as StampNs);
            Some(whole(sec)? * 1_000_000_000 + whole(nsec)?)
        };
        match Option::<Spelling>::deserialize(deserializer)? {
            None => Ok(Self(None)),
            Some(Spelling::Parts { sec, nsec }) => parts(sec, nsec)
                .map(|ns| Self(Some(ns)))
                .ok_or_else(|| serde::de::Error::custom("timestamp: sec and nsec must be whole numbers")),
            Some(Spelling::Text(text)) => rfc3339(&text)
                .map(|ns| Self(Some(ns)))
                .ok_or_else(|| serde::de::Error::custom(format!("timestamp \"{text}\" is no RFC 3339 time"))),
        }
    }
}

/// Nanoseconds since the epoch of a time such as `2025-06-15T15:06:51.000359810Z` or with an offset such as `+02:00`.
fn rfc3339(text: &str) -> Option<StampNs> {
    StampNs::try_from(text.parse::<jiff::Timestamp>().ok()?.as_nanosecond()).ok()
}

/// A number in the spellings of JSON writers: `1.5`, `"1.5"`, `"NaN"`, `null` for NaN.
#[derive(Clone, Copy, Default)]
struct Number(f64);

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Spelling {
            Number(f64),
            Text(String),
        }
        match Option::<Spelling>::deserialize(deserializer)? {
            None => Ok(Self(f64::NAN)),
            Some(Spelling::Number(value)) => Ok(Self(value)),
            Some(Spelling::Text(text)) => {
                text.parse().map(Self).map_err(|_| serde::de::Error::custom(format!("\"{text}\" is not a number")))
            }
        }
    }
}

/// The numbers of a vector or quaternion.
#[derive(Deserialize, Default)]
#[serde(default)]
struct Numbers {
    x: Number,
    y: Number,
    z: Number,
    w: Number,
}

fn vector<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Vector3>, D::Error> {
    Ok(Option::<Numbers>::deserialize(deserializer)?.map(|v| Vector3 { x: v.x.0, y: v.y.0, z: v.z.0 }))
}

fn quaternion<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Quaternion>, D::Error> {
    Ok(Option::<Numbers>::deserialize(deserializer)?.map(|q| Quaternion { x: q.x.0, y: q.y.0, z: q.z.0, w: q.w.0 }))
}
