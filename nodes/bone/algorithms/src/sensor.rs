//! What a scan was measured with, and how that errs.

use osteoflow_node_macros::params;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// 95 % of the lengths of three-dimensional errors are below this many standard deviations of an axis.
const NORM_SIGMAS: f64 = 2.8;

/// Shared error from which a sensor, not the CT's segmentation, decides, mm.
const COARSE_MM: f64 = 0.25;

/// A sensor and how it errs, across the surface, mm.
///
/// Standard deviations, unless said otherwise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sensor {
    /// Its name.
    pub name: String,
    /// Error of single points, which neighbours do not share.
    pub noise_mm: f64,
    /// Error that neighbours share.
    pub patch_mm: f64,
    /// Error that the whole scan shares along the surface's normal.
    pub bias_mm: f64,
    /// Shift of the whole scan along each axis, which no residual shows.
    pub shift_mm: f64,
    /// Share of points that are off by more.
    pub outliers: f64,
    /// Radius of the ball that touches the surface: points lie as far outside.
    pub tip_radius_mm: f64,
}

/// The sensors that are known by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SensorKind {
    /// A structured-light camera. Eiríksson et al. 2016.
    StructuredLight,
    /// A laser line scanner. Feng, Liu and Xi 2001.
    Laser,
    /// A depth camera: projected dots or time of flight. Khoshelham and Elberink 2012; Carfagni et al. 2019.
    DepthCamera,
    /// Tracked ultrasound, freehand. Barratt et al. 2006; Hsu et al. 2009.
    Ultrasound,
    /// A tracked pointer. Wiles, Thompson and Frantz 2004.
    Stylus,
}

impl SensorKind {
    /// All of them, the finest first.
    pub const ALL: [Self; 5] = [Self::StructuredLight, Self::Laser, Self::Stylus, Self::DepthCamera, Self::Ultrasound];

    /// The word for it.
    pub fn word(self) -> &'static str {
        match self {
            Self::StructuredLight => "structured_light",
            Self::Laser => "laser",
            Self::DepthCamera => "depth_camera",
            Self::Ultrasound => "ultrasound",
            Self::Stylus => "stylus",
        }
    }

    /// How it errs, rounded: of the order that is published for it.
    pub fn sensor(self) -> Sensor {
        let [noise_mm, patch_mm, bias_mm, shift_mm, outliers] = match self {
            Self::StructuredLight => [0.05, 0.1, 0.0, 0.0, 0.01],
            Self::Laser => [0.05, 0.1, 0.05, 0.0, 0.02],
            Self::DepthCamera => [0.3, 1.5, 1.0, 0.0, 0.05],
            Self::Ultrasound => [0.6, 1.2, 0.5, 1.2, 0.05],
            Self::Stylus => [0.1, 0.3, 0.1, 0.2, 0.01],
        };
        let name = self.word().into();
        Sensor { name, noise_mm, patch_mm, bias_mm, shift_mm, outliers, tip_radius_mm: 0.0 }
    }
}

/// What a scan was measured with. Without any of it the scan is taken for one of structured light.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SensorParams {
    /// The sensor by its name. What is stated beside it replaces its values.
    pub like: Option<SensorKind>,
    /// Error of single points across the surface, which neighbours do not share (standard deviation).
    #[param(None, 0.0..=100.0)]
    pub noise_mm: Option<f64>,
    /// Error that neighbours share (standard deviation).
    #[param(None, 0.0..=100.0)]
    pub patch_mm: Option<f64>,
    /// Error that the whole scan shares along the surface's normal (standard deviation).
    #[param(None, 0.0..=100.0)]
    pub bias_mm: Option<f64>,
    /// Shift of the whole scan along each axis, as of a probe's calibration (standard deviation).
    #[param(None, 0.0..=100.0)]
    pub shift_mm: Option<f64>,
    /// Share of points that are off by more.
    #[param(None, 0.0..=1.0)]
    pub outliers: Option<f64>,
    /// Radius of the ball of a stylus' tip: the surface is moved outside by it, where the ball's middle was. Negative: inside.
    #[param(None, -100.0..=100.0)]
    pub tip_radius_mm: Option<f64>,
}

impl SensorParams {
    /// The sensor that is stated.
    pub fn sensor(&self) -> Option<Sensor> {
        if *self == Self::default() {
            return None;
        }
        let mut sensor = self.like.unwrap_or(SensorKind::StructuredLight).sensor();
        for (stated, of) in [
            (self.noise_mm, &mut sensor.noise_mm),
            (self.patch_mm, &mut sensor.patch_mm),
            (self.bias_mm, &mut sensor.bias_mm),
            (self.shift_mm, &mut sensor.shift_mm),
            (self.outliers, &mut sensor.outliers),
            (self.tip_radius_mm, &mut sensor.tip_radius_mm),
        ] {
            *of = stated.unwrap_or(*of);
        }
        Some(sensor)
    }

