//! A treatment plan of the phantom: contours and a dose, analytic in planning space.
//!
//! The target lies left of the pharynx and close to the cord; the dose is level inside it, falls steeply outside, and is
//! held down around the cord, as intensity modulation does. No beam and no scatter: a dose to map, not to treat with.

use super::asymmetry::{MOST_MM, drawn_at};
use super::build::{chain, ell};
use super::shape::V3;
use super::solid::Solid;
use super::spine;
use super::texture::smoothstep;
use super::{Anatomy, Phantom};
use crate::error::Result;
use crate::geometry::Grid;
use crate::volume::Volume;
use crate::volume::contour::{Contours, Polygon, Structure, trace};
use nalgebra::{Matrix3, Point3};
use rayon::prelude::*;

/// Dose of the target, Gy.
const TARGET_GY: f64 = 60.0;
/// Margin of the planning target around the clinical one, mm.
const PTV_MARGIN: f64 = 5.0;
/// Fall-off of the steep part outside the target, mm.
const FALL_MM: f64 = 14.0;
/// Range of the shallow part, mm.
const SPREAD_MM: f64 = 45.0;
/// Reach of the sparing around the cord, mm.
const SPARED_MM: f64 = 13.0;
/// Half the width over which the dose fades at the skin, mm.
const SKIN_MM: f64 = 1.5;
/// Pixel of the contours, mm.
const PIXEL_MM: f64 = 1.0;

/// Contours and dose on the planning CT.
#[derive(Debug, Clone)]
pub struct Plan {
    /// `body`, `ctv`, `ptv`, `spinal_cord`, `brainstem`, `parotid_left`, `parotid_right`, on the planning CT's slices.
    pub contours: Contours,
    /// Dose, Gy, on a grid of its own.
    pub dose: Volume<f32>,
}

/// A named signed distance, negative inside, with its box.
struct Organ {
    name: &'static str,
    colour: [u8; 3],
    solid: Solid,
    /// How far the organ reaches beyond its solid, mm.
    grown: f64,
}

impl Organ {
    /// Signed distance to the organ, mm.
    fn distance(&self, p: &V3) -> f64 {
        self.solid.distance(&drawn_at(p)) - self.grown
    }
}

fn organs() -> Vec<Organ> {
    let cord: Vec<[f64; 4]> = spine::canal().iter().map(|&[x, y, z]| [x, y, z, 5.0]).collect();
    let ctv = || [ell([20.0, -24.0, -62.0], [17.0, 15.0, 26.0]), ell([30.0, -8.0, -78.0], [11.0, 11.0, 24.0])];
    let parotid = |side: f64| {
        [ell([58.0 * side, 4.0, -14.0], [10.0, 13.0, 20.0]), ell([62.0 * side, -16.0, -4.0], [6.0, 16.0, 11.0])]
    };
    let stem = chain(&[[0.0, 4.0, 38.0, 13.0], [0.0, 6.0, 20.0, 12.0], [0.0, 14.0, 0.0, 7.5]]);
    let organ = |name, colour, solid, grown| Organ { name, colour, solid, grown };
    vec![
        organ("ctv", [220, 40, 40], Solid::of(ctv()), 0.0),
        organ("ptv", [240, 140, 40], Solid::of(ctv()), PTV_MARGIN),
        organ("spinal_cord", [250, 220, 60], Solid::of(chain(&cord)), 0.0),
        organ("brainstem", [120, 200, 90], Solid::of(stem), 0.0),
        organ("parotid_left", [80, 160, 230], Solid::of(parotid(1.0)), 0.0),
        organ("parotid_right", [60, 110, 200], Solid::of(parotid(-1.0)), 0.0),
    ]
}

