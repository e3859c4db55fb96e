//! The search for the pre-images of a slab of fraction voxels.

use super::super::PushField;
use super::super::in_steps;
use super::super::mesh::tetrahedra::{Drop, FieldMesh};
use super::bones::MovedBones;
use super::newton::newton;
use super::pre_image::{Continued, InvertOptions, solve};
use super::reach::Reach;
use crate::geometry::{Grid, LANES, Wide, vectorised};
use crate::volume::extent::{extent, union};
use crate::volume::interpolation::lanes::{NOWHERE, Sampler};
use nalgebra::{Point3, Vector3};
use std::ops::Range;

/// Iteration limit of the quick search, which is all that there is where no tissue comes to lie: the continued field outside
/// tissue may have no inverse at all.
const QUICK_ITERATIONS: usize = 10;

/// What was found in a slab.
#[derive(Default)]
pub(in crate::field) struct SearchTally {
    pub(in crate::field) residuals: Vec<f32>,
    pub(in crate::field) unconverged: usize,
    pub(in crate::field) tissue: usize,
    pub(in crate::field) strayed: usize,
    pub(in crate::field) worst: f64,
    pub(in crate::field) outside: usize,
}

/// Everything that the inversion of a voxel needs.
pub(in crate::field) struct Search<'a, V> {
    pub(in crate::field) push: &'a PushField,
    pub(in crate::field) robust: Continued<'a>,
    pub(in crate::field) quick: Sampler<'a>,
    pub(in crate::field) reach: Reach,
    pub(in crate::field) guess: Continued<'a>,
    pub(in crate::field) mesh: FieldMesh<'a, V>,
    pub(in crate::field) bones: Option<&'a MovedBones<'a>>,
    pub(in crate::field) fraction: &'a Grid,
    pub(in crate::field) options: &'a InvertOptions,
}

/// What the moved mesh and the moved bones have drawn into fraction voxels.
#[derive(Clone, Copy)]
pub(in crate::field) struct Painted<'a> {
    /// Of the mesh.
    pub(in crate::field) drawn: &'a [Drop<3>],
    /// The label of the bone that lies there; 0 for none.
    pub(in crate::field) owner: &'a [u16],
}

/// Where the search leaves what it finds for fraction voxels.
pub(in crate::field) struct FoundPlace<'a> {
    /// Ways to the pre-images, mm.
    pub(in crate::field) v: &'a mut [[f32; 3]],
    /// Whether they lie inside the planning scan.
    pub(in crate::field) inside: &'a mut [bool],
}

