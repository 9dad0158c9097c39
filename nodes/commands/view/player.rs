use crate::commands::common::serve::picks::{Known, Picks};
use osteoflow_geometry::SurgicalPlan;
use osteoflow_viewer::{App, Playback, Response};

/// A recording on the page: it is played, and what is picked on it is saved.
pub(super) struct Player {
    pub(super) playback: Playback,
    pub(super) picks: Picks,
    pub(super) plan: Option<SurgicalPlan>,
}

impl App for Player {
    fn get(&self, path: &str) -> Option<Response> {
        self.picks.get(path, self.plan.as_ref(), &[])
    }

    fn post(&self, path: &str, body: &[u8]) -> Option<Response> {
        self.picks.post(path, body, Known { plan: self.plan.as_ref(), made_for: None })
    }

    fn playback(&self) -> Option<&Playback> {
        Some(&self.playback)
    }
}
