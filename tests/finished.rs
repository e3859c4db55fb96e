//! `aventail figure` and `aventail view` on a finished run.

#![expect(clippy::unwrap_used, reason = "a test that cannot read what it wrote fails")]

use crate::support::browser::Browser;
use crate::support::viewer::{click, numbers, on_canvas, pixels, told};
use crate::support::{
    Register, aventail, copy, dicom_phantom, done, files, folder, near, phantom, quick_settings, small_phantom,
};
use aventail::io::{read_field, read_image};
use aventail::volume::Volume;
use nalgebra::{Point3, Vector3};
use serde_json::Value;
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;

fn figure(run: &Path, kind: &str, plane: &str, out: &Path) -> assert_cmd::Command {
    let mut command = aventail();
    command.arg("figure").arg(run).args(["--quiet", "--kind", kind, "--plane", plane, "--out"]).arg(out);
    command
}

#[test]
fn figures_of_a_run_are_drawn_in_both_formats() {
    let run = &done().out;
    for (kind, plane, name) in [
        ("fusion", "sagittal", "fusion.svg"),
        ("displacement", "axial", "displacement.svg"),
        ("jacobian", "coronal", "jacobian.png"),
        ("uncertainty", "axial", "uncertainty.png"),
    ] {
        let out = folder().join(name);
        figure(run, kind, plane, &out).args(["--at", "-4"]).assert().success();
        let bytes = fs::read(&out).unwrap();
        if name.ends_with("svg") {
            let text = String::from_utf8(bytes).unwrap();
            assert!(
                text.starts_with("<svg") && text.contains("= -4.0 mm") && text.contains("data:image/png"),
                "{name}"
            );
            assert!(text.matches('M').count() > 50 && text.contains("<text"), "{name}");
        } else {
            let mut reader = png_size(&bytes);
            assert!(reader.remove(0) == 1080 && reader[0] > 200, "{name}");
        }
    }
    let out = folder().join("far.png");
    let far = figure(run, "fusion", "axial", &out).args(["--at", "5000"]).assert().code(2);
    assert!(String::from_utf8_lossy(&far.get_output().stderr).contains("outside the fraction scan") && !out.exists());
    figure(run, "fusion", "axial", &folder().join("figure.gif")).assert().code(2);
}

/// Width and height in the header of a PNG file.
fn png_size(bytes: &[u8]) -> Vec<u32> {
    [16, 20].map(|at| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap())).into()
}

#[test]
fn a_run_whose_files_or_inputs_have_changed_is_refused() {
    let changed = Register::quick("changed");
    changed.command().assert().success();
    let out = folder().join("changed.png");
    figure(&changed.out, "jacobian", "axial", &out).assert().success();
    fs::write(changed.out.join("body.nii.gz"), "other").unwrap();
    let refused = figure(&changed.out, "jacobian", "axial", &out).assert().code(4);
    assert!(String::from_utf8_lossy(&refused.get_output().stderr).contains("run-changed"));
    // An input that is another file now.
    let own = folder().join("own_fraction.nii.gz");
    fs::copy(&small_phantom().fraction, &own).unwrap();
    let run = Register::quick("own").fraction(&own);
    run.command().assert().success();
    fs::copy(&small_phantom().planning, &own).unwrap();
    let refused = figure(&run.out, "fusion", "axial", &out).assert().code(4);
    let message = String::from_utf8_lossy(&refused.get_output().stderr).into_owned();
    assert!(message.contains("run-changed") && message.contains("own_fraction"), "{message}");
}

