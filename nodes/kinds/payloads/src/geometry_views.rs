//! The payloads of `osteoflow-geometry`: millimetres and `f64`, bit for bit.

#[cfg(feature = "viewer")]
use crate::foxglove;
use crate::{
    Table,
    columns::{from_column, to_column},
};
use osteoflow_geometry::{
    Axes, Cloud, Distortion, Frame, Image, Intrinsics, Mesh, NamedPoint, Plane, PlanePlace, Planes, Points, Pose,
    Region, RigidError, SurfaceOrigin, TooFar, check_rotation, exact_isometry, matrix_rows,
    nalgebra::{Isometry3, Matrix3, Point3, Quaternion, Vector3},
};
use osteoflow_node::{ColumnType, Field, Payload, SchemaEntry, View, ViewError};
#[cfg(feature = "viewer")]
use osteoflow_node::{Display, DisplayContext, Value};
use serde_json::{Value as Json, json};

/// Separator of names in one text field; a name holds no line break.
pub(crate) const LINE: &str = "\n";

/// Translation x, y, z in mm and quaternion x, y, z, w.
fn numbers(t: &Isometry3<f64>) -> [f64; 7] {
    let (v, q) = (t.translation.vector, t.rotation.coords);
    [v.x, v.y, v.z, q.x, q.y, q.z, q.w]
}

/// The motion of [`numbers`], bit for bit.
fn isometry(n: &[f64; 7]) -> Result<Isometry3<f64>, RigidError> {
    exact_isometry(Vector3::new(n[0], n[1], n[2]), Quaternion::new(n[6], n[3], n[4], n[5]))
}

/// Three coordinates of that name.
fn point(view: &View, name: &str) -> Result<Point3<f64>, ViewError> {
    let numbers = view.floats::<3>(name)?;
    if !numbers.iter().all(|c| c.is_finite()) {
        return Err(invalid(format!("{name} is not finite")));
    }
    TooFar::check(&numbers).map_err(|far| invalid(format!("{name}: {far}")))?;
    Ok(numbers.into())
}

pub(crate) fn invalid(error: impl std::fmt::Display) -> ViewError {
    ViewError::Invalid(error.to_string())
}

/// Largest distance of a stamp from 1970, as for the stamps of items.
const MAX_STAMP_NS: u64 = 1 << 62;

/// The stamp of the head.
fn stamp_ns(view: &View) -> Result<i64, ViewError> {
    let stamp_ns = view.int("stamp_ns")?;
    match stamp_ns.unsigned_abs() > MAX_STAMP_NS {
        true => Err(invalid(format!("stamp_ns {stamp_ns} is more than 146 years from 1970; is it in nanoseconds?"))),
        false => Ok(stamp_ns),
    }
}

fn frame(view: &View) -> Result<Frame, ViewError> {
    frame_of(view, "frame")
}

fn frame_of(view: &View, field: &str) -> Result<Frame, ViewError> {
    let name = view.shared_text(field)?;
    let is_name = !name.trim().is_empty();
    is_name
        .then(|| Frame::from(name))
        .ok_or_else(|| invalid(format!("\"{field}\" is empty; it names a frame of the graph")))
}

