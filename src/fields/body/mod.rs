//! Rank 3: the patient in a CT. Couch, headrest, clamps and a mask that touches the skin are not patient.
//!
//! The variants that were measured are in `docs/decisions/patient.md`.

mod coarse;
mod fill;
mod lung;
pub mod mr;

pub use lung::{SLIDING_ORGANS, lung, organs_labelled, slides};

use crate::error::{Error, Result};
use crate::volume::components::{Components, Connectivity};
use crate::volume::distance::squared_distance;
use crate::volume::morphology::{dilate, erode};
use crate::volume::{LabelMap, Mask, Volume};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// How to find the patient.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BodyOptions {
    /// What is denser than this is solid: patient or device. HU.
    pub threshold_hu: f64,
    /// Solid that a ball of this radius does not fit into is cut off: mask sheets, couch shells. mm.
    pub opening_mm: f64,
    /// Solids whose cores are apart after erosion by this radius are different things, and touch only. mm.
    pub separation_mm: f64,
    /// Outside air does not enter the patient through openings narrower than twice this (nostrils, ears). mm.
    pub closing_mm: f64,
}

impl Default for BodyOptions {
    fn default() -> Self {
        Self { threshold_hu: -350.0, opening_mm: 4.0, separation_mm: 8.0, closing_mm: 5.0 }
    }
}

/// Soft tissue, HU.
const SOFT: std::ops::Range<f32> = -200.0..200.0;
/// Denser than any couch plastic, HU.
const BONE: f32 = 250.0;
/// Cores smaller than this tell nothing, mm^3.
const SMALLEST_CORE: f64 = 1000.0;
/// A limb apart from the trunk has at least this core, mm^3, ...
const SMALLEST_LIMB: f64 = 20_000.0;
/// ... this share of soft tissue in it ...
const LIMB_SOFT: f64 = 0.5;
/// ... and this share of bone.
const LIMB_BONE: f64 = 0.03;

/// The patient in a CT (HU), with airway and other cavities filled. Same grid as `ct`.
///
/// The patient is the solid that holds the labelled voxels of `labels` (any grid), without labels the one with
/// most soft tissue, and solids apart from it that look like a limb: soft tissue around bone. The image's edge
/// is not skin: a shoulder or neck that leaves the field of view ends there without rounding. No direction of
/// the world or the grid is preferred. In voxels finer than 0.75 mm all but the skin is found on voxels of 1.5 mm.
///
/// # Errors
/// When nothing in the CT is thick enough to be a patient.
pub fn find(ct: &Volume<f32>, labels: Option<&LabelMap>, options: &BodyOptions) -> Result<Mask> {
    let Some(grid) = coarse::grid(ct.grid()) else { return found(ct, labels, options) };
    let coarsely = found(&coarse::means(ct, &grid), labels, options)?;
    let (hint, threshold) = (Hint::new(ct, labels), options.threshold_hu as f32);
    Ok(coarse::refined(&coarsely, ct.grid(), |l| ct.data()[l] > threshold || hint.labelled(l)))
}

/// The patient in the voxels of the CT as they are.
fn found(ct: &Volume<f32>, labels: Option<&LabelMap>, options: &BodyOptions) -> Result<Mask> {
    let threshold = options.threshold_hu as f32;
    let solid = ct.map(|&hu| hu > threshold);
    // A ball smaller than a voxel would cut nothing.
    let finest = 1.01 * ct.grid().spacing().into_iter().fold(f64::INFINITY, f64::min);
    let opening = options.opening_mm.max(finest);
    let separation = options.separation_mm.max(opening);

    let hint = Hint::new(ct, labels);
    let (patient, device) = sort_cores(ct, &hint, &erode(&solid, separation)).ok_or_else(|| {
        Error::input(
            "CT",
            format!("no patient: nothing above {threshold} HU holds a ball of {separation} mm radius"),
            "check that the image is a CT in HU (rescale slope and intercept), or lower body.threshold_hu",
        )
    })?;
    let core = claim(erode(&solid, opening), &patient, &device);
    let near = dilate(&core, opening);
    let body = Volume::from_fn(near.grid().clone(), |l| near.data()[l] && solid.data()[l] || hint.labelled(l));
    Ok(fill::cavities(&lung::with_lungs(ct, body), options.closing_mm))
}

