//! The ways in which the world may depart from a rigid copy of the CT: each a few displacements, with a prior, and what shows it.

use super::NuisanceParams;
use super::axes::Axes;
use nalgebra::{Point3, Vector3};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

/// A displacement that carries points of the scan, where the bone is, to where the CT shows them; for a parameter of 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Mode {
    /// `to` for each mm along `of`: a stretch, a shear.
    Strain { of: Vector3<f64>, to: Vector3<f64> },
    /// Away from the centroid, in proportion to the distance.
    Growth,
    /// Towards a direction by 1 mm at both ends of the scan against its middle, with the turn of the sections that goes with it.
    Bend(Vector3<f64>),
    /// A turn about the axis by 1 rad at one end and -1 rad at the other.
    Twist,
    /// Along the surface's outward normal, 1 mm: up to two `half_waves` along the scan times up to two waves `around` the bone, a cosine from the
    /// camera on or a sine.
    Surface { half_waves: usize, around: usize, is_sine: bool },
    /// A film on the side that faces the camera, 1 mm where the surface faces it; from none at one end to 1 mm at the other for a
    /// ramp of 1 or -1, as thick everywhere for 0.
    Film { ramp: f64 },
    /// A film from none on one side of the bone to 1 mm on the other.
    FilmAround,
    /// Beyond a place along the axis, 1 mm towards a direction.
    Step { beyond_mm: f64, to: Vector3<f64> },
    /// Beyond an end of the scan, a turn about it by 1 rad.
    TurnBeyond { end_mm: f64, about: Vector3<f64> },
    /// Away from the camera, in proportion to the distance.
    Scale(Point3<f64>),
    /// Along the camera's view: of the depth, and of its square along `across`, as multiples.
    Depth { camera: Point3<f64>, scale: f64, plane: Vector3<f64>, bend: Vector3<f64> },
    /// The plan alone, or the bone against its marker, towards a direction.
    Shift(Vector3<f64>),
}

/// A place on the bone, for every mode.
pub(super) struct Spot {
    p: Point3<f64>,
    /// The surface's outward normal.
    normal: Vector3<f64>,
    /// From the centroid.
    arm: Vector3<f64>,
    /// Position along the axis, from -1 at one end of the scan to 1 at the other.
    share: f64,
    /// Cosines of 0, 1 and 2 half waves along the scan.
    along: [f64; 3],
    /// Cosines and sines of 0, 1 and 2 times the normal's angle about the axis, from the camera on.
    around: [[f64; 2]; 3],
}

impl Spot {
    pub(super) fn new(axes: &Axes, p: Point3<f64>, normal: Vector3<f64>) -> Self {
        let share = axes.along_share(&p);
        let half_wave = (FRAC_PI_2 * (share.clamp(-1.0, 1.0) + 1.0)).cos();
        let [x, y] = [axes.towards, axes.sideways].map(|way| normal.dot(&way));
        let size = x.hypot(y);
        let [cos, sin] = if size > 0.0 { [x / size, y / size] } else { [1.0, 0.0] };
        let around = [[1.0, 0.0], [cos, sin], [cos * cos - sin * sin, 2.0 * sin * cos]];
        let along = [1.0, half_wave, 2.0 * half_wave * half_wave - 1.0];
        Self { p, normal, arm: p - axes.centre, share, along, around }
    }
}

