//! Random views of random postures: what is found of them, what is refused, and whether what is said of vertebral levels is true.
//!
//! A few run always. `AVENTAIL_SWEEP=200` runs so many (`200..400` those from 200 on), on all cores, and writes a line for each
//! to the file that `AVENTAIL_SWEEP_OUT` names; `AVENTAIL_SWEEP_SHORT=1` shows a few vertebrae in each. Where `AVENTAIL_CASES` names a folder of real cases, a third of them are parts of
//! its scans. `tests/peers/levels.py` tells from that file how often a stated probability holds.

use crate::support::folder;
use crate::support::shared::{bones_alone, fine};
use crate::support::views::{Cut, Draw, Scene, Shown, of_phantom, of_real, real_scans};
use aventail::config::Config;
use aventail::findings::{self, Finding};
use aventail::fit::{DeterminedBy, Place, Resolution, level_apart, levels_apart};
use aventail::geometry::Rigid;
use aventail::io::{read_image, read_labels};
use aventail::pipeline::{Case, FractionScan, Outcome, Planning, PlanningScan, register_fraction};
use aventail::progress::Silent;
use aventail::runtime::Runtime;
use aventail::skeleton::{Skeleton, build};
use aventail::view::View;
use aventail::volume::LabelMap;
use nalgebra::Point3;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

/// A bone is found within this, and where the view cuts it within the second, mm.
const NEAR_MM: [f64; 2] = [3.0, 5.0];
/// A bone of which less is in view is cut.
const WHOLE: f64 = 0.9;
/// A vertebra of which less is in view has no level.
const HALF: f64 = 0.5;
/// Bones of this volume tell a place, mm^3.
const LARGE_MM3: f64 = 5000.0;

/// What asks for a look at where the bones are; what is said of the soft tissue between them does not count here.
const OF_PLACE: [&Finding; 5] = [
    findings::BONES_LOST,
    findings::FRACTION_SCALED,
    findings::LEVEL_UNSURE,
    findings::SIDE_UNSURE,
    findings::WEAK_START,
];

/// The planning side of many cases.
struct Patient {
    scan: Arc<PlanningScan>,
    skeleton: Skeleton,
    planning: Planning,
}

impl Patient {
    fn new(scan: PlanningScan, config: &Config) -> Self {
        let runtime = Runtime::silent().expect("threads start");
        let planning = Planning::new(&scan, config, &runtime).expect("CT and labels fit each other");
        let skeleton = build(&scan.bones).expect("the bones have joints").skeleton;
        Self { scan: scan.into(), skeleton, planning }
    }

    /// The phantom with all bones, or with the spine and the head alone.
    fn phantom(all: bool, config: &Config) -> Self {
        let phantom = fine();
        let mut bones = phantom.bones.clone();
        if !all {
            let axis = |name: &str| name.starts_with("vertebrae") || name == "skull" || name == "mandible";
            bones.names.retain(|_, name| axis(name));
            let LabelMap { volume, names } = bones;
            bones = LabelMap { volume: volume.map(|l| if names.contains_key(l) { *l } else { 0 }), names };
        }
        Self::new(PlanningScan::new(phantom.planning.clone(), bones), config)
    }

    fn real(cases: &Path, config: &Config) -> Self {
        let ct = read_image(cases.join("planning_ct.nii.gz")).expect("AVENTAIL_CASES holds the planning CT").value;
        let bones = read_labels(cases.join("bones.nii.gz"), Some(&cases.join("bones.json"))).expect("and bones").value;
        Self::new(PlanningScan::new(ct, bones), config)
    }
}

