//! The subject of a simulated procedure: a bone and its plan.

use crate::other_bone::OtherBone;
use crate::plan::{complete, plan_on};
use crate::{BoneParams, SimulationError, bone};
use osteoflow_algorithms::{mesh_query::MeshQuery, mesh_topology::open_edges};
use osteoflow_geometry::{Mesh, SurgicalPlan};

/// A bone with its plan. A cheap handle: the search structure of the surface is shared.
#[derive(Clone)]
pub struct Subject {
    /// The exact surface, closed, normals outward, frame `ct`.
    pub surface: MeshQuery,
    /// The plan: landmarks, assessment points, cuts, axes, anatomy, marker poses.
    pub plan: SurgicalPlan,
    /// Corrections of the surface, one sentence each.
    pub notes: Vec<String>,
}

impl Subject {
    /// The built-in bone and its plan.
    ///
    /// # Errors
    /// [`SimulationError`] if parameters make a bone too short for the plan.
    pub fn built_in(params: &BoneParams) -> Result<Self, SimulationError> {
        params.check()?;
        let (mut bone, mut anatomy) = (bone::fibula(params), bone::anatomy(params));
        if let Some(other) = OtherBone::new(params, &bone, &anatomy) {
            (bone, anatomy) = (other.mesh(&bone)?, other.anatomy(&anatomy));
        }
        let surface = MeshQuery::new(&bone);
        let plan = plan_on(&surface, &anatomy)?;
        Self { surface, plan, notes: Vec::new() }.in_ct(params)
    }

    /// The bone with its plan as a CT shows it that differs from the bone by `params`.
    fn in_ct(self, params: &BoneParams) -> Result<Self, SimulationError> {
        let Some(other) = OtherBone::in_ct(params, self.bone(), &self.plan)? else { return Ok(self) };
        let surface = MeshQuery::new(&other.mesh(self.bone())?);
        Ok(Self { surface, plan: other.plan(&self.plan), notes: self.notes })
    }

    /// Any closed surface, with a plan or with an anatomy alone, from which the plan is made. Missing axes and marker
    /// poses are replaced by those of the bone and the built-in ones. A surface whose faces point inward, as those of a
    /// mirrored bone, is turned inside out.
    ///
    /// # Errors
    /// [`SimulationError`] if the surface is open; as [`crate::plan`]; or if the plan has no anatomy.
    pub fn of(bone: Mesh, plan: SurgicalPlan) -> Result<Self, SimulationError> {
        Self::altered(bone, plan, &BoneParams::default())
    }

    /// As [`Subject::of`], deformed, mirrored and distorted with its plan by `warp_mm`, `warp_seed`, `mirrored`, and the
    /// differences of a CT of `params`, of which nothing else is used.
    ///
    /// # Errors
    /// As [`Subject::of`].
    pub fn altered(bone: Mesh, plan: SurgicalPlan, params: &BoneParams) -> Result<Self, SimulationError> {
        params.check()?;
        let n_open_edges = open_edges(&bone);
        if n_open_edges > 0 {
            return Err(SimulationError::not_closed(n_open_edges));
        }
        let mut notes = Vec::new();
        let bone = if bone.volume_mm3() < 0.0 {
            notes.push("the bone's faces turn inward, as a mirrored bone's do; they were turned over".to_owned());
            let faces: Vec<[u32; 3]> = bone.faces().iter().map(|&[a, b, c]| [a, c, b]).collect();
            Mesh::new(&bone.frame, bone.origin, bone.vertices().to_vec(), faces)?
        } else {
            bone
        };
        let anatomy = plan.anatomy.as_ref().ok_or_else(SimulationError::no_anatomy)?;
        let (bone, plan) = match OtherBone::new(params, &bone, anatomy) {
            Some(other) => (other.mesh(&bone)?, other.plan(&plan)),
            None => (bone, plan),
        };
        let surface = MeshQuery::new(&bone);
        let plan = complete(plan, &surface)?;
        Self { surface, plan, notes }.in_ct(params)
    }

    /// The surface as a mesh.
    pub fn bone(&self) -> &Mesh {
        self.surface.mesh()
    }
}