impl Payload<Table> for Cloud {
    const NAME: &'static str = "geometry/Cloud";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[
        SchemaEntry::text("frame"),
        SchemaEntry::int("stamp_ns"),
        SchemaEntry::text("label").optional(),
        SchemaEntry::float_list("viewpoint").optional().unit("pose").doc("the sensor's pose, 7 numbers"),
        SchemaEntry::column("points", ColumnType::F64, 3).unit("mm"),
        SchemaEntry::column("normals", ColumnType::F64, 3).optional().doc("of length 1, one for each point"),
        SchemaEntry::column("extra/*", ColumnType::F64, 1).doc("a value for each point, by name"),
    ];

    fn to_view(&self) -> View {
        let mut view = View::new().with("frame", self.frame.shared()).with("stamp_ns", self.stamp_ns);
        if let Some(label) = &self.label {
            view = view.with("label", label.clone());
        }
        if let Some(viewpoint) = &self.viewpoint {
            view = view.with("viewpoint", numbers(viewpoint).to_vec());
        }
        view = view.with_column(to_column("points", ColumnType::F64, self.point_column()));
        if let Some(normals) = self.normal_column() {
            view = view.with_column(to_column("normals", ColumnType::F64, normals));
        }
        for (name, values) in self.extras() {
            view = view.with_column(to_column(format!("extra/{name}"), ColumnType::F64, values));
        }
        view
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        let mut cloud = Cloud::new(frame(view)?, from_column(view, "points")?).map_err(invalid)?;
        cloud.stamp_ns = stamp_ns(view)?;
        cloud.label = view.shared_text("label").ok();
        if view.field("viewpoint").is_some() {
            let viewpoint = isometry(&view.floats("viewpoint")?);
            cloud.viewpoint = Some(viewpoint.map_err(|error| invalid(format!("viewpoint: {error}")))?);
        }
        if view.column("normals").is_ok() {
            cloud = cloud.with_normals(from_column(view, "normals")?).map_err(invalid)?;
        }
        for column in &view.columns {
            if let Some(name) = column.name.strip_prefix("extra/") {
                cloud = cloud.with_extra(name, from_column(view, &column.name)?).map_err(invalid)?;
            }
        }
        Ok(cloud)
    }

    fn n_bytes(&self) -> usize {
        let normals = self.normals().map_or(0, size_of_val);
        let extras: usize = self.extras().iter().map(|(_, values)| size_of_val(&**values)).sum();
        size_of::<Self>() + size_of_val(self.points()) + normals + extras
    }

    fn to_result(&self) -> Json {
        json!({ "frame": self.frame, "stamp_ns": self.stamp_ns, "label": self.label, "n_points": self.len() })
    }

    #[cfg(feature = "viewer")]
    fn display() -> Option<Display> {
        foxglove::schema::<foxglove::PointCloud>()
    }

    #[cfg(feature = "viewer")]
    fn to_display(&self, about: &DisplayContext<'_>) -> Option<Vec<u8>> {
        foxglove::points(&self.frame, about.stamp_ns, self.points())
    }

    #[cfg(feature = "viewer")]
    fn to_display_on(&self, surface: &Value, pose: &Value, about: &DisplayContext<'_>) -> Option<Vec<u8>> {
        foxglove::points_on(self, surface, pose.get()?, about.stamp_ns)
    }

    #[cfg(feature = "viewer")]
    fn display_centre(&self) -> Option<[f64; 3]> {
        foxglove::centre(self.points())
    }
}

impl Payload<Table> for Mesh {
    const NAME: &'static str = "geometry/Mesh";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[
        SchemaEntry::text("frame"),
        SchemaEntry::text("origin").doc("where the surface comes from: exact, simulated_ct or user"),
        SchemaEntry::column("vertices", ColumnType::F64, 3).unit("mm"),
        SchemaEntry::column("faces", ColumnType::U32, 3).doc("indices of the corners of triangles"),
    ];

    fn to_view(&self) -> View {
        View::new()
            .with("frame", self.frame.shared())
            .with("origin", self.origin.to_string())
            .with_column(to_column("vertices", ColumnType::F64, self.vertex_column()))
            .with_column(to_column("faces", ColumnType::U32, self.face_column()))
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        let origin = origin(view.text("origin")?)?;
        Mesh::new(frame(view)?, origin, from_column(view, "vertices")?, from_column(view, "faces")?).map_err(invalid)
    }

    fn n_bytes(&self) -> usize {
        size_of::<Self>() + size_of_val(self.vertices()) + size_of_val(self.faces())
    }

    fn to_result(&self) -> Json {
        json!({ "frame": self.frame, "n_vertices": self.vertices().len(), "n_faces": self.faces().len() })
    }

    #[cfg(feature = "viewer")]
    fn display() -> Option<Display> {
        foxglove::surface_schema()
    }

    #[cfg(feature = "viewer")]
    fn to_display(&self, about: &DisplayContext<'_>) -> Option<Vec<u8>> {
        foxglove::mesh(self, about)
    }

    #[cfg(feature = "viewer")]
    fn display_centre(&self) -> Option<[f64; 3]> {
        foxglove::centre(self.vertices())
    }
}

