use nalgebra::{Matrix2, Vector2};

/// Largest angle of a ray from the optical axis, rad: image coordinates are its tangent.
const MAX_ANGLE: f64 = 1.562;

/// Step in which the model is searched for the angle at which it turns back, rad.
const ANGLE_STEP: f64 = 1e-3;

/// Number of halvings of an interval: below the rounding of its ends.
const HALVINGS: usize = 60;

/// Number of steps of Newton's method.
const STEPS: usize = 30;

/// Maximum error of an undistorted place, in image coordinates: 1e-7 pixels at a focal length of 1000.
const CONVERGED: f64 = 1e-10;

/// The names that recordings give to models, and the numbers of coefficients they may have.
const BROWN: &[&str] = &["plumb_bob", "rational_polynomial"];
const FISHEYE: &[&str] = &["equidistant", "kannala_brandt", "fisheye"];

/// How the lens of a camera bends rays: from the image coordinates `x / z`, `y / z` of a point to those at which it is seen.
///
/// A model holds within an angle from the optical axis, [`Distortion::limit_rad`], up to which what is farther out is seen farther
/// out. Beyond it a polynomial turns back: points far outside of the field of view would land in the image.
///
/// # Source
/// Brown 1971 with the rational factor of OpenCV; Kannala and Brandt 2006 as OpenCV's `fisheye`. OpenCV 4, module `calib3d`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distortion {
    model: Model,
    /// Tangent of the angle up to which the model holds.
    limit: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Model {
    Pinhole,
    /// k1, k2, p1, p2, k3, k4, k5, k6: OpenCV's order.
    Brown([f64; 8]),
    /// k1 to k4.
    Fisheye([f64; 4]),
}

/// A distortion that cannot be used: what was expected, and what was found.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct DistortionError(String);

impl Default for Distortion {
    fn default() -> Self {
        Self::NONE
    }
}

impl Distortion {
    /// A pinhole.
    pub const NONE: Self = Self { model: Model::Pinhole, limit: f64::INFINITY };

    /// A model by the name that ROS and Foxglove give it, with coefficients in OpenCV's order: `plumb_bob` and
    /// `rational_polynomial` (k1, k2, p1, p2, k3, k4, k5, k6; as many as there are), `equidistant`, `kannala_brandt` and `fisheye`
    /// (k1, k2, k3, k4). Coefficients that are all 0, or none, are a pinhole for the former, whatever the name.
    ///
    /// # Errors
    /// [`DistortionError`] if a model is not known, has another number of coefficients, or one that is not finite.
    pub fn named(name: &str, coefficients: &[f64]) -> Result<Self, DistortionError> {
        let refused = |reason: String| Err(DistortionError(reason));
        if let Some(k) = coefficients.iter().position(|c| !c.is_finite()) {
            return refused(format!("coefficient {} of the distortion is {}", k + 1, coefficients[k]));
        }
        let n = coefficients.len();
        if FISHEYE.contains(&name) {
            return match <[f64; 4]>::try_from(coefficients) {
                Ok(k) => Ok(Self::within_limit(Model::Fisheye(k))),
                Err(_) => {
                    refused(format!("distortion \"{name}\" has {n} coefficients, 4 are expected (k1, k2, k3, k4)"))
                }
            };
        }
        if coefficients.iter().all(|c| *c == 0.0) {
            return Ok(Self::NONE);
        }
        if !BROWN.contains(&name) {
            let name = if name.is_empty() { "unnamed" } else { name };
            return refused(format!(
                "distortion \"{name}\" is not read; {} and {} are; record the rectified image, with its calibration",
                BROWN.join(", "),
                FISHEYE.join(", ")
            ));
        }
        // Behind k6 OpenCV has thin prisms and tilted sensors.
        if !matches!(n, 4 | 5 | 8) && coefficients.get(8..).is_none_or(|rest| rest.iter().any(|c| *c != 0.0)) {
            return refused(format!(
                "distortion \"{name}\" has {n} coefficients, 4, 5 or 8 are expected (k1, k2, p1, p2, k3, k4, k5, k6)"
            ));
        }
        let k = std::array::from_fn(|i| coefficients.get(i).copied().unwrap_or(0.0));
        Ok(Self::within_limit(Model::Brown(k)))
    }

