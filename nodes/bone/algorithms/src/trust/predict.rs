//! The error to expect, from the spread of the pose and the stated errors of the devices.

use super::cut::Cut;
use super::nuisance::params::NuisanceParams;
use super::{Limits, PredictedLast, Spread};
use crate::axes::largest_first;
use crate::calibrate::PhantomReport;
use crate::product::product;
use crate::sensor::Sensor;
use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Matrix6, Point3, UnitQuaternion, Vector3, Vector6};
use osteoflow_geometry::NamedPoint;
use osteoflow_node_macros::params;
use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Number of draws of the pose that an interval is read from: its ends are then known to 3 %.
const N_DRAWS: usize = 4000;

/// Least number of draws of what is unlikely.
const N_LEAST: usize = 100;

/// Share of the draws below and above an interval of 90 %.
const TAIL: f64 = 0.05;

/// Standard deviation of the factor by which the predicted errors may be larger or smaller as a whole. 0.2: the errors of
/// trackers and prints are stated to about a fifth, and a spread from a few dozen patches of a scan is known no better. From fewer
/// it is larger.
const SCALE_SIGMA: f64 = 0.2;

/// Semi-axes of the ellipsoid that holds 90 % of a three-dimensional Gaussian, in standard deviations.
const ELLIPSOID_SIGMAS: f64 = 2.500_278;

/// The name of the term of what the markers move while the scan is taken.
pub(super) const SCAN_MOTION: &str = "motion during the scan";

/// Stated errors.
#[params]
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
pub struct PredictParams {
    /// Standard deviation, per axis, of a marker's tracked position while it stands still. 0.06: an optical tracker's
    /// volumetric error of 0.1 mm in all.
    #[param(0.06, 0.0..=10.0)]
    pub marker_mm: f64,
    /// Standard deviation of its tracked attitude about each axis. 0.023: that error over a marker of 150 mm.
    #[param(0.023, 0.0..=10.0)]
    pub marker_deg: f64,
    /// Standard deviation, per axis, of the phantom's marker against its CAD. 0.05: a printed part.
    #[param(0.05, 0.0..=10.0)]
    pub print_mm: f64,
    /// Standard deviation of its attitude against the CAD about each axis. 0.03: as much over the phantom.
    #[param(0.03, 0.0..=10.0)]
    pub print_deg: f64,
    /// Standard deviation, per axis, of the camera's place on its marker, mm, where `t_camera_camera_marker` is given and not calibrated in the
    /// run. 30: unknown, as after an inverted matrix. What the camera's turns between the scan and its landmarks test is left out.
    #[param(30.0, 0.001..=1000.0)]
    pub hand_eye_mm: f64,
    /// Standard deviation of its attitude there about each axis, degrees. 10: unknown.
    #[param(10.0, 0.001..=180.0)]
    pub hand_eye_deg: f64,
    /// RMS error of the CT's surface over patches of a centimetre, as stated: how much it may swell or shrink with the
    /// segmentation's threshold. 0.1: a seventh of a voxel of 0.7 mm. It widens only the second interval, as the first has what
    /// varies along the scan.
    #[param(0.1, 0.0..=10.0)]
    pub ct_bias_mm: f64,
    /// Standard deviation, per axis, of a shift of the whole scan that no residual shows, as of an ultrasound probe's
    /// calibration. 0: markers and camera have their own. The surface's `sensor` states it, too.
    #[param(0.0, 0.0..=100.0)]
    pub scan_mm: f64,
    /// What may be wrong beside the pose.
    pub nuisances: NuisanceParams,
}

impl PredictParams {
    /// With the errors of a sensor that are stated.
    pub(super) fn of(&self, sensor: &Sensor) -> Self {
        let NuisanceParams { offset_mm, field_mm, .. } = self.nuisances;
        let nuisances = NuisanceParams {
            offset_mm: offset_mm.hypot(sensor.bias_mm),
            field_mm: field_mm.max(sensor.bias_mm),
            ..self.nuisances.clone()
        };
        Self { scan_mm: self.scan_mm.hypot(sensor.shift_mm), nuisances, ..self.clone() }
    }
}

