//! A simulated procedure on a built-in bone: camera, tracker, laser, phantom, stylus and CT, all from one seed.
