//! The host functions that a plugin calls. Each catches panics: nothing unwinds into a plugin.
#![allow(unsafe_code, reason = "is called through pointers")]

use super::log_lines;
use crate::panics;
use osteoflow_node::{
    Budget, BuildContext, Context, Emission, PayloadType, PortPayload, Value, ViewError,
    abi::{self, Text, param, status},
    serde_json::Value as Json,
};
use std::{
    mem::{self, ManuallyDrop},
    panic::{AssertUnwindSafe, catch_unwind},
    ptr,
    sync::atomic::{AtomicPtr, Ordering},
    time::Duration,
};

/// A value lent to a plugin; its view is created on first use.
pub(super) struct LentValue {
    /// Not dropped with this: see [`HeldValue`].
    value: ManuallyDrop<Value>,
    view: Lazy<Option<abi::OutgoingView>>,
    result: Lazy<String>,
}

/// A value created on first use, from any thread. `OnceLock` takes three times as long, which is noticeable per firing.
struct Lazy<T>(AtomicPtr<T>);

impl<T> Lazy<T> {
    const fn new() -> Self {
        Self(AtomicPtr::new(ptr::null_mut()))
    }

    fn get_or(&self, make: impl FnOnce() -> T) -> &T {
        let mut made = self.0.load(Ordering::Acquire);
        if made.is_null() {
            let new = Box::into_raw(Box::new(make()));
            match self.0.compare_exchange(ptr::null_mut(), new, Ordering::AcqRel, Ordering::Acquire) {
                Ok(_) => made = new,
                Err(first) => {
                    // SAFETY: another thread was first, so this pointer was never shared.
                    drop(unsafe { Box::from_raw(new) });
                    made = first;
                }
            }
        }
        // SAFETY: it came from a box, was published whole, and is freed with this only.
        unsafe { &*made }
    }
}

impl<T> Drop for Lazy<T> {
    fn drop(&mut self) {
        let made = *self.0.get_mut();
        if !made.is_null() {
            // SAFETY: it came from a box and is not shared.
            drop(unsafe { Box::from_raw(made) });
        }
    }
}

impl LentValue {
    /// A value that outlives the loan; cloning its reference count would cost as much as a channel.
    ///
    /// # Safety
    /// `value` outlives every use of this.
    pub(super) unsafe fn borrowed(value: &Value) -> Self {
        // SAFETY: guaranteed by the caller; it is not dropped.
        Self::of(unsafe { ptr::read(value) })
    }

    pub(super) fn handle(&self) -> *const abi::Value {
        ptr::from_ref(self).cast()
    }

    /// The view, created on first use; `None`, with a log line, if the payload has none.
    pub(super) fn abi_view(&self) -> Option<abi::View> {
        let made = self.view.get_or(|| {
            let ty = self.value.ty();
            let made = abi::OutgoingView::lent(self.value.to_view(), ty.schema);
            made.inspect_err(|error| tracing::error!("a {} has no view for a plugin: {error}", ty.name)).ok()
        });
        made.as_ref().map(abi::OutgoingView::view)
    }

    fn of(value: Value) -> Self {
        Self { value: ManuallyDrop::new(value), view: Lazy::new(), result: Lazy::new() }
    }
}

/// A value owned for as long as a plugin holds it.
#[repr(transparent)]
pub(super) struct HeldValue(LentValue);

impl HeldValue {
    pub(super) fn new(value: Value) -> Self {
        Self(LentValue::of(value))
    }

    pub(super) fn is(&self, value: &Value) -> bool {
        self.0.value.is_same(value)
    }

    pub(super) fn lent(&self) -> &LentValue {
        &self.0
    }

    fn into_value(self) -> Value {
        let mut held = ManuallyDrop::new(self);
        // SAFETY: the value is taken once, and the rest dropped once, as `held` itself is not.
        unsafe {
            let value = ManuallyDrop::take(&mut held.0.value);
            ptr::drop_in_place(&mut held.0);
            value
        }
    }
}

impl Drop for HeldValue {
    fn drop(&mut self) {
        // SAFETY: it is dropped once, here.
        unsafe { ManuallyDrop::drop(&mut self.0.value) };
    }
}

/// The context of a call into a plugin.
pub(super) enum CallContext<'a> {
    /// While it is built.
    Build(&'a BuildContext),
    /// At a firing.
    Firing(&'a mut Context),
}

/// The state of a call into a plugin.
pub(super) struct Run<'a> {
    pub(super) context: CallContext<'a>,
    pub(super) built: &'a super::node::BuiltKind,
    pub(super) params: &'a Json,
    pub(super) out: &'a mut [Emission],
    /// The parameter at fault, and the message.
    pub(super) failed: Option<(String, String)>,
    /// Values lent until the call returns.
    pub(super) lent: Vec<LentParam>,
}