impl Mode {
    /// The displacement at a place, mm.
    pub(super) fn at(&self, axes: &Axes, spot: &Spot) -> Vector3<f64> {
        let Spot { p, normal, arm, share, along, around } = *spot;
        match *self {
            Self::Strain { of, to } => to * of.dot(&arm),
            Self::Growth => arm,
            Self::Bend(to) => to * (share * share) - axes.along * (2.0 * share * to.dot(&arm) / axes.half_mm),
            Self::Twist => axes.along.cross(&arm) * share,
            Self::Surface { half_waves, around: waves, is_sine } => {
                normal * (along[half_waves] * around[waves][usize::from(is_sine)])
            }
            Self::Film { ramp } => {
                let thickness = if ramp == 0.0 { 1.0 } else { 0.5 * (1.0 + ramp * share) };
                -normal * (normal.dot(&axes.towards).max(0.0) * thickness)
            }
            Self::FilmAround => -normal * (0.5 * (1.0 + normal.dot(&axes.sideways))),
            Self::Step { beyond_mm, to } if arm.dot(&axes.along) > beyond_mm => to,
            Self::Step { .. } => Vector3::zeros(),
            Self::TurnBeyond { end_mm, about } => {
                let beyond = arm - axes.along * end_mm;
                if beyond.dot(&axes.along) * end_mm > 0.0 { about.cross(&beyond) } else { Vector3::zeros() }
            }
            Self::Scale(camera) => p - camera,
            Self::Depth { camera, scale, plane, bend } => {
                let view = (axes.centre - camera).normalize();
                let across = bend.dot(&arm) / axes.half_mm;
                view * (scale * view.dot(&(p - camera)) + plane.dot(&arm) + across * across)
            }
            Self::Shift(to) => to,
        }
    }

    /// Whether it displaces the planned points with the bone; else it displaces the scan alone.
    pub(super) fn moves_plan(&self) -> bool {
        let of_scan = matches!(
            self,
            Self::Surface { .. } | Self::Film { .. } | Self::FilmAround | Self::Scale(_) | Self::Depth { .. }
        );
        !of_scan
    }

    /// Whether only that of it which looks as another pose is known well enough: how evenly a film covers the side that faces the camera is not
    /// known, so that what little would tell an even one from a shift and a tilt says nothing of a real one.
    pub(super) fn is_as_pose(&self) -> bool {
        matches!(self, Self::Film { .. })
    }

    /// Whether it displaces anything that the scan shows.
    pub(super) fn moves_scan(&self) -> bool {
        !matches!(self, Self::Shift(_) | Self::TurnBeyond { .. })
    }
}

/// Units of a size: percent, degrees or mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Unit {
    Percent,
    Degrees,
    Mm,
}

impl Unit {
    /// Its name, and what a parameter is multiplied by to have it.
    pub(super) fn of(self) -> (&'static str, f64) {
        match self {
            Self::Percent => ("%", 100.0),
            Self::Degrees => ("degrees", 1_f64.to_degrees()),
            Self::Mm => ("mm", 1.0),
        }
    }
}

/// A family of errors beyond the pose.
pub(super) struct Cause {
    /// The name in the results.
    pub(super) name: &'static str,
    pub(super) unit: Unit,
    /// Standard deviation of each parameter in a sound procedure, in the unit.
    pub(super) prior: fn(&NuisanceParams) -> f64,
    /// The same where it is a fault.
    pub(super) fault: f64,
    /// The largest size that is what its name says: beyond it, tissue or another bone is explained.
    pub(super) largest: f64,
    /// Its displacements; none where it needs a camera that is not known, or where nothing lies there.
    pub(super) modes: fn(&Axes) -> Vec<Mode>,
    /// What is found: `{}` is the size, and `[a|b]` one of two words by its sign.
    pub(super) found: &'static str,
    /// The size from which it would be wrong.
    pub(super) wrong: &'static str,
    /// What to check where it is found.
    pub(super) remedy: &'static str,
    pub(super) of: Of,
}

/// What is taken for granted where causes are not seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Of {
    Ct,
    Surface,
    /// A check piece tests it.
    Devices,
}

impl Of {
    pub(super) const ALL: [Self; 3] = [Self::Ct, Self::Surface, Self::Devices];

