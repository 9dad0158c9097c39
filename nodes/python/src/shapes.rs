//! Clouds, surfaces, points and poses between Python and the program.

use crate::{
    errors::{UsageError, exception, watched},
    foreign, views,
};
use numpy::PyArrayDyn;
use osteoflow::app::{self, CloudFileRead, Content, MeshOrCloud, MeshRead, Precision, Space};
use osteoflow_geometry::{
    Cloud, Mesh, NamedPoint, Pose, SurfaceOrigin, matrix_rows,
    nalgebra::{Isometry3, Matrix4, Point3, Vector3},
    nearest_isometry,
};
use osteoflow_node::{Payload, Value, View};
use pyo3::{
    exceptions::PyValueError,
    prelude::*,
    types::{PyDict, PyList},
};
use std::{path::PathBuf, sync::Arc};

type Array<'py, T> = Bound<'py, PyArrayDyn<T>>;

/// What Python gives of a cloud: points, normals, extra columns; of a surface: vertices, faces. And the space.
#[derive(FromPyObject)]
enum Shape<'py> {
    Mesh(Array<'py, f64>, Array<'py, u32>, String),
    Cloud(Array<'py, f64>, Option<Array<'py, f64>>, Bound<'py, PyDict>, String),
}

pub(crate) fn space_of(name: &str) -> PyResult<Space> {
    match name {
        "" => Ok(Space::Unknown),
        "LPS" => Ok(Space::Lps),
        "RAS" => Ok(Space::Ras),
        other => Err(UsageError::new_err(format!("space is \"{other}\", but must be \"LPS\", \"RAS\" or None"))),
    }
}

fn name_of(space: Space) -> &'static str {
    match space {
        Space::Unknown => "",
        Space::Lps | Space::Ras => "LPS",
    }
}

fn invalid(what: &str, error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(format!("{what}: {error}"))
}

/// A cloud or surface that Python gives.
pub(crate) fn given(shape: &Bound<'_, PyAny>, what: &str) -> PyResult<MeshOrCloud> {
    match shape.extract()? {
        Shape::Mesh(vertices, faces, space) => {
            let vertices = foreign::column::<f64, Point3<f64>>(&vertices, &format!("{what}: vertices"))?;
            let faces = foreign::column::<u32, [u32; 3]>(&faces, &format!("{what}: faces"))?;
            let mesh = Mesh::new(what, SurfaceOrigin::User, vertices, faces).map_err(|e| invalid(what, e))?;
            let space = space_of(&space)?;
            Ok(MeshOrCloud::Mesh(MeshRead { mesh, n_degenerate: 0, space, notes: Vec::new() }))
        }
        Shape::Cloud(points, normals, extras, space) => {
            let points = foreign::column::<f64, Point3<f64>>(&points, what)?;
            let mut cloud = Cloud::new(what, points).map_err(|error| {
                invalid(what, format!("{error}; leave such points out: a[np.isfinite(a).all(axis=1)]"))
            })?;
            if let Some(normals) = normals {
                let normals = foreign::column::<f64, Vector3<f64>>(&normals, &format!("{what}: normals"))?;
                cloud = cloud.with_normals(normals).map_err(|e| invalid(what, e))?;
            }
            for (name, values) in extras.iter() {
                let (name, values): (String, Vec<f64>) = (name.extract()?, values.extract()?);
                cloud = cloud.with_extra(name, values).map_err(|e| invalid(what, e))?;
            }
            let (n_points_in_file, space) = (cloud.len(), space_of(&space)?);
            let read = CloudFileRead { cloud, n_points_in_file, n_dropped: 0, n_invalid: 0, space, notes: Vec::new() };
            Ok(MeshOrCloud::Cloud(read, Vec::new()))
        }
    }
}

/// The rigid motion of a 4 x 4 matrix, the nearest one if it is rounded, as from a file.
pub(crate) fn rigid(rows: &[[f64; 4]; 4], what: &str) -> PyResult<Isometry3<f64>> {
    let matrix = Matrix4::from_fn(|row, column| rows[row][column]);
    Ok(nearest_isometry(&matrix).map_err(|error| invalid(what, error))?.value)
}

/// The 4 x 4 matrix of a rigid motion.
fn rows(isometry: &Isometry3<f64>) -> Vec<Vec<f64>> {
    matrix_rows(isometry).iter().map(|row| row.to_vec()).collect()
}

