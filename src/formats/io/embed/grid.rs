//! The voxels of a scan that a page shows: every one, or every second or third, along the axes of
//! the world.

use crate::error::Result;
use crate::geometry::Grid;
use crate::volume::{Spans, Volume, trilinear};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// How HU are embedded as numbers from 2 on; 0 is no data.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HuScale {
    /// Least HU that are told, embedded as 2; what is less is air, embedded as 1.
    pub first: f32,
    /// HU from one number to the next.
    pub step: f32,
}

/// For a page that is sent around: the noise of air is half of a scan's bytes.
const FEW_BYTES: HuScale = HuScale { first: -900.0, step: 4.0 };
/// Least HU of a file.
const LEAST_HU: f32 = -32_768.0;

/// Greatest number: the script keeps 16 bits.
const MOST_NUMBER: i32 = 65_535;
/// Voxels that are shown, at most.
const MOST: usize = 6_000_000;
/// Spacing that is finer than one sees, mm; coarser ones where there are too many voxels.
pub const FINEST_MM: f64 = 2.0;
/// Where something is to be seen, HU.
const MATTER_HU: f32 = -500.0;
/// Rim around it, voxels.
const RIM: usize = 3;
/// Directions that differ from the world's axes by less are along them.
const ALONG: f64 = 1e-3;

/// Voxels of a scan along the axes of the world, x, y and z in storage order. Of a scan along these
/// axes they are its own voxels; of another one each has the value of the voxel that it lies in.
#[derive(Debug, Clone)]
pub struct PageGrid {
    /// The voxels.
    grid: Grid,
    /// The scan.
    scan: Grid,
    /// For a scan along the axes: what each place along x, y and z adds to the place in storage.
    steps: Option<[Vec<usize>; 3]>,
    hu: HuScale,
}

impl PageGrid {
    /// The voxels of scans on one grid, cut to what they show.
    ///
    /// # Errors
    /// [`crate::error::Error::Internal`] when no grid can be made of them.
    pub fn of(scans: &[&Volume<f32>]) -> Result<Self> {
        Self::thinned(scans, FINEST_MM)
    }

    /// Every voxel of scans on one grid, cut to what they show, however many there are, with HU in whole numbers from the
    /// least of them or of `least` on.
    ///
    /// # Errors
    /// [`crate::error::Error::Internal`] when no grid can be made of them.
    pub fn whole(scans: &[&Volume<f32>], least: f32) -> Result<Self> {
        let scan = Self::scan_of(scans)?;
        let all = Self::with_spacing(&scan, 0.0)?;
        let first = scans.iter().fold(least, |least, scan| least.min(scan.extremes()[0])).floor().max(LEAST_HU);
        Ok(Self { hu: HuScale { first, step: 1.0 }, ..all.cut(&all.matter(scans))? })
    }

    /// How HU are embedded.
    pub fn hu_scale(&self) -> HuScale {
        self.hu
    }

    fn scan_of(scans: &[&Volume<f32>]) -> Result<Grid> {
        scans.first().map_or_else(|| Grid::axis_aligned([1; 3], [1.0; 3], [0.0; 3]), |s| Ok(s.grid().clone()))
    }

    /// The same with voxels no finer than about `finest` mm.
    ///
    /// # Errors
    /// [`crate::error::Error::Internal`] when no grid can be made of them.
    pub fn thinned(scans: &[&Volume<f32>], mut finest: f64) -> Result<Self> {
        let scan = Self::scan_of(scans)?;
        loop {
            let whole = Self::with_spacing(&scan, finest)?;
            let cut = whole.cut(&whole.matter(scans))?;
            if cut.grid.len() <= MOST {
                return Ok(cut);
            }
            finest *= 1.25;
        }
    }

