//! The cutting planes in the world.

pub mod last;
pub mod to_world;
pub mod update;
