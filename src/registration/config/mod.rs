//! Rank 6: the settings of a run. A preset, overlaid with the user's file; complete, serialisable, recorded with every
//! result.

mod recorded;
mod study;

pub use recorded::RecordedInput;
pub use study::{Published, StudyPlan, StudyStage, StudyTable};

use crate::body::BodyOptions;
use crate::chainmail::{ChainmailOptions, VolumeChange};
use crate::error::{Error, Result};
use crate::evaluate::verdict::Limits;
use crate::field::{ConsistencyOptions, FieldFormat, InvertOptions, Resampling};
use crate::fit::FitOptions;
use crate::plausibility::CheckOptions;
use crate::refine::RefineOptions;
use crate::skeleton::SlidingOptions;
use crate::volume::region::RegionOptions;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::path::{Path, PathBuf};

/// Complete settings of a registration.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// What the settings started from.
    pub preset: Preset,
    /// What the checks of the inputs may do.
    pub checks: CheckOptions,
    /// Finding the patient.
    pub body: BodyOptions,
    /// Fitting the skeleton.
    pub fit: FitOptions,
    /// Where bones slide on each other.
    pub sliding: SlidingOptions,
    /// The model of soft tissue.
    pub soft_tissue: SoftTissue,
    /// Carrying bone motion to soft tissue by the chain mail.
    pub chainmail: ChainmailOptions,
    /// Refining soft tissue by the images.
    pub refine: RefineOptions,
    /// Where results are wanted.
    pub region: RegionOptions,
    /// Inverting the field.
    pub invert: InvertOptions,
    /// How well the field and its inverse have to agree between voxels.
    pub consistency: ConsistencyOptions,
    /// Bringing the planning CT onto the fraction grid.
    pub resampling: Resampling,
    /// What is written, and how.
    pub output: OutputOptions,
    /// By which limits the result is judged.
    pub verdict: Limits,
}

/// What carries bone motion to soft tissue.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SoftTissue {
    /// The chain mail.
    #[default]
    ChainMail,
    /// For comparison: thin-plate splines through 6 control points per bone (thesis 4.2.3).
    ThinPlateSplines,
    /// For comparison: each voxel moves rigidly with its nearest bone.
    NearestBone,
}

/// Named starting points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// What measures best (docs/validation.md).
    #[default]
    Default,
    /// Elements of 5 mm, fewer samples of the fit and comparisons of the images, no map of uncertainty, fields not made to agree
    /// between voxels.
    Fast,
    /// More comparisons of the images and rounds of relaxation.
    Accurate,
    /// The final model of the thesis (6.1.7): timestamps, linear decay, superposition t^-4, stiff, every voxel; nothing
    /// beyond it changes the field.
    Thesis,
}

/// What is written, and how.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OutputOptions {
    /// File format of the two displacement fields.
    pub field_format: FieldFormat,
    /// Gzip level of compressed files, 0 to 9.
    pub gzip_level: u32,
    /// Write the regions of influence as `regions.nii.gz`: which bone each voxel follows.
    pub regions: bool,
    /// Write `uncertainty.nii.gz`: how far the result may be trusted, mm.
    pub uncertainty: bool,
}

impl Default for OutputOptions {
    fn default() -> Self {
        Self { field_format: FieldFormat::Nifti, gzip_level: 1, regions: false, uncertainty: true }
    }
}

