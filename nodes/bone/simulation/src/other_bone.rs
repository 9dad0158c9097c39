//! Another bone made of a bone: a smooth deformation, the mirror image, and what a CT has different from the bone.

use crate::distortion::Distortion;
use crate::draws::{Term, stream};
use crate::waves::Waves;
use crate::{BoneParams, SimulationError};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Unit, UnitQuaternion, Vector3};
use osteoflow_geometry::{Anatomy, Axes, Mesh, NamedPoint, Plane, PlanePlace, Planes, Points, SurgicalPlan};

/// Range of the wavelengths of the deformation, mm: shorter than a bone, longer than its ridges.
const WARP_WAVELENGTHS_MM: [f64; 2] = [40.0, 120.0];

/// A map of a bone's points and directions: deformed first, then mirrored, then distorted.
#[derive(Default)]
pub(crate) struct OtherBone {
    warp: Option<Warp>,
    mirror: Option<Mirror>,
    distortion: Option<Distortion>,
}

struct Warp {
    axes: [Waves; 3],
    scale_mm: f64,
}

impl Warp {
    fn new(params: &BoneParams, bone: &Mesh) -> Self {
        let axis = |k| Waves::between(&mut stream(params.warp_seed, Term::BoneWarp, k), WARP_WAVELENGTHS_MM);
        let mut warp = Self { axes: [axis(0), axis(1), axis(2)], scale_mm: 1.0 };
        let squares: f64 = bone.vertices().iter().map(|v| warp.at(v).norm_squared()).sum();
        warp.scale_mm = params.warp_mm / (squares / bone.vertices().len() as f64).sqrt();
        warp
    }

    /// The displacement of a point of the bone, mm.
    fn at(&self, point: &Point3<f64>) -> Vector3<f64> {
        let [x, y, z] = self.axes.each_ref().map(|waves| waves.scaled(self.scale_mm, point));
        Vector3::new(x, y, z)
    }
}

/// The reflection in the plane through the middle of the bone, perpendicular to its lateral direction.
struct Mirror {
    on_plane: Point3<f64>,
    normal: Unit<Vector3<f64>>,
}

impl Mirror {
    fn new(bone: &Mesh, lateral: &Unit<Vector3<f64>>) -> Self {
        let first = bone.vertices()[0];
        let aside = bone.vertices().iter().map(|v| (v - first).dot(lateral));
        let (low, high) = aside.fold((0.0f64, 0.0f64), |(low, high), a| (low.min(a), high.max(a)));
        Self { on_plane: first + lateral.into_inner() * ((low + high) / 2.0), normal: *lateral }
    }

    fn direction(&self, v: &Vector3<f64>) -> Vector3<f64> {
        v - *self.normal * (2.0 * v.dot(&self.normal))
    }
}

impl OtherBone {
    /// The map for `bone`; `None` if it is the bone itself.
    pub(crate) fn new(params: &BoneParams, bone: &Mesh, anatomy: &Anatomy) -> Option<Self> {
        let warp = (params.warp_mm > 0.0).then(|| Warp::new(params, bone));
        let mirror = params.mirrored.then(|| Mirror::new(bone, &anatomy.lateral));
        (warp.is_some() || mirror.is_some()).then_some(Self { warp, mirror, distortion: None })
    }

    /// The map onto the CT of a bone whose plan is made; `None` if the CT shows the bone as it is.
    pub(crate) fn in_ct(
        params: &BoneParams,
        bone: &Mesh,
        plan: &SurgicalPlan,
    ) -> Result<Option<Self>, SimulationError> {
        let distortion = Distortion::new(params, bone, plan)?;
        Ok(distortion.map(|distortion| Self { distortion: Some(distortion), ..Self::default() }))
    }

    fn point(&self, point: &Point3<f64>) -> Point3<f64> {
        let deformed = self.warp.as_ref().map_or(*point, |warp| point + warp.at(point));
        let mirrored = match &self.mirror {
            Some(mirror) => mirror.on_plane + mirror.direction(&(deformed - mirror.on_plane)),
            None => deformed,
        };
        self.distortion.as_ref().map_or(mirrored, |distortion| distortion.point(&mirrored))
    }

    /// A direction at a point. The deformation turns none.
    fn direction(&self, at: &Point3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
        let mirrored = self.mirror.as_ref().map_or(*v, |mirror| mirror.direction(v));
        self.distortion.as_ref().map_or(mirrored, |distortion| distortion.direction(at, &mirrored))
    }

