//! The tree of frames that viewers are shown, planned before the run.
//!
//! A viewer places every frame by one chain of transforms, so each frame may have one parent. A graph has more poses than
//! that: where a camera is assumed to be and where it was found to be, the start of a fit and its result, the truth of a
//! simulation. Which recorded wire places which frame is decided here from the plan alone, so it depends neither on the
//! order of arrival nor on the number of workers. The other wires get frames of their own; see [`FrameEdge::Own`].

use crate::plan::{OutputId, Plan, PlanNode};
use osteoflow_node::{FrameEdge, Join, PayloadType, Role};
use std::collections::{BTreeMap, BTreeSet};

/// How much a wire of poses has to say about the frames it joins; the smallest is asked first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Rank {
    /// Samples of a source, such as a tracker's: they follow a frame that moves.
    Measured,
    /// Computed by a node. Of two that join the same frames the later one in the graph counts: the fit, not its start.
    Computed,
    /// A constant of a source: what was assumed, planned or, in a simulation, true.
    Constant,
    /// A product of poses that its node takes: it says nothing that they do not say, and follows no frame.
    Composed,
}

/// A recorded wire of poses whose frames are known before the run.
#[derive(Debug, Clone)]
struct PoseWire {
    id: OutputId,
    to: String,
    from: String,
    rank: Rank,
}

/// A forest of frames, with one wire for each edge.
#[derive(Debug, Default)]
pub(super) struct FrameTree {
    root: Option<String>,
    /// The frame that most samples are given in, which is the root unless something is registered onto a surface.
    origin: Option<String>,
    /// Whether the root is the frame of a surface that others are registered onto.
    is_anchored: bool,
    /// The wire of the pose that registers onto the surface in the root.
    fit: Option<OutputId>,
    /// Parent of each frame, and the wire that places it.
    parents: BTreeMap<String, (String, OutputId)>,
    /// For each wire that has a frame of its own, the frame of its pose that is the parent.
    own: BTreeMap<OutputId, String>,
}

impl FrameTree {
    /// Plans the tree of the recorded wires.
    pub(super) fn new(plan: &Plan) -> Self {
        Self::of(pose_wires(plan), &anchors(plan))
    }

    fn of(mut wires: Vec<PoseWire>, anchors: &BTreeSet<String>) -> Self {
        let latest_first = |wire: &PoseWire| (wire.rank == Rank::Computed).then_some(std::cmp::Reverse(wire.id));
        wires.sort_by_key(|wire| (wire.rank, latest_first(wire), wire.id));
        let mut joined = Components::default();
        let (edges, others): (Vec<_>, Vec<_>) = wires.iter().partition(|wire| joined.join(&wire.to, &wire.from));
        let origin = root(&wires);
        let mut tree = Self { root: origin.clone(), origin, ..Self::default() };
        tree.grow(&edges);
        // What another wire says of a frame is shown beside it: in the tracker's frame, even where that is not the root.
        for wire in others {
            let nearer = if tree.depth(&wire.from) < tree.depth(&wire.to) { &wire.from } else { &wire.to };
            tree.own.insert(wire.id, nearer.clone());
        }
        // Of several registrations the last in the graph counts: that of the bone, not of the phantom before it.
        let onto = |edge: &&&PoseWire| {
            edge.rank == Rank::Computed && anchors.contains(&edge.to) != anchors.contains(&edge.from)
        };
        if let Some(fit) = edges.iter().filter(onto).max_by_key(|edge| edge.id) {
            let anchor = if anchors.contains(&fit.to) { &fit.to } else { &fit.from };
            (tree.root, tree.is_anchored, tree.fit) = (Some(anchor.clone()), true, Some(fit.id));
            tree.grow(&edges);
        }
        tree
    }

