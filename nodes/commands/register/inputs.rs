//! Reading the target, the source and the start.

use super::{
    Register, SpaceOption,
    files::space_of,
    landmarks::{self, Picked},
    method::Method,
    start::Start,
};
use crate::app::{UsageError, files::is_volume};
use anyhow::{Result, anyhow, bail};
use osteoflow_algorithms::{
    field::{ClosestPointField, FieldParams},
    icp::PairingKind,
    mesh_query::MeshQuery,
    normals, sample,
    target::Target,
};
use osteoflow_engine::store::{Key, Store};
use osteoflow_formats::{
    Space,
    cloud_file::CloudFileRead,
    input,
    mesh_or_cloud::{MeshOrCloud, read_mesh_or_cloud},
    pose_file,
};
use osteoflow_geometry::{
    Cloud, Column, Frame, Mesh, SurfaceOrigin,
    nalgebra::{Isometry3, Point3, Vector3},
};
use osteoflow_payloads::Table;
use osteoflow_standard::surface::ct::{NoThreshold, read_bone};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use serde_json::{Value, json};
use std::{path::Path, sync::Arc, time::Instant};

/// The frames of the two files.
pub(super) const TARGET: &str = "target";
pub(super) const SOURCE: &str = "source";

/// The word for the identity as the start.
const IDENTITY: &str = "identity";

/// The contents of the files, in mm.
pub(crate) struct Inputs {
    pub(super) target: TargetFile,
    pub(super) source: SourceFile,
    pub(super) start: Start,
    /// Notes on the files, one sentence each.
    pub(crate) notes: Vec<String>,
    pub(super) load: LoadMs,
}

/// Inputs that are in memory already, in mm, and replace the files of the command line.
#[derive(Debug, Default)]
pub(crate) struct Given {
    pub(crate) target: Option<MeshOrCloud>,
    pub(crate) source: Option<MeshOrCloud>,
    pub(crate) init: Option<Isometry3<f64>>,
}

/// Reading times, ms.
#[derive(Debug, Default)]
pub(super) struct LoadMs {
    pub(super) target: f64,
    /// Sampling a surface.
    pub(super) sample: f64,
    pub(super) source: f64,
    pub(super) init: f64,
}

impl LoadMs {
    pub(super) fn sum(&self) -> f64 {
        self.target + self.sample + self.source + self.init
    }
}

/// What the method and the pairing need of the target.
struct Needs {
    normals: bool,
    field: bool,
}

/// The target's file.
pub(super) struct TargetFile {
    content: TargetContent,
    /// Whether the method needs normals that the file does not have.
    estimates: bool,
    /// Whether the pairing needs a closest-point field.
    with_field: bool,
    /// What the file states of its coordinates.
    space: Space,
    /// Where to store the prepared target for the next run.
    entry: Option<(Arc<Store>, Key)>,
}

enum TargetContent {
    /// Prepared by an earlier run.
    Stored(Target),
    /// Read from the file.
    Read {
        points: Column<Point3<f64>>,
        normals: Option<Column<Vector3<f64>>>,
        /// The surface that the points were sampled from, if it is one.
        mesh: Option<Mesh>,
    },
}

/// The source's file.
pub(super) struct SourceFile {
    /// Points, with normals if the file has them, and the camera as viewpoint if given.
    cloud: Cloud,
    /// What the file states of its coordinates.
    space: Space,
    /// Number of points that were not finite.
    n_dropped: usize,
    is_surface: bool,
}

