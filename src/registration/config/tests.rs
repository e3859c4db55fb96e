//! What a file of settings may say, and what is made of it.
#![expect(clippy::float_cmp, reason = "values that are exact by construction")]

use super::*;
use crate::chainmail::{
    Carry, ChainmailOptions, Combination, Front, LinkTime, Material, MaterialName, Order, SlipOptions, Structures,
    Variant,
};
use crate::error::Result;
use crate::field::Resampling;
use crate::fit::Resolution;
use serde_json::Value;

fn resolve(toml: &str) -> Result<Config> {
    let value: Value = toml::from_str(toml).unwrap();
    ConfigFile { settings: value.as_object().cloned().unwrap(), ..ConfigFile::default() }.resolve(None)
}

#[test]
fn a_file_changes_what_it_names_and_nothing_else() {
    let c =
        resolve("[chainmail]\nvariant.exponent = 2.0\nmaterial = \"elastic\"\n[fit]\nlevels = [[1.5, 100]]").unwrap();
    assert_eq!(c.chainmail.variant.exponent, 2.0);
    assert_eq!(c.fit.levels, vec![Resolution { blur_mm: 1.5, samples: 100 }]);
    assert_eq!(c.chainmail.variant.cutoff, Variant::default().cutoff);
    assert_eq!(resolve("preset = \"thesis\"").unwrap().chainmail, ChainmailOptions::thesis());
    assert_eq!(resolve("").unwrap(), Config::default());
}

#[test]
fn settings_in_memory_are_those_of_a_file() {
    let settings = serde_json::json!({ "chainmail": { "variant": { "exponent": 2.0 } }, "preset": "fast" });
    let file = ConfigFile::of(settings).unwrap();
    assert!(file.inputs.is_empty() && file.folder.is_none());
    let config = file.resolve(None).unwrap();
    assert_eq!(config, resolve("preset = \"fast\"\n[chainmail.variant]\nexponent = 2.0").unwrap());
    let fast = Preset::Fast.config();
    assert_eq!((config.chainmail.variant.exponent, config.preset), (2.0, Preset::Fast));
    assert_eq!(config.chainmail.variant.cutoff, fast.chainmail.variant.cutoff);
    // The argument's preset goes before theirs, and nothing at all is the default.
    let thesis = file.resolve(Some(Preset::Thesis)).unwrap();
    assert_eq!((thesis.preset, thesis.chainmail.variant.exponent), (Preset::Thesis, 2.0));
    assert_eq!(ConfigFile::of(serde_json::json!({})).unwrap().resolve(None).unwrap(), Config::default());
}

#[test]
fn settings_in_memory_are_a_table_of_known_keys() {
    for other in [Value::Null, serde_json::json!([1]), serde_json::json!("fast"), serde_json::json!(2.5)] {
        let error = ConfigFile::of(other.clone()).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains(&format!("{other}, not a table")), "{error}");
    }
    let unknown = ConfigFile::of(serde_json::json!({ "chainmail": { "exponant": 2.0 } })).unwrap();
    let error = unknown.resolve(None).unwrap_err();
    assert!(error.exit_code() == 2 && error.to_string().contains("exponant"), "{error}");
}

#[test]
fn nothing_beyond_the_thesis_changes_the_field_of_its_preset() {
    let Config { chainmail, refine, consistency, resampling, soft_tissue, .. } = Preset::Thesis.config();
    assert!(!refine.pulls() && consistency.rounds == 0);
    assert_eq!((soft_tissue, resampling), (SoftTissue::ChainMail, Resampling::PullBack));
    // Every setting by name, so that a new one has to be judged here.
    let ChainmailOptions {
        material,
        organs,
        volume_change,
        spacing_mm,
        poisson: _,
        relaxation,
        mend,
        least_hu,
        lung,
        slip,
        variant,
    } = chainmail;
    let Variant {
        order,
        link_time,
        front,
        structures,
        carry,
        combination,
        exponent,
        cutoff,
        prune_ratio,
        waves_mm: _,
        elasticity: _,
    } = variant;
    assert!(organs.is_empty() && volume_change.is_empty() && relaxation.is_empty() && !lung);
    assert_eq!(slip, SlipOptions::none());
    assert_eq!((order, link_time, front), (Order::Timestamps, LinkTime::FastInStiff, Front::Rhombus));
    assert_eq!((structures, carry), (Structures::None, Carry::LinearDecay));
    assert_eq!((combination, material), (Combination::Superposition, Material::Named(MaterialName::Stiff)));
    assert_eq!((exponent, cutoff, prune_ratio, spacing_mm), (4.0, 800.0, 0.0, 0.0));
    assert_eq!((mend, least_hu), (0, -500.0));
}

#[test]
fn every_complete_configuration_survives_a_round_trip() {
    for preset in [Preset::Default, Preset::Fast, Preset::Thesis] {
        let settings = serde_json::to_value(preset.config()).unwrap().as_object().cloned().unwrap();
        let again = ConfigFile { settings, ..ConfigFile::default() }.resolve(None).unwrap();
        assert_eq!(again, preset.config());
    }
}

#[test]
fn refuses_unknown_keys_and_illegal_values_by_name() {
    for (toml, name) in [
        ("[chainmail]\nexponant = 2.0", "exponant"),
        ("[chainmail.variant]\nexponent = -1.0", "chainmail.variant.exponent"),
        ("[output]\ngzip_level = 12", "gzip_level"),
        ("colour = 1", "colour"),
        ("[[chainmail.volume_change]]\norgan = \"parotid_left\"\nfactor = 0.0", "parotid_left"),
        ("soft_tissue = \"nearest-bone\"\n[[chainmail.volume_change]]\norgan = \"a\"\nfactor = 0.9", "volume_change"),
        ("[[sliding.interfaces]]\nname = \"a\"\nbetween = [\"skull\", \"scapla\"]\nreach_mm = 5.0", "scapla"),
        ("[fit]\nlevels = \"many\"", "fit.levels"),
        ("[verdict]\ndice = [0.7, 0.8]", "verdict.dice"),
        ("[verdict]\nlandmark_mean_mm = 2.0", "verdict.landmark_mean_mm"),
        ("[chainmail]\nvariant = 4", "chainmail.variant"),
        ("[chainmail.variant]\nexponent = true", "chainmail.variant.exponent"),
        ("[chainmail.variant]\norder = \"first-moved\"\nstructures = \"third-criterion\"", "structures"),
        ("[chainmail.organs]\ntongue = { min = 1.5, max = 2.0, shear = 0.2 }", "tongue"),
        ("[chainmail]\nmaterial = [{ value = 3.0, min = 0.5, max = 0.9, shear = 0.1 }]", "grey value 3"),
    ] {
        let error = resolve(toml).unwrap_err();
        assert!(error.to_string().contains(name), "{error}");
        assert_eq!(error.exit_code(), 2);
    }
}