/// A served run; ended with the test.
struct Served {
    process: Child,
    /// Address and port.
    host: String,
    path: String,
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn serve(run: &Path, more: &[&Path]) -> Served {
    let mut process = Command::new(env!("CARGO_BIN_EXE_aventail"))
        .args(["view", "--quiet", "--no-browser"])
        .arg(run)
        .args(more)
        .stdout(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut line = String::new();
    BufReader::new(process.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let address = line.trim().strip_prefix("http://").unwrap_or_else(|| panic!("no address: {line}"));
    let (host, path) = address.split_once('/').unwrap();
    Served { host: host.into(), path: format!("/{path}"), process }
}

#[test]
fn contours_of_another_frame_are_not_shown_as_planning() {
    let path = folder().join("elsewhere.json");
    let square = "[[0, 0, 0], [9, 0, 0], [9, 9, 0], [0, 9, 0]]";
    let text = format!(
        r#"{{"aventail_contours": 1, "frame": "day1", "structures": [{{"name": "a", "contours": [{square}]}}]}}"#
    );
    fs::write(&path, text).unwrap();
    let run =
        aventail().arg("view").arg(&done().out).args(["--quiet", "--no-browser", "--structures"]).arg(&path).assert();
    let said = String::from_utf8_lossy(&run.code(4).get_output().stderr).into_owned();
    assert!(said.contains("elsewhere.json") && said.contains("day1"), "{said}");
}

/// Status and body of what a request gets.
fn ask(served: &Served, method: &str, path: &str, host: &str) -> (u16, String) {
    let mut stream = TcpStream::connect(&served.host).expect("it listens");
    write!(stream, "{method} {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    let status = answer.split(' ').nth(1).and_then(|s| s.parse().ok()).unwrap_or_else(|| panic!("{answer}"));
    (status, answer.split_once("\r\n\r\n").map_or(String::new(), |(_, body)| body.to_owned()))
}

#[test]
fn a_run_is_served_to_whom_has_the_address_on_this_machine_alone() {
    let contours = phantom().planning.with_file_name("contours.json");
    let served = serve(&done().out, &[Path::new("--structures"), &contours]);
    assert!(served.host.starts_with("127.0.0.1:"), "{}", served.host);
    let own = served.host.clone();
    let (status, page) = ask(&served, "GET", &served.path, &own);
    assert!(status == 200 && page.contains("view-fraction") && page.contains("default-src 'none'"), "{status}");
    for path in ["/", "/report.json", "/0123456789abcdef0123456789abcdef/"] {
        assert_eq!(ask(&served, "GET", path, &own).0, 404, "{path}");
    }
    for more in ["../report.json", "report.json", "..%2freport.json", "../../../../etc/passwd"] {
        let (status, body) = ask(&served, "GET", &format!("{}{more}", served.path), &own);
        assert!(status == 404 && body.is_empty(), "{more}: {status}");
    }
    assert_eq!(ask(&served, "POST", &served.path, &own).0, 405);
    assert_eq!(ask(&served, "GET", &served.path, "evil.example").0, 403);
    // Nothing listens on that port but on loopback.
    if let Ok(table) = fs::read_to_string("/proc/net/tcp") {
        let port: u16 = own.rsplit(':').next().unwrap().parse().unwrap();
        let listening: Vec<&str> =
            table.lines().filter(|l| l.contains(&format!(":{port:04X} 00000000:0000 0A"))).collect();
        assert!(listening.len() == 1 && listening[0].contains("0100007F:"), "{listening:?}");
    }
    // The page shows every voxel of the fraction.
    let report: Value = serde_json::from_slice(&fs::read(done().out.join("report.json")).unwrap()).unwrap();
    let about = page.split("id=\"view-about\"").nth(1).and_then(|rest| rest.split_once('>')).unwrap().1;
    let about = about.split("</script>").next().unwrap();
    let about: Value = serde_json::from_str(about).unwrap();
    let spacing = &report["fraction_grid"]["spacing"];
    for a in 0..3 {
        let apart = |v: &Value| v[a].as_f64().unwrap();
        assert!((apart(&about["grid"]["spacing"]) - apart(spacing)).abs() < 1e-9, "{}", about["grid"]);
    }
    let Some(browser) = Browser::start(&folder().join("profile")) else { return };
    browser.open_address(&format!("http://{}{}", served.host, served.path));
    browser.wait("!!document.getElementById('viewer').dataset.state");
    assert_eq!(browser.text("document.getElementById('viewer').dataset.state"), "ready");
    tells_every_value(&browser);
    // Structures are drawn before and after, each with its own line to switch it.
    let names =
        browser.text("[...document.querySelectorAll('[data-list=structures] label')].map(l => l.textContent).join()");
    assert!(names.contains("parotid_left") && names.contains("ctv"), "{names}");
    browser.value("document.querySelectorAll('[data-list=structures] input').forEach(box => box.click())");
    let bare = pixels(&browser, "coronal");
    browser.value("document.querySelectorAll('[data-list=structures] input').forEach(box => box.click())");
    assert!(bare != pixels(&browser, "coronal"));
}

/// What stands under the crosshair is what the files hold at that voxel: HU, noise of air too, and displacement.
fn tells_every_value(browser: &Browser) {
    let run = &done().out;
    let fraction = read_image(phantom().fraction.clone()).unwrap().value;
    let deformed = read_image(run.join("planning_on_fraction.nii.gz")).unwrap().value;
    let pull = read_field(run.join("fraction_to_planning.nii.gz")).unwrap().value;
    browser.value("document.getElementById('viewer').scrollIntoView()");
    let (mut moved, mut air) = (0, 0);
    for n in 0..24 {
        let shares = [0.06 + 0.88 * f64::from(n % 6) / 5.0, 0.1 + 0.8 * f64::from(n / 6) / 3.0];
        click(browser, on_canvas(browser, ["axial", "coronal", "sagittal"][n as usize % 3], shares));
        let at = Point3::from(numbers(&told(browser, "at")));
        let voxel = fraction.grid().voxel_at(&at).expect("the crosshair lies in the scan");
        let hu = |image: &Volume<f32>| format!("{}", *image.at(voxel));
        assert_eq!([told(browser, "fraction"), told(browser, "deformed")], [hu(&fraction), hu(&deformed)], "{at}");
        air += usize::from(*fraction.at(voxel) < -905.0);
        let displacement = told(browser, "displacement");
        let Some(parts) = displacement.split(['(', ')']).nth(1) else { continue };
        let v = Vector3::from(pull.at(voxel).map(f64::from));
        assert!((numbers(parts) + v).amax() < 0.0051, "{displacement} {v}");
        moved += usize::from(v.norm() > 3.0);
    }
    assert!(moved >= 3 && air >= 3, "{moved} places moved, {air} of air");
}

#[test]
fn a_made_posture_is_drawn_and_served_too() {
    let pose = folder().join("nod.toml");
    fs::write(&pose, "[bones.skull]\nflexion_deg = 4.0\n").unwrap();
    let out = folder().join("posed");
    let f = small_phantom();
    let mut command = aventail();
    command.arg("pose").arg("--planning").arg(&f.planning).arg("--bones").arg(&f.bones).arg("--pose").arg(&pose);
    command.args(["--margin", "20", "--quiet", "--config"]).arg(quick_settings()).arg("--out").arg(&out);
    command.assert().success();
    for (kind, name) in [("fusion", "posed.png"), ("displacement", "posed.svg")] {
        figure(&out, kind, "sagittal", &folder().join(name)).assert().success();
    }
    let served = serve(&out, &[]);
    let (status, page) = ask(&served, "GET", &served.path, &served.host);
    assert!(status == 200 && page.contains("view-fraction"), "{status}");
}

/// The second fraction of the small phantom.
fn second() -> PathBuf {
    small_phantom().planning.parent().unwrap().join("fraction_2/fraction_ct.nii.gz")
}

/// Two fractions, registered together once.
fn both() -> &'static Path {
    static RUN: OnceLock<PathBuf> = OnceLock::new();
    RUN.get_or_init(|| {
        let both = Register::searched("both").with("--fraction", second());
        both.command().assert().success();
        both.out
    })
}

#[test]
fn of_several_fractions_one_is_to_be_named() {
    let both = both();
    let out = folder().join("both.png");
    let refused = figure(both, "fusion", "axial", &out).assert().failure();
    let said = String::from_utf8_lossy(&refused.get_output().stderr).into_owned();
    for name in ["1", "2"] {
        let one = both.join(name);
        assert!(said.contains(&one.display().to_string()), "{said}");
        figure(&one, "fusion", "axial", &out).assert().success();
    }
    // The page above leads to them, and is named.
    let page = both.join("index.html");
    assert!(said.contains(&page.display().to_string()), "{said}");
    let index: Value = serde_json::from_slice(&fs::read(both.join("index.json")).unwrap()).unwrap();
    for (n, name) in ["1", "2"].into_iter().enumerate() {
        let report: Value = serde_json::from_slice(&fs::read(both.join(name).join("report.json")).unwrap()).unwrap();
        let line = &index["fractions"][n];
        assert_eq!((line["fraction"].as_str(), &line["verdict"]), (Some(name), &report["verdict"]));
        assert_eq!(line["warned"].as_u64(), report["warnings"].as_array().map(|w| w.len() as u64));
        assert_eq!(line["figures"]["folded_percent"], report["jacobian"]["body"]["folded_percent"]);
        assert_eq!(index["inputs"][n]["path"], format!("{name}/report.json"));
    }
    let Some(browser) = Browser::start(&folder().join("index")) else { return };
    browser.open(&page);
    let shown = "[...document.images].every(i => i.complete && i.naturalWidth > 100) && document.images.length";
    assert_eq!(browser.value(shown), 2);
    let links = "[...document.querySelectorAll('table a')].map(a => a.getAttribute('href')).join()";
    assert_eq!(browser.text(links), "1/report.html,2/report.html");
    let (complaints, requests) = browser.complaints_and_requests();
    assert!(complaints.is_empty() && requests.iter().all(|r| r.starts_with("data:") || r.ends_with("index.html")));
    let phone = serde_json::json!({ "width": 390, "height": 800, "deviceScaleFactor": 2, "mobile": true });
    browser.call("Emulation.setDeviceMetricsOverride", phone);
    let wide = browser.value("document.documentElement.scrollWidth").as_f64().expect("a number");
    assert!(wide <= 390.0, "{wide}");
}

#[test]
fn an_index_goes_when_its_fractions_do() {
    let run = || Register::searched("index_goes").with("--fraction", second());
    copy(both(), &run().out);
    let index = run().out.join("index.html");
    assert!(index.is_file());
    // Refused before it writes: it stays.
    run().with("--max-memory", "0.0001").command().assert().failure();
    assert!(index.is_file());
    // The first fraction is registered anew and the second fails: the index would tell of what is no longer there.
    let bytes = fs::read(second()).unwrap();
    fs::create_dir_all(folder().join("torn")).unwrap();
    let torn = files::bytes(&folder().join("torn/fraction_ct.nii.gz"), &bytes[..bytes.len() / 2]);
    Register::searched("index_goes").with("--fraction", torn).command().assert().failure();
    assert!(!index.is_file() && !run().out.join("index.json").is_file());
}

#[test]
fn structures_that_a_run_carried_are_shown_by_themselves() {
    let made = dicom_phantom();
    let (dicom, out, set) = (made.join("dicom"), folder().join("carried"), folder().join("RS.dcm"));
    fs::copy(dicom.join("planning/RS.dcm"), &set).unwrap();
    let mut run = aventail();
    run.arg("register").arg("--config").arg(quick_settings()).arg("--planning").arg(dicom.join("planning"));
    run.arg("--bones").arg(made.join("bones.nii.gz")).arg("--fraction").arg(dicom.join("fraction"));
    run.args(["--dicom", "--quiet", "--start", &near(), "--structures"])
        .arg(&set)
        .arg("--out")
        .arg(&out)
        .assert()
        .success();
    let names = |served: &Served| {
        let (status, page) = ask(served, "GET", &served.path, &served.host);
        assert_eq!(status, 200);
        let about = page.split("id=\"view-about\"").nth(1).and_then(|rest| rest.split_once('>')).unwrap().1;
        let about: Value = serde_json::from_str(about.split("</script>").next().unwrap()).unwrap();
        about["structures"].to_string()
    };
    assert!(names(&serve(&out, &[])).contains("parotid_left"));
    // A file that has changed since is not what the run carried.
    let mut bytes = fs::read(&set).unwrap();
    bytes.push(0);
    fs::write(&set, bytes).unwrap();
    assert!(!names(&serve(&out, &[])).contains("parotid_left"));
}
