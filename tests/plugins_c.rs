//! Plugins in C and C++, built by the system compiler with the two headers: the examples give the results of the built-in
//! kinds, columns are not copied in either direction, and payloads unknown to the program pass between plugins and are
//! recorded.

use osteoflow_engine::{
    Event, Observer, Outcome, ReplayOptions, RunOptions, RunReport, check, check_text,
    plan::Plan,
    plugin::{Library, provide},
    recording::digest::digest,
    replay, run,
    validate::validate,
};
use osteoflow_geometry::{
    Cloud, Column,
    nalgebra::{Point3, Vector3},
};
use osteoflow_node::{
    Context, Describe, Inputs, Node, NodeError, Outputs, ParamError, Registry, Source, schemars, serde,
};
use osteoflow_payloads::Text;
use serde_json::Value;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, OnceLock},
};

use crate::common::{build, root};

const EXAMPLES: &str = "nodes/kinds/payloads/examples/c";

/// The library of a C or C++ file; `None` if there is no compiler.
fn library(file: &str) -> Option<PathBuf> {
    static BUILT: Mutex<BTreeMap<String, Option<PathBuf>>> = Mutex::new(BTreeMap::new());
    let name = Path::new(file).file_stem().unwrap().to_str().unwrap();
    let at = |name: &str| Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("lib{name}.so"));
    let built = BUILT
        .lock()
        .unwrap()
        .entry(file.to_owned())
        .or_insert_with(|| {
            let library = at(name);
            build::compile(Path::new(file), &library, &[]).then_some(library)
        })
        .clone()?;
    // Each test has its own library, because it counts the clouds it gave.
    let own = at(&format!("{name}_{}", std::thread::current().name().unwrap()));
    std::fs::copy(built, &own).unwrap();
    Some(own)
}

/// The built-in kinds, those of this file, and those of `libraries`.
fn registry(libraries: &[&Path]) -> Registry {
    let mut registry = osteoflow_standard::registry();
    registry.source::<Give>().node::<Address>().node::<Keep>().node::<Dress>();
    for path in libraries {
        let library: &'static Library = Box::leak(Box::new(Library::load(path).unwrap()));
        provide(&mut registry, library.description(), &"0".into(), move || Ok(library)).unwrap();
    }
    registry
}

fn plan(graph: &str, registry: &Registry) -> Plan {
    let graph = format!("[graph]\nformat = 1\n{graph}");
    check_text(&graph, &root().join("test.toml"), &[], registry).unwrap_or_else(|faults| panic!("{faults}")).plan
}

/// Runs a graph.
fn try_run(graph: &str, registry: &Registry) -> RunReport {
    run(&plan(graph, registry), registry, &RunOptions::default(), &()).unwrap()
}

/// Results of a complete run.
fn results(graph: &str, registry: &Registry) -> Value {
    let report = try_run(graph, registry);
    assert_eq!(report.outcome, Outcome::Complete, "{graph}");
    report.results
}

/// Runs a plan with a recording in `dir`.
fn recorded(plan: &Plan, registry: &Registry, dir: &Path) -> PathBuf {
    let options = RunOptions { out_dir: Some(dir.into()), record: true, ..RunOptions::default() };
    let report = run(plan, registry, &options, &()).unwrap();
    assert_eq!(report.outcome, Outcome::Complete);
    dir.join("run.mcap")
}

// ---- Kinds of these tests ----------------------------------------------------------------------------------------------

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
struct NoParams {}

#[derive(Inputs)]
struct CloudIn {
    /// A cloud.
    cloud: Cloud,
}

#[derive(Outputs)]
struct TextOut {
    /// The observation.
    text: Text,
}

#[derive(Outputs)]
struct CloudOut {
    /// A cloud.
    cloud: Cloud,
}

fn address(cloud: &Cloud) -> Text {
    Text(cloud.points().as_ptr().addr().to_string().into())
}

