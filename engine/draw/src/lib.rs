//! Draws a data-flow graph as SVG, Mermaid or Graphviz.
//!
//! A [`Diagram`] is plain data: nodes in topological order, and links between them with the lines of their labels. Colours
//! show each node's share of the busy time and red marks failures and dropped items, where the diagram has them. [`svg`]
//! lays the diagram out itself and needs no other program.
//!
//! ```
//! use osteoflow_draw::{Diagram, Link, Node, svg};
//!
//! let node = |name: &str, kind: &str| Node { name: name.into(), kind: kind.into(), ..Node::default() };
//! let diagram = Diagram {
//!     title: "two nodes".into(),
//!     nodes: vec![node("scan", "acquire.mcap"), node("crop", "crop.box")],
//!     links: vec![Link { from: 0, to: 1, label: vec!["cloud".into()], ..Link::default() }],
//!     ..Diagram::default()
//! };
//! assert!(svg(&diagram).starts_with("<svg"));
//! ```

mod layout;
mod svg;
mod text;
pub mod xml;

pub use svg::svg;
pub use text::{dot, mermaid};

/// A graph to draw.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Diagram {
    /// The title: the graph's name.
    pub title: String,
    /// Lines below the title.
    pub notes: Vec<String>,
    /// The nodes in topological order.
    pub nodes: Vec<Node>,
    /// The links, each from an earlier node to a later one; one that leads back, or to its own node, is drawn dashed.
    pub links: Vec<Link>,
}

/// A node of a diagram, drawn as a box.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Node {
    /// Its name.
    pub name: String,
    /// Its kind; may be empty.
    pub kind: String,
    /// Whether its kind has no inputs: drawn with round ends.
    pub is_source: bool,
    /// Lines below the kind, such as times and counts.
    pub lines: Vec<String>,
    /// Its share of the time that all nodes were busy, from 0 to 1: colours the box.
    pub busy_share: Option<f64>,
    /// The reason for its failure.
    pub failure: Option<String>,
}

/// A link from an output port to an input port. The SVG draws all links between the same two nodes as one curve.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Link {
    /// Index of the producing node.
    pub from: usize,
    /// Index of the consuming node.
    pub to: usize,
    /// The lines of its label, such as ports, payload and frames.
    pub label: Vec<String>,
    /// Number of dropped items; drawn red if there are any.
    pub dropped: u64,
    /// Details, shown by the SVG as a tooltip.
    pub tooltip: String,
}

impl Link {
    /// Whether it closes a cycle.
    fn leads_back(&self) -> bool {
        self.from >= self.to
    }
}

/// Colours of nodes by their share of the busy time: smallest share, fill colour, text of the legend.
const SHARE_COLOURS: [(f64, &str, &str); 5] = [
    (0.0, "#eef1f4", "below 1 %"),
    (0.01, "#fdf0c4", "1 %"),
    (0.05, "#fbd37a", "5 %"),
    (0.15, "#f5a353", "15 %"),
    (0.30, "#ec7f5b", "30 % and more"),
];

/// The fill colour of a node; that of the smallest shares where the share is unknown.
fn share_colour(share: Option<f64>) -> &'static str {
    let share = share.unwrap_or(0.0);
    SHARE_COLOURS.iter().rfind(|(smallest, ..)| share >= *smallest).unwrap_or(&SHARE_COLOURS[0]).1
}
