//! Rank 4: dose on a deforming patient. Mapping, accumulation, dose-volume histograms, differences; Gy and grams.

mod band;
mod caution;
mod count;
mod density;
mod difference;
mod dvh;
mod energy;
mod interpolate;
mod judge;
mod sample;

pub use band::{Decision, DoseLimit, DvhBand, FigureBand, bands};
pub use caution::{Caution, STEEP, caution, steep};
pub use count::DoseCounts;
pub use density::DensityTable;
pub use difference::{DoseDifference, difference, distance_to_difference};
pub use dvh::{Dvh, DvhPlaces, Share, doubts, dvh, dvh_of_contours};
pub use energy::{EnergyBalance, EnergyMassOptions, energy_mass};
pub use interpolate::{accumulate, displacement, dose_at, interpolate};
pub use judge::{dose_carried, judge, judge_result, question};