/// A cloud of the program, and the address of its points.
#[derive(Describe)]
struct Give(bool);

#[derive(Outputs)]
struct GiveOut {
    /// A cloud.
    cloud: Cloud,
    /// The address of its points.
    text: Text,
}

impl Source for Give {
    const KIND: &'static str = "test.give";
    type Params = NoParams;
    type Outputs = GiveOut;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self(false))
    }

    fn next(&mut self, _: &mut Context) -> Result<Option<GiveOut>, NodeError> {
        let ended = std::mem::replace(&mut self.0, true);
        let cloud = Cloud::new("camera", [1.0, 2.0, 3.0].map(|x| Point3::new(x, 0.0, -x)).to_vec())?;
        Ok((!ended).then(|| GiveOut { text: address(&cloud), cloud }))
    }
}

/// Address of the points of a cloud.
#[derive(Describe)]
struct Address;

impl Node for Address {
    const KIND: &'static str = "test.address";
    type Params = NoParams;
    type Inputs = CloudIn;
    type Outputs = TextOut;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: CloudIn, _: &mut Context) -> Result<TextOut, NodeError> {
        Ok(TextOut { text: address(&i.cloud) })
    }
}

/// Keeps a cloud after the run.
#[derive(Describe)]
struct Keep;

static KEPT: Mutex<Option<Cloud>> = Mutex::new(None);

impl Node for Keep {
    const KIND: &'static str = "test.keep";
    type Params = NoParams;
    type Inputs = CloudIn;
    type Outputs = TextOut;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: CloudIn, _: &mut Context) -> Result<TextOut, NodeError> {
        let text = address(&i.cloud);
        *KEPT.lock().unwrap() = Some(i.cloud);
        Ok(TextOut { text })
    }
}

/// Adds every optional column and field to a cloud.
#[derive(Describe)]
struct Dress;

impl Node for Dress {
    const KIND: &'static str = "test.dress";
    type Params = NoParams;
    type Inputs = CloudIn;
    type Outputs = CloudOut;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: CloudIn, _: &mut Context) -> Result<CloudOut, NodeError> {
        let normals: Column<Vector3<f64>> = i.cloud.points().iter().map(|p| p.coords.normalize()).collect();
        let grey: Column<f64> = i.cloud.points().iter().map(|p| p.x.sin()).collect();
        let nearness: Column<f64> = i.cloud.points().iter().map(|p| 1.0 / p.z).collect();
        assert!(i.cloud.viewpoint.is_some() && i.cloud.stamp_ns != 0, "a scan has both");
        let cloud = i.cloud.with_normals(normals)?.with_extra("grey", grey)?.with_extra("nearness", nearness)?;
        Ok(CloudOut { cloud: cloud.labelled("P1 µ") })
    }
}

// ---- The examples ------------------------------------------------------------------------------------------------------

/// A recorded scan of the built-in bone with all optional columns, cropped.
fn crop(kind: &str, rest: &str) -> String {
    format!(
        r#"
        [node.recording]
        kind = "acquire.simulated"
        camera = {{ n_points = 2000 }}
        [node.dress]
        kind = "test.dress"
        in = {{ cloud = "recording.scan" }}
        [node.crop]
        kind = "{kind}"
        in = {{ cloud = "dress.cloud", region = "recording.region" }}
        {rest}
        [record]
        wires = ["dress.cloud", "crop.cloud"]
        [results]
        cloud = "crop.cloud"
        "#
    )
}