impl Preset {
    /// The settings that the preset stands for.
    pub fn config(self) -> Config {
        let base = Config { preset: self, ..Config::default() };
        match self {
            Self::Default => base,
            Self::Fast => Config {
                chainmail: ChainmailOptions {
                    spacing_mm: 5.0,
                    relaxation: vec![(20.0, 30), (10.0, 20), (5.0, 8)],
                    ..ChainmailOptions::default()
                },
                fit: FitOptions { levels: vec![(2.0, 2000), (0.8, 5000)], ..FitOptions::default() },
                refine: RefineOptions { passes: 4, rounds: 2, ..RefineOptions::default() },
                consistency: ConsistencyOptions { rounds: 0, ..ConsistencyOptions::default() },
                output: OutputOptions { uncertainty: false, gzip_level: 0, ..OutputOptions::default() },
                ..base
            },
            Self::Accurate => Config {
                refine: RefineOptions { passes: 16, settled: 0.005, rounds: 5, ..RefineOptions::default() },
                ..base
            },
            Self::Thesis => Config {
                chainmail: ChainmailOptions::thesis(),
                refine: RefineOptions { weight: 0.0, ..RefineOptions::default() },
                consistency: ConsistencyOptions { rounds: 0, ..ConsistencyOptions::default() },
                ..base
            },
        }
    }
}

/// A configuration file: settings and, from a report, the inputs it was run with.
#[derive(Debug, Clone, Default)]
pub struct ConfigFile {
    /// The user's settings, to be overlaid on a preset.
    settings: Map<String, Value>,
    /// Inputs of the run that a report describes.
    pub inputs: Vec<RecordedInput>,
    /// The folder of that report when it was written.
    pub folder: Option<PathBuf>,
}

impl ConfigFile {
    /// Reads a TOML file, or the `report.json` of an earlier run.
    ///
    /// # Errors
    /// [`Error::Read`] when the file cannot be read or parsed, [`Error::Usage`] when it holds `nan` or `inf`.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path)
            .map_err(|e| Error::read(path, e.to_string(), "check the path of --config"))?;
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
            return Ok(Self { settings, inputs, folder });
        }
        let value: Value = toml::from_str(text).map_err(|e| bad(format!("it is no TOML: {e}")))?;
        if let Some(key) = not_finite(&value) {
            return Err(Error::usage(
                format!("{}: {key} is not a finite number", path.display()),
                "give a finite number, or leave the line out",
            ));
        }
        Ok(Self { settings: value.as_object().cloned().unwrap_or_default(), ..Self::default() })
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
                format!("the settings are not legal: {e}"),
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
        let mut value = serde_json::to_value(preset.config()).map_err(|e| Error::Internal(e.to_string()))?;
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

impl Config {
    /// All settings as a value, as reports hold them.
    ///
    /// # Errors
    /// [`Error::Internal`] when one has no JSON.
    pub fn value(&self) -> Result<Value> {
        serde_json::to_value(self).map_err(|e| Error::Internal(e.to_string()))
    }

    /// All settings as a file for `--config`.
    ///
    /// # Errors
    /// [`Error::Internal`] when one has no TOML.
    pub fn toml(&self) -> Result<String> {
        toml::to_string_pretty(self).map_err(|e| Error::Internal(format!("settings as TOML: {e}")))
    }

    /// Lays changes of organs' volumes over those of the settings; what is impossible then, if there are any.
    pub fn change_volumes(&mut self, changes: &[VolumeChange]) -> Option<String> {
        for change in changes {
            self.chainmail.volume_change.retain(|c| c.organ != change.organ);
            self.chainmail.volume_change.push(change.clone());
        }
        self.problem().filter(|_| !changes.is_empty())
    }

