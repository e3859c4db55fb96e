//! The analytic anatomy: HU and bone label of any planning-space point.

use super::asymmetry::drawn_at;
use super::cells::Cells;
use super::outline::{self, OutlineCouch};
use super::shape::{Bounds, Shape, V3};
use super::solid::{BoneSolid, Fill, Gather, Solid, SolidRole, SolidTissue};
use super::texture::smoothstep;
use super::voxel::Voxel;
use super::{head_bones, head_tissue, spine, trunk_bones, trunk_tissue};
use nalgebra::Point3;

/// Reach of a bone's cell lists: how far from a bone its distance is still known, mm.
pub(super) const BONE_REACH: f64 = 10.0;
/// Least gap between two bones, mm: overlapping solids are parted so that no point is in two bones.
const JOINT_SPACE: f64 = 2.0;
/// Width of the fat planes between muscles, mm.
const FASCIA: f64 = 1.4;
/// How far muscles swell into the fat between them, mm.
const MUSCLE_FILL: f64 = 2.5;
/// Depth to which the outline's distance is kept, mm: below it everything is inside.
const SKIN_REACH: f64 = 30.0;
/// Bones that can be near one point.
const MOST_NEAR: usize = 16;

/// Head, neck and shoulders as analytic solids, in the planning posture. LPS mm about the atlanto-occipital joint.
#[derive(Debug, Clone)]
pub struct Anatomy {
    bones: Vec<BoneSolid>,
    bone_parts: Vec<AnatomyPart>,
    bone_cells: Cells,
    tissues: Vec<SolidTissue>,
    tissue_parts: Vec<AnatomyPart>,
    tissue_cells: Cells,
    skin: Vec<(f64, Shape)>,
    skin_cells: Cells,
    depth: Vec<Depth>,
    couch: OutlineCouch,
    edge: f64,
    fat: f64,
}

/// A shape of a solid, by position.
#[derive(Debug, Clone, Copy)]
struct AnatomyPart {
    owner: u16,
    index: u16,
}

/// Where a cell lies with respect to the skin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Depth {
    Air,
    Skin,
    Inside,
}

/// What is seen of the patient.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Seen {
    /// Share of patient.
    pub(super) cover: f64,
    /// HU of that share.
    pub(super) hu: f64,
    /// Label of the bone in the middle, 0 outside bone.
    pub(super) label: u16,
    /// Signed distance of the middle to the nearest bone, mm; infinite far from all.
    to_bone: f64,
}

/// What is at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// HU.
    pub hu: f64,
    /// Label of the bone, 0 outside bone.
    pub label: u16,
}

/// Bones near a point with the signed distance to each (joint gaps taken out), mm.
#[derive(Debug, Clone, Copy)]
pub(super) struct Near {
    list: [(u16, f64); MOST_NEAR],
    len: usize,
    tooth: f64,
}

impl Near {
    /// The bones, by position in the list of bones.
    pub(super) fn bones(&self) -> &[(u16, f64)] {
        &self.list[..self.len]
    }
    /// The nearest bone.
    fn nearest(&self) -> Option<(u16, f64)> {
        self.bones().iter().copied().min_by(|a, b| a.1.total_cmp(&b.1))
    }
}

fn parts<'a>(solids: impl Iterator<Item = &'a Solid>) -> Vec<AnatomyPart> {
    let of = |(owner, s): (u16, &Solid)| (0..s.parts.len() as u16).map(move |index| AnatomyPart { owner, index });
    (0u16..).zip(solids).flat_map(of).collect()
}

impl Anatomy {
    /// The anatomy; `edge` is the width in mm over which tissues mix at their borders (partial volume), `fat` the thickness of a
    /// layer that is put around it.
    pub fn new(edge: f64, fat: f64) -> Self {
        let mut bones = vec![head_bones::skull(), head_bones::mandible(), head_bones::hyoid()];
        bones.extend(spine::vertebrae());
        bones.extend(trunk_bones::bones());
        let mut tissues = head_tissue::muscles();
        tissues.extend(trunk_tissue::muscles());
        tissues.push(trunk_tissue::chest_wall());
        tissues.extend(trunk_tissue::organs());
        tissues.extend(head_tissue::organs());
        tissues.extend(head_tissue::airway());
        let skin = outline::skin();
        let within: Bounds = [V3::new(-290.0, -190.0, -500.0), V3::new(290.0, 170.0, 170.0)];
        let bone_cells = Cells::new(within, bones.iter().flat_map(|b| b.solid.parts.iter().map(|p| &p.1)), BONE_REACH);
        let tissue_cells = Cells::new(
            within,
            tissues.iter().flat_map(|t| t.solid.parts.iter().map(|p| &p.1)),
            edge + MUSCLE_FILL + 2.0,
        );
        let skin_cells = Cells::new(within, skin.iter().map(|s| &s.1), SKIN_REACH + 20.0 + fat);
        let mut out = Self {
            bone_parts: parts(bones.iter().map(|b| &b.solid)),
            tissue_parts: parts(tissues.iter().map(|t| &t.solid)),
            bones,
            bone_cells,
            tissues,
            tissue_cells,
            skin,
            depth: Vec::new(),
            skin_cells,
            couch: OutlineCouch::new(fat),
            edge,
            fat,
        };
        let room = super::cells::CELL;
        let depth = |cell: usize| match out.outline_in(cell, &out.skin_cells.centre(cell)) {
            d if d > room + 3.0 => Depth::Air,
            d if d < -(room + 6.0) => Depth::Inside,
            _ => Depth::Skin,
        };
        out.depth = (0..out.skin_cells.len()).map(depth).collect();
        out
    }