/// What came of a view. Lists are `;` between items and `:` within one.
#[derive(Debug, Serialize)]
struct Row {
    seed: u64,
    kind: String,
    strength: f64,
    low_mm: f64,
    high_mm: f64,
    circle_mm: f64,
    shaded: bool,
    unfound: usize,
    /// Bones with their middle in view, those of 5 ml among them, and vertebrae.
    middles: usize,
    large: usize,
    vertebrae: usize,
    /// `registered`, the code of the refusal, or an error that is no finding.
    outcome: String,
    /// Codes of what was found, and whether one asks for a look at where the bones are.
    findings: String,
    doubted: bool,
    /// The worst of the bones in view that the image places, and whether a finding names it.
    worst_mm: f64,
    worst_bone: String,
    worst_named: bool,
    /// Bones in view beyond 3 mm, cut ones beyond 5 mm, that no finding names.
    beyond: usize,
    /// Vertebrae in view that the image places, and those nearer to the place of another one than to their own.
    levels: usize,
    levels_wrong: usize,
    /// Levels by which the result is off; nothing without a vertebra.
    level: Option<i32>,
    /// Volume in view of the bones that the image places, mm^3.
    visible_mm3: f64,
    /// Places that the fit weighed, the result first: cost, share found, levels from the result, levels from the truth, mm from the
    /// result, probability.
    places: String,
    /// Of the result's bones: name, share in view, share explained, mm off, what placed it.
    bones: String,
    /// Of the best place at another level: name, share in view, share explained.
    rival: String,
    /// What the search proposed: cost, mm from the best, levels from the truth.
    hypotheses: String,
    seconds: f64,
}

fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

impl Row {
    fn new(seed: u64, patient: &Patient, scene: &Scene) -> Self {
        let (grid, view) = (scene.fraction.grid(), View::of(&scene.fraction));
        let measured = |p: &Point3<f64>| grid.voxel_at(p).is_some_and(|at| view.measured().is_none_or(|m| *m.at(at)));
        let bones = || patient.skeleton.bones.iter();
        let middles: Vec<_> = bones().filter(|b| measured(&(scene.truth[&b.name] * b.centroid))).collect();
        let Cut { slab_mm: [low, high], circle_mm, shaded } = scene.cut;
        Self {
            seed,
            kind: scene.kind.clone(),
            strength: rounded(scene.strength),
            low_mm: rounded(low),
            high_mm: rounded(high),
            circle_mm: rounded(circle_mm),
            shaded,
            unfound: scene.unfound,
            middles: middles.len(),
            large: middles.iter().filter(|b| b.volume_mm3 >= LARGE_MM3).count(),
            vertebrae: middles.iter().filter(|b| b.name.starts_with("vertebrae")).count(),
            outcome: String::new(),
            findings: String::new(),
            doubted: false,
            worst_mm: 0.0,
            worst_bone: String::new(),
            worst_named: false,
            beyond: 0,
            levels: 0,
            levels_wrong: 0,
            level: None,
            visible_mm3: 0.0,
            places: String::new(),
            bones: String::new(),
            rival: String::new(),
            hypotheses: String::new(),
            seconds: 0.0,
        }
    }

