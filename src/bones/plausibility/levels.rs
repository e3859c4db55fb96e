//! Whether the names of vertebrae fit the landmarks that tell them: the skull sits on C1, C1 is a ring and C2 has the dens,
//! ribs meet the vertebrae of their numbers, the sacrum lies below L5.
//!
//! Distances are means over the part of a landmark that faces the spine. Of real scans the skull lay 4.5 mm from C1 and 17 mm
//! from C2, first ribs 4 to 12 mm from T1 and 11 to 32 mm from the next, the sacrum 7 mm from L5 and 29 mm from L4. In the
//! middle plane C1 had 0.3 of the bone that levels below have in front of the canal, C2 1.9.

use super::sides::level;
use crate::findings;
use crate::volume::LabelMap;
use crate::warning::Warning;
use nalgebra::{Point3, Vector3};
use std::collections::BTreeMap;

/// Points of a bone's surface that are looked at.
const MOST: usize = 800;
/// How far from the spine a landmark's points are looked at, mm.
const AROUND_MM: f64 = 45.0;
/// Points this much farther than the nearest one still face the spine, mm.
const FACING_MM: f64 = 6.0;
/// A landmark farther from its nearest vertebra than this tells nothing, mm.
/// In real scans the right vertebra lay within 13 mm.
const FAR_MM: f64 = 15.0;
/// So does one whose second vertebra is less than this much farther, mm.
const MARGIN_MM: f64 = 4.0;
/// Between L5 and the sacrum there is no room for more than this, mm.
/// Half way between L5 at 7 mm and L4 at 29 mm, as real scans have them.
const MOST_BELOW_L5_MM: f64 = 18.0;
/// A bone of fewer voxels has no form.
const LEAST: usize = 40;
/// Half of the slab about the middle plane, mm, and steps from front to back there.
const HALF_MM: f64 = 4.0;
const STEP_MM: f64 = 2.0;
/// Bone in front of the canal against the levels below: of a ring, and of a body with a dens.
/// In real scans the ring of C1 had 0.3, C2 with its dens 1.9.
const RING: f64 = 0.5;
const DENS: f64 = 1.35;
/// Levels above the trunk's: C1, C2 and T1, L5 by number, C1 = 0.
const T1: usize = 7;
const L5: usize = 23;

/// A bone as its label shows it, LPS mm.
#[derive(Default)]
struct Bone {
    /// Centres of its voxels, of a bone of the neck only: its form is looked at.
    points: Vec<Point3<f64>>,
    /// Centres of the voxels that face something else.
    surface: Vec<Point3<f64>>,
    /// Whether the scan ends in it.
    cut: bool,
}

/// The bones that this room looks at, by name.
struct Bones {
    by_name: BTreeMap<String, Bone>,
    /// Vertebrae from the top.
    spine: Vec<(usize, String)>,
    /// Longest edge of a voxel, mm.
    voxel: f64,
}

impl Bones {
    fn of(labels: &LabelMap) -> Self {
        let wanted = |name: &str| level(name).is_some() || name == "skull" || name == "sacrum" || rib(name).is_some();
        let grid = labels.volume.grid();
        let mut slots = vec![usize::MAX; usize::from(u16::MAX) + 1];
        let names: Vec<(&u16, &String)> = labels.names.iter().filter(|(_, name)| wanted(name)).collect();
        for (n, (label, _)) in names.iter().enumerate() {
            slots[usize::from(**label)] = n;
        }
        let mut found: Vec<Bone> = names.iter().map(|_| Bone::default()).collect();
        let solid: Vec<bool> = names.iter().map(|(_, name)| level(name).is_some_and(|l| l < T1)).collect();
        let data = labels.volume.data();
        for (n, &label) in data.iter().enumerate().filter(|(_, label)| **label != 0) {
            let slot = slots[usize::from(label)];
            let Some(bone) = found.get_mut(slot) else { continue };
            let voxel = grid.voxel(n);
            let edge = (0..3).any(|a| voxel[a] == 0 || voxel[a] + 1 == grid.size()[a]);
            bone.cut |= edge;
            if edge || grid.strides().iter().any(|s| data[n - s] != label || data[n + s] != label) {
                bone.surface.push(grid.centre(voxel));
            }
            if solid[slot] {
                bone.points.push(grid.centre(voxel));
            }
        }
        let by_name: BTreeMap<String, Bone> = names
            .into_iter()
            .zip(found)
            .filter(|(_, bone)| !bone.surface.is_empty())
            .map(|((_, name), bone)| (name.clone(), bone))
            .collect();
        let mut spine: Vec<(usize, String)> =
            by_name.keys().filter_map(|name| Some((level(name)?, name.clone()))).collect();
        spine.sort();
        Self { by_name, spine, voxel: grid.spacing().into_iter().fold(0.0, f64::max) }
    }

