//! The kind `acquire.simulated`.

use super::{
    playback::{Event, Playback, in_order},
    procedure_ports::{ProcedureEvents, ProcedureOut, ProcedurePort},
};
use crate::own_bone::{OwnBone, refused};
use osteoflow_geometry::{Cloud, Points, Pose};
use osteoflow_node::{
    Context, Describe, Emission, NodeError, ParamError, Source, schemars::JsonSchema, serde::Deserialize,
};
use osteoflow_simulation::{Procedure, ProcedureParams};

/// A simulated procedure on the built-in bone or one of your own: all that a recording holds, and the truth.
///
/// The errors of all devices are drawn from the run's seed. The truth has ports of its own, for scoring only. "Other simulator"
/// is the noise model beside the recording of the development data; "assumed" is not measured.
#[derive(Describe)]
#[describe(example = r#"
kind = "acquire.simulated"
camera = { n_points = 20000, depth_noise_mm = 0.05 }
"#)]
pub struct Simulated {
    params: Params,
    playback: Option<Playback<Emission>>,
}

/// Parameters of [`Simulated`].
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default)]
pub struct Params {
    /// A bone of your own.
    #[serde(flatten)]
    pub own: OwnBone,
    /// Every error term.
    #[serde(flatten)]
    pub procedure: ProcedureParams,
}

impl Source for Simulated {
    const KIND: &'static str = "acquire.simulated";
    type Params = Params;
    type Outputs = ProcedureOut;

    fn new(params: Params) -> Result<Self, ParamError> {
        params.own.check(&params.procedure.bone)?;
        params.procedure.check().map_err(refused)?;
        Ok(Self { params, playback: None })
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<ProcedureOut>, NodeError> {
        if self.playback.is_none() {
            let Params { own, procedure } = &self.params;
            let subject = own.subject(&procedure.bone)?;
            let procedure = Procedure::simulate_for(&subject, procedure, ctx.seed())?;
            self.playback = Some(in_order(events(procedure)));
        }
        let Some(event) = self.playback.as_mut().and_then(Iterator::next) else { return Ok(None) };
        ctx.set_stamp_ns(event.stamp_ns);
        Ok(Some(ProcedureOut::new(event.port, event.body)))
    }
}

fn events(procedure: Procedure) -> Vec<Event<Emission>> {
    let start_ns = procedure.camera_marker.first().map_or(0, |pose| pose.stamp_ns);
    let (truth, is_tracked) = (procedure.truth, !procedure.bone_marker.is_empty());
    let region = procedure.region.ok_or("no region of interest was drawn");
    let mut events = ProcedureEvents::new(start_ns, true, is_tracked, region);
    if !is_tracked {
        for port in [ProcedurePort::PhantomMarker, ProcedurePort::BoneMarker] {
            events.add(port, start_ns, Emission::Empty("nothing is tracked (tracker.none)".into()));
        }
    }
    events.clouds(ProcedurePort::PhantomScan, [procedure.phantom_scan]);
    events.clouds(ProcedurePort::Scan, [procedure.scan]);
    let mut on_landmarks = procedure.laser;
    // There may be no laser scans.
    let n_landmarks = procedure.plan.landmarks.points.len().min(on_landmarks.len());
    let on_assessment = on_landmarks.split_off(n_landmarks);
    events.clouds(ProcedurePort::Laser, on_landmarks);
    events.clouds(ProcedurePort::LaserAssessment, on_assessment);
    // Nothing where none are taken, so that recordings stay the same.
    for image in procedure.images.into_iter().take(n_landmarks) {
        events.add(ProcedurePort::Image, image.stamp_ns, Emission::value(image));
    }
    events.poses(ProcedurePort::CameraMarker, procedure.camera_marker);
    events.poses(ProcedurePort::PhantomMarker, procedure.phantom_marker);
    events.poses(ProcedurePort::BoneMarker, procedure.bone_marker);
    events.add(ProcedurePort::PhantomMarkerCad, start_ns, Emission::value(procedure.t_phantom_phantom_marker));
    events.points(ProcedurePort::StylusInit, &procedure.stylus_init);
    events.points(ProcedurePort::StylusAssessment, &procedure.stylus_assessment);
    events.points(ProcedurePort::StylusPalpation, &procedure.stylus_palpation);
    let t_ct_world_true = truth.t_world_ct_at_scan.inverse();
    events.add(ProcedurePort::TCtWorldTrue, start_ns, Emission::value(t_ct_world_true));
    events.add(ProcedurePort::TCameraCameraMarkerTrue, start_ns, Emission::value(truth.t_camera_camera_marker));
    let at_scan = &truth.t_world_ct_at_scan;
    for (port, points) in
        [(ProcedurePort::LaserSpotsTrue, &truth.laser_spots_ct), (ProcedurePort::LaserMarksTrue, &truth.laser_marks_ct)]
    {
        events.add(port, start_ns, Emission::value(points.transformed(&at_scan.to, &at_scan.isometry)));
    }
    let assessment = procedure.plan.assessment.transformed(&at_scan.to, &at_scan.isometry);
    events.add(ProcedurePort::AssessmentTrue, start_ns, Emission::value(assessment));
    events.add(ProcedurePort::PlanesTrue, start_ns, Emission::value(truth.planes_world_at_scan));
    for (read, known) in procedure.check {
        let stamp_ns = read.points.first().map_or(start_ns, |point| point.stamp_ns);
        events.add(ProcedurePort::CheckCamera, stamp_ns, Emission::value(read));
        events.add(ProcedurePort::CheckWorld, stamp_ns, Emission::value(known));
    }
    events.poses(ProcedurePort::StylusPivoting, procedure.stylus_pivoting);
    events.poses(ProcedurePort::StylusMarker, procedure.stylus_marker);
    events.0
}

impl ProcedureEvents {
    fn clouds(&mut self, port: ProcedurePort, clouds: impl IntoIterator<Item = Cloud>) {
        clouds.into_iter().for_each(|cloud| self.add(port, cloud.stamp_ns, Emission::value(cloud)));
    }

    fn poses(&mut self, port: ProcedurePort, poses: Vec<Pose>) {
        poses.into_iter().for_each(|pose| self.add(port, pose.stamp_ns, Emission::value(pose)));
    }

    /// One item for each point, as a stylus gives them.
    fn points(&mut self, port: ProcedurePort, points: &Points) {
        for point in &*points.points {
            let one = Points::new(&points.frame, vec![point.clone()]);
            self.add(port, point.stamp_ns, Emission::value(one));
        }
    }
}
