//! What viewers are shown of a payload: derived from it, lossy, and outside digests.

use crate::StampNs;

/// The message type that viewers show for a payload, such as `foxglove.PointCloud`.
#[derive(Debug, Clone, PartialEq)]
pub struct Display {
    /// The schema's name.
    pub schema_name: String,
    /// The encoding of the schema's data: `protobuf` or `jsonschema`.
    pub schema_encoding: String,
    /// The schema itself.
    pub schema_data: Vec<u8>,
    /// The encoding of the messages: `protobuf` or `json`.
    pub message_encoding: String,
    /// Whether the message shows an answer of the run: it is then written when the run has ended, unless the run is
    /// refused.
    pub answer: bool,
    /// Whether other payloads are registered onto what it shows, such as a bone: what is shown is placed by its frame.
    pub anchor: bool,
    /// The message that removes all that the channel has shown. Without one, an answer is not shown before the run has ended.
    pub removal: Vec<u8>,
}

/// What a picture for viewers is made for, beside its payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DisplayContext<'a> {
    /// The time at which it is shown; at least 1, because viewers reject zero.
    pub stamp_ns: StampNs,
    /// The wire, `node.port`.
    pub wire: &'a str,
    /// Where a pose lies in the tree of frames; other payloads ignore it.
    pub edge: FrameEdge<'a>,
    /// Whether the root of the tree is the frame of a surface that others are registered onto. What belongs to that surface at its
    /// stamp then stays on it as viewers place it by its stamp, in whatever frame it is given.
    pub anchored: bool,
}

/// Where a pose lies in the tree of frames. Viewers need a tree: a frame with two parents jumps between them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameEdge<'a> {
    /// There is no tree: `from` is shown as a child of `to`.
    Unplanned,
    /// The pose is the edge of these two frames, inverted if its `to` is the child.
    Tree {
        /// The frame nearer to the root.
        parent: &'a str,
        /// The frame that this pose places.
        child: &'a str,
    },
    /// Another wire places these frames. The pose gets a frame of its own, named by [`own_frame`].
    Own {
        /// The frame of the pose that is the parent; `None` for its `to`.
        parent: Option<&'a str>,
    },
}

/// The edge of the tree that a pose with frames `to` and `from` is shown as: parent, child, and whether the pose is inverted.
///
/// A pose whose frames are not those of its planned edge gets a frame of its own, so that it cannot displace another.
pub fn frame_edge(about: &DisplayContext<'_>, to: &str, from: &str) -> (String, String, bool) {
    match about.edge {
        FrameEdge::Unplanned => (to.into(), from.into(), false),
        FrameEdge::Tree { parent, child } if (parent, child) == (to, from) => (to.into(), from.into(), false),
        FrameEdge::Tree { parent, child } if (parent, child) == (from, to) => (from.into(), to.into(), true),
        FrameEdge::Own { parent: Some(parent) } if parent == from => (from.into(), own_frame(to, about.wire), true),
        FrameEdge::Tree { .. } | FrameEdge::Own { .. } => (to.into(), own_frame(from, about.wire), false),
    }
}

/// The name of the frame of a wire whose pose is not an edge of the tree: `ct (coarse.t_target_source)`.
pub fn own_frame(frame: &str, wire: &str) -> String {
    format!("{frame} ({wire})")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_is_shown_as_its_edge_and_never_displaces_another() {
        let shown =
            |edge, to, from| frame_edge(&DisplayContext { stamp_ns: 1, wire: "n.p", edge, anchored: false }, to, from);
        let edge = |parent: &str, child: &str, inverted| (parent.to_owned(), child.to_owned(), inverted);
        let tree = FrameEdge::Tree { parent: "world", child: "ct" };
        assert_eq!(shown(FrameEdge::Unplanned, "ct", "world"), edge("ct", "world", false));
        assert_eq!(shown(tree, "world", "ct"), edge("world", "ct", false));
        assert_eq!(shown(tree, "ct", "world"), edge("world", "ct", true));
        assert_eq!(shown(tree, "ct", "camera"), edge("ct", "camera (n.p)", false), "not the planned frames");
        let own = |parent| FrameEdge::Own { parent };
        assert_eq!(shown(own(Some("world")), "ct", "world"), edge("world", "ct (n.p)", true));
        assert_eq!(shown(own(Some("world")), "world", "ct"), edge("world", "ct (n.p)", false));
        assert_eq!(shown(own(None), "ct", "world"), edge("ct", "world (n.p)", false));
    }
}
