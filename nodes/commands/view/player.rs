use crate::commands::common::serve::picks::{Known, Picks};
use osteoflow_geometry::SurgicalPlan;
use osteoflow_viewer::{App, Door, Playback, Role};
use serde_json::Value;

/// A recording on the page: it is played, and what is picked on it is saved.
pub(super) struct Player {
    pub(super) playback: Playback,
    pub(super) picks: Picks,
    pub(super) plan: Option<SurgicalPlan>,
}

impl App for Player {
    fn doors(&self) -> &'static [Door] {
        &[Door::Picks, Door::SavePlan, Door::SavePairs]
    }

    fn act(&self, door: Door, _: Role, request: &[u8]) -> Result<Value, String> {
        match door {
            Door::Picks => Ok(self.picks.describe(self.plan.as_ref(), &[])),
            _ => self.picks.save(door, request, Known { plan: self.plan.as_ref(), made_for: None }),
        }
    }

    fn playback(&self) -> Option<&Playback> {
        Some(&self.playback)
    }
}
