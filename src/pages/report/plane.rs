//! Planes through the world: axial, coronal and sagittal, whatever the grid's orientation, in true proportions.
//!
//! Radiological convention: patient right on image left, anterior on top (axial), head on top, anterior on the left
//! (sagittal).

use super::canvas::{Align, Canvas, Pen, Rgb};
use crate::geometry::Grid;
use crate::volume::{Spans, Volume, trilinear};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// A box in the world, LPS mm: least and greatest corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Region {
    pub(super) low: Point3<f64>,
    pub(super) high: Point3<f64>,
}

impl Region {
    /// The smallest box around some points; `None` without points.
    pub(super) fn around(points: impl IntoIterator<Item = Point3<f64>>) -> Option<Self> {
        points.into_iter().fold(None, |region, p| match region {
            None => Some(Self { low: p, high: p }),
            Some(r) => Some(Self { low: r.low.inf(&p), high: r.high.sup(&p) }),
        })
    }
    /// The box around a grid's voxel centres.
    pub(super) fn of(grid: &Grid) -> Self {
        let [first, rest @ ..] = grid.corners();
        rest.iter().fold(Self { low: first, high: first }, |r, p| Self { low: r.low.inf(p), high: r.high.sup(p) })
    }
    /// Grown by `margin` mm on all sides.
    pub(super) fn grown(self, margin: f64) -> Self {
        let by = Vector3::repeat(margin);
        Self { low: self.low - by, high: self.high + by }
    }
    /// The part inside `other`, or `other` when they do not meet.
    pub(super) fn within(self, other: Self) -> Self {
        let (low, high) = (self.low.sup(&other.low), self.high.inf(&other.high));
        if low.iter().zip(high.iter()).all(|(a, b)| a < b) { Self { low, high } } else { other }
    }
    pub(super) fn contains(&self, p: &Point3<f64>) -> bool {
        (0..3).all(|a| p[a] >= self.low[a] && p[a] <= self.high[a])
    }
    fn extent(&self) -> Vector3<f64> {
        self.high - self.low
    }
}

/// Orientation of a plane.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Across the body.
    Axial,
    /// From side to side.
    Coronal,
    /// From front to back.
    Sagittal,
}

/// Kinds in the order in which they are shown.
pub(super) const KINDS: [Kind; 3] = [Kind::Axial, Kind::Coronal, Kind::Sagittal];

impl Kind {
    /// World axis across the plane.
    pub(super) fn across(self) -> usize {
        match self {
            Self::Axial => 2,
            Self::Coronal => 1,
            Self::Sagittal => 0,
        }
    }
    /// Extent of a region to the right (axis 0) or down (1), mm.
    fn size(self, region: &Region, axis: usize) -> f64 {
        self.axes()[axis].dot(&region.extent()).abs().max(1.0)
    }
    /// World directions of image right and image down.
    fn axes(self) -> [Vector3<f64>; 2] {
        match self {
            Self::Axial => [Vector3::x(), Vector3::y()],
            Self::Coronal => [Vector3::x(), -Vector3::z()],
            Self::Sagittal => [Vector3::y(), -Vector3::z()],
        }
    }
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Axial => "axial",
            Self::Coronal => "coronal",
            Self::Sagittal => "sagittal",
        }
    }
}

/// A plane of the world as a picture of square pixels.
#[derive(Debug, Clone)]
pub(super) struct Plane {
    pub(super) kind: Kind,
    /// World position of the top left corner.
    corner: Point3<f64>,
    /// Pixels per mm.
    pub(super) scale: f64,
    pub(super) width: usize,
    pub(super) height: usize,
    /// Whether what is drawn over its pictures is kept apart from their pixels.
    shapes: bool,
}

/// Width of a picture, pixels: twice what it takes on the page, for print.
pub(super) const WIDTH: usize = 1080;
/// Largest height of the three planes together, pixels.
const MAX_HEIGHT: f64 = 2100.0;
/// Finest scale, pixels per mm: beyond it a picture shows interpolation only.
const MAX_SCALE: f64 = 6.0;

