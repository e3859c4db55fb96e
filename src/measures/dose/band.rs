//! Histograms with intervals: what a dose may be where the registration behind it is off.

use super::dvh::Dvh;
use crate::error::{Error, Result};
use crate::stats::percentile;
use serde::Serialize;

/// Percentiles of the samples at the ends of an interval.
const ENDS: [f64; 2] = [5.0, 95.0];

/// A figure with the interval that holds it in nine of ten cases.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FigureBand {
    /// What it is: `mean`, `D95`, `V20`.
    pub figure: String,
    /// `Gy`, or `%` of the volume.
    pub unit: &'static str,
    /// Of the registration that was found.
    pub value: f64,
    /// 5th percentile over the samples.
    pub low: f64,
    /// 95th percentile over the samples.
    pub high: f64,
}

/// A structure's histogram with its band.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DvhBand {
    /// Name of the structure.
    pub name: String,
    /// Figures with their intervals.
    pub figures: Vec<FigureBand>,
    /// Share of the volume (0 to 1) with at least `n * bin` Gy: 5th percentile.
    pub low: Vec<f64>,
    /// 95th percentile.
    pub high: Vec<f64>,
    /// Width of a bin, Gy.
    pub bin: f64,
}

/// A figure of a histogram: its name, its unit, and how it is read.
type Figure = (String, &'static str, Box<dyn Fn(&Dvh) -> f64>);

/// Names of the figures that are doses.
const DOSES: [&str; 8] = ["mean", "D98", "D95", "D50", "D2", "D0.03cc", "Dmin", "Dmax"];

/// The figures that have an interval.
fn figures(of: &Dvh) -> Vec<Figure> {
    let dose = |name: &str, read: fn(&Dvh) -> f64| (name.to_owned(), "Gy", Box::new(read) as Box<dyn Fn(&Dvh) -> f64>);
    let doses = [
        dose("mean", |d| d.mean),
        dose("D98", |d| d.d98),
        dose("D95", |d| d.d95),
        dose("D50", |d| d.d50),
        dose("D2", |d| d.d2),
        dose("D0.03cc", |d| d.d003cc),
        dose("Dmin", |d| d.min),
        dose("Dmax", |d| d.max),
    ];
    let volume = |(n, v): (usize, &super::Share)| {
        let read = move |d: &Dvh| d.v.get(n).map_or(f64::NAN, |v| v.percent);
        (format!("V{}", v.gy), "%", Box::new(read) as Box<dyn Fn(&Dvh) -> f64>)
    };
    doses.into_iter().chain(of.v.iter().enumerate().map(volume)).collect()
}

/// Intervals of histograms over those of samples, each of the same structures in the same order.
///
/// A structure whose dose is not known has none.
pub fn bands(found: &[Dvh], samples: &[Vec<Dvh>]) -> Vec<DvhBand> {
    let one = |(n, own): (usize, &Dvh)| {
        let each: Vec<&Dvh> = samples.iter().filter_map(|s| s.get(n)).collect();
        if own.mean.is_nan() || each.is_empty() {
            return None;
        }
        let interval = |(figure, unit, read): Figure| {
            let [low, high] = percentiles(each.iter().map(|d| read(d)).collect());
            FigureBand { figure, unit, value: read(own), low, high }
        };
        let bins = each.iter().map(|d| d.cumulative.len()).max().unwrap_or(0).max(own.cumulative.len());
        let share = |d: &Dvh, bin: usize| d.cumulative.get(bin).copied().unwrap_or(0.0);
        let curve = (0..bins).map(|bin| percentiles(each.iter().map(|d| share(d, bin)).collect()));
        let (low, high) = curve.map(|[low, high]| (low, high)).unzip();
        Some(DvhBand {
            name: own.name.clone(),
            figures: figures(own).into_iter().map(interval).collect(),
            low,
            high,
            bin: own.bin,
        })
    };
    found.iter().enumerate().filter_map(one).collect()
}

/// 5th and 95th percentile; not a number where there is no value.
fn percentiles(mut values: Vec<f64>) -> [f64; 2] {
    values.retain(|v| v.is_finite());
    values.sort_by(f64::total_cmp);
    ENDS.map(|p| if values.is_empty() { f64::NAN } else { percentile(&values, p) })
}

/// What a figure must not exceed, or must reach.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DoseLimit {
    /// Name of the structure.
    pub structure: String,
    /// `mean`, `D98`, `D95`, `D50`, `D2`, `D0.03cc`, `Dmin`, `Dmax`, or `V` and a dose.
    pub figure: String,
    /// Whether the value is the most that is allowed; else the least.
    pub at_most: bool,
    /// Gy, or percent of the volume.
    pub value: f64,
}

