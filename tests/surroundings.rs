//! Scans with their surroundings, surfaces of several parts, pixels without depth, and faces that turn inwards.

use crate::common::{osteoflow, shared_folder};
use osteoflow_algorithms::sample;
use osteoflow_formats::{
    mesh_or_cloud::{read_cloud, read_mesh},
    write::{write_ply, write_stl},
};
use osteoflow_geometry::{
    Anatomy, Cloud, Mesh, SurfaceOrigin, isometry_from_matrix,
    nalgebra::{Isometry3, Matrix4, Point3, Vector3},
};
use osteoflow_node::rand::RngExt;
use osteoflow_simulation::{BoneParams, bone};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use serde_json::Value;
use std::{fs, sync::LazyLock};

/// Half the width of the scan's uniform noise, mm.
const NOISE_MM: f64 = 0.1;

/// A bone, another beside it, and a scan of the first.
struct Case {
    dir: tempfile::TempDir,
    bone: Mesh,
    other: Mesh,
    anatomy: Anatomy,
    scan: Vec<Point3<f64>>,
}

static CASE: LazyLock<Case> = LazyLock::new(|| {
    let dir = tempfile::tempdir_in(shared_folder()).unwrap();
    let params = BoneParams { edge_mm: 2.0, ..BoneParams::default() };
    let (bone, anatomy) = (bone::fibula(&params), bone::anatomy(&params));
    // Thicker and shorter, as a tibia beside a fibula.
    let beside = bone::fibula(&BoneParams { shape_seed: 5, ..params });
    let (low, high) = bounds(&bone);
    let place = |v: &Point3<f64>| {
        let from_low = v - low;
        low + Vector3::new(2.2 * from_low.x, 2.2 * from_low.y, 0.9 * from_low.z)
            + Vector3::x() * (high.x - low.x + 25.0)
    };
    let places: Vec<_> = beside.vertices().iter().map(place).collect();
    let other = Mesh::new("ct", SurfaceOrigin::User, places, beside.faces().to_vec()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let seen = sample::surface(&bone, 40_000, &mut rng);
    let side = seen.points.iter().zip(&seen.normals).filter(|(p, n)| {
        let height_mm = (**p - anatomy.malleolus_tip).dot(&anatomy.proximal);
        (0.0..150.0).contains(&height_mm) && n.dot(&anatomy.lateral) > 0.2
    });
    let noisy = side.map(|(p, n)| p + n.scale(NOISE_MM * (2.0 * rng.random::<f64>() - 1.0)));
    let scan: Vec<Point3<f64>> = noisy.map(|p| t_target_source().inverse() * p).collect();
    let case = Case { dir, bone, other, anatomy, scan };
    write_stl(&case.path("bone.stl"), &case.bone).unwrap();
    write_stl(&case.path("two.stl"), &joined(&[case.bone.clone(), case.other.clone()])).unwrap();
    case.write("scan.ply", &case.scan);
    case
});

fn t_target_source() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(120.0, -340.0, 900.0), Vector3::new(0.4, -1.1, 2.0))
}

fn bounds(mesh: &Mesh) -> (Point3<f64>, Point3<f64>) {
    let first = mesh.vertices()[0];
    mesh.vertices().iter().fold((first, first), |(low, high), v| (low.inf(v), high.sup(v)))
}

fn joined(meshes: &[Mesh]) -> Mesh {
    let (mut vertices, mut faces) = (Vec::new(), Vec::new());
    for mesh in meshes {
        let first = vertices.len() as u32;
        vertices.extend_from_slice(mesh.vertices());
        faces.extend(mesh.faces().iter().map(|face| face.map(|v| v + first)));
    }
    Mesh::new("ct", SurfaceOrigin::User, vertices, faces).unwrap()
}

/// What `register` said.
struct Said {
    code: Option<i32>,
    answer: Value,
    err: String,
}