    /// Gives each frame its parent, walking the edges from the root.
    fn grow(&mut self, edges: &[&PoseWire]) {
        self.parents.clear();
        // Each component is walked from its root; components without the root begin with the `to` of their first wire.
        let roots = self.root.clone().into_iter().chain(edges.iter().map(|edge| edge.to.clone()));
        let mut seen = BTreeSet::new();
        for root in roots.collect::<Vec<_>>() {
            let mut next = vec![root];
            while let Some(parent) = next.pop() {
                if !seen.insert(parent.clone()) {
                    continue;
                }
                for edge in edges {
                    let child = match (&edge.to, &edge.from) {
                        (to, from) if *to == parent => from,
                        (to, from) if *from == parent => to,
                        _ => continue,
                    };
                    if !seen.contains(child) {
                        self.parents.insert(child.clone(), (parent.clone(), edge.id));
                        next.push(child.clone());
                    }
                }
            }
        }
    }

    /// The frame that most samples are given in, the tracker's.
    pub(super) fn origin(&self) -> Option<&str> {
        self.origin.as_deref()
    }

    /// Whether the root is the frame of a surface that others are registered onto.
    pub(super) fn is_anchored(&self) -> bool {
        self.is_anchored
    }

    /// The wire of the pose that registers onto the surface in the root.
    pub(super) fn fit(&self) -> Option<OutputId> {
        self.fit
    }

    /// The frame that the others are shown in; `None` if no recorded wire has poses with known frames.
    pub(super) fn root(&self) -> Option<&str> {
        self.root.as_deref()
    }

    /// All frames that a wire places, and the root.
    pub(super) fn frames(&self) -> BTreeSet<&str> {
        self.parents.keys().map(String::as_str).chain(self.root()).collect()
    }

    /// Where the poses of a wire lie.
    pub(super) fn edge(&self, wire: OutputId) -> FrameEdge<'_> {
        let placed = self.parents.iter().find(|(_, (_, id))| *id == wire);
        match placed {
            Some((child, (parent, _))) => FrameEdge::Tree { parent, child },
            None => FrameEdge::Own { parent: self.own.get(&wire).map(String::as_str) },
        }
    }

    /// Why a frame cannot be shown with the root: the wire that gave no pose, or `None` in the error if no wire has one.
    pub(super) fn connected(&self, frame: &str, has_pose: impl Fn(OutputId) -> bool) -> Result<(), Option<OutputId>> {
        let mut at = frame;
        while let Some((parent, wire)) = self.parents.get(at) {
            if !has_pose(*wire) {
                return Err(Some(*wire));
            }
            at = parent;
        }
        if Some(at) == self.root() { Ok(()) } else { Err(None) }
    }

    /// Number of edges between a frame and its root.
    fn depth(&self, frame: &str) -> usize {
        std::iter::successors(self.parents.get(frame), |(parent, _)| self.parents.get(parent)).count()
    }
}

/// The frames of the recorded surfaces onto which something may be registered.
fn anchors(plan: &Plan) -> BTreeSet<String> {
    let outputs = plan.record.iter().map(|&id| &plan.nodes[id.node].outputs[id.port]);
    let surfaces = outputs
        .filter(|output| output.payload.ty().and_then(PayloadType::display).is_some_and(|display| display.anchor));
    surfaces.filter_map(|output| output.frames.frame.clone()).collect()
}

/// The frame that most samples are given in, the tracker's; ties go to the first.
fn root(sorted: &[PoseWire]) -> Option<String> {
    let measured = || sorted.iter().filter(|wire| wire.rank == Rank::Measured);
    let n_in = |frame: &str| measured().filter(|wire| wire.to == frame).count();
    let most = measured().rev().max_by_key(|wire| n_in(&wire.to));
    most.or_else(|| sorted.first()).map(|wire| wire.to.clone())
}

fn pose_wires(plan: &Plan) -> Vec<PoseWire> {
    let wires = plan.record.iter().filter_map(|&id| {
        let node = &plan.nodes[id.node];
        let frames = &node.outputs[id.port].frames;
        let (to, from) = (frames.to.clone()?, frames.from.clone()?);
        let rank = match node.role {
            Role::Node if is_composed(plan, node, &to, &from) => Rank::Composed,
            Role::Node => Rank::Computed,
            _ if is_stream(plan, id) => Rank::Measured,
            _ => Rank::Constant,
        };
        Some(PoseWire { id, to, from, rank })
    });
    wires.collect()
}

