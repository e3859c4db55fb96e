//! Posture after posture: drawn, made, judged, written.

use super::args::LibraryArgs;
use super::sources::Carried;
use super::write::PostureWritten;
use crate::body;
use crate::chainmail::VolumeChange;
use crate::config::Config;
use crate::error::{Error, Result};
use crate::findings;
use crate::io::checksum::sha256;
use crate::io::{read_image, read_labels};
use crate::phantom::CbctOptions;
use crate::pipeline::{BoneMotion, Outcome, Posing};
use crate::postures::{Drawn, MOST_DRAWS, PosturePlan, VolumeRange, sixes};
use crate::report::{Gallery, PostureRecord, Rejected};
use crate::runtime::Runtime;
use crate::skeleton::Pose;
use crate::volume::Mask;
use std::time::Instant;

/// More draws per posture than this are not tried.
const TRIES: usize = 20;

/// Makes postures of one patient.
pub(super) struct Maker<'a> {
    pub(super) posing: &'a Posing,
    pub(super) plan: &'a PosturePlan,
    pub(super) config: &'a Config,
    pub(super) carried: &'a Carried,
    pub(super) degrade: Option<&'a CbctOptions>,
    pub(super) args: &'a LibraryArgs,
    /// What every posture depends on, as a checksum.
    pub(super) base: String,
    /// Shows nothing: there are too many stages.
    pub(super) runtime: Runtime,
    pub(super) rejected: Vec<Rejected>,
    pub(super) draws: u32,
}

/// A posture to be made.
struct PostureWanted {
    pose: Pose,
    changes: Vec<VolumeChange>,
    held: usize,
    chosen: Option<String>,
    draw: Option<u32>,
}

impl Maker<'_> {
    /// The patient, for pictures.
    pub(super) fn patient(&self) -> Result<Mask> {
        let scan = self.posing.planning();
        self.runtime.stage("find the patient", || body::find(&scan.ct, Some(&scan.bones), &self.config.body))
    }

    /// Posture `n` of the library: the plan's own come first, then those that are drawn.
    pub(super) fn posture(&mut self, n: usize, name: &str, gallery: &mut Gallery) -> Result<PostureRecord> {
        if let Some(own) = self.plan.postures.get(n) {
            // Volumes that are no range hold for every posture.
            let fixed = self.plan.volumes.iter().filter(|v| v.range[0].to_bits() == v.range[1].to_bits());
            let change = |v: &VolumeRange| VolumeChange { organ: v.organ.clone(), factor: v.range[0] };
            let wanted = PostureWanted {
                pose: own.pose.clone(),
                changes: fixed.map(change).collect(),
                held: 0,
                chosen: Some(own.name.clone()),
                draw: None,
            };
            return self.made(&wanted, n, name, gallery).map(|made| made.0);
        }
        let mut why = Vec::new();
        for _ in 0..TRIES {
            if self.draws >= MOST_DRAWS {
                break;
            }
            let wanted = self.drawn();
            let draw = wanted.draw.unwrap_or_default();
            // Bones can be judged before anything else is made of a posture.
            why = if self.args.reject { self.bones(&wanted.pose) } else { Vec::new() };
            if why.is_empty() {
                let (record, keep) = self.made(&wanted, n, name, gallery)?;
                if keep {
                    return Ok(record);
                }
                why = record.why;
            }
            self.rejected.push(Rejected { draw, why: why.clone() });
        }
        let problem = format!("{TRIES} draws for {name} were implausible; the last: {}", why.join("; "));
        let remedy = "lower `scale` or the deviations of the plan, raise its [limits], or leave --reject out";
        Err(Error::refused(findings::POSTURES_IMPLAUSIBLE, "the plan", problem, remedy))
    }

    /// The next draw.
    fn drawn(&mut self) -> PostureWanted {
        let draw = self.draws;
        self.draws += 1;
        let Drawn { pose, factors, held } = self.plan.draw(draw, self.args.seed);
        let change =
            |(v, factor): (&crate::postures::VolumeRange, f64)| VolumeChange { organ: v.organ.clone(), factor };
        let changes = self.plan.volumes.iter().zip(factors).map(change).collect();
        PostureWanted { pose, changes, held, chosen: None, draw: Some(draw) }
    }

    fn bones(&self, pose: &Pose) -> Vec<String> {
        let contact = self.runtime.stage("bones", || self.posing.bones_meet(pose));
        self.posing.why_of_bones(&contact, &self.plan.limits)
    }

    /// A posture with its files, those of an earlier run where they are as they would be made; and whether it is to be kept.
    /// What is not kept is not written.
    fn made(
        &self,
        wanted: &PostureWanted,
        n: usize,
        name: &str,
        gallery: &mut Gallery,
    ) -> Result<(PostureRecord, bool)> {
        let key = self.key(wanted, n);
        let out = &self.args.out;
        if let Some(record) = PostureRecord::finished(out, name, &key) {
            let keep = record.plausible || !self.rejects(wanted);
            if keep {
                let file = |role: &str| record.files.get(role).map_or_else(|| out.join(name), |f| out.join(f));
                gallery.add(name, &read_image(file("ct"))?.value, &read_labels(file("label"), None)?.value)?;
            }
            return Ok((record, keep));
        }
        let start = Instant::now();
        self.runtime.restart();
        let mut config = self.config.clone();
        config.chainmail.volume_change.clone_from(&wanted.changes);
        let motion = BoneMotion::Pose(wanted.pose.clone());
        let outcome = self.posing.posed(&motion, &[], &config, &self.runtime)?;
        let why = self.posing.why_implausible(&outcome, &self.plan.limits);
        let mut record = PostureRecord::new(name, &outcome, why);
        (record.chosen, record.draw, record.held) = (wanted.chosen.clone(), wanted.draw, wanted.held);
        record.key = key;
        if !record.plausible && self.rejects(wanted) {
            return Ok((record, false));
        }
        self.write(&outcome, wanted, n, &mut record, gallery, start)?;
        Ok((record, true))
    }

    fn rejects(&self, wanted: &PostureWanted) -> bool {
        self.args.reject && wanted.draw.is_some()
    }

    fn write(
        &self,
        outcome: &Outcome,
        wanted: &PostureWanted,
        n: usize,
        record: &mut PostureRecord,
        gallery: &mut Gallery,
        start: Instant,
    ) -> Result<()> {
        let written = PostureWritten::of(outcome, self.degrade, self.seed(n))?;
        let (files, drawn) = self.runtime.beside(
            || written.write(self.args, self.config, &wanted.pose, self.carried, record),
            || gallery.add(&record.name, &written.ct, &written.labels),
        );
        drawn?;
        let (names, outputs, warnings) = files?;
        (record.files, record.outputs) = (names, outputs);
        record.warnings.extend(warnings);
        record.seconds = start.elapsed().as_secs_f64();
        PostureWritten::record(&self.args.out, record)
    }

    /// Seed of the noise of posture `n`.
    fn seed(&self, n: usize) -> u64 {
        u64::from(self.args.seed) << 32 | n as u64
    }

    /// What a posture depends on.
    fn key(&self, wanted: &PostureWanted, n: usize) -> String {
        // Noise differs from posture to posture, by its place.
        let noise = self.degrade.map(|_| self.seed(n));
        let own = serde_json::json!([sixes(&wanted.pose), wanted.changes, wanted.chosen, wanted.draw, noise]);
        format!("{}-{}", self.base, sha256(own.to_string().as_bytes()))
    }
}
