//! The closest point of a surface that is known by points and normals.

use super::{Nearest, Node, Surface};
use crate::bvh::{Aabb, below, bits};
use crate::point_blocks::{BLOCK_LEN, PointBlock, PointBlocks, halves};
use nalgebra::{Matrix3, Point3, Vector3};
use parry3d_f64::glamx::Vec4;

/// Samples within the radius of an average. 40: weights fall off towards its rim, so that about fifteen count, which
/// averages facets and noise, and a fibula 10 mm thick bends by less than 0.1 mm over the 0.8 mm of 10 samples a mm².
const AVERAGED: usize = 30;

/// A fit serves where the foot lies nearer to its middle than this share of the radius.
const CENTRED: f64 = 0.3;

/// The mean normal of an average is shorter than this where its samples do not agree which side is outside.
const AGREEMENT: f64 = 0.3;

/// Samples of a surface along a space-filling curve.
pub(super) struct Samples {
    points: PointBlocks,
    /// Of each block: for each axis four and four.
    normals: Vec<[[Vec4; 2]; 3]>,
    extent: Aabb,
    radius: f64,
}

/// Weighted sums over samples about a place.
#[derive(Default)]
struct Sums {
    weight: f64,
    at: Vector3<f64>,
    normal: Vector3<f64>,
    at_normal: f64,
    at_at: f64,
}

impl Samples {
    /// The samples about `centre`, along `axes`; at least one, normals of unit length.
    pub(super) fn new(
        points: &[Point3<f64>],
        normals: &[Vector3<f64>],
        centre: &Point3<f64>,
        axes: &Matrix3<f64>,
    ) -> Self {
        let places: Vec<Vector3<f64>> = points.iter().map(|p| axes.tr_mul(&(p - centre))).collect();
        let points = PointBlocks::new(&places);
        let normals = points
            .order
            .chunks(BLOCK_LEN)
            .map(|eight| {
                let turned = |k: usize| eight.get(k).map_or(Vector3::zeros(), |&i| axes.tr_mul(&normals[i as usize]));
                let turned: [Vector3<f64>; BLOCK_LEN] = std::array::from_fn(turned);
                [0, 1, 2].map(|axis| halves(turned.map(|n| n[axis] as f32)))
            })
            .collect();
        let radius = points.typical_radius(AVERAGED);
        Self { points, normals, extent: Aabb::of(&places), radius }
    }

    /// The share of samples whose normal points opposite to that of the next one along the curve, if that is near.
    pub(super) fn disagreement(&self) -> f64 {
        let (mut near, mut opposite) = (0_usize, 0_usize);
        for (block, normals) in self.points.blocks.iter().zip(&self.normals) {
            let normal = |k: usize| Vector3::from(normals.map(|halves| halves[k / 4][k % 4]));
            for k in 1..BLOCK_LEN {
                if (block.place(k) - block.place(k - 1)).norm() < self.radius {
                    near += 1;
                    opposite += usize::from(normal(k).dot(&normal(k - 1)) < 0.0);
                }
            }
        }
        opposite as f64 / near.max(1) as f64
    }

    /// Weights fall from one to zero at the radius, smoothly: `(1 - s²)²`.
    fn sums(&self, about: &Vector3<f64>) -> Sums {
        let mut sums = [Vec4::ZERO; 9];
        let scale = (1.0 / (self.radius * self.radius)) as f32;
        self.points.bvh.within(&Aabb { min: *about, max: *about }, self.radius, |k| {
            add(&self.points.blocks[k], &self.normals[k], about, scale, &mut sums);
        });
        let [weight, x, y, z, nx, ny, nz, at_normal, at_at] =
            sums.map(|four| four.to_array().into_iter().map(f64::from).sum());
        Sums { weight, at: Vector3::new(x, y, z), normal: Vector3::new(nx, ny, nz), at_normal, at_at }
    }
}

