//! The reports of algorithms as payloads: one JSON text each, as in `results.json`.

use crate::Table;
use osteoflow_node::{Payload, Registry, SchemaEntry, View, ViewError};

/// Declares reports as payloads and adds them to a registry.
macro_rules! reports {
    ($($name:literal = $report:ty;)*) => {
        $(
            impl Payload<Table> for $report {
                const NAME: &'static str = concat!("report/", $name);
                const VERSION: u32 = 1;
                const SCHEMA: &'static [SchemaEntry] = &[SchemaEntry::text("json").doc("as in results.json")];

                fn to_view(&self) -> View {
                    View::new().with("json", self.to_result().to_string())
                }

                fn from_view(view: &View) -> Result<Self, ViewError> {
                    serde_json::from_str(view.text("json")?).map_err(|error| ViewError::Invalid(error.to_string()))
                }

                fn to_result(&self) -> serde_json::Value {
                    serde_json::to_value(self).expect("a report is made of numbers, words and lists")
                }
            }
        )*

        /// Adds the reports to a registry.
        pub(crate) fn register(registry: &mut Registry) {
            $(registry.payload::<$report, _>();)*
        }
    };
}

reports! {
    "Calibration" = osteoflow_algorithms::calibrate::PhantomReport;
    "Check" = osteoflow_algorithms::metrics::CheckReport;
    "Coarse" = osteoflow_algorithms::coarse::CoarseReport;
    "CoarseGlobal" = osteoflow_algorithms::coarse::GlobalReport;
    "CutDifference" = osteoflow_algorithms::metrics::CutDifferenceReport;
    "Cuts" = osteoflow_algorithms::metrics::CutsReport;
    "Fre" = osteoflow_algorithms::metrics::FreReport;
    "HandEye" = osteoflow_algorithms::calibrate::HandEyeReport;
    "Hole" = osteoflow_algorithms::hole::HoleReport;
    "Icp" = osteoflow_algorithms::icp::IcpReport;
    "IcpTrace" = osteoflow_algorithms::icp::IcpTrace;
    "LaserSpot" = osteoflow_algorithms::metrics::LaserSpotReport;
    "Motion" = osteoflow_algorithms::still_average::StillReport;
    "Path" = osteoflow_algorithms::still_average::MarkerPath;
    "Pivot" = osteoflow_algorithms::calibrate::PivotReport;
    "PoseError" = osteoflow_algorithms::metrics::PoseErrorReport;
    "Ruled" = osteoflow_algorithms::landmarks::RuledReport;
    "Slide" = osteoflow_algorithms::slide::SlideReport;
    "Surface" = osteoflow_algorithms::metrics::SurfaceReport;
    "TakeMotion" = osteoflow_algorithms::still_average::TakeMotion;
    "Track" = osteoflow_algorithms::track::TrackReport;
    "Tre" = osteoflow_algorithms::metrics::TreReport;
    "VerdictScore" = osteoflow_algorithms::trust::VerdictScore;
    "Verdict" = osteoflow_algorithms::trust::Verdict;
}
