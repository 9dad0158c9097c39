//! Extraction of an iso-surface from a volume, in the coordinates of its voxels.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Raises voxels (`size`, x fastest) to just above `level` until no two regions touch only at an edge or corner, so that the surface
/// between them is a manifold; returns their number. It is always the voxel nearest the level that is raised.
///
/// # Source
/// Latecki 1997, 3D well-composed pictures: two diagonal corners of a square of voxels, or two opposite corners of a
/// cube, must not differ from all others. Raising terminates, as it only ever adds voxels above the level.
pub fn make_well_composed(volume: &mut [f32], size: [usize; 3], level: f32) -> usize {
    let [nx, ny, nz] = size;
    let step = [1, nx, nx * ny];
    let just_above = level + (1e-5 * level.abs()).max(1e-6);
    let mut n_raised = 0;
    loop {
        let before = n_raised;
        for z in 0..nz.saturating_sub(1) {
            for y in 0..ny.saturating_sub(1) {
                let row = (z * ny + y) * nx;
                // The four voxels of a cell at one x are its corners 0, 2, 4 and 6.
                let column = |volume: &[f32], x: usize| {
                    let at = [row + x, row + x + step[1], row + x + step[2], row + x + step[1] + step[2]];
                    at.iter().enumerate().fold(0u8, |mask, (k, &v)| mask | u8::from(volume[v] > level) << (2 * k))
                };
                let mut next = column(volume, 0);
                for x in 0..nx.saturating_sub(1) {
                    let first = row + x;
                    let corner = |c: usize| first + (c & 1) * step[0] + (c >> 1 & 1) * step[1] + (c >> 2) * step[2];
                    let left = next;
                    next = column(volume, x + 1);
                    let above = left | next << 1;
                    if above == 0 || above == 255 {
                        continue;
                    }
                    let touching = (0..3).find_map(|axis| {
                        let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
                        [0, 1 << axis].into_iter().find_map(|at: usize| {
                            let square = [at, at | u, at | u | v, at | v].map(|c| above >> c & 1);
                            (square[0] == square[2] && square[1] == square[3] && square[0] != square[1])
                                .then_some(1u8 << at | 1 << (at | u) | 1 << (at | u | v) | 1 << (at | v))
                        })
                    });
                    let opposite = (0..4).any(|c| {
                        let pair = 1u8 << c | 1 << (7 - c);
                        above == pair || above == !pair
                    });
                    let Some(among) = touching.or(opposite.then_some(255)) else { continue };
                    let low = (0..8).filter(|&c| among >> c & 1 == 1 && above >> c & 1 == 0).map(corner);
                    let Some(nearest) = low.reduce(|a, b| if volume[b] > volume[a] { b } else { a }) else { continue };
                    volume[nearest] = just_above;
                    next = column(volume, x + 1);
                    n_raised += 1;
                }
            }
        }
        if n_raised == before {
            return n_raised;
        }
    }
}

