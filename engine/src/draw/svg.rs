//! The picture as SVG, drawn without any other program.

use super::{
    Picture, SHARES, class_of, escaped,
    layout::{Edge, Layout, Place, Size, layout},
};
use std::{collections::BTreeMap, fmt::Write};

const MARGIN: f64 = 20.0;
/// Between the lines of a box.
const LINE: f64 = 15.0;
/// Between the lines of a label.
const LABEL_LINE: f64 = 12.0;
/// The mean width of a letter, of its size; on the safe side, as every viewer has its own font.
const LETTER: f64 = 0.58;
/// Longer words are cut in the picture; the tip holds them whole.
const MOST_LETTERS: usize = 46;

/// Boxes keep their light colours and dark words; what stands on the paper changes with the viewer's colours.
const STYLE: &str = "\
text { font-family: system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif; font-size: 12px }
.paper { fill: #ffffff }
.ink { fill: #24292f }
.faint { fill: #59636e; font-size: 11px }
.label { fill: #3c4650; font-size: 10px }
.dropped { fill: #c62828 }
.wire { fill: none; stroke: #8b949e; stroke-width: 1.2 }
.wire.lossy { stroke: #c62828; stroke-width: 2 }
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

/// All wires from one node to one other: drawn as one.
struct Bundle<'a> {
    from: usize,
    to: usize,
    wires: Vec<&'a super::Wire>,
}

/// The picture as SVG: from left to right, its wires labelled, what is known beyond that as a tip of each part.
pub fn svg(picture: &Picture) -> String {
    let mut bundles: BTreeMap<(usize, usize), Bundle<'_>> = BTreeMap::new();
    for wire in &picture.wires {
        let (from, to) = (wire.from, wire.to);
        bundles.entry((from, to)).or_insert(Bundle { from, to, wires: Vec::new() }).wires.push(wire);
    }
    let bundles: Vec<_> = bundles.into_values().collect();
    let sizes: Vec<_> = (0..picture.nodes.len()).map(|node| node_size(picture, node)).collect();
    let edges: Vec<_> =
        bundles.iter().map(|bundle| Edge { from: bundle.from, to: bundle.to, label: label_size(bundle) }).collect();
    let placed = layout(&sizes, &edges);
    let head = head(picture);
    let (dx, dy) = (MARGIN, MARGIN + head.height);
    let width = (placed.size.width + 2.0 * MARGIN).max(head.width + 2.0 * MARGIN);
    let height = dy + placed.size.height + MARGIN;

    let mut out = String::new();
    let (w, h) = (width.ceil(), height.ceil());
    let _ = writeln!(
        out,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" role=\"img\">"
    );
    let _ = writeln!(out, "<title>{}</title>\n<style>{STYLE}</style>", escaped(&picture.name));
    let _ = writeln!(out, "<rect class=\"paper\" width=\"{w}\" height=\"{h}\"/>");
    out.push_str(&head.text);
    let _ = writeln!(out, "<g transform=\"translate({dx:.1} {dy:.1})\">");
    let ends = ends(&bundles, &placed);
    for (index, bundle) in bundles.iter().enumerate() {
        draw_wires(&mut out, bundle, &placed.edges[index], ends[index]);
    }
    for (index, place) in placed.nodes.iter().enumerate() {
        draw_node(&mut out, picture, index, place);
    }
    out.push_str("</g>\n</svg>\n");
    out
}

fn cut(text: &str) -> String {
    cut_to(text, MOST_LETTERS)
}

fn cut_to(text: &str, most: usize) -> String {
    let line = text.lines().next().unwrap_or_default();
    if line.chars().count() <= most && line.len() == text.len() {
        return text.into();
    }
    let mut short: String = line.chars().take(most - 1).collect();
    short.push('\u{2026}');
    short
}

fn width_of(text: &str, size: f64) -> f64 {
    text.chars().count() as f64 * size * LETTER
}

/// What stands in a box: words and their class.
fn lines(picture: &Picture, index: usize) -> Vec<(&'static str, f64, String)> {
    let node = &picture.nodes[index];
    let slowest = slowest(picture) == Some(index);
    let name = if slowest { format!("{} \u{25c6}", node.name) } else { node.name.clone() };
    let mut lines = vec![("name", 14.0, cut(&name))];
    if !node.kind.is_empty() {
        lines.push(("inside", 11.0, cut(&node.kind)));
    }
    lines.extend(node.figures.iter().map(|line| ("inside", 11.0, cut(line))));
    // The reason whole is the tip.
    lines.extend(node.failed.as_ref().map(|reason| ("reason", 11.5, cut_to(&format!("\u{2715} {reason}"), 26))));
    lines
}

/// The node that was busy longest.
fn slowest(picture: &Picture) -> Option<usize> {
    let shares = picture.nodes.iter().enumerate().filter_map(|(index, node)| Some((node.share?, index)));
    shares.filter(|(share, _)| *share > 0.0).max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, index)| index)
}

fn node_size(picture: &Picture, index: usize) -> Size {
    let lines = lines(picture, index);
    let width = lines.iter().map(|(_, size, text)| width_of(text, *size)).fold(60.0, f64::max);
    Size { width: width + 20.0, height: lines.len() as f64 * LINE + 12.0 }
}

fn draw_node(out: &mut String, picture: &Picture, index: usize, place: &Place) {
    let node = &picture.nodes[index];
    let Size { width, height } = place.size;
    let mut tip = vec![if node.kind.is_empty() { node.name.clone() } else { format!("{} ({})", node.name, node.kind) }];
    tip.extend(node.figures.iter().cloned());
    tip.extend((slowest(picture) == Some(index)).then(|| "the node that was busy longest".into()));
    tip.extend(node.failed.as_ref().map(|reason| format!("failed: {reason}")));
    let fill = SHARES[node.share.map_or(0, class_of)].1;
    let (radius, class) =
        (if node.is_source { 14.0 } else { 3.0 }, if node.failed.is_some() { "box failed" } else { "box" });
    let _ = writeln!(out, "<g><title>{}</title>", escaped(&tip.join("\n")));
    let _ = writeln!(
        out,
        "<rect class=\"{class}\" fill=\"{fill}\" x=\"{:.1}\" y=\"{:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" \
         rx=\"{radius}\"/>",
        place.x, place.y
    );
    for (line, (class, _, text)) in lines(picture, index).iter().enumerate() {
        let (x, y) = (place.x + width / 2.0, place.y + 6.0 + (line as f64 + 0.75) * LINE);
        let text = escaped(text);
        let _ = writeln!(out, "<text class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"middle\">{text}</text>");
    }
    out.push_str("</g>\n");
}

/// Where each bundle leaves its producer and meets its consumer: along the side, in the order in which they come.
fn ends(bundles: &[Bundle<'_>], placed: &Layout) -> Vec<((f64, f64), (f64, f64))> {
    let mut ends = vec![((0.0, 0.0), (0.0, 0.0)); bundles.len()];
    for (node, place) in placed.nodes.iter().enumerate() {
        for leaving in [true, false] {
            let own = |bundle: &Bundle<'_>| if leaving { bundle.from == node } else { bundle.to == node };
            let mut beside: Vec<(f64, usize)> = (0..bundles.len())
                .filter(|index| own(&bundles[*index]))
                .filter_map(|index| {
                    let chain = &placed.edges[index];
                    let next = if leaving { chain.first() } else { chain.last() };
                    Some((next.map(|place| passing(place, leaving))?, index))
                })
                .collect();
            beside.sort_by(|a, b| a.0.total_cmp(&b.0));
            let n = beside.len() as f64;
            for (i, (_, index)) in beside.iter().enumerate() {
                let y = place.y + place.size.height * (i as f64 + 1.0) / (n + 1.0);
                match leaving {
                    true => ends[*index].0 = (place.right(), y),
                    false => ends[*index].1 = (place.x, y),
                }
            }
        }
    }
    ends
}

/// Where the wire passes a place: below its label, where the place holds one.
fn passing(place: &Place, has_label: bool) -> f64 {
    if has_label { place.y + place.size.height - 2.0 } else { place.middle() }
}

fn label_size(bundle: &Bundle<'_>) -> Size {
    let lines = bundle.wires.iter().flat_map(|wire| &wire.label).map(|line| cut(line));
    let (mut width, mut n) = (0.0f64, 0);
    for line in lines {
        width = width.max(width_of(&line, 10.0));
        n += 1;
    }
    Size { width: width + 8.0, height: f64::from(n) * LABEL_LINE + 5.0 }
}

fn draw_wires(out: &mut String, bundle: &Bundle<'_>, chain: &[Place], ends: ((f64, f64), (f64, f64))) {
    let lossy = if bundle.wires.iter().any(|wire| wire.dropped > 0) { " lossy" } else { "" };
    let tip: Vec<_> = bundle.wires.iter().map(|wire| wire.about.as_str()).collect();
    let ((x, y), (to_x, to_y)) = ends;
    let mut path = format!("M{x:.1} {y:.1}");
    let (mut x, mut y) = (x, y);
    let mut curve = |x: &mut f64, y: &mut f64, to_x: f64, to_y: f64| {
        let half = (to_x - *x) / 2.0;
        let _ = write!(path, " C{:.1} {y:.1} {:.1} {to_y:.1} {to_x:.1} {to_y:.1}", *x + half, to_x - half);
        (*x, *y) = (to_x, to_y);
    };
    for (i, place) in chain.iter().enumerate() {
        let level = passing(place, i == 0);
        curve(&mut x, &mut y, place.x, level);
        curve(&mut x, &mut y, place.right(), level);
    }
    // The head of the arrow is the last of it.
    curve(&mut x, &mut y, to_x - 6.0, to_y);
    let _ = writeln!(out, "<g><title>{}</title>", escaped(&tip.join("\n")));
    let _ = writeln!(out, "<path class=\"wire{lossy}\" d=\"{path}\"/>");
    let _ = writeln!(out, "<path class=\"tip{lossy}\" d=\"M{to_x:.1} {to_y:.1} l-7 -3.5 v7 z\"/>");
    if let Some(place) = chain.first() {
        let labels = bundle.wires.iter().flat_map(|wire| wire.label.iter().map(|line| (line, wire.dropped > 0)));
        for (line, (text, dropped)) in labels.enumerate() {
            let class = if dropped { "label dropped" } else { "label" };
            let (x, y) = (place.x + place.size.width / 2.0, place.y + (line as f64 + 0.75) * LABEL_LINE);
            let text = escaped(&cut(text));
            let _ =
                writeln!(out, "<text class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"middle\">{text}</text>");
        }
    }
    out.push_str("</g>\n");
}

/// The name, what the run was, and what the colours mean.
struct Head {
    text: String,
    width: f64,
    height: f64,
}

fn head(picture: &Picture) -> Head {
    let mut text = String::new();
    let mut y = MARGIN + 14.0;
    let mut width = width_of(&picture.name, 18.0);
    let _ = writeln!(
        text,
        "<text class=\"ink\" x=\"{MARGIN}\" y=\"{y:.1}\" style=\"font-size: 18px; font-weight: bold\">{}</text>",
        escaped(&cut(&picture.name))
    );
    for line in &picture.about {
        y += 17.0;
        let line: String = line.lines().next().unwrap_or_default().chars().take(160).collect();
        width = width.max(width_of(&line, 11.0));
        let _ = writeln!(text, "<text class=\"faint\" x=\"{MARGIN}\" y=\"{y:.1}\">{}</text>", escaped(&line));
    }
    if picture.nodes.iter().any(|node| node.share.is_some()) {
        y += 20.0;
        let mut x = MARGIN;
        let words = |text: &mut String, x: &mut f64, words: &str, class: &str| {
            let _ = writeln!(text, "<text class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\">{words}</text>");
            *x += width_of(words, 11.0) + 14.0;
        };
        words(&mut text, &mut x, "share of the time that nodes were busy:", "faint");
        for (_, colour, what) in SHARES {
            let _ = writeln!(
                text,
                "<rect class=\"box\" fill=\"{colour}\" x=\"{x:.1}\" y=\"{:.1}\" width=\"14\" height=\"12\" rx=\"2\"/>",
                y - 10.0
            );
            x += 19.0;
            words(&mut text, &mut x, what, "faint");
        }
        words(&mut text, &mut x, "\u{25c6} the slowest", "faint");
        words(&mut text, &mut x, "on wires: items", "faint");
        words(&mut text, &mut x, "dropped items", "faint dropped");
        width = width.max(x - MARGIN);
    }
    Head { text, width, height: y - MARGIN + 22.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::{Node, Wire};
    use serde_json::json;

    #[test]
    fn words_are_escaped_and_cut() {
        let node =
            |name: &str| Node { name: name.into(), failed: Some("a < b & \"c\"\u{0}\nd".into()), ..Node::default() };
        let wire = Wire { from: 0, to: 1, label: vec!["<x>".into()], dropped: 3, about: "a -> b".into() };
        let picture = Picture {
            name: "a & b".into(),
            about: vec!["<now>".into()],
            nodes: vec![node("first"), node(&"x".repeat(200))],
            wires: vec![wire],
        };
        let drawn = svg(&picture);
        assert!(drawn.contains("failed: a &lt; b &amp; &quot;c&quot;\nd</title>"), "{drawn}");
        assert!(drawn.contains("&lt;x&gt;") && drawn.contains("class=\"wire lossy\""), "{drawn}");
        assert!(!drawn.contains('\u{0}') && drawn.contains(&format!("{}\u{2026}", "x".repeat(45))), "{drawn}");
    }

    #[test]
    fn a_picture_without_nodes_or_wires_is_one_too() {
        for nodes in [0, 1] {
            let picture = Picture { nodes: vec![Node::default(); nodes], ..Picture::default() };
            assert!(svg(&picture).ends_with("</svg>\n"));
        }
        let manifest = json!({ "nodes": [], "links": [] });
        assert!(svg(&Picture::of_run(&manifest).unwrap()).contains("unfinished"));
        assert!(Picture::of_run(&json!({})).is_err() && Picture::of_run(&json!([1])).is_err());
    }
}