impl Said {
    fn verdict(&self) -> &str {
        self.answer["verdict"]["answer"].as_str().unwrap_or_default()
    }

    fn notes(&self) -> String {
        self.answer["notes"].to_string()
    }

    /// Largest distance of the scan of the bone from where it belongs, mm; `None` without a pose.
    fn off_mm(&self) -> Option<f64> {
        let numbers: Vec<f64> = self.answer["T"].as_array()?.iter().map(|c| c.as_f64().unwrap()).collect();
        let found = isometry_from_matrix(&Matrix4::from_row_slice(&numbers)).unwrap();
        Some(CASE.scan.iter().map(|p| (found * p - t_target_source() * p).norm()).fold(0.0, f64::max))
    }

    /// Right, or no pose that is trusted; and what is in doubt names the options that crop.
    fn is_right_or_names_the_crops(&self, name: &str) {
        if self.off_mm().is_some_and(|mm| mm < 1.0) {
            return;
        }
        assert_ne!(self.verdict(), "trusted", "{name}: {:?} mm off, {}", self.off_mm(), self.answer["verdict"]);
        let all = format!("{}{}", self.answer, self.err);
        assert!(all.contains("--box") && all.contains("--region"), "{name}: {all}");
    }
}

impl Case {
    fn path(&self, name: &str) -> std::path::PathBuf {
        self.dir.path().join(name)
    }

    fn write(&self, name: &str, points: &[Point3<f64>]) {
        write_ply(&self.path(name), &Cloud::new("camera", points.to_vec()).unwrap(), 1.0).unwrap();
    }

    fn command(&self, arguments: &str) -> (Option<i32>, String, String) {
        let mut command = osteoflow();
        command.current_dir(self.dir.path()).env("OSTEOFLOW_CACHE", self.path("store"));
        let output = command.args(arguments.split(' ')).output().unwrap();
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        (output.status.code(), text(&output.stdout), text(&output.stderr))
    }

    fn register(&self, arguments: &str) -> Said {
        let (code, out, err) = self.command(&format!("register {arguments} --format json"));
        let answer = out.lines().last().and_then(|line| serde_json::from_str(line).ok()).unwrap_or_default();
        Said { code, answer, err }
    }

    /// The scan with points around it, given in the frame of the bone.
    fn with(&self, more: impl IntoIterator<Item = Point3<f64>>) -> Vec<Point3<f64>> {
        self.scan.iter().copied().chain(more.into_iter().map(|p| t_target_source().inverse() * p)).collect()
    }

    /// `share` of all points, from `point` of three numbers below 1.
    fn drawn(&self, share: f64, point: impl Fn([f64; 3]) -> Point3<f64>) -> Vec<Point3<f64>> {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let n = (share / (1.0 - share) * self.scan.len() as f64) as usize;
        (0..n).map(|_| point([(); 3].map(|()| rng.random()))).collect()
    }
}

/// A box around the scan of the bone alone, as an option.
fn box_around_the_scan() -> String {
    let first = CASE.scan[0];
    let (low, high) = CASE.scan.iter().fold((first, first), |(low, high), p| (low.inf(p), high.sup(p)));
    let corners = [low.x - 1.0, low.y - 1.0, low.z - 1.0, high.x + 1.0, high.y + 1.0, high.z + 1.0];
    format!("--box={}", corners.map(|c| format!("{c:.3}")).join(","))
}

