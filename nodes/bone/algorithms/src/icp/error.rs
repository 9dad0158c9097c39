/// Why an ICP has no result.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum IcpError {
    /// Too few source points are near the target.
    #[error(
        "{n_pairs} of {n_source} source points lie within {max_pair_distance_mm} mm of the target, {min_pairs} are \
         needed; the nearest target point is {nearest_mm:.1} mm away: is init right, and are both in mm?"
    )]
    TooFewPairs {
        /// Number of pairs found.
        n_pairs: usize,
        /// Number of pairs needed.
        min_pairs: usize,
        /// Number of source points.
        n_source: usize,
        /// Largest distance of a pair, mm.
        max_pair_distance_mm: f64,
        /// Distance of the source point nearest to the target, mm.
        nearest_mm: f64,
    },
    /// Few source points, or of a thousand of them, are near the part of the target that faces the camera, but many are near any part of it.
    #[error(
        "{n_pairs} of {n_source} source points lie within {max_pair_distance_mm} mm of the part of the target that faces the camera, \
         but {n_any} lie as near to any part of it; is the target an open surface that is inside out, or a cloud \
         with normals of the wrong side? Flip its faces (in MeshLab: Invert Faces Orientation), or leave the camera out; else check the \
         camera's position, in the source's frame and in mm"
    )]
    TooFewFacing {
        /// Number of pairs found.
        n_pairs: usize,
        /// Number of source points.
        n_source: usize,
        /// Number of source points near any part of the target.
        n_any: usize,
        /// Largest distance of a pair, mm.
        max_pair_distance_mm: f64,
    },
    /// No part of the target faces the camera.
    #[error(
        "no part of the target faces the camera; is its position in the source's frame and in mm? If so, the target is an open surface \
         that is inside out: flip its faces (in MeshLab: Invert Faces Orientation), or leave the camera out"
    )]
    NothingFaces,
    /// There are too few source points.
    #[error("{n_source} source points, {min_pairs} are needed; is the crop empty?")]
    TooFewPoints {
        /// Number of source points.
        n_source: usize,
        /// Number of points needed.
        min_pairs: usize,
    },
    /// The variant needs normals, and the target has none.
    #[error("the target has no normals, which this variant needs; sample it from a mesh or estimate them")]
    NoNormals,
    /// The variant needs a mesh, and the target has none.
    #[error("the target has no triangles, which point_to_mesh needs; prepare it from a mesh")]
    NoMesh,
    /// The source's normals and points differ in number.
    #[error("the source has {n_normals} normals for {n_points} points")]
    SourceNormals {
        /// Number of points.
        n_points: usize,
        /// Number of normals.
        n_normals: usize,
    },
    /// A source point or the start is NaN or infinite.
    #[error("{what} is not finite; drop such points before the registration")]
    NotFinite {
        /// What is not finite.
        what: String,
    },
    /// A parameter is out of range.
    #[error("{parameter} is {value}, but {expected}")]
    Parameter {
        /// Its name.
        parameter: &'static str,
        /// Its value.
        value: f64,
        /// The values it may have.
        expected: &'static str,
    },
}
