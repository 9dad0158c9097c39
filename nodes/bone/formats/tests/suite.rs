//! The tests of this crate, as one program; `damage` watches the allocator of its process and stays alone.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test, with its line")]

mod development_data;
mod layouts;
mod nifti_fields;
mod rotations;
mod round_trip;
mod volumes;
mod volumes_of_others;
