//! What the presets stand for.

use super::settings::{Config, OutputOptions, Preset};
use crate::chainmail::{ChainmailOptions, RelaxationLevel};
use crate::field::ConsistencyOptions;
use crate::fit::{FitOptions, Resolution};
use crate::refine::RefineOptions;

impl Preset {
    /// The settings that the preset stands for.
    pub fn config(self) -> Config {
        let base = Config { preset: self, ..Config::default() };
        match self {
            Self::Default => base,
            Self::Fast => Config {
                chainmail: ChainmailOptions {
                    spacing_mm: 5.0,
                    relaxation: [(20.0, 30), (10.0, 20), (5.0, 8)].map(RelaxationLevel::from).into(),
                    ..ChainmailOptions::default()
                },
                fit: FitOptions {
                    levels: [(2.0, 2000), (0.8, 5000)].map(Resolution::from).into(),
                    ..FitOptions::default()
                },
                refine: RefineOptions { passes: 4, rounds: 2, ..RefineOptions::default() },
                consistency: ConsistencyOptions { rounds: 0, ..ConsistencyOptions::default() },
                output: OutputOptions { uncertainty: false, gzip_level: 0, ..OutputOptions::default() },
                ..base
            },
            Self::Thesis => Config {
                chainmail: ChainmailOptions::thesis(),
                refine: RefineOptions { weight: 0.0, ..RefineOptions::default() },
                consistency: ConsistencyOptions { rounds: 0, ..ConsistencyOptions::default() },
                ..base
            },
        }
    }
}