/// The surface origin of that name.
pub(crate) fn origin(name: &str) -> Result<SurfaceOrigin, ViewError> {
    [SurfaceOrigin::Exact, SurfaceOrigin::SimulatedCt, SurfaceOrigin::User]
        .into_iter()
        .find(|origin| origin.to_string() == name)
        .ok_or_else(|| invalid(format!("unknown surface origin \"{name}\"")))
}

impl Payload<Table> for Pose {
    const NAME: &'static str = "geometry/Pose";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[
        SchemaEntry::text("to"),
        SchemaEntry::text("from"),
        SchemaEntry::int("stamp_ns"),
        SchemaEntry::floats("isometry", 7).unit("pose").doc("takes coordinates in from to coordinates in to"),
    ];
    const INTERPOLATES: bool = true;

    fn to_view(&self) -> View {
        View::new()
            .with("to", self.to.shared())
            .with("from", self.from.shared())
            .with("stamp_ns", self.stamp_ns)
            .with("isometry", numbers(&self.isometry).to_vec())
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        let (to, from) = (frame_of(view, "to")?, frame_of(view, "from")?);
        let isometry = isometry(&view.floats("isometry")?);
        let isometry = isometry.map_err(|error| invalid(format!("t_{to}_{from} is no rigid motion: {error}")))?;
        Ok(Pose::new(to, from, isometry).at(stamp_ns(view)?))
    }

    fn to_result(&self) -> Json {
        json!({ "to": self.to, "from": self.from, "matrix": matrix_rows(&self.isometry) })
    }

    fn interpolate(a: &Self, b: &Self, s: f64) -> Option<Self> {
        Pose::interpolate(a, b, s)
    }

    #[cfg(feature = "viewer")]
    fn display() -> Option<Display> {
        foxglove::schema::<foxglove::FrameTransform>()
    }

    #[cfg(feature = "viewer")]
    fn to_display(&self, about: &DisplayContext<'_>) -> Option<Vec<u8>> {
        foxglove::transform(self, about)
    }
}