    /// What is taken for granted, and what shows it; of plan and markers where they are among the causes.
    pub(super) fn words(self, has: impl Fn(&str) -> bool) -> [&'static str; 2] {
        match self {
            Self::Ct if has("plan") => [
                "the bone is as in the CT, and the plan as drawn",
                "the headers of CT and plan, osteoflow convert --bind or a new CT",
            ],
            Self::Ct => ["the bone is as in the CT", "its header or a new CT"],
            Self::Surface => {
                ["the scan shows the bone's surface as segmented", "cleaning, a stylus or the surface over the CT"]
            }
            Self::Devices if has("marker") => ["camera and markers are as calibrated", "a later check piece or stylus"],
            Self::Devices => ["the camera is as calibrated", "a later check piece"],
        }
    }
}

/// Half waves along the scan and waves around the bone of the smooth errors of a surface; a constant is the offset.
const SMOOTH: [(usize, usize); 8] = [(1, 0), (2, 0), (0, 1), (1, 1), (2, 1), (0, 2), (1, 2), (2, 2)];

/// A shift in any direction of what the scan does not show.
fn shifts() -> Vec<Mode> {
    [Vector3::x(), Vector3::y(), Vector3::z()].map(Mode::Shift).to_vec()
}

/// Every family.
pub(super) const CAUSES: &[Cause] = &[
    Cause {
        name: "stretch_along",
        unit: Unit::Percent,
        prior: |p| p.stretch_percent,
        fault: 3.0,
        largest: f64::INFINITY,
        modes: |a| vec![Mode::Strain { of: a.along, to: a.along }],
        found: "the CT is {} too [long|short] along the bone",
        wrong: "a stretch along the bone above {}",
        remedy: "check the slice spacing of the CT",
        of: Of::Ct,
    },
    Cause {
        name: "growth",
        unit: Unit::Percent,
        prior: |p| p.stretch_percent,
        fault: 3.0,
        largest: 15.0,
        modes: |_| vec![Mode::Growth],
        found: "the CT is {} too [large|small] in all directions",
        wrong: "growth or shrinkage above {}",
        remedy: "check the voxel size of the CT and its date; a bone grows",
        of: Of::Ct,
    },
    Cause {
        // Slices are stacked along z of the CT, and a gantry tilts about x. Up to a turn, both ways to write it are one: this moves a
        // shaft the least.
        name: "shear",
        unit: Unit::Degrees,
        prior: |p| p.shear_deg,
        fault: 8.0,
        largest: 30.0,
        modes: |a| {
            let (y, z) = (Vector3::y(), Vector3::z());
            let (of, to) = if a.along.z.abs() >= a.along.y.abs() { (y, z) } else { (z, y) };
            vec![Mode::Strain { of, to }]
        },
        found: "the CT's slices are sheared by {}",
        wrong: "a shear above {}",
        remedy: "check the tilt of the CT's gantry",
        of: Of::Ct,
    },
    Cause {
        name: "affine",
        unit: Unit::Percent,
        prior: |p| p.affine_percent,
        fault: 2.0,
        largest: 15.0,
        modes: |a| {
            let [x, y, z] = [a.along, a.towards, a.sideways];
            [(x, x), (y, y), (z, z), (x, y), (x, z), (y, z)].map(|(of, to)| Mode::Strain { of, to }).to_vec()
        },
        found: "the CT is distorted by {}, differently along three directions, as by a wrong spacing across the bone or of an oblique reformat",
        wrong: "a stretch across or oblique to the bone above {}",
        remedy: "check the spacing of the CT's voxels in all three directions, and whether it was reformatted",
        of: Of::Ct,
    },
    Cause {
        name: "bend",
        unit: Unit::Mm,
        prior: |p| p.bend_mm,
        fault: 0.5,
        largest: 10.0,
        modes: |a| vec![Mode::Bend(a.towards), Mode::Bend(a.sideways)],
        found: "the bone is bent against the CT by {} over the scan",
        wrong: "a bend above {}",
        remedy: "check whether the bone was bent, has healed or moved during the CT",
        of: Of::Ct,
    },
    Cause {
        name: "twist",
        unit: Unit::Degrees,
        prior: |p| p.twist_deg,
        fault: 3.0,
        largest: 30.0,
        modes: |_| vec![Mode::Twist],
        found: "the bone is twisted against the CT by {} over half of the scan",
        wrong: "a twist above {}",
        remedy: "check whether the bone was bent, has healed or moved during the CT",
        of: Of::Ct,
    },
    Cause {
        name: "offset",
        unit: Unit::Mm,
        prior: |p| p.offset_mm,
        fault: 0.5,
        largest: 10.0,
        modes: |_| vec![Mode::Surface { half_waves: 0, around: 0, is_sine: false }],
        found: "the CT's surface is {} [outside|inside] the bone's",
        wrong: "a surface swollen or shrunk by more than {}",
        remedy: "check the threshold of the CT's segmentation",
        of: Of::Surface,
    },
    Cause {
        name: "smooth",
        unit: Unit::Mm,
        prior: |p| p.smooth_mm,
        fault: 0.3,
        largest: 5.0,
        modes: |_| {
            let of = |(half_waves, around): (usize, usize)| {
                let sines = if around > 0 { vec![false, true] } else { vec![false] };
                sines.into_iter().map(move |is_sine| Mode::Surface { half_waves, around, is_sine })
            };
            SMOOTH.into_iter().flat_map(of).collect()
        },
        found: "the CT's surface is off the bone's by {}, differently along and around it",
        wrong: "a wavy surface, by more than {}",
        remedy: "check the CT's segmentation: a threshold that drifts, beam hardening, or a surface from a model of shapes",
        of: Of::Surface,
    },
    Cause {
        name: "film_along",
        unit: Unit::Mm,
        prior: |p| p.film_mm,
        fault: 1.5,
        largest: 5.0,
        modes: |_| vec![Mode::Film { ramp: 1.0 }],
        found: "a film of {} covers the bone",
        wrong: "a film thicker at one end by more than {}",
        remedy: "clean the bone and scan again",
        of: Of::Surface,
    },
    Cause {
        name: "film_around",
        unit: Unit::Mm,
        prior: |p| p.film_mm,
        fault: 1.5,
        largest: 5.0,
        modes: |_| vec![Mode::FilmAround],
        found: "a film of {} covers one side of the bone",
        wrong: "a film thicker on one side by more than {}",
        remedy: "clean the bone and scan again",
        of: Of::Surface,
    },
    Cause {
        name: "film",
        unit: Unit::Mm,
        prior: |p| p.film_mm,
        fault: 1.5,
        largest: 5.0,
        modes: |_| vec![Mode::Film { ramp: 0.0 }],
        found: "a film of {} covers the bone",
        wrong: "an even film above {}",
        remedy: "clean the bone and scan again",
        of: Of::Surface,
    },
    Cause {
        name: "camera_scale",
        unit: Unit::Percent,
        prior: |p| p.camera_percent,
        fault: 1.5,
        largest: 10.0,
        modes: |a| a.camera.map(Mode::Scale).into_iter().collect(),
        found: "the camera measures {} too [short|long]",
        wrong: "a camera scale error above {}",
        remedy: "measure an object of known size with the camera",
        of: Of::Devices,
    },
    Cause {
        name: "camera_depth",
        unit: Unit::Percent,
        prior: |p| p.camera_percent,
        fault: 1.5,
        largest: 10.0,
        modes: |a| a.depth(1.0, Vector3::zeros(), Vector3::zeros()),
        found: "the camera measures depths {} too [short|long]",
        wrong: "a camera depth error above {}",
        remedy: "measure an object of known size with the camera",
        of: Of::Devices,
    },
    Cause {
        name: "camera_plane",
        unit: Unit::Percent,
        prior: |p| p.camera_percent,
        fault: 1.0,
        largest: 10.0,
        modes: |a| [a.along, a.sideways].into_iter().flat_map(|way| a.depth(0.0, way, Vector3::zeros())).collect(),
        found: "the camera's depth is tilted by {}",
        wrong: "a camera depth tilt above {}",
        remedy: "measure a plane of known place with the camera",
        of: Of::Devices,
    },
    Cause {
        name: "camera_bend",
        unit: Unit::Mm,
        prior: |p| p.field_mm,
        fault: 0.5,
        largest: 10.0,
        modes: |a| {
            let diagonal = [a.along + a.sideways, a.along - a.sideways].map(|way| way * FRAC_PI_4.sin());
            [[a.along, a.sideways], diagonal]
                .concat()
                .into_iter()
                .flat_map(|way| a.depth(0.0, Vector3::zeros(), way))
                .collect()
        },
        found: "the camera shows a plane bent by {}",
        wrong: "a camera depth bend above {}",
        remedy: "measure a flat object with the camera",
        of: Of::Devices,
    },
    Cause {
        name: "beyond",
        unit: Unit::Degrees,
        prior: |p| p.beyond_deg,
        fault: 1.5,
        largest: 30.0,
        modes: |a| {
            let turns = |end_mm: f64| [a.along, a.towards, a.sideways].map(|about| Mode::TurnBeyond { end_mm, about });
            a.beyond_mm.into_iter().flatten().flat_map(turns).collect()
        },
        found: "the bone beyond the scan is turned by {}",
        wrong: "a turn of the leg above {} beyond the scan",
        remedy: "scan the part that is cut",
        of: Of::Ct,
    },
    Cause {
        name: "step",
        unit: Unit::Mm,
        prior: |p| p.step_mm,
        fault: 1.5,
        largest: 10.0,
        modes: |a| a.steps().iter().flat_map(|at| a.step(*at)).collect(),
        found: "a part of the bone is displaced by {}",
        wrong: "a step in the bone above {}",
        remedy: "check for a fracture, a loosened part, or slices that are missing, and scan the part that is cut",
        of: Of::Ct,
    },
    Cause {
        name: "plan",
        unit: Unit::Mm,
        prior: |p| p.plan_mm,
        fault: 3.0,
        largest: f64::INFINITY,
        modes: |_| shifts(),
        found: "the plan is displaced by {}",
        wrong: "a shift of the plan above {}",
        remedy: "look at plan and surface together, and bind the plan (osteoflow convert PLAN OUT --bind BONE)",
        of: Of::Ct,
    },
    Cause {
        name: "marker",
        unit: Unit::Mm,
        prior: |p| p.slip_mm,
        fault: 3.0,
        largest: f64::INFINITY,
        modes: |_| shifts(),
        found: "a marker has moved by {}",
        wrong: "a marker's shift above {}",
        remedy: "check the screws of the markers, and touch a landmark or a check piece after the scan",
        of: Of::Devices,
    },
];

