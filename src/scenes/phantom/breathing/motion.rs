//! The true motion of breathing: what lies inside a pleura slides along it, all else rests.
//!
//! Each side has a tube from the apex of the lung down to the belly; its wall is the pleura, and
//! below the diaphragm the peritoneum. Inside, a point is told by its height `z` and by its place
//! `(X, Y)` in the tube's cross-section, which is the unit disc at every height. Motion changes the
//! height and turns the disc, so that the wall goes onto itself: at the wall the motion is
//! tangential at any amplitude, and it has an exact inverse.

use super::super::shape::V3;
use super::super::texture::smoothstep;
use super::options::BreathingOptions;
use crate::geometry::Rigid;
use nalgebra::{Point3, Translation3, UnitQuaternion};

/// Depth over which the tubes widen below the apex, mm.
const WIDENING: f64 = 90.0;
/// Height of the tubes' upper ends, mm.
const APEX: f64 = 0.0;
/// Where motion begins, where it is greatest, and where it has faded again: heights, mm.
const BEGINS: f64 = -15.0;
const GREATEST: f64 = -200.0;
const FADED: f64 = -420.0;
/// Half depth of the tubes front to back, far below the apex, mm.
const HALF_DEPTH: f64 = 78.0;
/// Room between the midplane and a tube at the apex, more than farther below, mm.
const APEX_ROOM: f64 = 30.0;
/// How much lower the diaphragm lies at the wall than in its middle, and behind than in its middle,
/// mm.
const DOME: [f64; 2] = [45.0, 12.0];

/// What moves as one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Bones, chest wall, mediastinum, and what is around them: at rest but for the patient's
    /// setup.
    Rest,
    /// Inside the left pleura and below it.
    Left,
    /// Inside the right pleura and below it.
    Right,
}

impl Part {
    /// The two parts that breathe.
    pub const BREATHING: [Self; 2] = [Self::Left, Self::Right];
}

/// One tube.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tube {
    /// Which part it holds.
    pub(super) part: Part,
    /// 1 on the left (greater x), -1 on the right.
    side: f64,
    /// Room to the midplane, mm.
    room: f64,
    /// Half width far below the apex, mm.
    half_width: f64,
    /// Height of the dome of the diaphragm, mm.
    dome: f64,
}

/// The tubes: the heart leaves less room on the left, the liver less height on the right.
pub(super) const TUBES: [Tube; 2] = [
    Tube { part: Part::Left, side: 1.0, room: 26.0, half_width: 50.0, dome: -190.0 },
    Tube { part: Part::Right, side: -1.0, room: 14.0, half_width: 56.0, dome: -180.0 },
];

/// Share of the full width that a tube has at a height.
pub(super) fn widening(z: f64) -> f64 {
    (1.0 - (-2.0 * (APEX - z).max(0.0) / WIDENING).exp()).sqrt()
}

/// A place in a tube: in the unit disc, and the height.
#[derive(Debug, Clone, Copy)]
pub(super) struct Inner {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) z: f64,
}

impl Inner {
    /// Distance from the disc's middle: 1 at the wall.
    pub(super) fn radius(&self) -> f64 {
        self.x.hypot(self.y)
    }
}

impl Tube {
    /// Middle (left to right) and half axes of the cross-section at a height, mm.
    pub(super) fn section(&self, z: f64) -> (f64, [f64; 2]) {
        let half = self.half_width * widening(z);
        let room = self.room + APEX_ROOM * (-(APEX - z).max(0.0) / WIDENING).exp();
        (self.side * (room + half), [half, HALF_DEPTH * widening(z)])
    }

    /// A point by its place in the tube; `None` at the apex and above it.
    pub(super) fn inner(&self, p: &V3) -> Option<Inner> {
        let (middle, [a, b]) = self.section(p.z);
        (p.z < APEX - 1e-6).then(|| Inner { x: (p.x - middle) / a, y: p.y / b, z: p.z })
    }

    /// The point at a place.
    pub(super) fn outer(&self, at: &Inner) -> V3 {
        let (middle, [a, b]) = self.section(at.z);
        V3::new(middle + at.x * a, at.y * b, at.z)
    }