impl Payload<Table> for Points {
    const NAME: &'static str = "geometry/Points";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[
        SchemaEntry::text("frame"),
        SchemaEntry::int("stamp_ns"),
        SchemaEntry::text("names").doc("one a line"),
        SchemaEntry::column("positions", ColumnType::F64, 3).unit("mm"),
        SchemaEntry::column("stamps_ns", ColumnType::I64, 1),
        SchemaEntry::column("confidences", ColumnType::F64, 1).doc("NaN for none"),
    ];

    fn to_view(&self) -> View {
        let names: Vec<&str> = self.points.iter().map(|p| &*p.name).collect();
        let stamps: Vec<i64> = self.points.iter().map(|p| p.stamp_ns).collect();
        let confidences: Vec<f64> = self.points.iter().map(|p| p.confidence.unwrap_or(f64::NAN)).collect();
        View::new()
            .with("frame", self.frame.shared())
            .with("stamp_ns", self.stamp_ns)
            .with("names", names.join(LINE))
            .with_column(to_column("positions", ColumnType::F64, &self.positions().into()))
            .with_column(to_column("stamps_ns", ColumnType::I64, &stamps.into()))
            .with_column(to_column("confidences", ColumnType::F64, &confidences.into()))
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        let positions = from_column::<Point3<f64>>(view, "positions")?;
        let stamps = from_column::<i64>(view, "stamps_ns")?;
        let confidences = from_column::<f64>(view, "confidences")?;
        let names: Vec<&str> =
            if positions.is_empty() { Vec::new() } else { view.text("names")?.split(LINE).collect() };
        if [names.len(), stamps.len(), confidences.len()] != [positions.len(); 3] {
            return Err(invalid("names, positions, stamps and confidences differ in number"));
        }
        if let Some(i) = positions.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
            return Err(invalid(format!("point {i} \"{}\" is not finite", names[i])));
        }
        if let Some((i, far)) = TooFar::first(&positions) {
            return Err(invalid(format!("point {i} \"{}\": {far}", names[i])));
        }
        let points = (0..names.len()).map(|i| NamedPoint {
            name: names[i].into(),
            position: positions[i],
            stamp_ns: stamps[i],
            confidence: Some(confidences[i]).filter(|c| !c.is_nan()),
        });
        Ok(Points { frame: frame(view)?, stamp_ns: stamp_ns(view)?, points: points.collect() })
    }

    fn n_bytes(&self) -> usize {
        size_of::<Self>() + size_of_val(&*self.points)
    }

    fn to_result(&self) -> Json {
        let points = self.points.iter().map(|p| {
            let mut entry = json!({ "name": p.name, "frame": self.frame, "position_mm": p.position.coords.as_slice() });
            if let Some(confidence) = p.confidence {
                entry["confidence"] = confidence.into();
            }
            entry
        });
        Json::Array(points.collect())
    }

    #[cfg(feature = "viewer")]
    fn display() -> Option<Display> {
        foxglove::scene_schema()
    }

    #[cfg(feature = "viewer")]
    fn to_display(&self, about: &DisplayContext<'_>) -> Option<Vec<u8>> {
        foxglove::named_points(self, about)
    }
}

impl Payload<Table> for Planes {
    const NAME: &'static str = "geometry/Planes";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[
        SchemaEntry::text("frame"),
        SchemaEntry::int("stamp_ns"),
        SchemaEntry::text("names").doc("one a line"),
        SchemaEntry::text("unknown").doc("for each plane a line: why its place is unknown, or nothing"),
        SchemaEntry::column("isometries", ColumnType::F64, 7).unit("pose").doc("NaN where the place is unknown"),
    ];

    fn to_view(&self) -> View {
        let names: Vec<&str> = self.planes.iter().map(|p| &*p.name).collect();
        let mut reasons = Vec::new();
        let mut places = Vec::new();
        for plane in &*self.planes {
            match &plane.place {
                PlanePlace::Known(t) => {
                    places.push(numbers(t));
                    reasons.push(String::new());
                }
                PlanePlace::Unknown(reason) => {
                    places.push([f64::NAN; 7]);
                    reasons.push(reason.replace(LINE, " "));
                }
            }
        }
        View::new()
            .with("frame", self.frame.shared())
            .with("stamp_ns", self.stamp_ns)
            .with("names", names.join(LINE))
            .with("unknown", reasons.join(LINE))
            .with_column(to_column("isometries", ColumnType::F64, &places.into()))
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        let places = from_column::<[f64; 7]>(view, "isometries")?;
        let lines = |name| view.text(name).map(|t| t.split(LINE).collect::<Vec<_>>());
        let (names, reasons) = if places.is_empty() { (vec![], vec![]) } else { (lines("names")?, lines("unknown")?) };
        if [names.len(), reasons.len()] != [places.len(); 2] {
            return Err(invalid("names, reasons and places differ in number"));
        }
        let plane = |i: usize| {
            let place = match reasons[i] {
                "" => PlanePlace::Known(
                    isometry(&places[i]).map_err(|error| invalid(format!("plane {i} \"{}\": {error}", names[i])))?,
                ),
                reason => PlanePlace::Unknown(reason.into()),
            };
            Ok(Plane { name: names[i].into(), place })
        };
        let planes = (0..names.len()).map(plane).collect::<Result<_, ViewError>>()?;
        Ok(Planes { frame: frame(view)?, stamp_ns: stamp_ns(view)?, planes })
    }

    fn n_bytes(&self) -> usize {
        size_of::<Self>() + size_of_val(&*self.planes)
    }

    fn to_result(&self) -> Json {
        let planes = self.planes.iter().map(|plane| match &plane.place {
            PlanePlace::Known(t) => json!({
                "name": plane.name, "frame": self.frame, "stamp_ns": self.stamp_ns, "matrix": matrix_rows(t),
            }),
            PlanePlace::Unknown(reason) => json!({ "name": plane.name, "unknown": reason }),
        });
        Json::Array(planes.collect())
    }

    #[cfg(feature = "viewer")]
    fn display() -> Option<Display> {
        Some(Display { answer: true, removal: foxglove::no_planes()?, ..foxglove::scene_schema()? })
    }

    #[cfg(feature = "viewer")]
    fn to_display(&self, about: &DisplayContext<'_>) -> Option<Vec<u8>> {
        foxglove::planes(self, about)
    }
}

