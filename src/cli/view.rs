//! `aventail view`: a finished run to look through at full resolution, on this machine alone.

use super::args::QuietArgs;
use super::contours;
use super::finished::Finished;
use super::terminal::progress;
use crate::config::{InputRole, RecordedInput};
use crate::error::{Error, Result};
use crate::io::checksum::sha256_file;
use crate::report::view_page;
use crate::runtime::Runtime;
use crate::volume::contour::Contours;
use clap::Args;
use std::io::Write;
use std::path::{Path, PathBuf};
use tiny_http::{Header, Method, Request, Response, Server};

/// What `aventail view --help` adds.
pub(super) const AFTER: &str = "\
The page is served on the loopback address of this machine, under an address with a random token,
until Ctrl-C. Nothing but the page is served, and other machines cannot reach it. The run's files
and inputs must be unchanged. A run with --dicom --structures is shown with those structures. Of a
run of several fractions give the folder of one; OUT/index.html links to the reports of all.

Examples:
  aventail view out
  aventail view week/monday
  aventail view out --structures contours.json";

/// Options of `view`.
#[derive(Debug, Args)]
pub struct ViewArgs {
    /// The --out folder of a finished run of `aventail register`, `pose` or `demo`; for several
    /// fractions the folder of one
    #[arg(value_name = "OUT")]
    pub run: PathBuf,
    /// Structures of the planning CT, shown before and after: contours (JSON, DICOM structure set).
    /// Default: the --structures of the run
    #[arg(long, value_name = "FILE")]
    pub structures: Option<PathBuf>,
    /// Print the address without opening a browser
    #[arg(long)]
    pub no_browser: bool,
    /// Whether progress is shown.
    #[command(flatten)]
    pub shown: QuietArgs,
}

/// Serves the page until the process is ended.
///
/// # Errors
/// When the run cannot be read, or no port is free.
pub(super) fn run(args: &ViewArgs) -> Result<String> {
    let runtime = Runtime::new(0, progress(args.shown.quiet))?;
    let Finished { case, outcome, provenance, structures: carried } = Finished::read(&args.run, &runtime)?;
    let known = carried.as_ref().filter(|_| args.structures.is_none()).and_then(|set| unchanged(set, &runtime));
    let contours = args.structures.as_deref().or(known);
    let contours = contours.map(|path| structures(path, provenance.file(InputRole::Planning), &runtime)).transpose()?;
    let page = runtime.stage("pack the volumes", || view_page(&case, &outcome, &provenance, contours.as_ref()))?;
    drop((case, outcome));
    let failed =
        |what: String| Error::write("127.0.0.1", what, "look whether something forbids programs to listen on loopback");
    let server = Server::http("127.0.0.1:0").map_err(|e| failed(e.to_string()))?;
    let host = server.server_addr().to_ip().ok_or_else(|| failed("no address".into()))?.to_string();
    let site = Site { host, token: token()?, page };
    let address = site.address();
    // A reader that is gone is no reason not to serve.
    let mut out = std::io::stdout();
    let _ = writeln!(out, "{address}\nCtrl-C ends it.").and_then(|()| out.flush());
    if !args.no_browser && open::that_detached(&address).is_err() {
        runtime.progress().note("no browser was found: open the address above in one");
    }
    for request in server.incoming_requests() {
        site.answer(request);
    }
    Ok(String::new())
}

/// The file of the run's structures, if it is still what the run has read; else why it is not shown is told.
fn unchanged<'a>(set: &'a RecordedInput, runtime: &Runtime) -> Option<&'a Path> {
    let problem = match sha256_file(&set.path) {
        Ok(sum) if sum == set.sha256 => return Some(&set.path),
        Ok(_) => "it is not what the run has read".to_owned(),
        Err(e) => e.to_string(),
    };
    let path = set.path.display();
    runtime
        .progress()
        .note(&format!("the run's structures are not shown ({path}: {problem}); --structures takes others"));
    None
}

/// Reads structures in the frame of the run's planning CT.
fn structures(path: &Path, planning: Option<&Path>, runtime: &Runtime) -> Result<Contours> {
    let (contours, warnings) = contours::of_planning(path, planning)?;
    for warning in warnings {
        runtime.progress().note(&format!("warning ({}): {}", warning.code, warning.message));
    }
    Ok(contours)
}

/// 128 random bits of the system, hexadecimal.
fn token() -> Result<String> {
    let mut bytes = [0u8; 16];
    getrandom::fill(&mut bytes).map_err(|e| Error::Internal(format!("no random numbers: {e}")))?;
    Ok(bytes.iter().map(|b| format!("{b:02x}")).collect())
}

/// The one page and who may have it.
struct Site {
    /// Address and port.
    host: String,
    token: String,
    page: String,
}

impl Site {
    fn address(&self) -> String {
        format!("http://{}/{}/", self.host, self.token)
    }

    /// What a request gets: another host's name in it is a page elsewhere that has had its name point here.
    fn status(&self, method: &Method, host: Option<&str>, path: &str) -> u16 {
        let port = self.host.rsplit(':').next().unwrap_or_default();
        let local = format!("localhost:{port}");
        match () {
            () if host != Some(&self.host) && host != Some(&local) => 403,
            () if *method != Method::Get => 405,
            () if path.strip_prefix('/').and_then(|p| p.strip_suffix('/')) == Some(&self.token) => 200,
            () => 404,
        }
    }

    /// Answers; what a browser that has gone away does not take is no failure.
    fn answer(&self, request: Request) {
        let named = request.headers().iter().find(|h| h.field.equiv("Host")).map(|h| h.value.as_str().to_owned());
        let status = self.status(request.method(), named.as_deref(), request.url());
        let text = if status == 200 { self.page.clone() } else { String::new() };
        // Whole: the length is known, and a browser shows how far it has come.
        let mut response = Response::from_string(text).with_status_code(status).with_chunked_threshold(usize::MAX);
        for (name, value) in [
            ("Content-Type", "text/html; charset=utf-8"),
            ("X-Content-Type-Options", "nosniff"),
            ("Cache-Control", "no-store"),
            ("Referrer-Policy", "no-referrer"),
        ] {
            response.add_header(Header::from_bytes(name, value).expect("these are legal headers"));
        }
        let _ = request.respond(response);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_page_is_given_to_whom_has_the_address() {
        let site = Site { host: "127.0.0.1:4000".into(), token: "abc".into(), page: String::new() };
        let get = |host, path| site.status(&Method::Get, host, path);
        assert_eq!(get(Some("127.0.0.1:4000"), "/abc/"), 200);
        assert_eq!(get(Some("localhost:4000"), "/abc/"), 200);
        for path in ["/", "/abc", "/abd/", "/abc/report.json", "/abc/../report.json", "//abc/", "/abc/%2e%2e/"] {
            assert_eq!(get(Some("127.0.0.1:4000"), path), 404, "{path}");
        }
        for host in [None, Some("evil.example"), Some("127.0.0.1"), Some("127.0.0.1:4001")] {
            assert_eq!(get(host, "/abc/"), 403, "{host:?}");
        }
        assert_eq!(site.status(&Method::Post, Some("127.0.0.1:4000"), "/abc/"), 405);
        assert_eq!(token().unwrap().len(), 32);
        assert_ne!(token().unwrap(), token().unwrap());
    }
}
