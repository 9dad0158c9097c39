//! One program gives the same bits on every processor: what it takes from the C library, which of its libraries ask for the processor's
//! features, and runs from which the C library hides some.

use crate::{
    arrows::ARROWS,
    common::{build, osteoflow_to_spawn, program, root, skips_slow},
    python_package,
};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    io::Read,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

/// What the C library shall not see: without these it computes as on a processor of 2008.
const HIDDEN: &str = "glibc.cpu.hwcaps=-AVX2_Usable,-FMA_Usable,-AVX2,-FMA,-AVX512F,-FMA4";

/// Libraries of the program that ask for the processor's features, and why their results do not depend on them.
const ASK: [(&str, &str); 17] = [
    ("base64", "exact"),
    ("chacha20", "integers"),
    ("constant_time_eq", "compares bytes"),
    ("cpufeatures", "asks for others, which are in this list"),
    ("crc32fast", "integers"),
    ("getrandom", "gives what is random in any case"),
    ("httparse", "finds the same bytes"),
    ("jpeg-decoder", "integers; lossless images have no transform"),
    ("libm", "a fused product and sum, which is exact either way"),
    ("matrixmultiply", "not called, see below"),
    ("memchr", "finds the same bytes"),
    ("portable-atomic", "no numbers"),
    ("ppv-lite86", "integers"),
    ("sha1", "integers"),
    ("sha2", "integers"),
    ("simd-adler32", "integers"),
    ("zune-core", "asked by zune-jpeg, which is compiled without such code"),
];

/// The symbols of a file by `nm` with these options; `None` without one.
fn symbols(file: &Path, options: &[&str]) -> Option<BTreeSet<String>> {
    let output = Command::new("nm").args(options).arg(file).output().ok()?;
    assert!(output.status.success(), "nm {options:?} {}: {}", file.display(), String::from_utf8_lossy(&output.stderr));
    let name =
        |line: &str| line.split_whitespace().last().map(|name| name.split('@').next().unwrap_or(name).to_owned());
    Some(String::from_utf8(output.stdout).unwrap().lines().filter_map(name).collect())
}

/// The functions of the C library of mathematics that a file imports, and those that it gives to others; `None` where there is no `nm`, or
/// no such library.
fn mathematics(file: &Path) -> Option<[Vec<String>; 2]> {
    let asked = Command::new("cc").arg("-print-file-name=libm.so.6").output().ok()?;
    let library = PathBuf::from(String::from_utf8(asked.stdout).unwrap().trim()).canonicalize().ok()?;
    let known = symbols(&library, &["-D", "--defined-only"])?;
    assert!(["sin", "exp", "powf", "sincos"].iter().all(|name| known.contains(*name)), "{}", library.display());
    let of = |option| Some(symbols(file, &["-D", option])?.intersection(&known).cloned().collect());
    Some([of("--undefined-only")?, of("--defined-only")?])
}

#[test]
fn no_function_of_mathematics_is_taken_from_the_c_library_or_given_to_others() {
    let test = "no_function_of_mathematics_is_taken_from_the_c_library_or_given_to_others";
    let dir = tempfile::tempdir().unwrap();
    // The check sees a file that takes one, and gives one.
    let (source, takes) = (dir.path().join("takes.c"), dir.path().join("libtakes.so"));
    fs::write(&source, "#include <math.h>\ndouble sin(double x) { return exp(x); }\n").unwrap();
    if !build::compile(&source, &takes, &["-fno-builtin", "-lm"]) {
        return;
    }
    let Some(found) = mathematics(&takes) else {
        return println!("skipped: {test}: no nm, or no libm.so.6");
    };
    assert_eq!(found, [["exp".to_owned()].to_vec(), ["sin".to_owned()].to_vec()]);

    let mut files = vec![program(), std::env::current_exe().unwrap()];
    files.extend(["template_icp", "template_metric", "plugin_relay"].map(build::example));
    files.extend(extension(dir.path()));
    for file in files {
        let name = file.display();
        let none: [Vec<String>; 2] = Default::default();
        assert_eq!(mathematics(&file).unwrap(), none, "{name}: imported, and exported");
    }
}

/// The library of the Python package, from its wheel.
fn extension(dir: &Path) -> Option<PathBuf> {
    let wheel = match python_package::wheel() {
        Ok((wheel, _)) => wheel,
        Err(why) => {
            println!("skipped: the library of the Python package: {why}");
            return None;
        }
    };
    let mut wheel = zip::ZipArchive::new(fs::File::open(wheel).unwrap()).unwrap();
    let name = wheel.file_names().flatten().find(|name| name.ends_with(".so")).unwrap().into_owned();
    let (mut bytes, file) = (Vec::new(), dir.join("library.so"));
    wheel.by_name(&name).unwrap().read_to_end(&mut bytes).unwrap();
    fs::write(&file, bytes).unwrap();
    Some(file)
}

