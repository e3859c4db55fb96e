//! Analytic solids: signed distances in mm, negative inside.
//!
//! Capsules, boxes and plates are exact; ellipsoids, cylinders and lofts divide an implicit function by its
//! gradient, which is exact to first order at the surface, where the edges of a CT are made.

use nalgebra::{Matrix3, Vector3};

/// Position or vector in the anatomy's frame, LPS mm.
pub(super) type V3 = Vector3<f64>;

/// Cross-section of a [`Shape::Loft`] at one height.
#[derive(Debug, Clone, Copy)]
pub(super) struct Section {
    /// Height, mm.
    pub(super) z: f64,
    /// Front-back position of the widest place, mm.
    pub(super) middle: f64,
    /// Half width, mm.
    pub(super) half: f64,
    /// Foremost position, mm (smaller y is front).
    pub(super) front: f64,
    /// Rearmost position, mm.
    pub(super) back: f64,
    /// Exponent: 2 is an ellipse, more is squarer.
    pub(super) power: f64,
}

/// One analytic solid.
#[derive(Debug, Clone)]
pub(super) enum Shape {
    /// Ellipsoid; `frame` takes world vectors to its axes.
    Ellipsoid { centre: V3, frame: Matrix3<f64>, radii: V3 },
    /// Capsule whose radius goes from `ra` at `a` to `rb` at `b`.
    Capsule { a: V3, b: V3, ra: f64, rb: f64 },
    /// Box with rounded edges; `half` includes the rounding.
    Block { centre: V3, frame: Matrix3<f64>, half: V3, round: f64 },
    /// Elliptic cylinder along its third axis.
    Cylinder { centre: V3, frame: Matrix3<f64>, radii: [f64; 2], half: f64 },
    /// Triangle of thickness `2 r`.
    Plate { corners: [V3; 3], r: f64 },
    /// Superelliptic sections along z, grown by `offset`; symmetric about `x`.
    Loft { sections: Vec<Section>, x: f64, offset: f64 },
}

/// Axis-aligned box, least and greatest corner.
pub(super) type Bounds = [V3; 2];

impl Shape {
    /// Signed distance of a point, mm.
    pub(super) fn distance(&self, p: &V3) -> f64 {
        match self {
            Self::Ellipsoid { centre, frame, radii } => {
                let q = (frame * (p - centre)).component_div(radii);
                let (k0, k1) = (q.norm(), q.component_div(radii).norm());
                if k1 < 1e-12 { -radii.min() } else { k0 * (k0 - 1.0) / k1 }
            }
            Self::Capsule { a, b, ra, rb } => {
                let (pa, ba) = (p - a, b - a);
                let t = (pa.dot(&ba) / ba.norm_squared().max(1e-12)).clamp(0.0, 1.0);
                (pa - ba * t).norm() - (ra + (rb - ra) * t)
            }
            Self::Block { centre, frame, half, round } => {
                let q = (frame * (p - centre)).abs() - half.add_scalar(-round);
                q.sup(&V3::zeros()).norm() + q.max().min(0.0) - round
            }
            Self::Cylinder { centre, frame, radii, half } => {
                let q = frame * (p - centre);
                let (x, y) = (q.x / radii[0], q.y / radii[1]);
                let k0 = x.hypot(y);
                let k1 = (x / radii[0]).hypot(y / radii[1]);
                let side = if k1 < 1e-12 { -radii[0].min(radii[1]) } else { k0 * (k0 - 1.0) / k1 };
                let end = q.z.abs() - half;
                side.max(end).min(0.0) + side.max(0.0).hypot(end.max(0.0))
            }
            Self::Plate { corners, r } => triangle(p, corners) - r,
            Self::Loft { sections, x, offset } => loft(&V3::new(p.x - x, p.y, p.z), sections) - offset,
        }
    }