    /// What is stated here, and else there.
    pub fn or(&self, other: &Self) -> Self {
        Self {
            like: self.like.or(other.like),
            noise_mm: self.noise_mm.or(other.noise_mm),
            patch_mm: self.patch_mm.or(other.patch_mm),
            bias_mm: self.bias_mm.or(other.bias_mm),
            shift_mm: self.shift_mm.or(other.shift_mm),
            outliers: self.outliers.or(other.outliers),
            tip_radius_mm: self.tip_radius_mm.or(other.tip_radius_mm),
        }
    }
}

impl Sensor {
    /// Its name in a sentence.
    pub fn words(&self) -> String {
        match self.name.as_str() {
            "structured_light" => "a structured-light camera".into(),
            "laser" => "a laser scanner".into(),
            "depth_camera" => "a depth camera".into(),
            "ultrasound" => "tracked ultrasound".into(),
            "stylus" => "a stylus".into(),
            name => name.to_owned(),
        }
    }

    /// Whether it errs by more over patches than two segmentations of one CT differ by.
    pub fn is_coarse(&self) -> bool {
        self.patch_mm > COARSE_MM
    }

    /// The error of a registration that this sensor cannot be expected to stay below, mm (95 %).
    pub fn attains_mm(&self) -> f64 {
        NORM_SIGMAS * self.shift_mm.hypot(self.bias_mm).hypot(self.patch_mm)
    }

    /// The sensor by name whose noise and shared error are nearest to these, by their ratios.
    pub fn nearest(noise_mm: f64, patch_mm: f64) -> SensorKind {
        let far = |kind: &SensorKind| {
            let of = kind.sensor();
            let ratio = |a: f64, b: f64| (a.max(0.02) / b.max(0.02)).ln();
            ratio(noise_mm, of.noise_mm).hypot(ratio(patch_mm, of.patch_mm))
        };
        let nearest = SensorKind::ALL.into_iter().min_by(|a, b| far(a).total_cmp(&far(b)));
        nearest.unwrap_or(SensorKind::StructuredLight)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_stated_counts_before_what_is_published_and_nothing_stated_is_no_sensor() {
        assert_eq!(SensorParams::default().sensor(), None);
        let stated =
            SensorParams { like: Some(SensorKind::Stylus), tip_radius_mm: Some(0.5), ..SensorParams::default() };
        let expected = Sensor { tip_radius_mm: 0.5, ..SensorKind::Stylus.sensor() };
        assert_eq!(stated.sensor(), Some(expected.clone()));
        let file = SensorParams { noise_mm: Some(0.1), tip_radius_mm: Some(9.0), ..SensorParams::default() };
        assert_eq!(stated.or(&file).sensor(), Some(Sensor { noise_mm: 0.1, ..expected }));
        // A ball of radius zero is stated, too: the default is not.
        assert!(SensorParams { tip_radius_mm: Some(0.0), ..SensorParams::default() }.sensor().is_some());
    }

    #[test]
    fn residuals_are_likened_to_the_sensor_that_has_them() {
        for kind in SensorKind::ALL {
            let Sensor { noise_mm, patch_mm, .. } = kind.sensor();
            let like = Sensor::nearest(1.1 * noise_mm, 0.9 * patch_mm);
            // Of structured light and laser the residuals are the same.
            let is_fine = |kind| matches!(kind, SensorKind::StructuredLight | SensorKind::Laser);
            assert!(like == kind || is_fine(like) && is_fine(kind), "{kind:?}: {like:?}");
        }
        assert_eq!(Sensor::nearest(0.0, 0.0), SensorKind::StructuredLight);
    }

    #[test]
    fn fine_sensors_change_no_limit_and_coarse_ones_attain_less() {
        for kind in SensorKind::ALL {
            let sensor = kind.sensor();
            let is_coarse = !matches!(kind, SensorKind::StructuredLight | SensorKind::Laser);
            assert_eq!(sensor.is_coarse(), is_coarse, "{kind:?}");
            assert_eq!(
                sensor.attains_mm() > 1.5,
                matches!(kind, SensorKind::DepthCamera | SensorKind::Ultrasound),
                "{kind:?}"
            );
        }
    }
}