/// `matrixmultiply` sums in an order that depends on the processor. nalgebra calls it for products of matrices whose sizes are known at run
/// time, which the compiler leaves out of a crate that has none; not of the command's, which is compiled without optimisation.
#[test]
fn no_crate_multiplies_matrices_by_a_kernel_of_the_processor() {
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args(["build", "--release", "--locked", "--offline", "--workspace", "--lib", "--message-format=json"]);
    let output = cargo.current_dir(root()).stderr(Stdio::null()).output().unwrap();
    assert!(output.status.success(), "the crates build");
    let artifacts = String::from_utf8(output.stdout).unwrap();
    let artifacts = artifacts.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
    let files: BTreeSet<String> = artifacts
        .filter(|artifact| artifact["reason"] == "compiler-artifact")
        .filter_map(|artifact| artifact["filenames"].as_array().map(|files| files.to_owned()))
        .flatten()
        .filter_map(|file| file.as_str().map(str::to_owned))
        .filter(|file| file.ends_with(".rlib"))
        .collect();
    let multiply = |name: &str| -> Option<BTreeSet<String>> {
        let file = files.iter().find(|file| file.ends_with(&format!("/lib{name}.rlib")));
        let names = symbols(Path::new(file.unwrap_or_else(|| panic!("no library {name}"))), &["--undefined-only"])?;
        Some(names.into_iter().filter(|name| name.contains("matrixmultiply")).collect())
    };
    for (name, folder, _) in ARROWS.iter().filter(|(name, ..)| !["osteoflow-python", "my_plugin"].contains(name)) {
        // Of macros and of the tests' nodes there is no such file.
        if root().join(folder).join("src").is_dir() && !name.ends_with("macros") {
            let Some(found) = multiply(&name.replace('-', "_")) else {
                return println!("skipped: no_crate_multiplies_matrices_by_a_kernel_of_the_processor: no nm");
            };
            assert!(found.is_empty(), "{name}: multiply by its `product` or `gram`, not by `*`: {found:?}");
        }
    }
    assert!(!multiply("osteoflow").unwrap().is_empty(), "the command's code is optimised: it can be held, too");
    for file in ["nodes/app", "nodes/commands"].into_iter().flat_map(|folder| sources(&root().join(folder))) {
        let text = fs::read_to_string(&file).unwrap();
        let found = ["DMatrix", "Dyn>", "Dyn,", "MatrixXx"].into_iter().find(|name| text.contains(name));
        assert_eq!(found, None, "{}: mathematics belongs into a crate of its own", file.display());
    }
}

/// The Rust files below a folder.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let below = |path: PathBuf| if path.is_dir() { sources(&path) } else { vec![path] };
    entries.flat_map(below).filter(|path| path.extension().is_some_and(|extension| extension == "rs")).collect()
}

#[test]
fn each_library_that_asks_for_features_of_the_processor_is_known() {
    let mut tree = Command::new(env!("CARGO"));
    tree.args(["tree", "--locked", "--offline", "--prefix", "none", "--edges", "normal", "--format", "{p}"]);
    let output = tree.current_dir(root()).output().unwrap();
    let packages: BTreeSet<(String, String)> = String::from_utf8(output.stdout)
        .unwrap()
        .lines()
        .filter_map(|line| line.split_once(" v").map(|(name, rest)| (name, rest.split(' ').next().unwrap())))
        .filter(|(name, _)| !name.starts_with("osteoflow"))
        .map(|(name, version)| (name.to_owned(), format!("{name}-{version}")))
        .collect();
    let home =
        std::env::var_os("CARGO_HOME").map_or_else(|| std::env::home_dir().unwrap().join(".cargo"), PathBuf::from);
    let registries: Vec<PathBuf> =
        fs::read_dir(home.join("registry/src")).unwrap().map(|entry| entry.unwrap().path()).collect();
    let mut asking = BTreeMap::new();
    for (name, folder) in packages {
        let folder = registries.iter().map(|registry| registry.join(&folder)).find(|folder| folder.is_dir());
        let folder = folder.unwrap_or_else(|| panic!("{name} has no sources below {}", home.display()));
        if let Some(file) = asks(&folder) {
            asking.insert(name, file);
        }
    }
    let known: BTreeSet<&str> = ASK.iter().map(|(name, _)| *name).collect();
    let found: BTreeSet<&str> = asking.keys().map(String::as_str).collect();
    assert_eq!(
        found, known,
        "a library that asks gets a line in ASK that says why its results are the same: {asking:#?}"
    );
}

/// A source of a library that asks for features at run time.
fn asks(folder: &Path) -> Option<PathBuf> {
    let is_asking = |line: &str| {
        let asks = ["feature_detected", "cpufeatures::", "__cpuid"].iter().any(|name| line.contains(name));
        asks && !line.trim_start().starts_with("//")
    };
    let own = |file: &PathBuf| {
        let parts = file.strip_prefix(folder).unwrap().iter().map(|part| part.to_str().unwrap_or_default());
        !parts.into_iter().any(|part| ["tests", "benches", "examples", "tests.rs"].contains(&part))
    };
    let files = sources(folder).into_iter().filter(own);
    files.into_iter().find(|file| fs::read_to_string(file).is_ok_and(|text| text.lines().any(is_asking)))
}