impl Inputs {
    /// Reads all files.
    pub(super) fn read(asked: &Register, method: &Method, pairing: PairingKind, given: Given) -> Result<Self> {
        let mut notes = Vec::new();
        let mut load = LoadMs::default();
        let unit = |of_file: Option<f64>| of_file.unwrap_or(asked.unit_mm);

        let unit_mm = unit(asked.target_unit_mm);
        let needs = Needs { normals: method.needs_normals, field: pairing == PairingKind::Field };
        let target = TargetFile::read(asked, given.target, unit_mm, &needs, &mut notes, &mut load)?;
        if target.estimates {
            notes.push(format!(
                "{}: no normals; they are estimated from the points, outwards if the surface is closed; on an open one their \
                 side is a guess, which matters only with --camera",
                asked.target.display()
            ));
        }

        let began = Instant::now();
        let shape = match given.source {
            Some(shape) => shape,
            None => {
                let bytes = bytes(&asked.source)?;
                shape(&asked.source, &bytes, unit(asked.source_unit_mm), SOURCE, "source", &mut notes)?
            }
        };
        let source = SourceFile::of(shape, asked.camera, &mut notes, &asked.source)?;
        load.source = ms_since(began);

        let began = Instant::now();
        let start = match (&asked.init, asked.landmarks.as_deref()) {
            _ if given.init.is_some() => Start::Pose(given.init.unwrap_or_default()),
            (None, Some([of_target, of_source])) => {
                let picked = [(of_target, target.space), (of_source, source.space)];
                let picked = picked.map(|(file, stated)| Picked { file, stated });
                let units = [unit(asked.target_unit_mm), unit(asked.source_unit_mm)];
                landmarks::read(picked, units, asked.space, &mut notes)?
            }
            (Some(word), _) if word.as_os_str() == IDENTITY => Start::Pose(Isometry3::identity()),
            (Some(file), _) => {
                let read = pose_file::read_pose(file, unit(asked.init_unit_mm))?;
                notes.extend(read.notes.iter().map(|note| format!("{}: {note}", file.display())));
                Start::Pose(read.isometry)
            }
            (None, _) => Start::Shape,
        };
        load.init = ms_since(began);
        if asked.space.is_some() && target.space != Space::Unknown && source.space != Space::Unknown {
            let files = [&asked.target, &asked.source].map(|file| file.display().to_string()).join(" and ");
            return Err(UsageError(format!("{files} state their space; leave out --space")).into());
        }
        Ok(Self { target, source, start, notes, load })
    }

    /// The spaces of the numbers of target and source.
    pub(super) fn spaces(&self, option: Option<SpaceOption>) -> [Space; 2] {
        [self.target.space, self.source.space].map(|stated| space_of(stated, option))
    }
}

fn bytes(file: &Path) -> Result<Vec<u8>> {
    Ok(input::read(file)?)
}

/// The surface of the bone in a CT.
fn ct_surface(asked: &Register, unit_mm: f64, notes: &mut Vec<String>) -> Result<Mesh> {
    let name = asked.target.display();
    if unit_mm != 1.0 {
        bail!("{name}: a CT states its unit; leave out --unit-mm, or give --source-unit-mm");
    }
    let params =
        json!({ "path": asked.target, "threshold_hu": asked.threshold_hu, "series": asked.series, "frame": TARGET });
    let params = serde_json::from_value(params)?;
    let bone = read_bone(&params, NoThreshold::Suggest).map_err(|error| {
        let error = error.to_string().replace("threshold_hu", "--threshold-hu");
        if error.contains(&name.to_string()) { anyhow!("{error}") } else { anyhow!("{name}: {error}") }
    })?;
    notes.extend(bone.notes.into_iter().map(|note| format!("{name}: {note}")));
    Ok(bone.mesh)
}

fn shape(
    file: &Path,
    bytes: &[u8],
    unit_mm: f64,
    frame: &str,
    which: &str,
    notes: &mut Vec<String>,
) -> Result<MeshOrCloud> {
    let shape = read_mesh_or_cloud(file, bytes, unit_mm, Frame::from(frame))?;
    let found = match &shape {
        MeshOrCloud::Mesh(read) => &read.notes,
        MeshOrCloud::Cloud(_, notes) => notes,
    };
    // The readers name a parameter, which is an option here.
    let option = format!("--{which}-unit-mm ");
    notes.extend(found.iter().map(|note| format!("{}: {}", file.display(), note.replace("unit_mm = ", &option))));
    Ok(shape)
}

/// The spaces of files whose prepared targets are stored: one in RAS has a note.
const STORED_SPACES: [Space; 2] = [Space::Unknown, Space::Lps];

