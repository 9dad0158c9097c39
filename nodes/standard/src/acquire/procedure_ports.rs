use osteoflow_geometry::{Cloud, Points, Pose, Region};
use osteoflow_node::{Emission, Emit, OutputPorts, Outputs};
use osteoflow_payloads::Flag;

/// The streams of a procedure, as `acquire.folder` and `acquire.simulated` give them.
#[derive(Outputs)]
pub struct ProcedurePorts {
    /// The calibration phantom, seen by the camera.
    #[port(frame = "@camera")]
    phantom_scan: Emit<Cloud>,
    /// The bone, seen by the camera.
    #[port(frame = "@camera")]
    scan: Emit<Cloud>,
    /// The bone with the laser spot on P1, P2, P3 in turn, labelled so.
    #[port(frame = "@camera")]
    laser: Emit<Cloud>,
    /// The marker on the camera, tracked.
    #[port(to = "@world", from = "@camera_marker")]
    camera_marker: Emit<Pose>,
    /// The marker on the phantom, tracked.
    #[port(to = "@world", from = "@phantom_marker")]
    phantom_marker: Emit<Pose>,
    /// Where the marker sits on the phantom, known from its CAD; else an empty.
    #[port(to = "@phantom", from = "@phantom_marker")]
    phantom_marker_cad: Emit<Pose>,
    /// The marker on the bone, tracked.
    #[port(to = "@world", from = "@bone_marker")]
    bone_marker: Emit<Pose>,
    /// Whether the bone carries a marker.
    bone_tracked: Emit<Flag>,
    /// The region of interest, where one was drawn; else an empty.
    #[port(frame = "@camera")]
    region: Emit<Region>,
    /// The stylus on P1, P2, P3, one point at a time.
    #[port(frame = "@world")]
    stylus_init: Emit<Points>,
    /// The stylus on M1..M5, one point at a time.
    #[port(frame = "@world")]
    stylus_assessment: Emit<Points>,
    /// The stylus drawn over the surface, one point at a time.
    #[port(frame = "@world")]
    stylus_palpation: Emit<Points>,
    /// Whether all this was simulated.
    simulated: Emit<Flag>,
    /// The true registration at the scan, for scoring; only a simulation has it.
    #[port(to = "@ct", from = "@world")]
    t_ct_world_true: Emit<Pose>,
    /// The true calibration, for scoring; only a simulation has it.
    #[port(to = "@camera", from = "@camera_marker")]
    t_camera_camera_marker_true: Emit<Pose>,
    /// Where the laser spots truly were, carried with the bone to the full scan, for scoring; only a simulation has it.
    #[port(frame = "@world")]
    laser_spots_true: Emit<Points>,
    /// The marks on the bone that the laser was to show, at the full scan, for scoring; only a simulation has it.
    #[port(frame = "@world")]
    laser_marks_true: Emit<Points>,
    /// The holes of the check piece as read from the camera's cloud: one list where the phantom stood (`calibration_1`, ..),
    /// then one where the bone lies (`working_1`, ..).
    #[port(frame = "@camera")]
    check_camera: Emit<Points>,
    /// The same holes by the piece's marker and CAD.
    #[port(frame = "@world")]
    check_world: Emit<Points>,
    /// The stylus' marker while the stylus is turned about its tip.
    #[port(to = "@world", from = "@stylus_marker")]
    stylus_pivoting: Emit<Pose>,
    /// The stylus' marker at each touch.
    #[port(to = "@world", from = "@stylus_marker")]
    stylus_marker: Emit<Pose>,
    /// The bone with the laser spot on M1, M2, .. in turn, labelled so, where no stylus touches them.
    #[port(frame = "@camera")]
    laser_assessment: Emit<Cloud>,
}

/// The ports of [`ProcedurePorts`] by index.
#[allow(missing_docs)]
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Role {
    PhantomScan,
    Scan,
    Laser,
    CameraMarker,
    PhantomMarker,
    PhantomMarkerCad,
    BoneMarker,
    BoneTracked,
    Region,
    StylusInit,
    StylusAssessment,
    StylusPalpation,
    Simulated,
    TCtWorldTrue,
    TCameraCameraMarkerTrue,
    LaserSpotsTrue,
    LaserMarksTrue,
    CheckCamera,
    CheckWorld,
    StylusPivoting,
    StylusMarker,
    LaserAssessment,
}

impl Role {
    /// What only a simulation, or a bench, gives.
    pub(crate) const OF_EXPERIMENTS: [Self; 7] = [
        Self::LaserSpotsTrue,
        Self::LaserMarksTrue,
        Self::CheckCamera,
        Self::CheckWorld,
        Self::StylusPivoting,
        Self::StylusMarker,
        Self::LaserAssessment,
    ];
}

/// An answer on one of the [`ProcedurePorts`].
pub struct ProcedureOut {
    port: usize,
    emission: Emission,
}

impl ProcedureOut {
    pub(crate) fn new(port: usize, emission: Emission) -> Self {
        Self { port, emission }
    }
}

impl Outputs for ProcedureOut {
    fn ports() -> OutputPorts {
        ProcedurePorts::ports()
    }

    fn put(self, out: &mut [Emission]) {
        out[self.port] = self.emission;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roles_are_numbered_as_the_ports() {
        let OutputPorts::Fixed(ports) = ProcedurePorts::ports() else { panic!("the ports are fixed") };
        assert_eq!(ports[Role::PhantomScan as usize].name, "phantom_scan");
        assert_eq!(ports[Role::BoneTracked as usize].name, "bone_tracked");
        assert_eq!(ports[Role::StylusPalpation as usize].name, "stylus_palpation");
        assert_eq!(ports.len() - 1, Role::LaserAssessment as usize);
        assert_eq!(ports[Role::LaserAssessment as usize].name, "laser_assessment");
        assert_eq!(ports[Role::CheckCamera as usize].name, "check_camera");
        assert_eq!(ports[Role::TCameraCameraMarkerTrue as usize].name, "t_camera_camera_marker_true");
    }
}