#[inline(always)]
fn add(points: &PointBlock, normals: &[[Vec4; 2]; 3], about: &Vector3<f64>, scale: f32, sums: &mut [Vec4; 9]) {
    let away = points.relative_to(about);
    for half in 0..2 {
        let [x, y, z] = away.map(|halves| halves[half]);
        let [nx, ny, nz] = normals.map(|halves| halves[half]);
        let squared = x * x + y * y + z * z;
        let left = (Vec4::ONE - squared * scale).max(Vec4::ZERO);
        let w = left * left;
        sums[0] += w;
        sums[1] += w * x;
        sums[2] += w * y;
        sums[3] += w * z;
        sums[4] += w * nx;
        sums[5] += w * ny;
        sums[6] += w * nz;
        sums[7] += w * (x * nx + y * ny + z * nz);
        sums[8] += w * squared;
    }
}

/// A sphere, or a plane, through samples: `c + l.q + a |q|²` is zero on it, for places `q` about the one of the sums.
///
/// # Source
/// Guennebaud and Gross 2007, section 4.4 (the fit to points with normals).
struct Sphere {
    c: f64,
    l: Vector3<f64>,
    a: f64,
}

impl Sphere {
    /// `None` where the samples do not agree on a side.
    fn through(sums: &Sums) -> Option<Self> {
        let (at, normal) = (sums.at / sums.weight, sums.normal / sums.weight);
        if normal.norm_squared() < AGREEMENT * AGREEMENT {
            return None;
        }
        let spread = sums.at_at / sums.weight - at.norm_squared();
        let bend = sums.at_normal / sums.weight - at.dot(&normal);
        let a = if spread > 1e-9 * sums.at_at / sums.weight { 0.5 * bend / spread } else { 0.0 };
        let l = normal - at * (2.0 * a);
        Some(Self { c: -l.dot(&at) - a * sums.at_at / sums.weight, l, a })
    }

    /// Signed distance and its gradient at `q`; past the middle of a sphere, those of the plane through it.
    fn at(&self, q: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let slope = self.l + q * (2.0 * self.a);
        let on_surface = self.l.norm_squared() - 4.0 * self.a * self.c;
        let length = slope.norm();
        if on_surface <= 0.0 || slope.dot(&self.l) < 0.25 * self.l.norm_squared() {
            let length = self.l.norm();
            return ((self.c + self.l.dot(q)) / length, self.l / length);
        }
        let value = self.c + self.l.dot(q) + self.a * q.norm_squared();
        (2.0 * value / (length + on_surface.sqrt()), slope / length)
    }
}

impl Surface for Samples {
    fn n(&self) -> usize {
        self.points.len()
    }

    fn extent(&self) -> Aabb {
        self.extent
    }

    fn nearest(&self, at: &Vector3<f64>, hint: Option<u32>) -> Nearest {
        let mut best = Nearest { squared: f64::INFINITY, which: 0 };
        if let Some(which) = hint {
            best = Nearest { squared: (self.points.place(which) - at).norm_squared() * (1.0 + 1e-6), which };
        }
        self.points.bvh.nearest(at, best.squared, |block| {
            let squared = self.points.blocks[block].squared(at);
            for k in bits(below(&squared, best.squared as f32)) {
                let squared = f64::from(squared[k / 4][k % 4]);
                if squared < best.squared {
                    best = Nearest { squared, which: (block * BLOCK_LEN + k) as u32 };
                }
            }
            best.squared
        });
        best
    }

    fn node(&self, at: &Vector3<f64>, nearest: &Nearest) -> Node {
        let nearest = self.points.place(nearest.which);
        let mut about = nearest;
        let mut found = None;
        // About the nearest sample, then about where that puts the foot, unless it is there already.
        for _ in 0..2 {
            let sums = self.sums(&about);
            let Some(sphere) = Sphere::through(&sums).filter(|_| sums.weight > 0.0) else { break };
            let q = at - about;
            let (distance, normal) = sphere.at(&q);
            let foot = q - normal * distance;
            let off = foot.norm();
            if off > self.radius {
                break;
            }
            found = Some((distance, normal));
            if off < CENTRED * self.radius {
                break;
            }
            about += foot;
        }
        found.map_or(Node::NONE, |(distance, normal)| Node::new(distance, &normal))
    }
}
