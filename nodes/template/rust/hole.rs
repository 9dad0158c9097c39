//! A hole detector as a starting point: change it, build it, and run the graph again.

use osteoflow_node::{
    Context, Describe, Function, Inputs, NodeError, Outputs, schemars::JsonSchema, serde::Deserialize,
};
use osteoflow_payloads::{
    Metrics,
    algorithms::nearest::Nearest,
    geometry::{
        Cloud, NamedPoint, Points,
        nalgebra::{Point3, Vector3},
    },
};

/// Missing points at most this many times `radius_mm` apart are of one hole: more than the spacing of a scan.
const LINK: f64 = 1.5;

/// The landmark under a laser spot: the centre of the largest patch of the full scan that the scan with the laser lacks.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "my_plugin.difference"
in   = { reference = "to_bone.cloud", cloud = "to_bone_laser.cloud" }
radius_mm = 1.0
"#,
    literature = ["section 2.3 of the paper"]
)]
pub struct Difference;

/// Parameters of [`Difference`].
#[osteoflow_node::params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(crate = "osteoflow_node::serde", default, deny_unknown_fields)]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct Params {
    /// A point of the full scan is missing if the scan with the laser has none nearer. 1: twice the spacing of a scan.
    #[param(1.0, 0.01..=20.0)]
    radius_mm: f64,
    /// Minimum number of points of a hole. 15: a spot of 2 mm radius leaves thirty.
    #[param(15, 3..=100_000)]
    min_points: usize,
}

/// The ports of every hole detector, so that graphs can switch to this one by its kind.
#[derive(Inputs)]
pub struct In {
    /// The full scan.
    #[port(join = "once", frame = "cloud")]
    reference: Cloud,
    /// A scan with the laser spot, labelled with the landmark's name.
    #[port(frame = "reference")]
    cloud: Cloud,
}

/// The outputs.
#[derive(Outputs)]
pub struct Out {
    /// The landmark under the spot, with its name.
    #[port(frame = "cloud")]
    point: Points,
    /// Missing points, those of the hole, and its radius.
    report: Metrics,
}

impl Function for Difference {
    const KIND: &'static str = "my_plugin.difference";
    type Params = Params;
    type Inputs = In;
    type Outputs = Out;

    fn process(params: &Params, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        i.cloud.frame.expect(&i.reference.frame, "the scan with the laser")?;
        let Params { radius_mm, min_points } = *params;
        let tree = Nearest::new(i.cloud.points());
        let is_missing = |p: &Point3<f64>| tree.nearest(p).is_none_or(|(_, square)| square > radius_mm * radius_mm);
        let missing: Vec<_> = i.reference.points().iter().copied().filter(is_missing).collect();
        let hole = largest_patch(&missing, LINK * radius_mm);
        if hole.len() < min_points {
            return Err(NodeError::new(format!(
                "{} points are missing, {} of them in one place, {min_points} are needed; is the laser on the bone?",
                missing.len(),
                hole.len()
            )));
        }
        let n = hole.len() as f64;
        let centre = Point3::from(hole.iter().map(|p| p.coords).sum::<Vector3<f64>>() / n);
        // A disc of radius r has a mean squared distance of r²/2 from its centre; points at its rim are not missing.
        let squares: f64 = hole.iter().map(|p| (p - centre).norm_squared()).sum();
        let hole_radius_mm = (2.0 * squares / n).sqrt() + radius_mm;
        let name = i.cloud.label.clone().unwrap_or_else(|| "hole".into());
        let point = NamedPoint { stamp_ns: i.cloud.stamp_ns, ..NamedPoint::new(name, centre) };
        let report =
            [("n_missing", missing.len() as f64, ""), ("n_hole", n, ""), ("hole_radius", hole_radius_mm, "mm")];
        Ok(Out { point: Points::new(i.cloud.frame.clone(), [point]), report: Metrics::new(report)? })
    }
}

/// The largest set of points that are connected by steps of at most `link_mm`.
fn largest_patch(points: &[Point3<f64>], link_mm: f64) -> Vec<Point3<f64>> {
    let tree = Nearest::new(points);
    let mut seen = vec![false; points.len()];
    let mut largest = Vec::new();
    for first in 0..points.len() {
        let (mut patch, mut next) = (Vec::from_iter((!seen[first]).then_some(first)), 0);
        seen[first] = true;
        while let Some(&point) = patch.get(next) {
            let near = tree.within(&points[point], link_mm).into_iter().map(|(near, _)| near);
            patch.extend(near.filter(|&near| !std::mem::replace(&mut seen[near], true)));
            next += 1;
        }
        if patch.len() > largest.len() {
            largest = patch;
        }
    }
    largest.into_iter().map(|point| points[point]).collect()
}

osteoflow_node::export!(Difference);

#[cfg(test)]
mod tests {
    use super::*;

    /// A plane of 61 x 61 points, 0.5 mm apart, without those nearer to (3, 4) than `radius_mm`.
    fn plane(radius_mm: f64) -> Cloud {
        let place = |k: u32| Point3::new(f64::from(k % 61) * 0.5 - 15.0, f64::from(k / 61) * 0.5 - 15.0, 200.0);
        let outside = |p: &Point3<f64>| (p - Point3::new(3.0, 4.0, 200.0)).norm() >= radius_mm;
        let points: Vec<_> = (0..61 * 61).map(place).filter(outside).collect();
        Cloud::new("camera", points).unwrap().labelled("P1")
    }

    fn found(radius_mm: f64) -> Result<Out, NodeError> {
        let input = In { reference: plane(0.0), cloud: plane(radius_mm) };
        Difference::process(&Params::default(), input, &mut Context::for_test("hole"))
    }

    #[test]
    fn the_centre_of_a_hole_is_found_under_the_name_of_the_scan() {
        let point = found(3.0).unwrap().point.points[0].clone();
        assert_eq!(&*point.name, "P1");
        assert!((point.position - Point3::new(3.0, 4.0, 200.0)).norm() < 1e-9, "{}", point.position);
    }

    #[test]
    fn a_scan_without_a_hole_is_an_error_and_no_point() {
        let message = found(0.0).map(|_| ()).unwrap_err().to_string();
        assert!(message.starts_with("0 points are missing, 0 of them in one place, 15 are needed"), "{message}");
    }
}