    /// What a registration found, held against the truth.
    fn judge(&mut self, found: &Outcome, scene: &Scene) {
        let (skeleton, fits) = (&found.skeleton, &found.bone_fits);
        let truth: Vec<Rigid> = skeleton.bones.iter().map(|b| scene.truth[&b.name]).collect();
        let own: Vec<Rigid> = fits.iter().map(|f| f.transform).collect();
        let codes: Vec<&str> = found.warnings.iter().map(|w| w.code.as_str()).collect();
        self.outcome = "registered".into();
        self.findings = codes.join("|");
        self.doubted = found.warnings.iter().any(|w| OF_PLACE.iter().any(|finding| w.is(finding)));
        let placed = |b: usize| fits[b].determined_by == DeterminedBy::Image;
        let shown = |b: usize| placed(b) && fits[b].visible >= HALF;
        let named = |b: usize| found.warnings.iter().any(|w| w.message.contains(&fits[b].name));
        let off = |b: usize| (own[b] * skeleton.bones[b].centroid - truth[b] * skeleton.bones[b].centroid).norm();
        let all = 0..fits.len();
        if let Some(worst) = all.clone().filter(|b| shown(*b)).max_by(|a, b| off(*a).total_cmp(&off(*b))) {
            (self.worst_mm, self.worst_bone) = (rounded(off(worst)), fits[worst].name.clone());
            self.worst_named = named(worst);
        }
        let far = |b: &usize| off(*b) > NEAR_MM[usize::from(fits[*b].visible < WHOLE)];
        self.beyond = all.clone().filter(|b| shown(*b) && far(b) && !named(*b)).count();
        let levels = levels_apart(skeleton, &own, &truth, shown);
        (self.levels, self.levels_wrong) = (levels.len(), levels.iter().filter(|l| l.1 != 0).count());
        self.level = level_apart(skeleton, &own, &truth, shown);
        let volume = |b: usize| skeleton.bones[b].volume_mm3 * fits[b].visible;
        self.visible_mm3 = rounded(all.clone().filter(|b| placed(*b)).map(volume).sum());
        let number = |level: Option<i32>| level.map_or(String::new(), |l| l.to_string());
        let from = |there: &[Rigid]| level_apart(skeleton, &own, there, shown);
        let apart = |there: &[Rigid]| {
            let (mm, n) = all.clone().filter(|b| shown(*b)).fold((0.0, 1e-9), |(mm, n), b| {
                let c = skeleton.bones[b].centroid;
                (mm + (own[b] * c - there[b] * c).norm(), n + 1.0)
            });
            mm / n
        };
        let place = |p: &Place| {
            let right = level_apart(skeleton, &p.transforms, &truth, |b| p.seen[b][0] >= HALF && p.seen[b][1] > 0.3);
            let (own, right) = (number(from(&p.transforms)), number(right));
            format!("{:.4}:{:.4}:{own}:{right}:{:.2}:{:.4}", p.cost, p.found, apart(&p.transforms), p.probability)
        };
        self.places = found.weighed.places.iter().map(place).collect::<Vec<_>>().join(";");
        let bone = |b: usize| {
            let (f, explained) = (&fits[b], fits[b].similarity_after.unwrap_or(0.0));
            format!("{}:{:.3}:{explained:.4}:{:.3}:{}", f.name, f.visible, off(b), f.determined_by.name())
        };
        let in_view = |b: &usize| fits[*b].visible > 0.0;
        self.bones = all.clone().filter(in_view).map(bone).collect::<Vec<_>>().join(";");
        let others = found.weighed.places.iter().skip(1).filter(|p| from(&p.transforms).is_some_and(|l| l != 0));
        if let Some(rival) = others.min_by(|a, b| a.cost.total_cmp(&b.cost)) {
            let seen = all.clone().filter(|b| rival.seen[*b][0] > 0.0);
            let bone = |b: usize| format!("{}:{:.3}:{:.4}", fits[b].name, rival.seen[b][0], rival.seen[b][1]);
            self.rival = seen.map(bone).collect::<Vec<_>>().join(";");
        }
        let proposed = found.weighed.hypotheses.iter().map(|h| {
            // Where bones out of view are is a guess.
            let most = h.evidence.iter().copied().fold(0.0, f64::max);
            let right = level_apart(skeleton, &h.transforms, &truth, |b| h.evidence[b] > 0.2 * most);
            format!("{:.4}:{:.2}:{}", h.cost, h.apart_mm, number(right))
        });
        self.hypotheses = proposed.collect::<Vec<_>>().join(";");
    }
}

/// Registers a view.
fn row(seed: u64, patient: &Patient, scene: Scene, config: &Config, runtime: &Runtime) -> Row {
    let mut row = Row::new(seed, patient, &scene);
    let case = Case { planning: patient.scan.clone(), fraction: FractionScan::new(scene.fraction.clone()) };
    let begin = Instant::now();
    match register_fraction(&case, patient.planning.clone(), config, runtime) {
        Ok((found, _)) => row.judge(&found, &scene),
        Err(refused) if refused.finding().is_some() => row.outcome = refused.code().into(),
        Err(e) => row.outcome = format!("error {}: {}", e.exit_code(), e.problem()),
    }
    row.seconds = rounded(begin.elapsed().as_secs_f64());
    row
}

