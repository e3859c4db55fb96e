//! Several fractions of one patient: what depends on planning alone is read and made once.

use super::fraction::FractionSources;
use super::headers;
use super::planning::{BonesBy, PlanningSources};
use super::registered::{Made, Registered};
use crate::config::{Config, RecordedInput};
use crate::error::{Error, Result};
use crate::pipeline::{Case, FractionScan, Planning, PlanningScan, check_fraction, register_fraction, same_scan};
use crate::provenance::Provenance;
use crate::report::{Clinic, ClinicFiles, one_frame};
use crate::runtime::Runtime;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What is to be registered, and how.
#[derive(Debug, Clone)]
pub struct Request {
    /// The planning side.
    pub planning: PlanningSources,
    /// The fractions, in the order in which they are registered.
    pub fractions: Vec<FractionSources>,
    /// What goes back to a planning system, where DICOM is asked for.
    pub clinic: Option<ClinicFiles>,
    /// Leaves the patient's identity out of reports.
    pub anonymous: bool,
    /// Planning and fraction truly lie in one frame of reference: nothing is to be said about it.
    pub same_frame: bool,
    /// Inputs of an earlier run, whose checksums are compared with those of the files that are read.
    pub recorded: Vec<RecordedInput>,
    /// Complete settings.
    pub config: Config,
    /// What is run, as reports and locks name it.
    pub command: String,
}

impl Request {
    /// All files that will be read.
    pub fn files(&self) -> Vec<PathBuf> {
        let mut all: Vec<PathBuf> = self.planning.files().collect();
        all.extend(self.needed());
        all
    }

    /// The files beside those of the planning side.
    pub fn needed(&self) -> Vec<PathBuf> {
        let clinic = self.clinic.iter().flat_map(ClinicFiles::paths).map(Path::to_owned);
        self.fractions.iter().flat_map(FractionSources::files).chain(clinic).collect()
    }

    /// Whether labels of planning or a fraction are `auto`.
    pub fn wants_bones(&self) -> bool {
        self.planning.wants_bones() || self.fractions.iter().any(FractionSources::wants_bones)
    }

    /// Makes the labels that are `auto`, of planning and fractions, or takes those that were made before.
    ///
    /// # Errors
    /// As [`PlanningSources::make_bones`].
    pub fn make_bones(&mut self, by: BonesBy<'_>, runtime: &Runtime) -> Result<()> {
        let needed = self.needed();
        let [planning, fraction] = [self.config.planning.modality, self.config.fraction.modality];
        self.planning.make_bones(&needed, planning, by, runtime)?;
        self.fractions.iter_mut().try_for_each(|one| one.make_bones(fraction, by, runtime))
    }

    /// Reads what is small of each fraction, so that a fault in it is told before anything long begins.
    ///
    /// # Errors
    /// As [`FractionSources::settle`].
    pub fn settle(&mut self) -> Result<()> {
        let planning = self.planning.ct.path().map(Path::to_owned);
        self.fractions.iter_mut().try_for_each(|one| one.settle(planning.as_deref()))
    }

    /// Refuses faults that show in the request itself or in headers; returns the expected memory of the fraction that needs most,
    /// bytes.
    ///
    /// # Errors
    /// [`Error::Usage`] when scans in memory, or a part of them, are to go back as DICOM; else as [`headers::judge`].
    pub fn expected_memory(&self) -> Result<u64> {
        if self.clinic.is_some() {
            self.series()?;
        }
        headers::judge(&self.planning, &self.fractions, &self.config)
    }

    /// What is read for DICOM.
    fn clinic(&self) -> Result<Option<Arc<Clinic>>> {
        let Some(files) = &self.clinic else { return Ok(None) };
        let (planning, fractions) = self.series()?;
        Ok(Some(Arc::new(Clinic::read(files, planning, &fractions)?)))
    }

    /// The series that can go back as DICOM: whole scans, none of them in memory.
    fn series(&self) -> Result<(&Path, Vec<&Path>)> {
        Clinic::check(&self.config)?;
        let fractions = self.fractions.iter().map(|one| on_disk(one.ct.path())).collect::<Result<_>>();
        Ok((on_disk(self.planning.ct.path())?, fractions?))
    }
}

fn on_disk(path: Option<&Path>) -> Result<&Path> {
    path.ok_or_else(|| {
        let problem = "DICOM results need DICOM input, and a scan is given in memory";
        Error::usage(problem, "give the folders of both series, or leave dicom out")
    })
}

/// A fraction that was read ahead.
struct Ahead {
    name: String,
    read: Result<(FractionScan, Provenance)>,
}

impl Ahead {
    fn of(mut one: FractionSources, recorded: &[RecordedInput]) -> Self {
        Self { name: std::mem::take(&mut one.name), read: one.read(recorded) }
    }
}

