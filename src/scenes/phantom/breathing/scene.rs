//! Anatomy of the breathing phantom: a chest with ribs, spine and sternum around two lungs, liver
//! and stomach below.

use super::super::build::{bar, cap, chain, ell};
use super::super::cells::Cells;
use super::super::shape::{Section, Shape, V3};
use super::super::solid::{BoneSolid, Fill, Solid};
use super::super::texture::{self, smoothstep};
use super::super::voxel::Voxel;
use super::motion::{Inner, Part, TUBES, Tube, widening};

/// How far from a bone its distance is still known, mm.
const BONE_REACH: f64 = 8.0;
/// Thoracic vertebrae, and pairs of ribs.
const VERTEBRAE: usize = 12;
const RIBS: usize = 10;
/// Height of the first vertebra, and distance from one to the next, mm.
const FIRST: f64 = 2.0;
const NEXT: f64 = 23.5;
/// From the tubes' widest place to the middle of the ribs: sidewards, and front to back, mm.
const CAGE: [f64; 2] = [10.5, 15.5];
/// Half the thickness of the muscle around the ribs, mm.
const WALL: f64 = 7.0;
/// Width of the lungs' vessels, against those of the phantom of head and neck.
const VESSELS: f64 = 3.0;
/// Exponent of the chest's cross-sections.
const SQUARE: f64 = 3.0;

/// HU and bone label of any planning point, and of a moved one.
#[derive(Debug, Clone)]
pub(super) struct ChestScene {
    bones: Vec<BoneSolid>,
    owners: Vec<u16>,
    shapes: Vec<Shape>,
    cells: Cells,
    skin: Shape,
    cage: Shape,
    edge: f64,
}

/// What is at a point.
pub(super) struct ChestSample {
    /// HU.
    pub(super) hu: f64,
    /// Share of patient.
    pub(super) cover: f64,
    /// Label of the bone, 0 outside bone.
    pub(super) label: u16,
}

/// Half axes of the rib cage's middle at a height, mm.
fn cage(z: f64) -> [f64; 2] {
    let wide = TUBES.iter().map(|t| {
        let (middle, [half, _]) = t.section(z);
        middle.abs() + half
    });
    let (_, [_, deep]) = TUBES[0].section(z);
    [wide.fold(0.0, f64::max) + CAGE[0], deep + CAGE[1]]
}

/// Cross-sections from above the apex to below the image, at `half` axes `[sidewards, front,
/// back]`.
fn loft(half: impl Fn(f64) -> [f64; 3]) -> Shape {
    let section = |n: i32| {
        let z = f64::from(6 - n) * 10.0 - 5.0;
        let [side, front, back] = half(z);
        Section { z, middle: 0.0, half: side, front: -front, back, power: SQUARE }
    };
    Shape::Loft { sections: (0..50).map(section).collect(), x: 0.0, offset: 0.0 }
}

fn vertebra(n: usize) -> BoneSolid {
    let z = FIRST - NEXT * n as f64;
    let mut shapes = vec![ell([0.0, 62.0, z], [18.5, 15.0, 11.5])];
    for side in [-1.0, 1.0] {
        shapes.push(cap([10.0 * side, 72.0, z + 3.0], [13.0 * side, 88.0, z + 1.0], 4.5, 4.5));
        shapes.push(cap([13.0 * side, 88.0, z + 1.0], [0.0, 99.0, z - 3.0], 4.0, 4.5));
        shapes.push(cap([13.0 * side, 88.0, z + 1.0], [33.0 * side, 94.0, z], 4.5, 4.0));
    }
    shapes.push(cap([0.0, 99.0, z - 3.0], [0.0, 112.0, z - 9.0], 4.0, 3.5));
    BoneSolid::new(format!("vertebrae_T{}", n + 1), Solid::of(shapes)).filled(1.6, 800.0, 220.0)
}

/// A rib: from beside its vertebra around the chest, downwards to the front.
fn rib(n: usize, side: f64) -> BoneSolid {
    let start = FIRST + 4.0 - NEXT * n as f64;
    // The lower ones end farther from the sternum.
    let end: f64 = if n < 7 { -66.0 } else { -66.0 + 18.0 * (n - 6) as f64 };
    let drop = 30.0 + 6.0 * (n as f64).min(7.0);
    let knots = (0..=16).map(|step| {
        let t = f64::from(step) / 16.0;
        let angle = (68.0 + (end - 68.0) * t).to_radians();
        let z = start - drop * t;
        let [a, b] = cage(z.min(-6.0));
        let (sin, cos) = angle.sin_cos();
        let power = 2.0 / SQUARE;
        [side * a * cos.abs().powf(power), b * sin.abs().powf(power) * sin.signum(), z, 4.6]
    });
    let mut line = vec![[27.0 * side, 68.0, start, 4.0]];
    line.extend(knots);
    let name = format!("rib_{}_{}", if side > 0.0 { "left" } else { "right" }, n + 1);
    BoneSolid::new(name, Solid::of(chain(&line))).filled(1.4, 900.0, 260.0)
}

fn sternum() -> BoneSolid {
    let front = |z: f64| -cage(z)[1];
    let shapes = [bar([0.0, front(-48.0), -48.0], [0.0, front(-165.0), -165.0], 15.0, 6.0)];
    BoneSolid::new("sternum", Solid::of(shapes)).filled(1.5, 700.0, 180.0)
}