    /// The bones; label = position + 1.
    pub(super) fn bones(&self) -> &[BoneSolid] {
        &self.bones
    }

    /// HU and bone label at a point of the planning space, with the couch in its planning place.
    pub fn sample(&self, point: &Point3<f64>) -> Sample {
        let p = point.coords;
        let Seen { cover, hu, label, .. } = self.patient(&p);
        let outer = if cover < 1.0 { self.couch_hu(&p) } else { 0.0 };
        Sample { hu: outer + (hu - outer) * cover, label }
    }

    /// Signed distance to the skin, mm, negative inside; exact only within 15 mm of it.
    pub fn skin_distance(&self, point: &Point3<f64>) -> f64 {
        self.outline(&drawn_at(&point.coords))
    }

    /// Signed distance to the bone at `position` (label - 1), mm; infinite when farther than about 10 mm.
    pub fn bone_distance(&self, position: usize, point: &Point3<f64>) -> f64 {
        let near = self.near_bones(&point.coords);
        near.bones().iter().find(|b| usize::from(b.0) == position).map_or(f64::INFINITY, |b| b.1)
    }

    /// HU of couch and air alone.
    pub(super) fn couch_hu(&self, p: &V3) -> f64 {
        self.couch.hu(p, || self.outline(&drawn_at(p)), self.edge)
    }

    /// Whether a point is outside the patient by 4 mm at least.
    pub(super) fn outer_air(&self, p: &V3) -> bool {
        self.skin_cells.cell(&drawn_at(p)).is_none_or(|c| self.depth[c] == Depth::Air)
    }

    /// The patient at a point.
    pub(super) fn patient(&self, p: &V3) -> Seen {
        const NOTHING: Seen = Seen { cover: 0.0, hu: -1000.0, label: 0, to_bone: f64::INFINITY };
        let p = &drawn_at(p);
        let Some(cell) = self.skin_cells.cell(p) else { return NOTHING };
        let (cover, skin) = match self.depth[cell] {
            Depth::Air => return NOTHING,
            Depth::Inside => (1.0, 0.0),
            Depth::Skin => {
                let d = self.outline_in(cell, p);
                (self.cover(d), self.cover(-2.0 - d))
            }
        };
        if cover <= 0.0 {
            return NOTHING;
        }
        // From the top layer down, until nothing shows through.
        let near = self.near_drawn(p);
        let mut paint = Paint { hu: 0.0, through: 1.0 };
        let (mut label, mut to_bone) = (0, f64::INFINITY);
        if let Some((bone, d)) = near.nearest() {
            paint.layer(self.cover(d), || self.bones[usize::from(bone)].hu(p, -d, -near.tooth));
            label = if d < 0.0 { bone + 1 } else { 0 };
            to_bone = d;
        }
        self.paint_tissues(cell, p, &mut paint);
        paint.layer(skin, || 8.0);
        paint.layer(1.0, || Fill::Fat.hu(p, 0.0));
        Seen { cover, hu: paint.hu, label, to_bone }
    }

    /// The patient over a voxel: `middle` and `place`, its middle and where a place about it lies, in the planning space.
    pub(super) fn over(&self, voxel: &Voxel, middle: &V3, place: impl Fn(&V3) -> V3) -> Seen {
        let seen = self.patient(middle);
        let places = voxel.places(seen.to_bone);
        if places.is_empty() {
            return seen;
        }
        let (mut cover, mut hu) = (0.0, 0.0);
        for part in places.iter().map(|offset| self.patient(&place(offset))) {
            cover += part.cover;
            hu += part.cover * part.hu;
        }
        let hu = if cover > 0.0 { hu / cover } else { seen.hu };
        Seen { cover: cover / places.len() as f64, hu, ..seen }
    }