/// Cases on all cores, one thread each; what each gave is handed on as it comes.
fn each(seeds: std::ops::Range<u64>, made: impl Fn(u64, &Runtime) -> Row + Sync, mut told: impl FnMut(Row) + Send) {
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(seeds.clone().count());
    let (next, told) = (AtomicU64::new(seeds.start), Mutex::new(&mut told));
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                let runtime = Runtime::new(1, Box::new(Silent)).expect("a thread starts");
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= seeds.end {
                        break;
                    }
                    let row = made(seed, &runtime);
                    told.lock().expect("no thread stopped while it wrote")(row);
                }
            });
        }
    });
}

/// Views long enough to be found without a search, which takes longer, and a mild posture.
const QUICK: [Cut; 4] = [
    Cut { slab_mm: [80.0, 330.0], circle_mm: 0.0, shaded: false },
    Cut { slab_mm: [110.0, 300.0], circle_mm: 0.0, shaded: true },
    Cut { slab_mm: [130.0, 330.0], circle_mm: 230.0, shaded: false },
    Cut { slab_mm: [140.0, 340.0], circle_mm: 0.0, shaded: false },
];
const MILD: f64 = 0.3;

#[test]
fn random_views_are_found_at_their_level() {
    let mut config = bones_alone();
    config.fit.outward = vec![Resolution { blur_mm: 4.0, samples: 1500 }];
    config.fit.levels = vec![Resolution { blur_mm: 2.0, samples: 3000 }];
    let patient = Patient::phantom(false, &config);
    let mut rows = Vec::new();
    let made = |seed: u64, runtime: &Runtime| {
        let cut = QUICK[seed as usize];
        let scene = runtime.stage("pose", || of_phantom(seed, &fine().skeleton, Shown::Given(cut, MILD)));
        row(seed, &patient, scene, &config, runtime)
    };
    each(0..QUICK.len() as u64, made, |row| rows.push(row));
    assert_eq!(rows.len(), QUICK.len());
    for row in rows {
        println!("{row:?}");
        assert!(row.large >= 4 && row.vertebrae >= 5, "{}: the view shows too little", row.seed);
        assert_eq!(row.outcome, "registered", "{}", row.seed);
        assert!(row.worst_mm < 2.0 && row.beyond == 0, "{}: {} {}", row.seed, row.worst_bone, row.worst_mm);
        assert!(row.levels >= 5 && row.levels_wrong == 0 && row.level == Some(0), "{}: {row:?}", row.seed);
        // What was weighed begins with the result.
        let own = row.places.split(';').next().expect("a text has a first part");
        assert!(own.contains(":0:0:0.00:0.9"), "{own}");
    }
}

/// The phantom's spine moved up by one vertebra.
#[test]
fn a_level_that_is_off_is_seen() {
    let skeleton = &fine().skeleton;
    let at = |name: &str| skeleton.bones.iter().position(|b| b.name == name).expect("the phantom has it");
    let (here, there) = (at("vertebrae_T4"), at("vertebrae_T3"));
    let step = skeleton.bones[there].centroid - skeleton.bones[here].centroid;
    let truth = vec![Rigid::identity(); skeleton.bones.len()];
    let off = vec![Rigid::translation(step.x, step.y, step.z); skeleton.bones.len()];
    let thorax = |b: usize| (at("vertebrae_T6")..=at("vertebrae_T2")).contains(&b);
    // Where T4 was put lies T3.
    assert_eq!(level_apart(skeleton, &off, &truth, thorax), Some(1));
    assert_eq!(level_apart(skeleton, &truth, &truth, thorax), Some(0));
}

