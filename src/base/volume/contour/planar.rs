//! Signed distance to the polygons of one plane, on a pixel grid.
//!
//! Nearest segments are handed from pixel to pixel (Danielsson, Computer Graphics and Image Processing 14, 1980), so the
//! distance is that to a segment, not to a pixel. The sign is by the even-odd rule.

/// Pixel size, mm; half of it where the whole drawing is small.
const PIXEL_MM: f64 = 1.0;
/// Drawings smaller than this get smaller pixels, mm.
const SMALL_MM: f64 = 60.0;
/// Pixels across a drawing at least, so that the smallest structures have a shape.
const PIXELS: f64 = 48.0;
/// Smallest pixel, mm.
const FINEST_MM: f64 = 0.04;
/// Margin of the pixel grid around the polygons, mm.
const MARGIN_MM: f64 = 6.0;
/// Margin around the smallest drawings, mm.
const LEAST_MARGIN_MM: f64 = 1.0;
/// No segment yet.
const NONE: u32 = u32::MAX;

/// Distance to the polygons of a plane: positive inside.
pub(super) struct PlanarDistance {
    origin: [f64; 2],
    pixel: f64,
    size: [usize; 2],
    values: Vec<f32>,
}

type Segment = [[f64; 2]; 2];

fn distance(p: [f64; 2], [a, b]: &Segment) -> f64 {
    let (d, e) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
    let length = d[0] * d[0] + d[1] * d[1];
    let t = if length > 0.0 { ((d[0] * e[0] + d[1] * e[1]) / length).clamp(0.0, 1.0) } else { 0.0 };
    (e[0] - t * d[0]).hypot(e[1] - t * d[1])
}

impl PlanarDistance {
    /// The distance to closed polygons, mm.
    pub(super) fn new(polygons: &[&[[f64; 2]]]) -> Self {
        let all = || polygons.iter().flat_map(|p| p.iter());
        let drawn_low: [f64; 2] = std::array::from_fn(|a| all().map(|p| p[a]).fold(f64::MAX, f64::min));
        let drawn_high: [f64; 2] = std::array::from_fn(|a| all().map(|p| p[a]).fold(f64::MIN, f64::max));
        let drawn = (drawn_high[0] - drawn_low[0]).max(drawn_high[1] - drawn_low[1]);
        let margin = (0.5 * drawn).clamp(LEAST_MARGIN_MM, MARGIN_MM);
        let (low, high) = (drawn_low.map(|c| c - margin), drawn_high.map(|c| c + margin));
        let coarse = if drawn + 2.0 * MARGIN_MM < SMALL_MM { 0.5 * PIXEL_MM } else { PIXEL_MM };
        let pixel = (drawn / PIXELS).clamp(FINEST_MM, coarse);
        let size: [usize; 2] = std::array::from_fn(|a| ((high[a] - low[a]) / pixel).ceil() as usize + 1);
        let segments: Vec<Segment> = polygons
            .iter()
            .flat_map(|p| p.iter().zip(p.iter().cycle().skip(1)).map(|(a, b)| [*a, *b]).collect::<Vec<_>>())
            .collect();
        let mut out = Self { origin: low, pixel, size, values: Vec::new() };
        let inside = out.inside(&segments);
        let distances = out.distances(&segments);
        let signed = |(inside, distance): (bool, f32)| if inside { distance } else { -distance };
        out.values = inside.into_iter().zip(distances).map(signed).collect();
        out
    }

    fn centre(&self, n: usize) -> [f64; 2] {
        let at = [n % self.size[0], n / self.size[0]];
        std::array::from_fn(|a| self.origin[a] + at[a] as f64 * self.pixel)
    }

