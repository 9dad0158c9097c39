//! Transforms that form a tree, and the transform between any two frames of it.

use crate::{Frame, Pose, StampNs};
use nalgebra::Isometry3;
use std::collections::{BTreeMap, BTreeSet};

/// Time by which samples of one moment arrive apart at most.
const LATE_NS: StampNs = 200_000_000;

/// Transforms over time between frames of which each has one parent, as tf of ROS keeps them.
///
/// # Source
/// Foote 2013, "tf: The transform library": between two frames there is the one path through their nearest common ancestor; each
/// transform on it is taken at the same time, between its samples, never beyond them. Here a gap between samples is bounded, too, and
/// a sample in which the tool was not seen is no sample.
#[derive(Debug, Clone, Default)]
pub struct TransformTree {
    edges: BTreeMap<(Frame, Frame), Edge>,
}

/// The samples of one transform, in any order.
#[derive(Debug, Clone, Default)]
struct Edge {
    samples: Vec<(StampNs, Result<Isometry3<f64>, String>)>,
    is_static: bool,
}

/// One transform on the path between two frames.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Step {
    /// The frame that it leads to.
    pub parent: Frame,
    /// The frame that it leads from.
    pub child: Frame,
    /// Whether its inverse is taken.
    pub is_inverse: bool,
}

/// The transform between two frames of a tree over time.
#[derive(Debug, Clone, PartialEq)]
pub struct Chain {
    /// The transforms of which it is the product, from the frame it leads to.
    pub steps: Vec<Step>,
    /// The motion at each stamp at which one of them was measured, or why there is none; if all are static, at
    /// each stamp from which one of them holds.
    pub samples: Vec<(StampNs, Result<Isometry3<f64>, String>)>,
    /// Stamp up to which the motion is settled while samples arrive: each transform has a later sample, or has had none for the longest
    /// gap, and 0.2 s.
    pub settled_ns: StampNs,
}

/// Two frames have no one path between them.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TreeError {
    /// A frame on the way has two parents, so that there are two ways.
    #[error("frame \"{child}\" has the parents {}: between frames of a tree there is one way; choose one of them", .parents.join(" and "))]
    Parents {
        /// The frame.
        child: Frame,
        /// Its parents.
        parents: Vec<String>,
    },
    /// Frames are parents of themselves.
    #[error("frame \"{0}\" is an ancestor of itself")]
    Circle(Frame),
}

impl Chain {
    /// The product in words, such as `t_map_base * t_base_camera` or `the inverse of t_map_camera`.
    pub fn formula(&self) -> String {
        let name = |step: &Step| format!("t_{}_{}", step.parent, step.child);
        match &self.steps[..] {
            [one] if one.is_inverse => format!("the inverse of {}", name(one)),
            steps => {
                let factor =
                    |step: &Step| if step.is_inverse { format!("inverse({})", name(step)) } else { name(step) };
                steps.iter().map(factor).collect::<Vec<_>>().join(" * ")
            }
        }
    }
}

impl TransformTree {
    /// Adds a sample of `t_parent_child`, or why there is none; of stamp 0 it is static, as by [`Self::add_static`], unless others have
    /// stamps.
    pub fn add(&mut self, parent: &Frame, child: &Frame, stamp_ns: StampNs, motion: Result<Isometry3<f64>, String>) {
        let edge = self.edges.entry((parent.clone(), child.clone())).or_default();
        if stamp_ns != 0 && edge.is_static {
            edge.samples.clear();
        }
        edge.is_static = stamp_ns == 0 && (edge.is_static || edge.samples.is_empty());
        edge.samples.push((stamp_ns, motion));
    }

    /// Adds a static `t_parent_child`: it holds from its stamp until the next one, and the first from the beginning. Whether it is taken:
    /// samples over time go before.
    pub fn add_static(&mut self, parent: &Frame, child: &Frame, stamp_ns: StampNs, motion: Isometry3<f64>) -> bool {
        let edge = self.edges.entry((parent.clone(), child.clone())).or_default();
        edge.is_static |= edge.samples.is_empty();
        if edge.is_static {
            edge.samples.push((stamp_ns, Ok(motion)));
        }
        edge.is_static
    }

    /// The pairs of frames, `child -> parent`.
    pub fn pairs(&self) -> Vec<String> {
        self.edges.keys().map(|(parent, child)| format!("{child} -> {parent}")).collect()
    }

