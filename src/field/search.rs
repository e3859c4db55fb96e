//! The search for the pre-images of a slab of fraction voxels.

use super::PushField;
use super::bones::MovedBones;
use super::invert::{Continued, InvertOptions, solve};
use super::newton::Sampler;
use super::tetrahedra::{Drop, Mesh};
use crate::geometry::Grid;
use nalgebra::{Point3, Vector3};

/// Iteration limit of the quick search, which is all that there is where no tissue comes to lie: the continued field outside
/// tissue may have no inverse at all.
const QUICK_ITERATIONS: usize = 10;

/// What was found in a slab.
#[derive(Default)]
pub(super) struct Tally {
    pub(super) residuals: Vec<f32>,
    pub(super) unconverged: usize,
    pub(super) tissue: usize,
    pub(super) strayed: usize,
    pub(super) worst: f64,
    pub(super) outside: usize,
}

/// Everything that the inversion of a voxel needs.
pub(super) struct Search<'a, V> {
    pub(super) push: &'a PushField,
    pub(super) robust: Continued<'a>,
    pub(super) quick: Sampler<'a>,
    pub(super) guess: Sampler<'a>,
    pub(super) mesh: Mesh<'a, V>,
    pub(super) bones: Option<&'a MovedBones<'a>>,
    pub(super) fraction: &'a Grid,
    pub(super) options: &'a InvertOptions,
}

impl<V> Search<'_, V> {
    /// Inverts the planes from `first` on.
    pub(super) fn slab(
        &self,
        first: usize,
        (drawn, owner): (&[Drop<3>], &[u16]),
        v: &mut [[f32; 3]],
        inside: &mut [bool],
    ) -> Tally {
        let [nx, ny, _] = self.fraction.size();
        let planning = self.push.displacement.grid();
        let along: Vector3<f64> = self.fraction.step().column(0).into_owned();
        let miss = planning.spacing().into_iter().fold(0.0, f64::max);
        let mut t = Tally::default();
        for (row, drawn) in drawn.chunks(nx).enumerate() {
            let start = self.fraction.centre([0, row % ny, first + row / ny]).coords;
            // The last two solutions on the row, where both are known: the third is nearly in line.
            let mut before: [Option<Vector3<f64>>; 2] = [None; 2];
            for (i, drawn) in drawn.iter().enumerate() {
                let y = start + along * i as f64;
                let ahead = before[1].zip(before[0]).map(|(last, first)| last + last - first);
                let (mut d, residual, converged) =
                    self.in_bone(&y, owner[row * nx + i]).unwrap_or_else(|| self.voxel(&y, drawn, ahead));
                before = [before[1], converged.then_some(d)];
                let at = planning.index(&Point3::from(y + d));
                let mut within = planning.contains(&at);
                let tissue = within && self.tissue(&at);
                if tissue && !converged && residual > miss {
                    // Showing that tissue here would show it twice.
                    d = self.beyond(&at) - y;
                    within = false;
                    t.strayed += 1;
                }
                let n = row * nx + i;
                v[n] = [d.x as f32, d.y as f32, d.z as f32];
                inside[n] = within;
                t.outside += usize::from(!within);
                match (converged, tissue) {
                    (true, true) => t.residuals.push(residual as f32),
                    (false, _) => {
                        t.unconverged += 1;
                        t.tissue += usize::from(tissue);
                        t.worst = t.worst.max(residual);
                    }
                    _ => {}
                }
            }
        }
        t
    }

    /// Whether the model computed the planning voxel nearest to an index inside the grid.
    fn tissue(&self, at: &Vector3<f64>) -> bool {
        let near = [at.x, at.y, at.z].map(|c| (c + 0.5) as u32 as usize);
        self.push.computed.data()[self.push.computed.grid().linear(near)]
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

    /// The pre-image inside a bone, if the field moves it as the bone moves.
    #[inline(always)]
    fn in_bone(&self, y: &Vector3<f64>, owner: u16) -> Option<(Vector3<f64>, f64, bool)> {
        let v = self.bones?.back(owner, y)?;
        let x = y + v;
        let residual = (v + self.quick.value([x.x, x.y, x.z])).norm();
        (residual < self.options.tolerance_mm).then_some((v, residual, true))
    }

    /// One voxel: quickly from a good start, patiently where that fails. `ahead`: what its row leads to expect, where no tissue
    /// comes to lie.
    #[inline(always)]
    fn voxel(&self, y: &Vector3<f64>, drawn: &Drop<3>, ahead: Option<Vector3<f64>>) -> (Vector3<f64>, f64, bool) {
        let tolerance = self.options.tolerance_mm;
        let held = drawn.rank > 0;
        let start = match ahead {
            _ if held => -Vector3::from(drawn.value.map(f64::from)),
            Some(v) => v,
            None => self.guess.value([y.x, y.y, y.z]),
        };
        let most = self.options.max_iterations;
        let found = self.quick.invert(y, start, (tolerance, most.min(QUICK_ITERATIONS)));
        if found.2 {
            return found;
        }
        let at = self.push.displacement.grid().index(&Point3::from(y + found.0));
        let tissue = held || (self.push.displacement.grid().contains(&at) && self.tissue(&at));
        let patient = if tissue { solve(y, start, &self.robust, (tolerance, most)) } else { found };
        if patient.1 < found.1 { patient } else { found }
    }
}
