//! Whether bone labels lie on the bones of their CT.
//!
//! Under a bone's label the CT is denser than a few millimetres beside it. Of 6 real scans the middle bone's contrast was 190 to
//! 490 HU and the least bone's 127; with labels 12 mm aside the middle one's was below 80, mirrored below 50.

use crate::error::{Error, Result};
use crate::findings;
use crate::skeleton::Skeleton;
use crate::volume::{LabelMap, Volume};
use crate::warning::Warning;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Less contrast than this between a bone and what lies beside it is doubtful, HU.
/// The middle bone of right labels has 193 and more, that of labels 12 mm aside less than 80.
const LEAST_CONTRAST: f32 = 80.0;
/// So is a bone of which more than this share is air.
const MOST_AIR: f64 = 0.25;
const AIR_HU: f32 = -200.0;
/// Doubtful bones beyond this share, by number or by volume: the labels belong elsewhere.
const MOST_DOUBTFUL: f64 = 0.5;
/// How far beside a bone is looked, mm.
const BESIDE_MM: f64 = 5.0;
/// Voxels that stand for a bone, and for all bones where another place is looked for.
const MOST: usize = 4000;
const SCOUTS: usize = 3000;
/// Labels with fewer voxels in all tell nothing.
const LEAST: usize = 8;
/// Density for the search of another place, HU.
const CLAMP: [f32; 2] = [-100.0, 600.0];
/// Steps of that search, mm, and how far it goes.
const STEP_MM: f64 = 6.0;
const STEPS: i32 = 7;
/// A place is better where the labels hold so much more density than where they are.
const BETTER: f64 = 1.3;
/// Another place near by is looked for where labels next to theirs would hold more than this much of the density.
const BESIDE_BETTER: f64 = 1.02;

/// What one bone's label holds.
struct Contrast {
    voxels: usize,
    /// Median HU inside, and beside where that is seen.
    inside: f32,
    beside: Option<f32>,
    /// Share of air inside.
    air: f64,
}

impl Contrast {
    fn doubtful(&self) -> bool {
        self.voxels >= LEAST
            && (self.beside.is_some_and(|beside| self.inside - beside < LEAST_CONTRAST) || self.air > MOST_AIR)
    }
}

/// Judges bone labels on the grid of their CT (HU).
///
/// # Errors
/// [`Error::Input`] where they miss the bones; warnings name bones that are doubtful.
pub fn labels_on_bone(skeleton: &Skeleton, planning: &Volume<f32>, labels: &LabelMap) -> Result<Vec<Warning>> {
    let voxels_of = voxels_of(skeleton, labels);
    let contrasts = contrasts(&voxels_of, planning, labels);
    let told: Vec<usize> = (0..contrasts.len()).filter(|&b| contrasts[b].voxels >= LEAST).collect();
    let doubtful: Vec<usize> = told.iter().copied().filter(|&b| contrasts[b].doubtful()).collect();
    let voxels = |list: &[usize]| list.iter().map(|&b| contrasts[b].voxels).sum::<usize>() as f64;
    let share = (doubtful.len() as f64 / told.len().max(1) as f64).max(voxels(&doubtful) / voxels(&told).max(1.0));
    let elsewhere = Elsewhere::new(&voxels_of, planning);
    let near = elsewhere.as_ref().is_some_and(Elsewhere::near_is_better);
    if share <= MOST_DOUBTFUL && !near {
        return Ok(doubtful.iter().map(|&b| one(&skeleton.bones[b].name, &contrasts[b])).collect());
    }
    let better = elsewhere.and_then(|e| e.better());
    if share <= MOST_DOUBTFUL && better.is_none() {
        return Ok(doubtful.iter().map(|&b| one(&skeleton.bones[b].name, &contrasts[b])).collect());
    }
    let mut inside: Vec<f32> = told.iter().map(|&b| contrasts[b].inside).collect();
    inside.sort_by(f32::total_cmp);
    let middle = inside.get(inside.len() / 2).copied().unwrap_or(f32::NAN);
    let air = told.iter().map(|&b| contrasts[b].air * contrasts[b].voxels as f64).sum::<f64>() / voxels(&told).max(1.0);
    let place = better.map_or(String::new(), |place| format!("; {place} they would lie on bone"));
    Err(Error::refused(
        findings::LABELS_OFF_BONE,
        "bone labels",
        format!(
            "they do not lie on the bones of the planning CT: {} of {} bones stand out by less than {LEAST_CONTRAST} HU from \
             what is beside them, the middle one has {middle:.0} HU, {:.0} % of the labels is air{place}",
            doubtful.len(),
            told.len(),
            100.0 * air
        ),
        "give the labels of this planning CT on its grid and orientation; where planning and fraction CT were exchanged, \
         exchange them back; look at labels and CT in one viewer",
    ))
}

