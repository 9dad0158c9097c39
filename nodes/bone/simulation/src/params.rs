//! Every term of the simulated procedure, its default and the source of that.
//!
//! "Other simulator" means the noise model written beside the recording of the development data, made independently of
//! this crate; "assumed" means not measured. A term is switched off by 0.

use crate::bone::BoneParams;
use crate::error::{SimulationError, check_rules};
use crate::ranges::{self, without_table_defaults};
use osteoflow_node_macros::params;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A simulated procedure: the bone and the errors of every device.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[schemars(transform = without_table_defaults)]
pub struct ProcedureParams {
    /// The built-in bone.
    pub bone: BoneParams,
    /// The structured-light camera and its view.
    pub camera: CameraParams,
    /// The localiser and the markers.
    pub tracker: TrackerParams,
    /// The laser pointer that marks the landmarks.
    pub laser: LaserParams,
    /// The colour images at the scans with the laser.
    pub image: ImageParams,
    /// The calibration phantom and the camera marker's support.
    pub phantom: PhantomParams,
    /// The printed check piece of a calibration.
    pub check: CheckParams,
    /// The tracked stylus.
    pub stylus: StylusParams,
    /// The ruler with which the marks are measured off on the bone.
    pub ruler: RulerParams,
    /// The periosteum left on the stripped bone.
    pub periosteum: PeriosteumParams,
    /// Lumps of soft tissue left on the stripped bone.
    pub tissue: TissueParams,
    /// Time and motions.
    pub motion: MotionParams,
}

