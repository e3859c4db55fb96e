//! Where a bone may be: the correlation of the turned bone with what the fraction shows, at every place
//! (normalised correlation with a mask, Padfield 2012; by sums over the bone's voxels, a row of places at a time).

use super::super::coarse::Coarse;
use super::super::shape::{CHANNELS, Descriptor, Shapes};
use super::template::{Template, Turned};
use crate::geometry::{Grid, vectorised};
use crate::volume::region::part;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rayon::prelude::*;

/// Least share of a bone's voxels that the fraction shows.
pub(super) const LEAST_SHARE: f32 = 0.35;
/// Correlation squared that noise leaves.
pub(super) const MOST_CORRELATION: f32 = 0.998;
/// Less evidence is none.
const LEAST_EVIDENCE: f32 = 0.05;
/// HU that sums are taken about, and their unit: in single precision they must not cancel.
const MIDDLE_HU: f32 = 100.0;
const UNIT_HU: f32 = 100.0;
/// Places next to each other, in voxels, are one.
const NEXT: usize = 1;
/// And so are those nearer than this, mm.
const SAME_MM: f64 = 6.0;
/// In an image of more places than this, that of a trunk, their rows lie so far apart at most, mm, where voxels are smaller: a
/// voxel around is looked at later. Everywhere, one of 20 slabs got a cut bone 1.2 mm farther off.
const MANY: usize = 1_000_000;
const ROWS_MM: f64 = 6.2;
/// Voxels of a bone that are looked at everywhere, and the best places that are looked at more closely.
const SCOUTS: usize = 100;
const FINALISTS: usize = 80;

/// A place and a turn that a bone may have.
#[derive(Debug, Clone)]
pub struct Proposal {
    /// Share in view times `-ln(1 - correlation^2)`.
    pub evidence: f32,
    /// Where the bone's middle is, LPS mm.
    pub middle: Point3<f64>,
    /// Its turn.
    pub turn: UnitQuaternion<f64>,
}

/// The fraction, ready for sums: for each voxel whether it is seen, its value and its square.
pub struct Ready {
    grid: Grid,
    size: [usize; 3],
    pub(super) seen: Vec<f32>,
    pub(super) value: Vec<f32>,
    pub(super) square: Vec<f32>,
    /// Descriptors, where these are compared.
    pub(super) shape: Option<ReadyShape>,
}

/// Descriptors, ready for sums.
pub(super) struct ReadyShape {
    /// Whether there is one.
    pub(super) is: Vec<f32>,
    /// Each channel, zero where there is none, and the sum of their squares.
    pub(super) channels: [Vec<f32>; CHANNELS],
    pub(super) square: Vec<f32>,
    /// Their mean.
    pub(super) mean: Descriptor,
}

impl Ready {
    /// Of the fraction, without what lies outside of the view.
    pub fn new(fraction: &Coarse, shapes: Option<&Shapes<'_>>) -> Self {
        let whole = fraction.value.grid();
        let seen = (0..whole.len()).filter(|&l| fraction.seen[l]).map(|l| whole.voxel(l));
        let none = [[usize::MAX, 0]; 3];
        let range = seen.fold(none, |r, v| std::array::from_fn(|a| [r[a][0].min(v[a]), r[a][1].max(v[a] + 1)]));
        let range = range.map(|[low, high]| low.min(high)..high.max(1));
        let part = part(&fraction.value, &range).unwrap_or_else(|_| fraction.value.clone());
        let grid = part.grid().clone();
        let from: Vec<Option<usize>> =
            (0..grid.len()).map(|l| whole.voxel_at(&grid.centre(grid.voxel(l))).map(|v| whole.linear(v))).collect();
        let seen: Vec<bool> = from.iter().map(|l| l.is_some_and(|l| fraction.seen[l])).collect();
        let shape = shapes.map(|shapes| {
            let all = shapes.fraction();
            let each = |of: &dyn Fn(usize) -> f32| from.iter().map(|l| l.map_or(0.0, of)).collect::<Vec<f32>>();
            ReadyShape {
                is: each(&|l| f32::from(u8::from(all.is[l]))),
                channels: std::array::from_fn(|c| each(&|l| all.each[l][c])),
                square: each(&|l| all.each[l].iter().map(|d| d * d).sum()),
                mean: all.mean(),
            }
        });
        let unit = |(v, s): (&f32, &bool)| if *s { (v - MIDDLE_HU) / UNIT_HU } else { 0.0 };
        let value: Vec<f32> = part.data().iter().zip(&seen).map(unit).collect();
        Self {
            size: grid.size(),
            grid,
            seen: seen.iter().map(|s| f32::from(u8::from(*s))).collect(),
            square: value.iter().map(|v| v * v).collect(),
            value,
            shape,
        }
    }