/// Vertices and faces of the surface between voxels (`size`, x fastest) at or below `level` and those above; normals
/// point to the lower side. Empty if no voxel is above. Where the border of the grid is above the level the surface stays
/// open.
///
/// `place` takes the index of a voxel's centre, or a position between centres, to the vertex's coordinates; any affine
/// map will do. One that mirrors (of negative determinant) turns the normals to the higher side: swap two corners of each
/// face. `O(voxels)`, on all threads; the result does not depend on their number.
///
/// Naive surface nets: one vertex in each cell of eight voxels that the surface passes through, at the mean of its
/// intersections with the cell's edges, and one quad for each intersected edge. Triangles are of even size, half as
/// many as of marching tetrahedra; the vertices of a flat surface lie exactly on it.
///
/// # Source
/// Gibson 1998, Constrained elastic surface nets, in the form without relaxation.
pub fn iso_surface(
    volume: &[f32],
    size: [usize; 3],
    level: f32,
    place: impl Fn(Vector3<f64>) -> Point3<f64> + Sync,
) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let [nx, ny, nz] = size;
    if nx < 2 || ny < 2 || nz < 2 {
        return (Vec::new(), Vec::new());
    }
    let value = |x: usize, y: usize, z: usize| volume[(z * ny + y) * nx + x] - level;

    // Cells of a layer that hold a vertex, by their index in the layer.
    let layers: Vec<Vec<(u32, Point3<f64>)>> = (0..nz - 1)
        .into_par_iter()
        .map(|z| {
            let mut crossings = Vec::new();
            for y in 0..ny - 1 {
                // The four voxels of a cell at one x are its corners 0, 2, 4 and 6.
                let column = |x: usize| {
                    let at = [value(x, y, z), value(x, y + 1, z), value(x, y, z + 1), value(x, y + 1, z + 1)];
                    at.iter().enumerate().fold(0u8, |mask, (k, v)| mask | u8::from(*v > 0.0) << (2 * k))
                };
                let mut next = column(0);
                for x in 0..nx - 1 {
                    let left = next;
                    next = column(x + 1);
                    let above = left | next << 1;
                    if above == 0 || above == 255 {
                        continue;
                    }
                    let corners: [f32; 8] = std::array::from_fn(|c| value(x + (c & 1), y + (c >> 1 & 1), z + (c >> 2)));
                    let within = cell_vertex(&corners);
                    let at = Vector3::new(x as f64, y as f64, z as f64) + within;
                    crossings.push(((y * nx + x) as u32, place(at)));
                }
            }
            crossings
        })
        .collect();
    let mut first = Vec::with_capacity(layers.len());
    let mut n = 0;
    for layer in &layers {
        first.push(n);
        n += layer.len();
    }
    let vertex = |x: usize, y: usize, z: usize| {
        let cell = (y * nx + x) as u32;
        let place = layers[z].binary_search_by_key(&cell, |(c, _)| *c).expect("a cut edge's cells hold vertices");
        (first[z] + place) as u32
    };

    // Every edge is shared by four cells; those at the grid's border by fewer, and give no face.
    let faces: Vec<Vec<[u32; 3]>> = (0..nz - 1)
        .into_par_iter()
        .map(|z| {
            let mut faces = Vec::new();
            for &(cell, _) in &layers[z] {
                let (x, y) = (cell as usize % nx, cell as usize / nx);
                let here = value(x, y, z) > 0.0;
                let mut quad = |there: f32, [a, b, c, d]: [u32; 4]| {
                    if here {
                        faces.extend([[a, b, c], [a, c, d]]);
                    } else if there > 0.0 {
                        faces.extend([[a, c, b], [a, d, c]]);
                    }
                };
                let ends = [value(x + 1, y, z), value(x, y + 1, z), value(x, y, z + 1)];
                let cut = ends.map(|there| (there > 0.0) != here);
                if cut[0] && y > 0 && z > 0 {
                    quad(ends[0], [vertex(x, y, z), vertex(x, y - 1, z), vertex(x, y - 1, z - 1), vertex(x, y, z - 1)]);
                }
                if cut[1] && x > 0 && z > 0 {
                    quad(ends[1], [vertex(x, y, z), vertex(x, y, z - 1), vertex(x - 1, y, z - 1), vertex(x - 1, y, z)]);
                }
                if cut[2] && x > 0 && y > 0 {
                    quad(ends[2], [vertex(x, y, z), vertex(x - 1, y, z), vertex(x - 1, y - 1, z), vertex(x, y - 1, z)]);
                }
            }
            faces
        })
        .collect();
    (layers.into_iter().flatten().map(|(_, p)| p).collect(), faces.into_iter().flatten().collect())
}

/// The mean of the intersections of the level with the edges of a unit cell, from its corner values (bit 0 is x, 1 is
/// y, 2 is z).
fn cell_vertex(corners: &[f32; 8]) -> Vector3<f64> {
    let (mut sum, mut n) = (Vector3::zeros(), 0.0);
    for axis in 0..3 {
        for a in (0..8).filter(|c| c >> axis & 1 == 0) {
            let b = a | 1 << axis;
            let (va, vb) = (f64::from(corners[a]), f64::from(corners[b]));
            if (va > 0.0) != (vb > 0.0) {
                let mut at = Vector3::new((a & 1) as f64, (a >> 1 & 1) as f64, (a >> 2 & 1) as f64);
                at[axis] = va / (va - vb);
                sum += at;
                n += 1.0;
            }
        }
    }
    sum / n
}