#[test]
fn the_crop_in_c_equals_the_built_in_one_to_the_last_bit() {
    let Some(library) = library(&format!("{EXAMPLES}/crop_box.c")) else { return };
    let registry = registry(&[&library]);
    let bounds = "min_mm = [-15.0, -100.0, 0.0]\nmax_mm = [20.5, 4.0, 1000.0]";
    for (rest, cuts) in [(bounds, true), ("max_mm = [1000.0, 1.5, 1000.0]", true), ("", false)] {
        let (a, b) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let built_in = recorded(&plan(&crop("crop.box", rest), &registry), &registry, a.path());
        let in_c = recorded(&plan(&crop("crop_c.box", rest), &registry), &registry, b.path());
        let [built_in, in_c] = [&built_in, &in_c].map(|path| digest(path, &mut |_, _| {}).unwrap());
        let of = |report: &osteoflow_engine::recording::digest::DigestReport, wire: &str| {
            report.wires.iter().find(|w| w.wire == wire).and_then(|w| w.digest).unwrap()
        };
        assert_eq!(of(&in_c, "crop.cloud"), of(&built_in, "crop.cloud"), "{rest}");
        assert_eq!(of(&in_c, "crop.cloud") != of(&in_c, "dress.cloud"), cuts, "{rest}");
    }
}

#[test]
fn the_crop_in_c_gives_the_error_messages_of_the_built_in_one() {
    let Some(library) = library(&format!("{EXAMPLES}/crop_box.c")) else { return };
    let registry = registry(&[&library]);
    let said =
        |kind: &str, rest: &str| match run(&plan(&crop(kind, rest), &registry), &registry, &RunOptions::default(), &())
        {
            Ok(RunReport { outcome: Outcome::Refused(refusal), .. }) => refusal.to_string(),
            Ok(report) => panic!("{:?}", report.outcome),
            Err(error) => error.to_string(),
        };
    let nothing = said("crop_c.box", "max_mm = [-1e5, 0.0, 0.0]");
    assert!(nothing.contains("points lies in the region of interest; is it given in mm, in camera?"), "{nothing}");
    // The built-in one says where the points lie, too.
    let built_in = said("crop.box", "max_mm = [-1e5, 0.0, 0.0]");
    assert!(built_in.starts_with(&format!("{nothing} They lie in the box ")), "{built_in}");
    let turned_over = said("crop_c.box", "min_mm = [0.0, 5.0, 0.0]\nmax_mm = [1.0, 4.0, 1.0]");
    assert!(turned_over.contains("y reaches from 5 to 4; min is below max"), "{turned_over}");
    let faults = |kind: &str, rest: &str| {
        let graph = format!("[graph]\nformat = 1\n{}", crop(kind, rest));
        let faults = check_text(&graph, Path::new("test.toml"), &[], &registry).unwrap_err();
        faults.0.iter().map(|fault| fault.message.replace("crop_c.", "crop.")).collect::<Vec<_>>()
    };
    // A run says it of a plugin, which a check does not build.
    let built_in = faults("crop.box", "min_mm = [0.0, 5.0, 0.0]\nmax_mm = [1.0, 4.0, 1.0]");
    assert!(built_in.len() == 1 && turned_over.ends_with(&built_in[0]), "{turned_over} is not {built_in:?}");
    for rest in ["min_mm = [0.0, 5.0]", "min_mm = 5", "min = [0.0, 5.0, 1.0]"] {
        assert_eq!(faults("crop_c.box", rest), faults("crop.box", rest), "{rest}");
    }
}

/// The shipped procedure with these settings, and every fourth point of the scan.
fn fibula(sets: &[&str], registry: &Registry) -> Plan {
    let thinned = [
        "bone.exact=true",
        "thin.kind=cloud.downsample",
        "thin.in.cloud=to_bone.cloud",
        "thin.every=4",
        "icp.in.source=thin.cloud",
        "results.pose=icp.t_target_source",
    ];
    let all: Vec<_> = thinned.iter().chain(sets).map(|set| (*set).to_owned()).collect();
    check(&root().join("graphs/fibula.toml"), &all, registry).unwrap_or_else(|faults| panic!("{faults}")).plan
}

