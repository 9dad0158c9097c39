//! A bone of the user's own, for the kinds that simulate.

use osteoflow_formats::{input, mesh_or_cloud::read_mesh, plan_file::read_plan_of};
use osteoflow_geometry::{Mesh, SurfaceOrigin};
use osteoflow_node::{FilePath, NodeError, ParamError, schemars::JsonSchema, serde::Deserialize};
use osteoflow_simulation::{
    BoneParams, SimulationError, Subject,
    ct::{self, CtParams},
};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// The bone of a simulation, if not the built-in one. All nodes that simulate need the same.
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default)]
pub struct OwnBone {
    /// Closed surface of a bone to simulate on, STL or PLY, mm, in the CT's coordinates; with `plan_file`, and the same for
    /// every node that simulates. None: the built-in bone.
    pub bone_file: Option<FilePath>,
    /// Its plan as `plan.file` reads it, or only its anatomy (`malleolus_tip`, `proximal`, `lateral`, `posterior`), also under
    /// a key named after the bone's file; landmarks, assessment points and cuts are then placed by it.
    pub plan_file: Option<FilePath>,
}

impl OwnBone {
    /// Refuses one file without the other, and files with a parameter of the built-in bone, which would change nothing.
    pub(crate) fn check(&self, bone: &BoneParams) -> Result<(), ParamError> {
        let (given, lacks) = match (&self.bone_file, &self.plan_file) {
            (None, None) => return Ok(()),
            (Some(_), None) => ("bone_file", "plan_file"),
            (None, Some(_)) => ("plan_file", "bone_file"),
            (Some(_), Some(_)) => {
                let Some(name) = bone.of_built_in_only() else { return Ok(()) };
                let message = "it shapes the built-in bone and changes nothing of bone_file; remove one of the two";
                return Err(ParamError::new(name, message));
            }
        };
        let message = format!("{given} is given, but {lacks} is not; a bone of your own needs both");
        Err(ParamError::new(lacks, message))
    }

    /// The bone and its plan; `bone` where no files are given, and what makes another of it.
    pub(crate) fn subject(&self, bone: &BoneParams) -> Result<Subject, NodeError> {
        Ok(self.keyed(bone)?.1)
    }

    /// The frame of reference of the bone's simulated CT: the same for every node that simulates this bone.
    pub(crate) fn frame_of_reference_uid(&self, params: &BoneParams) -> Result<String, NodeError> {
        let bytes = self.bone_file.as_ref().map(|file| input::read(file.as_ref())).transpose()?.unwrap_or_default();
        let digest = input::sha256_of(&[format!("{params:?}").as_bytes(), &bytes].concat());
        // A unique identifier that is derived from 128 bits.
        let bits = u128::from_str_radix(&digest[..32], 16).expect("a digest has 64 hexadecimal digits");
        Ok(format!("2.25.{bits}"))
    }

    /// The CT's surface of the bone.
    pub(crate) fn ct_surface(&self, bone: &BoneParams, ct: &CtParams, seed: u64) -> Result<Mesh, NodeError> {
        static LAST: Memo<(Key, CtParams, u64), Mesh> = Memo::new();
        let (key, subject) = self.keyed(bone)?;
        let seed = ct.scan_seed.unwrap_or(seed);
        LAST.get_or((key, ct.clone(), seed), || Ok(ct::ct_surface(subject.bone(), ct, seed)?))
    }

    fn keyed(&self, params: &BoneParams) -> Result<(Key, Subject), NodeError> {
        static LAST: Memo<Key, Subject> = Memo::new();
        let (Some(bone), Some(plan)) = (&self.bone_file, &self.plan_file) else {
            let key = Key::BuiltIn(params.clone());
            let subject = LAST.get_or(key.clone(), || Ok(Subject::built_in(params)?))?;
            return Ok((key, subject));
        };
        let content = |path: &FilePath| input::read(path.as_ref()).map(Arc::new).map_err(NodeError::from);
        let name = name(bone.as_ref());
        let key = Key::Files { name, bone: content(bone)?, plan: content(plan)?, params: params.clone() };
        let subject = LAST.get_or(key.clone(), || read_altered(bone.as_ref(), plan.as_ref(), params))?;
        Ok((key, subject))
    }
}

/// The refusal of a parameter of a simulation.
pub(crate) fn refused(error: SimulationError) -> ParamError {
    let name = match &error {
        SimulationError::Parameter { name, .. } => name.rsplit(' ').next().unwrap_or_default(),
        _ => "",
    };
    ParamError::new(name, error.to_string())
}

/// Everything that a subject depends on, to the byte.
#[derive(Clone, PartialEq)]
enum Key {
    BuiltIn(BoneParams),
    Files { name: String, bone: Arc<Vec<u8>>, plan: Arc<Vec<u8>>, params: BoneParams },
}

/// The last results of a function: the nodes of one graph, and the runs of a sweep, ask for the same bone.
struct Memo<K, V>(Mutex<Vec<(K, V)>>);

impl<K: PartialEq, V: Clone> Memo<K, V> {
    const N: usize = 4;

    const fn new() -> Self {
        Self(Mutex::new(Vec::new()))
    }

    /// The lock is not held during `make`, which may need threads that ask too; two of them may compute the same.
    fn get_or(&self, key: K, make: impl FnOnce() -> Result<V, NodeError>) -> Result<V, NodeError> {
        let known = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, value)) = known().iter().find(|(k, _)| *k == key) {
            return Ok(value.clone());
        }
        let value = make()?;
        let mut known = known();
        known.insert(0, (key, value.clone()));
        known.truncate(Self::N);
        Ok(value)
    }
}

fn name(bone_file: &Path) -> String {
    bone_file.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// The bone and its plan from their files.
///
/// # Errors
/// If a file cannot be read, the surface is open, or the plan lacks an anatomy or does not fit the bone.
pub fn read(bone_file: &Path, plan_file: &Path) -> Result<Subject, NodeError> {
    read_altered(bone_file, plan_file, &BoneParams::default())
}

/// As [`read`], then deformed and mirrored as `params` have it, which are otherwise not used.
///
/// # Errors
/// As [`read`].
pub fn read_altered(bone_file: &Path, plan_file: &Path, params: &BoneParams) -> Result<Subject, NodeError> {
    let plan = read_plan_of(plan_file, &name(bone_file))?;
    let read = read_mesh(bone_file, 1.0, "ct", SurfaceOrigin::Exact)?;
    let mut subject = Subject::altered(read.mesh, plan.plan, params)?;
    subject.notes.splice(0..0, read.notes.into_iter().chain(plan.notes));
    Ok(subject)
}