/// The structured-light camera and its view of the bone.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CameraParams {
    /// Points of each cloud. 20,000: the paper's.
    #[param(20_000, 100..=500_000)]
    pub n_points: usize,
    /// Distance from the camera to the bone's surface. 200: the paper's working distance.
    #[param(200.0, 50.0..=1000.0)]
    pub working_distance_mm: f64,
    /// Start of the stripped bone, along the bone from the malleolus tip. 70: other simulator.
    #[param(70.0, 0.0..=450.0)]
    pub scan_from_mm: f64,
    /// End of the stripped bone, along the bone from the malleolus tip. 165: other simulator.
    #[param(165.0, 0.0..=450.0)]
    pub scan_to_mm: f64,
    /// Whether the wound's bed and the skin around the stripped bone are seen, too. false: in the paper the region of interest
    /// excludes them.
    pub surroundings: bool,
    /// Direction from the bone to the camera, from lateral (0) towards posterior (90). 45: both faces with landmarks are seen
    /// at about 45 degrees.
    #[param(45.0, -180.0..=180.0)]
    pub view_azimuth_deg: f64,
    /// Standard deviation, per axis, of the camera's attitude from that view. 3: assumed, hand-held.
    #[param(3.0, 0.0..=15.0)]
    pub view_spread_deg: f64,
    /// Standard deviation of the depth of single points, at normal incidence. 0.05: 0.045 to 0.051 in laser scans of the
    /// Stanford repository.
    #[param(0.05, 0.0..=2.0)]
    pub depth_noise_mm: f64,
    /// Depth noise grows as 1 / cos(incidence) to this power. 1: assumed, as a slanted pixel spreads.
    #[param(1.0, 0.0..=4.0)]
    pub depth_noise_growth: f64,
    /// Maximum angle of incidence of a point. 72: other simulator.
    #[param(72.0, 10.0..=89.0)]
    pub max_incidence_deg: f64,
    /// Share of pixels that fail at random. 0.02: other simulator.
    #[param(0.02, 0.0..=0.9)]
    pub dropout: f64,
    /// Number of round patches that are missing, drawn for each cloud: highlights, drops of blood. 3: other simulator.
    #[param(3, 0..=100)]
    pub n_patches: u32,
    /// Their radius. 1.2: other simulator.
    #[param(1.2, 0.0..=20.0)]
    pub patch_radius_mm: f64,
    /// Number of round pools of blood on the bone, none on a mark, the same in all clouds of a run. 0: off; assumed 3 in a
    /// bleeding wound.
    #[param(0, 0..=100)]
    pub n_pools: u32,
    /// Their radius. 3: assumed, a large drop.
    #[param(3.0, 0.0..=20.0)]
    pub pool_radius_mm: f64,
    /// Share of the bone's pixels that fail where it reflects the projector into the lens, drawn for each cloud. 0: off, a bone
    /// wiped dry; assumed 0.7 for a wet one.
    #[param(0.0, 0.0..=1.0)]
    pub specular_dropout: f64,
    /// Maximum angle between the surface's normal and that of the reflection. 8: assumed, a wet surface.
    #[param(8.0, 0.0..=45.0)]
    pub specular_deg: f64,
    /// Distance from the lens to the projector, along the camera's x. 80: assumed, the baseline of a hand-held scanner.
    #[param(80.0, 0.0..=1000.0)]
    pub projector_mm: f64,
    /// RMS of the smooth error in depth that the camera's own calibration leaves: one field for all clouds of a run. 0.05:
    /// other simulator.
    #[param(0.05, 0.0..=2.0)]
    pub depth_bias_mm: f64,
    /// Wavelength of that error. 60: assumed, a few periods over the field of view.
    #[param(60.0, 10.0..=1000.0)]
    pub depth_bias_wavelength_mm: f64,
    /// Seed of that field. None: the run's seed; a number keeps one camera in many procedures.
    pub bias_seed: Option<u64>,
    /// RMS of the error across the surface that points within some millimetres share, as of fringes, laser lines and lenses:
    /// one field in the camera's space for a run. 0.075: residuals then have the 0.09 to 0.1 of the Stanford scans. 0: off.
    #[param(0.075, 0.0..=2.0)]
    pub surface_error_mm: f64,
    /// Wavelength of that error. 20: residuals are then correlated by 0.55 at 2 mm and 0.42 at 4 mm, as in the Stanford scans
    /// (docs/method/simulation.md).
    #[param(20.0, 1.0..=200.0)]
    pub surface_error_wavelength_mm: f64,
    /// Share of the points that are outliers, within 0.5 mm of where the surface ends in the image. 0.025: 1.4 % of the
    /// residuals are then beyond five standard deviations, 1 to 2 % in the Stanford scans. 0: off.
    #[param(0.025, 0.0..=0.2)]
    pub edge_outliers: f64,
    /// Standard deviation of an outlier's error across the surface. 1: assumed; two thirds are then beyond 0.45 mm.
    #[param(1.0, 0.0..=20.0)]
    pub edge_outlier_mm: f64,
    /// Factor of every coordinate of the camera: clouds, region of interest, holes of the check piece. 1: off; 0.001: metres
    /// taken for millimetres.
    #[param(1.0, 0.000_001..=1_000_000.0)]
    pub unit_factor: f64,
    /// Excess of the coordinates of the bone's clouds, the region of interest and the check piece at the bone, not of the
    /// phantom's scan: a camera that warmed up or was bumped since its calibration. 0: off.
    #[param(0.0, -20.0..=20.0)]
    pub scale_percent: f64,
    /// Excess of z alone in the same clouds: a baseline or focal length that has changed since. 0: off.
    #[param(0.0, -20.0..=20.0)]
    pub depth_percent: f64,
    /// Time that a cloud of the bone takes, half of it before its stamp; bone and camera move in it. 0: an instant, nearly as
    /// the paper's camera; a line swept by hand takes some seconds.
    #[param(0.0, 0.0..=3.0)]
    pub scan_s: f64,
    /// Direction in the image in which a cloud is swept. 0: along the bone, proximally; 90: across it.
    #[param(0.0, -360.0..=360.0)]
    pub sweep_deg: f64,
    /// Whether clouds of the bone have a column `t`, the time of each point in seconds from their stamp. false: few files have
    /// it.
    pub point_times: bool,
}

