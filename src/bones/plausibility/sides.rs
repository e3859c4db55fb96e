//! Whether bones lie on the sides that their names say: left on the patient's left, front before back, head above foot,
//! vertebrae in their order and without gaps.

use crate::error::{Error, Result};
use crate::findings;
use crate::volume::LabelMap;
use crate::warning::Warning;
use nalgebra::Vector3;

/// Centres closer along an axis than this, mm, tell nothing of it.
const LEAST_MM: f64 = 8.0;
/// A level that lies this much farther from the next one than its neighbours do leaves room for another.
/// Where a level is missing, the next one lies about twice as far.
const GAP: f64 = 1.6;

/// Bones by name with the mean of their voxels, LPS mm.
struct Centres(Vec<(String, Vector3<f64>)>);

impl Centres {
    fn of(labels: &LabelMap) -> Self {
        let grid = labels.volume.grid();
        let mut sums = vec![([0u64; 3], 0u64); usize::from(u16::MAX) + 1];
        for (n, &label) in labels.volume.data().iter().enumerate().filter(|(_, label)| **label != 0) {
            let (sum, count) = &mut sums[usize::from(label)];
            let at = grid.voxel(n);
            (0..3).for_each(|a| sum[a] += at[a] as u64);
            *count += 1;
        }
        let centre = |(label, name): (&u16, &String)| {
            let (sum, count) = sums[usize::from(*label)];
            (count > 0).then(|| {
                let index = Vector3::from(sum.map(|s| s as f64 / count as f64));
                (name.clone(), grid.origin().coords + grid.step() * index)
            })
        };
        Self(labels.names.iter().filter_map(centre).collect())
    }

    fn get(&self, name: &str) -> Option<&Vector3<f64>> {
        self.0.iter().find(|(n, _)| n == name).map(|(_, c)| c)
    }

    /// Mean of the bones whose names begin so.
    fn mean(&self, begins: &[&str]) -> Option<Vector3<f64>> {
        let all: Vec<&Vector3<f64>> =
            self.0.iter().filter(|(name, _)| begins.iter().any(|b| name.starts_with(b))).map(|(_, c)| c).collect();
        (!all.is_empty()).then(|| all.iter().copied().sum::<Vector3<f64>>() / all.len() as f64)
    }
}

/// A relation that holds in every patient: its words, and by how far, mm; negative where it is the other way round.
type Relation = (String, f64);

fn left_right(centres: &Centres) -> Vec<Relation> {
    let lefts = centres.0.iter().filter_map(|(name, left)| {
        let other = name.contains("_left").then(|| name.replace("_left", "_right"))?;
        Some((format!("{name} against {other}"), left.x - centres.get(&other)?.x))
    });
    lefts.collect()
}

