//! Superposition and prioritisation where bones hand on their motion undiminished: waves over packed cells, blended row by
//! row, along which a rigid motion's displacement is linear.

use super::super::lattice::Lattice;
use super::super::lattice::Node;
use super::super::variants::{Combination, Variant};
use super::average::{FirstWave, each_active, is_usual, usual_weight, weight, weighted_mean};
use super::carry::Initiators;
use super::front::{FrontRules, Source, TICKS};
use super::shortest::arrival::{Arrival, Medium, came};
use super::shortest::brick::{Brick, CELLS, TILE, value};
use crate::geometry::{Rigid, vectorised};
use nalgebra::Vector3;
use rayon::prelude::*;

/// As [`super::super::spread`], and how many waves were pruned; with prioritisation none is.
pub(in crate::chainmail) fn spread(
    lattice: &Lattice,
    bones: &Initiators<'_>,
    variant: &Variant,
) -> (Vec<Option<[f32; 3]>>, usize) {
    let medium = Medium::new(lattice, FrontRules::of(variant));
    match variant.combination {
        Combination::Superposition => superpose(&medium, lattice, bones, variant),
        Combination::Prioritisation => {
            let wave = medium.first_arrivals();
            let first = each_active(lattice, bones, |_, voxel| {
                let (_, bone) = wave.at(medium.cell(voxel))?;
                let x = lattice.grid.centre(voxel);
                let u = bones.transforms[usize::from(bone)] * x - x;
                Some([u.x as f32, u.y as f32, u.z as f32])
            });
            (first, 0)
        }
    }
}

/// As [`super::super::first_wave`].
pub(in crate::chainmail) fn first_wave(lattice: &Lattice, variant: &Variant) -> FirstWave {
    let medium = Medium::new(lattice, FrontRules::of(variant));
    let wave = medium.first_arrivals();
    let (mut time, mut owner) = (vec![f64::INFINITY; lattice.node.len()], vec![None; lattice.node.len()]);
    for &n in &lattice.active {
        let n = n as usize;
        let cell = medium.cell(lattice.grid.voxel(n));
        (time[n], owner[n]) = match lattice.node[n] {
            Node::Bone(b) => (0.0, Some(b)),
            _ => match wave.at(cell) {
                Some((t, bone)) => (f64::from(t) / TICKS, Some(bone)),
                None => continue,
            },
        };
    }
    let soft = |n: &u32| lattice.node[*n as usize] == Node::Soft && time[*n as usize].is_finite();
    let mut order: Vec<u32> = lattice.active.iter().copied().filter(soft).collect();
    order.sort_by(|a, b| time[*a as usize].total_cmp(&time[*b as usize]));
    FirstWave { order, time, owner, angle: Vec::new() }
}

/// Waves are kept up to this many bytes: those of 42 bones in the thesis's scan take 60 MB.
const MOST_KEPT: usize = 128 << 20;

/// When each bone's wave comes to each element.
pub(in crate::chainmail) struct Waves {
    medium: Medium,
    /// In the order of the skeleton.
    each: Vec<Kept>,
}

/// A wave that is kept: what it brought to the bricks that hold soft tissue, in their order.
struct Kept {
    times: Vec<Brick<i32>>,
    limit: i32,
    pruned: bool,
}

/// When a wave came.
trait Times: Sync {
    /// To the cells of a brick, which has this place among those that hold soft tissue.
    fn at(&self, brick: usize, place: usize) -> &Brick<i32>;
    /// The latest time that counts.
    fn limit(&self) -> i32;
}

impl Times for Kept {
    #[inline(always)]
    fn at(&self, _: usize, place: usize) -> &Brick<i32> {
        &self.times[place]
    }

    fn limit(&self) -> i32 {
        self.limit
    }
}

impl Times for Arrival {
    #[inline(always)]
    fn at(&self, brick: usize, _: usize) -> &Brick<i32> {
        &self.times[brick]
    }

    fn limit(&self) -> i32 {
        self.limit
    }
}