    /// The voxels that are shown.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Every voxel, or every few where they are finer than `finest` mm.
    fn with_spacing(scan: &Grid, finest: f64) -> Result<Self> {
        let every = |spacing: f64| ((finest / spacing).round() as usize).max(1);
        let (size, spacing, strides) = (scan.size(), scan.spacing(), scan.strides());
        // Along each axis of the world, the scan's axis and whether it runs the same way.
        let axes: [(usize, bool); 3] = [0, 1, 2].map(|a| {
            let row = scan.direction().row(a).transpose();
            (row.iamax(), row[row.iamax()] > 0.0)
        });
        let along = axes.iter().enumerate().all(|(a, (g, _))| (scan.direction()[(a, *g)].abs() - 1.0).abs() < ALONG)
            && scan.direction().iter().all(|d| d.abs() < ALONG || (d.abs() - 1.0).abs() < ALONG);
        if along {
            let voxels: [Vec<usize>; 3] = axes.map(|(g, up)| {
                let places = (0..size[g]).step_by(every(spacing[g]));
                if up { places.collect() } else { places.map(|i| size[g] - 1 - i).collect() }
            });
            let mut first = [0; 3];
            axes.iter().zip(&voxels).for_each(|((g, _), places)| first[*g] = places[0]);
            let grid = Grid::axis_aligned(
                [0, 1, 2].map(|a| voxels[a].len()),
                axes.map(|(g, _)| every(spacing[g]) as f64 * spacing[g]),
                scan.centre(first).coords.into(),
            )?;
            let steps = [0, 1, 2].map(|a| voxels[a].iter().map(|i| i * strides[axes[a].0]).collect());
            return Ok(Self { grid, scan: scan.clone(), steps: Some(steps), hu: FEW_BYTES });
        }
        let [low, high] = scan.corners().iter().fold([scan.origin(); 2], |[l, h], p| [l.inf(p), h.sup(p)]);
        let steps = axes.map(|(g, _)| every(spacing[g]) as f64 * spacing[g]);
        let size = [0, 1, 2].map(|a| ((high[a] - low[a]) / steps[a]) as usize + 1);
        let grid = Grid::axis_aligned(size, steps, low.coords.into())?;
        Ok(Self { grid, scan: scan.clone(), steps: None, hu: FEW_BYTES })
    }

    /// The voxels from the first to the last along each axis that show something in any scan; all
    /// where none does.
    fn matter(&self, scans: &[&Volume<f32>]) -> [[usize; 2]; 3] {
        let [ni, nj, nk] = self.grid.size();
        let none = [[usize::MAX, 0]; 3];
        let join =
            |a: [[usize; 2]; 3], b: [[usize; 2]; 3]| [0, 1, 2].map(|n| [a[n][0].min(b[n][0]), a[n][1].max(b[n][1])]);
        let plane = |k: usize| {
            let mut found = none;
            for j in 0..nj {
                let shows =
                    |i: usize| scans.iter().any(|s| self.place([i, j, k]).is_some_and(|n| s.data()[n] > MATTER_HU));
                if let (Some(first), Some(last)) = ((0..ni).find(|i| shows(*i)), (0..ni).rfind(|i| shows(*i))) {
                    found = join(found, [[first, last], [j, j], [k, k]]);
                }
            }
            found
        };
        let found = (0..nk).into_par_iter().map(plane).reduce(|| none, join);
        let size = self.grid.size();
        [0, 1, 2].map(|a| {
            if found[a][0] > found[a][1] {
                return [0, size[a] - 1];
            }
            [found[a][0].saturating_sub(RIM), (found[a][1] + RIM).min(size[a] - 1)]
        })
    }

    /// The voxels from the first to the last along each axis.
    fn cut(&self, ends: &[[usize; 2]; 3]) -> Result<Self> {
        let first = ends.map(|e| e[0]);
        let size = ends.map(|e| e[1] - e[0] + 1);
        let grid = Grid::axis_aligned(size, self.grid.spacing(), self.grid.centre(first).coords.into())?;
        let steps = self.steps.as_ref().map(|s| [0, 1, 2].map(|a| s[a][ends[a][0]..=ends[a][1]].to_vec()));
        Ok(Self { grid, scan: self.scan.clone(), steps, hu: self.hu })
    }

    /// Where a voxel lies in the storage of the scan; `None` outside.
    #[inline(always)]
    fn place(&self, [i, j, k]: [usize; 3]) -> Option<usize> {
        match &self.steps {
            Some([x, y, z]) => Some(x[i] + y[j] + z[k]),
            None => self.scan.voxel_at(&self.grid.centre([i, j, k])).map(|v| self.scan.linear(v)),
        }
    }

    /// A number for each voxel, by its place.
    fn each(&self, value: impl Fn([usize; 3]) -> i32 + Sync) -> Vec<i32> {
        let [ni, nj, _] = self.grid.size();
        let mut out = vec![0; self.grid.len()];
        out.par_chunks_mut(ni).enumerate().for_each(|(row, line)| {
            let (j, k) = (row % nj, row / nj);
            line.iter_mut().enumerate().for_each(|(i, out)| *out = value([i, j, k]));
        });
        out
    }

