//! Cubic convolution (Keys 1981, a = -1/2): value and world gradient, once continuously differentiable.

use crate::geometry::Wide;
use crate::volume::Volume;
use nalgebra::Vector3;

/// Weights of the four samples around a fraction `t` in [0, 1) and their derivatives.
#[inline(always)]
fn weights(t: f32) -> ([f32; 4], [f32; 4]) {
    let (t2, t3) = (t * t, t * t * t);
    (
        [-0.5 * t + t2 - 0.5 * t3, 1.0 - 2.5 * t2 + 1.5 * t3, 0.5 * t + 2.0 * t2 - 1.5 * t3, -0.5 * t2 + 0.5 * t3],
        [-0.5 + 2.0 * t - 1.5 * t2, -5.0 * t + 4.5 * t2, 0.5 + 4.0 * t - 4.5 * t2, -t + 1.5 * t2],
    )
}

#[inline(always)]
fn both(a: &[f32; 4], b: &[f32; 4]) -> Wide {
    Wide([a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3]])
}

#[inline(always)]
fn halves(w: &Wide) -> ([f32; 4], [f32; 4]) {
    let [a, b, c, d, e, f, g, h] = w.0;
    ([a, b, c, d], [e, f, g, h])
}

/// Value and gradient per index step at a continuous index; the image is continued at its edges.
///
/// `None` outside the hull of the voxel centres.
#[inline(always)]
pub fn cubic(volume: &Volume<f32>, index: &Vector3<f64>) -> Option<(f64, Vector3<f64>)> {
    let grid = volume.grid();
    if !grid.contains(index) {
        return None;
    }
    let size = grid.size();
    let (mut low, mut w) = ([0usize; 3], [([0f32; 4], [0f32; 4]); 3]);
    for a in 0..3 {
        low[a] = index[a] as usize;
        w[a] = weights((index[a] - low[a] as f64) as f32);
    }
    let d = volume.data();
    let (nx, plane) = (size[0], size[0] * size[1]);
    // Rows and planes of the four voxels along each axis; at the edge the last one stands for what would lie beyond.
    let places = |a: usize, stride: usize| {
        let mut at = [0; 4];
        for (n, at) in at.iter_mut().enumerate() {
            *at = stride * (low[a] + n).saturating_sub(1).min(size[a] - 1);
        }
        at
    };
    let (columns, rows, planes) = (places(0, 1), places(1, nx), places(2, plane));
    let inner = columns[3] == columns[0] + 3;
    // Across the rows first, four voxels of a row at a time, their values and slopes side by side; along them last.
    let (mut value, mut through) = (Wide::default(), Wide::default());
    for kk in 0..4 {
        let mut plane = Wide::default();
        for jj in 0..4 {
            let row = &d[rows[jj] + planes[kk]..];
            let s = match row[columns[0]..].first_chunk::<4>() {
                Some(&s) if inner => s,
                _ => columns.map(|i| row[i]),
            };
            plane = plane + both(&[w[1].0[jj]; 4], &[w[1].1[jj]; 4]) * both(&s, &s);
        }
        value = value + plane * Wide::all(w[2].0[kk]);
        through = through + plane * Wide::all(w[2].1[kk]);
    }
    let (value, down) = halves(&value);
    let (through, _) = halves(&through);
    let along = |w: &[f32; 4], s: &[f32; 4]| w[0] * s[0] + w[1] * s[1] + w[2] * s[2] + w[3] * s[3];
    let (w, dw) = (&w[0].0, &w[0].1);
    let gradient = Vector3::new(along(dw, &value), along(w, &down), along(w, &through));
    Some((f64::from(along(w, &value)), gradient.cast()))
}
