//! A CT as the fit sees it: blurred tissue with the places where tissue is known.
//!
//! Air takes no part. A bone never lies in air, so air where a bone should be means padding: the circle of the
//! reconstruction, a cut field of view, a fill value. Blurring is normalised over tissue, so that neither padding
//! nor the image's edge bleeds into bone.

use crate::geometry::Grid;
use crate::volume::{
    COARSE_MM, Counted, Volume, block_means, block_within, blur_after, cubic, gaussian, gaussian_ratio, interpolation,
};
use nalgebra::{Point3, Vector3};

/// Below this HU a voxel is air or padding.
const AIR_HU: f32 = -600.0;
/// Above this HU metal and its artefacts are cut.
const METAL_HU: f32 = 2000.0;

/// Blurred tissue with its validity.
#[derive(Debug, Clone)]
pub struct Tissue {
    /// Blurred HU; in air the blurred value of the tissue near it.
    pub value: Volume<f32>,
    /// Share of tissue: [`ALL`] in tissue, 0 in air.
    pub valid: Volume<u8>,
}

/// How far from an image's end its voxels are blurred with what lies beyond and nobody knows, mm: the reach of the finest blur.
/// Where only the outermost voxel was left out, a clavicle at the end of slices of 1.5 mm erred by 0.76 mm for 0.12.
pub(super) const EDGE_MM: f64 = 2.4;

/// A voxel of nothing but tissue.
const ALL: u8 = u8::MAX;

/// Blocks of voxels this wide, as a share of the blur's sigma, are averaged first: the blur hides them. Blocks of fine voxels are
/// as wide as sigma, up to [`COARSE_MM`].
const BLOCK: f64 = 0.5;

impl Tissue {
    /// Whether a voxel is air or padding.
    pub fn is_air(hu: f32) -> bool {
        hu.is_nan() || hu <= AIR_HU
    }

    /// The tissue of a CT, blurred by `sigma` mm; on a coarser grid where the blur allows it.
    pub fn blurred(ct: &Volume<f32>, sigma: f64) -> Self {
        let block = Self::block(ct, sigma);
        let rest = blur_after(ct.grid(), block, sigma);
        let normalised = |hu: f32, share: f32| if share > 1e-3 { hu / share } else { AIR_HU };
        if block == [1; 3] {
            let value = gaussian_ratio(
                &Counted { image: ct, value: hu },
                &Counted { image: ct, value: amount },
                rest,
                |_| false,
                normalised,
            );
            return Self { value, valid: ct.map(|v| if *v > AIR_HU { ALL } else { 0 }) };
        }
        let [sum, share] = block_means(ct, block, |_, v| [hu(v), amount(v)]);
        let value = gaussian_ratio(&Counted::whole(&sum), &Counted::whole(&share), rest, |_| false, normalised);
        Self { value, valid: share.map(|s| (s * f32::from(ALL) + 0.5) as u8) }
    }

    /// The block of voxels that is averaged before a blur by `sigma` mm.
    pub fn block(ct: &Volume<f32>, sigma: f64) -> [usize; 3] {
        block_within(ct.grid(), (BLOCK * sigma).max(sigma.min(COARSE_MM)))
    }

    /// Two figures of each voxel, blurred as [`Tissue::blurred`] blurs but not normalised.
    pub fn spread(ct: &Volume<f32>, sigma: f64, of: impl Fn(f32) -> [f32; 2] + Sync) -> [Volume<f32>; 2] {
        let block = Self::block(ct, sigma);
        let rest = blur_after(ct.grid(), block, sigma);
        block_means(ct, block, |_, hu| of(hu)).map(|mean| gaussian(&mean, rest))
    }

    /// Blurred HU at a world position, where that is tissue.
    pub fn at(&self, world: &Point3<f64>) -> Option<f64> {
        // Voxel centres of the fine grid reach up to half a block beyond those of the blocks.
        let index = self.value.grid().index_within(world);
        (self.share(&index).0 > 0.5).then(|| cubic(&self.value, &index).map(|v| v.0)).flatten()
    }