    /// Share covered by a part whose surface is `d` mm away.
    fn cover(&self, d: f64) -> f64 {
        if d >= 0.5 * self.edge { 0.0 } else { smoothstep(0.5 * self.edge, -0.5 * self.edge, d) }
    }

    fn paint_tissues(&self, cell: usize, p: &V3, paint: &mut Paint) {
        let list = self.tissue_cells.parts(cell);
        let mut muscle = [f64::MAX; 2];
        let mut end = list.len();
        while end > 0 && paint.through > 0.0 {
            let (owner, from) = group(&self.tissue_parts, list, end);
            let SolidTissue { fill, solid } = &self.tissues[owner];
            let d = gather(p, &self.tissue_parts, &list[from..end], solid).distance();
            end = from;
            if *fill == Fill::Muscle {
                muscle = lowest_two(muscle, d - MUSCLE_FILL);
            } else {
                paint.layer(self.cover(d), || fill.hu(p, -d));
            }
        }
        // Muscles come first in the list, so they lie below all other parts.
        let d = parted(muscle[0], muscle[1], FASCIA);
        paint.layer(self.cover(d), || Fill::Muscle.hu(p, -d));
    }

    /// Bones within [`BONE_REACH`] of a point.
    pub(super) fn near_bones(&self, p: &V3) -> Near {
        self.near_drawn(&drawn_at(p))
    }

    /// The same of a point of the drawing.
    fn near_drawn(&self, p: &V3) -> Near {
        let mut near = Near { list: [(0, 0.0); MOST_NEAR], len: 0, tooth: f64::MAX };
        let Some(cell) = self.bone_cells.cell(p) else { return near };
        let list = self.bone_cells.parts(cell);
        let (mut end, mut two) = (list.len(), [f64::MAX; 2]);
        while end > 0 {
            let (owner, from) = group(&self.bone_parts, list, end);
            let gather = gather(p, &self.bone_parts, &list[from..end], &self.bones[owner].solid);
            end = from;
            let d = gather.distance();
            if d < 2.0 * BONE_REACH && near.len < MOST_NEAR {
                near.list[near.len] = (owner as u16, d);
                near.len += 1;
                two = lowest_two(two, d);
                near.tooth = near.tooth.min(gather.teeth());
            }
        }
        for n in 0..near.len {
            let d = near.list[n].1;
            let other = if d <= two[0] { two[1] } else { two[0] };
            near.list[n].1 = parted(d, other, JOINT_SPACE);
        }
        near
    }

    /// Signed distance to the skin at a point of the drawing.
    fn outline(&self, p: &V3) -> f64 {
        self.skin_cells.cell(p).map_or(SKIN_REACH, |cell| self.outline_in(cell, p))
    }

    fn outline_in(&self, cell: usize, p: &V3) -> f64 {
        let lean = self.skin_cells.parts(cell).iter().fold(SKIN_REACH + self.fat, |d, &n| {
            let (width, shape) = &self.skin[n as usize];
            outline::blend(d, shape.distance(p), *width)
        });
        lean - self.fat
    }
}

/// What is seen so far from the top layer down, and the share that lower layers still show.
struct Paint {
    hu: f64,
    through: f64,
}

impl Paint {
    /// A layer that covers the share `cover` of what is below it.
    fn layer(&mut self, cover: f64, hu: impl FnOnce() -> f64) {
        if cover > 0.0 && self.through > 0.0 {
            self.hu += self.through * cover * hu();
            self.through *= 1.0 - cover;
        }
    }
}

/// The solid that owns the entry before `end` of a cell's list, and where its entries begin.
fn group(parts: &[AnatomyPart], list: &[u32], end: usize) -> (usize, usize) {
    let owner = |n: usize| parts[list[n] as usize].owner;
    let last = owner(end - 1);
    let from = (0..end).rev().take_while(|&n| owner(n) == last).last().unwrap_or(end - 1);
    (usize::from(last), from)
}

/// Distances of those shapes of a solid that a cell lists.
fn gather(p: &V3, parts: &[AnatomyPart], list: &[u32], solid: &Solid) -> Gather {
    let mut out = Gather::default();
    for n in list {
        let (role, shape): &(SolidRole, Shape) = &solid.parts[usize::from(parts[*n as usize].index)];
        out.visit(*role, shape.distance(p));
    }
    out
}

fn lowest_two([a, b]: [f64; 2], d: f64) -> [f64; 2] {
    if d < a { [d, a] } else { [a, b.min(d)] }
}

/// Distance to a solid after it gave way to its neighbour: between the two stays a gap of `gap` mm.
fn parted(d: f64, neighbour: f64, gap: f64) -> f64 {
    d.max((d - neighbour + gap) * 0.5)
}