#[test]
fn the_icp_in_cpp_converges_to_the_pose_of_the_built_in_one_within_a_billionth_of_a_millimetre() {
    let Some(library) = library(&format!("{EXAMPLES}/icp.cpp")) else { return };
    let registry = registry(&[&library]);
    let options = RunOptions::default();
    let ran = |sets: &[&str]| {
        let report = run(&fibula(sets, &registry), &registry, &options, &()).unwrap();
        assert_eq!(report.outcome, Outcome::Complete);
        report.results
    };
    let built_in = ran(&["icp.kind=icp.published", "icp.reading=iterations", "icp.max_iterations=5000"]);
    let in_cpp = ran(&["icp.kind=icp_cpp.point_to_point", "icp.max_iterations=5000"]);
    let [a, b] = [&built_in, &in_cpp].map(|results| crate::common::isometry(&results["pose"]["matrix"]));
    let centre = a.inverse() * crate::common::point(&built_in["icp"]["centroid_mm"]);
    let ends = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| centre + axis * 100.0);
    let off_mm = ends.iter().chain([&centre]).map(|p| (a * p - b * p).norm()).fold(0.0, f64::max);
    println!("{off_mm:.1e} mm apart; steps: {} and {}", built_in["icp"]["iterations"], in_cpp["icp"]["iterations"]);
    assert!(off_mm < 1e-9, "{off_mm} mm apart within 100 mm of the scan's centroid");
    assert_eq!(in_cpp["icp"]["converged"], true, "no pair changes any more");
    assert_eq!(in_cpp["icp"]["n_pairs"], built_in["icp"]["n_pairs"]);
    let rms = |results: &Value| results["icp"]["rms_mm"].as_f64().unwrap();
    assert!((rms(&in_cpp) - rms(&built_in)).abs() < 1e-9, "{} and {} mm", rms(&in_cpp), rms(&built_in));
}

#[test]
fn an_exception_of_the_icp_is_an_error_of_the_node_and_other_branches_finish() {
    let Some(library) = library(&format!("{EXAMPLES}/icp.cpp")) else { return };
    let registry = registry(&[&library]);
    let plan = fibula(&["icp.kind=icp_cpp.point_to_point", "icp.max_pair_distance_mm=0.000001"], &registry);
    let report = run(&plan, &registry, &RunOptions::default(), &()).unwrap();
    let Outcome::Refused(refusal) = report.outcome else { panic!("{:?}", report.outcome) };
    let said = refusal.to_string();
    assert!(
        said.contains("icp") && said.contains("source points lie within 0.000001 mm of the target, 10 are"),
        "{said}"
    );
    let hole = report.nodes.iter().find(|node| node.name == "hole").unwrap();
    assert_eq!((hole.items, hole.failed), (3, 0), "the other branches finished");
}

#[test]
fn a_graph_names_libraries_and_swaps_crop_and_icp_by_kind() {
    let Some(crop) = library(&format!("{EXAMPLES}/crop_box.c")) else { return };
    let Some(icp) = library(&format!("{EXAMPLES}/icp.cpp")) else { return };
    let dir = tempfile::tempdir().unwrap();
    let graph = dir.path().join("graph.toml");
    let base = root().join("graphs/fibula.toml");
    std::fs::write(&graph, format!("extends = {base:?}\nplugins = [{crop:?}, {icp:?}]\n")).unwrap();
    let graph = graph.to_str().unwrap();
    let digest_of = |ran: &crate::common::Ran| digest(&ran.dir.path().join("run.mcap"), &mut |_, _| {}).unwrap().digest;
    let small = ["--set", "recording.camera.n_points=5000", "--set", "bone.exact=true"];
    let bounds = [&small[..], &["--set", "crop.max_mm=[1000.0, 1000.0, 206.0]"]].concat();
    let built_in = crate::common::run_whole(graph, &bounds);
    let swapped = crate::common::run_whole(graph, &[&bounds[..], &["--set", "crop.kind=crop_c.box"]].concat());
    assert_eq!(digest_of(&swapped), digest_of(&built_in), "no wire of the procedure differs by a bit");
    assert!(built_in.results["icp"]["n_source"].as_u64().unwrap() < 4750, "something is cut off");
    let in_cpp = crate::common::run_whole(graph, &[&small[..], &["--set", "icp.kind=icp_cpp.point_to_point"]].concat());
    assert_eq!(in_cpp.results["icp"]["converged"], true);
    assert!(
        crate::common::json(&in_cpp.dir.path().join("manifest.json")).to_string().contains("icp_cpp.point_to_point")
    );
}