fn front_back(centres: &Centres) -> Vec<Relation> {
    let before = |front: &str, back: &[&str], words: &str| {
        Some((words.to_owned(), centres.mean(back)?.y - centres.get(front)?.y))
    };
    let upper = ["vertebrae_C2", "vertebrae_C3", "vertebrae_C4"];
    [
        before("mandible", &upper, "mandible against the upper cervical spine"),
        before("hyoid", &["vertebrae_C"], "hyoid against the cervical spine"),
        before("sternum", &["vertebrae_T"], "sternum against the thoracic spine"),
        before("hip_left", &["sacrum"], "left hip against the sacrum"),
        before("hip_right", &["sacrum"], "right hip against the sacrum"),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// Place of a vertebra's name in the spine, C1 = 0.
pub(super) fn level(name: &str) -> Option<usize> {
    let rest = name.strip_prefix("vertebrae_")?;
    let number: usize = rest.get(1..)?.parse().ok()?;
    match rest.as_bytes().first()? {
        b'C' if (1..=7).contains(&number) => Some(number - 1),
        b'T' if (1..=12).contains(&number) => Some(number + 6),
        b'L' if (1..=5).contains(&number) => Some(number + 18),
        _ => None,
    }
}

fn head_foot(centres: &Centres) -> Vec<Relation> {
    let mut spine: Vec<(usize, &Vector3<f64>)> =
        centres.0.iter().filter_map(|(name, c)| Some((level(name)?, c))).collect();
    spine.sort_by_key(|(level, _)| *level);
    let mut found: Vec<Relation> = Vec::new();
    if let (Some(first), Some(last)) = (spine.first(), spine.last())
        && first.0 < last.0
    {
        found.push(("the first vertebra against the last".into(), first.1.z - last.1.z));
    }
    let above = |upper: &str, lower: &[&str], words: &str| {
        Some((words.to_owned(), centres.get(upper)?.z - centres.mean(lower)?.z))
    };
    found.extend(above("skull", &["vertebrae_C"], "skull against the cervical spine"));
    found.extend(above("vertebrae_L1", &["sacrum"], "L1 against the sacrum"));
    found
}

/// Judges the places of bones by their names.
///
/// # Errors
/// [`Error::Input`] where most relations of an axis are the other way round; warnings where a few are, and of vertebrae
/// that are missing between others.
pub fn sides_and_levels(labels: &LabelMap) -> Result<Vec<Warning>> {
    let centres = Centres::of(labels);
    let mut warnings = Vec::new();
    let axes = [
        ("left and right", left_right(&centres)),
        ("front and back", front_back(&centres)),
        ("head and foot", head_foot(&centres)),
    ];
    for (axis, relations) in axes {
        let telling: Vec<&Relation> = relations.iter().filter(|(_, mm)| mm.abs() > LEAST_MM).collect();
        let wrong: Vec<&str> = telling.iter().filter(|(_, mm)| *mm < 0.0).map(|(words, _)| words.as_str()).collect();
        if 2 * wrong.len() > telling.len() {
            return Err(Error::refused(
                findings::LABELS_MIRRORED,
                "bone labels",
                format!(
                    "{axis} are exchanged, by {} of {} relations: {}",
                    wrong.len(),
                    telling.len(),
                    wrong.join("; ")
                ),
                "names, voxel order or header of the labels are wrong (of the planning CT too, where they lie on its bones): \
                 write both anew from the DICOM series, and check the side of a known structure",
            ));
        }
        if !wrong.is_empty() {
            let message = format!("{axis} are exchanged for {}: check these labels", wrong.join("; "));
            warnings.push(Warning::new(findings::LABEL_ON_WRONG_SIDE, message));
        }
    }
    warnings.extend(gaps(&centres));
    Ok(warnings)
}

/// Vertebrae that are missing between others.
fn gaps(centres: &Centres) -> Option<Warning> {
    let mut spine: Vec<(usize, &str, &Vector3<f64>)> =
        centres.0.iter().filter_map(|(name, c)| Some((level(name)?, name.as_str(), c))).collect();
    spine.sort_by_key(|(level, ..)| *level);
    let missing = |pair: &[(usize, &str, &Vector3<f64>)]| pair[1].0 - pair[0].0 > 1;
    let names: Vec<String> =
        spine.windows(2).filter(|p| missing(p)).map(|p| format!("between {} and {}", p[0].1, p[1].1)).collect();
    let steps = |pair: &[(usize, &str, &Vector3<f64>)]| (pair[1].2 - pair[0].2).norm();
    let mut wide: Vec<String> = Vec::new();
    for around in spine.windows(4).filter(|w| w.windows(2).all(|p| !missing(p))) {
        let [before, here, after] = [steps(&around[..2]), steps(&around[1..3]), steps(&around[2..])];
        if here > GAP * before.max(after) {
            wide.push(format!(
                "{} and {} lie {here:.0} mm apart, their neighbours {before:.0} and {after:.0}",
                around[1].1, around[2].1
            ));
        }
    }
    let all = [
        (!names.is_empty()).then(|| format!("no vertebra is labelled {}", names.join(", "))),
        (!wide.is_empty())
            .then(|| format!("{}: a level may be missing there, and names below it off by one", wide.join("; "))),
    ];
    let told: Vec<String> = all.into_iter().flatten().collect();
    (!told.is_empty())
        .then(|| Warning::new(findings::VERTEBRA_MISSING, format!("{}; check the numbering", told.join("; "))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use crate::volume::Volume;

    /// One voxel of 10 mm for each bone: (name, LPS cm).
    fn labels(bones: &[(&str, [usize; 3])]) -> LabelMap {
        let grid = Grid::axis_aligned([20, 20, 40], [10.0; 3], [-100.0, -100.0, 0.0]).unwrap();
        let mut volume = Volume::filled(grid.clone(), 0u16);
        for (n, (_, at)) in bones.iter().enumerate() {
            volume.data_mut()[grid.linear(*at)] = n as u16 + 1;
        }
        let names = bones.iter().enumerate().map(|(n, (name, _))| (n as u16 + 1, (*name).to_owned())).collect();
        LabelMap { volume, names }
    }

    const BONES: [(&str, [usize; 3]); 9] = [
        ("skull", [10, 8, 30]),
        ("mandible", [10, 4, 27]),
        ("vertebrae_C2", [10, 11, 27]),
        ("vertebrae_C3", [10, 11, 25]),
        ("vertebrae_C4", [10, 11, 23]),
        ("vertebrae_C5", [10, 11, 21]),
        ("hyoid", [10, 6, 23]),
        ("clavicula_left", [14, 6, 18]),
        ("clavicula_right", [6, 6, 18]),
    ];

    fn mapped(map: impl Fn([usize; 3]) -> [usize; 3]) -> Vec<(&'static str, [usize; 3])> {
        BONES.iter().map(|(name, at)| (*name, map(*at))).collect()
    }

    #[test]
    fn a_patient_passes_and_his_mirror_images_are_refused() {
        assert!(sides_and_levels(&labels(&BONES)).unwrap().is_empty());
        type Map = fn([usize; 3]) -> [usize; 3];
        let mirrors: [(Map, &str); 3] = [
            (|[i, j, k]| [19 - i, j, k], "left and right"),
            (|[i, j, k]| [i, 19 - j, k], "front and back"),
            (|[i, j, k]| [i, j, 39 - k], "head and foot"),
        ];
        for (map, word) in mirrors {
            let error = sides_and_levels(&labels(&mapped(map))).unwrap_err();
            assert_eq!((error.exit_code(), error.code()), (4, "labels-mirrored"));
            assert!(error.to_string().contains(word), "{error}");
        }
    }

    #[test]
    fn single_bones_on_the_wrong_side_and_missing_levels_are_named() {
        let mut bones = BONES.to_vec();
        bones.extend([
            ("scapula_left", [4, 14, 18]),
            ("scapula_right", [16, 14, 18]),
            ("rib_left_1", [13, 9, 17]),
            ("rib_right_1", [7, 9, 17]),
        ]);
        let warnings = sides_and_levels(&labels(&bones)).unwrap();
        assert!(warnings.len() == 1 && warnings[0].message.contains("scapula_left"), "{warnings:?}");
        let gap: Vec<_> = BONES.iter().copied().filter(|(name, _)| *name != "vertebrae_C4").collect();
        assert_eq!(sides_and_levels(&labels(&gap)).unwrap()[0].code, "vertebra-missing");
        let wide: Vec<_> = mapped(|[i, j, k]| [i, j, if k <= 23 { k - 3 } else { k }]);
        assert!(sides_and_levels(&labels(&wide)).unwrap()[0].message.contains("off by one"));
    }
}