    /// What is impossible in these settings, if anything.
    pub fn problem(&self) -> Option<String> {
        let (f, b) = (&self.fit, &self.body);
        let r = &self.refine;
        let within = |name: &str, value: f64, low: f64, high: f64| {
            let bad = !(low..=high).contains(&value);
            bad.then(|| format!("{name} is {value}: it must lie in [{low}, {high}]"))
        };
        let levels = |name: &str, list: &[(f64, usize)]| {
            let bad = list.iter().any(|l| !(0.0..=50.0).contains(&l.0) || l.1 == 0);
            bad.then(|| format!("{name} is {list:?}: pairs of a blur in [0, 50] mm and samples above 0 are needed"))
        };
        let count = |name: &str, n: usize| (n == 0).then(|| format!("{name} is 0: it must be above 0"));
        let checks = [
            f.levels.is_empty().then(|| "fit.levels is []: at least one (blur mm, samples) pair is needed".to_owned()),
            levels("fit.levels", &f.levels),
            levels("fit.outward", &f.outward),
            within("fit.start_blur_mm", f.start_blur_mm, 0.0, 50.0),
            within("fit.tolerance_mm", f.tolerance_mm, 1e-9, 10.0),
            count("fit.max_iterations", usize::try_from(f.max_iterations).unwrap_or(usize::MAX)),
            self.chainmail.problem(),
            self.sliding.problem(),
            (self.soft_tissue != SoftTissue::ChainMail && !self.chainmail.volume_change.is_empty())
                .then(|| "chainmail.volume_change needs soft_tissue = \"chain-mail\"".to_owned()),
            self.region.problem(),
            within("refine.weight", r.weight, 0.0, 1e6),
            count("refine.passes", r.passes),
            count("refine.rounds", r.rounds),
            within("refine.blur", r.blur, 0.0, 10.0),
            within("refine.least_blur", r.least_blur, 0.0, 10.0),
            within("refine.settled", r.settled, 0.0, 10.0),
            within("refine.robust", r.robust, 0.1, 1e6),
            within("refine.departure", r.departure, 1e-4, 1e6),
            within("refine.unseen_mm", r.unseen_mm, 0.0, 1e4),
            within("refine.lung", r.lung, 0.0, 10.0),
            within("refine.shading.least_hu", r.shading.least_hu, 0.0, 1e6),
            within("refine.shading.least_gain", r.shading.least_gain, 0.0, 10.0),
            within("refine.shading.weight", r.shading.weight, 0.0, 1e6),
            within("refine.shading.blur", r.shading.blur, 0.0, 10.0),
            within("refine.shading.least_blur", r.shading.least_blur, 0.0, 10.0),
            within("refine.shading.neighbourhood_mm", r.shading.neighbourhood_mm, 0.0, 1000.0),
            within("refine.shading.window_hu, its upper end", f64::from(r.shading.window_hu[1]), -1999.0, 65535.0),
            within(
                "refine.shading.window_hu, its lower end",
                f64::from(r.shading.window_hu[0]),
                -2000.0,
                f64::from(r.shading.window_hu[1]) - 1.0,
            ),
            within("refine.skin.weight", r.skin.weight, 0.0, 1e6),
            within("refine.skin.sd_mm", r.skin.sd_mm, 0.01, 100.0),
            within("refine.skin.edge_mm", r.skin.edge_mm, 0.1, 1000.0),
            within(
                "refine.window_hu, its lower end",
                f64::from(r.window_hu[0]),
                -2000.0,
                f64::from(r.window_hu[1]) - 1.0,
            ),
            within("refine.window_hu, its upper end", f64::from(r.window_hu[1]), -1999.0, 65535.0),
            within("invert.tolerance_mm", self.invert.tolerance_mm, 1e-9, 10.0),
            count("invert.max_iterations", self.invert.max_iterations),
            within("consistency.limit_mm", self.consistency.limit_mm, 0.01, 100.0),
            self.verdict.problem(),
            within("output.gzip_level", f64::from(self.output.gzip_level), 0.0, 9.0),
            within("body.threshold_hu", b.threshold_hu, -2000.0, 3000.0),
            within("body.opening_mm", b.opening_mm, 0.0, 100.0),
            within("body.separation_mm", b.separation_mm, 0.0, 100.0),
            within("body.closing_mm", b.closing_mm, 0.0, 100.0),
        ];
        checks.into_iter().flatten().next()
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "values that are exact by construction")]
mod tests {
    use super::*;
    use crate::chainmail::{
        Carry, Combination, Front, LinkTime, Material, MaterialName, Order, SlipOptions, Structures,
    };

    fn resolve(toml: &str) -> Result<Config> {
        let value: Value = toml::from_str(toml).unwrap();
        ConfigFile { settings: value.as_object().cloned().unwrap(), ..ConfigFile::default() }.resolve(None)
    }