impl Payload<Table> for Region {
    const NAME: &'static str = "geometry/Region";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[
        SchemaEntry::text("frame"),
        SchemaEntry::floats("min", 3).unit("mm"),
        SchemaEntry::floats("max", 3).unit("mm"),
    ];

    fn to_view(&self) -> View {
        View::new()
            .with("frame", self.frame.shared())
            .with("min", self.min.coords.as_slice().to_vec())
            .with("max", self.max.coords.as_slice().to_vec())
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        let (min, max) = (Point3::from(view.floats("min")?), Point3::from(view.floats("max")?));
        // A NaN compares as false, so it is refused here too. An infinite bound is none.
        if !(0..3).all(|k| min[k] <= max[k]) {
            return Err(invalid(format!("min {min} does not lie below max {max}")));
        }
        Ok(Region { frame: frame(view)?, min, max })
    }

    fn to_result(&self) -> Json {
        json!({ "frame": self.frame, "min_mm": self.min.coords.as_slice(), "max_mm": self.max.coords.as_slice() })
    }
}

impl Payload<Table> for Axes {
    const NAME: &'static str = "geometry/Axes";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[
        SchemaEntry::text("frame"),
        SchemaEntry::floats("centre", 3).unit("mm"),
        SchemaEntry::floats("columns", 9).doc("the axes x, y, z, three numbers each"),
    ];

    fn to_view(&self) -> View {
        View::new()
            .with("frame", self.frame.shared())
            .with("centre", self.centre.coords.as_slice().to_vec())
            .with("columns", self.columns.as_slice().to_vec())
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        let columns = Matrix3::from_column_slice(&view.floats::<9>("columns")?);
        check_rotation(&columns).map_err(|error| invalid(format!("columns: {error}")))?;
        Ok(Axes { frame: frame(view)?, centre: point(view, "centre")?, columns })
    }

    fn to_result(&self) -> Json {
        let column = |k: usize| self.columns.column(k).iter().copied().collect::<Vec<f64>>();
        json!({
            "frame": self.frame, "centre_mm": self.centre.coords.as_slice(),
            "x": column(0), "y": column(1), "z": column(2),
        })
    }
}

impl Payload<Table> for Image {
    const NAME: &'static str = "geometry/Image";
    /// 2: the two fields of distortion.
    const VERSION: u32 = 2;
    const OLDEST: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[
        SchemaEntry::text("frame").doc("of its camera: x right, y down, z forward"),
        SchemaEntry::int("stamp_ns"),
        SchemaEntry::text("label").optional(),
        SchemaEntry::int("width").unit("px"),
        SchemaEntry::int("height").unit("px"),
        SchemaEntry::int("channels").doc("bytes of a pixel: 1 grey, 3 red, green, blue"),
        SchemaEntry::floats("intrinsics", 4).unit("px").doc("fx, fy, cx, cy; the top left pixel's centre is 0, 0"),
        SchemaEntry::text("distortion_model")
            .optional()
            .doc("plumb_bob, rational_polynomial or equidistant; absent of a pinhole without distortion"),
        SchemaEntry::float_list("distortion").optional().doc("its coefficients, in OpenCV's order"),
        SchemaEntry::column("pixels", ColumnType::U8, 1).doc("row by row from the top left"),
    ];