impl Waves {
    /// Runs the waves of so many bones; `None` where they would take too much room.
    pub(in crate::chainmail) fn new(lattice: &Lattice, bones: u16, variant: &Variant) -> Option<Self> {
        let medium = Medium::new(lattice, FrontRules::of(variant));
        let bricks = medium.soft_bricks();
        if bricks.len() * usize::from(bones) * size_of::<Brick<i32>>() > MOST_KEPT {
            return None;
        }
        let latest = latest(&medium, variant);
        let keep = |wave: &mut Arrival, bone| {
            medium.times_into(wave, Source::Bone(bone), latest.as_deref());
            let times = bricks.iter().map(|&brick| wave.times[brick]).collect();
            Kept { times, limit: wave.limit, pruned: wave.pruned }
        };
        let each = (0..bones).into_par_iter().map_init(Arrival::default, keep).collect();
        Some(Self { medium, each })
    }

    /// As [`spread`].
    pub(in crate::chainmail) fn blend(
        &self,
        lattice: &Lattice,
        bones: &Initiators<'_>,
        variant: &Variant,
    ) -> (Vec<Option<[f32; 3]>>, usize) {
        let mut sums = WaveSums::new(&self.medium, lattice, variant.exponent);
        sums.add(&bones.transforms.iter().zip(&self.each).collect::<Vec<_>>());
        (sums.blended(bones), self.each.iter().filter(|wave| wave.pruned).count())
    }
}

/// The latest time at each cell, where waves are pruned.
fn latest(medium: &Medium, variant: &Variant) -> Option<Vec<Brick<i32>>> {
    (variant.prune_ratio > 1.0).then(|| medium.latest(&medium.times(Source::AnyBone, None), variant.prune_ratio))
}

/// The latest time at each node, where waves are pruned.
pub(in crate::chainmail) fn latest_at_nodes(lattice: &Lattice, variant: &Variant) -> Option<Vec<u32>> {
    let medium = Medium::new(lattice, FrontRules::of(variant));
    let latest = latest(&medium, variant)?;
    let of = |&n: &u32| value(&latest, medium.cell(lattice.grid.voxel(n as usize))) as u32;
    Some(lattice.on_all_nodes(lattice.active.iter().map(of), 0))
}

/// Eq. 5.7: some waves at a time for each thread, added brick by brick.
fn superpose(
    medium: &Medium,
    lattice: &Lattice,
    bones: &Initiators<'_>,
    variant: &Variant,
) -> (Vec<Option<[f32; 3]>>, usize) {
    let latest = latest(medium, variant);
    let mut pruned = 0;
    let mut sums = WaveSums::new(medium, lattice, variant.exponent);
    let present: Vec<u16> = (0..bones.transforms.len() as u16).collect();
    let mut waves: Vec<Arrival> = Vec::new();
    for group in present.chunks(ABREAST * rayon::current_num_threads()) {
        waves.resize_with(group.len(), Arrival::default);
        let each = waves.par_iter_mut().zip(group);
        each.for_each(|(wave, &b)| medium.times_into(wave, Source::Bone(b), latest.as_deref()));
        let motions = group.iter().map(|&b| &bones.transforms[usize::from(b)]);
        sums.add(&motions.zip(&waves).collect::<Vec<_>>());
        pruned += waves.iter().filter(|wave| wave.pruned).count();
    }
    (sums.blended(bones), pruned)
}

/// Waves on their way for each thread, before they are added: with two, no thread waits long for the other.
const ABREAST: usize = 2;

/// Weights and weighted displacements of a brick's cells.
#[derive(Clone, Copy, Default)]
struct Sum {
    weight: Brick<f64>,
    moved: [Brick<f64>; 3],
}

/// The sums of the waves so far, in the bricks that hold soft tissue.
struct WaveSums<'a> {
    medium: &'a Medium,
    lattice: &'a Lattice,
    exponent: f64,
    /// The bricks, in order.
    bricks: Vec<usize>,
    sums: Vec<Sum>,
}

impl<'a> WaveSums<'a> {
    fn new(medium: &'a Medium, lattice: &'a Lattice, exponent: f64) -> Self {
        let bricks = medium.soft_bricks();
        let sums = bricks.par_iter().map(|_| Sum::default()).collect();
        Self { medium, lattice, exponent, bricks, sums }
    }