/// Labelled voxels on the CT's grid.
struct Hint<'a> {
    ct: &'a Volume<f32>,
    labels: Option<&'a LabelMap>,
    same_grid: bool,
}

impl<'a> Hint<'a> {
    fn new(ct: &'a Volume<f32>, labels: Option<&'a LabelMap>) -> Self {
        let same_grid = labels.is_some_and(|l| l.volume.grid().matches(ct.grid(), 1e-3));
        Self { ct, labels, same_grid }
    }

    /// Whether the voxel at this storage position of the CT is labelled.
    fn labelled(&self, linear: usize) -> bool {
        let Some(labels) = self.labels else { return false };
        if self.same_grid {
            return labels.volume.data()[linear] != 0;
        }
        let grid = self.ct.grid();
        let index: Vector3<f64> = labels.volume.grid().index(&grid.centre(grid.voxel(linear)));
        let size = labels.volume.grid().size();
        let near = index.map(|c| (c + 0.5).floor());
        (0..3).all(|a| near[a] >= 0.0 && near[a] < size[a] as f64)
            && *labels.volume.at([near.x as usize, near.y as usize, near.z as usize]) != 0
    }
}

/// What a core is made of, in voxels.
#[derive(Debug, Clone, Copy, Default)]
struct BodyContent {
    labelled: usize,
    soft: usize,
    bone: usize,
}

/// Sorts the connected cores into patient and device; `None` without any core.
fn sort_cores(ct: &Volume<f32>, hint: &Hint, cores: &Mask) -> Option<(Mask, Mask)> {
    let parts = Components::of(cores, false, Connectivity::Face);
    let mut content = vec![BodyContent::default(); parts.len()];
    for run in &parts.runs {
        let c = &mut content[run.component];
        for l in run.start..run.end {
            let hu = ct.data()[l];
            c.labelled += usize::from(hint.labelled(l));
            c.soft += usize::from(SOFT.contains(&hu));
            c.bone += usize::from(hu > BONE);
        }
    }
    let main = (0..parts.len()).rev().max_by_key(|&n| (content[n].labelled, content[n].soft))?;
    let voxel = ct.grid().voxel_volume();
    let limb = |n: usize| {
        let (c, all) = (content[n], parts.sizes[n] as f64);
        all * voxel >= SMALLEST_LIMB && c.soft as f64 >= LIMB_SOFT * all && c.bone as f64 >= LIMB_BONE * all
    };
    let is_patient = |n: usize| n == main || content[n].labelled > 0 || limb(n);
    let is_device = |n: usize| !is_patient(n) && parts.sizes[n] as f64 * voxel >= SMALLEST_CORE;
    Some((parts.select(cores, is_patient), parts.select(cores, is_device)))
}