/// A parameter's value, at a fixed address.
pub(super) struct LentParam {
    text: String,
    numbers: Vec<f64>,
}

impl Run<'_> {
    pub(super) fn handle(&mut self) -> *mut abi::Run {
        ptr::from_mut(self).cast()
    }

    fn context(&self) -> Option<&Context> {
        match &self.context {
            CallContext::Firing(context) => Some(context),
            CallContext::Build(_) => None,
        }
    }

    fn context_mut(&mut self) -> Option<&mut Context> {
        match &mut self.context {
            CallContext::Firing(context) => Some(context),
            CallContext::Build(_) => None,
        }
    }

    fn fail(&mut self, parameter: &str, message: String) {
        // Keep the first failure: it caused the others.
        self.failed.get_or_insert((parameter.into(), message));
    }

    fn put(&mut self, port: u64, answer: impl FnOnce(PortPayload) -> Result<Emission, String>) -> Result<(), String> {
        let index = usize::try_from(port).ok().filter(|port| *port < self.out.len());
        let index = index.ok_or_else(|| format!("it answers on output {port}, but has {}", self.out.len()))?;
        let (name, payload) = &self.built.outputs.get(index).ok_or("its outputs are not known yet")?;
        let named = |message: String| format!("output \"{name}\": {message}");
        if !matches!(self.out[index], Emission::Silent) {
            return Err(named("it is answered twice in one firing".into()));
        }
        self.out[index] = answer(*payload).map_err(named)?;
        Ok(())
    }
}

