//! All that decides about the content of what a run writes: UIDs of DICOM objects follow from it, so that two contents never
//! share one.

use crate::config::Config;
use crate::error::Result;
use crate::io::checksum::sha256;
use crate::pipeline::Case;
use crate::provenance::InputFile;
use crate::volume::LabelMap;

/// All that decides about a run's content, beside the program's version.
#[derive(Debug, Clone, Copy)]
pub struct Decided<'a> {
    /// What was registered, in memory.
    pub case: &'a Case,
    /// All files that were read.
    pub inputs: &'a [InputFile],
    /// The settings.
    pub config: &'a Config,
}

impl Decided<'_> {
    /// Texts of it: inputs by their checksums, what was made of them in memory, the settings, and what else was `given`.
    ///
    /// # Errors
    /// [`crate::error::Error::Internal`] when the settings cannot be told.
    pub(super) fn parts(&self, given: &[(&str, bool)]) -> Result<Vec<String>> {
        let file = |input: &InputFile| {
            let entry = input.entry.as_deref().unwrap_or_default();
            format!("{:?} {} {entry}", input.role, input.sha256)
        };
        let mut files: Vec<String> = self.inputs.iter().map(file).collect();
        files.sort();
        files.dedup();
        let mut parts = vec![self.config.toml()?, files.join("\n")];
        parts.extend(given.iter().map(|(name, value)| format!("{name} {value}")));
        let Case { planning, fraction } = self.case;
        parts.push(of_labels(&planning.bones));
        parts.push(format!("{:?}", planning.skeleton));
        parts.push(format!("{:?}", fraction.start));
        parts.push(format!("{:?}", fraction.bone_landmarks));
        parts.push(fraction.bones.as_ref().map_or(String::new(), of_labels));
        parts.push(format!("{:?}", fraction.landmarks));
        Ok(parts)
    }
}

/// Grid, values and names of a label map.
fn of_labels(map: &LabelMap) -> String {
    let values: Vec<u8> = map.volume.data().iter().flat_map(|label| label.to_le_bytes()).collect();
    format!("{:?} {} {:?}", map.volume.grid(), sha256(&values), map.names)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::InputRole;
    use crate::evaluate::landmark::Landmark;
    use crate::geometry::{Grid, Rigid};
    use crate::skeleton::Skeleton;
    use crate::volume::{LabelMap, Volume};
    use nalgebra::{Matrix3, Point3};

    fn case() -> Case {
        let grid = Grid::new([3, 3, 3], [1.0; 3], Point3::origin(), Matrix3::identity()).unwrap();
        let bones = LabelMap { volume: Volume::filled(grid.clone(), 1u16), names: [(1, "sacrum".to_owned())].into() };
        let ct = Volume::filled(grid, 0.0f32);
        Case::new(ct.clone(), bones, ct)
    }

    fn files() -> Vec<InputFile> {
        [
            (InputRole::Planning, "aa"),
            (InputRole::Bones, "bb"),
            (InputRole::Fraction, "cc"),
            (InputRole::Structures, "dd"),
            (InputRole::Dose, "ee"),
        ]
        .map(|(role, sum)| file(role, sum))
        .into()
    }

    fn file(role: InputRole, sum: &str) -> InputFile {
        InputFile::new(role, "x".into(), sum.into())
    }

    const GIVEN: [(&str, bool); 2] = [("anonymous", false), ("same frame", false)];

    #[test]
    fn each_input_decides() {
        let config = Config::default();
        let of = |case: &Case, inputs: &[InputFile], given: &[(&str, bool)]| {
            Decided { case, inputs, config: &config }.parts(given).unwrap()
        };
        let first = of(&case(), &files(), &GIVEN);
        assert_eq!(first, of(&case(), &files(), &GIVEN));
        // Where a file lies decides nothing.
        let mut elsewhere = files();
        elsewhere[2].path = "y".into();
        assert_eq!(first, of(&case(), &elsewhere, &GIVEN));
        type Change = dyn Fn(&mut Case);
        let changes: [(&str, &Change); 5] = [
            ("labels", &|c| c.planning_mut().bones.volume.data_mut()[4] = 2),
            ("names", &|c| drop(c.planning_mut().bones.names.insert(1, "hyoid".into()))),
            ("skeleton", &|c| c.planning_mut().skeleton = Some(Skeleton { bones: Vec::new() })),
            ("start", &|c| c.fraction.start = Some(Rigid::translation(1.0, 0.0, 0.0))),
            ("landmarks", &|c| {
                let [planning, fraction] = [Point3::origin(); 2];
                c.fraction.landmarks.push(Landmark { name: "a".into(), planning, fraction });
            }),
        ];
        for (name, change) in changes {
            let mut other = case();
            change(&mut other);
            assert_ne!(first, of(&other, &files(), &GIVEN), "{name}");
        }
        for n in 0..files().len() {
            for change in [
                (|file| file.sha256 = "ab".into()) as fn(&mut InputFile),
                |file| file.entry = Some("1".into()),
                |file| file.role = InputRole::Landmarks,
            ] {
                let mut other = files();
                change(&mut other[n]);
                assert_ne!(first, of(&case(), &other, &GIVEN), "{:?}", files()[n].role);
            }
        }
        let mut more = files();
        more.push(file(InputRole::Organs, "ff"));
        assert_ne!(first, of(&case(), &more, &GIVEN), "organs");
        for n in 0..GIVEN.len() {
            let mut given = GIVEN;
            given[n].1 = true;
            assert_ne!(first, of(&case(), &files(), &given), "{}", GIVEN[n].0);
        }
    }

    /// Every setting with a number or a switch, by its place in the file, changed.
    fn changed(value: &toml::Value) -> Vec<toml::Value> {
        match value {
            toml::Value::Table(table) => table
                .iter()
                .flat_map(|(key, inner)| {
                    changed(inner).into_iter().map(|new| {
                        let mut table = table.clone();
                        table.insert(key.clone(), new);
                        toml::Value::Table(table)
                    })
                })
                .collect(),
            toml::Value::Integer(n) => vec![toml::Value::Integer(n + 1)],
            toml::Value::Float(f) => vec![toml::Value::Float(f * 1.25 + 0.01)],
            toml::Value::Boolean(b) => vec![toml::Value::Boolean(!b)],
            _ => Vec::new(),
        }
    }

    #[test]
    fn each_setting_decides() {
        let all: toml::Value = toml::from_str(&Config::default().toml().unwrap()).unwrap();
        let case = case();
        let of = |config: &Config| Decided { case: &case, inputs: &[], config }.parts(&GIVEN).unwrap();
        let first = of(&Config::default());
        let (mut seen, mut count) = (std::collections::BTreeSet::from([first]), 0);
        for other in changed(&all) {
            let Ok(config) = toml::from_str::<Config>(&toml::to_string(&other).unwrap()) else { continue };
            assert!(seen.insert(of(&config)), "{other}");
            count += 1;
        }
        assert!(count > 35, "{count}");
    }
}
