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
        assert_eq!(ports.len() - 1, Role::TCameraCameraMarkerTrue as usize);
        assert_eq!(ports[Role::TCameraCameraMarkerTrue as usize].name, "t_camera_camera_marker_true");
    }
}
