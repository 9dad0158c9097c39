use super::{Fault, Severity, Span};
use serde_json::{Map, Value, json};

pub(super) fn fault(fault: &Fault) -> Value {
    let mut out = Map::new();
    let severity = match fault.severity {
        Severity::Error => "error",
        Severity::Warning => "warning",
    };
    out.insert("severity".into(), severity.into());
    out.insert("message".into(), fault.message.as_str().into());
    if let Some((span, label)) = &fault.at {
        out.extend(place(span, label));
    }
    let also: Vec<_> = fault.also.iter().map(|(span, label)| Value::Object(place(span, label))).collect();
    out.insert("also".into(), also.into());
    out.insert("notes".into(), json!(fault.notes));
    out.insert("help".into(), json!(fault.help));
    Value::Object(out)
}

fn place(span: &Span, label: &str) -> Map<String, Value> {
    let (start, (end_line, end_column)) = (span.location(), span.end());
    let mut out = Map::new();
    out.insert("file".into(), start.file.display().to_string().into());
    out.insert("line".into(), start.line.into());
    out.insert("column".into(), start.column.into());
    out.insert("end_line".into(), end_line.into());
    out.insert("end_column".into(), end_column.into());
    out.insert("label".into(), label.into());
    out
}