impl<V> Search<'_, V> {
    /// Inverts the planes from `first` on.
    pub(in crate::field) fn slab(&self, first: usize, painted: Painted<'_>, found: FoundPlace<'_>) -> SearchTally {
        let [nx, ny, _] = self.fraction.size();
        let mut t = SearchTally::default();
        let mut rows = SearchRows::new(nx);
        let painted = painted.drawn.chunks(nx).zip(painted.owner.chunks(nx));
        let found = found.v.chunks_mut(nx).zip(found.inside.chunks_mut(nx));
        for (row, ((drawn, owner), (v, inside))) in painted.zip(found).enumerate() {
            let (j, k) = (row % ny, first + row / ny);
            if j == 0 {
                rows.forget();
            }
            let y = self.fraction.centre([0, j, k]).coords;
            let open = self.open(&y, drawn, owner);
            rows.now.rest(&open);
            self.leave(&y, &open, inside, &mut t);
            self.starts(&y, drawn, open.clone(), &mut rows);
            self.row(&y, drawn, open.clone(), &mut rows);
            self.settle(&y, Painted { drawn, owner }, open, FoundPlace { v, inside }, &mut rows, &mut t);
            rows.advance();
        }
        t
    }

    /// The voxels of a row that begins at `y` in which anything may come to lie but what is there, in whole blocks.
    fn open(&self, y: &Vector3<f64>, drawn: &[Drop<3>], owner: &[u16]) -> Range<usize> {
        let planning = self.push.displacement.grid();
        let along: Vector3<f64> = planning.inverse_step() * self.fraction.step().column(0);
        let reach = self.reach.of_places(&planning.index(&Point3::from(*y)), &along, drawn.len());
        let drawn_there = extent(drawn, |part| part.iter().fold(false, |any, d| any | (d.rank > 0)));
        let owned = extent(owner, |part| part.iter().fold(false, |any, o| any | (*o > 0)));
        let Range { start, end } = union(&reach, &union(&drawn_there, &owned));
        start / LANES * LANES..end.next_multiple_of(LANES).min(drawn.len())
    }

    /// What lies beside the `open` voxels of a row that begins at `y`: it stays, inside the planning scan or not.
    fn leave(&self, y: &Vector3<f64>, open: &Range<usize>, inside: &mut [bool], t: &mut SearchTally) {
        let planning = self.push.displacement.grid();
        let first = planning.index(&Point3::from(*y));
        let along: Vector3<f64> = planning.inverse_step() * self.fraction.step().column(0);
        let whole = self.reach.holds(&first, &(first + along * inside.len() as f64));
        for beside in [0..open.start, open.end..inside.len()] {
            if whole {
                inside[beside].fill(true);
                continue;
            }
            let begin = beside.start;
            for (n, inside) in inside[beside].chunks_mut(LANES).enumerate() {
                let block = Sampler::block(&(first + along * (begin + n * LANES) as f64), &along);
                let places = self.quick.land(&block, &Default::default());
                inside.iter_mut().zip(places).for_each(|(inside, place)| *inside = place != NOWHERE);
                t.outside += inside.iter().filter(|inside| !**inside).count();
            }
        }
    }

    /// Where the search starts in a row that begins at `y`.
    fn starts(&self, y: &Vector3<f64>, drawn: &[Drop<3>], open: Range<usize>, rows: &mut SearchRows) {
        let along: Vector3<f64> = self.fraction.step().column(0).into_owned();
        let [before, last] = &rows.before;
        // What the rows lead to expect: the third is nearly in line.
        for a in 0..3 {
            let starts = rows.now.v[a][open.clone()].iter_mut();
            for ((start, before), last) in starts.zip(&before.v[a][open.clone()]).zip(&last.v[a][open.clone()]) {
                *start = 2.0 * last - before;
            }
        }
        for i in open {
            let drawn = &drawn[i];
            if drawn.rank == 0 && before.solved[i] & last.solved[i] {
                continue;
            }
            let held = || drawn.value.map(|u| -u);
            let guess = || self.guess.value(&Point3::from(y + along * i as f64)).map(|v| v as f32).into();
            let start: [f32; 3] = if drawn.rank > 0 { held() } else { guess() };
            for (v, start) in rows.now.v.iter_mut().zip(start) {
                v[i] = start;
            }
        }
    }

    /// The quick search of a row, from where its voxels start.
    fn row(&self, y: &Vector3<f64>, drawn: &[Drop<3>], open: Range<usize>, rows: &mut SearchRows) {
        let planning = self.push.displacement.grid();
        let first = planning.index(&Point3::from(*y));
        let along: Vector3<f64> = planning.inverse_step() * self.fraction.step().column(0);
        // A little less, so that rounding cannot take it across the limit.
        let tolerance = self.options.tolerance_mm as f32 * (1.0 - f32::EPSILON);
        let steps = self.options.max_iterations.min(QUICK_ITERATIONS);
        let (begin, end) = (open.start / LANES, open.end.div_ceil(LANES));
        vectorised(
            #[inline(always)]
            || {
                let [x, y, z] = rows.now.v.each_mut().map(|v| &mut v.as_chunks_mut::<LANES>().0[begin..end]);
                let blocks = x.iter_mut().zip(y).zip(z).zip(&mut rows.residual.as_chunks_mut::<LANES>().0[begin..end]);
                for (n, (((x, y), z), residual)) in (begin..).zip(blocks) {
                    let block = Sampler::block(&(first + along * (n * LANES) as f64), &along);
                    let rough = drawn[n * LANES..].iter().take(LANES).any(|d| d.rank > 0);
                    let found = newton(&self.quick, &block, [Wide(*x), Wide(*y), Wide(*z)], rough, tolerance, steps);
                    [*x, *y, *z] = found.v.map(|v| v.0);
                    *residual = found.residual.0;
                }
                let [x, y, z] = rows.now.v.each_ref().map(|v| &v.as_chunks::<LANES>().0[begin..end]);
                let places = &mut rows.place.as_chunks_mut::<LANES>().0[begin..end];
                for (n, (place, ((x, y), z))) in (begin..).zip(places.iter_mut().zip(x.iter().zip(y).zip(z))) {
                    let block = Sampler::block(&(first + along * (n * LANES) as f64), &along);
                    *place = self.quick.land(&block, &[Wide(*x), Wide(*y), Wide(*z)]);
                }
            },
        );
    }

    /// What a row has come to: bones where they lie, patiently where the quick search failed, nothing twice.
    fn settle(
        &self,
        y: &Vector3<f64>,
        Painted { drawn, owner }: Painted<'_>,
        open: Range<usize>,
        FoundPlace { v, inside }: FoundPlace<'_>,
        rows: &mut SearchRows,
        t: &mut SearchTally,
    ) {
        let along: Vector3<f64> = self.fraction.step().column(0).into_owned();
        let arrived = |residual: f32| f64::from(residual) < self.options.tolerance_mm;
        for start in open.clone().step_by(LANES) {
            let block = start..(start + LANES).min(open.end);
            let plain = owner[block.clone()].iter().all(|o| *o == 0)
                && rows.residual[block.clone()].iter().all(|r| arrived(*r));
            if !plain {
                for i in block.clone() {
                    self.settle_one(&(y + along * i as f64), &drawn[i], owner[i], i, rows, t);
                }
            }
            for i in block {
                let place = rows.place[i];
                let (found, tissue) = (rows.now.v.each_ref().map(|v| v[i]), self.tissue(place));
                v[i] = if tissue { found } else { in_steps(found) };
                inside[i] = place != NOWHERE;
                rows.now.solved[i] = plain || arrived(rows.residual[i]);
                t.outside += usize::from(place == NOWHERE);
                if rows.now.solved[i] && tissue {
                    t.residuals.push(rows.residual[i]);
                }
            }
        }
    }

    /// As [`Search::settle`], of one voxel that may lie in a bone or that the quick search failed at.
    fn settle_one(
        &self,
        y: &Vector3<f64>,
        drawn: &Drop<3>,
        owner: u16,
        i: usize,
        rows: &mut SearchRows,
        t: &mut SearchTally,
    ) {
        let tolerance_mm = self.options.tolerance_mm;
        let quick = One { v: rows.now.v.each_ref().map(|v| v[i]), residual: rows.residual[i], place: rows.place[i] };
        if owner == 0 && f64::from(quick.residual) < tolerance_mm {
            return;
        }
        let found = self.patiently(y, drawn, owner, &quick, t);
        for a in 0..3 {
            rows.now.v[a][i] = found.v[a];
        }
        (rows.residual[i], rows.place[i]) = (found.residual, found.place);
        if f64::from(found.residual) >= tolerance_mm {
            t.unconverged += 1;
            t.tissue += usize::from(self.tissue(found.place));
            t.worst = t.worst.max(f64::from(found.residual));
        }
    }

    /// Whether the model computed a planning voxel.
    fn tissue(&self, place: usize) -> bool {
        self.push.computed.data().get(place).is_some_and(|c| *c)
    }

    /// The place one voxel outside the planning scan that is nearest to an index inside it.
    fn beyond(&self, at: &Vector3<f64>) -> Vector3<f64> {
        let grid = self.push.displacement.grid();
        let faces =
            (0..3).flat_map(|a| [(a, -1.0, at[a] + 1.0), (a, grid.size()[a] as f64, grid.size()[a] as f64 - at[a])]);
        let nearest = faces.min_by(|x, y| (x.2 * grid.spacing()[x.0]).total_cmp(&(y.2 * grid.spacing()[y.0])));
        let mut out = *at;
        if let Some((axis, place, _)) = nearest {
            out[axis] = place;
        }
        grid.world(&out).coords
    }

    /// The pre-image inside a bone and its residual, if the field moves it as the bone moves.
    #[inline(always)]
    fn in_bone(&self, y: &Vector3<f64>, owner: u16) -> Option<(Vector3<f64>, f64)> {
        let v = self.bones?.back(owner, y)?;
        let residual = (v + self.robust.value(&Point3::from(y + v))).norm();
        (residual < self.options.tolerance_mm).then_some((v, residual))
    }

    /// What becomes of a voxel that may lie in a bone, or that the quick search failed at.
    fn patiently(&self, y: &Vector3<f64>, drawn: &Drop<3>, owner: u16, quick: &One, t: &mut SearchTally) -> One {
        let tolerance_mm = self.options.tolerance_mm;
        let planning = self.push.displacement.grid();
        let (mut v, mut residual) = (Vector3::from(quick.v.map(f64::from)), f64::from(quick.residual));
        let held = drawn.rank > 0;
        if let Some(bone) = self.in_bone(y, owner) {
            (v, residual) = bone;
        } else if residual >= tolerance_mm && (held || self.tissue(quick.place)) {
            let start =
                if held { -Vector3::from(drawn.value.map(f64::from)) } else { self.guess.value(&Point3::from(*y)) };
            let found = solve(y, start, &self.robust, self.options);
            if found.residual_mm < residual {
                (v, residual) = (found.displacement, found.residual_mm);
            }
        }
        let at = planning.index(&Point3::from(y + v));
        let near = || planning.linear([at.x, at.y, at.z].map(|c| (c + 0.5) as usize));
        let mut place = if planning.contains(&at) { near() } else { NOWHERE };
        let miss = planning.spacing().into_iter().fold(0.0, f64::max);
        if residual >= tolerance_mm && residual > miss && self.tissue(place) {
            // Showing that tissue here would show it twice.
            v = self.beyond(&at) - y;
            place = NOWHERE;
            t.strayed += 1;
            t.tissue += 1;
        }
        One { v: v.map(|v| v as f32).into(), residual: residual as f32, place }
    }
}