#[test]
fn a_scan_with_surroundings_is_found_or_refused_with_the_options_that_crop_it() {
    let (case, anatomy) = (&*CASE, &CASE.anatomy);
    let across = anatomy.proximal.cross(&anatomy.lateral).normalize();
    let at = |u: f64, v: f64, w: f64| {
        anatomy.malleolus_tip + anatomy.proximal.scale(u) + across * v + anatomy.lateral.scale(w)
    };
    let second = sample::surface(&case.other, 60_000, &mut ChaCha8Rng::seed_from_u64(3)).points;
    let bones = case.drawn(0.6, |[u, ..]| second[(u * second.len() as f64) as usize]);
    let skin = |share| case.drawn(share, |[u, v, w]| at(-20.0 + 190.0 * u, 60.0 * (v - 0.5), -9.0 + 0.2 * w + 4.0 * v));
    let table = case.drawn(0.5, |[u, v, w]| at(-60.0 + 280.0 * u, 260.0 * (v - 0.5), -60.0 + 0.2 * w));
    for (name, more) in [("skin.ply", skin(0.3)), ("table.ply", table), ("second.ply", bones)] {
        case.write(name, &case.with(more));
        case.register(&format!("bone.stl {name}")).is_right_or_names_the_crops(name);
    }
}

#[test]
fn the_scan_is_cropped_by_boxes_balls_and_regions_and_the_moved_scan_says_what_belongs_to_the_bone() {
    let (case, n) = (&*CASE, CASE.scan.len());
    let anatomy = &case.anatomy;
    let sheet = case.drawn(0.6, |[u, v, w]| {
        anatomy.malleolus_tip + anatomy.proximal.scale(300.0 * u) - anatomy.lateral.scale(150.0 + w)
            + anatomy.proximal.cross(&anatomy.lateral).scale(300.0 * v)
    });
    let all = case.with(sheet);
    case.write("around.ply", &all);
    let the_box = box_around_the_scan();
    let corners: Vec<f64> = the_box[6..].split(',').map(|c| c.parse().unwrap()).collect();
    let inside = |p: &Point3<f64>| (0..3).all(|k| (corners[k]..=corners[k + 3]).contains(&p[k]));
    let n_inside = all.iter().filter(|p| inside(p)).count();
    let grouped = |n: usize| format!("{},{:03}", n / 1000, n % 1000);
    let said = case.register(&format!("bone.stl around.ply {the_box} --write-source moved.csv"));
    assert_eq!((said.code, said.verdict()), (Some(0), "trusted"), "{}{}", said.answer["verdict"], said.err);
    assert!(said.off_mm().unwrap() < 0.5, "{:?} mm", said.off_mm());
    let note = format!("{} of {} points are in the box", grouped(n_inside), grouped(all.len()));
    assert!(said.notes().contains(&note), "{note}: {}", said.notes());
    let moved = read_cloud(&case.path("moved.csv"), 1.0, "ct").unwrap().cloud;
    let column = |name: &str| moved.extras().iter().find(|(column, _)| &**column == name).unwrap().1.to_vec();
    let (on_bone, residuals) = (column("on_bone"), column("residual_mm"));
    for (k, p) in all.iter().enumerate() {
        assert_eq!(on_bone[k] == 1.0, inside(p) && residuals[k].abs() <= 5.0, "point {k}, {} mm", residuals[k]);
    }
    assert!(on_bone[..n].iter().all(|on| *on == 1.0), "the scan of the bone is within 5 mm of it");
    assert!(on_bone.iter().filter(|on| **on == 1.0).count() <= n_inside);

    // Two regions: what is in both.
    let region = format!(
        r#"{{ "format": "osteoflow-region", "version": 1, "units": "mm", "frame": "camera", "keep": [ {{ "shape": "box",
            "min": [{}, {}, {}], "max": [{}, {}, {}] }} ] }}"#,
        corners[0], corners[1], corners[2], corners[3], corners[4], corners[5]
    );
    fs::write(case.path("region.json"), region).unwrap();
    let middle = Point3::new(corners[0] + corners[3], corners[1] + corners[4], corners[2] + corners[5]) / 2.0;
    let near = all.iter().filter(|p| inside(p) && (*p - middle).norm() <= 70.0).count();
    let both = format!("--region region.json --sphere={},{},{},70", middle.x, middle.y, middle.z);
    let said = case.register(&format!("bone.stl around.ply --init identity --no-verdict {both} --source-unit-mm 1"));
    let notes = said.notes();
    assert!(notes.contains("points are in the region") && notes.contains("are in the sphere"), "{notes}{}", said.err);
    assert!(notes.contains(&format!("{} of {} points are in the sphere", grouped(near), grouped(n_inside))), "{notes}");
}

