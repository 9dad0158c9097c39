//! Poses that are known, to measure a registration with.

pub mod perturb;