    /// Adds waves in their order, whatever the number of threads.
    fn add(&mut self, waves: &[(&Rigid, &impl Times)]) {
        let (medium, lattice, exponent) = (self.medium, self.lattice, self.exponent);
        let lines: Vec<WaveMotion> = waves.iter().map(|(motion, _)| WaveMotion::of(motion, medium, lattice)).collect();
        let parts = self.bricks.par_chunks(PART).zip(self.sums.par_chunks_mut(PART));
        parts.enumerate().for_each(|(part, (bricks, mut sums))| {
            let mut first = part * PART;
            for bricks in bricks.chunk_by(|a, b| a / TILE == b / TILE) {
                let (row, rest) = sums.split_at_mut(bricks.len());
                sums = rest;
                let start = bricks[0] / TILE * TILE;
                let place = medium.bricks.place(start);
                for (motion, (_, wave)) in lines.iter().zip(waves) {
                    let line = motion.along(place);
                    let times = |(&brick, place)| (brick - start, wave.at(brick, place));
                    let each = bricks.iter().zip(first..).map(times).zip(&mut *row);
                    if is_usual(exponent) {
                        vectorised(
                            #[inline(always)]
                            || line.add(wave.limit(), each, usual_weight),
                        );
                    } else {
                        line.add(wave.limit(), each, |t| weight(t, exponent));
                    }
                }
                first += bricks.len();
            }
        });
    }

    fn blended(&self, bones: &Initiators<'_>) -> Vec<Option<[f32; 3]>> {
        let mut place = vec![0u32; self.medium.bricks.len()];
        for (at, &brick) in self.bricks.iter().enumerate() {
            place[brick] = at as u32;
        }
        each_active(self.lattice, bones, |_, voxel| {
            let (brick, at) = {
                let cell = self.medium.cell(voxel);
                (cell / CELLS, cell % CELLS)
            };
            let Sum { weight, moved: [x, y, z] } = &self.sums[place[brick] as usize];
            weighted_mean([weight, x, y, z].map(|sum| sum.0[at]))
        })
    }
}

/// Bricks that a thread adds at a time.
const PART: usize = 4096;

/// A bone's motion, whose displacement is linear in a cell's place.
struct WaveMotion {
    /// Displacement of the first cell of the medium.
    first: Vector3<f64>,
    /// What is added to it from a cell to the next along each axis.
    step: [Vector3<f64>; 3],
}

impl WaveMotion {
    fn of(motion: &Rigid, medium: &Medium, lattice: &Lattice) -> Self {
        let x = lattice.grid.centre(medium.low());
        let step = [0, 1, 2].map(|a| lattice.grid.step().column(a).into_owned());
        Self { first: motion * x - x, step: step.map(|s| motion.rotation * s - s) }
    }

    /// Along the row of bricks that begins at this cell.
    fn along(&self, [i, j, k]: [usize; 3]) -> WaveLine {
        let mut first = [Brick::default(); 3];
        for at in 0..CELLS {
            let cell = [i + at % 2, j + at / 2 % 2, k + at / 4].map(|c| c as f64);
            let u = self.first + self.step[0] * cell[0] + self.step[1] * cell[1] + self.step[2] * cell[2];
            (0..3).for_each(|a| first[a].0[at] = u[a]);
        }
        WaveLine { first, step: self.step[0] * 2.0 }
    }
}

/// A bone's motion along a row of bricks.
struct WaveLine {
    /// Displacement of the cells of the first brick.
    first: [Brick<f64>; 3],
    /// What is added to it from a brick to the next.
    step: Vector3<f64>,
}

impl WaveLine {
    /// Adds a wave's weights and weighted displacements to bricks at some places in the row, by its times there.
    #[inline(always)]
    fn add<'s>(
        &self,
        limit: i32,
        bricks: impl Iterator<Item = ((usize, &'s Brick<i32>), &'s mut Sum)>,
        weigh: impl Fn(f64) -> f64,
    ) {
        for ((i, times), sum) in bricks {
            let (mut w, mut any) = (Brick::<f64>::default(), false);
            for l in 0..CELLS {
                any |= came(times.0[l], limit);
            }
            // Most of a wave that is pruned early.
            if !any {
                continue;
            }
            for l in 0..CELLS {
                let time = times.0[l];
                w.0[l] = f64::from(came(time, limit)) * weigh(f64::from(time.max(1)));
            }
            for l in 0..CELLS {
                sum.weight.0[l] += w.0[l];
            }
            for a in 0..3 {
                let (first, ahead) = (self.first[a], self.step[a] * i as f64);
                let moved = &mut sum.moved[a];
                for l in 0..CELLS {
                    moved.0[l] += w.0[l] * (first.0[l] + ahead);
                }
            }
        }
    }
}