/// # Safety
/// `run` is what the program called with, and that call has not returned.
unsafe fn with<T>(run: *mut abi::Run, otherwise: T, f: impl FnOnce(&mut Run<'_>) -> T) -> T {
    // SAFETY: guaranteed by the caller; a plugin calls these functions from one thread at a time.
    let run = unsafe { &mut *run.cast::<Run<'_>>() };
    // The node's firing reports panics; here they only must not unwind into the plugin.
    match catch_unwind(AssertUnwindSafe(|| f(&mut *run))) {
        Ok(answer) => answer,
        Err(payload) => {
            run.fail("", panics::describe(payload));
            otherwise
        }
    }
}

/// # Safety
/// As for [`with`], but from any threads of the node.
unsafe fn look<T>(run: *const abi::Run, otherwise: T, f: impl FnOnce(&Run<'_>) -> T) -> T {
    // SAFETY: guaranteed by the caller.
    let run = unsafe { &*run.cast::<Run<'_>>() };
    panics::catch(|| f(run)).unwrap_or(otherwise)
}

/// # Safety
/// As for [`with`].
unsafe fn answer(run: *mut abi::Run, f: impl FnOnce(&mut Run<'_>) -> Result<(), String>) -> i32 {
    // SAFETY: guaranteed by the caller.
    unsafe {
        with(run, status::FAILED, |run| match f(run) {
            Ok(()) => status::OK,
            Err(message) => {
                run.fail("", message);
                status::FAILED
            }
        })
    }
}

/// # Safety
/// `value` was lent by the program, or returned by `hold`.
unsafe fn lent<'a>(value: *const abi::Value) -> &'a LentValue {
    // SAFETY: guaranteed by the caller.
    unsafe { &*value.cast::<LentValue>() }
}

unsafe extern "C" fn view(value: *const abi::Value, view: *mut abi::View) -> i32 {
    // SAFETY: the plugin calls it as the header requires.
    let lent = unsafe { lent(value) };
    let made = panics::catch(|| lent.abi_view());
    match made {
        Ok(Some(made)) => {
            // SAFETY: the header requires a valid pointer to a view.
            unsafe { view.write(made) };
            status::OK
        }
        Ok(None) => status::FAILED,
        Err(said) => {
            tracing::error!("a view for a plugin: {said}");
            status::FAILED
        }
    }
}

unsafe extern "C" fn result(value: *const abi::Value) -> Text {
    // SAFETY: the plugin calls it as the header requires.
    let lent = unsafe { lent(value) };
    let made = panics::catch(|| lent.result.get_or(|| lent.value.to_result().to_string()));
    made.map_or(Text::NONE, |text| Text::of(text))
}

unsafe extern "C" fn hold(value: *const abi::Value) -> *const abi::Value {
    // SAFETY: the plugin calls it as the header requires.
    let lent = unsafe { lent(value) };
    Box::into_raw(Box::new(HeldValue::new((*lent.value).clone()))).cast_const().cast()
}

unsafe extern "C" fn release(held: *const abi::Value) {
    // SAFETY: the header requires exactly one call with a pointer returned by `hold`.
    let held = unsafe { Box::from_raw(held.cast_mut().cast::<HeldValue>()) };
    // A payload's destructor must not unwind into the plugin.
    if let Err(said) = panics::catch(|| drop(held)) {
        tracing::warn!("a value that a plugin had held {said}");
    }
}

/// The columns of a plugin's answer; the host releases them from now on.
///
/// # Safety
/// `view` is a plugin's, as the header says, and outlives the answer.
unsafe fn given<'a>(view: *const abi::View) -> Result<abi::IncomingView<'a>, String> {
    if view.is_null() || !view.is_aligned() {
        return Err("the view of an answer is a null pointer".into());
    }
    // SAFETY: guaranteed by the caller.
    unsafe { abi::IncomingView::new(&*view, abi::Ownership::Given) }.map_err(|error| error.to_string())
}

fn taken(given: abi::IncomingView<'_>, ty: &'static PayloadType) -> Result<Emission, String> {
    let named = |error: ViewError| format!("{}: {error}", ty.name);
    let view = given.take(ty.schema).map_err(named)?;
    view.check_columns(ty.schema).map_err(named)?;
    ty.from_view(&view).map(Emission::Value).map_err(named)
}

unsafe extern "C" fn emit(run: *mut abi::Run, port: u64, view: *const abi::View) -> i32 {
    // SAFETY: the plugin calls it as the header requires.
    unsafe {
        answer(run, |run| {
            let given = given(view)?;
            run.put(port, |payload| match payload {
                PortPayload::Type(ty) => taken(given, ty),
                PortPayload::Any => Err("it takes any payload, so the answer must name its own: emit_as".into()),
            })
        })
    }
}

unsafe extern "C" fn emit_as(run: *mut abi::Run, port: u64, name: Text, version: u32, view: *const abi::View) -> i32 {
    // SAFETY: the plugin calls it as the header requires.
    unsafe {
        answer(run, |run| {
            let given = given(view)?;
            let name = abi::required_text(name, "the name of a payload").map_err(|error| error.to_string())?;
            let types = &run.built.types;
            let known = types.iter().find(|ty| ty.name == name && ty.version == version).copied();
            run.put(port, |payload| {
                let ty = payload.ty().filter(|ty| ty.name == name && ty.version == version).or(known);
                let ty = ty.ok_or_else(|| match types.iter().find(|ty| ty.name == name) {
                    Some(ty) => format!("it gives {name}@{version}, this program has version {}", ty.version),
                    None => format!("there is no payload {name}@{version} here"),
                })?;
                expect(payload, ty)?;
                taken(given, ty)
            })
        })
    }
}

fn expect(payload: PortPayload, found: &PayloadType) -> Result<(), String> {
    match payload.ty() {
        Some(ty) if ty != found => Err(format!("it gives {}, but was answered with {}", ty.name, found.name)),
        _ => Ok(()),
    }
}

unsafe extern "C" fn emit_value(run: *mut abi::Run, port: u64, value: *const abi::Value) -> i32 {
    // SAFETY: the plugin calls it as the header requires.
    unsafe {
        answer(run, |run| {
            if value.is_null() {
                return Err(format!("output {port} is answered with a value that is a null pointer"));
            }
            let value = &*lent(value).value;
            run.put(port, |payload| expect(payload, value.ty()).map(|()| Emission::Value(value.clone())))
        })
    }
}

unsafe extern "C" fn emit_held(run: *mut abi::Run, port: u64, held: *const abi::Value) -> i32 {
    if held.is_null() {
        // SAFETY: as below.
        return unsafe { emit_value(run, port, held) };
    }
    // SAFETY: the header requires a pointer returned by `hold`, whose ownership passes here.
    let value = unsafe { Box::from_raw(held.cast_mut().cast::<HeldValue>()) }.into_value();
    // SAFETY: the plugin calls it as the header requires.
    unsafe { answer(run, |run| run.put(port, |payload| expect(payload, value.ty()).map(|()| Emission::Value(value)))) }
}

unsafe extern "C" fn emit_empty(run: *mut abi::Run, port: u64, reason: Text) -> i32 {
    // SAFETY: the plugin calls it as the header requires.
    unsafe {
        answer(run, |run| {
            let reason = abi::text(reason, "the reason").map_err(|error| error.to_string())?;
            let reason = reason.filter(|reason| !reason.is_empty()).unwrap_or("the node gives no reason");
            run.put(port, |_| Ok(Emission::Empty(reason.into())))
        })
    }
}

unsafe extern "C" fn fail(run: *mut abi::Run, parameter: Text, message: Text) {
    // SAFETY: the plugin calls it as the header requires.
    unsafe {
        with(run, (), |run| {
            let text = |text| {
                abi::text(text, "the message").unwrap_or_else(|error| {
                    tracing::warn!("a plugin says why it failed, but {error}");
                    None
                })
            };
            let message = text(message).unwrap_or_default().to_owned();
            // An empty message means that a host function has recorded the reason.
            if !message.is_empty() {
                run.fail(text(parameter).unwrap_or_default(), message);
            }
        });
    }
}

unsafe extern "C" fn node(run: *const abi::Run) -> Text {
    // SAFETY: the plugin calls it as the header requires.
    unsafe {
        look(run, Text::NONE, |run| match &run.context {
            CallContext::Build(build) => Text::of(&build.node),
            CallContext::Firing(context) => Text::of(context.node()),
        })
    }
}

unsafe extern "C" fn item(run: *const abi::Run) -> u64 {
    // SAFETY: the plugin calls it as the header requires.
    unsafe { look(run, 0, |run| run.context().map_or(0, Context::item)) }
}

unsafe extern "C" fn stamp_ns(run: *const abi::Run) -> i64 {
    // SAFETY: the plugin calls it as the header requires.
    unsafe { look(run, 0, |run| run.context().map_or(0, Context::stamp_ns)) }
}

unsafe extern "C" fn set_stamp_ns(run: *mut abi::Run, stamp_ns: i64) {
    // SAFETY: the plugin calls it as the header requires.
    unsafe {
        with(run, (), |run| {
            if let Some(context) = run.context_mut() {
                context.set_stamp_ns(stamp_ns);
            }
        });
    }
}

unsafe extern "C" fn seed(run: *const abi::Run) -> u64 {
    // SAFETY: the plugin calls it as the header requires.
    unsafe {
        look(run, 0, |run| match &run.context {
            CallContext::Build(build) => build.seed,
            CallContext::Firing(context) => context.seed(),
        })
    }
}

unsafe extern "C" fn random(run: *const abi::Run, index: u64) -> u64 {
    // SAFETY: the plugin calls it as the header requires.
    unsafe { look(run, 0, |run| run.context().map_or(0, |context| context.random(index))) }
}

unsafe extern "C" fn clock_ns(run: *mut abi::Run) -> i64 {
    // SAFETY: the plugin calls it as the header requires.
    unsafe { with(run, 0, |run| run.context_mut().map_or(0, Context::clock_ns)) }
}

unsafe extern "C" fn budget(run: *mut abi::Run, limit_ns: u64) -> *mut abi::Budget {
    // SAFETY: the plugin calls it as the header requires.
    unsafe {
        with(run, ptr::null_mut(), |run| {
            let budget = run.context_mut().map(|context| context.budget(Duration::from_nanos(limit_ns)));
            Box::into_raw(Box::new(budget)).cast()
        })
    }
}

unsafe extern "C" fn budget_is_over(budget: *mut abi::Budget) -> i32 {
    // SAFETY: the header requires a pointer returned by `budget`, from one thread at a time; null if the firing failed.
    let budget = unsafe { budget.cast::<Option<Budget>>().as_mut() };
    let over = budget.and_then(Option::as_mut).map(|budget| panics::catch(|| budget.is_over()).unwrap_or(true));
    i32::from(over.unwrap_or(true))
}

unsafe extern "C" fn budget_release(budget: *mut abi::Budget) {
    if !budget.is_null() {
        // SAFETY: the header requires exactly one call with a pointer returned by `budget`.
        drop(unsafe { Box::from_raw(budget.cast::<Option<Budget>>()) });
    }
}

unsafe extern "C" fn cancelled(run: *const abi::Run) -> i32 {
    // SAFETY: the plugin calls it as the header requires.
    unsafe { look(run, 0, |run| i32::from(run.context().is_some_and(Context::cancelled))) }
}

unsafe extern "C" fn warn(run: *mut abi::Run, message: Text) {
    // SAFETY: the plugin calls it as the header requires.
    unsafe {
        with(run, (), |run| {
            let message = abi::text(message, "the warning").ok().flatten().unwrap_or("a warning that is no text");
            match run.context_mut() {
                Some(context) => context.warn(message),
                None => tracing::warn!("while it was built: {message}"),
            }
        });
    }
}

unsafe extern "C" fn absent_reason(run: *const abi::Run, port: Text) -> Text {
    // SAFETY: the plugin calls it as the header requires.
    unsafe {
        look(run, Text::NONE, |run| {
            let port = abi::text(port, "a port").ok().flatten().unwrap_or_default();
            Text::of_option(run.context().and_then(|context| context.absent_reason(port)))
        })
    }
}

unsafe extern "C" fn out_dir(run: *const abi::Run) -> Text {
    // SAFETY: the plugin calls it as the header requires.
    unsafe { look(run, Text::NONE, |run| Text::of_option(run.context().and_then(|c| c.out_dir()?.to_str()))) }
}

unsafe extern "C" fn parameter(run: *mut abi::Run, name: Text, place: *mut abi::Param) {
    let numbers = abi::Numbers { data: ptr::null(), length: 0 };
    let mut found =
        abi::Param { what: param::MISSING, boolean: 0, number: 0.0, text: Text::NONE, numbers, json: Text::NONE };
    // SAFETY: the plugin calls it as the header requires.
    unsafe {
        with(run, (), |run| {
            let name = abi::text(name, "a parameter").ok().flatten().unwrap_or_default();
            let Some(value) = run.built.param(run.params, name) else { return };
            let list = value.as_array().map(|list| list.iter().map(Json::as_f64).collect::<Option<Vec<_>>>());
            let text = value.as_str().map(str::to_owned).unwrap_or_else(|| value.to_string());
            // Texts and numbers keep their address when this list grows.
            run.lent.push(LentParam { text, numbers: list.flatten().unwrap_or_default() });
            let Some(lent) = run.lent.last() else { return };
            match value {
                Json::Bool(yes) => (found.what, found.boolean) = (param::BOOL, u32::from(*yes)),
                Json::Number(number) => {
                    (found.what, found.number) = (param::NUMBER, number.as_f64().unwrap_or_default());
                }
                Json::String(_) => (found.what, found.text) = (param::TEXT, Text::of(&lent.text)),
                Json::Array(list) if lent.numbers.len() == list.len() => {
                    (found.what, found.numbers) = (param::NUMBERS, abi::Numbers::of(&lent.numbers));
                }
                _ => (found.what, found.json) = (param::OTHER, Text::of(&lent.text)),
            }
        });
        place.write(found);
    }
}

unsafe extern "C" fn n_declared(run: *const abi::Run) -> u64 {
    // SAFETY: the plugin calls it as the header requires.
    unsafe { look(run, 0, |run| run.built.declared.len() as u64) }
}

unsafe extern "C" fn declared(run: *const abi::Run, index: u64, place: *mut abi::Declared) -> i32 {
    // SAFETY: the plugin calls it as the header requires.
    unsafe {
        look(run, status::FAILED, |run| {
            let Some(port) = usize::try_from(index).ok().and_then(|index| run.built.declared.get(index)) else {
                return status::FAILED;
            };
            place.write(abi::Declared {
                name: Text::of(&port.name),
                payload: port.payload,
                params: Text::of(&port.params),
            });
            status::OK
        })
    }
}

unsafe extern "C" fn log_level() -> u32 {
    log_lines::level()
}
unsafe extern "C" fn log(level: u32, target: Text, message: Text) {
    // SAFETY: the plugin calls it as the header requires.
    let [target, message] = [target, message].map(|text| unsafe { abi::text(text, "a log line") }.ok().flatten());
    let (target, message) = (target.unwrap_or("plugin"), message.unwrap_or_default());
    // A subscriber's panic must not unwind into the plugin.
    let _ = panics::catch(|| log_lines::log(level, target, message));
}

/// The function table passed to every plugin.
pub(super) static HOST: abi::Host = abi::Host {
    size: mem::size_of::<abi::Host>() as u64,
    view,
    result,
    hold,
    release,
    emit,
    emit_as,
    emit_value,
    emit_held,
    emit_empty,
    fail,
    node,
    item,
    stamp_ns,
    set_stamp_ns,
    seed,
    random,
    clock_ns,
    budget,
    budget_is_over,
    budget_release,
    cancelled,
    warn,
    absent_reason,
    out_dir,
    param: parameter,
    n_declared,
    declared,
    log_level,
    log,
};
