//! Fields and rigid transforms between named frames, composed into one map of points.
//!
//! A *frame* is a scan's world, such as `planning` or `fraction`. A [`Link`] says which frame's points it takes where;
//! [`Chain::between`] walks the links from one frame to another and turns each the way it is needed: as it is, or by
//! numerical inversion. A field maps points outside its grid to themselves, as ITK's transforms do; its edge voxels
//! reach half a voxel beyond their centres.

use super::inverse::Inverse;
use super::inverse::pre_image::InvertOptions;
use crate::error::{Error, Result};
use crate::geometry::{Grid, Rigid};
use crate::stats::Summary;
use crate::volume::{Volume, trilinear_vector};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::Serialize;
use std::borrow::Cow;

/// What takes points of one frame to another.
#[derive(Debug, Clone)]
pub enum Motion {
    /// On a grid of the frame that it starts from: `x` goes to `x + u(x)`, LPS mm.
    Field(Box<Volume<[f32; 3]>>),
    /// A rigid transform, LPS mm.
    Rigid(Rigid),
}

/// A motion with the frames that it joins.
#[derive(Debug, Clone)]
pub struct Link {
    /// File or thing, for messages.
    pub name: String,
    /// Frame whose points it takes.
    pub from: String,
    /// Frame where they arrive.
    pub to: String,
    /// The motion itself.
    pub motion: Motion,
}

/// Links in order, each turned the way it is needed.
pub struct Chain<'a> {
    steps: Vec<Step<'a>>,
    /// What each step does, for people.
    pub description: Vec<String>,
}

enum Step<'a> {
    Displace(&'a Volume<[f32; 3]>),
    Undo(Box<Inverse<'a>>),
    Rigid(Rigid),
}

/// Where a chain takes a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mapped {
    /// The point in the last frame, LPS mm.
    pub point: Point3<f64>,
    /// Largest residual of an inversion on the way, mm; `None` when there was none.
    pub residual_mm: Option<f64>,
    /// Whether every inversion reached its tolerance.
    pub solved: bool,
    /// Whether every field on the way covers the point; elsewhere it is the identity.
    pub covered: bool,
}

/// What happened to many points.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChainReport {
    /// Points in all.
    pub points: usize,
    /// Points outside a field's grid, where that field is the identity.
    pub outside: usize,
    /// |v + u(y + v)| over the points that were inverted to the tolerance, mm; `None` without inversion.
    pub residual_mm: Option<Summary>,
    /// Points whose inversion did not reach the tolerance (folds and gaps of the field).
    pub unsolved: usize,
    /// Largest residual of those, mm.
    pub unsolved_max_mm: f64,
}

impl ChainReport {
    /// The report of mapped points.
    pub fn of(mapped: &[Mapped]) -> Self {
        let mut tally = ChainTally::default();
        mapped.iter().for_each(|m| tally.add(m));
        Self::sum(vec![tally])
    }

    fn sum(tallies: Vec<ChainTally>) -> Self {
        let inverted = tallies.iter().any(|t| t.inverted);
        let residuals: Vec<f64> = tallies.iter().flat_map(|t| t.residuals.iter().map(|&r| f64::from(r))).collect();
        Self {
            points: tallies.iter().map(|t| t.points).sum(),
            outside: tallies.iter().map(|t| t.outside).sum(),
            residual_mm: inverted.then(|| Summary::of(&residuals)),
            unsolved: tallies.iter().map(|t| t.unsolved).sum(),
            unsolved_max_mm: tallies.iter().map(|t| t.worst).fold(0.0, f64::max),
        }
    }
}

#[derive(Default)]
struct ChainTally {
    residuals: Vec<f32>,
    points: usize,
    outside: usize,
    inverted: bool,
    unsolved: usize,
    worst: f64,
}

impl ChainTally {
    fn add(&mut self, m: &Mapped) {
        self.points += 1;
        self.outside += usize::from(!m.covered);
        if let Some(r) = m.residual_mm {
            self.inverted = true;
            if m.solved {
                self.residuals.push(r as f32);
            } else {
                self.unsolved += 1;
                self.worst = self.worst.max(r);
            }
        }
    }
}

/// The displacement at a point; `None` outside the grid, whose edge voxels reach half a voxel beyond their centres.
pub fn displacement(field: &Volume<[f32; 3]>, point: &Point3<f64>) -> Option<Vector3<f64>> {
    let grid = field.grid();
    let last = Vector3::from(grid.size().map(|n| (n - 1) as f64));
    let index = grid.index(point);
    let inside = (0..3).all(|a| index[a] >= -0.5 && index[a] <= last[a] + 0.5);
    inside.then(|| trilinear_vector(field, &index.zip_map(&last, |i, l| i.clamp(0.0, l))).unwrap_or_default())
}

