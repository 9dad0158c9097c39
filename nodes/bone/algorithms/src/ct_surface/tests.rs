use super::*;
use crate::mesh_topology::open_edges;
use nalgebra::{Rotation3, Vector4};
use rand::{RngExt, SeedableRng};

/// Voxels of a grid, and the map that places them.
struct Sampled {
    size: [usize; 3],
    voxels: Vec<f32>,
    t_lps_voxel: Matrix4<f64>,
}

impl Sampled {
    fn new(size: [usize; 3], t_lps_voxel: Matrix4<f64>, f: impl Fn(Point3<f64>) -> f64) -> Self {
        let at = |k: usize| {
            let [x, y, z] = [k % size[0], k / size[0] % size[1], k / size[0] / size[1]].map(|c| c as f64);
            Point3::from((t_lps_voxel * Vector4::new(x, y, z, 1.0)).xyz())
        };
        Self { size, voxels: (0..size.iter().product()).map(|k| f(at(k)) as f32).collect(), t_lps_voxel }
    }

    fn view(&self) -> VolumeView<'_> {
        VolumeView { size: self.size, voxels: &self.voxels, t_lps_voxel: &self.t_lps_voxel }
    }

    fn surface(&self, params: &CtSurfaceParams) -> CtSurface {
        ct_surface(&self.view(), params).unwrap()
    }
}

/// 1000 inside, 0 outside, 500 at distance 0, linear over 2 mm.
fn edge(distance_mm: f64) -> f64 {
    (500.0 - 500.0 * distance_mm / 1.0).clamp(0.0, 1000.0)
}

fn grid(spacing: [f64; 3], first: [f64; 3], turn: Vector3<f64>, mirrored: bool) -> Matrix4<f64> {
    let mut axes = *Rotation3::new(turn).matrix() * Matrix3::from_diagonal(&spacing.into());
    if mirrored {
        axes.column_mut(2).neg_mut();
    }
    let mut t = axes.to_homogeneous();
    t.fixed_view_mut::<3, 1>(0, 3).copy_from(&Vector3::from(first));
    t
}

/// The grid's map with its middle voxel at the origin of LPS.
fn centred(size: [usize; 3], t: Matrix4<f64>) -> Matrix4<f64> {
    let middle = size.map(|s| (s as f64 - 1.0) / 2.0);
    let off = t * Vector4::new(middle[0], middle[1], middle[2], 1.0);
    Matrix4::new_translation(&-off.xyz()) * t
}

/// The closed surface, lids included.
fn closed_mesh(surface: &CtSurface) -> Mesh {
    Mesh::new("ct", SurfaceOrigin::User, surface.vertices.clone(), surface.faces.clone()).unwrap()
}

#[test]
fn a_ball_is_within_a_tenth_of_a_voxel_in_any_grid_and_faces_outwards() {
    let size = [41, 47, 37];
    for mirrored in [false, true] {
        for spacing in [[0.5, 0.5, 0.5], [0.5, 0.45, 0.6], [0.45, 0.4, 1.0]] {
            let t = centred(size, grid(spacing, [0.0; 3], Vector3::new(0.3, -0.5, 0.8), mirrored));
            let surface = Sampled::new(size, t, |p| edge(p.coords.norm() - 6.0)).surface(&CtSurfaceParams::at(500.0));
            let mesh = closed_mesh(&surface);
            assert_eq!((open_edges(&mesh), surface.n_border_faces()), (0, 0));
            let expected = 4.0 / 3.0 * std::f64::consts::PI * 216.0;
            assert!((mesh.volume_mm3() / expected - 1.0).abs() < 0.02, "{} mm3 of {expected}", mesh.volume_mm3());
            let worst = mesh.vertices().iter().map(|v| (v.coords.norm() - 6.0).abs()).fold(0.0, f64::max);
            let limit = 0.1 * spacing.into_iter().fold(0.0, f64::max);
            assert!(worst < limit, "{worst} mm, voxels of {spacing:?}, mirrored {mirrored}");
            for face in 0..mesh.faces().len() {
                let middle: Vector3<f64> = mesh.corners(face).iter().map(|p| p.coords).sum();
                assert!(mesh.area_vector(face).dot(&middle) > 0.0, "face {face} turns inwards");
            }
            // 500 per mm: 0.1 mm per 50.
            assert!((surface.shift_mm_per_50 - 0.1).abs() < 0.003, "{}", surface.shift_mm_per_50);
            let centre = Vector3::from(surface.chosen.centre_mm);
            assert!(centre.norm() < 0.01 && !surface.chosen.is_cut_by_border, "{centre}");
            assert!((surface.chosen.volume_mm3 / expected - 1.0).abs() < 0.02);
        }
    }
}

/// A tube along z through both ends of the volume, radius 8 mm, canal of radius 4 mm.
fn tube(t: Matrix4<f64>, size: [usize; 3]) -> Sampled {
    Sampled::new(size, t, |p| {
        let r = p.coords.xy().norm();
        edge(r - 8.0).min(edge(4.0 - r))
    })
}