#[test]
fn wrong_regions_and_parts_are_refused_with_the_option_what_was_given_and_an_example() {
    let case = &*CASE;
    for (option, value, expected) in [
        ("--box", "1,2,3", "such as -60,-40,150,60,40,250"),
        ("--box", "0,0,0,10,0,10", "have a coordinate in common"),
        ("--sphere", "0,0,200", "such as 0,0,200,80"),
        ("--sphere", "0,0,200,-1", "the radius is -1 mm"),
        ("--component", "smallest", "such as nearest:10,0,-250"),
        ("--source-component", "nearest:1,2", "such as nearest:10,0,-250"),
    ] {
        let (code, _, err) = case.command(&format!("register bone.stl scan.ply {option}={value}"));
        assert_eq!(code, Some(2), "{err}");
        assert!(err.contains(option) && err.contains(value) && err.contains(expected), "{option} {value}: {err}");
    }
    let (code, _, err) = case.command("register bone.stl scan.ply --box 900,900,900,910,910,910");
    assert_eq!(code, Some(3), "{err}");
    assert!(err.contains("points lies in the region of interest; is it given in mm, in camera?"), "{err}");
    let (code, _, err) = case.command("register bone.stl scan.ply --region none.json");
    assert_eq!(code, Some(1), "{err}");
    let (code, _, err) = case.command("register two.stl scan.ply --component 3");
    assert_eq!(code, Some(3), "{err}");
    assert!(err.contains("part 3 was asked for, but the surface has 2 (1: "), "{err}");
}

#[test]
fn one_of_several_parts_is_listed_chosen_and_converted_and_equal_ones_are_told() {
    let case = &*CASE;
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let (low, high) = bounds(&case.bone);
    // Specks all around, as a threshold leaves them.
    let speck = |rng: &mut ChaCha8Rng| {
        let at = Point3::from(std::array::from_fn::<f64, 3, _>(|k| {
            low[k] - 40.0 + (high[k] - low[k] + 80.0) * rng.random::<f64>()
        }));
        let corners = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|c| at + Vector3::from(c));
        Mesh::new("ct", SurfaceOrigin::User, corners.to_vec(), vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
            .unwrap()
    };
    let specks: Vec<Mesh> = (0..300).map(|_| speck(&mut rng)).collect();
    let whole = joined(&[&[case.bone.clone(), case.other.clone()], &specks[..]].concat());
    write_stl(&case.path("specks.stl"), &whole).unwrap();

    let (code, out, err) = case.command("info specks.stl --format json");
    assert_eq!(code, Some(0), "{err}");
    let info: Value = serde_json::from_str(&out).unwrap();
    assert_eq!((info["n_parts"].as_u64(), info["parts"].as_array().unwrap().len()), (Some(302), 20), "{out}");
    assert_eq!(info["parts"][0]["n_faces"].as_u64(), Some(case.other.faces().len() as u64));
    let (_, text, _) = case.command("info specks.stl");
    assert!(text.contains("302, the 20 largest of which are listed") && text.contains("2: "), "{text}");

    // By shape alone onto all of it, and onto the part that was scanned.
    case.register("two.stl scan.ply").is_right_or_names_the_crops("two.stl");
    case.register("specks.stl scan.ply").is_right_or_names_the_crops("specks.stl");
    let centre = (low.coords + high.coords) / 2.0;
    let nearest = format!("nearest:{:.1},{:.1},{:.1}", centre.x, centre.y, centre.z);
    let said = case.register("specks.stl scan.ply --component 2");
    assert_eq!((said.code, said.verdict()), (Some(0), "trusted"), "{}{}", said.answer["verdict"], said.err);
    assert!(said.off_mm().unwrap() < 0.5 && said.notes().contains("part 2 of 302 was taken"), "{}", said.notes());

    let (code, out, err) = case.command(&format!("convert two.stl part.stl --component {nearest}"));
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains(&format!("{} faces", case.bone.faces().len())), "{out}{err}");
    let run = case.command("register bone.stl two.stl --source-component 2 --init identity --no-verdict --format json");
    assert!(run.1.contains("part 2 of 2 was taken"), "{run:?}");

    let shifted: Vec<_> = case.bone.vertices().iter().map(|v| v + Vector3::x() * 150.0).collect();
    let twin = Mesh::new("ct", SurfaceOrigin::User, shifted, case.bone.faces().to_vec()).unwrap();
    write_stl(&case.path("legs.stl"), &joined(&[case.bone.clone(), twin])).unwrap();
    let said = case.register("legs.stl scan.ply");
    assert!(said.notes().contains("2 parts of about the same size"), "{}", said.notes());
    assert!(said.notes().contains("--component"), "{}", said.notes());
    assert_ne!(said.verdict(), "trusted", "it fits both bones alike");
}