    /// Axes or the frame of a plane at a point: the plane of x and y and the direction of y are mapped.
    fn columns(&self, at: &Point3<f64>, columns: &Matrix3<f64>) -> Matrix3<f64> {
        let [x, y, z] = [0, 1, 2].map(|k| self.direction(at, &columns.column(k).into_owned()));
        let (y, z) = if self.distortion.is_some() { (y.normalize(), x.cross(&y).normalize()) } else { (y, z) };
        Matrix3::from_columns(&[y.cross(&z), y, z])
    }

    /// The surface, its faces flipped if it is mirrored, so that normals stay outward.
    pub(crate) fn mesh(&self, bone: &Mesh) -> Result<Mesh, SimulationError> {
        let vertices: Vec<Point3<f64>> = bone.vertices().iter().map(|v| self.point(v)).collect();
        let flip = |&[a, b, c]: &[u32; 3]| if self.mirror.is_some() { [a, c, b] } else { [a, b, c] };
        let faces: Vec<[u32; 3]> = bone.faces().iter().map(flip).collect();
        Ok(Mesh::new(&bone.frame, bone.origin, vertices, faces)?)
    }

    pub(crate) fn anatomy(&self, anatomy: &Anatomy) -> Anatomy {
        let direction = |v: &Unit<Vector3<f64>>| Unit::new_normalize(self.direction(&anatomy.malleolus_tip, v));
        Anatomy {
            malleolus_tip: self.point(&anatomy.malleolus_tip),
            proximal: direction(&anatomy.proximal),
            lateral: direction(&anatomy.lateral),
            posterior: direction(&anatomy.posterior),
        }
    }

    /// The plan with its points, planes, axes and anatomy; marker poses stay.
    pub(crate) fn plan(&self, plan: &SurgicalPlan) -> SurgicalPlan {
        SurgicalPlan {
            landmarks: self.points(&plan.landmarks),
            assessment: self.points(&plan.assessment),
            planes: self.planes(&plan.planes),
            axes: plan.axes.as_ref().map(|axes| Axes {
                centre: self.point(&axes.centre),
                columns: self.columns(&axes.centre, &axes.columns),
                ..axes.clone()
            }),
            anatomy: plan.anatomy.as_ref().map(|anatomy| self.anatomy(anatomy)),
            ..plan.clone()
        }
    }

    fn points(&self, points: &Points) -> Points {
        let map = |p: &NamedPoint| NamedPoint { position: self.point(&p.position), ..p.clone() };
        Points { points: points.points.iter().map(map).collect(), ..points.clone() }
    }

    fn planes(&self, planes: &Planes) -> Planes {
        let map = |plane: &Plane| match &plane.place {
            PlanePlace::Known(t) => {
                let origin = t.translation.vector.into();
                let columns = self.columns(&origin, t.rotation.to_rotation_matrix().matrix());
                let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(columns));
                let middle = self.point(&origin);
                Plane::new(plane.name.clone(), Isometry3::from_parts(middle.into(), rotation))
            }
            PlanePlace::Unknown(_) => plane.clone(),
        };
        Planes { planes: planes.planes.iter().map(map).collect(), ..planes.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Subject, assert_closed_and_outward, bone};
    use osteoflow_algorithms::mesh_query::MeshQuery;

    fn subject(change: fn(&mut BoneParams)) -> Subject {
        let mut params = BoneParams::default();
        change(&mut params);
        Subject::built_in(&params).unwrap()
    }

    /// The built-in bone as a user's own, with its whole plan or its anatomy alone, altered.
    fn own(whole_plan: bool, change: fn(&mut BoneParams)) -> Subject {
        let (plain, mut params) = (subject(|_| ()), BoneParams::default());
        change(&mut params);
        let plan = if whole_plan {
            plain.plan.clone()
        } else {
            let none = Points::new("ct", Vec::new());
            SurgicalPlan {
                landmarks: none.clone(),
                assessment: none,
                planes: Planes::new("ct", Vec::new()),
                axes: None,
                ..plain.plan.clone()
            }
        };
        Subject::altered(plain.bone().clone(), plan, &params).unwrap()
    }

    fn all_points(plan: &SurgicalPlan) -> Vec<Point3<f64>> {
        [plan.landmarks.positions(), plan.assessment.positions()].concat()
    }