/// What a limit says of a figure with its interval.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Decision {
    /// Wherever in its interval the figure lies, the limit is kept.
    Kept,
    /// The limit lies within the interval.
    Undecided,
    /// Wherever in its interval the figure lies, the limit is not kept.
    Broken,
}

impl DoseLimit {
    /// From text: `cord:D0.03cc<=45`, `target:D95>=57`; the mean is also `Dmean`.
    ///
    /// # Errors
    /// [`Error::Usage`] when it is no limit.
    pub fn parse(text: &str) -> Result<Self> {
        let wrong = || {
            let problem = format!("limit {text:?} is not STRUCTURE:FIGURE<=VALUE or >=");
            Error::usage(problem, "give for example \"cord:D0.03cc<=45\" or \"target:D95>=57\" (Gy; V20 in percent)")
        };
        let (structure, rest) = text.rsplit_once(':').ok_or_else(wrong)?;
        let at_most = rest.contains("<=");
        let (figure, value) = rest.split_once(if at_most { "<=" } else { ">=" }).ok_or_else(wrong)?;
        let value: f64 = value.trim().parse().map_err(|_| wrong())?;
        let (structure, figure) = (structure.trim().to_owned(), figure.trim().to_owned());
        if structure.is_empty() || figure.is_empty() || !value.is_finite() {
            return Err(wrong());
        }
        let figure = if figure.eq_ignore_ascii_case("Dmean") { DOSES[0].to_owned() } else { figure };
        let limit = Self { structure, figure, at_most, value };
        if limit.volume_above().is_none() && !DOSES.iter().any(|d| d.eq_ignore_ascii_case(&limit.figure)) {
            let problem = format!("limit on {} of {:?}: there is no such figure", limit.figure, limit.structure);
            return Err(Error::usage(problem, format!("figures: Dmean, {}, V and a dose (V20)", DOSES.join(", "))));
        }
        Ok(limit)
    }

    /// Refuses a limit on a structure that is not among those of these names.
    ///
    /// # Errors
    /// [`Error::Usage`] then.
    pub fn require(&self, names: &[String]) -> Result<()> {
        if names.contains(&self.structure) {
            return Ok(());
        }
        let problem = format!("limit on {} of {:?}: there is no such structure", self.figure, self.structure);
        Err(Error::usage(problem, format!("structures: {}", names.join(", "))))
    }

    /// The dose of a volume above a dose, where the figure is one.
    pub fn volume_above(&self) -> Option<f64> {
        self.figure.strip_prefix('V')?.parse().ok()
    }

    /// The figure that it is of.
    pub fn figure<'a>(&self, bands: &'a [DvhBand]) -> Option<&'a FigureBand> {
        let own = bands.iter().find(|b| b.name == self.structure)?;
        own.figures.iter().find(|f| f.figure.eq_ignore_ascii_case(&self.figure))
    }

    /// Whether it is kept.
    pub fn decide(&self, figure: &FigureBand) -> Decision {
        let kept = |value: f64| if self.at_most { value <= self.value } else { value >= self.value };
        match (kept(figure.low.min(figure.value)), kept(figure.high.max(figure.value))) {
            (true, true) => Decision::Kept,
            (false, false) => Decision::Broken,
            _ => Decision::Undecided,
        }
    }

    /// As text.
    pub fn text(&self) -> String {
        format!("{} {} {}", self.figure, if self.at_most { "\u{2264}" } else { "\u{2265}" }, self.value)
    }
}