fn one(name: &str, c: &Contrast) -> Warning {
    let beside = c.beside.map_or(String::new(), |b| format!(", {b:.0} HU beside it"));
    Warning::new(
        findings::LABEL_DOUBTFUL,
        format!(
            "{name}: its label may miss the bone: {:.0} HU under it{beside}, {:.0} % air; look at it in a viewer",
            c.inside,
            100.0 * c.air
        ),
    )
}

/// Storage positions of every bone's voxels, bones in the order of the skeleton.
fn voxels_of(skeleton: &Skeleton, labels: &LabelMap) -> Vec<Vec<u32>> {
    let mut of_label = vec![usize::MAX; usize::from(u16::MAX) + 1];
    for (b, bone) in skeleton.bones.iter().enumerate() {
        of_label[usize::from(bone.label)] = b;
    }
    let mut found = vec![Vec::new(); skeleton.bones.len()];
    for (n, &label) in labels.volume.data().iter().enumerate().filter(|(_, label)| **label != 0) {
        if let Some(list) = found.get_mut(of_label[usize::from(label)]) {
            list.push(n as u32);
        }
    }
    found
}

fn contrasts(voxels: &[Vec<u32>], planning: &Volume<f32>, labels: &LabelMap) -> Vec<Contrast> {
    let (grid, hu, label) = (planning.grid(), planning.data(), labels.volume.data());
    let (size, strides) = (grid.size(), grid.strides());
    let far = grid.spacing().map(|s| (BESIDE_MM / s).round().max(1.0) as usize);
    let of_bone = |voxels: &Vec<u32>| {
        let every = voxels.len().div_ceil(MOST).max(1);
        let (mut inside, mut beside) = (Vec::new(), Vec::new());
        for &n in voxels.iter().step_by(every) {
            let n = n as usize;
            inside.push(hu[n]);
            let at = grid.voxel(n);
            for a in 0..3 {
                let step = far[a] * strides[a];
                let low = (at[a] >= far[a]).then(|| n - step);
                let high = (at[a] + far[a] < size[a]).then(|| n + step);
                beside.extend([low, high].into_iter().flatten().filter(|&m| label[m] == 0).map(|m| hu[m]));
            }
        }
        let air = inside.iter().filter(|v| **v < AIR_HU).count() as f64 / inside.len().max(1) as f64;
        Contrast {
            voxels: voxels.len(),
            inside: median(&mut inside).unwrap_or(f32::NAN),
            beside: median(&mut beside),
            air,
        }
    };
    voxels.par_iter().map(of_bone).collect()
}

fn median(values: &mut [f32]) -> Option<f32> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// Density that the labels would hold elsewhere.
struct Elsewhere<'a> {
    planning: &'a Volume<f32>,
    voxels: Vec<[usize; 3]>,
    here: f64,
}

impl<'a> Elsewhere<'a> {
    fn new(voxels: &[Vec<u32>], planning: &'a Volume<f32>) -> Option<Self> {
        let all: Vec<u32> = voxels.concat();
        let every = all.len().div_ceil(SCOUTS).max(1);
        let grid = planning.grid();
        let voxels: Vec<[usize; 3]> = all.iter().step_by(every).map(|&n| grid.voxel(n as usize)).collect();
        let mut found = Self { planning, voxels, here: 0.0 };
        found.here = found.shifted(&Vector3::zeros())?;
        Some(found)
    }

    /// Mean density above the least at voxels mapped by `to`; `None` where few of them are in the scan.
    fn density(&self, to: impl Fn(&[usize; 3]) -> Option<[usize; 3]>) -> Option<f64> {
        let seen: Vec<f64> = self
            .voxels
            .iter()
            .filter_map(&to)
            .map(|at| f64::from(self.planning.at(at).clamp(CLAMP[0], CLAMP[1]) - CLAMP[0]))
            .collect();
        (2 * seen.len() > self.voxels.len()).then(|| seen.iter().sum::<f64>() / seen.len() as f64)
    }

    fn shifted(&self, mm: &Vector3<f64>) -> Option<f64> {
        let grid = self.planning.grid();
        let step = grid.index(&Point3::from(grid.origin().coords + mm)).map(f64::round);
        let size = grid.size();
        self.density(|at| {
            let moved: [f64; 3] = std::array::from_fn(|a| at[a] as f64 + step[a]);
            (0..3).all(|a| moved[a] >= 0.0 && moved[a] < size[a] as f64).then(|| moved.map(|v| v as usize))
        })
    }