    /// The name of the model; `None` for a pinhole.
    pub fn name(&self) -> Option<&'static str> {
        match self.model {
            Model::Pinhole => None,
            Model::Brown(k) => Some(if k[5..].iter().all(|c| *c == 0.0) { BROWN[0] } else { BROWN[1] }),
            Model::Fisheye(_) => Some(FISHEYE[0]),
        }
    }

    /// The coefficients, which [`Distortion::named`] takes.
    pub fn coefficients(&self) -> Vec<f64> {
        match self.model {
            Model::Pinhole => Vec::new(),
            Model::Brown(k) if self.name() == Some(BROWN[0]) => k[..5].to_vec(),
            Model::Brown(k) => k.to_vec(),
            Model::Fisheye(k) => k.to_vec(),
        }
    }

    /// Angle from the optical axis up to which the model holds, rad.
    pub fn limit_rad(&self) -> f64 {
        self.limit.atan()
    }

    /// Where the point at image coordinates `at` is seen; `None` beyond the angle up to which the model holds.
    pub fn distorted(&self, at: [f64; 2]) -> Option<[f64; 2]> {
        let at = Vector2::from(at);
        let seen = match &self.model {
            Model::Pinhole => return Some(at.into()),
            _ if at.norm() > self.limit => return None,
            Model::Brown(k) => brown(k, &at).0,
            Model::Fisheye(k) => at * fisheye_scale(k, at.norm()),
        };
        Some(seen.into())
    }

    /// The image coordinates of the point that is seen at `seen`; `None` where no point is, within the angle up to which the model
    /// holds.
    pub fn undistorted(&self, seen: [f64; 2]) -> Option<[f64; 2]> {
        let seen = Vector2::from(seen);
        let radius = seen.norm();
        match &self.model {
            Model::Pinhole => Some(seen.into()),
            Model::Fisheye(k) => {
                let (angle, limit) = (|r: f64| r.atan(), self.limit.atan());
                let seen_angle = |angle: f64| angle * fisheye_factor(k, angle);
                if radius == 0.0 {
                    return Some([0.0, 0.0]);
                }
                if radius > seen_angle(angle(self.limit)) {
                    return None;
                }
                Some((seen * (root(limit, |angle| seen_angle(angle) - radius).tan() / radius)).into())
            }
            Model::Brown(k) => {
                // Without its tangential part as a start.
                let start = root(self.limit, |r| r * radial(k, r * r).0 - radius);
                let mut at = if radius > 0.0 { seen * (start / radius) } else { seen };
                for _ in 0..STEPS {
                    let (reached, jacobian) = brown(k, &at);
                    let off = reached - seen;
                    if off.amax() < 1e-15 {
                        break;
                    }
                    at -= jacobian.try_inverse()? * off;
                }
                let (reached, jacobian) = brown(k, &at);
                let holds =
                    (reached - seen).amax() < CONVERGED && at.norm() <= self.limit && jacobian.determinant() > 0.0;
                holds.then_some(at.into())
            }
        }
    }

    /// The model, up to the angle at which what is farther out is no longer seen farther out.
    fn within_limit(model: Model) -> Self {
        let grows = |angle: f64| match &model {
            Model::Pinhole => true,
            Model::Brown(k) => {
                let r = angle.tan();
                let (factor, slope) = radial(k, r * r);
                factor > 0.0 && denominator(k, r * r) > 0.0 && factor + 2.0 * r * r * slope > 0.0
            }
            Model::Fisheye(k) => {
                let square = angle * angle;
                1.0 + square * (3.0 * k[0] + square * (5.0 * k[1] + square * (7.0 * k[2] + square * 9.0 * k[3]))) > 0.0
            }
        };
        let n = (MAX_ANGLE / ANGLE_STEP) as usize;
        let limit = match (1..=n).map(|i| i as f64 * ANGLE_STEP).find(|angle| !grows(*angle)) {
            None => MAX_ANGLE,
            Some(above) => {
                let (mut low, mut high) = (above - ANGLE_STEP, above);
                for _ in 0..HALVINGS {
                    let middle = (low + high) / 2.0;
                    if grows(middle) { low = middle } else { high = middle }
                }
                low
            }
        };
        Self { model, limit: limit.tan() }
    }
}

