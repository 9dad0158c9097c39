//! Hostile bytes at the border of plugins and processes: what a plugin describes, what it gives, what a process sends.
#![allow(unsafe_code, reason = "passes views through their C form")]

use super::seeds::MAX_SEED_BYTES;
use super::targets::REGISTRY;
use osteoflow_algorithms::target::Target;
use osteoflow_engine::plugin::{
    InputDescription, KindDescription, OutputsDescription, PluginDescription, PortDescription, hostile, provide,
};
use osteoflow_engine::{Recording, RunOptions, check, run};
use osteoflow_geometry::{Cloud, Mesh, SurfaceOrigin, nalgebra::Point3};
use osteoflow_node::{
    Body, CachePolicy, ColumnType, DisplayContext, FrameEdge, Join, PayloadType, Role, SchemaEntry, Value, View,
    abi::{self, IncomingView, OutgoingView, Ownership, schema::PayloadDescription},
};
use std::{collections::BTreeMap, fs::File, io::Write, path::Path, sync::OnceLock};

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
}

/// The view of a payload, in the encoding of items, as the program takes it; then as a plugin gives it, with lies about its
/// columns that the last bytes choose.
pub(crate) fn payload(_: &Path, bytes: &[u8]) -> bool {
    let Some((name, view)) = hostile::named_view(bytes) else { return false };
    let Some(ty) = REGISTRY.payload_type(&name) else { return false };
    let is_accepted = accept(ty, &view);
    if let Ok(outgoing) = OutgoingView::lent(view, ty.schema) {
        across(ty, outgoing.view(), &mut Numbers(&bytes[bytes.len().saturating_sub(40)..]));
    }
    is_accepted
}

/// What is accepted is shown, written as a result, and accepted again.
fn accept(ty: &'static PayloadType, view: &View) -> bool {
    let Ok(value) = ty.from_view(view) else { return false };
    let again = value.to_view();
    assert!(again.check(ty.schema).is_ok(), "the view of {ty:?} does not fit its schema");
    assert!(ty.from_view(&again).is_ok(), "{ty:?} is accepted once, but not again");
    let _ = value.to_display(&DisplayContext {
        stamp_ns: 1,
        wire: "node.port",
        edge: FrameEdge::Unplanned,
        anchored: false,
    });
    let _ = (value.to_result(), value.display_centre(), value.n_bytes());
    true
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

/// What a plugin describes, as JSON, provided to the registry, and a graph with its kinds.
pub(crate) fn plugin_description(_: &Path, bytes: &[u8]) -> bool {
    let Ok(description) = serde_json::from_slice::<PluginDescription>(bytes) else { return false };
    let mut registry = REGISTRY.clone();
    let provided = provide(&mut registry, &description, &"0".repeat(64).into(), || Err("not loaded".into()));
    let graph = "[graph]\nformat = 1\n[node.s]\nkind = \"my.source\"\n[node.a]\nkind = \"my.kind\"\nn = 3\nin.pose = \"s.pose\"\n[results]\npoints = \"a.points\"\n";
    let checked = osteoflow_engine::check_text(graph, Path::new("graph.toml"), &[], &registry);
    provided.is_ok() && checked.is_ok()
}

/// A description with a source, a node and a payload of its own.
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
        example: "[node.a]\nkind = \"my.kind\"\n".into(),
        literature: vec!["paper2025".into()],
        role: Role::Node,
        constant: false,
        unsteady: false,
        kept: CachePolicy::Never,
        inputs: vec![InputDescription {
            port: port("pose", "geometry/Pose"),
            join: Join::Stamp { tolerance_ns: 5 },
            optional: true,
            unused: false,
        }],
        outputs: OutputsDescription::Fixed(vec![port("points", "my/Points")]),
    };
    let source = KindDescription {
        kind: "my.source".into(),
        params: serde_json::json!({"type": "object", "properties": {}}),
        role: Role::Source,
        inputs: Vec::new(),
        outputs: OutputsDescription::Fixed(vec![port("pose", "geometry/Pose")]),
        ..kind.clone()
    };
    let description = PluginDescription {
        name: "mine".into(),
        version: "1".into(),
        sdk: "1".into(),
        compiler: "rustc".into(),
        abi: (1, 0),
        kinds: vec![source, kind],
        payloads: vec![PayloadDescription { name: "my/Points".into(), version: 1, schema: own.to_vec() }],
        loads: Default::default(),
        watched: Vec::new(),
    };
    serde_json::to_string(&description).expect("a description is JSON")
}