/// The parts of `solid` that hang together with the patient's cores. Where device cores hang on them too, each
/// voxel goes to the nearer core.
fn claim(mut solid: Mask, patient: &Mask, device: &Mask) -> Mask {
    let touches = |parts: &Components<bool>, cores: &Mask| {
        let mut out = vec![false; parts.len()];
        for run in &parts.runs {
            out[run.component] |= cores.data()[run.start..run.end].contains(&true);
        }
        out
    };
    let mut parts = Components::of(&solid, false, Connectivity::Face);
    let contested = touches(&parts, patient).iter().zip(touches(&parts, device)).any(|(&p, d)| p && d);
    if contested {
        let (to_patient, to_device) = (squared_distance(patient, true), squared_distance(device, true));
        for ((s, p), d) in solid.data_mut().iter_mut().zip(to_patient.data()).zip(to_device.data()) {
            *s &= p <= d;
        }
        parts = Components::of(&solid, false, Connectivity::Face);
    }
    let keep = touches(&parts, patient);
    parts.select(&solid, |n| keep[n])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use nalgebra::{Matrix3, Point3};
    use std::collections::BTreeMap;

    /// A torso that the lower and lateral edges of the image cut, lying on a couch (shell, foam, rails) in a
    /// mask that touches the skin in front. HU at a world position, and whether it is patient.
    fn scene(p: &Point3<f64>) -> (f32, bool) {
        let (x, y, z) = (p.x, p.y, p.z);
        // Neck and head along z, shoulders along x below z = -20.
        let neck = |grow: f64| (x / (50.0 + grow)).powi(2) + (y / (36.0 + grow)).powi(2) < 1.0 && z < 44.0 + grow;
        let shoulder = z < -20.0 && y.abs() < 30.0;
        let trachea = x.hypot(y + 15.0) < 8.0 && z < 30.0;
        // A nostril: a channel of 3 mm radius from the trachea's upper part to the front.
        let nostril = x.hypot(z - 20.0) < 3.0 && y < -15.0;
        if neck(0.0) || shoulder {
            let bone = x.hypot(y - 15.0) < 7.0;
            return (
                if trachea || nostril {
                    -1000.0
                } else if bone {
                    700.0
                } else {
                    20.0
                },
                true,
            );
        }
        let shell = (36.0..39.0).contains(&y) || (57.0..60.0).contains(&y);
        let rail = (39.0..57.0).contains(&y) && (x.abs() - 30.0).abs() < 11.0;
        // The mask stands off by 3 mm, but for a strip along the front.
        let mask = z > -18.0 && y < 0.0 && if x.abs() < 8.0 { neck(3.0) } else { neck(6.0) && !neck(3.0) };
        let foam = (39.0..57.0).contains(&y);
        let hu = if rail {
            80.0
        } else if shell || mask {
            -150.0
        } else if foam {
            -900.0
        } else {
            -1000.0
        };
        (hu, false)
    }

    #[test]
    fn fine_voxels_show_the_same_patient() {
        let of = |spacing: f64| {
            let size = [70.0, 64.0, 50.0].map(|n| (2.0 * n / spacing) as usize);
            let grid = Grid::axis_aligned(size, [spacing; 3], [-69.0, -63.0, -49.0]).unwrap();
            find(&ct(&grid), None, &BodyOptions::default()).unwrap()
        };
        let (whole, fine) = (of(1.0), of(0.6));
        let index = |p: &Point3<f64>| whole.grid().voxel_at(p);
        let differ = (0..fine.grid().len()).filter(|l| {
            let at = index(&fine.grid().centre(fine.grid().voxel(*l)));
            at.is_some_and(|voxel| *whole.at(voxel) != fine.data()[*l])
        });
        let (differ, volume) = (differ.count(), fine.count());
        // A rim of half a voxel of 1 mm around the skin, couch and mask left out in both.
        assert!(differ as f64 <= 0.03 * volume as f64, "{differ} of {volume}");
        let ml = |mask: &Mask| mask.count() as f64 * mask.grid().voxel_volume() / 1000.0;
        assert!((ml(&fine) / ml(&whole) - 1.0).abs() < 0.01, "{} {}", ml(&fine), ml(&whole));
    }

    fn grid() -> Grid {
        Grid::axis_aligned([70, 64, 50], [2.0, 2.0, 2.0], [-69.0, -63.0, -49.0]).unwrap()
    }

    fn ct(grid: &Grid) -> Volume<f32> {
        Volume::from_fn(grid.clone(), |l| scene(&grid.centre(grid.voxel(l))).0)
    }

    #[test]
    fn couch_and_mask_are_not_patient_and_the_airway_is() {
        let grid = grid();
        let body = find(&ct(&grid), None, &BodyOptions::default()).unwrap();
        let truth = Volume::from_fn(grid.clone(), |l| scene(&grid.centre(grid.voxel(l))).1);
        let common = body.data().iter().zip(truth.data()).filter(|(b, t)| **b && **t).count();
        let dice = 2.0 * common as f64 / (body.count() + truth.count()) as f64;
        assert!(dice >= 0.98, "Dice {dice}");
        let near = dilate(&truth, 4.0);
        let far: Vec<_> = (0..grid.len()).filter(|&l| body.data()[l] && !near.data()[l]).collect();
        assert!(
            far.is_empty(),
            "device farther than 4 mm from the skin, for example {:?}",
            grid.centre(grid.voxel(far[0]))
        );
        let at = |p: [f64; 3]| *body.at(grid.index(&p.into()).map(|c| c.round() as usize).into());
        assert!(at([0.0, -15.0, -49.0]) && at([0.0, -15.0, 20.0]), "airway, also where the edge cuts it");
        assert!(at([-69.0, 29.0, -49.0]) && at([69.0, -29.0, -49.0]), "shoulders at the edge of the image");
    }

    #[test]
    fn storage_order_and_direction_do_not_matter() {
        let first = grid();
        let expected = find(&ct(&first), None, &BodyOptions::default()).unwrap();
        // Axes k, -i, -j of the first grid.
        let direction = Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0);
        let corner = first.centre([69, 63, 0]);
        let turned = Grid::new([50, 70, 64], [2.0; 3], corner, direction).unwrap();
        let got = find(&ct(&turned), None, &BodyOptions::default()).unwrap();
        assert_eq!(got.count(), expected.count());
        for (l, &e) in expected.data().iter().enumerate() {
            let index = turned.index(&first.centre(first.voxel(l))).map(|c| c.round() as usize);
            assert_eq!(*got.at(index.into()), e);
        }
    }

    #[test]
    fn a_limb_apart_is_patient_by_its_bone_or_its_labels_and_a_block_is_not() {
        let grid = Grid::axis_aligned([75, 40, 40], [3.0; 3], [0.0; 3]).unwrap();
        let trunk = |p: &Point3<f64>| p.x < 80.0;
        let limb = |p: &Point3<f64>| (p.y - 60.0).hypot(p.z - 60.0) < 30.0 && p.x > 100.0 && p.x < 160.0;
        let block = |p: &Point3<f64>| p.x > 180.0 && p.y < 60.0;
        let shaft = |p: &Point3<f64>| (p.y - 60.0).hypot(p.z - 60.0) < 9.0;
        let run = |bone: f32, labels: Option<&LabelMap>| {
            let ct = Volume::from_fn(grid.clone(), |l| {
                let p = grid.centre(grid.voxel(l));
                if limb(&p) && shaft(&p) {
                    bone
                } else if trunk(&p) || limb(&p) || block(&p) {
                    30.0
                } else {
                    -1000.0
                }
            });
            let body = find(&ct, labels, &BodyOptions::default()).unwrap();
            [[10, 20, 20], [43, 20, 20], [70, 10, 20]].map(|v| *body.at(v))
        };
        assert_eq!(run(600.0, None), [true, true, false]);
        assert_eq!(run(30.0, None), [true, false, false]);
        // Labels on a grid of their own.
        let coarse = grid.coarsened(5.0);
        let volume = Volume::from_fn(coarse.clone(), |l| {
            let p = coarse.centre(coarse.voxel(l));
            u16::from(p.x > 110.0 && p.x < 150.0 && shaft(&p))
        });
        let labels = LabelMap { volume, names: BTreeMap::from([(1, "humerus_left".to_owned())]) };
        assert!(run(30.0, Some(&labels))[1]);
    }

    #[test]
    fn air_is_refused_with_the_threshold() {
        let air = Volume::filled(grid(), -1000.0f32);
        let error = find(&air, None, &BodyOptions::default()).unwrap_err().to_string();
        assert!(error.contains("-350 HU") && error.contains("threshold_hu"), "{error}");
    }
}