/// What was found for a voxel.
struct One {
    /// mm.
    v: [f32; 3],
    /// |v + u(y + v)|, mm.
    residual: f32,
    /// The planning voxel nearest to where `v` leads, by its position in storage; [`NOWHERE`] outside the grid.
    place: usize,
}

/// The rows that a search goes through: what it has found in the last two, and the one at hand.
struct SearchRows {
    before: [SearchRow; 2],
    now: SearchRow,
    /// |v + u(y + v)| in the row at hand, mm.
    residual: Vec<f32>,
    /// The planning voxels that its displacements lead to.
    place: Vec<usize>,
}

/// A row, with room for whole blocks.
struct SearchRow {
    /// Displacements component by component, mm.
    v: [Vec<f32>; 3],
    /// Where they are solutions.
    solved: Vec<bool>,
}

impl SearchRow {
    /// What is not open stays where it is.
    fn rest(&mut self, open: &Range<usize>) {
        for v in &mut self.v {
            v[..open.start].fill(0.0);
            v[open.end..].fill(0.0);
        }
        self.solved[..open.start].fill(true);
        self.solved[open.end..].fill(true);
    }
}

impl SearchRows {
    fn new(voxels: usize) -> Self {
        let room = voxels.next_multiple_of(LANES);
        let row = || SearchRow { v: std::array::from_fn(|_| vec![0.0; room]), solved: vec![false; room] };
        Self { before: [row(), row()], now: row(), residual: vec![0.0; room], place: vec![NOWHERE; room] }
    }

    /// Begins a plane.
    fn forget(&mut self) {
        for row in &mut self.before {
            row.solved.fill(false);
        }
    }

    /// Goes on to the next row.
    fn advance(&mut self) {
        self.before.swap(0, 1);
        std::mem::swap(&mut self.before[1], &mut self.now);
    }
}