impl Phantom {
    /// Contours and dose of a plan on the planning CT.
    ///
    /// # Errors
    /// Never in practice; the dose has its grid's size.
    pub fn plan(&self) -> Result<Plan> {
        let organs = organs();
        let anatomy = self.motion.anatomy();
        let grid = self.planning.grid();
        let skin = |p: &V3| anatomy.skin_distance(&Point3::from(*p));
        let mut structures = vec![Structure {
            name: "body".into(),
            colour: Some([200, 200, 200]),
            polygons: drawn(grid, &[grid.origin().coords, grid.corners()[7].coords], &skin),
        }];
        structures.extend(organs.iter().map(|o| {
            let [low, high] = o.solid.bounds();
            let around = V3::repeat(o.grown + MOST_MM + 2.0 * PIXEL_MM);
            let inside = |p: &V3| o.distance(p).max(skin(p));
            let polygons = drawn(grid, &[low - around, high + around], &inside);
            Structure { name: o.name.into(), colour: Some(o.colour), polygons }
        }));
        let contours = Contours { axes: Matrix3::identity(), structures };
        Ok(Plan { contours, dose: dose(anatomy, &organs, &grid.coarsened(3.0))? })
    }
}

/// Polygons of what is below 0 inside a box, on the slices of an axis-aligned grid.
fn drawn(grid: &Grid, [low, high]: &[V3; 2], inside: &(impl Fn(&V3) -> f64 + Sync)) -> Vec<Polygon> {
    let (first, last) = (grid.origin().coords, grid.corners()[7].coords);
    let (low, high) = (low.sup(&first), high.inf(&last));
    let size = [0, 1].map(|a| ((high[a] - low[a]) / PIXEL_MM).ceil().max(1.0) as usize + 1);
    let heights: Vec<f64> =
        (0..grid.size()[2]).map(|k| grid.centre([0, 0, k]).z).filter(|z| (low.z..=high.z).contains(z)).collect();
    heights
        .into_par_iter()
        .flat_map_iter(|height| {
            let place = |at: [f64; 2]| [low.x + at[0] * PIXEL_MM, low.y + at[1] * PIXEL_MM];
            let depths: Vec<f64> = (0..size[0] * size[1])
                .map(|n| {
                    let [x, y] = place([(n % size[0]) as f64, (n / size[0]) as f64]);
                    -inside(&V3::new(x, y, height))
                })
                .collect();
            let polygons = trace(&depths, size);
            polygons.into_iter().map(move |p| Polygon { height, points: p.into_iter().map(place).collect() })
        })
        .collect()
}

/// The dose at every voxel.
fn dose(anatomy: &Anatomy, organs: &[Organ], grid: &Grid) -> Result<Volume<f32>> {
    let slice = grid.strides()[2];
    let mut out = vec![0f32; grid.len()];
    out.par_chunks_mut(slice).enumerate().for_each(|(k, out)| {
        for (n, dose) in out.iter_mut().enumerate() {
            *dose = dose_at(anatomy, organs, &grid.centre(grid.voxel(k * slice + n))) as f32;
        }
    });
    Volume::new(grid.clone(), out)
}

/// The dose at a planning point, Gy.
fn dose_at(anatomy: &Anatomy, organs: &[Organ], point: &Point3<f64>) -> f64 {
    let cover = smoothstep(SKIN_MM, -SKIN_MM, anatomy.skin_distance(point));
    let distance = |name: &str| {
        organs.iter().filter(|o| o.name == name).map(|o| o.distance(&point.coords)).fold(f64::MAX, f64::min)
    };
    let (target, cord) = (distance("ptv"), distance("spinal_cord").max(0.0));
    let outside = target.max(0.0);
    let shape = 0.62 * (1.0 - smoothstep(0.0, FALL_MM, outside)) + 0.38 * (-outside / SPREAD_MM).exp();
    let boost = 1.0 + 0.03 * (-target / 10.0).clamp(0.0, 1.0);
    // Nothing is spared inside the target.
    let spared = 0.6 * (-(cord / SPARED_MM).powi(2)).exp() * smoothstep(0.0, 4.0, outside);
    cover * TARGET_GY * shape * boost * (1.0 - spared)
}