    /// Distance to the wall to first order, mm, negative inside.
    pub(super) fn distance(&self, p: &V3) -> f64 {
        let Some(at) = self.inner(p) else { return (p.z - APEX).max(f64::EPSILON) };
        let (_, [a, b]) = self.section(p.z);
        let r = at.radius();
        let slope = (at.x / a).hypot(at.y / b) / r.max(1e-9);
        if r < 1e-3 { -a.min(b) } else { (r - 1.0) / slope }
    }

    /// Height of a place above the diaphragm, mm: lung above, liver or stomach below.
    pub(super) fn above_diaphragm(&self, at: &Inner) -> f64 {
        at.z - (self.dome - DOME[0] * (at.x * at.x + at.y * at.y) - DOME[1] * at.y)
    }
}

/// How far motion has grown at a height: 0 at the apex, 1 at the diaphragm, 0 far below.
fn share(z: f64) -> f64 {
    if z > GREATEST { smoothstep(BEGINS, GREATEST, z) } else { smoothstep(FADED, GREATEST, z) }
}

/// The true push map of breathing, exact in both directions, and at the pleura not continuous.
#[derive(Debug, Clone)]
pub struct BreathingMotion {
    amplitude: f64,
    turn: f64,
    setup: Rigid,
}

impl BreathingMotion {
    /// The motion of these options.
    pub(super) fn new(options: &BreathingOptions) -> Self {
        let turn = V3::from(options.setup_rotation_deg.map(f64::to_radians));
        let setup = Rigid::from_parts(
            Translation3::from(V3::from(options.setup_shift_mm)),
            UnitQuaternion::from_scaled_axis(turn),
        );
        Self { amplitude: options.amplitude_mm, turn: options.turn_deg.to_radians(), setup }
    }

    /// The rigid motion of what rests: bones, chest wall and mediastinum.
    pub fn setup(&self) -> &Rigid {
        &self.setup
    }

    /// The part that a planning point belongs to.
    pub fn part(&self, point: &Point3<f64>) -> Part {
        tube_of(&point.coords).map_or(Part::Rest, |(tube, _)| tube.part)
    }

    /// Distance of a planning point to the nearer pleura (below the diaphragm the peritoneum) to
    /// first order, mm, negative inside.
    pub fn pleura_distance(&self, point: &Point3<f64>) -> f64 {
        TUBES.iter().map(|t| t.distance(&point.coords)).fold(f64::MAX, f64::min)
    }

    /// Whether a planning point lies in a lung.
    pub fn in_lung(&self, point: &Point3<f64>) -> bool {
        tube_of(&point.coords).is_some_and(|(tube, at)| tube.above_diaphragm(&at) > 0.0)
    }

    /// Where a planning point goes in the fraction, as a point of its own part.
    pub fn push(&self, point: &Point3<f64>) -> Point3<f64> {
        self.push_as(self.part(point), point)
    }

    /// Where a point of a part goes; the part's motion goes on a little beyond its wall.
    pub fn push_as(&self, part: Part, point: &Point3<f64>) -> Point3<f64> {
        let moved = inner_as(part, &point.coords).map(|(tube, at)| tube.outer(&self.forward(&at)).into());
        self.setup * moved.unwrap_or(*point)
    }

    /// Where a fraction point was in planning.
    pub fn pull(&self, point: &Point3<f64>) -> Point3<f64> {
        // The wall goes onto itself, so a point is inside before as it is after.
        let rest = self.setup.inverse() * point;
        self.pull_as(self.part(&rest), point)
    }

    /// Where a fraction point of a part was in planning.
    pub fn pull_as(&self, part: Part, point: &Point3<f64>) -> Point3<f64> {
        let rest = self.setup.inverse() * point;
        inner_as(part, &rest.coords).map_or(rest, |(tube, at)| tube.outer(&self.backward(&at)).into())
    }

    /// How much larger tissue is in the fraction: the determinant of the push map's derivative in
    /// the part of a planning point.
    pub fn jacobian(&self, point: &Point3<f64>) -> f64 {
        self.jacobian_as(self.part(point), point)
    }

