//! Whether an image is a CT in HU: air and soft tissue lie where HU has them.

use crate::error::{Error, Result};
use crate::findings;
use crate::volume::Volume;
use crate::warning::Warning;
use rayon::prelude::*;

/// Width of a bin, HU, and what the bins hold.
const BIN: f32 = 20.0;
const LOWEST: f32 = -1100.0;
const HIGHEST: f32 = 4000.0;
const BINS: usize = ((HIGHEST - LOWEST) / BIN) as usize;
/// Nothing but air, lung and fat lies below.
const LOW: f32 = -200.0;
/// Soft tissue is the commonest of what is denser than that; it lies here in every CT, cone-beam ones included.
const TISSUE: [f32; 2] = [-200.0, 200.0];
/// Least share of voxels that are air, lung or fat, of those that are known.
const LEAST_LOW: f64 = 1e-4;
/// Where air is common it lies below this: outside air at -1000, lung from -950 to -700.
const AIR: f32 = -700.0;
const COMMON: f64 = 0.02;

/// Counts of an image.
struct Histogram {
    bins: Vec<u64>,
    /// Sum of the HU in each, rounded: whole numbers add up to the same in any order.
    sums: Vec<i64>,
    /// Voxels below all bins: padding; and above.
    below: u64,
    above: u64,
    lowest: f32,
    highest: f32,
}

impl Histogram {
    fn of(image: &Volume<f32>) -> Self {
        let empty = || Self {
            bins: vec![0; BINS],
            sums: vec![0; BINS],
            below: 0,
            above: 0,
            lowest: f32::MAX,
            highest: f32::MIN,
        };
        let count = |mut h: Self, part: &[f32]| {
            for &v in part {
                h.lowest = h.lowest.min(v);
                h.highest = h.highest.max(v);
                let at = (v - LOWEST) / BIN;
                if at < 0.0 {
                    h.below += 1;
                } else if let (Some(bin), Some(sum)) = (h.bins.get_mut(at as usize), h.sums.get_mut(at as usize)) {
                    *bin += 1;
                    *sum += v.round() as i64;
                } else {
                    h.above += 1;
                }
            }
            h
        };
        let add = |mut a: Self, b: Self| {
            a.bins.iter_mut().zip(&b.bins).for_each(|(a, b)| *a += b);
            a.sums.iter_mut().zip(&b.sums).for_each(|(a, b)| *a += b);
            (a.below, a.above) = (a.below + b.below, a.above + b.above);
            (a.lowest, a.highest) = (a.lowest.min(b.lowest), a.highest.max(b.highest));
            a
        };
        image.data().par_chunks(1 << 16).fold(empty, count).reduce(empty, add)
    }

    /// Bins from one HU up to another.
    fn between(&self, from: f32, to: f32) -> &[u64] {
        let bin = |hu: f32| (((hu - LOWEST) / BIN) as usize).min(BINS);
        &self.bins[bin(from)..bin(to)]
    }

    /// The commonest HU between two, and the share of all known voxels that lie there.
    fn peak(&self, from: f32, to: f32) -> (f32, f64) {
        let bins = self.between(from, to);
        // Of three neighbours, so that one value of padding does not outweigh a hill.
        let around = |n: usize| n.saturating_sub(1)..(n + 2).min(bins.len());
        let hill = |n: usize| bins[around(n)].iter().sum::<u64>();
        let best = (0..bins.len()).max_by(|&a, &b| hill(a).cmp(&hill(b)).then(b.cmp(&a))).unwrap_or(0);
        let first = ((from - LOWEST) / BIN) as usize;
        let sum = self.sums[first..][around(best)].iter().sum::<i64>();
        (sum as f32 / hill(best).max(1) as f32, bins.iter().sum::<u64>() as f64 / self.known().max(1) as f64)
    }

    fn known(&self) -> u64 {
        self.bins.iter().sum::<u64>() + self.above
    }
}

/// Judges an image that must be a CT in HU. `what`: its role, for people.
///
/// # Errors
/// [`Error::Input`] where it is none; a warning where it is doubtful.
pub fn in_hounsfield(what: &str, image: &Volume<f32>) -> Result<Option<Warning>> {
    let histogram = Histogram::of(image);
    let (tissue, _) = histogram.peak(LOW, HIGHEST);
    let low = histogram.between(LOWEST, LOW).iter().sum::<u64>() as f64 / histogram.known().max(1) as f64;
    let lies = (TISSUE[0]..TISSUE[1]).contains(&tissue);
    if low < LEAST_LOW || !lies {
        let beside = if lies { "" } else { ", where soft tissue has -100 to 100" };
        let problem = format!(
            "it is no CT in HU: its values run from {} to {}, {} of them are air, lung or fat (below {LOW} HU), and the \
             commonest denser value is about {tissue:.0}{beside}",
            histogram.lowest,
            histogram.highest,
            if low == 0.0 { "none".to_owned() } else { format!("{:.2} %", 100.0 * low) },
        );
        return Err(Error::refused(findings::NOT_IN_HU, what, problem, remedy(&histogram, tissue)));
    }
    let (air, share) = histogram.peak(LOWEST, -300.0);
    Ok((share > COMMON && air > AIR).then(|| {
        let message = format!(
            "{what}: air lies at about {air:.0} HU instead of -1000: its HU look scaled by {:.2}; compare RescaleSlope and \
             RescaleIntercept with the DICOM series",
            air / -1000.0
        );
        Warning::new(findings::HU_DOUBTFUL, message)
    }))
}

