//! What the files hold.

use super::{Register, method::Method};
use anyhow::{Result, anyhow};
use osteoflow_algorithms::{icp::PairingKind, mesh_query::MeshQuery, normals, sample, target::Target};
use osteoflow_formats::{
    FileError, pose_file,
    shape_file::{Shape, shape_of_bytes},
};
use osteoflow_geometry::{
    Cloud, Column, Frame, Mesh, SurfaceOrigin,
    nalgebra::{Isometry3, Point3, Vector3},
};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use serde_json::{Value, json};
use std::{fs, path::Path, time::Instant};

/// The frames of the two files.
const TARGET: &str = "target";
const SOURCE: &str = "source";

/// What the files hold, in mm.
pub(super) struct Inputs {
    pub(super) target: TargetFile,
    pub(super) source: SourceFile,
    pub(super) init: Isometry3<f64>,
    /// What is worth knowing of the files, one sentence each.
    pub(super) notes: Vec<String>,
    pub(super) load: LoadMs,
}

/// How long reading took, ms.
#[derive(Debug, Default)]
pub(super) struct LoadMs {
    pub(super) target: f64,
    /// Drawing points from a surface.
    pub(super) sample: f64,
    pub(super) source: f64,
    pub(super) init: f64,
}

impl LoadMs {
    pub(super) fn sum(&self) -> f64 {
        self.target + self.sample + self.source + self.init
    }
}

/// What stays.
pub(super) struct TargetFile {
    points: Column<Point3<f64>>,
    normals: Option<Column<Vector3<f64>>>,
    /// Whether the method needs normals that the file has not.
    estimates: bool,
    /// How many faces the points were drawn from, if it is a surface.
    n_faces: Option<usize>,
    /// The surface itself, where the method needs it.
    mesh: Option<Mesh>,
}

/// What moves.
pub(super) struct SourceFile {
    /// Its viewpoint is the camera, where given.
    cloud: Cloud,
    /// Points that were not finite.
    n_dropped: usize,
    is_surface: bool,
}

impl Inputs {
    /// Reads all files.
    pub(super) fn read(asked: &Register, method: &Method) -> Result<Self> {
        let mut notes = Vec::new();
        let mut load = LoadMs::default();
        let unit = |of_file: Option<f64>| of_file.unwrap_or(asked.unit_mm);

        let began = Instant::now();
        let shape = shape(&asked.target, unit(asked.target_unit_mm), TARGET, "target", &mut notes)?;
        load.target = ms_since(began);
        let began = Instant::now();
        let target = TargetFile::of(shape, usize::try_from(asked.target_points)?, asked.seed, method);
        if target.estimates {
            notes.push(format!(
                "{}: no normals; they are estimated from the points, outwards as of a closed surface; of an open one the \
                 side is a guess, and matters with --camera only",
                asked.target.display()
            ));
        }
        load.sample = ms_since(began);

        let began = Instant::now();
        let shape = self::shape(&asked.source, unit(asked.source_unit_mm), SOURCE, "source", &mut notes)?;
        let source = SourceFile::of(shape, asked.camera, &mut notes, &asked.source)?;
        load.source = ms_since(began);

        let began = Instant::now();
        let init = match &asked.init {
            Some(file) => {
                let read = pose_file::read_pose(file, unit(asked.init_unit_mm)).map_err(told)?;
                notes.extend(read.notes.iter().map(|note| format!("{}: {note}", file.display())));
                read.isometry
            }
            None => {
                notes.push("no --init: the registration starts where the files put the source".into());
                Isometry3::identity()
            }
        };
        load.init = ms_since(began);
        Ok(Self { target, source, init, notes, load })
    }
}

fn shape(file: &Path, unit_mm: f64, frame: &str, which: &str, notes: &mut Vec<String>) -> Result<Shape> {
    let read = fs::read(file).map_err(|source| FileError::Io { path: file.into(), action: "read", source });
    let shape = read.and_then(|bytes| shape_of_bytes(file, &bytes, unit_mm, Frame::from(frame))).map_err(told)?;
    let found = match &shape {
        Shape::Mesh(read) => &read.notes,
        Shape::Cloud(_, notes) => notes,
    };
    // The readers name a parameter; here it is an option.
    let option = format!("--{which}-unit-mm ");
    notes.extend(found.iter().map(|note| format!("{}: {}", file.display(), note.replace("unit_mm = ", &option))));
    Ok(shape)
}