    fn to_view(&self) -> View {
        let Intrinsics { fx, fy, cx, cy, distortion } = *self.intrinsics();
        let mut view = View::new().with("frame", self.frame.shared()).with("stamp_ns", self.stamp_ns);
        if let Some(label) = &self.label {
            view = view.with("label", label.clone());
        }
        view = view
            .with("width", i64::from(self.width()))
            .with("height", i64::from(self.height()))
            .with("channels", i64::from(self.channels()))
            .with("intrinsics", vec![fx, fy, cx, cy]);
        if let Some(name) = distortion.name() {
            view = view.with("distortion_model", name).with("distortion", distortion.coefficients());
        }
        view.with_column(to_column("pixels", ColumnType::U8, self.pixel_column()))
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        let count = |name: &str| {
            let n = view.int(name)?;
            u32::try_from(n).map_err(|_| invalid(format!("{name} {n} is no number of pixels or bytes")))
        };
        let [fx, fy, cx, cy] = view.floats("intrinsics")?;
        let size = [count("width")?, count("height")?];
        let pixels = from_column::<u8>(view, "pixels")?;
        let distortion = match (view.shared_text("distortion_model"), view.field("distortion")) {
            (Err(_), None) => Distortion::NONE,
            (Ok(name), Some(Field::Floats(coefficients))) => Distortion::named(&name, coefficients).map_err(invalid)?,
            _ => return Err(invalid("distortion_model and distortion belong together".to_owned())),
        };
        let intrinsics = Intrinsics { fx, fy, cx, cy, distortion };
        let mut image = Image::new(frame(view)?, size, count("channels")?, intrinsics, pixels).map_err(invalid)?;
        image.stamp_ns = stamp_ns(view)?;
        image.label = view.shared_text("label").ok();
        Ok(image)
    }

    fn n_bytes(&self) -> usize {
        size_of::<Self>() + self.pixels().len()
    }

    fn to_result(&self) -> Json {
        json!({
            "frame": self.frame, "stamp_ns": self.stamp_ns, "label": self.label,
            "width": self.width(), "height": self.height(), "channels": self.channels(),
        })
    }

    #[cfg(feature = "viewer")]
    fn display() -> Option<Display> {
        foxglove::schema::<foxglove::RawImage>()
    }