    #[test]
    fn a_file_changes_what_it_names_and_nothing_else() {
        let c = resolve("[chainmail]\nexponent = 2.0\nmaterial = \"elastic\"\n[fit]\nlevels = [[1.5, 100]]").unwrap();
        assert_eq!(c.chainmail.exponent, 2.0);
        assert_eq!(c.fit.levels, vec![(1.5, 100)]);
        assert_eq!(c.chainmail.cutoff, ChainmailOptions::default().cutoff);
        assert_eq!(resolve("preset = \"thesis\"").unwrap().chainmail, ChainmailOptions::thesis());
        assert_eq!(resolve("").unwrap(), Config::default());
    }

    #[test]
    fn settings_in_memory_are_those_of_a_file() {
        let settings = serde_json::json!({ "chainmail": { "exponent": 2.0 }, "preset": "fast" });
        let file = ConfigFile::of(settings).unwrap();
        assert!(file.inputs.is_empty() && file.folder.is_none());
        let config = file.resolve(None).unwrap();
        assert_eq!(config, resolve("preset = \"fast\"\n[chainmail]\nexponent = 2.0").unwrap());
        let fast = Preset::Fast.config();
        assert_eq!((config.chainmail.exponent, config.preset), (2.0, Preset::Fast));
        assert_eq!(config.chainmail.cutoff, fast.chainmail.cutoff);
        // The argument's preset goes before theirs, and nothing at all is the default.
        let thesis = file.resolve(Some(Preset::Thesis)).unwrap();
        assert_eq!((thesis.preset, thesis.chainmail.exponent), (Preset::Thesis, 2.0));
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
            spacing_mm,
            elasticity: _,
            poisson: _,
            relaxation,
            mend,
            least_hu,
            lung,
            slip,
        } = chainmail;
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
        for preset in [Preset::Default, Preset::Fast, Preset::Accurate, Preset::Thesis] {
            let settings = serde_json::to_value(preset.config()).unwrap().as_object().cloned().unwrap();
            let again = ConfigFile { settings, ..ConfigFile::default() }.resolve(None).unwrap();
            assert_eq!(again, preset.config());
        }
    }

    #[test]
    fn refuses_unknown_keys_and_illegal_values_by_name() {
        for (toml, name) in [
            ("[chainmail]\nexponant = 2.0", "exponant"),
            ("[chainmail]\nexponent = -1.0", "exponent"),
            ("[output]\ngzip_level = 12", "gzip_level"),
            ("colour = 1", "colour"),
            ("[[chainmail.volume_change]]\norgan = \"parotid_left\"\nfactor = 0.0", "parotid_left"),
            (
                "soft_tissue = \"nearest-bone\"\n[[chainmail.volume_change]]\norgan = \"a\"\nfactor = 0.9",
                "volume_change",
            ),
            ("[[sliding.interfaces]]\nname = \"a\"\nbetween = [\"skull\", \"scapla\"]\nreach_mm = 5.0", "scapla"),
            ("[fit]\nlevels = \"many\"", "fit.levels"),
            ("[verdict]\ndice = [0.7, 0.8]", "verdict.dice"),
            ("[verdict]\nlandmark_mean_mm = 2.0", "verdict.landmark_mean_mm"),
            ("[chainmail]\nexponent = true", "chainmail.exponent"),
            ("[chainmail]\norder = \"first-moved\"\nstructures = \"third-criterion\"", "structures"),
            ("[chainmail.organs]\ntongue = { min = 1.5, max = 2.0, shear = 0.2 }", "tongue"),
            ("[chainmail]\nmaterial = [{ value = 3.0, min = 0.5, max = 0.9, shear = 0.1 }]", "grey value 3"),
        ] {
            let error = resolve(toml).unwrap_err();
            assert!(error.to_string().contains(name), "{error}");
            assert_eq!(error.exit_code(), 2);
        }
    }
}
