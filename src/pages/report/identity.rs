//! All that decides about the content of what a run writes: UIDs of DICOM objects follow from it, so that two contents never
//! share one.

use crate::config::Config;
use crate::error::Result;
use crate::io::checksum::sha256;
use crate::pipeline::{Case, InputFile};

/// Texts of all that decides about a run's content, beside the program's version: its inputs by their checksums, what was made
/// of them in memory, the settings, and what else was `given`.
///
/// # Errors
/// [`crate::error::Error::Internal`] when the settings cannot be told.
pub(super) fn decided_by(
    case: &Case,
    inputs: &[InputFile],
    config: &Config,
    given: &[(&str, bool)],
) -> Result<Vec<String>> {
    let file = |input: &InputFile| {
        let entry = input.entry.as_deref().unwrap_or_default();
        format!("{:?} {} {entry}", input.role, input.sha256)
    };
    let mut files: Vec<String> = case.inputs().chain(inputs).map(file).collect();
    files.sort();
    files.dedup();
    let mut parts = vec![config.toml()?, files.join("\n")];
    parts.extend(given.iter().map(|(name, value)| format!("{name} {value}")));
    let (planning, fraction) = (&case.planning, &case.fraction);
    let labels: Vec<u8> = planning.bones.volume.data().iter().flat_map(|label| label.to_le_bytes()).collect();
    parts.push(format!("{:?} {} {:?}", planning.bones.volume.grid(), sha256(&labels), planning.bones.names));
    parts.push(format!("{:?}", planning.skeleton));
    parts.push(format!("{:?}", fraction.start));
    parts.push(format!("{:?}", fraction.bone_landmarks));
    parts.push(format!("{:?}", fraction.landmarks));
    Ok(parts)
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
        let mut case = Case::new(ct.clone(), bones, ct);
        case.planning.inputs = vec![file(InputRole::Planning, "aa"), file(InputRole::Bones, "bb")];
        case.fraction.inputs = vec![file(InputRole::Fraction, "cc")];
        case
    }

    fn file(role: InputRole, sum: &str) -> InputFile {
        InputFile::new(role, "x".into(), sum.into())
    }

    const GIVEN: [(&str, bool); 2] = [("anonymous", false), ("same frame", false)];

    #[test]
    fn each_input_decides() {
        let own = [file(InputRole::Structures, "dd"), file(InputRole::Dose, "ee")];
        let config = Config::default();
        let of = |case: &Case| decided_by(case, &own, &config, &GIVEN).unwrap();
        let first = of(&case());
        assert_eq!(first, of(&case()));
        // Where a file lies decides nothing.
        let mut elsewhere = case();
        elsewhere.fraction.inputs[0].path = "y".into();
        assert_eq!(first, of(&elsewhere));
        type Change<'a> = (&'a str, &'a dyn Fn(&mut Case));
        let changes: [Change<'_>; 11] = [
            ("planning", &|c| c.planning.inputs[0].sha256 = "ab".into()),
            ("bones", &|c| c.planning.inputs[1].sha256 = "ab".into()),
            ("entry", &|c| c.planning.inputs[1].entry = Some("1".into())),
            ("organs", &|c| c.planning.inputs.push(file(InputRole::Organs, "ff"))),
            ("fraction", &|c| c.fraction.inputs[0].sha256 = "ab".into()),
            ("labels", &|c| c.planning.bones.volume.data_mut()[4] = 2),
            ("names", &|c| drop(c.planning.bones.names.insert(1, "hyoid".into()))),
            ("skeleton", &|c| c.planning.skeleton = Some(Skeleton { bones: Vec::new() })),
            ("start", &|c| c.fraction.start = Some(Rigid::translation(1.0, 0.0, 0.0))),
            ("landmarks", &|c| {
                let [planning, fraction] = [Point3::origin(); 2];
                c.fraction.landmarks.push(Landmark { name: "a".into(), planning, fraction });
            }),
            ("roles", &|c| c.fraction.inputs[0].role = InputRole::Landmarks),
        ];
        for (name, change) in changes {
            let mut other = case();
            change(&mut other);
            assert_ne!(first, of(&other), "{name}");
        }
        for n in 0..own.len() {
            let mut other = own.clone();
            other[n].sha256 = "ab".into();
            assert_ne!(first, decided_by(&case(), &other, &config, &GIVEN).unwrap(), "{:?}", own[n].role);
            let mut given = GIVEN;
            given[n].1 = true;
            assert_ne!(first, decided_by(&case(), &own, &config, &given).unwrap(), "{}", GIVEN[n].0);
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
        let first = decided_by(&case(), &[], &Config::default(), &GIVEN).unwrap();
        let (mut seen, mut count) = (std::collections::BTreeSet::from([first]), 0);
        for other in changed(&all) {
            let Ok(config) = toml::from_str::<Config>(&toml::to_string(&other).unwrap()) else { continue };
            assert!(seen.insert(decided_by(&case(), &[], &config, &GIVEN).unwrap()), "{other}");
            count += 1;
        }
        assert!(count > 40, "{count}");
    }
}
