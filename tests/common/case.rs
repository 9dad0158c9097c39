//! A recorded procedure with its ground truth.

use super::{Ran, data, isometry, json, point, root, run, shared_run};
use osteoflow_geometry::nalgebra::{Isometry3, Matrix3, Point3};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// The graph of recorded procedures.
pub(crate) const GRAPH: &str = "graphs/fibula_recorded.toml";

/// A recording with its surfaces, its plan and the ground truth.
#[derive(Clone)]
pub(crate) struct Case {
    pub(crate) recording: PathBuf,
    pub(crate) bone: PathBuf,
    pub(crate) phantom: PathBuf,
    pub(crate) plan: PathBuf,
    pub(crate) truth: Value,
}

impl Case {
    /// The shipped recording.
    pub(crate) fn shipped() -> Self {
        let dir = root().join("tests/data/procedure");
        Self {
            recording: dir.join("procedure.mcap"),
            bone: dir.join("bone.stl"),
            phantom: dir.join("phantom.stl"),
            plan: dir.join("plan.json"),
            truth: json(&dir.join("truth.json")),
        }
    }

    /// A recording made by another program on a real bone.
    pub(crate) fn development(test: &str) -> Option<Self> {
        Some(Self {
            recording: data(test, "recordings/procedure_dev.mcap")?,
            bone: data(test, "bones/TLEM2_CT_fibula_r.stl")?,
            phantom: data(test, "bones/calibration_phantom.stl")?,
            plan: data(test, "recordings/procedure_dev.plan.json")?,
            truth: json(&data(test, "recordings/procedure_dev.truth.json")?),
        })
    }

    pub(crate) fn all(test: &str) -> Vec<Self> {
        std::iter::once(Self::shipped()).chain(Self::development(test)).collect()
    }

    pub(crate) fn with_plan(&self, plan: &Path, arguments: &[&str]) -> Ran {
        let ran = self.with_graph(GRAPH, plan, arguments);
        assert_eq!(ran.code, 0, "{GRAPH} {arguments:?}: {}", ran.stderr);
        ran
    }

    /// A run of this graph, which may end in a refusal.
    pub(crate) fn with_graph(&self, graph: &str, plan: &Path, arguments: &[&str]) -> Ran {
        let sets = self.sets(plan);
        let sets = sets.iter().flat_map(|set| ["--set", set]);
        run(graph, &sets.chain(arguments.iter().copied()).collect::<Vec<_>>())
    }

    /// Settings that name its files, and this plan.
    fn sets(&self, plan: &Path) -> [String; 4] {
        let sets = [("recording", &*self.recording), ("bone", &self.bone), ("phantom", &self.phantom), ("plan", plan)];
        sets.map(|(node, path)| format!("{node}.path={}", path.display()))
    }

    /// A run of the graph of recorded procedures, made once for all tests.
    pub(crate) fn run(&self, arguments: &[&str]) -> &'static Ran {
        let sets = self.sets(&self.plan);
        let sets = sets.iter().flat_map(|set| ["--set", set]);
        shared_run(GRAPH, &sets.chain(arguments.iter().copied()).collect::<Vec<_>>())
    }

    pub(crate) fn t_world_ct(&self) -> Isometry3<f64> {
        isometry(&self.truth["W_T_CT"])
    }

    /// True positions of the assessment points, in the world.
    pub(crate) fn assessment(&self) -> Vec<Point3<f64>> {
        self.truth["assessment_W_true"].as_array().unwrap().iter().map(point).collect()
    }

    /// The axes of errors: z along the bone.
    pub(crate) fn axes(&self) -> Matrix3<f64> {
        let plan = json(&self.plan);
        let rows = &plan["pca_axes_columns_xyz"];
        if rows.is_array() {
            return Matrix3::from_fn(|r, c| rows[r][c].as_f64().unwrap());
        }
        // Without axes in the plan: z from the malleolus to the knee, x and y across.
        let z = point(&plan["proximal"]).coords.normalize();
        let x = point(&plan["lateral"]).coords;
        let x = (x - z * x.dot(&z)).normalize();
        Matrix3::from_columns(&[x, z.cross(&x), z])
    }
}
