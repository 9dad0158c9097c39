//! What is made once for all tests of this program.

use super::measured_bone;
use osteoflow_geometry::SurgicalPlan;
use osteoflow_simulation::{BoneParams, Procedure, ProcedureParams, Subject, plan};
use std::{
    collections::BTreeMap,
    sync::{Mutex, OnceLock},
};

/// Values by key.
pub(crate) type Shared<T> = Mutex<BTreeMap<String, &'static OnceLock<T>>>;

/// The value of a key; the first who asks makes it.
pub(crate) fn shared<T>(all: &Shared<T>, key: String, make: impl FnOnce() -> T) -> &'static T {
    let value: &'static OnceLock<T> = all.lock().unwrap().entry(key).or_insert_with(|| Box::leak(Box::default()));
    value.get_or_init(make)
}

/// A built-in bone with its plan.
pub(crate) fn built_in(params: &BoneParams) -> &'static Subject {
    static SUBJECTS: Shared<Subject> = Mutex::new(BTreeMap::new());
    shared(&SUBJECTS, format!("{params:?}"), || Subject::built_in(params).unwrap())
}

/// A measured bone with its plan; `None`, and a line, without the development data.
pub(crate) fn measured(test: &str, name: &str) -> Option<&'static Subject> {
    static SUBJECTS: Shared<Option<Subject>> = Mutex::new(BTreeMap::new());
    let make = || {
        let (mesh, anatomy) = measured_bone(name)?;
        let plan = plan(&mesh, &anatomy).unwrap();
        Some(Subject::of(mesh, SurgicalPlan { anatomy: Some(anatomy), ..plan }).unwrap())
    };
    let subject = shared(&SUBJECTS, name.to_owned(), make).as_ref();
    if subject.is_none() {
        println!("skipped: {test} on {name}: no development data");
    }
    subject
}

/// [`Procedure::simulate`], with the bone made once.
pub(crate) fn simulate(params: &ProcedureParams, seed: u64) -> Procedure {
    Procedure::simulate_for(built_in(&params.bone), params, seed).unwrap()
}