/// Collects the failures of a run.
#[derive(Default)]
struct Failures(Mutex<Vec<String>>);

impl Observer for Failures {
    fn event(&self, event: &Event<'_>) {
        if let Event::Failed(refusal) = event {
            self.0.lock().unwrap().push(refusal.to_string());
        }
    }
}

#[test]
fn exceptions_in_cpp_are_errors_and_the_run_continues() {
    let Some(library) = library("tests/plugins/throws.cpp") else { return };
    let registry = registry(&[&library]);
    let graph = r#"
        [node.recording]
        kind = "acquire.simulated"
        camera = { n_points = 200 }
        [node.relay]
        kind = "cpp.throws"
        in = { value = "recording.stylus_assessment" }
        on_error = "skip"
        [results]
        points = { from = "relay.value", all = true }
    "#;
    let failures = Failures::default();
    let report = run(&plan(graph, &registry), &registry, &RunOptions::default(), &failures).unwrap();
    let messages = failures.0.into_inner().unwrap();
    let relay = report.nodes.iter().find(|node| node.name == "relay").unwrap();
    assert_eq!((relay.items, relay.failed), (5, 2));
    let messages = match messages.is_empty() {
        true => report.warnings.iter().map(|warning| warning.message.clone()).collect(),
        false => messages,
    };
    for expected in ["the spline turned inside out", "an exception was thrown that is no std::exception"] {
        assert!(messages.iter().any(|message| message.contains(expected)), "{messages:?}");
    }
    let unknown: Vec<_> = (0..5).map(|item| report.results["points"][item].get("unknown").is_some()).collect();
    assert_eq!(unknown, [false, true, true, false, false], "{}", report.results);
}

// ---- Columns are not copied --------------------------------------------------------------------------------------------

/// A graph of a source of clouds and a node that receives them; both give the address of the points.
fn from_to(give: &str, rest: &str, address: &str) -> String {
    by(give, rest, "crop.box", address)
}

/// Like [`from_to`], with a node of kind `relay` in between.
fn by(give: &str, rest: &str, relay: &str, address: &str) -> String {
    format!(
        r#"
        [node.give]
        kind = "{give}"
        {rest}
        [node.relay]
        kind = "{relay}"
        in = {{ cloud = "give.cloud" }}
        [node.address]
        kind = "{address}"
        in = {{ cloud = "relay.cloud" }}
        [results]
        given = "give.text"
        found = "address.text"
        "#
    )
}

/// Number of blocks of a plugin that were released, such as `1 of 2`.
fn released(prefix: &str, registry: &Registry) -> String {
    let graph = format!("[node.released]\nkind = \"{prefix}.released\"\n[results]\ntext = \"released.text\"\n");
    results(&graph, registry)["text"].as_str().unwrap().into()
}