/// Where a function that grows from a value of at most 0 at 0 is 0, or `limit` if that is farther.
fn root(limit: f64, function: impl Fn(f64) -> f64) -> f64 {
    let (mut low, mut high) = (0.0, limit);
    for _ in 0..HALVINGS {
        let middle = (low + high) / 2.0;
        if function(middle) < 0.0 { low = middle } else { high = middle }
    }
    (low + high) / 2.0
}

fn denominator(k: &[f64; 8], square: f64) -> f64 {
    1.0 + square * (k[5] + square * (k[6] + square * k[7]))
}

/// The radial factor at a squared radius, and its derivative by that.
fn radial(k: &[f64; 8], square: f64) -> (f64, f64) {
    let top = 1.0 + square * (k[0] + square * (k[1] + square * k[4]));
    let bottom = denominator(k, square);
    let top_slope = k[0] + square * (2.0 * k[1] + square * 3.0 * k[4]);
    let bottom_slope = k[5] + square * (2.0 * k[6] + square * 3.0 * k[7]);
    (top / bottom, (top_slope * bottom - top * bottom_slope) / (bottom * bottom))
}

/// Where a point is seen, and the derivative by the point.
fn brown(k: &[f64; 8], at: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
    let (x, y, square) = (at.x, at.y, at.norm_squared());
    let (factor, slope) = radial(k, square);
    let (p1, p2) = (k[2], k[3]);
    let seen = at * factor
        + Vector2::new(2.0 * p1 * x * y + p2 * (square + 2.0 * x * x), p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y);
    let across = 2.0 * (x * y * slope + p1 * x + p2 * y);
    let jacobian = Matrix2::new(
        factor + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
        across,
        across,
        factor + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
    );
    (seen, jacobian)
}

/// The angle at which a ray is seen, over its own.
fn fisheye_factor(k: &[f64; 4], angle: f64) -> f64 {
    let square = angle * angle;
    1.0 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3])))
}