impl ChestScene {
    pub(super) fn new(edge: f64) -> Self {
        let mut bones: Vec<BoneSolid> = (0..VERTEBRAE).map(vertebra).collect();
        bones.extend((0..RIBS).flat_map(|n| [rib(n, 1.0), rib(n, -1.0)]));
        bones.push(sternum());
        let (mut owners, mut shapes) = (Vec::new(), Vec::new());
        for (owner, bone) in (0u16..).zip(&bones) {
            for (_, shape) in &bone.solid.parts {
                owners.push(owner);
                shapes.push(shape.clone());
            }
        }
        let within = [V3::new(-200.0, -140.0, -360.0), V3::new(200.0, 160.0, 60.0)];
        let cells = Cells::new(within, shapes.iter(), BONE_REACH);
        let skin = loft(|z| {
            let wide = widening(z);
            [84.0 + 82.0 * wide, 64.0 + 52.0 * wide, 113.0 + 14.0 * wide]
        });
        let wall = loft(|z| {
            let [a, b] = cage(z);
            [a, b, b]
        });
        Self { bones, owners, shapes, cells, skin, cage: wall, edge }
    }

    /// The bones; label = position + 1.
    pub(super) fn bones(&self) -> &[BoneSolid] {
        &self.bones
    }

    /// The nearest bone within reach and its distance, mm.
    pub(super) fn bone(&self, p: &V3) -> Option<(u16, f64)> {
        let cell = self.cells.cell(p)?;
        let distance = |n: &u32| (self.owners[*n as usize], self.shapes[*n as usize].distance(p));
        self.cells.parts(cell).iter().map(distance).min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// What is at a point at rest. `before` gives, for a part that breathes, where the point was
    /// and how much its tissue has grown since.
    pub(super) fn sample(&self, p: &V3, before: impl Fn(Part) -> (V3, f64)) -> ChestSample {
        let cover = self.cover(self.skin.distance(p));
        if cover <= 0.0 {
            return ChestSample { hu: -1000.0, cover, label: 0 };
        }
        let nearest = TUBES.iter().map(|t| (t, t.distance(p))).min_by(|a, b| a.1.total_cmp(&b.1));
        let inside = nearest.map_or(0.0, |(_, d)| self.cover(d));
        let (mut hu, mut label) = (0.0, 0);
        if inside < 1.0 {
            let (wall, bone) = self.wall(p);
            hu += (1.0 - inside) * wall;
            label = bone;
        }
        if let Some((tube, _)) = nearest.filter(|_| inside > 0.0) {
            let (was, growth) = before(tube.part);
            hu += inside * tube.inner(&was).map_or(40.0, |at| self.organ(tube, &at, &was, growth));
        }
        ChestSample { hu: -1000.0 + (hu + 1000.0) * cover, cover, label }
    }

    /// Mean HU of a voxel whose middle is at `p` at rest, from the HU at places about it; none where its middle tells all.
    pub(super) fn over(&self, voxel: &Voxel, p: &V3, at: impl Fn(&V3) -> f64) -> Option<f64> {
        let places = voxel.places(self.bone(p)?.1);
        (!places.is_empty()).then(|| places.iter().map(at).sum::<f64>() / places.len() as f64)
    }

    /// Share covered by a part whose surface is `d` mm away.
    fn cover(&self, d: f64) -> f64 {
        smoothstep(0.5 * self.edge, -0.5 * self.edge, d)
    }

    /// HU and bone label outside of the tubes.
    fn wall(&self, p: &V3) -> (f64, u16) {
        let (muscle, fat) = (Fill::Muscle.hu(p, 0.0), texture::fat(p));
        let cage = self.cage.distance(p);
        // Inside of the ribs lies the mediastinum, or what the belly holds between the tubes.
        let soft = if cage < 0.0 { self.mix(fat, Fill::Organ(42.0).hu(p, 0.0), cage + WALL) } else { fat };
        let mut hu = self.mix(soft, muscle, cage.abs() - WALL);
        // Muscles of the back beside the spine.
        let back = Shape::distance(&ell([0.0, 96.0, p.z], [62.0, 22.0, 40.0]), p);
        hu = self.mix(hu, muscle, back);
        let skin = self.skin.distance(p);
        hu = self.mix(hu, 8.0, -2.0 - skin);
        match self.bone(p) {
            Some((bone, d)) => {
                let own = self.bones[usize::from(bone)].hu(p, -d, f64::MIN);
                (self.mix(hu, own, d), if d < 0.0 { bone + 1 } else { 0 })
            }
            None => (hu, 0),
        }
    }

    /// HU inside of a tube: `was` is the place before the motion.
    fn organ(&self, tube: &Tube, at: &Inner, was: &V3, growth: f64) -> f64 {
        let above = tube.above_diaphragm(at);
        // Vessels neither gain air nor lose it.
        let (vessel, thin) = (texture::lung_vessel(was, VESSELS), texture::lung_vessel(was, 1.0));
        let air = -1000.0 + (texture::lung(was) - 620.0 * thin + 1000.0) / growth;
        let lung = air + (20.0 - air) * vessel;
        let below = match tube.part {
            Part::Right => Fill::Organ(64.0).hu(was, 0.0),
            _ => Fill::Organ(28.0).hu(was, 0.0),
        };
        // The dome is steep at the wall: its distance is somewhat less than the height over it.
        self.mix(lung, below, 0.8 * above)
    }

    /// `under`, covered by what has its surface `d` mm away.
    fn mix(&self, under: f64, over: f64, d: f64) -> f64 {
        under + (over - under) * self.cover(d)
    }
}