/// The error without its cause, which its own words name.
fn told(error: FileError) -> anyhow::Error {
    anyhow!("{error}")
}

impl TargetFile {
    fn of(shape: Shape, n_points: usize, seed: u64, method: &Method) -> Self {
        match shape {
            Shape::Mesh(read) => {
                let samples = sample::surface(&read.mesh, n_points, &mut ChaCha8Rng::seed_from_u64(seed));
                let n_faces = Some(read.mesh.faces().len());
                let mesh = method.needs_mesh.then_some(read.mesh);
                let normals = Some(samples.normals.into());
                Self { points: samples.points.into(), normals, estimates: false, n_faces, mesh }
            }
            Shape::Cloud(read, _) => {
                let (points, normals) = (read.cloud.point_column().clone(), read.cloud.normal_column().cloned());
                let estimates = normals.is_none() && method.needs_normals;
                Self { points, normals, estimates, n_faces: None, mesh: None }
            }
        }
    }

    /// The target with all that is built for it once; an error says why there is none.
    pub(super) fn prepare(&self, pairing: PairingKind) -> Result<Target, String> {
        let normals = match self.estimates {
            true => Some(normals::of_surface(&self.points).map_err(|e| e.to_string())?.into()),
            false => self.normals.clone(),
        };
        let target = Target::new(TARGET, SurfaceOrigin::User, self.points.clone(), normals);
        let target = target.map_err(|e| e.to_string())?;
        let target = match &self.mesh {
            Some(mesh) => target.with_mesh(MeshQuery::new(mesh)),
            None => target,
        };
        match pairing {
            PairingKind::Tree => {
                target.prepare_tree();
            }
            PairingKind::Cached | PairingKind::Field => target.prepare(),
        }
        Ok(target)
    }

    pub(super) fn to_json(&self, file: &Path) -> Value {
        json!({
            "file": file.display().to_string(),
            "n_points": self.points.len(),
            "n_faces": self.n_faces,
            "normals": self.normals.is_some() || self.estimates,
            "normals_estimated": self.estimates,
        })
    }

    pub(super) fn in_words(&self) -> String {
        let n = self.points.len();
        match (self.n_faces, &self.normals) {
            (Some(n_faces), _) => format!("{n} points drawn from {n_faces} faces"),
            (None, Some(_)) => format!("{n} points with normals"),
            (None, None) if self.estimates => format!("{n} points, their normals estimated"),
            (None, None) => format!("{n} points without normals"),
        }
    }
}

impl SourceFile {
    fn of(shape: Shape, camera: Option<Point3<f64>>, notes: &mut Vec<String>, file: &Path) -> Result<Self> {
        let (cloud, n_dropped, is_surface) = match shape {
            Shape::Mesh(read) => {
                notes.push(format!("{}: a surface; its vertices are taken as the points", file.display()));
                (Cloud::new(SOURCE, read.mesh.vertex_column().clone())?, 0, true)
            }
            Shape::Cloud(read, _) => (read.cloud, read.n_dropped, false),
        };
        let cloud = match camera {
            // Of the camera's pose only its place is asked.
            Some(camera) => cloud.seen_from(Isometry3::from(camera.coords)),
            None => cloud,
        };
        Ok(Self { cloud, n_dropped, is_surface })
    }

    /// What the methods take: points, normals where the file has them, and the camera's place where it is known.
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

    pub(super) fn in_words(&self) -> String {
        let what = if self.is_surface { "vertices" } else { "points" };
        let normals = if self.cloud.normals().is_some() { " with normals" } else { "" };
        format!("{} {what}{normals}", self.cloud.len())
    }
}

pub(super) fn ms_since(began: Instant) -> f64 {
    began.elapsed().as_secs_f64() * 1e3
}
