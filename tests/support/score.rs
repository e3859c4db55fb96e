//! Errors of a registration against known truth.

use aventail::field::PushField;
use aventail::stats::percentile;
use aventail::volume::distance::squared_distance;
use aventail::volume::morphology::erode;
use aventail::volume::{LabelMap, Mask, Spans, Volume, trilinear, trilinear_vector};
use nalgebra::{Point3, Vector3};
use std::collections::BTreeMap;
use std::path::Path;

/// A planning point whose true motion is known.
pub struct TruthPoint {
    /// Planning position, LPS mm.
    pub at: Point3<f64>,
    /// True displacement, planning to fraction, mm.
    pub motion: Vector3<f64>,
    /// Label of its bone; 0 is soft tissue.
    pub bone: u16,
}

/// Reads `x,y,z,ux,uy,uz,bone,mm_to_bone` from a gzip CSV.
pub fn read_truth(path: &Path) -> Vec<TruthPoint> {
    let file = std::fs::File::open(path).expect("the case has its truth");
    let mut reader = csv::Reader::from_reader(flate2::read::MultiGzDecoder::new(file));
    let point = |record: csv::StringRecord| {
        let v: Vec<f64> = record.iter().map(|t| t.parse().expect("the truth holds numbers")).collect();
        TruthPoint { at: Point3::new(v[0], v[1], v[2]), motion: Vector3::new(v[3], v[4], v[5]), bone: v[6] as u16 }
    };
    reader.records().map(|r| point(r.expect("the truth is CSV"))).collect()
}

/// Mean errors of a push field, mm.
#[derive(Debug)]
pub struct Score {
    /// Soft tissue.
    pub soft: f64,
    /// Mean over visible bones of each bone's mean.
    pub bones: f64,
    /// The visible bone with the greatest mean, and that mean.
    pub worst: (u16, f64),
}

/// Fewest truth points of a bone that counts as visible.
const VISIBLE: usize = 200;

/// Errors of `push` at points of known motion.
pub fn score(push: &PushField, truth: &[TruthPoint], visible: usize) -> Score {
    let mut sums: BTreeMap<u16, (usize, f64)> = BTreeMap::new();
    for p in truth {
        let index = push.displacement.grid().index(&p.at);
        let u = trilinear_vector(&push.displacement, &index).expect("truth lies on the planning grid");
        let sum = sums.entry(p.bone).or_default();
        *sum = (sum.0 + 1, sum.1 + (u - p.motion).norm());
    }
    let mean = |(n, sum): (usize, f64)| sum / n as f64;
    let soft = sums.remove(&0).map_or(0.0, mean);
    let each: Vec<(u16, f64)> = sums.into_iter().filter(|(_, s)| s.0 >= visible).map(|(b, s)| (b, mean(s))).collect();
    let bones = each.iter().map(|b| b.1).sum::<f64>() / each.len() as f64;
    let worst = each.into_iter().max_by(|a, b| a.1.total_cmp(&b.1)).expect("a bone is visible");
    Score { soft, bones, worst }
}

/// [`score`] with the bones that the shared cases call visible.
pub fn score_case(push: &PushField, truth: &[TruthPoint]) -> Score {
    score(push, truth, VISIBLE)
}

/// Spearman's rank correlation of a map with the true error of soft tissue, and the share of errors below the map.
pub fn trust(map: &Spans<f32>, push: &PushField, truth: &[TruthPoint]) -> (f64, f64) {
    let map = map.to_volume();
    let pairs: Vec<(f64, f64)> = truth
        .iter()
        .filter(|p| p.bone == 0)
        .map(|p| {
            let u = trilinear_vector(&push.displacement, &push.displacement.grid().index(&p.at));
            let said = trilinear(&map, &map.grid().index(&p.at)).expect("truth lies on the planning grid");
            (said, (u.expect("truth lies on the planning grid") - p.motion).norm())
        })
        .collect();
    let ranks = |value: fn(&(f64, f64)) -> f64| {
        let mut order: Vec<usize> = (0..pairs.len()).collect();
        order.sort_by(|a, b| value(&pairs[*a]).total_cmp(&value(&pairs[*b])));
        let mut ranks = vec![0.0; pairs.len()];
        order.into_iter().enumerate().for_each(|(rank, n)| ranks[n] = rank as f64);
        ranks
    };
    let (said, wrong) = (ranks(|p| p.0), ranks(|p| p.1));
    let n = pairs.len() as f64;
    let squares: f64 = said.iter().zip(&wrong).map(|(a, b)| (a - b) * (a - b)).sum();
    let below = pairs.iter().filter(|(said, error)| error < said).count() as f64;
    (1.0 - 6.0 * squares / (n * (n * n - 1.0)), below / n)
}

/// The name of a label.
pub fn name(map: &LabelMap, label: u16) -> &str {
    map.names.get(&label).map_or("?", String::as_str)
}

/// Dice overlap of two masks.
pub fn dice(a: &Mask, b: &Mask) -> f64 {
    let both = a.data().iter().zip(b.data()).filter(|(a, b)| **a && **b).count();
    2.0 * both as f64 / (a.count() + b.count()) as f64
}

/// 95th percentile of the distances from a mask's surface voxels to the nearest of another's, mm.
pub fn surface_p95(from: &Mask, to: &Mask) -> f64 {
    let distance = squared_distance(&surface(to), true);
    let on_surface = surface(from);
    let pairs = on_surface.data().iter().zip(distance.data());
    let mut all: Vec<f64> = pairs.filter(|(on, _)| **on).map(|(_, d)| f64::from(*d).sqrt()).collect();
    all.sort_by(f64::total_cmp);
    percentile(&all, 95.0)
}

/// Voxels of a mask that face its outside; the image's edge is no outside.
fn surface(mask: &Mask) -> Mask {
    let least = mask.grid().spacing().into_iter().fold(f64::INFINITY, f64::min);
    let inner = erode(mask, least);
    Volume::from_fn(mask.grid().clone(), |l| mask.data()[l] && !inner.data()[l])
}