/// The distance from the centre at which a point is seen, over its own.
fn fisheye_scale(k: &[f64; 4], radius: f64) -> f64 {
    let angle = radius.atan();
    if radius > 0.0 { angle * fisheye_factor(k, angle) / radius } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(name: &str, k: &[f64]) -> Distortion {
        Distortion::named(name, k).unwrap()
    }

    /// A wide webcam, a depth camera with a rational model, and a fisheye lens.
    fn cameras() -> [Distortion; 3] {
        [
            named("plumb_bob", &[-0.28, 0.09, 0.0011, -0.0007, -0.012]),
            named("rational_polynomial", &[0.52, -2.6, 0.0006, -0.0002, 1.5, 0.39, -2.4, 1.44]),
            named("equidistant", &[-0.0125, 0.0034, -0.0011, 0.0002]),
        ]
    }

    #[test]
    fn what_opencv_distorts_is_distorted_here_and_undistorted_back() {
        // cv2.projectPoints and cv2.fisheye.distortPoints of opencv-python-headless 5.0.0, of x / z, y / z.
        let cases: [[[f64; 4]; 4]; 3] = [
            [
                [0.0, 0.0, 0.0, 0.0],
                [0.3, -0.2, 0.28917939079999994, -0.1927039272],
                [-0.45, 0.35, -0.41399994062500006, 0.322180509375],
                [0.1, 0.6, 0.0906703164, 0.5459828983999999],
            ],
            [
                [0.0, 0.0, 0.0, 0.0],
                [0.3, -0.2, 0.3039077755119571, -0.2025445170079714],
                [-0.45, 0.35, -0.4616423666998128, 0.3591996185442988],
                [0.1, 0.6, 0.10266753506826844, 0.6166712104096106],
            ],
            [
                [0.0, 0.0, 0.0, 0.0],
                [0.3, -0.2, 0.28751096920286817, -0.1916739794685788],
                [-0.45, 0.35, -0.40771025013067264, 0.31710797232385646],
                [0.1, 0.6, 0.08953058643334533, 0.537183518600072],
            ],
        ];
        for (camera, places) in cameras().iter().zip(cases) {
            for [x, y, seen_x, seen_y] in places {
                let [u, v] = camera.distorted([x, y]).unwrap();
                assert!((u - seen_x).hypot(v - seen_y) < 1e-12, "{camera:?} at {x}, {y}: {u}, {v}");
                let [back_x, back_y] = camera.undistorted([seen_x, seen_y]).unwrap();
                assert!((back_x - x).hypot(back_y - y) < 1e-10, "{camera:?} at {x}, {y}: {back_x}, {back_y}");
            }
        }
    }

    #[test]
    fn the_way_round_matters_and_is_barrel_for_a_negative_k1() {
        let [barrel, ..] = cameras();
        assert!(barrel.distorted([0.5, 0.0]).unwrap()[0] < 0.49, "a barrel draws points inwards");
        assert!(barrel.undistorted([0.5, 0.0]).unwrap()[0] > 0.51);
    }

    #[test]
    fn beyond_the_angle_at_which_the_model_turns_back_there_is_no_point_and_no_ray() {
        // r (1 - 0.3 r²) is largest at r² = 1 / 0.9, where it is two thirds of r.
        let barrel = named("plumb_bob", &[-0.3, 0.0, 0.0, 0.0, 0.0]);
        let turn = (1.0_f64 / 0.9).sqrt();
        assert!((barrel.limit_rad().tan() - turn).abs() < 1e-9, "{}", barrel.limit_rad());
        assert!(barrel.distorted([turn - 1e-6, 0.0]).is_some());
        assert_eq!(barrel.distorted([turn + 1e-6, 0.0]), None);
        // This point would be seen inside of the image, at 0.48.
        assert_eq!(barrel.distorted([1.5, 0.0]), None);
        let widest = turn * 2.0 / 3.0;
        assert!(barrel.undistorted([0.0, widest - 1e-5]).is_some());
        assert_eq!(barrel.undistorted([0.0, widest + 1e-6]), None);
        assert_eq!(barrel.undistorted([5.0, 5.0]), None);
        assert_eq!(named("equidistant", &[0.0; 4]).undistorted([1.58, 0.0]), None, "a right angle from the axis");
    }

    #[test]
    fn every_place_within_the_limit_comes_back() {
        for camera in cameras() {
            let limit = camera.limit_rad().min(1.4);
            for k in 0..2000 {
                let (turn, share) = (f64::from(k) * 2.399_963, (f64::from(k) / 2000.0).sqrt());
                let radius = (limit * share * 0.98).tan();
                let at = [radius * turn.cos(), radius * turn.sin()];
                let Some(seen) = camera.distorted(at) else { panic!("{camera:?} at {at:?}") };
                // Near the limit tangential parts turn some places back.
                match camera.undistorted(seen) {
                    Some(back) => {
                        let off = (back[0] - at[0]).hypot(back[1] - at[1]) / (1.0 + radius);
                        assert!(off < 1e-7 || share > 0.9, "{camera:?} at {at:?}: {off}");
                    }
                    None => assert!(share > 0.9, "{camera:?} at {at:?}"),
                }
            }
        }
    }

    #[test]
    fn models_are_named_as_ros_and_foxglove_name_them_and_others_are_refused() {
        assert_eq!(named("plumb_bob", &[0.0; 5]), Distortion::NONE);
        assert_eq!(named("", &[]), Distortion::NONE);
        assert_eq!(named("none", &[0.0; 5]), Distortion::NONE);
        assert_eq!(named("kannala_brandt", &[0.1; 4]), named("equidistant", &[0.1; 4]));
        assert_ne!(named("equidistant", &[0.0; 4]), Distortion::NONE, "a fisheye without coefficients is no pinhole");
        let padded: Vec<f64> = (0..14).map(|i| if i < 8 { 0.01 } else { 0.0 }).collect();
        assert_eq!(named("rational_polynomial", &padded), named("rational_polynomial", &[0.01; 8]));
        let refused = |name: &str, k: &[f64]| Distortion::named(name, k).unwrap_err().to_string();
        assert!(refused("plumb_bob", &[0.1; 3]).contains("has 3 coefficients, 4, 5 or 8 are expected"));
        assert!(refused("rational_polynomial", &[0.1; 14]).contains("has 14 coefficients"), "tilted sensors");
        assert!(refused("equidistant", &[0.1; 5]).contains("5 coefficients, 4 are expected"));
        assert!(refused("fisheye62", &[0.1; 8]).contains("distortion \"fisheye62\" is not read"));
        assert!(refused("", &[0.1; 5]).contains("\"unnamed\" is not read"));
        assert!(refused("plumb_bob", &[0.1, f64::NAN]).contains("coefficient 2 of the distortion is NaN"));
    }
}