#[test]
fn pixels_without_depth_are_left_out_and_counted() {
    let case = &*CASE;
    let mut points = case.scan.clone();
    (0..3000).for_each(|k| points.insert(2 * k % points.len(), Point3::origin()));
    case.write("zeros.ply", &points);
    let (plain, zeros) = (case.register("bone.stl scan.ply"), case.register("bone.stl zeros.ply"));
    assert_eq!(zeros.answer["T"], plain.answer["T"], "{}", zeros.err);
    let note = format!("3000 of {} points are pixels without depth", points.len());
    assert!(zeros.notes().contains(&note), "{}", zeros.notes());
    let (_, out, err) = case.command("convert zeros.ply zeros.csv");
    assert!(out.contains(&format!("{} points", case.scan.len())) && err.contains(&note), "{out}{err}");
}

#[test]
fn a_closed_surface_that_is_inside_out_is_turned_and_distances_keep_their_sign() {
    let case = &*CASE;
    let turned: Vec<_> = case.bone.faces().iter().map(|&[a, b, c]| [a, c, b]).collect();
    let turned = Mesh::new("ct", SurfaceOrigin::User, case.bone.vertices().to_vec(), turned).unwrap();
    write_stl(&case.path("inside_out.stl"), &turned).unwrap();
    let some = |(k, &[a, b, c]): (usize, &[u32; 3])| if k % 5 == 0 { [a, c, b] } else { [a, b, c] };
    let flipped: Vec<_> = case.bone.faces().iter().enumerate().map(some).collect();
    let n_flipped = flipped.len().div_ceil(5);
    let flipped = Mesh::new("ct", SurfaceOrigin::User, case.bone.vertices().to_vec(), flipped).unwrap();
    write_stl(&case.path("flipped.stl"), &flipped).unwrap();

    let said = case.register("inside_out.stl scan.ply --write-source a.csv");
    assert_eq!(case.register("bone.stl scan.ply --write-source b.csv").answer["T"], said.answer["T"], "{}", said.err);
    assert!(said.notes().contains("inside out, by their signed volume, and were turned outwards"), "{}", said.notes());
    assert_eq!(fs::read_to_string(case.path("a.csv")).unwrap(), fs::read_to_string(case.path("b.csv")).unwrap());
    let (code, _, err) = case.command("convert inside_out.stl outwards.stl");
    assert_eq!(code, Some(0), "{err}");
    assert!(read_mesh(&case.path("outwards.stl"), 1.0, "ct", SurfaceOrigin::User).unwrap().mesh.volume_mm3() > 0.0);
    let (_, text, _) = case.command("info flipped.stl");
    assert!(text.contains(&format!("{n_flipped} of {} faces turn the other way", case.bone.faces().len())), "{text}");
}