    /// `t_to_from` over time, by the one path between the frames; none if they are not connected.
    ///
    /// Between samples up to `max_gap_ns` apart a transform is interpolated, linear in the origin of the child, SLERP in the rotation.
    /// `O(n log n)` in the number of samples on the path.
    ///
    /// # Errors
    /// [`TreeError`] if the frames on the way form no tree.
    pub fn chain(&self, to: &Frame, from: &Frame, max_gap_ns: StampNs) -> Result<Option<Chain>, TreeError> {
        let Some(steps) = self.path(to, from)? else { return Ok(None) };
        let mut edges = Vec::new();
        for step in &steps {
            let mut edge = self.edges[&(step.parent.clone(), step.child.clone())].clone();
            edge.samples.retain(|(stamp_ns, _)| edge.is_static || *stamp_ns != 0);
            edge.samples.sort_by_key(|(stamp_ns, _)| *stamp_ns);
            edges.push(edge);
        }
        let moves = edges.iter().any(|edge| !edge.is_static);
        let timed = edges.iter().filter(|edge| edge.is_static != moves);
        let stamps: BTreeSet<StampNs> = timed.flat_map(|edge| edge.samples.iter().map(|(stamp, _)| *stamp)).collect();
        let stamps = if steps.is_empty() { BTreeSet::from([0]) } else { stamps };
        let at = |stamp_ns: StampNs| {
            let mut product = Isometry3::identity();
            for (edge, step) in edges.iter().zip(&steps) {
                let motion = edge.at(stamp_ns, max_gap_ns);
                let motion = motion.map_err(|reason| format!("t_{}_{} {reason}", step.parent, step.child))?;
                product *= if step.is_inverse { motion.inverse() } else { motion };
            }
            // Products of unit quaternions drift from length 1 by a bit each.
            product.rotation.renormalize();
            Ok(product)
        };
        let samples = stamps.into_iter().map(|stamp_ns| (stamp_ns, at(stamp_ns))).collect();
        let moving = edges.iter().filter(|edge| !edge.is_static);
        let lasts = moving.map(|edge| edge.samples.last().map_or(StampNs::MIN, |(stamp, _)| *stamp));
        let (first, last) = (lasts.clone().min(), lasts.max().unwrap_or(StampNs::MAX));
        let settled_ns = first.map_or(StampNs::MAX, |first| first.max(last.saturating_sub(max_gap_ns.max(LATE_NS))));
        Ok(Some(Chain { steps, samples, settled_ns }))
    }

    /// Forgets the samples before a stamp but the last of each transform, which later stamps need; static ones stay.
    pub fn forget(&mut self, before_ns: StampNs) {
        for edge in self.edges.values_mut().filter(|edge| !edge.is_static) {
            edge.samples.sort_by_key(|(stamp_ns, _)| *stamp_ns);
            let n_before = edge.samples.partition_point(|(stamp_ns, _)| *stamp_ns < before_ns);
            edge.samples.drain(..n_before.saturating_sub(1));
        }
    }

    /// The transforms from `to` up to the nearest common ancestor, and down to `from`.
    fn path(&self, to: &Frame, from: &Frame) -> Result<Option<Vec<Step>>, TreeError> {
        let (up, down) = (self.ancestors(to), self.ancestors(from));
        let (above_to, above_from) = (up.frames(), down.frames());
        let Some(n_up) = above_to.iter().position(|frame| above_from.contains(frame)) else {
            // Frames that have two parents hide what is above them.
            return up.end.and(down.end).map(|()| None);
        };
        let n_down = above_from.iter().position(|frame| *frame == above_to[n_up]).unwrap_or_default();
        let step = |pair: &[Frame], is_inverse| Step { parent: pair[1].clone(), child: pair[0].clone(), is_inverse };
        let inverse = above_to[..=n_up].windows(2).map(|pair| step(pair, true));
        let forward = above_from[..=n_down].windows(2).rev().map(|pair| step(pair, false));
        Ok(Some(inverse.chain(forward).collect()))
    }

    /// The frame and those above it.
    fn ancestors(&self, frame: &Frame) -> Ancestors {
        let (mut frames, mut end) = (vec![frame.clone()], Ok(()));
        loop {
            let last = &frames[frames.len() - 1];
            let parents: Vec<&Frame> =
                self.edges.keys().filter(|(_, child)| child == last).map(|(parent, _)| parent).collect();
            match parents[..] {
                [] => break,
                [parent] if frames.contains(parent) => {
                    end = Err(TreeError::Circle(parent.clone()));
                    break;
                }
                [parent] => frames.push(parent.clone()),
                _ => {
                    let parents = parents.iter().map(|parent| format!("\"{parent}\"")).collect();
                    end = Err(TreeError::Parents { child: last.clone(), parents });
                    break;
                }
            }
        }
        Ancestors { frames, end }
    }
}

/// A frame with those above it, and why there are no more.
struct Ancestors {
    frames: Vec<Frame>,
    end: Result<(), TreeError>,
}

impl Ancestors {
    fn frames(&self) -> &[Frame] {
        &self.frames
    }
}