/// Axial, coronal and sagittal plane through a point, each cut to its region, all at one scale.
pub(super) fn planes(regions: &[Region; 3], through: &Point3<f64>) -> [Plane; 3] {
    let size = |kind: Kind, axis: usize| kind.size(&regions[kind as usize], axis);
    let widest = KINDS.map(|kind| size(kind, 0)).into_iter().fold(0.0, f64::max);
    let tall: f64 = KINDS.map(|kind| size(kind, 1)).iter().sum();
    let scale = (WIDTH as f64 / widest).min(MAX_HEIGHT / tall).min(MAX_SCALE);
    KINDS.map(|kind| Plane::at_scale(kind, &regions[kind as usize], through, scale))
}

/// The letter of a direction towards the patient's right, left, front, back, head or feet.
fn letter(direction: &Vector3<f64>) -> &'static str {
    let a = direction.iamax();
    [["L", "R"], ["P", "A"], ["H", "F"]][a][usize::from(direction[a] < 0.0)]
}

impl Plane {
    fn at_scale(kind: Kind, region: &Region, through: &Point3<f64>, scale: f64) -> Self {
        let pixels = |axis| (kind.size(region, axis) * scale).round().max(1.0) as usize;
        let mut corner = *through;
        for axis in kind.axes() {
            let a = axis.iamax();
            corner[a] = if axis[a] > 0.0 { region.low[a] } else { region.high[a] };
        }
        Self { kind, corner, scale, width: pixels(0).min(WIDTH), height: pixels(1), shapes: false }
    }

    /// One plane through a point, as large as a picture can be.
    pub(super) fn alone(kind: Kind, region: &Region, through: &Point3<f64>) -> Self {
        let [wide, high] = [0, 1].map(|axis| kind.size(region, axis));
        let scale = (WIDTH as f64 / wide).min(MAX_HEIGHT / high).min(MAX_SCALE);
        Self::at_scale(kind, region, through, scale)
    }

    /// What is drawn over its pictures stays apart from their pixels.
    pub(super) fn keeping_shapes(self) -> Self {
        Self { shapes: true, ..self }
    }

    /// The same part of the world with `factor` as many pixels along each side.
    pub(super) fn scaled(&self, factor: f64) -> Self {
        let pixels = |n: usize| ((n as f64 * factor).round() as usize).max(1);
        Self { scale: self.scale * factor, width: pixels(self.width), height: pixels(self.height), ..self.clone() }
    }

    /// World position of a place in the picture.
    pub(super) fn world(&self, x: f64, y: f64) -> Point3<f64> {
        let [right, down] = self.kind.axes();
        self.corner + right * (x / self.scale) + down * (y / self.scale)
    }

    /// Place of a world position in the picture, seen across the plane.
    pub(super) fn place(&self, p: &Point3<f64>) -> [f64; 2] {
        let [right, down] = self.kind.axes();
        let d = p - self.corner;
        [right.dot(&d) * self.scale, down.dot(&d) * self.scale]
    }

    /// Pixels of an in-plane part of a world vector.
    pub(super) fn vector(&self, v: &Vector3<f64>) -> [f64; 2] {
        let [right, down] = self.kind.axes();
        [right.dot(v) * self.scale, down.dot(v) * self.scale]
    }

    /// Coordinate of the plane along the world axis across it, mm.
    pub(super) fn at(&self) -> f64 {
        self.corner[self.kind.across()]
    }

    /// A picture with `colour` of each pixel's world position and of its number, row after row.
    pub(super) fn paint(&self, colour: impl Fn(Point3<f64>, usize) -> Rgb + Sync) -> Canvas {
        let columns: Vec<Vector3<f64>> = (0..self.width).map(|x| self.along(0, x)).collect();
        let mut canvas = Canvas::by_rows(self.width, self.height, |y, row| {
            let start = self.corner + self.along(1, y);
            let pixels = row.iter_mut().zip(&columns).zip(y * self.width..);
            pixels.for_each(|((pixel, column), n)| *pixel = colour(start + column, n));
        });
        if self.shapes {
            canvas.keep_shapes();
        }
        canvas
    }

    /// CT numbers at the pixels, row after row; negative infinity outside the image.
    pub(super) fn hu(&self, ct: &Volume<f32>) -> Vec<f32> {
        self.hu_moved(ct, &Vector3::zeros())
    }