/// The localiser, which measures the markers' poses in frame `world`.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TrackerParams {
    /// Samples per second. 20: other simulator.
    #[param(20.0, 2.0..=1000.0)]
    pub rate_hz: f64,
    /// Share of samples that are lost. 0.03: other simulator.
    #[param(0.03, 0.0..=0.9)]
    pub lost: f64,
    /// Mean number of samples that are lost in a row. 0: each is lost by itself, as in the test data of PLUS (gaps of two
    /// periods, 4 of 995); more: a marker that is hidden for a moment.
    #[param(0.0, 0.0..=1000.0)]
    pub lost_run: f64,
    /// Standard deviation, per axis, of the constant error of a marker at one place. 0.06: other simulator.
    #[param(0.06, 0.0..=2.0)]
    pub placement_mm: f64,
    /// Standard deviation of that error about each axis. 0.023 (0.0004 rad): other simulator.
    #[param(0.023, 0.0..=2.0)]
    pub placement_deg: f64,
    /// Standard deviation, per axis, of a sample's noise. 0.03: other simulator.
    #[param(0.03, 0.0..=2.0)]
    pub noise_mm: f64,
    /// Standard deviation of that noise about each axis. 0.0115 (0.0002 rad): other simulator.
    #[param(0.0115, 0.0..=2.0)]
    pub noise_deg: f64,
    /// Correlation of the noise of successive samples. 0.85: markers at rest in the test data of PLUS have 0.7 to 0.96. 0:
    /// white noise.
    #[param(0.85, 0.0..=0.999)]
    pub noise_lag1: f64,
    /// Step of the coordinates, as a localiser writes them. 0.01: optical streams of PLUS; electromagnetic ones have 0.11. 0:
    /// off.
    #[param(0.01, 0.0..=1.0)]
    pub step_mm: f64,
    /// Share of samples that repeat the one before to the bit. 0.1: assumed for an optical localiser; an electromagnetic stream
    /// of PLUS repeats 634 of 800. 0: off.
    #[param(0.1, 0.0..=0.99)]
    pub repeats: f64,
    /// Drift of the localiser's world, in one direction per run. 0.05: assumed, a localiser that warms up.
    #[param(0.05, 0.0..=5.0)]
    pub drift_mm_per_min: f64,
    /// Time for which a marker is tracked before and after each cloud, beyond half of `camera.scan_s`. 0.6: assumed, a dozen
    /// samples; 1.9: throughout.
    #[param(0.6, 0.1..=1.9)]
    pub burst_s: f64,
    /// Time by which all poses are stamped too late: the localiser's transport, or its clock. It shows where a marker moves. 0:
    /// off.
    #[param(0.0, 0.0..=1.0)]
    pub late_s: f64,
    /// Whether there is no localiser, as in vivo: the camera at the full scan is the world, its marker's poses are identities,
    /// and bone marker, stylus and check piece are absent. false: the paper's bench.
    pub none: bool,
}

/// The laser pointer; its spot blinds the camera.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LaserParams {
    /// Radius around the spot within which the camera measures nothing. 2: the paper's hole.
    #[param(2.0, 0.2..=10.0)]
    pub hole_radius_mm: f64,
    /// Standard deviation of aiming across the bone. 0.6: other simulator.
    #[param(0.6, 0.0..=5.0)]
    pub aim_across_mm: f64,
    /// Standard deviation of aiming along the bone. 0.7: other simulator.
    #[param(0.7, 0.0..=30.0)]
    pub aim_along_mm: f64,
    /// Maximum number of attempts to aim at a mark, each with its own error, until the camera sees a third of the laser's disc
    /// on the bone (assumed); else the attempt with the largest share counts. 1: other simulator; a surgeon who watches the
    /// screen would make perhaps 3 (assumed).
    #[param(1, 1..=100)]
    pub max_attempts: usize,
    /// Shape of the hole. `ball`, the surface within the radius: other simulator. `beam`: the surface in the beam, elongated
    /// where it is slanted.
    pub disc: LaserDisc,
    /// Standard deviation, about each axis across it, of the beam's direction from the camera's ray. 10: assumed, a pointer
    /// held beside the camera.
    #[param(10.0, 0.0..=30.0)]
    pub beam_deg: f64,
    /// Whether scans with the laser are taken. true: the paper's method; false: to start from ruled marks or by shape alone, so
    /// the stripped bone need not show the landmarks.
    #[param(true)]
    pub scans: bool,
    /// Whether the laser also points at the assessment marks, after the landmarks, as in vivo. false: the paper's bench, where
    /// a stylus touches them.
    pub assessment: bool,
    /// Marks whose laser scans have a wrong label: each has the label of the next in the list, the last that of the first.
    /// Empty: off.
    pub swap: Vec<String>,
}

