//! Built nodes, called by the program.
#![allow(unsafe_code, reason = "is called through pointers")]

use super::panic;
use crate::{
    AnyNode, Body, BuildContext, Built, Context, DeclaredPort, Emission, Empty, Item, Joined, Kind, NodeError,
    ParamError, PayloadType, PortPayload, Slot, Value, abi, host::Host,
};
use std::{ffi::c_void, sync::Arc, time::Duration};

/// A built node, and buffers that its firings reuse.
pub(super) struct Instance {
    built: Built,
    context: Context,
    joined: Joined,
    out: Vec<Emission>,
    inputs: Vec<PortPayload>,
    /// The types of the outputs, where the kind has fixed ones.
    outputs: Vec<Option<&'static PayloadType>>,
    /// The values of ports joined by `once`.
    constants: Vec<Option<Value>>,
}

/// Calls `f`, and reports an error or panic to the program.
fn guarded(host: Host, f: impl FnOnce() -> Result<i32, NodeError>) -> i32 {
    match panic::catch(f) {
        Ok(Ok(status)) => status,
        Ok(Err(error)) => {
            host.fail("", &error.message);
            abi::status::FAILED
        }
        Err(message) => {
            host.fail("", &message);
            abi::status::PANICKED
        }
    }
}

/// [`abi::Kind::create`]
pub(super) unsafe extern "C" fn create(
    kind: *const abi::Kind,
    firing: *const abi::Firing,
    params: abi::Text,
    node: *mut *mut c_void,
) -> i32 {
    // SAFETY: by the contract of the header, `kind` is one of ours and `firing` outlives the call.
    let (kind, host) = unsafe { (&*(*kind).data.cast::<Kind>(), Host::of(&*firing)) };
    guarded(host, || {
        // SAFETY: as above.
        let params = unsafe { abi::text(params, "the parameters") }?.unwrap_or("{}");
        match Instance::new(kind, &serde_json::from_str(params)?, host) {
            Ok(instance) => {
                // SAFETY: by the contract of the header, `node` is writable.
                unsafe { node.write(Box::into_raw(Box::new(instance)).cast()) };
                Ok(abi::status::OK)
            }
            Err(error) => {
                host.fail(&error.parameter, &error.message);
                Ok(abi::status::FAILED)
            }
        }
    })
}

/// [`abi::Kind::fire`]
pub(super) unsafe extern "C" fn fire(node: *mut c_void, firing: *const abi::Firing) -> i32 {
    // SAFETY: by the contract of the header, `node` comes from `create` and is used by one thread at a time.
    let (instance, firing) = unsafe { (&mut *node.cast::<Instance>(), &*firing) };
    // SAFETY: not used after this call returns.
    let host = unsafe { Host::of(firing) };
    instance.context.enter(host);
    let status = guarded(host, || {
        // SAFETY: the firing belongs to the program.
        unsafe { instance.join(firing, host) }?;
        let status = instance.fire(host);
        instance.clear();
        status
    });
    instance.context.leave();
    // Releases values also after a panic of the node.
    if status == abi::status::PANICKED
        && let Err(message) = panic::catch(|| instance.clear())
    {
        tracing::warn!("releasing the values of a firing: {message}");
    }
    status
}

/// [`abi::Kind::destroy`]
pub(super) unsafe extern "C" fn destroy(node: *mut c_void) {
    // SAFETY: by the contract of the header, called once with a node from `create`.
    let instance = unsafe { Box::from_raw(node.cast::<Instance>()) };
    if let Err(message) = panic::catch(|| drop(instance)) {
        tracing::warn!("dropping a node: {message}");
    }
}

/// [`abi::Kind::max_delay_ns`]
pub(super) unsafe extern "C" fn max_delay_ns(node: *mut c_void) -> i64 {
    // SAFETY: as for `fire`.
    let instance = unsafe { &*node.cast::<Instance>() };
    match &instance.built {
        Built::Source(source) => panic::catch(|| source.max_delay_ns()).unwrap_or(0),
        Built::Node(_) => 0,
    }
}

/// [`abi::Kind::silent_after_ns`]
pub(super) unsafe extern "C" fn silent_after_ns(node: *mut c_void) -> i64 {
    // SAFETY: as for `fire`.
    let instance = unsafe { &*node.cast::<Instance>() };
    let after = match &instance.built {
        Built::Source(source) => panic::catch(|| source.silent_after()).unwrap_or(crate::SILENT_AFTER),
        Built::Node(_) => crate::SILENT_AFTER,
    };
    Duration::as_nanos(&after).try_into().unwrap_or(i64::MAX)
}

