use crate::{
    Table,
    columns::{from_column, to_column},
    foxglove,
    geometry::origin,
};
use osteoflow_algorithms::target::Target;
use osteoflow_node::{ColumnType, Display, Payload, StampNs, View, ViewError};
use serde_json::{Value as Json, json};

/// The view holds points and normals; the tree over them is built again when it is read back.
impl Payload<Table> for Target {
    const NAME: &'static str = "algorithms/Target";
    const VERSION: u32 = 1;
    const UNITS: &'static [(&'static str, &'static str)] = &[("points", "mm")];

    fn to_view(&self) -> View {
        let mut view = View::new()
            .with("frame", self.frame.as_str())
            .with("origin", self.origin.to_string())
            .with_column(to_column("points", ColumnType::F64, self.point_column()));
        if let Some(normals) = self.normal_column() {
            view = view.with_column(to_column("normals", ColumnType::F64, normals));
        }
        view
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        let normals = match view.column("normals") {
            Ok(_) => Some(from_column(view, "normals")?),
            Err(_) => None,
        };
        Target::new(view.text("frame")?, origin(view.text("origin")?)?, from_column(view, "points")?, normals)
            .map_err(|error| ViewError::Invalid(error.to_string()))
    }

    /// The tree holds each point once more.
    fn n_bytes(&self) -> usize {
        let points = size_of_val(self.points());
        size_of::<Self>() + 2 * points + self.normals().map_or(0, size_of_val)
    }

    fn to_result(&self) -> Json {
        json!({ "frame": self.frame, "n_points": self.points().len(), "ct_surface": self.origin })
    }

    fn display() -> Option<Display> {
        foxglove::schema::<::foxglove::messages::PointCloud>()
    }

    fn to_display(&self, stamp_ns: StampNs) -> Option<Vec<u8>> {
        foxglove::points(&self.frame, stamp_ns, self.points())
    }
}
