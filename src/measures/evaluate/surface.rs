//! The surface of a solid that voxels describe, as triangles, and distances to it.
//!
//! Surface nets (Gibson, "Constrained elastic surface nets", MICCAI 1998): a vertex in every cell of eight voxel centres
//! that the surface passes through, at the mean of the crossed edges' middles, then smoothed without shrinking (Taubin 1995)
//! but never out of its cell. Steps of the voxels vanish; a structure one voxel thin stays.

use crate::geometry::Grid;
use crate::volume::Volume;
use nalgebra::{Point3, Vector3};

/// A triangulated surface with a search tree. World frame, LPS mm.
#[derive(Debug, Clone)]
pub struct Surface {
    /// Vertices.
    pub vertices: Vec<Point3<f64>>,
    /// Area that each vertex stands for, mm^2.
    pub areas: Vec<f64>,
    triangles: Vec<[u32; 3]>,
    nodes: Vec<SurfaceNode>,
}

/// A box of the search tree: a leaf holds triangles `from..to`, an inner box the children `from` and `to`.
#[derive(Debug, Clone)]
struct SurfaceNode {
    low: Point3<f64>,
    high: Point3<f64>,
    from: u32,
    to: u32,
    leaf: bool,
}

/// Triangles of a leaf.
const LEAF: usize = 6;
/// Rounds of smoothing: a step in, a step out each, so that nothing shrinks (Taubin, SIGGRAPH 1995).
const ROUNDS: usize = 8;
const STEPS: [f64; 2] = [0.5, -0.53];
const NONE: u32 = u32::MAX;

impl Surface {
    /// The surface of the voxels whose value satisfies `inside`; `None` when there are none. The image's edge closes it.
    pub fn of<T: Copy>(volume: &Volume<T>, inside: impl Fn(T) -> bool) -> Option<Self> {
        let net = Net::new(volume, inside)?;
        let vertices = net.smoothed(volume.grid());
        let mut areas = vec![0.0; vertices.len()];
        let mut triangles = Vec::with_capacity(2 * net.quads.len());
        for [a, b, c, d] in &net.quads {
            for t in [[*a, *b, *c], [*a, *c, *d]] {
                let p = t.map(|v| vertices[v as usize]);
                let area = (p[1] - p[0]).cross(&(p[2] - p[0])).norm() / 2.0;
                t.iter().for_each(|v| areas[*v as usize] += area / 3.0);
                triangles.push(t);
            }
        }
        let nodes = Vec::with_capacity(nodes_over(triangles.len()));
        let mut surface = Self { vertices, areas, triangles, nodes };
        surface.build(0, surface.triangles.len());
        Some(surface)
    }

    /// Total area, mm^2.
    pub fn area(&self) -> f64 {
        self.areas.iter().sum()
    }

    /// Distance of each of `points` to the surface, mm. Neighbouring points in the list are found faster.
    pub fn distances(&self, points: &[Point3<f64>]) -> Vec<f64> {
        let mut last = 0;
        points
            .iter()
            .map(|p| {
                let (square, triangle) = self.nearest(p, last);
                last = triangle;
                square.sqrt()
            })
            .collect()
    }

    /// The nearest point of the surface to each of `points`. Neighbouring points in the list are found faster.
    pub fn closest(&self, points: &[Point3<f64>]) -> Vec<Point3<f64>> {
        let mut last = 0;
        let one = |p: &Point3<f64>| {
            last = self.nearest(p, last).1;
            p - from_nearest(p, &self.corners(last))
        };
        points.iter().map(one).collect()
    }

    fn corners(&self, triangle: usize) -> [Point3<f64>; 3] {
        self.triangles[triangle].map(|v| self.vertices[v as usize])
    }

    /// Squared distance to the nearest triangle, and that triangle; `hint` is tried first.
    fn nearest(&self, p: &Point3<f64>, hint: usize) -> (f64, usize) {
        let mut best = (squared_distance(p, &self.corners(hint)), hint);
        let mut stack = vec![0u32];
        while let Some(n) = stack.pop() {
            let node = &self.nodes[n as usize];
            if node.squared_distance(p) >= best.0 {
                continue;
            }
            if node.leaf {
                for t in node.from as usize..node.to as usize {
                    let square = squared_distance(p, &self.corners(t));
                    if square < best.0 {
                        best = (square, t);
                    }
                }
            } else {
                let [a, b] = [node.from, node.to].map(|c| (self.nodes[c as usize].squared_distance(p), c));
                // The nearer child is looked at first: it comes last onto the stack.
                let (near, far) = if a.0 <= b.0 { (a.1, b.1) } else { (b.1, a.1) };
                stack.extend([far, near]);
            }
        }
        best
    }

