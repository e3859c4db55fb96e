//! Phantoms and registrations that several files of tests look at, each made once.

use aventail::config::{Config, SoftTissue};
use aventail::phantom::{Phantom, PhantomOptions};
use aventail::pipeline::{Case, Outcome, register};
use aventail::runtime::Runtime;
use std::sync::OnceLock;

/// The phantom at 3 mm.
pub fn fine() -> &'static Phantom {
    static ONE: OnceLock<Phantom> = OnceLock::new();
    ONE.get_or_init(|| {
        let options =
            PhantomOptions { size: [172, 120, 140], spacing_mm: [3.0; 3], edge_mm: 2.5, ..PhantomOptions::default() };
        Phantom::new(&options).expect("the options are sensible")
    })
}

/// The phantom at 5 x 5 x 6 mm.
pub fn coarse() -> &'static Phantom {
    static ONE: OnceLock<Phantom> = OnceLock::new();
    ONE.get_or_init(|| Phantom::new(&PhantomOptions::coarse()).expect("the options are sensible"))
}

/// Settings of a fit as it comes, where what is made of soft tissue is not looked at.
pub fn bones_alone() -> Config {
    let mut config = Config { soft_tissue: SoftTissue::NearestBone, ..Config::default() };
    config.consistency.rounds = 0;
    config.output.uncertainty = false;
    config
}

/// A case with default settings.
pub fn registered(case: &Case) -> Outcome {
    register(case, &Config::default(), &Runtime::silent().expect("threads start")).expect("the phantom registers")
}

/// The phantom at 3 mm and its registration as it comes.
pub fn fine_registered() -> (&'static Phantom, &'static Outcome) {
    static ONE: OnceLock<Outcome> = OnceLock::new();
    let phantom = fine();
    (phantom, ONE.get_or_init(|| registered(&phantom.clone().into())))
}