impl TargetFile {
    /// Reads the file, or the prepared target of the same bytes from the store.
    fn read(
        asked: &Register,
        given: Option<MeshOrCloud>,
        unit_mm: f64,
        needs: &Needs,
        notes: &mut Vec<String>,
        load: &mut LoadMs,
    ) -> Result<Self> {
        let began = Instant::now();
        let with_field = needs.field;
        if let Some(shape) = given {
            return Self::of(asked, shape, needs, load);
        }
        if asked.target.is_dir() || is_volume(&asked.target) {
            let read = ct_surface(asked, unit_mm, notes)?;
            load.target = ms_since(began);
            return Ok(Self::sampled(asked, read, with_field, load));
        }
        for (option, is_given) in
            [("--threshold-hu", asked.threshold_hu.is_some()), ("--series", asked.series.is_some())]
        {
            if is_given {
                let message = format!("{option} is for a CT, and {} is none", asked.target.display());
                return Err(UsageError(message).into());
            }
        }
        let bytes = bytes(&asked.target)?;
        let entry = asked.keep.store()?.and_then(|store| {
            let key = Key::of("register_target").digest("program", store.program()?).bytes("file", &bytes);
            let key = key.number("unit_mm", unit_mm.to_bits()).number("n_points", asked.target_points);
            // Of the structures for pairing only the field is stored.
            Some((store, key.number("seed", asked.seed).number("field", with_field.into())))
        });
        let entry = |estimates: bool, space: Space| {
            let (store, key) = entry.as_ref()?;
            let key = key.clone().number("estimates", estimates.into()).text("space", &space.to_string());
            Some((store.clone(), key.done()))
        };
        for (estimates, space) in [false, true].into_iter().flat_map(|e| STORED_SPACES.map(|space| (e, space))) {
            let stored = entry(estimates, space).and_then(|(store, key)| store.load::<Target, Table>(&key));
            let serves = |target: &Target| if needs.normals { target.normals().is_some() } else { !estimates };
            if let Some(target) = stored.filter(serves) {
                load.target = ms_since(began);
                let content = TargetContent::Stored(target);
                return Ok(Self { content, estimates, with_field, space, entry: None });
            }
        }
        let n_notes = notes.len();
        let shape = shape(&asked.target, &bytes, unit_mm, TARGET, "target", notes)?;
        load.target = ms_since(began);
        let read = Self::of(asked, shape, needs, load)?;
        // A file with notes is not stored, so that the next run repeats them.
        let is_stored = notes.len() == n_notes && STORED_SPACES.contains(&read.space);
        Ok(Self { entry: entry(read.estimates, read.space).filter(|_| is_stored), ..read })
    }

    /// The target of a surface or cloud, which is not stored.
    fn of(asked: &Register, shape: MeshOrCloud, needs: &Needs, load: &mut LoadMs) -> Result<Self> {
        let space = match &shape {
            MeshOrCloud::Mesh(read) => read.space,
            MeshOrCloud::Cloud(read, _) => read.space,
        };
        let began = Instant::now();
        let (points, normals, mesh) = match shape {
            MeshOrCloud::Mesh(read) => {
                let n_points = usize::try_from(asked.target_points)?;
                let samples = sample::surface(&read.mesh, n_points, &mut ChaCha8Rng::seed_from_u64(asked.seed));
                (samples.points.into(), Some(samples.normals.into()), Some(read.mesh))
            }
            MeshOrCloud::Cloud(read, _) => {
                (read.cloud.point_column().clone(), read.cloud.normal_column().cloned(), None)
            }
        };
        load.sample = ms_since(began);
        let estimates = normals.is_none() && needs.normals;
        let content = TargetContent::Read { points, normals, mesh };
        Ok(Self { content, estimates, with_field: needs.field, space, entry: None })
    }

    /// A CT's surface, which is not stored.
    fn sampled(asked: &Register, mesh: Mesh, with_field: bool, load: &mut LoadMs) -> Self {
        let began = Instant::now();
        let n_points = asked.target_points as usize;
        let samples = sample::surface(&mesh, n_points, &mut ChaCha8Rng::seed_from_u64(asked.seed));
        let (points, normals) = (samples.points.into(), Some(samples.normals.into()));
        let content = TargetContent::Read { points, normals, mesh: Some(mesh) };
        load.sample = ms_since(began);
        Self { content, estimates: false, with_field, space: Space::Lps, entry: None }
    }

    /// The target with the structures that method and pairing need.
    pub(super) fn prepare(&self, method: &Method, pairing: PairingKind) -> Result<Target> {
        let target = match &self.content {
            TargetContent::Stored(target) => target.clone(),
            TargetContent::Read { points, normals, mesh } => {
                let normals = if self.estimates { Some(normals::of_surface(points)?.into()) } else { normals.clone() };
                let target = Target::new(TARGET, SurfaceOrigin::User, points.clone(), normals)?;
                let mesh = mesh.as_ref().map(MeshQuery::new);
                let field = self.with_field.then(|| field(&target, mesh.as_ref())).transpose()?;
                let target = mesh.into_iter().fold(target, Target::with_mesh);
                field.into_iter().fold(target, Target::with_field)
            }
        };
        match pairing {
            PairingKind::Tree => target.prepare_tree(),
            PairingKind::Cached | PairingKind::Field => target.prepare(),
        }
        if let Some(mesh) = target.mesh().filter(|_| method.needs_mesh) {
            mesh.prepare();
        }
        Ok(target)
    }