impl Step<'_> {
    fn apply(&self, m: &mut Mapped) {
        match self {
            Self::Rigid(t) => m.point = t * m.point,
            Self::Displace(field) => match displacement(field, &m.point) {
                Some(u) => m.point += u,
                None => m.covered = false,
            },
            Self::Undo(inverse) => {
                let grid = inverse.grid();
                let solved = inverse.at(&m.point);
                let before = m.point + solved.displacement;
                // Beyond the grid the field is the identity, and so is its inverse.
                if !grid.contains(&grid.index(&before)) && !grid.contains(&grid.index(&m.point)) {
                    m.covered = false;
                    return;
                }
                m.point = before;
                m.residual_mm = Some(m.residual_mm.unwrap_or(0.0).max(solved.residual_mm));
                m.solved &= solved.converged;
            }
        }
    }
}

impl<'a> Chain<'a> {
    /// The chain of one field, used as it is: `x` goes to `x + u(x)`.
    pub fn along(field: &'a Volume<[f32; 3]>) -> Self {
        Self { steps: vec![Step::Displace(field)], description: vec!["one field, as it is".into()] }
    }

    /// The chain that takes points of frame `from` to frame `to` through all links, in their order.
    ///
    /// Two neighbouring links between the same two frames are one step: the one that points the right way is taken.
    ///
    /// # Errors
    /// [`Error::Usage`] when the links do not lead from one to the other, or one is left over or given twice.
    pub fn between(links: &'a [Link], from: &str, to: &str, options: &InvertOptions) -> Result<Self> {
        let list = || links.iter().map(|l| format!("{}:{} ({})", l.from, l.to, l.name)).collect::<Vec<_>>().join(", ");
        let refuse = |problem: String| {
            let remedy = format!(
                "give the fields in order, each as FROM:TO=FILE with the frames that it joins, so that they lead from {from} to {to}; given: {}",
                list()
            );
            Error::usage(problem, remedy)
        };
        let (mut steps, mut description) = (Vec::new(), Vec::new());
        let mut here = from;
        let mut rest = links;
        while let Some(first) = rest.first() {
            let joins =
                |l: &Link| (l.from == first.from && l.to == first.to) || (l.from == first.to && l.to == first.from);
            let same = rest.iter().take_while(|l| joins(l)).count();
            let (group, others) = rest.split_at(same);
            let forward: Vec<&Link> = group.iter().filter(|l| l.from == here).collect();
            let backward: Vec<&Link> = group.iter().filter(|l| l.to == here).collect();
            let (link, ahead) = match (&forward[..], &backward[..]) {
                ([one], _) => (*one, true),
                ([], [one]) => (*one, false),
                ([], []) => {
                    return Err(refuse(format!("{} joins {} and {}, not {here}", first.name, first.from, first.to)));
                }
                _ => {
                    return Err(refuse(format!(
                        "two fields take the same way between {} and {}",
                        first.from, first.to
                    )));
                }
            };
            let next = if ahead { &link.to } else { &link.from };
            let how = match (&link.motion, ahead) {
                (Motion::Field(_), true) => "as it is",
                (Motion::Field(_), false) => "inverted numerically",
                (Motion::Rigid(_), true) => "rigid",
                (Motion::Rigid(_), false) => "rigid, inverted exactly",
            };
            description.push(format!("{here} -> {next}: {}, {how}", link.name));
            steps.push(match (&link.motion, ahead) {
                (Motion::Field(field), true) => Step::Displace(field),
                (Motion::Field(field), false) => Step::Undo(Box::new(Inverse::new(field, options)?)),
                (Motion::Rigid(t), true) => Step::Rigid(*t),
                (Motion::Rigid(t), false) => Step::Rigid(t.inverse()),
            });
            here = next;
            rest = others;
        }
        if here != to {
            return Err(refuse(format!("the fields lead from {from} to {here}, not to {to}")));
        }
        Ok(Self { steps, description })
    }

    /// Where a point of the first frame goes.
    pub fn map(&self, point: &Point3<f64>) -> Mapped {
        let mut m = Mapped { point: *point, residual_mm: None, solved: true, covered: true };
        self.steps.iter().for_each(|s| s.apply(&mut m));
        m
    }