    /// Visibility of a continuous index and its derivative per index step: 1 in tissue, 0 in air and outside, with a
    /// ramp over the outermost voxel ([`EDGE_MM`] of fine ones) of the image and over the surface of the tissue.
    #[inline(always)]
    pub fn visibility(&self, index: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let (edge, edge_slope) = ramp(self.valid.grid(), index);
        if edge <= 0.0 {
            return (0.0, Vector3::zeros());
        }
        let (tissue, slope) = self.share(index);
        // Half-filled cells hold partial volume: only the inner half of the ramp counts.
        let (w, dw) = if tissue > 0.5 { (2.0 * tissue - 1.0, slope * 2.0) } else { (0.0, Vector3::zeros()) };
        (edge * w, edge_slope * w + dw * edge)
    }

    /// Share of tissue at an index inside the image, and its slope, trilinear.
    #[inline(always)]
    fn share(&self, index: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let grid = self.valid.grid();
        let (size, strides) = (grid.size(), grid.strides());
        let low: [usize; 3] = std::array::from_fn(|a| (index[a] as usize).min(size[a].saturating_sub(2)));
        let up: [usize; 3] = std::array::from_fn(|a| if size[a] > 1 { strides[a] } else { 0 });
        let base = grid.linear(low);
        let corner = |c: usize| self.valid.data()[base + (c & 1) * up[0] + (c >> 1 & 1) * up[1] + (c >> 2 & 1) * up[2]];
        let corners: [u8; 8] = std::array::from_fn(corner);
        // Nearly all of a bone lies where there is nothing else.
        if corners == [ALL; 8] {
            return (1.0, Vector3::zeros());
        }
        let t = std::array::from_fn(|a| index[a] - low[a] as f64);
        interpolation::corners(corners.map(|x| f64::from(x) / f64::from(ALL)), t)
    }
}

/// What a voxel adds to a sum over tissue: its HU, with metal cut; nothing in air.
#[inline(always)]
fn hu(v: f32) -> f32 {
    if v > AIR_HU { v.min(METAL_HU) } else { 0.0 }
}

/// What it adds to the amount of tissue.
#[inline(always)]
fn amount(v: f32) -> f32 {
    if v > AIR_HU { 1.0 } else { 0.0 }
}