/// Asserts that points have the same address on both sides, and that each block is released once, after its last use.
fn assert_not_copied(prefix: &str, library: &Path, refused: &[(&str, &str, usize)]) {
    let registry = registry(&[library]);
    let (give, address) = (format!("{prefix}.give"), format!("{prefix}.address"));
    for (give, address) in [("test.give", &*address), (&give, "test.address"), (&give, &address)] {
        let found = results(&from_to(give, "", address), &registry);
        assert_eq!(found["given"], found["found"], "from {give} to {address}");
    }
    assert_eq!(released(prefix, &registry), "2 of 2", "when the runs are over");

    let found = results(&from_to(&give, "", "test.keep"), &registry);
    assert_eq!(released(prefix, &registry), "2 of 3", "one is still in use");
    let kept = KEPT.lock().unwrap().take().unwrap();
    assert_eq!((&found["given"], kept.points()[1]), (&Value::from(&*address_text(&kept)), Point3::new(3.0, 4.0, 5.0)));
    drop(kept);
    assert_eq!(released(prefix, &registry), "3 of 3", "after the last use");

    let mut n = 3;
    for (how, why, n_given) in refused {
        let report = try_run(&from_to(&give, &format!("how = \"{how}\""), "test.address"), &registry);
        let Outcome::Refused(refusal) = report.outcome else { panic!("{how}: {:?}", report.outcome) };
        assert!(refusal.to_string().contains(why), "{how}: {refusal}");
        n += n_given;
        assert_eq!(released(prefix, &registry), format!("{n} of {n}"), "refused: {how}");
    }
}

fn address_text(cloud: &Cloud) -> Arc<str> {
    address(cloud).0
}

/// The two tests share [`KEPT`], so they run one at a time.
static ONE_AT_A_TIME: OnceLock<Mutex<()>> = OnceLock::new();

#[test]
fn columns_are_not_copied_to_or_from_a_plugin_in_c() {
    let Some(library) = library("tests/plugins/address.c") else { return };
    let _alone = ONE_AT_A_TIME.get_or_init(Default::default).lock().unwrap_or_else(|error| error.into_inner());
    let refused = [("nan", "is not finite", 1), ("port", "answers on output 7, but has 2", 1), ("twice", "twice", 2)];
    assert_not_copied("c", &library, &refused);

    // The input columns are emitted with another head.
    let registry = registry(&[&library]);
    for give in ["test.give", "c.give"] {
        let found = results(&by(give, "", "c.hand_on", "test.keep"), &registry);
        let kept = KEPT.lock().unwrap().take().unwrap();
        assert_eq!((&found["given"], kept.label.as_deref()), (&Value::from(&*address_text(&kept)), Some("handed on")));
    }
    assert_eq!(released("c", &registry), "8 of 8");
}

#[test]
fn columns_are_not_copied_to_or_from_a_plugin_in_rust() {
    let library = build::example("plugin_cloud");
    let _alone = ONE_AT_A_TIME.get_or_init(Default::default).lock().unwrap_or_else(|error| error.into_inner());
    assert_not_copied("rust", &library, &[("normals", "1 values for 3 points", 1)]);
}

// ---- Payload types of plugins -------------------------------------------------------------------------------------------

#[test]
fn a_payload_type_of_a_plugin_passes_to_another_plugin_and_is_recorded() {
    let Some(give) = library("tests/plugins/spline_give.c") else { return };
    let Some(length) = library("tests/plugins/spline_length.cpp") else { return };
    let graph = r#"
        [node.splines]
        kind = "acme.splines"
        [node.length]
        kind = "acme.length"
        in = { spline = "splines.spline" }
        [record]
        wires = ["splines.*", "length.*"]
        [results]
        lengths = { from = "length.report", all = true }
        last = "splines.spline"
    "#;
    let both = registry(&[&give, &length]);
    let (first, again) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let recording = recorded(&plan(graph, &both), &both, first.path());
    let results = crate::common::json(&first.path().join("results.json"));
    let lengths: Vec<_> = results["lengths"].as_array().unwrap().iter().map(|row| row["length_mm"].as_f64()).collect();
    assert_eq!(lengths, [5.0, 10.0, 15.0].map(Some));
    assert_eq!(results["lengths"][1]["n_knots"], 0.0, "a field may be missing: {results}");

    let options = RunOptions { out_dir: Some(again.path().into()), record: true, ..RunOptions::default() };
    let replayed = replay(&recording, &ReplayOptions::default(), &both, &options, &()).unwrap();
    assert!(replayed.is_equal() && replayed.wires.iter().any(|wire| wire.n_compared == 3), "{replayed:?}");
    let digests = [&recording, &again.path().join("run.mcap")].map(|path| digest(path, &mut |_, _| {}).unwrap().digest);
    assert_eq!(digests[0], digests[1]);

    // The recording has the schema of a spline, so it is checked without the plugin.
    for known in [&both, &osteoflow_standard::registry()] {
        let report = validate(&recording, known, &mut |_, _| {}).unwrap();
        assert!(report.is_sound(), "{:?}", report.findings);
    }
}