    /// As [`Plane::hu`] of an image moved by `shift`.
    pub(super) fn hu_moved(&self, ct: &Volume<f32>, shift: &Vector3<f64>) -> Vec<f32> {
        let grid = ct.grid();
        let columns: Vec<Vector3<f64>> = (0..self.width).map(|x| grid.inverse_step() * self.along(0, x)).collect();
        let mut hu = vec![f32::NEG_INFINITY; self.width * self.height];
        hu.par_chunks_mut(self.width.max(1)).enumerate().for_each(|(y, row)| {
            let start = grid.index(&(self.corner + self.along(1, y) - shift));
            for (hu, column) in row.iter_mut().zip(&columns) {
                *hu = trilinear(ct, &(start + column)).map_or(f32::NEG_INFINITY, |hu| hu as f32);
            }
        });
        hu
    }

    /// From the corner to the middle of the pixel with this number across (axis 0) or down (1).
    fn along(&self, axis: usize, pixel: usize) -> Vector3<f64> {
        self.kind.axes()[axis] * ((pixel as f64 + 0.5) / self.scale)
    }

    /// What `value` makes of the point of each pixel, row after row.
    pub(super) fn each<T>(&self, value: impl Fn(&Point3<f64>) -> T) -> Vec<T> {
        let at = |n: usize| self.world((n % self.width) as f64 + 0.5, (n / self.width) as f64 + 0.5);
        (0..self.width * self.height).map(|n| value(&at(n))).collect()
    }

    /// Draws the borders between pixels with other values (see [`Plane::each`]): a line of `colour` and of the first
    /// opacity, and one of the second on its left.
    pub(super) fn borders<T: PartialEq>(&self, picture: &mut Canvas, values: &[T], colour: Rgb, [own, left]: [f64; 2]) {
        for y in 1..self.height {
            for x in 1..self.width {
                let n = x + self.width * y;
                if values[n] != values[n - 1] || values[n] != values[n - self.width] {
                    picture.blend(x as i64, y as i64, colour, own);
                    picture.blend(x as i64 - 1, y as i64, colour, left);
                }
            }
        }
    }

    /// Sets a picture of this plane in the middle of a row of the sheet, with orientation letters, the plane's name and
    /// position, and a scale bar.
    pub(super) fn row(&self, picture: &Canvas, backdrop: Rgb, colour: Rgb, halo: Rgb) -> Canvas {
        let mut row = Canvas::new(WIDTH, self.height, backdrop);
        let left = (WIDTH - self.width) / 2;
        row.paste(picture, left, 0);
        let pen = |size: f64, align| Pen { size, colour, halo: Some(halo), align };
        let edge = 22.0;
        let (middle, low) = (self.height as f64 / 2.0, self.height as f64 - edge);
        // Beside the picture where there is room, inside it otherwise.
        let aside = if left as f64 >= 2.0 * edge { -edge } else { edge };
        let (west, east) = (left as f64 + aside, (left + self.width) as f64 - aside);
        let centre = WIDTH as f64 / 2.0;
        let [right, down] = self.kind.axes();
        for (direction, x, y) in
            [(-right, west, middle), (right, east, middle), (-down, centre, edge), (down, centre, low)]
        {
            row.text(letter(&direction), [x, y], pen(32.0, Align::Centre));
        }
        let axis = ["x", "y", "z"][self.kind.across()];
        row.text(self.kind.name(), [14.0, edge], pen(26.0, Align::Left));
        row.text(&format!("{axis} = {:.1} mm", self.at()), [14.0, edge + 30.0], pen(26.0, Align::Left));
        self.scale_bar(&mut row, colour, halo);
        row
    }

    /// A bar of a round length in the lower right corner.
    fn scale_bar(&self, row: &mut Canvas, colour: Rgb, halo: Rgb) {
        let room = WIDTH as f64 / 5.0;
        let Some(mm) = [100.0, 50.0, 20.0, 10.0, 5.0, 2.0, 1.0].into_iter().find(|mm| mm * self.scale <= room) else {
            return;
        };
        let end = [WIDTH as f64 - 18.0, self.height as f64 - 16.0];
        let start = [end[0] - mm * self.scale, end[1]];
        row.line(start, end, 8.0, halo);
        row.line(start, end, 4.0, colour);
        let middle = [(start[0] + end[0]) / 2.0, end[1] - 22.0];
        row.text(&format!("{mm} mm"), middle, Pen { size: 26.0, colour, halo: Some(halo), align: Align::Centre });
    }
}

/// CT number at a world position; `None` outside the image.
pub(super) fn hu_at(ct: &Volume<f32>, p: &Point3<f64>) -> Option<f64> {
    trilinear(ct, &ct.grid().index(p))
}

