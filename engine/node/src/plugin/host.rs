//! The program's functions, as a context calls them.
#![allow(unsafe_code, reason = "calls the functions of the program")]

use crate::{Emission, NodeError, Part, PayloadType, StampNs, Value, View, ViewError, abi};
use std::{any::Any, cell::RefCell, sync::Arc};

/// The program's functions for the firing at hand.
#[derive(Clone, Copy)]
pub(crate) struct Host {
    table: &'static abi::Host,
    run: *mut abi::Run,
}

// SAFETY: functions that take a const run may be called from any thread of the node; all others are called through a
// context or an instance that is borrowed for writing. A `Host` is in a context during its firing only.
unsafe impl Send for Host {}
// SAFETY: as above.
unsafe impl Sync for Host {}

impl Host {
    /// # Safety
    /// `firing` is what the program has just called with, and the answer is not used after that call.
    pub(super) unsafe fn of(firing: &abi::Firing) -> Self {
        // SAFETY: the program's table lives as long as the program.
        Self { table: unsafe { &*firing.host }, run: firing.run }
    }

    fn text(&self, text: abi::Text) -> Option<&str> {
        // SAFETY: the program lends texts at least as long as the firing, which outlives this.
        unsafe { abi::text(text, "a text of the program") }.ok().flatten()
    }

    pub(crate) fn node(&self) -> &str {
        // SAFETY: the run is the firing's, here and in the following.
        self.text(unsafe { (self.table.node)(self.run) }).unwrap_or_default()
    }

    pub(crate) fn item(&self) -> u64 {
        // SAFETY: as above.
        unsafe { (self.table.item)(self.run) }
    }

    pub(crate) fn stamp_ns(&self) -> StampNs {
        // SAFETY: as above.
        unsafe { (self.table.stamp_ns)(self.run) }
    }

    pub(crate) fn set_stamp_ns(&mut self, stamp_ns: StampNs) {
        // SAFETY: as above.
        unsafe { (self.table.set_stamp_ns)(self.run, stamp_ns) }
    }

    pub(crate) fn seed(&self) -> u64 {
        // SAFETY: as above.
        unsafe { (self.table.seed)(self.run) }
    }

    pub(crate) fn clock_ns(&mut self) -> StampNs {
        // SAFETY: as above.
        unsafe { (self.table.clock_ns)(self.run) }
    }

    pub(crate) fn budget(&mut self, limit_ns: u64) -> HostBudget {
        // SAFETY: as above.
        HostBudget { table: self.table, budget: unsafe { (self.table.budget)(self.run, limit_ns) } }
    }

    pub(crate) fn cancelled(&self) -> bool {
        // SAFETY: as above.
        unsafe { (self.table.cancelled)(self.run) != 0 }
    }

    pub(crate) fn warn(&mut self, message: &str) {
        // SAFETY: as above; the text is read before the call returns.
        unsafe { (self.table.warn)(self.run, abi::Text::of(message)) }
    }

    pub(crate) fn absent_reason(&self, port: &str) -> Option<&str> {
        // SAFETY: as above.
        self.text(unsafe { (self.table.absent_reason)(self.run, abi::Text::of(port)) })
    }

    pub(crate) fn out_dir(&self) -> Option<&std::path::Path> {
        // SAFETY: as above.
        self.text(unsafe { (self.table.out_dir)(self.run) }).map(std::path::Path::new)
    }

    /// The outputs that the graph declared: name, payload, parameters as JSON.
    pub(super) fn declared(&self) -> Result<Vec<(String, &'static PayloadType, String)>, NodeError> {
        // SAFETY: as above.
        let n = unsafe { (self.table.n_declared)(self.run) };
        let one = |index| {
            let mut declared =
                abi::Declared { name: abi::Text::NONE, payload: std::ptr::null(), params: abi::Text::NONE };
            // SAFETY: as above; the program fills it in.
            if unsafe { (self.table.declared)(self.run, index, &mut declared) } != abi::status::OK {
                return Err(NodeError::new(format!("the program does not say what output {index} is")));
            }
            let text = |text| self.text(text).unwrap_or_default().to_owned();
            // SAFETY: payloads of the program live as long as it does.
            Ok((text(declared.name), unsafe { handle_type(declared.payload) }?, text(declared.params)))
        };
        (0..n).map(one).collect()
    }

    pub(super) fn fail(&self, parameter: &str, message: &str) {
        let parameter = if parameter.is_empty() { abi::Text::NONE } else { abi::Text::of(parameter) };
        // SAFETY: as above; the texts are read before the call returns.
        unsafe { (self.table.fail)(self.run, parameter, abi::Text::of(message)) }
    }

    /// Answers on a port; `expected` is the type that the port has, if it is one.
    pub(super) fn emit(
        &self,
        port: usize,
        expected: Option<&PayloadType>,
        emission: Emission,
    ) -> Result<(), NodeError> {
        let port = port as u64;
        let answered = match emission {
            Emission::Silent => abi::status::OK,
            // SAFETY: as above.
            Emission::Empty(reason) => unsafe { (self.table.emit_empty)(self.run, port, abi::Text::of(&reason)) },
            Emission::PassedOn(empty) => {
                // SAFETY: as above.
                unsafe { (self.table.emit_empty)(self.run, port, abi::Text::of(&empty.reason)) }
            }
            Emission::Value(value) => match value.into_held::<Handle>() {
                Ok(handle) => match Arc::try_unwrap(handle) {
                    // SAFETY: as above; the program takes the handle over.
                    Ok(handle) => unsafe { (self.table.emit_held)(self.run, port, handle.into_raw()) },
                    // SAFETY: as above; the handle is the program's.
                    Err(handle) => unsafe { (self.table.emit_value)(self.run, port, handle.value) },
                },
                Err(value) => {
                    let ty = value.ty();
                    let given = abi::Lent::given(value.to_view(), ty.schema)?;
                    let view = given.view();
                    match expected.is_some_and(|expected| expected == ty) {
                        // SAFETY: as above; the columns are given away with the call, the head is read in it.
                        true => unsafe { (self.table.emit)(self.run, port, &view) },
                        // SAFETY: as above.
                        false => unsafe {
                            (self.table.emit_as)(self.run, port, abi::Text::of(ty.name), ty.version, &view)
                        },
                    }
                }
            },
        };
        match answered {
            abi::status::OK => Ok(()),
            // The program has noted why.
            _ => Err(NodeError::new("")),
        }
    }

