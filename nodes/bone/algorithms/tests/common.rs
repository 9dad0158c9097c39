//! Bones from files and what a camera sees of them.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_algorithms::sample;
use osteoflow_algorithms::target::Target;
use osteoflow_geometry::{Cloud, Mesh, SurfaceOrigin};
use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, Normal, UnitSphere};
use std::path::PathBuf;

/// The folder of development data, or a line saying that the test is skipped.
pub(crate) fn data(test: &str, file: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("OSTEOFLOW_DATA")
        .map(PathBuf::from)
        .unwrap_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../../shared/data"));
    let path = folder.join(file);
    if !path.exists() {
        println!("skipped: {test}: no development data");
        return None;
    }
    Some(path)
}

/// A binary STL in mm.
pub(crate) fn stl(path: &PathBuf, frame: &str) -> Mesh {
    let bytes = std::fs::read(path).unwrap();
    let n = u32::from_le_bytes(bytes[80..84].try_into().unwrap()) as usize;
    let number = |at: usize| f64::from(f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()));
    let corner = |face: usize, k: usize| {
        let at = 84 + 50 * face + 12 + 12 * k;
        Point3::new(number(at), number(at + 4), number(at + 8))
    };
    let vertices: Vec<Point3<f64>> = (0..n).flat_map(|face| (0..3).map(move |k| corner(face, k))).collect();
    let faces: Vec<[u32; 3]> = (0..n as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
    Mesh::new(frame, SurfaceOrigin::Exact, vertices, faces).unwrap()
}

/// A bone, where its malleolus tip is and how it lies.
pub(crate) struct Bone {
    pub(crate) name: &'static str,
    pub(crate) mesh: Mesh,
    pub(crate) query: MeshQuery,
    pub(crate) tip: Point3<f64>,
    pub(crate) proximal: Vector3<f64>,
    pub(crate) lateral: Vector3<f64>,
    pub(crate) posterior: Vector3<f64>,
}

/// The two finely described bones of the development data.
pub(crate) fn bones(test: &str) -> Vec<Bone> {
    ["TLEM2_CT_fibula_r", "MC22_fibula_r"]
        .into_iter()
        .filter_map(|name| {
            let mesh = stl(&data(test, &format!("bones/{name}.stl"))?, "ct");
            let anatomy = std::fs::read_to_string(data(test, "bones/anatomy.json")?).unwrap();
            let anatomy: serde_json::Value = serde_json::from_str(&anatomy).unwrap();
            let vector = |key: &str| {
                let v = &anatomy[name][key];
                Vector3::new(v[0].as_f64().unwrap(), v[1].as_f64().unwrap(), v[2].as_f64().unwrap())
            };
            Some(Bone {
                name,
                query: MeshQuery::new(&mesh),
                mesh,
                tip: Point3::from(vector("malleolus_tip")),
                proximal: vector("proximal").normalize(),
                lateral: vector("lateral").normalize(),
                posterior: vector("posterior").normalize(),
            })
        })
        .collect()
}

