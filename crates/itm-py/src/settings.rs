//! Settings from what Python has: TOML, a dictionary, keyword arguments.

use std::path::PathBuf;

use itm_core::Settings;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyList, PyMapping, PyString, PyTuple};
use toml::Value;

use crate::arrays::describe;
use crate::errors::{self, SettingsError};

/// Settings as they were given.
#[derive(Default)]
pub(crate) struct Given {
    /// A file's text, with the name to show in errors.
    text: Option<(String, String)>,
    /// Single settings, `key=value`, later ones winning.
    overrides: Vec<String>,
}

impl Given {
    /// `settings` is a TOML file's path, TOML text or a dictionary; `more`, keyword arguments, win over it.
    pub(crate) fn new(settings: Option<&Bound<'_, PyAny>>, more: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let mut given = Self::default();
        match settings {
            None => {}
            Some(settings) => {
                if let Ok(mapping) = settings.cast::<PyMapping>() {
                    flatten(mapping, "", &mut given.overrides)?;
                } else if let Some(text) = text_of(settings) {
                    given.text = Some(("settings".into(), text));
                } else if let Ok(path) = settings.extract::<PathBuf>() {
                    let name = path.display().to_string();
                    let text = std::fs::read_to_string(&path).map_err(|error| {
                        SettingsError::new_err(format!("cannot read the settings '{name}': {error}"))
                    })?;
                    given.text = Some((name, text));
                } else {
                    let found = describe(settings);
                    return Err(PyTypeError::new_err(format!(
                        "settings must be a dict, TOML text or the path of a TOML file, not {found}"
                    )));
                }
            }
        }
        if let Some(more) = more {
            flatten(more.as_mapping(), "", &mut given.overrides)?;
        }
        Ok(given)
    }

    /// The settings, on top of `base` where no text was given.
    pub(crate) fn resolve(&self, base: Option<(&str, &str)>) -> PyResult<Settings> {
        let text = self.text.as_ref().map(|(name, text)| (name.as_str(), text.as_str()));
        Settings::resolve(text.or(base), &self.overrides).map_err(|error| errors::of_settings(&error))
    }
}

/// TOML text: a path holds neither of the two without which no setting can be written.
fn text_of(settings: &Bound<'_, PyAny>) -> Option<String> {
    let text: String = settings.cast::<PyString>().ok()?.extract().ok()?;
    (text.contains(['\n', '=']) || text.trim().is_empty()).then_some(text)
}

/// Groups of settings as `group.key=value`.
fn flatten(mapping: &Bound<'_, PyMapping>, before: &str, overrides: &mut Vec<String>) -> PyResult<()> {
    for item in mapping.items()? {
        let (key, value): (Bound<'_, PyAny>, Bound<'_, PyAny>) = item.extract()?;
        let Ok(name) = key.extract::<String>() else {
            let found = describe(&key);
            return Err(PyTypeError::new_err(format!("the keys of settings are strings, not {found}")));
        };
        let mut key = format!("{before}{name}");
        if let Ok(group) = value.cast::<PyMapping>() {
            flatten(group, &format!("{key}."), overrides)?;
            continue;
        }
        let value = toml_of(&value, &key)?;
        // The one thing that is to be said of a device.
        if key == "device" {
            key.push_str(".adapter");
        }
        overrides.push(format!("{key}={value}"));
    }
    Ok(())
}

fn toml_of(value: &Bound<'_, PyAny>, key: &str) -> PyResult<Value> {
    if value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>() {
        return value.try_iter()?.map(|item| toml_of(&item?, key)).collect::<PyResult<_>>().map(Value::Array);
    }
    if value.is_instance_of::<PyBool>() {
        return value.extract().map(Value::Boolean);
    }
    if let Ok(text) = value.extract::<String>() {
        return Ok(Value::String(text));
    }
    if value.is_instance_of::<PyFloat>() {
        return value.extract().map(Value::Float);
    }
    // Numpy's numbers as well.
    if let Ok(number) = value.extract::<i64>() {
        return Ok(Value::Integer(number));
    }
    if let Ok(number) = value.extract::<f64>() {
        return Ok(Value::Float(number));
    }
    if let Ok(switch) = value.extract::<bool>() {
        return Ok(Value::Boolean(switch));
    }
    let found = describe(value);
    Err(PyTypeError::new_err(format!("the setting {key} must be a number, a switch, a string or a list, not {found}")))
}

/// Every setting as nested dictionaries.
pub(crate) fn as_dict<'py>(py: Python<'py>, settings: &Settings) -> PyResult<Bound<'py, PyDict>> {
    // What was written as TOML can be read as such.
    let tree: toml::Table =
        settings.to_toml().parse().map_err(|error: toml::de::Error| SettingsError::new_err(error.to_string()))?;
    dict_of(py, &tree)
}

fn dict_of<'py>(py: Python<'py>, table: &toml::Table) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    for (key, value) in table {
        dict.set_item(key, object_of(py, value)?)?;
    }
    Ok(dict)
}

fn object_of<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::String(text) => text.into_pyobject(py)?.into_any(),
        Value::Integer(number) => number.into_pyobject(py)?.into_any(),
        Value::Float(number) => number.into_pyobject(py)?.into_any(),
        Value::Boolean(switch) => switch.into_pyobject(py)?.to_owned().into_any(),
        Value::Datetime(time) => time.to_string().into_pyobject(py)?.into_any(),
        Value::Array(items) => {
            let items: PyResult<Vec<_>> = items.iter().map(|item| object_of(py, item)).collect();
            PyList::new(py, items?)?.into_any()
        }
        Value::Table(table) => dict_of(py, table)?.into_any(),
    })
}

/// Every setting with its value, as nested dictionaries: the defaults, or what settings and keyword arguments as of Session
/// make of them.
#[pyfunction]
#[pyo3(signature = (settings=None, **more))]
pub(crate) fn resolve_settings<'py>(
    py: Python<'py>,
    settings: Option<&Bound<'py, PyAny>>,
    more: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyDict>> {
    as_dict(py, &Given::new(settings, more)?.resolve(None)?)
}