    /// The same for a point of a part, also a little beyond its wall.
    pub(super) fn jacobian_as(&self, part: Part, point: &Point3<f64>) -> f64 {
        inner_as(part, &point.coords).map_or(1.0, |(tube, at)| self.growth(&tube, &at))
    }

    /// The determinant at a place of a tube.
    fn growth(&self, tube: &Tube, at: &Inner) -> f64 {
        let area = |z: f64| {
            let (_, [a, b]) = tube.section(z);
            a * b
        };
        let h = 1e-3;
        let along = |z: f64| z - self.depth(at) * share(z);
        area(along(at.z)) / area(at.z) * (along(at.z + h) - along(at.z - h)) / (2.0 * h)
    }

    /// How far the diaphragm goes down below a place of the disc, mm: most in the middle and
    /// behind, least in front.
    fn depth(&self, at: &Inner) -> f64 {
        self.amplitude * (1.0 - 0.3 * (at.x * at.x + at.y * at.y) + 0.2 * at.y)
    }

    /// Turn of the disc at a height, radians.
    fn angle(&self, z: f64, radius: f64) -> f64 {
        self.turn * share(z) * radius * radius
    }

    fn forward(&self, at: &Inner) -> Inner {
        let z = at.z - self.depth(at) * share(at.z);
        turned(at, self.angle(z, at.radius()), z)
    }

    fn backward(&self, at: &Inner) -> Inner {
        let place = turned(at, -self.angle(at.z, at.radius()), at.z);
        // The height rises all the way (options are checked for it), so halving finds the one
        // before.
        let depth = self.depth(&place);
        let (mut low, mut high) = (at.z - depth.abs() - 1.0, at.z + depth.abs() + 1.0);
        for _ in 0..60 {
            let z = 0.5 * (low + high);
            if z - depth * share(z) < at.z { low = z } else { high = z }
        }
        Inner { z: 0.5 * (low + high), ..place }
    }
}

fn turned(at: &Inner, angle: f64, z: f64) -> Inner {
    let (sin, cos) = angle.sin_cos();
    Inner { x: cos * at.x - sin * at.y, y: sin * at.x + cos * at.y, z }
}

/// The tube that a point lies in.
fn tube_of(p: &V3) -> Option<(Tube, Inner)> {
    TUBES.iter().find_map(|tube| tube.inner(p).filter(|at| at.radius() < 1.0).map(|at| (*tube, at)))
}