/// The poses by which the markers' places are carried to the target.
#[derive(Debug, Clone, PartialEq)]
pub struct MarkerPoses {
    /// The camera at the scan.
    pub t_target_camera: Isometry3<f64>,
    /// The camera's marker on the camera.
    pub t_camera_camera_marker: Isometry3<f64>,
    /// The phantom's marker in the scan of the phantom, if there was one.
    pub t_camera_phantom_marker: Option<Isometry3<f64>>,
}

/// Where the markers were, for the propagation of their errors. In the target's frame, mm.
#[derive(Debug, Clone, PartialEq)]
pub struct Tracking {
    /// The camera's marker at the scan.
    pub camera_marker: Point3<f64>,
    /// The phantom's marker at the calibration, in the camera's frame, carried to the scan.
    pub phantom_marker: Option<Point3<f64>>,
    /// Covariance of the phantom's fit: shift (mm) and turn (rad) about a point.
    pub phantom_fit: Option<(Matrix6<f64>, Point3<f64>)>,
}

impl Tracking {
    /// The markers as the camera saw them, and the fit of the phantom.
    ///
    /// An error of the calibration moves the scan as a rigid body with the camera, so the phantom's marker acts from where it
    /// was in the camera's frame.
    pub fn new(seen: &MarkerPoses, calibration: Option<&PhantomReport>) -> Self {
        let t = &seen.t_target_camera;
        let phantom_fit = calibration.map(|report| {
            let covariance = Matrix6::from_fn(|row, column| report.covariance[row][column]);
            (rotated(&covariance, &t.rotation), t * Point3::from(report.centre_mm))
        });
        Self {
            camera_marker: t * (seen.t_camera_camera_marker * Point3::origin()),
            phantom_marker: seen.t_camera_phantom_marker.map(|marker| t * (marker * Point3::origin())),
            phantom_fit,
        }
    }
}

/// The predicted error.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Predicted {
    /// At each assessment point.
    pub points: Vec<PredictedPoint>,
    /// At each cut, in the middle of the bone.
    pub cuts: Vec<PredictedPoint>,
    /// The mean TRE of the assessment points.
    pub assessment: Option<PredictedSet>,
    /// The mean TRE of the cuts.
    pub all_cuts: Option<PredictedSet>,
    /// The chance that the answer is wrong by the limits, from the same errors.
    pub beyond_limits: f64,
    /// The same by what may be at fault beside the pose, the sound one first; the sum is that of `beyond_limits`.
    #[serde(skip)]
    pub(super) beyond_by: Vec<f64>,
    /// Each source of error, RMS over all of these points.
    pub terms: Vec<Term>,
    /// The interval of the mean TRE of the assessment points, else of the cuts, if the stated errors of markers and phantom were
    /// all twice as large, mm: no residual shows them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub devices_twice_mm: Option<Interval>,
    /// At the cuts as last followed, where they were: all else is of the scan's instant.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last: Option<PredictedLast>,
}

/// What a number of 1 does to the answer at a point of the target's frame: a column of 3 for each number, mm.
pub type Levers<'a> = dyn Fn(&Point3<f64>) -> DMatrix<f64> + 'a;

/// What numbers may be, with the weight of this among others.
#[derive(Debug, Clone, Copy)]
pub struct Component<'a> {
    /// Its weight; those of all components are 1.
    pub weight: f64,
    /// Mean of the numbers.
    pub mean: &'a DVector<f64>,
    /// Covariance of the numbers.
    pub covariance: &'a DMatrix<f64>,
}

/// Errors of pose, CT and camera, as numbers that are one of several Gaussians.
pub struct Deformation<'a> {
    /// What the numbers may be; the likeliest sound one first.
    pub components: Vec<Component<'a>>,
    /// Their levers at a point.
    pub at: Box<Levers<'a>>,
}

