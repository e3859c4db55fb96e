//! What the page's script needs of a run: volumes, packed, and what is told of places.

use super::super::pictures::uncertainty;
use super::super::plane::{cell_at, nearest, nearest_held};
use super::places::{ViewerPlace, bones, landmarks, places, start};
use super::structures;
use crate::error::Result;
use crate::geometry::Grid;
use crate::io::embed::{FINEST_MM, HuScale, PageGrid, pack};
use crate::pipeline::{Case, FractionKind, Outcome};
use crate::volume::contour::Contours;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde_json::{Value, json};

/// Distance of places of the field that are told, mm.
const FIELD_MM: f64 = 5.0;
/// Step in which the Jacobian is told.
const JACOBIAN: f64 = 0.01;
/// Steps in which displacement and uncertainty are told, mm.
#[derive(Clone, Copy)]
struct Steps {
    displacement: f64,
    uncertainty: f64,
}
/// For a page that is sent around.
const FEW_BYTES: Steps = Steps { displacement: 0.1, uncertainty: 0.05 };
/// For a page with everything.
const FINE: Steps = Steps { displacement: 0.01, uncertainty: 0.01 };
/// Least Jacobian that is told, so that 0 is free for places outside the patient; folded cells hold
/// -1.
const LEAST_JACOBIAN: f64 = -2.0;
/// Bytes of the packed volumes at most: with the pictures the page stays below 12 MB.
const MOST_BYTES: usize = 5_300_000;
/// Voxels that are never too many.
const FEW: usize = 1000;
/// Largest number of the script's volumes.
const MOST: f64 = 32_000.0;
/// Share of the patient's motions, the largest left out, that the colours of arrows span.
const MOST_MOTIONS: f64 = 0.99;

