//! Closed polygons where a function on a pixel grid changes its sign: marching squares (Lorensen and Cline's marching
//! cubes in the plane), with the mean of the corners deciding where two corners are joined.

use std::collections::BTreeMap;

/// The closed polygons around the pixels above 0, in pixel coordinates; `size` pixels, the first axis fastest.
///
/// Values are interpolated linearly between pixel centres. Outside the grid everything is below 0, so a polygon that
/// reaches the edge is closed along it. Outer polygons turn from the first to the second axis, holes the other way.
pub fn trace(values: &[f64], size: [usize; 2]) -> Vec<Vec<[f64; 2]>> {
    let next = segments(values, size);
    let mut rest = next.clone();
    let mut out = Vec::new();
    while let Some((&start, _)) = rest.first_key_value() {
        let mut polygon = Vec::new();
        let mut here = start;
        while let Some(to) = rest.remove(&here) {
            polygon.push(crossing(values, size, here));
            here = to;
        }
        polygon.dedup_by(|a, b| (a[0] - b[0]).abs() + (a[1] - b[1]).abs() < 1e-9);
        if polygon.len() > 2 {
            out.push(polygon);
        }
    }
    out
}

/// An edge between neighbouring pixels: its lower pixel (one off the grid is legal) and its axis.
type Edge = (i64, i64, u8);

fn value(values: &[f64], size: [usize; 2], i: i64, j: i64) -> f64 {
    let inside = i >= 0 && j >= 0 && i < size[0] as i64 && j < size[1] as i64;
    // Far below 0 outside: the polygon then runs along the outermost pixels.
    if inside { values[j as usize * size[0] + i as usize] } else { -1e12 }
}

/// Where the function is 0 on an edge.
fn crossing(values: &[f64], size: [usize; 2], (i, j, axis): Edge) -> [f64; 2] {
    let (di, dj) = if axis == 0 { (1, 0) } else { (0, 1) };
    let (a, b) = (value(values, size, i, j), value(values, size, i + di, j + dj));
    let t = if (a - b).abs() > 0.0 { a / (a - b) } else { 0.5 };
    [i as f64 + t * di as f64, j as f64 + t * dj as f64]
}

/// From each edge that is crossed the next one, keeping what is above 0 on the same side.
fn segments(values: &[f64], size: [usize; 2]) -> BTreeMap<Edge, Edge> {
    let mut next = BTreeMap::new();
    for j in -1..size[1] as i64 {
        for i in -1..size[0] as i64 {
            let corner = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(di, dj)| value(values, size, i + di, j + dj));
            let up = corner.map(|v| v > 0.0);
            let count = up.iter().filter(|u| **u).count();
            if count == 0 || count == 4 {
                continue;
            }
            // Edge n lies between corner n and the next one, around the cell.
            let edges: [Edge; 4] = [(i, j, 0), (i + 1, j, 1), (i, j + 1, 0), (i, j, 1)];
            let enter = |n: usize| up[n] && !up[(n + 1) % 4];
            let leave = |n: usize| !up[n] && up[(n + 1) % 4];
            let joined = corner.iter().sum::<f64>() > 0.0;
            for n in (0..4).filter(|&n| enter(n)) {
                // The walk keeps what is above 0 at its left: it ends at the next edge in the turn that a saddle asks for.
                let turn: [usize; 3] = if joined { [1, 2, 3] } else { [3, 2, 1] };
                if let Some(to) = turn.into_iter().map(|d| (n + d) % 4).find(|&m| leave(m)) {
                    next.insert(edges[n], edges[to]);
                }
            }
        }
    }
    next
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::contour::{encloses, shoelace};

    fn sample(size: [usize; 2], f: impl Fn(f64, f64) -> f64) -> Vec<f64> {
        (0..size[0] * size[1]).map(|n| f((n % size[0]) as f64, (n / size[0]) as f64)).collect()
    }

    #[test]
    fn a_ring_is_an_outer_polygon_and_a_hole() {
        let size = [41, 37];
        let ring = sample(size, |x, y| {
            let r = (x - 20.3).hypot(y - 18.1);
            (14.0 - r).min(r - 6.0)
        });
        let mut areas: Vec<f64> = trace(&ring, size).iter().map(|p| shoelace(p)).collect();
        areas.sort_by(f64::total_cmp);
        assert_eq!(areas.len(), 2);
        let pi = std::f64::consts::PI;
        assert!(
            (areas[0] / (-36.0 * pi) - 1.0).abs() < 0.01 && (areas[1] / (196.0 * pi) - 1.0).abs() < 0.005,
            "{areas:?}"
        );
    }

    #[test]
    fn what_reaches_the_edge_is_closed_along_it() {
        let polygons = trace(&sample([9, 9], |_, _| 1.0), [9, 9]);
        assert_eq!(polygons.len(), 1);
        assert!((shoelace(&polygons[0]) - 64.0).abs() < 1e-3);
    }

    #[test]
    fn saddles_are_closed_whatever_they_join() {
        for level in [-0.3, 0.0, 0.3] {
            let size = [24, 24];
            let values = sample(size, |x, y| (0.8 * x).sin() * (0.7 * y).cos() + level);
            let polygons = trace(&values, size);
            assert!(polygons.len() > 2);
            for (n, v) in values.iter().enumerate().filter(|(_, v)| v.abs() > 1e-3) {
                let at = [(n % 24) as f64, (n / 24) as f64];
                // Pixels on the outermost lines lie on the closing edge itself.
                if at.iter().all(|c| (1.0..22.5).contains(c)) {
                    let around = polygons.iter().filter(|p| encloses(p, at)).count();
                    assert_eq!(around % 2 == 1, *v > 0.0, "{at:?} {v}");
                }
            }
        }
    }
}
