//! The development data, where they are at hand.

use osteoflow_geometry::nalgebra::{Point3, Unit, Vector3};
use osteoflow_geometry::{Anatomy, Mesh, SurfaceOrigin};
use std::path::{Path, PathBuf};

/// The folder of development data: `OSTEOFLOW_DATA`, else `../shared/data` beside the workspace.
pub(crate) fn data_folder() -> Option<PathBuf> {
    let beside = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../../shared/data");
    let folder = std::env::var_os("OSTEOFLOW_DATA").map_or(beside, PathBuf::from);
    folder.is_dir().then_some(folder)
}

/// A measured fibula with its anatomy, by its name in `bones/anatomy.json`.
pub(crate) fn measured_bone(name: &str) -> Option<(Mesh, Anatomy)> {
    let bones = data_folder()?.join("bones");
    let all: serde_json::Value = serde_json::from_slice(&std::fs::read(bones.join("anatomy.json")).ok()?).unwrap();
    let vector =
        |key: &str| Vector3::from_iterator(all[name][key].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()));
    let anatomy = Anatomy {
        malleolus_tip: Point3::from(vector("malleolus_tip")),
        proximal: Unit::new_normalize(vector("proximal")),
        lateral: Unit::new_normalize(vector("lateral")),
        posterior: Unit::new_normalize(vector("posterior")),
    };
    Some((stl(&bones.join(format!("{name}.stl")), "ct")?, anatomy))
}

/// The surface in a file of the development data, mm, in this frame; `None` if there is no such file.
pub(crate) fn stl(path: &Path, frame: &str) -> Option<Mesh> {
    let stl = stl_io::read_stl(&mut std::fs::File::open(path).ok()?).unwrap();
    let vertices: Vec<Point3<f64>> =
        stl.vertices.iter().map(|v| Point3::new(f64::from(v[0]), f64::from(v[1]), f64::from(v[2]))).collect();
    let faces: Vec<[u32; 3]> = stl.faces.iter().map(|f| f.vertices.map(|v| v as u32)).collect();
    Some(Mesh::new(frame, SurfaceOrigin::User, vertices, faces).unwrap())
}
