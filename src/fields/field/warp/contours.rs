//! Contours through a chain: the structure as a solid of its first frame, cut by the planes of the new one.

use super::super::chain::{Chain, ChainReport, Mapped};
use crate::geometry::Grid;
use crate::volume::contour::{Contours, Polygon, Solid, Structure, trace};
use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;

/// Largest pixel that a plane is sampled with, mm.
const PIXEL_MM: f64 = 1.0;
/// Margin around the mapped polygons, mm.
const MARGIN_MM: f64 = 4.0;
/// How much farther samples are taken first where a structure reaches to the last, mm; then twice as much, and so on.
const GROWTH_MM: f64 = 16.0;
/// No farther than this, samples.
const MOST_GROWTH: i64 = 2048;
/// Distance to the surface within which inversions count in the report, mm.
const NEAR_MM: f64 = 2.0;

/// The planes of a grid's slices, for contours.
struct Planes<'a> {
    grid: &'a Grid,
    /// Columns: slice axes and normal.
    axes: Matrix3<f64>,
    pixel: f64,
}

/// Contours on the slices of `target`, a grid of the frame that `forward` leads to and `back` comes from.
///
/// On each slice the structure's depth is sampled at 1 mm or the slice's own pixel, whichever is smaller, and its zero
/// line is traced; so structures may part, merge and change their number of slices. A structure that meets no slice
/// keeps its name and has no polygon. The report counts the samples near the surfaces.
pub fn resample_contours(
    contours: &Contours,
    forward: &Chain<'_>,
    back: &Chain<'_>,
    target: &Grid,
) -> (Contours, ChainReport) {
    let [i, j] = [0, 1].map(|a| target.direction().column(a).into_owned());
    let [si, sj, sk] = target.spacing();
    let axes = Matrix3::from_columns(&[i, j, i.cross(&j)]);
    let planes = Planes { grid: target, axes, pixel: PIXEL_MM.min(si).min(sj) };
    let mut near = Vec::new();
    let structures = contours
        .structures
        .iter()
        .map(|s| {
            let moved: Vec<Vector3<f64>> = s
                .polygons
                .par_iter()
                .flat_map_iter(|p| p.points.iter().map(|q| contours.world(*q, p.height)))
                .map(|p| axes.transpose() * forward.map(&p).point.coords)
                .collect();
            let polygons = if moved.is_empty() {
                Vec::new()
            } else {
                let spacing = contours.spacing_of(s, sk);
                let (polygons, samples) = planes.cut(&contours.solid(s, spacing), back, &moved, spacing);
                near.extend(samples);
                polygons
            };
            Structure { name: s.name.clone(), colour: s.colour, polygons }
        })
        .collect();
    (Contours { axes, structures }, ChainReport::of(&near))
}

/// Samples of a plane, counted from the middle of the grid's first voxel: what lies between them is sampled, whatever the
/// structure, so that two ways to the same motion give the same polygons.
#[derive(Clone, Copy)]
struct Window {
    low: [i64; 2],
    high: [i64; 2],
}

impl Window {
    fn size(&self) -> [usize; 2] {
        [0, 1].map(|a| (self.high[a] - self.low[a]) as usize + 1)
    }

    /// Grown on the sides where samples lie inside of the solid; `None` where there are none.
    fn grown(&self, depths: &[f64], by: i64) -> Option<Self> {
        let [ni, nj] = self.size();
        let inside = |n: usize| depths[n] > 0.0;
        let sides = [
            (0..nj).any(|j| inside(j * ni)),
            (0..nj).any(|j| inside(j * ni + ni - 1)),
            (0..ni).any(inside),
            (0..ni).any(|i| inside((nj - 1) * ni + i)),
        ];
        let [left, right, front, back] = sides.map(|any| i64::from(any) * by);
        sides.contains(&true).then(|| Self {
            low: [self.low[0] - left, self.low[1] - front],
            high: [self.high[0] + right, self.high[1] + back],
        })
    }
}