impl Deformation<'_> {
    /// Second moment of the error at a point, mm², of the first component.
    fn moment_at(&self, p: &Point3<f64>) -> Matrix3<f64> {
        let Some(first) = self.components.first() else { return Matrix3::zeros() };
        let lever = (self.at)(p);
        let mean = &lever * first.mean;
        let moment = product(&product(&lever, first.covariance), &lever.transpose()) + &mean * mean.transpose();
        Matrix3::from_fn(|row, column| moment[(row, column)])
    }
}

/// Where the error is predicted, in the target's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Where<'a> {
    /// The assessment points.
    pub points: &'a [NamedPoint],
    /// The cuts.
    pub cuts: &'a [Cut],
    /// The points whose mean error the limits hold for.
    pub limited: &'a [Point3<f64>],
}

/// The predicted error of a point.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PredictedPoint {
    /// Its name.
    pub name: String,
    /// RMS error, mm.
    pub tre_mm: f64,
    /// The interval that holds the error with 90 %, mm.
    pub interval_mm: Interval,
    /// Semi-axes of the ellipsoid that holds the point with 90 %, mm, the longest first.
    pub semi_axes_mm: [f64; 3],
    /// Their unit directions in the target's frame.
    pub directions: [[f64; 3]; 3],
}

/// The predicted mean error of several points.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PredictedSet {
    /// Expected mean TRE, mm.
    pub mean_tre_mm: f64,
    /// The interval that holds it with 90 %, given the data, mm.
    pub interval_mm: Interval,
    /// The same with the stated bias of the CT's surface, mm.
    pub interval_with_ct_bias_mm: Interval,
}

/// Lower and upper end.
pub type Interval = [f64; 2];

/// A source of error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Term {
    /// Its name.
    pub name: String,
    /// RMS error, mm.
    pub tre_mm: f64,
}

impl Predicted {
    /// What the interval takes for granted of the devices.
    pub(super) fn devices_assumption(&self, params: &PredictParams) -> Option<String> {
        let [from_mm, to_mm] = self.devices_twice_mm?;
        let of = if self.assessment.is_some() { "at the assessment points" } else { "at the cuts" };
        let PredictParams { marker_mm, marker_deg, print_mm, print_deg, .. } = params;
        Some(format!(
            "markers are tracked to {marker_mm} mm and {marker_deg} degrees and the phantom is printed to {print_mm} mm and {print_deg} \
             degrees, as stated: errors twice as large would leave {from_mm:.1} to {to_mm:.1} mm {of} (90 %)"
        ))
    }

    /// The prediction in a sentence.
    pub(super) fn sentence(&self) -> String {
        let set = |what: &str, set: &Option<PredictedSet>| {
            set.as_ref().map(|set| format!("{:.1} to {:.1} mm {what}", set.interval_mm[0], set.interval_mm[1]))
        };
        let sets = [set("at the assessment points", &self.assessment), set("at the cuts", &self.all_cuts)];
        let sets: Vec<String> = sets.into_iter().flatten().collect();
        if sets.is_empty() {
            return "no sign against it was found".to_owned();
        }
        format!("predicted mean error {} (90 %)", sets.join(", "))
    }
}

/// Covariance of a shift and a turn, in the frame that a rotation leads to.
pub(super) fn rotated(covariance: &Matrix6<f64>, rotation: &UnitQuaternion<f64>) -> Matrix6<f64> {
    let rotation = rotation.to_rotation_matrix().into_inner();
    let mut both = Matrix6::zeros();
    both.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    both.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    both * covariance * both.transpose()
}

/// Covariance of a rigid error that acts about `about`, as shift and turn about `centre`.
pub(super) fn carried(covariance: &Matrix6<f64>, about: &Point3<f64>, centre: &Point3<f64>) -> Matrix6<f64> {
    let mut j = Matrix6::identity();
    j.fixed_view_mut::<3, 3>(0, 3).copy_from(&-(centre - about).cross_matrix());
    j * covariance * j.transpose()
}