#[test]
fn a_bone_cut_by_the_border_is_closed_by_a_lid_that_is_marked_and_can_be_left_out() {
    let size = [45, 45, 30];
    for mirrored in [false, true] {
        let t = centred(size, grid([0.5, 0.5, 0.7], [0.0; 3], Vector3::zeros(), mirrored));
        let surface = tube(t, size).surface(&CtSurfaceParams::at(500.0));
        let closed = closed_mesh(&surface);
        assert_eq!((open_edges(&closed), surface.n_filled), (0, 1));
        // 30 layers of 0.7 mm: the lid is half a voxel beyond the last centre.
        let expected = std::f64::consts::PI * 64.0 * 21.0;
        assert!((closed.volume_mm3() / expected - 1.0).abs() < 0.02, "{} mm3 of {expected}", closed.volume_mm3());
        let open = surface.open_mesh("ct").unwrap();
        assert!(surface.n_border_faces() > 0 && surface.chosen.is_cut_by_border);
        let half = 14.5 * 0.7;
        for v in open.vertices() {
            assert!((v.coords.xy().norm() - 8.0).abs() < 0.05, "{v} is not on the wall");
            assert!(v.z.abs() <= half + 1e-9, "{v} is beyond the last voxels");
        }
        let top = open.vertices().iter().map(|v| v.z).fold(f64::MIN, f64::max);
        assert!(top > half - 0.71, "the wall ends at {top} mm, the voxels at {half} mm");
        assert!(open_edges(&open) > 0);
        for face in 0..open.faces().len() {
            let middle: Vector3<f64> = open.corners(face).iter().map(|p| p.coords).sum();
            let normal = open.area_vector(face);
            assert!(normal.xy().dot(&middle.xy()) > 0.0 && normal.z.abs() < 0.3 * normal.norm(), "face {face}");
        }
        let hollow = tube(t, size).surface(&CtSurfaceParams { fill_cavities: false, ..CtSurfaceParams::at(500.0) });
        let closed = closed_mesh(&hollow);
        assert_eq!((open_edges(&closed), hollow.n_filled), (0, 0));
        assert!((closed.volume_mm3() / (expected * 0.75) - 1.0).abs() < 0.02, "{} mm3", closed.volume_mm3());
    }
}

#[test]
fn components_are_listed_by_size_and_chosen_by_rank_or_seed() {
    let size = [60, 30, 30];
    let t = grid([0.5; 3], [100.0, -50.0, 7.0], Vector3::zeros(), false);
    let centres = [[105.5, -43.0, 14.0], [117.0, -43.0, 14.0], [125.5, -46.5, 10.5]].map(Point3::from);
    let radii = [4.0, 6.0, 2.5];
    let volume =
        Sampled::new(size, t, |p| edge((0..3).map(|k| (p - centres[k]).norm() - radii[k]).fold(f64::MAX, f64::min)));
    let surface = volume.surface(&CtSurfaceParams::at(500.0));
    assert_eq!((surface.n_components, surface.components.len()), (3, 3));
    for (component, k) in surface.components.iter().zip([1, 0, 2]) {
        let off = (Point3::from(component.centre_mm) - centres[k]).norm();
        assert!(off < 0.2, "{component:?} is {off} mm off");
        for axis in 0..3 {
            let extent = component.max_mm[axis] - component.min_mm[axis];
            assert!((extent - 2.0 * radii[k]).abs() < 1.01, "{component:?}");
        }
    }
    let near = |surface: &CtSurface, k: usize| {
        surface.vertices.iter().all(|v| ((v - centres[k]).norm() - radii[k]).abs() < 0.05)
    };
    assert!(near(&surface, 1) && surface.chosen.rank == 1);
    let choose = |component| volume.surface(&CtSurfaceParams { component, ..CtSurfaceParams::at(500.0) });
    assert!(near(&choose(ComponentChoice::Rank(2)), 0));
    let seeded = choose(ComponentChoice::Seed(centres[2]));
    assert!(near(&seeded, 2));
    assert_eq!(seeded.chosen.rank, 3);

    let refused = |component| {
        let params = CtSurfaceParams { component, ..CtSurfaceParams::at(500.0) };
        ct_surface(&volume.view(), &params).unwrap_err().to_string()
    };
    assert_eq!(
        refused(ComponentChoice::Rank(4)),
        "component 4 was asked for, but 3 are above the threshold; take 1 to 3"
    );
    let between = refused(ComponentChoice::Seed(Point3::new(101.0, -37.0, 20.0)));
    assert!(between.contains("is 0, not above the threshold 500"), "{between}");
    let outside = refused(ComponentChoice::Seed(Point3::new(0.0, -43.0, 14.0)));
    assert!(outside.contains("outside the volume, which spans x 100.0 to 129.5"), "{outside}");
    let nan = refused(ComponentChoice::Seed(Point3::new(f64::NAN, 0.0, 0.0)));
    assert!(nan.contains("outside the volume"), "{nan}");
}

