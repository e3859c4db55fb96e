//! Phantoms and registrations that several files of tests look at, each made once.

use aventail::config::{Config, SoftTissue};
use aventail::geometry::Rigid;
use aventail::phantom::{Phantom, PhantomOptions};
use aventail::pipeline::{Case, Outcome, register};
use aventail::runtime::Runtime;
use std::sync::OnceLock;

/// So many voxels of 3 mm, with bones' edges so wide, mm.
fn at_3_mm(size: [usize; 3], edge_mm: f64) -> Phantom {
    let options = PhantomOptions { size, spacing_mm: [3.0; 3], edge_mm, ..PhantomOptions::default() };
    Phantom::new(&options).expect("the options are sensible")
}

/// The phantom at 3 mm.
pub fn fine() -> &'static Phantom {
    static ONE: OnceLock<Phantom> = OnceLock::new();
    ONE.get_or_init(|| at_3_mm([172, 120, 140], 2.5))
}

/// Head and neck of it at 3 mm: a quarter of its voxels.
pub fn neck() -> &'static Phantom {
    static ONE: OnceLock<Phantom> = OnceLock::new();
    ONE.get_or_init(|| at_3_mm([88, 84, 100], 2.7))
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

/// A case whose fit begins near the phantom's motion, where the search for it is not looked at.
pub fn begun_near(mut case: Case) -> Case {
    case.fraction.start = Some(Rigid::identity());
    case
}

/// Head and neck, and their registration with settings as they come.
pub fn neck_registered() -> (&'static Phantom, &'static Outcome) {
    static ONE: OnceLock<Outcome> = OnceLock::new();
    let phantom = neck();
    (phantom, ONE.get_or_init(|| registered(&begun_near(phantom.clone().into()))))
}

/// The phantom at 3 mm and its registration as it comes.
pub fn fine_registered() -> (&'static Phantom, &'static Outcome) {
    static ONE: OnceLock<Outcome> = OnceLock::new();
    let phantom = fine();
    (phantom, ONE.get_or_init(|| registered(&phantom.clone().into())))
}
