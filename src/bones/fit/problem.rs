//! The fit as an optimisation problem: rigid bodies with samples, coupled by joints.

use super::lie::left_jacobian;
use super::prior::{Penalty, penalty};
use super::samples::Samples;
use super::shape::Shape;
use super::similarity::{Evaluation, Held, Measure, evaluate};
use super::tissue::Tissue;
use crate::geometry::Rigid;
use crate::skeleton::Joint;
use nalgebra::{DMatrix, DVector, Matrix6, Point3, SVector, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;

/// One rigid body that moves.
pub struct Body<'a> {
    /// Its samples.
    pub samples: &'a Samples,
    /// Where it starts.
    pub base: Rigid,
    /// Centre of its samples in planning, LPS mm.
    pub centre: Point3<f64>,
    /// Root mean square distance of its samples from the centre, mm: turns radians into mm.
    pub radius: f64,
    /// What its similarity does not find anew wherever it moves.
    pub held: Option<Held>,
    /// Its surroundings, where they count beside its values.
    pub shape: Option<Shape<'a>>,
}

/// One end of a joint: a moving body or a bone that is held.
#[derive(Clone, Copy)]
pub enum End {
    /// Position in [`PoseProblem::bodies`].
    Moving(usize),
    /// A transform that stays.
    Held(Rigid),
}

/// A joint between two bodies.
pub struct Link<'a> {
    /// The joint.
    pub joint: &'a Joint,
    /// Parent side.
    pub parent: End,
    /// Child side.
    pub child: End,
}

/// Cost of a pose: similarity of each body plus the joints' penalties.
///
/// Parameters: 6 per body, all in mm: rotation vector times [`Body::radius`] about the body's moved centre, then shift.
pub struct PoseProblem<'a> {
    /// What moves.
    pub bodies: Vec<Body<'a>>,
    /// What couples it.
    pub links: Vec<Link<'a>>,
    /// Fraction image at this resolution; none where only the joints speak.
    pub fraction: Option<&'a Tissue>,
    /// How values are compared.
    pub measure: Measure,
}

/// Cost with derivatives at one parameter vector.
pub struct Local {
    /// Cost.
    pub cost: f64,
    /// Gradient.
    pub gradient: DVector<f64>,
    /// Gauss-Newton curvature.
    pub curvature: DMatrix<f64>,
}

/// Weak pull to the start, per mm: keeps a body that nothing determines in place.
const RIDGE: f64 = 1e-6;

impl Body<'_> {
    /// The body's transform for its six parameters.
    pub fn transform(&self, x: &[f64]) -> Rigid {
        let at = (self.base * self.centre).coords;
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(x[0], x[1], x[2]) / self.radius);
        let shift = Vector3::new(x[3], x[4], x[5]);
        Rigid::from_parts(Translation3::from(at + shift - turn * at), turn) * self.base
    }

    /// Derivative of (world rotation, shift) by the six parameters.
    fn chain(&self, x: &[f64]) -> Matrix6<f64> {
        let mut m = Matrix6::identity();
        let phi = Vector3::new(x[0], x[1], x[2]) / self.radius;
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(&(left_jacobian(&phi) / self.radius));
        m
    }
}

impl PoseProblem<'_> {
    /// Transforms of all bodies.
    pub fn transforms(&self, x: &DVector<f64>) -> Vec<Rigid> {
        self.bodies.iter().enumerate().map(|(b, body)| body.transform(&x.as_slice()[6 * b..])).collect()
    }

    /// Similarity of each body at the given transforms.
    pub fn similarities(&self, transforms: &[Rigid], derivatives: bool) -> Vec<Evaluation> {
        self.bodies
            .par_iter()
            .zip(transforms)
            .map(|(b, t)| match self.fraction {
                Some(f) => {
                    let centre = t * b.centre;
                    let mut found = evaluate(b.samples, f, t, &centre, self.measure, b.held, derivatives);
                    if let Some(shape) = &b.shape {
                        shape.add(&mut found, t, &centre, b.held, derivatives);
                    }
                    found
                }
                None => Evaluation::nothing(),
            })
            .collect()
    }

    fn penalty(&self, link: &Link<'_>, transforms: &[Rigid]) -> Penalty {
        let end = |e: End| match e {
            End::Moving(b) => (transforms[b], (transforms[b] * self.bodies[b].centre).coords),
            End::Held(t) => (t, Vector3::zeros()),
        };
        let ((p, pc), (c, cc)) = (end(link.parent), end(link.child));
        penalty(link.joint, &p, &c, &pc, &cc)
    }

    /// Cost with gradient and curvature.
    pub fn local(&self, x: &DVector<f64>) -> Local {
        let n = 6 * self.bodies.len();
        let t = self.transforms(x);
        let chains: Vec<Matrix6<f64>> =
            self.bodies.iter().enumerate().map(|(b, body)| body.chain(&x.as_slice()[6 * b..])).collect();
        let mut out = Local {
            cost: 0.5 * RIDGE * x.norm_squared(),
            gradient: x * RIDGE,
            curvature: DMatrix::identity(n, n) * RIDGE,
        };
        for (b, e) in self.similarities(&t, true).iter().enumerate() {
            out.cost += e.cost;
            let mut g = out.gradient.fixed_rows_mut::<6>(6 * b);
            g += chains[b].transpose() * e.gradient;
            let mut h = out.curvature.fixed_view_mut::<6, 6>(6 * b, 6 * b);
            h += chains[b].transpose() * e.curvature * chains[b];
        }
        for link in &self.links {
            let p = self.penalty(link, &t);
            out.cost += p.cost;
            let ends = [link.parent, link.child];
            for (r, end) in ends.iter().enumerate() {
                let End::Moving(b) = *end else { continue };
                let own: SVector<f64, 6> = p.gradient.fixed_rows::<6>(6 * r).into_owned();
                let mut g = out.gradient.fixed_rows_mut::<6>(6 * b);
                g += chains[b].transpose() * own;
                for (c, other) in ends.iter().enumerate() {
                    let End::Moving(d) = *other else { continue };
                    let mut h = out.curvature.fixed_view_mut::<6, 6>(6 * b, 6 * d);
                    h += chains[b].transpose() * p.curvature.fixed_view::<6, 6>(6 * r, 6 * c) * chains[d];
                }
            }
        }
        out
    }
}