/// A planning side that was read, and fractions that are still to be.
pub struct Session {
    scan: Arc<PlanningScan>,
    provenance: Provenance,
    fractions: std::vec::IntoIter<FractionSources>,
    /// The first of them, read beside the planning side.
    ahead: Option<Ahead>,
    clinic: Option<Arc<Clinic>>,
    anonymous: bool,
    same_frame: bool,
    recorded: Vec<RecordedInput>,
    config: Arc<Config>,
    command: Arc<str>,
}

impl Session {
    /// Reads what is small, then the planning side beside the first fraction.
    ///
    /// # Errors
    /// When a file cannot be read or used; what is asked for as DICOM must be there as DICOM; [`Error::Usage`] when a fraction is
    /// of another modality than the settings say.
    pub fn open(mut request: Request, runtime: &Runtime) -> Result<Self> {
        request.settle()?;
        let planning = headers::planning_modality(&request.planning, request.config.planning.modality)?;
        request.config.planning.modality = planning;
        request.config.fraction.modality = headers::modality(&request.fractions, request.config.fraction.modality)?;
        let clinic = match &request.clinic {
            Some(_) => runtime.stage("read for DICOM", || request.clinic())?,
            None => None,
        };
        let known = clinic.iter().flat_map(|clinic| clinic.warnings());
        known.for_each(|warning| runtime.progress().note(&warning.message));
        let Request { planning, fractions, anonymous, same_frame, recorded, config, command, .. } = request;
        let mut fractions = fractions.into_iter();
        let one = fractions.next();
        let (read, ahead) =
            runtime.beside(|| planning.read(&recorded, &config, runtime), || one.map(|one| Ahead::of(one, &recorded)));
        let (scan, mut provenance) = read?;
        provenance.inputs.extend(clinic.iter().flat_map(|clinic| clinic.inputs()).cloned());
        Ok(Self {
            scan: Arc::new(scan),
            provenance,
            fractions,
            ahead,
            clinic,
            anonymous,
            same_frame,
            recorded,
            config: Arc::new(config),
            command: command.into(),
        })
    }

    /// Registers one fraction after the other and hands each result on; the next fraction is read while `each` works, for disks
    /// and networks take their time.
    ///
    /// # Errors
    /// When a file cannot be read, inputs do not fit each other, or the images share no anatomy; what `each` reports.
    pub fn register_all(
        mut self,
        runtime: &Runtime,
        mut each: impl FnMut(Registered) -> Result<()> + Send,
    ) -> Result<()> {
        let mut planning: Option<Planning> = None;
        let mut next = self.ahead.take();
        let mut n = 0;
        while let Some(Ahead { name, read }) = next {
            if n > 0 {
                runtime.restart();
            }
            if !name.is_empty() {
                runtime.progress().note(&format!("fraction {name}"));
            }
            let (fraction, mut of_fraction) = runtime.stage("read the fraction", || read)?;
            check_fraction(&fraction.ct, &self.config)?;
            let same = same_scan(&self.scan.ct, &fraction.ct);
            same.iter().for_each(|warning| runtime.progress().note(&warning.message));
            of_fraction.warnings.extend(same);
            let prepared = match planning.take() {
                Some(planning) => planning,
                None => Planning::new(&self.scan, &self.config, runtime)?,
            };
            // The last fraction lets go of the planning side on its way.
            planning = (!self.fractions.as_slice().is_empty()).then(|| prepared.clone());
            let case = Case { planning: Arc::clone(&self.scan), fraction };
            let (outcome, part) = register_fraction(&case, prepared, &self.config, runtime)?;
            let mut provenance = self.provenance.clone();
            provenance.extend(of_fraction);
            if self.clinic.is_none() && !self.same_frame {
                let odd = one_frame(&provenance);
                odd.iter().for_each(|warning| runtime.progress().note(&warning.message));
                provenance.warnings.extend(odd);
            }
            if self.anonymous {
                provenance.forget_patient();
            }
            let back = self.clinic.clone().map(|clinic| (clinic, n));
            let made = Made { case: part.unwrap_or(case), outcome, provenance, back };
            let registered = Registered::new(made, &self.config, &self.command, runtime);
            let following = self.fractions.next();
            let recorded = &self.recorded;
            let (done, ahead) = runtime.beside(|| each(registered), || following.map(|one| Ahead::of(one, recorded)));
            done?;
            next = ahead;
            n += 1;
        }
        Ok(())
    }

    /// Registers a single fraction.
    ///
    /// # Errors
    /// As [`Session::register_all`].
    pub fn register(self, runtime: &Runtime) -> Result<Registered> {
        let mut only = None;
        self.register_all(runtime, |registered| {
            only = Some(registered);
            Ok(())
        })?;
        only.ok_or_else(|| Error::Internal("a session without a fraction".into()))
    }
}
