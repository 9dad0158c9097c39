//! SVG output.

use crate::{
    Diagram, Link, SHARE_COLOURS,
    layout::{Edge, Layout, Rect, Size, layout},
    share_colour,
    xml::{escape, text},
};
use std::{collections::BTreeMap, fmt::Write};

const MARGIN: f64 = 20.0;
/// Line height in a box.
const LINE: f64 = 15.0;
/// Line height in a label.
const LABEL_LINE: f64 = 12.0;
/// Mean width of a character relative to the font size; generous, as every viewer has its own font.
const CHARACTER_WIDTH: f64 = 0.58;
/// Distance of a link that closes a cycle from boxes and from its label.
const BACK_GAP: f64 = 8.0;
/// Longer lines are truncated; the tooltip has them in full.
const MAX_CHARACTERS: usize = 46;

/// Boxes keep light colours and dark text; everything else follows the viewer's colour scheme.
const STYLE: &str = "\
text { font-family: system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif; font-size: 12px }
.paper { fill: #ffffff }
.ink { fill: #24292f }
.faint { fill: #59636e; font-size: 11px }
.label { fill: #3c4650; font-size: 10px }
.dropped { fill: #c62828 }
.wire { fill: none; stroke: #8b949e; stroke-width: 1.2 }
.wire.lossy { stroke: #c62828; stroke-width: 2 }
.wire.back { stroke-dasharray: 5 3 }
.tip { fill: #8b949e }
.tip.lossy { fill: #c62828 }
.box { stroke: #57606a; stroke-width: 1 }
.box.failed { stroke: #c62828; stroke-width: 3 }
.name { fill: #1b1f24; font-weight: bold; font-size: 13px }
.inside { fill: #3c4650; font-size: 11px }
.reason { fill: #b71c1c; font-size: 11px; font-weight: bold }
@media (prefers-color-scheme: dark) {
.paper { fill: #0d1117 }
.ink { fill: #e6edf3 }
.faint { fill: #9198a1 }
.label { fill: #c9d1d9 }
.dropped { fill: #ff7b72 }
.wire, .tip { stroke: #7d8590 }
.tip { fill: #7d8590; stroke: none }
.wire.lossy { stroke: #ff7b72 }
.tip.lossy { fill: #ff7b72 }
}";

/// All links between the same two nodes, drawn as one curve.
struct Bundle<'a> {
    from: usize,
    to: usize,
    links: Vec<&'a Link>,
}

/// Draws the diagram as SVG, from left to right. Details are tooltips of the nodes and links.
pub fn svg(diagram: &Diagram) -> String {
    let mut bundles: BTreeMap<(usize, usize), Bundle<'_>> = BTreeMap::new();
    for link in &diagram.links {
        let (from, to) = (link.from, link.to);
        bundles.entry((from, to)).or_insert(Bundle { from, to, links: Vec::new() }).links.push(link);
    }
    let (back, bundles): (Vec<_>, Vec<_>) = bundles.into_values().partition(|bundle| bundle.from >= bundle.to);
    let sizes: Vec<_> = (0..diagram.nodes.len()).map(|node| node_size(diagram, node)).collect();
    let edges: Vec<_> =
        bundles.iter().map(|bundle| Edge { from: bundle.from, to: bundle.to, label: label_size(bundle) }).collect();
    let placed = layout(&sizes, &edges);
    let head = head(diagram);
    let (dx, dy) = (MARGIN, MARGIN + head.height);
    let width = (placed.size.width + 2.0 * MARGIN).max(head.width + 2.0 * MARGIN);
    let back_heights: Vec<_> = back.iter().map(|bundle| label_size(bundle).height + 2.0 * BACK_GAP).collect();
    let height = dy + placed.size.height + back_heights.iter().sum::<f64>() + MARGIN;

    let mut out = String::new();
    let (w, h) = (width.ceil(), height.ceil());
    let _ = writeln!(
        out,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" role=\"img\">"
    );
    let _ = writeln!(out, "<title>{}</title>\n<style>{STYLE}</style>", escape(&diagram.title));
    let _ = writeln!(out, "<rect class=\"paper\" width=\"{w}\" height=\"{h}\"/>");
    out.push_str(&head.text);
    let _ = writeln!(out, "<g transform=\"translate({dx:.1} {dy:.1})\">");
    let ends = ends(&bundles, &placed);
    for (index, bundle) in bundles.iter().enumerate() {
        draw_links(&mut out, bundle, &placed.edges[index], ends[index]);
    }
    let mut y = placed.size.height + BACK_GAP;
    for (bundle, height) in back.iter().zip(&back_heights) {
        draw_back(&mut out, bundle, &placed, y);
        y += height;
    }
    for (index, rect) in placed.nodes.iter().enumerate() {
        draw_node(&mut out, diagram, index, rect);
    }
    out.push_str("</g>\n</svg>\n");
    out
}

fn truncated(text: &str) -> String {
    truncated_to(text, MAX_CHARACTERS)
}

fn truncated_to(text: &str, max: usize) -> String {
    let line = text.lines().next().unwrap_or_default();
    if line.chars().count() <= max && line.len() == text.len() {
        return text.into();
    }
    let mut short: String = line.chars().take(max - 1).collect();
    short.push('\u{2026}');
    short
}

fn width_of(text: &str, size: f64) -> f64 {
    text.chars().count() as f64 * size * CHARACTER_WIDTH
}

/// The lines of a box: class, font size and text.
fn lines(diagram: &Diagram, index: usize) -> Vec<(&'static str, f64, String)> {
    let node = &diagram.nodes[index];
    let slowest = slowest(diagram) == Some(index);
    let name = if slowest { format!("{} \u{25c6}", node.name) } else { node.name.clone() };
    let mut lines = vec![("name", 14.0, truncated(&name))];
    if !node.kind.is_empty() {
        lines.push(("inside", 11.0, truncated(&node.kind)));
    }
    lines.extend(node.lines.iter().map(|line| ("inside", 11.0, truncated(line))));
    // The tooltip has the full reason.
    lines.extend(node.failure.as_ref().map(|reason| ("reason", 11.5, truncated_to(&format!("\u{2715} {reason}"), 26))));
    lines
}

/// The node with the largest share of the busy time.
fn slowest(diagram: &Diagram) -> Option<usize> {
    let shares = diagram.nodes.iter().enumerate().filter_map(|(index, node)| Some((node.busy_share?, index)));
    shares.filter(|(share, _)| *share > 0.0).max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, index)| index)
}

fn node_size(diagram: &Diagram, index: usize) -> Size {
    let lines = lines(diagram, index);
    let width = lines.iter().map(|(_, size, text)| width_of(text, *size)).fold(60.0, f64::max);
    Size { width: width + 20.0, height: lines.len() as f64 * LINE + 12.0 }
}

fn draw_node(out: &mut String, diagram: &Diagram, index: usize, rect: &Rect) {
    let node = &diagram.nodes[index];
    let Size { width, height } = rect.size;
    let mut tooltip =
        vec![if node.kind.is_empty() { node.name.clone() } else { format!("{} ({})", node.name, node.kind) }];
    tooltip.extend(node.lines.iter().cloned());
    tooltip.extend((slowest(diagram) == Some(index)).then(|| "the node that was busy longest".into()));
    tooltip.extend(node.failure.as_ref().map(|reason| format!("failed: {reason}")));
    let fill = share_colour(node.busy_share);
    let (radius, class) =
        (if node.is_source { 14.0 } else { 3.0 }, if node.failure.is_some() { "box failed" } else { "box" });
    let _ = writeln!(out, "<g><title>{}</title>", escape(&tooltip.join("\n")));
    let _ = writeln!(
        out,
        "<rect class=\"{class}\" fill=\"{fill}\" x=\"{:.1}\" y=\"{:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" \
         rx=\"{radius}\"/>",
        rect.x, rect.y
    );
    for (line, (class, _, words)) in lines(diagram, index).iter().enumerate() {
        let at = (rect.x + width / 2.0, rect.y + 6.0 + (line as f64 + 0.75) * LINE);
        text(out, at, &format!("class=\"{class}\" text-anchor=\"middle\""), words);
    }
    out.push_str("</g>\n");
}

/// The points where each bundle leaves its producer and meets its consumer, spread along the sides of the boxes.
fn ends(bundles: &[Bundle<'_>], placed: &Layout) -> Vec<((f64, f64), (f64, f64))> {
    let mut ends = vec![((0.0, 0.0), (0.0, 0.0)); bundles.len()];
    for (node, rect) in placed.nodes.iter().enumerate() {
        for leaving in [true, false] {
            let own = |bundle: &Bundle<'_>| if leaving { bundle.from == node } else { bundle.to == node };
            let mut here: Vec<(f64, usize)> = (0..bundles.len())
                .filter(|index| own(&bundles[*index]))
                .filter_map(|index| {
                    let chain = &placed.edges[index];
                    let next = if leaving { chain.first() } else { chain.last() };
                    Some((next.map(|rect| crossing_height(rect, leaving))?, index))
                })
                .collect();
            here.sort_by(|a, b| a.0.total_cmp(&b.0));
            let n = here.len() as f64;
            for (i, (_, index)) in here.iter().enumerate() {
                let y = rect.y + rect.size.height * (i as f64 + 1.0) / (n + 1.0);
                match leaving {
                    true => ends[*index].0 = (rect.right(), y),
                    false => ends[*index].1 = (rect.x, y),
                }
            }
        }
    }
    ends
}

/// The height at which a curve crosses a box of its edge: below the label, if the box has one.
fn crossing_height(rect: &Rect, has_label: bool) -> f64 {
    if has_label { rect.y + rect.size.height - 2.0 } else { rect.middle() }
}

fn label_size(bundle: &Bundle<'_>) -> Size {
    let lines: Vec<_> = bundle.links.iter().flat_map(|link| &link.label).collect();
    let width = lines.iter().map(|line| width_of(&truncated(line), 10.0)).fold(0.0, f64::max);
    Size { width: width + 8.0, height: lines.len() as f64 * LABEL_LINE + 5.0 }
}

fn draw_links(out: &mut String, bundle: &Bundle<'_>, chain: &[Rect], ends: ((f64, f64), (f64, f64))) {
    let lossy = if bundle.links.iter().any(|link| link.dropped > 0) { " lossy" } else { "" };
    let tooltip: Vec<_> = bundle.links.iter().map(|link| link.tooltip.as_str()).collect();
    let ((x, y), (to_x, to_y)) = ends;
    let mut path = format!("M{x:.1} {y:.1}");
    let (mut x, mut y) = (x, y);
    let mut curve = |x: &mut f64, y: &mut f64, to_x: f64, to_y: f64| {
        let half = (to_x - *x) / 2.0;
        let _ = write!(path, " C{:.1} {y:.1} {:.1} {to_y:.1} {to_x:.1} {to_y:.1}", *x + half, to_x - half);
        (*x, *y) = (to_x, to_y);
    };
    for (i, rect) in chain.iter().enumerate() {
        let level = crossing_height(rect, i == 0);
        curve(&mut x, &mut y, rect.x, level);
        curve(&mut x, &mut y, rect.right(), level);
    }
    // The head of the arrow covers the rest.
    curve(&mut x, &mut y, to_x - 6.0, to_y);
    let _ = writeln!(out, "<g><title>{}</title>", escape(&tooltip.join("\n")));
    let _ = writeln!(out, "<path class=\"wire{lossy}\" d=\"{path}\"/>");
    let _ = writeln!(out, "<path class=\"tip{lossy}\" d=\"M{to_x:.1} {to_y:.1} l-7 -3.5 v7 z\"/>");
    if let Some(rect) = chain.first() {
        let labels = bundle.links.iter().flat_map(|link| link.label.iter().map(|line| (line, link.dropped > 0)));
        for (line, (words, dropped)) in labels.enumerate() {
            let class = if dropped { "label dropped" } else { "label" };
            let at = (rect.x + rect.size.width / 2.0, rect.y + (line as f64 + 0.75) * LABEL_LINE);
            text(out, at, &format!("class=\"{class}\" text-anchor=\"middle\""), &truncated(words));
        }
    }
    out.push_str("</g>\n");
}

/// Draws links that close a cycle: from the right of the producer's column to the left of the consumer's, below all boxes.
fn draw_back(out: &mut String, bundle: &Bundle<'_>, placed: &Layout, lane: f64) {
    let lossy = if bundle.links.iter().any(|link| link.dropped > 0) { " lossy" } else { "" };
    let (from, to) = (&placed.nodes[bundle.from], &placed.nodes[bundle.to]);
    let in_column = |of: &Rect| {
        let middle = of.x + of.size.width / 2.0;
        placed.nodes.iter().filter(move |rect| rect.x < middle && middle < rect.right()).cloned().collect::<Vec<_>>()
    };
    let right = in_column(from).iter().map(Rect::right).fold(from.right(), f64::max) + BACK_GAP;
    let left = in_column(to).iter().map(|rect| rect.x).fold(to.x, f64::min) - BACK_GAP;
    // Below the wires that leave and enter the boxes.
    let (leaves, enters) = (from.y + from.size.height - 4.0, to.y + to.size.height - 4.0);
    let tooltip: Vec<_> = bundle.links.iter().map(|link| link.tooltip.as_str()).collect();
    let _ = writeln!(out, "<g><title>{}</title>", escape(&tooltip.join("\n")));
    let _ = writeln!(
        out,
        "<path class=\"wire back{lossy}\" d=\"M{:.1} {leaves:.1} H{right:.1} V{lane:.1} H{left:.1} V{enters:.1} H{:.1}\"/>",
        from.right(),
        to.x - 6.0
    );
    let _ = writeln!(out, "<path class=\"tip{lossy}\" d=\"M{:.1} {enters:.1} l-7 -3.5 v7 z\"/>", to.x);
    let labels = bundle.links.iter().flat_map(|link| link.label.iter().map(|line| (line, link.dropped > 0)));
    for (line, (words, dropped)) in labels.enumerate() {
        let class = if dropped { "label dropped" } else { "label" };
        let at = ((left + right) / 2.0, lane + 2.0 + (line as f64 + 0.9) * LABEL_LINE);
        text(out, at, &format!("class=\"{class}\" text-anchor=\"middle\""), &truncated(words));
    }
    out.push_str("</g>\n");
}

/// Title, notes and the legend of the colours.
struct Head {
    text: String,
    width: f64,
    height: f64,
}

fn head(diagram: &Diagram) -> Head {
    let mut out = String::new();
    let mut y = MARGIN + 14.0;
    let mut width = width_of(&diagram.title, 18.0);
    let title = "class=\"ink\" style=\"font-size: 18px; font-weight: bold\"";
    text(&mut out, (MARGIN, y), title, &truncated(&diagram.title));
    for line in &diagram.notes {
        y += 17.0;
        let line: String = line.lines().next().unwrap_or_default().chars().take(160).collect();
        width = width.max(width_of(&line, 11.0));
        text(&mut out, (MARGIN, y), "class=\"faint\"", &line);
    }
    if diagram.nodes.iter().any(|node| node.busy_share.is_some()) {
        y += 20.0;
        let mut x = MARGIN;
        let legend = |out: &mut String, x: &mut f64, words: &str, class: &str| {
            text(out, (*x, y), &format!("class=\"{class}\""), words);
            *x += width_of(words, 11.0) + 14.0;
        };
        legend(&mut out, &mut x, "share of the time that nodes were busy:", "faint");
        for (_, colour, what) in SHARE_COLOURS {
            let _ = writeln!(
                out,
                "<rect class=\"box\" fill=\"{colour}\" x=\"{x:.1}\" y=\"{:.1}\" width=\"14\" height=\"12\" rx=\"2\"/>",
                y - 10.0
            );
            x += 19.0;
            legend(&mut out, &mut x, what, "faint");
        }
        legend(&mut out, &mut x, "\u{25c6} the slowest", "faint");
        legend(&mut out, &mut x, "on wires: items", "faint");
        legend(&mut out, &mut x, "dropped items", "faint dropped");
        width = width.max(x - MARGIN);
    }
    Head { text: out, width, height: y - MARGIN + 22.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Node;

    #[test]
    fn text_is_escaped_and_truncated() {
        let node =
            |name: &str| Node { name: name.into(), failure: Some("a < b & \"c\"\u{0}\nd".into()), ..Node::default() };
        let link = Link { from: 0, to: 1, label: vec!["<x>".into()], dropped: 3, tooltip: "a -> b".into() };
        let diagram = Diagram {
            title: "a & b".into(),
            notes: vec!["<now>".into()],
            nodes: vec![node("first"), node(&"x".repeat(200))],
            links: vec![link],
        };
        let drawn = svg(&diagram);
        assert!(drawn.contains("failed: a &lt; b &amp; &quot;c&quot;\nd</title>"), "{drawn}");
        assert!(drawn.contains("&lt;x&gt;") && drawn.contains("class=\"wire lossy\""), "{drawn}");
        assert!(!drawn.contains('\u{0}') && drawn.contains(&format!("{}\u{2026}", "x".repeat(45))), "{drawn}");
        roxmltree::Document::parse(&drawn).unwrap();
    }

    #[test]
    fn a_diagram_without_nodes_or_links_is_drawn() {
        for nodes in [0, 1] {
            let diagram = Diagram { nodes: vec![Node::default(); nodes], ..Diagram::default() };
            assert!(svg(&diagram).ends_with("</svg>\n"));
        }
    }
}
