//! Hand-edited TOML files: values by key, with refusals that name file, key and value.

use crate::error::{Error, Result};
use std::path::Path;
use toml::{Table, Value};

/// A table of a TOML file and the way to it, for example `bones.skull`.
pub(super) struct Keyed<'a> {
    path: &'a Path,
    way: String,
    table: &'a Table,
}

/// Reads and parses a TOML file.
pub(super) fn parse(path: &Path) -> Result<Table> {
    parse_text(&super::text::read_text(path)?, path)
}

/// Parses the text of a TOML file; `path` is its name in messages.
pub(super) fn parse_text(text: &str, path: &Path) -> Result<Table> {
    let wrong = |e: toml::de::Error| Error::read(path, e.to_string().trim_end(), "correct the TOML at that place");
    text.parse::<Table>().map_err(wrong)
}

impl<'a> Keyed<'a> {
    /// The whole file.
    pub(super) fn new(path: &'a Path, table: &'a Table) -> Self {
        Self { path, way: String::new(), table }
    }

    /// The refusal of a value, or of the table itself for an empty key.
    pub(super) fn refuse(&self, key: &str, problem: impl std::fmt::Display, remedy: impl Into<String>) -> Error {
        let value = self.table.get(key).map_or_else(String::new, |v| format!(" = {v}"));
        Error::input(self.path.display().to_string(), format!("{}{value}: {problem}", self.key(key)), remedy)
    }

    /// A key with the way to it.
    fn key(&self, key: &str) -> String {
        [self.way.as_str(), key].into_iter().filter(|s| !s.is_empty()).collect::<Vec<_>>().join(".")
    }

    /// Refuses keys other than `known`.
    pub(super) fn only(&self, known: &[&str]) -> Result<()> {
        match self.table.keys().find(|k| !known.contains(&k.as_str())) {
            Some(key) => Err(self.refuse(key, "unknown key", format!("use one of: {}", known.join(", ")))),
            None => Ok(()),
        }
    }

    /// Its keys.
    pub(super) fn keys(&self) -> impl Iterator<Item = &'a str> + use<'a> {
        self.table.keys().map(String::as_str)
    }

    /// The tables of an array of them.
    pub(super) fn tables(&self, key: &str) -> Result<Vec<Keyed<'a>>> {
        let wrong = || self.refuse(key, "expected tables", format!("write [[{}]]", self.key(key)));
        let list = match self.table.get(key) {
            None => return Ok(Vec::new()),
            Some(value) => value.as_array().ok_or_else(wrong)?,
        };
        let table = |(n, value): (usize, &'a Value)| {
            let way = format!("{}[{n}]", self.key(key));
            Ok(Keyed { path: self.path, way, table: value.as_table().ok_or_else(wrong)? })
        };
        list.iter().enumerate().map(table).collect()
    }

    /// Yes or no.
    pub(super) fn flag(&self, key: &str) -> Result<Option<bool>> {
        let wrong = || self.refuse(key, "expected true or false", "write true or false");
        self.table.get(key).map(|value| value.as_bool().ok_or_else(wrong)).transpose()
    }

    /// The table under a key; `None` when there is none.
    pub(super) fn inner(&self, key: &str) -> Result<Option<Keyed<'a>>> {
        match self.table.get(key) {
            None => Ok(None),
            Some(Value::Table(table)) => Ok(Some(Keyed { path: self.path, way: self.key(key), table })),
            Some(_) => Err(self.refuse(key, "expected a table", format!("write [{}]", self.key(key)))),
        }
    }

    /// The tables under this one, with their keys.
    pub(super) fn each(&self) -> Result<Vec<(&'a str, Keyed<'a>)>> {
        let mut out = Vec::new();
        for key in self.table.keys() {
            if let Some(inner) = self.inner(key)? {
                out.push((key.as_str(), inner));
            }
        }
        Ok(out)
    }

    /// A text.
    pub(super) fn text(&self, key: &str) -> Result<Option<&'a str>> {
        match self.table.get(key) {
            None => Ok(None),
            Some(Value::String(s)) => Ok(Some(s)),
            Some(_) => Err(self.refuse(key, "expected a text", "put it in quotation marks")),
        }
    }

    /// A finite number.
    pub(super) fn number(&self, key: &str) -> Result<Option<f64>> {
        let Some(value) = self.table.get(key) else { return Ok(None) };
        let wrong = || self.refuse(key, "expected a finite number", "write for example 2.5");
        number(value).ok_or_else(wrong).map(Some)
    }

    /// `N` finite numbers.
    pub(super) fn numbers<const N: usize>(&self, key: &str) -> Result<Option<[f64; N]>> {
        let Some(value) = self.table.get(key) else { return Ok(None) };
        let wrong = || self.refuse(key, format!("expected {N} finite numbers"), example(N));
        list(value).ok_or_else(wrong).map(Some)
    }

    /// Three lists of three finite numbers.
    pub(super) fn rows(&self, key: &str) -> Result<Option<[[f64; 3]; 3]>> {
        let Some(value) = self.table.get(key) else { return Ok(None) };
        let rows = value.as_array().map(|a| a.iter().map_while(list::<3>).collect::<Vec<_>>());
        let wrong = || self.refuse(key, "expected 3 lists of 3 numbers", "write [[1, 0, 0], [0, 1, 0], [0, 0, 1]]");
        rows.and_then(|r| r.try_into().ok()).ok_or_else(wrong).map(Some)
    }
}

fn number(value: &Value) -> Option<f64> {
    let v = value.as_float().or_else(|| value.as_integer().map(|i| i as f64))?;
    v.is_finite().then_some(v)
}

fn list<const N: usize>(value: &Value) -> Option<[f64; N]> {
    let list = value.as_array()?;
    let numbers: Vec<f64> = list.iter().map_while(number).collect();
    (numbers.len() == list.len()).then(|| numbers.try_into().ok())?
}

fn example(n: usize) -> String {
    let numbers: Vec<_> = (0..n).map(|v| format!("{v}.0")).collect();
    format!("write for example [{}]", numbers.join(", "))
}

/// What a name may have meant: up to three of `names`, nearest first; all of them when few or none is near.
pub(super) fn near<'a>(name: &str, names: impl Iterator<Item = &'a str>) -> String {
    let mut ranked: Vec<(usize, &str)> = names.map(|n| (edits(name, n), n)).collect();
    ranked.sort_unstable();
    let close = ranked.iter().take_while(|(d, n)| *d <= 2.max(n.len() / 3)).count();
    let take = if close > 0 { close.min(3) } else { ranked.len() };
    ranked[..take].iter().map(|(_, n)| *n).collect::<Vec<_>>().join(", ")
}

/// Levenshtein distance in characters.
fn edits(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut corner = row[0];
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let change = corner + usize::from(x != *y);
            corner = row[j + 1];
            row[j + 1] = change.min(corner + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edits_and_near_names() {
        assert_eq!((edits("kitten", "sitting"), edits("", "abc"), edits("same", "same")), (3, 3, 0));
        let names = ["skull", "mandible", "vertebrae_C1", "vertebrae_C2"];
        assert_eq!(near("skul", names.into_iter()), "skull");
        assert_eq!(near("vertebra_C1", names.into_iter()), "vertebrae_C1, vertebrae_C2");
        assert_eq!(near("xyzzy", names.into_iter()).split(", ").count(), 4);
    }
}