    /// The grid in the first frame on which the chain is known exactly, if its first step is a field that needs no
    /// inversion.
    pub fn grid(&self) -> Option<&Grid> {
        match self.steps.first() {
            Some(Step::Displace(field)) => Some(field.grid()),
            _ => None,
        }
    }

    /// The whole chain as displacements on a grid of the first frame. A single field on that very grid is borrowed.
    ///
    /// # Errors
    /// Only for internal inconsistency of grids.
    pub fn displacement_on(&self, grid: &Grid) -> Result<(Cow<'_, Volume<[f32; 3]>>, ChainReport)> {
        if let [Step::Displace(field)] = &self.steps[..]
            && field.grid().matches(grid, 1e-4)
        {
            let report =
                ChainReport { points: grid.len(), outside: 0, residual_mm: None, unsolved: 0, unsolved_max_mm: 0.0 };
            return Ok((Cow::Borrowed(field), report));
        }
        let [nx, ny, _] = grid.size();
        let mut out = vec![[0f32; 3]; grid.len()];
        let tallies = out
            .par_chunks_mut(nx * ny)
            .enumerate()
            .map(|(k, plane)| {
                let mut tally = ChainTally::default();
                for (n, u) in plane.iter_mut().enumerate() {
                    let x = grid.centre([n % nx, n / nx, k]);
                    let mapped = self.map(&x);
                    *u = (mapped.point - x).map(|c| c as f32).into();
                    tally.add(&mapped);
                }
                tally
            })
            .collect();
        Ok((Cow::Owned(Volume::new(grid.clone(), out)?), ChainReport::sum(tallies)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::about;

    fn field(u: impl Fn(Vector3<f64>) -> Vector3<f64> + Sync) -> Motion {
        let grid = Grid::axis_aligned([41, 31, 21], [2.0, 2.0, 3.0], [-40.0, -30.0, -30.0]).unwrap();
        Motion::Field(Box::new(Volume::from_fn(grid.clone(), |l| {
            u(grid.centre(grid.voxel(l)).coords).map(|c| c as f32).into()
        })))
    }

    fn link(from: &str, to: &str, motion: Motion) -> Link {
        Link { name: format!("{from}_{to}"), from: from.into(), to: to.into(), motion }
    }

    fn wave(x: Vector3<f64>) -> Vector3<f64> {
        Vector3::new(4.0 * (x.y / 9.0).sin(), 3.0 * (x.x / 11.0).cos(), 2.0 * (x.x / 8.0).sin())
    }

    #[test]
    fn a_chain_of_affine_fields_and_rigids_is_their_product() {
        let turn = about(&Point3::new(3.0, 1.0, 0.0), Vector3::new(0.0, 0.0, 0.2), Vector3::new(1.0, 2.0, -1.0));
        let shift = Vector3::new(2.0, -1.5, 0.5);
        let links = [
            link("a", "b", Motion::Rigid(turn)),
            link("c", "b", field(|_| shift)),
            link("c", "d", field(|x| 0.05 * x)),
        ];
        let options = InvertOptions::default();
        let chain = Chain::between(&links, "a", "d", &options).unwrap();
        let back = Chain::between(&links[..2], "a", "c", &options).unwrap();
        let x = Point3::new(5.0, -4.0, 2.0);
        assert!((back.map(&x).point - (turn * x - shift)).norm() < 1e-5);
        let mapped = chain.map(&x);
        assert!((mapped.point.coords - 1.05 * (turn * x - shift).coords).norm() < 2e-3, "{mapped:?}");
        assert!(mapped.solved && mapped.residual_mm.unwrap() < 1e-3);
        assert!(chain.description[1].contains("inverted numerically"), "{:?}", chain.description);
        let reversed: Vec<Link> = links.iter().rev().cloned().collect();
        let home = Chain::between(&reversed, "d", "a", &options).unwrap();
        assert!((home.map(&mapped.point).point - x).norm() < 3e-3);
    }

    #[test]
    fn the_exact_direction_is_taken_where_both_are_given() {
        let links = [link("a", "b", field(|_| Vector3::x())), link("b", "a", field(|_| -1.5 * Vector3::x()))];
        let options = InvertOptions::default();
        let there = Chain::between(&links, "a", "b", &options).unwrap();
        let back = Chain::between(&links, "b", "a", &options).unwrap();
        assert!((there.map(&Point3::origin()).point.x - 1.0).abs() < 1e-6);
        assert!((back.map(&Point3::origin()).point.x + 1.5).abs() < 1e-6);
        assert!(there.map(&Point3::origin()).residual_mm.is_none());
    }

    #[test]
    fn a_field_along_which_points_go_is_used_as_it_is() {
        let links = [link("a", "b", field(wave))];
        let Motion::Field(wave) = &links[0].motion else { panic!("a field was made") };
        let along = Chain::along(wave);
        let between = Chain::between(&links, "a", "b", &InvertOptions::default()).unwrap();
        let at = |n: u8| {
            let [i, j] = [13, 7].map(|m| f64::from(n % m));
            Point3::new(i * 6.1 - 38.0, j * 8.3 - 27.0, f64::from(n) * 0.2 - 25.0)
        };
        for x in (0..250).map(at) {
            let mapped = along.map(&x);
            let moved = displacement(wave, &x).unwrap();
            assert!((mapped.point - x - moved).norm() < 1e-12 && mapped.covered && mapped.residual_mm.is_none());
            assert!((mapped.point - between.map(&x).point).norm() < 1e-12);
        }
        let voxel = [7, 11, 13];
        let (x, u) = (wave.grid().centre(voxel), wave.data()[wave.grid().linear(voxel)]);
        assert!((along.map(&x).point - x - Vector3::from(u.map(f64::from))).norm() < 1e-9);
        assert!(u.iter().any(|c| c.abs() > 1.0), "nothing moves there: {u:?}");
        let far = along.map(&Point3::new(0.0, 200.0, 0.0));
        assert!(!far.covered && (far.point.y - 200.0).abs() < 1e-12);
        // On its own grid the field itself comes back, and elsewhere what it says there.
        let (own, report) = along.displacement_on(wave.grid()).unwrap();
        assert!(matches!(own, Cow::Borrowed(_)) && own.data() == wave.data() && report.outside == 0);
        let grid = Grid::axis_aligned([3, 1, 1], [50.0, 2.0, 2.0], [-40.5, 3.5, 1.0]).unwrap();
        let (elsewhere, report) = along.displacement_on(&grid).unwrap();
        assert_eq!((report.points, report.outside), (3, 1));
        let expected = displacement(wave, &grid.centre([1, 0, 0])).unwrap();
        assert!((Vector3::from(elsewhere.data()[1].map(f64::from)) - expected).norm() < 1e-6);
        assert!(elsewhere.data()[2].iter().all(|c| c.abs() < f32::EPSILON));
    }

    #[test]
    fn outside_is_identity_and_the_edge_reaches_half_a_voxel() {
        let links = [link("a", "b", field(|_| Vector3::new(0.0, 0.0, 5.0)))];
        let options = InvertOptions::default();
        let there = Chain::between(&links, "a", "b", &options).unwrap();
        let back = Chain::between(&links, "b", "a", &options).unwrap();
        let edge = there.map(&Point3::new(40.9, 0.0, 0.0));
        assert!(edge.covered && (edge.point.z - 5.0).abs() < 1e-6);
        for chain in [&there, &back] {
            let far = chain.map(&Point3::new(300.0, 0.0, 0.0));
            assert!(!far.covered && (far.point.x - 300.0).abs() < 1e-9 && far.point.z.abs() < 1e-9);
        }
    }

    #[test]
    fn broken_chains_are_refused() {
        let options = InvertOptions::default();
        let step = |a: &str, b: &str| link(a, b, Motion::Rigid(Rigid::identity()));
        let ab = step("a", "b");
        let refused = |links: &[Link], from: &str, to: &str, word: &str| {
            let Err(error) = Chain::between(links, from, to, &options) else { panic!("{from} {to} was not refused") };
            assert!(error.to_string().contains(word) && error.exit_code() == 2, "{error}");
        };
        refused(std::slice::from_ref(&ab), "a", "c", "lead from a to b, not to c");
        refused(&[ab.clone(), step("c", "d")], "a", "d", "joins c and d, not b");
        refused(&[ab.clone(), ab.clone()], "a", "b", "same way");
        refused(&[ab, step("b", "c")], "a", "b", "lead from a to c");
    }

    #[test]
    fn there_and_back_is_where_it_was() {
        let links = [link("a", "b", field(wave))];
        let options = InvertOptions::default();
        let there = Chain::between(&links, "a", "b", &options).unwrap();
        let home = Chain::between(&links, "b", "a", &options).unwrap();
        for n in 0..1000 {
            let at = [(n % 10, 4.3), (n / 10 % 10, 3.9), (n / 100, 4.1)].map(|(i, step)| step * f64::from(i) - 19.0);
            let x = Point3::from(at);
            let back = home.map(&there.map(&x).point);
            assert!(back.solved && (back.point - x).norm() < 0.01, "{x}: {back:?}");
        }
    }
}