    /// A payload of this type, which the value is.
    ///
    /// # Safety
    /// `value` is one of the firing's, of this type.
    pub(super) unsafe fn read(&self, value: *const abi::Value, ty: &'static PayloadType) -> Result<Value, ViewError> {
        // SAFETY: as the caller vouches.
        ty.from_view(&unsafe { view_of(self.table, value, ty.schema) }?)
    }

    /// A handle on a value of any payload.
    ///
    /// # Safety
    /// `value` is one of the firing's, and `payload` its payload.
    pub(super) unsafe fn hold(
        &self,
        value: *const abi::Value,
        payload: *const abi::Payload,
    ) -> Result<Value, ViewError> {
        // SAFETY: as the caller vouches.
        let ty = unsafe { handle_type(payload) }?;
        // SAFETY: as the caller vouches.
        let value = unsafe { (self.table.hold)(value) };
        Ok(Value::held(Handle { value, table: self.table, schema: ty.schema }, ty))
    }
}

/// A value of the program that the plugin holds.
struct Handle {
    value: *const abi::Value,
    table: &'static abi::Host,
    schema: &'static [Part],
}

// SAFETY: values are immutable, and handles may be used and released from any thread.
unsafe impl Send for Handle {}
// SAFETY: as above.
unsafe impl Sync for Handle {}

impl Handle {
    fn of(any: &dyn Any) -> &Self {
        any.downcast_ref().expect("a handle's type has handles")
    }

    fn into_raw(self) -> *const abi::Value {
        std::mem::ManuallyDrop::new(self).value
    }

    fn to_view(&self) -> View {
        // SAFETY: it is held.
        unsafe { view_of(self.table, self.value, self.schema) }.unwrap_or_default()
    }

    fn to_result(&self) -> serde_json::Value {
        // SAFETY: it is held, and the program lends the text as long.
        let text = unsafe { abi::text((self.table.result)(self.value), "a result") }.ok().flatten();
        text.and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default()
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        // SAFETY: `hold` gave it, and it is released once.
        unsafe { (self.table.release)(self.value) };
    }
}

/// # Safety
/// The value is lent or held.
unsafe fn view_of(table: &abi::Host, value: *const abi::Value, schema: &'static [Part]) -> Result<View, ViewError> {
    let mut view = abi::View { head: std::ptr::null(), head_size: 0, columns: std::ptr::null(), n_columns: 0 };
    // SAFETY: as the caller vouches; the program fills the view in.
    if unsafe { (table.view)(value, &mut view) } != abi::status::OK {
        return Err(ViewError::Invalid("the program cannot show the value".into()));
    }
    // SAFETY: the program lends it as the header says.
    let crossing = unsafe { abi::Crossing::new(&view, abi::Origin::Lent) };
    crossing.map_err(|error| ViewError::Invalid(error.to_string()))?.take(schema)
}

/// The type of handles on values of this payload: one for each payload and thread.
///
/// # Safety
/// `payload` is one of the program's, which live as long as it does.
unsafe fn handle_type(payload: *const abi::Payload) -> Result<&'static PayloadType, ViewError> {
    thread_local! {
        static KNOWN: RefCell<Vec<(usize, &'static PayloadType)>> = const { RefCell::new(Vec::new()) };
    }
    let key = payload as usize;
    let known = KNOWN.with_borrow(|known| known.iter().find(|(k, _)| *k == key).map(|(_, ty)| *ty));
    if let Some(ty) = known {
        return Ok(ty);
    }
    // SAFETY: as the caller vouches.
    let about = unsafe { abi::schema::read(&*payload, abi::Sizes::OURS.part) };
    let about = about.map_err(|error| ViewError::Invalid(error.to_string()))?;
    let ty = PayloadType::of_held::<Handle>(
        &about.name,
        about.version,
        about.schema,
        |any| Handle::of(any).to_view(),
        |any| Handle::of(any).to_result(),
    );
    KNOWN.with_borrow_mut(|known| known.push((key, ty)));
    Ok(ty)
}

/// A budget of time that the program keeps.
pub(crate) struct HostBudget {
    table: &'static abi::Host,
    budget: *mut abi::Budget,
}

// SAFETY: it is looked at through a borrow for writing, so from one thread at a time.
unsafe impl Send for HostBudget {}

impl HostBudget {
    pub(crate) fn is_over(&mut self) -> bool {
        // SAFETY: the program keeps it until it is released.
        unsafe { (self.table.budget_is_over)(self.budget) != 0 }
    }
}

impl Drop for HostBudget {
    fn drop(&mut self) {
        // SAFETY: released once.
        unsafe { (self.table.budget_release)(self.budget) };
    }
}
