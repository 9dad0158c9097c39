//! The host functions that a context calls.
#![allow(unsafe_code, reason = "calls the functions of the program")]

use crate::{Emission, NodeError, PayloadType, SchemaEntry, StampNs, Value, View, ViewError, abi};
use std::{any::Any, cell::RefCell, sync::Arc};

/// The host functions for the current firing.
#[derive(Clone, Copy)]
pub(crate) struct Host {
    table: &'static abi::Host,
    run: *mut abi::Run,
}

// SAFETY: functions that take a const run may be called from any thread of the node; all others are called through a
// mutably borrowed context or instance. A context has a `Host` only during its firing.
unsafe impl Send for Host {}
// SAFETY: as above.
unsafe impl Sync for Host {}

impl Host {
    /// # Safety
    /// `firing` is an argument of the current call from the program, and the result is not used after that call.
    pub(crate) unsafe fn of(firing: &abi::Firing) -> Self {
        // SAFETY: the host table lives as long as the program.
        Self { table: unsafe { &*firing.host }, run: firing.run }
    }

    fn text(&self, text: abi::Text) -> Option<&str> {
        // SAFETY: the program lends texts at least until the end of the firing, which outlives `self`.
        unsafe { abi::text(text, "a text of the program") }.ok().flatten()
    }