impl Edge {
    /// The motion at a stamp, or why there is none.
    fn at(&self, stamp_ns: StampNs, max_gap_ns: StampNs) -> Result<Isometry3<f64>, String> {
        if self.is_static {
            let n_before = self.samples.partition_point(|(stamp, _)| *stamp <= stamp_ns);
            return self.samples[n_before.saturating_sub(1)].1.clone();
        }
        let next = self.samples.partition_point(|(stamp, _)| *stamp < stamp_ns);
        let same: Vec<_> = self.samples[next..].iter().take_while(|(stamp, _)| *stamp == stamp_ns).collect();
        if let [(_, first), .., (_, last)] = same[..] {
            // What contradicts itself at one stamp is taken between both, as everywhere.
            return between((0, first.as_ref()?), (1, last.as_ref()?), 0.5);
        }
        if let [(_, one)] = same[..] {
            return one.clone();
        }
        let (Some(before), Some(after)) = (next.checked_sub(1).map(|k| &self.samples[k]), self.samples.get(next))
        else {
            let [first, last] = [self.samples.first(), self.samples.last()].map(|s| s.map_or(0, |(stamp, _)| *stamp));
            return Err(format!("is known from {first} to {last} ns only"));
        };
        let gap_ns = after.0 - before.0;
        if gap_ns > max_gap_ns {
            return Err(format!("has no sample for {:.3} s, from {} ns on", gap_ns as f64 * 1e-9, before.0));
        }
        let s = (stamp_ns - before.0) as f64 / gap_ns as f64;
        between((before.0, before.1.as_ref()?), (after.0, after.1.as_ref()?), s)
    }
}