    /// Builds the tree over triangles `from..to`, which it sorts; returns the node.
    fn build(&mut self, from: usize, to: usize) -> u32 {
        let start = [Point3::from([f64::MAX; 3]), Point3::from([f64::MIN; 3])];
        let [low, high] =
            (from..to).flat_map(|t| self.corners(t)).fold(start, |[low, high], p| [low.inf(&p), high.sup(&p)]);
        let at = self.nodes.len() as u32;
        self.nodes.push(SurfaceNode { low, high, from: from as u32, to: to as u32, leaf: true });
        if to - from > LEAF {
            let axis = (high - low).imax();
            let vertices = &self.vertices;
            let middle = |t: &[u32; 3]| t.iter().map(|v| vertices[*v as usize][axis]).sum::<f64>();
            let half = (to - from) / 2;
            self.triangles[from..to].select_nth_unstable_by(half, |a, b| middle(a).total_cmp(&middle(b)));
            let first = self.build(from, from + half);
            let second = self.build(from + half, to);
            let node = &mut self.nodes[at as usize];
            (node.from, node.to, node.leaf) = (first, second, false);
        }
        at
    }
}

impl SurfaceNode {
    fn squared_distance(&self, p: &Point3<f64>) -> f64 {
        (0..3).map(|a| (self.low[a] - p[a]).max(p[a] - self.high[a]).max(0.0).powi(2)).sum()
    }
}

fn squared_distance(p: &Point3<f64>, triangle: &[Point3<f64>; 3]) -> f64 {
    from_nearest(p, triangle).norm_squared()
}

/// From the nearest point of a triangle to a point (Ericson, Real-Time Collision Detection, 5.1.5).
fn from_nearest(p: &Point3<f64>, [a, b, c]: &[Point3<f64>; 3]) -> Vector3<f64> {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return ap;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return bp;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return ap - ab * (d1 / (d1 - d3).max(f64::MIN_POSITIVE));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return cp;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return ap - ac * (d2 / (d2 - d6).max(f64::MIN_POSITIVE));
    }
    let va = d3 * d6 - d5 * d4;
    let (e, f) = (d4 - d3, d5 - d6);
    if va <= 0.0 && e >= 0.0 && f >= 0.0 {
        return bp - (c - b) * (e / (e + f).max(f64::MIN_POSITIVE));
    }
    let sum = (va + vb + vc).max(f64::MIN_POSITIVE);
    ap - ab * (vb / sum) - ac * (vc / sum)
}

/// Nodes of the tree over so many triangles.
fn nodes_over(triangles: usize) -> usize {
    let half = triangles / 2;
    if triangles <= LEAF { 1 } else { 1 + nodes_over(half) + nodes_over(triangles - half) }
}

/// Vertices, one per crossed cell, and the quadrilaterals between them.
struct Net {
    /// Cell of each vertex: its lowest corner in voxels, from -1.
    cells: Vec<[i32; 3]>,
    /// Start positions, continuous voxel index.
    at: Vec<Vector3<f64>>,
    quads: Vec<[u32; 4]>,
}

/// The neighbours of all vertices, one vertex after the other.
struct Neighbours {
    /// Where those of each vertex begin, and the end.
    ends: Vec<u32>,
    all: Vec<u32>,
}

impl Neighbours {
    fn of(&self, vertex: usize) -> &[u32] {
        &self.all[self.ends[vertex] as usize..self.ends[vertex + 1] as usize]
    }
}