/// The vertices that the faces use, in their order, and the faces among them.
pub(crate) fn compacted(vertices: &[Point3<f64>], mut faces: Vec<[u32; 3]>) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    const UNUSED: u32 = u32::MAX;
    let mut new_index = vec![UNUSED; vertices.len()];
    faces.iter().flatten().for_each(|&v| new_index[v as usize] = 0);
    let mut used = Vec::new();
    for (index, vertex) in new_index.iter_mut().zip(vertices).filter(|(index, _)| **index != UNUSED) {
        *index = used.len() as u32;
        used.push(*vertex);
    }
    faces.iter_mut().flatten().for_each(|v| *v = new_index[*v as usize]);
    (used, faces)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh_topology::open_edges;
    use osteoflow_geometry::{Mesh, SurfaceOrigin};
    use rand::{RngExt, SeedableRng};

    struct Grid {
        origin: Point3<f64>,
        spacing_mm: f64,
        size: [usize; 3],
    }

    impl Grid {
        fn surface(&self, volume: &[f32], level: f32) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
            iso_surface(volume, self.size, level, |at| self.origin + at * self.spacing_mm)
        }
    }

    fn assert_closed_and_outward(mesh: &Mesh) -> f64 {
        assert_eq!(open_edges(mesh), 0, "open edges");
        let volume = mesh.volume_mm3();
        assert!(volume > 0.0, "the normals point inward: volume {volume} mm3");
        volume
    }

    fn sampled(grid: &Grid, f: impl Fn(&Point3<f64>) -> f64) -> Vec<f32> {
        let [nx, ny, nz] = grid.size;
        (0..nx * ny * nz)
            .map(|i| {
                let at = Vector3::new((i % nx) as f64, (i / nx % ny) as f64, (i / nx / ny) as f64);
                f(&(grid.origin + at * grid.spacing_mm)) as f32
            })
            .collect()
    }

    #[test]
    fn a_ball_comes_out_closed_and_of_its_size() {
        let grid = Grid { origin: Point3::new(-7.0, -7.0, -7.0), spacing_mm: 0.5, size: [29, 29, 29] };
        let volume = sampled(&grid, |p| 5.0 - p.coords.norm());
        let (vertices, faces) = grid.surface(&volume, 0.0);
        for v in &vertices {
            let radius = v.coords.norm();
            // A chord of one cell's diagonal is 0.02 mm inside the arc.
            assert!((4.97..5.001).contains(&radius), "radius {radius} mm");
        }
        let ball = Mesh::new("ct", SurfaceOrigin::SimulatedCt, vertices, faces).unwrap();
        let volume = assert_closed_and_outward(&ball);
        let expected = 4.0 / 3.0 * std::f64::consts::PI * 125.0;
        assert!((volume / expected - 1.0).abs() < 0.02, "{volume} mm3, not {expected}");
    }

    #[test]
    fn even_pure_noise_gives_a_closed_manifold_once_it_is_well_composed() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let grid = Grid { origin: Point3::origin(), spacing_mm: 1.0, size: [20, 20, 20] };
        let inside = |p: &Point3<f64>| p.iter().all(|c| (1.5..17.5).contains(c));
        let noise = sampled(&grid, |p| if inside(p) { -0.6 } else { -9.0 });
        let mut noise: Vec<f32> = noise.into_iter().map(|v| v + rng.random::<f32>()).collect();
        let mesh = |volume: &[f32]| {
            let (vertices, faces) = grid.surface(volume, 0.5);
            Mesh::new("ct", SurfaceOrigin::SimulatedCt, vertices, faces).unwrap()
        };
        noise.iter_mut().for_each(|v| *v += 0.5);
        assert!(open_edges(&mesh(&noise)) > 0, "the noise should touch itself somewhere");
        assert!(make_well_composed(&mut noise, grid.size, 0.5) > 0);
        assert_closed_and_outward(&mesh(&noise));
        assert_eq!(make_well_composed(&mut noise, grid.size, 0.5), 0);
    }

    #[test]
    fn a_slanted_plane_is_met_exactly_and_a_flat_volume_gives_nothing() {
        let grid = Grid { origin: Point3::new(-3.0, -3.0, -3.0), spacing_mm: 0.6, size: [11, 11, 11] };
        let normal = Vector3::new(0.3, -0.5, 0.8);
        let (vertices, _) = grid.surface(&sampled(&grid, |p| 0.13 - normal.dot(&p.coords)), 0.0);
        assert!(!vertices.is_empty());
        for v in &vertices {
            // Values are single precision.
            assert!((normal.dot(&v.coords) - 0.13).abs() < 1e-6);
        }
        assert!(grid.surface(&[1.0; 11 * 11 * 11], 0.5).0.is_empty());
    }
}