/// What a process sends: the number of bytes of its messages (u32, little-endian), the messages, its shared memory.
pub(crate) fn process(path: &Path, bytes: &[u8]) -> bool {
    let Some((n_bytes, rest)) = bytes.split_first_chunk::<4>() else { return false };
    let (messages, memory) = rest.split_at((u32::from_le_bytes(*n_bytes) as usize).min(rest.len()));
    let file = File::options().read(true).write(true).create(true).truncate(true).open(path);
    let mut file = file.expect("the folder can be written");
    file.write_all(memory).expect("the folder can be written");
    let types: Vec<_> = REGISTRY.payload_types().collect();
    hostile::read_messages(messages, &file, &types).is_ok_and(|n_values| n_values > 0)
}

/// What processes send that give the values.
pub(crate) fn sent(root: &Path) -> Vec<Vec<u8>> {
    let sent = values(root).iter().map(|value| {
        let (messages, memory) = hostile::messages_of(value.clone()).expect("memory to share");
        let n_bytes = (messages.len() as u32).to_le_bytes();
        [&n_bytes[..], &messages, &memory].concat()
    });
    sent.collect()
}

/// The values as items.
pub(crate) fn items(root: &Path) -> Vec<Vec<u8>> {
    values(root).iter().map(|value| hostile::messages_of(value.clone()).expect("memory to share").1).collect()
}

/// A small value of each payload that the recordings of some graphs have, and of the bulky ones.
fn values(root: &Path) -> &'static [Value] {
    static VALUES: OnceLock<Vec<Value>> = OnceLock::new();
    VALUES.get_or_init(|| make_values(root))
}

fn make_values(root: &Path) -> Vec<Value> {
    let corners = vec![Point3::origin(), Point3::new(9.0, 0.0, 0.0), Point3::new(0.0, 9.0, 0.0)];
    let mut values: BTreeMap<&str, Value> = BTreeMap::new();
    let bulky = [
        Value::new(Cloud::new("camera", corners.clone()).expect("finite points")),
        Value::new(Mesh::new("ct", SurfaceOrigin::User, corners.clone(), vec![[0, 1, 2]]).expect("a face")),
        Value::new(Target::new("ct", SurfaceOrigin::User, corners, None).expect("finite points")),
    ];
    values.extend(bulky.map(|value| (value.ty().name, value)));
    for graph in
        ["fibula.toml", "variants/fibula_ruled.toml", "variants/fibula_slide.toml", "variants/fibula_rgb_spot.toml"]
    {
        let folder = tempfile::tempdir().expect("a folder for temporary files");
        let sets = ["record.wires=[\"*\"]".to_owned()];
        let plan = check(&root.join("graphs").join(graph), &sets, &*REGISTRY).expect("a shipped graph").plan;
        let options =
            RunOptions { workers: 1, out_dir: Some(folder.path().into()), record: true, ..RunOptions::default() };
        run(&plan, &REGISTRY, &options, &()).expect("a shipped graph");
        let recording = Recording::open(&folder.path().join("run.mcap")).expect("a recording");
        for wire in recording.wires.keys() {
            for item in recording.items(wire, &REGISTRY).expect("a sound recording") {
                if let Body::Value(value) = item.body
                    && value.n_bytes() < MAX_SEED_BYTES
                {
                    values.entry(value.ty().name).or_insert(value);
                }
            }
        }
    }
    values.into_values().collect()
}