/// More voxels of an MR than this share are not negative: magnitudes are none, but for what resampling makes of an edge.
const MOST_NEGATIVE: f64 = 0.01;
/// Below this a value is no ringing of a resampling, as a share of the brightest.
const NEGATIVE: f32 = -0.02;

/// Judges an image that must be an MR: magnitudes, of any scale.
///
/// # Errors
/// [`Error::Input`] where it holds negative values, as a CT in HU does.
pub fn no_hounsfield(what: &str, image: &Volume<f32>) -> Result<()> {
    let [lowest, highest] = image.extremes();
    let least = NEGATIVE * highest.abs();
    let negative = image.data().par_iter().filter(|v| **v < least).count() as f64 / image.data().len().max(1) as f64;
    if negative <= MOST_NEGATIVE {
        return Ok(());
    }
    Err(Error::refused(
        findings::NOT_AN_MR,
        what,
        format!(
            "it is no MR: its values run from {lowest} to {highest}, and {:.0} % of them are negative, where an MR shows magnitudes",
            100.0 * negative
        ),
        "a CT in HU needs no --modality; of a phase or difference image give the magnitude",
    ))
}

/// What would mend it.
fn remedy(histogram: &Histogram, tissue: f32) -> String {
    let low: u64 = histogram.between(LOWEST, LOW).iter().sum();
    let (_, shifted) = histogram.peak(900.0, 1200.0);
    if low == 0 && shifted > 0.05 {
        return "it looks like HU + 1024: subtract 1024, or set the slope 1 and the offset -1024 in its header".into();
    }
    if histogram.lowest >= 0.0 && histogram.highest <= 200.0 {
        return "it looks like a dose or a label map: give the CT".into();
    }
    if low > 0 && tissue > 500.0 {
        return "its grey values look inverted, or air was stored as a large number: export it anew in HU".into();
    }
    "give a CT in HU: air near -1000, soft tissue near 0; dose, labels and windowed pictures are none, and a fraction that is an MR \
     needs --modality mr"
        .into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    /// Air around tissue with some bone, through `change`.
    fn image(change: impl Fn(f32) -> f32 + Sync + Send) -> Volume<f32> {
        let grid = Grid::axis_aligned([40, 40, 10], [1.0; 3], [0.0; 3]).unwrap();
        Volume::from_fn(grid, |n| {
            let noise = (n * 7919 % 41) as f32 - 20.0;
            let (i, j) = (n % 40, n / 40 % 40);
            let hu = match (i.abs_diff(20).pow(2) + j.abs_diff(20).pow(2)).isqrt() {
                0..4 => 600.0,
                4..15 => 40.0,
                15..17 => -100.0,
                _ => -1000.0,
            };
            change(hu + noise)
        })
    }

    #[test]
    fn a_ct_passes_padded_or_not_and_what_is_none_is_refused_with_its_remedy() {
        let of = |change: &(dyn Fn(f32) -> f32 + Sync)| in_hounsfield("planning CT", &image(change));
        assert_eq!(of(&|v| v).unwrap(), None);
        for padding in [-1024.0, -2000.0, -3024.0, -32768.0, 0.0] {
            assert_eq!(of(&|v| if v < -1005.0 { padding } else { v }).unwrap(), None, "{padding}");
        }
        // Cone-beam greys: darker, with less contrast about air.
        assert_eq!(of(&|v| (v + 1000.0) * 0.8 - 1000.0 + 60.0).unwrap(), None);
        let refused: [(&(dyn Fn(f32) -> f32 + Sync), &str); 6] = [
            (&|v| v + 1024.0, "HU + 1024"),
            (&|v| if v < -900.0 { -2000.0 } else { v + 1024.0 }, "HU + 1024"),
            (&|v| -v, "inverted"),
            (&|v| (v + 1030.0) / 40.0, "dose"),
            (&|v| if v < -900.0 { 0.0 } else { 8.0 }, "commonest denser value is about 4 ["),
            (&|v| (v + 1030.0) * 8.0, "give a CT in HU"),
        ];
        for (change, word) in refused {
            let error = of(change).unwrap_err();
            assert_eq!((error.exit_code(), error.code()), (4, "not-in-hu"));
            assert!(error.to_string().contains(word), "{error}");
        }
        let mr = |change: &(dyn Fn(f32) -> f32 + Sync)| no_hounsfield("fraction MR", &image(change));
        assert_eq!(mr(&|v| v).unwrap_err().code(), "not-an-mr");
        mr(&|v| (v + 1030.0) * 0.4).unwrap();
        // An edge that was resampled by splines.
        mr(&|v| if v < -900.0 { -10.0 } else { v + 1024.0 }).unwrap();
        assert!(of(&|v| 0.6 * v).unwrap().unwrap().message.contains("scaled by 0.6"));
    }
}
