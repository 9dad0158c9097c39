//! Functions of Python as nodes of a run in this process.

use crate::{errors::UsageError, views};
use osteoflow::app;
use osteoflow_node::{
    AnyNode, Body, BuildContext, Built, Context, Emission, Item, Joined, Kind, Launch, NodeError, ParamError,
    PayloadType, PortPayload, Registry, Slot, serde_json,
};
use pyo3::{prelude::*, types::PyList};
use std::{
    collections::BTreeMap,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

/// Whether the user asked to stop, as the page of memory that nodes in processes look at: `stop[0] != 0`.
#[pyclass(frozen, module = "osteoflow._core")]
pub(crate) struct Stop(Arc<AtomicBool>);

#[pymethods]
impl Stop {
    fn __getitem__(&self, _index: usize) -> u8 {
        u8::from(self.0.load(Ordering::Relaxed))
    }
}

/// Builds the nodes that are functions, and all others as before.
struct Functions {
    by_node: BTreeMap<String, Py<PyAny>>,
    graph: Registry,
    cancelled: Arc<AtomicBool>,
}

/// What a function gives of an output: payload, stamp, head fields, columns.
type Given<'py> = Option<(String, Bound<'py, PyAny>)>;

/// The registry of a graph with functions in place of nodes.
///
/// # Errors
/// UsageError if a node has a process to itself.
pub(crate) fn registry(
    graph: &app::Graph,
    functions: BTreeMap<String, Py<PyAny>>,
    cancelled: &Arc<AtomicBool>,
) -> PyResult<app::Functions> {
    let nodes: Vec<String> = functions.keys().cloned().collect();
    for node in graph.plan().nodes.iter().filter(|node| nodes.iter().any(|name| **name == *node.name)) {
        if node.place.process.is_some() {
            let message = format!(
                "node \"{}\" is a function here, which fires in this process; take process out of its table",
                node.name
            );
            return Err(UsageError::new_err(message));
        }
    }
    let graph = graph.registry().clone();
    let mut registry = graph.clone();
    registry.set_launcher(Arc::new(Functions { by_node: functions, graph, cancelled: cancelled.clone() }));
    Ok(app::Functions { nodes, registry })
}

impl Launch for Functions {
    fn is_wanted(&self, _: &Kind) -> bool {
        true
    }

    fn launch(&self, kind: &Kind, params: &serde_json::Value, context: &BuildContext) -> Result<Built, ParamError> {
        let Some(function) = self.by_node.get(&*context.node) else { return self.graph.build(kind, params, context) };
        let outputs = kind.description.outputs.payloads(&context.declared).map(|(_, payload)| payload).collect();
        let function = Python::attach(|py| function.clone_ref(py));
        let stop = self.cancelled.clone();
        Ok(Built::Node(Box::new(FunctionNode { function, outputs, types: self.graph.clone(), stop })))
    }
}

struct FunctionNode {
    function: Py<PyAny>,
    outputs: Vec<PortPayload>,
    types: Registry,
    stop: Arc<AtomicBool>,
}

impl AnyNode for FunctionNode {
    fn fire(&mut self, joined: &mut Joined, out: &mut [Emission], ctx: &mut Context) -> Result<(), NodeError> {
        let sent = serde_json::to_string(&ctx.sent()).map_err(|error| NodeError::new(error.to_string()))?;
        let fired = Python::attach(|py| self.call(py, &sent, joined, out));
        let (done, failed) = fired.map_err(|error| NodeError::new(error.to_string()))?;
        ctx.take_over(serde_json::from_str(&done).map_err(|error| NodeError::new(error.to_string()))?);
        failed.map_or(Ok(()), |message| Err(NodeError::new(message)))
    }
}

impl FunctionNode {
    /// Calls the function; what it did with its context, and why it failed.
    fn call(
        &self,
        py: Python<'_>,
        sent: &str,
        joined: &Joined,
        out: &mut [Emission],
    ) -> PyResult<(String, Option<String>)> {
        let slots = joined.slots.iter().map(|slot| match slot {
            Slot::Item(item) => views::item_of_run(py, item).map(|item| PyList::new(py, [item]))?,
            Slot::Items(items) => {
                let items = items.iter().map(|item| views::item_of_run(py, item)).collect::<PyResult<Vec<_>>>()?;
                PyList::new(py, items)
            }
            Slot::Absent(_) => Ok(PyList::empty(py)),
        });
        let slots = slots.collect::<PyResult<Vec<_>>>()?;
        let stop = Py::new(py, Stop(self.stop.clone()))?;
        let answer = self.function.bind(py).call1((sent, slots, stop))?;
        let (done, failed, given): (String, Option<String>, Vec<Given<'_>>) = answer.extract()?;
        for ((place, given), payload) in out.iter_mut().zip(given).zip(&self.outputs) {
            *place = match given {
                None => Emission::Empty("the function gave no value".into()),
                Some((name, item)) => match self.value(payload, &name, &item)?.body {
                    Body::Value(value) => Emission::Value(value),
                    Body::Empty(empty) => Emission::PassedOn(empty),
                },
            };
        }
        Ok((done, failed))
    }

    fn value(&self, payload: &PortPayload, name: &str, item: &Bound<'_, PyAny>) -> PyResult<Item> {
        let ty: Option<&'static PayloadType> = match payload {
            PortPayload::Type(ty) => Some(*ty).filter(|ty| ty.name == name),
            PortPayload::Any => self.types.payload_type(name),
        };
        let of = payload.ty().map_or("a payload that this program knows", |ty| ty.name);
        let ty =
            ty.ok_or_else(|| UsageError::new_err(format!("the function gave {name}, but the output carries {of}")))?;
        views::given_item(ty, 0, item)
    }
}
