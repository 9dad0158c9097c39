//! What may travel on a wire, and the type-erased form in which the engine carries it.

use crate::{Part, StampNs, View, ViewError};
use std::{
    any::{Any, TypeId},
    fmt,
    sync::Arc,
};

/// A type that may travel: a cheap handle with a name, a version and one view.
///
/// `By` is any type of the crate that declares the payload; it lets one crate hold the table of what may travel while
/// the types themselves live in crates that know nothing of nodes. A payload type has exactly one implementation.
pub trait Payload<By>: Clone + Send + Sync + 'static {
    /// The name in graph files and recordings, such as `geometry/Cloud`.
    const NAME: &'static str;
    /// Raised when the view changes in a way that older readers cannot take.
    const VERSION: u32;
    /// What every view of it holds: head fields, then columns. [`View::check`] holds a view against it.
    const SCHEMA: &'static [Part];
    /// Whether [`Payload::interpolate`] gives values, so that a port may join by `interpolate`.
    const INTERPOLATES: bool = false;

    /// Head and columns, without copying the columns.
    fn to_view(&self) -> View;

    /// The payload that a view shows.
    ///
    /// # Errors
    /// [`ViewError`] if the view is of something else.
    fn from_view(view: &View) -> Result<Self, ViewError>;

    /// What `results.json` says of it: millimetres, names as in the docs.
    fn to_result(&self) -> serde_json::Value;

    /// How much memory it holds on to, bulk and all: what a wire counts that is bounded in bytes. Asked for every item
    /// on every wire, so it reads lengths and walks nothing. Columns shared with another payload count in both.
    fn n_bytes(&self) -> usize {
        size_of::<Self>()
    }

    /// The value a share `s` of the way from `a` to `b`; `None` where there is none.
    fn interpolate(_a: &Self, _b: &Self, _s: f64) -> Option<Self> {
        None
    }

    /// The schema of its picture for viewers, where it has one.
    fn display() -> Option<Display> {
        None
    }

    /// Its picture for viewers, encoded after [`Payload::display`].
    fn to_display(&self, _stamp_ns: StampNs) -> Option<Vec<u8>> {
        None
    }
}

/// The channel on which viewers are shown a payload: a schema of another program, such as `foxglove.PointCloud`.
#[derive(Debug, Clone, PartialEq)]
pub struct Display {
    /// The schema's name.
    pub schema_name: String,
    /// The encoding of the schema's data: `protobuf` or `jsonschema`.
    pub schema_encoding: String,
    /// The schema itself.
    pub schema_data: Vec<u8>,
    /// The encoding of the messages: `protobuf` or `json`.
    pub message_encoding: String,
}

/// A payload type as the engine knows it: of a Rust type, or [`PayloadType::free`]. Two are equal if their values are of
/// one Rust type, and name, version and schema the same.
pub struct PayloadType {
    /// The name in graph files and recordings.
    pub name: &'static str,
    /// The version of its view.
    pub version: u32,
    /// Whether ports may join it by `interpolate`.
    pub interpolates: bool,
    /// What its views hold.
    pub schema: &'static [Part],
    pub(crate) id: fn() -> TypeId,
    pub(crate) to_view: fn(&dyn Any) -> View,
    pub(crate) from_view: fn(&'static PayloadType, &View) -> Result<Value, ViewError>,
    pub(crate) to_result: fn(&dyn Any) -> serde_json::Value,
    pub(crate) n_bytes: fn(&dyn Any) -> usize,
    pub(crate) interpolate: fn(&dyn Any, &dyn Any, f64) -> Option<Value>,
    pub(crate) display: fn() -> Option<Display>,
    pub(crate) to_display: fn(&dyn Any, StampNs) -> Option<Vec<u8>>,
}

struct TypeOf<T, By>(std::marker::PhantomData<(T, By)>);

impl<T: Payload<By>, By: 'static> TypeOf<T, By> {
    const TYPE: &'static PayloadType = &PayloadType {
        name: T::NAME,
        version: T::VERSION,
        interpolates: T::INTERPOLATES,
        schema: T::SCHEMA,
        id: TypeId::of::<T>,
        to_view: |any| cast::<T>(any).to_view(),
        from_view: |_, view| T::from_view(view).map(Value::new),
        to_result: |any| cast::<T>(any).to_result(),
        n_bytes: |any| cast::<T>(any).n_bytes(),
        interpolate: |a, b, s| T::interpolate(cast(a), cast(b), s).map(Value::new),
        display: T::display,
        to_display: |any, stamp_ns| cast::<T>(any).to_display(stamp_ns),
    };
}

fn cast<T: 'static>(any: &dyn Any) -> &T {
    any.downcast_ref().expect("a value carries its own type")
}

impl PayloadType {
    /// The type of `T`.
    pub fn of<T: Payload<By>, By: 'static>() -> &'static Self {
        TypeOf::<T, By>::TYPE
    }