/// The shape of a laser spot's hole.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LaserDisc {
    /// The surface within the radius of the spot.
    #[default]
    Ball,
    /// The surface in the beam: a disc across it, elongated where the surface is slanted, and cut off where the surface
    /// ends, as on a ridge.
    Beam,
}

/// The colour images that the camera takes at each scan with the laser. The paper's camera takes none.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ImageParams {
    /// Whether images are taken. false: the paper's camera has no colour.
    pub taken: bool,
    /// Width. 640: assumed, a small depth camera.
    #[param(640, 16..=4096)]
    pub width_px: u32,
    /// Height. 480: assumed.
    #[param(480, 16..=4096)]
    pub height_px: u32,
    /// Horizontal field of view. 40: 146 mm at the working distance, so the stripped bone is in the image.
    #[param(40.0, 5.0..=120.0)]
    pub field_deg: f64,
    /// What marks the landmark: the `laser`'s spot, or a violet disc drawn with a `pen`, with the laser off. `laser`: the
    /// paper's.
    pub mark: ImageMark,
    /// Radius of a pen's mark. 1: assumed.
    #[param(1.0, 0.1..=10.0)]
    pub pen_radius_mm: f64,
    /// Brightness of bone that faces the lamp, relative to white. 0.6: assumed; the bone is then not saturated.
    #[param(0.6, 0.0..=10.0)]
    pub exposure: f64,
    /// Irradiance of the laser at its centre, relative to white; at the hole's radius it is 0.12. 8: assumed; the core then
    /// saturates all channels.
    #[param(8.0, 0.3..=1000.0)]
    pub laser_peak: f64,
    /// Number of white highlights on the bone, drawn for each image. 3: assumed, a wet bone.
    #[param(3, 0..=100)]
    pub n_glare: u32,
    /// Radius at which a highlight has fallen to a third. 1: assumed.
    #[param(1.0, 0.1..=20.0)]
    pub glare_radius_mm: f64,
    /// Brightness of a second reflection of the laser on the bone, relative to the spot. 0: off.
    #[param(0.0, 0.0..=1.0)]
    pub reflection: f64,
    /// Standard deviation of each channel's noise, levels of 255. 2: assumed.
    #[param(2.0, 0.0..=50.0)]
    pub noise_levels: f64,
}

/// What marks a landmark in an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ImageMark {
    /// The laser's spot.
    #[default]
    Laser,
    /// A violet disc at the mark, drawn with a surgical pen, with the laser off; one mark at a time.
    Pen,
}