    #[cfg(feature = "viewer")]
    fn to_display(&self, about: &DisplayContext<'_>) -> Option<Vec<u8>> {
        foxglove::image(self, about.stamp_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_node::Value;
    use std::sync::Arc;

    fn survives<T: Payload<Table> + PartialEq + std::fmt::Debug>(payload: T) {
        let view = payload.to_view();
        assert_eq!(view.check(T::SCHEMA), Ok(()), "{} does not fit its schema", T::NAME);
        let back = T::from_view(&view).unwrap();
        assert_eq!(back, payload);
        assert_eq!(back.to_view(), view, "the view of what came back differs");
    }

    fn turn() -> Isometry3<f64> {
        Isometry3::new(Vector3::new(0.1, -2e3, 3.3), Vector3::new(0.3, -0.2, 0.9))
    }

    #[test]
    fn every_geometry_payload_survives_its_view_bit_for_bit() {
        let points = vec![Point3::new(0.1, 0.2, 0.3), Point3::new(-1e3, 1e-9, 7.0)];
        let cloud = Cloud::new("camera", points.clone()).unwrap().at(17).labelled("P1").seen_from(turn());
        survives(cloud.clone());
        let intrinsics = Intrinsics::pinhole(100.1, 99.9, 0.7, 0.3);
        let image = Image::new("camera", [2, 2], 3, intrinsics, (0..12).collect::<Vec<u8>>()).unwrap();
        survives(image.clone());
        survives(image.at(17).labelled("P1"));
        survives(Image::new("camera", [2, 2], 1, intrinsics, vec![7u8; 4]).unwrap());
        for (name, n) in [("plumb_bob", 5), ("rational_polynomial", 8), ("equidistant", 4)] {
            let coefficients: Vec<f64> = (1..=n).map(|k| 0.01 / f64::from(k)).collect();
            let bent = Intrinsics { distortion: Distortion::named(name, &coefficients).unwrap(), ..intrinsics };
            assert_eq!((bent.distortion.name(), bent.distortion.coefficients()), (Some(name), coefficients));
            survives(Image::new("camera", [2, 2], 1, bent, vec![7u8; 4]).unwrap());
        }
        survives(cloud.with_normals(vec![Vector3::x(); 2]).unwrap().with_extra("grey", vec![1.0, 2.0]).unwrap());
        let corners = vec![Point3::origin(), Point3::new(1.0, 0.0, 0.0), Point3::new(0.0, 1.0, 0.0)];
        survives(Mesh::new("ct", SurfaceOrigin::SimulatedCt, corners, vec![[0, 1, 2]]).unwrap());
        survives(Pose::new("world", "camera", turn()).at(12));
        let mut p1 = NamedPoint::new("P1", points[0]);
        (p1.stamp_ns, p1.confidence) = (4, Some(0.9));
        survives(Points::new("ct", vec![p1, NamedPoint::new("P2", points[1])]));
        survives(Points::new("ct", vec![]));
        let planes = Planes::new("ct", vec![Plane::new("plane_1", turn()), Plane::new("plane_2", turn())]).at(3);
        survives(planes.unknown("world", 5, "the marker was lost"));
        survives(planes);
        survives(Region { frame: "camera".into(), min: points[0], max: Point3::new(f64::INFINITY, 1.0, 2.0) });
        survives(Axes { frame: "ct".into(), centre: points[0], columns: Matrix3::identity() });
    }

    /// The error of a view in which the number at index `at` of the head field or column `name` is replaced.
    fn refused<T: Payload<Table>>(payload: &T, name: &str, at: usize, number: f64) -> String {
        let mut view = payload.to_view();
        match view.head.iter_mut().find(|(n, _)| n == name) {
            Some((_, Field::Floats(numbers))) => numbers[at] = number,
            _ => {
                let column = view.columns.iter_mut().find(|c| c.name == name).unwrap();
                let mut numbers = column.bytes().to_vec();
                numbers[8 * at..][..8].copy_from_slice(&number.to_le_bytes());
                column.data = Arc::new(numbers);
            }
        }
        match T::from_view(&view) {
            Err(ViewError::Invalid(message)) => message,
            _ => panic!("{name}[{at}] = {number} is taken for a payload"),
        }
    }

    #[test]
    fn numbers_that_are_no_rigid_motion_are_refused_by_the_name_of_what_they_are() {
        let (nan, inf) = (f64::NAN, f64::INFINITY);
        let pose = Pose::new("ct", "world", turn());
        let cloud = Cloud::new("camera", vec![Point3::origin(); 2]).unwrap().seen_from(turn());
        let cloud = cloud.with_normals(vec![Vector3::z(); 2]).unwrap();
        let planes = Planes::new("ct", vec![Plane::new("distal", turn()), Plane::new("proximal", turn())]);
        let points = Points::new("ct", vec![NamedPoint::new("P1", Point3::origin())]);
        let region = Region { frame: "camera".into(), min: Point3::origin(), max: Point3::new(1.0, 1.0, 1.0) };
        let axes = Axes { frame: "ct".into(), centre: Point3::origin(), columns: Matrix3::identity() };
        let target = "t_ct_world is no rigid motion: ";
        for (message, expected) in [
            (refused(&pose, "isometry", 0, inf), format!("{target}the translation is not finite")),
            (refused(&pose, "isometry", 6, nan), format!("{target}the quaternion is not finite")),
            (refused(&pose, "isometry", 6, 3.0), format!("{target}the quaternion has length 3.0")),
            (refused(&cloud, "viewpoint", 1, nan), "viewpoint: the translation is not finite".into()),
            (refused(&cloud, "viewpoint", 3, 0.5), "viewpoint: the quaternion has length".into()),
            (refused(&cloud, "points", 4, nan), "point 1 is not finite".into()),
            (refused(&cloud, "normals", 5, 0.0), "normal 1 has length 0 instead of 1".into()),
            (refused(&cloud, "normals", 5, 1.0005), "normal 1 has length 1.0005 instead of 1".into()),
            (refused(&cloud, "normals", 2, nan), "normal 0 has length NaN instead of 1".into()),
            (refused(&planes, "isometries", 7, nan), "plane 1 \"proximal\": the translation is not finite".into()),
            (refused(&planes, "isometries", 6, -2.0), "plane 0 \"distal\": the quaternion has length".into()),
            (refused(&points, "positions", 2, inf), "point 0 \"P1\" is not finite".into()),
            (refused(&region, "min", 1, nan), "min {0, NaN, 0} does not lie below max {1, 1, 1}".into()),
            (refused(&region, "min", 1, 2.0), "min {0, 2, 0} does not lie below".into()),
            (refused(&axes, "centre", 2, nan), "centre is not finite".into()),
            (refused(&axes, "columns", 8, -1.0), "columns: the matrix is a mirror image".into()),
            (refused(&axes, "columns", 8, 0.0), "columns: the upper left 3 x 3 is not a rotation".into()),
            (refused(&axes, "columns", 4, nan), "columns: the matrix is not finite".into()),
        ] {
            assert!(message.starts_with(&expected) || message.ends_with(&expected), "{expected}\n{message}");
        }
    }

    #[test]
    fn a_plane_of_zeros_is_no_plane_and_a_viewpoint_of_six_numbers_no_pose() {
        let mut view = Planes::new("ct", vec![Plane::new("distal", turn())]).to_view();
        view.columns[0].data = Arc::new(vec![0; 56]);
        let message = Planes::from_view(&view).unwrap_err().to_string();
        assert!(message.ends_with("plane 0 \"distal\": the quaternion is zero"), "{message}");
        let cloud = Cloud::new("camera", vec![Point3::origin()]).unwrap();
        let view = cloud.to_view().with("viewpoint", vec![0.0; 6]);
        assert!(Cloud::from_view(&view).is_err(), "it is not taken for a cloud without a viewpoint");
    }

    #[test]
    fn a_cloud_counts_its_columns_as_bytes() {
        let cloud = Cloud::new("camera", vec![Point3::origin(); 1000]).unwrap();
        let n_bytes = |cloud: &Cloud| Value::new(cloud.clone()).n_bytes() - size_of::<Cloud>();
        assert_eq!(n_bytes(&cloud), 1000 * 24);
        let full = cloud.with_normals(vec![Vector3::x(); 1000]).unwrap().with_extra("grey", vec![0.0; 1000]).unwrap();
        assert_eq!(n_bytes(&full), 1000 * (24 + 24 + 8));
    }

    #[test]
    fn a_clouds_points_are_not_copied_by_a_view_and_back() {
        let cloud = Cloud::new("camera", vec![Point3::origin(); 100]).unwrap();
        let value = Value::new(cloud.clone());
        let back = Cloud::from_view(&value.to_view()).unwrap();
        assert_eq!(cloud.points().as_ptr(), back.points().as_ptr());
    }

    #[test]
    fn an_unknown_plane_says_so_in_the_results_and_gives_no_matrix() {
        let planes = Planes::new("ct", vec![Plane::new("plane_1", turn())]).unknown("world", 5, "lost");
        assert_eq!(planes.to_result(), json!([{ "name": "plane_1", "unknown": "lost" }]));
    }
}
