//! Values of Python as settings of a graph.

use crate::errors::UsageError;
use osteoflow::app::{Plugins, SettingValue};
use pyo3::{
    exceptions::PyTypeError,
    prelude::*,
    types::{PyBool, PyFloat, PyInt, PyList, PyMapping, PyString, PyTuple},
};
use std::{num::NonZeroUsize, path::PathBuf};

/// Settings as Python gives them: a mapping of keys to values, or texts, each KEY=VALUE.
pub(crate) fn settings(given: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<String>> {
    let mut settings = Vec::new();
    let Some(given) = given else { return Ok(settings) };
    match given.cast::<PyMapping>() {
        Ok(mapping) => {
            for pair in mapping.items()?.iter() {
                let (key, value): (Bound<'_, PyAny>, Bound<'_, PyAny>) = pair.extract()?;
                settings.push(format!("{}={}", key.str()?, value_of(&value)?));
            }
        }
        Err(_) => {
            for text in given.try_iter()? {
                settings.push(text?.str()?.to_string());
            }
        }
    }
    Ok(settings)
}

/// Each setting as `--set` takes it, for a process on another machine.
#[pyfunction]
pub(crate) fn setting_texts(given: Option<Bound<'_, PyAny>>) -> PyResult<Vec<String>> {
    settings(given.as_ref())
}

/// A value of Python as one of a graph file.
pub(crate) fn value_of(value: &Bound<'_, PyAny>) -> PyResult<SettingValue> {
    if value.is_instance_of::<PyBool>() {
        return Ok(SettingValue::Boolean(value.extract()?));
    }
    if value.is_instance_of::<PyInt>() {
        return Ok(SettingValue::Integer(value.extract()?));
    }
    if value.is_instance_of::<PyFloat>() {
        return Ok(SettingValue::Float(value.extract()?));
    }
    if value.is_instance_of::<PyString>() {
        return Ok(SettingValue::String(value.extract()?));
    }
    if value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>() {
        let values = value.try_iter()?.map(|value| value_of(&value?));
        return Ok(SettingValue::Array(values.collect::<PyResult<_>>()?));
    }
    if let Ok(mapping) = value.cast::<PyMapping>() {
        let pairs = mapping.items()?;
        let pairs = pairs.iter().map(|pair| {
            let (key, value): (Bound<'_, PyAny>, Bound<'_, PyAny>) = pair.extract()?;
            Ok((key.str()?.to_string(), value_of(&value)?))
        });
        return Ok(SettingValue::Table(pairs.collect::<PyResult<_>>()?));
    }
    // Arrays and numbers of numpy.
    if value.hasattr("tolist")? {
        return value_of(&value.call_method0("tolist")?);
    }
    if value.hasattr("__fspath__")? {
        return Ok(SettingValue::String(value.call_method0("__fspath__")?.extract()?));
    }
    let message = "is no value of a graph file; give a bool, number, text, list or dict";
    Err(PyTypeError::new_err(format!("{} {message}", value.repr()?)))
}

/// Plugins by their files.
pub(crate) fn plugins(files: Vec<PathBuf>) -> Plugins {
    Plugins { files, ..Plugins::default() }
}

/// A number of threads.
pub(crate) fn workers(workers: Option<usize>) -> PyResult<Option<NonZeroUsize>> {
    let at_least_one =
        |n| NonZeroUsize::new(n).ok_or_else(|| UsageError::new_err("workers is 0, but must be at least 1"));
    workers.map(at_least_one).transpose()
}

/// What a word means in a list of choices.
pub(crate) fn choice<T: Copy, const N: usize>(name: &str, word: &str, choices: [(&str, T); N]) -> PyResult<T> {
    let meaning = choices.iter().find(|(choice, _)| *choice == word).map(|(_, meaning)| *meaning);
    meaning.ok_or_else(|| {
        let words = choices.map(|(choice, _)| choice).join(", ");
        UsageError::new_err(format!("{name} is \"{word}\", but must be one of {words}"))
    })
}