/// Whether a node takes the items of the wire as they come, not one of them as a constant.
fn is_stream(plan: &Plan, wire: OutputId) -> bool {
    plan.nodes[wire.node].outputs[wire.port].links.iter().any(|&link| {
        let link = &plan.links[link];
        let port = &plan.nodes[link.to_node].inputs[link.to_port].port;
        !port.unused && port.join != Join::Once
    })
}

/// Whether the poses that a node takes already lead from one frame to the other. Poses of the same two frames, such as the
/// start of a fit, do not count.
fn is_composed(plan: &Plan, node: &PlanNode, to: &str, from: &str) -> bool {
    let mut joined = Components::default();
    for link in node.inputs.iter().flat_map(|input| &input.links).map(|link| &plan.links[*link]) {
        let frames = &plan.nodes[link.from.node].outputs[link.from.port].frames;
        if let (Some(a), Some(b)) = (&frames.to, &frames.from)
            && ![(to, from), (from, to)].contains(&(a, b))
        {
            joined.join(a, b);
        }
    }
    !joined.join(to, from)
}

/// Frames that are joined, each with a representative.
#[derive(Default)]
struct Components(BTreeMap<String, String>);

impl Components {
    fn of(&self, frame: &str) -> String {
        self.0.get(frame).map_or_else(|| frame.to_owned(), Clone::clone)
    }

