//! A plugin in Rust that reports the addresses of the points of clouds, of those it receives and those it gives, and the number
//! of clouds released. tests/plugins_c.rs compares it with one in C.

use osteoflow_node::{Context, Describe, Inputs, Node, NodeError, Outputs, ParamError, Source, schemars, serde};
use osteoflow_payloads::{
    Text,
    geometry::{
        Cloud, Column,
        nalgebra::{Point3, Vector3},
    },
};
use std::sync::{
    Arc,
    atomic::{AtomicUsize, Ordering},
};

static N_MADE: AtomicUsize = AtomicUsize::new(0);
static N_RELEASED: AtomicUsize = AtomicUsize::new(0);

/// Points that count their release.
struct Counted([Point3<f64>; 3]);

impl AsRef<[Point3<f64>]> for Counted {
    fn as_ref(&self) -> &[Point3<f64>] {
        &self.0
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        N_RELEASED.fetch_add(1, Ordering::SeqCst);
    }
}

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
struct Params {
    /// `normals`: with too few of them.
    how: String,
}

fn address(cloud: &Cloud) -> Text {
    Text(cloud.points().as_ptr().addr().to_string().into())
}

/// The address of a cloud's points.
#[derive(Describe)]
struct Address;

#[derive(Inputs)]
struct CloudIn {
    /// A cloud.
    cloud: Cloud,
}

#[derive(Outputs)]
struct TextOut {
    /// The address.
    text: Text,
}

impl Node for Address {
    const KIND: &'static str = "rust.address";
    type Params = Params;
    type Inputs = CloudIn;
    type Outputs = TextOut;

    fn new(_: Params) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: CloudIn, _: &mut Context) -> Result<TextOut, NodeError> {
        Ok(TextOut { text: address(&i.cloud) })
    }
}

/// A cloud of its own.
#[derive(Describe)]
struct Give(Option<Params>);

#[derive(Outputs)]
struct GiveOut {
    /// A cloud.
    cloud: Cloud,
    /// The address of its points.
    text: Text,
}

impl Source for Give {
    const KIND: &'static str = "rust.give";
    type Params = Params;
    type Outputs = GiveOut;

    fn new(params: Params) -> Result<Self, ParamError> {
        Ok(Self(Some(params)))
    }

    fn next(&mut self, _: &mut Context) -> Result<Option<GiveOut>, NodeError> {
        let Some(params) = self.0.take() else { return Ok(None) };
        N_MADE.fetch_add(1, Ordering::SeqCst);
        let points = Counted([0.0, 3.0, 6.0].map(|x| Point3::new(x, x + 1.0, x + 2.0)));
        let mut cloud = Cloud::new("camera", Column::from_owner(Arc::new(points)))?;
        if params.how == "normals" {
            cloud = cloud.with_normals(vec![Vector3::z()])?;
        }
        let text = address(&cloud);
        Ok(Some(GiveOut { cloud, text }))
    }
}

/// How many of the clouds were released.
#[derive(Describe)]
struct Released(bool);

impl Source for Released {
    const KIND: &'static str = "rust.released";
    type Params = Params;
    type Outputs = TextOut;

    fn new(_: Params) -> Result<Self, ParamError> {
        Ok(Self(false))
    }

    fn next(&mut self, _: &mut Context) -> Result<Option<TextOut>, NodeError> {
        if std::mem::replace(&mut self.0, true) {
            return Ok(None);
        }
        let [released, made] = [&N_RELEASED, &N_MADE].map(|n| n.load(Ordering::SeqCst));
        Ok(Some(TextOut { text: Text(format!("{released} of {made}").into()) }))
    }
}

osteoflow_node::export!(Address, Give, Released);