/// A ramp from 0 at the outermost voxel centres to 1 a voxel or [`EDGE_MM`] further in.
#[inline(always)]
fn ramp(grid: &Grid, index: &Vector3<f64>) -> (f64, Vector3<f64>) {
    let (size, spacing) = (grid.size(), grid.spacing());
    let mut w = [1.0; 3];
    let mut d = [0.0; 3];
    for a in 0..3 {
        let last = (size[a] - 1) as f64;
        let slope = (spacing[a] / EDGE_MM).min(1.0);
        let (low, high) = (slope * index[a], slope * (last - index[a]));
        if low < 1.0 || high < 1.0 {
            (w[a], d[a]) = if low < high { (low.clamp(0.0, 1.0), slope) } else { (high.clamp(0.0, 1.0), -slope) };
        }
    }
    (w[0] * w[1] * w[2], Vector3::new(d[0] * w[1] * w[2], w[0] * d[1] * w[2], w[0] * w[1] * d[2]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tissue of 40 HU beyond the plane between voxels 7 and 8 along i, air before it.
    fn half() -> Volume<f32> {
        let grid = Grid::axis_aligned([16, 12, 12], [1.0; 3], [0.0; 3]).unwrap();
        Volume::from_fn(grid.clone(), |l| if grid.voxel(l)[0] >= 8 { 40.0 } else { -1000.0 })
    }

    #[test]
    fn air_does_not_bleed_into_tissue_at_any_blur() {
        // The last is averaged in blocks first.
        for sigma in [1.0, 4.0] {
            let tissue = Tissue::blurred(&half(), sigma);
            for x in [8.7, 10.0, 12.3] {
                let value = tissue.at(&Point3::new(x, 5.0, 5.0)).unwrap();
                assert!((value - 40.0).abs() < 1e-3, "{sigma} {x}: {value}");
            }
            assert_eq!(tissue.at(&Point3::new(4.0, 5.0, 5.0)), None, "{sigma}");
        }
    }

    #[test]
    fn what_is_wholly_visible_is_blurred_as_if_the_image_went_on() {
        // A slanted plate of bone in slices of 1 mm, which end at z = 10 in one image.
        let tissue = |first: usize| {
            let grid = Grid::axis_aligned([40, 12, 40 - first], [1.0; 3], [0.0, 0.0, first as f64]).unwrap();
            let plate = |p: Point3<f64>| if (p.x - p.z).abs() < 4.0 { 800.0 } else { 40.0 };
            Tissue::blurred(&Volume::from_fn(grid.clone(), |l| plate(grid.centre(grid.voxel(l))) as f32), 0.8)
        };
        let (whole, cut) = (tissue(0), tissue(10));
        let (mut wholly, mut partly) = (0.0f64, 0.0f64);
        for (x, z) in (5..25).flat_map(|x| (40..64).map(move |z| (f64::from(x) + 0.3, f64::from(z) / 4.0))) {
            let p = Point3::new(x, 6.0, z);
            let (weight, _) = cut.visibility(&cut.value.grid().index_within(&p));
            let Some(error) = whole.at(&p).zip(cut.at(&p)).map(|(w, c)| (w - c).abs()) else { continue };
            let worst = if weight < 1.0 { &mut partly } else { &mut wholly };
            *worst = worst.max(error);
        }
        assert!(wholly < 10.0 && partly > 50.0, "{wholly} {partly}");
    }

    #[test]
    fn visibility_has_the_slope_of_the_tissues_surface() {
        let tissue = Tissue::blurred(&half(), 0.0);
        for (x, visible, slope) in
            [(7.3, 0.0, 0.0), (7.6, 0.2, 2.0), (7.9, 0.8, 2.0), (8.0, 1.0, 0.0), (10.5, 1.0, 0.0)]
        {
            let (w, dw) = tissue.visibility(&Vector3::new(x, 5.4, 5.0));
            assert!((w - visible).abs() < 1e-6, "{x}: {w}");
            assert!((dw - Vector3::new(slope, 0.0, 0.0)).norm() < 1e-6, "{x}: {dw}");
        }
    }
    #[test]
    fn a_blur_by_blocks_is_as_wide_as_one_without() {
        // A bright plane, blurred by 4 mm: in blocks of 2 voxels where they are 1 mm wide, without where they are 3.
        let profile = |spacing: f64| {
            let n = (90.0 / spacing) as usize;
            let grid = Grid::axis_aligned([n, 24, 24], [spacing; 3], [-45.0, -36.0, -36.0]).unwrap();
            let slab = |x: f64| if x.abs() < 7.6 { 1000.0 } else { 0.0 };
            let ct = Volume::from_fn(grid.clone(), |l| slab(grid.centre(grid.voxel(l)).x) as f32);
            let tissue = Tissue::blurred(&ct, 4.0);
            let values = (0..n).map(|i| tissue.at(&Point3::new(-45.0 + i as f64 * spacing, 0.0, 0.0)));
            let moments = values.enumerate().filter_map(|(i, v)| Some((-45.0 + i as f64 * spacing, v?)));
            let (sum, square) = moments.fold((0.0, 0.0), |(s, q), (x, v)| (s + v, q + v * x * x));
            square / sum
        };
        // Variance of the slab itself and of the blur, mm2; the slab is as wide as its voxels.
        for (spacing, slab) in [(1.0, 15.0), (3.0, 15.0)] {
            let expected = slab * slab / 12.0 + 16.0;
            let found = profile(spacing);
            assert!((found / expected - 1.0).abs() < 0.03, "{spacing}: {found} {expected}");
        }
    }

    #[test]
    fn the_share_of_tissue_is_trilinear_with_its_slope() {
        let grid = Grid::axis_aligned([5, 6, 7], [1.0; 3], [0.0; 3]).unwrap();
        let ct = Volume::from_fn(grid.clone(), |l| if l * 7 % 5 < 3 { 40.0 } else { -1000.0 });
        let tissue = Tissue::blurred(&ct, 0.0);
        let share = |at: &Vector3<f64>| tissue.share(at);
        let at = Vector3::new(1.3, 2.6, 3.45);
        let by_hand = (0..8).map(|c| {
            let corner = [1 + (c & 1), 2 + (c >> 1 & 1), 3 + (c >> 2 & 1)];
            let weight: f64 = (0..3).map(|a| 1.0 - (at[a] - corner[a] as f64).abs()).product();
            weight * f64::from(u8::from(*ct.at(corner) > 0.0))
        });
        let (value, slope) = share(&at);
        assert!((value - by_hand.sum::<f64>()).abs() < 1e-12);
        for a in 0..3 {
            let step = Vector3::ith(a, 1e-4);
            let numeric = (share(&(at + step)).0 - share(&(at - step)).0) / 2e-4;
            assert!((slope[a] - numeric).abs() < 1e-9, "{a}: {} {numeric}", slope[a]);
        }
    }
}