#[test]
fn even_noise_gives_closed_surfaces_and_the_rest_of_the_volume_changes_nothing() {
    for seed in 0..20 {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let volume = Sampled {
            size: [14, 12, 13],
            voxels: (0..14 * 12 * 13).map(|_| rng.random()).collect(),
            t_lps_voxel: grid([0.5, 0.6, 0.7], [0.0; 3], Vector3::new(0.1, 0.2, 0.3), seed % 2 == 1),
        };
        for threshold in [0.3, 0.7, 0.9] {
            for fill_cavities in [false, true] {
                let params = CtSurfaceParams { fill_cavities, ..CtSurfaceParams::at(threshold) };
                let Ok(surface) = ct_surface(&volume.view(), &params) else { continue };
                let mesh = closed_mesh(&surface);
                assert_eq!(open_edges(&mesh), 0, "seed {seed}, threshold {threshold}");
                assert!(mesh.volume_mm3() > 0.0);
            }
        }
    }
}

#[test]
fn volumes_and_thresholds_without_a_surface_are_refused() {
    let t = Matrix4::identity();
    let refused = |size: [usize; 3], voxels: &[f32], t: &Matrix4<f64>, threshold: f64| {
        ct_surface(&VolumeView { size, voxels, t_lps_voxel: t }, &CtSurfaceParams::at(threshold)).unwrap_err()
    };
    let ramp: Vec<f32> = (0..27).map(|k| k as f32).collect();
    for (size, t, threshold, expected) in [
        ([3, 9, 1], t, 5.0, "the volume has 3 x 9 x 1 voxels"),
        ([3, 3, 4], t, 5.0, "27 voxels were given for 3 x 3 x 4"),
        ([3; 3], t, 26.0, "no voxel is above the threshold 26; the highest value is 26"),
        ([3; 3], t, -1.0, "all voxels are above the threshold -1; the lowest value is 0"),
        ([3; 3], Matrix4::zeros(), 5.0, "the matrix from voxels to millimetres is singular"),
        ([3; 3], Matrix4::repeat(f64::NAN), 5.0, "the matrix from voxels to millimetres is singular"),
        ([usize::MAX, usize::MAX, 2], t, 5.0, "27 voxels were given for"),
    ] {
        let error = refused(size, &ramp, &t, threshold).to_string();
        assert!(error.starts_with(expected), "{error}");
    }
}

#[test]
fn the_suggested_threshold_is_half_way_between_soft_tissue_and_bone() {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    // Air, fat and muscle, bone, a little metal.
    let voxels: Vec<f32> = (0..100_000)
        .map(|k| match k % 100 {
            0..40 => -1000.0,
            40..95 => 50.0 + 60.0 * (rng.random::<f32>() - 0.5),
            95..99 => 1250.0 + 300.0 * (rng.random::<f32>() - 0.5),
            _ => 9000.0,
        })
        .collect();
    let t = Matrix4::identity();
    let view = VolumeView { size: [100, 100, 10], voxels: &voxels, t_lps_voxel: &t };
    let suggestion = suggested_threshold(&view, true).unwrap();
    assert!((suggestion - 650.0).abs() < 10.0, "{suggestion} HU");
    let soft: Vec<f32> = voxels.iter().map(|v| v.min(80.0)).collect();
    assert_eq!(suggested_threshold(&VolumeView { voxels: &soft, ..view }, true), None, "there is no bone");
    let other: Vec<f32> = (0..100_000).map(|k| if k % 4 == 0 { 40.0 } else { 8.0 }).collect();
    let suggestion = suggested_threshold(&VolumeView { voxels: &other, ..view }, false).unwrap();
    assert!((suggestion - 24.0).abs() < 0.1, "{suggestion}");
}

/// With `SLOW_TESTS` of thirty million voxels: prints the time, about a second in release.
#[test]
fn the_two_bones_of_a_leg_are_two_components_and_the_marrow_of_one_is_filled() {
    let coarse = if std::env::var_os("SLOW_TESTS").is_some() { 1 } else { 2 };
    let size = [320, 320, 300].map(|n| n / coarse);
    let t = centred(size, grid([0.7, 0.7, 1.0].map(|mm| mm * coarse as f64), [0.0; 3], Vector3::zeros(), false));
    let shell = |p: Point3<f64>, x: f64, radius: f64| {
        let r = (p.x - x).hypot(p.y);
        edge(r - radius).min(edge(radius - 5.0 - r))
    };
    let volume = Sampled::new(size, t, |p| {
        let noise = ((p.x * 91.7).sin() + (p.y * 57.3).sin() + (p.z * 33.1).sin()) * 20.0;
        shell(p, 0.0, 70.0).max(shell(p, 90.0, 12.0)) + noise
    });
    let start = std::time::Instant::now();
    let surface = volume.surface(&CtSurfaceParams::at(500.0));
    let seconds = start.elapsed().as_secs_f64();
    println!("{} voxels, {} vertices: {seconds:.2} s", volume.voxels.len(), surface.vertices.len());
    assert_eq!((surface.n_components, surface.n_filled), (2, 1));
}