    /// Stores the prepared target for the next run, if there is a store.
    pub(super) fn store(&self, prepared: &Target) {
        if let Some((store, key)) = &self.entry
            && let Err(error) = store.save::<Target, Table>(key, prepared)
        {
            tracing::warn!("{error}");
        }
    }

    fn n_points(&self) -> usize {
        match &self.content {
            TargetContent::Stored(target) => target.points().len(),
            TargetContent::Read { points, .. } => points.len(),
        }
    }

    fn has_normals(&self) -> bool {
        match &self.content {
            TargetContent::Stored(target) => target.normals().is_some(),
            TargetContent::Read { normals, .. } => normals.is_some(),
        }
    }

    /// Whether the normals were estimated for the method.
    pub(super) fn has_estimated_normals(&self) -> bool {
        self.estimates
    }

    /// Number of faces that the points were sampled from, if it is a surface.
    fn n_faces(&self) -> Option<usize> {
        let mesh = match &self.content {
            TargetContent::Stored(target) => target.mesh().map(MeshQuery::mesh),
            TargetContent::Read { mesh, .. } => mesh.as_ref(),
        };
        mesh.map(|mesh| mesh.faces().len())
    }

    pub(super) fn to_json(&self, file: &Path) -> Value {
        json!({
            "file": file.display().to_string(),
            "n_points": self.n_points(),
            "n_faces": self.n_faces(),
            "normals": self.has_normals() || self.estimates,
            "normals_estimated": self.estimates,
            "from_store": matches!(self.content, TargetContent::Stored(_)),
        })
    }

    pub(super) fn describe(&self) -> String {
        let n = self.n_points();
        let what = match (self.n_faces(), self.has_normals()) {
            (Some(n_faces), _) => format!("{n} points sampled from {n_faces} faces"),
            (None, _) if self.estimates => format!("{n} points, their normals estimated"),
            (None, true) => format!("{n} points with normals"),
            (None, false) => format!("{n} points without normals"),
        };
        let prepared =
            if matches!(self.content, TargetContent::Stored(_)) { ", prepared by an earlier run" } else { "" };
        format!("{what}{prepared}")
    }
}

/// The closest-point field of a mesh, else of points with normals.
fn field(target: &Target, mesh: Option<&MeshQuery>) -> Result<ClosestPointField> {
    let params = FieldParams::default();
    Ok(match (mesh, target.normals()) {
        (Some(mesh), _) => ClosestPointField::of_mesh(mesh, &params)?,
        (None, Some(normals)) => ClosestPointField::of_points(target.points(), normals, &params)?,
        (None, None) => bail!("the target has no normals, which its field needs; use a surface, or --pairing cached"),
    })
}

impl SourceFile {
    fn of(shape: MeshOrCloud, camera: Option<Point3<f64>>, notes: &mut Vec<String>, file: &Path) -> Result<Self> {
        let is_surface = matches!(shape, MeshOrCloud::Mesh(_));
        if is_surface {
            notes.push(format!("{}: a surface; its vertices are taken as the points", file.display()));
        }
        let CloudFileRead { cloud, space, n_dropped, .. } = shape.into_cloud().0;
        let cloud = match camera {
            // Only the camera's position is used.
            Some(camera) => cloud.seen_from(Isometry3::from(camera.coords)),
            None => cloud,
        };
        Ok(Self { cloud, space, n_dropped, is_surface })
    }

    pub(super) fn cloud(&self) -> &Cloud {
        &self.cloud
    }

    pub(super) fn to_json(&self, file: &Path) -> Value {
        json!({
            "file": file.display().to_string(),
            "n_points": self.cloud.len(),
            "n_dropped": self.n_dropped,
            "normals": self.cloud.normals().is_some(),
            "camera": self.cloud.viewpoint.map(|view| view.translation.vector.as_slice().to_vec()),
        })
    }

    pub(super) fn describe(&self) -> String {
        let what = if self.is_surface { "vertices" } else { "points" };
        let normals = if self.cloud.normals().is_some() { " with normals" } else { "" };
        format!("{} {what}{normals}", self.cloud.len())
    }
}

pub(super) fn ms_since(began: Instant) -> f64 {
    began.elapsed().as_secs_f64() * 1e3
}
