//! Organs beside the bones: their labels, and volumes that are known to change.

use crate::chainmail::VolumeChange;
use crate::config::Config;
use crate::error::{Error, Result};
use clap::Args;
use std::path::PathBuf;

/// Options on organs.
#[derive(Debug, Args, Clone, Default)]
pub struct OrganArgs {
    /// Organ labels on the planning grid: a label map with names, a mask whose file name is the
    /// organ's name, or a DICOM structure set (only organs named in settings or --volume-change
    /// count)
    #[arg(long, value_name = "FILE")]
    pub organs: Option<PathBuf>,
    /// Volume of an organ in the fraction divided by that in planning, for example
    /// parotid_left=0.8; repeat the option for several organs
    #[arg(long, value_name = "ORGAN=FACTOR", value_parser = parse_change)]
    pub volume_change: Vec<VolumeChange>,
}

impl OrganArgs {
    /// Lays the changes over those of the settings.
    ///
    /// # Errors
    /// [`Error::Usage`] when a factor makes no sense or the settings cannot use it.
    pub(super) fn apply(&self, config: &mut Config) -> Result<()> {
        let problem = config.change_volumes(&self.volume_change);
        problem.map_or(Ok(()), |p| Err(Error::usage(p, "correct --volume-change, or the settings it goes with")))
    }
}

fn parse_change(text: &str) -> Result<VolumeChange, String> {
    let (organ, factor) = text.split_once('=').ok_or("ORGAN=FACTOR is needed, for example parotid_left=0.8")?;
    let factor = factor.parse().map_err(|_| format!("`{factor}` is no number"))?;
    let change = VolumeChange { organ: organ.to_owned(), factor };
    change.problem().map_or(Ok(change), Err)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_read_and_refused() {
        assert_eq!(parse_change("a_b=0.8"), Ok(VolumeChange { organ: "a_b".into(), factor: 0.8 }));
        for bad in ["a", "a=", "a=x", "a=0", "a=NaN", "a=7"] {
            assert!(parse_change(bad).is_err(), "{bad}");
        }
        let args = OrganArgs { organs: None, volume_change: vec![parse_change("a=0.8").unwrap()] };
        let mut config = Config::default();
        config.chainmail.volume_change = vec![parse_change("a=1.5").unwrap(), parse_change("b=1.1").unwrap()];
        args.apply(&mut config).unwrap();
        let factors: Vec<f64> = config.chainmail.volume_change.iter().map(|c| c.factor).collect();
        assert_eq!(factors, [1.1, 0.8]);
        config.chainmail.relaxation = Vec::new();
        assert!(args.apply(&mut config).is_err());
    }
}