    /// The HU of an image on the scan's grid as embedded numbers.
    pub fn hu(&self, image: &Volume<f32>) -> Vec<i32> {
        self.each(|voxel| self.place(voxel).map_or(0, |n| self.hu.number(image.data()[n])))
    }

    /// The HU of an image on any grid, moved by `shift`, between its voxels.
    pub fn hu_between(&self, image: &Volume<f32>, shift: &Vector3<f64>) -> Vec<i32> {
        let grid = image.grid();
        self.each(|voxel| {
            let p = self.grid.centre(voxel) - shift;
            trilinear(image, &grid.index(&p)).map_or(0, |hu| self.hu.number(hu as f32))
        })
    }

    /// The labels of a map on the scan's grid.
    pub fn labels(&self, map: &Volume<u16>) -> Vec<i32> {
        self.each(|voxel| self.place(voxel).map_or(0, |n| i32::from(map.data()[n])))
    }

    /// The same of labels that are held in spans.
    pub fn labels_held(&self, map: &Spans<u16>) -> Vec<i32> {
        self.each(|voxel| self.place(voxel).map_or(0, |n| i32::from(map.at(map.grid().voxel(n)))))
    }

    /// The labels of a map on any grid, moved by `shift`.
    pub fn labels_moved(&self, map: &Volume<u16>, shift: &Vector3<f64>) -> Vec<i32> {
        let grid = map.grid();
        self.each(|voxel| {
            let p = self.grid.centre(voxel) - shift;
            grid.voxel_at(&p).map_or(0, |v| i32::from(*map.at(v)))
        })
    }

    /// Every few voxels, about `spacing` mm apart, from the first on.
    ///
    /// # Errors
    /// [`crate::error::Error::Internal`] when no grid can be made of them.
    pub fn coarser(&self, spacing: f64) -> Result<Self> {
        let every = self.grid.spacing().map(|s| ((spacing / s).round() as usize).max(1));
        let size = [0, 1, 2].map(|a| self.grid.size()[a].div_ceil(every[a]));
        let apart = [0, 1, 2].map(|a| every[a] as f64 * self.grid.spacing()[a]);
        let grid = Grid::axis_aligned(size, apart, self.grid.origin().coords.into())?;
        let steps = self.steps.as_ref().map(|s| [0, 1, 2].map(|a| s[a].iter().copied().step_by(every[a]).collect()));
        Ok(Self { grid, scan: self.scan.clone(), steps, hu: self.hu })
    }

    /// For each voxel what `values` makes of its position and of the value of a field on the scan's
    /// grid there; rows along x.
    pub fn of_field<const N: usize>(
        &self,
        field: &Volume<[f32; 3]>,
        values: impl Fn(Point3<f64>, [f32; 3]) -> [i32; N] + Sync,
    ) -> [Vec<i32>; N] {
        let mut out = [const { Vec::new() }; N];
        let [ni, nj, nk] = self.grid.size();
        let rows: Vec<Vec<[i32; N]>> = (0..nj * nk)
            .into_par_iter()
            .map(|row| {
                let voxel = |i| [i, row % nj, row / nj];
                let one = |i| {
                    let place = self.place(voxel(i));
                    place.map_or([0; N], |n| values(self.grid.centre(voxel(i)), field.data()[n]))
                };
                (0..ni).map(one).collect()
            })
            .collect();
        for all in rows.iter().flatten() {
            out.iter_mut().zip(all).for_each(|(out, value)| out.push(*value));
        }
        out
    }
}