    /// What a row of so many places, which begins `margin` voxels before the row (j, k), sees at an offset: where that begins in
    /// storage and in the row, and how many voxels it is.
    #[inline(always)]
    pub(super) fn span(
        &self,
        [di, dj, dk]: [i32; 3],
        margin: i32,
        [j, k]: [i32; 2],
        width: usize,
    ) -> Option<(usize, usize, usize)> {
        let [ni, nj, nk] = self.size.map(|n| n as i32);
        let (y, z) = (j + dj, k + dk);
        if y < 0 || y >= nj || z < 0 || z >= nk {
            return None;
        }
        // Place p of the row sees voxel p + shift.
        let shift = di - margin;
        let (low, high) = ((-shift).max(0), (ni - shift).min(width as i32));
        (low < high).then(|| ((low + shift + ni * (y + nj * z)) as usize, low as usize, (high - low) as usize))
    }
}

/// Sums of a row of places, of which the evidence for each follows.
pub trait Row {
    /// Every so many rows of places are looked at first, as wide as the evidence around the right place is.
    const STRIDE: usize;
    /// So many of the best turns at a place are looked at around it; none: all.
    const TURNS: Option<usize>;
    /// For so many places.
    fn new(width: usize) -> Self;
    /// Sums those that begin `margin` voxels before the row (j, k) of the image.
    fn row(&mut self, turned: &Turned, image: &Ready, margin: i32, at: [i32; 2]);
    /// Evidence for the i-th place, of so many voxels of the bone.
    fn evidence(&self, i: usize, voxels: usize) -> f32;
}

/// Places of the bone's middle: the image and a margin about it.
#[derive(Clone, Copy)]
struct Places {
    margin: [usize; 3],
    size: [usize; 3],
    stride: [usize; 3],
}

impl Places {
    fn voxel(&self, n: usize) -> [i32; 3] {
        let [i, j, _] = self.size;
        let at = [n % i, n / i % j, n / i / j];
        std::array::from_fn(|a| (at[a] * self.stride[a]) as i32 - self.margin[a] as i32)
    }
}

/// Turns that are tried.
pub struct Turns<'a> {
    pub all: &'a [UnitQuaternion<f64>],
    /// So many of the first are looked at everywhere.
    pub everywhere: usize,
}

/// The best places of a bone, best first, at most `most`.
pub fn proposals<S: Row>(
    bone: &Template<'_>,
    ready: &Ready,
    turns: &Turns<'_>,
    most: usize,
    shapes: Option<&Shapes<'_>>,
) -> Vec<Proposal> {
    let Turns { all: turns, everywhere } = *turns;
    let all: Vec<Turned> = turns.par_iter().map(|t| bone.turned(t, &ready.grid, shapes)).collect();
    let few: Vec<Turned> = all.iter().take(everywhere).map(|t| t.thinned(SCOUTS)).collect();
    // As far beyond the image as a bone's middle is while the least share is in view.
    let reach = |a: usize| all.iter().flat_map(|t| &t.offsets).map(|o| o[a].unsigned_abs() as usize).max().unwrap_or(0);
    let margin: [usize; 3] = std::array::from_fn(|a| reach(a) * 2 / 5);
    let number: usize = (0..3).map(|a| ready.size[a] + 2 * margin[a]).product();
    let apart = |a: usize| if number > MANY { (ROWS_MM / ready.grid.spacing()[a]) as usize } else { 1 };
    let stride = [1, apart(1).max(S::STRIDE), apart(2).max(S::STRIDE)];
    let size = std::array::from_fn(|a| (ready.size[a] + 2 * margin[a]).div_ceil(stride[a]));
    let places = Places { margin, size, stride };
    let width = places.size[0];
    let mut best = vec![0f32; places.size.iter().product()];
    best.par_chunks_mut(width).enumerate().for_each_init(
        || S::new(width),
        |sums, (row, best)| {
            let [_, j, k] = places.voxel(row * width);
            for turned in &few {
                vectorised(
                    #[inline(always)]
                    || sums.row(turned, ready, margin[0] as i32, [j, k]),
                );
                for (i, b) in best.iter_mut().enumerate() {
                    *b = b.max(sums.evidence(i, turned.values.len()));
                }
            }
        },
    );
    let mut found: Vec<usize> =
        (0..best.len()).into_par_iter().filter(|&n| best[n] > LEAST_EVIDENCE && peak(&best, &places, n)).collect();
    found.sort_by(|&a, &b| best[b].total_cmp(&best[a]));
    found.truncate(FINALISTS);
    // The best turn of each, one voxel around.
    let closer = |&n: &usize| {
        let mut sums = S::new(3);
        let [i, j, k] = places.voxel(n);
        let mut best = Proposal { evidence: 0.0, middle: Point3::origin(), turn: UnitQuaternion::identity() };
        for &t in &likely(&mut sums, &all, ready, [i, j, k]) {
            let (turned, turn) = (&all[t], &turns[t]);
            for (dk, dj) in (-1..=1).flat_map(|dk| (-1..=1).map(move |dj| (dk, dj))) {
                sums.row(turned, ready, 1 - i, [j + dj, k + dk]);
                for x in 0..3 {
                    let evidence = sums.evidence(x, turned.values.len());
                    if evidence > best.evidence {
                        let at = Vector3::new(i + x as i32 - 1, j + dj, k + dk).map(f64::from);
                        best = Proposal { evidence, middle: ready.grid.world(&at), turn: *turn };
                    }
                }
            }
        }
        best
    };
    let mut closer: Vec<Proposal> = found.par_iter().map(closer).collect();
    closer.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    let mut out: Vec<Proposal> = Vec::new();
    for p in closer.into_iter().filter(|p| p.evidence > LEAST_EVIDENCE) {
        if out.len() < most && out.iter().all(|o| (o.middle - p.middle).norm() > SAME_MM) {
            out.push(p);
        }
    }
    out
}