    /// A distance that the true one is not below: prunes the cell lists.
    pub(super) fn at_least(&self, p: &V3) -> f64 {
        match self {
            Self::Ellipsoid { centre, frame, radii } => {
                ((frame * (p - centre)).component_div(radii).norm() - 1.0) * radii.min()
            }
            Self::Cylinder { centre, frame, radii, half } => {
                let q = frame * (p - centre);
                (((q.x / radii[0]).hypot(q.y / radii[1]) - 1.0) * radii[0].min(radii[1])).max(q.z.abs() - half)
            }
            Self::Loft { .. } => f64::MIN,
            _ => self.distance(p),
        }
    }

    /// A box that holds the solid.
    pub(super) fn bounds(&self) -> Bounds {
        let around = |c: &V3, e: V3| [c - e, c + e];
        match self {
            Self::Ellipsoid { centre, frame, radii } => around(centre, frame.transpose().abs() * radii),
            Self::Block { centre, frame, half, .. } => around(centre, frame.transpose().abs() * half),
            Self::Cylinder { centre, frame, radii, half } => {
                around(centre, frame.transpose().abs() * V3::new(radii[0], radii[1], *half))
            }
            Self::Capsule { a, b, ra, rb } => {
                let r = V3::repeat(ra.max(*rb));
                [a.inf(b) - r, a.sup(b) + r]
            }
            Self::Plate { corners: [a, b, c], r } => {
                let r = V3::repeat(*r);
                [a.inf(b).inf(c) - r, a.sup(b).sup(c) + r]
            }
            Self::Loft { sections, x, offset } => {
                let mut out = [V3::repeat(f64::MAX), V3::repeat(f64::MIN)];
                for s in sections {
                    out[0] = out[0].inf(&V3::new(x - s.half, s.front, s.z));
                    out[1] = out[1].sup(&V3::new(x + s.half, s.back, s.z));
                }
                let e = V3::repeat(offset.max(0.0));
                [out[0] - e, out[1] + e]
            }
        }
    }

    /// The solid on the other side of the midplane x = 0.
    pub(super) fn mirrored(&self) -> Self {
        let m = |v: &V3| V3::new(-v.x, v.y, v.z);
        let flip = Matrix3::from_diagonal(&V3::new(-1.0, 1.0, 1.0));
        match self.clone() {
            Self::Ellipsoid { centre, frame, radii } => {
                Self::Ellipsoid { centre: m(&centre), frame: frame * flip, radii }
            }
            Self::Capsule { a, b, ra, rb } => Self::Capsule { a: m(&a), b: m(&b), ra, rb },
            Self::Block { centre, frame, half, round } => {
                Self::Block { centre: m(&centre), frame: frame * flip, half, round }
            }
            Self::Cylinder { centre, frame, radii, half } => {
                Self::Cylinder { centre: m(&centre), frame: frame * flip, radii, half }
            }
            Self::Plate { corners, r } => Self::Plate { corners: corners.each_ref().map(m), r },
            Self::Loft { sections, x, offset } => Self::Loft { sections, x: -x, offset },
        }
    }
}

/// Distance to a triangle.
fn triangle(p: &V3, [a, b, c]: &[V3; 3]) -> f64 {
    let n = (b - a).cross(&(a - c));
    let edges = [(a, b), (b, c), (c, a)];
    let outside = edges.iter().any(|(s, e)| (*e - *s).cross(&n).dot(&(p - *s)) < 0.0);
    if outside {
        let edge = |(s, e): &(&V3, &V3)| {
            let d = *e - *s;
            let t = (d.dot(&(p - *s)) / d.norm_squared()).clamp(0.0, 1.0);
            (p - *s - d * t).norm_squared()
        };
        edges.iter().map(edge).fold(f64::MAX, f64::min).sqrt()
    } else {
        n.dot(&(p - a)).abs() / n.norm()
    }
}