    /// A type whose values a plugin holds for the program, which alone knows what they are. Never freed: there is one for
    /// each payload that a plugin has met.
    pub(crate) fn of_held<T: 'static>(
        name: &str,
        version: u32,
        schema: Vec<Part>,
        to_view: fn(&dyn Any) -> View,
        to_result: fn(&dyn Any) -> serde_json::Value,
    ) -> &'static Self {
        Box::leak(Box::new(Self {
            name: String::leak(name.to_owned()),
            version,
            interpolates: false,
            schema: Vec::leak(schema),
            id: TypeId::of::<T>,
            to_view,
            from_view: |_, _| Err(ViewError::Invalid("a value that the program holds is made of no view".into())),
            to_result,
            n_bytes: |_| 0,
            interpolate: |_, _, _| None,
            display: || None,
            to_display: |_, _| None,
        }))
    }

    /// Units of head fields and columns whose names do not say them, by name: a unit, or `pose` for rows of translation
    /// x, y, z in mm and quaternion x, y, z, w. Recordings carry them.
    pub fn units(&self) -> Vec<(&'static str, &'static str)> {
        Part::units(self.schema)
    }

    /// The payload that a view of this type shows.
    ///
    /// # Errors
    /// [`ViewError`] if the view is of something else.
    pub fn from_view(&'static self, view: &View) -> Result<Value, ViewError> {
        (self.from_view)(self, view)
    }

    /// The schema of its picture for viewers, where it has one.
    pub fn display(&self) -> Option<Display> {
        (self.display)()
    }
}

impl PartialEq for PayloadType {
    #[inline]
    fn eq(&self, other: &Self) -> bool {
        // One type may have several of these, one for each crate that asked first.
        std::ptr::eq(self, other)
            || ((self.id)() == (other.id)()
                && (self.name, self.version) == (other.name, other.version)
                && Part::first_difference(self.schema, other.schema).is_none())
    }
}

impl fmt::Debug for PayloadType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{}", self.name, self.version)
    }
}

/// A payload on its way: shared, immutable, and of a type known at run time. Clones are cheap and never copy data.
#[derive(Clone)]
pub struct Value {
    pub(crate) inner: Arc<dyn Any + Send + Sync>,
    pub(crate) ty: &'static PayloadType,
}

impl Value {
    /// Wraps a payload.
    pub fn new<T: Payload<By>, By: 'static>(payload: T) -> Self {
        Self { inner: Arc::new(payload), ty: PayloadType::of::<T, By>() }
    }

    /// What a plugin holds for the program.
    pub(crate) fn held<T: Send + Sync + 'static>(held: T, ty: &'static PayloadType) -> Self {
        Self { inner: Arc::new(held), ty }
    }

    /// What was given to [`Value::held`], if it was one.
    pub(crate) fn into_held<T: Send + Sync + 'static>(self) -> Result<Arc<T>, Self> {
        let Self { inner, ty } = self;
        inner.downcast().map_err(|inner| Self { inner, ty })
    }

    /// Its type.
    #[inline]
    pub fn ty(&self) -> &'static PayloadType {
        self.ty
    }

    /// Whether both are the very same value.
    #[inline]
    pub fn is_same(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.inner, &other.inner)
    }

    /// The payload, if it is a `T`.
    #[inline]
    pub fn get<T: 'static>(&self) -> Option<&T> {
        self.inner.downcast_ref()
    }

    /// The payload, if it is a `T`: itself where this is the only handle, else one more handle on it.
    pub(crate) fn into_payload<T: Clone + Send + Sync + 'static>(self) -> Result<T, Self> {
        self.into_held().map(Arc::unwrap_or_clone)
    }

    /// Head and columns, without copying the columns.
    pub fn to_view(&self) -> View {
        (self.ty.to_view)(&*self.inner)
    }

    /// What `results.json` says of it.
    pub fn to_result(&self) -> serde_json::Value {
        (self.ty.to_result)(&*self.inner)
    }

    /// How much memory it holds on to, bulk and all.
    #[inline]
    pub fn n_bytes(&self) -> usize {
        (self.ty.n_bytes)(&*self.inner)
    }

    /// The value a share `s` of the way from `a` to `b`; `None` where there is none or the types differ.
    pub fn interpolate(a: &Self, b: &Self, s: f64) -> Option<Self> {
        if a.ty != b.ty {
            return None;
        }
        (a.ty.interpolate)(&*a.inner, &*b.inner, s)
    }

    /// Its picture for viewers.
    pub fn to_display(&self, stamp_ns: StampNs) -> Option<Vec<u8>> {
        (self.ty.to_display)(&*self.inner, stamp_ns)
    }
}

impl fmt::Debug for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Value({:?})", self.ty)
    }
}