    /// Whether labels one step aside would hold more.
    fn near_is_better(&self) -> bool {
        let beside =
            (0..27).map(|n| Vector3::new(n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1).map(|v: i32| f64::from(v) * STEP_MM));
        let aside = beside.filter(|mm| mm.norm() > 0.0).filter_map(|mm| self.shifted(&mm));
        aside.fold(0.0, f64::max) > BESIDE_BETTER * self.here
    }

    /// Where the labels would lie on bone, in words.
    fn better(&self) -> Option<String> {
        let steps: Vec<Vector3<f64>> = (-STEPS..=STEPS)
            .flat_map(|k| (-STEPS..=STEPS).map(move |j| (j, k)))
            .flat_map(|(j, k)| (-STEPS..=STEPS).map(move |i| Vector3::new(i, j, k).map(f64::from) * STEP_MM))
            .collect();
        let scored: Vec<(f64, Vector3<f64>)> =
            steps.into_par_iter().filter_map(|mm| Some((self.shifted(&mm)?, mm))).collect();
        let shift = scored.into_iter().max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.norm().total_cmp(&a.1.norm())))?;
        let size = self.planning.grid().size();
        let flipped = (1..8usize).filter_map(|axes| {
            let flip = |at: &[usize; 3]| {
                Some(std::array::from_fn(|a| if axes >> a & 1 == 1 { size[a] - 1 - at[a] } else { at[a] }))
            };
            Some((self.density(flip)?, axes))
        });
        let flipped = flipped.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
        if let Some((density, axes)) = flipped
            && density > shift.0.max(BETTER * self.here)
        {
            let names: Vec<&str> = ["first", "second", "third"]
                .into_iter()
                .enumerate()
                .filter(|(a, _)| axes >> a & 1 == 1)
                .map(|(_, n)| n)
                .collect();
            return Some(format!("with the order of voxels reversed along the {} axis", names.join(" and ")));
        }
        let [x, y, z] = shift.1.into();
        (shift.0 > BETTER * self.here && shift.1.norm() > 0.0)
            .then(|| format!("moved by about ({x:.0}, {y:.0}, {z:.0}) mm (LPS)"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use crate::skeleton::{self};

    /// A row of vertebrae in tissue with air around, and the same labels moved.
    fn scene(moved: [i64; 3], reversed: bool) -> (Volume<f32>, LabelMap) {
        let grid = Grid::axis_aligned([60, 60, 60], [2.0; 3], [-60.0, -60.0, 0.0]).unwrap();
        let bone = |[i, j, k]: [i64; 3]| {
            let level = (k - 6) / 12;
            let inside = (25..35).contains(&i) && (35..45).contains(&j) && k >= 6 && (k - 6) % 12 < 9 && level < 4;
            inside.then_some(level as u16 + 1)
        };
        let at = |n: usize| grid.voxel(n).map(|v| v as i64);
        let ct = Volume::from_fn(grid.clone(), |n| {
            let [i, j, _] = at(n);
            match bone(at(n)) {
                Some(_) => 350.0,
                None if (i - 30).pow(2) + (j - 30).pow(2) < 600 => 40.0,
                None => -1000.0,
            }
        });
        let labels = Volume::from_fn(grid.clone(), |n| {
            let mut at: [i64; 3] = std::array::from_fn(|a| at(n)[a] - moved[a]);
            if reversed {
                at[1] = 59 - at[1];
            }
            bone(at).unwrap_or(0)
        });
        let names = (1..=4).map(|n| (n, format!("vertebrae_L{}", 5 - n))).collect();
        (ct, LabelMap { volume: labels, names })
    }

    #[test]
    fn labels_that_miss_the_bone_are_refused_with_the_place_where_they_belong() {
        let judge = |moved, reversed| {
            let (ct, labels) = scene(moved, reversed);
            labels_on_bone(&skeleton::build(&labels).unwrap().skeleton, &ct, &labels)
        };
        assert!(judge([0, 0, 0], false).unwrap().is_empty());
        assert!(judge([1, 0, 1], false).unwrap().is_empty());
        for (moved, reversed, word) in [
            ([6, 0, 0], false, "moved by about (-12, 0, 0) mm"),
            ([0, -15, 0], false, "moved by about (0, 30, 0) mm"),
            ([0, 0, 0], true, "reversed along the second axis"),
        ] {
            let error = judge(moved, reversed).unwrap_err();
            assert_eq!((error.exit_code(), error.code()), (4, "labels-off-bone"));
            assert!(error.to_string().contains(word), "{error}");
        }
    }
}
