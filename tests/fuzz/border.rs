//! Hostile bytes at the border of plugins and processes: what a plugin describes, what it gives, what a process sends.
#![allow(unsafe_code, reason = "passes views through their C form")]

use crate::targets::REGISTRY;
use osteoflow_engine::plugin::{
    InputDescription, KindDescription, OutputsDescription, PluginDescription, PortDescription, hostile, provide,
};
use osteoflow_geometry::{
    Cloud, Pose,
    nalgebra::{Isometry3, Point3},
};
use osteoflow_node::{
    CachePolicy, Column, ColumnType, DisplayContext, EntryType, Field, FrameEdge, Join, PayloadType, Role, SchemaEntry,
    Value, View,
    abi::{self, IncomingView, OutgoingView, Ownership, schema::PayloadDescription},
};
use std::{io::Write, path::Path, sync::Arc};

/// Numbers of the bytes, in their order; zeros when they have ended.
struct Numbers<'a>(&'a [u8]);

impl Numbers<'_> {
    fn bytes<const N: usize>(&mut self) -> [u8; N] {
        let mut out = [0; N];
        let (now, rest) = self.0.split_at(N.min(self.0.len()));
        out[..now.len()].copy_from_slice(now);
        self.0 = rest;
        out
    }

    fn byte(&mut self) -> u8 {
        self.bytes::<1>()[0]
    }

    /// Mostly a number that could be measured, otherwise any.
    fn float(&mut self) -> f64 {
        match self.byte() {
            0 => f64::from_le_bytes(self.bytes()),
            1 => 1.0,
            _ => f64::from(i16::from_le_bytes(self.bytes())) / 64.0,
        }
    }
}

/// The view of a payload: the first byte chooses which, the others make fields and columns.
pub(crate) fn payload(_: &Path, bytes: &[u8]) {
    let types: Vec<_> = REGISTRY.payload_types().collect();
    let mut numbers = Numbers(bytes);
    let ty = types[usize::from(numbers.byte()) % types.len()];
    let view = view(ty.schema, &mut numbers);
    accept(ty, &view);
    if let Ok(outgoing) = OutgoingView::lent(view, ty.schema) {
        across(ty, outgoing.view(), &mut numbers);
    }
}

/// What is accepted is shown, written as a result, and accepted again.
fn accept(ty: &'static PayloadType, view: &View) {
    let Ok(value) = ty.from_view(view) else { return };
    let again = value.to_view();
    assert!(again.check(ty.schema).is_ok(), "the view of {ty:?} does not fit its schema");
    assert!(ty.from_view(&again).is_ok(), "{ty:?} is accepted once, but not again");
    let _ = value.to_display(&DisplayContext { stamp_ns: 1, wire: "node.port", edge: FrameEdge::Unplanned });
    let _ = (value.to_result(), value.display_centre(), value.n_bytes());
}

fn view(schema: &[SchemaEntry], numbers: &mut Numbers<'_>) -> View {
    let mut view = View::new();
    for entry in schema {
        let spoilt = numbers.byte();
        if spoilt == 1 {
            continue;
        }
        let mut list = |n: usize| (0..n).map(|_| numbers.float()).collect::<Vec<_>>();
        let field = match entry.ty {
            _ if spoilt == 2 => Field::Int(i64::from_le_bytes(numbers.bytes())),
            EntryType::Bool => Field::Bool(numbers.byte() > 127),
            EntryType::Int => Field::Int(i64::from_le_bytes(numbers.bytes())),
            EntryType::Float => Field::Float(numbers.float()),
            EntryType::Floats(n) => Field::Floats(list(n as usize + usize::from(spoilt == 3))),
            EntryType::FloatList => {
                let n = if spoilt == 3 { 200 } else { usize::from(spoilt % 16) };
                Field::Floats(list(n))
            }
            EntryType::Text => Field::Text(text(numbers)),
            EntryType::Column { kind, width } => {
                view.columns.push(column(entry.name, kind, width, spoilt, numbers));
                continue;
            }
        };
        view.head.push((entry.name.into(), field));
    }
    view
}

fn text(numbers: &mut Numbers<'_>) -> Arc<str> {
    match numbers.byte() {
        0 => String::from_utf8_lossy(&numbers.bytes::<40>()).into(),
        1 => "".into(),
        2 => "{\"a\": [1, null]}".into(),
        n if n % 2 == 0 => "ct".into(),
        _ => "world".into(),
    }
}

fn column(name: &'static str, kind: ColumnType, width: u32, spoilt: u8, numbers: &mut Numbers<'_>) -> Column {
    let (kind, width) = match spoilt {
        3 => (ColumnType::U8, width),
        4 => (kind, width.wrapping_add(u32::from(numbers.byte()))),
        _ => (kind, width),
    };
    let n_rows = if spoilt == 5 { 300 } else { u32::from(spoilt % 24) };
    let mut bytes = Vec::new();
    for _ in 0..n_rows * width.min(64) {
        match kind {
            ColumnType::F64 => bytes.extend(numbers.float().to_le_bytes()),
            ColumnType::F32 => bytes.extend((numbers.float() as f32).to_le_bytes()),
            ColumnType::I64 => bytes.extend(i64::from(i16::from_le_bytes(numbers.bytes())).to_le_bytes()),
            ColumnType::U32 => bytes.extend(u32::from(numbers.byte() % 32).to_le_bytes()),
            ColumnType::U8 => bytes.push(numbers.byte()),
        }
    }
    if spoilt == 6 {
        bytes.pop();
    }
    let name = match name.strip_suffix("/*") {
        Some(prefix) => format!("{prefix}/{}", numbers.byte()),
        None => name.to_owned(),
    };
    Column::new(name, kind, width, Arc::new(bytes))
}

