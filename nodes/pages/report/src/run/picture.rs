//! What the live page shows of a run that has ended: the last item of each recorded wire that can be drawn, and where frames are.

use super::transforms::{Transform, to_root};
use crate::{
    html::Page,
    run_folder::RunFolder,
    scene::packed::{MAX_POINTS, levels, positions, surface},
};
use base64::{Engine, engine::general_purpose::STANDARD};
use nalgebra::Isometry3;
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_engine::recording::{RecordedWire, item_bytes};
use osteoflow_geometry::{Cloud, Mesh};
use osteoflow_node::Item;
use osteoflow_viewer::last_messages;
use rayon::prelude::*;
use serde_json::{Value as Json, json};

/// Residual at the ends of the colour scale, mm.
pub(super) const RESIDUAL_MM: f64 = 1.0;
/// Points farther away have no residual, mm.
const FAR_MM: f64 = 5.0;

const EXACT: &str = "/exact/";
const VIEW: &str = "/view/";

/// What the live page shows.
pub(super) struct Picture {
    /// For the page's scripts.
    pub(super) json: Json,
    /// A sentence for each cloud of which not all points are drawn.
    pub(super) thinned: Vec<String>,
}

/// The last item of a wire.
struct LastItem {
    wire: String,
    payload: String,
    data: Vec<u8>,
    solid: Option<Solid>,
}

/// An item that is written anew, in fewer bytes.
enum Solid {
    Mesh(Mesh),
    Cloud(Cloud),
}

impl Picture {
    /// The picture of a run at its end.
    ///
    /// # Errors
    /// The reason why there is none.
    pub(super) fn of(page: &mut Page, run: &RunFolder) -> Result<Self, String> {
        let path = run.recording_path()?;
        let wanted = last_messages(path, |channel| {
            is_exact(&channel.topic, &channel.encoding)
                || (channel.topic.starts_with(VIEW) && channel.schema_name == "foxglove.FrameTransform")
        });
        let (mut transforms, mut items, mut origin) = (Vec::new(), Vec::new(), None);
        for (channel, data) in wanted.map_err(|error| error.to_string())? {
            let topic = &channel.topic;
            if let Some(wire) = topic.strip_prefix(VIEW) {
                let read = Transform::read(wire, &data);
                origin = channel.metadata.get("origin").cloned().or(origin);
                transforms.push(read.ok_or_else(|| format!("the transform of the wire {wire} is damaged"))?);
            } else if let Some(wire) = topic.strip_prefix(EXACT) {
                let data = item_bytes(&channel.encoding, &data).unwrap_or_default().to_vec();
                items.extend(LastItem::read(run, wire, &channel.schema_name, data)?);
            }
        }
        if items.iter().all(|item| !item.is_drawn()) {
            return Err("no surface, cloud, points or planes were recorded".into());
        }
        let bone = items.iter().rev().find_map(|item| match &item.solid {
            Some(Solid::Mesh(mesh)) if !item.wire.starts_with("phantom") => Some(mesh),
            _ => None,
        });
        let residuals = bone.map(|bone| Residuals::new(bone, &transforms));
        let mut thinned = Vec::new();
        let layers: Vec<_> = items.iter().map(|item| item.json(page, residuals.as_ref(), &mut thinned)).collect();
        let transforms: Vec<_> = transforms.iter().map(Transform::json).collect();
        let targets = run.node_of_kind("verdict.registration").and_then(|node| run.wire_into(node, "assessment"));
        let json = json!({ "transforms": transforms, "items": layers, "targets": targets, "origin": origin });
        Ok(Self { json, thinned })
    }
}

fn is_exact(topic: &str, encoding: &str) -> bool {
    topic.starts_with(EXACT) && item_bytes(encoding, &[]).is_some()
}