/// `200` or `200..400`.
fn seeds(text: &str) -> std::ops::Range<u64> {
    let number = |t: &str| t.trim().parse().expect("AVENTAIL_SWEEP is a number, or two with .. between them");
    match text.split_once("..") {
        Some((from, to)) => number(from)..number(to),
        None => 0..number(text),
    }
}

/// What is told of a kind of views, in a line.
fn summary(kind: &str, rows: &[&Row]) -> String {
    let count = |of: &dyn Fn(&Row) -> bool| rows.iter().filter(|r| of(r)).count();
    let registered = |r: &Row| r.outcome == "registered";
    let wrong = |r: &Row| registered(r) && r.level.is_some_and(|l| l != 0);
    format!(
        "{kind}: {} views with two large bones; registered {}, in doubt {} of them; all bones within bounds {}; wrong level {}, \
         untold {}; refused {}",
        rows.len(),
        count(&registered),
        count(&|r| registered(r) && r.doubted),
        count(&|r| registered(r) && r.beyond == 0),
        count(&wrong),
        count(&|r| wrong(r) && !r.doubted),
        count(&|r| !registered(r)),
    )
}

/// Many of them, when `AVENTAIL_SWEEP` asks for it.
#[test]
fn a_sweep_of_random_views() {
    let Some(text) = std::env::var_os("AVENTAIL_SWEEP").filter(|text| !text.is_empty()) else { return };
    let seeds = seeds(text.to_str().expect("AVENTAIL_SWEEP is text"));
    let wanted = seeds.clone().count();
    let set = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    let out = set("AVENTAIL_SWEEP_OUT").unwrap_or_else(|| folder().join("sweep.csv"));
    let draw: Draw = if set("AVENTAIL_SWEEP_SHORT").is_some() { Cut::short } else { Cut::random };
    let config = bones_alone();
    let phantoms = [true, false].map(|all| Patient::phantom(all, &config));
    let real = set("AVENTAIL_CASES").map(|cases| (Patient::real(&cases, &config), real_scans(&cases)));
    let made = |seed: u64, runtime: &Runtime| {
        if let Some((patient, scans)) = real.as_ref().filter(|_| seed % 3 == 2) {
            let scan = &scans[(seed / 3) as usize % scans.len()];
            let scene = runtime.stage("cut", || of_real(seed, &patient.skeleton, scan, draw));
            return row(seed, patient, scene, &config, runtime);
        }
        let patient = &phantoms[(seed / 3 + seed) as usize % 2];
        let mut scene = runtime.stage("pose", || of_phantom(seed, &fine().skeleton, Shown::Drawn(draw)));
        if patient.skeleton.bones.len() < fine().skeleton.bones.len() {
            scene.kind = "phantom:axis".into();
        }
        row(seed, patient, scene, &config, runtime)
    };
    let mut writer = csv::Writer::from_path(&out).expect("AVENTAIL_SWEEP_OUT can be written");
    let mut rows = Vec::new();
    each(seeds, made, |row| {
        writer.serialize(&row).and_then(|()| Ok(writer.flush()?)).expect("a line is written");
        rows.push(row);
    });
    assert_eq!(rows.len(), wanted);
    let told = |kind: &str, of: &dyn Fn(&Row) -> bool| {
        let some: Vec<&Row> = rows.iter().filter(|r| r.large >= 2 && of(r)).collect();
        println!("{}", summary(kind, &some));
    };
    told("all", &|_| true);
    for kind in ["phantom", "phantom:axis", "ct", "cbct"] {
        told(kind, &|r| r.kind == kind || (r.kind.starts_with(kind) && !kind.starts_with("phantom")));
    }
    println!("{}", out.display());
    let errors: Vec<&Row> = rows.iter().filter(|r| r.outcome.starts_with("error")).collect();
    assert!(errors.is_empty(), "{errors:?}");
}