    /// Pixels inside, by crossings along each row.
    fn inside(&self, segments: &[Segment]) -> Vec<bool> {
        let [nx, ny] = self.size;
        let mut crossings: Vec<Vec<f64>> = vec![Vec::new(); ny];
        for [a, b] in segments {
            let (low, high) = (a[1].min(b[1]), a[1].max(b[1]));
            // One row early, for rounding; which rows count is decided by comparisons that neighbouring segments share.
            let first = (((low - self.origin[1]) / self.pixel).floor() - 1.0).max(0.0) as usize;
            for (j, row) in crossings.iter_mut().enumerate().skip(first) {
                let y = self.origin[1] + j as f64 * self.pixel;
                if y < low {
                    continue;
                }
                // Half open, so that a corner on the row counts once.
                if y >= high {
                    break;
                }
                row.push(a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]));
            }
        }
        let mut out = vec![false; nx * ny];
        for (j, row) in crossings.iter_mut().enumerate() {
            row.sort_by(f64::total_cmp);
            for pair in row.as_chunks::<2>().0 {
                let [from, to] = pair.map(|x| (((x - self.origin[0]) / self.pixel).ceil().max(0.0) as usize).min(nx));
                out[j * nx + from..j * nx + to.max(from)].fill(true);
            }
        }
        out
    }

    /// Distance of each pixel to its nearest segment.
    fn distances(&self, segments: &[Segment]) -> Vec<f32> {
        let [nx, ny] = self.size;
        let mut nearest = vec![(NONE, f64::MAX); nx * ny];
        let offer = |nearest: &mut [(u32, f64)], i: i64, j: i64, segment: u32| {
            if i < 0 || j < 0 || i >= nx as i64 || j >= ny as i64 || segment == NONE {
                return;
            }
            let n = j as usize * nx + i as usize;
            if nearest[n].0 != segment {
                let d = distance(self.centre(n), &segments[segment as usize]);
                if d < nearest[n].1 {
                    nearest[n] = (segment, d);
                }
            }
        };
        for (s, [a, b]) in segments.iter().enumerate() {
            let steps = ((b[0] - a[0]).hypot(b[1] - a[1]) / (0.5 * self.pixel)).ceil().max(1.0) as usize;
            for n in 0..=steps {
                let t = n as f64 / steps as f64;
                let [i, j] = [0, 1].map(|c| ((a[c] + t * (b[c] - a[c]) - self.origin[c]) / self.pixel).round() as i64);
                for (di, dj) in [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)] {
                    offer(&mut nearest, i + di, j + dj, s as u32);
                }
            }
        }
        let (w, h) = (nx as i64, ny as i64);
        for _ in 0..2 {
            for (dj, rows) in [(-1, (0..h).collect::<Vec<_>>()), (1, (0..h).rev().collect())] {
                for j in rows {
                    for i in 0..w {
                        for (di, dj) in [(-1, dj), (0, dj), (1, dj), (-1, 0)] {
                            if let Some(segment) = self.at_pixel(&nearest, i + di, j + dj) {
                                offer(&mut nearest, i, j, segment);
                            }
                        }
                    }
                    for i in (0..w).rev() {
                        if let Some(segment) = self.at_pixel(&nearest, i + 1, j) {
                            offer(&mut nearest, i, j, segment);
                        }
                    }
                }
            }
        }
        nearest.into_iter().map(|(_, d)| d as f32).collect()
    }

    fn at_pixel(&self, nearest: &[(u32, f64)], i: i64, j: i64) -> Option<u32> {
        let inside = i >= 0 && j >= 0 && i < self.size[0] as i64 && j < self.size[1] as i64;
        inside.then(|| nearest[j as usize * self.size[0] + i as usize].0)
    }

    /// The signed distance at a point of the plane; beyond the pixels by the distance to them.
    pub(super) fn at(&self, point: [f64; 2]) -> f64 {
        let mut beyond = [0.0; 2];
        let (mut low, mut t) = ([0usize; 2], [0.0; 2]);
        for a in 0..2 {
            let last = (self.size[a] - 1) as f64;
            let index = (point[a] - self.origin[a]) / self.pixel;
            let held = index.clamp(0.0, last);
            beyond[a] = (index - held) * self.pixel;
            low[a] = (held as usize).min(self.size[a] - 2);
            t[a] = held - low[a] as f64;
        }
        let value = |i: usize, j: usize| f64::from(self.values[(low[1] + j) * self.size[0] + low[0] + i]);
        let row = |j: usize| value(0, j) * (1.0 - t[0]) + value(1, j) * t[0];
        row(0) * (1.0 - t[1]) + row(1) * t[1] - beyond[0].hypot(beyond[1])
    }
}