/// Receives the view as the program receives one of a plugin, with columns that are described wrongly.
fn across(ty: &'static PayloadType, mut view: abi::View, numbers: &mut Numbers<'_>) {
    // SAFETY: `OutgoingView` points to as many columns.
    let mut columns = match view.n_columns {
        0 => Vec::new(),
        n => unsafe { std::slice::from_raw_parts(view.columns, n as usize) }.to_vec(),
    };
    for column in &mut columns {
        let n_bytes = u128::from(column.n_rows) * u128::from(column.stride);
        match numbers.byte() {
            0 => column.n_rows = u64::from_le_bytes(numbers.bytes()),
            1 => column.stride = u64::from_le_bytes(numbers.bytes()),
            2 => column.type_ = u32::from_le_bytes(numbers.bytes()),
            3 => column.width = u32::from_le_bytes(numbers.bytes()),
            4 => column.data = std::ptr::null(),
            5 => (column.n_rows, column.stride) = (column.n_rows / 2, column.stride * 2),
            6 => column.name = abi::Text { data: std::ptr::null(), length: 9 },
            7 => column.name = abi::Text { data: b"\xff".as_ptr(), length: 1 },
            _ => {}
        }
        let size = ColumnType::from_code(column.type_ as u8).map_or(8, ColumnType::size) as u128;
        let row = (size * u128::from(column.width)).max(u128::from(column.stride));
        // By its contract a pointer that is not null is valid for as many rows.
        if u128::from(column.n_rows) * row > n_bytes {
            column.data = std::ptr::null();
        }
    }
    view.columns = columns.as_ptr();
    if numbers.byte() == 0 {
        view.head_size = view.head_size.min(u64::from(numbers.byte()));
    }
    // SAFETY: head, columns and rows are those of `OutgoingView`, or shorter, or null.
    let Ok(incoming) = (unsafe { IncomingView::new(&view, Ownership::Lent) }) else { return };
    if let Ok(taken) = incoming.take(ty.schema) {
        accept(ty, &taken);
    }
}

/// What a plugin describes, as JSON, provided to the registry.
pub(crate) fn plugin_description(_: &Path, bytes: &[u8]) {
    let Ok(description) = serde_json::from_slice::<PluginDescription>(bytes) else { return };
    let mut registry = REGISTRY.clone();
    let _ = provide(&mut registry, &description, &"0".repeat(64).into(), || Err("not loaded".into()));
    let _ = osteoflow_engine::check_text(
        "format = 1\n[nodes.a]\nkind = \"my.kind\"\nn = 3\n",
        Path::new("graph.toml"),
        &[],
        &registry,
    );
}

/// A description with a kind and a payload of its own.
pub(crate) fn description() -> String {
    let port = |name: &str, payload: &str| PortDescription {
        name: name.into(),
        doc: "a port".into(),
        payload: Some((payload.into(), 1)),
        frames: [None, Some("ct".into()), Some("$frame".into())],
    };
    let own = [
        SchemaEntry::text("frame"),
        SchemaEntry::float("error_mm").optional(),
        SchemaEntry::column("points", ColumnType::F64, 3).unit("mm"),
    ];
    let kind = KindDescription {
        kind: "my.kind".into(),
        doc: "Counts.\n\nMore.".into(),
        params: serde_json::json!({"type": "object", "properties": {"n": {"type": "integer", "default": 2}}}),
        example: "[nodes.a]\nkind = \"my.kind\"\n".into(),
        literature: vec!["paper2025".into()],
        role: Role::Node,
        constant: false,
        kept: CachePolicy::Never,
        inputs: vec![InputDescription {
            port: port("pose", "geometry/Pose"),
            join: Join::Stamp { tolerance_ns: 5 },
            optional: true,
            unused: false,
        }],
        outputs: OutputsDescription::Fixed(vec![port("points", "my/Points")]),
    };
    let description = PluginDescription {
        name: "mine".into(),
        version: "1".into(),
        sdk: "1".into(),
        compiler: "rustc".into(),
        abi: (1, 0),
        kinds: vec![kind],
        payloads: vec![PayloadDescription { name: "my/Points".into(), version: 1, schema: own.to_vec() }],
    };
    serde_json::to_string(&description).expect("a description is JSON")
}

/// What a process sends: the number of bytes of its messages (u32, little-endian), the messages, its shared memory.
pub(crate) fn process(path: &Path, bytes: &[u8]) {
    let Some((n_bytes, rest)) = bytes.split_first_chunk::<4>() else { return };
    let (messages, memory) = rest.split_at((u32::from_le_bytes(*n_bytes) as usize).min(rest.len()));
    let mut file = std::fs::File::options().read(true).write(true).create(true).truncate(true).open(path);
    let file = file.as_mut().expect("the folder can be written");
    file.write_all(memory).expect("the folder can be written");
    let types: Vec<_> = REGISTRY.payload_types().collect();
    let _ = hostile::read_messages(messages, file, &types);
}

/// What processes send that give a cloud and a pose.
pub(crate) fn sent_by_processes() -> Vec<Vec<u8>> {
    let points: Vec<_> = (0..4).map(|n| Point3::new(f64::from(n), 2.0, 3.0)).collect();
    let cloud = Cloud::new("camera", points).expect("finite points");
    let pose = Pose::new("world", "camera", Isometry3::translation(1.0, 2.0, 3.0));
    let sent = [Value::new(cloud), Value::new(pose)].map(|value| {
        let (messages, memory) = hostile::messages_of(value).expect("memory to share");
        let n_bytes = (messages.len() as u32).to_le_bytes();
        [&n_bytes[..], &messages, &memory].concat()
    });
    sent.to_vec()
}
