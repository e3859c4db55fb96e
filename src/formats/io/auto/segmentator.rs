//! TotalSegmentator as a program on the path: found, asked its version, run, its progress shown.

use crate::error::{Error, Result};
use crate::progress::Progress;
use std::ffi::OsString;
use std::io::{PipeReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

/// The program's name.
const NAME: &str = "TotalSegmentator";
/// Licences of the program and of the weights of all tasks that are run for a CT or an MR, as its README says.
pub(super) fn licence(is_mr: bool) -> String {
    let (tasks, paper) = if is_mr {
        ("total_mr and vertebrae_mr", "Akinci D'Antonoli et al. 2025, doi 10.1148/radiol.241613")
    } else {
        ("total, craniofacial_structures and headneck_bones_vessels", "Wasserthal et al. 2023, doi 10.1148/ryai.230024")
    };
    format!("TotalSegmentator and the weights of the tasks {tasks}: Apache-2.0; cite {paper}.")
}
/// Ways to labels without it.
pub(super) const BY_HAND: &str = "bones come in one of three ways: \
    (1) run TotalSegmentator by hand (`TotalSegmentator -i CT.nii.gz -o total.nii.gz --ml`; mandible and hyoid with \
    `--task craniofacial_structures` and `--task headneck_bones_vessels`; of an MR `--task total_mr` and `--task vertebrae_mr`) \
    and join its files with `aventail labels merge`; \
    (2) give the DICOM structure set (RTSTRUCT) in which bones are drawn; \
    (3) give any label map of this scan whose labels have names of bones";
/// Bytes of the program's output that an error can tell of.
const KEPT: usize = 4000;
/// How often a run is asked whether it goes on while the program is silent.
const POLL: Duration = Duration::from_millis(100);
/// Its last lines that an error tells.
const LINES: usize = 6;

/// The program.
pub(super) struct Segmentator {
    path: PathBuf,
    /// As it says itself.
    pub(super) version: String,
    quiet: bool,
}

impl Segmentator {
    /// The program on the path.
    ///
    /// # Errors
    /// [`Error::Usage`] when it is not there.
    pub(super) fn find(quiet: bool) -> Result<Self> {
        let paths = std::env::var_os("PATH").unwrap_or_default();
        let name = format!("{NAME}{}", std::env::consts::EXE_SUFFIX);
        let mut places = std::env::split_paths(&paths).filter(|f| !f.as_os_str().is_empty()).map(|f| f.join(&name));
        let Some(path) = places.find(|p| is_program(p)) else {
            let problem = "bones by `auto` need the program TotalSegmentator, and it is not on the PATH";
            return Err(Error::usage(problem, format!("{BY_HAND}; aventail itself installs and fetches nothing")));
        };
        let version = version(&path);
        Ok(Self { path, version, quiet })
    }

    /// What is told before anything is run.
    pub(super) fn told(&self, is_mr: bool) -> String {
        format!(
            "bones by {} (version {}). {} When it is run for the first time TotalSegmentator itself fetches its weights; it may \
             send statistics of its use unless its own settings say no",
            self.path.display(),
            self.version,
            licence(is_mr)
        )
    }

    /// A command line as it could be typed.
    pub(super) fn command_line(&self, arguments: &[OsString]) -> String {
        let quoted = |text: &str| match text.contains([' ', '\'', '"', '$', '&', ';', '(', ')']) {
            true => format!("'{}'", text.replace('\'', "'\\''")),
            false => text.to_owned(),
        };
        let own = self.path.to_string_lossy();
        std::iter::once(own)
            .chain(arguments.iter().map(|a| a.to_string_lossy()))
            .map(|t| quoted(&t))
            .collect::<Vec<_>>()
            .join(" ")
    }

    /// Runs it to its end, or to that of this run: `progress` may unwind while it waits. Its output goes to standard error as it comes, unless the run is quiet.
    ///
    /// # Errors
    /// What to say behind the command line when it could not be started or failed.
    pub(super) fn run(&self, arguments: &[OsString], progress: &dyn Progress) -> Result<(), String> {
        let ran = watched(&self.path, arguments, self.quiet, progress);
        let (status, last) = ran.map_err(|e| format!("cannot be run: {e}"))?;
        if status.success() {
            return Ok(());
        }
        let last = if last.is_empty() { "it said nothing".into() } else { format!("its last words: {last}") };
        Err(format!("failed ({status}); {last}"))
    }
}

/// The arguments of a task, for these classes alone where some are named.
pub(super) fn arguments(ct: &Path, out: &Path, task: &str, classes: &[String]) -> Vec<OsString> {
    let mut all: Vec<OsString> = vec!["-i".into(), ct.into(), "-o".into(), out.into()];
    all.extend(["--ml", "--task", task].map(OsString::from));
    if !classes.is_empty() {
        all.push("--roi_subset".into());
        all.extend(classes.iter().map(OsString::from));
    }
    all
}

/// Whether a path is a file that may be run.
fn is_program(path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        std::fs::metadata(path).is_ok_and(|m| m.is_file() && m.permissions().mode() & 0o111 != 0)
    }
    #[cfg(not(unix))]
    path.is_file()
}