impl Net {
    fn new<T: Copy>(volume: &Volume<T>, inside: impl Fn(T) -> bool) -> Option<Self> {
        let grid = volume.grid();
        let size = grid.size().map(|n| n as i32);
        let (low, high) = bounds(volume, &inside)?;
        let value =
            |v: [i32; 3]| (0..3).all(|a| v[a] >= 0 && v[a] < size[a]) && inside(*volume.at(v.map(|c| c as usize)));
        // Cells from one before the first voxel to the last one.
        let extent: [usize; 3] = std::array::from_fn(|a| (high[a] - low[a] + 2) as usize);
        let slot = |c: [i32; 3]| {
            let [x, y, z]: [usize; 3] = std::array::from_fn(|a| (c[a] - low[a] + 1) as usize);
            x + extent[0] * (y + extent[1] * z)
        };
        let mut ids = vec![NONE; extent.iter().product()];
        let mut net = Self { cells: Vec::new(), at: Vec::new(), quads: Vec::new() };
        for z in low[2] - 1..=high[2] {
            for y in low[1] - 1..=high[1] {
                for x in low[0] - 1..=high[0] {
                    let corners: [bool; 8] = std::array::from_fn(|c| value(corner([x, y, z], c)));
                    if let Some(at) = crossing(&corners) {
                        ids[slot([x, y, z])] = net.at.len() as u32;
                        net.at.push(Vector3::new(f64::from(x), f64::from(y), f64::from(z)) + at);
                        net.cells.push([x, y, z]);
                    }
                }
            }
        }
        // Each crossed edge from a voxel to its next along an axis has four cells around it.
        for z in low[2] - 1..=high[2] {
            for y in low[1] - 1..=high[1] {
                for x in low[0] - 1..=high[0] {
                    let v = [x, y, z];
                    let here = value(v);
                    for a in 0..3 {
                        let mut next = v;
                        next[a] += 1;
                        if here != value(next) {
                            net.quads.push(around(v, a).map(|cell| ids[slot(cell)]));
                        }
                    }
                }
            }
        }
        Some(net)
    }

    /// The vertices around each vertex, in the order of the quadrilaterals.
    fn neighbours(&self) -> Neighbours {
        let pairs = || self.quads.iter().flat_map(|q| (0..4).map(|n| (q[n] as usize, q[(n + 1) % 4] as usize)));
        let mut ends = vec![0u32; self.at.len() + 1];
        pairs().for_each(|(a, b)| {
            ends[a + 1] += 1;
            ends[b + 1] += 1;
        });
        (1..ends.len()).for_each(|n| ends[n] += ends[n - 1]);
        let mut all = vec![NONE; 8 * self.quads.len()];
        let mut next = ends.clone();
        let mut put = |at: usize, neighbour: usize| {
            all[next[at] as usize] = neighbour as u32;
            next[at] += 1;
        };
        pairs().for_each(|(a, b)| {
            put(a, b);
            put(b, a);
        });
        Neighbours { ends, all }
    }

    /// Vertices in the world, smoothed inside their cells.
    fn smoothed(&self, grid: &Grid) -> Vec<Point3<f64>> {
        // Smoothing acts in millimetres, so that thick slices do not pull.
        let scale = Vector3::from(grid.spacing());
        let mut at: Vec<Vector3<f64>> = self.at.iter().map(|p| p.component_mul(&scale)).collect();
        let neighbours = self.neighbours();
        for step in STEPS.into_iter().cycle().take(2 * ROUNDS) {
            let moved = (0..at.len()).map(|n| {
                let near = neighbours.of(n);
                let mean = near.iter().map(|m| at[*m as usize]).sum::<Vector3<f64>>() / near.len().max(1) as f64;
                let to = at[n] + (mean - at[n]) * step;
                let cell = Vector3::from(self.cells[n].map(f64::from));
                let inside = |a: usize| to[a].clamp(cell[a] * scale[a], (cell[a] + 1.0) * scale[a]);
                Vector3::new(inside(0), inside(1), inside(2))
            });
            at = moved.collect();
        }
        at.iter().map(|p| grid.world(&p.component_div(&scale))).collect()
    }
}

/// The four cells around the edge from voxel `v` along axis `a`, in turn.
fn around(v: [i32; 3], a: usize) -> [[i32; 3]; 4] {
    [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[b, c]| {
        let mut cell = v;
        cell[(a + 1) % 3] -= b;
        cell[(a + 2) % 3] -= c;
        cell
    })
}

/// Corner `c` of a cell; bit 0, 1, 2 say whether it lies high along i, j, k.
fn corner(cell: [i32; 3], c: usize) -> [i32; 3] {
    std::array::from_fn(|a| cell[a] + (c >> a & 1) as i32)
}

/// Mean of the middles of a cell's crossed edges, in cells; `None` when none is crossed.
fn crossing(corners: &[bool; 8]) -> Option<Vector3<f64>> {
    let (mut sum, mut count) = (Vector3::zeros(), 0);
    for c in 0..8usize {
        for a in (0..3).filter(|a| c >> a & 1 == 0) {
            if corners[c] != corners[c | 1 << a] {
                let mut middle = Vector3::new((c & 1) as f64, (c >> 1 & 1) as f64, (c >> 2 & 1) as f64);
                middle[a] = 0.5;
                sum += middle;
                count += 1;
            }
        }
    }
    (count > 0).then(|| sum / f64::from(count))
}