/// A graph with an image of a public writer and the lens that a library sees.
fn lens(library: &Path, process: bool) -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let graph = dir.path().join("graph.toml");
    let recording = root().join("tests/data/ros2_images.mcap");
    let text = format!(
        r#"
        plugins = [{library:?}]
        [graph]
        format = 1
        [node.camera]
        kind = "acquire.mcap"
        path = {recording:?}
        out.image = {{ type = "geometry/Image", topic = "/rgb8", calibration = "/brown/info", labels = ["P1"], frame = "camera" }}
        [node.lens]
        kind = "c.lens"
        in = {{ image = "camera.image" }}
        process = {process}
        [record]
        wires = ["*"]
        [results]
        lens = "lens.text"
    "#
    );
    std::fs::write(&graph, text).unwrap();
    (dir, graph)
}

#[test]
fn a_plugin_sees_the_distortion_of_an_image_and_hands_it_on_to_the_last_bit() {
    let Some(library) = library("tests/plugins/image.c") else { return };
    for process in [false, true] {
        let (_dir, graph) = lens(&library, process);
        let ran = crate::common::run_whole(graph.to_str().unwrap(), &[]);
        // As tests/python/ros2_images.py wrote them.
        assert_eq!(ran.results["lens"], "plumb_bob -0.28 0.09 0.0011 -0.0007 -0.012", "process = {process}");
        let report = digest(&ran.dir.path().join("run.mcap"), &mut |_, _| {}).unwrap();
        let images = report.wires.iter().filter(|wire| wire.payload == "geometry/Image").map(|wire| wire.digest);
        let images: Vec<_> = images.collect();
        assert_eq!(images.len(), 2);
        assert_eq!(images[0], images[1], "process = {process}");
    }
}

#[test]
fn a_plugin_of_before_images_had_distortion_is_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let older = dir.path().join("libolder.so");
    if !build::compile(Path::new("tests/plugins/image.c"), &older, &["-DIMAGE_VERSION=1"]) {
        return;
    }
    let (_dir, graph) = lens(&older, false);
    let ran = crate::common::osteoflow().args(["run", graph.to_str().unwrap()]).output().unwrap();
    let stderr = String::from_utf8_lossy(&ran.stderr);
    assert!(!ran.status.success(), "{stderr}");
    let told = "port \"image\" of kind c.lens names the payload geometry/Image@1, this program has version 2; build the plugin with the SDK";
    assert!(stderr.contains(told), "{stderr}");
    assert!(stderr.contains("libolder.so"), "{stderr}");
}

// ---- The page ----------------------------------------------------------------------------------------------------------

#[test]
fn the_page_about_plugins_shows_this_code() {
    let text = |path: &str| std::fs::read_to_string(root().join(path)).unwrap();
    let sources =
        [format!("{EXAMPLES}/crop_box.c"), format!("{EXAMPLES}/icp.cpp"), "tests/plugins/acme_spline.h".into()]
            .map(|path| text(&path));
    let page = text("docs/extend/writing-a-plugin.md");
    let blocks = ["```c\n", "```cpp\n"].map(|fence| page.split(fence).skip(1).collect::<Vec<_>>()).concat();
    assert!(blocks.len() >= 6, "{} blocks of C and C++ on the page", blocks.len());
    for block in blocks {
        let block = block.split("```").next().unwrap();
        assert!(sources.iter().any(|source| source.contains(block)), "the page shows code that is not there:\n{block}");
    }
}
