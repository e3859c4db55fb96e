//! Settings of earlier versions, so that their files and reports still run: a key that has moved is read at its old place; one
//! that is a constant now is passed over where it has that value, and refused where it has another.

use serde_json::{Map, Value, json};

/// Keys of `[chainmail]` that stand in `[chainmail.variant]` now.
const VARIANT: [&str; 11] = [
    "order",
    "link_time",
    "front",
    "structures",
    "carry",
    "combination",
    "exponent",
    "cutoff",
    "prune_ratio",
    "waves_mm",
    "elasticity",
];

/// What no measurement asked to be a setting: table, key, and the value that it always had unless a file said otherwise.
fn constants() -> [(&'static [&'static str], &'static str, Value); 11] {
    [
        (&["fit"], "start_blur_mm", json!(6.0)),
        (&["fit"], "tolerance_mm", json!(1e-3)),
        (&["refine"], "unseen_mm", json!(80.0)),
        (&["refine"], "lung", json!(0.3)),
        (&["refine", "shading"], "weight", json!(0.5)),
        (&["refine", "shading"], "blur", json!(0.15)),
        (&["refine", "shading"], "least_blur", json!(0.3)),
        (&["refine", "shading"], "window_hu", json!([-500.0, 500.0])),
        (&["refine", "shading"], "neighbourhood_mm", json!(6.0)),
        (&["refine", "skin"], "sd_mm", json!(0.5)),
        (&["refine", "skin"], "edge_mm", json!(6.0)),
    ]
}

/// The same settings as this version names them, or what is wrong with them.
pub(super) fn current(mut settings: Map<String, Value>) -> Result<Map<String, Value>, String> {
    for key in VARIANT {
        let Some(chainmail) = table(&mut settings, &["chainmail"]) else { break };
        let Some(value) = chainmail.remove(key) else { continue };
        let variant = chainmail.entry("variant").or_insert_with(|| json!({}));
        // A variant that is no table is refused as such later.
        if variant.as_object_mut().is_some_and(|variant| variant.insert(key.to_owned(), value).is_some()) {
            return Err(format!(
                "chainmail.{key} and chainmail.variant.{key} are one setting, which stands in [chainmail.variant] now: give it once"
            ));
        }
    }
    for (path, key, constant) in constants() {
        let found = table(&mut settings, path).and_then(|table| table.remove(key));
        if let Some(value) = found.filter(|value| !same(value, &constant)) {
            let path = path.join(".");
            return Err(format!(
                "{path}.{key} is {value}: it is no setting any more but always {constant}; leave it out"
            ));
        }
    }
    Ok(settings)
}

/// The table at a path, where there is one.
fn table<'a>(settings: &'a mut Map<String, Value>, path: &[&str]) -> Option<&'a mut Map<String, Value>> {
    path.iter().try_fold(settings, |table, key| table.get_mut(*key)?.as_object_mut())
}

/// Whether values are equal, numbers with or without a point.
fn same(a: &Value, b: &Value) -> bool {
    match (a.as_array(), b.as_array()) {
        (Some(a), Some(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| same(a, b)),
        _ => a.as_f64().is_some() && a.as_f64() == b.as_f64(),
    }
}