    /// Mean distance (mm) from the part of a landmark that faces the spine to each vertebra of these levels, nearest first.
    fn facing(&self, landmark: &Bone, levels: impl Fn(usize) -> bool) -> Vec<(f64, usize, &str)> {
        let near: Vec<(usize, &str, Vec<Point3<f64>>)> = self
            .spine
            .iter()
            .filter(|(level, _)| levels(*level))
            .map(|(level, name)| (*level, name.as_str(), thin(&self.by_name[name].surface)))
            .collect();
        let points: Vec<&Point3<f64>> = near.iter().flat_map(|(.., p)| p).collect();
        let start = [Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN)];
        let [low, high] = points.iter().fold(start, |[lo, hi], p| [lo.inf(&p.coords), hi.sup(&p.coords)]);
        let inside = |p: &&Point3<f64>| (0..3).all(|a| p[a] > low[a] - AROUND_MM && p[a] < high[a] + AROUND_MM);
        let own = thin(&landmark.surface.iter().filter(inside).copied().collect::<Vec<_>>());
        let apart: Vec<Vec<f64>> = own
            .iter()
            .map(|p| {
                let to = |(.., vertebra): &(usize, &str, Vec<Point3<f64>>)| {
                    vertebra.iter().map(|q| (q - p).norm_squared()).fold(f64::MAX, f64::min).sqrt()
                };
                near.iter().map(to).collect()
            })
            .collect();
        let least = |d: &Vec<f64>| d.iter().copied().fold(f64::MAX, f64::min);
        let nearest = apart.iter().map(least).fold(f64::MAX, f64::min);
        let facing: Vec<&Vec<f64>> = apart.iter().filter(|d| least(d) <= nearest + FACING_MM).collect();
        if facing.is_empty() {
            return Vec::new();
        }
        let mean = |n: usize| facing.iter().map(|d| d[n]).sum::<f64>() / facing.len() as f64;
        let mut all: Vec<(f64, usize, &str)> =
            near.iter().enumerate().map(|(n, (level, name, _))| (mean(n), *level, *name)).collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        all
    }

    /// The vertebra that a landmark meets without doubt.
    fn meets(&self, landmark: &Bone, levels: impl Fn(usize) -> bool) -> Option<(f64, usize, &str)> {
        let all = self.facing(landmark, levels);
        let next = all.get(1).map_or(f64::MAX, |second| second.0);
        all.into_iter().next().filter(|first| first.0 <= FAR_MM && next >= first.0 + MARGIN_MM)
    }

    fn skull(&self) -> Option<String> {
        let (mm, level, name) = self.meets(self.by_name.get("skull")?, |l| l < T1)?;
        // Where C1 has no label, C2 is the nearest one, but does not touch.
        let touches = self.by_name.contains_key("vertebrae_C1") || mm < 4.0 + self.voxel;
        (level > 0 && touches).then(|| format!("the skull sits on {name}, not on C1"))
    }

    fn sacrum(&self) -> Option<String> {
        let sacrum = self.by_name.get("sacrum")?;
        let all = self.facing(sacrum, |l| l >= T1);
        let &(mm, level, name) = all.first()?;
        let cut = self.by_name.get(name).is_none_or(|bone| bone.cut) || sacrum.cut && mm > MOST_BELOW_L5_MM;
        if level == L5 {
            let words = || format!("{name} lies {mm:.0} mm above the sacrum, with room for another level");
            return (mm > MOST_BELOW_L5_MM && !cut).then(words);
        }
        let touches = self.by_name.contains_key("vertebrae_L5") || mm < 7.0 + self.voxel;
        (mm <= FAR_MM && touches).then(|| format!("the sacrum lies below {name}, not below L5"))
    }

    /// First ribs decide where they meet a vertebra; else most of the other ribs.
    fn ribs(&self) -> Option<String> {
        let mut others: Vec<(i64, String)> = Vec::new();
        let mut told = 0;
        let has_t1 = self.by_name.contains_key("vertebrae_T1");
        for (name, bone) in &self.by_name {
            let Some(number) = rib(name) else { continue };
            let own = T1 + number - 1;
            if number == 1 {
                let met = self.meets(bone, |l| l + 3 > own && l < own + 4).filter(|_| has_t1);
                match met {
                    Some((_, level, _)) if level == T1 => return None,
                    Some((_, _, met)) => return Some(format!("{name} meets {met}, not T1")),
                    None => continue,
                }
            }
            let all = self.facing(bone, |l| l + 3 > own && l < own + 4);
            let Some(&(mm, level, met)) = all.first() else { continue };
            // Ribs 2 to 10 meet the vertebra of their number, the one above, or both.
            let single = number > 10;
            if mm > FAR_MM || single && self.meets(bone, |l| l + 3 > own && l < own + 4).is_none() {
                continue;
            }
            told += 1;
            let off = match level as i64 - own as i64 {
                0 => 0,
                -1 if !single => 0,
                off => off,
            };
            others.push((off.signum(), format!("{name} meets {met}")));
        }
        for way in [-1, 1] {
            let wrong: Vec<&str> = others.iter().filter(|o| o.0 == way).map(|o| o.1.as_str()).collect();
            if wrong.len() > 1 && 2 * wrong.len() > told {
                let shown = wrong.iter().take(3).copied().collect::<Vec<_>>().join(", ");
                return Some(format!(
                    "{} of {told} ribs do not meet the vertebra of their number: {shown}",
                    wrong.len()
                ));
            }
        }
        None
    }

    /// C1 and C2 by their form.
    fn form(&self) -> Vec<String> {
        let front: Vec<Option<f64>> = self.spine.iter().map(|(_, name)| self.front(name)).collect();
        let mut told = Vec::new();
        for (n, (level, name)) in self.spine.iter().enumerate().filter(|(_, (level, _))| *level < 4) {
            // The next level but one and those below it: the next may be C2, which is large.
            let mut below: Vec<f64> = front.iter().skip(n + 2).take(3).filter_map(|f| *f).collect();
            below.sort_by(f64::total_cmp);
            let (Some(own), 2..) = (front[n], below.len()) else { continue };
            let share = own / below[below.len() / 2];
            if share < RING && *level > 0 {
                told.push(format!("{name} has the form of C1, a ring without a body"));
            } else if share > DENS && *level != 1 {
                told.push(format!("{name} has the form of C2, a body with a dens"));
            }
        }
        told
    }

    /// Voxels in front of the canal about the middle plane; `None` where the scan ends in it.
    fn front(&self, name: &str) -> Option<f64> {
        let bone = self.by_name.get(name).filter(|b| !b.cut && b.points.len() >= LEAST)?;
        let mut across: Vec<f64> = bone.points.iter().map(|p| p.x).collect();
        let n = across.len() / 2;
        let middle = *across.select_nth_unstable_by(n, f64::total_cmp).1;
        let half = HALF_MM.max(0.6 * self.voxel);
        let slab: Vec<f64> = bone.points.iter().filter(|p| (p.x - middle).abs() <= half).map(|p| p.y).collect();
        let first = slab.iter().copied().fold(f64::MAX, f64::min);
        let step = STEP_MM.max(self.voxel);
        let mut heights = vec![0usize; 200];
        for y in &slab {
            if let Some(h) = heights.get_mut(((y - first) / step) as usize) {
                *h += 1;
            }
        }
        // From the front to the canal: until there is next to nothing after the most.
        let most = *heights.iter().max()?;
        let begun = heights.iter().position(|h| 3 * h > most)?;
        let ends = heights.iter().skip(begun).position(|h| 8 * h < most).map_or(heights.len(), |n| begun + n);
        Some(heights[..ends].iter().sum::<usize>() as f64)
    }
}