/// First-order distance to a loft; sections run from high z to low and are linear in between.
fn loft(p: &V3, sections: &[Section]) -> f64 {
    let lower = sections.partition_point(|s| s.z > p.z).clamp(1, sections.len() - 1);
    let (u, l) = (&sections[lower - 1], &sections[lower]);
    let run = u.z - l.z;
    let t = ((u.z - p.z) / run).clamp(0.0, 1.0);
    let mix = |a: f64, b: f64| a + (b - a) * t;
    let (half, middle, n) = (mix(u.half, l.half), mix(u.middle, l.middle), mix(u.power, l.power));
    let in_front = p.y < middle;
    let reach = |s: &Section| if in_front { s.middle - s.front } else { s.back - s.middle };
    let depth = mix(reach(u), reach(l));
    let (x, y) = (p.x.abs() / half, (p.y - middle).abs() / depth);
    let (xn, yn) = (x.powf(n), y.powf(n));
    let k = (xn + yn).powf(1.0 / n);
    let gradient = if k < 0.05 {
        1.0 / half.min(depth)
    } else {
        // Derivatives of the radial function along x, y and z, the last through the sections' change.
        let scale = k / (xn + yn);
        let (kx, ky) = (scale * xn / x.max(1e-9), scale * yn / y.max(1e-9));
        let side = if in_front { -1.0 } else { 1.0 };
        let shift = side * (u.middle - l.middle) / run + y * (reach(u) - reach(l)) / run;
        let kz = kx * x * (u.half - l.half) / run / half + ky * shift / depth;
        V3::new(kx / half, ky / depth, kz).norm()
    };
    ((k - 1.0) / gradient).max(p.z - sections[0].z).max(sections[sections.len() - 1].z - p.z)
}

#[cfg(test)]
mod tests {
    use super::super::build::*;
    use super::*;

    fn zoo() -> Vec<Shape> {
        vec![
            ell([1.0, 2.0, 3.0], [10.0, 14.0, 18.0]),
            cap([0.0, 0.0, 0.0], [20.0, 5.0, -8.0], 4.0, 6.0),
            bar([0.0, -5.0, 0.0], [0.0, 5.0, 30.0], 12.0, 4.0),
            plate([[0.0, 0.0, 0.0], [20.0, 0.0, 0.0], [5.0, 18.0, 7.0]], 3.0),
            loft_of(&[[20.0, 0.0, 20.0, -15.0, 25.0, 2.3], [-20.0, 3.0, 30.0, -20.0, 30.0, 2.0]], 0.0),
        ]
    }

    #[test]
    fn bounds_hold_every_inside_point() {
        for s in zoo() {
            let [lo, hi] = s.bounds();
            for n in 0..40_000 {
                let c = [n % 40, n / 40 % 40, n / 1600].map(|v| f64::from(v) * 2.5 - 40.0);
                let p = V3::from(c);
                let inside_box = (0..3).all(|a| p[a] >= lo[a] && p[a] <= hi[a]);
                assert!(inside_box || s.distance(&p) > 0.0, "{s:?} at {p}");
            }
        }
    }

    #[test]
    fn distance_has_unit_slope_at_the_surface() {
        for s in zoo() {
            let mut seen = 0;
            for n in 0..64_000 {
                let p = V3::from([n % 40, n / 40 % 40, n / 1600].map(|v| f64::from(v) * 2.0 - 39.1));
                let h = 1e-4;
                if s.distance(&p).abs() > 0.3 || p.z.abs() > 18.0 {
                    continue;
                }
                let g = V3::from_fn(|a, _| {
                    let mut e = V3::zeros();
                    e[a] = h;
                    (s.distance(&(p + e)) - s.distance(&(p - e))) / (2.0 * h)
                });
                seen += 1;
                assert!((0.75..1.3).contains(&g.norm()), "{s:?} at {p}: {}", g.norm());
            }
            assert!(seen > 10);
        }
    }

    #[test]
    fn mirror_is_a_mirror() {
        let p = V3::new(7.0, 3.0, 2.0);
        for s in zoo() {
            assert!((s.mirrored().distance(&V3::new(-p.x, p.y, p.z)) - s.distance(&p)).abs() < 1e-12);
        }
    }
}