/// The motion between two.
fn between(a: (StampNs, &Isometry3<f64>), b: (StampNs, &Isometry3<f64>), s: f64) -> Result<Isometry3<f64>, String> {
    let pose = |(stamp_ns, motion): (StampNs, &Isometry3<f64>)| Pose::new("parent", "child", *motion).at(stamp_ns);
    let between = Pose::interpolate(&pose(a), &pose(b), s);
    between.map(|pose| pose.isometry).ok_or_else(|| "turns by half a turn between two samples".into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};

    fn motion(x: f64, turn: f64) -> Isometry3<f64> {
        Isometry3::new(Vector3::new(x, -2.0 * x, 7.0), Vector3::new(0.2, -0.5, 1.0) * turn)
    }

    fn tree(edges: &[(&str, &str, StampNs, f64)]) -> TransformTree {
        let mut tree = TransformTree::default();
        for (parent, child, stamp_ns, x) in edges {
            tree.add(&(*parent).into(), &(*child).into(), *stamp_ns, Ok(motion(*x, x / 10.0)));
        }
        tree
    }

    fn chain(tree: &TransformTree, to: &str, from: &str) -> Chain {
        tree.chain(&to.into(), &from.into(), 100).unwrap().unwrap()
    }

    #[test]
    fn the_path_leads_over_the_common_ancestor_and_inverses_are_taken_on_the_way_up() {
        let tree = tree(&[
            ("map", "base", 10, 1.0),
            ("base", "arm", 10, 2.0),
            ("arm", "tool", 0, 3.0),
            ("base", "camera", 10, 4.0),
        ]);
        let read = chain(&tree, "tool", "camera");
        assert_eq!(read.formula(), "inverse(t_arm_tool) * inverse(t_base_arm) * t_base_camera");
        let expected = motion(3.0, 0.3).inverse() * motion(2.0, 0.2).inverse() * motion(4.0, 0.4);
        let [(10, Ok(found))] = &read.samples[..] else { panic!("{:?}", read.samples) };
        let point = Point3::new(11.0, -5.0, 2.0);
        assert!((found * point - expected * point).norm() < 1e-12);
        assert_eq!(chain(&tree, "camera", "map").formula(), "inverse(t_base_camera) * inverse(t_map_base)");
        assert_eq!(chain(&tree, "base", "map").formula(), "the inverse of t_map_base");
        assert_eq!(chain(&tree, "map", "tool").formula(), "t_map_base * t_base_arm * t_arm_tool");
        assert_eq!(tree.chain(&"map".into(), &"ct".into(), 100), Ok(None));
    }

    #[test]
    fn transforms_are_taken_at_one_time_between_samples_and_never_beyond_them() {
        let mut tree = tree(&[("map", "base", 10, 1.0), ("map", "base", 50, 2.0), ("map", "base", 300, 3.0)]);
        for (stamp_ns, x) in [(5, 1.0), (20, 1.0), (200, 1.0), (310, 1.0)] {
            tree.add(&"base".into(), &"camera".into(), stamp_ns, Ok(motion(x, 0.0)));
        }
        let read = chain(&tree, "map", "camera");
        let x_of = |stamp_ns| read.samples.iter().find(|(stamp, _)| *stamp == stamp_ns).unwrap().1.clone();
        let quarter =
            Pose::interpolate(&Pose::new("a", "b", motion(1.0, 0.1)), &Pose::new("a", "b", motion(2.0, 0.2)), 0.25);
        let expected = quarter.unwrap().isometry * motion(1.0, 0.0);
        assert!((x_of(20).unwrap().translation.vector - expected.translation.vector).norm() < 1e-12);
        for (stamp_ns, expected) in [
            (5, "t_map_base is known from 10 to 300 ns only"),
            (50, "t_base_camera has no sample for 0.000 s, from 20 ns on"),
            (200, "t_map_base has no sample for 0.000 s, from 50 ns on"),
            (310, "t_map_base is known from 10 to 300 ns only"),
        ] {
            assert_eq!(x_of(stamp_ns).unwrap_err(), expected);
        }
    }

    #[test]
    fn a_lost_sample_is_no_sample_and_nothing_is_taken_across_it() {
        let mut tree = tree(&[
            ("map", "base", 10, 1.0),
            ("map", "base", 30, 2.0),
            ("base", "camera", 15, 1.0),
            ("base", "camera", 25, 1.0),
        ]);
        tree.add(&"map".into(), &"base".into(), 20, Err("was not seen".into()));
        let read = chain(&tree, "map", "camera");
        let reasons: Vec<_> = read.samples.iter().map(|(stamp, motion)| (*stamp, motion.is_ok())).collect();
        assert_eq!(reasons, [(10, false), (15, false), (20, false), (25, false), (30, false)]);
        assert_eq!(read.samples[1].1, Err("t_map_base was not seen".into()));
    }

    #[test]
    fn static_transforms_hold_at_any_time_in_chains_of_several_and_a_changed_one_from_its_stamp_on() {
        let mut tree = tree(&[("map", "base", 10, 1.0), ("map", "base", 20, 2.0)]);
        let mut add = |parent: &str, child: &str, stamp_ns, x: f64| {
            tree.add_static(&parent.into(), &child.into(), stamp_ns, motion(x, x / 10.0))
        };
        assert!(add("base", "arm", 0, 3.0) && add("arm", "camera", 0, 4.0) && add("arm", "camera", 15, 5.0));
        let read = chain(&tree, "map", "camera");
        let stamps: Vec<_> = read.samples.iter().map(|(stamp, _)| *stamp).collect();
        assert_eq!(stamps, [10, 20], "at the stamps of what moves, and never before or beyond");
        for ((_, found), (base, camera)) in read.samples.iter().zip([(1.0, 4.0), (2.0, 5.0)]) {
            let expected = motion(base, base / 10.0) * motion(3.0, 0.3) * motion(camera, camera / 10.0);
            assert!((found.as_ref().unwrap().inverse() * expected).translation.vector.norm() < 1e-12, "{found:?}");
        }
        // From below, the inverse.
        let read = chain(&tree, "camera", "base");
        let [(0, Ok(first)), (15, Ok(second))] = &read.samples[..] else { panic!("{:?}", read.samples) };
        assert!((first * motion(3.0, 0.3) * motion(4.0, 0.4)).translation.vector.norm() < 1e-12);
        assert!((second * motion(3.0, 0.3) * motion(5.0, 0.5)).translation.vector.norm() < 1e-12);
    }

    #[test]
    fn what_moves_goes_before_a_static_transform_of_the_same_frames_in_either_order() {
        let mut tree = tree(&[("map", "base", 10, 1.0)]);
        assert!(!tree.add_static(&"map".into(), &"base".into(), 0, motion(9.0, 0.9)));
        let mut other = TransformTree::default();
        assert!(other.add_static(&"map".into(), &"base".into(), 0, motion(9.0, 0.9)));
        other.add(&"map".into(), &"base".into(), 10, Ok(motion(1.0, 0.1)));
        assert_eq!(chain(&tree, "map", "base"), chain(&other, "map", "base"));
        assert_eq!(chain(&tree, "map", "base").samples, [(10, Ok(motion(1.0, 0.1)))]);
    }

    #[test]
    fn two_parents_on_the_way_are_refused_and_elsewhere_they_do_not_matter() {
        let tree = tree(&[
            ("map", "base", 1, 1.0),
            ("odom", "base", 1, 1.0),
            ("base", "camera", 1, 1.0),
            ("camera", "lens", 1, 1.0),
        ]);
        let error = tree.chain(&"map".into(), &"camera".into(), 9).unwrap_err().to_string();
        assert!(error.starts_with("frame \"base\" has the parents \"map\" and \"odom\""), "{error}");
        assert_eq!(chain(&tree, "base", "lens").formula(), "t_base_camera * t_camera_lens");
        let circle = super::tests::tree(&[("a", "b", 1, 1.0), ("b", "a", 1, 1.0)]);
        assert_eq!(circle.chain(&"c".into(), &"a".into(), 9), Err(TreeError::Circle("a".into())));
    }
}