impl LastItem {
    /// Reads the last item of a wire; `None` if the page shows nothing of it.
    fn read(run: &RunFolder, wire: &str, schema: &str, data: Vec<u8>) -> Result<Option<Self>, String> {
        let damaged = |why: String| format!("the last item of the wire {wire} cannot be read: {why}");
        // As ROS 2 names types; before format 3 by payload@version.
        let named = schema.split_once("/msg/").and_then(|(package, name)| {
            let (name, version) = name.rsplit_once('V')?;
            Some((format!("{package}/{name}"), version))
        });
        let (payload, version) = match &named {
            Some((payload, version)) => (payload.as_str(), *version),
            None => schema.split_once('@').unwrap_or((schema, "1")),
        };
        let version = version.parse().map_err(|_| damaged(format!("its schema is {schema}")))?;
        let recorded = RecordedWire { payload: payload.into(), version, source: false, messages: vec![data.clone()] };
        let items = recorded.items().map_err(|(_, error)| damaged(error.to_string()))?;
        let Some(item) = items.into_iter().next() else { return Ok(None) };
        let payload = item.payload.clone().map_or_else(|| payload.to_owned(), |(name, _)| name);
        let is_empty = item.body.is_err();
        let solid = match payload.as_str() {
            "geometry/Mesh" | "geometry/Cloud" if !is_empty => {
                let ty = run.registry().payload_type(&payload);
                let ty = ty.ok_or_else(|| damaged(format!("no payload {payload} is known here")))?;
                solid(&item.into_item(ty).map_err(|error| damaged(error.to_string()))?)
            }
            "geometry/Planes" | "geometry/Points" | "geometry/Axes" | "geometry/Mesh" | "geometry/Cloud" => None,
            // A pose that is not known takes what it places from the view; a known one is in the transforms.
            "geometry/Pose" if is_empty => None,
            _ => return Ok(None),
        };
        Ok(Some(Self { wire: wire.into(), payload, data, solid }))
    }

    fn is_drawn(&self) -> bool {
        !matches!(self.payload.as_str(), "geometry/Pose" | "geometry/Axes")
    }

    fn json(&self, page: &mut Page, residuals: Option<&Residuals>, thinned: &mut Vec<String>) -> Json {
        let mut json = json!({ "wire": self.wire, "payload": self.payload });
        match &self.solid {
            None => json["message"] = STANDARD.encode(&self.data).into(),
            Some(Solid::Mesh(mesh)) => {
                json["frame"] = mesh.frame.to_string().into();
                json["shared"] = page.share(surface(mesh)).into();
            }
            Some(Solid::Cloud(cloud)) => {
                let all = cloud.points();
                let every = all.len().div_ceil(MAX_POINTS).max(1);
                let points: Vec<_> = all.iter().copied().step_by(every).collect();
                if every > 1 {
                    thinned.push(format!("Of {}, {} of {} points are drawn.", self.wire, points.len(), all.len()));
                }
                json["frame"] = cloud.frame.to_string().into();
                json["own"] = positions(&points);
                let near = residuals.and_then(|residuals| residuals.of(&cloud.frame.to_string(), &points));
                if let Some(near) = near {
                    json["own"]["values"] = levels(&near, RESIDUAL_MM).into();
                }
            }
        }
        json
    }
}

/// The surface or the cloud of an item.
fn solid(item: &Item) -> Option<Solid> {
    let value = item.body.value()?;
    let mesh = value.get::<Mesh>().cloned().map(Solid::Mesh);
    mesh.or_else(|| value.get::<Cloud>().cloned().map(Solid::Cloud))
}

/// Distances from the bone, on its whole surface: what is drawn of it may be simplified.
struct Residuals<'a> {
    surface: MeshQuery,
    root: String,
    t_bone_root: Isometry3<f64>,
    transforms: &'a [Transform],
}

impl<'a> Residuals<'a> {
    fn new(bone: &Mesh, transforms: &'a [Transform]) -> Self {
        let surface = MeshQuery::new(bone);
        surface.prepare();
        let (root, t_root_bone) = to_root(transforms, &bone.frame.to_string());
        Self { surface, root, t_bone_root: t_root_bone.inverse(), transforms }
    }

    /// The signed distance of each point, NaN if it is far; `None` if no pose connects the frame to the bone's.
    fn of(&self, frame: &str, points: &[nalgebra::Point3<f64>]) -> Option<Vec<f64>> {
        let (root, t_root_frame) = to_root(self.transforms, frame);
        let t = self.t_bone_root * t_root_frame;
        let signed = |p: &nalgebra::Point3<f64>| {
            let p = t * p;
            let at = self.surface.closest_point(&p).filter(|at| at.distance_mm < FAR_MM);
            at.map_or(f64::NAN, |at| at.distance_mm.copysign((p - at.point).dot(&at.normal)))
        };
        (root == self.root).then(|| points.par_iter().map(signed).collect())
    }
}