    pub(crate) fn node(&self) -> &str {
        // SAFETY: the run belongs to the current firing, here and below.
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

    /// The outputs that the graph declares: name, payload, parameters as JSON.
    pub(super) fn declared(&self) -> Result<Vec<(String, &'static PayloadType, String)>, NodeError> {
        // SAFETY: as above.
        let n = unsafe { (self.table.n_declared)(self.run) };
        let one = |index| {
            let mut declared =
                abi::Declared { name: abi::Text::NONE, payload: std::ptr::null(), params: abi::Text::NONE };
            // SAFETY: as above; the program fills it in.
            if unsafe { (self.table.declared)(self.run, index, &mut declared) } != abi::status::OK {
                return Err(NodeError::new(format!("the program does not describe output {index}")));
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

    /// Sends an emission to a port; `expected` is the type of the port, if it has one.
    pub(super) fn emit(
        &self,
        port: usize,
        expected: Option<&PayloadType>,
        emission: Emission,
    ) -> Result<(), NodeError> {
        let port = port as u64;
        let status = match emission {
            Emission::Silent => abi::status::OK,
            // SAFETY: as above.
            Emission::Empty(reason) => unsafe { (self.table.emit_empty)(self.run, port, abi::Text::of(&reason)) },
            Emission::PassedOn(empty) => {
                // SAFETY: as above.
                unsafe { (self.table.emit_empty)(self.run, port, abi::Text::of(&empty.reason)) }
            }
            Emission::Value(value) => match value.into_held::<Handle>() {
                Ok(handle) => match Arc::try_unwrap(handle) {
                    // SAFETY: as above; the program takes ownership of the handle.
                    Ok(handle) => unsafe { (self.table.emit_held)(self.run, port, handle.into_raw()) },
                    // SAFETY: as above; the handle belongs to the program.
                    Err(handle) => unsafe { (self.table.emit_value)(self.run, port, handle.value) },
                },
                Err(value) => {
                    let ty = value.ty();
                    let outgoing = abi::OutgoingView::given(value.to_view(), ty.schema)?;
                    let view = outgoing.view();
                    match expected.is_some_and(|expected| expected == ty) {
                        // SAFETY: as above; the call takes ownership of the columns and copies the head.
                        true => unsafe { (self.table.emit)(self.run, port, &view) },
                        // SAFETY: as above.
                        false => unsafe {
                            (self.table.emit_as)(self.run, port, abi::Text::of(ty.name), ty.version, &view)
                        },
                    }
                }
            },
        };
        match status {
            abi::status::OK => Ok(()),
            // The program has noted why.
            _ => Err(NodeError::new("")),
        }
    }

    /// The payload of a value.
    ///
    /// # Safety
    /// `value` belongs to the firing and is of type `ty`.
    pub(super) unsafe fn read(&self, value: *const abi::Value, ty: &'static PayloadType) -> Result<Value, ViewError> {
        // SAFETY: guaranteed by the caller.
        ty.from_view(&unsafe { view_of(self.table, value, ty.schema) }?)
    }

    /// A handle on a value of any type.
    ///
    /// # Safety
    /// `value` belongs to the firing, and `payload` describes its type.
    pub(super) unsafe fn hold(
        &self,
        value: *const abi::Value,
        payload: *const abi::Payload,
    ) -> Result<Value, ViewError> {
        // SAFETY: guaranteed by the caller.
        let ty = unsafe { handle_type(payload) }?;
        // SAFETY: guaranteed by the caller.
        let value = unsafe { (self.table.hold)(value) };
        Ok(Value::held(Handle { value, table: self.table, schema: ty.schema }, ty))
    }
}

/// An owned handle on a value of the program.
struct Handle {
    value: *const abi::Value,
    table: &'static abi::Host,
    schema: &'static [SchemaEntry],
}

// SAFETY: values are immutable, and handles may be used and released from any thread.
unsafe impl Send for Handle {}
// SAFETY: as above.
unsafe impl Sync for Handle {}

impl Handle {
    fn of(any: &dyn Any) -> &Self {
        any.downcast_ref().expect("the type is one of handles")
    }

    fn into_raw(self) -> *const abi::Value {
        std::mem::ManuallyDrop::new(self).value
    }

    fn to_view(&self) -> View {
        // SAFETY: the value is held.
        unsafe { view_of(self.table, self.value, self.schema) }.unwrap_or_default()
    }

    fn to_result(&self) -> serde_json::Value {
        // SAFETY: the value is held, and the text lives as long.
        let text = unsafe { abi::text((self.table.result)(self.value), "a result") }.ok().flatten();
        text.and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default()
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        // SAFETY: returned by `hold`, and released once.
        unsafe { (self.table.release)(self.value) };
    }
}

/// # Safety
/// `value` is lent or held.
unsafe fn view_of(
    table: &abi::Host,
    value: *const abi::Value,
    schema: &'static [SchemaEntry],
) -> Result<View, ViewError> {
    let mut view = abi::View { head: std::ptr::null(), head_size: 0, columns: std::ptr::null(), n_columns: 0 };
    // SAFETY: guaranteed by the caller; the program fills the view in.
    if unsafe { (table.view)(value, &mut view) } != abi::status::OK {
        return Err(ViewError::Invalid("the program cannot show the value".into()));
    }
    // SAFETY: lent by the program, by the contract of the header.
    let incoming = unsafe { abi::IncomingView::new(&view, abi::Ownership::Lent) };
    incoming.map_err(|error| ViewError::Invalid(error.to_string()))?.take(schema)
}

/// The type of handles on values of this payload: one per payload and thread.
///
/// # Safety
/// `payload` belongs to the program and lives as long.
unsafe fn handle_type(payload: *const abi::Payload) -> Result<&'static PayloadType, ViewError> {
    thread_local! {
        static KNOWN: RefCell<Vec<(usize, &'static PayloadType)>> = const { RefCell::new(Vec::new()) };
    }
    let key = payload as usize;
    let known = KNOWN.with_borrow(|known| known.iter().find(|(k, _)| *k == key).map(|(_, ty)| *ty));
    if let Some(ty) = known {
        return Ok(ty);
    }
    // SAFETY: guaranteed by the caller.
    let description = unsafe { abi::schema::read(&*payload, abi::Sizes::OURS.part) };
    let description = description.map_err(|error| ViewError::Invalid(error.to_string()))?;
    let ty = PayloadType::of_held::<Handle>(
        &description.name,
        description.version,
        description.schema,
        |any| Handle::of(any).to_view(),
        |any| Handle::of(any).to_result(),
    );
    KNOWN.with_borrow_mut(|known| known.push((key, ty)));
    Ok(ty)
}

/// A time budget of the program.
pub(crate) struct HostBudget {
    table: &'static abi::Host,
    budget: *mut abi::Budget,
}

// SAFETY: checked through a mutable borrow, so from one thread at a time.
unsafe impl Send for HostBudget {}

impl HostBudget {
    pub(crate) fn is_over(&mut self) -> bool {
        // SAFETY: the budget lives until it is released.
        unsafe { (self.table.budget_is_over)(self.budget) != 0 }
    }
}

impl Drop for HostBudget {
    fn drop(&mut self) {
        // SAFETY: released once.
        unsafe { (self.table.budget_release)(self.budget) };
    }
}