/// The calibration phantom as printed, and the support that carries the camera's marker.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PhantomParams {
    /// Standard deviation, per axis, of the printed phantom marker against its CAD. 0.05: other simulator.
    #[param(0.05, 0.0..=2.0)]
    pub print_mm: f64,
    /// Standard deviation of that error about each axis. 0.023 (0.0004 rad): other simulator.
    #[param(0.023, 0.0..=2.0)]
    pub print_deg: f64,
    /// Seed of that error. None: the run's seed; a number keeps one phantom in many procedures.
    pub print_seed: Option<u64>,
    /// Standard deviation, per axis, of the camera marker against its nominal pose. 1.5: assumed, "good to a few mm".
    #[param(1.5, 0.0..=10.0)]
    pub mounting_mm: f64,
    /// Standard deviation of that pose about each axis. 1.2: assumed, about 2 degrees in all.
    #[param(1.2, 0.0..=10.0)]
    pub mounting_deg: f64,
    /// Seed of that pose. None: the run's seed; a number keeps one support in many procedures.
    pub mounting_seed: Option<u64>,
    /// Distance from the camera to the phantom, half its radius nearer than its centre. None: the working distance.
    #[param(None, 50.0..=1000.0)]
    pub distance_mm: Option<f64>,
    /// Factor of every coordinate in the phantom's scan, from the lens. 1: off; 1.05: the camera's scale was 5 % too large at
    /// the calibration alone.
    #[param(1.0, 0.000_001..=1_000_000.0)]
    pub scan_scale: f64,
    /// Whether the phantom's scan is a mirror image, its x negated. false: off.
    pub scan_mirrored: bool,
    /// Error of `t_phantom_phantom_marker` in the recording, in a direction drawn per run; the plan has none. 0: off.
    #[param(0.0, 0.0..=500.0)]
    pub marker_cad_wrong_mm: f64,
    /// Rotation of that pose, about an axis drawn per run. 0: off.
    #[param(0.0, 0.0..=180.0)]
    pub marker_cad_wrong_deg: f64,
}

/// A printed piece with twelve holes and a marker, which the camera sees at the places of the phantom and the bone.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CheckParams {
    /// Standard deviation, per axis, of a hole as read from the cloud. 0.1: assumed, half the spacing of the points.
    #[param(0.1, 0.0..=5.0)]
    pub reading_mm: f64,
    /// Standard deviation, per axis, of a printed hole against the piece's CAD. 0.05: as the phantom's.
    #[param(0.05, 0.0..=2.0)]
    pub print_mm: f64,
    /// Seed of that error. None: the run's seed; a number keeps one piece in many procedures.
    pub print_seed: Option<u64>,
}

/// Errors of the marks on the bone, which are measured off from the malleolus with a ruler and moved back onto the
/// surface. The laser, the holes and the stylus follow the marks.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RulerParams {
    /// Standard deviation, along the bone, of the origin of all marks, the malleolus under the skin. 0: off.
    #[schemars(range(min = 0.0, max = 30.0))]
    pub shared_mm: f64,
    /// Standard deviation, along the bone, of each mark. 0: off.
    #[schemars(range(min = 0.0, max = 30.0))]
    pub each_mm: f64,
    /// Standard deviation, across the bone, of each mark. 0: off.
    #[schemars(range(min = 0.0, max = 30.0))]
    pub across_mm: f64,
}

/// A patchy film on the bone, which the camera sees instead of the bone, always closer. The stylus pierces it.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PeriosteumParams {
    /// Maximum thickness. 0: off, a bone scraped clean; assumed up to 0.5 otherwise.
    #[param(0.0, 0.0..=3.0)]
    pub thickness_mm: f64,
    /// Share of the surface that is covered, on average over seeds. 0.5: assumed.
    #[param(0.5, 0.01..=0.99)]
    pub share: f64,
    /// Wavelength of the patches. 15: assumed, a few strokes of a scraper.
    #[param(15.0, 1.0..=500.0)]
    pub patch_mm: f64,
    /// Thickness, at the end of the stripped stretch, of a film that grows evenly from 0 at its start: blood that ran down, or
    /// a scraper that was lifted. 0: off.
    #[param(0.0, 0.0..=3.0)]
    pub grows_mm: f64,
    /// Thickness, on the posterior side, of a film that grows evenly around the bone from 0 on the lateral side. 0: off.
    #[param(0.0, 0.0..=3.0)]
    pub around_mm: f64,
    /// Seed of the patches. None: the run's seed; a number keeps one stripped bone in many procedures.
    pub film_seed: Option<u64>,
}