/// Least and greatest voxel inside.
fn bounds<T: Copy>(volume: &Volume<T>, inside: impl Fn(T) -> bool) -> Option<([i32; 3], [i32; 3])> {
    let mut found: Option<([i32; 3], [i32; 3])> = None;
    for (l, _) in volume.data().iter().enumerate().filter(|(_, v)| inside(**v)) {
        let v = volume.grid().voxel(l).map(|c| c as i32);
        let (low, high) = found.unwrap_or((v, v));
        found = Some((std::array::from_fn(|a| low[a].min(v[a])), std::array::from_fn(|a| high[a].max(v[a]))));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn ball(radius: f64, spacing: [f64; 3]) -> Surface {
        let size = spacing.map(|s| (2.4 * radius / s) as usize);
        let grid = Grid::axis_aligned(size, spacing, [-1.2 * radius; 3]).unwrap();
        let mask = Volume::from_fn(grid.clone(), |l| grid.centre(grid.voxel(l)).coords.norm() <= radius);
        Surface::of(&mask, |v| v).unwrap()
    }

    #[test]
    fn a_ball_has_its_radius_and_area() {
        for spacing in [[1.0; 3], [1.0, 1.0, 2.0], [0.7, 1.1, 0.9]] {
            let s = ball(20.0, spacing);
            let area = 4.0 * std::f64::consts::PI * 400.0;
            assert!((s.area() / area - 1.0).abs() < 0.02, "{spacing:?}: {} {area}", s.area());
            let mean = s.vertices.iter().zip(&s.areas).map(|(p, a)| p.coords.norm() * a).sum::<f64>() / s.area();
            assert!((mean - 20.0).abs() < 0.1, "{spacing:?}: {mean}");
        }
    }

    #[test]
    fn one_voxel_is_a_solid_too() {
        let grid = Grid::axis_aligned([3, 3, 3], [1.0; 3], [0.0; 3]).unwrap();
        let s = Surface::of(&Volume::from_fn(grid.clone(), |l| l == 13), |v| v).unwrap();
        assert_eq!(s.vertices.len(), 8);
        assert!(Surface::of(&Volume::filled(grid, false), |v| v).is_none());
    }

    /// Distance to a triangle by another way: the plane where the foot lies inside, else the nearest of the edges.
    fn by_plane_and_edges(p: &Point3<f64>, corners: &[Point3<f64>; 3]) -> f64 {
        let edge = |a: &Point3<f64>, b: &Point3<f64>| {
            let along = b - a;
            let t = ((p - a).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
            (p - (a + along * t)).norm()
        };
        let [a, b, c] = corners;
        let edges = edge(a, b).min(edge(b, c)).min(edge(c, a));
        let normal = (b - a).cross(&(c - a)).normalize();
        let foot = p - normal * normal.dot(&(p - a));
        let left = |a: &Point3<f64>, b: &Point3<f64>| (b - a).cross(&(foot - a)).dot(&normal) >= 0.0;
        let inside = left(a, b) && left(b, c) && left(c, a);
        if inside { normal.dot(&(p - a)).abs() } else { edges }
    }

    proptest! {
        #[test]
        fn a_triangle_is_as_far_as_its_plane_or_its_edges(
            corners in prop::array::uniform3(prop::array::uniform3(-5.0f64..5.0)),
            p in prop::array::uniform3(-8.0f64..8.0),
        ) {
            let (corners, p) = (corners.map(Point3::from), Point3::from(p));
            let [a, b, c] = corners;
            prop_assume!((b - a).cross(&(c - a)).norm() > 0.1);
            let expected = by_plane_and_edges(&p, &corners);
            prop_assert!((squared_distance(&p, &corners).sqrt() - expected).abs() < 1e-9);
        }

        #[test]
        fn the_tree_finds_what_all_triangles_give(p in prop::array::uniform3(-30.0f64..30.0)) {
            let s = ball(9.0, [1.0; 3]);
            let p = Point3::from(p);
            let all = (0..s.triangles.len()).map(|t| squared_distance(&p, &s.corners(t))).fold(f64::MAX, f64::min);
            prop_assert!((s.distances(&[p])[0] - all.sqrt()).abs() < 1e-12);
        }
    }
}
