use super::*;
use crate::fault::{SourceText, Span};
use std::sync::Arc;

/// A text of this name, which is the file of a module if it is used as a node.
fn text(name: &str, order: usize, used: Option<(&str, &Span)>) -> Arc<SourceText> {
    let used = used.map(|(node, at)| Use { node: node.into(), at: at.clone() });
    let text = "first\nsecond\nthird\n".into();
    Arc::new(SourceText {
        name: name.into(),
        dir: "".into(),
        text,
        order,
        command_line: false,
        merged: Default::default(),
        used,
        line_starts: Default::default(),
    })
}

fn at(text: &Arc<SourceText>, start: usize) -> Span {
    Span::new(text, start..start + 2)
}

fn messages(faults: &[Fault]) -> Vec<&str> {
    faults.iter().map(|fault| fault.message.as_str()).collect()
}

#[test]
fn a_fault_of_a_module_is_listed_once_with_every_use() {
    let graph = text("graph.toml", 0, None);
    let (one, two) = (at(&graph, 0), at(&graph, 6));
    let (first, second) = (text("m.toml", 1, Some(("one", &one))), text("m.toml", 2, Some(("two", &two))));
    let fault = |text: &Arc<SourceText>, node: &str, start: usize, message: &str, label: &str| {
        Fault::new(format!("node \"{node}/crop\": {message}")).at(&at(text, start), label)
    };
    let same = add_uses(vec![fault(&first, "one", 3, "wrong", "here"), fault(&second, "two", 3, "wrong", "here")]);
    assert_eq!(messages(&same), ["node \"one/crop\": wrong"]);
    let uses: Vec<_> = same[0].also.iter().map(|(span, label)| (span.range.start, label.as_str())).collect();
    assert_eq!(uses, [(0, "used here as \"one\""), (6, "used here as \"two\"")]);
    // Another place, label, message, file or use is another fault.
    let other = text("n.toml", 2, Some(("two", &two)));
    for (what, later) in [
        ("place", fault(&second, "two", 4, "wrong", "here")),
        ("label", fault(&second, "two", 3, "wrong", "there")),
        ("message", fault(&second, "two", 3, "not right", "here")),
        ("node", fault(&second, "three", 3, "wrong", "here")),
        ("file", fault(&other, "two", 3, "wrong", "here")),
        ("use", fault(&first, "one", 3, "wrong", "here")),
        ("graph", fault(&graph, "two", 3, "wrong", "here")),
        ("nowhere", Fault::new("node \"two/crop\": wrong")),
    ] {
        let found = add_uses(vec![fault(&first, "one", 3, "wrong", "here"), later]);
        assert_eq!(found.len(), 2, "another {what}");
    }
    let twice = add_uses(vec![fault(&graph, "x", 3, "wrong", "here"), fault(&graph, "x", 3, "wrong", "here")]);
    assert_eq!((twice.len(), twice[1].also.len()), (2, 0), "faults of the graph stay as they are");
    // A module in a module names both uses.
    let inner = text("inner.toml", 3, Some(("one/inner", &at(&first, 6))));
    let nested = add_uses(vec![fault(&inner, "one/inner", 0, "wrong", "here")]);
    let uses: Vec<_> = nested[0].also.iter().map(|(_, label)| label.as_str()).collect();
    assert_eq!(uses, ["used here as \"one/inner\"", "used here as \"one\""]);
}

#[test]
fn faults_are_in_the_order_of_the_texts_and_consequences_of_a_syntax_fault_are_left_out() {
    let (graph, base) = (text("graph.toml", 0, None), text("base.toml", 1, None));
    let fault = |name: &str, text: &Arc<SourceText>, start: usize| Fault::new(name).at(&at(text, start), "");
    let all = || {
        vec![
            fault("base", &base, 0),
            fault("third line", &graph, 14),
            Fault::new("nowhere"),
            fault("follows", &base, 7).follows(),
            fault("second line", &graph, 8),
        ]
    };
    assert_eq!(messages(&sorted(all())), ["nowhere", "second line", "third line", "base", "follows"]);
    let mut broken = all();
    broken.push(fault("syntax", &graph, 6).hides(&at(&graph, 6)));
    assert_eq!(messages(&sorted(broken)), ["nowhere", "syntax", "third line", "base"]);
    // A syntax fault is no consequence of another one.
    let mut broken = all();
    for start in [6, 8] {
        broken.push(fault("syntax", &graph, start).hides(&at(&graph, 6)).follows());
    }
    assert_eq!(messages(&sorted(broken)), ["nowhere", "syntax", "syntax", "third line", "base"]);
}

#[test]
fn a_warning_at_several_places_is_listed_once_and_an_error_at_each() {
    let graph = text("graph.toml", 0, None);
    let fault = |start: usize| Fault::new("it is ignored").at(&at(&graph, start), "here");
    let told = sorted(vec![fault(12).warning(), fault(0).warning(), fault(6), fault(7)]);
    assert_eq!(messages(&told), ["it is ignored"; 3]);
    let places: Vec<_> = told[0].at.iter().chain(&told[0].also).map(|(span, _)| span.range.start).collect();
    assert_eq!(places, [0, 12]);
}