/// The simulated bone in the project's own test data, which every clone has; its directions are its principal axes.
pub(crate) fn own_bone() -> Bone {
    let mesh = stl(&PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../tests/data/folder/bone.stl"), "ct");
    let n = mesh.vertices().len() as f64;
    let middle = mesh.vertices().iter().map(|p| p.coords).sum::<Vector3<f64>>() / n;
    let scatter: Matrix3<f64> =
        mesh.vertices().iter().map(|p| (p.coords - middle) * (p.coords - middle).transpose()).sum();
    let eigen = scatter.symmetric_eigen();
    let axis = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
    let proximal = axis * axis.z.signum();
    let low = mesh.vertices().iter().map(|p| (p.coords - middle).dot(&proximal)).fold(f64::MAX, f64::min);
    let lateral = proximal.cross(&Vector3::y()).normalize();
    let (tip, posterior) = (Point3::from(middle + proximal * low), proximal.cross(&lateral));
    Bone { name: "own", query: MeshQuery::new(&mesh), mesh, tip, proximal, lateral, posterior }
}

/// What spoils a scan.
pub(crate) struct Noise {
    pub(crate) depth_mm: f64,
    pub(crate) dropout: f64,
    pub(crate) n_patches: usize,
    pub(crate) patch_radius_mm: f64,
}

pub(crate) const CLEAN: Noise = Noise { depth_mm: 0.0, dropout: 0.0, n_patches: 0, patch_radius_mm: 0.0 };
pub(crate) const USUAL: Noise = Noise { depth_mm: 0.05, dropout: 0.02, n_patches: 3, patch_radius_mm: 1.2 };

impl Bone {
    /// The camera's pose 200 mm from the shaft, looking at a height above the tip between lateral and posterior.
    pub(crate) fn camera(&self, height_mm: f64) -> Isometry3<f64> {
        let at = self.tip + self.proximal * height_mm;
        let out = (self.lateral + self.posterior).normalize();
        let middle = self.query.cast_ray(&(at + out * 100.0), &-out).map_or(at, |hit| hit.point);
        let z = -out;
        let x = (self.proximal - z * z.dot(&self.proximal)).normalize();
        let columns = Matrix3::from_columns(&[x, z.cross(&x), z]);
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(columns));
        Isometry3::from_parts((middle + out * 200.0).coords.into(), rotation)
    }

    /// What the camera sees between two heights above the tip, on a grid of `step_mm` at 200 mm, in the CT frame; a
    /// laser spot leaves a disc out.
    pub(crate) fn scan(
        &self,
        t_ct_camera: &Isometry3<f64>,
        heights_mm: [f64; 2],
        step_mm: f64,
        noise: &Noise,
        spot: Option<(Point3<f64>, f64)>,
        seed: u64,
    ) -> Cloud {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let depth = Normal::new(0.0, noise.depth_mm).unwrap();
        let half = (heights_mm[1] - heights_mm[0]) * 0.75;
        let n = (half / step_mm) as i64;
        let shift = (rng.random::<f64>(), rng.random::<f64>());
        let mut points = Vec::new();
        for i in -n..=n {
            for j in -(n / 2)..=n / 2 {
                let (u, v) = ((i as f64 + shift.0) * step_mm / 200.0, (j as f64 + shift.1) * step_mm / 200.0);
                let ray = t_ct_camera.rotation * Vector3::new(u, v, 1.0).normalize();
                let Some(hit) = self.query.cast_ray(&Point3::from(t_ct_camera.translation.vector), &ray) else {
                    continue;
                };
                let height = (hit.point - self.tip).dot(&self.proximal);
                let seen = -hit.normal.dot(&ray) > 72_f64.to_radians().cos();
                let lost = rng.random::<f64>() < noise.dropout;
                let point = hit.point + ray * depth.sample(&mut rng);
                if seen && !lost && (heights_mm[0]..=heights_mm[1]).contains(&height) {
                    points.push((hit.point, point));
                }
            }
        }
        let patches: Vec<Point3<f64>> =
            (0..noise.n_patches).map(|_| points[rng.random_range(0..points.len())].0).collect();
        points.retain(|(at, _)| {
            patches.iter().all(|p| (p - at).norm() > noise.patch_radius_mm)
                && spot.is_none_or(|(p, radius)| (p - at).norm() > radius)
        });
        let points: Vec<Point3<f64>> = points.into_iter().map(|(_, p)| p).collect();
        Cloud::new("ct", points).unwrap().seen_from(*t_ct_camera)
    }

    /// Samples of the whole surface, with normals.
    pub(crate) fn target(&self, n: usize) -> Target {
        let samples = sample::surface(&self.mesh, n, &mut ChaCha8Rng::seed_from_u64(7));
        Target::new("ct", SurfaceOrigin::Exact, samples.points, Some(samples.normals.into())).unwrap()
    }
}

/// A motion about `centre` of the given size in a random direction.
pub(crate) fn displaced(centre: &Point3<f64>, mm: f64, rad: f64, seed: u64) -> Isometry3<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut direction = || Vector3::from(UnitSphere.sample(&mut rng));
    let turn = UnitQuaternion::from_scaled_axis(direction() * rad);
    let shift = direction() * mm;
    Isometry3::from_parts((shift + centre.coords - turn * centre.coords).into(), turn)
}

/// RMS distance between the points moved by two motions, mm.
pub(crate) fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>, points: &[Point3<f64>]) -> f64 {
    (points.iter().map(|p| (a * p - b * p).norm_squared()).sum::<f64>() / points.len() as f64).sqrt()
}