/// Lumps of soft tissue on the stripped bone, none on a mark, in the same place in all clouds of a run. They hide what is
/// behind them. The stylus pierces them.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TissueParams {
    /// Share of the bone's visible pixels that is covered by at least half the minimum thickness. 0: off.
    #[param(0.0, 0.0..=0.9)]
    pub share: f64,
    /// Minimum and maximum thickness of a lump at its top. 1 to 6: assumed, remains of muscle.
    #[param([1.0, 6.0])]
    #[schemars(inner(range(min = 0.1, max = 20.0)))]
    pub thickness_mm: [f64; 2],
    /// Minimum and maximum diameter of a lump; the last is as small as the share requires. 10 to 25: assumed.
    #[param([10.0, 25.0])]
    #[schemars(inner(range(min = 2.0, max = 100.0)))]
    pub patch_mm: [f64; 2],
    /// Seed of the lumps. None: the run's seed; a number keeps one stripped bone in many procedures.
    pub seed: Option<u64>,
}

/// The tracked stylus: the reference of the assessment, and the baseline method.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StylusParams {
    /// Standard deviation, per axis, of the tip's constant error, which its calibration left. 0.1: other simulator.
    #[param(0.1, 0.0..=5.0)]
    pub tip_mm: f64,
    /// Standard deviation, per axis, of each touch of a mark or hole. 0.1: other simulator.
    #[param(0.1, 0.0..=5.0)]
    pub touch_mm: f64,
    /// Points palpated on the surface. 300: the paper's baseline.
    #[param(300, 0..=10_000)]
    pub n_palpated: usize,
    /// Standard deviation, per axis, of a palpation's constant error, beyond the tip's. 0.3: other simulator.
    #[param(0.3, 0.0..=5.0)]
    pub palpation_bias_mm: f64,
    /// Standard deviation, per axis, of each palpated point. 0.25: other simulator.
    #[param(0.25, 0.0..=5.0)]
    pub palpation_mm: f64,
    /// Number of poses of a pivot calibration before the procedure, whose error the tip then has; the stylus' marker is tracked
    /// at every touch. 0: none, `tip_mm` holds.
    #[param(0, 0..=10_000)]
    pub pivot_poses: usize,
    /// Maximum tilt of the stylus in that calibration. 30: assumed, as markers stay in view.
    #[param(30.0, 1.0..=80.0)]
    pub pivot_deg: f64,
    /// Standard deviation, per axis, of the tip's position in the dimple. 0.05: assumed.
    #[param(0.05, 0.0..=2.0)]
    pub dimple_mm: f64,
}