    #[test]
    fn a_mirrored_bone_is_the_other_side_closed_in_the_same_place_with_marks_on_the_same_faces() {
        let (right, left) = (subject(|_| ()), subject(|p| p.mirrored = true));
        let volume = assert_closed_and_outward(left.bone());
        assert!((volume - right.bone().volume_mm3()).abs() < 1e-3, "{volume} mm3");
        let [one, other] = [&right, &left].map(|s| s.plan.anatomy.clone().unwrap());
        let side = |a: &Anatomy| a.lateral.dot(&a.posterior.cross(&a.proximal));
        assert!(side(&one) * side(&other) < -0.9, "{} and {}", side(&one), side(&other));
        assert!((one.lateral.into_inner() + *other.lateral).norm() < 1e-12);
        let middle = |s: &Subject| {
            let vertices = s.bone().vertices();
            vertices.iter().fold(Vector3::zeros(), |sum, v| sum + v.coords) / vertices.len() as f64
        };
        assert!((middle(&right) - middle(&left)).norm() < 10.0, "the bone stays in its place");
        // The same place by the anatomy: height, and distances lateral and posterior of the tip.
        let places = |s: &Subject, a: &Anatomy| -> Vec<Vector3<f64>> {
            let of = |p: &Point3<f64>| {
                let off = p - a.malleolus_tip;
                Vector3::new(off.dot(&a.proximal), off.dot(&a.lateral), off.dot(&a.posterior))
            };
            all_points(&s.plan).iter().map(of).collect()
        };
        for (a, b) in places(&right, &one).iter().zip(places(&left, &other)) {
            assert!((a - b).norm() < 1e-6, "{a} on the right, {b} on the left");
        }
        for (a, b) in right.plan.planes.planes.iter().zip(left.plan.planes.planes.iter()) {
            let tilt = |p: &Plane, a: &Anatomy| p.normal().unwrap().dot(&a.lateral);
            assert!((tilt(a, &one) - tilt(b, &other)).abs() < 1e-9, "the cuts are tilted alike");
        }
    }

    #[test]
    fn a_bone_of_ones_own_is_mirrored_and_deformed_as_the_built_in_one_with_its_plan_or_its_anatomy_alone() {
        let change = |p: &mut BoneParams| (p.mirrored, p.warp_mm) = (true, 0.8);
        let (built_in, whole, alone) = (subject(change), own(true, change), own(false, change));
        assert_eq!(built_in.bone(), alone.bone());
        assert_eq!(built_in.bone(), whole.bone());
        assert_eq!(built_in.plan, alone.plan);
        // A planned point moves with the bone; a recipe is followed anew on the deformed bone.
        for (a, b) in all_points(&whole.plan).iter().zip(all_points(&alone.plan)) {
            assert!((a - b).norm() < 2.5, "{a} and {b}");
            let off = whole.surface.closest_point(a).unwrap().distance_mm;
            assert!(off < 0.01, "a planned point is {off} mm off the deformed bone");
        }
        let mirrored = |p: &mut BoneParams| p.mirrored = true;
        let (built_in, whole) = (subject(mirrored), own(true, mirrored));
        for (a, b) in all_points(&whole.plan).iter().zip(all_points(&built_in.plan)) {
            assert!((a - b).norm() < 1e-6, "{a} and {b}");
        }
        for (a, b) in whole.plan.planes.planes.iter().zip(built_in.plan.planes.planes.iter()) {
            let off = a.isometry().unwrap().inverse() * b.isometry().unwrap();
            assert!(off.translation.vector.norm() < 1e-6 && off.rotation.angle() < 1e-6, "{off}");
        }
        let columns = whole.plan.axes.as_ref().unwrap().columns;
        assert!((columns.determinant() - 1.0).abs() < 1e-9, "axes are right-handed");
    }

    #[test]
    fn a_deformed_bone_is_displaced_smoothly_by_its_rms_and_is_the_same_for_one_seed() {
        let plain = bone::fibula(&BoneParams::default());
        let warped = |warp_seed| {
            Subject::built_in(&BoneParams { warp_mm: 0.8, warp_seed, ..BoneParams::default() }).unwrap().bone().clone()
        };
        let bone = warped(1);
        assert_closed_and_outward(&bone);
        let moved: Vec<Vector3<f64>> = bone.vertices().iter().zip(plain.vertices()).map(|(a, b)| a - b).collect();
        let rms = (moved.iter().map(Vector3::norm_squared).sum::<f64>() / moved.len() as f64).sqrt();
        assert!((rms - 0.8).abs() < 1e-9, "{rms} mm");
        // Waves of 40 mm and more: neighbours 1 mm apart move alike.
        let worst = bone.faces().iter().map(|f| (moved[f[0] as usize] - moved[f[1] as usize]).norm());
        let worst = worst.fold(0.0, f64::max);
        assert!(worst < 0.35, "neighbours move apart by {worst} mm");
        assert_eq!(bone, warped(1));
        assert_ne!(bone, warped(2));
        let surface = MeshQuery::new(&plain);
        let off = bone.vertices().iter().map(|v| surface.closest_point(v).unwrap().distance_mm.powi(2));
        let off = (off.sum::<f64>() / moved.len() as f64).sqrt();
        println!("0.8 mm RMS of displacement are {off:.2} mm RMS off the bone's surface");
        assert!((0.4..0.6).contains(&off), "{off} mm off the surface");
    }
}