/// The turns that are looked at around a place: those of the most evidence at it, where not all are.
fn likely<S: Row>(sums: &mut S, all: &[Turned], ready: &Ready, [i, j, k]: [i32; 3]) -> Vec<usize> {
    let mut turns: Vec<usize> = (0..all.len()).collect();
    let Some(most) = S::TURNS.filter(|most| *most < all.len()) else { return turns };
    let at = |turned: &Turned| {
        sums.row(turned, ready, 1 - i, [j, k]);
        (0..3).map(|x| sums.evidence(x, turned.values.len())).fold(0.0, f32::max)
    };
    let evidence: Vec<f32> = all.iter().map(at).collect();
    turns.sort_by(|&a, &b| evidence[b].total_cmp(&evidence[a]));
    turns.truncate(most);
    turns
}

/// Whether no place around has more evidence; of equal ones the first counts.
fn peak(best: &[f32], places: &Places, n: usize) -> bool {
    let [ni, nj, nk] = places.size;
    let (i, j, k) = (n % ni, n / ni % nj, n / ni / nj);
    let around = |v: usize, size: usize| v.saturating_sub(NEXT)..(v + NEXT + 1).min(size);
    around(k, nk).all(|z| {
        around(j, nj).all(|y| {
            around(i, ni).all(|x| {
                let m = x + ni * (y + nj * z);
                best[n] > best[m] || (m >= n && best[n] >= best[m])
            })
        })
    })
}

/// Sums of a row of places: of what is seen its number, planning's values and squares, the fraction's, and both together.
pub struct Sums([Vec<f32>; 6]);

impl Row for Sums {
    const STRIDE: usize = 1;
    const TURNS: Option<usize> = Some(5);

    fn new(width: usize) -> Self {
        Self(std::array::from_fn(|_| vec![0.0; width]))
    }

    #[inline(always)]
    fn row(&mut self, turned: &Turned, image: &Ready, margin: i32, [j, k]: [i32; 2]) {
        self.0.iter_mut().for_each(|s| s.fill(0.0));
        let width = self.0[0].len();
        for (offset, hu) in turned.offsets.iter().zip(&turned.values) {
            let Some((start, low, n)) = image.span(*offset, margin, [j, k], width) else { continue };
            let t = (hu - MIDDLE_HU) / UNIT_HU;
            let [count, a, aa, f, ff, fa] = &mut self.0;
            let part = low..low + n;
            let (count, a, aa) = (&mut count[part.clone()], &mut a[part.clone()], &mut aa[part.clone()]);
            let (f, ff, fa) = (&mut f[part.clone()], &mut ff[part.clone()], &mut fa[part]);
            let (seen, value, square) =
                (&image.seen[start..start + n], &image.value[start..start + n], &image.square[start..start + n]);
            for p in 0..n {
                count[p] += seen[p];
                a[p] += t * seen[p];
                aa[p] += t * t * seen[p];
                f[p] += value[p];
                ff[p] += square[p];
                fa[p] += t * value[p];
            }
        }
    }

    fn evidence(&self, i: usize, voxels: usize) -> f32 {
        let [n, a, aa, f, ff, fa] = [0, 1, 2, 3, 4, 5].map(|s| self.0[s][i]);
        let share = n / voxels.max(1) as f32;
        if share < LEAST_SHARE {
            return 0.0;
        }
        let (covariance, va, vf) = (fa - f * a / n, aa - a * a / n, ff - f * f / n);
        let flat = 1e-4 * n;
        if covariance <= 0.0 || va <= flat || vf <= flat {
            return 0.0;
        }
        -share * (1.0 - (covariance * covariance / (va * vf)).min(MOST_CORRELATION)).ln()
    }
}