/// The tube of a part, and a point's place in it.
fn inner_as(part: Part, p: &V3) -> Option<(Tube, Inner)> {
    let tube = TUBES.iter().find(|t| t.part == part)?;
    tube.inner(p).map(|at| (*tube, at))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    fn motion(amplitude_mm: f64) -> BreathingMotion {
        BreathingMotion::new(&BreathingOptions { amplitude_mm, ..BreathingOptions::default() })
    }

    /// Points all over the field of view.
    fn points() -> impl Iterator<Item = Point3<f64>> {
        (0..6000).map(|n| {
            let at = [n % 24, n / 24 % 16, n / 384].map(f64::from);
            Point3::new(-138.0 + 12.1 * at[0], -90.0 + 12.3 * at[1], -290.0 + 19.7 * at[2])
        })
    }

    #[test]
    fn pull_undoes_push_in_each_part_and_no_point_changes_its_part() {
        for amplitude in [20.0, -35.0, 60.0] {
            let motion = motion(amplitude);
            let mut seen = [0; 3];
            for x in points() {
                let (part, y) = (motion.part(&x), motion.push(&x));
                let back = motion.pull(&y);
                assert!((back - x).norm() < 1e-9, "{amplitude}: {x} came back as {back}");
                assert!((motion.push(&motion.pull(&x)) - x).norm() < 1e-9, "{amplitude}: {x}");
                let rest = motion.setup().inverse() * y;
                assert_eq!(motion.part(&rest), part, "{amplitude}: {x}");
                seen[part as usize] += 1;
                if part == Part::Rest {
                    assert!((motion.setup() * x - y).norm() < 1e-12);
                }
            }
            assert!(seen.iter().all(|n| *n > 300), "{seen:?}");
        }
    }

    #[test]
    fn at_the_pleura_the_motion_jumps_along_it_and_not_across() {
        let motion = motion(20.0);
        let mut longest: f64 = 0.0;
        for tube in &TUBES {
            for z in [-40.0, -90.0, -150.0, -200.0, -240.0] {
                for angle in 0..24 {
                    let (y, x) = (f64::from(angle) * std::f64::consts::TAU / 24.0).sin_cos();
                    let wall = Point3::from(tube.outer(&Inner { x, y, z }));
                    let [inner, outer] = [tube.part, Part::Rest].map(|part| motion.push_as(part, &wall));
                    // The lung's side of the wall lies on the wall again, elsewhere.
                    let rest = motion.setup().inverse() * inner;
                    assert!(tube.distance(&rest.coords).abs() < 1e-9, "{rest}");
                    longest = longest.max((inner - outer).norm());
                }
            }
        }
        assert!(longest > 15.0, "{longest}");
        // Of a small motion the part across the wall vanishes beside the part along it.
        let small = self::motion(0.2);
        let small = BreathingMotion { turn: small.turn * 0.01, setup: Rigid::identity(), ..small };
        for tube in &TUBES {
            for (angle, z) in [(0.3f64, -70.0), (1.9, -120.0), (3.3, -180.0), (4.8, -220.0), (5.9, -90.0)] {
                let (y, x) = angle.sin_cos();
                let wall = tube.outer(&Inner { x, y, z });
                let slip = small.push_as(tube.part, &wall.into()) - Point3::from(wall);
                let h = 1e-3;
                let normal = V3::from_fn(|a, _| {
                    let mut e = V3::zeros();
                    e[a] = h;
                    tube.distance(&(wall + e)) - tube.distance(&(wall - e))
                })
                .normalize();
                assert!(slip.norm() > 0.02 && normal.dot(&slip).abs() < 0.01 * slip.norm(), "{wall}: {slip}");
            }
        }
    }

    #[test]
    fn within_a_part_the_map_is_smooth_and_its_jacobian_is_the_one_it_says() {
        for amplitude in [20.0, -60.0, 60.0] {
            let motion = motion(amplitude);
            let (mut least, mut greatest) = (f64::MAX, f64::MIN);
            for x in points().filter(|x| motion.pleura_distance(x).abs() > 1.0 && x.z < -3.0) {
                let h = 1e-3;
                let column = |a: usize| {
                    let mut e = V3::zeros();
                    e[a] = h;
                    (motion.push(&(x + e)) - motion.push(&(x - e))) / (2.0 * h)
                };
                let derivative = Matrix3::from_columns(&[column(0), column(1), column(2)]);
                let (own, said) = (derivative.determinant(), motion.jacobian(&x));
                assert!((own - said).abs() < 1e-4 * said, "{amplitude}: {x}: {own} {said}");
                (least, greatest) = (least.min(own), greatest.max(own));
            }
            assert!(least > 0.3 && greatest < 1.8, "{amplitude}: {least} to {greatest}");
            assert!(greatest - least > 0.1, "something breathes");
        }
    }

    #[test]
    fn tubes_keep_apart_and_breathing_in_fills_the_lung() {
        for x in points() {
            let inside = TUBES.iter().filter(|t| t.distance(&x.coords) < 0.0).count();
            assert!(inside < 2, "{x}");
        }
        let motion = motion(20.0);
        let lung: Vec<Point3<f64>> = points().filter(|x| motion.in_lung(x)).collect();
        let mean = lung.iter().map(|x| motion.jacobian(x)).sum::<f64>() / lung.len() as f64;
        assert!((1.05..1.3).contains(&mean), "{mean}");
        let down = lung.iter().map(|x| x.z - (motion.setup().inverse() * motion.push(x)).z).fold(0.0, f64::max);
        assert!((15.0..21.0).contains(&down), "{down}");
    }
}