#[cfg(test)]
mod tests {
    use super::super::Share;
    use super::*;

    fn cord(mean: f64) -> Dvh {
        let v = vec![Share { gy: 20.0, percent: 10.0 * mean }];
        Dvh {
            name: "cord".into(),
            volume_ml: 1.0,
            mean,
            d95: 2.0 * mean,
            v,
            cumulative: vec![1.0, 0.1 * mean],
            bin: 1.0,
            ..Dvh::default()
        }
    }

    #[test]
    fn an_interval_holds_nine_of_ten_samples() {
        let samples: Vec<Vec<Dvh>> = (0..=100).map(|n| vec![cord(0.1 * f64::from(n))]).collect();
        let found = bands(&[cord(4.0)], &samples);
        let [band] = found.as_slice() else { panic!("one structure") };
        let of = |name: &str| band.figures.iter().find(|f| f.figure == name).unwrap();
        let close = |a: f64, b: f64| (a - b).abs() < 1e-9;
        let mean = of("mean");
        assert!(close(mean.value, 4.0) && close(mean.low, 0.5) && close(mean.high, 9.5), "{mean:?}");
        assert!(close(of("D95").high, 19.0) && close(of("V20").low, 5.0) && of("V20").unit == "%");
        assert!(close(band.low[1], 0.05) && close(band.high[1], 0.95));
        // What is not known has no interval.
        assert_eq!(bands(&[Dvh { mean: f64::NAN, ..cord(1.0) }], &samples), []);
    }

    #[test]
    fn a_limit_inside_the_interval_is_undecided() {
        let samples: Vec<Vec<Dvh>> = (0..=100).map(|n| vec![cord(0.1 * f64::from(n))]).collect();
        let found = bands(&[cord(4.0)], &samples);
        let decided = |text: &str| {
            let limit = DoseLimit::parse(text).unwrap();
            limit.decide(limit.figure(&found).unwrap())
        };
        assert_eq!(decided("cord:mean<=9.6"), Decision::Kept);
        assert_eq!(decided("cord: mean <= 4.5"), Decision::Undecided);
        assert_eq!(decided("cord:mean<=0.4"), Decision::Broken);
        assert_eq!(decided("cord:D95>=0.9"), Decision::Kept);
        assert_eq!(decided("cord:V20>=4"), Decision::Kept);
        assert_eq!(DoseLimit::parse("cord:V20>=4").unwrap().volume_above(), Some(20.0));
        // The names that histograms are printed with.
        assert_eq!(decided("cord:Dmean<=9.6"), Decision::Kept);
        assert_eq!(DoseLimit::parse("cord:Dmean<=8").unwrap().figure, "mean");
        let known = found[0].figures.iter().map(|f| format!("cord:{}>=0", f.figure));
        known.for_each(|text| drop(DoseLimit::parse(&text).unwrap()));
        let unknown = DoseLimit::parse("cord:D90<=8").unwrap_err();
        assert!(unknown.to_string().contains("no such figure") && unknown.remedy().contains("Dmean"), "{unknown}");
        let elsewhere = DoseLimit::parse("chord:D95<=8").unwrap().require(&["cord".into()]).unwrap_err();
        assert!(elsewhere.to_string().contains("structures: cord"), "{elsewhere}");
        for wrong in ["cord", "cord:D95", "cord:D95<45", ":D95<=45", "cord:D95<=x", "cord:<=1"] {
            assert_eq!(DoseLimit::parse(wrong).unwrap_err().exit_code(), 2, "{wrong}");
        }
    }
}