/// The version that the program tells, in one word.
fn version(path: &Path) -> String {
    let output = Command::new(path).arg("--version").stdin(Stdio::null()).output().ok().filter(|o| o.status.success());
    let text = output.map(|o| String::from_utf8_lossy(&o.stdout).into_owned()).unwrap_or_default();
    text.split_whitespace().last().map_or_else(|| "unknown".to_owned(), |v| v.chars().take(30).collect())
}

/// A program at work, which ends when nobody waits for it any longer.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        // It has ended already, but where a run was given up.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Runs a program, shows what it says, and keeps its last lines.
fn watched(
    path: &Path,
    arguments: &[OsString],
    quiet: bool,
    progress: &dyn Progress,
) -> std::io::Result<(ExitStatus, String)> {
    let (reader, writer) = std::io::pipe()?;
    let mut command = Command::new(path);
    command.args(arguments).stdin(Stdio::null()).stdout(writer.try_clone()?).stderr(writer);
    let mut running = Running(command.spawn()?);
    // With our own ends of the pipe open it would never end.
    drop(command);
    let said = chunks(reader);
    let mut last = Vec::new();
    loop {
        match said.recv_timeout(POLL) {
            Ok(chunk) => {
                let chunk = chunk?;
                if !quiet {
                    // A closed terminal is no reason to stop.
                    let _ = std::io::stderr().write_all(&chunk);
                }
                last.extend_from_slice(&chunk);
                last.drain(..last.len().saturating_sub(KEPT));
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
        progress.waiting();
    }
    Ok((running.0.wait()?, last_lines(&last)))
}

/// What comes out of a pipe, read on a thread of its own so that whoever waits for it can give up.
fn chunks(mut reader: PipeReader) -> Receiver<std::io::Result<Vec<u8>>> {
    let (to, said) = channel();
    std::thread::spawn(move || {
        let mut buffer = [0; 4096];
        loop {
            let chunk = match reader.read(&mut buffer) {
                Ok(0) => break,
                Ok(n) => Ok(buffer[..n].to_vec()),
                Err(e) if e.kind() == std::io::ErrorKind::Interrupted => continue,
                Err(e) => Err(e),
            };
            let failed = chunk.is_err();
            if to.send(chunk).is_err() || failed {
                break;
            }
        }
    });
    said
}

/// The last lines of a text that say something, behind each other.
fn last_lines(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(bytes);
    let lines: Vec<&str> = text.split(['\n', '\r']).map(str::trim).filter(|l| !l.is_empty()).collect();
    lines[lines.len().saturating_sub(LINES)..].join(" / ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn command_lines_are_as_typed() {
        let program = Segmentator { path: "bin/TotalSegmentator".into(), version: String::new(), quiet: true };
        let all =
            arguments(Path::new("my ct.nii"), Path::new("o.nii.gz"), "total", &["skull".into(), "sternum".into()]);
        let line = "bin/TotalSegmentator -i 'my ct.nii' -o o.nii.gz --ml --task total --roi_subset skull sternum";
        assert_eq!(program.command_line(&all), line);
        assert_eq!(arguments(Path::new("a"), Path::new("b"), "body", &[]).len(), 7);
    }

    #[test]
    fn the_end_of_a_text_is_told() {
        assert_eq!(last_lines(b"1\n2\r\n3\r4\n\n5\n6\n7\n"), "2 / 3 / 4 / 5 / 6 / 7");
        assert_eq!(last_lines(b""), "");
    }
}
