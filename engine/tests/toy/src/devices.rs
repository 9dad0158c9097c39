//! Devices of a simulated world, and a node that follows them: what comes when is a list, and the clock is the world's own.

use crate::{Number, NumberOut};
use osteoflow_node::{
    Context, Declared, Describe, Emission, Inputs, Node, NodeError, ParamError, Source, schemars, serde,
};
use std::{
    collections::BTreeMap,
    sync::{
        Arc, Condvar, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

/// What a device gives.
#[derive(Debug, Clone, Copy)]
pub struct Given {
    pub device: usize,
    /// When it gives it.
    pub at_ns: u64,
    pub stamp_ns: i64,
    /// Whether it is an empty.
    pub is_lost: bool,
}

/// A firing of [`Follow`].
#[derive(Debug, Clone)]
pub struct Followed {
    pub item: u64,
    pub stamp_ns: i64,
    pub a: Result<usize, String>,
    pub b: Result<usize, String>,
    pub began_ns: u64,
    pub ended_ns: u64,
}

/// What its devices give, one after the other, and what came of it.
#[derive(Default)]
pub struct World {
    pub clock: Arc<AtomicU64>,
    pub given: Vec<Given>,
    /// How long the firings of [`Follow`] take, in turn.
    pub spent_ns: Vec<u64>,
    /// The time when each was given.
    pub times: Mutex<Vec<u64>>,
    /// How many more of the first device are given than were followed, if the node may not fall behind.
    pub ahead: Option<usize>,
    pub turn: Condvar,
    pub followed: Mutex<Vec<Followed>>,
}

static WORLDS: Mutex<BTreeMap<String, Arc<World>>> = Mutex::new(BTreeMap::new());

impl World {
    /// Makes it the world of that name.
    pub fn begin(self, name: &str) -> Arc<Self> {
        let world = Arc::new(self);
        WORLDS.lock().unwrap().insert(name.into(), world.clone());
        world
    }

    fn of(name: &str) -> Result<Arc<Self>, ParamError> {
        let world = WORLDS.lock().unwrap().get(name).cloned();
        world.ok_or_else(|| ParamError::new("world", "there is no such world"))
    }

    /// Waits until the node has kept up, or cannot because the other device is silent.
    fn wait_for_follower(&self, place: usize) {
        let n_given = self.given[..place].iter().filter(|given| given.device == 0).count();
        let behind = |ahead: usize| self.followed.lock().unwrap().len() + ahead < n_given;
        while self.ahead.is_some_and(behind) {
            std::thread::sleep(Duration::from_micros(50));
        }
    }

    pub fn now(&self) -> u64 {
        self.clock.load(Ordering::SeqCst)
    }
}

#[derive(serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
#[derive(Default)]
pub struct DeviceParams {
    world: String,
    device: usize,
    /// Ignored.
    calls: Vec<u32>,
}

/// Gives the place of each in the list. A device that gives nothing more is dead: it does not end before the world does.
#[derive(Describe)]
pub struct Device(Arc<World>, usize);

impl Source for Device {
    const KIND: &'static str = "toy.device";
    const LIVE: bool = true;
    type Params = DeviceParams;
    type Outputs = Declared<DeviceParams>;

    fn new(params: DeviceParams) -> Result<Self, ParamError> {
        Ok(Self(World::of(&params.world)?, params.device))
    }

    fn silent_after(&self) -> Duration {
        Duration::from_secs(3600)
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<Declared<DeviceParams>>, NodeError> {
        let Self(world, device) = self;
        let mut times = world.times.lock().unwrap();
        loop {
            let place = times.len();
            match world.given.get(place) {
                Some(given) if given.device == *device => {
                    world.wait_for_follower(place);
                    let before = world.clock.fetch_max(given.at_ns, Ordering::SeqCst);
                    times.push(before.max(given.at_ns));
                    world.turn.notify_all();
                    ctx.set_stamp_ns(given.stamp_ns);
                    let value = match given.is_lost {
                        true => Emission::Empty("lost".into()),
                        false => Emission::value(Number(place as f64)),
                    };
                    return Ok(Some(Declared::one(0, value)));
                }
                Some(_) if !ctx.cancelled() => {
                    times = world.turn.wait_timeout(times, Duration::from_millis(20)).unwrap().0;
                }
                _ => return Ok(None),
            }
        }
    }
}

#[derive(Inputs)]
pub struct FollowIn {
    /// What it follows.
    a: Option<Number>,
    /// What it takes along.
    b: Option<Number>,
}

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
pub struct FollowParams {
    world: String,
}

/// Notes what it got and when, and lets time go by.
#[derive(Describe)]
pub struct Follow(Arc<World>);

impl Node for Follow {
    const KIND: &'static str = "toy.follow";
    type Params = FollowParams;
    type Inputs = FollowIn;
    type Outputs = NumberOut;

    fn new(params: FollowParams) -> Result<Self, ParamError> {
        Ok(Self(World::of(&params.world)?))
    }

    fn process(&mut self, i: FollowIn, ctx: &mut Context) -> Result<NumberOut, NodeError> {
        let Self(world) = self;
        let began_ns = world.now();
        let spent = world.spent_ns.get(ctx.item() as usize % world.spent_ns.len().max(1)).copied().unwrap_or(0);
        let ended_ns = world.clock.fetch_add(spent, Ordering::SeqCst) + spent;
        let of = |port, number: Option<Number>| {
            number.map(|number| number.0 as usize).ok_or_else(|| ctx.absent_reason(port).unwrap_or_default().to_owned())
        };
        let (a, b) = (of("a", i.a), of("b", i.b));
        let out = Number([&a, &b].map(|given| given.as_ref().map_or(-1.0, |place| *place as f64)).iter().sum());
        let (item, stamp_ns) = (ctx.item(), ctx.stamp_ns());
        world.followed.lock().unwrap().push(Followed { item, stamp_ns, a, b, began_ns, ended_ns });
        Ok(NumberOut { out })
    }
}