/// A run as the viewer of its page shows it.
#[derive(Debug, Clone)]
pub struct View {
    /// Name of each volume in the page, and its bytes; see [`pack`].
    pub(super) volumes: Vec<(&'static str, Vec<u8>)>,
    /// Grids, steps, names, landmarks and places.
    pub(super) about: Value,
}

impl View {
    /// Bytes of all volumes.
    fn bytes(&self) -> usize {
        self.volumes.iter().map(|(_, bytes)| bytes.len()).sum()
    }
}

/// Makes the numbers of a volume.
type ViewerValues<'a> = Box<dyn Fn() -> Vec<i32> + Sync + 'a>;

/// What [`View`] holds, of a finished run. All volumes lie on voxels of the fraction, as many as
/// [`PageGrid::of`] takes; the planning CT also as it was scanned, or with the couch shift alone where the
/// scans have hardly any volume in common. `contours`: structures of the planning CT, to be shown
/// before and after.
///
/// # Errors
/// [`crate::error::Error::Internal`] when a volume cannot be packed.
pub fn embed(case: &Case, outcome: &Outcome, contours: Option<&Contours>) -> Result<View> {
    within(MOST_BYTES, case, outcome, contours)
}

/// The same with every voxel of the fraction, however many there are, every HU, and the fields at every voxel.
///
/// # Errors
/// As [`embed`].
pub fn embed_whole(case: &Case, outcome: &Outcome, contours: Option<&Contours>) -> Result<View> {
    let scans = [&case.fraction.ct, &outcome.planning_on_fraction];
    let page = PageGrid::whole(&scans, case.planning.ct.extremes()[0])?;
    let field = outcome.pull.displacement.data();
    let most = field.par_iter().map(|v| v.iter().fold(0f32, |most, c| most.max(c.abs()))).reduce(|| 0.0, f32::max);
    // Far scanner origins need more than the script's 16 bits in fine steps.
    let fits = f64::from(most) < MOST * FINE.displacement;
    let steps = Steps { displacement: if fits { FINE } else { FEW_BYTES }.displacement, ..FINE };
    embed_on(&page, &page, steps, case, outcome, contours)
}

/// The same in so many bytes at most: noise does not pack, and takes fewer voxels.
fn within(most: usize, case: &Case, outcome: &Outcome, contours: Option<&Contours>) -> Result<View> {
    let scans = [&case.fraction.ct, &outcome.planning_on_fraction];
    let mut finest = FINEST_MM;
    let mut page = PageGrid::thinned(&scans, finest)?;
    loop {
        let view = embed_on(&page, &page.coarser(FIELD_MM)?, FEW_BYTES, case, outcome, contours)?;
        let over = view.bytes() as f64 / most as f64;
        let voxels = page.grid().len();
        if over <= 1.0 || voxels <= FEW {
            return Ok(view);
        }
        while page.grid().len() >= voxels {
            finest *= over.cbrt().max(1.1);
            page = PageGrid::thinned(&scans, finest)?;
        }
    }
}

/// The same on the voxels of a page, with the fields at those of `coarse`.
fn embed_on(
    page: &PageGrid,
    coarse: &PageGrid,
    steps: Steps,
    case: &Case,
    outcome: &Outcome,
    contours: Option<&Contours>,
) -> Result<View> {
    let shift_before = super::super::pictures::shift_before(case, outcome);
    let shift = shift_before.unwrap_or_default();
    let whole: [(&'static str, ViewerValues<'_>); 5] = [
        ("fraction", Box::new(|| page.hu(&case.fraction.ct))),
        ("deformed", Box::new(|| page.hu(&outcome.planning_on_fraction))),
        ("planning", Box::new(|| page.hu_between(&case.planning.ct, &shift))),
        ("bones_before", Box::new(|| page.labels_moved(&case.planning.bones.volume, &shift))),
        ("bones_after", Box::new(|| page.labels_held(&outcome.bones_on_fraction.volume))),
    ];
    let (volumes, (maps, top)) = rayon::join(
        || {
            let one =
                |(name, values): &(&'static str, ViewerValues<'_>)| Ok((*name, pack(&values(), page.grid().size())?));
            whole.par_iter().with_max_len(1).map(one).collect::<Result<Vec<_>>>()
        },
        || maps(outcome, coarse, &shift, steps),
    );
    let size = coarse.grid().size();
    let mut volumes = volumes?;
    let maps = maps.into_par_iter().map(|(name, values)| Ok((name, pack(&values, size)?)));
    volumes.extend(maps.collect::<Result<Vec<_>>>()?);
    if let Some(contours) = contours {
        let [before, after] = structures::bits(case, outcome, contours, page, &shift)?;
        volumes.push(("structures_before", pack(&before, page.grid().size())?));
        volumes.push(("structures_after", pack(&after, page.grid().size())?));
    }
    let HuScale { first, step } = page.hu_scale();
    let scale = |hu: f32| outcome.kind.as_ref().map_or(hu, |kind| kind.on_plannings_scale(hu));
    let offset = f64::from(scale(0.0));
    let all = |list: Vec<ViewerPlace>| list.into_iter().map(ViewerPlace::json).collect::<Vec<_>>();
    let about = json!({
        "grid": grid(page.grid()),
        "coarse": grid(coarse.grid()),
        "own": case.fraction.ct.grid().spacing(),
        "mr": outcome.kind.as_ref().is_some_and(|kind| kind.mr.is_some()),
        "hu": { "first": first, "step": step },
        // The fraction on planning's scale, as the pictures show it.
        "scale": [(f64::from(scale(1000.0)) - offset) / 1000.0, offset],
        "steps": { "mm": steps.displacement, "jacobian": JACOBIAN, "uncertainty": steps.uncertainty },
        "shift": shift.as_slice(),
        // Colours would tell of grey values, not of motion.
        "mode": if outcome.kind.as_ref().is_some_and(FractionKind::unlike) { "checker" } else { "colour" },
        "shifted": shift_before.is_some(),
        "top": top,
        // Motion of the couch beyond that shift.
        "couch": (outcome.couch.shift() - shift).as_slice(),
        "unsure": outcome.uncertainty.as_ref().map_or([3.0, 0.0], |(map, _)| uncertainty::scale(map)),
        "names": case.planning.bones.names,
        "structures": structures::about(contours),
        "start": start(case, outcome),
        "places": all(places(case, outcome)),
        "bones": bones(outcome),
        "landmarks": landmarks(outcome),
    });
    Ok(View { volumes, about })
}

fn grid(grid: &Grid) -> Value {
    json!({ "size": grid.size(), "spacing": grid.spacing(), "origin": grid.origin().coords.as_slice() })
}

/// Displacement, Jacobian and uncertainty at the places of `coarse`, and a motion apart from
/// `shift` that few exceed, mm. Outside the patient all are 0.
fn maps(
    outcome: &Outcome,
    coarse: &PageGrid,
    shift: &Vector3<f64>,
    steps: Steps,
) -> (Vec<(&'static str, Vec<i32>)>, f64) {
    let count = |value: f64, step: f64| (value / step).round().clamp(-MOST, MOST) as i32;
    let unsure = outcome.uncertainty.as_ref().map(|u| &u.0);
    let [x, y, z, jacobian, uncertainty] = coarse.of_field(&outcome.pull.displacement, |p, v| {
        let from: Point3<f64> = p + Vector3::from(v.map(f64::from));
        if nearest(&outcome.body, &from) != Some(true) {
            return [0; 5];
        }
        let [x, y, z] = v.map(|c| count(f64::from(c), steps.displacement));
        let j = cell_at(&outcome.jacobian, &from).map_or(1.0, f64::from);
        let mm = unsure.and_then(|map| nearest_held(map, &from)).filter(|mm| *mm >= 0.0);
        [
            x,
            y,
            z,
            count((j - LEAST_JACOBIAN).max(JACOBIAN), JACOBIAN),
            mm.map_or(0, |mm| 1 + count(f64::from(mm), steps.uncertainty)),
        ]
    });
    let inside = (0..x.len()).filter(|n| jacobian[*n] != 0);
    let length = |n: usize| (Vector3::new(x[n], y[n], z[n]).map(f64::from) * steps.displacement + shift).norm();
    let mut lengths: Vec<f64> = inside.map(length).collect();
    let most = (lengths.len() as f64 * MOST_MOTIONS) as usize;
    let top = if lengths.is_empty() { 1.0 } else { *lengths.select_nth_unstable_by(most, f64::total_cmp).1 };
    let mut maps = vec![("ux", x), ("uy", y), ("uz", z), ("jacobian", jacobian)];
    maps.extend(unsure.is_some().then_some(("uncertainty", uncertainty)));
    (maps, top.max(1.0))
}

#[cfg(test)]
mod tests {
    use super::super::super::example;
    use super::*;

    #[test]
    fn what_packs_badly_is_shown_in_fewer_voxels() {
        let (case, outcome, _) = example::small();
        let whole = embed(&case, &outcome, None).unwrap();
        let most = whole.bytes() / 3;
        let less = within(most, &case, &outcome, None).unwrap();
        assert!(less.bytes() <= most, "{} {most}", less.bytes());
        let voxels = |view: &View| {
            view.about["grid"]["size"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).product::<u64>()
        };
        assert!(voxels(&less) < voxels(&whole) && voxels(&less) > 100, "{} {}", voxels(&less), voxels(&whole));
        assert_eq!(whole.volumes.len(), less.volumes.len());
    }
}