impl HuScale {
    /// HU as they are embedded.
    #[inline(always)]
    fn number(self, hu: f32) -> i32 {
        if hu < self.first - 0.5 * self.step {
            return 1;
        }
        (2 + ((hu - self.first) / self.step).round() as i32).min(MOST_NUMBER)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    /// HU that tell the place.
    fn scan(grid: Grid) -> Volume<f32> {
        Volume::from_fn(grid.clone(), |l| {
            let p = grid.centre(grid.voxel(l));
            (8.0 * p.x + 4.0 * p.y + 0.5 * p.z) as f32
        })
    }

    /// The embedded numbers of a scan are its HU at the very places that the page names, within
    /// half a step.
    fn check(grid: Grid, off_mm: f64) {
        let scan = scan(grid);
        let page = PageGrid::of(&[&scan]).unwrap();
        let shown = page.grid().clone();
        let hu = page.hu(&scan);
        let mut seen = 0;
        for (l, number) in hu.iter().enumerate() {
            let p = shown.centre(shown.voxel(l));
            if *number < 2 {
                continue;
            }
            let told = FEW_BYTES.first + FEW_BYTES.step * (number - 2) as f32;
            let voxel = scan.grid().voxel_at(&p).unwrap();
            let centre = scan.grid().centre(voxel);
            assert!((centre - p).norm() <= off_mm, "{centre} {p}");
            assert!((told - scan.at(voxel)).abs() <= FEW_BYTES.step / 2.0 + 1e-3, "{told} {}", scan.at(voxel));
            seen += 1;
        }
        assert!(seen * 3 > hu.len() && seen > 500, "{seen} of {}", hu.len());
    }

    #[test]
    fn hu_are_those_of_the_scans_own_voxels() {
        check(Grid::axis_aligned([40, 30, 10], [1.0, 1.0, 3.0], [-20.0, -15.0, 7.0]).unwrap(), 1e-9);
        let turned = Matrix3::new(0.0, 0.0, -1.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
        check(Grid::new([30, 10, 40], [0.9, 3.0, 1.3], Point3::new(20.0, -15.0, 9.0), turned).unwrap(), 1e-9);
    }

    #[test]
    fn an_oblique_scan_shows_the_voxel_that_a_place_lies_in() {
        let turn = nalgebra::Rotation3::from_euler_angles(0.1, 0.05, 0.3).into_inner();
        check(Grid::new([40, 30, 10], [2.0, 2.0, 3.0], Point3::new(-20.0, -15.0, 7.0), turn).unwrap(), 2.1);
    }

    #[test]
    fn large_scans_are_thinned_and_empty_rims_cut() {
        let grid = Grid::axis_aligned([400, 400, 120], [0.5, 0.5, 0.5], [0.0; 3]).unwrap();
        let ct = Volume::from_fn(grid.clone(), |l| if grid.voxel(l)[0] >= 200 { 40.0 } else { -1000.0 });
        let page = PageGrid::of(&[&ct]).unwrap();
        let tenths = |grid: &Grid| grid.spacing().map(|s| (s * 10.0).round() as usize);
        assert_eq!(tenths(page.grid()), [20; 3]);
        assert!((page.grid().origin().x - (100.0 - 2.0 * RIM as f64)).abs() < 1e-9);
        assert_eq!(page.grid().size(), [50 + RIM, 100, 30]);
        let every = page.coarser(5.0).unwrap();
        assert_eq!((tenths(every.grid()), every.grid().size()), ([60; 3], [18, 34, 10]));
    }

    #[test]
    fn air_and_what_is_not_there_are_told_apart() {
        let numbers = [-3000.0, -903.0, -900.0, -896.0, 0.0, 3071.0].map(|hu| FEW_BYTES.number(hu));
        assert_eq!(numbers, [1, 1, 2, 3, 227, 995]);
        let grid = |n| Grid::axis_aligned([n, 8, 8], [3.0; 3], [0.0; 3]).unwrap();
        let (long, short) = (Volume::filled(grid(12), 40.0), Volume::filled(grid(8), 40.0));
        let page = PageGrid::of(&[&long]).unwrap();
        let moved = page.hu_between(&short, &Vector3::new(3.0, 0.0, 0.0));
        assert_eq!(moved[..12], [0, 237, 237, 237, 237, 237, 237, 237, 237, 0, 0, 0]);
    }

    #[test]
    fn a_whole_scan_keeps_every_hu() {
        let grid = Grid::axis_aligned([40, 30, 10], [1.0, 1.0, 3.0], [0.0; 3]).unwrap();
        // Air with noise, soft tissue, metal.
        let ct = Volume::from_fn(grid, |l| [-1024.0, -1019.0, -3.0, 41.0, 3071.0, 30_000.0][l % 6]);
        let page = PageGrid::whole(&[&ct], 0.0).unwrap();
        let HuScale { first, step } = page.hu_scale();
        assert!(page.grid().len() == ct.data().len());
        for (number, hu) in page.hu(&ct).iter().zip(ct.data()) {
            assert!(
                (2..=MOST_NUMBER).contains(number) && (first + step * (number - 2) as f32 - hu).abs() < 1e-6,
                "{hu}"
            );
        }
        // What is read between the voxels of another scan may be less.
        let page = PageGrid::whole(&[&ct], -2000.5).unwrap();
        assert_eq!(page.hu_scale(), HuScale { first: -2001.0, step: 1.0 });
    }
}
