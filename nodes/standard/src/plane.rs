//! The cutting planes in the world.

pub mod to_world;
pub mod update;