impl Planes<'_> {
    /// Where the first voxel lies along the axes, mm.
    fn origin(&self) -> Vector3<f64> {
        self.axes.transpose() * self.grid.origin().coords
    }

    /// A solid's polygons on the slices around the points `moved` (slice axes and normal, mm), and its samples near the
    /// surface. Where it reaches farther than they tell, since some have no place in the new frame, so do the samples.
    fn cut(
        &self,
        solid: &Solid,
        back: &Chain<'_>,
        moved: &[Vector3<f64>],
        spacing: f64,
    ) -> (Vec<Polygon>, Vec<Mapped>) {
        let start = [Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN)];
        let [low, high] = moved.iter().fold(start, |[low, high], p| [low.inf(p), high.sup(p)]);
        let margin = Vector3::new(MARGIN_MM, MARGIN_MM, MARGIN_MM.max(spacing));
        let (low, high, origin) = (low - margin, high + margin, self.origin());
        let window = Window {
            low: [0, 1].map(|a| ((low[a] - origin[a]) / self.pixel).floor() as i64),
            high: [0, 1].map(|a| ((high[a] - origin[a]) / self.pixel).ceil() as i64),
        };
        let height = |k: usize| self.axes.column(2).dot(&self.grid.centre([0, 0, k]).coords);
        let slices = 0..self.grid.size()[2];
        let first = slices.clone().find(|&k| height(k) >= low.z).unwrap_or(slices.end);
        let end = slices.clone().rfind(|&k| height(k) <= high.z).map_or(first, |k| k + 1).max(first);
        let slice = |k: usize| self.slice(solid, back, window, height(k));
        let mut cut: Vec<(Vec<Polygon>, Vec<Mapped>)> = (first..end).into_par_iter().map(slice).collect();
        let reaches = |one: Option<&(Vec<Polygon>, Vec<Mapped>)>| one.is_some_and(|(polygons, _)| !polygons.is_empty());
        let below = (0..first).rev().map(slice).take_while(|one| reaches(Some(one)));
        let below: Vec<_> = if reaches(cut.first()) { below.collect() } else { Vec::new() };
        let above = (end..slices.end).map(slice).take_while(|one| reaches(Some(one)));
        let above: Vec<_> = if reaches(cut.last()) { above.collect() } else { Vec::new() };
        cut.splice(0..0, below.into_iter().rev());
        cut.extend(above);
        let (polygons, near): (Vec<_>, Vec<_>) = cut.into_iter().unzip();
        (polygons.concat(), near.concat())
    }

    /// The polygons on the plane of one slice, and the samples near the surface.
    fn slice(&self, solid: &Solid, back: &Chain<'_>, mut window: Window, height: f64) -> (Vec<Polygon>, Vec<Mapped>) {
        let origin = self.origin();
        let mut grow = (GROWTH_MM / self.pixel).ceil() as i64;
        loop {
            let (size, low) = (window.size(), window.low.map(|l| l as f64));
            let place = |at: [f64; 2]| [0, 1].map(|a| origin[a] + (low[a] + at[a]) * self.pixel);
            let mut near = Vec::new();
            let sample = |n: usize| {
                let [u, v] = place([(n % size[0]) as f64, (n / size[0]) as f64]);
                let mapped = back.map(&Point3::from(self.axes * Vector3::new(u, v, height)));
                let depth = solid.depth(&mapped.point);
                if depth.abs() < NEAR_MM {
                    near.push(mapped);
                }
                depth
            };
            let depths: Vec<f64> = (0..size[0] * size[1]).map(sample).collect();
            if let Some(wider) = window.grown(&depths, grow).filter(|_| grow < MOST_GROWTH) {
                (window, grow) = (wider, 2 * grow);
                continue;
            }
            let polygon = |points: Vec<[f64; 2]>| Polygon { height, points: points.into_iter().map(place).collect() };
            return (trace(&depths, size).into_iter().map(polygon).collect(), near);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::{InvertOptions, Link, Motion};
    use crate::geometry::{Rigid, about};
    use crate::volume::Volume;
    use nalgebra::Rotation3;
    use std::f64::consts::{PI, TAU};

    /// A ball of 15 mm about (2, 3, 4) on planes of 2 mm.
    fn ball() -> Contours {
        let polygons = (-7..=7)
            .map(|k| {
                let z = 2.0 * f64::from(k);
                let r = (225.0 - z * z).sqrt();
                let at = |n: u32| (TAU * f64::from(n) / 120.0).sin_cos();
                let points = (0..120).map(|n| [2.0 + r * at(n).1, 3.0 + r * at(n).0]).collect();
                Polygon { height: 4.0 + z, points }
            })
            .collect();
        let ball = Structure { name: "ball".into(), colour: Some([255, 0, 0]), polygons };
        Contours { axes: Matrix3::identity(), structures: vec![ball] }
    }

    fn mapped(links: &[Link], target: &Grid) -> (Contours, ChainReport) {
        let options = InvertOptions::default();
        let forward = Chain::between(links, "a", "b", &options).unwrap();
        let back = Chain::between(links, "b", "a", &options).unwrap();
        resample_contours(&ball(), &forward, &back, target)
    }

    fn link(motion: Motion) -> [Link; 1] {
        [Link { name: "m".into(), from: "a".into(), to: "b".into(), motion }]
    }

    #[test]
    fn a_ball_stays_a_ball_on_other_and_oblique_planes() {
        let turn: Rigid =
            about(&Point3::new(5.0, 0.0, 0.0), Vector3::new(0.3, -0.2, 0.5), Vector3::new(10.0, 20.0, 30.0));
        let centre = turn * Point3::new(2.0, 3.0, 4.0);
        for tilt in [0.0, 0.4] {
            let direction = Rotation3::from_axis_angle(&Vector3::x_axis(), tilt).into_inner();
            let origin = centre - direction * Vector3::new(40.0, 40.0, 37.5);
            let target = Grid::new([80, 80, 26], [1.0, 1.0, 3.0], origin, direction).unwrap();
            let (out, report) = mapped(&link(Motion::Rigid(turn)), &target);
            let ball = &out.structures[0];
            let middle = out.axes.column(2).dot(&centre.coords);
            assert_eq!((ball.name.as_str(), ball.colour, report.unsolved), ("ball", Some([255, 0, 0]), 0));
            assert_eq!(ball.heights().len(), 10);
            for h in ball.heights() {
                let truth = PI * (225.0 - (h - middle).powi(2));
                // Planes of 2 mm make a ball of frusta; towards the poles it is blunt.
                if (h - middle).abs() < 12.0 {
                    assert!(
                        (ball.area(h) / truth - 1.0).abs() < 0.025,
                        "tilt {tilt}, {}: {}",
                        h - middle,
                        ball.area(h) / truth
                    );
                }
            }
        }
    }

    /// What is known of where a structure goes may be a part of it: it is not cut off there.
    #[test]
    fn a_structure_is_shown_beyond_the_points_that_are_known_to_move() {
        let target = Grid::axis_aligned([40, 40, 20], [1.0, 1.0, 2.0], [-17.3, -16.8, -14.0]).unwrap();
        let planes = Planes { grid: &target, axes: Matrix3::identity(), pixel: PIXEL_MM };
        let links = link(Motion::Rigid(Rigid::identity()));
        let options = InvertOptions::default();
        let back = Chain::between(&links, "b", "a", &options).unwrap();
        let contours = ball();
        let whole = &contours.structures[0];
        let known = [Vector3::new(2.0, 3.0, 4.0)];
        let (polygons, _) = planes.cut(&contours.solid(whole, 2.0), &back, &known, 2.0);
        let found = Structure { name: String::new(), colour: None, polygons };
        assert_eq!(found.heights(), whole.heights());
        for h in whole.heights() {
            assert!((found.area(h) / whole.area(h) - 1.0).abs() < 0.01, "{h}: {} {}", found.area(h), whole.area(h));
        }
    }

    #[test]
    fn a_push_field_is_inverted_and_the_area_grows_with_it() {
        let grid = Grid::axis_aligned([41, 41, 41], [2.0; 3], [-40.0; 3]).unwrap();
        let grow =
            Volume::from_fn(grid.clone(), |l| grid.centre(grid.voxel(l)).coords.map(|c| (0.1 * c) as f32).into());
        let (out, report) = mapped(&link(Motion::Field(Box::new(grow))), &grid);
        let ball = &out.structures[0];
        assert!(report.residual_mm.unwrap().max < 1e-3 && report.unsolved == 0);
        let truth = PI * (1.21 * 225.0 - (4.4f64 - 4.0).powi(2));
        assert!((ball.area(4.0) / truth - 1.0).abs() < 0.005, "{}", ball.area(4.0) / truth);
        let volume: f64 = ball.heights().iter().map(|h| 2.0 * ball.area(*h)).sum();
        assert!((volume / (1.331 * 4.0 / 3.0 * PI * 3375.0) - 1.0).abs() < 0.02, "{volume}");
    }
}
