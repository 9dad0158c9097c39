//! Payload types, and the type-erased values that the engine carries.

use crate::{Display, DisplayContext, SchemaEntry, View, ViewError, view::json::to_json};
use std::{
    any::{Any, TypeId},
    fmt,
    sync::Arc,
};

/// A type that may travel on a wire: a cheap handle with a name, a version and a view.
///
/// `By` is any type of the crate that implements the trait. It lets one crate declare all payloads while the types live in
/// crates that know nothing of nodes. A payload type has exactly one implementation.
pub trait Payload<By>: Clone + Send + Sync + 'static {
    /// The name in graph files and recordings, such as `geometry/Cloud`.
    const NAME: &'static str;
    /// Raised with each incompatible change of the view: also with a new field, since a compiled plugin's head has none.
    const VERSION: u32;
    /// The oldest version whose recorded views [`Payload::from_view`] reads: a later one only added optional fields.
    const OLDEST: u32 = Self::VERSION;
    /// The schema of every view: head fields, then columns. See [`View::check`].
    const SCHEMA: &'static [SchemaEntry];
    /// Whether [`Payload::interpolate`] is implemented, so that a port may join by `interpolate`.
    const INTERPOLATES: bool = false;

    /// The view; columns are not copied.
    fn to_view(&self) -> View;

    /// The payload of a view.
    ///
    /// # Errors
    /// [`ViewError`] if the view does not match the type.
    fn from_view(view: &View) -> Result<Self, ViewError>;

    /// The value in `results.json`: millimetres, names as in the docs. By default the fields and columns of the view.
    fn to_result(&self) -> serde_json::Value {
        to_json(&self.to_view())
    }

    /// Memory held, including columns; bounds the bytes on a wire. Called for every item on every wire, so it must
    /// not walk the rows. Columns shared with another payload count in both.
    fn n_bytes(&self) -> usize {
        size_of::<Self>()
    }

    /// The value at fraction `s` between `a` and `b`; `None` if there is none.
    fn interpolate(_a: &Self, _b: &Self, _s: f64) -> Option<Self> {
        None
    }

    /// The schema of the message for viewers, if there is one.
    fn display() -> Option<Display> {
        None
    }

    /// The message for viewers, encoded as [`Payload::display`] says.
    fn to_display(&self, _about: &DisplayContext<'_>) -> Option<Vec<u8>> {
        None
    }

    /// The message for viewers that shows it where `pose` places it on a surface, encoded as [`Payload::display`] says; `None` if it
    /// is nothing that lies on surfaces.
    fn to_display_on(&self, _surface: &Value, _pose: &Value, _about: &DisplayContext<'_>) -> Option<Vec<u8>> {
        None
    }

    /// Where a viewer's camera should look to see it, in metres in its frame; `None` if it has no extent.
    fn display_centre(&self) -> Option<[f64; 3]> {
        None
    }
}

/// A payload type known at run time: of a Rust type, or made by [`PayloadType::dynamic`]. Two are equal if Rust type, name,
/// version and schema are.
pub struct PayloadType {
    /// The name in graph files and recordings.
    pub name: &'static str,
    /// The version of the view.
    pub version: u32,
    /// The oldest version of views that are read; see [`Payload::OLDEST`].
    pub oldest: u32,
    /// Whether ports may join by `interpolate`.
    pub interpolates: bool,
    /// The schema of the views.
    pub schema: &'static [SchemaEntry],
    pub(crate) id: fn() -> TypeId,
    pub(crate) to_view: fn(&dyn Any) -> View,
    pub(crate) from_view: fn(&'static PayloadType, &View) -> Result<Value, ViewError>,
    pub(crate) to_result: fn(&dyn Any) -> serde_json::Value,
    pub(crate) n_bytes: fn(&dyn Any) -> usize,
    pub(crate) interpolate: fn(&dyn Any, &dyn Any, f64) -> Option<Value>,
    pub(crate) display: fn() -> Option<Display>,
    pub(crate) to_display: fn(&dyn Any, &DisplayContext<'_>) -> Option<Vec<u8>>,
    pub(crate) to_display_on: fn(&dyn Any, &Value, &Value, &DisplayContext<'_>) -> Option<Vec<u8>>,
    pub(crate) display_centre: fn(&dyn Any) -> Option<[f64; 3]>,
}

struct TypeOf<T, By>(std::marker::PhantomData<(T, By)>);

impl<T: Payload<By>, By: 'static> TypeOf<T, By> {
    const TYPE: &'static PayloadType = &PayloadType {
        name: T::NAME,
        version: T::VERSION,
        oldest: T::OLDEST,
        interpolates: T::INTERPOLATES,
        schema: T::SCHEMA,
        id: TypeId::of::<T>,
        to_view: |any| cast::<T>(any).to_view(),
        from_view: |_, view| T::from_view(view).map(Value::new),
        to_result: |any| cast::<T>(any).to_result(),
        n_bytes: |any| cast::<T>(any).n_bytes(),
        interpolate: |a, b, s| T::interpolate(cast(a), cast(b), s).map(Value::new),
        display: T::display,
        to_display: |any, about| cast::<T>(any).to_display(about),
        to_display_on: |any, surface, pose, about| cast::<T>(any).to_display_on(surface, pose, about),
        display_centre: |any| cast::<T>(any).display_centre(),
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

    /// In a plugin: the type of handles on values of the program. Never freed; there is one per payload that the plugin
    /// has received.
    pub(crate) fn of_held<T: 'static>(
        name: &str,
        version: u32,
        schema: Vec<SchemaEntry>,
        to_view: fn(&dyn Any) -> View,
        to_result: fn(&dyn Any) -> serde_json::Value,
    ) -> &'static Self {
        Box::leak(Box::new(Self {
            name: String::leak(name.to_owned()),
            version,
            oldest: version,
            interpolates: false,
            schema: Vec::leak(schema),
            id: TypeId::of::<T>,
            to_view,
            from_view: |_, _| {
                Err(ViewError::Invalid("a handle on a value of the program cannot be made from a view".into()))
            },
            to_result,
            n_bytes: |_| 0,
            interpolate: |_, _, _| None,
            display: || None,
            to_display: |_, _| None,
            to_display_on: |_, _, _, _| None,
            display_centre: |_| None,
        }))
    }