    /// Joins two frames; returns whether they were apart.
    fn join(&mut self, a: &str, b: &str) -> bool {
        let (kept, other) = (self.of(a), self.of(b));
        for frame in [a, b] {
            let own = self.of(frame);
            self.0.insert(frame.to_owned(), own);
        }
        self.0.values_mut().filter(|representative| **representative == other).for_each(|r| kept.clone_into(r));
        kept != other
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tree(wires: &[(&str, &str, Rank)]) -> FrameTree {
        let wire = |(node, (to, from, rank)): (usize, &(&str, &str, Rank))| PoseWire {
            id: OutputId { node, port: 0 },
            to: (*to).into(),
            from: (*from).into(),
            rank: *rank,
        };
        FrameTree::of(wires.iter().enumerate().map(wire).collect(), &BTreeSet::new())
    }

    fn onto(anchors: &[&str], wires: &[(&str, &str, Rank)]) -> FrameTree {
        let ids = (0..wires.len()).map(|node| OutputId { node, port: 0 });
        let wire = |(id, &(to, from, rank)): (OutputId, &(&str, &str, Rank))| PoseWire {
            id,
            to: to.into(),
            from: from.into(),
            rank,
        };
        FrameTree::of(ids.zip(wires).map(wire).collect(), &anchors.iter().map(|&frame| frame.to_owned()).collect())
    }

    fn edges(tree: &FrameTree) -> Vec<(&str, &str, usize)> {
        tree.parents.iter().map(|(child, (parent, id))| (&**parent, &**child, id.node)).collect()
    }

    use Rank::{Composed, Computed, Constant, Measured};

    /// The poses of graphs/fibula.toml.
    const FIBULA: &[(&str, &str, Rank)] = &[
        ("world", "camera_marker", Measured),
        ("world", "phantom_marker", Measured),
        ("world", "bone_marker", Measured),
        ("ct", "world", Constant), // truth
        ("phantom", "phantom_marker", Constant),
        ("camera", "camera_marker", Constant), // nominal
        ("camera", "camera_marker", Computed),
        ("camera", "phantom_marker", Composed),
        ("world", "bone_marker", Computed), // at the scan
        ("ct", "bone_marker", Computed),    // coarse
        ("ct", "bone_marker", Computed),    // ICP
        ("ct", "world", Composed),
    ];

    #[test]
    fn estimates_win_over_starts_and_truths_and_samples_over_their_means() {
        let tree = tree(FIBULA);
        assert_eq!(tree.root(), Some("world"));
        let expected = [
            ("world", "bone_marker", 2),
            ("camera_marker", "camera", 6),
            ("world", "camera_marker", 0),
            ("bone_marker", "ct", 10),
            ("phantom_marker", "phantom", 4),
            ("world", "phantom_marker", 1),
        ];
        assert_eq!(edges(&tree), expected);
        let own = |node| tree.edge(OutputId { node, port: 0 });
        for (node, parent) in
            [(3, "world"), (5, "camera_marker"), (7, "phantom_marker"), (8, "world"), (9, "bone_marker")]
        {
            assert_eq!(own(node), FrameEdge::Own { parent: Some(parent) }, "wire {node}");
        }
    }

    #[test]
    fn the_surface_that_others_are_registered_onto_is_the_root_and_what_is_beside_stays_there() {
        let tree = onto(&["ct", "phantom"], FIBULA);
        assert_eq!((tree.root(), tree.is_anchored()), (Some("ct"), true));
        assert_eq!(tree.fit(), Some(OutputId { node: 10, port: 0 }));
        let expected = [
            ("ct", "bone_marker", 10),
            ("camera_marker", "camera", 6),
            ("world", "camera_marker", 0),
            ("phantom_marker", "phantom", 4),
            ("world", "phantom_marker", 1),
            ("bone_marker", "world", 2),
        ];
        assert_eq!(edges(&tree), expected);
        let own = |node| tree.edge(OutputId { node, port: 0 });
        assert_eq!(own(3), FrameEdge::Own { parent: Some("world") }, "the truth is shown where the tracker has it");
        assert_eq!(own(9), FrameEdge::Own { parent: Some("bone_marker") });
        // A constant places nothing onto a surface, and so the tracker stays the root.
        let tree = onto(&["phantom"], FIBULA);
        assert_eq!((tree.root(), tree.is_anchored(), tree.fit()), (Some("world"), false, None));
    }

    #[test]
    fn each_frame_has_one_parent_and_every_chain_ends_at_the_root_whatever_is_left_out() {
        for left_out in 0..1_u32 << FIBULA.len() {
            let wires = FIBULA.iter().enumerate().filter(|(bit, _)| left_out >> bit & 1 == 0).map(|(_, wire)| *wire);
            let wires: Vec<_> = wires.collect();
            let tree = tree(&wires);
            let children: BTreeSet<_> = tree.parents.keys().collect();
            let placed: BTreeSet<_> = tree.parents.values().map(|(_, id)| *id).collect();
            assert_eq!(placed.len(), tree.parents.len(), "a wire places two frames: {wires:?}");
            assert_eq!(placed.len() + tree.own.len(), wires.len(), "a wire is lost: {wires:?}");
            for frame in children {
                let mut at = frame;
                for _ in 0..=tree.parents.len() {
                    at = tree.parents.get(at).map_or(at, |(parent, _)| parent);
                }
                assert!(!tree.parents.contains_key(at), "{frame} is in a circle: {wires:?}");
            }
        }
    }

    #[test]
    fn a_frame_without_a_pose_is_not_connected_and_the_wire_is_named() {
        let tree = tree(FIBULA);
        let icp = OutputId { node: 10, port: 0 };
        assert_eq!(tree.connected("ct", |_| true), Ok(()));
        assert_eq!(tree.connected("world", |_| false), Ok(()));
        assert_eq!(tree.connected("ct", |wire| wire != icp), Err(Some(icp)));
        assert_eq!(tree.connected("stylus", |_| true), Err(None));
    }

    #[test]
    fn a_fit_of_two_files_is_shown_in_the_frame_of_its_target() {
        let tree = tree(&[("ct", "camera", Computed), ("ct", "camera", Computed)]);
        assert_eq!((tree.root(), edges(&tree)), (Some("ct"), vec![("ct", "camera", 1)]));
        assert_eq!(FrameTree::of(Vec::new(), &BTreeSet::new()).root(), None);
    }
}