/// Number of a rib's name.
fn rib(name: &str) -> Option<usize> {
    let number = name.strip_prefix("rib_left_").or_else(|| name.strip_prefix("rib_right_"))?;
    number.parse().ok().filter(|n| (1..=12).contains(n))
}

fn thin(points: &[Point3<f64>]) -> Vec<Point3<f64>> {
    points.iter().step_by(points.len().div_ceil(MOST).max(1)).copied().collect()
}

/// A word about vertebrae whose names contradict a landmark.
pub fn levels_by_landmarks(labels: &LabelMap) -> Option<Warning> {
    let bones = Bones::of(labels);
    let told: Vec<String> =
        bones.skull().into_iter().chain(bones.form()).chain(bones.ribs()).chain(bones.sacrum()).collect();
    (!told.is_empty()).then(|| {
        let message = format!(
            "names of vertebrae may be off by a level: {}; count from C1 (a ring), C2 (the dens), the first rib (T1) or the \
             sacrum (below L5)",
            told.join("; ")
        );
        Warning::new(findings::LEVELS_SHIFTED, message)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use crate::volume::Volume;

    /// Vertebrae T9 to L5 as blocks of 24 mm, 30 mm from one to the next, with ribs 11 and 12 beside theirs and the sacrum
    /// below; names moved down by `by` levels.
    fn trunk(by: usize, ribs: bool) -> LabelMap {
        let grid = Grid::axis_aligned([40, 30, 90], [4.0; 3], [0.0; 3]).unwrap();
        let names = ["T9", "T10", "T11", "T12", "L1", "L2", "L3", "L4", "L5"];
        let volume = Volume::from_fn(grid.clone(), |n| {
            let at = grid.centre(grid.voxel(n));
            let (down, side) = (350.0 - at.z, (at.x - 80.0).abs());
            let row = (down / 30.0) as usize;
            let in_row = down >= 0.0 && down % 30.0 < 24.0;
            match row {
                _ if (at.y - 60.0).abs() > 20.0 => 0,
                0..9 if side < 14.0 && in_row => row as u16 + 1,
                9 if side < 30.0 => 10,
                2 | 3 if ribs && (17.0..60.0).contains(&side) && in_row && down % 30.0 < 10.0 => {
                    11 + 2 * (row as u16 - 2) + u16::from(at.x < 80.0)
                }
                _ => 0,
            }
        });
        let vertebrae = (1u16..).zip(names.iter().skip(by)).map(|(n, name)| (n, format!("vertebrae_{name}")));
        let rest = ["sacrum", "rib_left_11", "rib_right_11", "rib_left_12", "rib_right_12"];
        let rest = (10u16..).zip(rest).map(|(n, name)| (n, name.to_owned()));
        LabelMap { volume, names: vertebrae.chain(rest).collect() }
    }

    #[test]
    fn ribs_and_sacrum_tell_names_that_are_off_by_a_level() {
        assert_eq!(levels_by_landmarks(&trunk(0, true)), None);
        let word = levels_by_landmarks(&trunk(1, true)).unwrap();
        assert!(
            word.message.contains("rib_left_12 meets vertebrae_L1") && word.is(findings::LEVELS_SHIFTED),
            "{word:?}"
        );
        assert!(word.message.contains("vertebrae_L5 lies") && word.message.contains("above the sacrum"), "{word:?}");
        let word = levels_by_landmarks(&trunk(1, false)).unwrap();
        assert!(!word.message.contains("rib_left"), "{word:?}");
        // The other way: what is L5 is called L4.
        let mut up = trunk(0, false);
        let name = |n: u16| up.names.get(&(n - 1)).cloned();
        let names = (2u16..=9).filter_map(|n| Some((n, name(n)?))).chain([(10, "sacrum".to_owned())]).collect();
        up.names = names;
        let word = levels_by_landmarks(&up).unwrap();
        assert!(word.message.contains("the sacrum lies below vertebrae_L4"), "{word:?}");
    }

    #[test]
    fn bones_that_are_cut_or_missing_tell_nothing() {
        let mut labels = trunk(1, false);
        labels.names.remove(&10);
        assert_eq!(levels_by_landmarks(&labels), None);
        labels.names.clear();
        assert_eq!(levels_by_landmarks(&labels), None);
    }
}