/// Value of the voxel nearest to a world position; `None` outside the image.
pub(super) fn nearest<T: Copy>(volume: &Volume<T>, p: &Point3<f64>) -> Option<T> {
    volume.grid().voxel_at(p).map(|voxel| *volume.at(voxel))
}

/// The same of a map that is held in spans.
pub(super) fn nearest_held(map: &Spans<f32>, p: &Point3<f64>) -> Option<f32> {
    map.grid().voxel_at(p).map(|voxel| map.at(voxel))
}

/// Value of the cell (named by its lowest-index corner) that holds a world position; `None` outside the image.
pub(super) fn cell_at(map: &Spans<f32>, p: &Point3<f64>) -> Option<f32> {
    let grid = map.grid();
    let index = grid.index(p);
    let inside = (0..3).all(|a| index[a] >= 0.0 && index[a] < grid.size()[a] as f64);
    inside.then(|| map.at([0, 1, 2].map(|a| index[a] as usize)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    /// One scene on a grid with given axes: bright on the patient's left, brighter towards the head.
    fn scene(direction: Matrix3<f64>, origin: [f64; 3], size: [usize; 3]) -> Volume<f32> {
        let grid = Grid::new(size, [1.0; 3], origin.into(), direction).unwrap();
        Volume::from_fn(grid.clone(), |l| {
            let p = grid.centre(grid.voxel(l));
            (p.x * 10.0 + p.z) as f32
        })
    }

    #[test]
    fn flipped_and_permuted_grids_give_the_same_picture() {
        let plain = scene(Matrix3::identity(), [0.0; 3], [20, 16, 12]);
        let flipped = scene(Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, -1.0)), [19.0, 0.0, 11.0], [20, 16, 12]);
        let permuted =
            scene(Matrix3::new(0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0), [0.0, 0.0, 11.0], [16, 12, 20]);
        let region = Region::of(plain.grid());
        for other in [&flipped, &permuted] {
            assert_eq!(Region::of(other.grid()), region);
        }
        for plane in planes(&[region; 3], &Point3::new(9.0, 7.0, 5.0)) {
            let paint = |v: &Volume<f32>| {
                let hu = plane.hu(v);
                plane.paint(|_, n| [hu[n].round() as u8; 3])
            };
            for other in [&flipped, &permuted] {
                assert!(paint(&plain).difference(&paint(other)) <= 1, "rounding only");
            }
            if plane.kind != Kind::Sagittal {
                let picture = paint(&plain);
                let (left, right) = (picture.pixel(5, 5)[0], picture.pixel(plane.width - 5, 5)[0]);
                assert!(left < right, "patient left must be on image right");
            }
        }
    }

    #[test]
    fn places_and_letters() {
        let region = Region { low: Point3::new(-100.0, -50.0, 0.0), high: Point3::new(100.0, 50.0, 80.0) };
        let [axial, coronal, sagittal] = planes(&[region; 3], &Point3::new(10.0, 20.0, 30.0));
        assert_eq!((axial.width, axial.height, coronal.height, sagittal.width), (1080, 540, 432, 540));
        assert!((axial.scale - 5.4).abs() < 1e-12);
        assert_eq!((axial.at(), coronal.at(), sagittal.at()), (30.0, 20.0, 10.0));
        // Head is up and front is on the left.
        for [x, y] in [coronal.place(&Point3::new(-100.0, 0.0, 80.0)), sagittal.place(&Point3::new(0.0, -50.0, 80.0))] {
            assert!(x.abs() < 1e-9 && y.abs() < 1e-9);
        }
        // Forwards is left, headwards is up, patient left is right.
        assert!(
            sagittal.vector(&-Vector3::y())[0] < 0.0
                && coronal.vector(&Vector3::z())[1] < 0.0
                && axial.vector(&Vector3::x())[0] > 0.0
        );
        let p = axial.world(270.0, 135.0);
        assert!((p - Point3::new(-50.0, -25.0, 30.0)).norm() < 1e-9);
        for (kind, marks) in [
            (Kind::Axial, ["R", "L", "A", "P"]),
            (Kind::Coronal, ["R", "L", "H", "F"]),
            (Kind::Sagittal, ["A", "P", "H", "F"]),
        ] {
            let [right, down] = kind.axes();
            assert_eq!([-right, right, -down, down].map(|d| letter(&d)), marks);
        }
    }
}
