//! Holes as keyholes: an inner polygon joined to what surrounds it by a line there and back (PS3.3 C.8.8.6.3).
//!
//! aventail has inner polygons as holes (even-odd rule). CLOSED_PLANAR contours do not say how several of one plane combine,
//! and some readers take their union, which fills the holes. A keyhole is one polygon, and the same to everyone: it encloses
//! what the polygons enclose by the even-odd rule, since its line counts twice.

use crate::volume::contour::Polygon;
use std::collections::HashMap;

/// Planes closer than this are one, mm.
const SAME_PLANE_MM: f64 = 0.05;

/// Polygons of which none is a hole of another, enclosing the same by the even-odd rule.
pub(super) fn keyholes(polygons: &[Polygon]) -> Vec<Polygon> {
    let mut sorted: Vec<&Polygon> = polygons.iter().collect();
    sorted.sort_by(|a, b| a.height.total_cmp(&b.height));
    sorted.chunk_by(|a, b| b.height - a.height <= SAME_PLANE_MM).flat_map(of_plane).collect()
}

/// The polygons that a keyhole joins, without its lines: edges that are walked there and back. Distances to the surface would
/// be wrong beside such a line. A polygon without them stays as it is.
pub(super) fn opened(points: Vec<[f64; 2]>) -> Vec<Vec<[f64; 2]>> {
    let (mut open, mut waiting) = (Vec::new(), vec![points]);
    while let Some(points) = waiting.pop() {
        match there_and_back(&points) {
            Some([there, back]) => {
                // Edge `there` begins with that point and edge `back` ends with it.
                let outer = [&points[..=there], points.get(back + 2..).unwrap_or_default()].concat();
                let inner = points[there + 1..back].to_vec();
                waiting.extend([inner, outer]);
            }
            None if points.len() > 2 => open.push(points),
            None => {}
        }
    }
    open
}

/// The first edge that is walked the other way later, and that later edge; an edge has the number of its first point.
fn there_and_back(points: &[[f64; 2]]) -> Option<[usize; 2]> {
    let key = |p: &[f64; 2]| p.map(|c| (c + 0.0).to_bits());
    let mut walked: HashMap<[[u64; 2]; 2], usize> = HashMap::with_capacity(points.len());
    for (n, (a, b)) in edges(points).enumerate() {
        if let Some(there) = walked.get(&[key(b), key(a)]) {
            return Some([*there, n]);
        }
        walked.entry([key(a), key(b)]).or_insert(n);
    }
    None
}

/// The same for one plane.
fn of_plane(polygons: &[&Polygon]) -> Vec<Polygon> {
    let within =
        |inner: usize, outer: usize| inner != outer && lies_in(&polygons[inner].points, &polygons[outer].points);
    let around: Vec<Vec<usize>> =
        (0..polygons.len()).map(|n| (0..polygons.len()).filter(|&m| within(n, m)).collect()).collect();
    let depth = |n: usize| around[n].len();
    let solid = |n: &usize| depth(*n) % 2 == 0;
    (0..polygons.len())
        .filter(solid)
        .map(|outer| {
            let holes = (0..polygons.len()).filter(|&n| depth(n) == depth(outer) + 1 && around[n].contains(&outer));
            let holes = holes.map(|n| polygons[n].points.as_slice()).collect();
            Polygon { height: polygons[outer].height, points: joined(&polygons[outer].points, holes) }
        })
        .chain(
            // A hole without a solid around it, as only crossing polygons make one, stays as it is.
            (0..polygons.len())
                .filter(|n| !solid(n) && !around[*n].iter().any(|&m| depth(m) + 1 == depth(*n)))
                .map(|n| polygons[n].clone()),
        )
        .collect()
}

/// The outer polygon with all holes, nearest first.
fn joined(outer: &[[f64; 2]], mut holes: Vec<&[[f64; 2]]>) -> Vec<[f64; 2]> {
    let mut all = outer.to_vec();
    while let Some((n, at, from)) = nearest(&all, &holes) {
        let hole = holes.swap_remove(n);
        let mut points: Vec<[f64; 2]> = hole[from..].iter().chain(&hole[..=from]).copied().collect();
        // Against the outer's turn, so that areas by the shoelace formula are right too.
        if (area(outer) > 0.0) == (area(hole) > 0.0) {
            points.reverse();
        }
        points.push(all[at]);
        all.splice(at + 1..at + 1, points);
    }
    all
}

