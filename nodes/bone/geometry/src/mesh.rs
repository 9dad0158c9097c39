use crate::{Column, Frame, TooFar};
use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize};
use std::fmt;

/// The origin of a CT surface, reported with every result made with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SurfaceOrigin {
    /// The surface that was scanned; only a simulation has it.
    Exact,
    /// The iso-surface of a simulated CT.
    SimulatedCt,
    /// A file that the user gave.
    User,
}

impl fmt::Display for SurfaceOrigin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Exact => "exact",
            Self::SimulatedCt => "simulated_ct",
            Self::User => "user",
        })
    }
}

/// A triangle mesh in mm; faces turn counter-clockwise seen from outside. A cheap handle.
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    /// The frame of the vertices.
    pub frame: Frame,
    /// The origin of the surface.
    pub origin: SurfaceOrigin,
    vertices: Column<Point3<f64>>,
    faces: Column<[u32; 3]>,
}

/// Invalid vertices or faces.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MeshError {
    /// There is no triangle.
    #[error("the mesh has no triangles; is it a point cloud or an empty file?")]
    Empty,
    /// A face names a vertex that is not there.
    #[error("face {face} names vertex {vertex}, but there are {n_vertices}")]
    Index {
        /// The face.
        face: usize,
        /// The vertex it names.
        vertex: u32,
        /// The number of vertices.
        n_vertices: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("vertex {vertex} is not finite")]
    NotFinite {
        /// The first such vertex.
        vertex: usize,
    },
    /// A coordinate is beyond [`FARTHEST_MM`](crate::FARTHEST_MM).
    #[error("vertex {vertex}: {far}")]
    TooFar {
        /// The first such vertex.
        vertex: usize,
        /// Its coordinate.
        far: TooFar,
    },
}

impl Mesh {
    /// A mesh of `faces` over `vertices` in `frame`.
    ///
    /// # Errors
    /// [`MeshError`] if there are no faces, a face names a missing vertex, a vertex is not finite, or
    /// beyond [`FARTHEST_MM`](crate::FARTHEST_MM).
    pub fn new(
        frame: impl Into<Frame>,
        origin: SurfaceOrigin,
        vertices: impl Into<Column<Point3<f64>>>,
        faces: impl Into<Column<[u32; 3]>>,
    ) -> Result<Self, MeshError> {
        let (vertices, faces) = (vertices.into(), faces.into());
        if faces.is_empty() {
            return Err(MeshError::Empty);
        }
        if let Some((vertex, far)) = TooFar::first(&vertices) {
            let is_finite = far.value_mm.is_finite();
            return Err(if is_finite { MeshError::TooFar { vertex, far } } else { MeshError::NotFinite { vertex } });
        }
        let n_vertices = vertices.len();
        for (face, corners) in faces.iter().enumerate() {
            if let Some(&vertex) = corners.iter().find(|&&v| v as usize >= n_vertices) {
                return Err(MeshError::Index { face, vertex, n_vertices });
            }
        }
        Ok(Self { frame: frame.into(), origin, vertices, faces })
    }

    /// The vertices, `n`, mm.
    pub fn vertices(&self) -> &[Point3<f64>] {
        &self.vertices
    }

    /// The faces, `m × 3`, as indices of vertices.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    /// The vertices as a column that can be shared.
    pub fn vertex_column(&self) -> &Column<Point3<f64>> {
        &self.vertices
    }

    /// The faces as a column that can be shared.
    pub fn face_column(&self) -> &Column<[u32; 3]> {
        &self.faces
    }

    /// The three corners of a face.
    ///
    /// # Panics
    /// If `face` is out of range.
    pub fn corners(&self, face: usize) -> [Point3<f64>; 3] {
        self.faces[face].map(|v| self.vertices[v as usize])
    }

    /// Twice the area of a face times its outward normal; zero for a degenerate face.
    ///
    /// # Panics
    /// If `face` is out of range.
    pub fn area_vector(&self, face: usize) -> Vector3<f64> {
        let [a, b, c] = self.corners(face);
        (b - a).cross(&(c - a))
    }

    /// The area of the whole surface, mm². `O(n)`.
    pub fn area_mm2(&self) -> f64 {
        (0..self.faces.len()).map(|face| self.area_vector(face).norm() / 2.0).sum()
    }

    /// The enclosed volume, mm³, negative if the faces turn clockwise seen from outside; for a closed mesh. `O(n)`.
    ///
    /// Taken about the first face's first corner, so that no digits are lost far from the origin.
    pub fn volume_mm3(&self) -> f64 {
        let start = self.corners(0)[0];
        let six_times = |face: usize| {
            let [a, b, c] = self.corners(face).map(|v| v - start);
            a.dot(&b.cross(&c))
        };
        (0..self.faces.len()).map(six_times).sum::<f64>() / 6.0
    }

    /// The mesh in frame `to`, moved by `t_to_frame`. `O(n)`.
    pub fn transformed(&self, to: impl Into<Frame>, t_to_frame: &Isometry3<f64>) -> Mesh {
        let vertices = self.vertices.iter().map(|v| t_to_frame * v).collect();
        Mesh { frame: to.into(), origin: self.origin, vertices, faces: self.faces.clone() }
    }
}
