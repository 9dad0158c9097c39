//! Payloads between Python and the engine: their views, as dicts of fields and arrays.

use crate::foreign;
use bytemuck::{Pod, pod_collect_to_vec};
use numpy::{Element, PyArray1, PyArrayDyn, PyArrayMethods};
use osteoflow_node::{Body, Column, ColumnType, Empty, Field, Item, PayloadType, View};
use pyo3::{
    exceptions::PyValueError,
    prelude::*,
    types::{PyBool, PyDict, PyFloat, PyInt, PyString},
};

/// What Python gets of an item: number, stamp, payload, the node and reason of an empty, head fields, columns.
pub(crate) type PyItem = (u64, i64, String, Option<(String, String)>, Py<PyDict>, Py<PyDict>);

/// A column as an array: `n` for one value in a row, else `n x width`.
fn array<'py>(py: Python<'py>, column: &Column) -> PyResult<Bound<'py, PyAny>> {
    fn of<'py, T: Element + Pod>(py: Python<'py>, column: &Column) -> PyResult<Bound<'py, PyAny>> {
        let values = match bytemuck::try_cast_slice::<u8, T>(column.bytes()) {
            Ok(values) => PyArray1::from_slice(py, values),
            Err(_) => PyArray1::from_vec(py, pod_collect_to_vec(column.bytes())),
        };
        match column.width {
            0 | 1 => Ok(values.into_any()),
            width => Ok(values.reshape([column.rows(), width as usize])?.into_any()),
        }
    }
    match column.kind {
        ColumnType::F64 => of::<f64>(py, column),
        ColumnType::F32 => of::<f32>(py, column),
        ColumnType::I64 => of::<i64>(py, column),
        ColumnType::U32 => of::<u32>(py, column),
        ColumnType::U8 => of::<u8>(py, column),
    }
}

/// A view as a dict of its head and one of its columns.
pub(crate) fn dicts(py: Python<'_>, view: &View) -> PyResult<(Py<PyDict>, Py<PyDict>)> {
    let (head, columns) = (PyDict::new(py), PyDict::new(py));
    for (name, field) in &view.head {
        match field {
            Field::Bool(value) => head.set_item(&**name, value)?,
            Field::Int(value) => head.set_item(&**name, value)?,
            Field::Float(value) => head.set_item(&**name, value)?,
            Field::Floats(values) => head.set_item(&**name, PyArray1::from_slice(py, values))?,
            Field::Text(text) => head.set_item(&**name, &**text)?,
        }
    }
    for column in &view.columns {
        columns.set_item(&*column.name, array(py, column)?)?;
    }
    Ok((head.unbind(), columns.unbind()))
}

/// An item for Python.
pub(crate) fn item(
    py: Python<'_>,
    number: u64,
    stamp_ns: i64,
    payload: &str,
    body: Result<&View, &Empty>,
) -> PyResult<PyItem> {
    let view = body.ok();
    let (head, columns) = dicts(py, view.unwrap_or(&View::new()))?;
    let empty = body.err().map(|empty| (empty.node.clone(), empty.reason.clone()));
    Ok((number, stamp_ns, payload.to_owned(), empty, head, columns))
}

/// An item of a run for Python.
pub(crate) fn item_of_run(py: Python<'_>, found: &Item) -> PyResult<PyItem> {
    match &found.body {
        Body::Value(value) => item(py, found.number, found.stamp_ns, value.ty().name, Ok(&value.to_view())),
        Body::Empty(empty) => item(py, found.number, found.stamp_ns, "", Err(empty)),
    }
}

fn field(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Field> {
    // A bool is an int in Python, so it comes first.
    if value.is_instance_of::<PyBool>() {
        return Ok(Field::Bool(value.extract()?));
    }
    if value.is_instance_of::<PyInt>() {
        return Ok(Field::Int(value.extract()?));
    }
    if value.is_instance_of::<PyFloat>() {
        return Ok(Field::Float(value.extract()?));
    }
    if value.is_instance_of::<PyString>() {
        return Ok(Field::Text(value.extract::<String>()?.into()));
    }
    let numbers: Vec<f64> =
        value.try_iter()?.map(|number| number?.extract()).collect::<PyResult<_>>().map_err(|_| {
            PyValueError::new_err(format!("field \"{name}\" must be a bool, a number, a text, or a list of numbers"))
        })?;
    Ok(Field::Floats(numbers))
}

fn column(name: &str, array: &Bound<'_, PyAny>) -> PyResult<Column> {
    macro_rules! of {
        ($($value:ty => $kind:ident),*) => {$(
            if let Ok(array) = array.cast::<PyArrayDyn<$value>>() {
                use numpy::PyUntypedArrayMethods;
                let width = array.shape().get(1).copied().unwrap_or(1);
                let width = u32::try_from(width).map_err(|_| PyValueError::new_err("a row is too long"))?;
                return Ok(Column::new(name.to_owned(), ColumnType::$kind, width, foreign::bytes(array, name)?));
            }
        )*};
    }
    of!(f64 => F64, f32 => F32, i64 => I64, u32 => U32, u8 => U8);
    Err(PyValueError::new_err(format!("\"{name}\" must be an array of float64, float32, int64, uint32 or uint8")))
}

/// An item that Python gives: stamp, head fields and columns of a payload of type `ty`.
pub(crate) fn given_item(ty: &'static PayloadType, number: u64, given: &Bound<'_, PyAny>) -> PyResult<Item> {
    let (stamp_ns, head, columns): (i64, Bound<'_, PyDict>, Bound<'_, PyDict>) = given.extract()?;
    let mut view = View::new();
    for (name, value) in head.iter() {
        let name: String = name.extract()?;
        let field = field(&name, &value)?;
        view = view.with(name, field);
    }
    for (name, array) in columns.iter() {
        view = view.with_column(column(&name.extract::<String>()?, &array)?);
    }
    let value = ty.from_view(&view).map_err(|error| PyValueError::new_err(format!("{}: {error}", ty.name)))?;
    Ok(Item { number, stamp_ns, body: Body::Value(value) })
}