pub(super) fn isotropic(mm: f64, deg: f64) -> Matrix6<f64> {
    let rad = deg.to_radians();
    Matrix6::from_diagonal(&Vector6::new(mm, mm, mm, rad, rad, rad).map(|sd| sd * sd))
}

/// The stated errors of the markers and the phantom, each with its name.
fn stated(tracking: &Tracking, centre: &Point3<f64>, params: &PredictParams) -> Vec<(&'static str, Matrix6<f64>)> {
    let marker = isotropic(params.marker_mm, params.marker_deg);
    let camera_marker = carried(&marker, &tracking.camera_marker, centre);
    let mut terms = vec![("camera marker at the scan", camera_marker)];
    if let Some(phantom_marker) = &tracking.phantom_marker {
        terms.push(("camera marker at the calibration", camera_marker));
        terms.push(("phantom marker", carried(&marker, phantom_marker, centre)));
        terms.push(("phantom", carried(&isotropic(params.print_mm, params.print_deg), phantom_marker, centre)));
    }
    terms
}

/// Predicts the error at points and cuts.
///
/// The terms are independent: the registration with what may be wrong beside the pose, in one posterior, or without it the spread of the
/// registration; the camera's marker at the scan and at the calibration; the phantom's marker, its print and its fit. The bone's marker cancels,
/// as planes are carried back by the pose that brought the scan. The interval of a mean is read from draws of their sum, always the same.
///
/// # Source
/// Propagation of rigid errors to a target: Fitzpatrick, West and Maurer 1998; Moghari and Abolmaesumi 2009; Ma and Ellis 2006
/// for surface registration.
///
/// `to_settled` is the motion from the pose to the one at which the scan fits best nearby: an error that the pose is known to
/// have, about which the others spread; a posterior has its own. `others` are more errors of the pose, by name, each with the point about which it
/// acts.
#[expect(clippy::too_many_arguments, reason = "each is another source of error, or where and how it is told")]
pub fn predict(
    spread: &Spread,
    to_settled: &Isometry3<f64>,
    deformation: Option<&Deformation<'_>>,
    tracking: Option<&Tracking>,
    others: &[(&'static str, Matrix6<f64>, Point3<f64>)],
    at: &Where<'_>,
    limits: &Limits,
    params: &PredictParams,
) -> Predicted {
    let centre = spread.centre;
    let points = at.points;
    let cuts: Vec<NamedPoint> = at.cuts.iter().map(|cut| cut.middle.clone()).collect();
    let stated = tracking.map(|tracking| stated(tracking, &centre, params)).unwrap_or_default();
    let scan = (params.scan_mm > 0.0).then(|| ("shift of the scan", isotropic(params.scan_mm, 0.0)));
    let fit = tracking.and_then(|tracking| tracking.phantom_fit.as_ref());
    let fit = fit.map(|(covariance, about)| ("phantom's fit", carried(covariance, about, &centre)));
    let others = others.iter().map(|(name, covariance, about)| (*name, carried(covariance, about, &centre)));
    let registration = deformation.is_none().then_some(("registration", spread.covariance));
    let terms: Vec<(&str, Matrix6<f64>)> =
        registration.into_iter().chain(scan).chain(others).chain(stated.iter().copied()).chain(fit).collect();
    let settles = deformation.is_none();
    let shift = if settles { to_settled * centre - centre } else { Vector3::zeros() };
    let turn = if settles { to_settled.rotation.scaled_axis() } else { Vector3::zeros() };
    let mean = Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
    let sum = |terms: &[(&str, Matrix6<f64>)]| terms.iter().map(|(_, covariance)| covariance).sum::<Matrix6<f64>>();
    let (total, devices) = (sum(&terms), sum(&stated));
    let bias = spread.beyond(params.ct_bias_mm);
    let all: Vec<Point3<f64>> = points.iter().chain(&cuts).map(|p| p.position).collect();
    let rms_of = |variance: &dyn Fn(&Point3<f64>) -> f64| {
        (all.iter().map(variance).sum::<f64>() / all.len().max(1) as f64).max(0.0).sqrt()
    };
    let rms = |covariance: &Matrix6<f64>| rms_of(&|p| covariance_at(covariance, &centre, p).trace());
    let mut terms: Vec<Term> =
        terms.iter().map(|(name, covariance)| Term { name: (*name).to_owned(), tre_mm: rms(covariance) }).collect();
    match deformation {
        Some(deformation) => {
            let tre_mm = rms_of(&|p| deformation.moment_at(p).trace());
            terms.insert(0, Term { name: "registration, CT and camera".to_owned(), tre_mm });
        }
        None => terms.push(Term { name: "not settled".to_owned(), tre_mm: rms(&(mean * mean.transpose())) }),
    }
    terms.push(Term { name: "stated bias of the CT".to_owned(), tre_mm: rms(&bias) });
    let outputs = Outputs::new(at, &centre, deformation);
    let numbers = Numbers::new(deformation);
    // A standard deviation from so many cells, less the six numbers of a pose.
    let scale_sigma = SCALE_SIGMA.max((2.0 * (spread.n_cells as f64 - 6.0).max(1.0)).sqrt().recip());
    let draws = |covariance: &Matrix6<f64>| Draws { scale_sigma, ..outputs.draws(&mean, covariance, &numbers) };
    let (given, biased) = (draws(&total), draws(&(total + bias)));
    let set = |rows: &[usize]| {
        let (mean_tre_mm, interval_mm) = given.mean_error(rows)?;
        let (_, interval_with_ct_bias_mm) = biased.mean_error(rows)?;
        Some(PredictedSet { mean_tre_mm, interval_mm, interval_with_ct_bias_mm })
    };
    let devices_twice_mm = (!stated.is_empty()).then(|| {
        let draws = draws(&(total + devices * 3.0));
        let mean = draws.mean_error(&outputs.points).or_else(|| draws.mean_error(&outputs.middles));
        mean.map(|(_, interval)| interval)
    });
    let moved = |p: &Point3<f64>| shift + turn.cross(&(p - centre));
    let point = |(named, row): (&NamedPoint, &usize)| {
        let own = deformation.map_or(Matrix3::zeros(), |deformation| deformation.moment_at(&named.position));
        let covariance = covariance_at(&total, &centre, &named.position) + own;
        let (semi_axes_mm, directions) = ellipsoid(&covariance);
        PredictedPoint {
            name: named.name.to_string(),
            tre_mm: (covariance.trace() + moved(&named.position).norm_squared()).max(0.0).sqrt(),
            interval_mm: given.mean_error(&[*row]).map_or([0.0; 2], |(_, interval)| interval),
            semi_axes_mm,
            directions,
        }
    };
    let beyond_by = given.beyond_limits(&outputs, limits);
    Predicted {
        points: points.iter().zip(&outputs.points).map(point).collect(),
        cuts: cuts.iter().zip(&outputs.middles).map(point).collect(),
        assessment: set(&outputs.points),
        all_cuts: set(&outputs.middles),
        beyond_limits: beyond_by.iter().sum(),
        beyond_by,
        terms,
        devices_twice_mm: devices_twice_mm.flatten(),
        last: None,
    }
}

/// Covariance of the position of a point, mm², from that of shift and turn about `centre`.
fn covariance_at(covariance: &Matrix6<f64>, centre: &Point3<f64>, point: &Point3<f64>) -> Matrix3<f64> {
    carried(covariance, centre, point).fixed_view::<3, 3>(0, 0).into_owned()
}

fn ellipsoid(covariance: &Matrix3<f64>) -> ([f64; 3], [[f64; 3]; 3]) {
    let (directions, variances) = largest_first(covariance);
    (variances.map(|value| ELLIPSOID_SIGMAS * value.max(0.0).sqrt()), directions.map(Into::into))
}

/// What errors do, as rows: the displacements of points, three rows each, and of cuts.
struct Outputs {
    /// The first row of each assessment point.
    points: Vec<usize>,
    /// The first row of each point whose mean error is limited.
    limited: Vec<usize>,
    /// The first row of the middle of each cut; after it come the offset along the normal and the two slopes.
    middles: Vec<usize>,
    /// What a shift and a turn about the centre do.
    of_pose: DMatrix<f64>,
    /// What the numbers of the deformation do.
    of_numbers: DMatrix<f64>,
}

impl Outputs {
    fn new(at: &Where<'_>, centre: &Point3<f64>, deformation: Option<&Deformation<'_>>) -> Self {
        let named: Vec<Point3<f64>> = at.points.iter().map(|p| p.position).collect();
        let is_same = named == at.limited;
        let positions = if is_same { named } else { [&named, at.limited].concat() };
        let rows = |lever: &dyn Fn(&Point3<f64>) -> DMatrix<f64>| {
            let of_cut = |cut: &Cut| {
                let [offset, slopes] = cut.levers(lever);
                [lever(&cut.middle.position), offset, slopes]
            };
            let all: Vec<DMatrix<f64>> = positions.iter().map(lever).chain(at.cuts.iter().flat_map(of_cut)).collect();
            let mut rows = DMatrix::zeros(all.iter().map(DMatrix::nrows).sum(), all.first().map_or(0, DMatrix::ncols));
            let mut first = 0;
            for part in all {
                rows.rows_mut(first, part.nrows()).copy_from(&part);
                first += part.nrows();
            }
            rows
        };
        let pose = |p: &Point3<f64>| {
            let mut lever = DMatrix::zeros(3, 6);
            lever.view_mut((0, 0), (3, 3)).copy_from(&Matrix3::identity());
            lever.view_mut((0, 3), (3, 3)).copy_from(&-(p - centre).cross_matrix());
            lever
        };
        let (n, n_limited) = (at.points.len(), at.limited.len());
        let first = 3 * positions.len();
        Self {
            points: (0..n).map(|k| 3 * k).collect(),
            limited: (0..n_limited).map(|k| 3 * if is_same { k } else { n + k }).collect(),
            middles: (0..at.cuts.len()).map(|k| first + 6 * k).collect(),
            of_pose: rows(&pose),
            of_numbers: deformation.map_or_else(|| DMatrix::zeros(0, 0), |deformation| rows(&*deformation.at)),
        }
    }

    /// Draws of the errors of a pose of this mean and covariance, and of the numbers.
    fn draws(&self, mean: &Vector6<f64>, covariance: &Matrix6<f64>, numbers: &Numbers<'_>) -> Draws {
        let eigen = covariance.symmetric_eigen();
        let root = eigen.eigenvectors * Matrix6::from_diagonal(&eigen.eigenvalues.map(|value| value.max(0.0).sqrt()));
        let root = DMatrix::from_column_slice(6, 6, root.as_slice());
        let mean = DVector::from_column_slice(mean.as_slice());
        let mut pose = product(&product(&self.of_pose, &root), &numbers.of_pose);
        let at_mean = &self.of_pose * mean;
        pose.column_iter_mut().for_each(|mut column| column += &at_mean);
        let columns = DMatrix::zeros(pose.nrows(), 0);
        let mut draws = Draws { columns, weights: Vec::new(), of: Vec::new(), scale_sigma: SCALE_SIGMA };
        let mut parts = Vec::new();
        for (k, (component, root, n)) in numbers.components.iter().enumerate() {
            let mut part = pose.columns(0, *n).into_owned();
            let standard = numbers.standard.columns(0, *n).into_owned();
            part += product(&product(&self.of_numbers, root), &standard);
            let at_mean = &self.of_numbers * component.mean;
            part.column_iter_mut().for_each(|mut column| column += &at_mean);
            draws.weights.extend(vec![component.weight / *n as f64; *n]);
            draws.of.extend(vec![k; *n]);
            parts.extend_from_slice(part.as_slice());
        }
        if numbers.components.is_empty() {
            draws.weights = vec![1.0 / N_DRAWS as f64; N_DRAWS];
            draws.of = vec![0; N_DRAWS];
            draws.columns = pose;
        } else {
            draws.columns = DMatrix::from_vec(pose.nrows(), draws.of.len(), parts);
        }
        draws
    }
}

/// Standard normal numbers, always the same, and what makes the numbers of a deformation of them.
struct Numbers<'a> {
    /// A column for each draw.
    of_pose: DMatrix<f64>,
    standard: DMatrix<f64>,
    /// Each component with a root of its covariance, and its number of draws.
    components: Vec<(Component<'a>, DMatrix<f64>, usize)>,
}

impl<'a> Numbers<'a> {
    fn new(deformation: Option<&Deformation<'a>>) -> Self {
        let components = deformation.map(|deformation| deformation.components.clone()).unwrap_or_default();
        let n = components.first().map_or(0, |component| component.mean.len());
        let standard = |rows: usize, seed: u64| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            DMatrix::from_fn(rows, N_DRAWS, |_, _| normal(&mut rng))
        };
        let of = |component: Component<'a>| {
            let root = component.covariance.clone().cholesky().map(|cholesky| cholesky.unpack());
            let n_draws = (component.weight * N_DRAWS as f64) as usize;
            (component, root.unwrap_or_else(|| DMatrix::zeros(n, n)), n_draws.clamp(N_LEAST, N_DRAWS))
        };
        Self { of_pose: standard(6, 1), standard: standard(n, 3), components: components.into_iter().map(of).collect() }
    }
}

