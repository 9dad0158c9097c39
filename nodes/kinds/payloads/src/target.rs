#[cfg(feature = "viewer")]
use crate::foxglove;
use crate::{
    Table,
    columns::{from_column, to_column},
    geometry_views::{invalid, origin},
};
use osteoflow_algorithms::{
    mesh_query::MeshQuery,
    target::{GridColumns, Target},
};
use osteoflow_geometry::{Column, Mesh, first_not_unit, nalgebra::Vector3};
use osteoflow_node::{ColumnType, Payload, SchemaEntry, View, ViewError};
#[cfg(feature = "viewer")]
use osteoflow_node::{Display, DisplayContext};
use serde_json::{Value as Json, json};

/// The head field that is present if the view has a grid.
const CELL_MM: &str = "cell_mm";

/// The column that is present if the scan's sensor is stated.
const SENSOR: &str = "sensor";

fn has(view: &View, column: &str) -> bool {
    view.column(column).is_ok()
}

/// The view holds all that a registration needs, so that one read back is ready: points, normals, the cells that they are
/// found by, and the mesh that they were drawn from. All but the points may be missing; cells
/// (`cell_mm` and three columns) are then built when they are needed.
impl Payload<Table> for Target {
    const NAME: &'static str = "algorithms/Target";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[
        SchemaEntry::text("frame"),
        SchemaEntry::text("origin").doc("where the surface comes from: exact, simulated_ct or user"),
        SchemaEntry::float(CELL_MM).optional(),
        SchemaEntry::column("points", ColumnType::F64, 3).unit("mm"),
        SchemaEntry::column("normals", ColumnType::F64, 3).optional(),
        SchemaEntry::column("cells/blocks", ColumnType::U32, 1).optional(),
        SchemaEntry::column("cells/starts", ColumnType::U32, 1).optional(),
        SchemaEntry::column("cells/items", ColumnType::U32, 1).optional(),
        SchemaEntry::column("mesh/vertices", ColumnType::F64, 3).optional().unit("mm"),
        SchemaEntry::column("mesh/faces", ColumnType::U32, 3).optional(),
        // A column, as plugins of earlier versions know the head.
        SchemaEntry::column(SENSOR, ColumnType::U8, 1)
            .optional()
            .doc("what the scan is measured with, as JSON; the surface is moved for its tip"),
        // Of recordings by earlier versions, whose closest-point field is not read.
        SchemaEntry::column("field/head", ColumnType::F64, 1).optional(),
        SchemaEntry::column("field/index", ColumnType::U32, 1).optional(),
        SchemaEntry::column("field/nodes", ColumnType::F32, 1).optional(),
    ];

    fn to_view(&self) -> View {
        let cells = self.grid_columns();
        let mut view = View::new()
            .with("frame", self.frame.shared())
            .with("origin", self.origin.to_string())
            .with(CELL_MM, cells.cell_mm)
            .with_column(to_column("points", ColumnType::F64, self.point_column()));
        if let Some(sensor) = self.sensor() {
            let text = Column::from(serde_json::to_vec(sensor).unwrap_or_default());
            view = view.with_column(to_column(SENSOR, ColumnType::U8, &text));
        }
        if let Some(normals) = self.normal_column() {
            view = view.with_column(to_column("normals", ColumnType::F64, normals));
        }
        view = view
            .with_column(to_column("cells/blocks", ColumnType::U32, &cells.blocks))
            .with_column(to_column("cells/starts", ColumnType::U32, &cells.starts))
            .with_column(to_column("cells/items", ColumnType::U32, &cells.items));
        if let Some(mesh) = self.mesh().map(MeshQuery::mesh) {
            view = view
                .with_column(to_column("mesh/vertices", ColumnType::F64, mesh.vertex_column()))
                .with_column(to_column("mesh/faces", ColumnType::U32, mesh.face_column()));
        }
        view
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        let normals: Option<Column<Vector3<f64>>> =
            has(view, "normals").then(|| from_column(view, "normals")).transpose()?;
        if let Some((index, length)) = normals.as_ref().and_then(|normals| first_not_unit(normals)) {
            return Err(invalid(format!("normal {index} has length {length} instead of 1")));
        }
        let (frame, origin) = (view.text("frame")?, origin(view.text("origin")?)?);
        let mut target = Target::new(frame, origin, from_column(view, "points")?, normals).map_err(invalid)?;
        if view.field(CELL_MM).is_some() {
            let cells = GridColumns {
                cell_mm: view.float(CELL_MM)?,
                blocks: from_column(view, "cells/blocks")?,
                starts: from_column(view, "cells/starts")?,
                items: from_column(view, "cells/items")?,
            };
            target = target.with_grid_columns(&cells).map_err(invalid)?;
        }
        if has(view, "mesh/faces") {
            let (vertices, faces) = (from_column(view, "mesh/vertices")?, from_column(view, "mesh/faces")?);
            let mesh = Mesh::new(frame, origin, vertices, faces).map_err(invalid)?;
            target = target.with_mesh(MeshQuery::new(&mesh));
        }
        if has(view, SENSOR) {
            let text: Column<u8> = from_column(view, SENSOR)?;
            let sensor = serde_json::from_slice(&text).map_err(|error| invalid(error.to_string()))?;
            target = target.for_sensor(Some(sensor));
        }
        if view.field(CELL_MM).is_some() {
            target.prepare();
        }
        Ok(target)
    }

    /// The cells hold each point and its normal once more.
    fn n_bytes(&self) -> usize {
        let mesh = self.mesh().map_or(0, |mesh| mesh.mesh().n_bytes());
        let normals = self.normals().map_or(0, size_of_val);
        size_of::<Self>() + 2 * (size_of_val(self.points()) + normals) + mesh
    }

    fn to_result(&self) -> Json {
        json!({ "frame": self.frame, "n_points": self.points().len(), "ct_surface": self.origin })
    }

    #[cfg(feature = "viewer")]
    fn display() -> Option<Display> {
        foxglove::surface_schema()
    }

    #[cfg(feature = "viewer")]
    fn to_display(&self, about: &DisplayContext<'_>) -> Option<Vec<u8>> {
        match self.mesh() {
            Some(mesh) => foxglove::mesh(mesh.mesh(), about),
            None => foxglove::surface_points(&self.frame, self.points(), self.normals(), about),
        }
    }

    #[cfg(feature = "viewer")]
    fn display_centre(&self) -> Option<[f64; 3]> {
        foxglove::centre(self.points())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_algorithms::{
        icp::{self, IcpParams, Method, PairingKind},
        sensor::SensorKind,
    };
    use osteoflow_geometry::{
        SurfaceOrigin,
        nalgebra::{Isometry3, Point3},
    };

    /// A bent tube, open at its ends.
    fn tube() -> Mesh {
        let (rings, around) = (41_u32, 24_u32);
        let point = |i: u32, j: u32| {
            let (z, turn) = (f64::from(i), f64::from(j) / f64::from(around) * std::f64::consts::TAU);
            let radius = 6.0 + 0.9 * (3.0 * turn).cos() + 0.5 * (z / 5.0).sin();
            Point3::new(radius * turn.cos() + 0.01 * z * z, radius * turn.sin(), z)
        };
        let vertices: Vec<_> = (0..rings).flat_map(|i| (0..around).map(move |j| point(i, j))).collect();
        let index = |i: u32, j: u32| i * around + j % around;
        let faces: Vec<_> = (0..rings - 1)
            .flat_map(|i| (0..around).map(move |j| (i, j)))
            .flat_map(|(i, j)| {
                let (a, b, c, d) = (index(i, j), index(i, j + 1), index(i + 1, j), index(i + 1, j + 1));
                [[a, b, c], [b, d, c]]
            })
            .collect();
        Mesh::new("ct", SurfaceOrigin::SimulatedCt, vertices, faces).unwrap()
    }

    /// The middles of the tube's faces, with all that a registration may need.
    fn target() -> Target {
        let mesh = tube();
        let faces = 0..mesh.faces().len();
        let middle = |face| Point3::from(mesh.corners(face).iter().map(|c| c.coords).sum::<Vector3<f64>>() / 3.0);
        let points: Vec<_> = faces.clone().map(middle).collect();
        let normals: Vec<_> = faces.map(|face| mesh.area_vector(face).normalize()).collect();
        let target = Target::new("ct", SurfaceOrigin::SimulatedCt, points, Some(normals.into()));
        target.unwrap().with_mesh(MeshQuery::new(&mesh))
    }

    #[test]
    fn a_target_that_is_read_back_registers_to_the_same_bits() {
        let target = target();
        assert_eq!(target.to_view().check(Target::SCHEMA), Ok(()));
        let back = Target::from_view(&target.to_view()).unwrap();
        assert_eq!(back.to_view(), target.to_view());
        assert_eq!(back, target);
        let stated = target.clone().for_sensor(Some(SensorKind::Ultrasound.sensor()));
        assert_ne!(stated, target);
        assert_eq!(stated.to_view().check(Target::SCHEMA), Ok(()));
        assert_eq!(Target::from_view(&stated.to_view()), Ok(stated));
        let t = Isometry3::new(Vector3::new(0.4, -0.3, 0.5), Vector3::new(0.02, 0.03, -0.01));
        let source: Vec<_> = target.points().iter().step_by(3).map(|p| t * p).collect();
        for (method, pairing) in [
            (Method::PointToPlane, PairingKind::Cached),
            (Method::PointToPlane, PairingKind::Tree),
            (Method::PointToMesh, PairingKind::Cached),
        ] {
            let params = IcpParams { pairing, ..IcpParams::default() };
            let poses = [&target, &back].map(|target| {
                let fit = icp::register(method, target, &*source, &Isometry3::identity(), &params, &mut |_| {
                    std::ops::ControlFlow::Continue(())
                });
                fit.unwrap().t_target_source
            });
            assert_eq!(poses[0], poses[1], "{method:?} with {pairing:?}");
            let left_mm = (poses[0] * t).translation.vector.norm();
            assert!(left_mm < 0.1, "{method:?} with {pairing:?}: {left_mm} mm from the truth, faces are 1 mm large");
        }
    }

    #[test]
    fn a_recorded_target_with_a_closest_point_field_is_read_without_it() {
        let view = target().to_view();
        let field = Column::from(vec![1.0_f64; 4]);
        let earlier = view.clone().with_column(to_column("field/head", ColumnType::F64, &field));
        assert_eq!(earlier.check(Target::SCHEMA), Ok(()));
        assert_eq!(Target::from_view(&earlier).unwrap().to_view(), view);
    }

    #[test]
    fn points_alone_make_a_target_and_what_is_damaged_makes_none() {
        let whole = target().to_view();
        let without = |ends: &[&str]| {
            let mut view = whole.clone();
            view.head.retain(|(name, _)| name != CELL_MM);
            view.columns.retain(|column| !ends.iter().any(|end| column.name.starts_with(end)));
            Target::from_view(&view).unwrap()
        };
        let bare = without(&["normals", "cells", "mesh"]);
        assert_eq!(bare.to_view().check(Target::SCHEMA), Ok(()));
        assert!(bare.normals().is_none() && bare.mesh().is_none());
        assert_eq!(without(&["cells"]).to_view(), whole, "cells are built again, the same");

        for name in ["cells/items", "mesh/faces"] {
            let mut view = whole.clone();
            let damaged = view.columns.iter_mut().find(|column| column.name == name).unwrap();
            let mut rows = damaged.rows_of::<[u32; 1]>().unwrap_or_default().concat();
            if rows.is_empty() {
                rows = damaged.rows_of::<[u32; 3]>().unwrap().concat();
            }
            rows[5] = u32::MAX - 1;
            *damaged = osteoflow_node::Column {
                data: to_column("", ColumnType::U32, &Column::from(rows)).data,
                ..damaged.clone()
            };
            assert!(matches!(Target::from_view(&view), Err(ViewError::Invalid(_))), "{name}");
        }
        let mut view = whole.clone();
        let normals = view.columns.iter_mut().find(|column| column.name == "normals").unwrap();
        let mut rows = normals.rows_of::<Vector3<f64>>().unwrap().into_owned();
        rows[7] *= 1.0005;
        normals.data = to_column("", ColumnType::F64, &Column::from(rows)).data;
        let message = Target::from_view(&view).unwrap_err().to_string();
        assert!(message.contains("normal 7 has length 1.0005"), "{message}");
    }
}
