//! A file of settings, or the report of an earlier run: a preset, overlaid with what it names.

use super::recorded::RecordedInput;
use super::settings::{Config, Preset};
use crate::error::{Error, Result};
use serde_json::{Map, Value};
use std::path::{Path, PathBuf};

/// A configuration file: settings and, from a report, the inputs it was run with.
#[derive(Debug, Clone, Default)]
pub struct ConfigFile {
    /// The user's settings, to be overlaid on a preset.
    pub(super) settings: Map<String, Value>,
    /// Inputs of the run that a report describes.
    pub inputs: Vec<RecordedInput>,
    /// The folder of that report when it was written.
    pub folder: Option<PathBuf>,
    /// The file itself, for messages.
    pub(super) file: Option<PathBuf>,
}

impl ConfigFile {
    /// Reads a TOML file, or the `report.json` of an earlier run.
    ///
    /// # Errors
    /// [`Error::Read`] when the file cannot be read or parsed, [`Error::Usage`] when it holds `nan` or `inf`.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path)
            .map_err(|e| Error::read(path, e.to_string(), "check the path of --config, a text file"))?;
        let text = text.trim_start_matches('\u{feff}');
        let bad = |problem: String| {
            Error::read(path, problem, "give a TOML file of settings or the report.json of an earlier run")
        };
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json")) {
            let report: Value = serde_json::from_str(text).map_err(|e| bad(format!("it is no JSON ({e})")))?;
            let settings = report
                .get("settings")
                .and_then(Value::as_object)
                .ok_or_else(|| bad("it has no `settings`".into()))?
                .clone();
            let recorded = report.get("inputs").cloned().unwrap_or(Value::Array(Vec::new()));
            let inputs =
                serde_json::from_value(recorded).map_err(|e| bad(format!("its `inputs` are damaged ({e})")))?;
            let folder = report.get("folder").and_then(Value::as_str).map(PathBuf::from);
            return Ok(Self { settings, inputs, folder, file: Some(path.to_owned()) });
        }
        let value: Value = toml::from_str(text).map_err(|e| bad(format!("it is no TOML: {e}")))?;
        if let Some(key) = not_finite(&value) {
            return Err(Error::usage(
                format!("{}: {key} is not a finite number", path.display()),
                "give a finite number, or leave the line out",
            ));
        }
        let settings = value.as_object().cloned().unwrap_or_default();
        Ok(Self { settings, file: Some(path.to_owned()), ..Self::default() })
    }

    /// Settings in memory, as the TOML file or `settings` of a report nests them.
    ///
    /// # Errors
    /// [`Error::Usage`] when it is no table.
    pub fn of(settings: Value) -> Result<Self> {
        match settings {
            Value::Object(settings) => Ok(Self { settings, ..Self::default() }),
            other => Err(Error::usage(
                format!("the settings are {other}, not a table"),
                "nest them as a TOML file of settings does",
            )),
        }
    }

    /// The complete settings: the preset (the argument's, else the file's, else the default), overlaid with the file.
    ///
    /// # Errors
    /// [`Error::Usage`] when the file has an unknown key or a value that is not legal.
    pub fn resolve(&self, preset: Option<Preset>) -> Result<Config> {
        let bad = |e: String| {
            Error::usage(
                match &self.file {
                    Some(file) => format!("{}: the settings are not legal: {e}", file.display()),
                    None => format!("the settings are not legal: {e}"),
                },
                "compare with docs/settings.md; `settings` of any report.json is a complete example",
            )
        };
        let named = self
            .settings
            .get("preset")
            .map(|p| serde_json::from_value::<Preset>(p.clone()))
            .transpose()
            .map_err(|e| bad(e.to_string()))?;
        let preset = preset.or(named).unwrap_or_default();
        let mut value = preset.config().value()?;
        overlay(&mut value, &Value::Object(self.settings.clone()));
        value["preset"] = serde_json::to_value(preset).map_err(|e| Error::Internal(e.to_string()))?;
        let config: Config =
            serde_path_to_error::deserialize(value).map_err(|e| bad(format!("{}: {}", e.path(), e.inner())))?;
        config.problem().map_or(Ok(config), |p| Err(bad(p)))
    }
}

/// Key of the first `nan` or `inf` of a TOML file: JSON values, which the settings are held in, have null in their place.
fn not_finite(value: &Value) -> Option<String> {
    let join = |key: String, inner: String| if inner.is_empty() { key } else { format!("{key}.{inner}") };
    match value {
        Value::Null => Some(String::new()),
        Value::Object(table) => table.iter().find_map(|(key, v)| Some(join(key.clone(), not_finite(v)?))),
        Value::Array(list) => list.iter().enumerate().find_map(|(n, v)| Some(join(n.to_string(), not_finite(v)?))),
        _ => None,
    }
}

/// Replaces values of `base` by those of `over`; objects are merged key by key, except where their kind differs.
fn overlay(base: &mut Value, over: &Value) {
    match (base, over) {
        (Value::Object(base), Value::Object(over)) => {
            for (key, value) in over {
                overlay(base.entry(key.clone()).or_insert(Value::Null), value);
            }
        }
        (base, over) => *base = over.clone(),
    }
}