/// Reads a file: what it is ("cloud", "mesh", "points", "pose", "recording"), its content, its space, and notes.
#[pyfunction]
pub(crate) fn read<'py>(
    py: Python<'py>,
    file: PathBuf,
    unit_mm: f64,
    frame: &str,
    threshold_hu: Option<f64>,
    series: Option<&str>,
) -> PyResult<(&'static str, Bound<'py, PyAny>, &'static str, Vec<String>)> {
    let cancelled = Arc::default();
    let content = watched(py, &cancelled, || app::read(&file, unit_mm, frame, threshold_hu, series))?;
    let dicts = |view: &View| Ok::<_, PyErr>(views::dicts(py, view)?.into_pyobject(py)?.into_any());
    Ok(match content {
        Content::Recording => ("recording", py.None().into_bound(py), "", Vec::new()),
        Content::Pose(isometry, notes) => ("pose", rows(&isometry).into_pyobject(py)?.into_any(), "", notes),
        Content::Points(picked) => {
            let points = picked.points.iter().map(|point| {
                let p = point.position;
                (point.name.to_string(), [p.x, p.y, p.z])
            });
            let mut notes = picked.notes.clone();
            let n_other = (picked.planes.len(), picked.rois.len());
            if n_other != (0, 0) {
                notes.push(format!("{} planes and {} boxes are not points, and were left out", n_other.0, n_other.1));
            }
            let points = PyList::new(py, points.collect::<Vec<_>>())?;
            ("points", points.into_any(), name_of(picked.space), notes)
        }
        Content::Shape(MeshOrCloud::Mesh(read)) => {
            ("mesh", dicts(&Value::new(read.mesh).to_view())?, name_of(read.space), read.notes)
        }
        Content::Shape(MeshOrCloud::Cloud(read, notes)) => {
            ("cloud", dicts(&Value::new(read.cloud).to_view())?, name_of(read.space), notes)
        }
    })
}

/// Writes a cloud or surface; returns what the reader of the file should know.
#[pyfunction]
pub(crate) fn write_shape(
    py: Python<'_>,
    file: PathBuf,
    shape: Bound<'_, PyAny>,
    double: bool,
) -> PyResult<Vec<String>> {
    let cancelled = Arc::default();
    let precision = if double { Precision::Double } else { Precision::Single };
    match given(&shape, "what is to be written")? {
        MeshOrCloud::Mesh(read) => {
            watched(py, &cancelled, || app::write_mesh(&file, &read.mesh, read.space, precision))
        }
        MeshOrCloud::Cloud(read, _) => {
            watched(py, &cancelled, || app::write_cloud(&file, &read.cloud, read.space, precision))
        }
    }
}

/// Writes named points.
#[pyfunction]
pub(crate) fn write_points(
    py: Python<'_>,
    file: PathBuf,
    points: Vec<(String, [f64; 3])>,
    space: &str,
) -> PyResult<()> {
    let points: Vec<NamedPoint> =
        points.into_iter().map(|(name, xyz)| NamedPoint::new(name, Point3::from(xyz))).collect();
    app::write_points(&file, &points, space_of(space)?).map_err(|error| exception(py, error))
}

/// Writes a rigid motion.
#[pyfunction]
pub(crate) fn write_pose(py: Python<'_>, file: PathBuf, pose: [[f64; 4]; 4]) -> PyResult<()> {
    app::write_pose(&file, &pose).map_err(|error| exception(py, error))
}

/// A 4 x 4 matrix as the seven numbers of a pose payload.
#[pyfunction]
pub(crate) fn seven(pose: [[f64; 4]; 4]) -> PyResult<Vec<f64>> {
    let view = Value::new(Pose::new("to", "from", rigid(&pose, "the pose")?)).to_view();
    Ok(view.floats::<7>("isometry").map_err(|error| invalid("the pose", error))?.to_vec())
}

/// The 4 x 4 matrix of the seven numbers of a pose payload.
#[pyfunction]
pub(crate) fn matrix(seven: [f64; 7]) -> PyResult<Vec<Vec<f64>>> {
    let view = View::new().with("to", "to").with("from", "from").with("stamp_ns", 0).with("isometry", seven.to_vec());
    let pose = <Pose as Payload<osteoflow_payloads::Table>>::from_view(&view);
    Ok(rows(&pose.map_err(|error| invalid("the pose", error))?.isometry))
}