/// Start of the procedure, and its motions.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MotionParams {
    /// Start of the procedure, seconds since the Unix epoch. 1,750,000,000 (15 June 2025): never 0, which viewers refuse.
    #[param(1_750_000_000, 1.0..=4_000_000_000.0)]
    pub start_s: u32,
    /// Motion of the bone after all scans and touches, in a direction drawn per run. 60: assumed, a leg that is repositioned.
    #[param(60.0, 0.0..=500.0)]
    pub bone_mm: f64,
    /// Rotation of the bone in that motion. 7: assumed.
    #[param(7.0, 0.0..=90.0)]
    pub bone_deg: f64,
    /// Motion of the bone between two scans, drawn each time. 0: the leg is held (assumed).
    #[param(0.0, 0.0..=100.0)]
    pub bone_between_scans_mm: f64,
    /// Rotation of the bone between two scans. 0: the leg is held (assumed).
    #[param(0.0, 0.0..=30.0)]
    pub bone_between_scans_deg: f64,
    /// Motion of the camera between two scans of the bone, drawn each time. 0: it is on an arm (assumed).
    #[param(0.0, 0.0..=100.0)]
    pub camera_between_scans_mm: f64,
    /// Rotation of the camera between two scans. 0: it is on an arm (assumed).
    #[param(0.0, 0.0..=30.0)]
    pub camera_between_scans_deg: f64,
    /// Speed of the camera for a second before and after each cloud of the bone, in a direction drawn per run. 0: it is held
    /// still.
    #[param(0.0, 0.0..=200.0)]
    pub camera_speed_mm_s: f64,
    /// Turn of the camera in that time, about what it looks at. 0: off.
    #[param(0.0, 0.0..=90.0)]
    pub camera_speed_deg_s: f64,
    /// Speed of the bone, as `camera_speed_mm_s`. 0: the leg is held.
    #[param(0.0, 0.0..=200.0)]
    pub bone_speed_mm_s: f64,
    /// Turn of the bone in that time, about the middle of its scan. 0: off.
    #[param(0.0, 0.0..=90.0)]
    pub bone_speed_deg_s: f64,
    /// Distance by which the bone is carried away and back between two clouds, each way in a second at up to 1.5 times this per
    /// second, in a direction drawn each time. 0: off.
    #[param(0.0, 0.0..=500.0)]
    pub carry_mm: f64,
    /// Rotation of the bone on that way. 0: off.
    #[param(0.0, 0.0..=90.0)]
    pub carry_deg: f64,
    /// Time for which the bone is sawed after the touches, before its last motion: it shakes with its marker. 0: off.
    #[param(0.0, 0.0..=60.0)]
    pub saw_s: f64,
    /// Amplitude of that shaking, in a direction drawn per run. 1: assumed, a leg in an assistant's hands.
    #[param(1.0, 0.0..=20.0)]
    pub saw_mm: f64,
    /// Rotation of the bone in that shaking. 0.5: assumed.
    #[param(0.5, 0.0..=20.0)]
    pub saw_deg: f64,
    /// Frequency of that shaking. 5: assumed, strokes of a hand and what the saw leaves of them.
    #[param(5.0, 0.1..=50.0)]
    pub saw_hz: f64,
    /// Slip of the bone's marker, in a direction drawn per run. 0: off.
    #[param(0.0, 0.0..=20.0)]
    pub marker_slip_mm: f64,
    /// Rotation of that marker. 0: off.
    #[param(0.0, 0.0..=30.0)]
    pub marker_slip_deg: f64,
    /// When it slips: before the `touches`, after all scans; or before the `laser` scans, after the full scan.
    pub marker_slips_before: SlipsBefore,
    /// Shift of the camera's marker on the camera between the calibration and the full scan, in a direction drawn per run. 0:
    /// off.
    #[param(0.0, 0.0..=200.0)]
    pub knock_mm: f64,
    /// Rotation of that marker. 0: off.
    #[param(0.0, 0.0..=180.0)]
    pub knock_deg: f64,
}

/// Scans of the bone during its last motion.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StreamParams {
    /// Scans per second. 5: assumed, a structured-light camera that projects a dozen patterns for each cloud.
    #[param(5.0, 0.1..=100.0)]
    pub rate_hz: f64,
    /// Number of scans. 40: a second of rest, six of motion and one of rest.
    #[param(40, 1..=10_000)]
    pub n_scans: u32,
    /// Duration of the motion by `motion.bone_mm` and `motion.bone_deg`. 6: assumed, a leg that is repositioned; at most 3.75
    /// mm from scan to scan at 5 Hz and 60 mm.
    #[param(6.0, 0.1..=600.0)]
    pub motion_s: f64,
}

/// The time at which the bone's marker slips.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SlipsBefore {
    /// Between the last scan and the touches.
    #[default]
    Touches,
    /// Between the full scan and the first laser scan.
    Laser,
}

impl ProcedureParams {
    /// Checks the declared range of every number, and what must hold between two of them.
    ///
    /// # Errors
    /// [`SimulationError::Parameter`] of the first that is refused.
    pub fn check(&self) -> Result<(), SimulationError> {
        ranges::check("", self)?;
        let (camera, tissue) = (&self.camera, &self.tissue);
        let ([thinnest, thickest], [smallest, largest]) = (tissue.thickness_mm, tissue.patch_mm);
        check_rules([
            ("camera.scan_to_mm", camera.scan_to_mm, camera.scan_to_mm > camera.scan_from_mm, "beyond scan_from_mm"),
            ("the maximum of tissue.thickness_mm", thickest, thickest >= thinnest, "at least the minimum"),
            ("the maximum of tissue.patch_mm", largest, largest >= smallest, "at least the minimum"),
            // Left out, it has no value, as a NaN in JSON.
            ("phantom.distance_mm", self.phantom.distance_mm.unwrap_or(0.0), true, "a finite number"),
        ])
    }
}