#[cfg(test)]
mod tests {
    use super::*;

    fn axes(camera: Option<Point3<f64>>) -> Axes {
        let points: Vec<Point3<f64>> = (0..100).map(|k| Point3::new(5.0, f64::from(k % 3), f64::from(k))).collect();
        let axes = Axes::new(&points, &vec![Vector3::x(); points.len()], camera).unwrap();
        axes.with_targets([Point3::new(5.0, 0.0, 130.0)].iter())
    }

    #[test]
    fn every_family_is_whole() {
        let axes = axes(Some(Point3::new(300.0, 0.0, 50.0)));
        let spot = Spot::new(&axes, Point3::new(5.0, 1.0, 70.0), Vector3::x());
        let mut names: Vec<&str> = CAUSES.iter().map(|cause| cause.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), CAUSES.len());
        for cause in CAUSES {
            let sound = (cause.prior)(&NuisanceParams::default());
            assert!(sound > 0.0 && sound < cause.fault && cause.fault < cause.largest, "{}", cause.name);
            assert!(
                cause.found.contains("{}") && cause.wrong.contains("{}") && !cause.remedy.is_empty(),
                "{}",
                cause.name
            );
            let modes = (cause.modes)(&axes);
            assert!(!modes.is_empty(), "{}", cause.name);
            for mode in modes {
                let shift = mode.at(&axes, &spot);
                assert!(shift.iter().all(|mm| mm.is_finite()), "{}: {mode:?}", cause.name);
                assert!(mode.moves_scan() || mode.moves_plan(), "{}: {mode:?} moves nothing", cause.name);
            }
        }
    }

    #[test]
    fn what_needs_a_camera_or_targets_beyond_the_scan_is_left_out_without() {
        let axes = axes(None);
        let of = |name: &str| (CAUSES.iter().find(|cause| cause.name == name).unwrap().modes)(&axes).len();
        assert_eq!(["camera_scale", "camera_depth", "camera_plane", "camera_bend"].map(of), [0; 4]);
        assert_eq!(of("beyond"), 3, "one end");
        assert_eq!(of("step") % 3, 0);
    }

    #[test]
    fn displacements_are_as_stated() {
        let axes = axes(Some(Point3::new(300.0, 0.0, 50.0)));
        let at = |mode: Mode, p: [f64; 3], normal: [f64; 3]| {
            mode.at(&axes, &Spot::new(&axes, Point3::from(p), Vector3::from(normal)))
        };
        let centre = axes.centre.coords;
        let near = |found: Vector3<f64>, expected: Vector3<f64>| (found - expected).norm() < 1e-9;
        let end = centre + axes.along * axes.half_mm;
        let across = Vector3::new(1.0, 0.0, 0.0);
        assert!(near(
            at(Mode::Strain { of: axes.along, to: axes.along }, end.into(), [1.0, 0.0, 0.0]),
            axes.along * axes.half_mm
        ));
        // The sag of an end against the middle is 1 mm.
        let bent = at(Mode::Bend(axes.towards), end.into(), [1.0, 0.0, 0.0]);
        assert!((bent.dot(&axes.towards) - 1.0).abs() < 1e-9, "{bent}");
        let beyond = Mode::TurnBeyond { end_mm: axes.half_mm, about: axes.towards };
        assert_eq!(at(beyond, centre.into(), [1.0, 0.0, 0.0]), Vector3::zeros());
        let farther = end + axes.along * 30.0;
        assert!(near(at(beyond, farther.into(), [1.0, 0.0, 0.0]), axes.towards.cross(&axes.along) * 30.0));
        let step = Mode::Step { beyond_mm: 8.0, to: across };
        assert_eq!(at(step, (centre + axes.along * 9.0).into(), [1.0, 0.0, 0.0]), across);
        assert_eq!(at(step, (centre + axes.along * 7.0).into(), [1.0, 0.0, 0.0]), Vector3::zeros());
        // A film is where the surface faces the camera, and grows from none to 1 mm.
        let film = |ramp: f64, p: Vector3<f64>, facing: f64| {
            at(Mode::Film { ramp }, p.into(), (axes.towards * facing).into()).dot(&(axes.towards * facing))
        };
        assert!((film(0.0, centre, 1.0) + 1.0).abs() < 1e-9 && film(0.0, centre, -1.0) == 0.0);
        assert!((film(1.0, end, 1.0) + 1.0).abs() < 1e-9 && film(-1.0, end, 1.0).abs() < 1e-9);
        // A camera that measures 1 % too long puts a point at 300 mm 3 mm too far.
        let camera = Point3::new(300.0, 0.0, 50.0);
        let scaled = at(Mode::Scale(camera), [5.0, 0.0, 50.0], [1.0, 0.0, 0.0]) * 0.01;
        assert!(near(scaled, Vector3::new(-2.95, 0.0, 0.0)), "{scaled}");
    }
}