impl Instance {
    fn new(kind: &Kind, params: &serde_json::Value, host: Host) -> Result<Self, ParamError> {
        let description = &kind.description;
        let outputs: Vec<_> = description.outputs.fixed().iter().map(|port| port.payload.ty()).collect();
        let declared = host.declared().map_err(|error| ParamError::new("out", error.message))?;
        let declared = declared.into_iter().map(|(name, payload, params)| match serde_json::from_str(&params) {
            Ok(params) => Ok(DeclaredPort { name, payload, params }),
            Err(error) => Err(ParamError::new("out", error.to_string())),
        });
        let declared = declared.collect::<Result<Arc<[_]>, _>>()?;
        let n_outputs = outputs.len().max(declared.len());
        let context = BuildContext { declared: declared.clone(), ..BuildContext::detached(host.node()) };
        let built = kind.build(params, &context)?;
        Ok(Self {
            built,
            context: Context::new(host.node(), host.seed(), Arc::default(), declared),
            joined: Joined { slots: Vec::new(), is_spent: true },
            out: vec![Emission::Silent; n_outputs],
            constants: vec![None; description.inputs.len()],
            inputs: description.inputs.iter().map(|port| port.payload).collect(),
            outputs,
        })
    }

    /// Converts the slots of the firing.
    ///
    /// # Safety
    /// `firing` is the current firing of the program.
    unsafe fn join(&mut self, firing: &abi::Firing, host: Host) -> Result<(), NodeError> {
        // SAFETY: guaranteed by the caller, here and below.
        let slots = unsafe { abi::list(firing.slots, firing.n_slots, "the slots of a firing") }?;
        self.joined.slots.clear();
        for (index, slot) in slots.iter().enumerate() {
            let payload = self.inputs.get(index).copied().unwrap_or(PortPayload::Any);
            // SAFETY: as above.
            let items = unsafe { abi::list(slot.items, slot.n_items, "the items of a slot") }?;
            let is_constant = slot.flags & abi::slot::CONSTANT != 0;
            let mut item = |item: &abi::Item| -> Result<Item, NodeError> {
                let known = self.constants.get(index).and_then(Option::as_ref).filter(|_| is_constant);
                // SAFETY: as above.
                let body = match (item.value.is_null(), known) {
                    (true, _) => Body::Empty(unsafe { empty(item) }?),
                    (false, Some(value)) => Body::Value(value.clone()),
                    (false, None) => Body::Value(match payload {
                        PortPayload::Type(ty) => unsafe { host.read(item.value, ty) }?,
                        PortPayload::Any => unsafe { host.hold(item.value, item.payload) }?,
                    }),
                };
                if let (true, Body::Value(value), Some(place)) = (is_constant, &body, self.constants.get_mut(index)) {
                    *place = Some(value.clone());
                }
                Ok(Item { number: item.number, stamp_ns: item.stamp_ns, body })
            };
            self.joined.slots.push(match (slot.what, items) {
                (abi::slot::ITEM, [one]) => Slot::Item(item(one)?),
                // SAFETY: as above.
                (abi::slot::ABSENT, [one]) => Slot::Absent(unsafe { empty(one) }?),
                _ => Slot::Items(items.iter().map(item).collect::<Result<_, _>>()?),
            });
        }
        Ok(())
    }

    fn fire(&mut self, host: Host) -> Result<i32, NodeError> {
        match &mut self.built {
            Built::Node(node) => AnyNode::fire(&mut **node, &mut self.joined, &mut self.out, &mut self.context)?,
            Built::Source(source) => {
                if !source.next(&mut self.out, &mut self.context)? {
                    return Ok(abi::status::END);
                }
            }
        }
        // Drops the inputs, so that a value that was passed through has one handle only.
        self.joined.slots.clear();
        for (port, emission) in self.out.iter_mut().enumerate() {
            let emission = std::mem::replace(emission, Emission::Silent);
            if !matches!(emission, Emission::Silent) {
                host.emit(port, self.outputs.get(port).copied().flatten(), emission)?;
            }
        }
        Ok(abi::status::OK)
    }

    /// Drops the values of the firing.
    fn clear(&mut self) {
        self.joined.slots.clear();
        self.out.iter_mut().for_each(|emission| *emission = Emission::Silent);
    }
}

/// # Safety
/// The item belongs to the current firing.
unsafe fn empty(item: &abi::Item) -> Result<Arc<Empty>, NodeError> {
    // SAFETY: guaranteed by the caller.
    let text = |text| unsafe { abi::text(text, "a reason") }.map(|text| text.unwrap_or_default().to_owned());
    Ok(Arc::new(Empty { node: text(item.empty_node)?, reason: text(item.empty_reason)? }))
}