/// Whether the C library itself computes otherwise with features hidden; it does not where the processor lacks them.
fn hiding_counts() -> bool {
    let numbers = |tunables: &str| {
        let mut python = Command::new("python3");
        python.args(["-c", "import math; print([math.exp(k / 7) * math.sin(k / 3) for k in range(3000)])"]);
        Some(python.env("GLIBC_TUNABLES", tunables).output().ok()?.stdout)
    };
    numbers("").is_some_and(|plain| numbers(HIDDEN).is_some_and(|hidden| plain != hidden))
}

/// The digest of a run of a graph by a program, or the table of its sweep.
fn bits(program: &Path, arguments: &[&str], tunables: &str) -> String {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let mut command = osteoflow_to_spawn();
    // With the settings of tests, but another file.
    let settings: Vec<_> = command.get_envs().filter_map(|(k, v)| Some((k.to_owned(), v?.to_owned()))).collect();
    command = Command::new(program);
    command.current_dir(root()).envs(settings).env("GLIBC_TUNABLES", tunables).args(arguments).arg("--out").arg(&out);
    let status = command.stdout(Stdio::null()).stderr(Stdio::null()).status().unwrap();
    assert!(status.success(), "{arguments:?}: {status}");
    match fs::read_to_string(out.join("runs.csv")) {
        Ok(table) => table,
        Err(_) => {
            let report = osteoflow_engine::recording::digest::digest(&out.join("run.mcap"), &mut |_, _| {}).unwrap();
            report.digest.unwrap().to_string()
        }
    }
}

#[test]
fn a_run_gives_the_same_bits_with_features_of_the_processor_hidden() {
    if !hiding_counts() {
        return println!(
            "skipped: a_run_gives_the_same_bits_with_features_of_the_processor_hidden: nothing can be hidden here"
        );
    }
    let page = fs::read_to_string(root().join("docs/use/promises.md")).unwrap();
    assert!(
        page.contains(&format!("\nGLIBC_TUNABLES={HIDDEN} osteoflow run graphs/fibula.toml --out old\n")),
        "the page hides others"
    );
    // The verdict's matrices, small enough for every run of the tests.
    let small = ["run", "graphs/fibula.toml", "--set", "recording.camera.n_points=5000", "--set", "bone.exact=true"];
    for arguments in [&["run", "graphs/calibration.toml"][..], &small] {
        assert_eq!(bits(&program(), arguments, ""), bits(&program(), arguments, HIDDEN), "{arguments:?}");
    }
}

#[test]
fn runs_and_sweeps_give_the_same_bits_as_compiled_for_every_level_of_processors() {
    let test = "runs_and_sweeps_give_the_same_bits_as_compiled_for_every_level_of_processors";
    if skips_slow(test) {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let sweep = dir.path().join("sweep.toml");
    let graph = root().join("graphs/fibula.toml");
    let text = format!(
        "extends = \"{}\"\n[graph]\nname = \"small\"\n[node.recording]\ncamera.n_points = 4000\n[node.bone]\nexact = true\n[sweep]\nrepeat = 4\n\
         [sweep.columns]\ntre_mm = \"metrics.tre_true_mm.mean_abs.norm\"\n",
        graph.display()
    );
    fs::write(&sweep, text).unwrap();
    let graphs = ["fibula", "fibula_recorded", "calibration"].map(|name| format!("graphs/{name}.toml"));
    let mut all: Vec<_> = graphs.iter().map(|graph| vec!["run", graph]).collect();
    all.push(vec!["sweep", sweep.to_str().unwrap()]);
    let expected: Vec<String> = all.iter().map(|arguments| bits(&program(), arguments, "")).collect();
    let mut programs = vec![(program(), HIDDEN)];
    for level in ["x86-64-v2", "x86-64-v3", "x86-64-v4"] {
        let has = match level {
            "x86-64-v2" => is_x86_feature_detected!("sse4.2"),
            "x86-64-v3" => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            _ => is_x86_feature_detected!("avx512bw") && is_x86_feature_detected!("avx512vl"),
        };
        if !has {
            println!("skipped: {level}: this processor is older");
            continue;
        }
        // The compiler computes constants by the C library, too.
        let target = root().join("target/processors").join(level);
        let mut cargo = Command::new(env!("CARGO"));
        cargo
            .args(["build", "--release", "--locked", "--package", "osteoflow", "--bin", "osteoflow"])
            .current_dir(root());
        cargo
            .env("RUSTFLAGS", format!("-Ctarget-cpu={level}"))
            .env("CARGO_TARGET_DIR", &target)
            .env("GLIBC_TUNABLES", HIDDEN);
        assert!(cargo.status().unwrap().success(), "{level}");
        programs.push((target.join("release/osteoflow"), ""));
    }
    for (program, tunables) in programs {
        for (arguments, expected) in all.iter().zip(&expected) {
            assert_eq!(&bits(&program, arguments, tunables), expected, "{}: {arguments:?}", program.display());
        }
    }
}
