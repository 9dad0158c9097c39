use super::playback::Event;
use osteoflow_geometry::{Cloud, Image, Planes, Points, Pose, Region, StampNs};
use osteoflow_node::{Emission, Emit, OutputPorts, Outputs};
use osteoflow_payloads::Flag;

/// Defines the ports of a procedure, and the enum of their indices, from one list.
macro_rules! procedure_ports {
    ($($(#[$attribute:meta])* $variant:ident = $port:ident: $payload:ty,)*) => {
        /// The streams of a procedure, as `acquire.folder` and `acquire.simulated` give them.
        #[derive(Outputs)]
        pub struct ProcedurePorts {
            $($(#[$attribute])* $port: Emit<$payload>,)*
        }

        /// The index of a port of [`ProcedurePorts`].
        #[derive(Clone, Copy, PartialEq, Eq)]
        pub(crate) enum ProcedurePort {
            $($variant,)*
        }
    };
}

procedure_ports! {
    /// The calibration phantom, seen by the camera.
    #[port(frame = "@camera")]
    PhantomScan = phantom_scan: Cloud,
    /// The bone, seen by the camera.
    #[port(frame = "@camera")]
    Scan = scan: Cloud,
    /// The bone with the laser spot on P1, P2, P3 in turn, labelled so.
    #[port(frame = "@camera")]
    Laser = laser: Cloud,
    /// The marker on the camera, tracked.
    #[port(to = "@world", from = "@camera_marker")]
    CameraMarker = camera_marker: Pose,
    /// The marker on the phantom, tracked.
    #[port(to = "@world", from = "@phantom_marker")]
    PhantomMarker = phantom_marker: Pose,
    /// The marker on the phantom by its CAD; empty if it is not known.
    #[port(to = "@phantom", from = "@phantom_marker")]
    PhantomMarkerCad = phantom_marker_cad: Pose,
    /// The marker on the bone, tracked.
    #[port(to = "@world", from = "@bone_marker")]
    BoneMarker = bone_marker: Pose,
    /// Whether the bone carries a marker.
    BoneTracked = bone_tracked: Flag,
    /// The region of interest; empty if none was drawn.
    #[port(frame = "@camera")]
    Region = region: Region,
    /// The stylus on P1, P2, P3, one point at a time.
    #[port(frame = "@world")]
    StylusInit = stylus_init: Points,
    /// The stylus on M1..M5, one point at a time.
    #[port(frame = "@world")]
    StylusAssessment = stylus_assessment: Points,
    /// The stylus drawn over the surface, one point at a time.
    #[port(frame = "@world")]
    StylusPalpation = stylus_palpation: Points,
    /// Whether the procedure was simulated.
    Simulated = simulated: Flag,
    /// Simulated: the true registration at the scan, for scoring.
    #[port(to = "@ct", from = "@world")]
    TCtWorldTrue = t_ct_world_true: Pose,
    /// Simulated: the true calibration, for scoring.
    #[port(to = "@camera", from = "@camera_marker")]
    TCameraCameraMarkerTrue = t_camera_camera_marker_true: Pose,
    /// Simulated: the true laser spots, carried with the bone to the full scan, for scoring.
    #[port(frame = "@world")]
    LaserSpotsTrue = laser_spots_true: Points,
    /// Simulated: the marks that the laser was aimed at, at the full scan, for scoring.
    #[port(frame = "@world")]
    LaserMarksTrue = laser_marks_true: Points,
    /// The holes of the check piece as read from the cloud: one list at the phantom's place (`calibration_1`, ..), then one at
    /// the bone (`working_1`, ..).
    #[port(frame = "@camera")]
    CheckCamera = check_camera: Points,
    /// The holes of the check piece by its marker and CAD.
    #[port(frame = "@world")]
    CheckWorld = check_world: Points,
    /// The stylus' marker during the pivot calibration.
    #[port(to = "@world", from = "@stylus_marker")]
    StylusPivoting = stylus_pivoting: Pose,
    /// The stylus' marker at each touch.
    #[port(to = "@world", from = "@stylus_marker")]
    StylusMarker = stylus_marker: Pose,
    /// The bone with the laser spot on M1, M2, .. in turn, labelled so, if no stylus touches them.
    #[port(frame = "@camera")]
    LaserAssessment = laser_assessment: Cloud,
    /// Simulated: a colour image at each scan of `laser`, labelled as it, with `image.taken`.
    #[port(frame = "@camera")]
    Image = image: Image,
    /// Simulated: the true places of the planned assessment points at the full scan, for scoring, also if CT and plan differ
    /// from the bone.
    #[port(frame = "@world")]
    AssessmentTrue = assessment_true: Points,
    /// Simulated: the true places of the planned planes at the full scan, for scoring.
    #[port(frame = "@world")]
    PlanesTrue = planes_true: Planes,
}

impl ProcedurePort {
    /// The ports that only a simulation or a bench fills.
    pub(crate) const OF_EXPERIMENTS: [Self; 10] = [
        Self::LaserSpotsTrue,
        Self::LaserMarksTrue,
        Self::CheckCamera,
        Self::CheckWorld,
        Self::StylusPivoting,
        Self::StylusMarker,
        Self::LaserAssessment,
        Self::Image,
        Self::AssessmentTrue,
        Self::PlanesTrue,
    ];
}

/// The events of a procedure.
pub(super) struct ProcedureEvents(pub(super) Vec<Event<Emission>>);

impl ProcedureEvents {
    /// What is known of a procedure from its start on; without a region, why there is none.
    pub(super) fn new(start_ns: StampNs, simulated: bool, tracked: bool, region: Result<Region, &str>) -> Self {
        let mut events = Self(Vec::new());
        events.add(ProcedurePort::Simulated, start_ns, Emission::value(Flag(simulated)));
        events.add(ProcedurePort::BoneTracked, start_ns, Emission::value(Flag(tracked)));
        let region = region.map_or_else(|why| Emission::Empty(why.into()), Emission::value);
        events.add(ProcedurePort::Region, start_ns, region);
        events
    }

    pub(super) fn add(&mut self, port: ProcedurePort, stamp_ns: StampNs, body: Emission) {
        self.0.push(Event { stamp_ns, port: port as usize, body });
    }
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
    fn the_enum_has_the_index_of_each_port() {
        let OutputPorts::Fixed(ports) = ProcedurePorts::ports() else { panic!("the ports are fixed") };
        assert_eq!(ports[ProcedurePort::PhantomScan as usize].name, "phantom_scan");
        assert_eq!(ports[ProcedurePort::TCtWorldTrue as usize].name, "t_ct_world_true");
        assert_eq!(ports.last().map(|port| port.name), Some("planes_true"));
        assert_eq!(ports.len() - 1, ProcedurePort::PlanesTrue as usize);
    }
}