    /// Name and unit of the schema entries with a unit (see [`SchemaEntry::unit`]), as recordings store them.
    pub fn units(&self) -> Vec<(&'static str, &'static str)> {
        SchemaEntry::units(self.schema)
    }

    /// Whether recorded views of that version are read.
    pub fn reads(&self, version: u32) -> bool {
        (self.oldest..=self.version).contains(&version)
    }

    /// The payload of a view.
    ///
    /// # Errors
    /// [`ViewError`] if the view does not match the type.
    pub fn from_view(&'static self, view: &View) -> Result<Value, ViewError> {
        (self.from_view)(self, view)
    }

    /// The schema of the message for viewers, if there is one.
    pub fn display(&self) -> Option<Display> {
        (self.display)()
    }
}

impl PartialEq for PayloadType {
    #[inline]
    fn eq(&self, other: &Self) -> bool {
        // One Rust type may have several of these: one for each crate that instantiates it.
        std::ptr::eq(self, other)
            || ((self.id)() == (other.id)()
                && (self.name, self.version) == (other.name, other.version)
                && SchemaEntry::first_difference(self.schema, other.schema).is_none())
    }
}

impl fmt::Debug for PayloadType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{}", self.name, self.version)
    }
}

/// A shared, immutable payload of a type known at run time. Clones are cheap and never copy data.
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

    /// In a plugin: wraps a handle on a value of the program.
    pub(crate) fn held<T: Send + Sync + 'static>(held: T, ty: &'static PayloadType) -> Self {
        Self { inner: Arc::new(held), ty }
    }

    /// The handle given to [`Value::held`], if the value is one.
    pub(crate) fn into_held<T: Send + Sync + 'static>(self) -> Result<Arc<T>, Self> {
        let Self { inner, ty } = self;
        inner.downcast().map_err(|inner| Self { inner, ty })
    }

    /// The payload type.
    #[inline]
    pub fn ty(&self) -> &'static PayloadType {
        self.ty
    }

    /// Whether both are handles on the same value.
    #[inline]
    pub fn is_same(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.inner, &other.inner)
    }

    /// The payload, if it is a `T`.
    #[inline]
    pub fn get<T: 'static>(&self) -> Option<&T> {
        self.inner.downcast_ref()
    }

    /// The payload, if it is a `T`: moved out of the only handle, otherwise cloned.
    pub(crate) fn into_payload<T: Clone + Send + Sync + 'static>(self) -> Result<T, Self> {
        self.into_held().map(Arc::unwrap_or_clone)
    }

    /// The view; columns are not copied.
    pub fn to_view(&self) -> View {
        (self.ty.to_view)(&*self.inner)
    }

    /// The value in `results.json`.
    pub fn to_result(&self) -> serde_json::Value {
        (self.ty.to_result)(&*self.inner)
    }

    /// Memory held, including columns.
    #[inline]
    pub fn n_bytes(&self) -> usize {
        (self.ty.n_bytes)(&*self.inner)
    }

    /// The value at fraction `s` between `a` and `b`; `None` if there is none or the types differ.
    pub fn interpolate(a: &Self, b: &Self, s: f64) -> Option<Self> {
        if a.ty != b.ty {
            return None;
        }
        (a.ty.interpolate)(&*a.inner, &*b.inner, s)
    }

    /// The message for viewers.
    pub fn to_display(&self, about: &DisplayContext<'_>) -> Option<Vec<u8>> {
        (self.ty.to_display)(&*self.inner, about)
    }

    /// The message for viewers that shows it where `pose` places it on a surface.
    pub fn to_display_on(&self, surface: &Self, pose: &Self, about: &DisplayContext<'_>) -> Option<Vec<u8>> {
        (self.ty.to_display_on)(&*self.inner, surface, pose, about)
    }

    /// Where a viewer's camera should look to see it, in metres in its frame.
    pub fn display_centre(&self) -> Option<[f64; 3]> {
        (self.ty.display_centre)(&*self.inner)
    }
}

impl fmt::Debug for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Value({:?})", self.ty)
    }
}