/// Draws of the errors.
struct Draws {
    /// A column for each draw.
    columns: DMatrix<f64>,
    weights: Vec<f64>,
    /// The component of each.
    of: Vec<usize>,
    /// Standard deviation of the factor by which all of them may be larger or smaller.
    scale_sigma: f64,
}

impl Draws {
    /// The mean error of the points at some rows for each draw, mm.
    fn means(&self, rows: &[usize]) -> Vec<f64> {
        let mean = |column: nalgebra::DVectorView<'_, f64>| {
            rows.iter().map(|row| column.fixed_rows::<3>(*row).norm()).sum::<f64>() / rows.len().max(1) as f64
        };
        self.columns.column_iter().map(mean).collect()
    }

    /// Mean and 90 % interval of the mean error of points; `None` without points.
    fn mean_error(&self, rows: &[usize]) -> Option<(f64, Interval)> {
        if rows.is_empty() {
            return None;
        }
        let errors = self.means(rows);
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut scaled: Vec<(f64, f64)> = errors
            .iter()
            .map(|e| e * (1.0 + self.scale_sigma * normal(&mut rng)).abs())
            .zip(self.weights.clone())
            .collect();
        scaled.sort_by(|a, b| a.0.total_cmp(&b.0));
        let at = |share: f64| {
            let mut sum = 0.0;
            let reached = scaled.iter().find(|(_, weight)| {
                sum += weight;
                sum >= share
            });
            reached.or(scaled.last()).map_or(0.0, |(error, _)| *error)
        };
        let mean = errors.iter().zip(&self.weights).map(|(error, weight)| error * weight).sum();
        Some((mean, [at(TAIL), at(1.0 - TAIL)]))
    }

    /// The chance of each component that the errors are beyond a limit.
    fn beyond_limits(&self, outputs: &Outputs, limits: &Limits) -> Vec<f64> {
        let tre_mm = self.means(&outputs.limited);
        let mut chances = vec![0.0; self.of.last().map_or(0, |last| last + 1)];
        for (k, column) in self.columns.column_iter().enumerate() {
            let (mut offset_mm, mut slope) = (0.0_f64, 0.0_f64);
            for middle in &outputs.middles {
                offset_mm = offset_mm.max(column[middle + 3].abs());
                slope = slope.max(column[middle + 4].hypot(column[middle + 5]));
            }
            if limits.times(tre_mm[k], offset_mm, slope.to_degrees()) > 1.0 {
                chances[self.of[k]] += self.weights[k];
            }
        }
        chances
    }
}

/// A standard normal number. Source: Box and Muller 1958.
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

#[cfg(test)]
mod tests;