/// The hole with the corner nearest to one of a polygon's, and both corners.
fn nearest(outer: &[[f64; 2]], holes: &[&[[f64; 2]]]) -> Option<(usize, usize, usize)> {
    let pairs = holes.iter().enumerate().flat_map(|(n, hole)| {
        hole.iter().enumerate().flat_map(move |(from, q)| {
            outer.iter().enumerate().map(move |(at, p)| ((p[0] - q[0]).hypot(p[1] - q[1]), (n, at, from)))
        })
    });
    pairs.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, found)| found)
}

/// Whether most corners of a polygon lie in a larger one.
fn lies_in(inner: &[[f64; 2]], outer: &[[f64; 2]]) -> bool {
    let inside = inner.iter().filter(|p| encloses(outer, **p)).count();
    2 * inside > inner.len() && area(inner).abs() < area(outer).abs()
}

fn edges(points: &[[f64; 2]]) -> impl Iterator<Item = (&[f64; 2], &[f64; 2])> {
    points.iter().zip(points.iter().cycle().skip(1))
}

fn encloses(points: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let crossed = |(a, b): &(&[f64; 2], &[f64; 2])| {
        (a[1] > y) != (b[1] > y) && x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
    };
    edges(points).filter(crossed).count() % 2 == 1
}

/// Signed area, mm^2.
fn area(points: &[[f64; 2]]) -> f64 {
    0.5 * edges(points).map(|(a, b)| a[0] * b[1] - b[0] * a[1]).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(centre: [f64; 2], half: f64, turned: bool) -> Polygon {
        let mut points: Vec<[f64; 2]> = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
            .map(|p| [0, 1].map(|a| centre[a] + half * p[a]))
            .into();
        if turned {
            points.reverse();
        }
        Polygon { height: 3.0, points }
    }

    #[test]
    fn a_keyhole_encloses_what_its_polygons_did() {
        // A ring with two holes, an island in one of them, a second ring, and another plane.
        let mut other = square([0.0, 0.0], 4.0, false);
        other.height = 6.0;
        for turned in [false, true] {
            let all = [
                square([1.0, 0.0], 2.0, turned),
                square([0.0, 0.0], 10.0, false),
                square([-6.0, 5.0], 1.0, false),
                square([1.5, 0.2], 0.5, turned),
                square([30.0, 0.0], 4.0, true),
                square([31.0, 0.0], 1.0, true),
                other.clone(),
            ];
            let out = keyholes(&all);
            assert_eq!(out.len(), 4);
            let areas: f64 = out.iter().filter(|p| p.height < 5.0).map(|p| area(&p.points).abs()).sum();
            assert!((areas - (400.0 - 16.0 - 4.0 + 1.0 + 64.0 - 4.0)).abs() < 1e-9, "{areas}");
            let parity = |polygons: &[Polygon], p: [f64; 2]| {
                polygons.iter().filter(|q| q.height < 5.0 && encloses(&q.points, p)).count() % 2 == 1
            };
            for n in 0..4000 {
                let p = [-12.03 + 0.61 * f64::from(n % 80), -11.07 + 0.47 * f64::from(n / 80)];
                assert_eq!(parity(&all, p), parity(&out, p), "{p:?}");
                // Nothing is enclosed twice, so that a union gives the same.
                assert!(out.iter().filter(|q| q.height < 5.0 && encloses(&q.points, p)).count() < 2, "{p:?}");
            }
        }
    }

    #[test]
    fn keyholes_are_opened_again() {
        let all = [square([0.0, 0.0], 10.0, false), square([-6.0, 5.0], 1.0, false), square([1.0, 0.0], 2.0, true)];
        for first in 0..16 {
            let mut joined = keyholes(&all).remove(0).points;
            // Wherever the walk begins, and with the first point repeated.
            joined.rotate_left(first);
            if first % 2 == 1 {
                joined.push(joined[0]);
            }
            let mut out: Vec<f64> = opened(joined).iter().map(|p| area(p).abs()).collect();
            out.sort_by(f64::total_cmp);
            assert_eq!(out, [4.0, 16.0, 400.0], "{first}");
        }
        let plain = square([0.0, 0.0], 1.0, false).points;
        assert_eq!(opened(plain.clone()), [plain]);
    }

    #[test]
    fn polygons_without_holes_stay_as_they_are() {
        let all = [square([0.0, 0.0], 1.0, false), square([5.0, 0.0], 1.0, true)];
        assert_eq!(keyholes(&all), all);
    }
}
